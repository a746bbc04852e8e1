//! How well the order of a file keeps neighbours together.
//!
//! Sampled: [`RUNS`] runs of [`RUN`] consecutive faces, evenly spread. A step to the next face is *far* when one of its
//! corners lies far from the one before in vertex numbers (a file whose vertices are scattered) or in
//! space (a soup in random order, whose numbers always ascend). And a run is *stretched* as often as it is longer than a
//! round patch of as many faces would be wide: 1–2 along Hilbert's curve, √([`RUN`]) and more in rows of a grid. A front
//! that crosses such rows touches a page a face too, however near its neighbours are. A pure function of the mesh, never of budget or
//! threads. Cost: 65,536 faces read.

use crate::mesh::Mesh;

const RUNS: usize = 256;
const RUN: usize = 256;
/// Vertices that a step may pass over at the least.
const NEAR: u64 = 1 << 16;

/// What was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Locality {
    /// Share of far steps, 0 to 1: near 0 in scan order, near 1 at random.
    pub far_steps: f64,
    /// Mean extent of a run over that of a round patch of as many faces.
    pub stretch: f64,
}

/// Measures the order of `mesh`, whose box has diagonal `diagonal`.
pub fn measure(mesh: &Mesh, diagonal: f64) -> Locality {
    let n = mesh.faces.len();
    let near = NEAR.max(mesh.positions.len() as u64 / 64);
    let runs = RUNS.min(n.div_ceil(RUN));
    let (mut far, mut steps, mut stretch, mut measured) = (0u64, 0u64, 0f64, 0u64);
    for k in 0..runs {
        let start = (k as u128 * n as u128 / runs as u128) as usize;
        let mut last: Option<(u32, [f64; 3])> = None;
        let (mut low, mut high, mut edges) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3], (0f64, 0u64));
        mesh.faces.for_each(start..n.min(start + RUN), |_, corners| {
            let (Some(&first), Some(&other)) = (corners.first(), corners.get(1)) else { return };
            let (at, end) = (mesh.positions.get(first), mesh.positions.get(other));
            let square = |a: [f64; 3], b: [f64; 3]| (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>();
            if let Some((vertex, place)) = last {
                let jump = corners.iter().any(|&v| u64::from(v.abs_diff(vertex)) > near);
                steps += 1;
                far += u64::from(jump || square(at, place) > (diagonal / 16.).powi(2));
            }
            for axis in 0..3 {
                low[axis] = low[axis].min(at[axis]);
                high[axis] = high[axis].max(at[axis]);
            }
            edges = (edges.0 + square(at, end).sqrt(), edges.1 + 1);
            last = Some((first, at));
        });
        let extent = (0..3).map(|axis| (high[axis] - low[axis]).powi(2)).sum::<f64>().sqrt();
        // A triangle of edge e has area .43 e²; a disc of as much area as the run is this wide.
        let round = (edges.0 / edges.1.max(1) as f64) * (0.55 * edges.1 as f64).sqrt();
        if extent.is_finite() && round > 0. {
            stretch += extent / round;
            measured += 1;
        }
    }
    Locality { far_steps: far as f64 / steps.max(1) as f64, stretch: stretch / measured.max(1) as f64 }
}
