//! Truncated rows: the distances from each of many samples to nearby vertices only.
//!
//! If only nearby vertices matter, as under a narrow kernel, a front stops at a limit, and hundreds of samples cost as
//! much as a few full rows: every vertex is reached by as many fronts as there are samples within the limit. Stored by
//! vertex, as a sparse matrix of n rows, because they are used vertex by vertex.
//!
//! Cost: time of the fronts ([`super::march`]) per vertex and nearby sample; on disk 8 bytes each, twice while they are
//! sorted by vertex, and 8 bytes per vertex; in memory 4 bytes per vertex for the field of each front, and 8 per
//! distance for the samples that wait to be written, [`WAITING`] per thread.

use super::front::mean_weight;
use super::march::{March, Surface};
use super::vertex_rows::Distance;
use crate::base::Result;
use crate::distance::Front;
use crate::store::{Context, MappedSlice};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

/// Samples per thread whose distances are in memory: four wait, one is computed.
const WAITING: u64 = 5;

/// A sample near a vertex.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Near {
    /// The number of the sample.
    pub sample: u32,
    /// Its distance, in units of the graph.
    pub distance: f32,
}

/// The samples near each vertex.
#[derive(Clone, Debug)]
pub struct LocalRows {
    /// The vertices of the samples (s).
    pub samples: Vec<u32>,
    /// Distances are below this.
    pub limit: f32,
    /// Where each vertex's entries begin (n + 1).
    starts: MappedSlice<u64>,
    /// Number of a sample and bits of a distance, sorted by vertex and sample.
    entries: MappedSlice<u32>,
}

impl LocalRows {
    /// The distances below `limit` from `samples` on `surface`, in files of `context` whose names start with `name`.
    /// Progress is reported as stage `basis`, in rows.
    ///
    /// # Errors
    /// [`crate::base::Error::Memory`], [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn compute(
        surface: Surface<'_>,
        samples: Vec<u32>,
        limit: f32,
        distance: Distance,
        name: &str,
        context: Context<'_>,
    ) -> Result<Self> {
        let (n, work) = (surface.nodes.len(), context.work);
        // All vertices may be near a sample; a single thread is not refused for that.
        let (field, near) = (4 * n as u64, WAITING * size_of::<(u32, f32)>() as u64 * n as u64);
        let (run, grant) = context.run.threads_beside("local rows", (0, field + near), near)?;
        let mean = mean_weight(surface.graph);
        let front = |k: usize, (front, march, field): &mut (Front, March, Vec<f32>)| {
            let near = match distance {
                Distance::March => march.within(surface, samples[k], limit, field, &run.cancel)?,
                Distance::Edges => along_edges(front, surface, samples[k], limit, field, &run.cancel)?,
            };
            run.progress.advance("basis", 1);
            Ok(near)
        };
        let by_sample = format!("{name}_by_sample.tmp");
        let mut writer = work.writer::<u32>(&by_sample, 2)?;
        let mut counts = work.array::<u64>(&format!("{name}_starts.npy"), &[n + 1])?;
        let ends = &mut counts.data()[..];
        ends.fill(0);
        let mut sizes = Vec::with_capacity(samples.len());
        let state = || (Front::new(mean), March::new(mean), vec![f32::INFINITY; n]);
        run.in_order(samples.len(), state, front, |_, near: Vec<(u32, f32)>| {
            let flat: Vec<u32> = near.iter().flat_map(|(vertex, distance)| [*vertex, distance.to_bits()]).collect();
            near.iter().for_each(|(vertex, _)| ends[*vertex as usize + 1] += 1);
            sizes.push(near.len());
            writer.push(&flat)
        })?;
        drop(grant);
        let flat = writer.finish(false)?;
        for v in 0..n {
            ends[v + 1] += ends[v];
        }
        let mut entries = work.array::<u32>(&format!("{name}.npy"), &[flat.len() / 2, 2])?;
        let out = &mut entries.data()[..];
        // Samples ascend, so each vertex's entries do too; the starts become ends along the way.
        let mut at = 0;
        for (sample, size) in sizes.into_iter().enumerate() {
            run.cancel.check()?;
            for pair in flat[2 * at..2 * (at + size)].chunks_exact(2) {
                let place = &mut ends[pair[0] as usize];
                out[2 * *place as usize..][..2].copy_from_slice(&[sample as u32, pair[1]]);
                *place += 1;
            }
            at += size;
        }
        ends.copy_within(0..n, 1);
        ends[0] = 0;
        drop(flat);
        work.remove(&by_sample);
        Ok(Self { samples, limit, starts: counts.finish(false)?, entries: entries.finish(false)? })
    }

    /// Vertices n.
    pub fn nodes(&self) -> usize {
        self.starts.len() - 1
    }

    /// Number of stored distances.
    pub fn len(&self) -> usize {
        self.entries.len() / 2
    }

    /// The samples near `vertex`, in ascending order of their numbers.
    pub fn near(&self, vertex: usize) -> impl Iterator<Item = Near> + '_ {
        let span: Range<usize> = 2 * self.starts[vertex] as usize..2 * self.starts[vertex + 1] as usize;
        let near = |pair: &[u32]| Near { sample: pair[0], distance: f32::from_bits(pair[1]) };
        self.entries[span].chunks_exact(2).map(near)
    }
}

/// The vertices nearer than `limit` along edges; `field` is infinite before and after.
fn along_edges(
    front: &mut Front,
    surface: Surface<'_>,
    source: u32,
    limit: f32,
    field: &mut [f32],
    cancel: &crate::base::Cancel,
) -> Result<Vec<(u32, f32)>> {
    let result = front.within(surface.graph, &[source], limit, field, cancel);
    // The reached vertices are connected with each other.
    let took = |field: &mut [f32], v: u32| {
        let distance = std::mem::replace(&mut field[v as usize], f32::INFINITY);
        (v, distance)
    };
    let (mut found, mut at) = (vec![took(field, source)], 0);
    while at < found.len() {
        for (next, _) in surface.graph.neighbours(found[at].0) {
            if field[next as usize] < f32::INFINITY {
                found.push(took(field, next));
            }
        }
        at += 1;
    }
    found.retain(|(_, distance)| *distance < limit);
    found.sort_unstable_by_key(|(vertex, _)| *vertex);
    result.map(|_| found)
}
