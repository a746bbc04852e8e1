//! From C to a hierarchy: nested labellings at a ladder of thresholds, and the joins between.
//!
//! The labelling at ½ comes first, as the expected Rand index wants it. Below it each part is
//! labelled again at rising thresholds, so that cuts nest; above it parts are joined. A join's
//! level is the mean of C between the joined: the threshold from which on it loses. Where a number
//! of parts is given that is less than found, joins rank by what they add to the expected Rand index at ½, so the parts are
//! those of the greatest expected index that the hierarchy has for that number; where it is more, by their level.

use super::cells::{CellGraph, class_sums, compact};
use super::hierarchy::PartTree;
use super::labelling::{HALF, Pull, between};
use super::linkage::{Linkage, Rank};
use super::matrix::Square;
use super::members::Atoms;
use crate::base::Result;
use crate::base::parallel::map_chunks;
use crate::store::run::Run;

/// Thresholds above ½ at which parts are labelled again.
const LADDER: [f64; 10] = [0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 0.99];

/// Greatest level of what the labelling at ½ leaves apart: below ½ in single precision too.
const BELOW_HALF: f64 = 0.4999;

/// A union of atoms (or of cells): a thing on either side.
type Union = super::hierarchy::Union;

/// The hierarchy of cells whose atoms belong together with probabilities C.
///
/// # Errors
/// Cancellation.
pub fn soft_hierarchy(
    cells: &CellGraph,
    atoms: &Atoms,
    together: &Square,
    small_part: f64,
    run: &Run,
) -> Result<PartTree> {
    let n = atoms.len();
    let pull = Pull { area: &atoms.area, together };
    let everything: Vec<u32> = (0..n as u32).collect();
    let label = pull.best(&everything, HALF);
    let context = Context { touch: atoms.touch(cells), pull };
    // What becomes of a part above ½ is its own affair.
    let parts = members(&label);
    let ladders =
        map_chunks(run.threads, &run.cancel, parts.len(), || (), |k, ()| Ok(ladder(context.pull, &parts[k])))?;
    // Coarsest first; reversed at the end.
    let mut levels = vec![vec![0; n], label];
    for step in 0..LADDER.len() {
        let (mut finer, mut next) = (vec![0; n], 0);
        for (part, ladder) in parts.iter().zip(&ladders) {
            for (&x, k) in part.iter().zip(&ladder[step]) {
                finer[x as usize] = next + k;
            }
            next += ladder[step].iter().max().map_or(0, |m| m + 1);
        }
        levels.push(compact(&finer).0);
    }
    levels.push(everything);
    let stages = map_chunks(
        run.threads,
        &run.cancel,
        levels.len() - 1,
        || (),
        |k, ()| {
            let (low, high) = match k {
                0 => (0.0, BELOW_HALF),
                1 => (HALF, LADDER[0]),
                _ => (LADDER[k - 2], LADDER.get(k - 1).copied().unwrap_or(1.0)),
            };
            Ok(context.stage(&levels[k], &levels[k + 1], low, high))
        },
    )?;
    let coarse = stages.into_iter().rev().flatten();
    let cell = |atom: u32| atoms.first[atom as usize];
    let unions = coarse.map(|u| Union { a: cell(u.a), b: cell(u.b), ..u });
    Ok(PartTree::new(cells, within(cells, &atoms.of_cell).into_iter().chain(unions), small_part))
}

/// The labels of the atoms of one part at each threshold of [`LADDER`], each within those of the one before.
fn ladder(pull: Pull<'_>, part: &[u32]) -> Vec<Vec<u32>> {
    let mut label = vec![0; part.len()];
    let mut out = Vec::with_capacity(LADDER.len());
    for high in LADDER {
        let (mut finer, mut next) = (vec![0; part.len()], 0);
        for class in members(&label) {
            let atoms: Vec<u32> = class.iter().map(|&i| part[i as usize]).collect();
            let sub = pull.best(&atoms, high);
            for (&i, k) in class.iter().zip(&sub) {
                finer[i as usize] = next + k;
            }
            next += sub.iter().max().map_or(0, |m| m + 1);
        }
        label = compact(&finer).0;
        out.push(label.clone());
    }
    out
}

/// Unions of level 1 that make the atoms of their cells: strongest boundaries first, then, where
/// an atom is not connected, in cell order.
pub fn within(cells: &CellGraph, atom: &[u32]) -> Vec<Union> {
    let mut inside: Vec<usize> = (0..cells.pairs.len())
        .filter(|&k| atom[cells.pairs[k][0] as usize] == atom[cells.pairs[k][1] as usize])
        .collect();
    let strength = |k: usize| cells.length[k] * (-2.0 * cells.concave[k]).exp();
    inside.sort_by(|&a, &b| strength(b).total_cmp(&strength(a)));
    let certain = |a, b| Union { level: 1.0, rank: f64::INFINITY, a, b };
    let mut out: Vec<Union> = inside.iter().map(|&k| certain(cells.pairs[k][0], cells.pairs[k][1])).collect();
    let mut first = vec![u32::MAX; atom.iter().max().map_or(0, |&m| m as usize + 1)];
    for (&a, i) in atom.iter().zip(0u32..) {
        if first[a as usize] == u32::MAX {
            first[a as usize] = i;
        }
        out.push(certain(first[a as usize], i));
    }
    out
}

/// The members of each class of a labelling.
fn members(label: &[u32]) -> Vec<Vec<u32>> {
    let mut out = vec![Vec::new(); label.iter().max().map_or(0, |&m| m as usize + 1)];
    for (&k, i) in label.iter().zip(0u32..) {
        out[k as usize].push(i);
    }
    out
}

struct Context<'a> {
    touch: Vec<(u32, u32, f64)>,
    pull: Pull<'a>,
}

impl Context<'_> {
    /// The unions that lead from the classes `fine` to the classes `coarse`, levels within
    /// `low`..`high`, greatest first.
    fn stage(&self, coarse: &[u32], fine: &[u32], low: f64, high: f64) -> Vec<Union> {
        let mut out: Vec<Union> = Vec::new();
        for class in members(coarse) {
            let (sub, n) = compact(&class.iter().map(|&x| fine[x as usize]).collect::<Vec<_>>());
            if n > 1 {
                out.extend(self.inside(&class, &sub, n, low, high));
            }
        }
        out
    }

    /// The unions of the `n` sub-classes of one class of atoms into one.
    fn inside(&self, class: &[u32], sub: &[u32], n: usize, low: f64, high: f64) -> Vec<Union> {
        let Pull { area, together } = self.pull;
        let size: Vec<f64> = class.iter().map(|&x| area[x as usize]).collect();
        let mut local = Square::zeros(class.len());
        for (i, &x) in class.iter().enumerate() {
            let from = together.row(x as usize);
            for ((slot, &y), b) in local.row_mut(i).iter_mut().zip(class).zip(&size) {
                *slot = size[i] * b * from[y as usize];
            }
        }
        let mut name = vec![u32::MAX; area.len()];
        let mut first = vec![u32::MAX; n];
        for (&x, &k) in class.iter().zip(sub) {
            name[x as usize] = k;
            first[k as usize] = first[k as usize].min(x);
        }
        let mut touch = Square::zeros(n);
        for &(a, b, length) in &self.touch {
            let (a, b) = (name[a as usize], name[b as usize]);
            if a != b && a != u32::MAX && b != u32::MAX {
                touch.add_both(a as usize, b as usize, length);
            }
        }
        let linkage = Linkage { sums: between(&local, sub, n), area: class_sums(sub, &size, n), touch: Some(touch) };
        linkage
            .joins(if low < HALF { Rank::Gain } else { Rank::Mean }, 1)
            .iter()
            .map(|join| {
                // Below the labelling at ½ what people would least miss goes first. Above it all joins gain, a crumb's
                // the least, whether it is one or not: there the surest come first.
                let rank = if low < HALF { join.gain.min(0.0) } else { join.mean.max(f64::MIN_POSITIVE) };
                Union { level: join.mean.clamp(low, high), rank, a: first[join.i], b: first[join.j] }
            })
            .collect()
    }
}
