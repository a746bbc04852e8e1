//! The first look at a mesh: the area of each part, and a sample of triangles that stands for the whole.
//!
//! One parallel pass over all faces and one over a sample; 60 bytes a sampled triangle.

use super::triangles::{self, CHUNK};
use super::vector::{Vec3, dot, double_area};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range, in_order};
use crate::mesh::Mesh;
use crate::store::Run;

/// Triangles in a sample.
const SAMPLE: usize = 40_000;

/// Area by label; labels from `parts` on share the last entry.
pub(super) fn areas(mesh: &Mesh, labels: &[u32], parts: usize, run: &Run) -> Result<Vec<f64>> {
    let n = mesh.faces.len();
    let mut areas = vec![0.0; parts + 1];
    let chunk = |k, (): &mut ()| {
        let mut found: Vec<(u32, f64)> = Vec::new();
        triangles::for_each(mesh, chunk_range(n, CHUNK, k), |face, _, at| {
            let cross = double_area(at);
            let (label, area) = (labels[face].min(parts as u32), dot(cross, cross).sqrt() / 2.0);
            match found.last_mut() {
                Some(last) if last.0 == label => last.1 += area,
                _ => found.push((label, area)),
            }
        });
        Ok(found)
    };
    in_order(
        run.threads,
        &run.cancel,
        chunk_count(n, CHUNK),
        || (),
        chunk,
        |_, found| {
            found.iter().for_each(|&(label, area)| areas[label as usize] += area);
            Ok(())
        },
    )?;
    Ok(areas)
}

/// A triangle that stands for its neighbours too.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    /// Corners; in a sample, drawn out so that pieces together cover about what the mesh covers.
    pub at: [Vec3; 3],
    pub middle: Vec3,
    /// Of length 1, or 0 where the triangle has no area.
    pub normal: Vec3,
    pub area: f64,
    pub label: u32,
}

/// Some [`SAMPLE`] triangles, evenly over the file; all of a smaller mesh.
pub(super) fn sample(mesh: &Mesh, labels: Option<&[u32]>, run: &Run) -> Result<Vec<Piece>> {
    let n = mesh.faces.len();
    let step = n.div_ceil(SAMPLE).max(1);
    let growth = (step as f64).sqrt();
    let mut pieces = Vec::new();
    let chunk = |k, (): &mut ()| {
        let mut found = Vec::new();
        for one in chunk_range(n.div_ceil(step), CHUNK, k) {
            // Not at a fixed stride, which could fall in step with rows of a grid.
            let face = (one * step + one.wrapping_mul(0x9e37_79b1) % step).min(n - 1);
            triangles::of_face(mesh, face, |_, at| {
                let middle = [0, 1, 2].map(|k| (at[0][k] + at[1][k] + at[2][k]) / 3.0);
                let normal = double_area(at);
                let length = dot(normal, normal).sqrt();
                let grown = at.map(|p| [0, 1, 2].map(|k| middle[k] + growth * (p[k] - middle[k])));
                found.push(Piece {
                    at: grown,
                    middle,
                    normal: if length > 0.0 { normal.map(|x| x / length) } else { [0.0; 3] },
                    area: length / 2.0,
                    label: labels.map_or(0, |labels| labels[face]),
                });
            });
        }
        Ok(found)
    };
    let chunks = chunk_count(n.div_ceil(step), CHUNK);
    in_order(
        run.threads,
        &run.cancel,
        chunks,
        || (),
        chunk,
        |_, mut found| {
            pieces.append(&mut found);
            Ok(())
        },
    )?;
    Ok(pieces)
}
