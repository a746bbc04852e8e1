//! Triangulates polygons without leaving them.
//!
//! A convex polygon becomes the fan of its first corner. The fan of a concave one may leave it: it would fill the notch
//! of an L, and its triangles have more area than the L. Then ears are clipped instead, in the plane of the polygon's
//! area vector (Newell's). All corners are used, so a closed surface stays closed. Cost: some 5 ns per corner of a fan,
//! 100 ns where ears are clipped.

use crate::base::vector::{add_scaled, cross, dot, length, minus, unit};
use earcut::Earcut;

/// Relative difference in area up to which a triangulation counts as free of folds.
const FOLDS: f64 = 1e-6;
/// Share of the area up to which a flipped triangle counts as one of collinear corners, rounded to floats.
const IN_LINE: f64 = 1e-6;

/// Calls `visit` with the triangles of a polygon with corners `at`, as corner indices, wound like the polygon: two
/// fewer than corners. It is the fan of the first corner unless that folds, and also where nothing better is found.
#[inline]
pub fn triangles(at: &[[f64; 3]], visit: impl FnMut([usize; 3])) {
    triangles_of(at.len(), |k| at[k], visit);
}

/// The same for `n` corners that are read through `at`: there may be millions.
#[inline]
pub(super) fn triangles_of(n: usize, at: impl Fn(usize) -> [f64; 3], mut visit: impl FnMut([usize; 3])) {
    let ears = || clipped(&(0..n).map(&at).collect::<Vec<_>>(), &mut Earcut::new());
    // One of the two fans of a simple quad does not fold.
    let first = match n {
        0..=2 => return,
        3 => 0,
        _ if !folds(n, &at, 0) => 0,
        4 => usize::from(!folds(4, &at, 1)),
        _ => match ears() {
            Some(ears) => return ears.into_iter().for_each(|ear| visit(ear.map(|corner| corner as usize))),
            None => 0,
        },
    };
    fan(n, first).for_each(visit);
}

/// The fan of corner `first` of `n`.
#[inline]
fn fan(n: usize, first: usize) -> impl Iterator<Item = [usize; 3]> {
    let corner = move |k: usize| if first + k < n { first + k } else { first + k - n };
    (1..n - 1).map(move |k| [first, corner(k), corner(k + 1)])
}

/// Whether the fan of corner `first` has flipped triangles. False if a corner is not finite.
#[inline]
fn folds(n: usize, at: &impl Fn(usize) -> [f64; 3], first: usize) -> bool {
    turned(n, at, first, 1.).unwrap_or_else(|| {
        // The squares overflow or underflow: rescale.
        let spokes = (0..n).flat_map(|k| minus(at(k), at(first)));
        let size = spokes.fold(0., |size: f64, x| size.max(x.abs()));
        turned(n, at, first, 1. / size).unwrap_or(false)
    })
}

/// The same for the polygon scaled by `scale`; `None` if the square of its area is not representable.
#[inline]
fn turned(n: usize, at: &impl Fn(usize) -> [f64; 3], first: usize, scale: f64) -> Option<bool> {
    let origin = at(first);
    let spoke = |k: usize| minus(at(k), origin).map(|x| x * scale);
    let area = |[_, b, c]: [usize; 3]| cross(spoke(b), spoke(c));
    let mut normal = [0.; 3];
    for own in fan(n, first).map(area) {
        (0..3).for_each(|k| normal[k] += own[k]);
    }
    let square = dot(normal, normal);
    square.is_normal().then(|| fan(n, first).any(|corners| dot(area(corners), normal) < -IN_LINE * square))
}

/// Twice the area vector of a polygon (Newell's), given its corners relative to the first.
pub(crate) fn double_area_vector(spokes: impl IntoIterator<Item = [f64; 3]>) -> [f64; 3] {
    let (mut sum, mut before) = ([0.; 3], [0.; 3]);
    for spoke in spokes {
        sum = add_scaled(sum, 1., cross(before, spoke));
        before = spoke;
    }
    sum
}

/// The ear-clipping triangles of a loop with corners `at`, in the plane of its area vector, wound like the loop; `None`
/// unless they use all corners and do not fold.
pub(crate) fn clipped(at: &[[f64; 3]], clipper: &mut Earcut<f64>) -> Option<Vec<[u32; 3]>> {
    let spokes: Vec<[f64; 3]> = at.iter().map(|&p| minus(p, at[0])).collect();
    let normal = double_area_vector(spokes.iter().copied());
    let size = length(normal);
    if !size.is_normal() {
        return None;
    }
    let normal = normal.map(|x| x / size);
    let least = (0..3).min_by(|&i, &j| normal[i].abs().total_cmp(&normal[j].abs())).unwrap_or(0);
    let mut axis = [0.; 3];
    axis[least] = 1.;
    let u = unit(cross(normal, axis));
    let v = cross(normal, u);
    let flat: Vec<[f64; 2]> = spokes.iter().map(|&p| [dot(p, u), dot(p, v)]).collect();
    let mut corners: Vec<u32> = Vec::new();
    clipper.earcut_slice(&flat, &[], &mut corners);
    let mut triangles: Vec<[u32; 3]> = corners.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    let double = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|k| flat[k as usize]);
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let sum = triangles.iter().map(|t| double(t).abs()).sum::<f64>();
    if triangles.len() + 2 != at.len() || (sum - size).abs() > FOLDS * size {
        return None;
    }
    if triangles.iter().map(double).sum::<f64>() < 0. {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    Some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::vector::{area, double_area};

    #[test]
    fn triangles_cover_a_polygon_and_nothing_else() {
        // Regression: from most of its corners, the fan of an L had nearly twice its area.
        let ell = [[0., 0.], [1.5, 0.], [3., 0.], [3., 1.], [1., 1.], [1., 3.], [0., 3.]];
        let dart = [[0., 0.], [2., 1.], [0., 2.], [0.5, 1.]];
        let square = [[0., 0.], [0.5, 0.], [1., 0.], [1., 1.], [0., 1.]];
        for (corners, whole) in [(&ell[..], 5.), (&dart, 1.5), (&square, 1.)] {
            for (first, scale) in (0..corners.len()).flat_map(|first| [1., 1e-3, 1e60].map(|scale| (first, scale))) {
                let n = corners.len();
                let corner = |k: usize| corners[(first + k) % n].map(|x| x * scale);
                let at: Vec<[f64; 3]> = (0..n).map(|k| [corner(k)[0], 0.5 * corner(k)[0], corner(k)[1]]).collect();
                let (mut sum, mut count, mut used) = (0., 0, vec![false; n]);
                triangles(&at, |corners| {
                    let own = corners.map(|k| at[k]);
                    assert!(double_area(own)[2] >= -1e-9 * scale * scale, "{first} {corners:?}");
                    (sum, count) = (sum + area(own), count + 1);
                    corners.iter().for_each(|&k| used[k] = true);
                });
                let expected = 1.25f64.sqrt() * whole;
                assert!((sum / (scale * scale) - expected).abs() < 1e-9, "{first} {scale}: {sum}");
                assert!(count == n - 2 && used.iter().all(|&used| used));
            }
        }
    }

    #[test]
    fn odd_polygons_are_fans() {
        let bow = [[0., 0., 0.], [1., 1., 0.], [1., 0., 0.], [0., 1., 0.]];
        let nowhere = [[0., 0., 0.], [1., 0., 0.], [f64::NAN, 0., 0.], [1., 1., 0.], [0., 1., 0.]];
        for at in [&bow[..], &nowhere, &[[1.; 3]; 6], &[[1e300, -1e300, 0.]; 4], &bow[..2], &[]] {
            let mut found = Vec::new();
            triangles(at, |corners| found.push(corners));
            assert_eq!(found, (1..at.len().max(2) - 1).map(|k| [0, k, k + 1]).collect::<Vec<_>>());
        }
    }
}
