//! The sampled block `[A B]` of affinities: its columns, the kept eigenpairs of A, and degrees.
//!
//! A block has l rows (landmarks) and n columns in node order, including A's ([`SampledBlock`]). Columns are computed
//! in chunks and discarded; nothing of the size of the mesh is stored. Cost of a pass: n·l affinities.
//!
//! A⁻¹ of eq. 1 and eq. 6 is the pseudo-inverse on the kept eigenpairs ([`KeptEigenpairs`]): A of a Gaussian of
//! geodesic distances is indefinite, and its small eigenvalues are noise. O(l³).
//!
//! D^-½ W D^-½ takes the degrees of the Nyström approximation, d_j = B_jᵀ A⁺ (W 1) ([`Degrees`]): the row sums W 1 of
//! the landmarks take one pass, d_j then follows from column j. It is a normalisation of [`super::embedding`].

use super::kernel::Kernel;
use crate::base::eigen;
use crate::distance::DistanceRows;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Columns per chunk; it affects results, since sums are formed by chunks.
pub const CHUNK: usize = 2048;

/// The sampled block.
pub trait SampledBlock: Sync {
    /// Nodes of the landmarks (l).
    fn landmarks(&self) -> &[u32];

    /// Number of columns n.
    fn nodes(&self) -> usize;

    /// Columns `range` of `[A B]` (m of them): row k at `k * m` of `out` (l × m).
    fn columns(&self, range: Range<usize>, out: &mut [f64]);

    /// Number of landmarks l.
    fn len(&self) -> usize {
        self.landmarks().len()
    }

    /// The columns of the given nodes (l × count).
    fn columns_of(&self, nodes: &[u32]) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(self.len(), nodes.len());
        for (to, &node) in nodes.iter().enumerate() {
            let at = node as usize;
            self.columns(at..at + 1, out.column_mut(to).as_mut_slice());
        }
        out
    }

    /// A (l × l), symmetrised.
    fn sampled(&self) -> DMatrix<f64> {
        let a = self.columns_of(self.landmarks());
        0.5 * (&a + a.transpose())
    }
}

/// A block in memory, for small sets and for points without a mesh.
#[derive(Clone, Debug)]
pub struct DenseBlock {
    /// Nodes of the landmarks (l).
    pub landmarks: Vec<u32>,
    /// Their rows (l × n).
    pub rows: DMatrix<f64>,
}

impl SampledBlock for DenseBlock {
    fn landmarks(&self) -> &[u32] {
        &self.landmarks
    }

    fn nodes(&self) -> usize {
        self.rows.ncols()
    }

    fn columns(&self, range: Range<usize>, out: &mut [f64]) {
        let m = range.len();
        for (j, column) in range.enumerate() {
            for k in 0..self.len() {
                out[k * m + j] = self.rows[(k, column)];
            }
        }
    }
}

/// The kernel's width.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bandwidth {
    /// σ, the same everywhere.
    Global(f64),
    /// √(σ_i σ_j), where σ_j is the distance from j to its q-th nearest landmark (self-tuning, after Zelnik-Manor and
    /// Perona 2004, with landmarks as neighbours).
    Local(usize),
}

/// Affinities of distances under a kernel.
///
/// ```
/// use nystrom_stream::spectral::Kernel;
/// use nystrom_stream::spectral::affinity::{AffinityBlock, Bandwidth, KeptEigenpairs, SampledBlock};
///
/// // Distances of four nodes on a line from two landmarks, the nodes 0 and 3.
/// let rows = [[0., 1., 2., 3.], [3., 2., 1., 0f32]];
/// let rows = rows.iter().map(|row| &row[..]).collect();
/// let block = AffinityBlock::new(&[0, 3], rows, Kernel::Exponential, Bandwidth::Global(1.));
/// let a = block.sampled();
/// assert_eq!([a[(0, 0)], a[(0, 1)]], [1., (-3f64).exp()]);
/// // λ = 1 ± e⁻³.
/// assert!((KeptEigenpairs::of(a, 1e-3).values[0] - 1. - (-3f64).exp()).abs() < 1e-12);
/// ```
#[derive(Clone, Debug)]
pub struct AffinityBlock<'a> {
    landmarks: &'a [u32],
    /// Distances, one row per landmark (l × n).
    rows: Vec<&'a [f32]>,
    kernel: Kernel,
    bandwidth: Bandwidth,
    /// σ_i of the landmarks, if the bandwidth is local.
    own: Vec<f64>,
}

impl<'a> AffinityBlock<'a> {
    /// The affinities for `rows`, the distances from `landmarks`; both have the same length, at least 1.
    pub fn new(landmarks: &'a [u32], rows: Vec<&'a [f32]>, kernel: Kernel, bandwidth: Bandwidth) -> Self {
        let mut block = Self { landmarks, rows, kernel, bandwidth, own: Vec::new() };
        if let Bandwidth::Local(q) = bandwidth {
            block.own = landmarks.iter().map(|&node| block.nearest(node as usize, q)).collect();
        }
        block
    }

    /// The distance of column `j` to its `q`-th nearest landmark.
    fn nearest(&self, j: usize, q: usize) -> f64 {
        let mut column: Vec<f32> = self.rows.iter().map(|row| row[j]).collect();
        column.sort_unstable_by(f32::total_cmp);
        f64::from(column[q.clamp(1, column.len()) - 1]).max(1e-30)
    }
}

impl SampledBlock for AffinityBlock<'_> {
    fn landmarks(&self) -> &[u32] {
        self.landmarks
    }

    fn nodes(&self) -> usize {
        self.rows.first().map_or(0, |row| row.len())
    }

    fn columns(&self, range: Range<usize>, out: &mut [f64]) {
        let m = range.len();
        let local: Vec<f64> = match self.bandwidth {
            Bandwidth::Global(_) => Vec::new(),
            Bandwidth::Local(q) => range.clone().map(|j| self.nearest(j, q)).collect(),
        };
        for ((k, row), out) in self.rows.iter().enumerate().zip(out.chunks_exact_mut(m)) {
            for (j, (w, &d)) in out.iter_mut().zip(&row[range.clone()]).enumerate() {
                let sigma = match self.bandwidth {
                    Bandwidth::Global(sigma) => sigma,
                    Bandwidth::Local(_) => (self.own[k] * local[j]).sqrt(),
                };
                *w = self.kernel.of(sigma, f64::from(d));
            }
        }
    }
}

/// The affinities among the landmarks, A (l × l), symmetric in `f64`.
pub fn landmark_affinities(rows: &DistanceRows, kernel: Kernel, sigma: f64) -> DMatrix<f64> {
    let l = rows.len();
    let d = |i: usize, j: usize| f64::from(rows.row(i)[rows.landmarks[j] as usize]);
    DMatrix::from_fn(l, l, |i, j| kernel.of(sigma, 0.5 * (d(i, j) + d(j, i))))
}

/// The kept eigenpairs of A, and statistics of the others.
#[derive(Clone, Debug)]
pub struct KeptEigenpairs {
    /// Kept eigenvalues, descending (r ≥ 1 unless l = 0).
    pub values: Vec<f64>,
    /// Their eigenvectors (l × r).
    pub vectors: DMatrix<f64>,
    /// All eigenvalues (l).
    pub all: Vec<f64>,
}

impl KeptEigenpairs {
    /// Keeps eigenvalues of `a` above `tolerance` times the greatest.
    pub fn of(a: DMatrix<f64>, tolerance: f64) -> Self {
        let (all, vectors) = eigen::symmetric(a);
        let cut = (tolerance * all.first().copied().unwrap_or(0.)).max(0.);
        let count = all.iter().take_while(|&&value| value > cut).count().max(1).min(all.len());
        Self { values: all[..count].to_vec(), vectors: vectors.columns(0, count).into_owned(), all }
    }

    /// Columns uᵉ·√(λ_e/(λ_e² + ε²)) for all positive eigenvalues of `a` (l × r), where ε is `tolerance` times the
    /// greatest: their product with its transpose is A⁺ with Tikhonov damping instead of truncation. Truncation may
    /// keep a pair here and drop it on a mesh that differs only in its triangulation; damping depends on A
    /// continuously.
    pub fn damped(a: DMatrix<f64>, tolerance: f64) -> DMatrix<f64> {
        let (all, mut vectors) = eigen::symmetric(a);
        let epsilon = tolerance * all.first().copied().unwrap_or(0.);
        let count = all.iter().take_while(|&&value| value > 0.).count().max(1).min(all.len());
        for (mut column, &value) in vectors.column_iter_mut().zip(&all[..count]) {
            let value = value.max(1e-300);
            column *= (value / (value * value + epsilon * epsilon)).sqrt();
        }
        vectors.columns(0, count).into_owned()
    }

    /// Eigenpairs dropped.
    pub fn dropped(&self) -> usize {
        self.all.len() - self.values.len()
    }

    /// Number of negative eigenvalues.
    pub fn negative(&self) -> usize {
        self.all.iter().filter(|value| **value < 0.).count()
    }

    /// Σ|λ < 0| / Σ|λ|.
    pub fn negative_mass(&self) -> f64 {
        let mass: f64 = self.all.iter().map(|value| value.abs()).sum();
        let negative: f64 = self.all.iter().filter(|value| **value < 0.).map(|value| -value).sum();
        // An empty sum is −0.
        if mass > 0. { (negative / mass).max(0.) } else { 0. }
    }

    /// A⁺ b.
    pub fn solve(&self, b: &[f64]) -> Vec<f64> {
        let mut in_basis = self.vectors.tr_mul(&DVector::from_column_slice(b));
        in_basis.iter_mut().zip(&self.values).for_each(|(x, value)| *x /= value);
        (&self.vectors * in_basis).iter().copied().collect()
    }

    /// uᵉ/√λ_e as columns (l × r): A⁺ is this matrix times its transpose.
    pub fn roots(&self) -> DMatrix<f64> {
        let mut roots = self.vectors.clone();
        for (mut column, value) in roots.column_iter_mut().zip(&self.values) {
            column /= value.sqrt();
        }
        roots
    }
}

/// Degrees of the Nyström approximation: that of a column k of `[A B]` is kᵀ `toward`.
#[derive(Clone, Debug)]
pub(super) struct Degrees {
    /// A⁺ (W 1) (l).
    pub toward: Vec<f64>,
    /// Lower bound on degrees.
    pub floor: f64,
    /// Square roots of the landmarks' own degrees (l).
    pub roots: Vec<f64>,
}

impl Degrees {
    /// From the landmarks' row sums W 1 (l).
    pub fn of(a: &KeptEigenpairs, sums: &[f64]) -> Self {
        let floor = 1e-3 * sums.iter().sum::<f64>() / sums.len() as f64;
        let roots = sums.iter().map(|sum| sum.max(floor).sqrt()).collect();
        Self { toward: a.solve(sums), floor, roots }
    }
}
