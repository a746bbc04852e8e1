//! A basis of smooth functions on a mesh of any size: Nyström's extension with a kernel so narrow that a sample affects
//! only its neighbourhood.
//!
//! Under a Gaussian whose width is the distance between samples, the affinities W between s samples and n vertices are
//! sparse, and the eigenvectors of the diffusion between samples, D⁻¹ W diag(m), approximate those of the
//! Laplace–Beltrami operator (Coifman and Lafon 2006, *Diffusion maps*). This gives any number of independent smooth
//! functions, while a few full rows give only as many as there are rows. They are extended to all vertices as in eq. 2
//! of the paper, f(v) = Σ_j w_vj m_j f_j / (λ Σ_j w_vj m_j), and orthonormalised by area.
//!
//! m_j is the area that sample j represents: each vertex's area is shared among the samples near it in proportion to
//! their affinities. So the result depends neither on the density of vertices nor on that of samples.
//!
//! Cost: an eigenproblem of the size of the sample (600: a second); two passes over [`LocalRows`], r multiplications
//! per entry; 4 r bytes per vertex on disk.

use super::kernel::Kernel;
use super::laplacian;
use super::nystrom::area_shares;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::vector::axpy;
use crate::base::{Result, eigen};
use crate::distance::local_rows::LocalRows;
use crate::graph::{Node, VertexGraph};
use crate::store::{Context, MappedSlice, Run};
use nalgebra::DMatrix;

/// Vertices per chunk.
const CHUNK: usize = 1 << 12;
/// Maximum number of chunks whose moments are stored.
const MOST_CHUNKS: usize = 256;
/// Eigenvalues of the diffusion below this are noise.
const LEAST: f64 = 1e-3;

/// Functions on the vertices of a mesh, orthonormal with respect to area.
#[derive(Clone, Debug)]
pub struct LocalBasis {
    /// Number of functions r.
    pub count: usize,
    /// Frequencies (r), ascending from 0: −ln λ of the diffusion, or eigenvalues of the Laplacian in units of 1/area.
    pub frequencies: Vec<f64>,
    /// Values, vertex by vertex (n × r).
    pub values: MappedSlice<f32>,
}

/// The Gaussian of width `sigma`.
#[inline]
fn affinity(distance: f32, sigma: f64) -> f64 {
    Kernel::Gaussian.of(sigma, f64::from(distance))
}

/// Adds a row times a number.
struct Add<'a> {
    scale: f64,
    row: &'a [f64],
    out: &'a mut [f64],
}

impl SimdKernel for Add<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        axpy(self.out, self.scale, self.row);
    }
}

/// Adds the lower half of weight · row rowᵀ (r × r).
struct AddMoments<'a> {
    weight: f64,
    row: &'a [f64],
    moments: &'a mut [f64],
}

impl SimdKernel for AddMoments<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let r = self.row.len();
        for (i, sums) in self.moments.chunks_exact_mut(r.max(1)).enumerate() {
            let scale = self.weight * self.row[i];
            axpy(&mut sums[..=i], scale, self.row);
        }
    }
}

/// A Gaussian of width `sigma` around each sample of `rows`, and the share of area that each sample represents (s).
struct Gaussians<'a> {
    rows: &'a LocalRows,
    nodes: &'a [Node],
    sigma: f64,
    mass: Vec<f64>,
}

impl<'a> Gaussians<'a> {
    fn new(rows: &'a LocalRows, nodes: &'a [Node], sigma: f64, run: &Run) -> Result<Self> {
        let mass = masses(rows, nodes, sigma, run)?;
        Ok(Self { rows, nodes, sigma, mass })
    }

    /// The functions Σ_j w_vj `factors`_jk / Σ_j w_vj `mass`_j at all vertices, orthonormalised by area in this order.
    fn extend(&self, factors: &[f64], frequencies: Vec<f64>, name: &str, context: Context<'_>) -> Result<LocalBasis> {
        let Self { rows, nodes, sigma, mass } = self;
        let (n, r, run) = (rows.nodes(), frequencies.len(), context.run);
        let share = area_shares(nodes);
        let extend = |v: usize, out: &mut [f64]| {
            out.fill(0.);
            let mut sum = 0f64;
            for near in rows.near(v) {
                let (j, w) = (near.sample as usize, affinity(near.distance, *sigma));
                sum += w * mass[j];
                dispatch(Add { scale: w, row: &factors[j * r..(j + 1) * r], out });
            }
            if sum > 0. {
                out.iter_mut().for_each(|out| *out /= sum);
            }
        };
        let mut array = context.work.array::<f32>(name, &[n, r])?;
        // The moments of all chunks are kept until the end.
        let chunk = CHUNK.max(n.div_ceil(MOST_CHUNKS));
        let moments = |k: usize, values: &mut [f32], row: &mut Vec<f64>| {
            row.resize(r, 0.);
            let mut moments = vec![0f64; r * r];
            for (v, out) in chunk_range(n, chunk, k).zip(values.chunks_exact_mut(r)) {
                extend(v, row);
                dispatch(AddMoments { weight: share(v), row: &row[..], moments: &mut moments });
                out.iter_mut().zip(&row[..]).for_each(|(out, x)| *out = *x as f32);
            }
            Ok(moments)
        };
        let parts = run.fill_chunks(array.data(), chunk * r.max(1), Vec::new, moments)?;
        let mut gram = DMatrix::<f64>::zeros(r, r);
        for part in parts {
            for i in 0..r {
                for j in 0..=i {
                    gram[(i, j)] += part[i * r + j];
                    gram[(j, i)] = gram[(i, j)];
                }
            }
        }
        // Cholesky preserves the order: function k is a combination of the first k.
        let columns = orthonormaliser(gram);
        let turn = |_: usize, values: &mut [f32], row: &mut Vec<f64>| {
            for out in values.chunks_exact_mut(r.max(1)) {
                row.clear();
                row.resize(r, 0.);
                for (j, &x) in out.iter().enumerate() {
                    dispatch(Add { scale: f64::from(x), row: &columns[j * r + j..(j + 1) * r], out: &mut row[j..] });
                }
                out.iter_mut().zip(&row[..]).for_each(|(out, x)| *out = *x as f32);
            }
            Ok(())
        };
        run.fill_chunks(array.data(), CHUNK * r.max(1), Vec::new, turn)?;
        Ok(LocalBasis { count: r, frequencies, values: array.finish(false)? })
    }
}

/// The share of area that each sample represents (s).
fn masses(rows: &LocalRows, nodes: &[Node], sigma: f64, run: &Run) -> Result<Vec<f64>> {
    let (n, s, share) = (rows.nodes(), rows.samples.len(), area_shares(nodes));
    let mut mass = vec![0f64; s];
    let part = |k: usize, (): &mut ()| {
        let mut mass = vec![0f64; s];
        for v in chunk_range(n, CHUNK, k) {
            let sum: f64 = rows.near(v).map(|near| affinity(near.distance, sigma)).sum();
            if sum > 0. {
                let scale = share(v) / sum;
                rows.near(v).for_each(|near| mass[near.sample as usize] += scale * affinity(near.distance, sigma));
            }
        }
        Ok(mass)
    };
    run.in_order(
        chunk_count(n, CHUNK),
        || (),
        part,
        |_, part| {
            mass.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
            Ok(())
        },
    )?;
    // A sample left without area must still have a positive mass.
    mass.iter_mut().for_each(|m| *m = m.max(1e-9 / s as f64));
    Ok(mass)
}

impl LocalBasis {
    /// Up to `count` functions on vertices with the areas in `nodes`, from a Gaussian of width `sigma` (units of the
    /// graph) over `rows`, in the file `name` of `context`.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn fit(
        rows: &LocalRows,
        nodes: &[Node],
        sigma: f64,
        count: usize,
        name: &str,
        context: Context<'_>,
    ) -> Result<Self> {
        let s = rows.samples.len();
        let gaussians = Gaussians::new(rows, nodes, sigma, context.run)?;
        let mass = &gaussians.mass;
        let mut within = DMatrix::<f64>::zeros(s, s);
        for (i, &vertex) in rows.samples.iter().enumerate() {
            for near in rows.near(vertex as usize) {
                let w = 0.5 * affinity(near.distance, sigma);
                within[(i, near.sample as usize)] += w;
                within[(near.sample as usize, i)] += w;
            }
        }
        let degree: Vec<f64> = (0..s).map(|i| (0..s).map(|j| within[(i, j)] * mass[j]).sum()).collect();
        let scale: Vec<f64> = mass.iter().zip(&degree).map(|(m, d)| (m / d).sqrt()).collect();
        let diffusion = DMatrix::from_fn(s, s, |i, j| scale[i] * within[(i, j)] * scale[j]);
        let (mut values, vectors) = eigen::symmetric(diffusion);
        values.truncate(count.min(s));
        let r = values.iter().take_while(|&&value| value > LEAST).count();
        values.truncate(r);
        // The factor for an entry's affinity: m_j f_j / λ.
        let factor = |j: usize, k: usize| mass[j] * vectors[(j, k)] / (mass[j] * degree[j]).sqrt() / values[k];
        let factors: Vec<f64> = (0..s).flat_map(|j| (0..r).map(move |k| (j, k))).map(|(j, k)| factor(j, k)).collect();
        let frequencies = values.iter().map(|value| -libm::log(value.min(1.))).collect();
        gaussians.extend(&factors, frequencies, name, context)
    }

    /// Up to `count` eigenfunctions of the Laplace–Beltrami operator of `graph` among combinations of the Gaussians of
    /// width `sigma` over `rows` ([`super::laplacian`]), in the file `name` of `context`.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn laplacian(
        rows: &LocalRows,
        graph: &VertexGraph,
        sigma: f64,
        count: usize,
        name: &str,
        context: Context<'_>,
    ) -> Result<Self> {
        let s = rows.samples.len();
        let gaussians = Gaussians::new(rows, &graph.nodes, sigma, context.run)?;
        let mass = &gaussians.mass;
        let weigh = |v: usize, out: &mut Vec<(u32, f64)>| {
            out.clear();
            out.extend(rows.near(v).map(|near| {
                let j = near.sample;
                (j, mass[j as usize] * affinity(near.distance, sigma))
            }));
            let sum: f64 = out.iter().map(|(_, w)| w).sum();
            out.iter_mut().for_each(|(_, w)| *w /= if sum > 0. { sum } else { 1. });
        };
        let (frequencies, vectors) = laplacian::eigenfunctions(graph, s, count, weigh, context.run)?;
        let r = frequencies.len();
        let factors: Vec<f64> =
            (0..s).flat_map(|j| (0..r).map(move |k| (j, k))).map(|(j, k)| mass[j] * vectors[(j, k)]).collect();
        gaussians.extend(&factors, frequencies, name, context)
    }

    /// The functions restricted to the first `n` vertices, in the file `name` of `context` if there are more.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub fn first(self, n: usize, name: &str, context: Context<'_>) -> Result<Self> {
        let kept = n * self.count;
        if kept == self.values.len() {
            return Ok(self);
        }
        let mut array = context.work.array::<f32>(name, &[n, self.count])?;
        array.data().copy_from_slice(&self.values[..kept]);
        Ok(Self { values: array.finish(false)?, ..self })
    }

    /// The functions at `vertex` (r).
    #[inline]
    pub fn at(&self, vertex: usize) -> &[f32] {
        &self.values[vertex * self.count..(vertex + 1) * self.count]
    }
}

/// L⁻¹ for `gram` = L Lᵀ, column by column (r × r); for L Lᵀ + εI if it is singular.
fn orthonormaliser(gram: DMatrix<f64>) -> Vec<f64> {
    let r = gram.nrows();
    let mut ridge = 0.;
    loop {
        let lifted = &gram + DMatrix::identity(r, r) * ridge;
        if let Some(factor) = nalgebra::Cholesky::new(lifted) {
            let lower = factor.l();
            let inverse = lower.solve_lower_triangular(&DMatrix::identity(r, r));
            if let Some(inverse) = inverse.filter(|inverse| inverse.iter().all(|x| x.is_finite())) {
                return inverse.as_slice().to_vec();
            }
        }
        ridge = if ridge == 0. { 1e-9 } else { 10. * ridge };
        if ridge > 1e3 {
            return DMatrix::<f64>::identity(r, r).as_slice().to_vec();
        }
    }
}
