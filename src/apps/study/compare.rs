//! Samplings × numbers of landmarks × seeds on one mesh, with one σ: Fig. 5 of the paper, in numbers; and the distance
//! of the extrapolated embeddings from the true one.
//!
//! Most samplings are nested ([`Sampling::is_nested`]), so each is run once per seed, with the greatest l; one that is
//! not is run for every l. Runs are distributed over threads. Memory per thread, from the budget: a field of 4 n bytes,
//! and matrices of the landmarks. Rows are in the matrix of all distances, or in mapped files that are removed with the
//! run.
//!
//! The true embedding ([`embedding_errors`]) consists of the leading eigenvectors of all of W times the square roots of
//! their eigenvalues; weighted by area, those of M^½WM^½, times M^-½. Coordinates are compared after the best rotation.
//! Only for small sets: all of W in `f64`.

use super::data::StudyData;
use crate::base::error::LESS_WORK;
use crate::base::printable::Significant;
use crate::base::printable::counted;
use crate::base::{Error, Result};
use crate::distance::front::{Front, mean_weight};
use crate::distance::sampler::VisitCount;
use crate::landmarks::{GraphSpace, MatrixSpace, Sampling, SamplingParams, SearchGraph, Space};
use crate::spectral::affinity::{AffinityBlock, Bandwidth, CHUNK, KeptEigenpairs, SampledBlock};
use crate::spectral::kernel::Kernel;
use crate::spectral::measures::{Measures, TrueErrors, aligned_error, exact, leading, measure};
use crate::spectral::nystrom::{ExtensionParams, Extrapolation, NodeWeight, NystromExtension, Scaling};
use crate::store::needs::BESIDE_BUDGET;
use crate::store::{Context, MappedSlice, Run};
use nalgebra::DMatrix;
use serde::Serialize;

/// How the width of the measures' kernel is chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StudyWidth {
    /// This many times the mean distance, the same everywhere.
    Mean(f64),
    /// By the distances to the q-th nearest landmark ([`Bandwidth::Local`]).
    Local(usize),
}

impl StudyWidth {
    /// The bandwidth on a mesh with the mean distance `mean`.
    fn bandwidth(self, mean: f64) -> Bandwidth {
        match self {
            Self::Mean(factor) => Bandwidth::Global(factor * mean),
            Self::Local(q) => Bandwidth::Local(q),
        }
    }
}

/// What to compare.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct CompareParams {
    /// Samplings.
    pub samplings: Vec<Sampling>,
    /// Numbers of landmarks.
    pub landmarks: Vec<usize>,
    /// Seeds.
    pub seeds: Vec<u64>,
    /// Kernel of the measures.
    pub kernel: Kernel,
    /// Its width.
    pub width: StudyWidth,
    /// Eigenvalues of A up to this share of the greatest are dropped; by default [`Kernel::tolerance`].
    pub tolerance: Option<f64>,
    /// Kernel of Γ used by greedy sampling and pivoted Cholesky; its width is the mean distance.
    pub gamma_kernel: Kernel,
    /// Whether the residual over all of W is computed, if all distances are known.
    pub residual: bool,
    /// Whether the Schur complement and the eigenvectors are evaluated too: O(n³).
    pub schur: bool,
}

impl Default for CompareParams {
    fn default() -> Self {
        Self {
            samplings: vec![Sampling::default()],
            landmarks: vec![10],
            seeds: vec![0],
            kernel: Kernel::Exponential,
            width: StudyWidth::Mean(1.),
            tolerance: None,
            gamma_kernel: Kernel::Exponential,
            residual: false,
            schur: false,
        }
    }
}

crate::base::setters::setters!(CompareParams {
    samplings: Vec<Sampling>,
    landmarks: Vec<usize>,
    seeds: Vec<u64>,
    kernel: Kernel,
    width: StudyWidth,
    tolerance: Option<f64>,
    gamma_kernel: Kernel,
    residual: bool,
    schur: bool,
});

impl CompareParams {
    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// [`Error::Parameter`] for no or 0 landmarks, no sampling, no seed, a width that is not positive, or a local width
    /// by more landmarks than there are.
    pub fn check(&self) -> Result<()> {
        let refused = |name: &str, problem: &str, remedy: &str| Err(Error::parameter(name, problem, remedy));
        if self.landmarks.is_empty() || self.landmarks.contains(&0) {
            return refused("landmarks", "0 landmarks", "choose at least 1");
        }
        if self.samplings.is_empty() {
            return refused("sampling", "none is given", "give at least one");
        }
        if self.seeds.is_empty() {
            return refused("seeds", "none is given", "measure under at least one");
        }
        if let StudyWidth::Mean(factor) = self.width
            && !(factor > 0. && factor.is_finite())
        {
            let problem = format!("{} is not a positive number", Significant(factor));
            return refused("width", &problem, "give a number of mean distances");
        }
        let least = self.landmarks.iter().copied().min().unwrap_or(0);
        if let StudyWidth::Local(q) = self.width
            && !(1..=least).contains(&q)
        {
            let problem = format!("{} have no nearest one of number {q}", counted(least, "landmark"));
            return refused("local", &problem, &format!("choose from 1 to {least}"));
        }
        self.kernel.check()
    }
}

/// One sample and its quality.
#[derive(Clone, Debug, Serialize)]
pub struct SampleRecord {
    /// The mesh.
    pub mesh: String,
    /// The sampling.
    pub sampling: Sampling,
    /// Number of landmarks l.
    pub l: usize,
    /// Seed.
    pub seed: u64,
    /// Number of nodes n.
    pub nodes: usize,
    /// σ, in units of distance; absent if local.
    pub sigma: Option<f64>,
    /// The cost of the search, in fronts (Dijkstra's algorithm over all nodes), besides the l rows.
    pub search_fronts: f64,
    /// The measures.
    #[serde(flatten)]
    pub measures: Measures,
    /// ‖W − W̄‖ / ‖W‖, Frobenius, if requested and possible.
    pub residual: Option<f64>,
    /// Errors that need all of W, if requested and possible.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exact: Option<TrueErrors>,
    /// Landmarks, in the order in which they were found.
    #[serde(skip)]
    pub landmarks: Vec<u32>,
}

/// Bytes per pair of landmarks while a sample is measured: affinities, eigenvectors and roots.
const MATRICES: u64 = 40;
/// Bytes per landmark and column of a chunk.
const COLUMNS: u64 = 16;
/// Maximum number of eigenvectors that are compared with true ones.
pub const VECTORS: usize = 6;

/// Runs the comparison on `ground`, the mesh called `mesh`: one record per sampling, number of landmarks and seed. More
/// landmarks than nodes means all nodes. Repeated values are measured once, so that no sample counts twice.
///
/// # Errors
/// [`crate::base::Error::Memory`], [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn compare(
    ground: &StudyData,
    mesh: &str,
    params: &CompareParams,
    context: Context<'_>,
) -> Result<Vec<SampleRecord>> {
    params.check()?;
    let counts = each_once(params.landmarks.iter().map(|&l| l.min(ground.len())));
    let most = counts.iter().copied().max().unwrap_or(0);
    let mut jobs = Vec::new();
    for sampling in each_once(params.samplings.iter().copied()) {
        let sizes = if sampling.is_nested() { vec![most] } else { counts.clone() };
        for seed in each_once(params.seeds.iter().copied()) {
            jobs.extend(sizes.iter().map(|&l| (sampling, seed, l)));
        }
    }
    let l = most as u64;
    let bytes = 4 * ground.len() as u64 + (MATRICES * l + COLUMNS * CHUNK as u64).saturating_mul(l);
    // Half of what is left stays for what each job takes itself.
    let run = context.run.with_threads((context.run.budget.left() / 2 / bytes.max(1)).min(jobs.len() as u64));
    let (run, _grant) = run
        .threads_beside("samples of so many landmarks", (0, bytes), BESIDE_BUDGET)
        .map_err(|error| error.with_remedy(LESS_WORK))?;
    let one = Run {
        threads: 1,
        budget: context.run.budget.clone(),
        resident: context.run.resident,
        progress: &(),
        cancel: context.run.cancel.clone(),
        seed: context.run.seed,
    };
    let compute = || {
        run.map_chunks(
            jobs.len(),
            || (),
            |k, ()| {
                let (sampling, seed, l) = jobs[k];
                let (landmarks, search) = landmarks(ground, sampling, l, seed, params, &one)?;
                let name = format!("rows-{k}.tmp");
                let rows = Rows::of(ground, &landmarks, &name, Context::new(context.work, &one))?;
                let sizes = counts.iter().copied();
                let wanted = sizes.filter(|&size| sampling.is_nested() || size == l);
                let records: Result<Vec<SampleRecord>> = wanted
                    .map(|l| {
                        let sample =
                            Sample { mesh, sampling, seed, landmarks: &landmarks[..l], search_fronts: search[l - 1] };
                        record(ground, sample, &rows, params, &one)
                    })
                    .collect();
                drop(rows);
                context.work.remove(&name);
                context.run.progress.advance("compare", 1);
                records
            },
        )
    };
    let (records, _) = context.run.stage("compare", "samples", jobs.len() as u64, compute)?;
    Ok(records.into_iter().flatten().collect())
}

/// The values without repetitions, in their order.
fn each_once<T: PartialEq>(all: impl Iterator<Item = T>) -> Vec<T> {
    let mut once = Vec::new();
    for one in all {
        if !once.contains(&one) {
            once.push(one);
        }
    }
    once
}

/// Landmarks of a sampling, and for each the number of fronts that the search had needed when it was found, not
/// counting those whose rows are part of the result.
pub fn landmarks(
    ground: &StudyData,
    sampling: Sampling,
    l: usize,
    seed: u64,
    params: &CompareParams,
    run: &Run,
) -> Result<(Vec<u32>, Vec<f64>)> {
    let graph = ground.graph();
    // Small sets are used completely.
    let columns = if ground.matrix.is_some() { ground.len() } else { SamplingParams::default().columns };
    let how = SamplingParams { kernel: params.gamma_kernel, sigma: Some(ground.mean), columns, ..Default::default() };
    let sampler = sampling.sampler(how);
    let mut field = vec![0f32; ground.len()];
    let (mut found, mut search) = (Vec::with_capacity(l), Vec::with_capacity(l));
    let mut choose = |space: &mut dyn Space, visits: VisitCount| {
        let mut spared = 0.;
        sampler.choose(l, seed, space, &mut field, &mut |node, row| {
            spared += if row.is_some() { 1. } else { 0. };
            found.push(node);
            search.push(visits.get() as f64 / graph.len() as f64 - spared);
            Ok(())
        })
    };
    if let Some(matrix) = &ground.matrix {
        let mut space = MatrixSpace::new(matrix, ground.nodes.view(), ground.lengths());
        let visits = space.visits();
        choose(&mut space, visits)?;
    } else {
        let mut front = Front::new(mean_weight(graph));
        let search = SearchGraph { graph, nodes: ground.nodes.view(), lengths: ground.lengths() };
        let mut space = GraphSpace::new(search, &mut front, &(), run);
        let visits = space.visits();
        choose(&mut space, visits)?;
    }
    Ok((found, search))
}

/// The rows of landmarks: in the matrix of all distances, or in a file of their own.
enum Rows<'a> {
    Matrix(Vec<&'a [f32]>),
    File(MappedSlice<f32>, usize),
}

impl<'a> Rows<'a> {
    fn of(ground: &'a StudyData, landmarks: &[u32], name: &str, context: Context<'_>) -> Result<Self> {
        let n = ground.len();
        Ok(match &ground.matrix {
            Some(matrix) => Self::Matrix(
                landmarks.iter().map(|&node| &matrix[node as usize * n..(node as usize + 1) * n]).collect(),
            ),
            None => Self::File(ground.rows(landmarks, name, context)?, n),
        })
    }

    fn first(&self, l: usize) -> Vec<&[f32]> {
        match self {
            Self::Matrix(rows) => rows[..l].to_vec(),
            Self::File(rows, n) => rows.chunks_exact(*n).take(l).collect(),
        }
    }
}

/// A sample to be measured.
struct Sample<'a> {
    mesh: &'a str,
    sampling: Sampling,
    seed: u64,
    landmarks: &'a [u32],
    /// Number of fronts for finding them.
    search_fronts: f64,
}

/// Measures a sample, whose landmarks are the first of those in `rows`.
fn record(ground: &StudyData, sample: Sample, rows: &Rows, params: &CompareParams, run: &Run) -> Result<SampleRecord> {
    let Sample { mesh, sampling, seed, landmarks, search_fronts } = sample;
    let (l, n) = (landmarks.len(), ground.len());
    let bandwidth = params.width.bandwidth(ground.mean);
    // With local widths, an affinity is known only between a landmark and another node.
    let sigma = match bandwidth {
        Bandwidth::Global(sigma) => Some(sigma),
        Bandwidth::Local(_) => None,
    };
    let tolerance = params.tolerance.unwrap_or(params.kernel.tolerance(l));
    let block = AffinityBlock::new(landmarks, rows.first(l), params.kernel, bandwidth);
    let held = AffinityBlock::new(&ground.held_out, ground.held_rows(), params.kernel, bandwidth);
    let measures = measure(&block, sigma.map(|_| &held as &dyn SampledBlock), tolerance, run)?;
    let all: Vec<u32> = (0..n as u32).collect();
    let known = ground.matrix.as_ref().zip(sigma);
    let residual = match known.filter(|_| params.residual) {
        Some((matrix, _)) => {
            let truth = AffinityBlock::new(&all, matrix.chunks_exact(n).collect(), params.kernel, bandwidth);
            residual(&block, &truth, tolerance, run)?
        }
        None => None,
    };
    let exact = match known.filter(|_| params.schur) {
        Some((matrix, sigma)) => {
            let bytes = 6 * 8 * (n * n) as u64;
            let _grant = run.budget.take("the exact comparison", bytes, bytes)?;
            let w = DMatrix::from_fn(n, n, |i, j| params.kernel.of(sigma, f64::from(matrix[j * n + i])));
            Some(exact(&(0.5 * (&w + w.transpose())), &block, tolerance, VECTORS, run)?)
        }
        None => None,
    };
    Ok(SampleRecord {
        mesh: mesh.into(),
        sampling,
        l,
        seed,
        nodes: n,
        sigma,
        search_fronts,
        measures,
        residual,
        exact,
        landmarks: landmarks.to_vec(),
    })
}

/// The residual over all of W: as if every column had been held out.
fn residual(block: &AffinityBlock, truth: &AffinityBlock, tolerance: f64, run: &Run) -> Result<Option<f64>> {
    Ok(measure(block, Some(truth), tolerance, run)?.held_out)
}

/// Errors of one sample.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct EmbeddingError {
    /// Number of landmarks l.
    pub l: usize,
    /// Of the plain extrapolation, eq. 1–2.
    pub plain: f64,
    /// Of the orthogonalised extrapolation.
    pub orthogonal: f64,
    /// Of the orthogonalised one with nodes weighted by area, against the area-weighted truth.
    pub by_area: f64,
    /// Share of negative eigenvalues of A.
    pub negative_share: f64,
}

/// The errors of [`VECTORS`] coordinates for each number of landmarks in `params`, with its kernel and width; landmarks
/// are those of `sampling` under `seed`, which may use its kernel of Γ.
///
/// # Errors
/// [`Error::Parameter`] if `ground` does not have all distances, or for local widths; [`Error::Cancelled`].
pub fn embedding_errors(
    ground: &StudyData,
    params: &CompareParams,
    sampling: Sampling,
    seed: u64,
    run: &Run,
) -> Result<Vec<EmbeddingError>> {
    let (kernel, sizes) = (params.kernel, &params.landmarks);
    let n = ground.len();
    let Some(matrix) = &ground.matrix else {
        return Err(Error::parameter("exact", format!("{n} faces are too many"), "decimate the mesh"));
    };
    let Bandwidth::Global(sigma) = params.width.bandwidth(ground.mean) else {
        return Err(Error::parameter("width", "is local", "give a number of mean distances"));
    };
    let bytes = 8 * (n * n) as u64;
    let _grant = run.budget.take("all affinities", bytes, bytes)?;
    let affinity = |i: usize, j: usize| kernel.of(sigma, 0.5 * f64::from(matrix[i * n + j] + matrix[j * n + i]));
    let weights = ground.weights();
    let ones = vec![1.; n];
    let truth = |weights: &[f64]| {
        let w = DMatrix::from_fn(n, n, |i, j| affinity(i, j) * (weights[i] * weights[j]).sqrt());
        let (values, mut vectors) = leading(&w, VECTORS);
        for (mut column, value) in vectors.column_iter_mut().zip(&values) {
            column *= value.max(0.).sqrt();
        }
        for (mut row, weight) in vectors.row_iter_mut().zip(weights) {
            row /= weight.sqrt();
        }
        vectors
    };
    let (even, by_area) = (truth(&ones), truth(&weights));
    let most = sizes.iter().copied().max().unwrap_or(0).min(n);
    let first_of = |l: usize| landmarks(ground, sampling, l, seed, params, run).map(|(found, _)| found);
    let nested = if sampling.is_nested() { Some(first_of(most)?) } else { None };
    let one = |&l: &usize| {
        let l = l.min(n);
        let own;
        let found = match &nested {
            Some(found) => &found[..l],
            None => {
                own = first_of(l)?;
                &own
            }
        };
        let rows: Vec<&[f32]> = found.iter().map(|&i| &matrix[i as usize * n..(i as usize + 1) * n]).collect();
        let block = AffinityBlock::new(found, rows, kernel, Bandwidth::Global(sigma));
        let tolerance = kernel.tolerance(l);
        let error = |how, weights: Option<&[f64]>, truth: &DMatrix<f64>| -> Result<f64> {
            let weigh = weights.map(|weights| move |node: usize| weights[node]);
            let weigh = weigh.as_ref().map(|weigh| weigh as NodeWeight<'_>);
            let y = NystromExtension::fit(
                &block,
                ExtensionParams::new(how, VECTORS, tolerance).scaled(Scaling::Root),
                weigh,
                run,
            )?
            .embed(&block);
            let mut padded = DMatrix::zeros(n, truth.ncols());
            padded.columns_mut(0, y.ncols()).copy_from(&y);
            Ok(aligned_error(truth, &padded, weights.unwrap_or(&ones)))
        };
        let kept = KeptEigenpairs::of(block.sampled(), tolerance);
        Ok(EmbeddingError {
            l,
            plain: error(Extrapolation::Plain, None, &even)?,
            orthogonal: error(Extrapolation::Orthogonal, None, &even)?,
            by_area: error(Extrapolation::Orthogonal, Some(&weights), &by_area)?,
            negative_share: kept.negative() as f64 / l as f64,
        })
    };
    sizes.iter().map(one).collect()
}
