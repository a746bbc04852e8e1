//! The finished picture: pixels of one byte per channel, text on them, and the PNG file.

use super::shading::{Pixel, linear, stored};
use crate::base::{Error, Result};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

// --- The finished picture: pixels of a byte a channel, and the PNG file.

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
        let partial = crate::store::npy::partial_name(path);
        let file = File::create(&partial).map_err(Error::io(&partial, "create"))?;
        let written = self.encode(BufWriter::with_capacity(1 << 18, file)).map_err(|error| match error {
            png::EncodingError::IoError(source) => Error::io(&partial, "write")(source),
            other => Error::io(&partial, "write")(std::io::Error::other(other)),
        });
        if written.is_err() {
            let _ = std::fs::remove_file(&partial);
            return written;
        }
        std::fs::rename(&partial, path).map_err(Error::io(&partial, "rename"))
    }

    /// Writes PNG to a stream.
    fn encode(&self, out: impl std::io::Write) -> std::result::Result<(), png::EncodingError> {
        let opaque = self.pixels.iter().all(|pixel| pixel[3] == 255);
        let mut encoder = png::Encoder::new(out, self.width as u32, self.height as u32);
        encoder.set_color(if opaque { png::ColorType::Rgb } else { png::ColorType::Rgba });
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Balanced);
        let mut writer = encoder.write_header()?;
        if opaque {
            let bytes: Vec<u8> = self.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
            writer.write_image_data(&bytes)?;
        } else {
            writer.write_image_data(self.pixels.as_flattened())?;
        }
        writer.finish()
    }
}

// --- A few glyphs of five by seven dots for the legend, drawn smoothly at any size.

/// Half a stroke's width in dots.
const STROKE: f64 = 0.46;

/// Rows of each glyph from the top, the leftmost dot in the highest of five bits.
const GLYPHS: [(char, [u8; 7]); 17] = [
    ('0', [0b01110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('1', [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('2', [0b01110, 0b10001, 0b00001, 0b00110, 0b01000, 0b10000, 0b11111]),
    ('3', [0b01110, 0b10001, 0b00001, 0b00110, 0b00001, 0b10001, 0b01110]),
    ('4', [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010]),
    ('5', [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110]),
    ('6', [0b01110, 0b10000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110]),
    ('7', [0b11111, 0b00001, 0b00010, 0b00100, 0b00100, 0b01000, 0b01000]),
    ('8', [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110]),
    ('9', [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00001, 0b01110]),
    ('.', [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b00100, 0b00100]),
    ('%', [0b11001, 0b11001, 0b00010, 0b00100, 0b01000, 0b10011, 0b10011]),
    ('+', [0b00000, 0b00100, 0b00100, 0b11111, 0b00100, 0b00100, 0b00000]),
    ('m', [0b00000, 0b00000, 0b11010, 0b10101, 0b10101, 0b10101, 0b10101]),
    ('o', [0b00000, 0b00000, 0b01110, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('r', [0b00000, 0b00000, 0b10110, 0b11001, 0b10000, 0b10000, 0b10000]),
    ('e', [0b00000, 0b00000, 0b01110, 0b10001, 0b11111, 0b10000, 0b01110]),
];

/// Pixels that `text` takes at `dot` pixels a dot.
pub(super) fn text_width(text: &str, dot: f64) -> f64 {
    text.chars().map(advance).sum::<f64>() * dot
}

/// Dots from a glyph to the next.
fn advance(c: char) -> f64 {
    match c {
        '.' => 3.5,
        ' ' => 3.0,
        _ => 6.2,
    }
}

/// Writes `text` in linear `colour` with its upper left corner at (`x`, `y`).
pub(super) fn write_text(image: &mut Image, text: &str, x: f64, y: f64, dot: f64, colour: [f32; 3]) {
    let mut left = x;
    for c in text.chars() {
        let shift = if c == '.' { -1.0 } else { 0.0 };
        if let Some((_, rows)) = GLYPHS.iter().find(|(known, _)| *known == c) {
            glyph(image, rows, left + shift * dot, y, dot, colour);
        }
        left += advance(c) * dot;
    }
}

/// Strokes between neighbouring dots, in dots; diagonal ones only where no others join the two.
fn strokes(rows: &[u8; 7]) -> Vec<[f64; 4]> {
    let lit = |i: i64, j: i64| (0..5).contains(&i) && (0..7).contains(&j) && rows[j as usize] >> (4 - i) & 1 == 1;
    let mut strokes = Vec::new();
    for (i, j) in (0..7).flat_map(|j| (0..5).map(move |i| (i, j))).filter(|&(i, j)| lit(i, j)) {
        let mut to = |k: i64, l: i64| strokes.push([i as f64, j as f64, k as f64, l as f64]);
        to(i, j);
        for (k, l) in [(i + 1, j), (i, j + 1)] {
            if lit(k, l) {
                to(k, l);
            }
        }
        for k in [i - 1, i + 1] {
            if lit(k, j + 1) && !lit(k, j) && !lit(i, j + 1) {
                to(k, j + 1);
            }
        }
    }
    strokes
}

/// Draws one glyph as strokes with round ends.
fn glyph(image: &mut Image, rows: &[u8; 7], left: f64, top: f64, dot: f64, colour: [f32; 3]) {
    let strokes = strokes(rows);
    for y in (top - dot).floor().max(0.0) as usize..(top + 8.0 * dot).ceil().max(0.0) as usize {
        for x in (left - dot).floor().max(0.0) as usize..(left + 6.0 * dot).ceil().max(0.0) as usize {
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
