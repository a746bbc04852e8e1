//! Farthest points in length alone, for rows in a metric that counts turning.
//!
//! Max–min in a combined metric picks outliers: a lone face across a sharp crease is far from everything and
//! represents nothing. In length alone the samples spread over the surface.

use super::farthest::{extremity, farthest_node};
use super::{Found, Sampler, Space};
use crate::base::Result;
use crate::base::parallel::fill_each;
use crate::graph::Node;
use crate::graph::dual::Csr;
use crate::graph::weights::LEAST;
use crate::store::Run;

/// The sampler.
pub struct GeodesicFarthest;

impl Sampler for GeodesicFarthest {
    fn choose(
        &self,
        l: usize,
        seed: u64,
        space: &mut dyn Space,
        field: &mut [f32],
        found: &mut Found<'_>,
    ) -> Result<()> {
        field.fill(f32::INFINITY);
        for k in 0..l {
            let landmark = if k == 0 { extremity(space.nodes(), seed, space.threads()) } else { farthest_node(field) };
            found(landmark, None)?;
            if k + 1 < l {
                space.lower_by_length(landmark, field)?;
            }
        }
        Ok(())
    }
}

/// Fills `out` (nnz) with the distances between the centroids of neighbours: `graph` weighted by length alone.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn fill_lengths(graph: Csr<'_>, nodes: &[Node], out: &mut [f32], run: &Run) -> Result<()> {
    let start = |e: usize| graph.indptr.partition_point(|&start| start as usize <= e) - 1;
    fill_each(run.threads, &run.cancel, out, 1 << 15, |e, _| {
        let (a, b) = (nodes[start(e)].centroid, nodes[graph.indices[e] as usize].centroid);
        let (x, y, z) = (a[0] - b[0], a[1] - b[1], a[2] - b[2]);
        (x * x + y * y + z * z).sqrt().max(LEAST)
    })
}
