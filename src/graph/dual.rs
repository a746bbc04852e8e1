//! The dual graph as a stage: built once into the work directory, then opened as mapped arrays.
//!
//! The other files of this folder do the work, and each states its own memory and time; this file puts them in order.
//! Kept per triangle: 28 bytes of geometry, 36 of neighbours, centroid distances and edge lengths, and packed row
//! starts; the weights take another 12. Computed geometry ([`super::node_geometry`]) saves 40 of these. Opening costs
//! one validation pass.

use super::assemble_in_memory::assemble_in_memory;
use super::bridges::{self, find_bridges};
use super::components::{self, FLIPPED, find_components};
use super::csr::{INDICES, WEIGHTS, WEIGHTS_STAGE, WeightedGraph};
use super::dual_edges::{Assembled, CENTROID_DISTANCES, DualEdges, EDGES, assemble};
use super::duplicates::{self, Evidence};
use super::flaps;
use super::frame::Frame;
use super::half_edge_pairs::WithinNeeds;
use super::node_blocks::NodeBlocks;
use super::node_geometry::{ComputedGeometry, NodeGeometry};
use super::nodes::{self, Node, NodeSums};
use super::orient::{Oriented, orient};
use super::row_starts::{BLOCKS, LONG_ROWS, StartsForm};
use super::weights::{Metric, Weighting};
use super::{half_edge_pairs, half_edges, node_blocks};
use crate::base::Result;
use crate::base::parallel::run_concurrently;
use crate::mesh::Mesh;
use crate::store::checked::all_below;
use crate::store::manifest::MANIFEST;
use crate::store::needs::{BudgetEstimate, Extent, Needs, ShuffleNeeds};
use crate::store::stage::{BuiltStage, Stage};
use crate::store::{Context, MappedSlice, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::Path;

/// What building the graph learned about the mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GraphFacts {
    /// Vertices of the mesh.
    pub vertices: u64,
    /// Nodes (= faces).
    pub nodes: u64,
    /// Undirected edges, bridges included.
    pub edges: u64,
    /// Mesh edges with one face, after welding.
    pub boundary_edges: u64,
    /// Edges of three faces or more.
    pub nonmanifold_edges: u64,
    /// Open edges joined to others at exactly the same position.
    pub welded_edges: u64,
    /// Faces without area or with a non-finite coordinate.
    pub degenerate_faces: u64,
    /// Those among them with a non-finite coordinate.
    pub nonfinite_faces: u64,
    /// Faces that lie exactly where an earlier face lies, in either winding. They count as having no area.
    pub duplicate_faces: u64,
    /// Vertices far outside the rest, which were moved to the mean of their neighbours.
    pub stray_vertices: u64,
    /// Faces whose normals were flipped, because their winding contradicts their component's or points inwards;
    /// duplicates among them.
    pub flipped_faces: u64,
    /// Edges whose faces cannot be oriented consistently (Möbius strips, some non-manifold edges).
    pub unoriented_edges: u64,
    /// Connected components, before bridging.
    pub components: u64,
    /// Edges added to join components.
    pub bridges: u64,
    /// Sum of face areas in the frame.
    pub area: f64,
    /// The frame.
    pub frame: Frame,
}

impl GraphFacts {
    /// Notes about oddities of the file `path`: faces without a position, faces in the place of another one.
    pub fn notes(&self, path: &Path) -> Vec<String> {
        let Self { nonfinite_faces: nonfinite, duplicate_faces: duplicate, .. } = *self;
        let mut notes = Vec::new();
        if nonfinite > 0 {
            let verb = if nonfinite == 1 { "face has a corner" } else { "faces have corners" };
            let why = "whose coordinates are not finite numbers: treated as having no area, and labelled like the faces \
                       around";
            notes.push(format!("{}: {nonfinite} {verb} {why}", path.display()));
        }
        if duplicate > 0 {
            let verb = if duplicate == 1 { "face lies" } else { "faces lie" };
            let why =
                "exactly where another one lies: treated as having no area, and labelled like it or the faces around";
            notes.push(format!("{}: {duplicate} {verb} {why}", path.display()));
        }
        notes
    }
}

/// A dual graph in a work directory.
#[derive(Clone, Debug)]
pub struct DualGraph {
    /// Its edges, without weights.
    pub edges: DualEdges,
    /// Geometry of the nodes.
    pub nodes: NodeGeometry,
    /// For each node the first node of its component before bridging, with the top bit ([`FLIPPED`]) set where its
    /// normal was flipped; `None` if there is only one component.
    pub components: Option<MappedSlice<u32>>,
    /// For each node 1 + the node whose duplicate it is, 0 for all others; `None` without duplicates.
    pub duplicates: Option<MappedSlice<u32>>,
    /// Counts and sums.
    pub facts: GraphFacts,
    /// Key of the stage, for stages built on it.
    pub key: String,
}

const FILES: [&str; 6] = [nodes::FILE, BLOCKS, LONG_ROWS, INDICES, CENTROID_DISTANCES, EDGES];

impl DualGraph {
    /// Builds the graph of `mesh` (from the file `path`, whose identity is `input`) in `work`, or opens it if it was
    /// built before. Stray vertices are used as they are; [`crate::graph::Ordered`] moves them beforehand.
    ///
    /// # Errors
    /// [`crate::base::Error::Unusable`] for more than 2³² − 1 corners, [`crate::base::Error::Io`],
    /// [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
    ///
    /// ```
    /// use nystrom_stream::graph::{DualGraph, Metric};
    /// use nystrom_stream::mesh::Mesh;
    /// use nystrom_stream::store::{Context, Run, WorkDir};
    ///
    /// # fn main() -> nystrom_stream::base::Result<()> {
    /// let run = Run::new(&());
    /// let work = WorkDir::temporary(&std::env::temp_dir())?;
    /// let points = [[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
    /// let mesh = Mesh::from_slices(&points, &[[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])?;
    /// let context = Context::new(&work, &run);
    /// let graph = DualGraph::build(&mesh, "tetrahedron".as_ref(), &"tetrahedron".into(), context)?;
    /// assert_eq!((graph.facts.nodes, graph.facts.edges, graph.facts.components), (4, 6, 1));
    ///
    /// let weighted = graph.weighted(Metric::Geodesic, context)?;
    /// let near: Vec<u32> = weighted.csr().neighbours(0).map(|(face, _weight)| face).collect();
    /// assert_eq!(near, [1, 2, 3]);
    /// # Ok(())
    /// # }
    /// ```
    pub fn build(mesh: &Mesh, path: &Path, input: &Value, context: Context<'_>) -> Result<Self> {
        Self::build_noting(GraphStage { mesh, path, input, computed: false }, context)
    }

    /// The same, but node geometry and shared edges are not stored: they are computed from the mesh at each access.
    /// 24.5 bytes per triangle instead of 64.5. Only in a temporary work directory.
    ///
    /// # Errors
    /// As [`DualGraph::build`].
    pub(crate) fn build_computed(mesh: &Mesh, path: &Path, input: &Value, context: Context<'_>) -> Result<Self> {
        Self::build_noting(GraphStage { mesh, path, input, computed: context.work.is_temporary() }, context)
    }

    /// The same as [`DualGraph::build`] for a `mesh` derived from another one, whose oddities have been noted.
    ///
    /// # Errors
    /// As [`DualGraph::build`].
    pub(crate) fn build_silently(mesh: &Mesh, input: &Value, context: Context<'_>) -> Result<Self> {
        context.stage(GraphStage { mesh, path: mesh.path(), input, computed: false })
    }

    /// Builds or opens the graph; either way, oddities of the mesh are noted.
    fn build_noting(stage: GraphStage<'_>, context: Context<'_>) -> Result<Self> {
        let path = stage.path;
        let graph = context.stage(stage)?;
        graph.facts.notes(path).iter().for_each(|note| context.run.progress.note(note));
        Ok(graph)
    }

    /// Opens the finished graph of `work`, whatever its mesh, and returns the identity of its input.
    ///
    /// # Errors
    /// [`crate::base::Error::WorkDir`] if there is none or its files are missing or damaged.
    pub fn kept(work: &WorkDir) -> Result<(Self, Value)> {
        let kept = work.finished_stage::<GraphStage<'_>>("recreate it with the original options: stage `record`")?;
        Ok((Self::open(work, kept.facts, StartsForm::Packed, kept.key)?, kept.inputs["input"].clone()))
    }

    /// The graph of `n` nodes with the key `key` in `work`, as left by the process that built or verified it. Checksums
    /// are not tested again: a share reads only part of the files.
    ///
    /// # Errors
    /// [`Error::WorkDir`] if there is none, [`Error::Io`], [`Error::Malformed`].
    pub(crate) fn prepared(key: String, n: usize, work: &WorkDir) -> Result<Self> {
        let facts = work.recorded_facts::<GraphStage<'_>>().ok_or_else(|| work.damaged(MANIFEST, "has no graph"))?;
        let graph = Self::open(work, facts, StartsForm::Packed, key)?;
        if graph.nodes.len() != n {
            return Err(work.damaged(MANIFEST, "has another number of faces"));
        }
        // A front over negative lengths would not terminate.
        if !graph.edges.centroid_distance.iter().all(|length| *length >= 0.) {
            return Err(work.damaged(FILES[4], "has lengths below 0"));
        }
        Ok(graph)
    }

    fn make(stage: &GraphStage<'_>, context: Context<'_>, key: String) -> Result<Self> {
        let GraphStage { mesh, path, computed, .. } = *stage;
        let geometry = || -> Result<(Frame, NodeGeometry, Option<NodeSums>)> {
            let frame = Frame::of(mesh, context.run)?;
            if computed {
                let from = ComputedGeometry { mesh: mesh.clone(), frame, flipped: MappedSlice::empty() };
                return Ok((frame, NodeGeometry::computed(from), None));
            }
            let array = context.work.array(nodes::FILE, &[mesh.faces.len(), 7])?;
            let (array, sums) = nodes::build(mesh, &frame, array, context.run)?;
            Ok((frame, array.into(), Some(sums)))
        };
        // Finding the vertices that blocks share is single-threaded, so it runs beside the geometry.
        let (blocks, geometry) = run_concurrently(context.run.threads, || NodeBlocks::of(mesh, context), geometry)?;
        let (frame, nodes, sums) = geometry?;
        let (pairs, counts) = half_edges::matched(mesh, path, blocks?, context)?;
        let two_sided = |evidence: Evidence<'_>| match mesh.duplicates() {
            None => duplicates::with_duplicates(mesh, evidence, context),
            Some(_) => Ok(None),
        };
        // Edges to duplicates do not follow from two faces alone.
        let again = |mesh: &Mesh| Self::make(&GraphStage { mesh, computed: false, ..*stage }, context, key.clone());
        // Within blocks, edges are counted only when pairs are taken.
        if !pairs.finds_within()
            && let Some(mesh) = two_sided(Evidence::Sides(counts.duplicates))?
        {
            drop((pairs, nodes));
            return again(&mesh);
        }
        let assembled = match assemble_in_memory(mesh, &frame, &nodes, &pairs, context)? {
            None => assemble(mesh, &frame, &nodes, &pairs, context)?,
            Some(edges) => Some(Assembled { edges, whole: None, joined: None }),
        };
        let mut nonmanifold_edges = counts.nonmanifold;
        let within = pairs.nonmanifold_within().map(|within| (within.edges(), within.duplicate_sides()));
        drop(pairs);
        let mut sides = counts.duplicates;
        if let Some((edges, further)) = within {
            nonmanifold_edges += edges;
            sides = sides.and(further);
            if let Some(mesh) = two_sided(Evidence::Sides(sides))? {
                drop((assembled, nodes));
                return again(&mesh);
            }
        }
        // Too many edges cannot be computed from two faces alone: store all edges instead.
        let Some(Assembled { edges, whole, joined }) = assembled else {
            return Self::make(&GraphStage { computed: false, ..*stage }, context, key);
        };
        let components = find_components(&edges, &nodes, joined, context)?;
        if let Some(mesh) = two_sided(Evidence::Components(&components))? {
            drop((components, edges, nodes));
            return again(&mesh);
        }
        if mesh.duplicates().is_none()
            && sides.mixed > 0
            && let Some(mesh) = flaps::without_flaps(mesh, &components, context)?
        {
            drop((components, edges, nodes));
            let mut graph = again(&mesh)?;
            // What the file has, which is not the surface twice, but a surface with flaps.
            graph.facts = GraphFacts {
                boundary_edges: counts.boundary,
                nonmanifold_edges,
                welded_edges: counts.welded,
                ..graph.facts
            };
            return Ok(graph);
        }
        let Oriented { mut edges, nodes, components, facts: orientation, sums } =
            orient(edges, nodes, sums, whole, components, context)?;
        let bridges = find_bridges(&components, &nodes, 0., context)?;
        if let Some(bridges) = &bridges {
            edges = bridges::insert(&edges, bridges.items(), context)?;
        }
        let facts = GraphFacts {
            vertices: mesh.positions.len() as u64,
            nodes: nodes.len() as u64,
            edges: edges.indices.len() as u64 / 2,
            boundary_edges: counts.boundary,
            nonmanifold_edges,
            welded_edges: counts.welded,
            degenerate_faces: sums.degenerate,
            duplicate_faces: mesh.duplicate_count(),
            nonfinite_faces: sums.nonfinite,
            stray_vertices: mesh.strays() as u64,
            flipped_faces: orientation.flipped,
            unoriented_edges: orientation.unsatisfied / 2,
            components: components.count() as u64,
            bridges: bridges.map_or(0, |bridges| bridges.items().len() as u64),
            area: sums.area,
            frame,
        };
        let components = if facts.components > 1 {
            components.root
        } else {
            drop(components);
            context.work.remove(components::FILE);
            None
        };
        let duplicates = mesh.duplicates().cloned();
        Ok(Self { edges, nodes, components, duplicates, facts, key })
    }

    /// Opens the arrays of a finished graph, its row starts in `form`.
    pub(crate) fn open(work: &WorkDir, facts: GraphFacts, form: StartsForm, key: String) -> Result<Self> {
        let [nodes, _, _, steps @ .., edge] = FILES;
        let n = usize::try_from(facts.nodes).unwrap_or(usize::MAX);
        let nodes: MappedSlice<Node> = work.array_of(nodes, n)?;
        let edges = DualEdges::open(work, n, form, steps, Some(edge))?;
        let sizes = [facts.area, facts.frame.scale];
        if n == 0 || !sizes.iter().all(|size| size.is_finite() && *size >= 0.) {
            return Err(work.damaged(MANIFEST, "has no graph"));
        }
        let components = if facts.components > 1 { Some(work.array_of::<u32>(components::FILE, n)?) } else { None };
        if let Some(roots) = &components
            && !all_below(roots.iter().map(|root| root & !FLIPPED), n)
        {
            return Err(work.damaged(components::FILE, format!("has indices that are not below {n}")));
        }
        let duplicates =
            if facts.duplicate_faces > 0 { Some(work.array_of::<u32>(duplicates::FILE, n)?) } else { None };
        Ok(Self { edges, nodes: nodes.into(), components, duplicates, facts, key })
    }

    /// Whether the winding of `node` in the file is against its normal; false if there is only one component.
    pub fn is_flipped(&self, node: u32) -> bool {
        self.components.as_ref().is_some_and(|roots| roots[node as usize] & FLIPPED != 0)
    }

    /// Deletes the step lengths in a temporary `work` once the weights are computed: 12 bytes of disk per triangle.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub fn release_lengths(&mut self, work: &WorkDir) -> Result<()> {
        if work.is_temporary() {
            self.edges.centroid_distance = MappedSlice::empty();
            work.release(GraphStage::NAME, &[CENTROID_DISTANCES])?;
        }
        Ok(())
    }

    /// The graph as a sparse matrix under `metric`, with computed or reused weights.
    ///
    /// # Errors
    /// [`crate::base::Error::Parameter`], [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn weighted(&self, metric: Metric, context: Context<'_>) -> Result<WeightedGraph> {
        self.weighted_with(metric, None, self.facts.area, context)
    }

    /// The same with turning measured by `normals` instead of the faces' own, and lengths in units of the square root
    /// of `area` (in the frame).
    ///
    /// # Errors
    /// As [`DualGraph::weighted`].
    pub fn weighted_with(
        &self,
        metric: Metric,
        normals: Option<TurningNormals<'_>>,
        area: f64,
        context: Context<'_>,
    ) -> Result<WeightedGraph> {
        context.stage(WeightsStage { graph: self, metric, normals, area })
    }
}

/// The stage of the graph.
pub(crate) struct GraphStage<'a> {
    mesh: &'a Mesh,
    path: &'a Path,
    input: &'a Value,
    /// Whether geometry is computed from the mesh at each access.
    computed: bool,
}

impl Stage for GraphStage<'_> {
    const NAME: &'static str = "graph";
    const VERSION: u32 = 11;
    type Facts = GraphFacts;
    type Output = DualGraph;

    fn inputs(&self, _: Context<'_>) -> Value {
        if self.computed { json!({"input": self.input, "computed": true}) } else { json!({"input": self.input}) }
    }

    fn make(self, key: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let graph = DualGraph::make(&self, context, key.to_string())?;
        let mut files = FILES.to_vec();
        if graph.nodes.is_computed() {
            files.retain(|name| ![nodes::FILE, EDGES].contains(name));
        }
        if graph.components.is_some() {
            files.push(components::FILE);
        }
        if graph.duplicates.is_some() {
            files.push(duplicates::FILE);
        }
        Ok(BuiltStage { facts: graph.facts.clone(), output: graph, files })
    }

    fn open(self, facts: GraphFacts, key: &str, context: Context<'_>) -> Result<DualGraph> {
        if self.computed {
            // The flipped faces and the listed edges are stored only in the arrays of the graph.
            return DualGraph::make(&self, context, key.to_string());
        }
        DualGraph::open(context.work, facts, StartsForm::Packed, key.to_string())
    }

    fn progress(&self) -> Option<(&'static str, u64)> {
        Some(("faces", self.mesh.faces.len() as u64))
    }

    /// Three phases: half-edges and their pairs beside the nodes, matched by blocks, as in a good order; then pairs
    /// beside all that is kept; then the components' roots, if they were not joined before.
    fn needs(extent: &Extent, estimate: &mut BudgetEstimate) -> Needs {
        let Extent { faces: n, vertices, corners, threads: t, computed, .. } = *extent;
        // Geometry, and per corner a neighbour and two lengths; or only a neighbour and one length.
        let (geometry, corner) = if computed { (0, 8) } else { (28 * n, 12) };
        let nodes = estimate.reserve_array(geometry);
        let marks = estimate.reserve_array(2 * vertices);
        let block = node_blocks::corners_a_block(corners, t, estimate.left() / 4);
        let matching = node_blocks::bytes(block.min(corners), t);
        // About one in ten half-edges lies between blocks.
        let half_edges = ShuffleNeeds::new(corners / 10, 12, 3 * t, 3, estimate.left(), t);
        let left = estimate.left().saturating_sub(half_edges.granted);
        // A table of pairs, for which the vertex marks are freed; or matching by blocks again, with finished rows
        // waiting.
        let (pairs, granted, kept) = if half_edge_pairs::fit(corners, left) {
            (4 * corners, 4 * corners, 0)
        } else {
            (matching, WithinNeeds::new(corners.div_ceil(block), block, corners / 10, t, left).granted, marks)
        };
        estimate.release(marks - kept);
        estimate.grant(granted);
        let mut edges = estimate.reserve_array(n / 2);
        // Lengths are kept in memory if they can be assembled there: beside a table of pairs, all or none.
        let before = estimate.clone();
        let arrays = [
            estimate.reserve_array(4 * corners),
            estimate.reserve_named(CENTROID_DISTANCES, 4 * corners),
            estimate.reserve_array(4 * corners),
        ];
        let in_memory = !computed && kept == 0 && !arrays.contains(&0);
        if in_memory {
            edges += arrays.iter().sum::<u64>();
        } else {
            *estimate = before;
            edges += estimate.reserve_array(4 * corners);
        }
        // Components are joined while rows are assembled, or else afterwards.
        let joined = if in_memory { 0 } else { estimate.reserve_array(4 * n) };
        estimate.release(granted + kept);
        let roots = if in_memory { estimate.reserve_array(4 * n) } else { joined };
        estimate.release(roots);
        let keeps = geometry + n / 2 + corner * corners - nodes - edges;
        Needs {
            memory: nodes + (marks + matching + half_edges.held + pairs).max(pairs + edges + joined).max(edges + roots),
            keeps,
            temporary: (geometry - nodes + 2 * vertices - marks).saturating_sub(keeps).max(4 * n - roots),
            frees: if extent.reordered && !extent.lasting && !computed { 12 * vertices + 4 * corners } else { 0 },
            ..Needs::default()
        }
        .moving(if computed { 93 } else { 207 } * n, if computed { 33 } else { 74 } * n)
    }
}

/// Normals for measuring turning, instead of the faces' own.
#[derive(Clone, Copy, Debug)]
pub struct TurningNormals<'a> {
    /// Normal of each node (n).
    pub normals: &'a [[f32; 3]],
    /// The radius over which they are averaged, in units of √(area).
    pub radius: f32,
    /// The version of the algorithm that made them; the weights depend on it.
    pub version: u32,
}

/// The stage of a graph's weights.
pub(crate) struct WeightsStage<'a> {
    graph: &'a DualGraph,
    metric: Metric,
    normals: Option<TurningNormals<'a>>,
    area: f64,
}

impl WeightsStage<'_> {
    fn matrix(&self, weights: MappedSlice<f32>, key: &str, work: &WorkDir) -> Result<WeightedGraph> {
        let DualEdges { starts, indices, .. } = &self.graph.edges;
        WeightedGraph::new(work.path(), starts.clone(), indices.clone(), weights, key.to_string())
    }
}

impl Stage for WeightsStage<'_> {
    const NAME: &'static str = WEIGHTS_STAGE;
    const VERSION: u32 = 2;
    type Facts = ();
    type Output = WeightedGraph;

    fn inputs(&self, context: Context<'_>) -> Value {
        let Self { graph, metric, normals, area } = self;
        let (radius, version) = normals.map_or((0., None), |normals| (normals.radius, Some(normals.version)));
        let mut inputs =
            json!({"graph": graph.key, "metric": metric, "radius": radius, "area": area, "seed": context.run.seed});
        if let Some(version) = version {
            inputs["normals"] = version.into();
        }
        inputs
    }

    fn make(self, key: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let Self { graph: DualGraph { edges, nodes, .. }, metric, normals, area, .. } = self;
        let weighting = Weighting { edges, nodes, normals: normals.map(|of| of.normals), area, metric };
        let weights = weighting.build(WEIGHTS, context)?;
        Ok(BuiltStage { output: self.matrix(weights, key, context.work)?, facts: (), files: vec![WEIGHTS] })
    }

    fn open(self, (): (), key: &str, context: Context<'_>) -> Result<WeightedGraph> {
        let weights = context.work.positive(WEIGHTS, self.graph.edges.indices.len())?;
        self.matrix(weights, key, context.work)
    }

    fn progress(&self) -> Option<(&'static str, u64)> {
        Some(("faces", self.graph.facts.nodes))
    }

    /// Lengths are freed once weights are computed.
    fn needs(extent: &Extent, estimate: &mut BudgetEstimate) -> Needs {
        let weights = estimate.reserve_named(WEIGHTS, 4 * extent.corners);
        let (memory, keeps) = (estimate.used(), 4 * extent.corners - weights);
        let frees = if extent.releases { 4 * extent.corners - estimate.release_named(CENTROID_DISTANCES) } else { 0 };
        let reads = if extent.computed { 67 } else { 104 };
        Needs { memory, keeps, frees, ..Needs::default() }.moving(reads * extent.faces, 12 * extent.faces)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Run;

    /// Regression: weights were reused though a new version of the program had made other normals of the same radius.
    #[test]
    fn weights_are_of_the_normals_that_they_were_made_of() {
        let dir = tempfile::tempdir().unwrap();
        let (work, run) = (WorkDir::open(dir.path()).unwrap(), Run::new(&()));
        let points = [[0f32, 0., 0.], [2., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        let mesh = Mesh::from_slices(&points, &[[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]).unwrap();
        let context = Context::new(&work, &run);
        let graph = DualGraph::build(&mesh, "mesh".as_ref(), &Value::Null, context).unwrap();
        let weights = |normals: &[[f32; 3]], version| {
            let normals = TurningNormals { normals, radius: 0.01, version };
            let weighted = graph.weighted_with(Metric::default(), Some(normals), 1., context).unwrap();
            weighted.csr().weights.to_vec()
        };
        let [flat, turned] = [[[0., 0., 1.]; 4], [[0., 0., 1.], [1., 0., 0.], [0., 1., 0.], [0., 0., -1.]]];
        let before = weights(&flat, 1);
        assert_eq!(weights(&turned, 1), before);
        assert_ne!(weights(&turned, 2), before);
    }
}
