//! Both meshes side by side, matched vertices in the same colours.
//!
//! The renderer draws faces in colours of labels, so a face gets the label of its corners' mean colour in a cube of
//! [`LEVELS`]³: 4 bytes per face on disk.

use super::carry::Colours;
use super::matches::Match;
use crate::apps::picture::{Image, PictureParams, render};
use crate::base::Result;
use crate::mesh::Mesh;
use crate::store::Context;

/// Steps of a channel.
const LEVELS: u32 = 24;

/// Draws A and B, each in half of a sheet of the size of `params`.
///
/// # Errors
/// As [`render`].
pub fn side_by_side(
    a: &Mesh,
    b: &Mesh,
    matches: &[Match],
    colours: &Colours,
    params: &PictureParams,
    context: Context<'_>,
) -> Result<Image> {
    let half = PictureParams { width: params.width / 2, legend: false, lines: false, ..*params };
    let of_a = |v: u32| colours.of_match(&matches[v as usize]);
    let left = draw(a, of_a, &half, context)?;
    Ok(Image::beside(&left, &draw(b, |v: u32| colours.of_b(v as usize), &half, context)?))
}

fn draw(
    mesh: &Mesh,
    colour: impl Fn(u32) -> [u8; 3] + Sync,
    params: &PictureParams,
    context: Context<'_>,
) -> Result<Image> {
    let _scratch = context.work.scratch(&["picture.tmp.partial"]);
    let mut labels = context.work.array::<u32>("picture.tmp", &[mesh.faces.len()])?;
    let step = |sum: u32, count: u32| (sum * LEVELS / (256 * count.max(1))).min(LEVELS - 1);
    let label = |face: usize, _: u32| {
        mesh.faces.with(face, |corners| {
            let mut sum = [0u32; 3];
            for &v in corners {
                let colour = colour(v);
                (0..3).for_each(|k| sum[k] += u32::from(colour[k]));
            }
            let [r, g, b] = sum.map(|sum| step(sum, corners.len() as u32));
            (r * LEVELS + g) * LEVELS + b
        })
    };
    context.run.fill_each(labels.data(), 1 << 14, label)?;
    let shade = |level: u32| ((2 * level + 1) * 128 / LEVELS) as u8;
    let palette: Vec<[u8; 3]> =
        (0..LEVELS.pow(3)).map(|k| [k / (LEVELS * LEVELS), k / LEVELS % LEVELS, k % LEVELS].map(shade)).collect();
    render(mesh, Some(&labels.data()[..]), &palette, params, context.run)
}
