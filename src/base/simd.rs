//! Loops compiled for the widest vectors that the processor supports.
//!
//! The program is built for every 64-bit processor, which on x86 means vectors of 16 bytes; a purely arithmetic loop
//! runs two to four times as fast on 32 or 64. [`dispatch`] runs a kernel compiled for the baseline, AVX2 or AVX-512,
//! whichever the processor supports. Results are the same to the bit: vectors perform the same operations on the same
//! numbers in the same order, and a multiplication and an addition are never fused.

/// A loop for [`dispatch`].
pub trait SimdKernel {
    /// The result.
    type Output;

    /// Runs it. Mark it and the functions that it calls `#[inline(always)]`: code that is not inlined is compiled for
    /// the baseline only. The same holds for closures passed on.
    fn run(self) -> Self::Output;
}

struct Inlined<W>(W);

impl<W: SimdKernel> pulp::WithSimd for Inlined<W> {
    type Output = W::Output;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> W::Output {
        self.0.run()
    }
}

/// Runs `kernel`, compiled for this processor.
#[inline(always)]
pub fn dispatch<W: SimdKernel>(kernel: W) -> W::Output {
    pulp::Arch::new().dispatch(Inlined(kernel))
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Products<'a>(&'a [f64]);

    impl SimdKernel for Products<'_> {
        type Output = Vec<f64>;

        #[inline(always)]
        fn run(self) -> Vec<f64> {
            self.0.iter().map(|x| x * x - (2. * x - 1.)).collect()
        }
    }

    #[test]
    fn products_and_sums_are_not_contracted() {
        // (1 + ε)² − (1 + 2ε) is ε² if fused (rounded once), and 0 if rounded twice.
        let x: Vec<f64> = (0..100).map(|i| 1. + f64::EPSILON * f64::from(i % 7 + 1)).collect();
        assert_eq!(dispatch(Products(&x)), [0.; 100]);
        assert_eq!(Products(&x).run(), [0.; 100]);
    }
}
