//! Caps that close a part where it was cut from its neighbours, or has a hole: with them, parts of a closed mesh are
//! solids.
//!
//! Open edges of the part are joined into loops ([`super::cap_loops`]); a loop that touches itself is divided into
//! simple ones. A loop is filled flat, and together with that of a cavity within it. If that is impossible, or would
//! duplicate an edge of the part or one next to the cut, each is filled by a fan around its centre, which always closes
//! it, but may intersect itself if the loop is far from flat and convex. Both sides of a loop get the same triangles,
//! so volumes of parts add up to that of the whole if each loop lies between two parts; caps of parts that meet three
//! at a time need not fill what they enclose. The diagonals of triangulated polygons count as edges too, since STL
//! files consist of triangles.
//!
//! Vertices at the same position count as one. Cost: a sort of the edges, as many at a time as the budget has room for,
//! with a pass over the part for each such block; from the budget also two bits per vertex of the mesh, [`OPEN`] per
//! open edge, and 8 bytes for each edge between open ones.

use super::cap_loops::{Filling, Loop, band, edges_of, ends, filled, loops, middle, nested, without_partner};
use crate::base::Result;
use crate::base::bit_set::BitSet;
use crate::base::vector::{finite, position_key};
use crate::mesh::Mesh;
use crate::mesh::split_faces::boundary_vertices;
use crate::store::Run;
use crate::store::budget::Grant;
use earcut::Earcut;
use std::collections::{BTreeSet, HashMap};
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};

/// Faces between two checks of the stop flag.
const CHUNK: usize = 1 << 16;

/// Minimum number of edges in a block, if there are as many.
const LEAST: u64 = 1 << 12;

/// Bytes per open edge while edges are joined into loops.
const OPEN: u64 = 220;

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
        let (several, _grant_of_vertices) = boundary_vertices(mesh, labels, run)?;
        let each = |visit: &mut dyn FnMut([u32; 2])| {
            (0..labels.len()).step_by(CHUNK).try_for_each(|start| {
                run.cancel.check()?;
                let faces = start..labels.len().min(start + CHUNK);
                mesh.faces.for_each(faces, |_, corners| edges_within(mesh, corners, &several, visit));
                Ok(())
            })
        };
        let (edges, grant) = gathered("edges where parts meet", run, each)?;
        Ok(Self { edges, _grant: grant })
    }
}

/// Calls `visit` with each edge, its smaller end first, of the triangles of a face that has both ends in `vertices`.
fn edges_within(mesh: &Mesh, corners: &[u32], vertices: &BitSet, visit: &mut dyn FnMut([u32; 2])) {
    let mut within = 0;
    for &v in corners {
        within += usize::from(vertices.has(v));
    }
    if within > 1 {
        mesh.triangles(corners, |[a, b, c], _| {
            let edges = [[a, b], [b, c], [c, a]].into_iter();
            edges.filter(|[a, b]| vertices.has(*a) && vertices.has(*b)).map(ends).for_each(&mut *visit);
        });
    }
}

/// The edges that `each` enumerates, ascending and without duplicates, and what the budget grants for them.
fn gathered(
    what: &'static str,
    run: &Run,
    each: impl Fn(&mut dyn FnMut([u32; 2])) -> Result<()>,
) -> Result<(Vec<[u32; 2]>, Grant)> {
    let mut count = 0;
    each(&mut |_| count += 1)?;
    let grant = run.budget.take(what, 8 * count, 8 * count)?;
    let mut edges = Vec::with_capacity(count as usize);
    each(&mut |edge| edges.push(edge))?;
    edges.sort_unstable();
    edges.dedup();
    Ok((edges, grant))
}

/// Calls `visit` with blocks of the items that `each` enumerates, about `count`; those of one `key`, which is spread
/// evenly, come together.
fn in_blocks<T>(
    count: u64,
    run: &Run,
    key: impl Fn(&T) -> u64,
    each: impl Fn(&mut dyn FnMut(T)) -> Result<()>,
    mut visit: impl FnMut(&mut Vec<T>),
) -> Result<()> {
    // A block that is larger than its share doubles its room, and is copied.
    let bytes = |items: u64| 3 * size_of::<T>() as u64 * items;
    let least = bytes(count.min(LEAST));
    // Half is left to what is found in the blocks.
    let grant = run.budget.take("edges of a part", least, bytes(count).min(least.max(run.budget.left() / 2)))?;
    let blocks = bytes(count).div_ceil(grant.bytes().max(1)).max(1);
    let mut items = Vec::with_capacity(count.div_ceil(blocks) as usize);
    for block in 0..blocks {
        items.clear();
        each(&mut |item| {
            if blocks == 1 || (u128::from(key(&item)) * u128::from(blocks)) >> 64 == u128::from(block) {
                items.push(item);
            }
        })?;
        visit(&mut items);
    }
    Ok(())
}

impl Caps {
    /// Closes the part whose faces `visit` enumerates; `at_cuts` are the edges at cuts of the mesh. With `by_place`,
    /// edges of different vertices at the same positions count as one when flaws are counted: an STL has only
    /// positions.
    ///
    /// # Errors
    /// [`crate::base::Error::Memory`]; those of `visit`.
    pub fn of(
        mesh: &Mesh,
        at_cuts: &EdgesAtCuts,
        (corners, by_place): (u64, bool),
        run: &Run,
        visit: impl Fn(&mut dyn FnMut(&[u32])) -> Result<()>,
    ) -> Result<Self> {
        let (mut open, mut flaws, mut nowhere) = (Vec::new(), 0, 0);
        visit(&mut |face| nowhere += u64::from(!face.iter().all(|&v| finite(mesh.positions.get(v)))))?;
        let each = |visit_edge: &mut dyn FnMut([u32; 2])| visit(&mut |face| edges_of(face).for_each(&mut *visit_edge));
        let key = |&edge: &[u32; 2]| xxh3_64(bytemuck::bytes_of(&ends(edge)));
        in_blocks(corners, run, key, each, |edges| {
            let (mine, more) = without_partner(edges);
            open.extend(mine);
            flaws += more;
        })?;
        let bytes = OPEN * open.len() as u64;
        let _grant_of_open = run.budget.take("open edges of a part", bytes, bytes)?;
        let (welded, open, more) = weld(mesh, &mut open);
        // Edges of welded vertices are unknown.
        let known = if welded || open.is_empty() { None } else { Some(edges_between(mesh, &open, run, &visit)?) };
        let (paths, left) = loops(open);
        let all: Vec<Loop> = paths.into_iter().map(|path| Loop::of(mesh, path)).collect();
        // Faces at welded edges are unknown.
        let groups = match welded {
            true => (0..all.len()).map(|k| vec![k]).collect(),
            false => nested(mesh, &all, run, &visit)?,
        };
        let mut caps = Caps { flaws: flaws + more + left + nowhere, loops: all.len(), ..Caps::default() };
        let (mut clipper, mut chords) = (Earcut::new(), BTreeSet::new());
        let is_known = |edge: [u32; 2]| {
            let part = known.as_ref().map(|(edges, _)| edges);
            part.is_none_or(|edges| [edges, &at_cuts.edges].iter().any(|edges| edges.binary_search(&edge).is_ok()))
        };
        let mut unless_known = |(triangles, inner): Filling| {
            let is_free = !inner.iter().any(|edge| is_known(*edge) || chords.contains(edge));
            is_free.then(|| {
                chords.extend(inner);
                triangles
            })
        };
        let against = |[a, b, c]: [Corner; 3], turned: bool| if turned { [a, c, b] } else { [a, b, c] };
        for group in groups {
            run.cancel.check()?;
            let group: Vec<&Loop> = group.into_iter().map(|k| &all[k]).collect();
            let mut whole = None;
            if group.len() > 1 {
                whole = filled(&group, &mut clipper, &run.cancel)?.and_then(&mut unless_known);
            }
            if let ([outer, inner], None) = (&group[..], &whole) {
                whole = band(outer, inner, &run.cancel)?.and_then(&mut unless_known);
            }
            if let Some(triangles) = whole {
                let turned = group[0].turned;
                caps.triangles.extend(triangles.into_iter().map(|t| against(t.map(Corner::Vertex), turned)));
                continue;
            }
            for one in group {
                let own = filled(&[one], &mut clipper, &run.cancel)?.and_then(&mut unless_known);
                let filled: Vec<[Corner; 3]> = match own {
                    Some(triangles) => triangles.into_iter().map(|t| t.map(Corner::Vertex)).collect(),
                    None => {
                        let centre = Corner::Centre(caps.centres.len() as u32);
                        caps.centres.push(middle(&one.at));
                        let next = one.ring.iter().cycle().skip(1);
                        one.ring
                            .iter()
                            .zip(next)
                            .map(|(&a, &b)| [Corner::Vertex(b), Corner::Vertex(a), centre])
                            .collect()
                    }
                };
                caps.triangles.extend(filled.into_iter().map(|t| against(t, one.turned)));
            }
        }
        if by_place {
            caps.flaws += doubled(mesh, &caps.triangles, corners, run, each)?;
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

/// The edges, of triangles and of triangulated polygons of the part that `visit` enumerates, between vertices of its
/// `open` edges.
fn edges_between(
    mesh: &Mesh,
    open: &[[u32; 2]],
    run: &Run,
    visit: impl Fn(&mut dyn FnMut(&[u32])) -> Result<()>,
) -> Result<(Vec<[u32; 2]>, Grant)> {
    let bytes = BitSet::bytes(mesh.positions.len());
    let _grant_of_vertices = run.budget.take("open vertices of a part", bytes, bytes)?;
    let mut vertices = BitSet::new(mesh.positions.len());
    open.iter().flatten().for_each(|&v| _ = vertices.add(v));
    let each = |visit_edge: &mut dyn FnMut([u32; 2])| {
        visit(&mut |face| {
            let within = edges_of(face).filter(|edge| edge.iter().all(|&v| vertices.has(v)));
            within.map(ends).for_each(&mut *visit_edge);
            if face.len() > 3 {
                edges_within(mesh, face, &vertices, visit_edge);
            }
        })
    };
    gathered("edges between open edges of a part", run, each)
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

/// How many of the directed edges of a part, which `each` enumerates, and of its `caps`, are duplicates after vertices
/// that are equal as floats are merged.
fn doubled(
    mesh: &Mesh,
    caps: &[[Corner; 3]],
    corners: u64,
    run: &Run,
    each: impl Fn(&mut dyn FnMut([u32; 2])) -> Result<()>,
) -> Result<u64> {
    let place = |v: u32| position_key(mesh.positions.get(v).map(|x| f64::from(x as f32)));
    // Hardly any two edges share this hash.
    let each_key = |visit: &mut dyn FnMut(u128)| {
        let mut add = |edge: [u32; 2]| {
            let places = edge.map(place);
            if places[0] != places[1] {
                visit(xxh3_128(bytemuck::bytes_of(&places)));
            }
        };
        each(&mut add)?;
        for [a, b, c] in caps {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                if let (Corner::Vertex(from), Corner::Vertex(to)) = (from, to) {
                    add([*from, *to]);
                }
            }
        }
        Ok(())
    };
    let mut count = 0;
    in_blocks(
        corners + 3 * caps.len() as u64,
        run,
        |key| (*key >> 64) as u64,
        each_key,
        |keys| {
            keys.sort_unstable();
            count += keys.windows(2).filter(|two| two[0] == two[1]).count() as u64;
        },
    )?;
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::vector::{cross, dot};

    fn caps(points: &[[f64; 3]], faces: &[Vec<u32>]) -> (Mesh, Caps) {
        caps_of(points, faces, false)
    }

    fn caps_of(points: &[[f64; 3]], faces: &[Vec<u32>], by_place: bool) -> (Mesh, Caps) {
        caps_in(points, faces, by_place, &Run::new(&()))
    }

    fn caps_in(points: &[[f64; 3]], faces: &[Vec<u32>], by_place: bool, run: &Run) -> (Mesh, Caps) {
        let triangles: Vec<[u32; 3]> = faces.iter().map(|f| [f[0], f[1], f[2]]).collect();
        let mesh = Mesh::from_slices(points, &triangles).unwrap();
        let visit = |visit_face: &mut dyn FnMut(&[u32])| {
            faces.iter().for_each(|face| visit_face(face));
            Ok(())
        };
        let whole = EdgesAtCuts::of(&mesh, &vec![0; faces.len()], run).unwrap();
        let corners = faces.iter().map(|f| f.len() as u64).sum();
        let caps = Caps::of(&mesh, &whole, (corners, by_place), run, visit).unwrap();
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

    /// Regression: 24 bytes per corner of the largest part had to fit into the budget, and a run on a large mesh was
    /// refused only when its parts were written.
    #[test]
    fn a_part_whose_edges_exceed_the_budget_gets_the_same_caps() {
        let circle = |n: u32| (0..n).map(move |k| f64::from(k) / f64::from(n) * std::f64::consts::TAU);
        let polygon: Vec<[f64; 2]> = circle(60).map(|x| [(1.5 + (5. * x).sin()) * x.cos(), x.sin()]).collect();
        // A stack of prisms, of which the first and the last rim are open.
        let (n, layers) = (polygon.len() as u32, 400);
        let points: Vec<[f64; 3]> =
            (0..=layers).flat_map(|z| polygon.iter().map(move |p| [p[0], p[1], f64::from(z)])).collect();
        let side = |k: u32| {
            let (a, b) = (k, k / n * n + (k + 1) % n);
            [vec![a, b, b + n], vec![a, b + n, a + n]]
        };
        let mut faces: Vec<Vec<u32>> = (0..layers * n).flat_map(side).collect();
        // An edge of three faces.
        faces.push(vec![200 * n, 200 * n + 1, 5]);
        let run = |bytes| Run { budget: crate::store::Budget::new(bytes), ..Run::new(&()) };
        for by_place in [false, true] {
            let [all, few] = [1 << 30, 512 << 10].map(|bytes| caps_in(&points, &faces, by_place, &run(bytes)).1);
            assert!((all.loops, all.flaws) == (few.loops, few.flaws) && all.loops > 1 && all.flaws > 0, "{few:?}");
            assert!(all.triangles == few.triangles && all.centres == few.centres);
        }
        assert!(24 * 6 * u64::from(layers * n) > 2 << 20, "more than the smaller budget");
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

    /// The surface of revolution through rings of `sides` points: (radius, z) each.
    fn tube(rings: &[[f64; 2]], sides: u32) -> (Vec<[f64; 3]>, Vec<Vec<u32>>) {
        let turn = |k: u32| libm::sincos(f64::from(k) / f64::from(sides) * std::f64::consts::TAU);
        let point = |[r, z]: [f64; 2], k: u32| [r * turn(k).1, r * turn(k).0, z];
        let points = rings.iter().flat_map(|&ring| (0..sides).map(move |k| point(ring, k))).collect();
        let faces = (0..(rings.len() as u32 - 1) * sides).flat_map(|k| {
            let (a, b) = (k, k / sides * sides + (k + 1) % sides);
            [vec![a, b, b + sides], vec![a, b + sides, a + sides]]
        });
        (points, faces.collect())
    }

    /// Regression: the outside and the cavity of a hollow part were closed one by one, with nothing between both caps.
    #[test]
    fn a_hollow_part_is_closed_by_rings_and_both_sides_get_the_same() {
        let wall = |z: [f64; 2]| {
            let (mut points, mut faces) = tube(&[[3., z[0]], [3., z[1]]], 24);
            // The cavity is cut a little higher, and has other vertices.
            let (inner, within) = tube(&[[2., z[0] + 0.1], [2., z[1] + 0.1]], 17);
            let first = points.len() as u32;
            points.extend(inner);
            faces.extend(within.into_iter().map(|f| vec![f[0] + first, f[2] + first, f[1] + first]));
            (points, faces)
        };
        let area = |sides: f64, r: f64| sides / 2. * r * r * libm::sin(std::f64::consts::TAU / sides);
        let material = area(24., 3.) - area(17., 2.);
        let (points, faces) = wall([0., 1.]);
        let (mesh, rings) = caps(&points, &faces);
        assert_eq!((rings.loops, rings.centres.len(), rings.flaws), (4, 0, 0));
        assert_eq!(rings.triangles.len(), 2 * (24 + 17));
        let (volume, wrong) = closed(&mesh, &faces, &rings);
        assert!(wrong == 0 && (volume / 6. - material).abs() < 1e-9, "{volume}");
        let mut corners = rings.triangles.iter().map(|t| t.map(|corner| rings.place(&mesh, corner)));
        assert!(corners.all(|t| {
            let middle = [0, 1].map(|c| (t[0][c] + t[1][c] + t[2][c]) / 3.);
            middle[0].hypot(middle[1]) > 1.9
        }));
        // The neighbour above has the same loops the other way round.
        let above: Vec<Vec<u32>> = wall([1., 2.]).1.iter().map(|f| f.iter().map(|v| v + 200).collect()).collect();
        let mut stacked = points.clone();
        stacked.resize(200, [0.; 3]);
        stacked.extend(wall([1., 2.]).0);
        let on_rim = |p: [f64; 3]| points.iter().position(|q| *q == p).map(|k| k as u32);
        let shared = |v: u32| on_rim(stacked[v as usize]).unwrap_or(v);
        let above: Vec<Vec<u32>> = above.iter().map(|f| f.iter().map(|&v| shared(v)).collect()).collect();
        let of = |faces: &[Vec<u32>]| {
            let mut all: Vec<[[u64; 3]; 3]> = Vec::new();
            let (mesh, caps) = caps(&stacked, faces);
            assert_eq!(closed(&mesh, faces, &caps).1, 0);
            for t in &caps.triangles {
                let mut t = t.map(|corner| caps.place(&mesh, corner).map(f64::to_bits));
                t.sort_unstable();
                all.push(t);
            }
            all
        };
        let [below, above] = [of(&faces), of(&above)];
        assert_eq!(below.iter().filter(|t| above.contains(t)).count(), 24 + 17);
    }

    /// A doll within a doll, both hollow: four rims around each other, two of each make a ring.
    #[test]
    fn rims_around_each_other_are_paired() {
        let (mut points, mut faces) = (Vec::new(), Vec::new());
        // The innermost comes first.
        for (radius, inwards) in [(1.5, true), (1.8, false), (2.7, true), (3., false)] {
            let (more, around) = tube(&[[radius, 0.], [radius, 1.]], 20);
            let first = points.len() as u32;
            points.extend(more);
            let turned = |f: &Vec<u32>| if inwards { [f[0], f[2], f[1]] } else { [f[0], f[1], f[2]] };
            faces.extend(around.iter().map(|f| turned(f).map(|v| v + first).to_vec()));
        }
        let (mesh, rings) = caps(&points, &faces);
        assert_eq!((rings.loops, rings.centres.len(), rings.triangles.len(), rings.flaws), (8, 0, 4 * 40, 0));
        let area = |r: f64| 10. * r * r * libm::sin(std::f64::consts::TAU / 20.);
        let (volume, wrong) = closed(&mesh, &faces, &rings);
        let expected = area(3.) - area(2.7) + area(1.8) - area(1.5);
        assert!(wrong == 0 && (volume / 6. - expected).abs() < 1e-9, "{volume}");
    }

    /// Rims that are far from flat are joined by a band.
    #[test]
    fn a_hollow_part_with_wavy_rims_is_closed_by_bands() {
        let wave = |points: &mut Vec<[f64; 3]>| {
            points.iter_mut().for_each(|p| {
                let at = libm::atan2(p[1], p[0]);
                // Overhanging waves: in the plane of the rim it crosses itself.
                p[2] += 0.8 * libm::sin(2. * at);
                let r = 1. + 0.3 * libm::sin(9. * at) * (p[2] - 0.5);
                (p[0], p[1]) = (p[0] * r, p[1] * r);
            });
        };
        let (mut points, mut faces) = tube(&[[3., 0.], [3., 1.]], 60);
        let (inner, within) = tube(&[[2.5, 0.], [2.5, 1.]], 50);
        let first = points.len() as u32;
        points.extend(inner);
        faces.extend(within.into_iter().map(|f| vec![f[0] + first, f[2] + first, f[1] + first]));
        wave(&mut points);
        let (mesh, bands) = caps(&points, &faces);
        assert_eq!((bands.loops, bands.centres.len(), bands.triangles.len(), bands.flaws), (4, 0, 2 * 110, 0));
        assert_eq!(closed(&mesh, &faces, &bands).1, 0);
    }

    #[test]
    fn loops_around_each_other_have_caps_of_their_own_unless_a_wall_lies_between() {
        // A band that narrows, and a flat ring, as around a nose: both ends leave in other directions.
        for rings in [[[3., 0.], [2., 1.]], [[3., 0.], [2., 0.]]] {
            let (points, faces) = tube(&rings, 12);
            let (mesh, own) = caps(&points, &faces);
            assert_eq!((own.loops, own.triangles.len(), own.flaws), (2, 2 * 10, 0));
            assert_eq!(closed(&mesh, &faces, &own).1, 0);
        }
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
