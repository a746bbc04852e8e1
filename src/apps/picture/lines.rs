//! Lines: between parts, and where the surface breaks off.
//!
//! Both are read off the drawn samples: a part ends where a neighbouring sample of like depth has another label, the
//! surface where the next sample lies far behind, more than its slope explains.

use super::raster::{Canvas, Hit};

/// How lines are drawn on a view.
pub(super) struct Lines {
    /// Offsets of the samples within half a line's width.
    near: Vec<[isize; 2]>,
    /// Depth, in samples, that counts as a break.
    jump: f64,
}

impl Lines {
    /// Lines `width` samples wide on a shape of `size` samples.
    pub(super) fn new(width: f64, size: f64) -> Self {
        let reach = (width / 2.0).max(1.0);
        let whole = reach as isize;
        let near = (-whole..=whole)
            .flat_map(|y| (-whole..=whole).map(move |x| [x, y]))
            .filter(|&[x, y]| (x, y) != (0, 0) && ((x * x + y * y) as f64) <= reach * reach)
            .collect();
        Self { near, jump: (0.012 * size).max(3.0) }
    }

    /// How much light lines leave at the sample (`x`, `y`), which shows `hit`: 1 away from all lines.
    pub(super) fn light(&self, canvas: &Canvas, x: usize, y: usize, hit: Hit, parts: bool) -> f32 {
        let at = |[dx, dy]: [isize; 2]| {
            let (i, j) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
            if i < canvas.width && j < canvas.height { canvas.get(j * canvas.width + i) } else { None }
        };
        let unlike = |other: Hit| other.item != hit.item && (other.depth - hit.depth).abs() < 2.0 * self.jump;
        if parts && self.near.iter().any(|&offset| at(offset).is_some_and(unlike)) {
            return 0.16;
        }
        let mut break_off = 0.0f64;
        for [dx, dy] in [[1, 0], [-1, 0], [0, 1], [0, -1]] {
            let slope = at([-dx, -dy]).map_or(0.0, |behind| (behind.depth - hit.depth).abs());
            let fall = at([dx, dy]).map_or(4.0 * self.jump, |other| other.depth - hit.depth);
            break_off = break_off.max((fall - slope - self.jump) / (2.0 * self.jump));
        }
        1.0 - 0.62 * break_off.clamp(0.0, 1.0) as f32
    }
}
