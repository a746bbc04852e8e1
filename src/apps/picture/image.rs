//! The finished picture: pixels of one byte per channel, text on them, and the PNG file.
//!
//! Uses four bytes per pixel.

use super::shading::{Pixel, stored};
use crate::apps::colours::linear;
use crate::apps::text;
use crate::base::{Error, Result};
use crate::mesh::output::publish;
use std::io::BufWriter;
use std::path::Path;

/// A picture in sRGB with opacity.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green, blue and opacity of each pixel, row by row from the top.
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

    /// Composites pixels (in rows of `width`) over the picture with their first at (`x`, `y`).
    pub(super) fn composite(&mut self, x: usize, y: usize, width: usize, pixels: &[Pixel]) {
        for (j, row) in pixels.chunks(width.max(1)).enumerate() {
            for (i, pixel) in row.iter().enumerate() {
                self.blend(x + i, y + j, *pixel);
            }
        }
    }

    /// Composites one pixel over the picture; outside it, nothing happens.
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

    /// Writes a PNG file, by rename; without an opacity channel if nothing is transparent.
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
    publish(path, 0, |file| {
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

/// Pixels of an em per dot of the legend.
const EM: f64 = 9.5;

/// Width of `text` in pixels at `dot` pixels per dot.
pub(super) fn text_width(text: &str, dot: f64) -> f64 {
    text::width(text, EM * dot)
}

/// Writes `text` in linear `colour` with the upper left corner of its capitals at (`x`, `y`).
pub(super) fn write_text(image: &mut Image, text: &str, x: f64, y: f64, dot: f64, colour: [f32; 3]) {
    text::draw(text, [x, y + 7. * dot], EM * dot, |x, y, coverage| {
        if let (Ok(x), Ok(y)) = (x.try_into(), y.try_into()) {
            image.blend(x, y, [colour[0] * coverage, colour[1] * coverage, colour[2] * coverage, coverage]);
        }
    });
}
