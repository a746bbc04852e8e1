//! The embedding of faces: fitted on sampled columns, extrapolated to any face from its own column.
//!
//! Fits (degrees, anchor shares, K-means) are averages over the surface, so a constant number of columns suffices:
//! [`MOST_COLUMNS`] faces, one per equal quantum of area in node order, stratified and seeded; every face of a small
//! mesh. Only what concerns every face (labels, Γ) streams over all columns. Memory: 4 (l + d) [`MOST_COLUMNS`] bytes.
//! Cost: one pass over areas, `MOST_COLUMNS · l` random reads.
//!
//! There are three normalisations of one form. With k the l affinities of a face, each is y = (Mᵀk + m₀)/s with s = 1,
//! or linear in k, or the square root of that; then optionally normalised to unit length. Only the fit of M, m₀, s
//! differs:
//! - [`Normalisation::None`], eq. 1–2: A = UΛUᵀ, M = UΛ⁻¹ on the kept eigenpairs.
//! - [`Normalisation::Degree`]: D^-½ W D^-½ with the degrees of the Nyström approximation, d = kᵀA⁺(W's row sums);
//!   these use A and the sample.
//! - [`Normalisation::Anchor`] (default): landmarks as anchors of a bipartite graph, z = v∘k + ε v (v: share of area
//!   nearest to each), columns divided by their sums, G = Φ diag(a) Φᵀ. Positive by construction, so the indefiniteness
//!   of the Gaussian does no harm; A itself is not inverted. ([`super::anchor`] builds the same graph over cells, in
//!   `f64` and without a map in `f32`; shared code is there.)
//!
//! Cost of extrapolation: l exponentials and l·d multiply-adds per face, vectorised over faces.

use super::affinity::{Degrees, KeptEigenpairs, landmark_affinities};
use super::anchor::{BACKGROUND, RowProducts, nearest_shares};
use super::kernel::{Kernel, check_width};
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::printable::Significant;
use crate::base::random::{stratified, stream};
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::vector::axpy;
use crate::base::{Error, Result, eigen};
use crate::distance::DistanceRows;
use crate::store::Run;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Faces that a thread embeds at once.
const FACES_PER_CHUNK: usize = 2048;
/// Maximum number of sampled columns.
pub const MOST_COLUMNS: usize = 1 << 14;

/// A sample of columns.
#[derive(Clone, Debug)]
pub struct SampledColumns {
    /// Their nodes (s), ascending.
    pub nodes: Vec<u32>,
    /// Their shares of the area (s), summing to 1.
    pub shares: Vec<f64>,
    /// Their distances: row k at `k * s` (l × s).
    pub distances: Vec<f32>,
}

/// Bytes that sampling and [`Embedding::fit`] allocate for `landmarks` landmarks on a mesh of `nodes` nodes (measured):
/// distances, affinities and anchor weights of the sampled columns, and matrices among the landmarks.
pub fn fit_bytes(landmarks: u64, nodes: u64) -> u64 {
    24 * landmarks * nodes.min(MOST_COLUMNS as u64) + 16 * landmarks * landmarks
}

impl SampledColumns {
    /// Samples the columns of `rows`; `area` gives the area of a node.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn sample(rows: &DistanceRows, area: impl Fn(usize) -> f32, run: &Run) -> Result<Self> {
        let n = rows.nodes;
        // They end early if a stop is requested.
        let goes_on = |i: usize| !i.is_multiple_of(STOP_CHECK) || !run.cancel.is_cancelled();
        let areas = || (0..n).take_while(|&i| goes_on(i)).map(|i| f64::from(area(i)));
        let total: f64 = areas().sum();
        run.cancel.check()?;
        let (chosen, mut shares): (Vec<u32>, Vec<f64>) = if n <= MOST_COLUMNS {
            // Areas have a lower bound, so that faces without area count if there are no others.
            let floor = 1e-6 * total.max(1e-30) / n as f64;
            (0..n as u32).map(|i| (i, f64::from(area(i as usize)).max(floor))).unzip()
        } else if total > 0. {
            // A face hit by several points counts several times.
            let points = stratified(areas(), total, MOST_COLUMNS, &mut stream(run.seed, "columns"));
            points.into_iter().map(|(node, hits)| (node, f64::from(hits))).unzip()
        } else {
            (0..MOST_COLUMNS).map(|k| ((k as u128 * n as u128 / MOST_COLUMNS as u128) as u32, 1.)).unzip()
        };
        let sum: f64 = shares.iter().sum();
        shares.iter_mut().for_each(|share| *share /= sum);
        run.cancel.check()?;
        let distances = distances(rows, &chosen, run)?;
        Ok(Self { nodes: chosen, shares, distances })
    }

    /// Number of columns s.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Row `k` of the distances (s).
    pub fn row(&self, k: usize) -> &[f32] {
        &self.distances[k * self.len()..(k + 1) * self.len()]
    }
}

/// Sampled nodes at most this far apart are read together with what lies between: fewer reads, at the cost of as many
/// bytes as a disk reads during one seek.
const NEAR: u32 = 4096;
/// Number of sampled nodes whose distances are requested at a time.
const ASKED: usize = 512;
/// Nodes between two checks of the stop flag.
const STOP_CHECK: usize = 1 << 18;

/// The distances of `nodes` (s, ascending) in `rows` (l × s).
fn distances(rows: &DistanceRows, nodes: &[u32], run: &Run) -> Result<Vec<f32>> {
    let mut distances = Vec::with_capacity(rows.len() * nodes.len());
    for k in 0..rows.len() {
        let row = rows.row(k);
        for some in nodes.chunks(ASKED) {
            run.cancel.check()?;
            let near = some.chunk_by(|a, b| b - a <= NEAR);
            run.will_need_few(row, near.map(|near| near[0] as usize..near[near.len() - 1] as usize + 1));
            distances.extend(some.iter().map(|&node| row[node as usize]));
        }
    }
    Ok(distances)
}

/// How affinities are normalised before the eigenproblem.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Normalisation {
    /// The affinities as they are (the paper's eq. 1).
    None,
    /// Divided by the square roots of both degrees.
    Degree,
    /// Anchor graph: divided by the anchors' sums, positive by construction.
    #[default]
    Anchor,
}

/// How σ is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "rule", content = "value")]
pub enum KernelWidth {
    /// This many times the mean of all computed distances; 1 is the paper's rule.
    Mean(f64),
    /// This distance.
    Fixed(f64),
}

/// How to embed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EmbeddingParams {
    /// From distance to affinity.
    pub kernel: Kernel,
    /// The kernel's width.
    pub width: KernelWidth,
    /// Normalisation of the affinities.
    pub normalisation: Normalisation,
    /// Number of coordinates wanted.
    pub dimensions: usize,
    /// Whether each face's coordinates are normalised to unit length.
    pub unit_rows: bool,
}

impl EmbeddingParams {
    /// The measured default for `parts` clusters: anchor graph, σ a quarter of the mean distance, unit rows.
    pub fn for_parts(parts: usize) -> Self {
        Self {
            kernel: Kernel::Gaussian,
            width: KernelWidth::Mean(0.25),
            normalisation: Normalisation::Anchor,
            dimensions: parts.max(2),
            unit_rows: true,
        }
    }

    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a width or a kernel out of range, or zero dimensions.
    pub fn check(&self) -> Result<()> {
        let (KernelWidth::Mean(width) | KernelWidth::Fixed(width)) = self.width;
        check_width(width)?;
        if self.dimensions == 0 {
            return Err(Error::parameter("dimensions", "0 dimensions", "choose at least 1"));
        }
        self.kernel.check()
    }
}

/// How s in y = (Mᵀk + m₀)/s depends on k.
#[derive(Clone, Debug)]
enum Divisor {
    One,
    /// kᵀc + c₀.
    Linear(Vec<f32>, f32),
    /// √max(kᵀc, floor).
    Root(Vec<f32>, f32),
}

/// A fitted embedding.
///
/// ```
/// use nystrom_stream::distance::{DistanceRows, rows::RowParams};
/// use nystrom_stream::graph::{DualGraph, Metric};
/// use nystrom_stream::landmarks::Sampling;
/// use nystrom_stream::mesh::Mesh;
/// use nystrom_stream::spectral::measures::Gamma;
/// use nystrom_stream::spectral::{Embedding, EmbeddingParams, SampledColumns};
/// use nystrom_stream::store::{Context, Run, WorkDir};
///
/// # fn main() -> nystrom_stream::base::Result<()> {
/// let run = Run::new(&());
/// let work = WorkDir::temporary(&std::env::temp_dir())?;
/// let context = Context::new(&work, &run);
/// let points = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.], [0.5, 0.5, 1f32]];
/// let mesh = Mesh::from_slices(&points, &[[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 3], [1, 3, 2]])?;
/// let graph = DualGraph::build(&mesh, "a pyramid".as_ref(), &"pyramid".into(), context)?;
/// let weighted = graph.weighted(Metric::Geodesic, context)?;
/// let params = RowParams { l: 3, sampling: Sampling::Farthest };
/// let rows = DistanceRows::build(&weighted, graph.nodes.view(), params, context)?;
///
/// let columns = SampledColumns::sample(&rows, |face| graph.nodes.at(face).area, &run)?;
/// let params = EmbeddingParams::for_parts(2);
/// let embedding = Embedding::fit(&rows, &columns, params)?;
/// // Two coordinates for each of six faces, each face of unit length.
/// let y = embedding.columns(&columns);
/// assert!((y[0] * y[0] + y[6] * y[6] - 1.).abs() < 1e-5);
///
/// // Γ (eq. 6): how well three landmarks stand for the other three faces.
/// let gamma = Gamma::new(&rows, params.kernel, embedding.sigma);
/// let (mut affinities, mut y) = (vec![0.; 3 * 6], vec![0.; 2 * 6]);
/// embedding.chunk(6, |landmark| rows.row(landmark), &mut affinities, &mut y);
/// let gamma = gamma.of_sum(gamma.chunk(6, &affinities));
/// assert!(gamma > 0.);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Embedding {
    kernel: Kernel,
    /// The kernel's width in distance units.
    pub sigma: f64,
    /// Landmarks l.
    landmarks: usize,
    /// Coordinates d.
    pub dimensions: usize,
    /// M, d rows of l.
    map: Vec<f32>,
    /// m₀ (d).
    offset: Vec<f32>,
    divisor: Divisor,
    unit_rows: bool,
    /// Eigenvalues, descending: of A (or its normalised form), or of G.
    pub eigenvalues: Vec<f64>,
    /// Eigenpairs of A that were dropped (λ ≤ ε λ_max).
    pub dropped: usize,
    /// Σ|λ < 0| / Σ|λ| of A.
    pub negative_mass: f64,
}

impl Embedding {
    /// Fits the embedding on `columns` of `rows`.
    ///
    /// # Errors
    /// [`Error::Parameter`] for a width or kernel out of range.
    pub fn fit(rows: &DistanceRows, columns: &SampledColumns, params: EmbeddingParams) -> Result<Self> {
        params.kernel.check()?;
        let sigma = match params.width {
            KernelWidth::Mean(factor) => factor * rows.mean(),
            KernelWidth::Fixed(sigma) => sigma,
        };
        if !sigma.is_finite() || sigma < 0. {
            let problem = format!("{} is not a width", Significant(sigma));
            return Err(Error::parameter("width", problem, "choose a positive number"));
        }
        let a = landmark_affinities(rows, params.kernel, sigma);
        let fit = EmbeddingFit { rows, columns, params, sigma };
        match params.normalisation {
            Normalisation::None => Ok(fit.plain(a)),
            Normalisation::Degree => Ok(fit.degree(a)),
            Normalisation::Anchor => Ok(fit.anchor(a)),
        }
    }

    /// Embeds a chunk of `m` faces. `distances(k)` returns their distances from landmark k (m); `affinities` receives l
    /// rows of m, the kernel values; `out` receives d rows of m.
    pub fn chunk<'a>(&self, m: usize, distances: impl Fn(usize) -> &'a [f32], affinities: &mut [f32], out: &mut [f32]) {
        debug_assert_eq!(affinities.len(), self.landmarks * m);
        for (k, row) in affinities.chunks_exact_mut(m).enumerate() {
            self.kernel.apply(self.sigma as f32, distances(k), row);
        }
        dispatch(Extrapolated { embedding: self, m, affinities, out });
    }

    /// Embeds all faces of `rows` in parallel chunks, with progress reported as `stage`. `consume` receives the chunks
    /// in order: a range of m nodes, and d rows of their m coordinates. Memory: 4 (l + d) bytes for each of 2048 faces
    /// per thread; the budget may limit the number of threads.
    ///
    /// # Errors
    /// Those of `consume`; [`Error::Cancelled`].
    pub fn for_each_chunk(
        &self,
        rows: &DistanceRows,
        stage: &str,
        run: &Run,
        mut consume: impl FnMut(Range<usize>, &[f32]) -> Result<()>,
    ) -> Result<()> {
        let n = rows.nodes;
        let embed = |k: usize, affinities: &mut Vec<f32>| {
            let range = chunk_range(n, FACES_PER_CHUNK, k);
            let m = range.len();
            let mut coordinates = vec![0.; m * self.dimensions];
            affinities.resize(rows.len() * m, 0.);
            self.chunk(m, |row| &rows.row(row)[range.clone()], affinities, &mut coordinates);
            run.progress.advance(stage, m as u64);
            Ok(coordinates)
        };
        let consume = |k: usize, coordinates: Vec<f32>| consume(chunk_range(n, FACES_PER_CHUNK, k), &coordinates);
        // Includes the chunks of coordinates that wait to be consumed.
        let bytes = 4 * FACES_PER_CHUNK * (rows.len() + 5 * self.dimensions);
        let (run, _grant) = run.threads_within(bytes as u64);
        run.in_order(chunk_count(n, FACES_PER_CHUNK), Vec::new, embed, consume)
    }

    /// Embeds the sampled columns: d rows of s.
    pub fn columns(&self, columns: &SampledColumns) -> Vec<f32> {
        let s = columns.len();
        let mut out = vec![0.; self.dimensions * s];
        self.chunk(s, |k| columns.row(k), &mut vec![0.; self.landmarks * s], &mut out);
        out
    }
}

/// The pass of [`Embedding::chunk`] over affinities (l rows of m), for [`dispatch`].
struct Extrapolated<'a> {
    embedding: &'a Embedding,
    m: usize,
    affinities: &'a [f32],
    out: &'a mut [f32],
}

impl SimdKernel for Extrapolated<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { embedding, m, affinities, out } = self;
        for (y, &start) in out.chunks_exact_mut(m).zip(&embedding.offset) {
            y.fill(start);
        }
        let mut divisor = match &embedding.divisor {
            Divisor::One => Vec::new(),
            Divisor::Linear(_, start) => vec![*start; m],
            Divisor::Root(..) => vec![0.; m],
        };
        for (k, affinities) in affinities.chunks_exact(m).enumerate() {
            for (y, map) in out.chunks_exact_mut(m).zip(embedding.map.chunks_exact(embedding.landmarks)) {
                axpy(y, map[k], affinities);
            }
            if let Divisor::Linear(c, _) | Divisor::Root(c, _) = &embedding.divisor {
                axpy(&mut divisor, c[k], affinities);
            }
        }
        if embedding.unit_rows {
            unit_columns(m, out, &mut divisor);
            return;
        }
        if let Divisor::Root(_, floor) = embedding.divisor {
            divisor.iter_mut().for_each(|s| *s = s.max(floor).sqrt());
        }
        for y in out.chunks_exact_mut(m) {
            for i in 0..divisor.len() {
                y[i] /= divisor[i];
            }
        }
    }
}

/// Normalises each face's coordinates to unit length; `scratch` is resized to m.
#[inline(always)]
fn unit_columns(m: usize, out: &mut [f32], scratch: &mut Vec<f32>) {
    scratch.clear();
    scratch.resize(m, 1e-30);
    for y in out.chunks_exact(m) {
        for (s, &y) in scratch.iter_mut().zip(y) {
            *s += y * y;
        }
    }
    scratch.iter_mut().for_each(|s| *s = 1. / s.sqrt());
    for y in out.chunks_exact_mut(m) {
        for (y, &s) in y.iter_mut().zip(scratch.iter()) {
            *y *= s;
        }
    }
}

/// Common data of the fits.
struct EmbeddingFit<'a> {
    rows: &'a DistanceRows,
    columns: &'a SampledColumns,
    params: EmbeddingParams,
    sigma: f64,
}

impl EmbeddingFit<'_> {
    /// The eigenpairs of `a` above the level of rounding and indefiniteness.
    fn kept(&self, a: DMatrix<f64>) -> KeptEigenpairs {
        let tolerance = self.params.kernel.tolerance(a.nrows());
        KeptEigenpairs::of(a, tolerance)
    }

    fn embedding(
        &self,
        map: Vec<f32>,
        offset: Vec<f32>,
        divisor: Divisor,
        eigenvalues: Vec<f64>,
        a: &KeptEigenpairs,
    ) -> Embedding {
        Embedding {
            kernel: self.params.kernel,
            sigma: self.sigma,
            landmarks: self.rows.len(),
            dimensions: offset.len(),
            map,
            offset,
            // With unit length, the divisor cancels.
            divisor: if self.params.unit_rows { Divisor::One } else { divisor },
            unit_rows: self.params.unit_rows,
            eigenvalues,
            dropped: a.dropped(),
            negative_mass: a.negative_mass(),
        }
    }

    /// The affinities of the sampled columns with landmark `k` (s).
    fn affinities(&self, k: usize) -> Vec<f32> {
        let mut out = vec![0.; self.columns.len()];
        self.params.kernel.apply(self.sigma as f32, self.columns.row(k), &mut out);
        out
    }

    fn plain(&self, a: DMatrix<f64>) -> Embedding {
        let l = a.nrows();
        let kept = self.kept(a);
        let d = self.params.dimensions.min(kept.values.len());
        let pairs = (0..d).flat_map(|c| (0..l).map(move |k| (c, k)));
        let map = pairs.map(|(c, k)| (kept.vectors[(k, c)] / kept.values[c]) as f32).collect();
        self.embedding(map, vec![0.; d], Divisor::One, kept.all.clone(), &kept)
    }

    fn degree(&self, a: DMatrix<f64>) -> Embedding {
        let l = a.nrows();
        let n = self.rows.nodes as f64;
        let kept = self.kept(a.clone());
        // Row sums of W over all faces, estimated on the sample: n times the area mean.
        let sums: Vec<f64> = (0..l)
            .map(|k| {
                let row = self.affinities(k);
                n * row.iter().zip(&self.columns.shares).map(|(&w, &share)| f64::from(w) * share).sum::<f64>()
            })
            .collect();
        let Degrees { toward, floor, roots } = Degrees::of(&kept, &sums);
        let normalised = DMatrix::from_fn(l, l, |i, j| a[(i, j)] / (roots[i] * roots[j]));
        let KeptEigenpairs { values, vectors, all } = self.kept(normalised);
        let d = self.params.dimensions.min(values.len());
        let mut map = Vec::with_capacity(d * l);
        for e in 0..d {
            map.extend((0..l).map(|k| (vectors[(k, e)] / (values[e] * roots[k])) as f32));
        }
        let divisor = Divisor::Root(toward.iter().map(|&c| c as f32).collect(), floor as f32);
        let dropped = l - values.len();
        Embedding { dropped, ..self.embedding(map, vec![0.; d], divisor, all, &kept) }
    }

    fn anchor(&self, a: DMatrix<f64>) -> Embedding {
        let l = a.nrows();
        let kept = self.kept(a);
        let s = self.columns.len();
        let shares = &self.columns.shares;
        let k: Vec<Vec<f32>> = (0..l).map(|row| self.affinities(row)).collect();
        let v = nearest_shares((0..l).map(|k| self.columns.row(k)), shares);
        // ε: a share of the mean weight, so that a face far from all anchors is still defined.
        let mean: f64 = (0..s).map(|j| shares[j] * (0..l).map(|i| v[i] * f64::from(k[i][j])).sum::<f64>()).sum();
        let epsilon = BACKGROUND * mean.max(1e-30);
        let mut z = DMatrix::<f64>::zeros(l, s);
        for j in 0..s {
            let mut sum = 0.;
            for i in 0..l {
                z[(i, j)] = v[i] * (f64::from(k[i][j]) + epsilon);
                sum += z[(i, j)];
            }
            for i in 0..l {
                z[(i, j)] /= sum;
            }
        }
        let c: Vec<f64> = (0..l).map(|i| (0..s).map(|j| z[(i, j)] * shares[j]).sum::<f64>().max(1e-30)).collect();
        for j in 0..s {
            let root = shares[j].sqrt();
            for i in 0..l {
                z[(i, j)] *= root / c[i].sqrt();
            }
        }
        let rows = z.transpose();
        let (values, vectors) = eigen::symmetric(dispatch(RowProducts { rows: rows.as_slice(), l, n: s }));
        let d = self.params.dimensions.min(l);
        let top = values.first().copied().unwrap_or(1.).max(1e-30);
        // X = Φᵀ Q / √g · √(g/g₀) = Φᵀ Q / √g₀, Φ = Z/√c, Z = (v∘k + ε v)/sum.
        let mut map = Vec::with_capacity(d * l);
        let mut offset = Vec::with_capacity(d);
        for e in 0..d {
            let row: Vec<f64> = (0..l).map(|i| vectors[(i, e)] * v[i] / (c[i].sqrt() * top.sqrt())).collect();
            offset.push((epsilon * row.iter().sum::<f64>()) as f32);
            map.extend(row.iter().map(|&x| x as f32));
        }
        let divisor = Divisor::Linear(v.iter().map(|&v| v as f32).collect(), epsilon as f32);
        self.embedding(map, offset, divisor, values, &kept)
    }
}
