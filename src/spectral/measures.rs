//! The quality of a sample: Γ and related measures from `[A B]` (§5 of the paper), and true errors on small sets.
//!
//! With the kept eigenpairs (λ_e, u_e) of A, w̃_jj = Σ_e (u_eᵀB_j)²/λ_e, and affinities of 1 on the diagonal:
//! - Γ = tr(BᵀA⁻¹B) (eq. 6, with the truncated pseudo-inverse) = Σ_j w̃_jj over the m = n − l nodes that are not
//!   landmarks;
//! - Γ* = Σ_j (1 − |1 − w̃_jj|): equal to Γ for positive kernels; for others, overshoot counts as an error rather than
//!   a gain;
//! - held-out residual (Σ_h ‖w_h − w̃_h‖² / Σ_h ‖w_h‖²)^½ over random columns h whose affinities are known.
//!
//! [`measure`] computes all of them in `f64`; [`Gamma`] accumulates Γ in `f32` during another pass over the columns.
//! One pass, O(n l²), each; C is never formed.
//!
//! [`exact`] compares with all of W: the norms of the Schur complement C − BᵀA⁺B, the residual, the angles between
//! approximated and true eigenvectors. Memory: a few n × n matrices in `f64`; O(n³): seconds for a thousand nodes,
//! minutes for four thousand.

use super::affinity::{CHUNK, KeptEigenpairs, SampledBlock, landmark_affinities};
use super::kernel::Kernel;
use super::nystrom::{ExtensionParams, Extrapolation, NystromExtension};
use crate::base::random::{stream, unit};
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::{Result, eigen};
use crate::distance::DistanceRows;
use crate::store::Run;
use nalgebra::DMatrix;
use serde::Serialize;

/// Measures of the quality of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Measures {
    /// Γ.
    pub gamma: f64,
    /// Γ/n.
    pub gamma_per_node: f64,
    /// Γ*.
    pub gamma_star: f64,
    /// Greatest w̃_jj; above 1 only if the kernel is not positive, or by rounding.
    pub max_diagonal: f64,
    /// Held-out residual, if columns were held out.
    pub held_out: Option<f64>,
    /// Σ|λ < 0| / Σ|λ| of A.
    pub negative_mass: f64,
    /// Negative eigenvalues of A.
    pub negative_eigenvalues: usize,
    /// Eigenpairs of A that were dropped.
    pub dropped_eigenpairs: usize,
}

/// Measures `block`, whose affinities are 1 on the diagonal. `held_out`, if given, is a block of the held-out columns'
/// own rows over the same nodes. `tolerance`: see [`KeptEigenpairs::of`].
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn measure(
    block: &dyn SampledBlock,
    held_out: Option<&dyn SampledBlock>,
    tolerance: f64,
    run: &Run,
) -> Result<Measures> {
    let (l, n) = (block.len(), block.nodes());
    let kept = KeptEigenpairs::of(block.sampled(), tolerance);
    let roots = kept.roots().transpose();
    let mut sorted_landmarks: Vec<u32> = block.landmarks().to_vec();
    sorted_landmarks.sort_unstable();
    // A⁺ B_h as rows (h × l).
    let toward: Option<DMatrix<f64>> =
        held_out.map(|held| (roots.tr_mul(&(&roots * block.columns_of(held.landmarks())))).transpose());
    let parts = run.map_ranges(n, CHUNK, |range| {
        let m = range.len();
        let mut out = vec![0.; l * m];
        block.columns(range.clone(), &mut out);
        // Rows of `out` are columns of this matrix: m × l.
        let columns = DMatrix::from_vec(m, l, out);
        let dots = &columns * roots.transpose();
        let (mut gamma, mut star, mut greatest) = (0., 0., 0f64);
        for j in 0..m {
            if sorted_landmarks.binary_search(&((range.start + j) as u32)).is_ok() {
                continue;
            }
            let w: f64 = dots.row(j).norm_squared();
            gamma += w;
            star += 1. - (1. - w).abs();
            greatest = greatest.max(w);
        }
        let (mut error, mut norm) = (0., 0.);
        if let (Some(held), Some(toward)) = (held_out, &toward) {
            let h = held.len();
            let mut truth = vec![0.; h * m];
            held.columns(range, &mut truth);
            let truth = DMatrix::from_vec(m, h, truth);
            error = (&truth - &columns * toward.transpose()).norm_squared();
            norm = truth.norm_squared();
        }
        Ok([gamma, star, greatest, error, norm])
    })?;
    let sum = |i: usize| parts.iter().map(|part| part[i]).sum::<f64>();
    Ok(Measures {
        gamma: sum(0),
        gamma_per_node: sum(0) / n.max(1) as f64,
        gamma_star: sum(1),
        max_diagonal: parts.iter().fold(0., |top, part| part[2].max(top)),
        held_out: held_out.map(|_| (sum(3) / sum(4).max(1e-300)).sqrt()),
        negative_mass: kept.negative_mass(),
        negative_eigenvalues: kept.negative(),
        dropped_eigenpairs: kept.dropped(),
    })
}

/// The quadratic form of Γ, to be evaluated on columns.
#[derive(Clone, Debug)]
pub struct Gamma {
    /// uᵉ/√λ_e of the kept eigenpairs: rows of l.
    roots: Vec<f32>,
    l: usize,
    /// Σ w̃_jj over the landmarks themselves, to be subtracted from the sum.
    landmarks: f64,
}

impl Gamma {
    /// The form for the affinities of `rows` under a kernel of width `sigma`.
    pub fn new(rows: &DistanceRows, kernel: Kernel, sigma: f64) -> Self {
        let l = rows.len();
        let a = landmark_affinities(rows, kernel, sigma);
        let kept = KeptEigenpairs::of(a, kernel.tolerance(l));
        // A's own columns: u_eᵀA_j = λ_e u_ej, so Σ_j w̃_jj over the landmarks is Σ λ_e.
        let landmarks = kept.values.iter().sum();
        let roots = kept.roots().iter().map(|&root| root as f32).collect();
        Self { roots, l, landmarks }
    }

    /// Σ w̃_jj over a chunk of `m` columns, whose affinities (l rows of m) come from [`super::Embedding::chunk`].
    pub fn chunk(&self, m: usize, affinities: &[f32]) -> f64 {
        dispatch(SquaredNorms { roots: &self.roots, l: self.l, m, affinities })
    }

    /// Γ from the sum over all columns, landmarks included.
    pub fn of_sum(&self, sum: f64) -> f64 {
        sum - self.landmarks
    }
}

/// Number of roots processed in parallel lanes.
const LANES: usize = 16;
/// Columns whose squares are summed before they are added to the total.
const BLOCK: usize = 64;

/// Σ_e Σ_j (uᵉᵀB_j/√λ_e)² over `m` columns, in the order of roots, then of blocks of columns, for [`dispatch`].
///
/// In `f32`, the squares of a block are added one after another, which fixes the bits of Γ. Several roots are processed
/// at once, each in its own lane, so that none waits for another.
struct SquaredNorms<'a> {
    /// Rows of l.
    roots: &'a [f32],
    l: usize,
    m: usize,
    /// l rows of m.
    affinities: &'a [f32],
}

impl SimdKernel for SquaredNorms<'_> {
    type Output = f64;

    #[inline(always)]
    fn run(self) -> f64 {
        let Self { roots, l, m, affinities } = self;
        let mut factors = vec![[0f32; LANES]; l];
        let mut sums = vec![[0f32; LANES]; m.div_ceil(BLOCK)];
        let mut total = 0f64;
        for some in roots.chunks(LANES * l.max(1)) {
            let count = some.len() / l;
            for (k, lanes) in factors.iter_mut().enumerate() {
                *lanes = std::array::from_fn(|lane| if lane < count { some[lane * l + k] } else { 0. });
            }
            for (b, sum) in sums.iter_mut().enumerate() {
                *sum = [0.; LANES];
                for j in b * BLOCK..m.min((b + 1) * BLOCK) {
                    let mut dot = [0f32; LANES];
                    for k in 0..l {
                        for lane in 0..LANES {
                            dot[lane] += factors[k][lane] * affinities[k * m + j];
                        }
                    }
                    for lane in 0..LANES {
                        sum[lane] += dot[lane] * dot[lane];
                    }
                }
            }
            for lane in 0..count {
                total = sums.iter().fold(total, |total, sum| total + f64::from(sum[lane]));
            }
        }
        total
    }
}

/// True errors of an approximation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrueErrors {
    /// Frobenius norm of the Schur complement.
    pub frobenius: f64,
    /// Its spectral norm.
    pub spectral: f64,
    /// Its nuclear norm: m − Γ if the kernel is positive and nothing was dropped.
    pub nuclear: f64,
    /// ‖W − W̄‖ / ‖W‖, Frobenius.
    pub residual: f64,
    /// Principal angles between the leading true eigenvectors and those of the plain extrapolation (eq. 1), in
    /// degrees, ascending.
    pub angles: Vec<f64>,
}

/// BᵀA⁺B over all nodes (n × n), as one matrix.
pub fn approximation(block: &dyn SampledBlock, tolerance: f64) -> DMatrix<f64> {
    let n = block.nodes();
    let mut columns = vec![0.; block.len() * n];
    block.columns(0..n, &mut columns);
    let f = DMatrix::from_vec(n, block.len(), columns) * KeptEigenpairs::of(block.sampled(), tolerance).roots();
    &f * f.transpose()
}

/// Only the norms of the Schur complement: Frobenius, spectral, nuclear. `w` (n × n) are all affinities.
pub fn schur_norms(w: &DMatrix<f64>, block: &dyn SampledBlock, tolerance: f64) -> [f64; 3] {
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
pub fn residual(w: &DMatrix<f64>, block: &dyn SampledBlock, tolerance: f64) -> f64 {
    (w - approximation(block, tolerance)).norm() / w.norm()
}

/// All of the measures; `vectors`: how many leading eigenvectors are compared.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn exact(
    w: &DMatrix<f64>,
    block: &dyn SampledBlock,
    tolerance: f64,
    vectors: usize,
    run: &Run,
) -> Result<TrueErrors> {
    let [frobenius, spectral, nuclear] = schur_norms(w, block, tolerance);
    let found =
        NystromExtension::fit(block, ExtensionParams::new(Extrapolation::Plain, vectors, tolerance), None, run)?
            .embed(block);
    let truth = leading(w, found.ncols()).1;
    Ok(TrueErrors {
        frobenius,
        spectral,
        nuclear,
        residual: residual(w, block, tolerance),
        angles: angles(&truth, &found),
    })
}

/// Principal angles between the spans of two sets of columns, in degrees, ascending.
pub fn angles(a: &DMatrix<f64>, b: &DMatrix<f64>) -> Vec<f64> {
    let basis = |x: &DMatrix<f64>| x.clone().qr().q();
    let cosines = basis(a).tr_mul(&basis(b)).svd(false, false).singular_values;
    let mut angles: Vec<f64> = cosines.iter().map(|c| c.clamp(-1., 1.).acos().to_degrees()).collect();
    angles.sort_by(f64::total_cmp);
    angles
}

/// The `k` greatest eigenvalues of `w`, descending, and their eigenvectors, chosen from the k + 10 eigenpairs of
/// greatest absolute value, by subspace iteration: n² k per step.
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

/// Relative error of the coordinates `found` (n × d) against `truth` after the best rotation between them, with nodes
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference: root by root, column by column.
    fn one_by_one(roots: &[f32], l: usize, m: usize, affinities: &[f32]) -> f64 {
        let mut total = 0f64;
        for root in roots.chunks_exact(l) {
            for first in (0..m).step_by(BLOCK) {
                let mut sum = 0f32;
                for j in first..m.min(first + BLOCK) {
                    let mut dot = 0f32;
                    (0..l).for_each(|k| dot += root[k] * affinities[k * m + j]);
                    sum += dot * dot;
                }
                total += f64::from(sum);
            }
        }
        total
    }

    #[test]
    fn roots_side_by_side_sum_to_the_same_bits() {
        let mut draw = stream(0, "affinities");
        let mut draws = |n: usize| -> Vec<f32> { (0..n).map(|_| unit(&mut draw) as f32 - 0.25).collect() };
        for (l, count, m) in [(1, 1, 1), (10, 10, 2048), (40, 33, 130), (5, 0, 7), (17, 16, 64)] {
            let (roots, affinities) = (draws(l * count), draws(l * m));
            let sum = dispatch(SquaredNorms { roots: &roots, l, m, affinities: &affinities });
            assert_eq!(sum.to_bits(), one_by_one(&roots, l, m, &affinities).to_bits());
        }
    }
}
