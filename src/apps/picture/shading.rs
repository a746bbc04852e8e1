//! From visible samples to pixels: normals, ambient occlusion, lines, light, and the filter over samples.
//!
//! Everything is computed only for visible samples, after drawing. Cost: 4 bytes per sample for normals (twice that
//! while smoothing), 12 bytes and some 100 ns per pixel for occlusion.

use super::camera::{Camera, Vec3};
use super::raster::{Canvas, Hit, triangles_of};
use super::vertex_normals::VertexNormals;
use crate::base::Result;
use crate::base::vector::{MapEach, add_scaled, dot, double_area, finite, is_zero, minus, unit};
use crate::mesh::Mesh;
use crate::mesh::ply::labelled::colour_of;
use crate::mesh::polygon::double_area_vector;
use crate::store::Run;

// The surface's normal at every sample of a view.
//
// Computed after drawing, only for visible samples: from the vertices' normals if there are some, else from the faces',
// smoothed over neighbouring samples of similar depth (a mesh of a hundred million faces has many per sample, and no
// room for vertex normals). 4 bytes per sample, twice that while smoothing.

/// A unit normal facing the viewer: its components to the right and up, in 1/32767.
pub(super) type Packed = [i16; 2];

/// Number of samples on each side over which normals are smoothed.
const REACH: usize = 2;

/// Packs a normal given in the frame, flipped to face the viewer.
#[inline]
fn pack(n: Vec3) -> Packed {
    let sign = if n[2] < 0.0 { -32767.0 } else { 32767.0 };
    [(n[0] * sign) as i16, (n[1] * sign) as i16]
}

/// Packs an interpolated normal of a face whose own normal is `face`: flipped like the face, and, if it still faces
/// away from the viewer, as may happen near an outline, bent until it is just visible.
#[inline]
fn pack_seen(n: Vec3, face: Vec3) -> Packed {
    let sign = if face[2] < 0.0 { -1.0 } else { 1.0 };
    let seen = [sign * n[0], sign * n[1], (sign * n[2]).max(0.0)];
    pack(if is_zero(seen) { face } else { unit(seen) })
}

/// Components to the right, up, and towards the viewer.
#[inline]
pub(super) fn unpack(packed: Packed) -> [f32; 3] {
    let [x, y] = packed.map_each(|x| f32::from(x) / 32767.0);
    [x, y, (1.0 - x * x - y * y).max(0.0).sqrt()]
}

/// Number of corners above which a face is drawn flat, since each sample searches all of its triangles.
const LONG: usize = 64;

/// A triangle of the most recent face.
struct Corner {
    at: [Vec3; 3],
    own: Vec3,
    normals: [Vec3; 3],
}

/// Normals of all samples; afterwards the canvas has labels instead of faces (0 if there are none).
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
    run.fill_chunks(&mut normals, width, Vec::new, |y, row, known: &mut Vec<Corner>| {
        let mut last = None;
        for (x, normal) in row.iter_mut().enumerate() {
            let Some(hit) = canvas.get(y * width + x) else { continue };
            if last != Some(hit.item) {
                known.clear();
                let long = mesh.faces.with(hit.item as usize, |corners| {
                    (corners.len() > LONG).then(|| camera.frame.of(polygon_normal(mesh, corners)))
                });
                if let Some(normal) = long {
                    // Any triangle will do.
                    let at = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
                    known.push(Corner { at, own: normal, normals: [normal; 3] });
                    last = Some(hit.item);
                }
            }
            if last != Some(hit.item) {
                triangles_of(mesh, hit.item as usize, |corners, at| {
                    let own = unit(double_area(at));
                    let normals = corners.map_each(|corner| vertex_normals.map_or(own, |all| all.at(corner, own)));
                    known.push(Corner {
                        at: at.map_each(|p| camera.project(p)),
                        own: camera.frame.of(own),
                        normals: normals.map_each(|n| camera.frame.of(n)),
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

/// The normal of a polygon as a whole; non-finite corners are skipped.
fn polygon_normal(mesh: &Mesh, corners: &[u32]) -> Vec3 {
    let mut at = corners.iter().map(|&v| mesh.positions.get(v)).filter(|&p| finite(p));
    let first = at.next().unwrap_or_default();
    unit(double_area_vector(at.map(|p| minus(p, first))))
}

/// The normal at a point of a face's triangles, in the one that contains it best.
#[inline]
fn interpolate(triangles: &[Corner], x: f64, y: f64) -> Packed {
    let mut best = (f64::NEG_INFINITY, [0.0; 3], [0.0; 3]);
    for triangle in triangles {
        let side = |a: Vec3, b: Vec3| (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
        let [a, b, c] = triangle.at;
        let areas = [side(b, c), side(c, a), side(a, b)];
        let total: f64 = areas.iter().sum();
        if total == 0.0 {
            continue;
        }
        let shares = areas.map_each(|area| area / total);
        let inside = shares[0].min(shares[1]).min(shares[2]);
        if inside > best.0 {
            let mut sum = [0.0; 3];
            for k in 0..3 {
                sum = add_scaled(sum, shares[k].max(0.0), triangle.normals[k]);
            }
            best = (inside, sum, triangle.own);
        }
    }
    pack_seen(best.1, best.2)
}

/// Means along one axis (samples `step` apart) over samples of similar depth.
fn smooth(normals: &[Packed], canvas: &Canvas, step: usize, run: &Run) -> Result<Vec<Packed>> {
    let mut out = vec![[0i16; 2]; normals.len()];
    let width = canvas.width;
    run.fill_chunks(
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
                *out = pack(unit(sum.map_each(f64::from)));
            }
            Ok(())
        },
    )?;
    Ok(out)
}

// Ambient occlusion: how much of the sky is visible from each pixel, according to the z-buffer.
//
// Around a pixel, points of the z-buffer at two scales (folds, and the space between limbs) occlude according to their
// height above the pixel's tangent plane and their proximity. The sampling pattern is rotated from pixel to pixel in a
// 4 × 4 pattern, and the mean over that pattern is smooth. 12 bytes per pixel, some 100 ns.

/// Number of points sampled per pixel.
const POINTS: usize = 18;
/// Pixels per side of the pattern.
const PATTERN: usize = 4;
/// An empty pixel.
const NOTHING: f32 = f32::INFINITY;

/// Depth, in pixels, and normal of pixels that are `factor` samples wide.
struct Pixels {
    width: usize,
    depth: Vec<f32>,
    normal: Vec<Packed>,
}

impl Pixels {
    fn of(canvas: &Canvas, normals: &[Packed], factor: usize, run: &Run) -> Result<Self> {
        let (width, height) = (canvas.width / factor, canvas.height / factor);
        // The nearest sample in a pixel.
        let nearest = |x: usize, y: usize| {
            let mut pixel = (NOTHING, [0i16; 2]);
            for sample in 0..factor * factor {
                let cell = (y * factor + sample / factor) * canvas.width + x * factor + sample % factor;
                let Some(hit) = canvas.get(cell) else { continue };
                let depth = (hit.depth / factor as f64) as f32;
                if depth < pixel.0 {
                    pixel = (depth, normals[cell]);
                }
            }
            pixel
        };
        let mut both = vec![(NOTHING, [0i16; 2]); width * height];
        fill_pixels(&mut both, width, run, nearest)?;
        let (depth, normal) = both.into_iter().unzip();
        Ok(Self { width, depth, normal })
    }

    #[inline]
    fn height(&self) -> usize {
        self.depth.len() / self.width.max(1)
    }
}

/// Sets each of `pixels`, in rows of `width`, to `value(x, y)`.
fn fill_pixels<T: Send>(
    pixels: &mut [T],
    width: usize,
    run: &Run,
    value: impl Fn(usize, usize) -> T + Sync,
) -> Result<()> {
    let fill = |y: usize, row: &mut [T], (): &mut ()| {
        row.iter_mut().enumerate().for_each(|(x, pixel)| *pixel = value(x, y));
        Ok(())
    };
    run.fill_chunks(pixels, width, || (), fill).map(drop)
}

/// Openness per pixel, 0 (occluded) to 1, for a shape of `size` pixels.
pub(super) fn openness(canvas: &Canvas, normals: &[Packed], factor: usize, size: f64, run: &Run) -> Result<Vec<f32>> {
    let pixels = Pixels::of(canvas, normals, factor, run)?;
    let (width, height) = (pixels.width, pixels.height());
    let turns: Vec<[[f32; 2]; POINTS]> = (0..PATTERN * PATTERN).map(|turn| points(turn, size)).collect();
    let mut raw = vec![1.0f32; width * height];
    fill_pixels(&mut raw, width, run, |x, y| {
        // Neighbouring pixels of the pattern get very different rotations.
        let turn = (x % PATTERN * 5 + y % PATTERN * 7 + (x % PATTERN) * (y % PATTERN) * 3) % (PATTERN * PATTERN);
        one(&pixels, x, y, &turns[turn], size as f32)
    })?;
    let near = (size * 0.02).max(1.5) as f32;
    // The mean over the pattern around a pixel, over pixels of similar depth.
    let mean = |x: usize, y: usize| {
        let depth = pixels.depth[y * width + x];
        if depth == NOTHING {
            return 1.0;
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
        if count > 0.0 { sum / count } else { raw[y * width + x] }
    };
    let mut smooth = vec![1.0f32; width * height];
    fill_pixels(&mut smooth, width, run, mean)?;
    Ok(smooth)
}

/// Offsets of the points: spirals, one per rotation of the pattern, with a third of the points for folds.
fn points(turn: usize, size: f64) -> [[f32; 2]; POINTS] {
    std::array::from_fn(|k| {
        let share = (k as f64 + (turn as f64 + 0.5) / (PATTERN * PATTERN) as f64) / POINTS as f64;
        let radius = size * (0.004 + 0.11 * share * share);
        let angle = 2.399_963 * k as f64 + std::f64::consts::TAU * turn as f64 / (PATTERN * PATTERN) as f64;
        [(radius * angle.cos()) as f32, (radius * angle.sin()) as f32]
    })
}

#[inline]
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
        // Points far in front occlude less of the sky than their height suggests.
        let near = 1.0 - (rise.abs() / (0.22 * size)).min(1.0).powi(2);
        shut += (above - 0.12).max(0.0) * near;
    }
    (1.0 - 2.1 * shut / POINTS as f32).clamp(0.0, 1.0)
}

// Lines: between parts, and at outlines.
//
// Both are derived from the drawn samples: a part ends where a neighbouring sample of similar depth has another label,
// the surface where the next sample lies much deeper than its slope explains.

/// Parameters for drawing lines on a view.
pub(super) struct Lines {
    /// Offsets of the samples within half a line's width.
    near: Vec<[isize; 2]>,
    /// Difference in depth, in samples, that counts as an outline.
    jump: f64,
}

impl Lines {
    /// Lines `width` samples wide on a shape of `size` samples.
    pub(super) fn new(width: f64, size: f64) -> Self {
        let reach = (width / 2.0).max(1.0);
        let whole = reach as isize;
        let near = (-whole..=whole)
            .flat_map(|y| (-whole..=whole).map(move |x| [x, y]))
            .filter(|&[x, y]| (x, y) != (0, 0) && ((x * x + y * y) as f64) <= reach * reach)
            .collect();
        Self { near, jump: (0.012 * size).max(3.0) }
    }

    /// The share of light that lines leave at the sample (`x`, `y`), which has the content `hit`: 1 away from all
    /// lines.
    #[inline]
    pub(super) fn light(&self, canvas: &Canvas, x: usize, y: usize, hit: Hit, parts: bool) -> f32 {
        let at = |[dx, dy]: [isize; 2]| {
            let (i, j) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
            if i < canvas.width && j < canvas.height { canvas.get(j * canvas.width + i) } else { None }
        };
        let unlike = |other: Hit| other.item != hit.item && (other.depth - hit.depth).abs() < 2.0 * self.jump;
        if parts && self.near.iter().any(|&offset| at(offset).is_some_and(unlike)) {
            return 0.16;
        }
        let mut break_off = 0.0f64;
        for [dx, dy] in [[1, 0], [-1, 0], [0, 1], [0, -1]] {
            let slope = at([-dx, -dy]).map_or(0.0, |behind| (behind.depth - hit.depth).abs());
            let fall = at([dx, dy]).map_or(4.0 * self.jump, |other| other.depth - hit.depth);
            break_off = break_off.max((fall - slope - self.jump) / (2.0 * self.jump));
        }
        1.0 - 0.62 * break_off.clamp(0.0, 1.0) as f32
    }
}

// From visible samples to pixels: light, colours, lines, and the box filter over a pixel's samples.

/// The colour of a mesh without labels.
pub(super) const UNLABELLED_COLOUR: [u8; 3] = [0xc9, 0xc3, 0xba];

/// The key light: from the upper left, over the viewer's shoulder.
const KEY: [f32; 3] = [-0.48, 0.58, 0.66];
/// The fill light: from the right, lower and softer.
const FILL: [f32; 3] = [0.78, -0.10, 0.62];

/// A drawn view with all the data that colour it.
pub(super) struct View<'a> {
    pub canvas: &'a Canvas,
    pub normals: &'a [Packed],
    /// One value per pixel.
    pub openness: &'a [f32],
    /// Samples per side of a pixel.
    pub factor: usize,
    /// Colours by label.
    pub colours: &'a [[u8; 3]],
    /// The linear value of each byte of a colour channel.
    pub light_of: [f32; 256],
    pub lines: Option<&'a Lines>,
    /// Whether there are labels.
    pub parts: bool,
}

/// A pixel in linear light, premultiplied by its opacity, and the opacity.
pub(super) type Pixel = [f32; 4];

impl View<'_> {
    /// All pixels, row by row.
    pub(super) fn pixels(&self, run: &Run) -> Result<Vec<Pixel>> {
        let width = self.canvas.width / self.factor;
        let mut pixels = vec![[0.0; 4]; width * (self.canvas.height / self.factor)];
        run.fill_chunks(
            &mut pixels,
            width.max(1),
            || (),
            |y, row, ()| {
                for (x, pixel) in row.iter_mut().enumerate() {
                    *pixel = self.pixel(x, y, self.openness[y * width + x]);
                }
                Ok(())
            },
        )?;
        Ok(pixels)
    }

    #[inline]
    fn pixel(&self, x: usize, y: usize, open: f32) -> Pixel {
        let mut sum = [0.0; 4];
        for sample in 0..self.factor * self.factor {
            let (i, j) = (x * self.factor + sample % self.factor, y * self.factor + sample / self.factor);
            let cell = j * self.canvas.width + i;
            let Some(hit) = self.canvas.get(cell) else { continue };
            let colour = colour_of(self.colours, hit.item).map_each(|part| self.light_of[usize::from(part)]);
            let line = self.lines.map_or(1.0, |lines| lines.light(self.canvas, i, j, hit, self.parts));
            let lit = light(colour, unpack(self.normals[cell]), open);
            (0..3).for_each(|k| sum[k] += lit[k] * line);
            sum[3] += 1.0;
        }
        sum.map_each(|x| x / (self.factor * self.factor) as f32)
    }
}

/// A surface's colour under the two lights and the sky.
#[inline]
fn light(colour: [f32; 3], normal: [f32; 3], open: f32) -> [f32; 3] {
    let along = |l: [f32; 3]| dot(normal, l);
    let key = ((along(KEY) + 0.15) / 1.15).max(0.0);
    let fill = along(FILL).max(0.0);
    let sky = 0.65 + 0.35 * normal[1];
    let open = open * open;
    let diffuse = 0.36 * sky * open + (0.86 * key + 0.16 * fill) * (0.35 + 0.65 * open);
    // A faint highlight, halfway between the key light and the viewer.
    let half = [KEY[0] / 1.822, KEY[1] / 1.822, (KEY[2] + 1.0) / 1.822];
    let gloss = 0.06 * along(half).max(0.0).powi(24) * open;
    colour.map_each(|c| c * diffuse + gloss)
}

/// Converts linear light to a stored byte.
#[inline]
pub(super) fn stored(x: f32) -> u8 {
    let x = x.clamp(0.0, 1.0);
    let x = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (x * 255.0 + 0.5) as u8
}
