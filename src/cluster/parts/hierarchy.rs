//! The hierarchy of parts: the answers for all numbers of parts at once, small enough to keep.
//!
//! A binary tree from single cells to one part, stored as its unions. Their order is the one in which they are made
//! until a given number of parts is left; their levels, in \[0, 1\] and never above those of the unions below them,
//! determine which of them a threshold makes. The cut at ½ gives the parts found; any other cut is a pass over the
//! cells. Numbers are stored in single precision, which round-trips through decimal text. Memory: some 50 bytes per
//! cell. A cut is O(S + m).

use super::cell_graph::CellGraph;
use super::cell_labels::{compact, small_parts};
use crate::base::printable::counted;
use crate::base::sort::sort_by;
use crate::base::union_find::Forest;
use crate::base::{Error, Result};
use serde::{Deserialize, Serialize};

/// The threshold of the Rand index: pairs that are more likely than not to belong together.
pub const HALF: f64 = 0.5;
/// Version of the stored form.
const VERSION: u32 = 1;

/// A merge hierarchy of the cells of a surface, with the data needed to clean a cut.
///
/// ```
/// use nystrom_stream::cluster::parts::hierarchy::CellUnion;
/// use nystrom_stream::cluster::parts::{CellGraph, PartTree};
///
/// // Four cells in a row; the outer pairs surely belong together, the two halves probably not.
/// let pairs = vec![[0, 1], [1, 2], [2, 3]];
/// let cells = CellGraph { area: vec![1.; 4], length: vec![1.; 3], pairs, ..CellGraph::default() };
/// let union = |level, a, b| CellUnion { level, rank: level, a, b };
/// let tree = PartTree::new(&cells, [union(0.9, 0, 1), union(0.8, 2, 3), union(0.3, 0, 2)], 0.003);
/// assert_eq!(tree.cut_detail(0.).label, [0, 0, 1, 1]);
/// assert_eq!(tree.cut_k(3).unwrap().label, [0, 0, 1, 2]);
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(expecting = "an object with version, unions, level, area, pairs, length and small_part")]
pub struct PartTree {
    /// Version of this form.
    pub version: u32,
    /// The S − 1 unions in their order, finest first; a set of cells is identified by its least cell.
    pub unions: Vec<[u32; 2]>,
    /// Threshold up to which each union is made: the probability that the two belong together, or a similar measure.
    pub level: Vec<f32>,
    /// Area share of each cell (S).
    pub area: Vec<f32>,
    /// Neighbouring cells (m).
    pub pairs: Vec<[u32; 2]>,
    /// Length of their common boundary, in units of √(total area) (m).
    pub length: Vec<f32>,
    /// Connected pieces below this share of the area join a neighbour.
    pub small_part: f32,
}

/// A union of two sets of cells, each identified by any of its cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellUnion {
    /// Threshold up to which a cut makes this union, in \[0, 1\].
    pub level: f64,
    /// If a number of parts is given, unions of greater rank come first.
    pub rank: f64,
    /// A cell of the one set.
    pub a: u32,
    /// A cell of the other set.
    pub b: u32,
}

/// A cut of a [`PartTree`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TreeCut {
    /// Part of each cell (S), numbered by first appearance.
    pub label: Vec<u32>,
    /// Number of parts.
    pub parts: usize,
}

/// The threshold for a detail d: 0 gives ½, the parts found; towards 1 it is finer, ½ + d/2 (only what almost certainly
/// belongs together stays together); towards −1 it is coarser, ½ (1 + d)², since parts that people separate rarely have
/// a high probability.
pub fn detail_threshold(detail: f64) -> f64 {
    if !detail.is_finite() {
        return HALF;
    }
    let detail = detail.clamp(-1.0, 1.0);
    if detail < 0.0 { HALF * (1.0 + detail) * (1.0 + detail) } else { HALF + HALF * detail }
}

impl PartTree {
    /// The tree of the given unions, made in the given order. Levels and ranks are lowered to those of the unions
    /// below; unions of a set with itself are skipped; sets left over are united last, at level 0.
    pub fn new(cells: &CellGraph, unions: impl IntoIterator<Item = CellUnion>, small_part: f64) -> PartTree {
        let n = cells.len();
        let mut tree = PartTree {
            version: VERSION,
            area: cells.area_shares().iter().map(|&a| a as f32).collect(),
            pairs: cells.pairs.clone(),
            length: cells.length.iter().map(|&x| x as f32).collect(),
            small_part: small_part as f32,
            ..PartTree::default()
        };
        let mut sets = Forest::new(n);
        // Level and rank of the union that made each set.
        let mut made = vec![(1.0f64, f64::INFINITY); n];
        let mut all = Vec::with_capacity(n.saturating_sub(1));
        let leftover = (1..n as u32).map(|b| CellUnion { level: 0.0, rank: f64::NEG_INFINITY, a: 0, b });
        for union in unions.into_iter().chain(leftover) {
            let (a, b) = (sets.find(union.a), sets.find(union.b));
            if !sets.join(a, b) {
                continue;
            }
            let (one, two) = (made[a as usize], made[b as usize]);
            let level = union.level.max(0.0).min(one.0).min(two.0);
            let rank = union.rank.min(one.1).min(two.1);
            made[a.min(b) as usize] = (level, rank);
            all.push(CellUnion { level, rank, a: a.min(b), b: a.max(b) });
        }
        // Stable: a union stays after those below it.
        sort_by(&mut all, |x, y| y.rank.total_cmp(&x.rank));
        tree.unions = all.iter().map(|u| [u.a, u.b]).collect();
        tree.level = all.iter().map(|u| u.level as f32).collect();
        tree
    }

    /// Checks a tree that was read from a file.
    ///
    /// # Errors
    /// If its version differs or it is not a valid tree over its cells.
    pub fn check(&self) -> Result<()> {
        let n = self.area.len();
        let known = |&[i, j]: &[u32; 2]| (i as usize) < n && (j as usize) < n;
        let sizes = self.unions.len() == n.saturating_sub(1)
            && self.level.len() == self.unions.len()
            && self.pairs.len() == self.length.len();
        let mut sets = Forest::new(n);
        let sound = self.unions.iter().chain(&self.pairs).all(known)
            && sizes
            && self.unions.iter().all(|&[i, j]| sets.join(i, j));
        let total: f64 = self.area.iter().map(|&area| f64::from(area)).sum();
        let measured = self.area.iter().chain(&self.length).all(|x| x.is_finite() && *x >= 0.)
            && total.is_normal()
            && self.level.iter().all(|level| (0. ..=1.).contains(level));
        if self.version == VERSION && sound && measured && n > 0 {
            return Ok(());
        }
        Err(Error::parameter(
            "tree",
            format!("not a hierarchy of parts, version {VERSION}"),
            "recreate it with the stage that wrote it",
        ))
    }

    /// Number of cells S.
    pub fn cells(&self) -> usize {
        self.area.len()
    }

    /// The same hierarchy, in which `left_out` cells (S) have no area and are no parts by themselves: the number of
    /// parts counts only the others. They are united with others before everything else.
    pub fn without(&self, left_out: &[bool]) -> PartTree {
        let mut sets = Forest::new(self.cells());
        let mut counts: Vec<bool> = left_out.iter().map(|left_out| !left_out).collect();
        let all = self.unions.iter().zip(&self.level).map(|(&[a, b], &level)| {
            let both = [a, b].map(|cell| counts[sets.find(cell) as usize]);
            sets.join(a, b);
            counts[sets.find(a) as usize] = both[0] || both[1];
            (both == [true; 2], [a, b], level)
        });
        // Stable: each of the two groups keeps its order.
        let mut all: Vec<(bool, [u32; 2], f32)> = all.collect();
        sort_by(&mut all, |x, y| x.0.cmp(&y.0));
        let area = self.area.iter().zip(left_out).map(|(&area, left_out)| if *left_out { 0. } else { area });
        PartTree {
            unions: all.iter().map(|(_, union, _)| *union).collect(),
            level: all.iter().map(|(_, _, level)| *level).collect(),
            area: area.collect(),
            ..self.clone()
        }
    }

    /// The parts made by the given unions, without cleaning.
    fn raw<'a>(&self, unions: impl IntoIterator<Item = &'a [u32; 2]>) -> Vec<u32> {
        let mut sets = Forest::new(self.cells());
        for &[i, j] in unions {
            sets.join(i, j);
        }
        compact(&sets.labels()).0
    }

    /// Cleans a labelling of pieces below `limit`; with `whole_too` also of parts.
    fn clean(&self, label: &[u32], limit: f64, whole_too: bool) -> TreeCut {
        let double = |x: &[f32]| x.iter().map(|&x| f64::from(x)).collect::<Vec<_>>();
        let (length, area) = (double(&self.length), double(&self.area));
        let (label, parts) = small_parts(&self.pairs, &length, &area, label, limit, whole_too);
        TreeCut { label, parts }
    }

    /// The parts at a threshold in \[0, 1\], without small ones. O(S + m).
    pub fn cut(&self, threshold: f64) -> TreeCut {
        // Rounded like the levels: .65 as an `f32` level may be less than .65 as an `f64` threshold.
        let threshold = threshold as f32;
        let made =
            self.unions.iter().zip(&self.level).filter(|(_, level)| **level >= threshold).map(|(union, _)| union);
        self.clean(&self.raw(made), f64::from(self.small_part), true)
    }

    /// The parts at a detail in −1..1, 0 being the default ([`detail_threshold`]).
    pub fn cut_detail(&self, detail: f64) -> TreeCut {
        self.cut(detail_threshold(detail))
    }

    /// The part of each cell for 1, 2, … parts: up to `most`, or as many as there are cells. Each cut is found by
    /// bisection under up to four limits, and cleans some dozens of labellings: on 2,000 cells, thirty cuts take a
    /// tenth of a second, all of them less than half a minute.
    ///
    /// # Errors
    /// As [`PartTree::cut_k`].
    pub fn first_cuts(&self, most: usize) -> Result<Vec<Vec<u32>>> {
        (1..=most.min(self.cells())).map(|k| Ok(self.cut_k(k)?.label)).collect()
    }

    /// Exactly `k` parts.
    ///
    /// Small parts do not count as long as the number can be reached without them: the coarsest cut that has `k` parts
    /// after cleaning is taken, where a part is small if it has less than a quarter of the mean part at most; otherwise
    /// the `k` parts of the tree without cleaning.
    ///
    /// # Errors
    /// If `k` is 0 or more than there are cells.
    pub fn cut_k(&self, k: usize) -> Result<TreeCut> {
        let n = self.cells();
        if k == 0 || k > n {
            return Err(Error::parameter(
                "parts",
                format!("{} cannot make {k} parts", counted(n, "cell")),
                format!("request 1 to {n}"),
            ));
        }
        let limit = f64::from(self.small_part).min(0.25 / k as f64);
        // The number of clean parts may skip k when two become large enough at once; then a lower limit helps.
        let found = [1., 0.7, 0.5, 0.3].iter().find_map(|share| self.coarsest(k, share * limit));
        Ok(found.unwrap_or_else(|| self.clean(&self.raw(&self.unions[..n - k]), limit, false)))
    }

    /// The coarsest cut into `k` parts that are not below `limit`, by bisection: as a rule, undoing a union adds one
    /// part or none.
    fn coarsest(&self, k: usize, limit: f64) -> Option<TreeCut> {
        let n = self.cells();
        let at = |depth: usize| self.clean(&self.raw(&self.unions[..n - depth]), limit, true);
        // `low` has too few parts, `high` enough.
        let (mut low, mut high, mut cut) = (k - 1, k, at(k));
        while cut.parts < k {
            if high == n {
                return None;
            }
            low = high;
            high = (2 * high + 8).min(n);
            cut = at(high);
        }
        while high - low > 1 {
            let middle = at(low.midpoint(high));
            if middle.parts < k {
                low = low.midpoint(high);
            } else {
                (high, cut) = (low.midpoint(high), middle);
            }
        }
        (cut.parts == k).then_some(cut)
    }

    /// The parts at a detail if their number is within `least` to `most`, else the nearest number allowed.
    ///
    /// # Errors
    /// If the range is empty or begins beyond the number of cells.
    pub fn cut_range(&self, least: usize, most: usize, detail: f64) -> Result<TreeCut> {
        if least > most {
            return Err(Error::parameter(
                "parts range",
                format!("{least} to {most} is empty"),
                "give the smaller number first",
            ));
        }
        let cut = self.cut_detail(detail);
        if cut.parts < least.max(1) {
            self.cut_k(least.max(1))
        } else if cut.parts > most {
            self.cut_k(most)
        } else {
            Ok(cut)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn strip(n: u32) -> CellGraph {
        let pairs: Vec<[u32; 2]> = (1..n).map(|i| [i - 1, i]).collect();
        CellGraph { area: vec![1.0; n as usize], length: vec![1.0; pairs.len()], pairs, ..CellGraph::default() }
    }

    #[test]
    fn every_number_of_parts_is_had_exactly() {
        let cells = strip(40);
        let unions = (0..20).map(|i| CellUnion {
            level: 0.9 - 0.03 * f64::from(i),
            rank: -f64::from(i),
            a: 2 * i,
            b: 2 * i + 1,
        });
        let tree = PartTree::new(&cells, unions, 0.003);
        tree.check().unwrap();
        for k in 1..=40 {
            let cut = tree.cut_k(k).unwrap();
            assert_eq!((cut.parts, *cut.label.iter().max().unwrap() as usize + 1), (k, k));
        }
        assert!(tree.cut_k(0).is_err() && tree.cut_k(41).is_err() && tree.cut_range(3, 2, 0.0).is_err());
        assert_eq!(tree.cut_range(1, 5, 0.0).unwrap().parts, 5);
        assert_eq!(tree.cut_range(39, 40, 0.0).unwrap().parts, 39);
    }

    /// Fifty blocks of forty cells; the last cell of each joins it only after the blocks have joined each other.
    fn tiny_components_last() -> PartTree {
        let cells = strip(2000);
        let union = |rank: f64, a, b| CellUnion { level: 0.9, rank, a, b };
        let inside = (0..2000).filter(|i| i % 40 < 38).map(|i| union(3., i, i + 1));
        let blocks = (1..50).map(|k| union(2. - f64::from(k) / 50., 0, 40 * k));
        let tiny = (0..50).map(|k| union(0.5 - f64::from(k) / 200., 40 * k, 40 * k + 39));
        PartTree::new(&cells, inside.chain(blocks).chain(tiny), 0.003)
    }

    #[test]
    fn a_number_of_parts_is_not_made_up_by_tiny_components() {
        let tree = tiny_components_last();
        for k in [2, 10, 30, 50] {
            let cut = tree.cut_k(k).unwrap();
            let mut sizes = vec![0; k];
            cut.label.iter().for_each(|&part| sizes[part as usize] += 1);
            assert!(cut.parts == k && sizes.iter().all(|size| *size >= 39), "{k}: {sizes:?}");
        }
        // More parts than exist without tiny components: these become parts too, and the number is as requested.
        assert_eq!(tree.cut_k(90).unwrap().parts, 90);
    }

    #[test]
    fn cells_that_are_left_out_are_no_parts() {
        // Every other block of ten is left out; the finest unions are within blocks, then the blocks join in a row.
        let cells = strip(100);
        let union = |rank: f64, a, b| CellUnion { level: 0.9, rank, a, b };
        let inside = (0..100).filter(|i| i % 10 < 9).map(|i| union(3., i, i + 1));
        let blocks = (1..10).map(|k| union(2. - f64::from(k) / 10., 0, 10 * k));
        let tree = PartTree::new(&cells, inside.chain(blocks), 0.003);
        let left_out: Vec<bool> = (0..100).map(|i| i / 10 % 2 == 1).collect();
        let without = tree.without(&left_out);
        without.check().unwrap();
        for k in 1..=50 {
            let label = without.cut_k(k).unwrap().label;
            let others: BTreeSet<u32> =
                label.iter().zip(&left_out).filter(|(_, left_out)| !**left_out).map(|(label, _)| *label).collect();
            assert_eq!((others.len(), *label.iter().max().unwrap() as usize + 1), (k, k));
        }
        // The five blocks that count, each whole.
        let five = without.cut_k(5).unwrap().label;
        let ends = [0, 2, 4, 6, 8].map(|block| [five[10 * block], five[10 * block + 9]]);
        assert!(ends.iter().all(|[first, last]| first == last), "{five:?}");
        assert_eq!(ends.map(|[first, _]| first).iter().collect::<BTreeSet<_>>().len(), 5);
    }

    #[test]
    fn a_union_at_a_threshold_is_made_by_it_whatever_single_precision_makes_of_both() {
        for detail in 0..100 {
            let (detail, cells) = (f64::from(detail) / 100., strip(2));
            let level = detail_threshold(detail);
            let tree = PartTree::new(&cells, [CellUnion { level, rank: 0., a: 0, b: 1 }], 0.);
            assert_eq!(tree.cut_detail(detail).parts, 1, "{level}");
            assert_eq!(tree.cut(level + 1e-6).parts, 2, "{level}");
        }
    }

    #[test]
    fn more_detail_is_finer_and_json_keeps_the_tree() {
        let cells = strip(30);
        let unions =
            (0..29).map(|i| CellUnion { level: 1.0 - f64::from(i) / 29.0, rank: -f64::from(i), a: i, b: i + 1 });
        let tree = PartTree::new(&cells, unions, 0.0);
        let counts: Vec<usize> = (-10..=10).map(|d| tree.cut_detail(f64::from(d) / 10.0).parts).collect();
        assert!(counts.windows(2).all(|w| w[0] <= w[1]) && counts[0] == 1 && counts[20] > 25);
        let text = serde_json::to_string(&tree).unwrap();
        assert_eq!(serde_json::from_str::<PartTree>(&text).unwrap(), tree);
        let mut broken = tree;
        broken.unions[3] = broken.unions[2];
        assert!(broken.check().is_err());
    }
}
