//! Pictures of meshes and their parts, rendered in memory: no window, no graphics card.
//!
//! A mesh of any size is streamed through a z-buffer of two samples per pixel and side; normals, light, ambient
//! occlusion and lines are computed from the visible samples. The view is chosen automatically ([`Up`], and the
//! direction that shows most of most parts), and the result does not depend on the number of threads. Cost: 70 bytes
//! per pixel whatever the mesh, plus 12 per vertex if there are few; a million faces take about a second on two cores,
//! half of which depends on the number of pixels.

mod camera;
pub(super) mod image;
mod raster;
mod shading;
mod sheet;
mod vertex_normals;
mod viewpoint;

pub use sheet::{PictureParams, Up};

use crate::base::vector::finite;
use crate::base::{Error, Result};
use crate::graph;
use crate::mesh::Mesh;
use crate::mesh::geometry::one_per_face;
use crate::store::budget::Grant;
use crate::store::{Context, Run, WorkDir};
use camera::Frame;
pub use image::Image;
use shading::UNLABELLED_COLOUR;
use sheet::{Legend, Sheet};
use vertex_normals::VertexNormals;

/// Maximum number of vertices for smooth normals; the faces of a larger mesh are no larger than a sample.
const SMOOTH: usize = 3_000_000;
/// Maximum number of parts distinguished when choosing the view and in the legend.
const MOST_DISTINCT: usize = 4096;
/// Faces per task where they are counted.
const CHUNK: usize = 1 << 16;

/// Draws `mesh` with its parts in the colours of their labels (grey beyond the last colour), or in a single colour
/// without labels.
///
/// ```
/// use nystrom_stream::apps::colours::palette;
/// use nystrom_stream::apps::picture::{PictureParams, render};
/// use nystrom_stream::mesh::Mesh;
/// use nystrom_stream::store::Run;
/// let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
/// let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]])?;
/// let params = PictureParams::default().width(64).height(48);
/// let image = render(&mesh, Some(&[0, 1]), &palette(2), &params, &Run::new(&()))?;
/// assert_eq!(image.pixels.len(), 64 * 48);
/// image.write_png(&std::env::temp_dir().join("square.png"))?;
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
///
/// # Errors
/// [`Error::Parameter`] for sizes or numbers of views out of range or labels that do not match the faces;
/// [`Error::Unusable`] if no face is finite; [`Error::Memory`]; [`Error::Cancelled`].
pub fn render(
    mesh: &Mesh,
    labels: Option<&[u32]>,
    colours: &[[u8; 3]],
    params: &PictureParams,
    run: &Run,
) -> Result<Image> {
    let work = WorkDir::in_memory(&std::env::temp_dir(), &run.budget);
    render_named(mesh, labels, (colours, &[]), params, Context::new(&work, run))
}

/// [`render`] with names of parts, one per colour and empty for none, in the legend, and with files in a work directory
/// where memory is short.
///
/// # Errors
/// As [`render`].
pub fn render_named(
    mesh: &Mesh,
    labels: Option<&[u32]>,
    (colours, names): (&[[u8; 3]], &[String]),
    params: &PictureParams,
    context: Context<'_>,
) -> Result<Image> {
    let run = context.run;
    params.check()?;
    let (mesh, _grant_of_it) = &in_common_size(mesh, run)?;
    let mesh = &mesh.without_strays(run)?;
    one_per_face("labels", labels.map_or(mesh.faces.len(), <[u32]>::len), mesh.faces.len())?;
    let smooth = mesh.positions.len() <= SMOOTH;
    let bytes = params.bytes() + if smooth { 12 * mesh.positions.len() as u64 } else { 0 };
    let _grant = PictureParams::grant(bytes, &run.budget)?;
    let parts = if labels.is_some() { colours.len().min(MOST_DISTINCT) } else { 0 };
    let legend = match labels.filter(|_| params.legend) {
        Some(labels) => {
            let areas = viewpoint::areas(mesh, labels, parts, run)?;
            Legend::of(&areas, (&colours[..parts], names), params.width, params.height)
        }
        None => None,
    };
    let frames = frames(mesh, labels, parts, params, run)?;
    let extents = raster::extents(mesh, &frames, run)?;
    let room = params.width - legend.as_ref().map_or(0, Legend::width).min(params.width / 2);
    let sheet = Sheet::of(&extents, room, params.height);
    let vertex_normals = if smooth { Some(VertexNormals::of(mesh, context)?) } else { None };
    let tints = if labels.is_some() { colours } else { &[UNLABELLED_COLOUR] };
    let white = if params.transparent { [255, 255, 255, 0] } else { [255; 4] };
    let mut image = Image::filled(params.width, params.height, white);
    for (view, (frame, extent)) in frames.iter().zip(&extents).enumerate() {
        let scene = sheet::Scene { mesh, labels, vertex_normals: vertex_normals.as_ref(), tints };
        let pixels = sheet.view(&scene, frame, extent, params, run)?;
        let (x, y) = sheet.place(view);
        image.composite(x, y, sheet.cell.0, &pixels);
    }
    if let Some(legend) = legend {
        legend.draw(&mut image);
    }
    Ok(image)
}

/// The number of faces that a picture lacks wholly or in part: those with a corner whose coordinates are not finite.
///
/// # Errors
/// [`Error::Cancelled`].
pub fn undrawn(mesh: &Mesh, run: &Run) -> Result<u64> {
    let count = |range| {
        let mut count = 0;
        let is_placed = |v: &u32| finite(mesh.positions.get(*v));
        mesh.faces.for_each(range, |_, corners| count += u64::from(!corners.iter().all(is_placed)));
        Ok(count)
    };
    Ok(run.map_ranges(mesh.faces.len(), CHUNK, count)?.into_iter().sum())
}

/// What helps, besides more memory, where a picture is too large but its size cannot be chosen.
pub const NO_PICTURE: &str = "leave the picture out";

/// The best view, as axes in space: to the right, up, and towards the viewer.
///
/// # Errors
/// [`Error::Parameter`] for labels that do not match the faces; [`Error::Unusable`] if no face is finite;
/// [`Error::Cancelled`].
pub fn best_view(mesh: &Mesh, labels: Option<&[u32]>, parts: usize, run: &Run) -> Result<[[f64; 3]; 3]> {
    one_per_face("labels", labels.map_or(mesh.faces.len(), <[u32]>::len), mesh.faces.len())?;
    let (mesh, _grant) = &in_common_size(mesh, run)?;
    let mesh = &mesh.without_strays(run)?;
    let found =
        frames(mesh, labels, parts.min(MOST_DISTINCT), &PictureParams { views: 1, ..PictureParams::default() }, run)?;
    Ok([found[0].right, found[0].up, found[0].toward])
}

/// The mesh itself; or, if it is so large or so small that areas would overflow or underflow, a copy in the unit box
/// with its grant for positions.
fn in_common_size(mesh: &Mesh, run: &Run) -> Result<(Mesh, Option<Grant>)> {
    // Floats cannot be that large or small.
    if !mesh.positions.is_double() {
        return Ok((mesh.clone(), None));
    }
    let frame = graph::Frame::of(mesh, run)?;
    if frame.is_of_common_size() {
        return Ok((mesh.clone(), None));
    }
    let bytes = 24 * mesh.positions.len() as u64;
    let grant = run.budget.take("positions of the picture", bytes, bytes)?;
    let positions = (0..mesh.positions.len() as u32).map(|v| frame.place(mesh.positions.get(v))).collect();
    Ok((mesh.with_positions(positions)?, Some(grant)))
}

/// The views: the best one, and others around the same axis.
fn frames(mesh: &Mesh, labels: Option<&[u32]>, parts: usize, params: &PictureParams, run: &Run) -> Result<Vec<Frame>> {
    let pieces = viewpoint::sample(mesh, labels, run)?;
    if pieces.is_empty() {
        let problem = "none of its faces has finite coordinates, so there is nothing to draw";
        return Err(Error::unusable(mesh.path(), problem, "give a mesh whose coordinates are finite numbers"));
    }
    let up = params.up.map_or_else(|| viewpoint::upright(&pieces), Up::direction);
    let (azimuth, elevation) = viewpoint::best(&pieces, parts, up, run)?;
    let azimuth = azimuth + params.turn.to_radians();
    let elevation = (elevation + params.tilt.to_radians()).clamp(-1.55, 1.55);
    let around = std::f64::consts::TAU / params.views as f64;
    // The opposite side comes second, if it is included: it shows what the first view hides.
    let order = |k: usize| if params.views.is_multiple_of(2) { k / 2 + k % 2 * (params.views / 2) } else { k };
    Ok((0..params.views).map(|k| Frame::turned(up, azimuth + order(k) as f64 * around, elevation)).collect())
}
