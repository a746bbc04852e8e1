//! Nyström's extension of eigenvectors from the sample to all nodes, as a linear map of a column of `[A B]`.
//!
//! [`NystromExtension`] combines any of three extrapolations with any of three scalings, in `f64`:
//! - [`Extrapolation::Plain`]: eq. 1–2, ȳ_j = Λ⁻¹ Uᵀ B_j on the kept eigenpairs of A.
//! - [`Extrapolation::Kpca`]: the features of kernel PCA, eq. 4, ỹ_j = Λ^-½ Uᵀ B_j: eq. 2 times λ^½.
//! - [`Extrapolation::Orthogonal`]: one-shot orthogonalisation. With F = WᵣᵀUΛ^-½ over all nodes and node weights m
//!   (areas, or 1), M = Fᵀ diag(m) F = QμQᵀ, E = FQ: μ and E are the exact eigenpairs of the approximated W̄ = FFᵀ in
//!   the inner product of m. Plain vectors are not orthogonal beyond the sample, and stop converging near l = 50. Small
//!   eigenvalues must be damped ([`KeptEigenpairs::damped`]): without damping it is worse than plain.
//!
//! Cost: a pass over the columns for [`Extrapolation::Orthogonal`], O(n l r); O(l d) per node to embed.
//!
//! [`OrthogonalEmbedding`] is the same on a mesh's rows, scalable, for correspondence. The plain version
//! ([`Eigenvectors::Plain`]) has the features of eq. 1 times √λ, as in §7.1. However, eigenvectors of A are not those
//! of the whole matrix. Orthogonalised by shares of area ([`Eigenvectors::Orthogonal`]), they are principal axes of the
//! surface in feature space, whatever the density of its vertices, which makes two triangulations comparable. Hard
//! truncation could decide differently on two meshes that hardly differ, so neither end is truncated: small eigenvalues
//! of A are damped, and the first omitted variance of the axes, μ_{k+1}, is subtracted from all variances μ (e_i is
//! scaled by √(1 − μ_{k+1}/μ_i)), so that an axis that nearly dropped out has almost no weight. On 24 decimated series,
//! with 20 landmarks aligned by ground truth, damping reduced the error of matches from .0137 to .0118, and this fading
//! to .0104. A vertex costs l exponentials and 8 l multiply-adds. Fitting is one pass over all rows, l² multiply-adds
//! per vertex in `f64`. A point is 8 `f32`, with zeros beyond the requested dimensions: 32 bytes per vertex on disk.

use super::affinity::{CHUNK, KeptEigenpairs, SampledBlock, landmark_affinities};
use super::kernel::{Kernel, check_width};
use crate::base::error::LESS_WORK;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::{Error, Result, eigen};
use crate::distance::DistanceRows;
use crate::graph::Node;
use crate::store::budget::Grant;
use crate::store::needs::BESIDE_BUDGET;
use crate::store::{Context, MappedSlice, Run};
use nalgebra::{DMatrix, DMatrixView};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// How coordinates are extended from the sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Extrapolation {
    /// Eq. 1–2.
    #[default]
    Plain,
    /// Eq. 4.
    Kpca,
    /// Orthogonalised over all nodes.
    Orthogonal,
}

/// An additional scaling of the eigenvectors. [`Extrapolation::Kpca`] already scales the features: with
/// [`Scaling::None`] it is eq. 4.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scaling {
    /// λ^½: distances in the embedding equal those in feature space.
    Root,
    /// λ^-½.
    InverseRoot,
    /// Nothing.
    #[default]
    None,
}

impl Scaling {
    fn of(self, value: f64) -> f64 {
        match self {
            Self::Root => value.sqrt(),
            Self::InverseRoot => 1. / value.sqrt(),
            Self::None => 1.,
        }
    }
}

/// Parameters of the extension.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ExtensionParams {
    /// How coordinates are extended.
    pub extrapolation: Extrapolation,
    /// How they are scaled.
    pub scaling: Scaling,
    /// Maximum number of coordinates.
    pub dimensions: usize,
    /// Share of A's greatest eigenvalue up to which eigenpairs are dropped ([`KeptEigenpairs::of`]) or damped
    /// ([`KeptEigenpairs::damped`]).
    pub tolerance: f64,
}

impl ExtensionParams {
    /// An extension without scaling.
    pub fn new(extrapolation: Extrapolation, dimensions: usize, tolerance: f64) -> Self {
        Self { extrapolation, scaling: Scaling::None, dimensions, tolerance }
    }

    /// The same, scaled.
    pub fn scaled(self, scaling: Scaling) -> Self {
        Self { scaling, ..self }
    }
}

/// A fitted extension: y_j = mapᵀ B_j.
///
/// ```
/// use nystrom_stream::spectral::Kernel;
/// use nystrom_stream::spectral::affinity::{AffinityBlock, Bandwidth};
/// use nystrom_stream::spectral::nystrom::{ExtensionParams, Extrapolation, NystromExtension};
/// use nystrom_stream::store::Run;
///
/// # fn main() -> nystrom_stream::base::Result<()> {
/// // Distances of four nodes on a line from two landmarks, the nodes 0 and 3.
/// let rows = [[0., 1., 2., 3.], [3., 2., 1., 0f32]];
/// let rows = rows.iter().map(|row| &row[..]).collect();
/// let block = AffinityBlock::new(&[0, 3], rows, Kernel::Exponential, Bandwidth::Global(1.));
/// let params = ExtensionParams::new(Extrapolation::Plain, 2, 1e-3);
/// let y = NystromExtension::fit(&block, params, None, &Run::new(&()))?.embed(&block);
/// assert_eq!(y.shape(), (4, 2));
/// // At the landmarks it is A's own eigenvector, of unit length (eq. 1).
/// assert!((y[(0, 0)].powi(2) + y[(3, 0)].powi(2) - 1.).abs() < 1e-9);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct NystromExtension {
    /// l × d.
    pub map: DMatrix<f64>,
    /// The eigenvalues of the d coordinates, descending: of A, or of the approximated W̄.
    pub values: Vec<f64>,
}

/// The weight of a node, by its number.
pub type NodeWeight<'a> = &'a (dyn Fn(usize) -> f64 + Sync);

impl NystromExtension {
    /// Fits the extension on `block`. `weights` are the node weights for [`Extrapolation::Orthogonal`], 1 by default.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn fit(
        block: &dyn SampledBlock,
        params: ExtensionParams,
        weights: Option<NodeWeight<'_>>,
        run: &Run,
    ) -> Result<Self> {
        let ExtensionParams { extrapolation: how, scaling, dimensions: d, tolerance } = params;
        let kept = KeptEigenpairs::of(block.sampled(), tolerance);
        let (mut map, values) = match how {
            Extrapolation::Plain | Extrapolation::Kpca => (kept.roots(), kept.values),
            Extrapolation::Orthogonal => {
                let roots = KeptEigenpairs::damped(block.sampled(), tolerance);
                let (values, q) = eigen::symmetric(moments(block, &roots, weights, run)?);
                (roots * q, values)
            }
        };
        let d = d.min(values.len());
        map = map.columns(0, d).into_owned();
        for (mut column, &value) in map.column_iter_mut().zip(&values) {
            let value = value.max(1e-300);
            // So far the map gives coordinates times λ^½.
            let features = if how == Extrapolation::Kpca { 1. } else { 1. / value.sqrt() };
            column *= features * scaling.of(value);
        }
        Ok(Self { map, values: values[..d].to_vec() })
    }

    /// Coordinates of all nodes (n × d): for sets that fit in memory.
    pub fn embed(&self, block: &dyn SampledBlock) -> DMatrix<f64> {
        let (n, d) = (block.nodes(), self.map.ncols());
        let mut out = DMatrix::zeros(n, d);
        for k in 0..chunk_count(n, CHUNK) {
            let range = chunk_range(n, CHUNK, k);
            out.rows_mut(range.start, range.len()).copy_from(&self.chunk(block, range));
        }
        out
    }

    /// Coordinates of the nodes in `range` (m × d).
    pub fn chunk(&self, block: &dyn SampledBlock, range: Range<usize>) -> DMatrix<f64> {
        let mut columns = vec![0.; block.len() * range.len()];
        block.columns(range.clone(), &mut columns);
        let mut y = DMatrix::from_vec(range.len(), block.len(), columns) * &self.map;
        if let Some(scale) = block.scale(range) {
            for (mut row, scale) in y.row_iter_mut().zip(scale) {
                row *= scale;
            }
        }
        y
    }
}

/// M = Fᵀ diag(m) F, F = Wᵣᵀ `map` (r × r), for a map of l × r.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn moments(
    block: &dyn SampledBlock,
    map: &DMatrix<f64>,
    weights: Option<NodeWeight<'_>>,
    run: &Run,
) -> Result<DMatrix<f64>> {
    let (l, n, r) = (block.len(), block.nodes(), map.ncols());
    let chunk = |k: usize, columns: &mut Vec<f64>| {
        let range = chunk_range(n, CHUNK, k);
        columns.resize(l * range.len(), 0.);
        block.columns(range.clone(), columns);
        let f = DMatrixView::from_slice(columns, range.len(), l) * map;
        let mut weighted = f.clone();
        if let Some(weight) = weights {
            for (mut row, node) in weighted.row_iter_mut().zip(range) {
                row *= weight(node);
            }
        }
        Ok(f.tr_mul(&weighted))
    };
    let mut sum = DMatrix::zeros(r, r);
    run.in_order(chunk_count(n, CHUNK), Vec::new, chunk, |_, part| {
        sum += part;
        Ok(())
    })?;
    Ok(sum)
}

/// Maximum number of coordinates.
pub const MOST_DIMENSIONS: usize = 8;
/// A vertex in the embedding, with zeros beyond the dimensions in use.
pub type Point = [f32; MOST_DIMENSIONS];

/// Vertices per chunk.
const VERTICES_PER_CHUNK: usize = 1 << 12;

/// The kind of eigenvectors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Eigenvectors {
    /// Those of A, extrapolated: the paper's.
    Plain,
    /// Those of the approximated whole matrix, weighted by area.
    #[default]
    Orthogonal,
}

/// Parameters of the embedding.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OrthogonalParams {
    /// From distance to affinity.
    pub kernel: Kernel,
    /// The kernel's width, relative to the mean distance.
    pub width: f64,
    /// Coordinates k, 2 to [`MOST_DIMENSIONS`].
    pub dimensions: usize,
    /// Which eigenvectors.
    pub eigenvectors: Eigenvectors,
}

impl Default for OrthogonalParams {
    fn default() -> Self {
        Self { kernel: Kernel::Gaussian, width: 1., dimensions: 8, eigenvectors: Eigenvectors::Orthogonal }
    }
}

impl OrthogonalParams {
    /// Checks that the constants are in range.
    ///
    /// # Errors
    /// [`Error::Parameter`] for numbers out of range.
    pub fn check(&self) -> Result<()> {
        if !(2..=MOST_DIMENSIONS).contains(&self.dimensions) {
            let problem = format!("{} is out of range", self.dimensions);
            return Err(Error::parameter("dimensions", problem, format!("choose from 2 to {MOST_DIMENSIONS}")));
        }
        check_width(self.width)?;
        self.kernel.check()
    }
}

/// A fitted embedding.
#[derive(Clone, Debug)]
pub struct OrthogonalEmbedding {
    kernel: Kernel,
    /// The kernel's width, in units of the rows.
    pub sigma: f64,
    /// Number of coordinates k: as many as requested, or fewer if there are not as many.
    pub dimensions: usize,
    /// k rows of l: e = map · w.
    map: Vec<f32>,
    landmarks: usize,
    /// Variance (mean square by area) of each coordinate (k), descending with [`Eigenvectors::Orthogonal`].
    pub variance: Vec<f64>,
}

/// Rows under a kernel.
struct RowAffinities<'a> {
    rows: &'a DistanceRows,
    kernel: Kernel,
    sigma: f64,
}

impl SampledBlock for RowAffinities<'_> {
    fn landmarks(&self) -> &[u32] {
        &self.rows.landmarks
    }

    fn nodes(&self) -> usize {
        self.rows.nodes
    }

    fn columns(&self, range: Range<usize>, out: &mut [f64]) {
        let mut affinities = vec![0f32; range.len()];
        for (j, out) in out.chunks_exact_mut(range.len()).enumerate() {
            self.kernel.apply(self.sigma as f32, &self.rows.row(j)[range.clone()], &mut affinities);
            out.iter_mut().zip(&affinities).for_each(|(out, &w)| *out = f64::from(w));
        }
    }

    fn sampled(&self) -> DMatrix<f64> {
        landmark_affinities(self.rows, self.kernel, self.sigma)
    }
}

/// Each vertex's share of the total area; equal shares if there is none.
pub(super) fn area_shares(nodes: &[Node]) -> impl Fn(usize) -> f64 + Sync + '_ {
    let total: f64 = nodes.iter().map(|node| f64::from(node.area)).sum();
    move |v| if total > 0. { f64::from(nodes[v].area) / total } else { 1. / nodes.len() as f64 }
}

/// Mean of all distances of `rows`, weighted by area.
fn mean_distance(rows: &DistanceRows, nodes: &[Node]) -> f64 {
    let total: f64 = nodes.iter().map(|node| f64::from(node.area)).sum();
    if total <= 0. {
        return rows.mean();
    }
    let (mut sum, mut weight) = (0f64, 0f64);
    for k in 0..rows.len() {
        for (&d, node) in rows.row(k).iter().zip(nodes) {
            if d < f32::INFINITY {
                sum += f64::from(d) * f64::from(node.area);
                weight += f64::from(node.area);
            }
        }
    }
    if weight > 0. { sum / weight } else { rows.mean() }
}

impl OrthogonalEmbedding {
    /// What [`OrthogonalEmbedding::fit`] takes from the budget for `landmarks` landmarks, and the run on as many
    /// threads as that has room for.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn memory<'a>(landmarks: usize, run: &Run<'a>) -> Result<(Run<'a>, Grant)> {
        let l = landmarks as u64;
        // Matrices among landmarks, some of them per thread; columns of a chunk, their coordinates, and these weighted.
        let bytes = (32 * l * l, 16 * l * l + 24 * CHUNK as u64 * l);
        run.threads_beside("an embedding with so many landmarks", bytes, BESIDE_BUDGET)
            .map_err(|error| error.with_remedy(LESS_WORK))
    }

    /// Fits the embedding on all of `rows`, over vertices with the areas in `nodes`.
    ///
    /// # Errors
    /// [`Error::Parameter`], [`Error::Cancelled`].
    pub fn fit(rows: &DistanceRows, nodes: &[Node], params: OrthogonalParams, run: &Run) -> Result<Self> {
        params.check()?;
        let (run, _grant) = &Self::memory(rows.len(), run)?;
        let sigma = params.width * mean_distance(rows, nodes);
        let share = area_shares(nodes);
        let block = RowAffinities { rows, kernel: params.kernel, sigma };
        let tolerance = params.kernel.tolerance(rows.len());
        let fit = |params| NystromExtension::fit(&block, params, Some(&share), run);
        let (axes, variance) = match params.eigenvectors {
            Eigenvectors::Plain => {
                let map = fit(ExtensionParams::new(Extrapolation::Kpca, params.dimensions, tolerance))?.map;
                let variance = moments(&block, &map, Some(&share), run)?.diagonal();
                (map, variance.as_slice().to_vec())
            }
            Eigenvectors::Orthogonal => {
                let params_of_axes = ExtensionParams::new(Extrapolation::Orthogonal, params.dimensions + 1, tolerance);
                let NystromExtension { mut map, values, .. } = fit(params_of_axes.scaled(Scaling::Root))?;
                let next = values.get(params.dimensions).copied().unwrap_or(0.).max(0.);
                let variance: Vec<f64> = values.iter().take(params.dimensions).map(|value| value - next).collect();
                map = map.columns(0, variance.len()).into_owned();
                for ((mut column, value), faded) in map.column_iter_mut().zip(&values).zip(&variance) {
                    column *= (faded / value.max(1e-300)).max(0.).sqrt();
                }
                (map, variance)
            }
        };
        // The first coordinate is nearly constant; make it positive.
        let sign = |i: usize| if i == 0 && axes.column(0).sum() < 0. { -1. } else { 1. };
        let map = axes.column_iter().enumerate();
        let map = map.flat_map(|(i, axis)| axis.iter().map(|x| (sign(i) * x) as f32).collect::<Vec<_>>()).collect();
        Ok(Self { kernel: params.kernel, sigma, dimensions: variance.len(), map, landmarks: rows.len(), variance })
    }

    /// Embeds all vertices of `rows` into the file `name` of `work`. The landmarks are those of the fit, or the
    /// corresponding ones on another mesh, with `sigma` as its width.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn embed(
        &self,
        rows: &DistanceRows,
        sigma: f64,
        name: &str,
        context: Context<'_>,
    ) -> Result<MappedSlice<Point>> {
        let n = rows.nodes;
        let mut array = context.work.array::<Point>(name, &[n, MOST_DIMENSIONS])?;
        let fill = |chunk: usize, out: &mut [Point], affinities: &mut Vec<f32>| {
            let range = chunk_range(n, VERTICES_PER_CHUNK, chunk);
            affinities.resize(range.len(), 0.);
            out.fill([0.; MOST_DIMENSIONS]);
            for j in 0..self.landmarks {
                self.kernel.apply(sigma as f32, &rows.row(j)[range.clone()], affinities);
                let mut factors = [0f32; MOST_DIMENSIONS];
                (0..self.dimensions).for_each(|i| factors[i] = self.map[i * self.landmarks + j]);
                for (point, &w) in out.iter_mut().zip(affinities.iter()) {
                    for (x, factor) in point.iter_mut().zip(factors) {
                        *x += factor * w;
                    }
                }
            }
            Ok(())
        };
        context.run.fill_chunks(array.data(), VERTICES_PER_CHUNK, Vec::new, fill)?;
        array.finish(false)
    }

    /// The width of this kind of embedding for other rows: `width` times the mean of their distances.
    pub fn width_on(rows: &DistanceRows, nodes: &[Node], width: f64) -> f64 {
        width * mean_distance(rows, nodes)
    }
}
