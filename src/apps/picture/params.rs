//! What a picture is asked to be.

use super::vector::Vec3;
use crate::base::{Error, Result};

/// An axis of the file that points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Up {
    /// 0, 1, 2: x, y, z.
    pub axis: usize,
    /// Whether its negative end is up.
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
            .ok_or_else(|| format!("{text:?} is no axis; write x, y, z, -x, -y or -z"))
    }
}

/// Size, views and manner of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PictureParams {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Views on one sheet.
    pub views: usize,
    /// Whether the background is transparent instead of white.
    pub transparent: bool,
    /// Whether shares of the surface are listed.
    pub legend: bool,
    /// Whether lines are drawn between parts and at edges.
    pub lines: bool,
    /// Samples a side of a pixel, 1 to 4.
    pub samples: usize,
    /// The axis that points up; found where `None`.
    pub up: Option<Up>,
    /// Degrees to turn around that axis from the view found.
    pub turn: f64,
    /// Degrees to look from higher than found.
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

impl PictureParams {
    /// Refuses what cannot be drawn.
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
        within("--size", self.width, 16, 16384)?;
        within("--size", self.height, 16, 16384)?;
        within("--views", self.views, 1, 64)?;
        within("--samples", self.samples, 1, 4)?;
        if !self.turn.is_finite() || !self.tilt.is_finite() {
            return Err(Error::parameter("--turn", "is no angle", "give degrees"));
        }
        Ok(())
    }
}
