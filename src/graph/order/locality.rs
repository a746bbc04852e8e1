//! How well the order of a file keeps neighbours together.
//!
//! Sampled: [`RUNS`] runs of [`RUN`] consecutive faces, evenly spread. A step to the next face is *far* when one of its
//! corners lies far from the one before in vertex numbers (a file whose vertices are scattered) or in
//! space (a soup in random order, whose numbers always ascend). A pure function of the mesh, never of budget or
//! threads. Cost: 65,536 faces read.

use crate::mesh::Mesh;

const RUNS: usize = 256;
const RUN: usize = 256;
/// Vertices that a step may pass over at the least.
const NEAR: u64 = 1 << 16;

/// The share of far steps, 0 to 1: near 0 in scan order, near 1 at random.
pub fn far_steps(mesh: &Mesh, diagonal: f64) -> f64 {
    let n = mesh.faces.len();
    let near = NEAR.max(mesh.positions.len() as u64 / 64);
    let runs = RUNS.min(n.div_ceil(RUN));
    let (mut far, mut steps) = (0u64, 0u64);
    for k in 0..runs {
        let start = (k as u128 * n as u128 / runs as u128) as usize;
        let mut last: Option<(u32, [f64; 3])> = None;
        mesh.faces.for_each(start..n.min(start + RUN), |_, corners| {
            let Some(&first) = corners.first() else { return };
            let at = mesh.positions.get(first);
            if let Some((vertex, place)) = last {
                let jump = corners.iter().any(|&v| u64::from(v.abs_diff(vertex)) > near);
                let square: f64 = (0..3).map(|axis| (at[axis] - place[axis]).powi(2)).sum();
                steps += 1;
                far += u64::from(jump || square > (diagonal / 16.).powi(2));
            }
            last = Some((first, at));
        });
    }
    far as f64 / steps.max(1) as f64
}
