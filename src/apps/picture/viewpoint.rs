//! The viewpoint: which axis points up, and the most informative view around it.
//!
//! One pass over all faces for the areas of the parts, one over a sample of 40,000 faces that represents the mesh (136
//! bytes per triangle, of which at most 120,000 are kept), then sixty small pictures of that sample: some 0.1 s
//! whatever the mesh.

use super::camera::{Camera, Extent, Frame, Vec3};
use super::raster::{CHUNK, Canvas, each_triangle, triangles_of};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::vector::{MapEach, dot, double_area};
use crate::mesh::Mesh;
use crate::store::Run;

/// Faces in a sample, and half the triangles of theirs that are kept in the mean.
const SAMPLE: usize = 40_000;

/// Area by label; labels from `parts` on share the last entry.
pub(super) fn areas(mesh: &Mesh, labels: &[u32], parts: usize, run: &Run) -> Result<Vec<f64>> {
    let n = mesh.faces.len();
    let mut areas = vec![0.0; parts + 1];
    let chunk = |k, (): &mut ()| {
        let mut found: Vec<(u32, f64)> = Vec::new();
        each_triangle(mesh, chunk_range(n, CHUNK, k), |face, _, at| {
            let cross = double_area(at);
            let (label, area) = (labels[face].min(parts as u32), dot(cross, cross).sqrt() / 2.0);
            match found.last_mut() {
                Some(last) if last.0 == label => last.1 += area,
                _ => found.push((label, area)),
            }
        });
        Ok(found)
    };
    run.in_order(
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

/// A triangle that also represents its neighbours.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    /// Corners; in a sample, enlarged so that the pieces together cover about as much as the mesh.
    pub at: [Vec3; 3],
    pub middle: Vec3,
    /// Of length 1, or 0 where the triangle has no area.
    pub normal: Vec3,
    pub area: f64,
    pub label: u32,
}

impl Piece {
    /// A triangle with corners `at`, enlarged by `growth` around its middle.
    fn of(at: [Vec3; 3], growth: f64, label: u32) -> Self {
        let middle = [0, 1, 2].map(|k| (at[0][k] + at[1][k] + at[2][k]) / 3.0);
        let normal = double_area(at);
        let length = dot(normal, normal).sqrt();
        Self {
            at: at.map(|p| [0, 1, 2].map(|k| middle[k] + growth * (p[k] - middle[k]))),
            middle,
            normal: if length > 0.0 { normal.map(|x| x / length) } else { [0.0; 3] },
            area: length / 2.0,
            label,
        }
    }
}

/// The triangles of some [`SAMPLE`] faces, evenly spread over the file, or of all faces of a smaller mesh. Of polygons
/// with many corners only every so many triangles are kept. Empty only if no face has a position.
pub(super) fn sample(mesh: &Mesh, labels: Option<&[u32]>, run: &Run) -> Result<Vec<Piece>> {
    let n = mesh.faces.len();
    let step = n.div_ceil(SAMPLE).max(1);
    let label = |face: usize| labels.map_or(0, |labels| labels[face]);
    let triangles = |corners: usize| corners.saturating_sub(2);
    let mean = triangles(mesh.faces.corner_count() / n.max(1));
    let least = (mean * n.div_ceil(step)).div_ceil(2 * SAMPLE).max(1);
    let spread = |k: usize| {
        let mut found = Vec::new();
        for one in chunk_range(n.div_ceil(step), CHUNK, k) {
            // Jittered, since a fixed stride could be in step with rows of a grid.
            let face = (one * step + one.wrapping_mul(0x9e37_79b1) % step).min(n - 1);
            let every = least.max(triangles(mesh.faces.corner_range(face).len()).div_ceil(SAMPLE));
            let growth = ((step * every) as f64).sqrt();
            let mut number = one;
            triangles_of(mesh, face, |_, at| {
                number += 1;
                if number % every == 0 {
                    found.push(Piece::of(at, growth, label(face)));
                }
            });
        }
        found
    };
    let sampled = collected(chunk_count(n.div_ceil(step), CHUNK), spread, usize::MAX, run)?;
    if !sampled.is_empty() {
        return Ok(sampled);
    }
    // If hardly any face has a position, the sample may have missed those.
    let first = |k: usize| {
        let mut found = Vec::new();
        each_triangle(mesh, chunk_range(n, CHUNK, k), |face, _, at| {
            if found.len() < SAMPLE {
                found.push(Piece::of(at, 1.0, label(face)));
            }
        });
        found
    };
    collected(chunk_count(n, CHUNK), first, SAMPLE, run)
}

/// The first `most` of the pieces of all chunks.
fn collected(chunks: usize, of: impl Fn(usize) -> Vec<Piece> + Sync, most: usize, run: &Run) -> Result<Vec<Piece>> {
    let mut pieces: Vec<Piece> = Vec::new();
    run.in_order(
        chunks,
        || (),
        |k, ()| Ok(of(k)),
        |_, found| {
            pieces.extend(found.into_iter().take(most - pieces.len()));
            Ok(())
        },
    )?;
    Ok(pieces)
}

// Which axis of the file points up.
//
// Files do not say. Each of the six directions is scored: for standing well (its lowest slice reaches under the centre
// of mass, and wide), for a flat bottom, for not being an axis of mirror symmetry (animals, people and chairs are
// symmetric left to right, not top to bottom), and for convention (y, then z, rarely downwards). Microseconds per
// sampled triangle.

/// Cells per side of the grid on which symmetry is measured.
const GRID: usize = 24;

/// The upward direction.
pub(super) fn upright(pieces: &[Piece]) -> Vec3 {
    let mut extent = Extent::EMPTY;
    pieces.iter().for_each(|piece| extent.include(piece.middle));
    let symmetry = [0, 1, 2].map(|axis| symmetry(pieces, &extent, axis));
    let mut best = ([0.0, 1.0, 0.0], f64::NEG_INFINITY);
    for (axis, sign, custom) in
        [(1, 1.0, 0.4), (2, 1.0, 0.25), (1, -1.0, -0.4), (2, -1.0, -0.45), (0, 1.0, -0.3), (0, -1.0, -0.5)]
    {
        let (stands, flat) = standing(pieces, &extent, axis, sign);
        let others = symmetry[(axis + 1) % 3].max(symmetry[(axis + 2) % 3]);
        let score = custom + 0.5 * stands + 0.5 * flat + 0.8 * (others - symmetry[axis]);
        if score > best.1 {
            let mut up = [0.0; 3];
            up[axis] = sign;
            best = (up, score);
        }
    }
    best.0
}

/// How well the shape stands on its lowest slice, and how flat that slice is, both 0 to 1.
fn standing(pieces: &[Piece], extent: &Extent, axis: usize, sign: f64) -> (f64, f64) {
    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
    let bottom = if sign > 0.0 { extent.low[axis] } else { extent.high[axis] };
    let height = extent.length(axis).max(f64::MIN_POSITIVE);
    let mut foot = Extent::EMPTY;
    let (mut mass, mut centre, mut flat) = (0.0, [0.0; 3], 0.0);
    for piece in pieces {
        let above = (piece.middle[axis] - bottom) * sign / height;
        if above < 0.06 {
            foot.include(piece.middle);
            if above < 0.02 && piece.normal[axis].abs() > 0.9 {
                flat += piece.area;
            }
        }
        mass += piece.area;
        (0..3).for_each(|k| centre[k] += piece.area * piece.middle[k]);
    }
    if mass <= 0.0 {
        return (0.0, 0.0);
    }
    let reach = |k: usize| {
        let under = centre[k] / mass;
        // How far the foot extends beyond the centre on the worse side, as a share of the shape's half width.
        let margin = (under - foot.low[k]).min(foot.high[k] - under);
        (2.0 * margin / extent.length(k).max(f64::MIN_POSITIVE)).clamp(-0.2, 0.5) / 0.5
    };
    // Only a foot that extends well beyond the centre on all sides counts.
    let stands = 2.0 * reach(a).min(reach(b)) - 1.0;
    (stands.clamp(0.0, 1.0), (flat / mass * 12.0).min(1.0))
}

/// The similarity of the shape and its mirror image along `axis`: 0 to 1.
fn symmetry(pieces: &[Piece], extent: &Extent, axis: usize) -> f64 {
    let longest = (0..3).map(|k| extent.length(k)).fold(f64::MIN_POSITIVE, f64::max);
    let cell = |p: Vec3| {
        let place = [0, 1, 2].map_each(|k| {
            let from_middle = (p[k] - (extent.low[k] + extent.high[k]) / 2.0) / longest;
            (((from_middle + 0.5) * GRID as f64) as usize).min(GRID - 1)
        });
        (place[0] * GRID + place[1]) * GRID + place[2]
    };
    let (mut here, mut there) = (vec![0.0f64; GRID.pow(3)], vec![0.0f64; GRID.pow(3)]);
    for piece in pieces {
        let mut mirrored = piece.middle;
        mirrored[axis] = extent.low[axis] + extent.high[axis] - mirrored[axis];
        here[cell(piece.middle)] += piece.area;
        there[cell(mirrored)] += piece.area;
    }
    let common: f64 = here.iter().zip(&there).map(|(a, b)| a.min(*b)).sum();
    common / here.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}

// The direction of view: the view that shows most.
//
// Sixty views around the upright axis, from eye level to well above, are rendered small from a sample of the mesh. A
// view is scored by how much of each part it shows compared with the best view of that part (small parts count more
// than their area), by its area, by the relief on it, and by its depth; views from slightly above and from the
// conventional front are preferred. Some 0.1 s.

/// Number of views around, and their elevations in degrees with a bonus by convention.
const AROUND: usize = 20;
const ELEVATIONS: [(f64, f64); 3] = [(4.0, 0.05), (18.0, 0.12), (36.0, 0.0)];
/// Samples per side of the small picture.
const SMALL: usize = 112;

/// The content of a view.
struct Seen {
    parts: Vec<f64>,
    area: f64,
    relief: f64,
    depth: f64,
}

/// Azimuth and elevation (radians) of the best view around `up`. Labels from `parts` on count as one part.
pub(super) fn best(pieces: &[Piece], parts: usize, up: Vec3, run: &Run) -> Result<(f64, f64)> {
    let views: Vec<(f64, f64, f64)> = ELEVATIONS
        .iter()
        .flat_map(|&(elevation, custom)| {
            (0..AROUND).map(move |k| {
                let azimuth = (k as f64 + 0.5) / AROUND as f64 * std::f64::consts::TAU;
                (azimuth, elevation.to_radians(), custom)
            })
        })
        .collect();
    let look = |k: usize, (): &mut ()| {
        let (azimuth, elevation, _) = views[k];
        Ok(look(pieces, parts, &Frame::turned(up, azimuth, elevation)))
    };
    let seen = run.map_chunks(views.len(), || (), look)?;
    let most = |value: &dyn Fn(&Seen) -> f64| seen.iter().map(value).fold(f64::MIN_POSITIVE, f64::max);
    let (area, relief, depth) = (most(&|s| s.area), most(&|s| s.relief), most(&|s| s.depth));
    let best: Vec<f64> = (0..=parts).map(|part| most(&|s| s.parts[part])).collect();
    let weight: Vec<f64> = best.iter().map(|&cells| if cells < 4.0 { 0.0 } else { cells.sqrt() }).collect();
    let total = weight.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    // By convention, shapes with y up are seen along z, those with z up along y, as in anatomy.
    let front = if up[1] != 0.0 { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] };
    let mut chosen = (0, f64::NEG_INFINITY);
    for (k, (seen, view)) in seen.iter().zip(&views).enumerate() {
        let shown: f64 = (0..=parts).map(|p| weight[p] * (seen.parts[p] / best[p] / 0.7).min(1.0).sqrt()).sum();
        let score = shown / total
            + 0.6 * seen.area / area
            + 0.35 * seen.relief / relief
            + 0.15 * (seen.depth / depth).min(0.7)
            + view.2
            + 0.1 * dot(Frame::turned(up, view.0, 0.0).toward, front);
        if score > chosen.1 + 1e-9 {
            chosen = (k, score);
        }
    }
    let (azimuth, elevation, _) = views[chosen.0];
    Ok((azimuth, elevation))
}

fn look(pieces: &[Piece], parts: usize, frame: &Frame) -> Seen {
    let mut extent = Extent::EMPTY;
    let mut size = Extent::EMPTY;
    for piece in pieces {
        extent.include(frame.of(piece.middle));
        size.include(piece.middle);
    }
    let scale = 0.94 * SMALL as f64 / size.diagonal().max(f64::MIN_POSITIVE);
    let camera = Camera::fit(*frame, &extent, scale, SMALL, SMALL);
    let canvas = Canvas::new(SMALL, SMALL, &camera);
    for (number, piece) in pieces.iter().enumerate() {
        canvas.triangle(piece.at.map_each(|p| camera.project(p)), number as u32);
    }
    let mut seen = Seen { parts: vec![0.0; parts + 1], area: 0.0, relief: 0.0, depth: 0.0 };
    let (mut sum, mut squares) = (0.0, 0.0);
    for cell in 0..SMALL * SMALL {
        let Some(hit) = canvas.get(cell) else { continue };
        let piece = &pieces[hit.item as usize];
        seen.parts[(piece.label as usize).min(parts)] += 1.0;
        seen.area += 1.0;
        sum += hit.depth;
        squares += hit.depth * hit.depth;
        for next in [cell + 1, cell + SMALL] {
            if next < SMALL * SMALL
                && let Some(other) = canvas.get(next)
                && (other.depth - hit.depth).abs() < 3.0
            {
                seen.relief += 1.0 - dot(piece.normal, pieces[other.item as usize].normal).abs();
            }
        }
    }
    let mean = sum / f64::max(seen.area, 1.0);
    seen.depth = (squares / f64::max(seen.area, 1.0) - mean * mean).max(0.0).sqrt();
    seen
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: all triangles of the sampled faces were kept, millions for polygons with many corners.
    #[test]
    fn a_sample_of_large_polygons_is_bounded_and_covers_the_mesh() {
        for (faces, sides) in [(300, 3), (3, 100_000), (900, 1_000)] {
            let (mut positions, mut corners) = (Vec::new(), Vec::new());
            for face in 0..faces {
                for k in 0..sides {
                    let angle = std::f64::consts::TAU * k as f64 / sides as f64;
                    corners.push(positions.len() as u32);
                    positions.push([angle.cos() + 2.0 * face as f64, angle.sin(), 0.0]);
                }
            }
            let starts = (0..=faces as u64).map(|face| face * sides as u64).collect();
            let mesh = Mesh::from_polygons(positions, starts, corners).unwrap();
            let pieces = sample(&mesh, None, &Run::new(&())).unwrap();
            assert!(pieces.len() <= 3 * SAMPLE, "{faces} {sides}: {}", pieces.len());
            let ends = [0, faces - 1].map(|face| 2.0 * face as f64);
            assert!(ends.iter().all(|x| pieces.iter().any(|piece| (piece.middle[0] - x).abs() < 1.0)));
            assert_eq!(sides == 3, pieces.len() == faces);
        }
    }

    /// Regression: the sample missed the only face with a position, and the mesh was refused as one without any.
    #[test]
    fn a_face_with_a_position_among_very_many_without_is_found() {
        let mut corners = vec![[f64::NAN; 3]; 9 * SAMPLE];
        corners[21..24].copy_from_slice(&[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]]);
        let faces: Vec<[u32; 3]> = (0..3 * SAMPLE as u32).map(|face| [0, 1, 2].map(|k| 3 * face + k)).collect();
        let mesh = Mesh::from_slices(&corners, &faces).unwrap();
        let labels: Vec<u32> = (0..faces.len() as u32).collect();
        let labels_of = |mesh: &Mesh| -> Vec<u32> {
            sample(mesh, Some(&labels), &Run::new(&())).unwrap().iter().map(|piece| piece.label).collect()
        };
        assert_eq!(labels_of(&mesh), [7]);
        corners.fill([f64::NAN; 3]);
        assert_eq!(labels_of(&Mesh::from_slices(&corners, &faces).unwrap()), [0; 0]);
    }
}
