//! Sums over the faces of one label, and the measurements computed from them.

use crate::base::moments::principal_axes;
use crate::base::vector::{MapEach, area, cross, distance, dot, minus};
use crate::graph::Frame;
use serde::Serialize;
use std::collections::BTreeMap;

/// An adjacent part.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Neighbour {
    /// Its label.
    pub label: u32,
    /// The length of their common border, in the file's unit.
    pub length: f64,
}

/// The measurements of a part, or of a whole mesh; in the file's unit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measures {
    /// Faces.
    pub faces: u64,
    /// Area.
    pub area: f64,
    /// Volume, if the surface is closed and consistently wound; positive if it is wound outwards.
    pub volume: Option<f64>,
    /// Least and greatest coordinates; `None` without a finite face.
    #[serde(rename = "box")]
    pub bounds: Option<[[f64; 3]; 2]>,
    /// Centre of gravity of the surface.
    pub centroid: [f64; 3],
    /// Principal axes of the surface, unit vectors, the longest first.
    pub axes: [[f64; 3]; 3],
    /// Standard deviation of the surface along each axis.
    pub spread: [f64; 3],
    /// Number of edges without another face of the mesh.
    pub open_edges: u64,
    /// Parts that share a border, by label.
    pub neighbours: Vec<Neighbour>,
}

/// Sums over faces of one label.
#[derive(Clone, Debug)]
pub(super) struct Sums {
    pub faces: u64,
    area: f64,
    volume: f64,
    low: [f64; 3],
    high: [f64; 3],
    first: [f64; 3],
    /// xx, yy, zz, xy, xz, yz.
    second: [f64; 6],
    pub open: u64,
    pub clashes: u64,
    pub borders: BTreeMap<u32, f64>,
}

impl Default for Sums {
    fn default() -> Self {
        Self {
            faces: 0,
            area: 0.,
            volume: 0.,
            low: [f64::INFINITY; 3],
            high: [f64::NEG_INFINITY; 3],
            first: [0.; 3],
            second: [0.; 6],
            open: 0,
            clashes: 0,
            borders: BTreeMap::new(),
        }
    }
}

/// Pairs of axes of [`Sums::second`].
const PAIRS: [[usize; 2]; 6] = [[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]];

impl Sums {
    /// Adds the triangle `at`, whose corners are relative to the origin of the sums.
    pub fn triangle(&mut self, at: [[f64; 3]; 3]) {
        let area = area(at);
        self.volume += dot(at[0], cross(at[1], at[2])) / 6.;
        for p in at {
            for axis in 0..3 {
                self.low[axis] = self.low[axis].min(p[axis]);
                self.high[axis] = self.high[axis].max(p[axis]);
            }
        }
        self.area += area;
        let sum = [0, 1, 2].map_each(|axis| at[0][axis] + at[1][axis] + at[2][axis]);
        for axis in 0..3 {
            self.first[axis] += area * sum[axis] / 3.;
        }
        // The second moment of a triangle: A/12 (Σ p pᵀ + s sᵀ), s = Σ p.
        for (k, [i, j]) in PAIRS.into_iter().enumerate() {
            let own = at[0][i] * at[0][j] + at[1][i] * at[1][j] + at[2][i] * at[2][j];
            self.second[k] += area / 12. * (own + sum[i] * sum[j]);
        }
    }

    pub fn add(&mut self, other: &Self) {
        self.faces += other.faces;
        self.area += other.area;
        self.volume += other.volume;
        self.open += other.open;
        self.clashes += other.clashes;
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(other.low[axis]);
            self.high[axis] = self.high[axis].max(other.high[axis]);
            self.first[axis] += other.first[axis];
        }
        self.second.iter_mut().zip(other.second).for_each(|(mine, other)| *mine += other);
        for (&label, length) in &other.borders {
            *self.borders.entry(label).or_default() += length;
        }
    }

    /// The measurements from sums relative to `origin` in units of `unit`.
    pub fn measures(self, unit: Unit) -> Measures {
        let mean = self.first.map(|x| if self.area > 0. { x / self.area } else { 0. });
        let moments: [f64; 6] = std::array::from_fn(|k| {
            let [i, j] = PAIRS[k];
            if self.area > 0. { self.second[k] / self.area - mean[i] * mean[j] } else { 0. }
        });
        let (mut axes, mut spread) = ([[1., 0., 0.], [0., 1., 0.], [0., 0., 1.]], [0.; 3]);
        if moments.iter().all(|x| x.is_finite()) {
            let values;
            (values, axes) = principal_axes(moments);
            spread = values.map(|value| unit.back(value.max(0.).sqrt(), 1));
        }
        // A part of which no face has a place encloses nothing.
        let bounded = self.low[0] <= self.high[0];
        let closed = self.open == 0 && self.clashes == 0 && self.borders.is_empty() && bounded;
        let back = |p: [f64; 3]| [0, 1, 2].map(|axis| unit.back(p[axis], 1) + unit.origin[axis]);
        Measures {
            faces: self.faces,
            area: unit.back(self.area, 2),
            volume: closed.then(|| unit.back(self.volume, 3)),
            bounds: bounded.then(|| [back(self.low), back(self.high)]),
            centroid: back(mean),
            axes,
            spread,
            open_edges: self.open,
            neighbours: self
                .borders
                .into_iter()
                .map(|(label, length)| Neighbour { label, length: unit.back(length, 1) })
                .collect(),
        }
    }
}

/// The origin of sums, and their unit of length: 1 unless the mesh is so large or so small that squared lengths or
/// areas would overflow or underflow.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unit {
    pub origin: [f64; 3],
    pub unit: f64,
}

impl Unit {
    /// For a mesh in `frame`.
    pub fn of(frame: &Frame) -> Self {
        Self { origin: frame.origin, unit: if frame.is_of_common_size() { 1. } else { frame.scale } }
    }

    pub fn place(self, p: [f64; 3]) -> [f64; 3] {
        minus(p, self.origin).map_each(|x| x / self.unit)
    }

    pub fn distance(self, a: [f64; 3], b: [f64; 3]) -> f64 {
        distance(a.map_each(|x| x / self.unit), b.map_each(|x| x / self.unit))
    }

    /// Converts `value`, a length to the power of `dimensions`, back to units of the file.
    fn back(self, value: f64, dimensions: usize) -> f64 {
        (0..dimensions).fold(value, |value, _| if value == 0. { value } else { value * self.unit })
    }
}
