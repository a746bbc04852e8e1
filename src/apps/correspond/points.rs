//! Matches as points inside triangles, so that a coarse mesh B does not quantise them.
//!
//! Among the triangles around the matched vertex of B, the point that is nearest in the coordinates of the refined map:
//! in a plane through three points of k coordinates this is a system of two equations. 24 bytes per vertex on disk; a
//! few µs per vertex.

use super::matches::Match;
use crate::base::Result;
use crate::graph::VertexGraph;
use crate::store::npy::Item;
use crate::store::{Context, MappedSlice};
use bytemuck::{Pod, Zeroable};

/// Vertices per chunk.
const CHUNK: usize = 1 << 12;

/// A point on a mesh: Σ weight × corner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct SurfacePoint {
    /// Vertices of a triangle; −1 without a match.
    pub corners: [i32; 3],
    /// Their weights, non-negative with sum 1; 0 without a match.
    pub weights: [f32; 3],
}

impl Item for SurfacePoint {
    // Without blanks, so that the header has room for a length of nine digits.
    const DESCR: &'static str = "[('corners','<i4',(3,)),('weights','<f4',(3,))]";
}

impl SurfacePoint {
    /// No match.
    pub const NONE: Self = Self { corners: [-1; 3], weights: [0.; 3] };
}

/// The weights of `b` and `c` in the point of the triangle (a, b, c) nearest to `x`, and its squared distance.
///
/// ```
/// use nystrom_stream::apps::correspond::points::nearest_in_triangle;
/// let [a, b, c] = [[0., 0., 0., 0.], [1., 0., 0., 0.], [0., 1., 0., 0.]];
/// assert_eq!(nearest_in_triangle(&[0.25, 0.5, 2., 0.], &a, &b, &c), ([0.25, 0.5], 4.));
/// assert_eq!(nearest_in_triangle(&[2., -1., 0., 0.], &a, &b, &c), ([1., 0.], 2.));
/// ```
pub fn nearest_in_triangle(x: &[f32], a: &[f32], b: &[f32], c: &[f32]) -> ([f64; 2], f64) {
    let [mut bb, mut bc, mut cc, mut xb, mut xc, mut xx] = [0f64; 6];
    for (((x, a), b), c) in x.iter().zip(a).zip(b).zip(c) {
        let [x, b, c] = [x, b, c].map(|of| f64::from(*of) - f64::from(*a));
        bb += b * b;
        bc += b * c;
        cc += c * c;
        xb += x * b;
        xc += x * c;
        xx += x * x;
    }
    let square = |u: f64, v: f64| xx - 2. * (u * xb + v * xc) + u * u * bb + 2. * u * v * bc + v * v * cc;
    let along = |dot: f64, length: f64| if length > 0. { (dot / length).clamp(0., 1.) } else { 0. };
    // The edge from b to c: b + t (c − b).
    let (dot, length) = (xc - xb - bc + bb, bb - 2. * bc + cc);
    let t = along(dot, length);
    let mut tried = vec![[along(xb, bb), 0.], [0., along(xc, cc)], [1. - t, t]];
    let determinant = bb * cc - bc * bc;
    if determinant > 1e-12 * bb * cc {
        let (u, v) = ((cc * xb - bc * xc) / determinant, (bb * xc - bc * xb) / determinant);
        if u >= 0. && v >= 0. && u + v <= 1. {
            tried.push([u, v]);
        }
    }
    let mut best = ([0.; 2], f64::INFINITY);
    for [u, v] in tried {
        let there = square(u, v).max(0.);
        if there <= best.1 {
            best = ([u, v], there);
        }
    }
    best
}

/// The weights of the three corners, from those of the second and the third.
fn weights([u, w]: [f64; 2]) -> [f32; 3] {
    // On the edge between these two the remainder is 0 but for rounding, which may leave less.
    [(1. - u - w).max(0.), u, w].map(|share| share as f32)
}

/// For each of `matches` the nearest point in the triangles around it on `graph`, into the file `name`; `from` are the
/// vertices of A and `to` those of B, in the same coordinates.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn points<'a>(
    matches: &[Match],
    from: impl Fn(u32) -> &'a [f32] + Sync,
    to: impl Fn(u32) -> &'a [f32] + Sync,
    graph: &VertexGraph,
    name: &str,
    context: Context<'_>,
) -> Result<MappedSlice<SurfacePoint>> {
    let mut array = context.work.array::<SurfacePoint>(name, &[matches.len()])?;
    let point = |v: usize, _: SurfacePoint| {
        let Some(target) = matches[v].vertex() else { return SurfacePoint::NONE };
        let own = SurfacePoint { corners: [target as i32; 3], weights: [1., 0., 0.] };
        let span = 2 * graph.ring_starts[target as usize] as usize..2 * graph.ring_starts[target as usize + 1] as usize;
        let mut best = (own, f64::INFINITY);
        for pair in graph.ring[span].chunks_exact(2) {
            let ([u, w], square) = nearest_in_triangle(from(v as u32), to(target), to(pair[0]), to(pair[1]));
            if square < best.1 {
                let corners = [target, pair[0], pair[1]].map(|corner| corner as i32);
                best = (SurfacePoint { corners, weights: weights([u, w]) }, square);
            }
        }
        best.0
    };
    context.run.fill_each(array.data(), CHUNK, point)?;
    array.finish(false)
}

#[cfg(test)]
mod tests {
    use super::{nearest_in_triangle, weights};

    /// Regression: on the edge opposite the matched vertex its weight was −5.6e−17 at 20 of 6,890 points of a man.
    #[test]
    fn no_weight_is_negative() {
        for k in 0..=1000 {
            let x = [3. - 3. * (k as f32 / 1000.), k as f32 / 1000.];
            let (at, _) = nearest_in_triangle(&x, &[0., 0.], &[3., 0.], &[0., 1.]);
            let shares = weights(at);
            assert!(shares.iter().all(|&share| share >= 0.), "{shares:?}");
            assert!((shares.iter().sum::<f32>() - 1.).abs() < 1e-6, "{shares:?}");
        }
    }
}
