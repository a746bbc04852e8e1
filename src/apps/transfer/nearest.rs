//! Faces of one mesh nearest to points on another, in blocks that fit the budget.
//!
//! Each block of faces becomes an R-tree of triangles; every point keeps, over all blocks, the nearest face
//! and the nearest whose normal agrees. Both are the least of (distance, face), so that the answer is the same whatever
//! the blocks. Some 2 µs a point and block; [`BYTES`] a triangle of a block, 16 bytes a point on disk.

use crate::base::Result;
use crate::base::parallel::fill_chunks;
use crate::base::vector::{cross, length, minus};
use crate::mesh::Mesh;
use crate::store::Run;
use rstar::{AABB, PointDistance, RTree, RTreeObject};

/// Bytes that a triangle takes in a tree: its corners, its number, and its share of the nodes above.
pub const BYTES: u64 = 128;
/// Cosine of the angle up to which normals agree.
const AGREE: f32 = 0.5;
/// Points that a thread takes at a time.
const CHUNK: usize = 1 << 12;
/// No face.
pub const NONE: u64 = u64::MAX;

/// A unit of length and an origin that suit both meshes.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    middle: [f64; 3],
    scale: f64,
}

impl Frame {
    /// The frame of `mesh`: its middle, and half its longest side.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn of(mesh: &Mesh, run: &Run) -> Result<Self> {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for v in 0..mesh.positions.len() as u32 {
            if v % (1 << 20) == 0 {
                run.cancel.check()?;
            }
            let p = mesh.positions.get(v);
            if p.iter().all(|x| x.is_finite()) {
                (0..3).for_each(|k| (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k])));
            }
        }
        let side = (0..3).map(|k| high[k] / 2. - low[k] / 2.).fold(0., f64::max);
        let scale = if side.is_finite() && side > 0. { side } else { 1. };
        Ok(Self { middle: [0, 1, 2].map(|k| if low[k] <= high[k] { low[k] / 2. + high[k] / 2. } else { 0. }), scale })
    }

    /// Calls `visit(face, triangle)` with the triangles, in the frame, of the faces of `range` that lie in space.
    pub fn triangles(&self, mesh: &Mesh, range: std::ops::Range<usize>, mut visit: impl FnMut(u32, [[f32; 3]; 3])) {
        let place = |v: u32| {
            let p = mesh.positions.get(v);
            [0, 1, 2].map(|k| ((p[k] - self.middle[k]) / self.scale) as f32)
        };
        mesh.faces.for_each(range, |face, corners| {
            for k in 1..corners.len().saturating_sub(1) {
                let triangle = [corners[0], corners[k], corners[k + 1]].map(place);
                if triangle.iter().flatten().all(|x| x.is_finite()) {
                    visit(face as u32, triangle);
                }
            }
        });
    }
}

/// Twice the area of a triangle times its normal.
pub fn normal(triangle: &[[f32; 3]; 3]) -> [f64; 3] {
    let [a, b, c] = triangle.map(|p| p.map(f64::from));
    cross(minus(b, a), minus(c, a))
}

/// `v` of length 1; zero where it has none.
pub fn unit(v: [f64; 3]) -> [f32; 3] {
    let norm = length(v);
    v.map(|x| if norm > 0. { (x / norm) as f32 } else { 0. })
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A triangle and the face it is of.
#[derive(Clone, Copy, Debug)]
pub struct Leaf {
    corners: [[f32; 3]; 3],
    face: u32,
}

impl RTreeObject for Leaf {
    type Envelope = AABB<[f32; 3]>;

    fn envelope(&self) -> Self::Envelope {
        AABB::from_points(&self.corners)
    }
}

impl PointDistance for Leaf {
    fn distance_2(&self, point: &[f32; 3]) -> f32 {
        distance_2(&self.corners, *point)
    }
}

/// The squared distance of `p` from a triangle: from its plane inside, from its edges outside.
pub fn distance_2([a, b, c]: &[[f32; 3]; 3], p: [f32; 3]) -> f32 {
    let sub = |a: [f32; 3], b: [f32; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let to_edge = |from: [f32; 3], to: [f32; 3]| {
        let (along, out) = (sub(to, from), sub(p, from));
        let size = dot(along, along);
        let t = if size > 0. { (dot(along, out) / size).clamp(0., 1.) } else { 0. };
        let rest = [0, 1, 2].map(|k| out[k] - t * along[k]);
        dot(rest, rest)
    };
    let (u, v, w) = (sub(*b, *a), sub(*c, *a), sub(p, *a));
    let (uu, uv, vv, wu, wv) = (dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v));
    let area = uu * vv - uv * uv;
    let (s, t) = (vv * wu - uv * wv, uu * wv - uv * wu);
    if area > 0. && s >= 0. && t >= 0. && s + t <= area {
        let rest = [0, 1, 2].map(|k| w[k] - (s * u[k] + t * v[k]) / area);
        return dot(rest, rest);
    }
    to_edge(*a, *b).min(to_edge(*b, *c)).min(to_edge(*c, *a))
}

/// A point to look from, and the normal there.
#[derive(Clone, Copy, Debug, Default)]
pub struct Probe {
    /// Where.
    pub place: [f32; 3],
    /// The normal there, of length 1 or 0.
    pub normal: [f32; 3],
}

/// What a point found: the nearest face, and the nearest that agrees; each (squared distance, face) or [`NONE`].
pub type Found = [u64; 2];

fn pack(distance_2: f32, face: u32) -> u64 {
    u64::from(distance_2.to_bits()) << 32 | u64::from(face)
}

/// The squared distance and the face behind a number of [`Found`].
pub fn unpack(packed: u64) -> Option<(f32, u32)> {
    (packed != NONE).then_some((f32::from_bits((packed >> 32) as u32), packed as u32))
}

/// The distance up to which a face that agrees is better than one at distance `d` that does not; `slack` is an edge.
pub fn window(d: f32, slack: f32) -> f32 {
    2. * d + slack
}

/// A tree of all triangles of some faces.
pub struct Tree(RTree<Leaf>);

impl Tree {
    /// Of the faces of `range` for which `wanted`.
    pub fn of(mesh: &Mesh, frame: &Frame, range: std::ops::Range<usize>, wanted: impl Fn(u32) -> bool) -> Self {
        let faces = &mesh.faces;
        let corners = range
            .clone()
            .next_back()
            .map_or(0, |last| faces.corner_range(last).end - faces.corner_range(range.start).start);
        let mut leaves = Vec::with_capacity(corners.saturating_sub(2 * range.len()));
        frame.triangles(mesh, range, |face, corners| {
            if wanted(face) {
                leaves.push(Leaf { corners, face });
            }
        });
        Self(RTree::bulk_load(leaves))
    }

    /// The normal of the triangle nearest to `place`.
    pub fn normal_near(&self, place: [f32; 3]) -> Option<[f32; 3]> {
        self.0.nearest_neighbor(place).map(|leaf| unit(normal(&leaf.corners)))
    }

    /// Improves `found` by what is near `probe`; normals agree where `sign` times theirs is much like its own.
    pub fn improve(&self, probe: &Probe, sign: f32, slack: f32, found: &mut Found) {
        if !probe.place.iter().all(|x| x.is_finite()) {
            return;
        }
        let mut reach = f32::INFINITY;
        for (leaf, distance_2) in self.0.nearest_neighbor_iter_with_distance_2(probe.place) {
            let packed = pack(distance_2, leaf.face);
            if distance_2 > reach {
                break;
            }
            found[0] = found[0].min(packed);
            if reach == f32::INFINITY {
                reach = window(distance_2.sqrt(), slack).powi(2);
            }
            if unpack(found[1]).is_some_and(|(best, _)| distance_2 > best) {
                break;
            }
            if sign * dot(unit(normal(&leaf.corners)), probe.normal) >= AGREE {
                found[1] = found[1].min(packed);
                // Only those that are as near can still be better.
                reach = distance_2;
            }
        }
    }

    /// [`Tree::improve`] for many points.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn improve_all(
        &self,
        probe: impl Fn(usize) -> Probe + Sync,
        sign: f32,
        slack: f32,
        found: &mut [Found],
        run: &Run,
    ) -> Result<()> {
        let work = |k: usize, piece: &mut [Found], (): &mut ()| {
            for (i, found) in piece.iter_mut().enumerate() {
                self.improve(&probe(k * CHUNK + i), sign, slack, found);
            }
            Ok(())
        };
        fill_chunks(run.threads, &run.cancel, found, CHUNK, || (), work).map(drop)
    }
}
