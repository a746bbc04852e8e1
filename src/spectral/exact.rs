//! What the approximation is compared with on small sets, where all of W is at hand.
//!
//! The norms of the Schur complement C − BᵀA⁺B, the residual of all of W, the angles between approximated and true
//! eigenvectors. Memory: a few n × n matrices in `f64`; cost O(n³): seconds at a thousand nodes, minutes at four.

use super::block::Block;
use super::measures::Kept;
use super::nystrom::{Extension, Extrapolation, Scaling};
use crate::base::random::{stream, unit};
use crate::base::{Result, eigen};
use crate::store::Run;
use nalgebra::DMatrix;
use serde::Serialize;

/// True measures of an approximation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Exact {
    /// Frobenius norm of the Schur complement.
    pub frobenius: f64,
    /// Its spectral norm.
    pub spectral: f64,
    /// Its nuclear norm: m − Γ where the kernel is positive and nothing was dropped.
    pub nuclear: f64,
    /// ‖W − W̄‖ / ‖W‖, Frobenius.
    pub residual: f64,
    /// Principal angles between the leading true eigenvectors and those of the plain extrapolation (eq. 1), in
    /// degrees, ascending.
    pub angles: Vec<f64>,
}

/// BᵀA⁺B over all nodes (n × n), in one piece.
pub fn approximation(block: &dyn Block, tolerance: f64) -> DMatrix<f64> {
    let n = block.nodes();
    let mut columns = vec![0.; block.len() * n];
    block.columns(0..n, &mut columns);
    let f = DMatrix::from_vec(n, block.len(), columns) * Kept::of(block.sampled(), tolerance).roots();
    &f * f.transpose()
}

/// The Schur complement's norms alone: Frobenius, spectral, nuclear. `w` (n × n) are all affinities.
pub fn schur_norms(w: &DMatrix<f64>, block: &dyn Block, tolerance: f64) -> [f64; 3] {
    let error = w - approximation(block, tolerance);
    let others: Vec<usize> = (0..w.nrows()).filter(|&j| !block.landmarks().contains(&(j as u32))).collect();
    if others.is_empty() {
        return [0.; 3];
    }
    let schur = error.select_rows(&others).select_columns(&others);
    let values = (0.5 * (&schur + schur.transpose())).symmetric_eigenvalues();
    let spectral = values.iter().fold(0f64, |top, value| top.max(value.abs()));
    [schur.norm(), spectral, values.iter().map(|value| value.abs()).sum()]
}

/// ‖W − W̄‖ / ‖W‖, Frobenius.
pub fn residual(w: &DMatrix<f64>, block: &dyn Block, tolerance: f64) -> f64 {
    (w - approximation(block, tolerance)).norm() / w.norm()
}

/// All of the measures; `vectors`: how many leading eigenvectors are compared.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn exact(w: &DMatrix<f64>, block: &dyn Block, tolerance: f64, vectors: usize, run: &Run) -> Result<Exact> {
    let [frobenius, spectral, nuclear] = schur_norms(w, block, tolerance);
    let found = Extension::fit(block, Extrapolation::Plain, Scaling::None, vectors, None, tolerance, run)?.embed(block);
    let truth = leading(w, found.ncols()).1;
    Ok(Exact { frobenius, spectral, nuclear, residual: residual(w, block, tolerance), angles: angles(&truth, &found) })
}

/// Principal angles between the spans of two sets of columns, in degrees, ascending.
pub fn angles(a: &DMatrix<f64>, b: &DMatrix<f64>) -> Vec<f64> {
    let basis = |x: &DMatrix<f64>| x.clone().qr().q();
    let cosines = basis(a).tr_mul(&basis(b)).svd(false, false).singular_values;
    let mut angles: Vec<f64> = cosines.iter().map(|c| c.clamp(-1., 1.).acos().to_degrees()).collect();
    angles.sort_by(f64::total_cmp);
    angles
}

/// The `k` eigenpairs of `w` of greatest absolute value, sorted by value, by subspace iteration: n² k a step.
pub fn leading(w: &DMatrix<f64>, k: usize) -> (Vec<f64>, DMatrix<f64>) {
    const MORE: usize = 10;
    const STEPS: usize = 300;
    let n = w.nrows();
    let size = (k + MORE).min(n);
    let mut draw = stream(0, "subspace");
    let mut basis = DMatrix::from_fn(n, size, |_, _| unit(&mut draw) - 0.5).qr().q();
    let mut before = f64::INFINITY;
    for _ in 0..STEPS {
        let next = w * &basis;
        let ritz: f64 = basis.columns(0, k.min(size)).dot(&next.columns(0, k.min(size)));
        basis = next.qr().q();
        if (ritz - before).abs() <= 1e-13 * ritz.abs() {
            break;
        }
        before = ritz;
    }
    let (values, q) = eigen::symmetric(basis.tr_mul(&(w * &basis)));
    (values[..k.min(size)].to_vec(), basis * q.columns(0, k.min(size)))
}

/// Relative error of the coordinates `found` (n × d) against `truth` after the best rotation between them, nodes
/// weighted by `weights` (n).
pub fn aligned_error(truth: &DMatrix<f64>, found: &DMatrix<f64>, weights: &[f64]) -> f64 {
    let weigh = |x: &DMatrix<f64>| {
        let mut x = x.clone();
        for (mut row, weight) in x.row_iter_mut().zip(weights) {
            row *= weight.sqrt();
        }
        x
    };
    let (truth, found) = (weigh(truth), weigh(found));
    let svd = found.tr_mul(&truth).svd(true, true);
    let rotation = match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => u * v_t,
        _ => DMatrix::identity(found.ncols(), truth.ncols()),
    };
    (&truth - found * rotation).norm() / truth.norm()
}
