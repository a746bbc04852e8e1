//! Loops of open edges, and the triangles that fill them.
//!
//! A loop is filled by ear clipping in the plane of its area vector (Newell's), unless that does not use each of its
//! edges once, or folds. Where a hollow part was cut off there are two loops, one around the other: the rim of the
//! outside and that of the cavity. What is cut there is the ring between them, so they are filled together: both are
//! joined by a bridge, and ears are clipped in the plane of the outer one. If that fails, as where neither is flat, a
//! band of triangles joins them. Both surfaces leave such a cut on the same side. Where they do not, as at the two ends
//! of a part that narrows, or around a nose cut out of a face, each loop has a cap of its own.
//!
//! Cost: for each pair of at most [`MOST_LOOPS`] loops a test of [`SAMPLES`] points against a polygon; for two nested
//! ones a pass over the part, and the product of their lengths.

use crate::base::bit_set::BitSet;
use crate::base::sort::sort_by;
use crate::base::vector::{add_scaled, distance, dot, length, minus, unit};
use crate::base::{Cancel, Result};
use crate::mesh::{Mesh, polygon};
use crate::store::Run;
use earcut::Earcut;
use std::collections::{BTreeSet, HashMap};

/// Loops beyond this number are not tested for being nested: so many are holes of a damaged mesh.
const MOST_LOOPS: usize = 256;
/// Points of a loop that must lie within another.
const SAMPLES: usize = 64;
/// Minimum area of a nested loop, relative to the outer one.
const LEAST_AREA: f64 = 0.1;
/// Maximum cosine between the area vectors of nested loops.
const OPPOSITE: f64 = -0.5;
/// Maximum distance of their centres along the outer one's area vector, relative to the square root of its area.
const APART: f64 = 0.5;
/// Minimum cosine between the directions in which surfaces leave a cut and the area vector.
const LEAVING: f64 = 0.3;
/// Maximum product of the lengths of nested loops.
const MOST_PAIRS: usize = 1 << 30;

/// Triangles that fill loops, wound against the ring of the first, and their edges that are on no loop.
pub(super) type Filling = (Vec<[u32; 3]>, BTreeSet<[u32; 2]>);

/// A vertex of a loop, and its position.
type Corner = (u32, [f64; 3]);

/// The vertices of a ring, and their positions.
type Ring = (Vec<u32>, Vec<[f64; 3]>);

/// A simple loop of open edges.
pub(super) struct Loop {
    /// Its vertices, from the least one towards the smaller neighbour, so that both sides of a cut have the same.
    pub ring: Vec<u32>,
    /// Whether that is against the direction of the edges.
    pub turned: bool,
    /// Positions of the vertices.
    pub at: Vec<[f64; 3]>,
    /// Twice the area vector of the ring.
    area: [f64; 3],
}

/// The edges of a ring of vertices, their smaller ends first.
fn edges_of_ring(ring: &[u32]) -> impl Iterator<Item = [u32; 2]> {
    ring.iter().zip(ring.iter().cycle().skip(1)).map(|(&a, &b)| ends([a, b]))
}

impl Loop {
    /// The loop through the vertices `path`.
    pub fn of(mesh: &Mesh, path: Vec<u32>) -> Self {
        let (ring, turned) = canonical(path);
        let at: Vec<[f64; 3]> = ring.iter().map(|&v| mesh.positions.get(v)).collect();
        let area = polygon::double_area_vector(at.iter().map(|&p| minus(p, at[0])));
        Self { ring, turned, at, area }
    }

    /// Its area vector in the direction of the edges, and its length.
    fn directed(&self) -> ([f64; 3], f64) {
        (self.area.map(|x| if self.turned { -x } else { x }), length(self.area))
    }

    /// The vertices and their positions.
    fn corners(&self) -> Vec<Corner> {
        self.ring.iter().copied().zip(self.at.iter().copied()).collect()
    }

    /// The same, in the direction that its edges have if those of `outer` have that of its ring: both sides of a cut
    /// get the same.
    fn beside(&self, outer: &Self) -> Vec<Corner> {
        let mut corners = self.corners();
        if self.turned != outer.turned {
            corners.reverse();
        }
        corners
    }

    /// Whether `inner` may be the rim of a cavity within this rim.
    fn surrounds(&self, inner: &Self) -> bool {
        let [(own, size), (other, least)] = [self, inner].map(Self::directed);
        if !(least < size && least >= LEAST_AREA * size && dot(own, other) < OPPOSITE * size * least) {
            return false;
        }
        let [middle, within] = [self, inner].map(|ring| middle(&ring.at));
        if dot(minus(within, middle), own).abs() / size > APART * (size / 2.).sqrt() {
            return false;
        }
        let plane = polygon::plane_across(unit(self.area));
        let flat = |p: [f64; 3]| plane.map(|axis| dot(minus(p, middle), axis));
        let rim: Vec<[f64; 2]> = self.at.iter().map(|&p| flat(p)).collect();
        inner.at.iter().step_by(inner.at.len().div_ceil(SAMPLES)).all(|&p| is_within(flat(p), &rim))
    }
}

/// Whether the point `p` lies in the polygon `rim`.
fn is_within([x, y]: [f64; 2], rim: &[[f64; 2]]) -> bool {
    let crosses = |(&[ax, ay], &[bx, by]): (&[f64; 2], &[f64; 2])| {
        (ay > y) != (by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax)
    };
    rim.iter().zip(rim.iter().cycle().skip(1)).filter(|&pair| crosses(pair)).count() % 2 == 1
}

/// The loops to fill together: the number of each outer loop, followed by those within it. `visit` enumerates the faces
/// of the part.
///
/// # Errors
/// [`crate::base::Error::Memory`]; those of `visit`.
pub(super) fn nested(
    mesh: &Mesh,
    loops: &[Loop],
    run: &Run,
    visit: impl Fn(&mut dyn FnMut(&[u32])) -> Result<()>,
) -> Result<Vec<Vec<usize>>> {
    let mut outer: Vec<Option<usize>> = vec![None; loops.len()];
    if (2..=MOST_LOOPS).contains(&loops.len()) {
        for (k, inner) in loops.iter().enumerate() {
            let around = (0..loops.len()).filter(|&j| j != k && loops[j].surrounds(inner));
            outer[k] = around.min_by(|&a, &b| loops[a].directed().1.total_cmp(&loops[b].directed().1));
        }
    }
    if outer.iter().any(Option::is_some) {
        let leaving = leaving(mesh, loops, run, visit)?;
        // The larger ones first: whether one is within another is settled before what is within it.
        let mut order: Vec<usize> = (0..loops.len()).collect();
        order.sort_by(|&a, &b| loops[b].directed().1.total_cmp(&loops[a].directed().1));
        for k in order {
            let Some(around) = outer[k] else { continue };
            let (axis, size) = loops[around].directed();
            let [own, other] = [k, around].map(|k| dot(leaving[k], axis) / size);
            if outer[around].is_some() || own.abs().min(other.abs()) < LEAVING || (own > 0.) != (other > 0.) {
                outer[k] = None;
            }
        }
    }
    let mut groups: Vec<Vec<usize>> = (0..loops.len()).map(|k| vec![k]).collect();
    for (k, outer) in outer.iter().enumerate().filter_map(|(k, outer)| Some((k, (*outer)?))) {
        groups[outer].push(k);
    }
    Ok(groups.into_iter().zip(outer).filter(|(_, outer)| outer.is_none()).map(|(group, _)| group).collect())
}

/// The mean direction from the edges of each loop to the centroids of their faces: of length 1 if all are the same.
fn leaving(
    mesh: &Mesh,
    loops: &[Loop],
    run: &Run,
    visit: impl Fn(&mut dyn FnMut(&[u32])) -> Result<()>,
) -> Result<Vec<[f64; 3]>> {
    let bytes = BitSet::bytes(mesh.positions.len());
    let _grant = run.budget.take("open vertices of a part", bytes, bytes)?;
    let mut vertices = BitSet::new(mesh.positions.len());
    loops.iter().flat_map(|ring| &ring.ring).for_each(|&v| _ = vertices.add(v));
    let edges = loops.iter().enumerate().flat_map(|(k, ring)| edges_of_ring(&ring.ring).map(move |edge| (edge, k)));
    let owner: HashMap<[u32; 2], usize> = edges.collect();
    let mut sums = vec![([0.; 3], 0.); loops.len()];
    visit(&mut |face| {
        for edge in edges_of(face).filter(|[a, b]| vertices.has(*a) && vertices.has(*b)) {
            let Some(&k) = owner.get(&ends(edge)) else { continue };
            let [a, b] = edge.map(|v| mesh.positions.get(v));
            let mean =
                face.iter().fold([0.; 3], |sum, &v| add_scaled(sum, 1. / face.len() as f64, mesh.positions.get(v)));
            let way = add_scaled(add_scaled(mean, -0.5, a), -0.5, b);
            sums[k].0 = add_scaled(sums[k].0, 1., way);
            sums[k].1 += length(way);
        }
    })?;
    Ok(sums.into_iter().map(|(sum, size)| sum.map(|x| if size > 0. { x / size } else { 0. })).collect())
}

/// The numbers of the corners of `a` and `b` with the least `gap`; of several, those of the least vertices, so that
/// both sides of a cut find the same. `None` if there are too many pairs, or both loops share that vertex.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
fn nearest(
    a: &[Corner],
    b: &[Corner],
    gap: impl Fn(usize, usize) -> f64,
    cancel: &Cancel,
) -> Result<Option<[usize; 2]>> {
    if a.len().saturating_mul(b.len()) > MOST_PAIRS {
        return Ok(None);
    }
    let mut found = (f64::INFINITY, [u32::MAX; 2], [0; 2]);
    for (i, (v, _)) in a.iter().enumerate() {
        cancel.check()?;
        for (j, (w, _)) in b.iter().enumerate() {
            let gap = gap(i, j);
            if gap < found.0 || gap == found.0 && [*v, *w] < found.1 {
                found = (gap, [*v, *w], [i, j]);
            }
        }
    }
    Ok((found.1[0] != found.1[1]).then_some(found.2))
}

/// One ring of vertices through `loops`, the first of which is around the others, and their positions: bridges, passed
/// in both directions, join them. `None` if they are too long, or touch.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
fn joined(loops: &[&Loop], cancel: &Cancel) -> Result<Option<Ring>> {
    let (outer, mut inner) = (loops[0], loops[1..].to_vec());
    let plane = polygon::plane_across(unit(outer.area));
    let flat = |p: &[f64; 3]| plane.map(|axis| dot(minus(*p, outer.at[0]), axis));
    inner.sort_unstable_by_key(|ring| ring.ring[0]);
    let mut all = outer.corners();
    for hole in inner {
        let own = hole.beside(outer);
        let places: Vec<[f64; 2]> = own.iter().map(|(_, p)| flat(p)).collect();
        let around: Vec<[f64; 2]> = all.iter().map(|(_, p)| flat(p)).collect();
        let gap = |i: usize, j: usize| (places[j][0] - around[i][0]).powi(2) + (places[j][1] - around[i][1]).powi(2);
        let Some([i, j]) = nearest(&all, &own, gap, cancel)? else { return Ok(None) };
        all = [&all[..=i], &own[j..], &own[..=j], &all[i..]].concat();
    }
    Ok(Some(all.into_iter().unzip()))
}

/// A band of triangles between the loop `outer` and `inner`, which it is around: on from the nearest two vertices,
/// always across the shorter diagonal. It need not be flat, and has no edge between two vertices of one loop. `None` if
/// the loops are too long, or touch, or one vertex would be joined to all others.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub(super) fn band(outer: &Loop, inner: &Loop, cancel: &Cancel) -> Result<Option<Filling>> {
    let (mut a, mut b) = (outer.corners(), inner.beside(outer));
    b.reverse();
    let gap = |p: &Corner, q: &Corner| distance(p.1, q.1);
    let Some([i, j]) = nearest(&a, &b, |i, j| gap(&a[i], &b[j]), cancel)? else { return Ok(None) };
    let (n, m) = (a.len(), b.len());
    a.rotate_left(i);
    b.rotate_left(j);
    let (mut i, mut j) = (0, 0);
    let (mut triangles, mut across) = (Vec::with_capacity(n + m), BTreeSet::new());
    while i < n || j < m {
        let (here, there) = (&a[i % n], &b[j % m]);
        let (next, after) = (&a[(i + 1) % n], &b[(j + 1) % m]);
        if j == m || i < n && gap(next, there) <= gap(here, after) {
            triangles.push([next.0, here.0, there.0]);
            i += 1;
        } else {
            triangles.push([there.0, after.0, here.0]);
            j += 1;
        }
        if !across.insert(ends([a[i % n].0, b[j % m].0])) {
            return Ok(None);
        }
    }
    Ok(Some((triangles, across)))
}

/// Fills `loops` together, in the plane of the first, which is around the others; `None` if that is impossible.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub(super) fn filled(loops: &[&Loop], clipper: &mut Earcut<f64>, cancel: &Cancel) -> Result<Option<Filling>> {
    Ok(joined(loops, cancel)?.and_then(|joined| filled_along(joined, loops, clipper)))
}

/// The same along the ring through all of them.
fn filled_along((ring, at): Ring, loops: &[&Loop], clipper: &mut Earcut<f64>) -> Option<Filling> {
    let n = ring.len();
    let mut triangles = polygon::clipped_along(&at, loops[0].area, clipper)?;
    triangles.iter_mut().for_each(|t| t.swap(1, 2));
    let mut edges: Vec<[u32; 2]> = triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
    let (mut rim, flaws) = without_partner(&mut edges);
    sort_by(&mut rim, |a, b| a[1].cmp(&b[1]));
    if flaws > 0 || rim.len() != n || !(0..n).all(|k| rim[k] == [((k + 1) % n) as u32, k as u32]) {
        return None;
    }
    let triangles: Vec<[u32; 3]> = triangles.into_iter().map(|t| t.map(|k| ring[k as usize])).collect();
    let own: BTreeSet<[u32; 2]> = loops.iter().flat_map(|ring| edges_of_ring(&ring.ring)).collect();
    let all = triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let inner = all.map(ends).filter(|edge| !own.contains(edge)).collect();
    Some((triangles, inner))
}

/// A face's directed edges that are not a point.
pub(super) fn edges_of(face: &[u32]) -> impl Iterator<Item = [u32; 2]> {
    let turned = face.iter().cycle().skip(1);
    face.iter().zip(turned).map(|(&a, &b)| [a, b]).filter(|[a, b]| a != b)
}

/// The ends of an edge, the smaller first.
pub(super) fn ends([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Sorts directed edges by their ends. Returns those without a partner, and the number that rule out a solid.
pub(super) fn without_partner(edges: &mut [[u32; 2]]) -> (Vec<[u32; 2]>, u64) {
    edges.sort_unstable_by_key(|&edge| (ends(edge), edge));
    let (mut open, mut flaws) = (Vec::new(), 0);
    for same in edges.chunk_by(|&a, &b| ends(a) == ends(b)) {
        let (ascending, descending) = same.split_at(same.partition_point(|[a, b]| a < b));
        let paired = ascending.len().min(descending.len());
        match same.len() {
            1 => open.push(same[0]),
            2 => flaws += u64::from(paired == 0),
            _ => {
                flaws += 1;
                open.extend_from_slice(&ascending[paired..]);
                open.extend_from_slice(&descending[paired..]);
            }
        }
    }
    (open, flaws)
}

/// Joins directed edges into simple loops; also returns the number of edges in no loop.
pub(super) fn loops(mut edges: Vec<[u32; 2]>) -> (Vec<Vec<u32>>, u64) {
    edges.sort_unstable();
    // The next unvisited edge from each vertex.
    let mut next: HashMap<u32, std::ops::Range<usize>> = HashMap::new();
    for (k, &[from, _]) in edges.iter().enumerate() {
        next.entry(from).or_insert(k..k).end = k + 1;
    }
    let (mut all, mut left) = (Vec::new(), 0);
    for &[start, _] in &edges {
        let (mut path, mut place) = (vec![start], HashMap::from([(start, 0)]));
        while let Some(&here) = path.last() {
            let Some(k) = next.get_mut(&here).and_then(Iterator::next) else {
                left += path.len() as u64 - 1;
                break;
            };
            let to = edges[k][1];
            match place.get(&to).copied() {
                Some(from) => {
                    all.push(path[from..].to_vec());
                    path.drain(from + 1..).for_each(|v| _ = place.remove(&v));
                }
                None => {
                    place.insert(to, path.len());
                    path.push(to);
                }
            }
        }
    }
    (all, left)
}

/// Rotates the loop to start at its least vertex and go towards the smaller neighbour, so that both sides give the same
/// loop; also returns whether the direction was reversed.
fn canonical(mut ring: Vec<u32>) -> (Vec<u32>, bool) {
    let least = (0..ring.len()).min_by_key(|&k| ring[k]).unwrap_or(0);
    ring.rotate_left(least);
    let turned = ring.len() > 2 && ring[ring.len() - 1] < ring[1];
    if turned {
        ring[1..].reverse();
    }
    (ring, turned)
}

/// The mean of a loop along its length.
pub(super) fn middle(at: &[[f64; 3]]) -> [f64; 3] {
    let (mut sum, mut whole) = ([0.; 3], 0.);
    for (&p, &q) in at.iter().zip(at.iter().cycle().skip(1)) {
        let step = distance(p, q);
        (0..3).for_each(|k| sum[k] += step * (p[k] + q[k]) / 2.);
        whole += step;
    }
    if whole > 0. { sum.map(|x| x / whole) } else { at[0] }
}
