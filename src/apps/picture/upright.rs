//! Which axis of the file points up.
//!
//! Files do not say. Each of the six directions is given points: for standing well (its lowest slice reaches under the
//! centre of mass, and wide), for a flat bottom, for not being an axis of mirror symmetry (animals, people and chairs
//! are symmetric left to right, not top to bottom), and for custom (y, then z, rarely downwards). Microseconds a
//! sampled triangle.

use super::camera::Extent;
use super::survey::Piece;
use super::vector::Vec3;

/// Cells a side of the grid on which symmetry is measured.
const GRID: usize = 24;

/// The upward direction.
pub(super) fn upright(pieces: &[Piece]) -> Vec3 {
    let mut extent = Extent::EMPTY;
    pieces.iter().for_each(|piece| extent.hold(piece.middle));
    let symmetry = [0, 1, 2].map(|axis| symmetry(pieces, &extent, axis));
    let mut best = ([0.0, 1.0, 0.0], f64::NEG_INFINITY);
    for (axis, sign, custom) in
        [(1, 1.0, 0.45), (2, 1.0, 0.25), (1, -1.0, -0.4), (2, -1.0, -0.45), (0, 1.0, -0.3), (0, -1.0, -0.5)]
    {
        let (stands, flat) = standing(pieces, &extent, axis, sign);
        let others = symmetry[(axis + 1) % 3].max(symmetry[(axis + 2) % 3]);
        let score = custom + 0.3 * stands + 0.5 * flat + 0.8 * (others - symmetry[axis]);
        tracing::debug!(axis, sign, score, stands, flat, symmetry = symmetry[axis], "up?");
        if score > best.1 {
            let mut up = [0.0; 3];
            up[axis] = sign;
            best = (up, score);
        }
    }
    best.0
}

/// How well the shape stands on its lowest slice, and how flat that is, both 0 to 1.
fn standing(pieces: &[Piece], extent: &Extent, axis: usize, sign: f64) -> (f64, f64) {
    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
    let bottom = if sign > 0.0 { extent.low[axis] } else { extent.high[axis] };
    let height = extent.length(axis).max(f64::MIN_POSITIVE);
    let mut foot = Extent::EMPTY;
    let (mut mass, mut centre, mut flat) = (0.0, [0.0; 3], 0.0);
    for piece in pieces {
        let above = (piece.middle[axis] - bottom) * sign / height;
        if above < 0.06 {
            foot.hold(piece.middle);
            if above < 0.02 && piece.normal[axis].abs() > 0.9 {
                flat += piece.area;
            }
        }
        mass += piece.area;
        (0..3).for_each(|k| centre[k] += piece.area * piece.middle[k]);
    }
    if mass <= 0.0 {
        return (0.0, 0.0);
    }
    let reach = |k: usize| {
        let under = centre[k] / mass;
        // How far the foot reaches beyond the centre to the worse side, as a share of the shape's half width.
        let margin = (under - foot.low[k]).min(foot.high[k] - under);
        (2.0 * margin / extent.length(k).max(f64::MIN_POSITIVE)).clamp(-0.2, 0.5) / 0.5
    };
    ((reach(a).min(reach(b))).clamp(0.0, 1.0), (flat / mass * 12.0).min(1.0))
}

/// How alike the shape and its mirror image along `axis` are: 0 to 1.
fn symmetry(pieces: &[Piece], extent: &Extent, axis: usize) -> f64 {
    let longest = (0..3).map(|k| extent.length(k)).fold(f64::MIN_POSITIVE, f64::max);
    let cell = |p: Vec3| {
        let place = [0, 1, 2].map(|k| {
            let from_middle = (p[k] - (extent.low[k] + extent.high[k]) / 2.0) / longest;
            (((from_middle + 0.5) * GRID as f64) as usize).min(GRID - 1)
        });
        (place[0] * GRID + place[1]) * GRID + place[2]
    };
    let (mut here, mut there) = (vec![0.0f64; GRID.pow(3)], vec![0.0f64; GRID.pow(3)]);
    for piece in pieces {
        let mut mirrored = piece.middle;
        mirrored[axis] = extent.low[axis] + extent.high[axis] - mirrored[axis];
        here[cell(piece.middle)] += piece.area;
        there[cell(mirrored)] += piece.area;
    }
    let common: f64 = here.iter().zip(&there).map(|(a, b)| a.min(*b)).sum();
    common / here.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}
