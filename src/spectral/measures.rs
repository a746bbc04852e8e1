//! How good a sample is, from `[A B]` and a few columns more (§5 of the paper).
//!
//! With the kept eigenpairs (λ_e, u_e) of A and w̃_jj = Σ_e (u_eᵀB_j)²/λ_e, affinities of 1 on the diagonal:
//! - Γ = Σ_j w̃_jj over the m = n − l nodes that are no landmarks (eq. 6 with the truncated pseudo-inverse);
//! - Γ* = Σ_j (1 − |1 − w̃_jj|): the same for positive kernels; for others overshoot counts against, not for;
//! - held-out residual (Σ_h ‖w_h − w̃_h‖² / Σ_h ‖w_h‖²)^½ over random columns h whose affinities are known.
//!
//! One pass over the columns each, O(n l²); C is never formed.

use super::block::{Block, CHUNK};
use crate::base::parallel::map_ranges;
use crate::base::{Result, eigen};
use crate::store::Run;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;

/// The eigenpairs of A that are kept, and what is known of the others.
#[derive(Clone, Debug)]
pub struct Kept {
    /// Kept eigenvalues, descending (r ≥ 1 unless l = 0).
    pub values: Vec<f64>,
    /// Their eigenvectors (l × r).
    pub vectors: DMatrix<f64>,
    /// All eigenvalues (l).
    pub all: Vec<f64>,
}

impl Kept {
    /// Keeps eigenvalues of `a` above `tolerance` times the greatest.
    pub fn of(a: DMatrix<f64>, tolerance: f64) -> Self {
        let (all, vectors) = eigen::symmetric(a);
        let cut = (tolerance * all.first().copied().unwrap_or(0.)).max(0.);
        let count = all.iter().take_while(|&&value| value > cut).count().max(1).min(all.len());
        Self { values: all[..count].to_vec(), vectors: vectors.columns(0, count).into_owned(), all }
    }

    /// Columns uᵉ·√(λ_e/(λ_e² + ε²)) of all positive eigenvalues of `a` (l × r), ε `tolerance` times the greatest: their
    /// product with its transpose is A⁺ with Tikhonov's damping for a cut. A cut keeps a pair here and drops it on a
    /// mesh that differs by its triangles alone; this depends on A continuously.
    pub fn damped(a: DMatrix<f64>, tolerance: f64) -> DMatrix<f64> {
        let (all, mut vectors) = eigen::symmetric(a);
        let epsilon = tolerance * all.first().copied().unwrap_or(0.);
        let count = all.iter().take_while(|&&value| value > 0.).count().max(1).min(all.len());
        for (mut column, &value) in vectors.column_iter_mut().zip(&all[..count]) {
            let value = value.max(1e-300);
            column *= (value / (value * value + epsilon * epsilon)).sqrt();
        }
        vectors.columns(0, count).into_owned()
    }

    /// Eigenpairs dropped.
    pub fn dropped(&self) -> usize {
        self.all.len() - self.values.len()
    }

    /// Number of negative eigenvalues.
    pub fn negative(&self) -> usize {
        self.all.iter().filter(|value| **value < 0.).count()
    }

    /// Σ|λ < 0| / Σ|λ|.
    pub fn negative_mass(&self) -> f64 {
        let mass: f64 = self.all.iter().map(|value| value.abs()).sum();
        let negative: f64 = self.all.iter().filter(|value| **value < 0.).map(|value| -value).sum();
        // An empty sum is −0.
        if mass > 0. { (negative / mass).max(0.) } else { 0. }
    }

    /// A⁺ b.
    pub fn solve(&self, b: &[f64]) -> Vec<f64> {
        let mut in_basis = self.vectors.tr_mul(&DVector::from_column_slice(b));
        in_basis.iter_mut().zip(&self.values).for_each(|(x, value)| *x /= value);
        (&self.vectors * in_basis).iter().copied().collect()
    }

    /// uᵉ/√λ_e as columns (l × r): A⁺ is this times its transpose.
    pub fn roots(&self) -> DMatrix<f64> {
        let mut roots = self.vectors.clone();
        for (mut column, value) in roots.column_iter_mut().zip(&self.values) {
            column /= value.sqrt();
        }
        roots
    }
}

/// Numbers that tell how good a sample is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Measures {
    /// Γ.
    pub gamma: f64,
    /// Γ/n.
    pub gamma_per_node: f64,
    /// Γ*.
    pub gamma_star: f64,
    /// Greatest w̃_jj; above 1 only where the kernel is not positive, or by rounding.
    pub greatest: f64,
    /// Held-out residual, where columns were held out.
    pub held_out: Option<f64>,
    /// Σ|λ < 0| / Σ|λ| of A.
    pub negative_mass: f64,
    /// Negative eigenvalues of A.
    pub negative: usize,
    /// Eigenpairs of A that were dropped.
    pub dropped: usize,
}

/// Measures `block`, of affinities that are 1 on the diagonal. `held_out`, where given, is a block of the held-out
/// columns' own rows over the same nodes. `tolerance`: see [`Kept::of`].
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn measure(block: &dyn Block, held_out: Option<&dyn Block>, tolerance: f64, run: &Run) -> Result<Measures> {
    let (l, n) = (block.len(), block.nodes());
    let kept = Kept::of(block.sampled(), tolerance);
    let roots = kept.roots().transpose();
    let mut is_landmark: Vec<u32> = block.landmarks().to_vec();
    is_landmark.sort_unstable();
    // A⁺ B_h as rows (h × l).
    let toward: Option<DMatrix<f64>> =
        held_out.map(|held| (roots.tr_mul(&(&roots * block.columns_of(held.landmarks())))).transpose());
    let parts = map_ranges(run.threads, &run.cancel, n, CHUNK, |range| {
        let m = range.len();
        let mut out = vec![0.; l * m];
        block.columns(range.clone(), &mut out);
        // Rows of `out` are columns of this matrix: m × l.
        let columns = DMatrix::from_vec(m, l, out);
        let dots = &columns * roots.transpose();
        let (mut gamma, mut star, mut greatest) = (0., 0., 0f64);
        for j in 0..m {
            if is_landmark.binary_search(&((range.start + j) as u32)).is_ok() {
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
        greatest: parts.iter().fold(0., |top, part| part[2].max(top)),
        held_out: held_out.map(|_| (sum(3) / sum(4).max(1e-300)).sqrt()),
        negative_mass: kept.negative_mass(),
        negative: kept.negative(),
        dropped: kept.dropped(),
    })
}
