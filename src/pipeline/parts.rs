//! The default method: parts as people would cut them.
//!
//! Everything of the size of the mesh is computed here once, out of core: area shares, smoothed normals, weights, rows,
//! cells. Then the parts are decided on cells, in constant time, as a whole tree of answers, and one more front moves
//! their boundaries onto creases. Another number of parts needs only the last step. If there are more parts than cells,
//! they are pieces of cells.

use super::contracted::{contraction_and_shares, faces_of, units_of, weighted};
use super::decision::{DecisionFacts, DecisionStage, decision_key, discard};
use super::edits::{Corrections, OnCells, PartMarks};
use super::labels::{self, Clustered, LABELS, SegmentStats};
use super::params::{Boundaries, SegmentParams, TinyComponents, Walls, grant_parts, landmarks_on_contraction};
use super::surface::{Kind, PreparedSurface, SurfaceStage, WeightedSurface};
use super::units::Units;
use crate::base::printable::counted;
use crate::base::{Error, Result};
use crate::cluster::area_shares::AreaShares;
use crate::cluster::boundary::{self, BoundaryMethod, BoundarySurface, CellLabels, RefinedLabels};
use crate::cluster::divide::divide;
use crate::cluster::extrapolate::LocalPartMeans;
use crate::cluster::part_totals::PartTotals;
use crate::cluster::parts::cell_labels::joined_pieces;
use crate::cluster::parts::hierarchy::TreeCut;
use crate::cluster::parts::{self, PartCount, PartDecision, PartTree, PartsParams, PartsResult};
use crate::distance::DistanceRows;
use crate::graph::frame::NO_AREA;
use crate::graph::{DualGraph, NodeOrder};
use crate::landmarks::Sampling;
use crate::store::{Context, MappedSlice};
use std::collections::{BTreeMap, BTreeSet};

const CHUNK: usize = 1 << 15;
/// Temporary labels for locating edits.
const SEEN: &str = "seen.tmp";

/// What determines the parts besides the options.
#[derive(Clone, Copy, Default)]
pub(super) struct PartRequests<'a> {
    /// A hierarchy to use instead of the computed one.
    pub tree: Option<&'a PartTree>,
    /// A person's corrections.
    pub corrections: Corrections<'a>,
}

/// [`PartRequests`] together with the mapping from their places to cells.
#[derive(Clone, Copy)]
struct Located<'a> {
    requests: PartRequests<'a>,
    /// The nodes at the places of each edit.
    nodes: &'a [Vec<u32>],
    order: &'a NodeOrder,
    /// The mesh itself, and its work directory.
    whole: BoundarySurface<'a>,
    context: Context<'a>,
    /// The contracted node of each node, if there is a contraction.
    units: Option<&'a [u16]>,
}

impl Located<'_> {
    /// Passes to `look` the part of each node (n) under the cell labels `label`, after refinement of boundaries.
    /// `cells` is the cell of each node, or contracted node.
    fn seen(&self, cells: &[u16], label: &[u32], look: &mut dyn FnMut(&[u32])) -> Result<()> {
        let of_units: Vec<u32>;
        let cells = match self.units {
            Some(of_node) => {
                of_units = cells.iter().map(|&cell| label[cell as usize]).collect();
                CellLabels { of_node, label: &of_units, further: &[], at_boundary: None }
            }
            None => CellLabels { of_node: cells, label, further: &[], at_boundary: None },
        };
        // A separate file, so that existing labels stay if an edit is rejected.
        let _scratch = self.context.work.scratch(&[SEEN]);
        let method = BoundaryMethod::Front;
        let RefinedLabels { labels, .. } = boundary::refine(self.whole, cells, method, SEEN, self.context)?;
        look(&labels);
        Ok(())
    }

    /// `cut` with the corrections applied: a cut of the decision `all` on the cells of `surface`, for the options
    /// `asked`. `walls` (S) have a label of their own, so no edit may be on them.
    fn corrected(
        &self,
        surface: &PreparedSurface,
        all: &PartDecision,
        walls: Option<&[bool]>,
        asked: (PartCount, f64),
        cut: TreeCut,
    ) -> Result<(TreeCut, PartMarks)> {
        let cells = surface.cells()?;
        let graph = cells.graph.cleaned()?;
        let unit = |node: u32| self.units.map_or(node, |units| units[node as usize].into());
        let on_cells = OnCells {
            nodes: self.nodes,
            order: self.order,
            cell: &|node| cells.of_node[unit(node) as usize].into(),
            seen: &|label, look| self.seen(&cells.of_node, label, look),
            affinities: all.affinities(&graph),
            tree: &all.tree,
        };
        let corrections = self.requests.corrections;
        if let Some(walls) = walls {
            corrections.refuse_own(self.nodes, "walls", |node| walls[(on_cells.cell)(node) as usize])?;
        }
        corrections.apply(on_cells, asked, cut)
    }
}

/// Cuts the mesh of `graph`, whose nodes are in `order`; `nodes` are those at the places of each edit.
pub(super) fn parts(
    graph: &DualGraph,
    (order, nodes): (&NodeOrder, &[Vec<u32>]),
    params: &SegmentParams,
    requests: PartRequests<'_>,
    context: Context<'_>,
) -> Result<Clustered> {
    let n = graph.nodes.len();
    let without_area;
    let params = if graph.facts.area < NO_AREA && params.parts.count == PartCount::Found {
        context.run.progress.note("the mesh has no area: it is left whole");
        without_area =
            SegmentParams { parts: PartsParams { count: PartCount::Exactly(1), ..params.parts }, ..params.clone() };
        &without_area
    } else {
        params
    };
    let (surface, weighted) = weighted(graph, params, context)?;
    let whole = WeightedSurface { graph, weighted: &weighted, surface: &surface };
    let boundaries = whole.boundaries(params.metric);
    let located = Located { requests, nodes, order, whole: boundaries, context, units: None };
    let PreparedSurface { shares, radius, .. } = &surface;
    if params.tiny_components == TinyComponents::Own && shares.tiny_nodes > 0 {
        let tiny = |node: u32| shares.at(node as usize) <= 0.;
        requests.corrections.refuse_own(nodes, "tiny components", tiny)?;
        let others = n as u64 - shares.tiny_nodes;
        if params.parts.count.least() as u64 > others {
            let problem = "tiny components cannot be one part if more parts are requested than there are other faces";
            let remedy = format!("request at most {others}, or leave out `tiny_components` own");
            return Err(Error::parameter(params.parts.count.option(), problem, remedy));
        }
    }
    let mut decided = decide_parts(whole, params, located, context)?;
    let extrapolated = match params.boundaries {
        Boundaries::Front => None,
        Boundaries::Embedding => Some(part_means(whole, &decided, params, context)?),
    };
    let method =
        extrapolated.as_ref().map_or(BoundaryMethod::Front, |(means, rows)| BoundaryMethod::Embedding(means, rows));
    labels::begin(context.work)?;
    let (refined, _) = context.run.stage("boundaries", "faces", n as u64, || {
        boundary::refine(boundaries, decided.units.cells(), method, LABELS, context)
    })?;
    let RefinedLabels { mut labels, boundary_nodes } = refined;
    let (mut parts, mut tiny_components_label) = (decided.parts, None);
    if params.tiny_components == TinyComponents::Own && shares.tiny_nodes == 0 {
        context.run.progress.note(labels::NO_TINY_COMPONENTS);
    } else if params.tiny_components == TinyComponents::Own {
        tiny_components_label = Some(parts as u32);
        labels = label_tiny_components(&labels, shares, parts as u32, context)?;
        parts += 1;
    }
    let wanted = params.parts.count.least();
    let divided = wanted > decided.cells;
    if divided {
        let wanted = wanted + usize::from(tiny_components_label.is_some());
        let _grant = grant_parts(wanted, None, context.run)?;
        let pieces = divide(weighted.csr(), &labels, wanted, tiny_components_label, LABELS, context)?;
        parts = pieces.count();
        labels = pieces.labels;
        tiny_components_label = tiny_components_label.map(|label| pieces.first[label as usize]);
    }
    weighted.release(context.work)?;
    let quality = decided.units.confidences(context)?;
    let PartTotals { faces, area } = decided.units.totals(graph, &labels, parts, !divided, context.run)?;
    if let Some(decision) = decided.numbers.decision.as_mut().filter(|_| divided) {
        decision.expected_agreement.clear();
    }
    let numbers = SegmentStats {
        radius: *radius,
        tiny_faces: shares.tiny_nodes,
        tiny_components_label,
        faces,
        area,
        ..decided.numbers
    };
    // Tiny components and pieces have additional boundaries.
    let boundary_nodes = (tiny_components_label.is_none() && !divided).then_some(boundary_nodes);
    let cell_labels = if divided { Vec::new() } else { decided.cell_labels };
    Ok(Clustered { labels, boundary_nodes, quality, numbers, marks: decided.marks, cell_labels, on_proxy: None })
}

/// The cells or contracted nodes of `whole`, whose nodes are in `order`, and their labels, without tree or corrections.
pub(super) fn units(
    whole: WeightedSurface<'_>,
    order: &NodeOrder,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<Units> {
    let (requests, boundaries) = (PartRequests::default(), whole.boundaries(params.metric));
    let located = Located { requests, nodes: &[], order, whole: boundaries, context, units: None };
    Ok(decide_parts(whole, params, located, context)?.units)
}

/// The rows over all faces that were used to decide on the parts, and the means of these parts in their embedding.
fn part_means(
    whole: WeightedSurface<'_>,
    decided: &Decided,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<(LocalPartMeans, DistanceRows)> {
    let (rows, b) = whole.rows_used(&decided.numbers, params, context)?;
    Ok((LocalPartMeans::new(&whole.surface.cells()?.graph, &b, &decided.cell_labels), rows))
}

/// Gives the tiny components, which have a `share` (n) of 0, a label of their own.
fn label_tiny_components(
    labels: &[u32],
    shares: &AreaShares,
    label: u32,
    context: Context<'_>,
) -> Result<MappedSlice<u32>> {
    let mut own = context.work.array::<u32>(LABELS, &[labels.len()])?;
    let of = |i: usize, _| if shares.at(i) == 0. { label } else { labels[i] };
    context.run.fill_each(own.data(), CHUNK, of)?;
    own.finish(false)
}

/// Parts decided on cells, and their transfer to the faces.
struct Decided {
    /// Number of cells S, the maximum number of parts of the decision.
    cells: usize,
    /// Number of parts.
    parts: usize,
    /// Part of each cell (S).
    cell_labels: Vec<u32>,
    units: Units,
    numbers: SegmentStats,
    marks: PartMarks,
}

/// Minimum number of faces of a mesh that may be contracted although rows over all of them are cheap. The arms of thin
/// plates of 6,000 faces were cut twice on 3,000 nodes.
const LEAST_CONTRACTED: usize = 12_000;
/// Expected disagreement with people from which parts are in doubt. It is .08 in the mean over the benchmark.
const DOUBTFUL: f64 = 0.09;
/// The contraction is preferred if at most this share of it is left there: .24 to .52 on walls and rods, .64 and more
/// on models of the benchmark.
const SURER: f64 = 0.55;
/// Or if it is smaller by this; by .08 at most on models of the benchmark.
const CLEARLY: f64 = 0.1;

/// Parts decided on cells of the contraction, if the mesh is large, or of the mesh itself. If those of the mesh are in
/// doubt, its contraction is tried too: cells of thin walls and rods with sharp edges follow these better there.
fn decide_parts(
    whole: WeightedSurface<'_>,
    params: &SegmentParams,
    located: Located<'_>,
    context: Context<'_>,
) -> Result<Decided> {
    let n = whole.graph.nodes.len();
    if params.contracts(n) {
        return decide_on_contraction(whole, params, located, |_| Ok(true), context)?
            .ok_or_else(|| Error::internal("a contraction was refused"));
    }
    let made = context.stage(DecisionStage { surface: whole, params })?;
    let doubt = expected_disagreement(&made.0)?;
    if n >= LEAST_CONTRACTED && doubt >= DOUBTFUL && !params.exact_rows() {
        let is_surer = |other: &PartDecision| Ok(expected_disagreement(other)? <= (SURER * doubt).max(doubt - CLEARLY));
        if let Some(decided) = decide_on_contraction(whole, params, located, is_surer, context)? {
            return Ok(decided);
        }
    }
    cut_of(whole, made, params, located, context)
}

/// The expected disagreement with people if as many parts as are found are cut, whatever the number requested.
fn expected_disagreement(decision: &PartDecision) -> Result<f64> {
    Ok(decision.expected_disagreement(&decision.tree.cut_for(PartCount::Found, 0.)?.label))
}

/// The parts of a decision on the cells of `surface`: those of a mesh, or of its contraction.
fn cut_of(
    surface: WeightedSurface<'_>,
    (mut all, facts): (PartDecision, DecisionFacts),
    params: &SegmentParams,
    located: Located<'_>,
    context: Context<'_>,
) -> Result<Decided> {
    let PartRequests { tree, corrections } = located.requests;
    if let Some(tree) = tree {
        if tree.cells() != all.tree.cells() {
            let (own, cells) = (counted(tree.cells(), "cell"), all.tree.cells());
            let problem = format!("has {own}, but the hierarchy of the work directory has {cells}");
            return Err(Error::parameter("tree", problem, "use one that was made in this work directory"));
        }
        all.tree = tree.clone();
    }
    // More parts than cells are made later by dividing.
    let count = params.parts.count.at_most(all.tree.cells());
    let mut cut = all.tree.cut_for(count, params.parts.detail)?;
    let least = params.parts.count.least();
    let walls = (params.walls == Walls::Own && all.is_wall.contains(&true)).then_some(&all.is_wall[..]);
    if let Some(walls) = walls {
        cut = beside_walls(&all.tree, walls, cut, count)?;
    }
    let mut marks = PartMarks::default();
    // Parts joined by corrections keep an interior for each of their pieces.
    let before = (!corrections.is_empty()).then(|| cut.label.clone());
    if !corrections.is_empty() {
        if least > all.tree.cells() {
            let problem = "edits cannot be applied if more parts are requested than the surface has cells";
            return Err(Error::parameter(count.option(), problem, format!("request at most {}", all.tree.cells())));
        }
        (cut, marks) = located.corrected(surface.surface, &all, walls, (count, params.parts.detail), cut)?;
    }
    marks.corrected = !corrections.is_empty() || tree.is_some();
    marks.decision = decision_key(context.work);
    let PartsResult { mut label, mut parts, confidence, mut report } =
        parts::describe(&all, cut, facts.l, facts.seconds);
    if !corrections.is_empty() {
        // The parts are a person's choice, so the expectation does not apply.
        report.expected_agreement.clear();
    }
    let mut walls_label = None;
    if let Some(walls) = walls {
        let kept = label_walls(walls, &mut label);
        (parts, walls_label) = (kept.len() + 1, Some(kept.len() as u32));
        marks = marks.of_parts(&kept);
        // The expectation is about other parts.
        report.expected_agreement.clear();
    }
    let numbers = SegmentStats { decision: Some(report), walls_label, ..facts.numbers };
    let cells = surface.surface.cells()?;
    let (pieces, further) = match before {
        Some(before) => joined_pieces(&cells.graph.pairs, &label, &before, parts),
        None => (label.clone(), Vec::new()),
    };
    let of_node = cells.of_node.clone();
    let units = Units { of_node, label: pieces, further, at_boundary: None, areas: None, confidence };
    Ok(Decided { cells: all.tree.cells(), parts, cell_labels: label, units, numbers, marks })
}

/// The labels of cells that are not `walls` (S), ascending.
fn labels_beside(walls: &[bool], label: &[u32]) -> Vec<u32> {
    let all: BTreeSet<u32> = label.iter().zip(walls).filter(|(_, wall)| !**wall).map(|(label, _)| *label).collect();
    all.into_iter().collect()
}

/// Gives `walls` (S) the label after those of the other cells, which are renumbered; returns the old labels of these.
fn label_walls(walls: &[bool], label: &mut [u32]) -> Vec<u32> {
    let kept = labels_beside(walls, label);
    let number: BTreeMap<u32, u32> = kept.iter().copied().zip(0..).collect();
    let own = kept.len() as u32;
    label.iter_mut().zip(walls).for_each(|(label, wall)| *label = if *wall { own } else { number[label] });
    kept
}

/// `cut`, or a cut with the least `count` of parts besides the `walls` (S) if some of its parts consist of walls only.
fn beside_walls(tree: &PartTree, walls: &[bool], cut: TreeCut, count: PartCount) -> Result<TreeCut> {
    let least = count.least();
    if labels_beside(walls, &cut.label).len() >= least {
        return Ok(cut);
    }
    let others = walls.iter().filter(|wall| !**wall).count();
    if others < least {
        let problem = "walls cannot be a separate part if more parts are requested than there are other cells";
        let remedy = format!("request at most {others}, or leave out `walls` own");
        return Err(Error::parameter(count.option(), problem, remedy));
    }
    tree.without(walls).cut_k(least)
}

/// The same on the contracted graph: constant time after one front. `None`, and nothing is left of that decision, if it
/// is not `preferred`.
fn decide_on_contraction(
    whole: WeightedSurface<'_>,
    params: &SegmentParams,
    located: Located<'_>,
    preferred: impl FnOnce(&PartDecision) -> Result<bool>,
    context: Context<'_>,
) -> Result<Option<Decided>> {
    let (inner, small) = contraction_and_shares(whole, context)?;
    let within = Context::new(&inner, context.run);
    let kind = Kind::Contracted(whole.graph, &small.seeds);
    let cut = within.stage(SurfaceStage { graph: &small.graph, kind, cells: true })?;
    let contracted = WeightedSurface { graph: &small.graph, weighted: &small.weighted, surface: &cut };
    let located = Located { units: Some(&small.of_node), ..located };
    let faces = whole.graph.nodes.len();
    let landmarks = params.landmarks.unwrap_or(landmarks_on_contraction(faces));
    let sampling = params.sampling.unwrap_or(Sampling::DistanceWeighted);
    let own = params.clone().landmarks(Some(landmarks)).sampling(Some(sampling));
    let made = within.stage(DecisionStage { surface: contracted, params: &own })?;
    if !preferred(&made.0)? {
        discard(&inner)?;
        return Ok(None);
    }
    let decided = cut_of(contracted, made, &own, located, within)?;
    let of_small = &decided.units.of_node;
    let landmarks = faces_of(&decided.numbers.landmarks, &small);
    let label: Vec<u32> = of_small.iter().map(|&cell| decided.units.label[cell as usize]).collect();
    let confidence = of_small.iter().map(|&cell| decided.units.confidence[cell as usize]).collect();
    let units = units_of(small, label, decided.units.further, confidence);
    Ok(Some(Decided { units, numbers: SegmentStats { landmarks, ..decided.numbers }, ..decided }))
}
