//! Connected pieces of regions.
//!
//! Regions without a common boundary never merge, so no data are needed between regions of different pieces. An object
//! of thousands of loose pieces has at least as many regions; sums over all pairs of these took 2 GB. Cost: 12 bytes
//! per region, and 24 per piece.

use super::cell_graph::CellGraph;
use super::cell_labels::compact;
use crate::base::union_find::Forest;

/// Connected pieces of regions, ordered by their first region, and the regions of each, ascending.
#[derive(Clone, Debug, PartialEq)]
pub struct RegionPieces {
    /// Piece of each region, and its position there (R).
    of_region: Vec<(u32, u32)>,
    /// The regions of each piece.
    regions: Vec<Vec<u32>>,
}

impl RegionPieces {
    /// All `count` regions as one piece.
    pub fn whole(count: usize) -> RegionPieces {
        Self::numbered(&vec![0; count], 1)
    }

    /// The pieces of the `count` regions `of_cell` (S): adjacent regions are in the same piece.
    pub fn connected(cells: &CellGraph, of_cell: &[u32], count: usize) -> RegionPieces {
        let mut forest = Forest::new(count);
        for &[i, j] in &cells.pairs {
            forest.join(of_cell[i as usize], of_cell[j as usize]);
        }
        let (piece, pieces) = compact(&forest.labels());
        Self::numbered(&piece, pieces)
    }

    /// From the `piece` of each region, with `pieces` in all.
    fn numbered(piece: &[u32], pieces: usize) -> RegionPieces {
        let mut regions = vec![Vec::new(); pieces];
        let put = |(&piece, region): (&u32, u32)| {
            let regions: &mut Vec<u32> = &mut regions[piece as usize];
            regions.push(region);
            (piece, regions.len() as u32 - 1)
        };
        RegionPieces { of_region: piece.iter().zip(0..).map(put).collect(), regions }
    }

    /// Number of regions of each piece.
    pub fn sizes(&self) -> impl Iterator<Item = usize> {
        self.regions.iter().map(Vec::len)
    }

    /// Number of regions.
    pub fn region_count(&self) -> usize {
        self.of_region.len()
    }

    /// The piece of `region`, and its position there.
    #[inline]
    pub fn place(&self, region: u32) -> (usize, usize) {
        let (piece, place) = self.of_region[region as usize];
        (piece as usize, place as usize)
    }

    /// The regions of `piece`, ascending.
    pub fn regions(&self, piece: usize) -> &[u32] {
        &self.regions[piece]
    }
}
