//! `exp` of a non-positive number, written so that a loop over it vectorises.
//!
//! exp(x) = 2^(x log₂e) = 2^i · 2^f with a polynomial on |f| ≤ ½. The relative error is below 3e-7, that of [`exp64`]
//! below 4e-16. The system's functions are as accurate, but need a call per value: passes over `[A B]` would be four to
//! eight times as slow, and results would differ between systems. Cost: about 15 multiplications and additions, no
//! memory.

/// exp(x) for x ≤ 0. Below −87 the result stays at e^−87 ≈ 1.6e-38, practically 0. The result for positive x or NaN is
/// unspecified.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let x = if x < -87. { -87. } else { x };
    let t = x * std::f32::consts::LOG2_E;
    // Rounding by the magic number 1.5 · 2²³: two additions, no call.
    let magic = 12_582_912f32;
    let rounded = t + magic;
    let i = rounded - magic;
    // f = t − i in two steps of ln 2 for accuracy.
    let r = x - i * 0.693_359_4 + i * 2.121_944_4e-4;
    let p = 1.987_569_1e-4;
    let p = p * r + 1.398_199_9e-3;
    let p = p * r + 8.333_452e-3;
    let p = p * r + 4.166_579_6e-2;
    let p = p * r + 1.666_666_5e-1;
    let p = p * r + 0.5;
    let e = p * r * r + r + 1.;
    let scale = f32::from_bits(
        ((rounded.to_bits() as i32).wrapping_sub(magic.to_bits() as i32).wrapping_add(127) as u32) << 23,
    );
    e * scale
}

/// exp(x) for x ≤ 0 in double precision; 0 below −708. The result for positive x or NaN is unspecified.
#[inline(always)]
pub fn exp64(x: f64) -> f64 {
    let least = -708.;
    let t = if x < least { least } else { x };
    // Rounding by the magic number 1.5 · 2⁵².
    let magic = 6_755_399_441_055_744f64;
    let rounded = t * std::f64::consts::LOG2_E + magic;
    let i = rounded - magic;
    // ln 2 is subtracted in two parts: the first has so few digits that its product with i is exact.
    let r = t - i * 0.693_147_180_369_123_8 - i * 1.908_214_929_270_587_7e-10;
    let mut p = FACTORS[0];
    for factor in &FACTORS[1..] {
        p = p * r + factor;
    }
    let e = p * r * r + r + 1.;
    let scale = f64::from_bits(rounded.to_bits().wrapping_sub(magic.to_bits()).wrapping_add(1023) << 52);
    if x < least { 0. } else { e * scale }
}

/// exp(x) of any x in double precision, by [`exp64`]; infinite above 708.
#[inline]
pub fn exp_signed(x: f64) -> f64 {
    if x > 0. { 1. / exp64(-x) } else { exp64(x) }
}

/// The probability with these log odds: 1 / (1 + exp(−x)).
#[inline]
pub fn logistic(log_odds: f64) -> f64 {
    1. / (1. + exp_signed(-log_odds))
}

/// 1/13!, 1/12!, …, 1/2!.
const FACTORS: [f64; 12] = {
    let mut factors = [0.5; 12];
    let mut k = 11;
    let mut factorial = 2.;
    while k > 0 {
        k -= 1;
        factorial *= 13. - k as f64;
        factors[k] = 1. / factorial;
    }
    factors
};

#[cfg(test)]
mod tests {
    #[test]
    fn exp64_is_accurate() {
        for i in 0..700_000 {
            let x = -f64::from(i) * 1.01e-3;
            let error = (super::exp64(x) - x.exp()).abs() / x.exp();
            assert!(error < 4e-16, "exp({x}): {error}");
        }
        for i in -7_000..7_000 {
            let x = f64::from(i) * 0.101;
            let error = (super::exp_signed(x) - x.exp()).abs() / x.exp();
            assert!(error < 6e-16, "exp({x}): {error}");
        }
        assert_eq!([f64::NEG_INFINITY, f64::INFINITY].map(super::exp_signed), [0., f64::INFINITY]);
        assert_eq!((super::exp64(0.), super::exp64(f64::NEG_INFINITY), super::exp64(-709.)), (1., 0., 0.));
    }

    #[test]
    fn exp_is_accurate() {
        for i in 0..200_000 {
            let x = -(i as f32) * 4e-4;
            let exact = f64::from(x).exp();
            let error = (f64::from(super::exp(x)) - exact).abs() / exact;
            assert!(error < 3e-7, "exp({x}): {error}");
        }
        assert_eq!(super::exp(0.), 1.);
        let least = super::exp(-87.);
        assert!(least < 1.7e-38);
        assert_eq!([-88., f32::NEG_INFINITY].map(super::exp), [least; 2]);
    }
}
