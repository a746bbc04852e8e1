//! Kernels: from distance to affinity.
//!
//! Rows of distances become affinities in `f32`, in loops that vectorise ([`Kernel::apply`]); the l × l problems of the
//! landmarks use `f64` ([`Kernel::of`]). Cost: some ten operations per distance, no memory.

use super::exp::{exp, exp64};
use crate::base::printable::Significant;
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::{Error, Result};
use serde::{Deserialize, Serialize};

const ROOT_3: f64 = 1.732_050_807_568_877_2;

/// The function from a distance d to an affinity, given the width σ.
///
/// The Gaussian of geodesic distances is not positive semi-definite (30–48 of 100 eigenvalues of A
/// were negative on real meshes); the exponential nearly is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kernel")]
pub enum Kernel {
    /// exp(−d²/2σ²), eq. 3.
    #[default]
    Gaussian,
    /// exp(−d/σ).
    Exponential,
    /// max(0, 1 − d/4σ)^degree: compact support, positive for high degrees.
    Polynomial {
        /// The power, 1 to 8.
        degree: u32,
    },
    /// 1/√(1 + d²/σ²).
    InverseMultiquadric,
    /// (1 + √3 d/σ) exp(−√3 d/σ), Matérn's kernel of order 3/2: smooth at 0, with an exponential tail.
    Matern,
    /// 1/(1 + d²/σ²).
    Cauchy,
}

/// Validates a kernel's width σ, in any unit.
///
/// # Errors
/// [`Error::Parameter`] if it is not a positive number below a million.
pub(super) fn check_width(width: f64) -> Result<()> {
    if width > 0. && width < 1e6 {
        return Ok(());
    }
    let problem = format!("{} is not a width", Significant(width));
    Err(Error::parameter("width", problem, "choose a positive number below 1000000"))
}

impl Kernel {
    /// Checks that the constants are in range.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a polynomial degree out of range.
    pub fn check(&self) -> Result<()> {
        match self {
            Self::Polynomial { degree } if !(1..=8).contains(degree) => {
                Err(Error::parameter("degree", format!("{degree} is out of range"), "choose from 1 to 8"))
            }
            _ => Ok(()),
        }
    }

    /// Converts `distances` to affinities, item by item; `out` has the same length. An infinite distance becomes 0, or,
    /// for kernels that use [`exp`], less than 2e-36.
    pub fn apply(&self, sigma: f32, distances: &[f32], out: &mut [f32]) {
        // Finite for any σ, so that a distance of 0 is never multiplied by infinity.
        let inverse = if sigma > 0. { (1. / sigma).min(f32::MAX) } else { 0. };
        dispatch(Applied { kernel: *self, inverse, distances, out });
    }

    /// The affinity of one distance, in `f64`, for the l × l problems.
    pub fn of(&self, sigma: f64, d: f64) -> f64 {
        if d.is_infinite() {
            return 0.;
        }
        let r = if sigma > 0. { d / sigma } else { 0. };
        match *self {
            Self::Gaussian => exp64(-0.5 * r * r),
            Self::Exponential => exp64(-r),
            Self::Polynomial { degree } => (1. - r * 0.25).max(0.).powi(degree as i32),
            Self::InverseMultiquadric => 1. / (1. + r * r).sqrt(),
            Self::Matern => (1. + ROOT_3 * r) * exp64(-ROOT_3 * r),
            Self::Cauchy => 1. / (1. + r * r),
        }
    }

    /// Whether A of geodesic distances is positive up to rounding and a few eigenvalues, so that its Cholesky
    /// factorisation is meaningful.
    pub fn nearly_positive(&self) -> bool {
        matches!(self, Self::Exponential)
    }

    /// Eigenvalues of A up to this share of the greatest are dropped: below it, rounding and indefiniteness leave only
    /// noise (measured with `f32` data). With 1e-6 instead of 1e-3 for the exponential, samples of 40 and more had up
    /// to 17 times the residual: small eigenvalues that happen to be positive are no better than negative ones.
    pub fn tolerance(&self, l: usize) -> f64 {
        match self {
            Self::Exponential => 1e-3,
            _ => (0.1 / l.max(1) as f64).clamp(1e-3, 1e-2),
        }
    }
}

/// [`Kernel::apply`], for [`dispatch`].
struct Applied<'a> {
    kernel: Kernel,
    /// 1/σ.
    inverse: f32,
    distances: &'a [f32],
    out: &'a mut [f32],
}

impl SimdKernel for Applied<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { kernel, inverse, distances, out } = self;
        match kernel {
            Kernel::Gaussian => {
                for (k, &d) in out.iter_mut().zip(distances) {
                    let r = d * inverse;
                    *k = exp(-0.5 * r * r);
                }
            }
            Kernel::Exponential => {
                for (k, &d) in out.iter_mut().zip(distances) {
                    *k = exp(-d * inverse);
                }
            }
            Kernel::Polynomial { degree } => {
                for (k, &d) in out.iter_mut().zip(distances) {
                    *k = (1. - d * inverse * 0.25).max(0.).powi(degree as i32);
                }
            }
            Kernel::InverseMultiquadric => {
                for (k, &d) in out.iter_mut().zip(distances) {
                    let r = d * inverse;
                    *k = 1. / (1. + r * r).sqrt();
                }
            }
            Kernel::Matern => {
                for (k, &d) in out.iter_mut().zip(distances) {
                    // Beyond 87 the exponential is constant; the bound avoids infinity times zero.
                    let r = (d * inverse * ROOT_3 as f32).min(100.);
                    *k = (1. + r) * exp(-r);
                }
            }
            Kernel::Cauchy => {
                for (k, &d) in out.iter_mut().zip(distances) {
                    let r = d * inverse;
                    *k = 1. / (1. + r * r);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chunked_kernel_equals_the_exact_one() {
        let distances: Vec<f32> = (0..1000).map(|i| i as f32 * 0.02).chain([f32::INFINITY]).collect();
        for kernel in [
            Kernel::Gaussian,
            Kernel::Exponential,
            Kernel::Polynomial { degree: 3 },
            Kernel::InverseMultiquadric,
            Kernel::Matern,
            Kernel::Cauchy,
        ] {
            let mut out = vec![0.; distances.len()];
            kernel.apply(1.5, &distances, &mut out);
            for (&d, &k) in distances.iter().zip(&out) {
                assert!((f64::from(k) - kernel.of(1.5, f64::from(d))).abs() < 1e-6, "{kernel:?} {d}");
            }
            assert!(out[1000] < 2e-36, "{kernel:?} of an infinite distance");
        }
    }
}
