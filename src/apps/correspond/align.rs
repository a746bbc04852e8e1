//! Aligns two embeddings without any known match.
//!
//! Initial guesses ([`candidates`]) are ranked by how close they bring [`COARSE`] points of one mesh to those of the
//! other; the best [`KEPT`] are refined by alternating nearest points and the orthogonal matrix that fits these best
//! (Procrustes), ranked again, tested for being mirror images ([`super::orientation`]) and refined on [`FINE`] points.
//! Closeness of points does not always distinguish head from tail: all of a head may lie near a tail. So the remaining
//! maps are ranked by the product of three terms: that distance; the least cost of transporting equal shares of area
//! onto each other one to one (the Wasserstein distance of two area distributions, so that a large part cannot be
//! matched to a small one); and their distortion, the difference between the distance on A from a landmark of A to the
//! image of one of B, and the distance on B from the image of the first to the second. A map that fits about as well,
//! but maps the shape differently, is an alternative: a symmetry that no measurement along the surface resolves.
//!
//! Points represent equal shares of area, so that vertex densities do not matter. Cost: constant, at most about a
//! second on one thread.

use super::orientation::Tensor;
use super::search::square;
use crate::apps::assignment::least_assignment;
use crate::base::Result;
use crate::base::random::{stream, unit};
use crate::base::sort::sort_by;
use crate::distance::DistanceRows;
use crate::graph::Node;
use crate::spectral::nystrom::Point;
use crate::store::Run;
use nalgebra::DMatrix;
use serde::Serialize;

/// Number of points for ranking guesses.
pub const COARSE: usize = 120;
/// Number of points for the last refinement.
pub const FINE: usize = 1000;
/// Number of guesses that are refined; of the distinct ones that fit then, [`LAST`] are refined finely.
pub const KEPT: usize = 40;
/// Number of points, representing equal shares of area, for the transport cost.
const TRANSPORTED: usize = 400;
/// Number of maps that are refined on [`FINE`] points.
const LAST: usize = 8;
/// Iterations of a refinement.
const STEPS: usize = 8;
/// Ratio of costs up to which the guess with the better orientation wins.
const TOLERATED: f64 = 3.;
/// Another map is an alternative if its distortion or cost is at most this many times the best.
pub const RIVAL: f64 = 1.15;
/// Mean squared distance between two maps, relative to the variance, above which they are different.
const APART: f64 = 0.1;
/// Minimum magnitude of the agreement of orientations, from −1 to 1, that tells a map from a mirror image.
pub const CONCLUSIVE_ORIENTATION: f64 = 0.5;

/// An embedded mesh, as used by alignment. If the two have different numbers of coordinates, only the common ones are
/// used.
#[derive(Clone, Copy, Debug)]
pub struct Shape<'a> {
    /// Embedded vertices (n).
    pub points: &'a [Point],
    /// Areas of vertices (n).
    pub nodes: &'a [Node],
    /// Variance of each coordinate (k).
    pub variance: &'a [f64],
    /// The orientation tensor of the embedded mesh.
    pub tensor: &'a Tensor,
    /// Distances from its landmarks, in units of √area after multiplication by `unit`; without them maps are ranked by
    /// cost.
    pub rows: Option<&'a DistanceRows>,
    /// 1/√area.
    pub unit: f64,
}

/// A change of coordinates from one embedding to the other.
#[derive(Clone, Debug, Serialize)]
pub struct Alignment {
    /// Orthogonal, k × k: e_B ≈ transform · e_A.
    #[serde(skip)]
    pub transform: DMatrix<f64>,
    /// Mean squared distance from points to the nearest of the other mesh, in both directions, relative to the
    /// variance.
    pub cost: f64,
    /// Mean squared distance when equal shares of area are transported one to one ([`least_assignment`]), relative to
    /// the variance.
    pub transport: Option<f64>,
    /// Mean difference between distances of landmarks on either mesh, over √area.
    pub distortion: Option<f64>,
    /// Agreement of orientation: near 1 correct, near −1 mirrored, in between inconclusive.
    pub orientation: f64,
}

/// The result of aligning.
#[derive(Clone, Debug, Serialize)]
pub struct Alignments {
    /// Best first; several only if others are about as good.
    pub found: Vec<Alignment>,
    /// All distinct ones, best first: possible starts of a refinement.
    #[serde(skip)]
    pub starts: Vec<Alignment>,
    /// Whether there is more than one, or the orientation could not be determined.
    pub ambiguous: bool,
}

impl Alignment {
    /// The ranking criterion of maps, least first.
    fn rank(&self) -> f64 {
        self.cost * self.transport.unwrap_or(1.) * self.distortion.unwrap_or(1.)
    }

    /// Whether this map is a plausible alternative to the best: hardly more distorted, or hardly more costly.
    fn rivals(&self, best: &Self) -> bool {
        let distorts = self.distortion.zip(best.distortion).is_some_and(|(mine, least)| mine <= RIVAL * least);
        distorts || self.cost <= RIVAL * best.cost
    }

    /// Transforms a point of A to the coordinates of B.
    #[inline]
    pub fn apply(&self, point: &Point) -> Point {
        apply(&self.transform, point)
    }
}

/// `transform` times `point`.
pub fn apply(transform: &DMatrix<f64>, point: &Point) -> Point {
    let k = transform.nrows();
    std::array::from_fn(|i| {
        if i < k { (0..k).map(|j| transform[(i, j)] * f64::from(point[j])).sum::<f64>() as f32 } else { 0. }
    })
}

/// `count` vertices that represent equal shares of area, in ascending order; one that represents several shares appears
/// several times.
pub fn shares(nodes: &[Node], count: usize, seed: u64, purpose: &str) -> Vec<u32> {
    let total: f64 = nodes.iter().map(|node| f64::from(node.area)).sum();
    if total <= 0. {
        return (0..count).map(|k| (k * nodes.len() / count) as u32).collect();
    }
    let mut draw = stream(seed, purpose);
    let mut chosen = Vec::with_capacity(count);
    let mut sum = 0f64;
    let mut target = unit(&mut draw) * total / count as f64;
    for (v, node) in nodes.iter().enumerate() {
        sum += f64::from(node.area);
        while chosen.len() < count && target < sum {
            chosen.push(v as u32);
            target = (chosen.len() as f64 + unit(&mut draw)) * total / count as f64;
        }
    }
    chosen.resize(count, nodes.len().saturating_sub(1) as u32);
    chosen
}

/// The same without repetitions.
pub fn sample(nodes: &[Node], count: usize, seed: u64, purpose: &str) -> Vec<u32> {
    let mut chosen = shares(nodes, count, seed, purpose);
    chosen.dedup();
    chosen
}

/// The orthogonal matrix that maps `from` closest to `to`, by the singular value decomposition of Σ to fromᵀ.
///
/// ```
/// use nystrom_stream::apps::correspond::align::{apply, procrustes};
/// // A quarter turn of the first two axes.
/// let points = [[1., 0., 0., 0., 0., 0., 0., 0.], [0., 2., 0., 0., 0., 0., 0., 0.]];
/// let turned = [[0., 1., 0., 0., 0., 0., 0., 0.], [-2., 0., 0., 0., 0., 0., 0., 0.]];
/// let turn = procrustes(points.into_iter().zip(turned), 2);
/// assert!((apply(&turn, &points[0])[1] - 1.).abs() < 1e-6);
/// ```
pub fn procrustes(pairs: impl Iterator<Item = (Point, Point)>, k: usize) -> DMatrix<f64> {
    let mut sum = DMatrix::<f64>::zeros(k, k);
    for (from, to) in pairs {
        for i in 0..k {
            for j in 0..k {
                sum[(i, j)] += f64::from(to[i]) * f64::from(from[j]);
            }
        }
    }
    let svd = nalgebra::SVD::new(sum, true, true);
    match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => u * v_t,
        _ => DMatrix::identity(k, k),
    }
}

/// The nearest of `among` to `point`: its index and the squared distance.
fn nearest(point: &Point, among: &[Point]) -> (usize, f32) {
    let mut best = (0, f32::INFINITY);
    for (k, other) in among.iter().enumerate() {
        let there = square(point, other);
        if there < best.1 {
            best = (k, there);
        }
    }
    best
}

/// Mean squared distance to the nearest point, in one direction.
fn one_way(from: &[Point], to: &[Point]) -> f64 {
    from.iter().map(|point| f64::from(nearest(point, to).1)).sum::<f64>() / from.len().max(1) as f64
}

/// Alternates nearest points, in both directions, and the best orthogonal matrix.
fn refine(mut transform: DMatrix<f64>, a: &[Point], b: &[Point]) -> DMatrix<f64> {
    let k = transform.nrows();
    for _ in 0..STEPS {
        let moved: Vec<Point> = a.iter().map(|point| apply(&transform, point)).collect();
        let there = moved.iter().zip(a).map(|(moved, point)| (*point, b[nearest(moved, b).0]));
        let back = b.iter().map(|point| (a[nearest(point, &moved).0], *point));
        let next = procrustes(there.chain(back), k);
        if (&next - &transform).norm() < 1e-9 {
            return next;
        }
        transform = next;
    }
    transform
}

fn two_way(transform: &DMatrix<f64>, a: &[Point], b: &[Point]) -> f64 {
    let moved: Vec<Point> = a.iter().map(|point| apply(transform, point)).collect();
    one_way(&moved, b) + one_way(b, &moved)
}

/// Aligns the embedding of `a` with that of `b`.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn align(a: Shape<'_>, b: Shape<'_>, run: &Run) -> Result<Alignments> {
    let dimensions = a.variance.len().min(b.variance.len());
    let first = |point: &Point| -> Point { std::array::from_fn(|i| if i < dimensions { point[i] } else { 0. }) };
    let embedded = |shape: Shape<'_>, chosen: &[u32]| -> Vec<Point> {
        chosen.iter().map(|&v| first(&shape.points[v as usize])).collect()
    };
    let coarse_points = |shape: Shape<'_>| embedded(shape, &sample(shape.nodes, COARSE, run.seed, "coarse points"));
    let (tensor_a, tensor_b) = (a.tensor.of_first(dimensions), b.tensor.of_first(dimensions));
    let (coarse_a, coarse_b) = (coarse_points(a), coarse_points(b));
    let spread: f64 = (1..dimensions).map(|i| a.variance[i] + b.variance[i]).sum();
    let unit = 1. / spread.max(1e-300);
    let measure = |transform: DMatrix<f64>, a_points: &[Point], b_points: &[Point]| Alignment {
        cost: unit * two_way(&transform, a_points, b_points),
        transport: None,
        distortion: None,
        orientation: tensor_a.turned(&transform).agreement(&tensor_b),
        transform,
    };
    let guesses = candidates(a.variance, b.variance);
    let rank = |k: usize, (): &mut ()| Ok((two_way(&guesses[k], &coarse_a, &coarse_b), k));
    let mut ranks = run.map_chunks(guesses.len(), || (), rank)?;
    sort_by(&mut ranks, |x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
    ranks.truncate(KEPT);
    let coarse = |k: usize, (): &mut ()| {
        let transform = refine(guesses[ranks[k].1].clone(), &coarse_a, &coarse_b);
        Ok(measure(transform, &coarse_a, &coarse_b))
    };
    let refined = run.map_chunks(ranks.len(), || (), coarse)?;
    let mut refined = plausible(refined);
    sort_by(&mut refined, |x, y| x.cost.total_cmp(&y.cost));
    let refined = different(refined, &coarse_a, 0.1 * APART * spread);
    let [chosen_a, chosen_b] = [a, b].map(|shape| sample(shape.nodes, FINE, run.seed, "fine points"));
    let (fine_a, fine_b) = (embedded(a, &chosen_a), embedded(b, &chosen_b));
    let [equal_a, equal_b] =
        [a, b].map(|shape| embedded(shape, &shares(shape.nodes, TRANSPORTED, run.seed, "equal shares")));
    let landmarks =
        a.rows.zip(b.rows).map(|rows| (rows, embedded(a, &rows.0.landmarks), embedded(b, &rows.1.landmarks)));
    let fine = |k: usize, (): &mut ()| {
        let transform = refine(refined[k].transform.clone(), &fine_a, &fine_b);
        let distortion = landmarks.as_ref().map(|((rows_a, rows_b), in_a, in_b)| {
            // The images of landmarks of either mesh on the other.
            let back = transform.transpose();
            let to_b: Vec<u32> = in_a.iter().map(|p| chosen_b[nearest(&apply(&transform, p), &fine_b).0]).collect();
            let to_a: Vec<u32> = in_b.iter().map(|p| chosen_a[nearest(&apply(&back, p), &fine_a).0]).collect();
            let mut sum = 0f64;
            for (i, &image_b) in to_b.iter().enumerate() {
                for (j, &image_a) in to_a.iter().enumerate() {
                    let (d_a, d_b) = (rows_a.row(i)[image_a as usize], rows_b.row(j)[image_b as usize]);
                    sum += (a.unit * f64::from(d_a) - b.unit * f64::from(d_b)).abs();
                }
            }
            sum / (to_a.len() * to_b.len()).max(1) as f64
        });
        let moved: Vec<Point> = equal_a.iter().map(|point| apply(&transform, point)).collect();
        let cost = |i: usize, k: usize| f64::from(square(&moved[i], &equal_b[k]));
        let transported = least_assignment(TRANSPORTED, TRANSPORTED, cost).map_or(f64::INFINITY, |holders| {
            holders.iter().enumerate().filter_map(|(k, holder)| holder.map(|i| cost(i, k))).sum()
        });
        let transport = Some(unit * transported / TRANSPORTED as f64);
        Ok(Alignment { transport, distortion, ..measure(transform, &fine_a, &fine_b) })
    };
    let mut refined = run.map_chunks(refined.len(), || (), fine)?;
    sort_by(&mut refined, |x, y| x.rank().total_cmp(&y.rank()));
    Ok(rival_alignments(refined, &fine_a, APART * spread))
}

/// The maps that fit well and are not mirrored, if that can be decided.
fn plausible(mut all: Vec<Alignment>) -> Vec<Alignment> {
    let least = all.iter().map(|one| one.cost).fold(f64::INFINITY, f64::min);
    all.retain(|one| one.cost <= TOLERATED * least);
    let best = all.iter().map(|one| one.orientation).fold(f64::NEG_INFINITY, f64::max);
    all.retain(|one| one.orientation >= best.min(0.5 * best));
    all
}

/// The maps that differ from all earlier ones: by more than `apart`, in the mean squared distance.
fn different(sorted: Vec<Alignment>, points: &[Point], apart: f64) -> Vec<Alignment> {
    let mut found: Vec<Alignment> = Vec::new();
    for one in sorted {
        let elsewhere = |other: &Alignment| {
            let squares = points.iter().map(|p| f64::from(square(&one.apply(p), &other.apply(p))));
            2. * squares.sum::<f64>() / points.len().max(1) as f64 > apart
        };
        if found.len() < LAST && found.iter().all(elsewhere) {
            found.push(one);
        }
    }
    found
}

/// The first, and those of the others that map the shape differently at about the same cost.
fn rival_alignments(mut sorted: Vec<Alignment>, points: &[Point], apart: f64) -> Alignments {
    let starts = different(sorted.clone(), points, 0.1 * apart);
    if let Some(best) = sorted.first().cloned() {
        sorted.retain(|one| one.rivals(&best));
    }
    let found = different(sorted, points, apart);
    let is_conclusive = found.first().is_some_and(|best| best.orientation >= CONCLUSIVE_ORIENTATION);
    Alignments { ambiguous: found.len() > 1 || !is_conclusive, found, starts }
}

// Initial guesses of the change of coordinates between two embeddings: signs, order, and rotations of axes with similar
// eigenvalues.
//
// An eigenvector is determined up to its sign, and two whose eigenvalues are nearly equal up to a rotation in their
// plane, so that on another mesh they come in another order or mixed. The guesses combine all signs of all axes but the
// first with rotations by 0°, ±45° and 90° of disjoint neighbouring pairs whose variances are within [`NEAR`] of each
// other. Some 2^(k−1) to [`MOST_TURNS`] 2^(k−1) matrices.

/// Minimum ratio of the variances of axes that may be rotated into each other.
pub const NEAR: f64 = 0.7;
/// Maximum number of rotations tried; the likeliest pairs come first.
pub const MOST_TURNS: usize = 32;

/// Guesses for axes of these variances on either mesh (k each).
pub fn candidates(a: &[f64], b: &[f64]) -> Vec<DMatrix<f64>> {
    let k = a.len().min(b.len());
    let ratio = |v: &[f64], i: usize| if v[i] > 0. { v[i + 1] / v[i] } else { 0. };
    let mut pairs: Vec<(usize, f64)> = (1..k.saturating_sub(1))
        .map(|i| (i, ratio(a, i).max(ratio(b, i))))
        .filter(|(_, ratio)| *ratio > NEAR)
        .collect();
    sort_by(&mut pairs, |x, y| y.1.total_cmp(&x.1).then(x.0.cmp(&y.0)));
    let mut turns = vec![(DMatrix::<f64>::identity(k, k), vec![false; k])];
    for (i, _) in pairs {
        let known = turns.len();
        for t in 0..known {
            if turns[t].1[i] || turns[t].1[i + 1] || turns.len() + 3 > MOST_TURNS {
                continue;
            }
            for degrees in [90f64, 45., -45.] {
                let (sin, cos) = libm::sincos(degrees.to_radians());
                let mut turn = DMatrix::identity(k, k);
                turn[(i, i)] = cos;
                turn[(i + 1, i + 1)] = cos;
                turn[(i, i + 1)] = -sin;
                turn[(i + 1, i)] = sin;
                let mut used = turns[t].1.clone();
                (used[i], used[i + 1]) = (true, true);
                turns.push((turn * &turns[t].0, used));
            }
        }
    }
    let mut all = Vec::with_capacity(turns.len() << k.saturating_sub(1));
    for (turn, _) in turns {
        for signs in 0..1usize << k.saturating_sub(1) {
            let mut guess = turn.clone();
            for i in (1..k).filter(|i| signs >> (i - 1) & 1 == 1) {
                guess.column_mut(i).neg_mut();
            }
            all.push(guess);
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn guesses_are_orthogonal_and_cover_signs_swaps_and_turns() {
        let apart = candidates(&[9., 4., 2., 1.], &[9., 4., 2., 1.]);
        assert_eq!(apart.len(), 8);
        let near = candidates(&[9., 4., 3.9, 1.], &[9., 4., 2., 1.]);
        assert_eq!(near.len(), 32);
        for guess in apart.iter().chain(&near) {
            assert!((guess * guess.transpose() - DMatrix::identity(4, 4)).norm() < 1e-12);
            assert_eq!(guess[(0, 0)], 1.);
        }
        let swap = DMatrix::from_row_slice(4, 4, &[1., 0., 0., 0., 0., 0., 1., 0., 0., 1., 0., 0., 0., 0., 0., 1.]);
        assert!(near.iter().any(|guess| (guess - &swap).norm() < 1e-12));
        assert!(candidates(&[1.; 8], &[1.; 8]).len() <= MOST_TURNS << 7);
    }
}
