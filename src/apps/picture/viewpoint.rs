//! From where to look: the view that shows most.
//!
//! Sixty views around the upright axis, from eye level to well above, are drawn small from a sample of the mesh. A view
//! counts for how much of each part it shows against the view that shows it best (small parts weigh more than their
//! area), for its area, for the relief on it, and for its depth; views from slightly above and from what is the front by custom
//! are preferred. Some 0.1 s.

use super::camera::{Camera, Extent, Frame};
use super::raster::Canvas;
use super::survey::Piece;
use super::vector::{Vec3, dot};
use crate::base::Result;
use crate::base::parallel::map_chunks;
use crate::store::Run;

/// Views around, and their elevations in degrees with what custom gives them.
const AROUND: usize = 20;
const ELEVATIONS: [(f64, f64); 3] = [(4.0, 0.05), (18.0, 0.12), (36.0, 0.0)];
/// Samples a side of the small picture.
const SMALL: usize = 112;

/// What a view shows.
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
    let seen = map_chunks(run.threads, &run.cancel, views.len(), || (), look)?;
    let most = |value: &dyn Fn(&Seen) -> f64| seen.iter().map(value).fold(f64::MIN_POSITIVE, f64::max);
    let (area, relief, depth) = (most(&|s| s.area), most(&|s| s.relief), most(&|s| s.depth));
    let best: Vec<f64> = (0..=parts).map(|part| most(&|s| s.parts[part])).collect();
    let weight: Vec<f64> = best.iter().map(|&cells| if cells < 4.0 { 0.0 } else { cells.sqrt() }).collect();
    let total = weight.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    // Shapes with y up look along z by custom, those with z up along y, as in anatomy.
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
    tracing::debug!(azimuth = azimuth.to_degrees(), elevation = elevation.to_degrees(), score = chosen.1, "view");
    Ok((azimuth, elevation))
}

fn look(pieces: &[Piece], parts: usize, frame: &Frame) -> Seen {
    let mut extent = Extent::EMPTY;
    let mut size = Extent::EMPTY;
    for piece in pieces {
        extent.hold(frame.of(piece.middle));
        size.hold(piece.middle);
    }
    let scale = 0.94 * SMALL as f64 / size.diagonal().max(f64::MIN_POSITIVE);
    let camera = Camera::fit(*frame, &extent, scale, SMALL, SMALL);
    let canvas = Canvas::new(SMALL, SMALL, &camera);
    for (number, piece) in pieces.iter().enumerate() {
        canvas.triangle(piece.at.map(|p| camera.project(p)), number as u32);
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
