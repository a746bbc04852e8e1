//! The un-sampled case: leading eigenvectors of the whole affinity matrix, by block iteration.
//!
//! Marched distances depend a little on the direction, so they are averaged over both.

use nalgebra::DMatrix;
use nystrom_stream::base::Result;
use nystrom_stream::base::eigen;
use nystrom_stream::base::parallel::{chunk_count, chunk_range};
use nystrom_stream::distance::DistanceRows;
use nystrom_stream::graph::Node;
use nystrom_stream::spectral::Kernel;
use nystrom_stream::spectral::nystrom::Point;
use nystrom_stream::store::Run;

/// Vectors iterated beyond those wanted, and iterations.
const EXTRA: usize = 8;
const STEPS: usize = 30;

/// All distances of `rows`, a row a vertex (n × n), averaged over both directions.
pub fn symmetric(rows: &DistanceRows) -> Vec<f32> {
    let n = rows.nodes;
    let mut all = rows.distances.to_vec();
    for i in 0..n {
        for j in 0..i {
            let mean = 0.5 * (all[i * n + j] + all[j * n + i]);
            (all[i * n + j], all[j * n + i]) = (mean, mean);
        }
    }
    all
}

/// Every vertex embedded by the `k` leading eigenvectors, times √λ, of W (n × n, a row a vertex), or `by_area` of
/// m^½ W m^½ with m the shares of area, divided by m^½ again; also the variances.
pub fn embed(distances: &[f32], nodes: &[Node], by_area: bool, k: usize, run: &Run) -> Result<(Vec<Point>, Vec<f64>)> {
    let n = nodes.len();
    let row = |v: usize| &distances[v * n..(v + 1) * n];
    let total: f64 = nodes.iter().map(|node| f64::from(node.area)).sum();
    let share: Vec<f64> = nodes
        .iter()
        .map(|node| if by_area { (f64::from(node.area) / total).max(1e-12) } else { 1. / n as f64 })
        .collect();
    let mean = |v: usize| -> f64 { row(v).iter().zip(&share).map(|(&d, m)| f64::from(d) * m).sum() };
    let sigma: f64 = (0..n).map(|v| mean(v) * share[v]).sum();
    let p = (k + EXTRA).min(n);
    let mut x =
        DMatrix::from_fn(
            n,
            p,
            |i, j| if j == 0 { 1. } else { ((i * (2 * j + 1)) as f64 * 0.754_877 + 0.3 * j as f64).sin() },
        );
    let mut values = vec![0.; p];
    for _ in 0..STEPS {
        x = x.qr().q();
        let scaled: Vec<Vec<f32>> =
            (0..p).map(|j| (0..n).map(|i| (x[(i, j)] * share[i].sqrt()) as f32).collect()).collect();
        let parts = run.map_chunks(
            chunk_count(n, 256),
            || vec![0f32; n],
            |c, w| {
                let mut out = Vec::new();
                for i in chunk_range(n, 256, c) {
                    Kernel::Gaussian.apply(sigma as f32, row(i), w);
                    out.extend(scaled.iter().map(|column| {
                        column
                            .chunks(1024)
                            .zip(w.chunks(1024))
                            .map(|(a, b)| f64::from(a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>()))
                            .sum::<f64>()
                            * share[i].sqrt()
                    }));
                }
                Ok(out)
            },
        )?;
        let y = DMatrix::from_row_slice(n, p, &parts.concat());
        // Rayleigh and Ritz.
        let (ritz, axes) = eigen::symmetric(x.transpose() * &y);
        x = y * axes;
        values = ritz;
    }
    let norms: Vec<f64> = (0..p).map(|j| x.column(j).norm()).collect();
    let points = (0..n)
        .map(|i| {
            std::array::from_fn(|j| {
                if j < k { (x[(i, j)] / norms[j] * (values[j].max(0.) / share[i]).sqrt()) as f32 } else { 0. }
            })
        })
        .collect();
    Ok((points, values[..k].to_vec()))
}
