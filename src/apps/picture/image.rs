//! The finished picture: pixels of one byte per channel, text on them, and the PNG file.

use super::shading::{Pixel, linear, stored};
use crate::base::{Error, Result};
use crate::mesh::output::by_rename;
use std::io::BufWriter;
use std::path::Path;

/// A picture in sRGB with opacity.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green, blue, opacity of each pixel, row by row from the top.
    pub pixels: Vec<[u8; 4]>,
}

impl Image {
    /// A picture of one colour.
    pub(super) fn filled(width: usize, height: usize, colour: [u8; 4]) -> Self {
        Self { width, height, pixels: vec![colour; width * height] }
    }

    /// Two pictures side by side, at the height of the higher one.
    pub fn beside(left: &Self, right: &Self) -> Self {
        let mut both = Self::filled(left.width + right.width, left.height.max(right.height), [255, 255, 255, 255]);
        for (image, start) in [(left, 0), (right, left.width)] {
            for (y, row) in image.pixels.chunks(image.width.max(1)).enumerate() {
                let at = y * both.width + start;
                both.pixels[at..at + row.len()].copy_from_slice(row);
            }
        }
        both
    }

    /// Lays pixels (in rows of `width`) over the picture with their first at (`x`, `y`).
    pub(super) fn lay(&mut self, x: usize, y: usize, width: usize, pixels: &[Pixel]) {
        for (j, row) in pixels.chunks(width.max(1)).enumerate() {
            for (i, pixel) in row.iter().enumerate() {
                self.blend(x + i, y + j, *pixel);
            }
        }
    }

    /// Lays one pixel over the picture; outside of it, nothing happens.
    pub(super) fn blend(&mut self, x: usize, y: usize, [r, g, b, opacity]: Pixel) {
        if x >= self.width || y >= self.height || opacity <= 0.0 {
            return;
        }
        let under = &mut self.pixels[y * self.width + x];
        let before = f32::from(under[3]) / 255.0 * (1.0 - opacity);
        let whole = opacity + before;
        for (k, over) in [r, g, b].into_iter().enumerate() {
            under[k] = stored((over + linear(under[k]) * before) / whole);
        }
        under[3] = (whole * 255.0 + 0.5) as u8;
    }

    /// Writes a PNG file, by rename; without an opacity channel where nothing is transparent.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write_png(&self, path: &Path) -> Result<()> {
        let size = (self.width as u32, self.height as u32);
        if self.pixels.iter().all(|pixel| pixel[3] == 255) {
            let bytes: Vec<u8> = self.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
            return write_png(path, size, png::ColorType::Rgb, &bytes);
        }
        write_png(path, size, png::ColorType::Rgba, self.pixels.as_flattened())
    }
}

/// Writes `pixels`, one byte per channel, row by row from the top, as a PNG file, by rename.
pub(in crate::apps) fn write_png(path: &Path, size: (u32, u32), colour: png::ColorType, pixels: &[u8]) -> Result<()> {
    by_rename(path, 0, false, |file| {
        let mut encoder = png::Encoder::new(BufWriter::with_capacity(1 << 18, file), size.0, size.1);
        encoder.set_color(colour);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Balanced);
        let written = encoder.write_header().and_then(|mut writer| {
            writer.write_image_data(pixels)?;
            writer.finish()
        });
        written.map_err(|error| match error {
            png::EncodingError::IoError(source) => Error::io(path, "write")(source),
            other => Error::io(path, "write")(std::io::Error::other(other)),
        })
    })
}

/// Half a stroke's width in dots.
const STROKE: f64 = 0.46;

/// Dots of a glyph's side.
pub(in crate::apps) const SIDE: usize = 8;

/// Rows of a glyph of the built-in font from the top, the leftmost dot in the lowest bit; blank for what the font lacks.
pub(in crate::apps) fn glyph_rows(c: char) -> [u8; SIDE] {
    font8x8::legacy::BASIC_LEGACY.get(c as usize).copied().unwrap_or_default()
}

/// Pixels that `text` takes at `dot` pixels per dot.
pub(super) fn text_width(text: &str, dot: f64) -> f64 {
    text.chars().map(advance).sum::<f64>() * dot
}

/// Dots from a glyph to the next: its own columns and a gap.
fn advance(c: char) -> f64 {
    let columns = glyph_rows(c).into_iter().fold(0, |all, row| all | row);
    if columns == 0 { 3.0 } else { f64::from(8 - columns.leading_zeros() - columns.trailing_zeros()) + 0.5 }
}

/// Writes `text` in linear `colour` with its upper left corner at (`x`, `y`).
pub(super) fn write_text(image: &mut Image, text: &str, x: f64, y: f64, dot: f64, colour: [f32; 3]) {
    let mut left = x;
    for c in text.chars() {
        let rows = glyph_rows(c);
        let margin = rows.into_iter().fold(0, |all, row| all | row).trailing_zeros();
        draw_glyph(image, &rows.map(|row| row.checked_shr(margin).unwrap_or(0)), [left, y], dot, colour);
        left += advance(c) * dot;
    }
}

/// First and last dot of each run of lit dots in a row.
fn runs(row: u8) -> Vec<[f64; 2]> {
    let lit = |i: usize| i < SIDE && row >> i & 1 == 1;
    let starts = (0..SIDE).filter(|&i| lit(i) && (i == 0 || !lit(i - 1)));
    starts.map(|i| [i as f64, (i..SIDE).take_while(|&k| lit(k)).last().unwrap_or(i) as f64]).collect()
}

/// The glyph's centre lines, in dots. Upright strokes of the font are two dots wide: a run is drawn without half a dot at
/// either end, and joined to the runs below that it touches, straight down where they overlap, else aslant.
fn strokes(rows: &[u8; SIDE]) -> Vec<[f64; 4]> {
    let thin = |[a, b]: [f64; 2]| if a < b { [a + 0.5, b - 0.5] } else { [a, b] };
    let mut strokes = Vec::new();
    for (j, &row) in rows.iter().enumerate() {
        let (y, below) = (j as f64, rows.get(j + 1).copied().unwrap_or(0));
        for run in runs(row) {
            let [a, b] = thin(run);
            strokes.push([a, y, b, y]);
            for next in runs(below).into_iter().filter(|next| next[0] <= run[1] + 1.0 && run[0] <= next[1] + 1.0) {
                let [c, d] = thin(next);
                if c <= b && a <= d {
                    strokes.extend([a.max(c), b.min(d)].map(|x| [x, y, x, y + 1.0]));
                } else {
                    strokes.push(if b < c { [b, y, c, y + 1.0] } else { [a, y, d, y + 1.0] });
                }
            }
        }
    }
    strokes
}

/// Draws one glyph as strokes with round ends.
fn draw_glyph(image: &mut Image, rows: &[u8; SIDE], [left, top]: [f64; 2], dot: f64, colour: [f32; 3]) {
    let strokes = strokes(rows);
    for y in (top - dot).floor().max(0.0) as usize..(top + 9.0 * dot).ceil().max(0.0) as usize {
        for x in (left - dot).floor().max(0.0) as usize..(left + 9.0 * dot).ceil().max(0.0) as usize {
            let (u, v) = ((x as f64 + 0.5 - left) / dot - 0.5, (y as f64 + 0.5 - top) / dot - 0.5);
            let away = |&[a, b, c, d]: &[f64; 4]| {
                let length = (c - a) * (c - a) + (d - b) * (d - b);
                let along =
                    if length > 0.0 { (((u - a) * (c - a) + (v - b) * (d - b)) / length).clamp(0.0, 1.0) } else { 0.0 };
                (u - a - along * (c - a)).hypot(v - b - along * (d - b))
            };
            let away = strokes.iter().map(away).fold(f64::INFINITY, f64::min);
            let opacity = ((STROKE - away) * dot + 0.5).clamp(0.0, 1.0) as f32;
            image.blend(x, y, [colour[0] * opacity, colour[1] * opacity, colour[2] * opacity, opacity]);
        }
    }
}
