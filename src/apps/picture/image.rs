//! The finished picture: pixels of a byte a channel, and the PNG file.

use super::shade::{Pixel, stored};
use crate::base::{Error, Result};
use std::fs::File;
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
            under[k] = stored((over + super::shade::linear(under[k]) * before) / whole);
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
