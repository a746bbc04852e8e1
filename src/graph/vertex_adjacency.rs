//! Which vertices share a side of a face: the adjacency for orderings, without weights, without welding or bridges, and
//! without triangulating polygons.
//!
//! Orderings of vertices (breadth-first, Cuthill–McKee, sweeps, the exact Fiedler vector) need it; the dual graph does
//! not contain it. One shuffle of both directions of every side, sorted bucket by bucket and written in order: 16 B per
//! corner through the shuffle, 8 B per vertex and 4 B per direction kept (about 16 B per triangle).

use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::mesh::Mesh;
use crate::store::npy::ArrayWriter;
use crate::store::shuffle::{BudgetedShuffle, Producer, RangeBuckets};
use crate::store::{Context, MappedSlice, WorkDir};

const CHUNK: usize = 1 << 14;
const FILES: [&str; 2] = ["sides_indptr.tmp", "sides_indices.tmp"];

/// Which vertices share an edge.
#[derive(Clone, Debug)]
pub struct VertexAdjacency {
    /// Row starts (vertices + 1).
    pub indptr: MappedSlice<u64>,
    /// Neighbours, ascending in a row, without duplicates.
    pub indices: MappedSlice<u32>,
}

impl VertexAdjacency {
    /// The adjacency of `mesh`, in temporary files of `work`; see [`VertexAdjacency::remove`].
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
    pub fn build(mesh: &Mesh, context: Context<'_>) -> Result<Self> {
        let (n, faces, corners) = (mesh.positions.len(), mesh.faces.len(), mesh.faces.corner_count() as u64);
        let copies = 8 * context.run.threads as u64;
        let file = context.work.spill("side_links.tmp");
        // The result for a bucket has an entry for each of its vertices, which may outnumber its sides.
        let records = (2 * corners).max(n as u64);
        let what = "the graph of vertices";
        let sized = BudgetedShuffle::<[u32; 2]>::new(file, what, records, copies, 1, context.run)?;
        let shuffle = &sized.shuffle;
        let buckets = shuffle.buckets();
        let by_vertex = RangeBuckets::new(n, buckets);
        context.run.each_chunk(
            chunk_count(faces, CHUNK),
            || shuffle.producer(),
            |k, out| {
                mesh.faces.try_for_each(chunk_range(faces, CHUNK, k), |_, corners| {
                    for (slot, &a) in corners.iter().enumerate() {
                        let b = corners[(slot + 1) % corners.len()];
                        if a != b {
                            out.push(by_vertex.bucket_of(a), [a, b])?;
                            out.push(by_vertex.bucket_of(b), [b, a])?;
                        }
                    }
                    Ok(())
                })
            },
            Producer::finish,
        )?;
        let mut starts: ArrayWriter<u64> = context.work.writer(FILES[0], 1)?;
        let mut indices: ArrayWriter<u32> = context.work.writer(FILES[1], 1)?;
        let mut end = 0;
        starts.push(&[0])?;
        context.run.in_order(
            buckets,
            || (),
            |bucket, ()| {
                let mut edges = shuffle.take(bucket)?;
                edges.sort_unstable();
                edges.dedup();
                let range = by_vertex.range(bucket);
                let mut degrees = vec![0u64; range.len()];
                edges.iter().for_each(|edge| degrees[edge[0] as usize - range.start] += 1);
                Ok((degrees, edges.into_iter().map(|edge| edge[1]).collect::<Vec<u32>>()))
            },
            |_, (mut degrees, neighbours)| {
                for degree in &mut degrees {
                    end += *degree;
                    *degree = end;
                }
                starts.push(&degrees)?;
                indices.push(&neighbours)
            },
        )?;
        Ok(Self { indptr: starts.finish(false)?, indices: indices.finish(false)? })
    }

    /// Removes its files.
    pub fn remove(work: &WorkDir) {
        FILES.iter().for_each(|name| work.remove(name));
    }

    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.indptr.len() - 1
    }

    /// The neighbours of vertex `v`, ascending.
    #[inline]
    pub fn neighbours(&self, v: u32) -> &[u32] {
        &self.indices[self.indptr[v as usize] as usize..self.indptr[v as usize + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Run;
    use std::collections::BTreeSet;

    #[test]
    fn neighbours_are_those_of_the_sides_whatever_the_memory() {
        let dir = tempfile::tempdir().unwrap();
        let faces: Vec<Vec<u32>> = vec![vec![0, 1, 2, 3], vec![2, 1, 4], vec![4, 4, 1], vec![], vec![6, 7, 4]];
        let mesh = Mesh::from_slices(&[[0.; 3]; 9], &faces).unwrap();
        let mut expected = vec![BTreeSet::new(); 9];
        for face in &faces {
            for k in 0..face.len() {
                let (a, b) = (face[k], face[(k + 1) % face.len()]);
                if a != b {
                    expected[a as usize].insert(b);
                    expected[b as usize].insert(a);
                }
            }
        }
        let work = WorkDir::temporary(dir.path()).unwrap();
        for memory in [1 << 20, 1 << 30] {
            let run = Run { budget: crate::store::Budget::new(memory), ..Run::new(&()) };
            let graph = VertexAdjacency::build(&mesh, Context::new(&work, &run)).unwrap();
            assert_eq!(graph.len(), 9);
            for v in 0..9 {
                let found: Vec<u32> = graph.neighbours(v).to_vec();
                assert_eq!(found, expected[v as usize].iter().copied().collect::<Vec<_>>());
            }
        }
    }
}
