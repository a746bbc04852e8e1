//! Two meshes prepared for matching, and their refined match.
//!
//! Each mesh is turned into a vertex graph, rows and an embedding in its own folder ([`Side`]). [`refined`] computes
//! matches from two of them and alignments of their embeddings. [`super::correspond`] of wholes and [`super::partial`]
//! both build on this.
//!
//! Cost: everything of the size of a mesh is a mapped file; only queues of fronts are allocated.

use crate::apps::correspond::align::CONCLUSIVE_ORIENTATION;
use crate::apps::correspond::dense::{EXHAUSTIVE, RefinedPair, transformed};
use crate::apps::correspond::matches::{Match, Matching, matches};
use crate::apps::correspond::partial::PartialOutcome;
use crate::apps::correspond::refine::{Outcome, Prior, Refinable, Refine, Start, refine, refit, rivals};
use crate::apps::correspond::{Alignment, Alignments, Shape, SurfacePoint, Tensor};
use crate::base::{Error, Result};
use crate::distance::DistanceRows;
use crate::distance::local_rows::LocalRows;
use crate::distance::march::Surface;
use crate::distance::rows::RowParams;
use crate::distance::vertex_rows::{self, Distance};
use crate::graph::VertexGraph;
use crate::graph::vertex_graph::VertexFacts;
use crate::landmarks::Sampling;
use crate::mesh::Mesh;
use crate::pipeline::params::LANDMARKS_AT_MOST;
use crate::spectral::local::LocalBasis;
use crate::spectral::nystrom::{OrthogonalEmbedding, OrthogonalParams, Point};
use crate::store::{Context, MappedSlice, Run, WorkDir};
use nalgebra::DMatrix;
use serde::Serialize;
use serde_json::Value;

/// Parameters of `correspond`.
#[derive(Clone, Copy, Debug, Serialize)]
#[non_exhaustive]
pub struct CorrespondParams {
    /// Number of landmarks l on each mesh.
    pub landmarks: usize,
    /// How landmarks are chosen, on each mesh independently.
    pub sampling: Sampling,
    /// How distances between vertices are measured.
    pub distance: Distance,
    /// How vertices are embedded.
    pub embedding: OrthogonalParams,
    /// Which matches are kept.
    pub matching: Matching,
    /// Whether landmarks of A are transferred to B by the first matches and everything is repeated with these.
    pub transfer: bool,
    /// Which of several alignments to use, from 0.
    pub alternative: usize,
    /// How the first matches are refined.
    pub refine: Refine,
    /// Whether matches inside triangles are computed too.
    pub points: bool,
    /// Whether one mesh may be a part of the other, at the same scale; vertices without a counterpart stay unmatched.
    pub partial: bool,
}

impl Default for CorrespondParams {
    fn default() -> Self {
        Self {
            landmarks: 50,
            sampling: Sampling::Farthest,
            distance: Distance::March,
            embedding: OrthogonalParams::default(),
            matching: Matching::All,
            transfer: false,
            alternative: 0,
            refine: Refine::default(),
            points: false,
            partial: false,
        }
    }
}

crate::base::setters::setters!(CorrespondParams {
    landmarks: usize,
    sampling: Sampling,
    distance: Distance,
    embedding: OrthogonalParams,
    matching: Matching,
    transfer: bool,
    alternative: usize,
    refine: Refine,
    points: bool,
    partial: bool
});

/// Prior knowledge of the map; only for refinement.
#[derive(Clone, Debug, Default)]
pub struct Guidance {
    /// Pairs of corresponding vertices of A and B.
    pub pairs: Vec<(u32, u32)>,
    /// An initial map: for each vertex of A one of B.
    pub map: Option<Vec<Option<u32>>>,
}

/// A refined map as a matrix between functions.
#[derive(Clone, Debug)]
pub struct FunctionalMap {
    /// C (k × k): functions of B at matches are C times those of A.
    pub map: DMatrix<f64>,
    /// The functions on A and on B.
    pub bases: [LocalBasis; 2],
}

/// Default number of landmarks for meshes of up to `vertices` vertices: fewer if a row costs a third of a second. On
/// twelve decimated series, 20 instead of 50 increase the mean error from .007 to .010.
pub fn default_landmarks_for_vertices(vertices: usize) -> usize {
    if vertices <= LARGE { 50 } else { 20 }
}

/// Number of vertices of each mesh from which local rows start.
pub(super) const LOCAL_SAMPLES: usize = 700;
/// Width of the local kernel, relative to the mean spacing of these vertices: wide enough to even out their
/// distribution.
const LOCAL_WIDTH: f64 = 1.6;
/// The same for meshes beyond [`LARGE`] vertices, where truncated fronts cost the most.
const LARGE_WIDTH: f64 = 1.1;
/// Number of vertices above which a mesh gets fewer landmarks and a narrower kernel.
const LARGE: usize = 300_000;
/// Length of a local row, in kernel widths.
const LOCAL_REACH: f64 = 2.7;
/// Number of functions for refinement.
const FUNCTIONS: usize = 100;

/// A prepared mesh.
pub struct Side<'a> {
    /// The mesh.
    pub opened: &'a Mesh,
    /// Its vertex graph.
    pub graph: VertexGraph,
    /// Distances from its landmarks.
    pub rows: DistanceRows,
    /// Its fitted embedding.
    pub fit: OrthogonalEmbedding,
    /// Its embedded vertices (n).
    pub points: MappedSlice<Point>,
    /// The orientation of the embedded shape.
    pub tensor: Tensor,
    /// Temporary data, removed with this value.
    pub(super) work: WorkDir,
    /// The directory of graph and rows.
    _kept: WorkDir,
}

/// Facts about a mesh for the report.
#[derive(Clone, Debug, Serialize)]
pub struct SideFacts {
    /// Counts; unlike the graph's, the area is in the unit of the file.
    #[serde(flatten)]
    pub graph: VertexFacts,
    /// Landmarks, vertices of the file.
    pub landmarks: Vec<u32>,
    /// Kernel width in √area.
    pub sigma: f64,
    /// Variance of each coordinate.
    pub variance: Vec<f64>,
}

/// Matches, and facts about them.
#[derive(Debug)]
pub struct Correspondence {
    /// One match per vertex of A (n).
    pub matches: MappedSlice<Match>,
    /// The alignments found.
    pub alignments: Alignments,
    /// The refined results of the likeliest starts, best first; empty without refinement.
    pub refined: Vec<Outcome>,
    /// The chosen map as a matrix between functions; `None` without refinement.
    pub functional: Option<FunctionalMap>,
    /// Matches inside triangles (n), if requested.
    pub points: Option<MappedSlice<SurfacePoint>>,
    /// Maps from the part to the whole, best first; empty for whole meshes.
    pub partial: Vec<PartialOutcome>,
    /// Facts of A and B.
    pub sides: [SideFacts; 2],
}

impl<'a> Side<'a> {
    /// Prepares a mesh in the folder `name` of `work`. With `input`, which identifies the mesh
    /// ([`super::input::identity`]), graph and rows are kept there, and reused if they belong to the same mesh.
    ///
    /// # Errors
    /// [`Error::Parameter`], [`Error::Unusable`] for a mesh without triangles or without area, [`Error::Io`],
    /// [`Error::Memory`], [`Error::Cancelled`].
    pub fn build(
        opened: &'a Mesh,
        input: Option<&Value>,
        params: &CorrespondParams,
        name: &str,
        context: Context<'_>,
    ) -> Result<Self> {
        params.embedding.check()?;
        if !(2..=LANDMARKS_AT_MOST).contains(&params.landmarks) {
            let (problem, remedy) = (format!("{}", params.landmarks), format!("choose from 2 to {LANDMARKS_AT_MOST}"));
            return Err(Error::parameter("landmarks", problem, remedy));
        }
        let kept = WorkDir::open(&context.work.file(name))?;
        let work = WorkDir::temporary(kept.path())?;
        let context = Context::new(&kept, context.run);
        let n = opened.positions.len() as u64;
        let (path, mesh) = (opened.path(), opened.without_strays(context.run)?);
        if mesh.strays() > 0 {
            context.run.progress.note(&mesh.strays_note());
        }
        let build = || match input {
            Some(input) => VertexGraph::open_or_build(&mesh, path, input, context),
            None => Ok((VertexGraph::build(&mesh, path, context)?, String::new())),
        };
        let ((graph, key), _) = context.run.stage("vertex graph", "vertices", n, build)?;
        // All distances would be 0, or infinite in units of the square root of the area.
        if !(graph.facts.area > 0. && graph.facts.area.is_finite()) {
            let problem = "has no area: its vertices lie at one place or on a line";
            return Err(Error::unusable(path, problem, "give a surface"));
        }
        let surface = Surface::of(&graph);
        let row_params = RowParams { l: params.landmarks.min(graph.len()), sampling: params.sampling };
        // Refused before rows are computed.
        OrthogonalEmbedding::memory(row_params.l, context.run)?;
        let rows = if input.is_some() {
            vertex_rows::open_or_build(surface, row_params, params.distance, &key, context)?
        } else {
            let (landmarks, _) = context
                .run
                .stage("landmarks", "vertices", n, || vertex_rows::landmarks(surface, row_params, context))?;
            let rows = || vertex_rows::rows(surface, landmarks, params.distance, "distances.npy", context);
            context.run.stage("rows", "rows", row_params.l as u64, rows)?.0
        };
        let embed = || {
            let fit = OrthogonalEmbedding::fit(&rows, &graph.nodes, params.embedding, context.run)?;
            let points = fit.embed(&rows, fit.sigma, "embedding.npy", Context::new(&work, context.run))?;
            let tensor = Tensor::of(&mesh, &points, fit.dimensions, context.run)?;
            Ok((fit, points, tensor))
        };
        let ((fit, points, tensor), _) = context.run.stage("embedding", "vertices", n, embed)?;
        Ok(Self { opened, graph, rows, fit, points, tensor, work, _kept: kept })
    }

    /// The data for alignment.
    pub(super) fn shape(&self) -> Shape<'_> {
        Shape {
            points: &self.points,
            nodes: &self.graph.nodes,
            variance: &self.fit.variance,
            tensor: &self.tensor,
            rows: Some(&self.rows),
            unit: self.graph.unit(),
        }
    }

    /// Smooth functions on it, from `samples` vertices and a kernel of `width` times their spacing, in the file `name`.
    pub(super) fn basis(
        &self,
        samples: usize,
        width: f64,
        params: &CorrespondParams,
        name: &str,
        run: &Run,
    ) -> Result<LocalBasis> {
        const FILES: [&str; 2] = ["local_rows.npy", "local_rows_starts.npy"];
        let context = Context::new(&self.work, run);
        let surface = Surface::of(&self.graph);
        let row_params = RowParams { l: samples, sampling: Sampling::Farthest };
        let samples = vertex_rows::landmarks(surface, row_params, context)?;
        let sigma = width / (self.graph.unit() * (samples.len() as f64).sqrt());
        let limit = (LOCAL_REACH * sigma) as f32;
        let rows = LocalRows::compute(surface, samples, limit, params.distance, "local_rows", context)?;
        let count = FUNCTIONS;
        let basis = match params.refine {
            Refine::Laplacian => LocalBasis::laplacian(&rows, &self.graph, sigma, count, name, context)?,
            _ => LocalBasis::fit(&rows, &self.graph.nodes, sigma, count, name, context)?,
        };
        drop(rows);
        FILES.iter().for_each(|name| self.work.remove(name));
        Ok(basis)
    }

    /// The data for refinement, with `points` as its embedded vertices.
    fn refinable<'s>(&'s self, basis: &'s LocalBasis, points: &'s [Point]) -> Refinable<'s> {
        // Its tensor belongs to its own embedding only.
        let tensor = std::ptr::eq(points, &self.points[..]).then_some(&self.tensor);
        Refinable { basis, points, tensor, nodes: &self.graph.nodes, rows: &self.rows, unit: self.graph.unit() }
    }

    /// Its area, in squared units of the file.
    fn area(&self) -> f64 {
        self.graph.facts.area * self.graph.frame.scale * self.graph.frame.scale
    }

    pub(super) fn facts(&self) -> SideFacts {
        SideFacts {
            graph: VertexFacts { area: self.area(), ..self.graph.facts },
            landmarks: self.rows.landmarks.clone(),
            sigma: self.fit.sigma / self.graph.facts.area.sqrt(),
            variance: self.fit.variance.clone(),
        }
    }
}

impl Guidance {
    pub(super) fn check(&self, n_a: usize, n_b: usize, params: &CorrespondParams) -> Result<()> {
        let guided = !self.pairs.is_empty() || self.map.is_some() || params.points;
        if guided && params.refine == Refine::None {
            let problem = "landmarks, an initial map and matches inside triangles need refinement";
            return Err(Error::parameter("refine", problem, "leave it at its default"));
        }
        if self.pairs.iter().any(|(of_a, of_b)| *of_a as usize >= n_a || *of_b as usize >= n_b) {
            let problem = format!("name a vertex beyond the {n_a} of A or the {n_b} of B");
            return Err(Error::parameter("pairs", problem, "count vertices from 0"));
        }
        if params.partial && params.refine == Refine::None {
            let problem = "`partial` needs refinement";
            return Err(Error::parameter("refine", problem, "leave it at its default"));
        }
        let given = !self.pairs.is_empty() || self.map.is_some() || params.alternative > 0;
        if params.partial && (params.transfer || given) {
            let problem =
                "parts are matched by refinement, without `transfer`, `alternative`, landmarks or an initial map";
            return Err(Error::parameter("partial", problem, "leave these out"));
        }
        let Some(map) = &self.map else { return Ok(()) };
        if map.len() != n_a || map.iter().flatten().any(|&v| v as usize >= n_b) || map.iter().flatten().count() == 0 {
            let problem = format!("is not a map of {n_a} vertices to {n_b}");
            return Err(Error::parameter("map", problem, "give matches of the same meshes"));
        }
        Ok(())
    }
}

/// Width of the local kernel on both of `sides`.
pub(super) fn local_width(sides: [&Side<'_>; 2]) -> f64 {
    if sides.iter().any(|side| side.graph.len() > LARGE) { LARGE_WIDTH } else { LOCAL_WIDTH }
}

pub(super) fn no_alternative(asked: usize, found: usize) -> Error {
    let problem = format!("there is no alignment {asked} among {found}");
    Error::parameter("alternative", problem, "count from 0; the report lists them")
}

/// The inputs of a refinement.
#[derive(Clone, Copy)]
pub(super) struct Refinement<'a> {
    /// A and B, each with the graph whose vertices are matched: that of the original mesh.
    pub sides: [(&'a Side<'a>, &'a VertexGraph); 2],
    /// B's embedded vertices for alignment.
    pub points_b: &'a [Point],
    /// The options.
    pub params: &'a CorrespondParams,
    /// Prior knowledge.
    pub guidance: &'a Guidance,
    /// Prefix of file names.
    pub name: &'a str,
}

/// Refines all alignments, and matches vertices by the best outcome.
///
/// # Errors
/// [`Error::Parameter`] for an alternative that does not exist; [`Error::Io`], [`Error::Memory`], [`Error::Cancelled`].
pub(super) fn refined(
    refinement: Refinement<'_>,
    mut alignments: Alignments,
    context: Context<'_>,
) -> Result<Correspondence> {
    let Refinement { sides: [(a, graph_a), (b, graph_b)], points_b, params, guidance, name } = refinement;
    // The same number on both, so that the kernels have the same width.
    let samples = LOCAL_SAMPLES.min(a.graph.len()).min(b.graph.len());
    let width = local_width([a, b]);
    let basis = |side: &Side<'_>| side.basis(samples, width, params, &format!("{name}functions.npy"), context.run);
    let bases = || Ok([basis(a)?, basis(b)?]);
    let ([basis_a, basis_b], _) = context.run.stage("basis", "rows", 2 * samples as u64, bases)?;
    let sides = [a.refinable(&basis_a, &a.points), b.refinable(&basis_b, points_b)];
    let (outcomes, _) = context.run.stage("refinement", "starts", 0, || {
        let landmark_rows = |side: &Side<'_>, vertices: Vec<u32>| {
            let context = Context::new(&side.work, context.run);
            vertex_rows::rows(Surface::of(&side.graph), vertices, params.distance, "given.npy", context)
        };
        let (of_a, of_b) = guidance.pairs.iter().copied().unzip();
        let given =
            if guidance.pairs.is_empty() { None } else { Some([landmark_rows(a, of_a)?, landmark_rows(b, of_b)?]) };
        let rows = given.as_ref().map(|rows| rows.each_ref());
        let prior = Prior { pairs: &guidance.pairs, rows, map: guidance.map.as_deref() };
        refine(sides, &alignments.starts, prior, context.run)
    })?;
    let found = rivals(&outcomes, sides[1]);
    let begun = |one: &Outcome| match one.start {
        Start::Alignment(at) => {
            let start = alignments.starts[at].clone();
            Alignment { orientation: one.orientation.unwrap_or(start.orientation), ..start }
        }
        // Provided by the user and taken as correct.
        Start::Landmarks | Start::Map => Alignment {
            transform: DMatrix::identity(1, 1),
            cost: 0.,
            transport: None,
            distortion: Some(one.distortion),
            orientation: 1.,
        },
    };
    alignments.found = found.iter().map(begun).collect();
    let is_conclusive = alignments.found.first().is_some_and(|best| best.orientation >= CONCLUSIVE_ORIENTATION);
    alignments.ambiguous = found.len() > 1 || !is_conclusive;
    let outcome = found.get(params.alternative).ok_or_else(|| no_alternative(params.alternative, found.len()))?;
    let map = refit(sides, &outcome.map, &guidance.pairs, context.run);
    let make = || {
        let k = map.nrows();
        let first = |basis: LocalBasis, graph: &VertexGraph, side: &Side<'_>| {
            basis.first(graph.len(), &format!("{name}first_functions.npy"), Context::new(&side.work, context.run))
        };
        let (basis_a, basis_b) = (first(basis_a, graph_a, a)?, first(basis_b, graph_b, b)?);
        let in_a = transformed(&basis_b, &map, "transformed.npy", Context::new(&b.work, context.run))?;
        let coordinates = [(&basis_a.values[..], basis_a.count), (&in_a[..], k)];
        let pair = RefinedPair::new(coordinates, k, [graph_a, graph_b], EXHAUSTIVE, context)?;
        let found = matches(&pair, params.matching, &format!("{name}matches.npy"), context)?;
        let points = params.points.then(|| pair.points(&found, &format!("{name}points.npy"), context)).transpose()?;
        Ok((found, points, FunctionalMap { map, bases: [basis_a, basis_b] }))
    };
    let ((matches, points, functional), _) = context.run.stage("match", "vertices", graph_a.len() as u64, make)?;
    Ok(Correspondence {
        matches,
        alignments,
        refined: outcomes,
        functional: Some(functional),
        points,
        partial: Vec::new(),
        sides: [a.facts(), b.facts()],
    })
}
