//! The embedding for correspondence: Nyström's extrapolation, orthogonalised under the measure of area.
//!
//! With A = UλUᵀ on the kept pairs and w the l affinities of a vertex, f = λ^-½ Uᵀ w embeds it such that products of f
//! approximate affinities; that is "plain" ([`Style::Plain`]: eq. 1, scaled by √λ as in §7.1). Eigenvectors of A are not those of
//! the whole matrix, though. With M = Σ m f fᵀ (m: shares of area) and M = QμQᵀ, e = Qᵀf are: principal axes
//! of the surface in feature space, whatever the density of its vertices, which is what makes two triangulations
//! comparable ([`Style::Orthogonal`]). Either is linear in w, so a vertex costs l exponentials and 8 l
//! multiply-adds. The cut of small eigenvalues matters: without it orthogonalised is worse than plain.
//!
//! Fitting is one pass over all rows for M, l² multiply-adds a vertex in `f64`. Rows of the result are 8 `f32`, zeros
//! beyond the dimensions asked for: 32 bytes a vertex on disk.

use super::eigen;
use super::embedding::landmark_affinities;
use super::kernel::Kernel;
use crate::base::parallel::{chunk_count, chunk_range, fill_chunks, in_order};
use crate::base::{Error, Result};
use crate::distance::DistanceRows;
use crate::graph::Node;
use crate::store::{MappedSlice, Run, WorkDir};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// Coordinates of a row at the most.
pub const MOST: usize = 8;
/// A vertex in the embedding, zeros beyond the dimensions in use.
pub type Point = [f32; MOST];

/// Vertices a chunk; part of the results, since sums add up by chunks.
const CHUNK: usize = 1 << 12;
/// Vertices a block of products.
const BLOCK: usize = 512;

/// Which eigenvectors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Style {
    /// Those of A, extrapolated: the paper's.
    Plain,
    /// Those of the approximated whole, by area.
    #[default]
    Orthogonal,
}

/// How to embed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OrthogonalParams {
    /// From distance to affinity.
    pub kernel: Kernel,
    /// The kernel's width in mean distances.
    pub width: f64,
    /// Coordinates k, 2 to [`MOST`].
    pub dimensions: usize,
    /// Which eigenvectors.
    pub style: Style,
}

impl Default for OrthogonalParams {
    fn default() -> Self {
        Self { kernel: Kernel::Gaussian, width: 1., dimensions: 7, style: Style::Orthogonal }
    }
}

impl OrthogonalParams {
    /// # Errors
    /// [`Error::Parameter`] for numbers out of range.
    pub fn check(&self) -> Result<()> {
        if !(2..=MOST).contains(&self.dimensions) {
            let problem = format!("{} is out of range", self.dimensions);
            return Err(Error::parameter("--vectors", problem, format!("choose from 2 to {MOST}")));
        }
        if !(self.width > 0. && self.width < 1e6) {
            return Err(Error::parameter("--sigma", format!("{} is no width", self.width), "choose a positive number"));
        }
        self.kernel.check()
    }
}

/// A fitted embedding.
#[derive(Clone, Debug)]
pub struct Orthogonal {
    kernel: Kernel,
    /// The kernel's width, in units of the rows.
    pub sigma: f64,
    /// Coordinates k, the fewest of those asked for and those there are.
    pub dimensions: usize,
    /// k rows of l: e = map · w.
    map: Vec<f32>,
    landmarks: usize,
    /// Variance (mean square by area) of each coordinate (k), descending with [`Style::Orthogonal`].
    pub variance: Vec<f64>,
    /// Kept eigenpairs of A.
    pub kept: usize,
}

/// Mean of all distances of `rows`, by area.
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

impl Orthogonal {
    /// Fits the embedding on all of `rows`, over vertices of the areas in `nodes`.
    ///
    /// # Errors
    /// [`Error::Parameter`], [`Error::Cancelled`].
    pub fn fit(rows: &DistanceRows, nodes: &[Node], params: OrthogonalParams, run: &Run) -> Result<Self> {
        params.check()?;
        let l = rows.len();
        let sigma = params.width * mean_distance(rows, nodes);
        let (values, vectors) = eigen::symmetric(landmark_affinities(rows, params.kernel, sigma));
        let cut = (params.kernel.tolerance(l) * values.first().copied().unwrap_or(0.)).max(0.);
        let kept = values.iter().take_while(|&&v| v > cut).count().max(1);
        // f = features · w.
        let features = DMatrix::from_fn(kept, l, |i, j| vectors[(j, i)] / values[i].max(1e-300).sqrt());
        let products = products(rows, nodes, params.kernel, sigma, run)?;
        let moments = &features * &products * features.transpose();
        let (all, axes) = match params.style {
            Style::Plain => (moments.diagonal().as_slice().to_vec(), features),
            Style::Orthogonal => {
                let (moments, axes) = eigen::symmetric(moments);
                (moments, axes.transpose() * features)
            }
        };
        let dimensions = params.dimensions.min(kept);
        // The first coordinate is about the same everywhere; it shall be positive.
        let total: f64 = (0..l).map(|j| axes[(0, j)]).sum();
        let sign = |i: usize| if i == 0 && total < 0. { -1. } else { 1. };
        let map = (0..dimensions).flat_map(|i| (0..l).map(move |j| (i, j)));
        let map = map.map(|(i, j)| (sign(i) * axes[(i, j)]) as f32).collect();
        let variance = all[..dimensions].to_vec();
        Ok(Self { kernel: params.kernel, sigma, dimensions, map, landmarks: l, variance, kept })
    }

    /// Embeds all vertices of `rows`, whose landmarks are those of the fit (or stand for them on another mesh, with
    /// `sigma` as its width): the file `name` of `work`.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn embed(
        &self,
        rows: &DistanceRows,
        sigma: f64,
        name: &str,
        work: &WorkDir,
        run: &Run,
    ) -> Result<MappedSlice<Point>> {
        let n = rows.nodes;
        let mut array = work.array::<Point>(name, &[n, MOST])?;
        let fill = |chunk: usize, out: &mut [Point], affinities: &mut Vec<f32>| {
            let range = chunk_range(n, CHUNK, chunk);
            affinities.resize(range.len(), 0.);
            out.fill([0.; MOST]);
            for j in 0..self.landmarks {
                self.kernel.apply(sigma as f32, &rows.row(j)[range.clone()], affinities);
                let mut factors = [0f32; MOST];
                (0..self.dimensions).for_each(|i| factors[i] = self.map[i * self.landmarks + j]);
                for (point, &w) in out.iter_mut().zip(affinities.iter()) {
                    for (x, factor) in point.iter_mut().zip(factors) {
                        *x += factor * w;
                    }
                }
            }
            Ok(())
        };
        fill_chunks(run.threads, &run.cancel, array.data(), CHUNK, Vec::new, fill)?;
        array.finish(false)
    }

    /// The width of this kind of embedding on other rows: `width` means of their distances.
    pub fn width_on(rows: &DistanceRows, nodes: &[Node], width: f64) -> f64 {
        width * mean_distance(rows, nodes)
    }
}

/// Σ m w wᵀ over all vertices (l × l), m: shares of area, evenly where there is none.
fn products(rows: &DistanceRows, nodes: &[Node], kernel: Kernel, sigma: f64, run: &Run) -> Result<DMatrix<f64>> {
    let (l, n) = (rows.len(), rows.nodes);
    let total: f64 = nodes.iter().map(|node| f64::from(node.area)).sum();
    let share = |node: &Node| if total > 0. { f64::from(node.area) / total } else { 1. / n as f64 };
    let mut sum = DMatrix::<f64>::zeros(l, l);
    let chunk = |k: usize, affinities: &mut Vec<f32>| {
        let mut sum = DMatrix::<f64>::zeros(l, l);
        let range = chunk_range(n, CHUNK, k);
        for start in range.clone().step_by(BLOCK) {
            let block = start..(start + BLOCK).min(range.end);
            affinities.resize(block.len(), 0.);
            let mut w = DMatrix::<f64>::zeros(l, block.len());
            for j in 0..l {
                kernel.apply(sigma as f32, &rows.row(j)[block.clone()], affinities);
                for (c, &a) in affinities.iter().enumerate() {
                    w[(j, c)] = f64::from(a);
                }
            }
            let mut weighted = w.clone();
            for (mut column, node) in weighted.column_iter_mut().zip(&nodes[block]) {
                column *= share(node);
            }
            sum.gemm(1., &weighted, &w.transpose(), 1.);
        }
        Ok(sum)
    };
    let chunks = chunk_count(n, CHUNK);
    in_order(run.threads, &run.cancel, chunks, Vec::new, chunk, |_, part| {
        sum += part;
        Ok(())
    })?;
    Ok(sum)
}
