//! The little linear algebra that pictures need.

pub(super) use crate::base::vector::{cross, minus as sub};

/// A point or a direction.
pub(super) type Vec3 = [f64; 3];

/// a·b
#[inline]
pub(super) fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// a + s·b
#[inline]
pub(super) fn add_scaled(a: Vec3, s: f64, b: Vec3) -> Vec3 {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}

/// a in length 1; 0 where it has no length.
#[inline]
pub(super) fn unit(a: Vec3) -> Vec3 {
    let length = dot(a, a).sqrt();
    if length > 0.0 { a.map(|x| x / length) } else { [0.0; 3] }
}

/// Twice the area times the normal of a triangle.
#[inline]
pub(super) fn double_area(triangle: [Vec3; 3]) -> Vec3 {
    cross(sub(triangle[1], triangle[0]), sub(triangle[2], triangle[0]))
}
