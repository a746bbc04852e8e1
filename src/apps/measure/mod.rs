//! Measurements of a mesh and its parts: area, volume, box, centroid, principal axes, open edges, and lengths of the
//! borders between parts.
//!
//! Adjacent faces come from the [dual graph](crate::graph), so edges at the same position count as one whatever their
//! vertices. At an edge of more than two faces a surface is closed if as many run one way as the other. One pass over
//! the faces sums up each part; a part's volume is given only if its surface is closed and consistently wound. Stray
//! vertices count at their repaired positions ([`Mesh::without_strays`]). Cost: the graph (60 bytes per face in a work
//! directory or in memory), some 200 ns per face, [`PER_LABEL`] bytes per distinct label, 100 per open edge while loops
//! are counted, 16 per corner of faces with more than 64 corners and of their neighbours, and some 200 per edge of
//! three or more faces, in a chunk.

mod adjacency;
mod sums;
mod table;

pub use sums::{Measures, Neighbour};
pub use table::table;

use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::printable::counted;
use crate::base::sort::map_of;
use crate::base::union_find::Forest;
use crate::base::vector::{MapEach, finite, position_key};
use crate::base::{Error, Result};
use crate::graph::{DualGraph, GraphFacts};
use crate::mesh::Mesh;
use crate::mesh::geometry::one_per_face;
use crate::store::Context;
use adjacency::{Faces, LongFaces, SharedEdge, SharedEdges, ends};
use serde::Serialize;
use serde_json::json;
use std::collections::{BTreeMap, HashMap};
use sums::{Sums, Unit};

/// Faces per chunk.
const CHUNK: usize = 1 << 14;
/// Bytes per open edge while loops are counted.
const OPEN: u64 = 100;
/// Bytes per label: sums, measures, and a row of a table.
const PER_LABEL: u64 = 1024;

/// Measurements of a whole mesh.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeshMeasures {
    /// Faces with three corners.
    pub triangles: u64,
    /// Faces with four corners.
    pub quads: u64,
    /// Faces with more corners.
    pub polygons: u64,
    /// Faces with fewer than three corners, which are not polygons.
    pub incomplete_faces: u64,
    /// Connected components.
    pub components: u64,
    /// Loops of open edges: holes, and rims of open surfaces. `None` if memory is too small to count them.
    pub boundary_loops: Option<u64>,
    /// Edges with three faces or more.
    pub nonmanifold_edges: u64,
    /// Faces without area or with a non-finite coordinate.
    pub degenerate_faces: u64,
    /// Those among them with a non-finite coordinate.
    pub nonfinite_faces: u64,
    /// Faces that lie exactly where an earlier face lies; nothing else counts them.
    pub duplicate_faces: u64,
    /// Open edges that lie at exactly the same position as another: texture seams, unwelded vertices.
    pub welded_edges: u64,
    /// Vertices far outside the rest.
    pub stray_vertices: u64,
    /// Edges whose faces cannot be wound consistently.
    pub unoriented_edges: u64,
    /// The other measurements, as for a part.
    #[serde(flatten)]
    pub all: Measures,
}

/// The result of a chunk of faces: sums by label, and the open edges.
type Share = (BTreeMap<u32, Sums>, Vec<[[u64; 3]; 2]>);

impl Faces<'_> {
    fn share(&self, range: std::ops::Range<usize>, wants_open: bool) -> Share {
        let (mut sums, mut open, mut long) = (BTreeMap::<u32, Sums>::new(), Vec::new(), LongFaces::default());
        let mut shared = SharedEdges::new();
        self.mesh.faces.for_each(range, |face, corners| {
            let face = face as u32;
            let label = self.label(face);
            let mine = sums.entry(label).or_default();
            mine.faces += 1;
            if self.is_duplicate(face) {
                return;
            }
            if self.is_in_space(corners) {
                self.mesh.triangles(corners, |_, at| mine.triangle(at.map_each(|p| self.unit.place(p))));
            }
            let edge = |k: usize| {
                let ends = [corners[k], corners[if k + 1 == corners.len() { 0 } else { k + 1 }]];
                ends.map_each(|v| self.mesh.positions.get(v))
            };
            for k in 0..corners.len() {
                let [from, to] = edge(k);
                let [a, b] = [position_key(from), position_key(to)];
                if a == b || !finite(from) || !finite(to) {
                    continue;
                }
                match self.across(face, [a, b], &mut long) {
                    None => {
                        // Where the face passes the edge again, it is a slit, as to a hole in a polygon.
                        let (mut passes, mut surplus) = (0, 0i64);
                        self.for_each_pass(face, [a, b], &mut long, &mut |_, along| {
                            passes += 1;
                            surplus += if along { 1 } else { -1 };
                        });
                        if passes > 1 {
                            mine.clashes += u64::from(surplus != 0);
                            continue;
                        }
                        mine.open += 1;
                        if wants_open {
                            open.push([a, b]);
                        }
                    }
                    Some((other, along, several)) => {
                        // Next to a face without a position there is a hole, which has no open edges.
                        let is_hole = || {
                            !self.whole && !self.mesh.faces.with(other as usize, |corners| self.is_in_space(corners))
                        };
                        mine.clashes += u64::from(is_hole());
                        let other = self.label(other);
                        let unlike = other != label;
                        let shared = if unlike || along || several {
                            self.shared_edge(face, [a, b], &mut long, &mut shared)
                        } else {
                            None
                        };
                        mine.clashes += u64::from(shared.map_or(along, |edge| !edge.balanced));
                        if !unlike {
                            continue;
                        }
                        let mut add = |other: u32| {
                            *mine.borders.entry(other).or_default() += self.unit.distance(from, to);
                        };
                        let Some(SharedEdge { labels, .. }) = shared else {
                            add(other);
                            continue;
                        };
                        // A face may pass the edge several times.
                        let passed = || (0..k).any(|k| ends(edge(k).map(position_key)) == ends([a, b]));
                        if labels.get(&label) == Some(&face) && !passed() {
                            labels.keys().filter(|&&other| other != label).for_each(|&other| add(other));
                        }
                    }
                }
            }
        });
        (sums, open)
    }
}

/// The number of loops of open edges: connected sets of edges.
fn loops(open: &[[[u64; 3]; 2]]) -> u64 {
    let mut numbers = HashMap::new();
    let ends: Vec<[u32; 2]> = open
        .iter()
        .map(|ends| {
            ends.map(|end| {
                let next = numbers.len() as u32;
                *numbers.entry(end).or_insert(next)
            })
        })
        .collect();
    let mut sets = Forest::new(numbers.len());
    let joins = ends.iter().filter(|[a, b]| sets.join(*a, *b)).count();
    (numbers.len() - joins) as u64
}

/// The graph of `mesh` in its own work directory.
fn graph(mesh: &Mesh, context: Context<'_>) -> Result<DualGraph> {
    DualGraph::build(mesh, mesh.path(), &json!("measures"), context)
}

/// Sums by label over all faces, and the number of loops if `wants_loops` and memory allows it.
fn sums(
    mesh: &Mesh,
    labels: Option<&[u32]>,
    graph: &DualGraph,
    wants_loops: bool,
    context: Context<'_>,
) -> Result<(BTreeMap<u32, Sums>, Option<u64>)> {
    let bytes = OPEN * graph.facts.boundary_edges;
    let grant = if wants_loops { context.run.budget.take("open edges", bytes, bytes).ok() } else { None };
    let unit = Unit::of(&graph.facts.frame);
    let whole = graph.facts.degenerate_faces == 0;
    let (neighbours, duplicates) = (graph.edges.by_shared_edge(), graph.duplicates.as_deref());
    let faces = Faces { mesh, labels, neighbours, duplicates, unit, whole };
    let (mut all, mut open) = (BTreeMap::<u32, Sums>::new(), Vec::new());
    let mut granted = Vec::new();
    let n = mesh.faces.len();
    context.run.in_order(
        chunk_count(n, CHUNK),
        || (),
        |k, ()| Ok(faces.share(chunk_range(n, CHUNK, k), grant.is_some())),
        |_, (sums, edges): Share| {
            let known = all.len();
            sums.iter().for_each(|(&label, sums)| all.entry(label).or_default().add(sums));
            open.extend(edges);
            let bytes = PER_LABEL * (all.len() - known) as u64;
            if bytes > 0 {
                granted.push(context.run.budget.take("what parts measure", bytes, bytes)?);
            }
            Ok(())
        },
    )?;
    Ok((all, grant.map(|_| loops(&open))))
}

/// Measures `mesh`. The graph goes to the work directory of `context`, which must not contain another one.
///
/// ```
/// use nystrom_stream::apps::measure::mesh;
/// use nystrom_stream::mesh::Mesh;
/// use nystrom_stream::store::{Context, Run, WorkDir};
/// # fn main() -> nystrom_stream::base::Result<()> {
/// let points = [[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
/// let tetrahedron = Mesh::from_slices(&points, &[[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])?;
/// let (work, run) = (WorkDir::temporary(&std::env::temp_dir())?, Run::new(&()));
/// let measures = mesh(&tetrahedron, Context::new(&work, &run))?;
/// assert_eq!((measures.components, measures.boundary_loops, measures.all.open_edges), (1, Some(0), 0));
/// assert!((measures.all.volume.unwrap() - 1. / 6.).abs() < 1e-12);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// As [`DualGraph::build`].
pub fn mesh(mesh: &Mesh, context: Context<'_>) -> Result<MeshMeasures> {
    let mesh = &mesh.without_strays(context.run)?;
    let graph = graph(mesh, context)?;
    let (sums, boundary_loops) = sums(mesh, None, &graph, true, context)?;
    let all = sums.into_values().next().unwrap_or_default().measures(Unit::of(&graph.facts.frame));
    let counts = context.run.map_ranges(mesh.faces.len(), CHUNK, |range| {
        let mut counts = [0u64; 3];
        mesh.faces.for_each(range, |_, corners| match corners.len() {
            0..=2 => counts[0] += 1,
            3 => counts[1] += 1,
            4 => counts[2] += 1,
            _ => {}
        });
        Ok(counts)
    })?;
    let [incomplete_faces, triangles, quads] = [0, 1, 2].map(|kind| counts.iter().map(|counts| counts[kind]).sum());
    let GraphFacts {
        components,
        nonmanifold_edges,
        degenerate_faces,
        nonfinite_faces,
        duplicate_faces,
        welded_edges,
        unoriented_edges,
        ..
    } = graph.facts;
    Ok(MeshMeasures {
        triangles,
        quads,
        polygons: mesh.faces.len() as u64 - triangles - quads - incomplete_faces,
        incomplete_faces,
        components,
        boundary_loops,
        nonmanifold_edges,
        degenerate_faces,
        nonfinite_faces,
        duplicate_faces,
        welded_edges,
        stray_vertices: mesh.strays() as u64,
        unoriented_edges,
        all,
    })
}

/// Measures the parts 0, 1, … `parts` − 1 of `mesh`, which has a label per face; a part without faces has zero
/// measurements. The graph goes to the work directory of `context`, which must not contain another one.
///
/// # Errors
/// As [`labelled`], and [`Error::Parameter`] for labels that are not below `parts`.
pub fn parts(mesh: &Mesh, labels: &[u32], parts: usize, context: Context<'_>) -> Result<Vec<Measures>> {
    if let Some(label) = labels.iter().find(|label| **label as usize >= parts) {
        let problem = format!("label {label} is out of range for {}", counted(parts, "part"));
        return Err(Error::parameter("labels", problem, "give one below the number of parts for every face"));
    }
    let mut found = labelled(mesh, labels, context)?;
    let nothing = || Sums::default().measures(Unit { origin: [0.; 3], unit: 1. });
    Ok((0..parts as u32).map(|part| found.remove(&part).unwrap_or_else(nothing)).collect())
}

/// Measures the faces of each distinct label on `mesh`, which has a label per face. The graph goes to the work
/// directory of `context`, which must not contain another one.
///
/// # Errors
/// [`Error::Parameter`] for labels that do not match the faces; [`Error::Memory`] for more labels than the budget has
/// room for; else as [`DualGraph::build`].
pub fn labelled(mesh: &Mesh, labels: &[u32], context: Context<'_>) -> Result<BTreeMap<u32, Measures>> {
    one_per_face("labels", labels.len(), mesh.faces.len())?;
    let mesh = &mesh.without_strays(context.run)?;
    let graph = graph(mesh, context)?;
    let (sums, _) = sums(mesh, Some(labels), &graph, false, context)?;
    let unit = Unit::of(&graph.facts.frame);
    Ok(map_of(sums.into_iter().map(|(label, sums)| (label, sums.measures(unit)))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::vector::distance;
    use crate::store::{Run, WorkDir};

    /// A box of the given size at `low`, wound outwards.
    fn cuboid(low: [f64; 3], size: [f64; 3]) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
        let corner = |k: usize| [0, 1, 2].map(|axis| low[axis] + if k >> axis & 1 == 1 { size[axis] } else { 0. });
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        ((0..8).map(corner).collect(), faces)
    }

    fn with<R>(work: impl FnOnce(Context<'_>) -> R) -> R {
        let dir = WorkDir::temporary(&std::env::temp_dir()).unwrap();
        work(Context::new(&dir, &Run::new(&())))
    }

    #[test]
    fn a_box_measures_what_it_should() {
        let (points, faces) = cuboid([10., 20., 30.], [1., 2., 4.]);
        let all = with(|context| mesh(&Mesh::from_slices(&points, &faces).unwrap(), context)).unwrap();
        assert_eq!((all.triangles, all.quads, all.components, all.boundary_loops), (12, 0, 1, Some(0)));
        assert!((all.all.area - 28.).abs() < 1e-9 && (all.all.volume.unwrap() - 8.).abs() < 1e-9, "{all:?}");
        assert_eq!(all.all.bounds, Some([[10., 20., 30.], [11., 22., 34.]]));
        assert!(distance(all.all.centroid, [10.5, 21., 32.]) < 1e-9);
        let [a, b, c] = all.all.axes;
        assert!(a[2] > 1. - 1e-9 && b[1] > 1. - 1e-9 && c[0] > 1. - 1e-9, "{all:?}");
        // For the surface: a² = Σ over the six faces of the second moment along z over the area.
        let along_z = (2. * 2. * 4. + (2. * 4. * 2. + 2. * 4. * 1.) * 16. / 12.) / 28.;
        assert!((all.all.spread[0] - f64::sqrt(along_z)).abs() < 1e-9, "{all:?}");
    }

    #[test]
    fn concave_polygons_are_measured_as_they_are() {
        // Regression: the fan of the upper L had an area of 9 instead of 5, and a wrong centroid.
        let ell = [[3., 0.], [3., 1.], [1., 1.], [1., 3.], [0., 3.], [0., 0.]];
        let points: Vec<[f64; 3]> = [0., 1.].iter().flat_map(|&z| ell.map(|[x, y]| [x, y, z])).collect();
        let mut faces: Vec<Vec<u32>> = vec![(0..6).rev().collect(), (6..12).collect()];
        faces.extend((0..6).map(|k| vec![k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6]));
        let all = with(|context| mesh(&Mesh::from_slices(&points, &faces).unwrap(), context)).unwrap();
        assert!((all.all.area - 22.).abs() < 1e-12 && (all.all.volume.unwrap() - 5.).abs() < 1e-12, "{all:?}");
        assert!((all.all.centroid[2] - 0.5).abs() < 1e-12, "{all:?}");
    }

    #[test]
    fn faces_without_a_place_have_no_area_and_leave_a_hole() {
        // Regression: a cube with three sides missing had a volume, two thirds of its own, and parts of these sides had
        // an area.
        let (mut points, _) = cuboid([0.; 3], [1.; 3]);
        points[7][0] = f64::NAN;
        let quads = [[0u32, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let all = with(|context| mesh(&Mesh::from_slices(&points, &quads).unwrap(), context)).unwrap();
        assert_eq!((all.degenerate_faces, all.all.open_edges, all.all.volume), (3, 0, None), "{all:?}");
        assert!((all.all.area - 3.).abs() < 1e-12, "{all:?}");
        // Regression: a mesh without any place enclosed a volume of 0.
        points.fill([f64::NAN; 3]);
        let all = with(|context| mesh(&Mesh::from_slices(&points, &quads).unwrap(), context)).unwrap();
        assert_eq!((all.nonfinite_faces, all.all.volume, all.all.bounds), (6, None, None), "{all:?}");
    }

    #[test]
    fn holes_are_counted_and_have_no_volume() {
        let (points, mut faces) = cuboid([0.; 3], [1.; 3]);
        // Two lids removed, and every face with its own vertices: edges at the same position still count as one.
        faces.drain(0..4);
        let soup: Vec<[f64; 3]> = faces.iter().flatten().map(|&v| points[v as usize]).collect();
        let own: Vec<[u32; 3]> = (0..faces.len() as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        for open in [Mesh::from_slices(&points, &faces).unwrap(), Mesh::from_slices(&soup, &own).unwrap()] {
            let all = with(|context| mesh(&open, context)).unwrap();
            assert_eq!((all.boundary_loops, all.all.open_edges, all.all.volume), (Some(2), 8, None), "{all:?}");
            assert_eq!(all.components, 1);
        }
    }

    /// Regression: the bridge between two bodies counted as a border where they touch, so neither had a volume.
    #[test]
    fn bodies_that_touch_are_closed() {
        let (mut points, mut faces) = cuboid([0.; 3], [1.; 3]);
        let (more, others) = cuboid([1., 0., 0.], [1.; 3]);
        points.extend(more);
        faces.extend(others.iter().map(|face| face.map(|v| v + 8)));
        let both = Mesh::from_slices(&points, &faces).unwrap();
        let labels: Vec<u32> = (0..24).map(|k| u32::from(k >= 12)).collect();
        for part in with(|context| parts(&both, &labels, 2, context)).unwrap() {
            assert!((part.volume.unwrap() - 1.).abs() < 1e-9 && part.neighbours.is_empty(), "{part:?}");
        }
    }

    /// Regression: whether there was a volume depended on the order of the faces.
    #[test]
    fn edges_of_many_faces_are_closed_if_as_many_run_each_way() {
        let (one, two) = (cuboid([0.; 3], [1.; 3]), cuboid([1., 1., 0.], [1.; 3]));
        let points: Vec<[f64; 3]> = one.0.into_iter().chain(two.0).collect();
        let place = |v: u32| points.iter().position(|p| *p == points[v as usize]).unwrap() as u32;
        let others = two.1.iter().map(|face| face.map(|v| place(v + 8)));
        let touching: Vec<[u32; 3]> = one.1.iter().copied().chain(others).collect();
        let points = [&points[..], &[[0.5, 0.5, 2.]]].concat();
        // The first box with its top twice: the edges of the top have three faces, and one top is a duplicate.
        let mut lidded = one.1.clone();
        lidded.extend([[4, 5, 7], [4, 7, 6]]);
        // With another top above it, they have three faces in different places.
        let mut roofed = one.1;
        roofed.extend([[4, 5, 16], [5, 7, 16], [7, 6, 16], [6, 4, 16]]);
        for turn in 0..touching.len() {
            let volume = |faces: &[[u32; 3]]| {
                let mut faces = faces.to_vec();
                faces.sort_by_key(|face| {
                    (face.map(u64::from).iter().sum::<u64>() * 7919 + face[0] as u64 * turn as u64) % 31
                });
                with(|context| mesh(&Mesh::from_slices(&points, &faces).unwrap(), context)).unwrap().all.volume
            };
            assert!((volume(&touching).unwrap() - 2.).abs() < 1e-9, "{turn}");
            assert!((volume(&lidded).unwrap() - 1.).abs() < 1e-9, "{turn}");
            assert_eq!(volume(&roofed), None, "{turn}");
        }
    }

    /// Regression: at an edge of three parts each listed one of the others, which did not always list it; at one of
    /// several faces per part, borders had different lengths on both sides.
    #[test]
    fn neighbours_list_each_other_at_edges_of_many_faces() {
        for (corners, labels) in
            [(3, &[0, 1, 2][..]), (3, &[2, 0, 0, 1, 1]), (80, &[0, 1, 1, 2]), (3, &[0, 0, 1, 0, 2])]
        {
            // Wings around the same edge; the first passes it twice.
            let (mut points, mut faces) = (vec![[0.; 3], [0., 0., 1.]], Vec::new());
            for wing in 0..labels.len() {
                let (sin, cos) = (wing as f64).sin_cos();
                let rim = (0..corners - 2).map(|k| 1. - k as f64 / corners as f64);
                let first = points.len() as u32;
                points.extend(rim.map(|z| [cos, sin, z]));
                faces.push([0, 1].into_iter().chain(first..points.len() as u32).collect::<Vec<u32>>());
            }
            faces[0].extend([0, 1, 2]);
            let soup: Vec<[f64; 3]> = faces.iter().flatten().map(|&v| points[v as usize]).collect();
            let mut next = 0..;
            let own: Vec<Vec<u32>> = faces.iter().map(|face| next.by_ref().take(face.len()).collect()).collect();
            for (points, faces) in [(&points, &faces), (&soup, &own)] {
                let wings = Mesh::from_slices(points, faces).unwrap();
                let all = with(|context| parts(&wings, labels, 3, context)).unwrap();
                for (part, measures) in (0..).zip(&all) {
                    let others = (0..3).filter(|other| *other != part);
                    let expected: Vec<Neighbour> = others.map(|label| Neighbour { label, length: 1. }).collect();
                    assert_eq!(measures.neighbours, expected, "{labels:?} {part} {corners}");
                }
            }
        }
    }

    #[test]
    fn parts_have_borders_and_closed_ones_a_volume() {
        let (mut points, mut faces) = cuboid([0.; 3], [1., 1., 2.]);
        let (more, others) = cuboid([5., 0., 0.], [1.; 3]);
        points.extend(more);
        faces.extend(others.iter().map(|face| face.map(|v| v + 8)));
        let both = Mesh::from_slices(&points, &faces).unwrap();
        // The bottom and the rest of the first box; the second box.
        let labels: Vec<u32> = (0..24).map(|k| if k < 2 { 0 } else { 1 + u32::from(k >= 12) }).collect();
        let all = with(|context| parts(&both, &labels, 4, context)).unwrap();
        assert_eq!(all.iter().map(|part| part.faces).collect::<Vec<_>>(), [2, 10, 12, 0]);
        assert_eq!((all[0].volume, all[1].volume, all[3].bounds), (None, None, None));
        assert!((all[2].volume.unwrap() - 1.).abs() < 1e-9 && (all[1].area - 9.).abs() < 1e-9);
        assert_eq!(all[0].neighbours, [Neighbour { label: 1, length: 4. }]);
        assert_eq!(all[1].neighbours, [Neighbour { label: 0, length: 4. }]);
        assert!(all[2].neighbours.is_empty());
        let text = with(|context| labelled(&both, &labels, context)).unwrap();
        let text = table(&text, &[[255, 0, 16]], &["left, \"upper\"".into()], &[0.75]);
        let row = text.lines().nth(1).unwrap();
        assert!(row.ends_with(",0.750,#ff0010,1,\"left, \"\"upper\"\"\""), "{row}");
        assert!(
            text.lines().skip(2).all(|row| row.split(',').count() == text.lines().next().unwrap().split(',').count())
        );
        // One face wound the other way: no volume.
        faces[0].swap(0, 1);
        let turned = Mesh::from_slices(&points, &faces).unwrap();
        assert_eq!(with(|context| mesh(&turned, context)).unwrap().all.volume, None);
        assert!(with(|context| parts(&both, &labels, 2, context)).is_err());
    }

    #[test]
    fn labels_that_do_not_occur_have_no_row_and_take_no_memory() {
        // Regression: there was a row, and 200 bytes, for every number up to the greatest label.
        let (points, faces) = cuboid([0.; 3], [1.; 3]);
        let mesh = Mesh::from_slices(&points, &faces).unwrap();
        let labels: Vec<u32> = (0..12).map(|face| if face < 2 { 7 } else { 4_000_000_000 }).collect();
        let all = with(|context| labelled(&mesh, &labels, context)).unwrap();
        let text = table(&all, &[], &[], &[]);
        let rows: Vec<&str> = text.lines().skip(1).map(|row| row.split(',').next().unwrap()).collect();
        assert_eq!(rows, ["7", "4000000000"]);
        // Distinct labels are charged to the budget: one per face is too many here.
        let many: Vec<u32> = (0..20_000).collect();
        let strip: Vec<[f64; 3]> = (0..20_002).map(|k| [f64::from(k / 2), f64::from(k % 2), 0.]).collect();
        let strip = Mesh::from_vecs(strip, many.iter().map(|&k| [k, k + 1, k + 2]).collect()).unwrap();
        let folder = WorkDir::temporary(&std::env::temp_dir()).unwrap();
        let run = Run { budget: crate::store::Budget::new(16 << 20), threads: 1, ..Run::new(&()) };
        let found = labelled(&strip, &many, Context::new(&folder, &run));
        assert!(matches!(found, Err(Error::Memory { .. })), "{found:?}");
    }

    #[test]
    fn strays_are_measured_where_they_are_put() {
        // Regression: the box and area in a table and in `info` included the stray.
        let w = 20u32;
        let mut points: Vec<[f64; 3]> = (0..w * w).map(|i| [f64::from(i % w), f64::from(i / w), 0.]).collect();
        let quads: Vec<[u32; 4]> =
            (0..w * (w - 1)).filter(|i| i % w < w - 1).map(|i| [i, i + 1, i + w + 1, i + w]).collect();
        points[210] = [3e3, 0., 7.];
        let sheet = Mesh::from_slices(&points, &quads).unwrap();
        let (all, part) = (
            with(|context| mesh(&sheet, context)).unwrap(),
            with(|context| parts(&sheet, &[0; 361], 1, context)).unwrap(),
        );
        assert_eq!((all.stray_vertices, all.all.bounds), (1, Some([[0.; 3], [19., 19., 0.]])));
        assert!((part[0].area - 361.).abs() < 1e-9 && part[0].bounds == all.all.bounds);
    }
}
