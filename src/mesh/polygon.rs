//! Triangulates polygons without leaving them.
//!
//! A convex polygon becomes the fan of its first corner. The fan of a concave one may leave it: it would fill the notch
//! of an L, and its triangles have more area than the L. Then ears are clipped instead, in the plane of the polygon's
//! area vector (Newell's). All corners are used, so a closed surface stays closed. The ears of a star or a comb take
//! quadratic time, so a polygon of thousands of corners is first divided by diagonals. Cost: some 5 ns per corner of a
//! fan, 100 to 200 ns where ears are clipped.

use crate::base::vector::{add_scaled, cross, dot, length, minus, unit};
use earcut::Earcut;

/// Relative difference in area up to which a triangulation counts as free of folds.
const FOLDS: f64 = 1e-6;
/// Share of the area up to which flipped triangles count as those of collinear corners, rounded to floats.
const IN_LINE: f64 = 1e-6;
/// Number of corners above which a polygon is divided before its ears are clipped.
const LONG: usize = 1 << 10;
/// Number of corners from which a diagonal is sought.
const TRIES: usize = 64;
/// Maximum number of corners whose ears can be clipped: the crate's nodes have offsets of 32 bits.
const MOST: usize = 1 << 26;
/// A piece has at least one in this many of the corners of what is divided.
const LEAST: usize = 16;

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
    let flipped = |corners| (-dot(area(corners), normal)).max(0.);
    square.is_normal().then(|| fan(n, first).map(flipped).sum::<f64>() > IN_LINE * square)
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
    let normal = double_area_vector(at.iter().map(|&p| minus(p, at[0])));
    clipped_along(at, normal, clipper)
}

/// The same in the plane across `normal`, of any length.
pub(crate) fn clipped_along(at: &[[f64; 3]], normal: [f64; 3], clipper: &mut Earcut<f64>) -> Option<Vec<[u32; 3]>> {
    let spokes: Vec<[f64; 3]> = at.iter().map(|&p| minus(p, at[0])).collect();
    let norm = length(normal);
    let normal = normal.map(|x| x / norm);
    let size = dot(double_area_vector(spokes.iter().copied()), normal);
    if !(norm.is_normal() && size > 0. && size.is_normal()) {
        return None;
    }
    let plane = plane_across(normal);
    let flat: Vec<[f64; 2]> = spokes.iter().map(|&p| plane.map(|axis| dot(p, axis))).collect();
    // Where a polygon touches itself, a diagonal may lead to the wrong one of two corners: then it is not divided.
    let most = if at.len() > LONG { &[LONG, usize::MAX][..] } else { &[usize::MAX] };
    let mut found = most.iter().map(|&most| clip(&flat, most, clipper));
    let mut triangles = found.find(|triangles| covers(triangles, &flat, size))?;
    if triangles.iter().map(|t| double(t, &flat)).sum::<f64>() < 0. {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    Some(triangles)
}

/// Two axes of the plane across `normal`, of length 1.
pub(crate) fn plane_across(normal: [f64; 3]) -> [[f64; 3]; 2] {
    let least = (0..3).min_by(|&i, &j| normal[i].abs().total_cmp(&normal[j].abs())).unwrap_or(0);
    let mut axis = [0.; 3];
    axis[least] = 1.;
    let u = unit(cross(normal, axis));
    [u, cross(normal, u)]
}

/// Twice the signed area of a triangle of corners of `flat`.
fn double(triangle: &[u32; 3], flat: &[[f64; 2]]) -> f64 {
    let [a, b, c] = triangle.map(|k| flat[k as usize]);
    cross2(minus2(b, a), minus2(c, a))
}

/// Whether `triangles` use all corners `flat` of a polygon of twice the area `size`, and do not fold.
fn covers(triangles: &[[u32; 3]], flat: &[[f64; 2]], size: f64) -> bool {
    let sum = triangles.iter().map(|t| double(t, flat).abs()).sum::<f64>();
    triangles.len() + 2 == flat.len() && (sum - size).abs() <= FOLDS * size
}

/// The ears of the polygon `flat`; pieces of more than `most` corners are divided.
fn clip(flat: &[[f64; 2]], most: usize, clipper: &mut Earcut<f64>) -> Vec<[u32; 3]> {
    let mut pieces = vec![(0..flat.len() as u32).collect::<Vec<u32>>()];
    let (mut triangles, mut ears) = (Vec::new(), Vec::<u32>::new());
    while let Some(piece) = pieces.pop() {
        let own: Vec<[f64; 2]> = piece.iter().map(|&k| flat[k as usize]).collect();
        match (own.len() > most).then(|| diagonal(&own)).flatten() {
            Some([i, j]) => pieces.extend([[&piece[..=i], &piece[j..]].concat(), piece[i..=j].to_vec()]),
            None if own.len() > MOST => {}
            None => {
                clipper.earcut_slice(&own, &[], &mut ears);
                triangles.extend(ears.chunks_exact(3).map(|t| [t[0], t[1], t[2]].map(|k| piece[k as usize])));
            }
        }
    }
    triangles
}

/// A diagonal inside the polygon `at`, wound counterclockwise, that divides it into pieces of similar size: two
/// corners, the first one first. `None` if none is found, as where the polygon crosses itself.
fn diagonal(at: &[[f64; 2]]) -> Option<[usize; 2]> {
    let n = at.len();
    // Of so many successive corners the one that is deepest inside: little is seen from the tip of a tooth.
    let nearby = n / TRIES;
    let deepest = |start: usize| {
        let depth = |k: usize| cross2(minus2(at[start + nearby - 1], at[start]), minus2(at[k], at[start]));
        (start..start + nearby).max_by(|&j, &k| depth(j).total_cmp(&depth(k)))
    };
    let tries = (0..TRIES).filter_map(|k| deepest(k * nearby));
    let mut found = tries.filter_map(|i| seen_from(at, i).map(|j| [i.min(j), i.max(j)]));
    found.find(|[i, j]| (j - i).min(n - (j - i)) >= n / LEAST)
}

/// A corner that is seen from corner `i` of the polygon `at` through its inside. A ray along the bisector of `i` ends
/// at an edge. One of the edge's ends is seen, unless other corners are in front of it, in the triangle between it and
/// the ray: then the one nearest to the ray is.
fn seen_from(at: &[[f64; 2]], i: usize) -> Option<usize> {
    let n = at.len();
    let to = |k: usize| minus2(at[if i + k < n { i + k } else { i + k - n }], at[i]);
    let [next, last] = [to(1), to(n - 1)].map(|edge| edge.map(|x| x / dot2(edge, edge).sqrt()));
    // The sum of the normals of both edges.
    let way = [last[1] - next[1], next[0] - last[0]];
    let (mut length, mut edge) = (f64::INFINITY, None);
    let mut from = to(1);
    for k in 2..n {
        let end = to(k);
        if (cross2(way, from) > 0.) != (cross2(way, end) > 0.) {
            let along = minus2(end, from);
            let own = cross2(from, along) / cross2(way, along);
            if own > 0. && own < length {
                (length, edge) = (own, Some(k - 1));
            }
        }
        from = end;
    }
    let edge = edge?;
    let mut seen = if 2 * edge < n { edge + 1 } else { edge };
    let (hit, far) = (way.map(|x| x * length), to(seen));
    let side = cross2(way, far).signum();
    let mut best = far;
    for k in 1..n {
        let q = to(k);
        let inside = [cross2(hit, q), cross2(q, far), cross2(minus2(far, hit), minus2(q, hit))];
        let turn = side * cross2(q, best);
        let nearer = turn > 0. || turn == 0. && dot2(q, q) < dot2(best, best);
        if nearer && q != [0.; 2] && inside.iter().all(|x| side * x >= 0.) {
            (seen, best) = (k, q);
        }
    }
    (2..n - 1).contains(&seen).then(|| (i + seen) % n)
}

fn minus2(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

fn cross2(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn dot2(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
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

    /// Regression: the ears of a star of 100,000 corners took 1.3 s.
    #[test]
    fn long_polygons_are_divided_and_covered() {
        let turn = |k: usize, n: usize| (std::f64::consts::TAU * k as f64 / n as f64).sin_cos();
        let star = |k: usize| {
            let (sin, cos) = turn(k, 5000);
            [cos, sin].map(|x| if k.is_multiple_of(2) { x } else { 0.5 * x })
        };
        let comb = |k: usize| match k {
            4998 => [1., 0.],
            4999 => [0., 0.],
            _ => [k as f64 / 4998., if k.is_multiple_of(2) { 0.1 } else { 1. }],
        };
        // Three turns, out and back.
        let spiral = |k: usize| {
            let (step, wide) = if k < 2500 { (k, 1.) } else { (4999 - k, 0.) };
            let (sin, cos) = turn(step, 800);
            [cos, sin].map(|x| x * (2. + wide + step as f64 / 400.))
        };
        let polygons =
            [(0..5000).map(star).collect::<Vec<_>>(), (0..5000).map(comb).collect(), (0..5000).map(spiral).collect()];
        for mut flat in polygons {
            let ring = |flat: &[[f64; 2]]| (0..5000).map(|k| cross2(flat[k], flat[(k + 1) % 5000])).sum::<f64>();
            if ring(&flat) < 0. {
                flat.reverse();
            }
            assert!(diagonal(&flat).is_some());
            let at: Vec<[f64; 3]> = flat.iter().map(|&[x, y]| [x, y, 0.]).collect();
            let (mut sum, mut count, mut used) = (0., 0, vec![false; 5000]);
            triangles(&at, |corners| {
                let own = double_area(corners.map(|k| at[k]))[2];
                assert!(own >= -1e-12, "{corners:?}");
                (sum, count) = (sum + own, count + 1);
                corners.iter().for_each(|&k| used[k] = true);
            });
            assert!((sum - ring(&flat)).abs() < 1e-9 * sum && count == 4998 && used.iter().all(|&used| used));
        }
    }

    /// Regression: no single triangle of two million has a millionth of the area, however many are flipped.
    #[test]
    fn the_fan_of_millions_of_corners_folds_as_that_of_a_few() {
        for half in [50, 1_500_000] {
            // Two thirds of a ring, from the outer end.
            let at = |k: usize| {
                let (step, radius) = if k < half { (k, 2.) } else { (2 * half - 1 - k, 1.) };
                let (sin, cos) = (4. / 3. * std::f64::consts::PI * step as f64 / (half - 1) as f64).sin_cos();
                [radius * cos, radius * sin, 0.]
            };
            assert!(folds(2 * half, &at, 0));
        }
        let disc = |k: usize| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / 1e6).sin_cos();
            [f64::from(cos as f32), f64::from(sin as f32), 0.]
        };
        assert!(!folds(1_000_000, &disc, 0));
    }

    /// A frame whose hole is joined to its rim by a slit: two edges at the same place.
    #[test]
    fn long_polygons_that_touch_themselves_are_covered() {
        let circle = |k: usize, n: usize, radius: f64| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / n as f64).sin_cos();
            [radius * cos, radius * sin, 0.]
        };
        let (rim, hole) = ((0..=1000).map(|k| circle(k, 1000, 2.)), (0..=1000).rev().map(|k| circle(k, 1000, 1.)));
        let at: Vec<[f64; 3]> = rim.chain(hole).collect();
        let mut sum = 0.;
        triangles(&at, |corners| sum += area(corners.map(|k| at[k])));
        let expected = 0.5 * 1000. * (std::f64::consts::TAU / 1000.).sin() * 3.;
        assert!((sum - expected).abs() < 1e-6, "{sum} {expected}");
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
