//! The sheet: its parameters, the views in rows and columns at one scale, their rendering, and the legend beside them.

use super::camera::{Camera, Extent, Frame, Vec3};
use super::image::{Image, text_width, write_text};
use super::raster::Canvas;
use super::shading::{Lines, Pixel, View, normals, openness};
use super::vertex_normals::VertexNormals;
use crate::apps::colours::linear;
use crate::base::sort::sort_by;
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh::ply::labelled::GREY;
use crate::store::budget::Grant;
use crate::store::{Budget, Run};

/// The axis of the file that points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Up {
    /// 0, 1, 2: x, y, z.
    pub axis: usize,
    /// Whether its negative direction points up.
    pub negative: bool,
}

impl Up {
    pub(super) fn direction(self) -> Vec3 {
        let mut up = [0.0; 3];
        up[self.axis.min(2)] = if self.negative { -1.0 } else { 1.0 };
        up
    }
}

impl std::str::FromStr for Up {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (negative, axis) = match text.strip_prefix('-') {
            Some(axis) => (true, axis),
            None => (false, text.strip_prefix('+').unwrap_or(text)),
        };
        let axis = ["x", "y", "z"].iter().position(|known| axis.eq_ignore_ascii_case(known));
        axis.map(|axis| Self { axis, negative })
            .ok_or_else(|| format!("{text:?} is not an axis; write x, y, z, -x, -y or -z"))
    }
}

/// Size, views and style of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PictureParams {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Number of views on one sheet.
    pub views: usize,
    /// Whether the background is transparent instead of white.
    pub transparent: bool,
    /// Whether a legend lists the shares of the surface.
    pub legend: bool,
    /// Whether lines are drawn between parts and at outlines.
    pub lines: bool,
    /// Samples per side of a pixel, 1 to 4.
    pub samples: usize,
    /// The axis that points up; chosen automatically if `None`.
    pub up: Option<Up>,
    /// Rotation around that axis in degrees, relative to the automatic view.
    pub turn: f64,
    /// Additional elevation in degrees, relative to the automatic view.
    pub tilt: f64,
}

impl Default for PictureParams {
    fn default() -> Self {
        Self {
            width: 1600,
            height: 1200,
            views: 1,
            transparent: false,
            legend: true,
            lines: true,
            samples: 2,
            up: None,
            turn: 0.0,
            tilt: 0.0,
        }
    }
}

crate::base::setters::setters!(PictureParams {
    width: usize,
    height: usize,
    views: usize,
    transparent: bool,
    legend: bool,
    lines: bool,
    samples: usize,
    up: Option<Up>,
    turn: f64,
    tilt: f64,
});

impl PictureParams {
    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// [`Error::Parameter`].
    pub fn check(&self) -> Result<()> {
        let within = |name: &str, value: usize, least: usize, most: usize| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(Error::parameter(name, format!("{value} is out of range"), format!("choose {least} to {most}")))
            }
        };
        within("size", self.width, 16, 16384)?;
        within("size", self.height, 16, 16384)?;
        within("views", self.views, 1, 64)?;
        within("samples", self.samples, 1, 4)?;
        for (name, angle) in [("turn", self.turn), ("tilt", self.tilt)] {
            if !angle.is_finite() {
                return Err(Error::parameter(name, format!("{angle} is not an angle"), "give degrees"));
            }
        }
        Ok(())
    }

    /// Maximum number of bytes for the picture itself, its encoded form, and drawing a view: cells, normals twice, and
    /// per-pixel data.
    pub(super) fn bytes(&self) -> u64 {
        let pixels = (self.width * self.height) as u64;
        let per_cell = 16 * (self.samples * self.samples) as u64 + 36;
        pixels * 7 + pixels * per_cell / self.views.max(1) as u64
    }

    /// Rejects a picture for which `budget` is too small, before any work.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn check_budget(&self, budget: &Budget) -> Result<()> {
        // As if nothing were taken from it yet.
        Self::grant(self.bytes(), &Budget::new(budget.total())).map(drop)
    }

    /// Takes the `bytes` of a picture from `budget`.
    pub(super) fn grant(bytes: u64, budget: &Budget) -> Result<Grant> {
        budget.take_or("the picture", bytes, "make the picture smaller")
    }
}

/// Maximum share of a cell that a shape fills.
const FILL: f64 = 0.92;

/// The arrangement of views in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sheet {
    columns: usize,
    /// Pixels of a cell.
    pub cell: (usize, usize),
    /// Pixels per unit of space.
    scale: f64,
    /// The shape's diagonal, in pixels.
    size: f64,
}

/// The drawn content.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub mesh: &'a Mesh,
    pub labels: Option<&'a [u32]>,
    pub vertex_normals: Option<&'a VertexNormals>,
    pub tints: &'a [[u8; 3]],
}

impl Sheet {
    /// The rows and columns that show views of these extents as large as possible on `width` × `height` pixels.
    pub(super) fn of(extents: &[Extent], width: usize, height: usize) -> Self {
        let views = extents.len().max(1);
        let most = |k: usize| extents.iter().map(|extent| extent.length(k)).fold(f64::MIN_POSITIVE, f64::max);
        let (across, upright) = (most(0), most(1));
        let diagonal = extents.iter().map(Extent::diagonal).fold(f64::MIN_POSITIVE, f64::max);
        let with = |columns: usize| {
            let cell = ((width / columns).max(1), (height / views.div_ceil(columns)).max(1));
            // A flat shape seen edge-on must still fit.
            let scale = (FILL * cell.0 as f64 / across.max(1e-6 * diagonal))
                .min(FILL * cell.1 as f64 / upright.max(1e-6 * diagonal));
            Self { columns, cell, scale, size: diagonal * scale }
        };
        (2..=views).map(with).fold(with(1), |best, one| if one.scale > best.scale { one } else { best })
    }

    /// The upper left pixel of a view.
    pub(super) fn place(&self, view: usize) -> (usize, usize) {
        (view % self.columns * self.cell.0, view / self.columns * self.cell.1)
    }

    /// The pixels of a cell.
    pub(super) fn view(
        &self,
        scene: &Scene,
        frame: &Frame,
        extent: &Extent,
        params: &PictureParams,
        run: &Run,
    ) -> Result<Vec<Pixel>> {
        let factor = params.samples;
        let (width, height) = (self.cell.0 * factor, self.cell.1 * factor);
        let camera = Camera::fit(*frame, extent, self.scale * factor as f64, width, height);
        let canvas = Canvas::new(width, height, &camera);
        canvas.draw(scene.mesh, &camera, run)?;
        let normals = normals(scene.mesh, scene.labels, &canvas, &camera, scene.vertex_normals, run)?;
        let openness = openness(&canvas, &normals, factor, self.size, run)?;
        let short = self.cell.0.min(self.cell.1) as f64;
        let lines = Lines::new((short / 800.0).max(1.0) * 1.5 * factor as f64, self.size * factor as f64);
        let view = View {
            canvas: &canvas,
            normals: &normals,
            openness: &openness,
            factor,
            colours: scene.tints,
            light_of: std::array::from_fn(|part| linear(part as u8)),
            lines: params.lines.then_some(&lines),
            parts: scene.labels.is_some(),
        };
        view.pixels(run)
    }
}

/// Colour of the shares and labels in the legend.
const DARK: [f32; 3] = [0.02; 3];
const PALE: [f32; 3] = [0.13; 3];

/// Maximum number of letters of a name in the legend.
const LONGEST: usize = 24;
/// The label of faces in no part, or in a part that the legend does not distinguish.
const OTHERS: &str = "other faces";

/// A line of the legend.
#[derive(Clone, Debug, PartialEq)]
struct Entry {
    label: usize,
    /// The name, or the number if there is none.
    text: String,
    colour: [u8; 3],
    share: f64,
}

/// A legend ready for drawing.
#[derive(Clone, Debug)]
pub(super) struct Legend {
    entries: Vec<Entry>,
    /// Number of parts without room in the legend.
    more: usize,
    dot: f64,
}

impl Legend {
    /// The legend for a picture of `width` × `height`, given the `areas` of the parts that have `colours`, and last the
    /// area in none of them; `None` if the picture is too small, or there is only one part.
    pub(super) fn of(
        areas: &[f64],
        (colours, names): (&[[u8; 3]], &[String]),
        width: usize,
        height: usize,
    ) -> Option<Self> {
        let total: f64 = areas.iter().sum();
        let mut entries: Vec<Entry> = areas
            .iter()
            .enumerate()
            .filter(|(_, area)| **area > 0.0)
            .map(|(label, area)| {
                let colour = colours.get(label).copied();
                let name = if colour.is_some() { names.get(label).map_or("", String::as_str) } else { OTHERS };
                Entry { label, text: shown(name, label), colour: colour.unwrap_or(GREY), share: area / total }
            })
            .collect();
        sort_by(&mut entries, |a, b| b.share.total_cmp(&a.share).then(a.label.cmp(&b.label)));
        if entries.len() < 2 || height < 160 || width < 240 {
            return None;
        }
        let dot = (height.min(width) as f64 / 520.0).clamp(1.0, 12.0);
        let room = ((height as f64 - 20.0 * dot) / (13.0 * dot)) as usize;
        let more = if entries.len() > room { entries.len() + 1 - room } else { 0 };
        entries.truncate(entries.len() - more);
        Some(Self { entries, more, dot })
    }

    /// Width of the legend in pixels, on the picture's right side.
    pub(super) fn width(&self) -> usize {
        (self
            .texts()
            .map(|(label, share)| text_width(&label, self.dot) + text_width(&share, self.dot))
            .fold(0.0, f64::max)
            + 36.0 * self.dot) as usize
    }

    fn texts(&self) -> impl Iterator<Item = (String, String)> + '_ {
        self.entries.iter().map(|entry| (entry.text.clone(), format!("{:.1} %", 100.0 * entry.share)))
    }

    /// Draws it on the right side, vertically centred.
    pub(super) fn draw(&self, image: &mut Image) {
        let dot = self.dot;
        let line = 13.0 * dot;
        let lines = self.entries.len() + usize::from(self.more > 0);
        let mut top = (image.height as f64 - lines as f64 * line) / 2.0;
        let left = (image.width - self.width().min(image.width)) as f64;
        let right = image.width as f64 - 10.0 * dot;
        for (entry, (label, share)) in self.entries.iter().zip(self.texts().collect::<Vec<_>>()) {
            swatch(image, left + 2.0 * dot, top - dot, 9.0 * dot, entry.colour);
            write_text(image, &label, left + 16.0 * dot, top, dot, PALE);
            write_text(image, &share, right - text_width(&share, dot), top, dot, DARK);
            top += line;
        }
        if self.more > 0 {
            write_text(image, &format!("+ {} more", self.more), left + 2.0 * dot, top, dot, PALE);
        }
    }
}

/// The displayed name, or the number of a part without one.
fn shown(name: &str, label: usize) -> String {
    match name.char_indices().nth(LONGEST) {
        _ if name.is_empty() => label.to_string(),
        Some((end, _)) => format!("{}…", &name[..end]),
        None => name.to_string(),
    }
}

/// A coloured disc.
fn swatch(image: &mut Image, left: f64, top: f64, size: f64, colour: [u8; 3]) {
    let colour = colour.map(linear);
    let radius = size / 2.0;
    for y in top.max(0.0) as usize..(top + size + 1.0).max(0.0) as usize {
        for x in left.max(0.0) as usize..(left + size + 1.0).max(0.0) as usize {
            let away = (x as f64 + 0.5 - left - radius).hypot(y as f64 + 0.5 - top - radius);
            let opacity = (radius - away + 0.5).clamp(0.0, 1.0) as f32;
            let rim = if away > radius - (size / 12.0).max(1.0) { 0.5 } else { 1.0 } * opacity;
            image.blend(x, y, [colour[0] * rim, colour[1] * rim, colour[2] * rim, opacity]);
        }
    }
}
