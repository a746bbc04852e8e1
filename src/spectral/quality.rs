//! Γ, the paper's quality measure (§5), from `[A B]` alone.
//!
//! Γ = tr(BᵀA⁻¹B) (eq. 6) = Σ_j w̃_jj over the faces that are no landmarks, w̃_jj = Σ_e (u_eᵀB_j)²/λ_e over the kept
//! eigenpairs of A: the truncated pseudo-inverse, since A of a Gaussian of geodesic distances is indefinite.
//! [`Gamma::chunk`] adds a chunk of columns, l² multiply-adds a face, vectorised; O(m l²) in all, one pass.

use super::eigen;
use super::embedding::landmark_affinities;
use super::kernel::Kernel;
use crate::distance::DistanceRows;

/// Γ's quadratic form, ready for columns.
#[derive(Clone, Debug)]
pub struct Gamma {
    kernel: Kernel,
    sigma: f32,
    /// uᵉ/√λ_e of the kept eigenpairs: rows of l.
    roots: Vec<f32>,
    l: usize,
    /// w̃ of the landmarks themselves, to be taken off the sum.
    landmarks: f64,
}

impl Gamma {
    /// The form for the affinities of `rows` under a kernel of width `sigma`.
    pub fn new(rows: &DistanceRows, kernel: Kernel, sigma: f64) -> Self {
        let l = rows.len();
        let a = landmark_affinities(rows, kernel, sigma);
        let (values, vectors) = eigen::symmetric(a.clone());
        let cut = kernel.tolerance(l) * values.first().copied().unwrap_or(0.);
        let kept: Vec<usize> = (0..l).filter(|&e| values[e] > cut && values[e] > 0.).collect();
        let mut landmarks = 0.;
        for &e in &kept {
            // A's own columns: u_eᵀA_j = λ_e u_ej, so w̃ = Σ λ_e u_ej².
            landmarks += values[e];
        }
        let roots =
            kept.iter().flat_map(|&e| (0..l).map(move |k| (e, k))).map(|(e, k)| (vectors[(k, e)] / values[e].sqrt()) as f32);
        Self { kernel, sigma: sigma as f32, roots: roots.collect(), l, landmarks }
    }

    /// Σ w̃_jj over a chunk of `m` columns; `distances(k)` as in [`super::Embedding::chunk`].
    pub fn chunk<'a>(&self, m: usize, distances: impl Fn(usize) -> &'a [f32]) -> f64 {
        let mut affinities = vec![0f32; self.l * m];
        for (k, row) in affinities.chunks_exact_mut(m).enumerate() {
            self.kernel.apply(self.sigma, distances(k), row);
        }
        let mut dot = vec![0f32; m];
        let mut sum = 0f64;
        for root in self.roots.chunks_exact(self.l.max(1)) {
            dot.fill(0.);
            for (row, &u) in affinities.chunks_exact(m).zip(root) {
                for (d, &w) in dot.iter_mut().zip(row) {
                    *d += u * w;
                }
            }
            for block in dot.chunks(64) {
                sum += f64::from(block.iter().map(|d| d * d).sum::<f32>());
            }
        }
        sum
    }

    /// Γ from the sum over all columns, landmarks included.
    pub fn of_sum(&self, sum: f64) -> f64 {
        sum - self.landmarks
    }
}
