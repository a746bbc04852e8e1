//! Caps that close a part where it was cut from its neighbours, or has a hole: with them, parts of a closed mesh are
//! solids.
//!
//! Open edges of the part are joined into loops; a loop that touches itself is divided into simple ones. A loop is
//! filled by ear clipping in the plane of its area vector (Newell's). If that does not use each of its edges once,
//! folds, or would duplicate an edge of the part or one next to the cut, it is filled by a fan around its centre, which
//! always closes it, but may intersect itself if the loop is far from flat and convex. Both sides of a loop get the
//! same triangles, so volumes of parts add up to that of the whole if each loop lies between two parts; caps of parts
//! that meet three at a time need not fill what they enclose. The diagonals of triangulated polygons count as edges
//! too, since STL files consist of triangles.
//!
//! Vertices at the same position count as one. Cost: 24 bytes per corner of the part (STL: 32), [`OPEN`] per open edge,
//! and 4 bytes per vertex of the mesh while the meeting points of parts are determined, from the budget; a sort of the
//! edges.

use crate::base::Result;
use crate::base::sort::sort_by;
use crate::base::vector::{distance, finite, position_key};
use crate::mesh::{Mesh, polygon};
use crate::store::Run;
use crate::store::budget::Grant;
use earcut::Earcut;
use std::collections::{BTreeSet, HashMap};

/// Faces between two checks of the stop flag.
const CHUNK: usize = 1 << 16;

/// Bytes per open edge while edges are joined into loops.
const OPEN: u64 = 130;

/// A corner of a cap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Corner {
    /// A vertex of the mesh.
    Vertex(u32),
    /// One of [`Caps::centres`].
    Centre(u32),
}

/// The caps of a part.
#[derive(Clone, Debug, Default)]
pub(super) struct Caps {
    /// Centres of fans.
    pub centres: Vec<[f64; 3]>,
    /// Triangles, wound like the part.
    pub triangles: Vec<[Corner; 3]>,
    /// Number of loops that were filled.
    pub loops: usize,
    /// Number of edges of more than two faces, or of two with contradicting winding, open edges in no loop, and faces
    /// with a corner without a position: if any, the part is not a solid.
    pub flaws: u64,
}

/// The edges of triangles with both ends where parts meet. A cap must not duplicate them on either side of a cut.
pub(super) struct EdgesAtCuts {
    /// Ascending, each with its smaller end first.
    edges: Vec<[u32; 2]>,
    _grant: Grant,
}

impl EdgesAtCuts {
    /// For `mesh`, whose faces have `labels`.
    ///
    /// # Errors
    /// [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
    pub fn of(mesh: &Mesh, labels: &[u32], run: &Run) -> Result<Self> {
        /// Faces of several parts meet at the vertex.
        const SEVERAL: u32 = u32::MAX;
        let bytes = 4 * mesh.positions.len() as u64;
        let _grant_of_parts = run.budget.take("where parts meet", bytes, bytes)?;
        // The part of each vertex plus one; 0 without a face.
        let mut parts = vec![0u32; mesh.positions.len()];
        let chunks = || (0..labels.len()).step_by(CHUNK).map(|start| start..labels.len().min(start + CHUNK));
        for faces in chunks() {
            run.cancel.check()?;
            mesh.faces.for_each(faces, |face, corners| {
                let own = labels[face].saturating_add(1);
                for &v in corners {
                    let part = &mut parts[v as usize];
                    *part = if *part == 0 || *part == own { own } else { SEVERAL };
                }
            });
        }
        let meet = |side: &[u32; 2]| side.iter().all(|&v| parts[v as usize] == SEVERAL);
        let each = |visit: &mut dyn FnMut([u32; 2])| {
            chunks().try_for_each(|faces| {
                run.cancel.check()?;
                mesh.faces.for_each(faces, |_, corners| {
                    let mut several = 0;
                    for &v in corners {
                        several += usize::from(parts[v as usize] == SEVERAL);
                    }
                    if several > 1 {
                        mesh.triangles(corners, |[a, b, c], _| {
                            [[a, b], [b, c], [c, a]].into_iter().filter(meet).map(ends).for_each(&mut *visit);
                        });
                    }
                });
                Ok(())
            })
        };
        let mut count = 0;
        each(&mut |_| count += 1)?;
        let grant = run.budget.take("edges where parts meet", 8 * count, 8 * count)?;
        let mut edges = Vec::with_capacity(count as usize);
        each(&mut |edge| edges.push(edge))?;
        edges.sort_unstable();
        edges.dedup();
        Ok(Self { edges, _grant: grant })
    }
}

/// The ends of an edge, the smaller first.
fn ends([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Sorts directed edges by their ends. Returns those without a partner, and the number that rule out a solid.
fn without_partner(edges: &mut [[u32; 2]]) -> (Vec<[u32; 2]>, u64) {
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
fn loops(mut edges: Vec<[u32; 2]>) -> (Vec<Vec<u32>>, u64) {
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

/// The ear-clipping triangles of a loop in the plane of its area vector, wound against it; `None` unless they use each
/// of its edges once and do not fold.
fn clipped(ring: &[u32], at: &[[f64; 3]], clipper: &mut Earcut<f64>) -> Option<Vec<[u32; 3]>> {
    let n = ring.len();
    let mut triangles = polygon::clipped(at, clipper)?;
    triangles.iter_mut().for_each(|t| t.swap(1, 2));
    let mut edges: Vec<[u32; 2]> = triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
    let (mut rim, flaws) = without_partner(&mut edges);
    sort_by(&mut rim, |a, b| a[1].cmp(&b[1]));
    let whole = rim.len() == n && (0..n).all(|k| rim[k] == [((k + 1) % n) as u32, k as u32]);
    (flaws == 0 && whole).then(|| triangles.into_iter().map(|t| t.map(|k| ring[k as usize])).collect())
}

impl Caps {
    /// Closes the part whose faces `visit` enumerates; `at_cuts` are the edges at cuts of the mesh. With `by_place`,
    /// edges of different vertices at the same positions count as one when flaws are counted: an STL has only
    /// positions.
    /// # Errors
    /// [`crate::base::Error::Memory`]; those of `visit`.
    pub fn of(
        mesh: &Mesh,
        at_cuts: &EdgesAtCuts,
        (corners, by_place): (u64, bool),
        run: &Run,
        visit: impl FnOnce(&mut dyn FnMut(&[u32])) -> Result<()>,
    ) -> Result<Self> {
        let bytes = if by_place { 32 } else { 24 } * corners;
        let _grant = run.budget.take("edges of a part", bytes, bytes)?;
        let mut edges: Vec<[u32; 2]> = Vec::with_capacity(corners as usize);
        let (mut diagonals, mut nowhere) = (Vec::new(), 0);
        visit(&mut |face| {
            let turned = face.iter().cycle().skip(1);
            edges.extend(face.iter().zip(turned).map(|(&a, &b)| [a, b]).filter(|[a, b]| a != b));
            nowhere += u64::from(!face.iter().all(|&v| finite(mesh.positions.get(v))));
            if face.len() > 3 {
                diagonals.extend(diagonals_of(face, mesh));
            }
        })?;
        diagonals.sort_unstable();
        let (mut open, flaws) = without_partner(&mut edges);
        let bytes = OPEN * open.len() as u64;
        let _grant_of_open = run.budget.take("open edges of a part", bytes, bytes)?;
        let (welded, open, more) = weld(mesh, &mut open);
        let (all, left) = loops(open);
        let mut caps = Caps { flaws: flaws + more + left + nowhere, ..Caps::default() };
        let (mut clipper, mut chords) = (Earcut::new(), BTreeSet::new());
        let known = |edge: [u32; 2]| {
            edges.binary_search_by_key(&edge, |&edge| ends(edge)).is_ok()
                || diagonals.binary_search(&edge).is_ok()
                || at_cuts.edges.binary_search(&edge).is_ok()
        };
        for ring in all {
            run.cancel.check()?;
            let (ring, turned) = canonical(ring);
            let at: Vec<[f64; 3]> = ring.iter().map(|&v| mesh.positions.get(v)).collect();
            caps.loops += 1;
            let flat = clipped(&ring, &at, &mut clipper).filter(|triangles| {
                let inner = inner_edges(&ring, triangles);
                // Edges of welded vertices are unknown.
                !inner.iter().any(|&edge| welded || known(edge) || !chords.insert(edge))
            });
            let filled: Vec<[Corner; 3]> = match flat {
                Some(triangles) => triangles.into_iter().map(|t| t.map(Corner::Vertex)).collect(),
                None => {
                    let centre = Corner::Centre(caps.centres.len() as u32);
                    caps.centres.push(middle(&at));
                    let next = ring.iter().cycle().skip(1);
                    ring.iter().zip(next).map(|(&a, &b)| [Corner::Vertex(b), Corner::Vertex(a), centre]).collect()
                }
            };
            caps.triangles.extend(filled.into_iter().map(|[a, b, c]| if turned { [a, c, b] } else { [a, b, c] }));
        }
        if by_place {
            caps.flaws += doubled(mesh, edges, &caps.triangles);
        }
        Ok(caps)
    }

    /// The position of a corner.
    pub fn place(&self, mesh: &Mesh, corner: Corner) -> [f64; 3] {
        match corner {
            Corner::Vertex(v) => mesh.positions.get(v),
            Corner::Centre(k) => self.centres[k as usize],
        }
    }
}

/// The diagonals of a polygon's triangulation.
fn diagonals_of(face: &[u32], mesh: &Mesh) -> Vec<[u32; 2]> {
    let at: Vec<[f64; 3]> = face.iter().map(|&v| mesh.positions.get(v)).collect();
    let (n, mut all) = (face.len(), Vec::with_capacity(face.len()));
    polygon::triangles(&at, |[a, b, c]| {
        for [i, j] in [[a, b], [b, c], [c, a]] {
            // Each diagonal only once.
            if i < j && i + 1 < j && (i, j) != (0, n - 1) {
                all.push(ends([face[i], face[j]]));
            }
        }
    });
    all
}

/// The edges of `triangles` that are not on the loop.
fn inner_edges(ring: &[u32], triangles: &[[u32; 3]]) -> BTreeSet<[u32; 2]> {
    let own: BTreeSet<[u32; 2]> = ring.iter().zip(ring.iter().cycle().skip(1)).map(|(&a, &b)| ends([a, b])).collect();
    let all = triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    all.map(ends).filter(|edge| !own.contains(edge)).collect()
}

/// The mean of a loop along its length.
fn middle(at: &[[f64; 3]]) -> [f64; 3] {
    let (mut sum, mut whole) = ([0.; 3], 0.);
    for (&p, &q) in at.iter().zip(at.iter().cycle().skip(1)) {
        let step = distance(p, q);
        (0..3).for_each(|k| sum[k] += step * (p[k] + q[k]) / 2.);
        whole += step;
    }
    if whole > 0. { sum.map(|x| x / whole) } else { at[0] }
}

/// Replaces the vertices of open edges by the least vertex at each position. Returns whether any was replaced, the
/// edges that are still open, and the number that rule out a solid.
fn weld(mesh: &Mesh, open: &mut [[u32; 2]]) -> (bool, Vec<[u32; 2]>, u64) {
    let vertices: BTreeSet<u32> = open.iter().flatten().copied().collect();
    let mut first: HashMap<[u64; 3], u32> = HashMap::new();
    let place = |v: u32| position_key(mesh.positions.get(v));
    let welded = vertices.iter().filter(|&&v| *first.entry(place(v)).or_insert(v) != v).count() > 0;
    let mut named: Vec<[u32; 2]> = open.iter().map(|edge| edge.map(|v| first[&place(v)])).collect();
    named.retain(|[a, b]| a != b);
    let (open, flaws) = without_partner(&mut named);
    (welded, open, flaws)
}

/// How many of the directed `edges` of a part, and of its caps, are duplicates after vertices that are equal as floats
/// are merged.
fn doubled(mesh: &Mesh, mut edges: Vec<[u32; 2]>, caps: &[[Corner; 3]]) -> u64 {
    let place = |v: u32| position_key(mesh.positions.get(v).map(|x| f64::from(x as f32)));
    let mut vertices: Vec<u32> = edges.iter().flatten().copied().collect();
    vertices.sort_unstable();
    vertices.dedup();
    let mut names: Vec<[u32; 2]> = vertices.into_iter().map(|v| [v, v]).collect();
    sort_by(&mut names, |a, b| place(a[0]).cmp(&place(b[0])).then(a[0].cmp(&b[0])));
    names.chunk_by_mut(|a, b| place(a[0]) == place(b[0])).for_each(|alike| {
        let first = alike[0][0];
        alike.iter_mut().for_each(|name| name[1] = first);
    });
    names.sort_unstable();
    let name = |v: u32| names.binary_search_by_key(&v, |name| name[0]).map_or(v, |k| names[k][1]);
    for [a, b, c] in caps {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            if let (Corner::Vertex(from), Corner::Vertex(to)) = (from, to) {
                edges.push([*from, *to]);
            }
        }
    }
    edges.iter_mut().for_each(|edge| *edge = edge.map(name));
    edges.retain(|[a, b]| a != b);
    edges.sort_unstable();
    edges.windows(2).filter(|two| two[0] == two[1]).count() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::vector::{cross, dot};

    fn caps(points: &[[f64; 3]], faces: &[Vec<u32>]) -> (Mesh, Caps) {
        caps_of(points, faces, false)
    }

    fn caps_of(points: &[[f64; 3]], faces: &[Vec<u32>], by_place: bool) -> (Mesh, Caps) {
        let triangles: Vec<[u32; 3]> = faces.iter().map(|f| [f[0], f[1], f[2]]).collect();
        let mesh = Mesh::from_slices(points, &triangles).unwrap();
        let visit = |visit_face: &mut dyn FnMut(&[u32])| {
            faces.iter().for_each(|face| visit_face(face));
            Ok(())
        };
        let run = Run::new(&());
        let whole = EdgesAtCuts::of(&mesh, &vec![0; faces.len()], &run).unwrap();
        let corners = faces.iter().map(|f| f.len() as u64).sum();
        let caps = Caps::of(&mesh, &whole, (corners, by_place), &run, visit).unwrap();
        (mesh, caps)
    }

    /// Six times the volume of faces and caps, and the number of edges not shared by exactly two triangles of
    /// consistent winding.
    fn closed(mesh: &Mesh, faces: &[Vec<u32>], caps: &Caps) -> (f64, u64) {
        let mut all: Vec<[[f64; 3]; 3]> =
            faces.iter().map(|f| [f[0], f[1], f[2]].map(|v| mesh.positions.get(v))).collect();
        all.extend(caps.triangles.iter().map(|t| t.map(|corner| caps.place(mesh, corner))));
        let mut numbers: HashMap<[u64; 3], u32> = HashMap::new();
        let mut number = |p: [f64; 3]| {
            let next = numbers.len() as u32;
            *numbers.entry(p.map(f64::to_bits)).or_insert(next)
        };
        let mut edges = Vec::new();
        for t in &all {
            let [a, b, c] = t.map(&mut number);
            edges.extend([[a, b], [b, c], [c, a]]);
        }
        let (open, flaws) = without_partner(&mut edges);
        (all.iter().map(|t| dot(t[0], cross(t[1], t[2]))).sum(), open.len() as u64 + flaws)
    }

    /// A prism of height 1 over a polygon, without bottom and lid.
    fn prism(polygon: &[[f64; 2]]) -> (Vec<[f64; 3]>, Vec<Vec<u32>>) {
        let n = polygon.len() as u32;
        let points = [0., 1.].iter().flat_map(|&z| polygon.iter().map(move |p| [p[0], p[1], z])).collect();
        let side = |k: u32| {
            let (a, b) = (k, (k + 1) % n);
            [vec![a, b, b + n], vec![a, b + n, a + n]]
        };
        (points, (0..n).flat_map(side).collect())
    }

    #[test]
    fn a_tube_is_closed_flat_where_that_can_be_and_by_fans_elsewhere() {
        // An L, whose centroid does not see all of it, with a vertex in the middle of a side.
        let ell = [[0., 0.], [1.5, 0.], [3., 0.], [3., 1.], [1., 1.], [1., 3.], [0., 3.]];
        let (points, faces) = prism(&ell);
        let (mesh, flat) = caps(&points, &faces);
        assert_eq!((flat.loops, flat.centres.len(), flat.triangles.len(), flat.flaws), (2, 0, 10, 0));
        let (volume, wrong) = closed(&mesh, &faces, &flat);
        assert!(wrong == 0 && (volume / 6. - 5.).abs() < 1e-12, "{volume}");
        // A loop that crosses itself.
        let (points, faces) = prism(&[[0., 0.], [3., 3.], [3., 0.], [0., 1.]]);
        let (mesh, fans) = caps(&points, &faces);
        assert_eq!((fans.loops, fans.centres.len(), fans.triangles.len(), fans.flaws), (2, 2, 8, 0));
        assert_eq!(closed(&mesh, &faces, &fans).1, 0);
    }

    /// Each is closed by its own vertices, but an STL has only positions: four faces meet at one edge there.
    #[test]
    fn solids_that_touch_along_an_edge_are_none_by_places() {
        let solid = |tip: [f64; 3], side: [f64; 3]| [[0., 0., 0.], [1., 0., 0.], side, tip];
        let points = [solid([0., 1., 0.], [0., 0., 1.]), solid([0., -1., 0.], [0., 0., -1.])].concat();
        let closed = |k: u32| [[0, 1, 2], [1, 0, 3], [2, 1, 3], [0, 2, 3]].map(|face| face.map(|v| v + k).to_vec());
        let faces = [closed(0), closed(4)].concat();
        let flaws = [false, true].map(|by_place| caps_of(&points, &faces, by_place).1.flaws);
        assert_eq!(flaws, [0, 2]);
        assert_eq!(caps_of(&points[..4], &faces[..4], true).1.flaws, 0);
    }

    #[test]
    fn both_sides_of_a_cut_get_the_same_cap() {
        // An octahedron cut along a ring that is not flat: volumes add up.
        let points = [[1., 0., 0.3], [0., 1., -0.2], [-1., 0., 0.4], [0., -1., -0.1], [0., 0., 1.], [0., 0., -1.]];
        let upper: Vec<Vec<u32>> = (0..4).map(|k| vec![k, (k + 1) % 4, 4]).collect();
        let lower: Vec<Vec<u32>> = (0..4).map(|k| vec![(k + 1) % 4, k, 5]).collect();
        let whole = [upper.clone(), lower.clone()].concat();
        let volume = |faces: &[Vec<u32>]| {
            let (mesh, caps) = caps(&points, faces);
            let (volume, wrong) = closed(&mesh, faces, &caps);
            assert_eq!((wrong, caps.flaws), (0, 0));
            volume
        };
        assert!((volume(&upper) + volume(&lower) - volume(&whole)).abs() < 1e-12);
        assert!(caps(&points, &whole).1.triangles.is_empty());
    }

    #[test]
    fn loops_that_touch_and_soups_are_closed_and_what_is_no_solid_is_told() {
        // Two tetrahedra without bottoms that touch at one vertex of their rims.
        let points =
            [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0.2, 0.2, 1.], [-1., 0., 0.], [0., -1., 0.], [-0.2, -0.2, 1.]];
        let cone = |a: u32, b: u32, c: u32, top: u32| vec![vec![a, b, top], vec![b, c, top], vec![c, a, top]];
        let faces = [cone(0, 1, 2, 3), cone(0, 4, 5, 6)].concat();
        let (mesh, touching) = caps(&points, &faces);
        assert_eq!((touching.loops, touching.flaws, closed(&mesh, &faces, &touching).1), (2, 0, 0));
        // Every face with vertices of its own.
        let soup: Vec<[f64; 3]> = faces.iter().flatten().map(|&v| points[v as usize]).collect();
        let own: Vec<Vec<u32>> = (0..faces.len() as u32).map(|k| vec![3 * k, 3 * k + 1, 3 * k + 2]).collect();
        assert_eq!(caps_of(&soup, &own, true).1.flaws, 0);
        let (mesh, loose) = caps(&soup, &own);
        assert_eq!((loose.loops, loose.flaws, closed(&mesh, &own, &loose).1), (2, 0, 0));
        // A face turned over; a third one at an edge.
        let mut turned = faces.clone();
        turned[1].swap(0, 1);
        assert!(caps(&points, &turned).1.flaws > 0);
        let fin = [faces, vec![vec![0, 1, 6]]].concat();
        assert!(caps(&points, &[fin, vec![vec![1, 0, 5]]].concat()).1.flaws > 0);
    }
}
