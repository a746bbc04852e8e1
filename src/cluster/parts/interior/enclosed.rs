//! What a surface encloses: walls of cavities, and bodies within.
//!
//! An isosurface of a volume also shows the inside: the inner side of a shell, a brain within a skull, marrow within a
//! bone. Measured as one surface, a shell has no thick and thin places, and half of its area is inside. So the cells
//! visible from outside ([`super::exposure`]) are decided on alone. A hidden cell is the wall of a cavity if random
//! walks through the solid, from ray to ray, soon reach a visible cell; it then follows the visible cell on the other
//! side of the wall, so a hollow leg is one part including its inside, and a bone one part including its marrow.
//! Otherwise it belongs to a body within. A minimum cut of the hidden cells separates the two kinds, so single cells do
//! not decide. Bodies within are a layer of their own, to which the same procedure is applied, and so on.
//!
//! Cavities that are closed surfaces of their own are known by their winding ([`super::cavities`]), even behind walls
//! too thin to make them dark; their rays start into the solid too.
//!
//! Folds hide much of a surface too, but gradually. A cavity is dark right up to its openings, so a surface encloses
//! something only if nearly all of its hidden area is dark. Cups and vases are open to the light. If folds hide more,
//! only components that are dark as a whole are within.
//!
//! Cost: exposure from few directions, and from many if much is dim; if something is enclosed, also rays behind the
//! hidden cells, and one more pass per layer.

use super::cavities::{closed_cavities, turned};
use super::exposure::{Directions, dark_pieces, exposure};
use crate::base::Result;
use crate::base::vector::distance;
use crate::cluster::max_flow::MaxFlow;
use crate::cluster::parts::cell_graph::CellGraph;
use crate::cluster::parts::cell_labels::{class_sums, connected_pieces};
use crate::cluster::parts::thickness::first_hits;
use crate::store::run::Run;
use serde::{Deserialize, Serialize};

/// Exposure below which a cell is dark.
const DARK: f64 = 0.05;
/// Exposure below which a cell is hidden.
const HIDDEN: f64 = 0.4;
/// Something is enclosed only if at least this share of the area is dark, and at least as much is not hidden.
const LEAST_SHARE: f64 = 0.1;
/// Maximum ratio of the hidden area to the dark area if something is enclosed. Bodies with an inside have 1.01 to 1.07,
/// cortices and brains 1.27 and 1.41, the one vase of the benchmark that is dark within 1.23.
const MOST_HIDDEN_PER_DARK: f64 = 1.15;
/// Probability that a walk continues after each step; from .8 to .95 the same bodies are found.
const CONTINUATION: f64 = 0.9;
/// Number of steps computed; few walks are longer.
const STEPS: usize = 100;
/// Cost of a boundary between walls and bodies, as an area: this factor times its length times the side of a mean cell.
const BOUNDARY: f64 = 1.0;
/// The integer that represents an area of 1 in the minimum cut.
const UNITS: f64 = (1u64 << 40) as f64;
/// Minimum share of the total area for a piece to be a body within; smaller ones follow nearby cells.
const BODY: f64 = 0.02;

/// Which cells are decided on together, and which follow others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::cluster::parts) struct Layers {
    /// The cells of each layer, ascending: visible from outside, then visible after removing those, ….
    pub layers: Vec<Vec<u32>>,
    /// The cell of a layer that each cell follows (S): itself if it is in a layer.
    pub follows: Vec<u32>,
}

/// How much of a surface is inside, as shares of its area.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Enclosed {
    /// Walls of cavities, which get the labels of the surface behind them.
    pub walls: f64,
    /// Bodies within, which are cut on their own.
    pub bodies: f64,
}

impl Layers {
    /// The layers of a surface; `None` if it encloses nothing.
    ///
    /// # Errors
    /// Cancellation.
    pub fn of(cells: &CellGraph, run: &Run) -> Result<Option<Self>> {
        let mut out = Self { layers: Vec::new(), follows: (0..cells.len() as u32).collect() };
        let mut rest: Vec<u32> = out.follows.clone();
        while !rest.is_empty() {
            let surface = cells.subset(&rest);
            let Some(inside) = Inside::of(&surface, run)? else {
                out.layers.push(rest);
                break;
            };
            let left: f64 = rest.iter().map(|&i| cells.area[i as usize]).sum();
            let within = inside.bodies(&surface, BODY * cells.total_area() / left);
            let those = |of: &[bool]| rest.iter().zip(of).filter(|(_, is)| **is).map(|(&i, _)| i).collect::<Vec<u32>>();
            let (seen, deeper) = (those(&inside.is_seen), those(&within));
            if seen.is_empty() {
                out.layers.push(rest);
                break;
            }
            for (k, &cell) in rest.iter().enumerate().filter(|&(k, _)| !inside.is_seen[k] && !within[k]) {
                let behind = inside.behind[k].map(|j| rest[j as usize]);
                out.follows[cell as usize] = behind.unwrap_or_else(|| nearest(cells, cell, &seen));
            }
            out.layers.push(seen);
            rest = deeper;
        }
        let encloses = out.layers.len() > 1 || out.walls().contains(&true);
        Ok(encloses.then_some(out))
    }

    /// Whether each cell is a wall: one that follows another (S).
    pub fn walls(&self) -> Vec<bool> {
        self.follows.iter().zip(0..).map(|(&to, cell)| to != cell).collect()
    }

    /// The shares that are inside; `shares` are the cells' shares of the area (S).
    pub fn enclosed(&self, shares: &[f64]) -> Enclosed {
        let walls = self.walls().iter().zip(shares).filter(|(wall, _)| **wall).fold(0., |sum, (_, share)| sum + share);
        let bodies = self.layers.iter().skip(1).flatten().fold(0., |sum, &cell| sum + shares[cell as usize]);
        Enclosed { walls, bodies }
    }
}

/// The cell of `others` whose centre is nearest to that of `cell`; `cell` if there are none.
fn nearest(cells: &CellGraph, cell: u32, others: &[u32]) -> u32 {
    let far = |i: u32| distance(cells.centre[i as usize], cells.centre[cell as usize]);
    others.iter().copied().min_by(|&a, &b| far(a).total_cmp(&far(b))).unwrap_or(cell)
}

/// The inside of a surface that encloses something.
struct Inside {
    /// Whether each cell is visible from outside (S).
    is_seen: Vec<bool>,
    /// Whether each cell is the wall of a cavity (S).
    is_wall: Vec<bool>,
    /// A visible cell behind each hidden one, if there is any (S).
    behind: Vec<Option<u32>>,
}

impl Inside {
    fn of(cells: &CellGraph, run: &Run) -> Result<Option<Self>> {
        let cavities = closed_cavities(cells, run)?;
        let is_seen = match (seen(cells, run)?, &cavities) {
            (None, None) => return Ok(None),
            (Some(seen), None) => seen,
            (None, Some(cavities)) => cavities.iter().map(|&is_cavity| !is_cavity).collect(),
            (Some(seen), Some(cavities)) => seen.iter().zip(cavities).map(|(&seen, cavity)| seen && !cavity).collect(),
        };
        let turned = cavities.map(|cavities| turned(cells, &cavities));
        let hidden: Vec<u32> = (0..cells.len() as u32).filter(|&i| !is_seen[i as usize]).collect();
        let hits = first_hits(turned.as_ref().unwrap_or(cells), &hidden, run)?;
        let mut behind = vec![None; cells.len()];
        for (&cell, hits) in hidden.iter().zip(&hits) {
            behind[cell as usize] = hits.iter().copied().find(|&j| is_seen[j as usize]);
        }
        let walls = walks_reaching_visible(&hidden, &hits, &is_seen);
        let mut is_wall = vec![false; cells.len()];
        for (&cell, wall) in hidden.iter().zip(cut(cells, &hidden, &walls, run)?) {
            is_wall[cell as usize] = wall;
        }
        Ok(Some(Self { is_seen, is_wall, behind }))
    }

    /// Whether each of `cells` belongs to a body within: a connected piece of hidden cells that are not walls, with at
    /// least `least` of the area.
    fn bodies(&self, cells: &CellGraph, least: f64) -> Vec<bool> {
        let within: Vec<u32> =
            self.is_seen.iter().zip(&self.is_wall).map(|(seen, wall)| u32::from(!seen && !wall)).collect();
        let (piece, pieces) = connected_pieces(&cells.pairs, &within);
        let area = class_sums(&piece, &cells.area_shares(), pieces);
        within.iter().zip(&piece).map(|(&within, &piece)| within == 1 && area[piece as usize] >= least).collect()
    }
}

/// Whether each cell is visible from outside (S); `None` if hardly any is hidden, or none belongs to an inside.
///
/// # Errors
/// Cancellation.
fn seen(cells: &CellGraph, run: &Run) -> Result<Option<Vec<bool>>> {
    let total = cells.total_area();
    let darker = |exposure: &[f64], than: f64| {
        exposure.iter().zip(&cells.area).filter(|(x, _)| **x < than).map(|(_, area)| area / total).sum::<f64>()
    };
    if darker(&exposure(cells, Directions::Few, run)?, HIDDEN) < LEAST_SHARE {
        return Ok(None);
    }
    let exposure = exposure(cells, Directions::Many, run)?;
    let [dark, hidden] = [DARK, HIDDEN].map(|than| darker(&exposure, than));
    // If next to nothing is visible, it is a room scanned from within.
    if dark < LEAST_SHARE || 1. - hidden < LEAST_SHARE {
        return Ok(None);
    }
    if hidden <= MOST_HIDDEN_PER_DARK * dark {
        return Ok(Some(exposure.iter().map(|x| *x >= HIDDEN).collect()));
    }
    let is_seen = beside_dark_components(cells, &exposure);
    let within: f64 = is_seen.iter().zip(&cells.area).filter(|(seen, _)| !**seen).map(|(_, area)| area / total).sum();
    Ok((within >= LEAST_SHARE).then_some(is_seen))
}

/// Whether each cell is not in a component that is dark as a whole (S).
fn beside_dark_components(cells: &CellGraph, exposure: &[f64]) -> Vec<bool> {
    let (component, count) = connected_pieces(&cells.pairs, &vec![0; cells.len()]);
    let dark = dark_pieces(cells, exposure, &component, count, DARK);
    component.iter().map(|&k| !dark[k as usize]).collect()
}

/// For each of the `hidden` cells, the share of walks that reach a cell that `is_seen`; a step goes to any of `hits`. ½
/// if there are none.
fn walks_reaching_visible(hidden: &[u32], hits: &[Vec<u32>], is_seen: &[bool]) -> Vec<f64> {
    let mut share: Vec<f64> = is_seen.iter().map(|&seen| f64::from(u8::from(seen))).collect();
    let mean = |share: &[f64], hits: &Vec<u32>| {
        let step = |&j: &u32| if is_seen[j as usize] { 1. } else { CONTINUATION * share[j as usize] };
        if hits.is_empty() { 0.5 } else { hits.iter().map(step).sum::<f64>() / hits.len() as f64 }
    };
    for _ in 0..STEPS {
        let next: Vec<f64> = hits.iter().map(|hits| mean(&share, hits)).collect();
        hidden.iter().zip(next).for_each(|(&cell, x)| share[cell as usize] = x);
    }
    hidden.iter().map(|&cell| share[cell as usize]).collect()
}

/// Whether each of the `hidden` cells is a wall: the labelling that minimises the contradicted area plus the cost of
/// boundaries; `walls` is the share of each cell's area that votes for a wall.
fn cut(cells: &CellGraph, hidden: &[u32], walls: &[f64], run: &Run) -> Result<Vec<bool>> {
    let total = cells.total_area();
    let units = |area: f64| (area / total * UNITS) as i64;
    let mut number = vec![None; cells.len()];
    hidden.iter().zip(0u32..).for_each(|(&cell, k)| number[cell as usize] = Some(k));
    let side = (total / cells.len() as f64).sqrt();
    let mut beside = vec![Vec::new(); hidden.len()];
    for (&[i, j], length) in cells.pairs.iter().zip(&cells.length) {
        if let (Some(i), Some(j)) = (number[i as usize], number[j as usize]) {
            let worth = units(BOUNDARY * length * side);
            beside[i as usize].push((j, worth));
            beside[j as usize].push((i, worth));
        }
    }
    let area = |k: usize, share: f64| units(share * cells.area[hidden[k] as usize]);
    let source = walls.iter().enumerate().map(|(k, wall)| area(k, *wall)).collect();
    let sink = walls.iter().enumerate().map(|(k, wall)| area(k, 1. - wall)).collect();
    let (mut start, mut arcs) = (vec![0], Vec::new());
    for own in &beside {
        arcs.extend_from_slice(own);
        start.push(arcs.len() as u32);
    }
    let mut flow = MaxFlow::new(source, sink, start, &arcs);
    flow.run(&run.cancel)?;
    Ok((0..hidden.len()).map(|k| flow.is_on_source_side(k)).collect())
}

#[cfg(test)]
mod tests {
    use super::super::exposure::tests::balls;
    use super::*;

    fn layers(cells: &CellGraph) -> Option<Layers> {
        Layers::of(cells, &Run::new(&())).unwrap()
    }

    #[test]
    fn a_solid_ball_encloses_nothing() {
        assert_eq!(layers(&balls(&[(1., 1500, false)])), None);
        assert_eq!(layers(&balls(&[])), None);
    }

    #[test]
    fn a_wall_follows_what_lies_behind_it() {
        let cells = balls(&[(1., 1100, false), (0.9, 900, true)]);
        let shell = layers(&cells).unwrap();
        assert_eq!(shell.layers, [(0..1100).collect::<Vec<u32>>()]);
        let near = |(&to, cell): (&u32, usize)| distance(cells.centre[to as usize], cells.centre[cell]) < 0.1;
        assert!(shell.follows.iter().zip(0..).all(near));
        let enclosed = shell.enclosed(&cells.area_shares());
        assert!((enclosed.walls - 0.81 / 1.81).abs() < 1e-12 && enclosed.bodies == 0., "{enclosed:?}");
    }

    /// Every closed component is oriented outward; the winding in the file tells a cavity.
    #[test]
    fn what_was_flipped_unlike_the_outside_is_a_wall() {
        let with = |flipped: [bool; 2]| {
            let mut cells = balls(&[(1., 1100, false), (0.9, 900, false)]);
            cells.flipped = [vec![flipped[0]; 1100], vec![flipped[1]; 900]].concat();
            layers(&cells).unwrap()
        };
        for cavity in [[false, true], [true, false]] {
            let shell = with(cavity);
            assert_eq!(shell.layers, [(0..1100).collect::<Vec<u32>>()]);
            assert!(shell.follows.iter().all(|&to| to < 1100));
        }
        assert_eq!(with([true, true]).layers.len(), 2);
    }

    /// Regression: behind folds of the outside that hide more than the inside does, a cavity was part of the surface.
    #[test]
    fn components_that_are_dark_as_a_whole_are_within_whatever_folds_hide() {
        let cells = balls(&[(1., 1100, false), (0.5, 400, false)]);
        let exposure: Vec<f64> = (0..1500).map(|i| if i < 1100 { 0.3 } else { 0.01 }).collect();
        let seen = beside_dark_components(&cells, &exposure);
        assert!((0..1500).all(|i| seen[i] == (i < 1100)));
        let fold: Vec<f64> = (0..1500).map(|i| if i < 200 { 0. } else { 0.3 }).collect();
        assert!(beside_dark_components(&cells, &fold).iter().all(|&seen| seen));
    }

    #[test]
    fn bodies_within_are_layers_one_inside_the_other() {
        let all = [(1., 800, false), (0.93, 700, true), (0.6, 350, false), (0.53, 270, true), (0.3, 100, false)];
        let dolls = layers(&balls(&all)).unwrap();
        assert_eq!(dolls.layers, [(0..800).collect::<Vec<u32>>(), (1500..1850).collect(), (2120..2220).collect()]);
        assert!(dolls.follows[800..1500].iter().all(|&to| to < 800));
        assert!(dolls.follows[1850..2120].iter().all(|&to| (1500..1850).contains(&to)));
    }
}
