//! The report of a run: one JSON object. It takes a kilobyte per part, and a look at the size of each file in the work
//! directory.

use super::labels::{Part, SegmentedMesh};
use super::params::SegmentParams;
use crate::apps::measure::Measures;
use crate::base::{Result, RunLog};
use crate::cluster::parts::{Enclosed, PartCount, PartsReport};
use crate::landmarks::Sampling;
use crate::store::{Context, json};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// No single body has as many parts: they are the pieces of an assembly. Pieces that are small beside the mean part, or
/// beside the cells, of which there are two thousand, share a part.
const ASSEMBLY: usize = 500;

/// The report.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The program's version.
    pub version: &'static str,
    /// The mesh.
    pub input: Input,
    /// The options.
    pub options: serde_json::Value,
    /// Landmark faces, as numbers in the file.
    pub landmarks: Vec<u32>,
    /// How they were finally chosen: farthest points that turn out to be outliers are replaced. Absent for K-means.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sampling: Option<Sampling>,
    /// The kernel's width, in the units of the distances.
    pub sigma: f64,
    /// Eigenvalues of the l × l problem, descending.
    pub eigenvalues: Vec<f64>,
    /// Eigenpairs dropped as negative or too small.
    pub dropped_eigenpairs: usize,
    /// Share of A's negative eigenvalues in the sum of all absolute ones.
    pub negative_mass: f64,
    /// Γ, eq. 6, if rows were embedded; deciding on parts does not need it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gamma: Option<f64>,
    /// Γ divided by the number of faces; for a contracted mesh (more than 60,000 faces, without `exact`) by the number
    /// of nodes of the contraction, over which Γ is summed there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gamma_per_face: Option<f64>,
    /// Radius, in units of √(area), of the normals used for measuring turning; 0: the faces' own.
    pub normal_radius: f64,
    /// Faces of components too small to be parts of their own.
    pub tiny_component_faces: u64,
    /// The part of the tiny components ([`super::TinyComponents::Own`]).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tiny_components_label: Option<u32>,
    /// The part of the walls of cavities ([`super::Walls::Own`]).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub walls_label: Option<u32>,
    /// How parts were decided on; absent for K-means.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decision: Option<PartsReport>,
    /// Whether the surface has parts that people would agree on: false if few people would have these, and if the
    /// surface is left whole. Absent if unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clear_parts: Option<bool>,
    /// The parts.
    pub parts: Vec<Part>,
    /// Measurements of the parts, by label, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measures: Option<Vec<Measures>>,
    /// Seconds per stage, and in total.
    pub seconds: BTreeMap<String, f64>,
    /// Memory and disk.
    pub bytes: Bytes,
    /// The quality of the transfer of parts from another mesh, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub like: Option<serde_json::Value>,
    /// Oddities of the input, and other notes about the mesh and its parts from the run.
    pub notes: Vec<String>,
}

/// The mesh in the report.
#[derive(Clone, Debug, Serialize)]
pub struct Input {
    /// As given.
    pub path: String,
    /// Vertices.
    pub vertices: u64,
    /// Faces.
    pub faces: u64,
    /// Connected components, before they are bridged.
    pub components: u64,
    /// Edges with one face.
    pub boundary_edges: u64,
    /// Edges with three faces or more.
    pub nonmanifold_edges: u64,
    /// Faces without area or with a non-finite coordinate.
    pub degenerate_faces: u64,
    /// Faces that lie exactly where an earlier face lies. They count as having no area.
    pub duplicate_faces: u64,
    /// Vertices far outside the rest, moved to the mean of their neighbours.
    pub stray_vertices: u64,
    /// Faces whose winding was flipped: it contradicted their component, or pointed inwards. Duplicates are included.
    pub flipped_faces: u64,
    /// Edges without a consistent winding.
    pub unoriented_edges: u64,
    /// Share of steps from face to face that lead far away in the file's order, 0 to 1.
    pub far_steps: f64,
    /// Whether faces were sorted along a curve for processing.
    pub reordered: bool,
    /// Open edges welded to others at exactly the same position.
    pub welded_edges: u64,
}

/// Memory and disk.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Bytes {
    /// Peak of allocated bytes (mapped files do not count), if counted.
    pub peak_allocated: Option<u64>,
    /// The memory budget.
    pub budget: u64,
    /// Bytes in the work directory at the end.
    pub work_dir: u64,
}

impl Report {
    /// Builds the report: for the mesh at `path`, with the seconds and notes in `log`, and with `peak` from a counting
    /// allocator, if any.
    ///
    /// # Errors
    /// [`crate::base::Error::Internal`] for options that JSON cannot represent.
    pub fn new(
        path: &Path,
        params: &SegmentParams,
        result: &SegmentedMesh,
        context: Context<'_>,
        log: &RunLog,
        peak: Option<u64>,
    ) -> Result<Self> {
        let (graph, numbers) = (&result.graph, &result.numbers);
        let has_gamma = params.cluster.embeds();
        let mut options = json::value("the options", params)?;
        if let Some(options) = options.as_object_mut() {
            options.insert("seed".into(), context.run.seed.into());
            options.insert("threads".into(), context.run.threads.into());
        }
        let mut report = Self {
            version: env!("CARGO_PKG_VERSION"),
            input: Input {
                path: path.display().to_string(),
                vertices: graph.vertices,
                faces: graph.nodes,
                components: graph.components,
                boundary_edges: graph.boundary_edges,
                nonmanifold_edges: graph.nonmanifold_edges,
                degenerate_faces: graph.degenerate_faces,
                duplicate_faces: graph.duplicate_faces,
                stray_vertices: graph.stray_vertices,
                flipped_faces: graph.flipped_faces,
                unoriented_edges: graph.unoriented_edges,
                far_steps: result.order.far_steps,
                reordered: result.order.reordered,
                welded_edges: graph.welded_edges,
            },
            options,
            landmarks: numbers.landmarks.clone(),
            sampling: numbers.sampling,
            sigma: numbers.sigma,
            eigenvalues: numbers.eigenvalues.clone(),
            dropped_eigenpairs: numbers.dropped_eigenpairs,
            negative_mass: numbers.negative_mass,
            gamma: has_gamma.then_some(numbers.gamma),
            gamma_per_face: has_gamma.then_some(numbers.gamma_per_node),
            // As in text, not as the nearest number of single precision: pages and reports then agree.
            normal_radius: (f64::from(numbers.radius) * 1e6).round() / 1e6,
            tiny_component_faces: numbers.tiny_faces,
            tiny_components_label: numbers.tiny_components_label,
            walls_label: numbers.walls_label,
            decision: numbers.decision.clone(),
            clear_parts: numbers.decision.as_ref().and_then(|decision| decision.has_clear_parts(&numbers.area)),
            parts: result.parts(),
            measures: None,
            seconds: log.seconds(),
            bytes: Bytes { peak_allocated: peak, budget: context.run.budget.total(), work_dir: context.work.bytes() },
            like: None,
            notes: log.notes(),
        };
        report.notes.extend(report.remarks(params));
        Ok(report)
    }

    /// Remarks for a person on the parts that `params` asked for, one per line.
    pub fn remarks(&self, params: &SegmentParams) -> Vec<String> {
        // A requested number may well exceed the number of natural parts.
        let found = params.parts.count == PartCount::Found && self.input.faces > 1;
        let of_found = self.doubts().into_iter().chain(self.crowded()).filter(|_| found);
        self.inside().into_iter().chain(of_found).collect()
    }

    /// That parts hold several of the pieces of an assembly; `None` if they do not, or if that is unknown.
    fn crowded(&self) -> Option<String> {
        let (pieces, parts) = (self.input.components, self.decision.as_ref()?.parts_found);
        let remedy = "as connected components each is a part of its own";
        (parts >= ASSEMBLY && pieces > parts as u64)
            .then(|| format!("some of the {pieces} separate pieces share a part: {remedy}"))
    }

    /// Number of parts that have faces: if parts are transferred, the reference may leave numbers unused.
    pub fn parts_with_faces(&self) -> usize {
        self.parts.iter().filter(|part| part.faces > 0).count()
    }

    /// Labels of the parts that most people are expected not to have.
    pub fn unsure(&self) -> impl Iterator<Item = u32> + '_ {
        self.parts.iter().filter(|part| part.unsure == Some(true)).map(|part| part.label)
    }

    /// A description of what the surface encloses; `None` if that is nothing or unknown.
    pub fn inside(&self) -> Option<String> {
        let Enclosed { walls, bodies } = self.decision.as_ref()?.enclosed;
        let percent = |share: f64| format!("{:.0} % of the area", 100. * share);
        let labelled = if self.walls_label.is_some() { "are one part" } else { "get the labels of the outer surface" };
        let walls = (walls > 0.).then(|| format!("walls of cavities, {}, {labelled}", percent(walls)));
        let bodies = (bodies > 0.).then(|| format!("enclosed bodies, {}, are cut separately", percent(bodies)));
        match (walls, bodies) {
            (Some(walls), Some(bodies)) => Some(format!("{walls}; {bodies}")),
            (walls, bodies) => walls.or(bodies),
        }
    }

    /// A description of the parts that few people would have; `None` if that is unknown or there are none.
    fn doubts(&self) -> Option<String> {
        let unsure: Vec<String> = self.unsure().map(|label| label.to_string()).collect();
        match (self.clear_parts?, unsure.as_slice()) {
            (false, _) if self.parts.len() < 2 => Some("no clear parts: the mesh is left whole".into()),
            (false, _) => Some("no clear parts: people would hardly agree on them".into()),
            (true, []) => None,
            (true, [one]) => Some(format!("part {one} is unsure: most people would not cut it out")),
            (true, [some @ .., last]) => {
                Some(format!("parts {} and {last} are unsure: most people would not cut them out", some.join(", ")))
            }
        }
    }
}
