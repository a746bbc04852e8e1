//! Divides one part further along the hierarchy.
//!
//! The hierarchy of a part's cells is that of all cells, restricted to the part. It is cut into n parts like that of
//! the whole surface. Cost: one pass over the unions.

use super::hierarchy::PartTree;
use crate::base::Result;
use crate::base::union_find::Forest;

impl PartTree {
    /// The hierarchy restricted to `members` (ascending); cell k of the result is `members[k]`.
    pub fn within(&self, members: &[u32]) -> PartTree {
        let mut place = vec![u32::MAX; self.cells()];
        members.iter().zip(0u32..).for_each(|(&cell, k)| place[cell as usize] = k);
        // The least member in each set, indexed by the least cell of the set.
        let mut least = place.clone();
        let (mut unions, mut level) = (Vec::new(), Vec::new());
        let mut sets = Forest::new(self.cells());
        for (&[a, b], &at) in self.unions.iter().zip(&self.level) {
            let (a, b) = (sets.find(a), sets.find(b));
            sets.join(a, b);
            let (one, two) = (least[a as usize], least[b as usize]);
            least[a.min(b) as usize] = one.min(two);
            if one != u32::MAX && two != u32::MAX {
                unions.push([one.min(two), one.max(two)]);
                level.push(at);
            }
        }
        let total: f32 = members.iter().map(|&cell| self.area[cell as usize]).sum();
        let scale = if total > 0. { total } else { 1. };
        let inside = |&&[a, b]: &&[u32; 2]| place[a as usize] != u32::MAX && place[b as usize] != u32::MAX;
        let kept = self.pairs.iter().zip(&self.length).filter(|(pair, _)| inside(pair));
        let (pairs, length) = kept.map(|(pair, &length)| (pair.map(|cell| place[cell as usize]), length)).unzip();
        PartTree {
            version: self.version,
            unions,
            level,
            area: members.iter().map(|&cell| self.area[cell as usize] / scale).collect(),
            pairs,
            length,
            small_part: (self.small_part / scale).min(0.25),
        }
    }

    /// The piece, 0 to `into` − 1, of each of `members` (ascending), when divided into that many along the hierarchy.
    ///
    /// # Errors
    /// No piece, or more pieces than members.
    pub fn split(&self, members: &[u32], into: usize) -> Result<Vec<u32>> {
        Ok(self.within(members).cut_k(into)?.label)
    }
}

#[cfg(test)]
mod tests {
    use super::super::cell_graph::CellGraph;
    use super::super::hierarchy::{CellUnion, PartTree};

    /// Eight cells in a row, joined in pairs, then fours, then all.
    fn tree() -> PartTree {
        let pairs: Vec<[u32; 2]> = (1..8).map(|i| [i - 1, i]).collect();
        let cells = CellGraph { area: vec![1.; 8], length: vec![1.; 7], pairs, ..CellGraph::default() };
        let union = |level, a, b| CellUnion { level, rank: level, a, b };
        let fine = (0..4).map(|k| union(0.9 - 0.01 * f64::from(k), 2 * k, 2 * k + 1));
        PartTree::new(&cells, fine.chain([union(0.6, 0, 2), union(0.5, 4, 6), union(0.1, 0, 4)]), 0.003)
    }

    #[test]
    fn a_part_that_the_hierarchy_knows_is_split_as_the_hierarchy_does() {
        let tree = tree();
        assert_eq!(tree.split(&[0, 1, 2, 3], 2).unwrap(), [0, 0, 1, 1]);
        assert_eq!(tree.split(&[4, 5, 6, 7], 3).unwrap().iter().max(), Some(&2));
        assert_eq!(tree.split(&(0..8).collect::<Vec<_>>(), 2).unwrap(), tree.cut_k(2).unwrap().label);
        assert_eq!(tree.within(&(0..8).collect::<Vec<_>>()).unions, tree.unions);
    }

    #[test]
    fn so_is_any_other_set_of_cells() {
        let tree = tree();
        // 3 and 4 are joined last.
        assert_eq!(tree.split(&[2, 3, 4], 2).unwrap(), [0, 0, 1]);
        assert_eq!(tree.split(&[3], 1).unwrap(), [0]);
        tree.within(&[1, 2, 5, 7]).check().unwrap();
        assert!(tree.split(&[3, 4], 3).is_err() && tree.split(&[3, 4], 0).is_err());
    }
}
