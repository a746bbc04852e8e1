//! The anchor embedding: represents cells as mixtures of nearby landmarks.
//!
//! With B the l × S distances of cells from landmarks, K = exp(−B²/2s²) with s a fixed share of the area-weighted mean
//! of B, and v_j the share of the area that is nearest to landmark j, a cell's affinities v_j K_ji (plus one hundredth
//! of their mean) are divided by their sum: the column is a distribution over landmarks. The S × S affinity Zᵀ
//! diag(Za)⁻¹ Z ("anchor graph"; W. Liu, He, Chang, ICML 2010) is positive semi-definite and doubly normalised by
//! construction, which the degree normalisation of an indefinite Gaussian is not. Its leading eigenvectors come from an
//! l × l problem: they are Φᵀ Q/√g, with Φ = Z/√(Za) and (Q, g) the eigenpairs of Φ diag(a) Φᵀ. After scaling by
//! √(g/g₀) and normalising rows to unit length, the factors of g cancel, and Φᵀ Q remains.
//!
//! This is the version for a few thousand points in `f64`, with all sums vectorised in a fixed order: l² S
//! multiply-adds and 16 l S bytes. [`super::embedding`] has the version that streams over faces.

use super::exp::exp64;
use crate::base::eigen;
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::vector::{axpy, inner_product as dot};
use nalgebra::DMatrix;

/// Share of the mean affinity that every landmark contributes to every cell, so that far cells still have a
/// distribution.
pub(super) const BACKGROUND: f64 = 0.01;
/// Minimum share of the area that a landmark represents.
const ANCHOR_FLOOR: f64 = 1e-4;
/// Points that [`project`] handles at a time.
const LANES: usize = 8;

/// The distances of `points` points from `count` landmarks, row-major, finite and ≥ 0.
#[derive(Clone, Debug)]
pub struct LandmarkDistances {
    /// Distances, `count` × `points`.
    pub values: Vec<f64>,
    /// Landmarks l.
    pub count: usize,
    /// Points S: cells, as a rule.
    pub points: usize,
}

impl LandmarkDistances {
    /// Takes rows in their order; unreached points are put at twice the row's greatest finite distance.
    pub fn new(values: &[f64], count: usize, points: usize) -> LandmarkDistances {
        let mut values = values.to_vec();
        for row in values.chunks_mut(points.max(1)) {
            let far = row.iter().filter(|x| x.is_finite()).fold(0.0f64, |m, &x| m.max(x));
            for x in row {
                *x = if x.is_finite() { x.clamp(0.0, 1e100) } else { (2.0 * far).min(1e100) };
            }
        }
        LandmarkDistances { values, count, points }
    }

    /// Distances of all points from landmark `j`.
    pub fn row(&self, j: usize) -> &[f64] {
        &self.values[j * self.points..(j + 1) * self.points]
    }

    /// The point nearest to landmark `j`.
    pub fn nearest_point(&self, j: usize) -> usize {
        let row = self.row(j);
        (0..row.len()).min_by(|&a, &b| row[a].total_cmp(&row[b])).unwrap_or(0)
    }
}

/// Points of unit length (or zero), row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct AnchorEmbedding {
    /// Coordinates, S × `width`.
    pub values: Vec<f64>,
    /// Coordinates per point.
    pub width: usize,
}

impl AnchorEmbedding {
    /// Coordinates of cell `i`.
    pub fn point(&self, i: usize) -> &[f64] {
        &self.values[i * self.width..(i + 1) * self.width]
    }
}

/// The parameters of the cells' anchor embedding: enough to embed any other column of distances.
#[derive(Clone, Debug)]
pub struct AnchorExtension {
    /// Share of the area that each landmark represents (l).
    pub weight: Vec<f64>,
    /// −1/2s².
    pub factor: f64,
    /// The background affinity of every landmark, divided by its weight.
    pub lift: f64,
    /// 1/√(Za)_j (l).
    pub root: Vec<f64>,
    /// Leading eigenvectors, row-major l × width.
    pub vectors: Vec<f64>,
    /// Coordinates per point.
    pub width: usize,
}

/// Embeds the points in min(`width`, landmarks) dimensions, given the rows of the `chosen` landmarks.
///
/// ```
/// use nystrom_stream::spectral::anchor::{LandmarkDistances, anchor_embedding};
///
/// // Points at 0, 1, 9 and 10 on a line, and their distances from the first and the last.
/// let rows = LandmarkDistances::new(&[0., 1., 9., 10., 10., 9., 1., 0.], 2, 4);
/// let x = anchor_embedding(&rows, &[0, 1], &[0.25; 4], 2, 0.25);
/// let cosine = |i, j| x.point(i).iter().zip(x.point(j)).map(|(a, b)| a * b).sum::<f64>();
/// assert!(cosine(0, 1) > 0.9 && cosine(2, 3) > 0.9 && cosine(0, 3) < 0.1);
/// ```
///
/// `shares`: area shares (S). `scale`: s relative to the area-weighted mean of the chosen rows (.2 to .3 work well).
pub fn anchor_embedding(
    rows: &LandmarkDistances,
    chosen: &[usize],
    shares: &[f64],
    width: usize,
    scale: f64,
) -> AnchorEmbedding {
    fit_anchor_embedding(rows, chosen, shares, width, scale).0
}

/// The same, together with its parameters.
pub fn fit_anchor_embedding(
    rows: &LandmarkDistances,
    chosen: &[usize],
    shares: &[f64],
    width: usize,
    scale: f64,
) -> (AnchorEmbedding, AnchorExtension) {
    dispatch(AnchorFit { rows, chosen, shares, width, scale })
}

/// [`fit_anchor_embedding`] on wide vectors.
struct AnchorFit<'a> {
    rows: &'a LandmarkDistances,
    chosen: &'a [usize],
    shares: &'a [f64],
    width: usize,
    scale: f64,
}

impl SimdKernel for AnchorFit<'_> {
    type Output = (AnchorEmbedding, AnchorExtension);

    #[inline(always)]
    fn run(self) -> (AnchorEmbedding, AnchorExtension) {
        let AnchorFit { rows, chosen, shares, width, scale } = self;
        let (l, n) = (chosen.len(), rows.points);
        let width = width.min(l);
        if l == 0 || n == 0 {
            let none =
                AnchorExtension { weight: vec![], factor: 0., lift: 0., root: vec![], vectors: vec![], width: 0 };
            return (AnchorEmbedding { values: Vec::new(), width: 0 }, none);
        }
        let mean = chosen.iter().map(|&j| dot(rows.row(j), shares)).sum::<f64>() / l as f64;
        let s = (scale * mean).max(1e-30);
        let weight = nearest_shares(chosen.iter().map(|&j| rows.row(j)), shares);
        let factor = -1.0 / (2.0 * s * s);
        let mut z = vec![0.0; l * n];
        let mut column = vec![0.0; n];
        for ((row, &j), v) in z.chunks_exact_mut(n).zip(chosen).zip(&weight) {
            let (row, column, from) = (&mut row[..n], &mut column[..n], &rows.row(j)[..n]);
            for i in 0..n {
                let k = v * exp64(from[i] * from[i] * factor);
                column[i] += k;
                row[i] = k;
            }
        }
        let lift = BACKGROUND * dot(&column, shares);
        let total: f64 = weight.iter().sum();
        column.iter_mut().for_each(|c| *c = 1.0 / (*c + lift * total).max(1e-300));
        let mut root = Vec::with_capacity(l);
        for (row, v) in z.chunks_exact_mut(n).zip(&weight) {
            row.iter_mut().zip(&column).for_each(|(x, c)| *x = (*x + lift * v) * c);
            let scale = 1.0 / dot(row, shares).max(1e-300).sqrt();
            row.iter_mut().for_each(|x| *x *= scale);
            root.push(scale);
        }
        let vectors = leading_eigenvectors(&z, l, n, shares, width);
        (project(&z, &vectors, l, n, width), AnchorExtension { weight, factor, lift, root, vectors, width })
    }
}

impl AnchorExtension {
    /// Embeds a point, given its distances from the landmarks (l, finite), into `out` (width): Nyström's extrapolation
    /// for this embedding, which is the cells' own formula for one column. A constant factor of the column cancels.
    pub fn embed(&self, distances: &[f32], out: &mut [f64]) {
        out.fill(0.);
        for (j, &d) in distances.iter().enumerate() {
            let d = f64::from(d);
            let z = self.weight[j] * (exp64(d * d * self.factor) + self.lift) * self.root[j];
            let vector = &self.vectors[j * self.width..(j + 1) * self.width];
            axpy(out, z, vector);
        }
        let norm = out.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-300);
        out.iter_mut().for_each(|x| *x /= norm);
    }
}

/// Share of the area that is nearest to each landmark, with a lower bound, summing to 1. `rows`: the points' distances,
/// landmark by landmark; `shares`: area shares of the points.
#[inline(always)]
pub(super) fn nearest_shares<'a, T: Copy + PartialOrd + 'a>(
    mut rows: impl Iterator<Item = &'a [T]>,
    shares: &[f64],
) -> Vec<f64> {
    let mut least = rows.next().unwrap_or_default().to_vec();
    let mut nearest = vec![0u32; least.len()];
    let mut count = 1;
    for row in rows {
        let row = &row[..least.len()];
        for i in 0..row.len() {
            let nearer = row[i] < least[i];
            nearest[i] = if nearer { count } else { nearest[i] };
            least[i] = if nearer { row[i] } else { least[i] };
        }
        count += 1;
    }
    let mut share = vec![0.0; count as usize];
    for (&k, a) in nearest.iter().zip(shares) {
        share[k as usize] += a;
    }
    share.iter_mut().for_each(|v| *v = v.max(ANCHOR_FLOOR));
    let total: f64 = share.iter().sum();
    share.iter_mut().for_each(|v| *v /= total);
    share
}

/// The `width` leading eigenvectors of Φ diag(a) Φᵀ, row-major l × width.
#[inline(always)]
fn leading_eigenvectors(phi: &[f64], l: usize, n: usize, shares: &[f64], width: usize) -> Vec<f64> {
    let root: Vec<f64> = shares.iter().map(|a| a.max(0.0).sqrt()).collect();
    let mut scaled = phi.to_vec();
    for row in scaled.chunks_exact_mut(n) {
        row.iter_mut().zip(&root).for_each(|(x, r)| *x *= r);
    }
    let (_, vectors) = eigen::symmetric(gram(&scaled, l, n));
    let mut q = vec![0.0; l * width];
    for (c, j) in (0..width).flat_map(|c| (0..l).map(move |j| (c, j))) {
        q[j * width + c] = vectors[(j, c)];
    }
    q
}

/// Inner products of the rows of a matrix with each other, for [`dispatch`]: the same bits on all processors, unlike
/// matrix products of the crate `nalgebra`.
pub(super) struct RowProducts<'a> {
    /// The rows, one after another (l × n).
    pub rows: &'a [f64],
    /// Number of rows.
    pub l: usize,
    /// Numbers per row.
    pub n: usize,
}

impl SimdKernel for RowProducts<'_> {
    type Output = DMatrix<f64>;

    #[inline(always)]
    fn run(self) -> DMatrix<f64> {
        gram(self.rows, self.l, self.n)
    }
}

/// Inner products of `l` rows of `n` numbers with each other, each a [`dot`]: four at a time were vectorised along the
/// wrong axis, and took longer.
#[inline(always)]
fn gram(rows: &[f64], l: usize, n: usize) -> DMatrix<f64> {
    let mut gram = DMatrix::zeros(l, l);
    let row = |i: usize| &rows[i * n..(i + 1) * n];
    for i in 0..l {
        for j in 0..=i {
            let product = dot(row(i), row(j));
            gram[(i, j)] = product;
            gram[(j, i)] = product;
        }
    }
    gram
}

/// Coordinates that [`project`] sums at a time.
const COORDINATES_AT_ONCE: usize = 4;

/// Φᵀ Q with rows normalised to unit length.
#[inline(always)]
fn project(phi: &[f64], q: &[f64], l: usize, n: usize, width: usize) -> AnchorEmbedding {
    // Q in groups of coordinates, row by row.
    let groups = width.div_ceil(COORDINATES_AT_ONCE);
    let mut vectors = vec![[0.0; COORDINATES_AT_ONCE]; groups * l];
    for j in 0..l {
        for (c, x) in q[j * width..(j + 1) * width].iter().enumerate() {
            vectors[c / COORDINATES_AT_ONCE * l + j][c % COORDINATES_AT_ONCE] = *x;
        }
    }
    let mut values = vec![0.0; n * width];
    let mut block = vec![[0.0; LANES]; l];
    let mut sums = vec![[0.0; LANES]; groups * COORDINATES_AT_ONCE];
    for (start, values) in (0..n).step_by(LANES).zip(values.chunks_mut(LANES * width)) {
        let lanes = LANES.min(n - start);
        let block = &mut block[..l];
        for j in 0..l {
            block[j][..lanes].copy_from_slice(&phi[j * n + start..][..lanes]);
        }
        for (g, out) in sums.as_chunks_mut::<COORDINATES_AT_ONCE>().0.iter_mut().enumerate() {
            let vectors = &vectors[g * l..(g + 1) * l];
            let mut sums = [[0.0; LANES]; COORDINATES_AT_ONCE];
            for j in 0..l {
                for c in 0..COORDINATES_AT_ONCE {
                    for k in 0..LANES {
                        sums[c][k] += vectors[j][c] * block[j][k];
                    }
                }
            }
            *out = sums;
        }
        let mut norm = [0.0f64; LANES];
        for s in &sums[..width] {
            for k in 0..LANES {
                norm[k] += s[k] * s[k];
            }
        }
        for (i, row) in values.chunks_exact_mut(width).enumerate() {
            let norm = norm[i].sqrt().max(1e-30);
            for c in 0..width {
                row[c] = sums[c][i] / norm;
            }
        }
    }
    AnchorEmbedding { values, width }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_far_clumps_embed_apart_and_each_together() {
        let place = [0.0, 0.1, 0.2, 5.0, 5.1, 5.2];
        let values: Vec<f64> = [0, 2, 3, 5].iter().flat_map(|&j| place.map(|x: f64| (x - place[j]).abs())).collect();
        let rows = LandmarkDistances::new(&values, 4, 6);
        let x = anchor_embedding(&rows, &[0, 1, 2, 3], &[1.0 / 6.0; 6], 2, 0.2);
        let cosine = |i, j| dot(x.point(i), x.point(j));
        assert!(cosine(0, 2) > 0.95 && cosine(3, 5) > 0.95 && cosine(1, 4) < 0.3);
    }

    #[test]
    fn a_column_of_a_cell_is_extrapolated_to_the_cell() {
        let mut random = crate::base::random::stream(3, "columns");
        let (l, n) = (9, 40);
        let values: Vec<f64> =
            (0..l * n).map(|_| f64::from(4. * crate::base::random::unit(&mut random) as f32)).collect();
        let rows = LandmarkDistances::new(&values, l, n);
        let (x, anchors) = fit_anchor_embedding(&rows, &[0, 2, 3, 5, 6, 8], &vec![1. / n as f64; n], 4, 0.2);
        let mut point = vec![0.; 4];
        for i in 0..n {
            anchors.embed(&[0, 2, 3, 5, 6, 8].map(|j| rows.row(j)[i] as f32), &mut point);
            assert!(point.iter().zip(x.point(i)).all(|(a, b)| (a - b).abs() < 1e-9), "{i}: {point:?} {:?}", x.point(i));
        }
    }

    #[test]
    fn one_cell_one_row_and_unreached_cells_stay_finite() {
        let one = anchor_embedding(&LandmarkDistances::new(&[0.0], 1, 1), &[0], &[1.0], 12, 0.2);
        assert_eq!((one.width, one.values.len()), (1, 1));
        let rows = LandmarkDistances::new(&[0.0, f64::INFINITY, 1.0, f64::NAN, 0.0, f64::INFINITY], 2, 3);
        assert_eq!(rows.row(0), [0.0, 2.0, 1.0]);
        let x = anchor_embedding(&rows, &[0, 1], &[0.5, 0.25, 0.25], 2, 0.25);
        assert!(x.values.iter().all(|v| v.is_finite()));
    }
}
