//! The angle between two unit normals, accurate where they nearly agree.
//!
//! `acos(a·b)` loses half the digits near zero: in `f32` a flat edge would get 4e-4 radians of noise, more than its
//! length contributes. `2 asin(|a − b| / 2)` keeps them. We use our own polynomial, so that results do not depend on
//! the system's mathematical library.

use crate::base::vector::is_zero;

/// `asin(x)` for `x` in `[0, 1]`, to 3e-7 relative; other values are clamped.
#[inline]
pub fn asin(x: f32) -> f32 {
    // asin(x) = x + x³ P(x²) on [0, ½]; beyond by asin(x) = π/2 − 2 asin(√((1 − x)/2)).
    fn small(x: f32) -> f32 {
        let z = x * x;
        let p = 0.166_666_67
            + z * (0.075_000_99 + z * (0.044_598_03 + z * (0.031_116_156 + z * (0.017_077_86 + z * 0.033_805_75))));
        x + x * z * p
    }
    let x = x.clamp(0., 1.);
    if x <= 0.5 { small(x) } else { std::f32::consts::FRAC_PI_2 - 2. * small(((1. - x) * 0.5).sqrt()) }
}

/// The angle in radians, in `[0, π]`, between unit vectors; 0 if one of them is zero (a degenerate face has no
/// direction).
#[inline]
pub fn between(a: [f32; 3], b: [f32; 3]) -> f32 {
    if is_zero(a) || is_zero(b) {
        return 0.;
    }
    2. * asin(0.5 * chord2(a, b).sqrt())
}

/// `|a − b|²`, which is `2 (1 − cos θ)` for unit vectors; symmetric to the bit.
#[inline]
pub fn chord2(a: [f32; 3], b: [f32; 3]) -> f32 {
    let (x, y, z) = (a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    x * x + y * y + z * z
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn asin_is_accurate() {
        for i in 0..=100_000 {
            let x = i as f32 / 100_000.;
            let exact = f64::from(x).asin();
            let error = (f64::from(asin(x)) - exact).abs() / exact.max(1e-9);
            assert!(error < 6e-7, "asin({x}): {error}");
        }
    }

    #[test]
    fn small_angles_keep_their_digits() {
        for exponent in 1..7 {
            let angle = 10f64.powi(-exponent);
            let b = [angle.cos() as f32, angle.sin() as f32, 0.];
            let error = (f64::from(between([1., 0., 0.], b)) / angle - 1.).abs();
            assert!(error < 0.1f64.powi(7 - exponent).max(2e-6), "angle {angle}: {error}");
        }
        assert!((between([1., 0., 0.], [-1., 0., 0.]) - std::f32::consts::PI).abs() < 1e-6);
    }
}
