//! The embedding for correspondence: Nyström's extrapolation, orthogonalised under the measure of area.
//!
//! [`super::nystrom`] on a mesh's rows, made to scale. "Plain" ([`Style::Plain`]) are the features of eq. 1 times √λ, as in
//! §7.1. Eigenvectors of A are not those of the whole matrix, though; orthogonalised by shares of area
//! ([`Style::Orthogonal`]) they are principal axes of the surface in feature space, whatever the density of its
//! vertices, which is what makes two triangulations comparable. So that nothing is decided on one mesh one way and the other way on
//! another that hardly differs, neither end is cut: small eigenvalues of A are damped, and of the variances μ of the axes
//! the first one left out, μ_{k+1}, is taken off all of them (e_i is scaled by √(1 − μ_{k+1}/μ_i)), so that an axis that might as well have
//! been the next counts next to nothing. On 24 decimated series, 20 landmarks aligned by truth, damping took the error of
//! matches from .0137 to .0118, and fading to .0104.
//!
//! Linear in the affinities: a vertex costs l exponentials and 8 l multiply-adds. Fitting is one pass over all rows, l² multiply-adds a
//! vertex in `f64`. Rows of the result are 8 `f32`, zeros beyond the dimensions asked for: 32 bytes a vertex on disk.

use super::block::Block;
use super::embedding::landmark_affinities;
use super::kernel::Kernel;
use super::nystrom::{Extension, Extrapolation, Scaling, moments};
use crate::base::parallel::{chunk_range, fill_chunks};
use crate::base::{Error, Result};
use crate::distance::DistanceRows;
use crate::graph::Node;
use crate::store::{Context, MappedSlice, Run};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Coordinates of a row at the most.
pub const MOST: usize = 8;
/// A vertex in the embedding, zeros beyond the dimensions in use.
pub type Point = [f32; MOST];

/// Vertices a chunk.
const CHUNK: usize = 1 << 12;

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
        Self { kernel: Kernel::Gaussian, width: 1., dimensions: 8, style: Style::Orthogonal }
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
}

/// Rows under a kernel.
struct Affinities<'a> {
    rows: &'a DistanceRows,
    kernel: Kernel,
    sigma: f64,
}

impl Block for Affinities<'_> {
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
        let sigma = params.width * mean_distance(rows, nodes);
        let total: f64 = nodes.iter().map(|node| f64::from(node.area)).sum();
        let even = 1. / rows.nodes as f64;
        let share = |v: usize| if total > 0. { f64::from(nodes[v].area) / total } else { even };
        let block = Affinities { rows, kernel: params.kernel, sigma };
        let tolerance = params.kernel.tolerance(rows.len());
        let fit = |how, scaling, d| Extension::fit(&block, how, scaling, d, Some(&share), tolerance, run);
        let (axes, variance) = match params.style {
            Style::Plain => {
                let map = fit(Extrapolation::Kpca, Scaling::None, params.dimensions)?.map;
                let variance = moments(&block, &map, Some(&share), run)?.diagonal();
                (map, variance.as_slice().to_vec())
            }
            Style::Orthogonal => {
                let Extension { mut map, values, .. } =
                    fit(Extrapolation::Orthogonal, Scaling::Root, params.dimensions + 1)?;
                let next = values.get(params.dimensions).copied().unwrap_or(0.).max(0.);
                let variance: Vec<f64> = values.iter().take(params.dimensions).map(|value| value - next).collect();
                map = map.columns(0, variance.len()).into_owned();
                for ((mut column, value), faded) in map.column_iter_mut().zip(&values).zip(&variance) {
                    column *= (faded / value.max(1e-300)).max(0.).sqrt();
                }
                (map, variance)
            }
        };
        // The first coordinate is about the same everywhere; it shall be positive.
        let sign = |i: usize| if i == 0 && axes.column(0).sum() < 0. { -1. } else { 1. };
        let map = axes.column_iter().enumerate();
        let map = map.flat_map(|(i, axis)| axis.iter().map(|x| (sign(i) * x) as f32).collect::<Vec<_>>()).collect();
        Ok(Self { kernel: params.kernel, sigma, dimensions: variance.len(), map, landmarks: rows.len(), variance })
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
        context: Context<'_>,
    ) -> Result<MappedSlice<Point>> {
        let n = rows.nodes;
        let mut array = context.work.array::<Point>(name, &[n, MOST])?;
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
        fill_chunks(context.run.threads, &context.run.cancel, array.data(), CHUNK, Vec::new, fill)?;
        array.finish(false)
    }

    /// The width of this kind of embedding on other rows: `width` means of their distances.
    pub fn width_on(rows: &DistanceRows, nodes: &[Node], width: f64) -> f64 {
        width * mean_distance(rows, nodes)
    }
}
