//! `correspond`: from two mesh files to matches.
//!
//! Each mesh is prepared ([`super::sides`]); then the embeddings are aligned and vertices matched, with or without
//! refinement. Partial correspondence is separate ([`super::partial`]). Everything of the size of a mesh is a mapped
//! file; only the queues of fronts and, without refinement, two search trees are allocated: at most 60 bytes per vertex
//! for both, and no more than 2²¹ vertices each.

use super::partial::match_partial;
pub use super::sides::{
    CorrespondParams, Correspondence, FunctionalMap, Guidance, Side, SideFacts, default_landmarks_for_vertices,
};
use super::sides::{Refinement, no_alternative, refined};
use super::subdivided::SubdividedMesh;
use super::used_vertices::UsedVerticesOfTwo;
use crate::apps::correspond::align::{FINE, procrustes, sample};
use crate::apps::correspond::matches::{AlignedPair, Match, Matching, matches};
use crate::apps::correspond::refine::Refine;
use crate::apps::correspond::{Alignment, EmbeddingSearch, align};
use crate::base::{Result, RunLog};
use crate::distance::march::Surface;
use crate::distance::vertex_rows;
use crate::mesh::Mesh;
use crate::spectral::nystrom::{OrthogonalEmbedding, Point};
use crate::store::{Context, MappedSlice, Run, WorkDir};
use serde_json::{Value, json};
use std::path::Path;

/// Matches the vertices of `a` with those of `b`; `inputs` as in [`Side::build`].
///
/// ```
/// use nystrom_stream::apps::creature::{Creature, Options};
/// use nystrom_stream::mesh;
/// use nystrom_stream::pipeline::correspond::{CorrespondParams, correspond};
/// use nystrom_stream::store::{Context, Run, WorkDir};
/// let (work, run) = (WorkDir::temporary(&std::env::temp_dir())?, Run::new(&()));
/// let path = work.file("creature.ply");
/// Creature::new(&Options { faces: 3_528, ..Options::default() })?.write_ply(&path, &run)?;
/// let (a, b) = (mesh::open(&path, work.path(), &run)?, mesh::open(&path, work.path(), &run)?);
/// let params = CorrespondParams::default().landmarks(12);
/// let found = correspond(&a, &b, None, &params, Context::new(&work, &run))?;
/// // With refinement, a vertex may be matched with a neighbour of its own.
/// let own = found.matches.iter().enumerate().filter(|(v, one)| one.vertex() == Some(*v as u32)).count();
/// assert!(own * 100 > 99 * found.matches.len());
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
///
/// # Errors
/// As [`Side::build`].
pub fn correspond(
    a: &Mesh,
    b: &Mesh,
    inputs: Option<&[Value; 2]>,
    params: &CorrespondParams,
    context: Context<'_>,
) -> Result<Correspondence> {
    correspond_guided(a, b, inputs, params, &Guidance::default(), context)
}

/// The same, given prior knowledge of the map.
///
/// # Errors
/// As [`Side::build`]; [`crate::base::Error::Parameter`] for guidance without refinement, or for vertices that do not
/// exist.
pub fn correspond_guided(
    a: &Mesh,
    b: &Mesh,
    inputs: Option<&[Value; 2]>,
    params: &CorrespondParams,
    guidance: &Guidance,
    context: Context<'_>,
) -> Result<Correspondence> {
    guidance.check(a.positions.len(), b.positions.len(), params)?;
    // A kept directory keeps only the graphs and rows of both meshes.
    let passing = WorkDir::temporary(context.work.path())?;
    let within = Context::new(&passing, context.run);
    let used = UsedVerticesOfTwo::of([a, b], within)?;
    let [a, b] = used.meshes([a, b]);
    let guidance = used.guidance(guidance)?;
    guidance.check(a.positions.len(), b.positions.len(), params)?;
    let side = |opened, k: usize, name| Side::build(opened, inputs.map(|inputs| &inputs[k]), params, name, context);
    let (a, b) = (side(a, 0, "a")?, side(b, 1, "b")?);
    used.in_file_numbering(match_sides(&a, &b, params, &guidance, within)?, within)
}

impl Correspondence {
    /// The report on the matches of the meshes at `paths` under `params`, with the seconds and notes in `log`.
    pub fn report(&self, paths: [&Path; 2], params: &CorrespondParams, run: &Run, log: &RunLog) -> Value {
        let matched = self.matches.iter().filter(|one| one.target >= 0);
        let (count, sum) = matched.fold((0u64, 0f64), |(n, sum), one| (n + 1, sum + f64::from(one.confidence)));
        json!({
            "a": paths[0].display().to_string(),
            "b": paths[1].display().to_string(),
            "options": params,
            "seed": run.seed,
            "meshes": self.sides,
            "ambiguous": self.alignments.ambiguous,
            "alignments": self.alignments.found,
            "refined": self.refined,
            "partial": self.partial,
            "alternative": params.alternative,
            "matched": count,
            "unmatched": self.matches.len() as u64 - count,
            "mean_confidence": if count > 0 { sum / count as f64 } else { 0. },
            "seconds": log.seconds(),
            "notes": log.notes(),
        })
    }
}

/// Matches prepared meshes with the same parameters.
///
/// # Errors
/// As [`Side::build`].
pub fn match_sides(
    a: &Side<'_>,
    b: &Side<'_>,
    params: &CorrespondParams,
    guidance: &Guidance,
    context: Context<'_>,
) -> Result<Correspondence> {
    if params.partial {
        return match_partial(a, b, params, context);
    }
    let aligned = |a: &Side<'_>, b: &Side<'_>| {
        context
            .run
            .stage("alignment", "guesses", 0, || align(a.shape(), b.shape(), context.run))
            .map(|(found, _)| found)
    };
    if params.refine != Refine::None && !params.transfer {
        let finer = [SubdividedMesh::of(a, context.run)?, SubdividedMesh::of(b, context.run)?];
        let [of_a, of_b] = &finer;
        let fine_a = of_a.as_ref().map(|finer| finer.side(a, params, context.run)).transpose()?;
        let fine_b = of_b.as_ref().map(|finer| finer.side(b, params, context.run)).transpose()?;
        let (fine_a, fine_b) = (fine_a.as_ref().unwrap_or(a), fine_b.as_ref().unwrap_or(b));
        let mut alignments = aligned(fine_a, fine_b)?;
        let mut guidance = guidance.clone();
        if let Some(map) = &mut guidance.map {
            alignments.starts.clear();
            if let Some(finer) = of_a {
                *map = finer.extended(map);
            }
        }
        let sides = [(fine_a, &a.graph), (fine_b, &b.graph)];
        let refinement = Refinement { sides, points_b: &fine_b.points, params, guidance: &guidance, name: "" };
        let found = refined(refinement, alignments, context)?;
        return Ok(Correspondence { sides: [a.facts(), b.facts()], ..found });
    }
    let mut alignments = aligned(a, b)?;
    let taken = |found: &[Alignment]| {
        found.get(params.alternative).cloned().ok_or_else(|| no_alternative(params.alternative, found.len()))
    };
    let alignment = taken(&alignments.found)?;
    let matching = if params.transfer { Matching::All } else { params.matching };
    let pass = |points_b: &[Point], alignment: &Alignment, matching, name: &str| {
        let make = || {
            let dimensions = alignment.transform.nrows();
            let in_b = EmbeddingSearch::new(points_b, b.graph.csr(), dimensions, Context::new(&b.work, context.run))?;
            let in_a = EmbeddingSearch::new(&a.points, a.graph.csr(), dimensions, Context::new(&a.work, context.run))?;
            let (graph_a, graph_b, in_a, in_b) = (&a.graph, &b.graph, &in_a, &in_b);
            let pair = AlignedPair { a: &a.points, b: points_b, graph_a, graph_b, alignment, in_b, in_a };
            matches(&pair, matching, name, context)
        };
        context.run.stage("match", "vertices", a.points.len() as u64, make).map(|(matches, _)| matches)
    };
    let mut found = pass(&b.points, &alignment, matching, "matches.npy")?;
    if params.transfer {
        let (points_b, alignment) = transferred(a, b, &found, params, context.run)?;
        if params.refine != Refine::None {
            // The choice among the first alignments is made, unless the map of the user takes their place.
            let chosen = guidance.map.is_none().then(|| (alignments.found.clone(), alignments.ambiguous));
            alignments.starts = if chosen.is_some() { vec![alignment] } else { Vec::new() };
            let params = &if chosen.is_some() { params.alternative(0) } else { *params };
            let sides = [(a, &a.graph), (b, &b.graph)];
            let refinement = Refinement { sides, points_b: &points_b, params, guidance, name: "" };
            let mut result = refined(refinement, alignments, context)?;
            if let Some((found, ambiguous)) = chosen.filter(|_| guidance.pairs.is_empty()) {
                result.alignments.found = found;
                result.alignments.ambiguous |= ambiguous;
            }
            return Ok(result);
        }
        found = pass(&points_b, &alignment, params.matching, "matches.npy")?;
    }
    let sides = [a.facts(), b.facts()];
    Ok(Correspondence {
        matches: found,
        alignments,
        refined: Vec::new(),
        functional: None,
        points: None,
        partial: Vec::new(),
        sides,
    })
}

/// B embedded by the images of A's landmarks and A's own map: the only alignment error left is that of the images.
fn transferred(
    a: &Side<'_>,
    b: &Side<'_>,
    found: &[Match],
    params: &CorrespondParams,
    run: &Run,
) -> Result<(MappedSlice<Point>, Alignment)> {
    let landmarks = a.rows.landmarks.iter().map(|&v| found[v as usize].vertex().unwrap_or(0)).collect();
    let surface = Surface::of(&b.graph);
    let rows = || vertex_rows::rows(surface, landmarks, params.distance, "transferred.npy", Context::new(&b.work, run));
    let (rows, _) = run.stage("rows", "rows", a.rows.len() as u64, rows)?;
    let sigma = OrthogonalEmbedding::width_on(&rows, &b.graph.nodes, params.embedding.width);
    let points = a.fit.embed(&rows, sigma, "transferred_embedding.npy", Context::new(&b.work, run))?;
    let k = a.fit.dimensions;
    let pairs = sample(&a.graph.nodes, 8 * FINE, run.seed, "transferred points");
    let pairs =
        pairs.iter().filter_map(|&v| Some((a.points[v as usize], points[found[v as usize].vertex()? as usize])));
    let transform = procrustes(pairs, k);
    Ok((points, Alignment { transform, cost: 0., transport: None, distortion: None, orientation: 1. }))
}
