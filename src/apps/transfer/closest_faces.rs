//! Faces of one mesh nearest to points on another, in blocks that fit the budget.
//!
//! Each block of faces becomes a tree of boxes over its triangles along a curve; every point keeps, over all blocks,
//! the nearest face and the nearest whose normal agrees. Both minimise (distance, face), so that the result is the same
//! whatever the blocks. One traversal finds both, and starts where the previous point ended; a tree from a library
//! would be traversed twice from the root, which takes several times as long. [`BYTES`] per triangle of a block, 16
//! bytes per point on disk.

use crate::base::Result;
use crate::base::bounds::{Bounds, centre, half_sides};
use crate::base::vector::{self, dot, double_area, minus, narrow, wide};
use crate::mesh::Mesh;
use crate::store::Run;
use std::ops::Range;

/// Bytes per triangle in a tree: its corners, its number, and its share of the nodes above.
pub const BYTES: u64 = 96;
/// Minimum cosine for normals to agree.
const AGREE: f32 = 0.5;
/// Triangles per group.
const GROUP: usize = 4;
/// Points that a thread takes at a time.
const CHUNK: usize = 1 << 12;
/// No face.
pub const NONE: u64 = u64::MAX;

/// A unit of length and an origin suitable for both meshes.
#[derive(Clone, Copy, Debug)]
pub struct UnitFrame {
    middle: [f64; 3],
    scale: f64,
}

impl UnitFrame {
    /// The frame of `mesh`: its centre, and half its longest side.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn of(mesh: &Mesh, run: &Run) -> Result<Self> {
        let bounds = mesh.extent(run)?;
        let side = half_sides(bounds).into_iter().fold(0., f64::max);
        let scale = if side.is_finite() && side > 0. { side } else { 1. };
        Ok(Self { middle: if bounds[0][0] <= bounds[1][0] { centre(bounds) } else { [0.; 3] }, scale })
    }

    /// Calls `visit(face, triangle)` with the triangles, in the frame, of the finite faces of `range`.
    pub fn triangles(&self, mesh: &Mesh, range: Range<usize>, mut visit: impl FnMut(u32, [[f32; 3]; 3])) {
        let place = |p: [f64; 3]| {
            let at = |k: usize| ((p[k] - self.middle[k]) / self.scale) as f32;
            [at(0), at(1), at(2)]
        };
        mesh.faces.for_each(range, |face, corners| {
            mesh.triangles(corners, |_, at| {
                let triangle = at.map(place);
                if triangle.iter().flatten().all(|x| x.is_finite()) {
                    visit(face as u32, triangle);
                }
            });
        });
    }
}

/// Twice the area of a triangle times its normal.
pub fn normal(triangle: &[[f32; 3]; 3]) -> [f64; 3] {
    double_area([wide(triangle[0]), wide(triangle[1]), wide(triangle[2])])
}

/// `v` normalised to length 1; zero if it has none.
pub fn unit(v: [f64; 3]) -> [f32; 3] {
    narrow(vector::unit(v), 1.)
}

/// A triangle and its face.
#[derive(Clone, Copy, Debug)]
struct Leaf {
    corners: [[f32; 3]; 3],
    face: u32,
    /// Its position on a space-filling curve.
    key: u32,
}

impl Leaf {
    fn new(corners: [[f32; 3]; 3], face: u32) -> Self {
        let spread = |x: f32| (0..10).fold(0u32, |bits, k| bits | ((x as u32 >> k) & 1) << (3 * k));
        let cell = |axis: usize| spread(((corners[0][axis] + 1.) * 512.).clamp(0., 1023.));
        Self { corners, face, key: cell(0) | cell(1) << 1 | cell(2) << 2 }
    }
}

/// The squared distance of `p` from a triangle: from its plane inside, from its edges outside. In double precision, as
/// the area of a sliver is a small difference of large products.
pub fn distance_2(triangle: &[[f32; 3]; 3], p: [f32; 3]) -> f32 {
    let ([a, b, c], p) = (triangle.map(wide), wide(p));
    let to_edge = |from: [f64; 3], to: [f64; 3]| {
        let (along, out) = (minus(to, from), minus(p, from));
        let size = dot(along, along);
        let t = if size > 0. { (dot(along, out) / size).clamp(0., 1.) } else { 0. };
        let rest = [out[0] - t * along[0], out[1] - t * along[1], out[2] - t * along[2]];
        dot(rest, rest)
    };
    let (u, v, w) = (minus(b, a), minus(c, a), minus(p, a));
    let (uu, uv, vv, wu, wv) = (dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v));
    let area = uu * vv - uv * uv;
    let (s, t) = (vv * wu - uv * wv, uu * wv - uv * wu);
    if area > 0. && s >= 0. && t >= 0. && s + t <= area {
        let rest = |k: usize| w[k] - (s * u[k] + t * v[k]) / area;
        let rest = [rest(0), rest(1), rest(2)];
        return dot(rest, rest) as f32;
    }
    to_edge(a, b).min(to_edge(b, c)).min(to_edge(c, a)) as f32
}

/// A query point and the normal there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Probe {
    /// Its position.
    pub place: [f32; 3],
    /// The normal there, of length 1 or 0.
    pub normal: [f32; 3],
}

/// When a face that is not the nearest is preferred because its normal agrees.
#[derive(Clone, Copy, Debug)]
pub struct Agreement {
    /// 1, or −1 if normals of the two meshes point in opposite directions.
    pub sign: f32,
    /// The edge length of the searched mesh: the slack of [`window`].
    pub slack: f32,
    /// The distance beyond which agreement is not sought. Without it, a point far from a block in which no face agrees
    /// would examine all faces.
    pub far: f32,
}

/// The result for a point: the nearest face, and the nearest that agrees; each (squared distance, face) or [`NONE`].
pub type Closest = [u64; 2];

fn pack(distance_2: f32, face: u32) -> u64 {
    u64::from(distance_2.to_bits()) << 32 | u64::from(face)
}

/// The squared distance and the face packed in a number of [`Closest`].
pub fn unpack(packed: u64) -> Option<(f32, u32)> {
    (packed != NONE).then_some((f32::from_bits((packed >> 32) as u32), packed as u32))
}

/// The distance up to which a face that agrees is preferred to one at distance `d` that does not; `slack` is an edge
/// length.
pub fn window(d: f32, slack: f32) -> f32 {
    2. * d + slack
}

/// A tree of the triangles of some faces: groups of neighbours along a curve, and boxes over pairs of boxes.
pub struct TriangleTree {
    /// Sorted along the curve, [`GROUP`] per group.
    leaves: Vec<Leaf>,
    /// Box of each node; node k has the children 2k and 2k + 1, the last half are groups.
    boxes: Vec<Bounds>,
}

impl TriangleTree {
    /// For the faces of some `ranges`.
    pub fn of(mesh: &Mesh, frame: &UnitFrame, ranges: impl Iterator<Item = Range<usize>> + Clone) -> Self {
        let corners = ranges.clone().flatten().map(|face| mesh.faces.corner_range(face).len());
        let mut leaves = Vec::with_capacity(corners.map(|corners| corners.saturating_sub(2)).sum());
        for range in ranges {
            frame.triangles(mesh, range, |face, corners| leaves.push(Leaf::new(corners, face)));
        }
        Self::over(leaves)
    }

    fn over(mut leaves: Vec<Leaf>) -> Self {
        leaves.sort_unstable_by_key(|leaf| (leaf.key, leaf.face));
        let half = leaves.len().div_ceil(GROUP).max(1).next_power_of_two();
        let mut boxes = vec![Bounds::EMPTY; 2 * half];
        for (group, bounds) in leaves.chunks(GROUP).zip(&mut boxes[half..]) {
            let points = group.iter().flat_map(|leaf| &leaf.corners);
            *bounds = points.fold(Bounds::EMPTY, |bounds, &p| bounds.with(&Bounds::at(p)));
        }
        for node in (1..half).rev() {
            boxes[node] = boxes[2 * node].with(&boxes[2 * node + 1]);
        }
        Self { leaves, boxes }
    }

    /// The normal of the triangle nearest to `place`.
    pub fn normal_near(&self, place: [f32; 3]) -> Option<[f32; 3]> {
        let mut found = [NONE; 2];
        let group = self.improve(
            &Probe { place, normal: [0.; 3] },
            Agreement { sign: 1., slack: 0., far: f32::INFINITY },
            0,
            &mut found,
        );
        let face = unpack(found[0])?.1;
        let leaves = self.leaves.iter().skip(group * GROUP).take(GROUP);
        leaves.filter(|leaf| leaf.face == face).map(|leaf| unit(normal(&leaf.corners))).next()
    }

    /// Improves `found` with triangles near `probe`; normals agree if theirs, times the sign, is similar to its own.
    /// `near` is the group to start with, ideally a close one; returns the group in which the nearest triangle was
    /// found.
    pub fn improve(&self, probe: &Probe, agreement: Agreement, near: usize, found: &mut Closest) -> usize {
        let half = self.boxes.len() / 2;
        if self.leaves.is_empty() || !probe.place.iter().all(|x| x.is_finite()) {
            return near;
        }
        let near = near.min(half - 1);
        let mut best = near;
        let mut limit = self.look(near, probe, agreement, found, &mut best);
        // A path down, with the other child at each step: the depth is at most 64.
        let mut stack = [(0f32, 0usize); 64];
        let mut height = 1;
        stack[0] = (0., 1);
        while height > 0 {
            height -= 1;
            let (distance_2, node) = stack[height];
            if distance_2 > limit {
                continue;
            }
            if node >= half {
                if node - half != near {
                    limit = self.look(node - half, probe, agreement, found, &mut best);
                }
                continue;
            }
            let child = |child: usize| (self.boxes[child].square_from(probe.place), child);
            let mut pair = [child(2 * node), child(2 * node + 1)];
            if pair[0].0 < pair[1].0 {
                pair.swap(0, 1);
            }
            for (distance_2, child) in pair {
                if distance_2 <= limit && distance_2 < f32::INFINITY {
                    stack[height] = (distance_2, child);
                    height += 1;
                }
            }
        }
        best
    }

    /// Improves `found` with the triangles of a group; returns the distance within which boxes still matter.
    fn look(&self, group: usize, probe: &Probe, agreement: Agreement, found: &mut Closest, best: &mut usize) -> f32 {
        let least = |packed: u64| unpack(packed).map_or(f32::INFINITY, |(distance_2, _)| distance_2);
        for leaf in self.leaves.iter().skip(group * GROUP).take(GROUP) {
            let distance_2 = distance_2(&leaf.corners, probe.place);
            let packed = pack(distance_2, leaf.face);
            if packed < found[0] {
                (found[0], *best) = (packed, group);
            }
            let agrees = || agreement.sign * dot(unit(normal(&leaf.corners)), probe.normal) >= AGREE;
            if packed < found[1] && agrees() {
                found[1] = packed;
            }
        }
        let any = least(found[0]).sqrt().min(agreement.far);
        let limit = least(found[0]).min(agreement.far.powi(2));
        let limit = limit.max(least(found[1]).min(window(any, agreement.slack).powi(2)));
        // Boxes and triangles are rounded differently; anything that might be equally near must be examined.
        limit + 1e-6 * limit.sqrt() + 1e-12
    }

    /// [`TriangleTree::improve`] for many points.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn improve_all(
        &self,
        probe: impl Fn(usize) -> Probe + Sync,
        agreement: Agreement,
        found: &mut [Closest],
        run: &Run,
    ) -> Result<()> {
        let work = |k: usize, piece: &mut [Closest], (): &mut ()| {
            let mut near = 0;
            for (i, found) in piece.iter_mut().enumerate() {
                // A point equally far from most triangles examines all of them.
                if i % 16 == 0 {
                    run.cancel.check()?;
                }
                near = self.improve(&probe(k * CHUNK + i), agreement, near, found);
            }
            Ok(())
        };
        run.fill_chunks(found, CHUNK, || (), work).map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: when a mesh was searched in blocks, a point far from one of them examined all of its faces for one
    /// that agrees: minutes for 640,000 faces in 16 MiB.
    #[test]
    fn faces_that_agree_are_looked_for_within_reach_only() {
        let corners = [[0f32, 0., 0.], [1e-3, 0., 0.], [0., 1e-3, 0.]];
        let tree = TriangleTree::over(vec![Leaf::new(corners, 7)]);
        let limit = |height: f32, far: f32| {
            let probe = Probe { place: [0., 0., height], normal: [0., 0., -1.] };
            let mut found = [NONE; 2];
            let limit = tree.look(0, &probe, Agreement { sign: 1., slack: 0.01, far }, &mut found, &mut 0);
            assert_eq!(unpack(found[0]).map(|found| found.1), Some(7));
            limit.sqrt()
        };
        let near = |a: f32, b: f32| (a / b - 1.).abs() < 1e-3;
        assert!(near(limit(1., f32::INFINITY), 2.01) && near(limit(1., 0.1), 0.21) && near(limit(0.05, 0.1), 0.11));
    }

    /// Regression: a tree of few faces took memory for all of the mesh: 44 bytes each, outside the budget.
    #[test]
    fn faces_left_out_take_no_memory() {
        let n = 4000;
        let positions: Vec<[f64; 3]> = (0..n + 2).map(|i| [f64::from(i), f64::from(i % 2), 0.]).collect();
        let faces: Vec<[u32; 3]> = (0..n as u32).map(|i| [i, i + 1, i + 2]).collect();
        let mesh = Mesh::from_slices(&positions, &faces).unwrap();
        let frame = UnitFrame::of(&mesh, &Run::new(&())).unwrap();
        let tree = TriangleTree::of(&mesh, &frame, (0..n as usize).step_by(100).map(|face| face..face + 1));
        assert_eq!((tree.leaves.len(), tree.leaves.capacity()), (40, 40));
    }
}
