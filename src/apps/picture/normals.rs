//! The surface's normal at every sample of a view.
//!
//! Found after drawing, for what is seen only: from the vertices' normals where there are some, else from the faces',
//! smoothed over neighbouring samples of like depth (a mesh of a hundred million faces has many to a sample, and no
//! room for normals at vertices). 4 bytes a sample, twice that while smoothing.

use super::camera::Camera;
use super::raster::Canvas;
use super::triangles;
use super::vector::{Vec3, add_scaled, double_area, unit};
use super::vertex_normals::VertexNormals;
use crate::base::Result;
use crate::base::parallel::fill_chunks;
use crate::mesh::Mesh;
use crate::store::Run;

/// A unit normal towards the viewer: its parts to the right and up, in 1/32767.
pub(super) type Packed = [i16; 2];

/// Samples to each side that normals are smoothed over.
const REACH: usize = 2;

/// Packs a normal given in the frame, turned towards the viewer.
fn pack(n: Vec3) -> Packed {
    let sign = if n[2] < 0.0 { -32767.0 } else { 32767.0 };
    [(n[0] * sign) as i16, (n[1] * sign) as i16]
}

/// To the right, up, towards the viewer.
#[inline]
pub(super) fn unpack(packed: Packed) -> [f32; 3] {
    let [x, y] = packed.map(|x| f32::from(x) / 32767.0);
    [x, y, (1.0 - x * x - y * y).max(0.0).sqrt()]
}

/// A triangle of the face last looked at.
struct Corner {
    at: [Vec3; 3],
    normals: [Vec3; 3],
}

/// Normals of all samples; the canvas shows labels afterwards (0 where there are none).
pub(super) fn normals(
    mesh: &Mesh,
    labels: Option<&[u32]>,
    canvas: &Canvas,
    camera: &Camera,
    vertex_normals: Option<&VertexNormals>,
    run: &Run,
) -> Result<Vec<Packed>> {
    let mut normals = vec![[0i16; 2]; canvas.width * canvas.height];
    let width = canvas.width;
    fill_chunks(run.threads, &run.cancel, &mut normals, width, Vec::new, |y, row, known: &mut Vec<Corner>| {
        let mut last = None;
        for (x, normal) in row.iter_mut().enumerate() {
            let Some(hit) = canvas.get(y * width + x) else { continue };
            if last != Some(hit.item) {
                known.clear();
                triangles::of_face(mesh, hit.item as usize, |corners, at| {
                    let own = unit(double_area(at));
                    let normals = corners.map(|corner| vertex_normals.map_or(own, |all| all.at(corner, own)));
                    known.push(Corner {
                        at: at.map(|p| camera.project(p)),
                        normals: normals.map(|n| camera.frame.of(n)),
                    });
                });
                last = Some(hit.item);
            }
            *normal = interpolate(known, x as f64 + 0.5, y as f64 + 0.5);
            canvas.replace(y * width + x, labels.and_then(|labels| labels.get(hit.item as usize)).map_or(0, |&l| l));
        }
        Ok(())
    })?;
    if vertex_normals.is_some() {
        return Ok(normals);
    }
    let across = smooth(&normals, canvas, 1, run)?;
    drop(normals);
    smooth(&across, canvas, width, run)
}

/// The normal at a point of a face's triangles: in the one that holds it best.
fn interpolate(triangles: &[Corner], x: f64, y: f64) -> Packed {
    let mut best = (f64::NEG_INFINITY, [0.0; 3]);
    for triangle in triangles {
        let side = |a: Vec3, b: Vec3| (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
        let [a, b, c] = triangle.at;
        let areas = [side(b, c), side(c, a), side(a, b)];
        let total: f64 = areas.iter().sum();
        if total == 0.0 {
            continue;
        }
        let shares = areas.map(|area| area / total);
        let inside = shares.iter().copied().fold(f64::INFINITY, f64::min);
        if inside > best.0 {
            let mut sum = [0.0; 3];
            for (share, normal) in shares.iter().zip(triangle.normals) {
                sum = add_scaled(sum, share.max(0.0), normal);
            }
            best = (inside, sum);
        }
    }
    pack(unit(best.1))
}

/// Means along one axis (samples `step` apart) over samples whose depth is near.
fn smooth(normals: &[Packed], canvas: &Canvas, step: usize, run: &Run) -> Result<Vec<Packed>> {
    let mut out = vec![[0i16; 2]; normals.len()];
    let width = canvas.width;
    fill_chunks(
        run.threads,
        &run.cancel,
        &mut out,
        width,
        || (),
        |y, row, ()| {
            for (x, out) in row.iter_mut().enumerate() {
                let cell = y * width + x;
                let Some(hit) = canvas.get(cell) else { continue };
                let (place, size) = if step == 1 { (x, width) } else { (y, canvas.height) };
                let mut sum = [0.0f32; 3];
                for k in place.saturating_sub(REACH)..(place + REACH + 1).min(size) {
                    let other = cell + k * step - place * step;
                    if canvas.get(other).is_some_and(|other| (other.depth - hit.depth).abs() < 2.0 * REACH as f64) {
                        let normal = unpack(normals[other]);
                        (0..3).for_each(|axis| sum[axis] += normal[axis]);
                    }
                }
                *out = pack(unit(sum.map(f64::from)));
            }
            Ok(())
        },
    )?;
    Ok(out)
}
