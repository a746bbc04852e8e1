//! Vertices of open edges at exactly the same position, as texture seams and triangle soups leave them: joined by edges
//! without length, so that distances pass.
//!
//! As for faces ([`super::weld`]), only open edges and only equal positions: sheets that touch stay apart. One shuffle by
//! a hash of the position, 32 bytes an open vertex; nothing where a mesh is closed. The edges found are held in memory,
//! 12 bytes each, and the chain through equal vertices follows their numbers.

use super::bridge::Bridge;
use super::weights::LEAST;
use crate::base::Result;
use crate::store::shuffle::BudgetedShuffle;
use crate::store::shuffle::Shuffle;
use crate::store::{Context, Run};
use xxhash_rust::xxh3::xxh3_64;

/// Position bits and vertex.
type Record = [u64; 4];

/// Open vertices on their way to their equals.
pub(super) struct DuplicateVertices {
    sized: BudgetedShuffle<Record>,
    staged: Vec<Record>,
}

impl DuplicateVertices {
    /// Ready for up to `n` vertices.
    pub(super) fn new(n: usize, context: Context<'_>) -> Result<Self> {
        let sized = BudgetedShuffle::new(&context.work.file("seams.tmp"), "seams", n as u64, 2, 4, context.run)?;
        Ok(Self { sized, staged: Vec::new() })
    }

    /// Adds the vertex `v` at `position`.
    pub(super) fn push(&mut self, v: u32, position: [f64; 3]) -> Result<()> {
        // Adding 0 makes one zero of both.
        let [x, y, z] = position.map(|x| (x + 0.).to_bits());
        self.staged.push([x, y, z, u64::from(v)]);
        if self.staged.len() < 1 << 12 { Ok(()) } else { Self::scatter(&self.sized.shuffle, &mut self.staged) }
    }

    fn scatter(shuffle: &Shuffle<Record>, staged: &mut Vec<Record>) -> Result<()> {
        let mut producer = shuffle.producer();
        for record in staged.drain(..) {
            let hash = xxh3_64(bytemuck::cast_slice(&record[..3]));
            producer.push(((u128::from(hash) * shuffle.buckets() as u128) >> 64) as usize, record)?;
        }
        producer.finish()
    }

    /// The edges between equals, ascending.
    pub(super) fn find(mut self, run: &Run) -> Result<Vec<Bridge>> {
        Self::scatter(&self.sized.shuffle, &mut self.staged)?;
        let mut found = Vec::new();
        for bucket in 0..self.sized.shuffle.buckets() {
            run.cancel.check()?;
            let mut records = self.sized.shuffle.take(bucket)?;
            records.sort_unstable();
            let equal = records.chunk_by(|a, b| a[..3] == b[..3]);
            found.extend(equal.flat_map(|equal| equal.windows(2)).map(|pair| [pair[0][3] as u32, pair[1][3] as u32]));
        }
        found.sort_unstable();
        Ok(found.into_iter().map(|nodes| Bridge { nodes, gap: LEAST }).collect())
    }
}
