//! Points and directions as plain arrays. These are inner loops, so all of it is inlined.

use std::ops::{Add, AddAssign, Mul, Sub};

/// What [`array::map`] does, always inlined: the standard library's makes a call per element where it is compiled apart
/// from its caller.
pub trait MapEach<T, const N: usize> {
    /// `f` of every element.
    fn map_each<U: Copy + Default>(self, f: impl FnMut(T) -> U) -> [U; N];
}

impl<T: Copy, const N: usize> MapEach<T, N> for [T; N] {
    #[inline(always)]
    fn map_each<U: Copy + Default>(self, mut f: impl FnMut(T) -> U) -> [U; N] {
        let mut out = [U::default(); N];
        for k in 0..N {
            out[k] = f(self[k]);
        }
        out
    }
}

/// a − b.
#[inline(always)]
pub fn minus<T: Copy + Sub<Output = T>>(a: [T; 3], b: [T; 3]) -> [T; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// (a + b) / 2, the same for (b, a) to the bit.
#[inline(always)]
pub fn middle(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [(a[0] + b[0]) * 0.5, (a[1] + b[1]) * 0.5, (a[2] + b[2]) * 0.5]
}

/// a × b.
#[inline(always)]
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// a · b.
#[inline(always)]
pub fn dot<T: Copy + Add<Output = T> + Mul<Output = T>>(a: [T; 3], b: [T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// a + s b.
#[inline(always)]
pub fn add_scaled(a: [f64; 3], s: f64, b: [f64; 3]) -> [f64; 3] {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}

/// a normalised to length 1; 0 where it has no length.
#[inline(always)]
pub fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = length(a);
    if length > 0. { [a[0] / length, a[1] / length, a[2] / length] } else { [0.; 3] }
}

/// Twice the area of a triangle times its normal.
#[inline(always)]
pub fn double_area([a, b, c]: [[f64; 3]; 3]) -> [f64; 3] {
    cross(minus(b, a), minus(c, a))
}

/// The area of a triangle. Correct even where its square overflows or underflows, as long as the area itself does not.
#[inline(always)]
pub fn area(triangle: [[f64; 3]; 3]) -> f64 {
    let double = double_area(triangle);
    let plain = length(double);
    (if plain.is_normal() { plain } else { scaled_length(double) }) / 2.
}

/// How far `p` is from a triangle.
pub fn triangle_distance([a, b, c]: [[f64; 3]; 3], p: [f64; 3]) -> f64 {
    let to_edge = |from: [f64; 3], to: [f64; 3]| {
        let (along, out) = (minus(to, from), minus(p, from));
        let size = dot(along, along);
        let t = if size > 0. { (dot(along, out) / size).clamp(0., 1.) } else { 0. };
        length(add_scaled(out, -t, along))
    };
    // If the foot of the perpendicular lies inside, the distance is the height above the plane.
    let (normal, out) = (double_area([a, b, c]), minus(p, a));
    let square = dot(normal, normal);
    let (s, t) = (dot(cross(out, minus(c, a)), normal), dot(cross(minus(b, a), out), normal));
    if square > 0. && s >= 0. && t >= 0. && s + t <= square {
        return dot(out, normal).abs() / square.sqrt();
    }
    to_edge(a, b).min(to_edge(b, c)).min(to_edge(c, a))
}

/// |a| without squaring the coordinates, so that it cannot overflow.
#[cold]
fn scaled_length(a: [f64; 3]) -> f64 {
    let most = a[0].abs().max(a[1].abs()).max(a[2].abs());
    if most > 0. && most.is_finite() { most * length([a[0] / most, a[1] / most, a[2] / most]) } else { most }
}

/// |a|.
#[inline(always)]
pub fn length(a: [f64; 3]) -> f64 {
    (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt()
}

/// |a − b|, the same for (b, a) to the bit.
#[inline(always)]
pub fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    length(minus(a, b))
}

/// In double precision.
#[inline(always)]
pub fn wide(a: [f32; 3]) -> [f64; 3] {
    [f64::from(a[0]), f64::from(a[1]), f64::from(a[2])]
}

/// `factor` · a, in single precision.
#[inline(always)]
pub fn narrow(a: [f64; 3], factor: f64) -> [f32; 3] {
    [(a[0] * factor) as f32, (a[1] * factor) as f32, (a[2] * factor) as f32]
}

/// Bits that are equal for two positions exactly where their coordinates are equal: −0 counts as 0.
#[inline(always)]
pub fn position_key(a: [f64; 3]) -> [u64; 3] {
    [(a[0] + 0.).to_bits(), (a[1] + 0.).to_bits(), (a[2] + 0.).to_bits()]
}

/// Whether all coordinates are 0.
#[inline(always)]
pub fn is_zero<T: Copy + Default + PartialEq>(a: [T; 3]) -> bool {
    a[0] == T::default() && a[1] == T::default() && a[2] == T::default()
}

/// Whether all coordinates are finite.
#[inline(always)]
pub fn finite(a: [f64; 3]) -> bool {
    a[0].is_finite() && a[1].is_finite() && a[2].is_finite()
}

/// y += a x, as in BLAS; `x` is at least as long as `y`.
#[inline(always)]
pub fn axpy<T: Copy + AddAssign + Mul<Output = T>>(y: &mut [T], a: T, x: &[T]) {
    let x = &x[..y.len()];
    for i in 0..y.len() {
        y[i] += a * x[i];
    }
}

/// Parallel sums of an [`inner_product`].
const LANES: usize = 8;

/// a · b of vectors of equal length, accumulated in parallel sums that are added up at the end: the same bits on all
/// processors.
#[inline(always)]
pub fn inner_product(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.; LANES];
    let ((xs, x_rest), (ys, y_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for k in 0..xs.len() {
        add_products(&mut lanes, &xs[k], &ys[k]);
    }
    let mut rest = 0.;
    for k in 0..x_rest.len() {
        rest += x_rest[k] * y_rest[k];
    }
    lanes.iter().sum::<f64>() + rest
}

#[inline(always)]
fn add_products(sums: &mut [f64; LANES], x: &[f64; LANES], y: &[f64; LANES]) {
    for k in 0..LANES {
        sums[k] += x[k] * y[k];
    }
}

/// |a − b|² of high-dimensional points, accumulated in `LANES` parallel sums that are added up at the end.
#[inline(always)]
pub fn square_apart<const LANES: usize>(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut rest = 0.;
    for k in 0..a_rest.len() {
        rest += (a_rest[k] - b_rest[k]) * (a_rest[k] - b_rest[k]);
    }
    let (b, mut sums) = (&b[..a.len()], [0f32; LANES]);
    for k in 0..a.len() {
        for lane in 0..LANES {
            sums[lane] += (a[k][lane] - b[k][lane]) * (a[k][lane] - b[k][lane]);
        }
    }
    sums.iter().sum::<f32>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_is_as_far_as_its_nearest_point() {
        let triangle = [[0., 0., 1.], [4., 0., 1.], [0., 4., 1.]];
        let cases = [
            ([1., 1., 1.], 0.),
            ([1., 1., -2.], 3.),
            ([2., -3., 1.], 3.),
            ([4., 4., 1.], 8f64.sqrt()),
            ([-3., -4., 1.], 5.),
            ([7., 0., 5.], 5.),
        ];
        for (p, expected) in cases {
            let [a, b, c] = triangle;
            for turned in [[a, b, c], [b, c, a], [c, b, a]] {
                assert!((triangle_distance(turned, p) - expected).abs() < 1e-12, "{p:?}");
            }
        }
        // Without an area: an edge, a point.
        assert_eq!(triangle_distance([[0.; 3], [2., 0., 0.], [1., 0., 0.]], [1.5, 2., 0.]), 2.);
        assert_eq!(triangle_distance([[0.; 3]; 3], [0., 3., 4.]), 5.);
    }
}
