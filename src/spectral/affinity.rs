//! The sampled block `[A B]` of affinities: its columns, the kept eigenpairs of A, and normalisations.
//!
//! A block has l rows (landmarks) and n columns in node order, including A's ([`SampledBlock`]). Columns are computed
//! in chunks and discarded; nothing of the size of the mesh is stored. Cost of a pass: n·l affinities.
//!
//! A⁻¹ of eq. 1 and eq. 6 is the pseudo-inverse on the kept eigenpairs ([`KeptEigenpairs`]): A of a Gaussian of
//! geodesic distances is indefinite, and its small eigenvalues are noise. O(l³).
//!
//! The preprocessing of affinities before the eigenproblem ([`Preprocess`]) is a function of `[A B]`'s columns:
//! - [`Preprocess::Degree`]: D^-½ W D^-½ with the degrees of the Nyström approximation, d_j = B_jᵀ A⁺ (W 1): the row
//!   sums W 1 of the landmarks take one pass, d_j then follows from column j.
//! - [`Preprocess::RowStochastic`]: D⁻¹W is not symmetric; its eigenvectors are D^-½ times those of the above, so
//!   coordinates are scaled after extrapolation.
//! - [`Preprocess::Centred`]: kernel PCA centred on the training set, k̃(x_r, y) = k(x_r, y) − mean_s k(x_s, y) −
//!   mean_s k(x_r, x_s) + mean_st k(x_s, x_t): a function of A and of column y.
//!
//! The anchor graph is a normalisation of [`super::embedding`]: it replaces A instead of preparing it.

use super::kernel::Kernel;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::vector::axpy;
use crate::base::{Result, eigen};
use crate::distance::DistanceRows;
use crate::store::Run;
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

    /// The factors for the coordinates of the columns `range` after extrapolation; none by default.
    fn scale(&self, _range: Range<usize>) -> Option<Vec<f64>> {
        None
    }

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
#[derive(Clone, Debug, Default)]
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

/// How affinities are preprocessed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preprocess {
    /// Nothing.
    #[default]
    None,
    /// Division by the square roots of both degrees.
    Degree,
    /// Division by the degree of the row.
    RowStochastic,
    /// Double centring.
    Centred,
}

/// A block after preprocessing.
pub struct PreprocessedBlock<'a> {
    block: &'a dyn SampledBlock,
    kind: Preprocess,
    /// Degrees, for the normalisations that divide by them.
    degrees: Degrees,
    /// Means of A's rows (l), if columns are centred.
    means: Vec<f64>,
    /// Mean of A.
    mean: f64,
}

impl<'a> PreprocessedBlock<'a> {
    /// Prepares `block`. `tolerance`: eigenvalues of A up to this share of the greatest are dropped.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn new(block: &'a dyn SampledBlock, kind: Preprocess, tolerance: f64, run: &Run) -> Result<Self> {
        let mut prepared = Self { block, kind, degrees: Degrees::default(), means: Vec::new(), mean: 0. };
        match kind {
            Preprocess::None => {}
            Preprocess::Centred => {
                prepared.means = block.sampled().row_mean().iter().copied().collect();
                prepared.mean = prepared.means.iter().sum::<f64>() / block.len() as f64;
            }
            Preprocess::Degree | Preprocess::RowStochastic => {
                let sums = row_sums(block, run)?;
                prepared.degrees = Degrees::of(&KeptEigenpairs::of(block.sampled(), tolerance), &sums);
            }
        }
        Ok(prepared)
    }

    /// Degrees of the m columns in `columns` (l × m).
    fn degrees(&self, m: usize, columns: &[f64]) -> Vec<f64> {
        let mut degrees = vec![0.; m];
        for (row, c) in columns.chunks_exact(m).zip(&self.degrees.toward) {
            axpy(&mut degrees, *c, row);
        }
        degrees.iter_mut().for_each(|d| *d = d.max(self.degrees.floor));
        degrees
    }
}

/// W 1 for the landmarks (l): one pass.
fn row_sums(block: &dyn SampledBlock, run: &Run) -> Result<Vec<f64>> {
    let (l, n) = (block.len(), block.nodes());
    let parts = run.map_chunks(chunk_count(n, CHUNK), Vec::new, |k, out: &mut Vec<f64>| {
        let range = chunk_range(n, CHUNK, k);
        out.resize(l * range.len(), 0.);
        block.columns(range.clone(), out);
        Ok(out.chunks_exact(range.len()).map(|row| row.iter().sum()).collect::<Vec<f64>>())
    })?;
    Ok((0..l).map(|k| parts.iter().map(|part| part[k]).sum()).collect())
}

impl SampledBlock for PreprocessedBlock<'_> {
    fn landmarks(&self) -> &[u32] {
        self.block.landmarks()
    }

    fn nodes(&self) -> usize {
        self.block.nodes()
    }

    fn columns(&self, range: Range<usize>, out: &mut [f64]) {
        let m = range.len();
        self.block.columns(range, out);
        match self.kind {
            Preprocess::None => {}
            Preprocess::Centred => {
                let mut means = vec![0.; m];
                for row in out.chunks_exact(m) {
                    means.iter_mut().zip(row).for_each(|(mean, w)| *mean += w / self.means.len() as f64);
                }
                for (row, own) in out.chunks_exact_mut(m).zip(&self.means) {
                    row.iter_mut().zip(&means).for_each(|(w, mean)| *w += self.mean - mean - own);
                }
            }
            Preprocess::Degree | Preprocess::RowStochastic => {
                let roots: Vec<f64> = self.degrees(m, out).into_iter().map(f64::sqrt).collect();
                for (row, own) in out.chunks_exact_mut(m).zip(&self.degrees.roots) {
                    row.iter_mut().zip(&roots).for_each(|(w, root)| *w /= own * root);
                }
            }
        }
    }

    fn scale(&self, range: Range<usize>) -> Option<Vec<f64>> {
        let inner = self.block.scale(range.clone());
        if self.kind != Preprocess::RowStochastic {
            return inner;
        }
        let m = range.len();
        let mut out = vec![0.; self.len() * m];
        self.block.columns(range, &mut out);
        let mut scale: Vec<f64> = self.degrees(m, &out).into_iter().map(|d| 1. / d.sqrt()).collect();
        if let Some(inner) = inner {
            scale.iter_mut().zip(inner).for_each(|(s, i)| *s *= i);
        }
        Some(scale)
    }
}
