//! Partial correspondence: matches a part with a whole.
//!
//! The mesh with less area is the part. Both must have the same scale, as lengths of the files are compared. First
//! matches come from distances between far points ([`crate::apps::correspond::partial`]). The region of the whole that
//! they cover, with as much area as the part, is cut out ([`Region`]) and matched with the part like two wholes,
//! starting from alignments and from the first matches: with the same boundary, both have nearly the same functions. Of
//! the likeliest first maps, the one whose region fits best is taken, and its region is cut out again from its matches
//! as long as the fit improves.
//!
//! Vertices outside the region have no match, nor do those whose confidence is below [`LEAST`].
//!
//! Cost: that of two wholes up to [`FINALISTS`] + [`ROUNDS`] times, and one row per candidate of the first matches.
//! Region and maps are in memory: the budget grants [`REGION`] bytes per vertex of the whole and [`MAPS`] per vertex of
//! the part.

use super::sides::{
    CorrespondParams, Correspondence, FunctionalMap, Guidance, LOCAL_SAMPLES, Refinement, Side, local_width, refined,
};
use crate::apps::correspond::align::{CONCLUSIVE_ORIENTATION, align};
use crate::apps::correspond::dense::{EXHAUSTIVE, RefinedPair, transformed};
use crate::apps::correspond::matches::{Match, Matching, matches};
use crate::apps::correspond::partial::{ANCHORS, CANDIDATES, PartialOutcome, PartialSide, match_part};
use crate::apps::correspond::refine::{Outcome, mean_apart};
use crate::apps::correspond::{Alignments, SurfacePoint};
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::union_find::Forest;
use crate::base::{Error, Result};
use crate::distance::march::Surface;
use crate::distance::rows::RowParams;
use crate::distance::vertex_rows;
use crate::graph::VertexGraph;
use crate::graph::vertex_graph::triangles;
use crate::landmarks::Sampling;
use crate::mesh::Mesh;
use crate::spectral::exp::exp64;
use crate::spectral::local::LocalBasis;
use crate::store::{Context, MappedSlice, Run};

/// Confidence below which a vertex has no match.
pub const LEAST: f32 = 0.05;
/// Minimum number of vertices of a part for which functions are computed; the matches of fewer are wrong.
const FEWEST: usize = 60;
/// Number of first maps whose regions are compared.
const FINALISTS: usize = 3;
/// Another first map is an alternative if its rank is at most this many times the best.
const RIVAL: f64 = 1.5;
/// Minimum mean distance between the images of two maps, over √area of the whole, for them to be different.
const APART: f64 = 0.1;
/// Diffusion time with which the area of a part is spread on the whole, in units of 1 / the highest frequency.
const SPREAD: f64 = 2.;
/// Vertices per chunk.
const CHUNK: usize = 1 << 14;
/// Number of vertices by which two maps are compared.
const COMPARED: usize = 200;
/// Maximum number of times that the region of the best is cut out again, as long as the fit improves.
const ROUNDS: usize = 4;
/// Components with a smaller share of the region's triangles are dropped.
const SMALL_COMPONENT: f64 = 0.02;

/// Bytes per vertex of the whole: flags, pieces and their sizes, numbers, two faces and a position.
const REGION: u64 = 72;
/// Bytes per vertex of the part: first maps, the best, the last, and matches on their way into the file.
const MAPS: u64 = 8 * (FINALISTS as u64 + 2) + 40;

/// For each vertex of the part, its image on the whole.
type Images = Vec<Option<u32>>;

/// The region of a whole that a part covers.
struct Region {
    mesh: Mesh,
    /// Its vertices in the whole.
    old: Vec<u32>,
}

/// A region matched with the part.
struct Candidate {
    /// Its vertices in the whole.
    old: Vec<u32>,
    graph: VertexGraph,
    functional: FunctionalMap,
    outcomes: Vec<Outcome>,
    alignments: Alignments,
    images: Images,
}

impl Candidate {
    /// How well region and part fit; lower is better. The change of area is left out: it varies randomly from region to
    /// region.
    fn rank(&self) -> f64 {
        self.outcomes.first().map_or(f64::INFINITY, |best| best.distortion * best.residual)
    }
}

impl Region {
    /// The vertices of `whole` most covered by `images` of `part`, as many as have the area `share` of it. The area of
    /// the part is transferred to its images and smoothed by heat diffusion in the functions `basis` of the whole, so
    /// that gaps between images are not holes and a few stray images do not count.
    fn covered(
        [part, whole]: [&Side<'_>; 2],
        basis: &LocalBasis,
        images: &Images,
        share: f64,
        run: &Run,
    ) -> Result<Self> {
        let graph = &whole.graph;
        let mut factors = vec![0f64; basis.count];
        for (node, image) in part.graph.nodes.iter().zip(images) {
            let Some(w) = *image else { continue };
            factors
                .iter_mut()
                .zip(basis.at(w as usize))
                .for_each(|(sum, x)| *sum += f64::from(node.area) * f64::from(*x));
        }
        let highest = basis.frequencies.last().copied().unwrap_or(1.).max(1e-300);
        let damp = |(factor, frequency): (&mut f64, &f64)| *factor *= exp64(-SPREAD * frequency / highest);
        factors.iter_mut().zip(&basis.frequencies).for_each(damp);
        let at =
            |v: usize| factors.iter().zip(basis.at(v)).map(|(factor, x)| factor * f64::from(*x)).sum::<f64>() as f32;
        let chunk = |k: usize, (): &mut ()| Ok(chunk_range(graph.len(), CHUNK, k).map(at).collect::<Vec<f32>>());
        let cover = run.map_chunks(chunk_count(graph.len(), CHUNK), || (), chunk)?.concat();
        let mut order: Vec<u32> = (0..cover.len() as u32).collect();
        order.sort_unstable_by(|&v, &w| cover[w as usize].total_cmp(&cover[v as usize]).then(v.cmp(&w)));
        let (mut taken, most) = (0., share * graph.facts.area);
        let mut inside = vec![false; cover.len()];
        for &v in &order {
            if taken >= most {
                break;
            }
            taken += f64::from(graph.nodes[v as usize].area);
            inside[v as usize] = true;
        }
        drop((order, cover));
        Self::of(whole.opened, inside)?.ok_or_else(|| {
            let problem =
                format!("covers no triangle of {}, which it is to be a part of", whole.opened.path().display());
            Error::unusable(part.opened.path(), problem, "scale both meshes alike, or give a larger part")
        })
    }

    /// The triangles of `mesh` whose corners are all `inside`, without crumbs; `None` if there are none.
    fn of(mesh: &Mesh, mut inside: Vec<bool>) -> Result<Option<Self>> {
        let mut faces: Vec<[u32; 3]> = Vec::new();
        mesh.faces.for_each(0..mesh.faces.len(), |_, corners| {
            triangles(mesh, corners, |face, _| {
                if face.iter().all(|&v| inside[v as usize]) {
                    faces.push(face);
                }
            });
        });
        if faces.is_empty() {
            return Ok(None);
        }
        // Components, identified by their least vertex.
        let mut pieces = Forest::new(inside.len());
        for &[a, b, c] in &faces {
            pieces.join(a, b);
            pieces.join(a, c);
        }
        let mut counts = vec![0u32; inside.len()];
        faces.iter().for_each(|face| counts[pieces.find(face[0]) as usize] += 1);
        let least = (SMALL_COMPONENT * faces.len() as f64) as u32;
        faces.retain(|face| counts[pieces.find(face[0]) as usize] > least);
        drop((counts, pieces));
        faces.shrink_to_fit();
        inside.fill(false);
        faces.iter().flatten().for_each(|&v| inside[v as usize] = true);
        let old: Vec<u32> = (0..inside.len() as u32).filter(|&v| inside[v as usize]).collect();
        let mut new = vec![0u32; inside.len()];
        old.iter().enumerate().for_each(|(at, &v)| new[v as usize] = at as u32);
        faces.iter_mut().flatten().for_each(|v| *v = new[*v as usize]);
        let positions = old.iter().map(|&v| mesh.positions.get(v)).collect();
        Ok(Some(Self { mesh: Mesh::from_vecs::<f64>(positions, faces)?, old }))
    }

    /// Matches `part` with it, starting from the first matches `images`.
    fn matched(
        self,
        part: &Side<'_>,
        images: &Images,
        params: &CorrespondParams,
        name: &str,
        context: Context<'_>,
    ) -> Result<Candidate> {
        let Self { mesh, old } = self;
        let side = Side::build(&mesh, None, params, name, context)?;
        let (alignments, _) =
            context.run.stage("alignment", "guesses", 0, || align(part.shape(), side.shape(), context.run))?;
        let here = |v: &u32| old.binary_search(v).ok().map(|at| at as u32);
        let map: Images = images.iter().map(|image| image.as_ref().and_then(here)).collect();
        let map = map.iter().any(Option::is_some).then_some(map);
        let guidance = Guidance { map, ..Guidance::default() };
        let sides = [(part, &part.graph), (&side, &side.graph)];
        let refinement = Refinement { sides, points_b: &side.points, params, guidance: &guidance, name };
        let found = refined(refinement, alignments, context)?;
        let images = found.matches.iter().map(|one| one.vertex().map(|at| old[at as usize])).collect();
        let Correspondence { functional, refined: outcomes, alignments, .. } = found;
        let functional = functional.filter(|_| !outcomes.is_empty());
        let functional = functional.ok_or_else(|| Error::internal("a refined map without functions"))?;
        Ok(Candidate { old, graph: side.graph, functional, outcomes, alignments, images })
    }
}

/// The scales of both meshes over a common power of two. Of lengths in the files only ratios matter, and these stay
/// exact; but squares of lengths beyond 10^154 or below 10^−162 would be infinite or 0.
fn scales(sides: [&Side<'_>; 2]) -> [f64; 2] {
    let scales = sides.map(|side| side.graph.frame.scale);
    let (_, exponent) = libm::frexp(scales[0].max(scales[1]));
    scales.map(|scale| libm::ldexp(scale, -exponent))
}

/// The areas of both meshes in the unit of [`scales`].
fn areas(sides: [&Side<'_>; 2]) -> [f64; 2] {
    let scales = scales(sides);
    [0, 1].map(|s| sides[s].graph.facts.area * scales[s] * scales[s])
}

/// Matches A with B, one of which is a part of the other.
///
/// # Errors
/// As [`super::correspond::correspond`].
pub(super) fn match_partial(
    a: &Side<'_>,
    b: &Side<'_>,
    params: &CorrespondParams,
    context: Context<'_>,
) -> Result<Correspondence> {
    let areas = areas([a, b]);
    let a_is_part = areas[0] <= areas[1];
    let [part, whole] = if a_is_part { [a, b] } else { [b, a] };
    let share = areas[0].min(areas[1]) / areas[0].max(areas[1]).max(1e-300);
    let bytes = REGION * whole.graph.len() as u64 + MAPS * part.graph.len() as u64;
    let _grant = context.run.budget.take("regions of the whole", bytes, bytes)?;
    let (starts, images, basis) = first_maps(part, whole, share, params, context)?;
    let all = params.matching(Matching::All).points(false);
    let mut best: Option<Candidate> = None;
    let mut tried: Vec<(f64, Images)> = Vec::new();
    let mut attempt = |best: &mut Option<Candidate>, images: &Images| -> Result<()> {
        let region = Region::covered([part, whole], &basis, images, share, context.run)?;
        let found = region.matched(part, images, &all, &format!("region-{}", tried.len()), context)?;
        tried.push((found.rank(), compared(&found.images)));
        if best.as_ref().is_none_or(|best| found.rank() < best.rank()) {
            *best = Some(found);
        }
        Ok(())
    };
    for images in &images {
        attempt(&mut best, images)?;
    }
    for _ in 0..ROUNDS {
        let images = best.as_ref().map(|best| best.images.clone());
        let rank = best.as_ref().map(Candidate::rank);
        images.map_or(Ok(()), |images| attempt(&mut best, &images))?;
        if best.as_ref().map(Candidate::rank) == rank {
            break;
        }
    }
    let mut best = best.ok_or_else(|| Error::internal("a part without a first map"))?;
    let rival = |(rank, images): &(f64, Images)| {
        *rank <= RIVAL * best.rank() && apart(whole, &compared(&best.images), images) > APART
    };
    best.alignments.ambiguous =
        best.outcomes[0].orientation.is_none_or(|one| one < CONCLUSIVE_ORIENTATION) || tried.iter().any(rival);
    let (matches, points) = finish(&best, [part, whole], a_is_part, params, context)?;
    if let Some(note) = note([part, whole], &matches) {
        context.run.progress.note(&note);
    }
    Ok(Correspondence {
        matches,
        alignments: best.alignments,
        refined: best.outcomes,
        functional: None,
        points,
        partial: starts,
        sides: [a.facts(), b.facts()],
    })
}

/// The note about a part that is too coarse to be found in the whole, or of which nothing was found there.
fn note([part, whole]: [&Side<'_>; 2], matches: &[Match]) -> Option<String> {
    let [part_path, whole_path] = [part, whole].map(|side| side.opened.path().display());
    let n = part.graph.len();
    if n < FEWEST {
        let result = "it gets no matches, or wrong ones; give a finer mesh or a larger part";
        return Some(format!("{part_path}: {n} vertices are too few to find it in {whole_path}: {result}"));
    }
    let reason = "it is too small or too coarse to be found there, or has another scale";
    let none = matches.iter().all(|one| one.vertex().is_none());
    none.then(|| format!("{part_path}: no reliable match with {whole_path}: {reason}"))
}

/// A subset of the images, for comparing two maps.
fn compared(images: &Images) -> Images {
    images.iter().step_by(images.len().div_ceil(COMPARED).max(1)).copied().collect()
}

/// [`mean_apart`] of two maps to `whole` at the [`compared`] images.
fn apart(whole: &Side<'_>, one: &Images, other: &Images) -> f64 {
    let pairs = one.iter().zip(other).filter_map(|(v, w)| Some(((*v)?, (*w)?)));
    mean_apart(pairs, &whole.rows, whole.graph.unit())
}

/// Maps of `part` to `whole` by distances between far points, the likeliest first, the matches of the first of them,
/// and functions on the whole.
fn first_maps(
    part: &Side<'_>,
    whole: &Side<'_>,
    share: f64,
    params: &CorrespondParams,
    context: Context<'_>,
) -> Result<(Vec<PartialOutcome>, Vec<Images>, LocalBasis)> {
    let sides = [part, whole];
    let root = areas(sides)[1].sqrt().max(1e-300);
    let units = scales(sides).map(|scale| scale / root);
    let width = local_width(sides);
    let of_whole = LOCAL_SAMPLES.min(whole.graph.len());
    let of_part = (of_whole as f64 * share).round() as usize;
    let of_part = of_part.max(FEWEST).min(part.graph.len());
    let basis = |side: &Side<'_>, count| side.basis(count, width, params, "first.npy", context.run);
    let bases = || Ok([basis(part, of_part)?, basis(whole, of_whole)?]);
    let (bases, _) = context.run.stage("basis", "rows", (of_part + of_whole) as u64, bases)?;
    let anchored = |side: &Side<'_>, count: usize| {
        let (surface, context) = (Surface::of(&side.graph), Context::new(&side.work, context.run));
        let row_params = RowParams { l: count.min(side.graph.len()), sampling: Sampling::Farthest };
        let chosen = vertex_rows::landmarks(surface, row_params, context)?;
        vertex_rows::rows(surface, chosen, params.distance, "anchors.npy", context)
    };
    let anchors = ANCHORS.min(part.graph.len()) + CANDIDATES.min(whole.graph.len());
    let rows = || Ok([anchored(part, ANCHORS)?, anchored(whole, CANDIDATES)?]);
    let (rows, _) = context.run.stage("rows", "rows", anchors as u64, rows)?;
    let seen = [0, 1].map(|s| PartialSide { graph: &sides[s].graph, basis: &bases[s], rows: &rows[s], unit: units[s] });
    let starts = || match_part(seen[0], seen[1], context.run);
    let (starts, _) = context.run.stage("refinement", "starts", 0, starts)?;
    let dense = |start: &PartialOutcome| -> Result<Images> {
        let kept = || start.images.iter().enumerate().filter_map(|(i, image)| Some((i, (*image)?)));
        let k = kept().count();
        if k == 0 {
            return Ok(vec![None; part.graph.len()]);
        }
        // Distances from anchors and from their images.
        let placed = |s: usize| {
            let row = |(i, c): (usize, u32)| rows[s].row(if s == 0 { i } else { c as usize });
            let (kept, unit) = (kept().map(row).collect::<Vec<_>>(), units[s] as f32);
            let mut array = sides[s].work.array::<f32>("anchored.npy", &[sides[s].graph.len(), k])?;
            context.run.fill_each(array.data(), CHUNK, |at, _: f32| unit * kept[at % k][at / k])?;
            array.finish(false)
        };
        let (of_part, of_whole) = (placed(0)?, placed(1)?);
        let coordinates = [(&of_part[..], k), (&of_whole[..], k)];
        let pair =
            RefinedPair::new(coordinates, k, [&part.graph, &whole.graph], EXHAUSTIVE, context)?.with_units(units);
        let found = matches(&pair, Matching::All, "first_matches.npy", context)?;
        Ok(found.iter().map(Match::vertex).collect())
    };
    let finalists = || starts.iter().take(FINALISTS);
    let matched = finalists().filter(|start| start.images.iter().any(Option::is_some)).count() * part.graph.len();
    let images = || finalists().map(dense).collect::<Result<Vec<_>>>();
    let (images, _) = context.run.stage("match", "vertices", matched as u64, images)?;
    let [_, of_whole] = bases;
    Ok((starts, images, of_whole))
}

/// The matches of A, which is the part or the whole, and those inside triangles if requested.
fn finish(
    best: &Candidate,
    [part, whole]: [&Side<'_>; 2],
    a_is_part: bool,
    params: &CorrespondParams,
    context: Context<'_>,
) -> Result<(MappedSlice<Match>, Option<MappedSlice<SurfacePoint>>)> {
    let Candidate { old, graph, functional, .. } = best;
    let k = functional.map.nrows();
    let [of_part, of_region] = &functional.bases;
    // In vertices of the part.
    let in_part = transformed(of_region, &functional.map, "transformed.npy", Context::new(&whole.work, context.run))?;
    let mut coordinates = [(&of_part.values[..], of_part.count), (&in_part[..], k)];
    let mut graphs = [&part.graph, graph];
    if !a_is_part {
        coordinates.reverse();
        graphs.reverse();
    }
    let n = if a_is_part { part.graph.len() } else { whole.graph.len() };
    let make = || {
        let pair = RefinedPair::new(coordinates, k, graphs, EXHAUSTIVE, context)?;
        let mut found = matches(&pair, params.matching, "inner_matches.npy", context)?.to_vec();
        for one in &mut found {
            if one.confidence < LEAST {
                *one = Match { confidence: one.confidence, ..Match::NONE };
            }
        }
        let points = params.points.then(|| pair.points(&found, "inner_points.npy", context)).transpose()?;
        let mut points = points.map(|points| points.to_vec());
        if a_is_part {
            let outer = |v: i64| usize::try_from(v).map_or(-1, |at| i64::from(old[at]));
            found.iter_mut().for_each(|one| one.target = outer(one.target));
            let corners = points.iter_mut().flatten().flat_map(|point| &mut point.corners);
            corners.for_each(|corner| *corner = outer(i64::from(*corner)) as i32);
        }
        // Vertices of the whole outside the region have none.
        let at = |v: usize| if a_is_part { Some(v) } else { old.binary_search(&(v as u32)).ok() };
        let mut array = context.work.array::<Match>("matches.npy", &[n])?;
        context.run.fill_each(array.data(), CHUNK, |v, _: Match| at(v).map_or(Match::NONE, |at| found[at]))?;
        let inside = |points: Vec<SurfacePoint>| {
            let mut array = context.work.array::<SurfacePoint>("points.npy", &[n])?;
            let one = |v: usize, _: SurfacePoint| at(v).map_or(SurfacePoint::NONE, |at| points[at]);
            context.run.fill_each(array.data(), CHUNK, one)?;
            array.finish(false)
        };
        Ok((array.finish(false)?, points.map(inside).transpose()?))
    };
    Ok(context.run.stage("match", "vertices", n as u64, make)?.0)
}
