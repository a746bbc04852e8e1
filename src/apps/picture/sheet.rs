//! The sheet: views in rows and columns at one scale, and the making of each.

use super::camera::{Camera, Extent, Frame};
use super::lines::Lines;
use super::normals;
use super::occlusion;
use super::params::PictureParams;
use super::raster::Canvas;
use super::shade::{Pixel, View};
use super::vertex_normals::VertexNormals;
use crate::base::Result;
use crate::mesh::Mesh;
use crate::store::Run;

/// Share of a cell that a shape fills at the most.
const FILL: f64 = 0.92;

/// How views share the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sheet {
    columns: usize,
    /// Pixels of a cell.
    pub cell: (usize, usize),
    /// Pixels a unit of space.
    scale: f64,
    /// The shape's diagonal, in pixels.
    size: f64,
}

/// What is drawn.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub mesh: &'a Mesh,
    pub labels: Option<&'a [u32]>,
    pub vertex_normals: Option<&'a VertexNormals>,
    pub tints: &'a [[f32; 3]],
}

impl Sheet {
    /// The rows and columns that show views of these extents largest on `width` × `height` pixels.
    pub(super) fn of(extents: &[Extent], width: usize, height: usize) -> Self {
        let views = extents.len().max(1);
        let most = |k: usize| extents.iter().map(|extent| extent.length(k)).fold(f64::MIN_POSITIVE, f64::max);
        let (across, upright) = (most(0), most(1));
        let diagonal = extents.iter().map(Extent::diagonal).fold(f64::MIN_POSITIVE, f64::max);
        let with = |columns: usize| {
            let cell = ((width / columns).max(1), (height / views.div_ceil(columns)).max(1));
            // A flat shape seen from its edge still fits.
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

    /// Bytes that drawing a view takes: cells, normals twice, and what a pixel holds.
    pub(super) fn bytes(&self, samples: usize) -> u64 {
        let pixels = (self.cell.0 * self.cell.1) as u64;
        pixels * (16 * (samples * samples) as u64 + 36)
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
        let normals = normals::normals(scene.mesh, scene.labels, &canvas, &camera, scene.vertex_normals, run)?;
        let openness = occlusion::openness(&canvas, &normals, factor, self.size, run)?;
        let short = self.cell.0.min(self.cell.1) as f64;
        let lines = Lines::new((short / 800.0).max(1.0) * 1.5 * factor as f64, self.size * factor as f64);
        let view = View {
            canvas: &canvas,
            normals: &normals,
            openness: &openness,
            factor,
            colours: scene.tints,
            lines: params.lines.then_some(&lines),
            parts: scene.labels.is_some(),
        };
        view.pixels(run)
    }
}
