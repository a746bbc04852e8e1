//! How far the extrapolated embeddings are from the true one: relative errors over kinds and numbers of landmarks.
//!
//! The true embedding are the leading eigenvectors of all of W times the roots of their eigenvalues; area-weighted, those
//! of M^½WM^½, times M^-½. Coordinates are compared after the best rotation. Small sets only: all of W in `f64`.

use super::compare::{CompareParams, landmarks};
use super::ground::StudyData;
use crate::base::{Error, Result};
use crate::landmarks::Sampling;
use crate::spectral::block::{Affinities, Bandwidth};
use crate::spectral::exact::{aligned_error, leading};
use crate::spectral::kernel::Kernel;
use crate::spectral::nystrom::{Extension, Extrapolation, Scaling, Weigh};
use crate::store::Run;
use nalgebra::DMatrix;
use serde::Serialize;

/// Errors of one sample.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct EmbeddingError {
    /// Number of landmarks l.
    pub l: usize,
    /// Of the plain extrapolation, eq. 1–2.
    pub plain: f64,
    /// Of the orthogonalised one.
    pub orthogonal: f64,
    /// Of the orthogonalised one with nodes weighted by area, against the area-weighted truth.
    pub by_area: f64,
    /// Negative eigenvalues of A, as a share.
    pub negative: f64,
}

/// The errors of `d` coordinates for each number of landmarks in `sizes`, σ `width` times the mean distance.
///
/// # Errors
/// [`Error::Parameter`] where `ground` does not hold all distances, [`Error::Cancelled`].
pub fn errors(
    ground: &StudyData,
    (kernel, width): (Kernel, f64),
    sampling: Sampling,
    sizes: &[usize],
    d: usize,
    seed: u64,
    run: &Run,
) -> Result<Vec<EmbeddingError>> {
    let n = ground.len();
    let Some(matrix) = &ground.matrix else {
        return Err(Error::parameter("--exact", format!("{n} faces are too many"), "decimate the mesh"));
    };
    let bytes = 8 * (n * n) as u64;
    let _grant = run.budget.take("all affinities", bytes, bytes)?;
    let sigma = width * ground.mean;
    let affinity = |i: usize, j: usize| kernel.of(sigma, 0.5 * f64::from(matrix[i * n + j] + matrix[j * n + i]));
    let weights = ground.weights();
    let ones = vec![1.; n];
    let truth = |weights: &[f64]| {
        let w = DMatrix::from_fn(n, n, |i, j| affinity(i, j) * (weights[i] * weights[j]).sqrt());
        let (values, mut vectors) = leading(&w, d);
        for (mut column, value) in vectors.column_iter_mut().zip(&values) {
            column *= value.max(0.).sqrt();
        }
        for (mut row, weight) in vectors.row_iter_mut().zip(weights) {
            row /= weight.sqrt();
        }
        vectors
    };
    let (even, by_area) = (truth(&ones), truth(&weights));
    let most = sizes.iter().copied().max().unwrap_or(0).min(n);
    let (found, _) = landmarks(ground, sampling, most, seed, &CompareParams::default(), run)?;
    let one = |&l: &usize| {
        let l = l.min(n);
        let rows: Vec<&[f32]> = found[..l].iter().map(|&i| &matrix[i as usize * n..(i as usize + 1) * n]).collect();
        let block = Affinities::new(&found[..l], rows, kernel, Bandwidth::Global(sigma));
        let tolerance = kernel.tolerance(l);
        let error = |how, weights: Option<&[f64]>, truth: &DMatrix<f64>| -> Result<f64> {
            let weigh = weights.map(|weights| move |node: usize| weights[node]);
            let weigh = weigh.as_ref().map(|weigh| weigh as Weigh<'_>);
            let y = Extension::fit(&block, how, Scaling::Root, d, weigh, tolerance, run)?.embed(&block);
            let mut padded = DMatrix::zeros(n, truth.ncols());
            padded.columns_mut(0, y.ncols()).copy_from(&y);
            Ok(aligned_error(truth, &padded, weights.unwrap_or(&ones)))
        };
        let kept = crate::spectral::measures::Kept::of(crate::spectral::block::Block::sampled(&block), tolerance);
        Ok(EmbeddingError {
            l,
            plain: error(Extrapolation::Plain, None, &even)?,
            orthogonal: error(Extrapolation::Orthogonal, None, &even)?,
            by_area: error(Extrapolation::Orthogonal, Some(&weights), &by_area)?,
            negative: kept.negative() as f64 / l as f64,
        })
    };
    sizes.iter().map(one).collect()
}
