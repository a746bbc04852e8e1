//! The orthographic camera: the axes of a view, the extent of the mesh in them, and the projection from space to
//! samples.
//!
//! A few multiplications per point.

use crate::base::vector::{add_scaled, cross, dot, unit};

/// Axes of a view in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frame {
    /// To the right in the picture.
    pub right: Vec3,
    /// Up in the picture.
    pub up: Vec3,
    /// Towards the viewer.
    pub toward: Vec3,
}

impl Frame {
    /// A view from `azimuth` around the axis `up` of space and `elevation` above its horizon (radians).
    pub(super) fn turned(up: Vec3, azimuth: f64, elevation: f64) -> Self {
        // Any direction across `up` serves as azimuth 0, if it is always the same.
        let across = if up[0].abs() < 0.9 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] };
        let first = unit(add_scaled(across, -dot(across, up), up));
        let second = cross(up, first);
        let level = add_scaled(first.map(|x| x * azimuth.cos()), azimuth.sin(), second);
        let toward = unit(add_scaled(level.map(|x| x * elevation.cos()), elevation.sin(), up));
        let right = unit(cross(up, toward));
        Self { right, up: cross(toward, right), toward }
    }

    /// Coordinates to the right, up, and towards the viewer.
    #[inline]
    pub(super) fn of(&self, p: Vec3) -> Vec3 {
        [dot(self.right, p), dot(self.up, p), dot(self.toward, p)]
    }
}

/// The bounding box, in a frame's coordinates, of the visible shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extent {
    pub low: Vec3,
    pub high: Vec3,
}

impl Extent {
    /// The empty box.
    pub(super) const EMPTY: Self = Self { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] };

    /// Grows to contain `p`.
    #[inline]
    pub(super) fn include(&mut self, p: Vec3) {
        for k in 0..3 {
            self.low[k] = self.low[k].min(p[k]);
            self.high[k] = self.high[k].max(p[k]);
        }
    }

    /// Grows to contain `other`.
    pub(super) fn join(&mut self, other: &Self) {
        self.include(other.low);
        self.include(other.high);
    }

    /// Length along axis `k`, 0 if empty.
    pub(super) fn length(&self, k: usize) -> f64 {
        (self.high[k] - self.low[k]).max(0.0)
    }

    /// The diagonal.
    pub(super) fn diagonal(&self) -> f64 {
        (0..3).map(|k| self.length(k).powi(2)).sum::<f64>().sqrt()
    }
}

/// Projects from space to samples of a canvas: x to the right, y down, depth away from the viewer, all in samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Camera {
    pub frame: Frame,
    /// Samples per unit of space.
    pub scale: f64,
    offset: Vec3,
    /// Depths lie between 0 and this.
    pub depth: f64,
}

impl Camera {
    /// Puts the middle of `extent` at the middle of a canvas of `width` × `height` samples.
    pub(super) fn fit(frame: Frame, extent: &Extent, scale: f64, width: usize, height: usize) -> Self {
        let middle = |k: usize| (extent.low[k] + extent.high[k]) / 2.0;
        let offset =
            [width as f64 / 2.0 - middle(0) * scale, height as f64 / 2.0 + middle(1) * scale, extent.high[2] * scale];
        Self { frame, scale, offset, depth: (extent.length(2) * scale).max(1e-9) }
    }

    /// The projection of `p`.
    #[inline]
    pub(super) fn project(&self, p: Vec3) -> Vec3 {
        let [x, y, z] = self.frame.of(p);
        [self.offset[0] + x * self.scale, self.offset[1] - y * self.scale, self.offset[2] - z * self.scale]
    }
}

/// A point or a direction.
pub(super) type Vec3 = [f64; 3];
