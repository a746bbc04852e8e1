//! Draws both meshes side by side, with matched vertices in the same colours.
//!
//! The renderer draws faces in colours of labels, so a face gets as label the mean colour of its corners, quantised to
//! a cube of [`LEVELS`]³: 4 bytes per face on disk.

use super::carry::Colours;
use super::matches::Match;
use crate::apps::picture::{Image, PictureParams, render_named};
use crate::base::Result;
use crate::mesh::Mesh;
use crate::store::Context;

/// Levels per channel.
const LEVELS: u32 = 24;

/// Draws A and B, each in half of a sheet of the size in `params`.
///
/// # Errors
/// As [`render_named`].
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
    let mut labels = context.work.array::<u32>("picture.tmp", &[mesh.faces.len()])?;
    let label = |face: usize, _: u32| {
        mesh.faces.with(face, |corners| {
            let [r, g, b] = mean_levels(corners.iter().map(|&v| colour(v)));
            (r * LEVELS + g) * LEVELS + b
        })
    };
    context.run.fill_each(labels.data(), 1 << 14, label)?;
    let shade = |level: u32| ((2 * level + 1) * 128 / LEVELS) as u8;
    let palette: Vec<[u8; 3]> =
        (0..LEVELS.pow(3)).map(|k| [k / (LEVELS * LEVELS), k / LEVELS % LEVELS, k % LEVELS].map(shade)).collect();
    render_named(mesh, Some(&labels.data()[..]), (&palette, &[]), params, context)
}

/// The quantised mean of `colours`, of which a face may have millions.
fn mean_levels(colours: impl ExactSizeIterator<Item = [u8; 3]>) -> [u32; 3] {
    let (mut sum, whole) = ([0u64; 3], 256 * colours.len().max(1) as u64);
    for colour in colours {
        (0..3).for_each(|k| sum[k] += u64::from(colour[k]));
    }
    sum.map(|sum| ((sum * u64::from(LEVELS) / whole) as u32).min(LEVELS - 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_face_of_a_million_white_corners_is_white() {
        assert_eq!(mean_levels(std::iter::repeat_n([255; 3], 1_000_000)), [LEVELS - 1; 3]);
        assert_eq!(mean_levels(std::iter::empty::<[u8; 3]>()), [0; 3]);
    }
}
