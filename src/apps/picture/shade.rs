//! From what each sample shows to pixels: light, colours, lines, and the box filter over a pixel's samples.

use super::lines::Lines;
use super::normals::{Packed, unpack};
use super::raster::Canvas;
use crate::base::Result;
use crate::base::parallel::fill_chunks;
use crate::store::Run;

/// The colour of labels beyond the last colour.
pub(super) const GREY: [u8; 3] = [128; 3];
/// The colour of a mesh without labels.
pub(super) const CLAY: [u8; 3] = [0xc9, 0xc3, 0xba];

/// From the upper left, over the viewer's shoulder.
const KEY: [f32; 3] = [-0.48, 0.58, 0.66];
/// From the right, lower and softer.
const FILL: [f32; 3] = [0.78, -0.10, 0.62];

/// A drawn view with everything that colours it.
pub(super) struct View<'a> {
    pub canvas: &'a Canvas,
    pub normals: &'a [Packed],
    /// A value a pixel.
    pub openness: &'a [f32],
    /// Samples a side of a pixel.
    pub factor: usize,
    /// By label, in linear light.
    pub colours: &'a [[f32; 3]],
    pub lines: Option<&'a Lines>,
    /// Whether there are labels.
    pub parts: bool,
}

/// A pixel in linear light, times its opacity, and that.
pub(super) type Pixel = [f32; 4];

impl View<'_> {
    /// All pixels, row by row.
    pub(super) fn pixels(&self, run: &Run) -> Result<Vec<Pixel>> {
        let width = self.canvas.width / self.factor;
        let mut pixels = vec![[0.0; 4]; width * (self.canvas.height / self.factor)];
        fill_chunks(
            run.threads,
            &run.cancel,
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

    fn pixel(&self, x: usize, y: usize, open: f32) -> Pixel {
        let mut sum = [0.0; 4];
        for sample in 0..self.factor * self.factor {
            let (i, j) = (x * self.factor + sample % self.factor, y * self.factor + sample / self.factor);
            let cell = j * self.canvas.width + i;
            let Some(hit) = self.canvas.get(cell) else { continue };
            let colour = self.colours.get(hit.item as usize).copied().unwrap_or_else(|| GREY.map(linear));
            let line = self.lines.map_or(1.0, |lines| lines.light(self.canvas, i, j, hit, self.parts));
            let lit = light(colour, unpack(self.normals[cell]), open);
            (0..3).for_each(|k| sum[k] += lit[k] * line);
            sum[3] += 1.0;
        }
        sum.map(|x| x / (self.factor * self.factor) as f32)
    }
}

/// A surface's colour under the two lights and the sky.
#[inline]
fn light(colour: [f32; 3], normal: [f32; 3], open: f32) -> [f32; 3] {
    let along = |l: [f32; 3]| normal[0] * l[0] + normal[1] * l[1] + normal[2] * l[2];
    let key = ((along(KEY) + 0.15) / 1.15).max(0.0);
    let fill = along(FILL).max(0.0);
    let sky = 0.65 + 0.35 * normal[1];
    let open = open * open;
    let diffuse = 0.36 * sky * open + (0.86 * key + 0.16 * fill) * (0.35 + 0.65 * open);
    // A faint gloss, between the key light and the viewer.
    let half = [KEY[0] / 1.822, KEY[1] / 1.822, (KEY[2] + 1.0) / 1.822];
    let gloss = 0.06 * along(half).max(0.0).powi(24) * open;
    colour.map(|c| c * diffuse + gloss)
}

/// From a stored byte to linear light.
pub(super) fn linear(byte: u8) -> f32 {
    let x = f32::from(byte) / 255.0;
    if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
}

/// From linear light to a byte to store.
pub(super) fn stored(x: f32) -> u8 {
    let x = x.clamp(0.0, 1.0);
    let x = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (x * 255.0 + 0.5) as u8
}
