//! Hints, places that belong together or apart, as constraints on the labelling of cells.
//!
//! The expected Rand index is maximised by a labelling of greatest Σ a_x a_y (C_xy − t) ([`super::labelling`]). A hint
//! excludes some labellings: two cells must share a label, or must not. Only the parts that contain hints are
//! relabelled, so one hint moves one cut and nothing else:
//! - a part whose hints must not share a label is divided among them ([`Affinities::divide`]);
//! - any other part stays whole, and parts that contain places of one group are joined.
//!
//! In a divided part each cell goes to the hint y with the greatest C_xy − λ d_xy. C alone is constant on superfaces;
//! the path length d, through the part and longer over creases, decides between hints with equal C. Moving cells
//! afterwards by their mean C to a whole piece was tried: it is worse, since one wrong piece attracts others.
//!
//! Cost: for each superface with hints, one shortest-path search over the cells of a divided part; milliseconds.

use super::cell_graph::CellGraph;
use super::cell_labels::{class_sums, compact, connected_pieces};
use super::ensemble::Superfaces;
use super::matrix::Square;
use crate::base::dijkstra::shortest_paths;
use crate::base::groups::Groups;
use crate::base::union_find::Forest;
use crate::base::vector::distance;
use std::collections::BTreeMap;

/// λ: the reduction of the probability of belonging together per path length of √(area).
const PATH: f64 = 0.1;
/// Length equivalent to a turn of one radian, on concave and on convex boundaries.
const TURN: [f64; 2] = [1.5, 0.05];
/// Path length to a hint on another component.
const UNREACHED: f64 = 1e3;

/// Hints about cells.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Hints {
    /// Groups of cells; the cells of a group belong together. A group may be a single cell.
    pub groups: Vec<Vec<u32>>,
    /// Sets of groups, given by their numbers; no two groups of a set belong together.
    pub apart: Vec<Vec<usize>>,
}

impl Hints {
    /// The first two groups that must be apart but have the same `class`.
    fn joined(&self, mut class: impl FnMut(u32) -> u32) -> Option<[usize; 2]> {
        // For each class the last set that contained it, and the group there.
        let mut seen = vec![(usize::MAX, 0); self.groups.len()];
        for (number, set) in self.apart.iter().enumerate() {
            for &group in set {
                let seen = &mut seen[class(group as u32) as usize];
                if seen.0 == number {
                    return Some([seen.1, group]);
                }
                *seen = (number, group);
            }
        }
        None
    }
}

/// Two groups that belong apart but have a cell in common, or are joined by other groups.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conflict(pub [usize; 2]);

/// How strongly cells belong together: the basis for dividing parts.
#[derive(Clone, Copy, Debug)]
pub struct Affinities<'a> {
    /// The cells (S); their arrays must be finite ([`CellGraph::cleaned`]).
    pub cells: &'a CellGraph,
    /// The superfaces (R).
    pub superfaces: &'a Superfaces,
    /// Probability that two superfaces belong together (R × R).
    pub co_association: &'a Square,
    /// Connected pieces below this share of the area join a neighbour.
    pub small_part: f64,
}

/// A hint: a cell, and its class.
pub type Seed = (u32, u32);

impl Affinities<'_> {
    /// Divides the cells of part `part` of `label` (S) among the `seeds` in it: returns the class of each cell of the
    /// part, ascending. Each seed keeps its class. Small pieces without a seed join an adjacent class.
    pub fn divide(&self, label: &[u32], part: u32, seeds: &[Seed]) -> Vec<(u32, u32)> {
        let members: Vec<u32> = (0..label.len() as u32).filter(|&cell| label[cell as usize] == part).collect();
        let mut place = vec![u32::MAX; label.len()];
        members.iter().zip(0u32..).for_each(|(&cell, k)| place[cell as usize] = k);
        let inside = |&e: &usize| self.cells.pairs[e].iter().all(|&cell| place[cell as usize] != u32::MAX);
        let edges: Vec<usize> = (0..self.cells.pairs.len()).filter(inside).collect();
        let pairs: Vec<[u32; 2]> =
            edges.iter().map(|&e| self.cells.pairs[e].map(|cell| place[cell as usize])).collect();
        let lengths: Vec<f64> = edges.iter().map(|&e| self.step(e)).collect();
        let both = |(&[i, j], &length): (&[u32; 2], &f64)| [(i, (j, length)), (j, (i, length))];
        let steps = Groups::of(members.len(), pairs.iter().zip(&lengths).flat_map(both));
        // Seeds of one class in one superface have the same C: one search from all of them finds the nearest.
        let mut sources: BTreeMap<(u32, u32), Vec<u32>> = BTreeMap::new();
        for &(cell, class) in seeds {
            let superface = self.superfaces.of_cell[cell as usize];
            sources.entry((class, superface)).or_default().push(place[cell as usize]);
        }
        let mut best = vec![(f64::INFINITY, u32::MAX); members.len()];
        for (&(class, superface), cells) in &sources {
            let mut path = vec![f64::INFINITY; members.len()];
            shortest_paths(cells, |i| steps.of_owner(i).iter().copied(), f64::INFINITY, &mut path, |_| ());
            let row = self.co_association.row(superface as usize);
            for ((best, &cell), path) in best.iter_mut().zip(&members).zip(path) {
                let other = self.superfaces.of_cell[cell as usize];
                let together = if other == superface { 1. } else { row[other as usize] };
                let cost = PATH * path.min(UNREACHED) - together;
                if cost < best.0 {
                    *best = (cost, class);
                }
            }
        }
        let mut class: Vec<u32> = best.into_iter().map(|(_, class)| class).collect();
        let mut seeded = vec![false; members.len()];
        for &(cell, own) in seeds {
            let k = place[cell as usize] as usize;
            (class[k], seeded[k]) = (own, true);
        }
        self.reassign_small_pieces(&members, &pairs, &edges, &seeded, &mut class);
        members.into_iter().zip(class).collect()
    }

    /// Length of crossing the boundary `edge`, a pair of the cell graph.
    pub fn step(&self, edge: usize) -> f64 {
        let [a, b] = self.cells.pairs[edge].map(|cell| self.cells.centre[cell as usize]);
        distance(a, b) + TURN[0] * self.cells.concave[edge] + TURN[1] * self.cells.convex[edge]
    }

    /// Reassigns small pieces of a class without a seed to the class that shares the longest boundary with them.
    fn reassign_small_pieces(
        &self,
        members: &[u32],
        pairs: &[[u32; 2]],
        edges: &[usize],
        seeded: &[bool],
        class: &mut [u32],
    ) {
        let (piece, count) = connected_pieces(pairs, class);
        let total = self.cells.total_area();
        let shares: Vec<f64> = members.iter().map(|&cell| self.cells.area[cell as usize] / total).collect();
        let area = class_sums(&piece, &shares, count);
        let mut loose: Vec<bool> = area.iter().map(|&area| area < self.small_part).collect();
        piece.iter().zip(seeded).filter(|(_, seeded)| **seeded).for_each(|(&p, _)| loose[p as usize] = false);
        let mut shared: BTreeMap<(u32, u32), f64> = BTreeMap::new();
        for (&[i, j], &edge) in pairs.iter().zip(edges) {
            for (i, j) in [(i as usize, j as usize), (j as usize, i as usize)] {
                if piece[i] != piece[j] && loose[piece[i] as usize] && !loose[piece[j] as usize] {
                    *shared.entry((piece[i], class[j])).or_default() += self.cells.length[edge];
                }
            }
        }
        let mut into: Vec<Option<(f64, u32)>> = vec![None; count];
        for ((piece, class), length) in shared {
            let best = into[piece as usize].get_or_insert((0., class));
            if length > best.0 {
                *best = (length, class);
            }
        }
        for (class, &piece) in class.iter_mut().zip(&piece) {
            *class = into[piece as usize].map_or(*class, |(_, class)| class);
        }
    }

    /// `label` (S) changed as little as `hints` require: labels numbered by first appearance, and their number.
    ///
    /// # Errors
    /// Hints that contradict each other.
    pub fn satisfy(&self, hints: &Hints, label: &[u32]) -> Result<(Vec<u32>, usize), Conflict> {
        let groups = hints.groups.len();
        // Groups with a common cell are merged.
        let mut sets = Forest::new(groups);
        let mut group_at: BTreeMap<u32, u32> = BTreeMap::new();
        for (group, cells) in hints.groups.iter().enumerate() {
            for &cell in cells {
                sets.join(group as u32, *group_at.entry(cell).or_insert(group as u32));
            }
        }
        if let Some(groups) = hints.joined(|group| sets.find(group)) {
            return Err(Conflict(groups));
        }
        // Seeds by part; the class of a seed is its group.
        let mut by_part: BTreeMap<u32, Vec<Seed>> = BTreeMap::new();
        for (&cell, &group) in &group_at {
            by_part.entry(label[cell as usize]).or_default().push((cell, sets.find(group)));
        }
        let parts = label.iter().max().map_or(0, |top| top + 1);
        let mut new = label.to_vec();
        // Classes merged because they share an undivided part.
        let mut classes = Forest::new(groups);
        for (&part, seeds) in &by_part {
            let first = seeds[0].1;
            let mut trial = classes.clone();
            seeds.iter().for_each(|&(_, class)| {
                trial.join(first, class);
            });
            if hints.joined(|group| trial.find(sets.find(group))).is_none() {
                classes = trial;
                new.iter_mut().filter(|label| **label == part).for_each(|label| *label = parts + first);
            } else {
                for (cell, class) in self.divide(label, part, seeds) {
                    new[cell as usize] = parts + class;
                }
            }
        }
        for label in &mut new {
            if *label >= parts {
                *label = parts + classes.find(*label - parts);
            }
        }
        Ok(compact(&new))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of 12 cells in four superfaces of three; C decreases with the number of superfaces in between.
    fn strip() -> (CellGraph, Superfaces, Square) {
        let n = 12u32;
        let cells = CellGraph {
            seed: Vec::new(),
            area: vec![1.; 12],
            centre: (0..n).map(|i| [0.1 * f64::from(i), 0., 0.]).collect(),
            normal: vec![[0., 0., 1.]; 12],
            pairs: (1..n).map(|i| [i - 1, i]).collect(),
            length: vec![1.; 11],
            concave: vec![0.; 11],
            convex: vec![0.; 11],
            convex04: vec![0.; 11],
            ..CellGraph::default()
        };
        let superfaces = Superfaces::kept((0..n).map(|i| i / 3).collect(), vec![3.; 4]).unwrap();
        let c = (0..16).map(|k| 0.9 - 0.2 * f64::from((k / 4i32 - k % 4).abs())).collect();
        (cells, superfaces, Square::from_values(4, c))
    }

    fn satisfy(hints: &Hints, label: &[u32]) -> Result<(Vec<u32>, usize), Conflict> {
        let (cells, superfaces, c) = strip();
        Affinities { cells: &cells, superfaces: &superfaces, co_association: &c, small_part: 0.003 }
            .satisfy(hints, label)
    }

    #[test]
    fn one_hint_moves_one_cut() {
        let label = [0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2];
        let apart = Hints { groups: vec![vec![0], vec![5]], apart: vec![vec![0, 1]] };
        assert_eq!(satisfy(&apart, &label).unwrap(), (vec![0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3], 4));
        let together = Hints { groups: vec![vec![7, 11]], apart: vec![] };
        assert_eq!(satisfy(&together, &label).unwrap(), (vec![0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1], 2));
        let none = Hints { groups: vec![vec![0], vec![7]], apart: vec![vec![0, 1]] };
        assert_eq!(satisfy(&none, &label).unwrap().0, label, "a hint that holds already changes nothing");
    }

    #[test]
    fn a_place_moves_from_one_part_to_another() {
        let label = [0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2];
        // 4 belongs with 7, not with 1.
        let hints = Hints { groups: vec![vec![4, 7], vec![1]], apart: vec![vec![0, 1]] };
        assert_eq!(satisfy(&hints, &label).unwrap(), (vec![0, 0, 0, 1, 1, 1, 1, 1, 1, 2, 2, 2], 3));
    }

    #[test]
    fn whole_parts_do_not_join_what_belongs_apart() {
        // 0 and 3 belong together, 5 and 7 too, 0 and 7 apart: the first part has to be divided.
        let label = [0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2];
        let hints = Hints { groups: vec![vec![0, 2], vec![5, 7], vec![6]], apart: vec![vec![0, 2]] };
        let (found, _) = satisfy(&hints, &label).unwrap();
        assert_ne!(found[0], found[6]);
        assert_eq!((found[5], found[0]), (found[7], found[2]));
    }

    #[test]
    fn contradictions_are_told() {
        let hints = Hints { groups: vec![vec![0, 5], vec![5], vec![9]], apart: vec![vec![2, 0], vec![0, 1]] };
        assert_eq!(satisfy(&hints, &[0; 12]), Err(Conflict([0, 1])));
    }

    #[test]
    fn every_hint_holds_for_any_hints() {
        use crate::base::random::{below, stream};
        for seed in 0..300 {
            let mut random = stream(seed, "hints");
            let label: Vec<u32> = (0..12).map(|_| below(&mut random, 4) as u32).collect();
            let mut cells: Vec<u32> = (0..12).collect();
            for i in (1..12).rev() {
                cells.swap(i, below(&mut random, i + 1));
            }
            let groups: Vec<Vec<u32>> = cells.chunks(2).take(4).map(<[u32]>::to_vec).collect();
            let apart: Vec<Vec<usize>> =
                (0..3).map(|_| (0..4).filter(|_| below(&mut random, 2) == 0).collect()).collect();
            let hints = Hints { groups, apart };
            let (found, parts) = satisfy(&hints, &label).unwrap();
            assert_eq!(found.iter().max().map(|top| *top as usize + 1), Some(parts));
            for group in &hints.groups {
                assert!(group.iter().all(|&c| found[c as usize] == found[group[0] as usize]), "{seed} {hints:?}");
            }
            for set in &hints.apart {
                let mut labels: Vec<u32> = set.iter().map(|&a| found[hints.groups[a][0] as usize]).collect();
                labels.sort_unstable();
                assert!(labels.windows(2).all(|two| two[0] != two[1]), "{seed} {hints:?}");
            }
        }
    }
}
