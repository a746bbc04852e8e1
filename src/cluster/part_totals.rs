//! Faces and area of each part: sums over all faces, added up by blocks of faces.
//!
//! Each block has sums for all parts, so the number of blocks is limited by a fixed number of bytes, whatever the mesh;
//! the more parts, the fewer blocks. The number of threads does not change the result. Cost: 16 bytes per part and
//! block, at most [`ROOM`], or one block if that is more.

use crate::base::parallel::chunk_count;

/// Bytes for the sums of all blocks.
const ROOM: usize = 4 << 20;

/// Faces and area of each part.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PartTotals {
    /// Faces per part.
    pub faces: Vec<u64>,
    /// Area per part, in the frame.
    pub area: Vec<f64>,
}

impl PartTotals {
    /// Totals of 0 for `parts` parts.
    pub fn new(parts: usize) -> Self {
        Self { faces: vec![0; parts], area: vec![0.; parts] }
    }

    /// Adds the totals of a block.
    pub fn add(&mut self, block: &Self) {
        self.faces.iter_mut().zip(&block.faces).for_each(|(sum, faces)| *sum += faces);
        self.area.iter_mut().zip(&block.area).for_each(|(sum, area)| *sum += area);
    }
}

/// Block size for summing `n` faces by `parts` parts: a multiple of `chunk`.
pub fn block_size(n: usize, chunk: usize, parts: usize) -> usize {
    let blocks = (ROOM / (16 * parts.max(1))).max(1);
    chunk_count(n, chunk).div_ceil(blocks).max(1) * chunk
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: each chunk of 2,048 faces kept sums for all parts until the end, 84 MB for four million faces in
    /// 2,000 parts.
    #[test]
    fn sums_take_no_more_for_a_larger_mesh() {
        for (n, parts) in [(1, 1), (4_000_000, 2_000), (1_000_000_000, 1_000), (1_000_000_000, 1_000_000)] {
            let block = block_size(n, 2_048, parts);
            let bytes = 16 * parts * chunk_count(n, block);
            assert!(block.is_multiple_of(2_048) && bytes <= ROOM.max(16 * parts), "{n} faces, {parts} parts: {bytes}");
        }
        // Blocks equal chunks if there is room for all of them.
        assert_eq!(block_size(2_000_000, 2_048, 10), 2_048);
    }
}
