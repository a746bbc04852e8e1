//! Ambient occlusion: how much of the sky each pixel sees, from the z-buffer.
//!
//! Around a pixel, points of the z-buffer at two scales (folds, and the space between limbs) count as far as they rise
//! above the pixel's tangent plane and are near. The points are turned from pixel to pixel in a pattern of 4 × 4, and
//! the mean over that pattern is smooth. 12 bytes a pixel, some 100 ns.

use super::normals::{Packed, unpack};
use super::raster::Canvas;
use crate::base::Result;
use crate::base::parallel::fill_chunks;
use crate::store::Run;

/// Points looked at a pixel.
const POINTS: usize = 18;
/// Pixels a side of the pattern.
const PATTERN: usize = 4;
/// A pixel that shows nothing.
const NOTHING: f32 = f32::INFINITY;

/// Depth, in pixels, and normal at pixels that are `factor` samples wide.
struct Pixels {
    width: usize,
    depth: Vec<f32>,
    normal: Vec<Packed>,
}

impl Pixels {
    fn of(canvas: &Canvas, normals: &[Packed], factor: usize, run: &Run) -> Result<Self> {
        let (width, height) = (canvas.width / factor, canvas.height / factor);
        let mut both = vec![(NOTHING, [0i16; 2]); width * height];
        fill_chunks(
            run.threads,
            &run.cancel,
            &mut both,
            width,
            || (),
            |y, row, ()| {
                for (x, pixel) in row.iter_mut().enumerate() {
                    for sample in 0..factor * factor {
                        let cell = (y * factor + sample / factor) * canvas.width + x * factor + sample % factor;
                        if let Some(hit) = canvas.get(cell) {
                            let depth = (hit.depth / factor as f64) as f32;
                            if depth < pixel.0 {
                                *pixel = (depth, normals[cell]);
                            }
                        }
                    }
                }
                Ok(())
            },
        )?;
        let (depth, normal) = both.into_iter().unzip();
        Ok(Self { width, depth, normal })
    }

    fn height(&self) -> usize {
        self.depth.len() / self.width.max(1)
    }
}

/// Openness a pixel, 0 (shut in) to 1, for a shape of `size` pixels.
pub(super) fn openness(canvas: &Canvas, normals: &[Packed], factor: usize, size: f64, run: &Run) -> Result<Vec<f32>> {
    let pixels = Pixels::of(canvas, normals, factor, run)?;
    let (width, height) = (pixels.width, pixels.height());
    let turns: Vec<[[f32; 2]; POINTS]> = (0..PATTERN * PATTERN).map(|turn| points(turn, size)).collect();
    let mut raw = vec![1.0f32; width * height];
    fill_chunks(
        run.threads,
        &run.cancel,
        &mut raw,
        width,
        || (),
        |y, row, ()| {
            for (x, open) in row.iter_mut().enumerate() {
                // Neighbours of the pattern get turns far from one another.
                let turn =
                    (x % PATTERN * 5 + y % PATTERN * 7 + (x % PATTERN) * (y % PATTERN) * 3) % (PATTERN * PATTERN);
                *open = one(&pixels, x, y, &turns[turn], size as f32);
            }
            Ok(())
        },
    )?;
    let near = (size * 0.02).max(1.5) as f32;
    let mut smooth = vec![1.0f32; width * height];
    fill_chunks(
        run.threads,
        &run.cancel,
        &mut smooth,
        width,
        || (),
        |y, row, ()| {
            for (x, out) in row.iter_mut().enumerate() {
                let depth = pixels.depth[y * width + x];
                if depth == NOTHING {
                    continue;
                }
                let (mut sum, mut count) = (0.0, 0.0);
                for j in y.saturating_sub(2)..(y + 2).min(height) {
                    for i in x.saturating_sub(2)..(x + 2).min(width) {
                        if (pixels.depth[j * width + i] - depth).abs() < near {
                            sum += raw[j * width + i];
                            count += 1.0;
                        }
                    }
                }
                *out = if count > 0.0 { sum / count } else { raw[y * width + x] };
            }
            Ok(())
        },
    )?;
    Ok(smooth)
}

/// Offsets of the points: spirals, one turn of the pattern each, a third of them for folds.
fn points(turn: usize, size: f64) -> [[f32; 2]; POINTS] {
    std::array::from_fn(|k| {
        let share = (k as f64 + (turn as f64 + 0.5) / (PATTERN * PATTERN) as f64) / POINTS as f64;
        let radius = size * (0.004 + 0.11 * share * share);
        let angle = 2.399_963 * k as f64 + std::f64::consts::TAU * turn as f64 / (PATTERN * PATTERN) as f64;
        [(radius * angle.cos()) as f32, (radius * angle.sin()) as f32]
    })
}

fn one(pixels: &Pixels, x: usize, y: usize, points: &[[f32; 2]; POINTS], size: f32) -> f32 {
    let depth = pixels.depth[y * pixels.width + x];
    if depth == NOTHING {
        return 1.0;
    }
    let normal = unpack(pixels.normal[y * pixels.width + x]);
    let mut shut = 0.0;
    for &[dx, dy] in points {
        let (dx, dy) = (dx.round(), dy.round());
        let (i, j) = (x as f32 + dx, y as f32 + dy);
        if i < 0.0 || j < 0.0 || i as usize >= pixels.width || j as usize >= pixels.height() {
            continue;
        }
        let there = pixels.depth[j as usize * pixels.width + i as usize];
        if there == NOTHING {
            continue;
        }
        let rise = depth - there;
        let square = dx * dx + dy * dy + rise * rise;
        if square < 0.5 {
            continue;
        }
        let above = (dx * normal[0] - dy * normal[1] + rise * normal[2]) / square.sqrt();
        // What is far in front hides less of the sky than it seems to.
        let near = 1.0 - (rise.abs() / (0.22 * size)).min(1.0).powi(2);
        shut += (above - 0.12).max(0.0) * near;
    }
    (1.0 - 2.1 * shut / POINTS as f32).clamp(0.0, 1.0)
}
