//! Distinguishes a shape from its mirror image in the embedding by the signed volume of the embedded surface.
//!
//! For spectral axes a < b < c the surface mapped to these three coordinates encloses the volume T_abc = Σ det[e(v₀),
//! e(v₁), e(v₂)]/6 over its triangles. T is an alternating 3-tensor: an orthogonal change of coordinates transforms it
//! by the 3 × 3 minors, and reversing the winding negates it. So with the right alignment two tensors agree (cosine
//! near 1), with a mirrored one they are opposite (near −1), and otherwise the shape is inconclusive. One parallel pass
//! over the triangles, k³/6 determinants each.

use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::vector::MapEach;
use crate::graph::vertex_graph::triangles;
use crate::mesh::Mesh;
use crate::spectral::nystrom::Point;
use crate::store::Run;
use nalgebra::DMatrix;

const CHUNK: usize = 1 << 14;

/// The alternating tensor of an embedded surface: T_abc for a < b < c, in the order of [`triples`].
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    dimensions: usize,
    values: Vec<f64>,
}

/// All a < b < c below `dimensions`.
fn triples(dimensions: usize) -> Vec<[usize; 3]> {
    let mut all = Vec::new();
    for a in 0..dimensions {
        for b in a + 1..dimensions {
            all.extend((b + 1..dimensions).map(|c| [a, b, c]));
        }
    }
    all
}

#[inline]
fn determinant(m: [[f64; 3]; 3]) -> f64 {
    m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
}

impl Tensor {
    /// The tensor of `mesh` mapped to `points` in `dimensions` coordinates.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn of(mesh: &Mesh, points: &[Point], dimensions: usize, run: &Run) -> Result<Self> {
        let triples = triples(dimensions);
        let mut values = vec![0f64; triples.len()];
        let n = mesh.faces.len();
        let chunk = |k: usize, (): &mut ()| {
            let mut sum = vec![0f64; triples.len()];
            mesh.faces.for_each(chunk_range(n, CHUNK, k), |_, corners| {
                triangles(mesh, corners, |corners, _| {
                    let rows = corners.map_each(|v| points[v as usize]);
                    for (sum, axes) in sum.iter_mut().zip(&triples) {
                        *sum += determinant(rows.map_each(|row| axes.map_each(|axis| f64::from(row[axis])))) / 6.;
                    }
                });
            });
            Ok(sum)
        };
        run.in_order(
            chunk_count(n, CHUNK),
            || (),
            chunk,
            |_, part| {
                values.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
                Ok(())
            },
        )?;
        Ok(Self { dimensions, values })
    }

    /// Number of coordinates k.
    pub fn dimensions(&self) -> usize {
        self.dimensions
    }

    /// The tensor of the first `dimensions` coordinates only.
    pub fn of_first(&self, dimensions: usize) -> Self {
        let kept = triples(self.dimensions).into_iter().zip(&self.values).filter(|(axes, _)| axes[2] < dimensions);
        Self { dimensions: dimensions.min(self.dimensions), values: kept.map(|(_, value)| *value).collect() }
    }

    /// The tensor after the change of coordinates `transform` (k × k).
    pub fn turned(&self, transform: &DMatrix<f64>) -> Self {
        let triples = triples(self.dimensions);
        let minor =
            |rows: [usize; 3], columns: [usize; 3]| determinant(rows.map(|i| columns.map(|j| transform[(i, j)])));
        let value = |rows: &[usize; 3]| -> f64 {
            triples.iter().zip(&self.values).map(|(columns, value)| minor(*rows, *columns) * value).sum()
        };
        Self { dimensions: self.dimensions, values: triples.iter().map(value).collect() }
    }

    /// The cosine between two tensors, from −1 to 1; 0 if one vanishes.
    pub fn agreement(&self, other: &Self) -> f64 {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let norms = (dot(&self.values, &self.values) * dot(&other.values, &other.values)).sqrt();
        if norms > 0. { dot(&self.values, &other.values) / norms } else { 0. }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_tetrahedron_encloses_a_sixth_and_a_reflection_negates_it() {
        let corners = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        let mesh = Mesh::from_slices(&corners, &[[0u32, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).unwrap();
        let points: Vec<Point> =
            corners.iter().map(|p| [p[0] as f32, p[1] as f32, p[2] as f32, 1., 0., 0., 0., 0.]).collect();
        let tensor = Tensor::of(&mesh, &points, 4, &Run::new(&())).unwrap();
        assert!((tensor.values[0] - 1. / 6.).abs() < 1e-12, "{:?}", tensor.values);
        // A closed surface has no projected area.
        assert!(tensor.values[1..].iter().all(|x| x.abs() < 1e-12));
        let mut mirror = DMatrix::identity(4, 4);
        mirror[(1, 1)] = -1.;
        assert!((tensor.turned(&mirror).agreement(&tensor) + 1.).abs() < 1e-12);
        assert_eq!(tensor.of_first(3).values, tensor.values[..1]);
        // Transforming by minors equals transforming the points.
        let (sin, cos) = 0.7f64.sin_cos();
        let turn =
            DMatrix::from_row_slice(4, 4, &[cos, -sin, 0., 0., sin, cos, 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.]);
        let turned: Vec<Point> = points
            .iter()
            .map(|p| {
                let q = &turn * DMatrix::from_fn(4, 1, |i, _| f64::from(p[i]));
                std::array::from_fn(|i| if i < 4 { q[(i, 0)] as f32 } else { 0. })
            })
            .collect();
        let direct = Tensor::of(&mesh, &turned, 4, &Run::new(&())).unwrap();
        for (a, b) in tensor.turned(&turn).values.iter().zip(&direct.values) {
            assert!((a - b).abs() < 1e-7);
        }
    }
}
