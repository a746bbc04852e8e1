//! Boundaries of parts, moved from the edges of cells onto creases.
//!
//! Faces deeper in a part than [`BAND`] (at least the deepest 40 % of it) are its interior and keep their label. One
//! front under the edge weights runs from the interiors into the narrow band between them and labels the rest: it is
//! held up where the surface turns, so fronts meet there. Boundaries come out a fifth shorter, without islands. The
//! other method labels each face of the narrow band by its own point in the embedding ([`super::extrapolate`]) and then
//! dissolves islands ([`dissolve`]): faces with their part's label but no path to its interior take the label around
//! them. With both methods boundaries are then straightened ([`super::shorten`]).
//!
//! Only the narrow band is visited. Both fronts can be computed in shares ([`depth_front`], [`band_front`]). Memory:
//! two mapped arrays of 4 bytes per face; while islands are dissolved, 8 bytes per node of the ring that is visited.
//! While boundaries are straightened, 16 bytes per node of the band and 16 per edge, 48 on rough surfaces, which are in
//! files too where the budget is short.

use super::area_shares::AreaShares;
use super::band_graph::{BandArrays, WeightedLengths, band_nodes};
use super::crease::OwnTurning;
use super::extrapolate::LocalPartMeans;
use super::few_nodes::{fitted, of_chunks, will_need_rows};
use super::shorten::{HOPS, PASSES, shorten};
use crate::base::Result;
use crate::base::parallel::chunk_range;
use crate::distance::voronoi::{self, VisitedPieces};
use crate::distance::{DistanceRows, SharedFront};
use crate::graph::{Csr, DualGraph, WeightedGraph};
use crate::store::{Context, MappedSlice, Run, ScratchArray};
use std::ops::Range;

/// Half the width of the narrow band around a boundary, which is labelled anew, in units of √(area).
pub const BAND: f32 = 0.04;
/// How far a boundary may be moved to be straight, in units of √(area); on a fine mesh, by no more faces than the cuts
/// reach.
const REACH: f32 = 0.015;
/// Minimum of that distance, in mean steps from face to face: it applies to coarse meshes.
const LEAST_FACES: f32 = 2.;
/// Share of a part's faces that at least keeps its label.
const INTERIOR: f64 = 0.4;
/// Bins of the depths' histogram.
const BINS: usize = 1024;
const CHUNK: usize = 1 << 15;

/// How the faces of the narrow band get their labels.
#[derive(Clone, Copy, Debug)]
pub enum BoundaryMethod<'a> {
    /// By one front from the interiors.
    Front,
    /// By the means of the parts in the embedding, and each face's column of the rows.
    Embedding(&'a LocalPartMeans, &'a DistanceRows),
}

/// The cells (or contracted nodes) of the nodes, and their labels.
#[derive(Clone, Copy, Debug)]
pub struct CellLabels<'a> {
    /// Cell of each node (n).
    pub of_node: &'a [u16],
    /// Label of each cell (S).
    pub label: &'a [u32],
    /// The last labels, one for each entry, are further pieces of the part that it names; none where each part counts
    /// as one. Each piece has an interior of its own, so a small one is not lost beside a large one.
    pub further: &'a [u32],
    /// Whether each cell (S) has a neighbour of another label; all may have where it is not known.
    pub at_boundary: Option<&'a [bool]>,
}

impl CellLabels<'_> {
    /// The label of `node`.
    pub fn of(&self, node: usize) -> u32 {
        self.label[self.of_node[node] as usize]
    }

    /// The nodes with a neighbour of another label, ascending. Few cells are looked into where it is
    /// known which ones have any.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn boundary_nodes(&self, graph: Csr<'_>, run: &Run) -> Result<Vec<u32>> {
        let own = |i: usize| self.at_boundary.is_none_or(|cells| cells[self.of_node[i] as usize]);
        of_chunks(graph, run, own, |mut nodes| {
            nodes.retain(|&i| graph.neighbours(i).any(|(j, _)| self.of(i as usize) != self.of(j as usize)));
            nodes
        })
    }

    /// The label of the part whose depth `node` has a say in; none of the parts' where it is in a tiny component.
    pub fn measured(&self, node: usize, shares: &AreaShares) -> u32 {
        if shares.tiny_nodes > 0 && shares.at(node) <= 0. { u32::MAX } else { self.of(node) }
    }

    /// Number of labels.
    pub fn labels(&self) -> usize {
        self.label.iter().max().map_or(0, |top| *top as usize + 1)
    }

    /// The part that each label is of.
    pub fn part_of_label(&self) -> Vec<u32> {
        (0..(self.labels() - self.further.len()) as u32).chain(self.further.iter().copied()).collect()
    }

    /// Makes `labels` (n) those of parts.
    fn join_pieces(&self, labels: &mut [u32], run: &Run) -> Result<()> {
        if self.further.is_empty() {
            return Ok(());
        }
        let part = self.part_of_label();
        run.fill_each(labels, CHUNK, |_, label| part[label as usize])
    }
}

/// What boundaries are refined on.
#[derive(Clone, Copy)]
pub struct BoundarySurface<'a> {
    /// The graph.
    pub graph: &'a DualGraph,
    /// The same under the weights that fronts use.
    pub weighted: &'a WeightedGraph,
    /// Shares of area.
    pub shares: &'a AreaShares,
    /// The faces' own turning, where these weights have averaged normals.
    pub own: Option<OwnTurning<'a>>,
}

/// The labels of the faces.
#[derive(Debug)]
pub struct RefinedLabels {
    /// Label of each node (n).
    pub labels: MappedSlice<u32>,
    /// Nodes with a neighbour of another label, ascending.
    pub boundary_nodes: Vec<u32>,
}

/// Half the width of the narrow band, in the unit of the mesh.
pub fn half_width(shares: &AreaShares) -> f32 {
    BAND / shares.unit
}

/// The front that measures how deep in their parts faces lie: from the nodes where labels change, to `half_width`.
pub fn depth_front<'a>(graph: &'a DualGraph, half_width: f32, boundary_nodes: &'a [u32]) -> SharedFront<'a> {
    SharedFront {
        name: "depths",
        stage: "boundaries",
        graph: graph.edges.by_distance(),
        key: &graph.key,
        sources: boundary_nodes,
        labels: None,
        limit: half_width,
    }
}

/// The front that labels the narrow bands, from the edge of the interiors, whose nodes have these `labels`.
pub fn band_front<'a>(weighted: &'a WeightedGraph, edge: &'a [u32], labels: &'a [u32]) -> SharedFront<'a> {
    SharedFront {
        name: "bands",
        stage: "boundaries",
        graph: weighted.csr(),
        key: &weighted.key,
        sources: edge,
        labels: Some(labels),
        limit: f32::INFINITY,
    }
}

/// Labels every face from the labels of cells. Writes the array `file`, and does not record a stage.
/// Fronts that were computed in shares are taken from these.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn refine(
    surface: BoundarySurface<'_>,
    cells: CellLabels<'_>,
    method: BoundaryMethod<'_>,
    file: &str,
    context: Context<'_>,
) -> Result<RefinedLabels> {
    let BoundarySurface { graph, weighted, shares, .. } = surface;
    let (n, steps) = (cells.of_node.len(), weighted.csr());
    let mut labels = context.work.array::<u32>(file, &[n])?;
    let boundary_nodes = cells.boundary_nodes(steps, context.run)?;
    if boundary_nodes.is_empty() {
        context.run.fill_each(labels.data(), CHUNK, |i, _| cells.of(i))?;
        cells.join_pieces(labels.data(), context.run)?;
        return Ok(RefinedLabels { labels: labels.finish(false)?, boundary_nodes });
    }
    let half_width = half_width(shares);
    // Zeros at first, which stay where the front does not come: there all is interior, and nothing
    // needs to be written or read.
    let mut field = context.work.array::<f32>("depth.tmp", &[n])?;
    let visited = depth_front(graph, half_width, &boundary_nodes).within_fresh(field.data(), context)?;
    let depth: &[f32] = field.data();
    let depth = |i: usize| if visited.has(i) { depth[i] } else { f32::INFINITY };
    // Cells tell the first labels in half the bytes that labels take; those are written where they are needed.
    let measured = |i: usize| (cells.measured(i, shares), depth(i));
    let limits = interior_limits(n, cells.labels(), measured, half_width, context.run)?;
    // The second front starts in the interiors, at distance 0; the narrow band is open.
    let begin = |k: usize, field: &mut [f32], labels: &mut [u32], (): &mut ()| {
        labels.iter_mut().zip(chunk_range(n, CHUNK, k)).for_each(|(label, i)| *label = cells.of(i));
        if visited.has(k * CHUNK) {
            for (depth, label) in field.iter_mut().zip(labels) {
                *depth = if *depth >= limits[*label as usize] { 0. } else { f32::INFINITY };
            }
        }
        Ok(())
    };
    context.run.fill_two((field.data(), labels.data()), CHUNK, || (), begin)?;
    let first: &[u32] = labels.data();
    let inside: &[f32] = field.data();
    let interior_edge = interior_edge(steps, |i| !visited.has(i) || inside[i] == 0., context.run)?;
    match method {
        BoundaryMethod::Front => {
            let of_edge: Vec<u32> = interior_edge.iter().map(|&node| first[node as usize]).collect();
            let front = band_front(weighted, &interior_edge, &of_edge);
            front.propagate_labels(field.data(), labels.data(), context)?;
            cells.join_pieces(labels.data(), context.run)?;
        }
        BoundaryMethod::Embedding(means, rows) => {
            let field = field.data();
            cells.join_pieces(labels.data(), context.run)?;
            means.relabel(rows, cells.of_node, |i| field[i] != 0., labels.data(), context.run)?;
            dissolve(steps, &interior_edge, field, labels.data(), context.run)?;
        }
    }
    let depths = Depths { field: field.data(), visited: &visited };
    let band = straighten(surface, depths, labels.data(), context)?;
    drop(field);
    // Outside the band labels differ only between interiors, where they differed at first.
    let boundary_nodes = at_boundary(steps, boundary_nodes.iter().chain(&*band), labels.data());
    Ok(RefinedLabels { labels: labels.finish(false)?, boundary_nodes })
}

/// Nodes with a neighbour of another label, ascending: those of `candidates`, and such neighbours of theirs.
fn at_boundary<'a>(graph: Csr<'_>, candidates: impl Iterator<Item = &'a u32>, labels: &[u32]) -> Vec<u32> {
    let across = |&i: &u32| {
        let others = graph.neighbours(i).map(|(j, _)| j);
        others.filter(move |&j| labels[j as usize] != labels[i as usize]).flat_map(move |j| [i, j])
    };
    let mut nodes: Vec<u32> = candidates.flat_map(across).collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes
}

/// How deep nodes lie in the narrow band.
struct Depths<'a> {
    /// Depth of each node (n), 0 in the interiors, also where nothing was visited.
    field: &'a mut [f32],
    visited: &'a VisitedPieces,
}

/// Straightens the new boundaries; `depths` are used up. Returns the nodes whose labels may have changed.
fn straighten(
    BoundarySurface { graph, weighted, shares, own }: BoundarySurface<'_>,
    Depths { field, visited }: Depths<'_>,
    labels: &mut [u32],
    context: Context<'_>,
) -> Result<ScratchArray<u32>> {
    let run = context.run;
    let steps = weighted.csr();
    let mean = graph.edges.mean_step();
    let across = |i: usize| steps.neighbours(i as u32).any(|(j, _)| labels[j as usize] != labels[i]);
    let open = run.fill_chunks(
        field,
        CHUNK,
        || (),
        |k, field, ()| {
            if !visited.has(k * CHUNK) {
                return Ok(Vec::new());
            }
            let range = chunk_range(labels.len(), CHUNK, k);
            let mut open: Vec<u32> = range.zip(&*field).filter(|(_, d)| **d > 0.).map(|(i, _)| i as u32).collect();
            will_need_rows(steps, &open, run);
            // Interiors cannot be lowered below 0, so they stay outside the band that is straightened.
            field.iter_mut().for_each(|d| *d = if *d == 0. { -1. } else { f32::INFINITY });
            open.retain(|&i| across(i as usize));
            Ok(fitted(open))
        },
    )?;
    let open = open.concat();
    // Weights of an altered graph may be no numbers.
    let reach = (REACH / shares.unit).max(LEAST_FACES * mean).min((HOPS * PASSES) as f32 * mean);
    voronoi::within(graph.edges.by_distance(), &open, reach, field, run)?;
    let band = band_nodes(field, visited, context)?;
    let lengths = WeightedLengths {
        steps,
        centroid_distance: &graph.edges.centroid_distance,
        edge: graph.edges.shared(),
        unit: shares.unit,
        own,
    };
    let arrays = BandArrays::of(lengths, &band, labels, context)?;
    let mut shortened = ScratchArray::<u32>::new("shortened.tmp", band.len(), context)?;
    shortened.iter_mut().zip(&*band).for_each(|(label, &node)| *label = labels[node as usize]);
    shorten(arrays.graph(), &mut shortened, context)?;
    band.iter().zip(&*shortened).for_each(|(&node, &label)| labels[node as usize] = label);
    Ok(band)
}

/// Nodes of interiors with a neighbour that is in none, ascending. They are found from these, which are few.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn interior_edge(graph: Csr<'_>, interior: impl Fn(usize) -> bool + Sync, run: &Run) -> Result<Vec<u32>> {
    let beside = |open: Vec<u32>| {
        let mut beside = Vec::new();
        for node in open {
            for (next, _) in graph.neighbours(node) {
                if interior(next as usize) {
                    beside.push(next);
                }
            }
        }
        beside.sort_unstable();
        beside.dedup();
        beside
    };
    let mut edge = of_chunks(graph, run, |node| !interior(node), beside)?;
    edge.sort_unstable();
    edge.dedup();
    Ok(edge)
}

/// Counts that histograms hold at a time, for a thread or for several together: 8 MB.
const COUNTS: usize = 1 << 21;

/// The depth from which on each part's faces keep their label: the half width of the narrow band, or less
/// where more than 60 % of the part lies in it. From histograms of label and depth of all `n` nodes;
/// depths beyond it are infinite. Nodes of tiny components, which float far from all boundaries, have no label there:
/// many of them beside a small part would be all of its interior, and the part would vanish. Where there are many
/// parts, nodes are counted for one group of parts after the other.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn interior_limits(
    n: usize,
    parts: usize,
    of: impl Fn(usize) -> (u32, f32) + Sync,
    half_width: f32,
    run: &Run,
) -> Result<Vec<f32>> {
    let size = (COUNTS / (BINS + 1)).min(parts).max(1);
    let counts_of = |labels: Range<usize>, nodes: Range<usize>| {
        let mut counts = vec![0u32; labels.len() * (BINS + 1)];
        for (label, depth) in nodes.map(&of).filter(|(label, _)| labels.contains(&(*label as usize))) {
            let bin = if depth < half_width { (depth / half_width * BINS as f32) as usize } else { BINS };
            counts[(label as usize - labels.start) * (BINS + 1) + bin.min(BINS)] += 1;
        }
        counts
    };
    if parts > size {
        let limits = run.map_ranges(parts, size, |labels| Ok(limits_of(&counts_of(labels, 0..n), half_width)))?;
        return Ok(limits.concat());
    }
    let blocks = (COUNTS / (size * (BINS + 1))).clamp(1, 8);
    let blocks = run.map_ranges(n, n.div_ceil(blocks).max(1), |nodes| Ok(counts_of(0..parts, nodes)))?;
    let sum = |mut sum: Vec<u32>, block: Vec<u32>| {
        sum.iter_mut().zip(block).for_each(|(a, b)| *a += b);
        sum
    };
    let counts = blocks.into_iter().reduce(sum).unwrap_or_else(|| vec![0; parts * (BINS + 1)]);
    Ok(limits_of(&counts, half_width))
}

/// The limit of each part whose histogram `counts` holds.
fn limits_of(counts: &[u32], half_width: f32) -> Vec<f32> {
    let limit = |bins: &[u32]| {
        let whole = bins.iter().map(|&count| u64::from(count)).sum::<u64>();
        // A part of tiny components alone, of which none counts, keeps all of its faces.
        let interior = ((INTERIOR * whole as f64).ceil() as u64).max(1);
        let mut kept = u64::from(bins[BINS]);
        let mut bin = BINS;
        while kept < interior && bin > 0 {
            bin -= 1;
            kept += u64::from(bins[bin]);
        }
        let edge = half_width * bin as f32 / BINS as f32;
        // A depth that was rounded up into its bin may be less than the bin's edge: it is kept as it was counted.
        if bin < BINS { edge * (1. - 4. * f32::EPSILON) } else { edge }
    };
    counts.chunks_exact(BINS + 1).map(limit).collect()
}

/// Rounds between checks of the stop flag.
const STOP_CHECK: usize = 1 << 10;
/// What `field` holds at nodes that an interior has reached: more than in the interior itself, less than any path.
const REACHED: f32 = f32::MIN_POSITIVE;

/// Dissolves islands of `labels` (n) among the nodes where `field` (n) is infinite; interiors are 0 there,
/// `boundary_nodes` is where they end. What an interior reaches ends up with a positive, finite field.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
fn dissolve(graph: Csr<'_>, boundary_nodes: &[u32], field: &mut [f32], labels: &mut [u32], run: &Run) -> Result<()> {
    let neighbours = |i: u32| &graph.indices[graph.span(i)];
    // Nodes beside an island, and the label they would give it.
    let mut island_boundary: Vec<(u32, u32)> = Vec::new();
    let mut ring: Vec<u32> = boundary_nodes.to_vec();
    for round in 0.. {
        if round % STOP_CHECK == 0 {
            run.cancel.check()?;
        }
        let mut next = Vec::new();
        for &i in &ring {
            for &j in neighbours(i) {
                if field[j as usize] < f32::INFINITY {
                    continue;
                }
                if labels[j as usize] == labels[i as usize] {
                    field[j as usize] = REACHED;
                    next.push(j);
                } else {
                    island_boundary.push((j, labels[i as usize]));
                }
            }
        }
        if next.is_empty() {
            break;
        }
        ring = next;
    }
    while !island_boundary.is_empty() {
        run.cancel.check()?;
        island_boundary.retain(|&(j, _)| field[j as usize] == f32::INFINITY);
        island_boundary.sort_unstable();
        island_boundary.dedup_by_key(|entry| entry.0);
        for &(j, label) in &island_boundary {
            labels[j as usize] = label;
            field[j as usize] = REACHED;
        }
        let mut next = Vec::new();
        for &(i, label) in &island_boundary {
            let open = neighbours(i).iter().filter(|&&j| field[j as usize] == f32::INFINITY);
            next.extend(open.map(|&j| (j, label)));
        }
        island_boundary = next;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream};
    use crate::graph::OwnedRowStarts;

    /// A grid of w × h nodes with four neighbours each.
    fn grid(w: usize, h: usize) -> (OwnedRowStarts, Vec<u32>) {
        let (mut degrees, mut indices) = (Vec::new(), Vec::new());
        for i in 0..w * h {
            let (x, y) = (i % w, i / w);
            let sides =
                [(y > 0, i.wrapping_sub(w)), (x > 0, i.wrapping_sub(1)), (x + 1 < w, i + 1), (y + 1 < h, i + w)];
            indices.extend(sides.iter().filter(|side| side.0).map(|side| side.1 as u32));
            degrees.push(sides.iter().filter(|side| side.0).count());
        }
        (OwnedRowStarts::of(degrees), indices)
    }

    /// By the definition: reached within the label; else ring by ring the smallest label beside it.
    fn oracle(graph: Csr<'_>, field: &[f32], labels: &[u32]) -> Vec<u32> {
        let n = labels.len();
        let of = |i: usize| graph.neighbours(i as u32).map(|(j, _)| j as usize);
        let (mut out, mut done) = (labels.to_vec(), field.iter().map(|&d| d == 0.).collect::<Vec<_>>());
        while let Some(i) = (0..n).find(|&i| !done[i] && of(i).any(|j| done[j] && labels[j] == labels[i])) {
            done[i] = true;
        }
        loop {
            let before = done.clone();
            for i in (0..n).filter(|&i| !before[i]) {
                if let Some(label) = of(i).filter(|&j| before[j]).map(|j| out[j]).min() {
                    (out[i], done[i]) = (label, true);
                }
            }
            if done == before {
                return out;
            }
        }
    }

    /// Regression: where all that is deep in a part lay just below the edge of a bin, nothing was interior.
    #[test]
    fn what_is_counted_as_interior_is_not_below_the_limit() {
        for half_width in [0.04f32, 0.04 / 1.7, 0.03] {
            for bin in 1..BINS {
                let deep = (half_width * bin as f32 / BINS as f32).next_down();
                let depth = |i: usize| (0, if i < 5 { deep } else { 0. });
                let limit = interior_limits(10, 1, depth, half_width, &Run::new(&())).unwrap()[0];
                assert!(limit <= deep, "{limit} {deep}");
            }
        }
    }

    /// One histogram, several side by side, and parts in groups: the limits are those of each part's sorted depths.
    #[test]
    fn interiors_keep_two_fifths_of_a_part() {
        let (n, half_width) = (20_000, 2.);
        for parts in [1, 300, 3_000, 7_000] {
            let mut random = stream(parts as u64, "interiors");
            let drawn: Vec<(u32, f32)> = (0..n)
                .map(|_| (below(&mut random, parts) as u32, below(&mut random, 30) as f32 * half_width / 20.))
                .collect();
            let limits = interior_limits(n, parts, |i| drawn[i], half_width, &Run::new(&())).unwrap();
            assert_eq!(limits.len(), parts);
            for (part, &limit) in limits.iter().enumerate().step_by(1 + parts / 250) {
                let depths: Vec<f32> = drawn.iter().filter(|one| one.0 as usize == part).map(|one| one.1).collect();
                let kept = |limit: f32| depths.iter().filter(|depth| **depth >= limit).count() as f64;
                let wanted = INTERIOR * depths.len() as f64;
                assert!(kept(limit) >= wanted, "{part} of {parts}");
                let next = limit + half_width / BINS as f32;
                assert!(limit == half_width || kept(next) < wanted || depths.is_empty(), "{part} of {parts}");
            }
        }
    }

    #[test]
    fn boundaries_are_found_from_either_side() {
        let (w, h) = (23, 17);
        let (starts, indices) = grid(w, h);
        let weights = vec![1f32; indices.len()];
        let graph = Csr::new(starts.view(), &indices, &weights);
        let mut random = stream(1, "boundaries");
        for _ in 0..20 {
            let labels: Vec<u32> =
                (0..w * h).map(|i| (i % w / 8) as u32 + 3 * u32::from(below(&mut random, 9) == 0)).collect();
            let of_node: Vec<u16> = (0..(w * h) as u16).collect();
            let cells = CellLabels { of_node: &of_node, label: &labels, further: &[], at_boundary: None };
            let all = cells.boundary_nodes(graph, &Run::new(&())).unwrap();
            let touches = |i| graph.neighbours(i).any(|(j, _)| labels[j as usize] != labels[i as usize]);
            let touching: Vec<bool> = (0..labels.len() as u32).map(touches).collect();
            assert_eq!(all, (0..labels.len() as u32).filter(|&i| touching[i as usize]).collect::<Vec<u32>>());
            let known = CellLabels { at_boundary: Some(&touching), ..cells };
            assert_eq!(known.boundary_nodes(graph, &Run::new(&())).unwrap(), all);
            // One side of each pair is enough, in any order and with others.
            let mut candidates: Vec<u32> = all.iter().copied().filter(|&i| labels[i as usize] % 3 != 1).rev().collect();
            candidates.extend(all.iter().copied().filter(|&i| labels[i as usize] >= 3));
            candidates.extend([0, 5, 200]);
            assert_eq!(at_boundary(graph, candidates.iter(), &labels), all);
        }
    }

    #[test]
    fn islands_take_the_label_they_lie_in() {
        let (w, h) = (23, 17);
        let (starts, indices) = grid(w, h);
        let weights = vec![1f32; indices.len()];
        let graph = Csr::new(starts.view(), &indices, &weights);
        for seed in 0..60 {
            let mut random = stream(seed, "islands");
            let field: Vec<f32> =
                (0..w * h).map(|i| if i % w < 4 || i % w > 18 { 0. } else { f32::INFINITY }).collect();
            let labels: Vec<u32> = (0..w * h)
                .map(|i| {
                    if field[i] == 0. {
                        u32::from(i % w > 4) + 2 * u32::from(i / w > 9)
                    } else {
                        below(&mut random, 4) as u32
                    }
                })
                .collect();
            let boundary_nodes: Vec<u32> = (0..(w * h) as u32).filter(|i| matches!(*i as usize % w, 3 | 19)).collect();
            let (mut found, mut reached) = (labels.clone(), field.clone());
            dissolve(graph, &boundary_nodes, &mut reached, &mut found, &Run::new(&())).unwrap();
            assert_eq!(found, oracle(graph, &field, &labels), "{seed}");
            assert!(reached.iter().all(|d| d.is_finite()));
        }
    }
}
