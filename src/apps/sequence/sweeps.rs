//! Jacobi sweeps: every coordinate becomes the mean of itself and its neighbours'.
//!
//! A sweep damps what changes quickly over the mesh and leaves the Fiedler vector nearly alone, so sweeps turn an
//! extrapolated vector into a better one. A component's mean tends to stay and its range to shrink: coordinates
//! are `f64`, which bears a range of 1e-10. Streamed: a sweep reads graph and coordinates once, some 30 B a
//! vertex and neighbours nearby, and writes another 8.

use crate::base::Result;
use crate::base::parallel::fill_chunks;
use crate::graph::VertexAdjacency;
use crate::store::Context;
use crate::store::npy::ArrayMut;

const CHUNK: usize = 1 << 14;

/// Sweeps `times` times over `coordinates` (one a vertex of `graph`); returns them in one of two arrays.
pub fn sweep(
    graph: &VertexAdjacency,
    mut coordinates: ArrayMut<f64>,
    times: usize,
    context: Context<'_>,
) -> Result<ArrayMut<f64>> {
    let n = graph.len();
    let mut other = context.work.array::<f64>("sweep.tmp", &[n])?;
    for _ in 0..times {
        let from = &coordinates.data()[..];
        let fill = |k: usize, out: &mut [f64], (): &mut ()| {
            for (i, x) in out.iter_mut().enumerate() {
                let v = k * CHUNK + i;
                let near = graph.neighbours(v as u32);
                let sum: f64 = near.iter().map(|&w| from[w as usize]).sum();
                *x = (from[v] + sum) / (near.len() + 1) as f64;
            }
            context.run.progress.advance("sweeps", out.len() as u64);
            Ok(())
        };
        fill_chunks(context.run.threads, &context.run.cancel, &mut other.data()[..], CHUNK, || (), fill)?;
        std::mem::swap(&mut coordinates, &mut other);
    }
    Ok(coordinates)
}
