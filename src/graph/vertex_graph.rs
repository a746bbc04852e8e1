//! The vertex graph: one node per vertex, one edge per mesh edge with its length as the weight, and the
//! triangles around each vertex.
//!
//! Correspondence uses it, as segmentation uses the dual graph. Built out of core in one shuffle: every triangle (also
//! of [polygons](crate::mesh::polygon)) gives each of its vertices the other two, and a sorted bucket of these gives
//! rows, rings, areas and open edges of its vertices. Components are bridged like those of the dual graph
//! ([`super::components`]). Triangles with a non-finite coordinate or a repeated vertex are skipped.
//!
//! Vertices of open edges at exactly the same position, as along texture seams and in triangle soups, are joined by
//! edges of length zero, so that paths can cross. As for faces ([`super::half_edges`]), only open edges and only equal
//! positions count: sheets that touch stay separate. One shuffle by a hash of the position, 32 bytes per open vertex;
//! free if a mesh is closed. The edges found are a file of 12 bytes each, and coincident vertices are chained in the
//! order of their numbers.
//!
//! Cost: 36 bytes per triangle through the shuffle; on disk 28 + 8 bytes per vertex, 8 per end of an edge, 24 per
//! triangle. About 0.1 µs per triangle and thread.

use super::bridges::{self, Bridge, find_bridges};
use super::components::{self, find_components};
use super::csr::{Csr, INDICES};
use super::dual_edges::{CENTROID_DISTANCES, DualEdges, EdgesWriter};
use super::frame::Frame;
use super::node_geometry::NodeGeometry;
use super::nodes::Node;
use super::row_starts::{PLAIN, StartsForm};
use super::weights::LEAST;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::vector::{cross, distance, finite, length, minus, narrow, position_key, wide};
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh::geometry::MOST_FACES;
use crate::store::needs::{BudgetEstimate, Extent, Needs, ShuffleNeeds};
use crate::store::npy::ArrayWriter;
use crate::store::shuffle::{BudgetedShuffle, Producer, RangeBuckets, Shuffle};
use crate::store::stage::{BuiltStage, Stage};
use crate::store::{Context, MappedSlice, Run, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::Path;
use xxhash_rust::xxh3::xxh3_64;

const CHUNK: usize = 1 << 14;

/// The files of the stage.
const FILES: [&str; 6] = ["vertex_geometry.npy", "ring_starts.npy", "ring.npy", PLAIN, INDICES, CENTROID_DISTANCES];

/// A triangle seen from one of its vertices: vertex, next, previous.
type Corner = [u32; 3];

/// A vertex graph in a work directory.
#[derive(Clone, Debug)]
pub struct VertexGraph {
    /// Its edges; lengths in the frame.
    pub edges: DualEdges,
    /// Position (as `centroid`, in the frame) and a third of the surrounding area (n); `normal` stays 0. A vertex
    /// without a position is put at 0.
    pub nodes: MappedSlice<Node>,
    /// Where each vertex's triangles start (n + 1).
    pub ring_starts: MappedSlice<u64>,
    /// The other two corners of each triangle around a vertex, in winding order (2 per triangle and corner).
    pub ring: MappedSlice<u32>,
    /// The frame.
    pub frame: Frame,
    /// Counts and sums.
    pub facts: VertexFacts,
}

/// Counts of a vertex graph.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VertexFacts {
    /// Vertices n.
    pub vertices: u64,
    /// Sum of triangle areas in the frame.
    pub area: f64,
    /// Vertices of open edges.
    pub boundary_vertices: u64,
    /// Edges added between vertices of open edges at the same position.
    pub seams: u64,
    /// Components before bridging, vertices without triangles included.
    pub components: u64,
}

/// Maximum number of vertices: as for faces ([`crate::mesh::geometry::MOST_FACES`]), components keep a parity in the
/// bit above the number.
const MOST_VERTICES: u64 = MOST_FACES;

/// Rejects a mesh in the file `path` with more vertices than nodes can have numbers.
fn check_size(vertices: usize, path: &Path) -> Result<()> {
    if vertices as u64 <= MOST_VERTICES {
        return Ok(());
    }
    let problem = format!("has {vertices} vertices, but at most {MOST_VERTICES} are supported");
    Err(Error::unusable(path, problem, "cut it into several meshes, or decimate it"))
}

/// Calls `visit(corners, positions)` for the triangles of one face that have three different vertices with positions.
pub fn triangles(mesh: &Mesh, corners: &[u32], mut visit: impl FnMut([u32; 3], [[f64; 3]; 3])) {
    mesh.triangles(corners, |[a, b, c], at| {
        if a != b && b != c && c != a {
            visit([a, b, c], at);
        }
    });
}

/// The rows of some consecutive vertices.
#[derive(Default)]
struct VertexRange {
    nodes: Vec<Node>,
    degrees: Vec<u32>,
    indices: Vec<u32>,
    lengths: Vec<f32>,
    ring_ends: Vec<u64>,
    ring: Vec<u32>,
    open: Vec<u32>,
}

impl VertexGraph {
    /// Builds the graph of `mesh` (from the file `path`) in `work`.
    ///
    /// # Errors
    /// [`Error::Unusable`] for a mesh without a single triangle or of 2³¹ vertices or more, [`Error::Io`],
    /// [`Error::Memory`], [`Error::Cancelled`].
    pub fn build(mesh: &Mesh, path: &Path, context: Context<'_>) -> Result<Self> {
        let n = mesh.positions.len();
        check_size(n, path)?;
        let frame = Frame::of(mesh, context.run)?;
        let records = 3 * mesh.faces.triangle_count();
        let sized = BudgetedShuffle::<Corner>::new(
            context.work.spill("corners.tmp"),
            "the vertex graph",
            // The result for a bucket has a node for each of its vertices, which may outnumber its corners.
            records.max(n as u64),
            6 * context.run.threads as u64,
            2,
            context.run,
        )?;
        let shuffle = &sized.shuffle;
        let by_vertex = RangeBuckets::new(n, shuffle.buckets());
        scatter(mesh, shuffle, by_vertex, context.run)?;
        if shuffle.is_empty() {
            let problem = "has no triangle with three distinct vertices and finite coordinates";
            return Err(Error::unusable(path, problem, "give another mesh"));
        }
        let mut writer = VertexGraphWriter::create(n, 2 * records as usize, context)?;
        context.run.in_order(
            shuffle.buckets(),
            || (),
            |bucket, ()| Ok(part(mesh, &frame, by_vertex.range(bucket), shuffle.take(bucket)?)),
            |_, part| writer.push(part, mesh),
        )?;
        drop(sized);
        writer.finish(frame, context)
    }

    /// The same in a work directory that is kept: opened if it was built there from the same `input`, else built. Also
    /// returns the key of the stage.
    ///
    /// # Errors
    /// As [`VertexGraph::build`].
    pub fn open_or_build(mesh: &Mesh, path: &Path, input: &Value, context: Context<'_>) -> Result<(Self, String)> {
        context.stage(VertexGraphStage { mesh, path, input })
    }

    fn open(facts: VertexFacts, frame: Frame, work: &WorkDir) -> Result<Self> {
        let [nodes, starts, ring, _, edges @ ..] = FILES;
        let n = usize::try_from(facts.vertices).unwrap_or(usize::MAX);
        let nodes = work.array_of(nodes, n)?;
        let entries = work.open_array::<u32>(ring)?.len();
        Ok(Self {
            edges: DualEdges::open(work, n, StartsForm::Plain, edges, None)?,
            nodes,
            ring_starts: work.starts(starts, n, entries / 2)?,
            ring: work.indices(ring, entries, n)?,
            frame,
            facts,
        })
    }

    /// The graph as raw slices.
    pub fn csr(&self) -> Csr<'_> {
        self.edges.by_distance()
    }

    /// Whether `vertex` is on an edge of a single triangle.
    pub fn is_open(&self, vertex: u32) -> bool {
        let [start, end] = [vertex, vertex + 1].map(|v| 2 * self.ring_starts[v as usize] as usize);
        let mut around = self.ring[start..end].to_vec();
        around.sort_unstable();
        around.chunk_by(|a, b| a == b).any(|same| same.len() == 1)
    }

    /// 1/√area, the factor that makes lengths comparable between surfaces.
    pub fn unit(&self) -> f64 {
        1. / self.facts.area.sqrt().max(1e-300)
    }

    /// Number of vertices.
    pub fn len(&self) -> usize {
        self.nodes.len()
    }
}

/// Sends the corners of all triangles to their vertices.
fn scatter(mesh: &Mesh, shuffle: &Shuffle<Corner>, by_vertex: RangeBuckets, run: &Run) -> Result<()> {
    let faces = mesh.faces.len();
    run.each_chunk(
        chunk_count(faces, CHUNK),
        || shuffle.producer(),
        |k, out| {
            mesh.faces.try_for_each(chunk_range(faces, CHUNK, k), |_, corners| {
                let mut pushed = Ok(());
                triangles(mesh, corners, |[a, b, c], _| {
                    let mut push = |corner: Corner| out.push(by_vertex.bucket_of(corner[0]), corner);
                    if pushed.is_ok() {
                        pushed = [[a, b, c], [b, c, a], [c, a, b]].into_iter().try_for_each(&mut push);
                    }
                });
                pushed
            })
        },
        Producer::finish,
    )
}

/// Writes the arrays of a vertex graph from front to back.
struct VertexGraphWriter {
    edges: EdgesWriter,
    nodes: ArrayWriter<Node>,
    ring_starts: ArrayWriter<u64>,
    ring: ArrayWriter<u32>,
    /// Triangles around vertices so far.
    ring_end: u64,
    duplicates: DuplicateVertices,
    facts: VertexFacts,
}

impl VertexGraphWriter {
    /// For `n` vertices with at most `entries` ends of edges.
    fn create(n: usize, entries: usize, context: Context<'_>) -> Result<Self> {
        let mut writer = Self {
            edges: EdgesWriter::create(n, entries, StartsForm::Plain, false, context.work)?,
            nodes: context.work.writer(FILES[0], 7)?,
            ring_starts: context.work.writer(FILES[1], 1)?,
            ring: context.work.writer(FILES[2], 2)?,
            ring_end: 0,
            duplicates: DuplicateVertices::new(n, context)?,
            facts: VertexFacts { vertices: n as u64, ..VertexFacts::default() },
        };
        writer.ring_starts.push(&[0])?;
        Ok(writer)
    }

    /// Appends the next vertices, which are vertices of `mesh`.
    fn push(&mut self, mut part: VertexRange, mesh: &Mesh) -> Result<()> {
        // One by one, since the number of vertices per call depends on memory and threads.
        part.nodes.iter().for_each(|node| self.facts.area += f64::from(node.area));
        self.facts.boundary_vertices += part.open.len() as u64;
        part.ring_ends.iter_mut().for_each(|at| *at += self.ring_end);
        self.ring_end = part.ring_ends.last().copied().unwrap_or(self.ring_end);
        self.nodes.push(&part.nodes)?;
        self.edges.push(&part.degrees, &part.indices, &part.lengths, &[])?;
        self.ring_starts.push(&part.ring_ends)?;
        self.ring.push(&part.ring)?;
        part.open.iter().try_for_each(|&v| self.duplicates.push(v, mesh.positions.get(v)))
    }

    /// Joins coincident vertices and components, and opens the graph.
    fn finish(self, frame: Frame, context: Context<'_>) -> Result<VertexGraph> {
        let Self { nodes, ring_starts, ring, duplicates, mut facts, .. } = self;
        let (mut edges, nodes) = (self.edges.finish()?, nodes.finish(false)?);
        let geometry = NodeGeometry::from(nodes.clone());
        {
            let _scratch = context.work.scratch(&[JOINS]);
            let joins = duplicates.find(context)?;
            facts.seams = joins.len() as u64;
            if !joins.is_empty() {
                edges = bridges::insert(&edges, &joins, context)?;
            }
        }
        let components = find_components(&edges, &geometry, None, context)?;
        facts.components = components.count() as u64;
        let bridges = find_bridges(&components, &geometry, LEAST, context)?;
        drop(components);
        context.work.remove(components::FILE);
        if let Some(bridges) = bridges {
            edges = bridges::insert(&edges, bridges.items(), context)?;
        }
        let (ring_starts, ring) = (ring_starts.finish(false)?, ring.finish(false)?);
        Ok(VertexGraph { edges, nodes, ring_starts, ring, frame, facts })
    }
}

/// The stage of the vertex graph.
struct VertexGraphStage<'a> {
    mesh: &'a Mesh,
    path: &'a Path,
    input: &'a Value,
}

impl Stage for VertexGraphStage<'_> {
    const NAME: &'static str = "vertex graph";
    const VERSION: u32 = 8;
    type Facts = (VertexFacts, Frame);
    type Output = (VertexGraph, String);

    fn inputs(&self, _: Context<'_>) -> Value {
        json!({"input": self.input})
    }

    fn make(self, key: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let graph = VertexGraph::build(self.mesh, self.path, context)?;
        Ok(BuiltStage { facts: (graph.facts, graph.frame), output: (graph, key.to_string()), files: FILES.to_vec() })
    }

    fn open(self, (facts, frame): Self::Facts, key: &str, context: Context<'_>) -> Result<Self::Output> {
        Ok((VertexGraph::open(facts, frame, context.work)?, key.to_string()))
    }

    /// 8 bytes per end of an edge, at most two per corner, 8 for the ring, and the nodes.
    fn needs(extent: &Extent, estimate: &mut BudgetEstimate) -> Needs {
        let Extent { faces: n, vertices, corners, threads: t, .. } = *extent;
        let records = 3 * corners.saturating_sub(2 * n);
        let shuffle = ShuffleNeeds::new(records, 12, 6 * t, 2, estimate.left(), t);
        let all = 44 * vertices + 24 * records;
        let kept = estimate.reserve_array(all);
        let temporary = (12 * records).saturating_sub(shuffle.held);
        Needs { memory: shuffle.held + estimate.used(), keeps: all - kept, temporary, ..Needs::default() }
    }
}

/// Rows, rings and areas of the vertices of `range`, from their corners.
fn part(mesh: &Mesh, frame: &Frame, range: std::ops::Range<usize>, mut corners: Vec<Corner>) -> VertexRange {
    // The order in which threads pushed them must not matter.
    corners.sort_unstable();
    let mut part = VertexRange::default();
    let (mut rest, mut neighbours) = (&corners[..], Vec::new());
    let place = |v: u32| wide(narrow(frame.place(mesh.positions.get(v)), 1.));
    for v in range {
        let count = rest.iter().take_while(|corner| corner[0] as usize == v).count();
        let (mine, after) = rest.split_at(count);
        rest = after;
        let here = place(v as u32);
        let position = if finite(here) { here } else { [0.; 3] };
        let mut area = 0f64;
        neighbours.clear();
        for &[_, next, previous] in mine {
            area += length(cross(minus(place(next), here), minus(place(previous), here))) / 6.;
            neighbours.extend([next, previous]);
            part.ring.extend([next, previous]);
        }
        neighbours.sort_unstable();
        let (mut degree, mut open) = (0, false);
        for same in neighbours.chunk_by(|a, b| a == b) {
            degree += 1;
            open |= same.len() == 1;
            part.indices.push(same[0]);
            part.lengths.push((distance(here, place(same[0])) as f32).max(LEAST));
        }
        part.degrees.push(degree);
        part.ring_ends.push(part.ring.len() as u64 / 2);
        part.nodes.push(Node { centroid: narrow(position, 1.), normal: [0.; 3], area: area as f32 });
        if open {
            part.open.push(v as u32);
        }
    }
    part
}

/// Temporary file of the edges between coincident vertices.
const JOINS: &str = "joins.tmp";

/// Position bits and vertex.
type PositionKey = [u64; 4];

/// Finds open vertices with equal positions.
struct DuplicateVertices {
    sized: BudgetedShuffle<PositionKey>,
    staged: Vec<PositionKey>,
}

impl DuplicateVertices {
    /// For up to `n` vertices.
    fn new(n: usize, context: Context<'_>) -> Result<Self> {
        let sized = BudgetedShuffle::new(context.work.spill("seams.tmp"), "seams", n as u64, 2, 4, context.run)?;
        Ok(Self { sized, staged: Vec::new() })
    }

    /// Adds the vertex `v` at `position`.
    fn push(&mut self, v: u32, position: [f64; 3]) -> Result<()> {
        let [x, y, z] = position_key(position);
        self.staged.push([x, y, z, u64::from(v)]);
        if self.staged.len() < 1 << 12 { Ok(()) } else { Self::scatter(&self.sized.shuffle, &mut self.staged) }
    }

    fn scatter(shuffle: &Shuffle<PositionKey>, staged: &mut Vec<PositionKey>) -> Result<()> {
        let mut producer = shuffle.producer();
        for record in staged.drain(..) {
            let hash = xxh3_64(bytemuck::cast_slice(&record[..3]));
            producer.push(((u128::from(hash) * shuffle.buckets() as u128) >> 64) as usize, record)?;
        }
        producer.finish()
    }

    /// The edges between coincident vertices.
    fn find(mut self, context: Context<'_>) -> Result<MappedSlice<Bridge>> {
        Self::scatter(&self.sized.shuffle, &mut self.staged)?;
        let mut joins = context.work.writer::<Bridge>(JOINS, 1)?;
        let mut found = Vec::new();
        for bucket in 0..self.sized.shuffle.buckets() {
            context.run.cancel.check()?;
            let mut records = self.sized.shuffle.take(bucket)?;
            records.sort_unstable();
            for pair in records.windows(2).filter(|pair| pair[0][..3] == pair[1][..3]) {
                found.push(Bridge { nodes: [pair[0][3] as u32, pair[1][3] as u32], gap: LEAST });
                if found.len() == 1 << 12 {
                    joins.push(&found)?;
                    found.clear();
                }
            }
        }
        joins.push(&found)?;
        joins.finish(false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{stream, unit};
    use crate::store::{Budget, WorkDir};

    /// A rough sheet of `width` × `width` vertices, which are the nearer to each other the nearer they are to a corner.
    fn sheet(width: u32) -> (Vec<[f64; 3]>, Vec<Vec<u32>>) {
        let mut random = stream(1, "sheet");
        let place = |k: u32| 0.9f64.powi(k as i32);
        let points = (0..width * width).map(|v| [place(v % width), place(v / width), unit(&mut random) * 1e-6]);
        let corners = (0..width * (width - 1)).filter(|v| v % width + 1 < width);
        let faces = corners.flat_map(|v| [vec![v, v + 1, v + width], vec![v + 1, v + width + 1, v + width]]);
        (points.collect(), faces.collect())
    }

    /// Regression: the top bit of a number was taken for a parity, which corrupted the components of other vertices.
    #[test]
    fn vertices_beyond_31_bits_are_refused() {
        let told = |vertices: usize| check_size(vertices, "mesh.ply".as_ref()).map_err(|error| error.to_string());
        assert!(told((1 << 31) - 1).is_ok());
        assert!(told(1 << 31).unwrap_err().contains("mesh.ply: has 2147483648 vertices"));
    }

    /// Regression: areas were summed bucket by bucket, and the number of buckets depends on memory and threads.
    #[test]
    fn the_area_has_the_same_bits_whatever_memory_and_threads() {
        let (points, faces) = sheet(150);
        let mesh = Mesh::from_slices(&points, &faces).unwrap();
        let area = |memory: u64, threads: usize| {
            let run = Run { threads, budget: Budget::new(memory), ..Run::new(&()) };
            let work = WorkDir::temporary(&std::env::temp_dir()).unwrap();
            VertexGraph::build(&mesh, "sheet".as_ref(), Context::new(&work, &run)).unwrap().facts.area.to_bits()
        };
        let expected = area(1 << 30, 1);
        for (memory, threads) in [(1 << 30, 2), (8 << 20, 1), (4 << 20, 2), (2 << 20, 3)] {
            assert_eq!(area(memory, threads), expected, "{memory} bytes, {threads} threads");
        }
    }

    /// The fan of its first corner fills the notch of an L, which would make distances across it too short.
    #[test]
    fn a_concave_polygon_is_not_left() {
        let ell = [[1., 1.], [1., 3.], [0., 3.], [0., 0.], [3., 0.], [3., 1.]].map(|[x, y]| [x, y, 0.]);
        for first in 0..6 {
            let corners: Vec<u32> = (0..6).map(|k| (first + k) % 6).collect();
            let mesh = Mesh::from_slices(&ell, &[corners]).unwrap();
            let run = Run::new(&());
            let work = WorkDir::temporary(&std::env::temp_dir()).unwrap();
            let graph = VertexGraph::build(&mesh, "ell".as_ref(), Context::new(&work, &run)).unwrap();
            let area = graph.facts.area * graph.frame.scale.powi(2);
            assert!((area - 5.).abs() < 1e-6, "from corner {first}: {area}");
        }
    }

    /// Regression: each such face reduced the room for triangles.
    #[test]
    fn faces_without_corners_take_no_room_from_triangles() {
        let (points, mut faces) = sheet(20);
        faces.resize(faces.len() + 300, Vec::new());
        let mesh = Mesh::from_slices(&points, &faces).unwrap();
        let run = Run::new(&());
        let work = WorkDir::temporary(&std::env::temp_dir()).unwrap().holding(&run.budget);
        let graph = VertexGraph::build(&mesh, "sheet".as_ref(), Context::new(&work, &run)).unwrap();
        assert_eq!(graph.ring.len(), 2 * 3 * (faces.len() - 300));
    }
}
