//! Eigenfunctions of the Laplace–Beltrami operator on a mesh of any size, as combinations of local functions.
//!
//! On a large mesh the eigenproblem over all vertices is too large, but its low-frequency functions are smooth:
//! combinations f = W c of s local functions (a row of W per vertex, of sum 1) approximate them well. Among these, the
//! Dirichlet energy fᵀ L f is stationary for a given fᵀ A f if Wᵀ L W c = μ Wᵀ A W c: a dense problem of size s (Magnet
//! and Ovsjanikov 2023, *Scalable and Efficient Functional Map Computations on Dense Meshes*). If every vertex has a
//! local function of its own, this is the full problem.
//!
//! L uses the cotangents of triangles, computed from edge lengths. The edges of a degenerate or nearly degenerate
//! triangle are lengthened slightly first (Sharp and Crane 2020, *A Laplacian for Nonmanifold Triangle Meshes*), and
//! the energy of each triangle is non-negative. So neither slivers nor edges of three triangles do harm. Open edges
//! have natural boundary conditions.
//!
//! Cost: one pass over vertices, at each the square of the number of its local functions; 16 s² bytes for each of up to
//! [`MOST_CHUNKS`] chunks in progress; a dense eigenproblem of size s.

use crate::base::Result;
use crate::base::eigen;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::vector::{distance, wide};
use crate::graph::VertexGraph;
use crate::store::Run;
use nalgebra::DMatrix;

/// Minimum number of vertices per chunk.
const CHUNK: usize = 1 << 13;
/// Maximum number of chunks.
const MOST_CHUNKS: usize = 64;
/// Minimum by which the sum of two edges of a triangle exceeds the third, relative to the mean edge of the triangle.
const SLACK: f64 = 1e-4;
/// Share of the greatest diagonal element of Wᵀ A W that is added to its diagonal, since neighbouring functions are
/// nearly dependent.
const RIDGE: f64 = 1e-11;

/// Half the cotangents of the angles of a triangle opposite its edges of `lengths`.
///
/// ```
/// use nystrom_stream::spectral::laplacian::half_cotangents;
/// let [right, sharp, other] = half_cotangents([2f64.sqrt(), 1., 1.]);
/// assert!(right.abs() < 1e-12 && (sharp - 0.5).abs() < 1e-12 && (other - 0.5).abs() < 1e-12);
/// assert!(half_cotangents([2., 1., 1.]).iter().all(|w| w.is_finite()));
/// ```
pub fn half_cotangents(lengths: [f64; 3]) -> [f64; 3] {
    let [mut a, mut b, mut c] = lengths;
    let mean = (a + b + c) / 3.;
    let lacking = SLACK * mean - (a + b + c - 2. * a.max(b).max(c));
    if lacking > 0. {
        (a, b, c) = (a + lacking, b + lacking, c + lacking);
    }
    // Heron: 16 area².
    let square = (a + b + c) * (b + c - a) * (c + a - b) * (a + b - c);
    if square <= 0. {
        return [0.; 3];
    }
    let scale = 0.5 / square.sqrt();
    [(b * b + c * c - a * a) * scale, (c * c + a * a - b * b) * scale, (a * a + b * b - c * c) * scale]
}

/// Adds x yᵀ for sparse x and a dense y at `columns`.
struct AddOuter<'a> {
    x: &'a [(u32, f64)],
    columns: &'a [u32],
    y: &'a [f64],
    sums: &'a mut [f64],
    size: usize,
}

impl SimdKernel for AddOuter<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for &(i, x) in self.x {
            let row = &mut self.sums[i as usize * self.size..][..self.size];
            self.columns.iter().zip(self.y).for_each(|(&j, y)| row[j as usize] += x * y);
        }
    }
}

/// A thread's buffers for one vertex.
#[derive(Default)]
struct Scratch {
    own: Vec<(u32, f64)>,
    other: Vec<(u32, f64)>,
    /// (neighbour, weight), with a neighbour once per triangle.
    edges: Vec<(u32, f64)>,
    dense: Vec<f64>,
    columns: Vec<u32>,
    y: Vec<f64>,
}

impl Scratch {
    /// Extracts the sparse vector in `dense` at `columns`, which is reset to 0.
    fn gather(&mut self) {
        self.columns.sort_unstable();
        self.columns.dedup();
        self.y.clear();
        for &j in &self.columns {
            self.y.push(std::mem::take(&mut self.dense[j as usize]));
        }
    }
}

/// Up to `count` of the least eigenvalues, in units of 1/area, and their functions (s × r) as combinations of `size`
/// local functions; `row(v, out)` returns the local functions at vertex v with their values.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn eigenfunctions(
    graph: &VertexGraph,
    size: usize,
    count: usize,
    row: impl Fn(usize, &mut Vec<(u32, f64)>) + Sync,
    run: &Run,
) -> Result<(Vec<f64>, DMatrix<f64>)> {
    let (n, s) = (graph.len(), size);
    let total = graph.facts.area.max(1e-300);
    let chunk = CHUNK.max(n.div_ceil(MOST_CHUNKS));
    let sums = |k: usize, scratch: &mut Scratch| {
        scratch.dense.resize(s, 0.);
        let [mut energy, mut mass] = [vec![0f64; s * s], vec![0f64; s * s]];
        for v in chunk_range(n, chunk, k) {
            row(v, &mut scratch.own);
            let share = f64::from(graph.nodes[v].area) / total;
            scratch.columns.clear();
            scratch.columns.extend(scratch.own.iter().map(|(j, _)| j));
            scratch.y.clear();
            scratch.y.extend(scratch.own.iter().map(|(_, w)| share * w));
            dispatch(AddOuter { x: &scratch.own, columns: &scratch.columns, y: &scratch.y, sums: &mut mass, size: s });
            edges_of(graph, v, &mut scratch.edges);
            if scratch.edges.is_empty() {
                continue;
            }
            // Row v of L W.
            scratch.columns.clear();
            let sum: f64 = scratch.edges.iter().map(|(_, w)| w).sum();
            for &(j, w) in &scratch.own {
                scratch.dense[j as usize] += sum * w;
                scratch.columns.push(j);
            }
            for e in 0..scratch.edges.len() {
                let (u, weight) = scratch.edges[e];
                row(u as usize, &mut scratch.other);
                for &(j, w) in &scratch.other {
                    scratch.dense[j as usize] -= weight * w;
                    scratch.columns.push(j);
                }
            }
            scratch.gather();
            dispatch(AddOuter {
                x: &scratch.own,
                columns: &scratch.columns,
                y: &scratch.y,
                sums: &mut energy,
                size: s,
            });
        }
        Ok([energy, mass])
    };
    let mut both = [vec![0f64; s * s], vec![0f64; s * s]];
    run.in_order(chunk_count(n, chunk), Scratch::default, sums, |_, parts: [Vec<f64>; 2]| {
        for (all, part) in both.iter_mut().zip(parts) {
            all.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        }
        Ok(())
    })?;
    let [energy, mass] = both.map(|all| DMatrix::from_vec(s, s, all));
    Ok(generalised(energy, mass, count))
}

/// The distinct neighbours of `v`, with the cotangent weights of the edges to them.
fn edges_of(graph: &VertexGraph, v: usize, edges: &mut Vec<(u32, f64)>) {
    edges.clear();
    let at = |v: u32| wide(graph.nodes[v as usize].centroid);
    let here = at(v as u32);
    let span = 2 * graph.ring_starts[v] as usize..2 * graph.ring_starts[v + 1] as usize;
    for pair in graph.ring[span].chunks_exact(2) {
        let [p, q] = [at(pair[0]), at(pair[1])];
        let [_, of_q, of_p] = half_cotangents([distance(p, q), distance(here, q), distance(here, p)]);
        edges.extend([(pair[0], of_p), (pair[1], of_q)]);
    }
    edges.sort_by_key(|(u, _)| *u);
    edges.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
}

/// The least eigenvalues μ and vectors c of energy c = μ mass c, ascending, with cᵀ mass c = 1.
pub(crate) fn generalised(energy: DMatrix<f64>, mass: DMatrix<f64>, count: usize) -> (Vec<f64>, DMatrix<f64>) {
    let s = mass.nrows();
    let most = mass.diagonal().max().max(1e-300);
    let symmetrised = 0.5 * (&mass + mass.transpose());
    let mut ridge = RIDGE * most;
    let lower = loop {
        if let Some(factor) = nalgebra::Cholesky::new(&symmetrised + DMatrix::identity(s, s) * ridge) {
            break factor.l();
        }
        ridge *= 10.;
        if ridge > most {
            break DMatrix::identity(s, s);
        }
    };
    // L⁻¹ S L⁻ᵀ.
    let half = lower.solve_lower_triangular(&energy).unwrap_or(energy);
    let inner = lower.solve_lower_triangular(&half.transpose()).unwrap_or(half);
    // The greatest of the negated values come first.
    let (values, vectors) = eigen::symmetric(-inner);
    let r = count.min(s);
    let vectors = lower.tr_solve_lower_triangular(&vectors.columns(0, r).into_owned());
    let vectors = vectors.unwrap_or_else(|| DMatrix::identity(s, r));
    (values[..r].iter().map(|value| (-value).max(0.)).collect(), vectors)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_generalised_problem_is_solved() {
        let mass = DMatrix::from_row_slice(3, 3, &[2., 0.5, 0., 0.5, 1., 0.2, 0., 0.2, 3.]);
        let energy = DMatrix::from_row_slice(3, 3, &[1., -1., 0., -1., 2., -1., 0., -1., 1.]);
        let (values, vectors) = generalised(energy.clone(), mass.clone(), 3);
        assert!(values[0] < 1e-9 && values[0] <= values[1] && values[1] <= values[2]);
        for (k, value) in values.iter().enumerate() {
            let c = vectors.column(k);
            assert!((&energy * c - &mass * c * *value).norm() < 1e-8);
            assert!(((c.transpose() * &mass * c)[(0, 0)] - 1.).abs() < 1e-8);
        }
    }

    #[test]
    fn no_triangle_has_a_negative_energy() {
        for lengths in [[1., 1., 1.], [2., 1., 1.], [3., 1., 1.], [1e-9, 1., 1.], [0., 0., 0.]] {
            let [a, b, c] = half_cotangents(lengths);
            // Values (1, 0, 0), (1, 1, 0) and (1, −1, 0) at the corners, whose energies are sums over edges.
            for energy in [b + c, a + b, a + b + 4. * c] {
                assert!(energy.is_finite() && energy >= -1e-9, "{lengths:?}: {energy}");
            }
        }
    }
}
