//! Functional maps between two bases, and the points that they match (Ovsjanikov et al. 2012, *Functional Maps*).
//!
//! A map of vertices transfers functions from B to A; between the first k functions of each basis that is a k × k
//! matrix C with Φ_B(match of v) ≈ C Φ_A(v) over vertices v of A. In the other direction, the match of v is the nearest
//! vertex of B in coordinates of A: the w whose Cᵀ Φ_B(w) is nearest to Φ_A(v).
//!
//! Nearest points in a hundred coordinates are found by comparing all of them, because no tree prunes there.
//! [`Targets`] stores them in blocks, so that one query is compared with as many points as a vector has lanes. Each
//! product is summed in the same order, whatever the vector width.

use crate::base::simd::{SimdKernel, dispatch};
use crate::base::vector::{MapEach, axpy};
use nalgebra::DMatrix;

/// Points compared at a time.
const LANES: usize = 16;
/// Queries processed together.
const QUERIES: usize = 4;

/// Points of k coordinates, row by row.
#[derive(Clone, Debug, Default)]
pub struct Points {
    /// Coordinates k.
    pub dimensions: usize,
    /// Values (n × k).
    pub values: Vec<f32>,
}

impl Points {
    /// Number of points n.
    pub fn len(&self) -> usize {
        self.values.len() / self.dimensions.max(1)
    }

    /// Point `i` (k).
    #[inline]
    pub fn at(&self, i: usize) -> &[f32] {
        &self.values[i * self.dimensions..(i + 1) * self.dimensions]
    }

    /// All points in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[f32]> {
        self.values.chunks_exact(self.dimensions.max(1))
    }

    /// The first `k` coordinates of each point.
    #[must_use]
    pub fn first(&self, k: usize) -> Self {
        let k = k.min(self.dimensions);
        let values = self.iter().flat_map(|point| &point[..k]).copied().collect();
        Self { dimensions: k, values }
    }
}

/// Points to be searched: blocks of [`LANES`], coordinate by coordinate, and half their squared norms.
pub struct Targets {
    dimensions: usize,
    blocks: Vec<[f32; LANES]>,
    halves: Vec<[f32; LANES]>,
}

impl Targets {
    /// Points of `dimensions` coordinates, in order.
    pub fn new<'a>(points: impl ExactSizeIterator<Item = &'a [f32]>, dimensions: usize) -> Self {
        let blocks = points.len().div_ceil(LANES);
        let mut all = Self {
            dimensions,
            blocks: vec![[0.; LANES]; blocks * dimensions],
            // Padding is infinitely far away.
            halves: vec![[f32::INFINITY; LANES]; blocks],
        };
        for (i, point) in points.enumerate() {
            let (block, lane) = (i / LANES, i % LANES);
            let mut half = 0.;
            for (d, &x) in point[..dimensions].iter().enumerate() {
                all.blocks[block * dimensions + d][lane] = x;
                half += 0.5 * x * x;
            }
            all.halves[block][lane] = half;
        }
        all
    }

    /// For each of `queries` the nearest point, the first if several; 0 if there are no points.
    pub fn nearest<'a>(&self, queries: impl Iterator<Item = &'a [f32]>) -> Vec<u32> {
        let queries: Vec<&[f32]> = queries.collect();
        let mut out = Vec::with_capacity(queries.len());
        for group in queries.chunks(QUERIES) {
            let padded: [&[f32]; QUERIES] = std::array::from_fn(|q| group[q.min(group.len() - 1)]);
            let found = dispatch(Nearest { targets: self, queries: padded });
            out.extend_from_slice(&found[..group.len()]);
        }
        out
    }
}

struct Nearest<'a> {
    targets: &'a Targets,
    queries: [&'a [f32]; QUERIES],
}

impl SimdKernel for Nearest<'_> {
    type Output = [u32; QUERIES];

    #[inline(always)]
    fn run(self) -> [u32; QUERIES] {
        let Targets { dimensions, blocks, halves, .. } = self.targets;
        // |x − y|² / 2 = |x|²/2 − (x·y − |y|²/2): the greatest difference is the nearest point.
        let mut best = [[f32::NEG_INFINITY; LANES]; QUERIES];
        let mut at = [[0u32; LANES]; QUERIES];
        let queries = self.queries.map_each(|query| &query[..*dimensions]);
        for (k, half) in halves.iter().enumerate() {
            let block = &blocks[k * dimensions..][..*dimensions];
            let mut sums = [[0f32; LANES]; QUERIES];
            for (d, y) in block.iter().enumerate() {
                for q in 0..QUERIES {
                    let x = queries[q][d];
                    for lane in 0..LANES {
                        sums[q][lane] += x * y[lane];
                    }
                }
            }
            for q in 0..QUERIES {
                for lane in 0..LANES {
                    let score = sums[q][lane] - half[lane];
                    let better = score > best[q][lane];
                    best[q][lane] = if better { score } else { best[q][lane] };
                    at[q][lane] = if better { k as u32 } else { at[q][lane] };
                }
            }
        }
        let mut found = [0; QUERIES];
        for q in 0..QUERIES {
            let mut top = (f32::NEG_INFINITY, u32::MAX);
            for lane in 0..LANES {
                let here = (best[q][lane], at[q][lane] * LANES as u32 + lane as u32);
                if here.0 > top.0 || (here.0 == top.0 && here.1 < top.1) {
                    top = here;
                }
            }
            found[q] = if top.1 == u32::MAX { 0 } else { top.1 };
        }
        found
    }
}

/// Sums Σ x xᵀ over rows `x` of `a`, and Σ x yᵀ over pairs with rows `y` of `b` (k × k each), row by row.
struct Products<'a> {
    a: &'a Points,
    b: &'a Points,
    pairs: &'a [(u32, u32)],
    k: usize,
}

impl SimdKernel for Products<'_> {
    type Output = [Vec<f64>; 2];

    #[inline(always)]
    fn run(self) -> [Vec<f64>; 2] {
        let k = self.k;
        let [mut square, mut mixed] = [vec![0f64; k * k], vec![0f64; k * k]];
        let (mut x, mut y) = (vec![0f64; k], vec![0f64; k]);
        for &(i, j) in self.pairs {
            x.iter_mut().zip(self.a.at(i as usize)).for_each(|(x, &from)| *x = f64::from(from));
            y.iter_mut().zip(self.b.at(j as usize)).for_each(|(y, &from)| *y = f64::from(from));
            let (x, y) = (&x[..k], &y[..k]);
            for (r, &scale) in x.iter().enumerate() {
                axpy(&mut square[r * k..][..k], scale, x);
                axpy(&mut mixed[r * k..][..k], scale, y);
            }
        }
        [square, mixed]
    }
}

/// The map C (k × k) that best maps the first k functions at points of A to those at their matches in B: Φ_B ≈ C Φ_A in
/// the least-squares sense over `pairs` of points (of `a`, of `b`), slightly regularised for directions that the pairs
/// do not determine.
///
/// ```
/// use nystrom_stream::apps::correspond::functional::{Points, fit};
/// let a = Points { dimensions: 2, values: vec![1., 0., 0., 1., 1., 1.] };
/// let b = Points { dimensions: 2, values: vec![0., -1., 1., 0., 1., -1.] };
/// let map = fit(&a, &b, &[(0, 0), (1, 1), (2, 2)], 2);
/// assert!((map[(1, 0)] + 1.).abs() < 1e-4 && (map[(0, 1)] - 1.).abs() < 1e-4 && map[(0, 0)].abs() < 1e-4);
/// ```
pub fn fit(a: &Points, b: &Points, pairs: &[(u32, u32)], k: usize) -> DMatrix<f64> {
    let [mut square, mixed] = dispatch(Products { a, b, pairs, k }).map(|sums| DMatrix::from_row_slice(k, k, &sums));
    let ridge = 1e-6 * square.trace() / k.max(1) as f64;
    for i in 0..k {
        square[(i, i)] += ridge.max(1e-300);
    }
    match nalgebra::Cholesky::new(square) {
        Some(factor) => factor.solve(&mixed).transpose(),
        None => DMatrix::identity(k, k),
    }
}

struct ApplyMap<'a> {
    map: &'a [f32],
    from: &'a [f32],
    out: &'a mut [f32],
}

impl SimdKernel for ApplyMap<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let k = self.out.len();
        self.out.fill(0.);
        for (i, &x) in self.from.iter().enumerate() {
            axpy(self.out, x, &self.map[i * k..]);
        }
    }
}

/// Transforms points of B to the coordinates of A: Cᵀ Φ_B.
pub struct ToA {
    /// Number of functions of B.
    of_b: usize,
    /// Number of functions of A.
    k: usize,
    /// C, row by row.
    map: Vec<f32>,
}

impl ToA {
    /// Uses the map `c` (functions of B × functions of A).
    pub fn new(c: &DMatrix<f64>) -> Self {
        Self { of_b: c.nrows(), k: c.ncols(), map: c.transpose().iter().map(|&x| x as f32).collect() }
    }

    /// Transforms a point from B's coordinates (at least as many as the map has) to A's (k).
    pub fn apply(&self, point: &[f32], out: &mut [f32]) {
        dispatch(ApplyMap { map: &self.map, from: &point[..self.of_b], out: &mut out[..self.k] });
    }

    /// Transforms all of `points`.
    pub fn apply_all(&self, points: &Points) -> Points {
        let mut values = vec![0.; points.len() * self.k];
        for (i, out) in values.chunks_exact_mut(self.k.max(1)).enumerate() {
            self.apply(points.at(i), out);
        }
        Points { dimensions: self.k, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{stream, unit};

    fn random(n: usize, k: usize, seed: u64) -> Points {
        let mut draw = stream(seed, "points");
        Points { dimensions: k, values: (0..n * k).map(|_| (unit(&mut draw) - 0.5) as f32).collect() }
    }

    #[test]
    fn the_nearest_of_blocks_is_the_nearest_of_all() {
        for (n, k) in [(1, 3), (15, 1), (16, 7), (333, 20)] {
            let (targets, queries) = (random(n, k, 1), random(41, k, 2));
            let found = Targets::new(targets.iter(), k).nearest(queries.iter());
            assert_eq!(found.len(), 41);
            for (q, &one) in found.iter().enumerate() {
                let square = |i: usize| -> f64 {
                    queries.at(q).iter().zip(targets.at(i)).map(|(x, y)| f64::from(x - y).powi(2)).sum()
                };
                let least = (0..n).map(square).fold(f64::INFINITY, f64::min);
                assert!(square(one as usize) <= least + 1e-6, "{n} points in {k} coordinates");
            }
        }
    }

    #[test]
    fn a_known_map_is_found_and_carries_back() {
        let (a, k) = (random(200, 12, 3), 12);
        let turn = nalgebra::QR::new(DMatrix::from_fn(k, k, |i, j| ((7 * i + 3 * j * j) % 11) as f64 - 5.)).q();
        let rotated = |i: usize| &turn * DMatrix::from_fn(k, 1, |d, _| f64::from(a.at(i)[d]));
        let b = Points {
            dimensions: k,
            values: (0..200).flat_map(|i| rotated(i).map(|x| x as f32).as_slice().to_vec()).collect(),
        };
        let pairs: Vec<(u32, u32)> = (0..200).map(|i| (i, i)).collect();
        let map = fit(&a, &b, &pairs, k);
        assert!((&map - &turn).norm() < 1e-4, "{}", (&map - &turn).norm());
        let back = ToA::new(&map).apply_all(&b);
        assert!(back.values.iter().zip(&a.values).all(|(x, y)| (x - y).abs() < 1e-4));
    }
}
