//! Ranks from positions alone (principal axes, Hilbert's curve), and from nothing (chance).

use super::sorting;
use crate::base::Result;
use crate::base::parallel::map_ranges;
use crate::graph::Frame;
use crate::graph::order::hilbert;
use crate::mesh::Positions;
use crate::store::{Context, MappedSlice};
use nalgebra::DMatrix;
use xxhash_rust::xxh3::xxh3_64_with_seed;

const CHUNK: usize = 1 << 15;

/// Ranks along the longest principal axis of the vertices, ties along the second.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
pub fn pca_ranks(name: &str, positions: &Positions, context: Context<'_>) -> Result<MappedSlice<u32>> {
    let frame = Frame::of(positions, context.run)?;
    let n = positions.len();
    let sums = map_ranges(context.run.threads, &context.run.cancel, n, CHUNK, |range| {
        let (mut sum, mut products, mut count) = ([0f64; 3], [[0f64; 3]; 3], 0u64);
        for v in range {
            let p = frame.place(positions.get(v as u32));
            if p.iter().all(|x| x.is_finite()) {
                count += 1;
                for i in 0..3 {
                    sum[i] += p[i];
                    (0..3).for_each(|j| products[i][j] += p[i] * p[j]);
                }
            }
        }
        Ok((sum, products, count))
    })?;
    let (mut sum, mut products, mut count) = ([0f64; 3], [[0f64; 3]; 3], 0u64);
    for (s, p, c) in sums {
        count += c;
        for i in 0..3 {
            sum[i] += s[i];
            (0..3).for_each(|j| products[i][j] += p[i][j]);
        }
    }
    let m = count.max(1) as f64;
    let covariance = DMatrix::from_fn(3, 3, |i, j| products[i][j] / m - sum[i] * sum[j] / (m * m));
    let axes = crate::spectral::eigen::symmetric(covariance).1;
    let key = |v: usize| {
        let p = frame.place(positions.get(v as u32));
        let along = |axis: usize| (0..3).map(|i| axes[(i, axis)] * p[i]).sum::<f64>();
        (0, along(0), along(1) as f32)
    };
    super::ranks_along(name, n, key, context)
}

/// Ranks along Hilbert's curve.
///
/// # Errors
/// As [`pca_ranks`].
pub fn hilbert_ranks(name: &str, positions: &Positions, context: Context<'_>) -> Result<MappedSlice<u32>> {
    let frame = Frame::of(positions, context.run)?;
    let key = |v: usize| {
        let place = hilbert::place_of(frame.place(positions.get(v as u32)));
        [(place >> 32) as u32, place as u32, 0, 0]
    };
    sorting::ranks(name, positions.len(), key, context)
}

/// Ranks by chance, under the run's seed.
///
/// # Errors
/// As [`pca_ranks`].
pub fn random_ranks(name: &str, vertices: usize, context: Context<'_>) -> Result<MappedSlice<u32>> {
    let key = |v: usize| {
        let draw = xxh3_64_with_seed(&(v as u64).to_le_bytes(), context.run.seed);
        [(draw >> 32) as u32, draw as u32, 0, 0]
    };
    sorting::ranks(name, vertices, key, context)
}
