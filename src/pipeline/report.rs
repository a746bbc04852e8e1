//! The report of a run: one JSON object.

use super::labels::SegmentedMesh;
use super::params::{Cluster, SegmentParams};
use crate::apps::measure::Measures;
use crate::base::Result;
use crate::cluster::parts::agreement::UNSURE;
use crate::cluster::parts::{Enclosed, PartsReport};
use crate::landmarks::Sampling;
use crate::mesh::Mesh;
use crate::store::{Context, json};
use serde::Serialize;
use std::collections::BTreeMap;

/// The report.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The program's version.
    pub version: &'static str,
    /// The mesh.
    pub input: Input,
    /// What was asked for.
    pub options: serde_json::Value,
    /// Landmark faces, numbers in the file.
    pub landmarks: Vec<u32>,
    /// How they were chosen in the end: farthest points that turn out to be outliers are given up. Absent for K-means.
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
    /// Γ, eq. 6, where rows became an embedding; deciding parts needs none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gamma: Option<f64>,
    /// Γ over the number of faces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gamma_per_face: Option<f64>,
    /// Radius, in units of √(area), of the normals that turning is measured with; 0: the faces' own.
    pub normal_radius: f32,
    /// Faces of components too small to be parts of their own.
    pub tiny_component_faces: u64,
    /// The part of the tiny components (`--tiny-components own`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tiny_components_label: Option<u32>,
    /// The part of the walls of cavities (`--walls own`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub walls_label: Option<u32>,
    /// How parts were decided on; absent for K-means.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decision: Option<PartsReport>,
    /// Whether the surface falls into parts that people would agree on: not where they would hardly have these, nor
    /// where it is left whole. Absent where that is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clear_parts: Option<bool>,
    /// The parts.
    pub parts: Vec<Part>,
    /// What the parts measure, by label, where that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measures: Option<Vec<Measures>>,
    /// Seconds a stage, and in total.
    pub seconds: BTreeMap<String, f64>,
    /// Memory and disk.
    pub bytes: Bytes,
    /// How well the parts of another mesh were carried over, where that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub like: Option<serde_json::Value>,
    /// Oddities of the input, and what else was told about the mesh and its parts during the run.
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
    /// Faces without area or with a coordinate that is no number.
    pub degenerate_faces: u64,
    /// Vertices far outside of the rest, taken to lie amid their neighbours.
    pub stray_vertices: u64,
    /// Faces treated as wound the other way: against their component, or inwards.
    pub turned_faces: u64,
    /// Edges where no consistent winding exists.
    pub unoriented_edges: u64,
    /// Share of steps from face to face that lead far away in the file's order, 0 to 1.
    pub far_steps: f64,
    /// Whether faces were sorted along a curve for the work.
    pub reordered: bool,
    /// Open edges joined to others at exactly the same position.
    pub welded_edges: u64,
}

/// A part in the report.
#[derive(Clone, Debug, Serialize)]
pub struct Part {
    /// Its label.
    pub label: u32,
    /// Its faces.
    pub faces: u64,
    /// Its area, in the square of the file's unit.
    pub area: f64,
    /// Its colour.
    pub colour: [u8; 3],
    /// Share of people who are expected to have such a part, 0 to 1; absent where the parts are
    /// not the decision's alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected_agreement: Option<f64>,
    /// Whether that is less than half. A band, a sliver, a crumb, or a boundary where the surface has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unsure: Option<bool>,
    /// Its name, where it has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
}

/// Memory and disk.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Bytes {
    /// Most bytes allocated at a time (mapped files are not), where counted.
    pub peak_allocated: Option<u64>,
    /// The memory budget.
    pub budget: u64,
    /// Bytes in the work directory at the end.
    pub work_dir: u64,
}

impl Report {
    /// Puts the report together. `seconds` by stage as measured; `peak` from a counting allocator, if any.
    ///
    /// # Errors
    /// [`crate::base::Error::Internal`] for options that JSON cannot tell.
    pub fn new(
        opened: &Mesh,
        params: &SegmentParams,
        result: &SegmentedMesh,
        context: Context<'_>,
        seconds: BTreeMap<String, f64>,
        peak: Option<u64>,
    ) -> Result<Self> {
        let (graph, numbers) = (&result.graph, &result.numbers);
        let computed = (params.cluster != Cluster::Parts).then_some(numbers.gamma);
        let unit = graph.frame.scale * graph.frame.scale;
        let mut options = json::value("the options", params)?;
        if let Some(options) = options.as_object_mut() {
            options.insert("seed".into(), context.run.seed.into());
            options.insert("threads".into(), context.run.threads.into());
        }
        let agreement = |label: usize| numbers.expected_agreement().get(label).copied();
        let parts = numbers.faces.iter().zip(&numbers.area).zip(&result.colours).enumerate();
        Ok(Self {
            version: env!("CARGO_PKG_VERSION"),
            input: Input {
                path: opened.path().display().to_string(),
                vertices: opened.positions.len() as u64,
                faces: graph.nodes,
                components: graph.components,
                boundary_edges: graph.boundary_edges,
                nonmanifold_edges: graph.nonmanifold_edges,
                degenerate_faces: graph.degenerate_faces,
                stray_vertices: graph.stray_vertices,
                turned_faces: graph.turned_faces,
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
            gamma: computed,
            gamma_per_face: computed.map(|gamma| gamma / graph.nodes.max(1) as f64),
            normal_radius: numbers.radius,
            tiny_component_faces: numbers.tiny_faces,
            tiny_components_label: numbers.tiny_components_label,
            walls_label: numbers.walls_label,
            decision: numbers.decision.clone(),
            clear_parts: numbers.decision.as_ref().and_then(PartsReport::has_clear_parts),
            parts: parts
                .map(|(label, ((&faces, &area), &colour))| Part {
                    label: label as u32,
                    faces,
                    area: area * unit,
                    colour,
                    expected_agreement: agreement(label),
                    unsure: agreement(label).map(|share| share < UNSURE),
                    name: result.names.get(label).filter(|name| !name.is_empty()).cloned(),
                })
                .collect(),
            measures: None,
            seconds,
            bytes: Bytes { peak_allocated: peak, budget: context.run.budget.total(), work_dir: context.work.bytes() },
            like: None,
            notes: opened.notes().to_vec(),
        })
    }

    /// Labels of the parts that most people are expected not to have.
    pub fn unsure(&self) -> impl Iterator<Item = u32> + '_ {
        self.parts.iter().filter(|part| part.unsure == Some(true)).map(|part| part.label)
    }

    /// What the surface encloses, in words; none where that is nothing or not known.
    pub fn inside(&self) -> Option<String> {
        let Enclosed { walls, bodies } = self.decision.as_ref()?.enclosed;
        let percent = |share: f64| format!("{:.0} % of the area", 100. * share);
        let told = if self.walls_label.is_some() { "are one part" } else { "have the labels of the outside" };
        let walls = (walls > 0.).then(|| format!("walls of cavities, {}, {told}", percent(walls)));
        let bodies = (bodies > 0.).then(|| format!("bodies within, {}, are cut on their own", percent(bodies)));
        match (walls, bodies) {
            (Some(walls), Some(bodies)) => Some(format!("{walls}; {bodies}")),
            (walls, bodies) => walls.or(bodies),
        }
    }

    /// Which of the parts people would hardly have, in words; none where that is not known or all is well.
    pub fn doubts(&self) -> Option<String> {
        let unsure: Vec<String> = self.unsure().map(|label| label.to_string()).collect();
        match (self.clear_parts?, unsure.as_slice()) {
            (false, _) if self.parts.len() < 2 => Some("no clear parts: the mesh is left whole".into()),
            (false, _) => Some("no clear parts: people would hardly agree on these".into()),
            (true, []) => None,
            (true, [one]) => Some(format!("part {one} is unsure: most people would not have it")),
            (true, [some @ .., last]) => {
                Some(format!("parts {} and {last} are unsure: most people would not have them", some.join(", ")))
            }
        }
    }
}
