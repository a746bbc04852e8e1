//! The members: over-segmentations of random subsets of the rows, each merged down to one part,
//! and what they say together of any two cells.

use super::anchor::{Rows, anchor_embedding};
use super::cells::{CellGraph, class_sums, intersect};
use super::convexity::{PairSums, WIDTHS, convexity};
use super::cost::Model;
use super::matrix::Square;
use super::over_segment::{Recipe, over_segment};
use super::regions::{Columns, EMBEDDED, Regions, cell_columns};
use super::thickness::log_thickness;
use super::tree::{meeting_probability, merges};
use crate::base::Result;
use crate::base::parallel::{map_chunks, map_ranges};
use crate::base::random::{below, stream};
use crate::store::run::Run;

/// s over the mean distance in the embedding whose means regions are compared by.
pub const COMPARE_SCALE: f64 = 0.2;
/// Atoms a chunk when members are averaged.
const CHUNK: usize = 32;

/// One over-segmentation of the cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Member {
    /// Region of each cell (S), numbered 0, 1, ….
    pub region: Vec<u32>,
    /// Number of regions.
    pub regions: usize,
    /// Its pair width, an index into [`WIDTHS`].
    pub width: usize,
}

impl Member {
    /// The member made by `recipe`; random choices from the stream named by `purpose`.
    pub fn new(cells: &CellGraph, rows: &Rows, recipe: &Recipe, width: usize, seed: u64, purpose: &str) -> Member {
        let (region, regions) = over_segment(cells, rows, recipe, &mut stream(seed, purpose));
        Member { region, regions, width }
    }
}

/// `count` random members, each from a stream of its own.
///
/// # Errors
/// Cancellation.
pub fn draw_members(cells: &CellGraph, rows: &Rows, count: usize, purpose: &str, run: &Run) -> Result<Vec<Member>> {
    map_chunks(
        run.threads,
        &run.cancel,
        count,
        || (),
        |k, ()| {
            let mut random = stream(run.seed, &format!("{purpose} {k}"));
            let recipe = Recipe::draw(rows.count, &mut random);
            let width = below(&mut random, WIDTHS.len());
            Ok(Member::new(cells, rows, &recipe, width, run.seed, &format!("{purpose} {k} clusters")))
        },
    )
}

/// Atoms, the intersections of the members' regions, and what region sums are gathered from.
#[derive(Clone, Debug)]
pub struct Atoms {
    /// Atom of each cell (S), numbered by first appearance.
    pub of_cell: Vec<u32>,
    /// A cell of each atom: its first (R).
    pub first: Vec<u32>,
    /// Area of each atom (R).
    pub area: Vec<f64>,
    /// Sums a cell (S).
    pub columns: Vec<Columns>,
    /// Convexity between atoms.
    pub sums: Vec<PairSums>,
}

impl Atoms {
    /// The atoms of some members.
    ///
    /// # Errors
    /// Cancellation.
    pub fn of(cells: &CellGraph, rows: &Rows, members: &[Member], run: &Run) -> Result<Atoms> {
        let (mut of_cell, mut n) = (vec![0; cells.len()], usize::from(!cells.is_empty()));
        for m in members {
            (of_cell, n) = intersect(&of_cell, &m.region);
        }
        let mut first = vec![0; n];
        for (i, &a) in of_cell.iter().enumerate().rev() {
            first[a as usize] = i as u32;
        }
        let all: Vec<usize> = (0..rows.count).collect();
        let embedding = anchor_embedding(rows, &all, &cells.area_shares(), EMBEDDED, COMPARE_SCALE);
        let thickness = log_thickness(cells, run)?;
        Ok(Atoms {
            area: class_sums(&of_cell, &cells.area, n),
            sums: convexity(cells, &thickness, &of_cell, n, run)?,
            columns: cell_columns(cells, &embedding, &thickness),
            of_cell,
            first,
        })
    }

    /// Atoms as they were kept: which each cell belongs to (S), and their areas (R). Enough for cutting a hierarchy, not
    /// for making one. `None` where a number names no atom, or an atom no cell.
    pub fn kept(of_cell: Vec<u32>, area: Vec<f64>) -> Option<Atoms> {
        let mut first = vec![u32::MAX; area.len()];
        for (cell, &atom) in of_cell.iter().enumerate().rev() {
            *first.get_mut(atom as usize)? = cell as u32;
        }
        let whole = !first.contains(&u32::MAX);
        whole.then(|| Atoms { of_cell, first, area, columns: Vec::new(), sums: Vec::new() })
    }

    /// Number of atoms R.
    pub fn len(&self) -> usize {
        self.first.len()
    }

    /// Whether there is no atom.
    pub fn is_empty(&self) -> bool {
        self.first.is_empty()
    }

    /// A labelling of cells that is constant on atoms, as one of atoms.
    pub fn labels(&self, cells: &[u32]) -> Vec<u32> {
        self.first.iter().map(|&i| cells[i as usize]).collect()
    }

    /// Region sums of a labelling of cells that is constant on atoms.
    pub fn regions(&self, cells: &CellGraph, region: &[u32], n: usize, width: usize) -> Regions {
        Regions::gather(cells, &self.columns, region, n, &self.sums, &self.labels(region), width)
    }

    /// Sums of the boundary lengths between atoms, as a list of (atom, atom, length).
    pub fn touch(&self, cells: &CellGraph) -> Vec<(u32, u32, f64)> {
        let name = |i: u32| self.of_cell[i as usize];
        let apart = |(&[i, j], &length): (&[u32; 2], &f64)| (name(i), name(j), length);
        cells.pairs.iter().zip(&cells.length).map(apart).filter(|(a, b, _)| a != b).collect()
    }
}

/// C (R × R): for two atoms the mean over the members of the probability at their lowest common
/// merge, 1 where a member has them in one region, 0 where its tree never joins them.
///
/// # Errors
/// Cancellation.
pub fn co_association(
    cells: &CellGraph,
    atoms: &Atoms,
    members: &[Member],
    model: &Model,
    run: &Run,
) -> Result<Square> {
    let trees = map_chunks(
        run.threads,
        &run.cancel,
        members.len(),
        || (),
        |k, ()| {
            let m = &members[k];
            let regions = atoms.regions(cells, &m.region, m.regions, m.width);
            Ok((atoms.labels(&m.region), meeting_probability(m.regions, &merges(regions, model, |_, _| false))))
        },
    )?;
    average(atoms.len(), &trees, run)
}

/// C of `n` atoms from members' regions of the atoms and the probabilities that two of these belong together.
///
/// # Errors
/// Cancellation.
pub fn average(n: usize, trees: &[(Vec<u32>, Square)], run: &Run) -> Result<Square> {
    let share = 1.0 / trees.len().max(1) as f64;
    let rows = map_ranges(run.threads, &run.cancel, n, CHUNK, |range| {
        let mut out = vec![0.0; range.len() * n];
        for (label, p) in trees {
            for (a, row) in range.clone().zip(out.chunks_exact_mut(n)) {
                let p = p.row(label[a] as usize);
                row.iter_mut().zip(label).for_each(|(sum, &b)| *sum += p[b as usize]);
            }
        }
        out.iter_mut().for_each(|x| *x *= share);
        Ok(out)
    })?;
    Ok(Square::from_values(n, rows.concat()))
}
