//! Boundaries shortened to the locally shortest curves along edges: minimum cuts in narrow bands.
//!
//! Where the surface turns, the front that labels a band meets on the crease; where it does not, it meets where noise
//! decides, and the boundary is ragged. Between two parts the labels of the faces within [`HOPS`] of their boundary
//! are found again as a minimum cut, whose cost is the length of the edges between the parts, less across a crease
//! ([`super::band_graph`]); so a boundary on a crease stays there, and elsewhere it is the shortest one that the
//! edges of the mesh offer so near. Parts are taken two by two, which is exact for two parts and a local optimum
//! where three meet. What has moved is cut once more from where it is: [`PASSES`] narrow cuts straighten nearly as
//! well as one of their width together, in half the time. Faces outside of the band, and interiors of parts, are
//! fixed: no part vanishes. Pieces of the band that do not touch are cut each on its own, at the same time: all limbs
//! of a body have a boundary with it.
//!
//! Cost: flows need tens of passes over bands of 2 [`HOPS`] faces across; 100 bytes per node of the boundaries that are
//! cut at the same time. 4 bytes per node of all bands, and 4 per node and thread, lie in files where the budget is
//! short; one thread works then.

use super::band_graph::{BandEdge, BandGraph};
use super::max_flow::MaxFlow;
use crate::base::parallel::lock;
use crate::base::sort::{map_of, sort_by};
use crate::base::union_find::Forest;
use crate::base::{Cancel, Result};
use crate::store::{Context, ScratchArray};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// How far from a boundary, in faces, one cut may move it.
pub const HOPS: usize = 8;
/// Maximum number of cuts of each boundary.
pub const PASSES: usize = 2;
/// The greatest weight of an edge is this many units.
const UNITS: f64 = (1 << 20) as f64;

/// Shortens the boundaries between the `labels` (m) of a band's positions.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn shorten(graph: BandGraph<'_>, labels: &mut [u32], context: Context<'_>) -> Result<()> {
    let greatest = graph.edges.iter().map(|edge| edge.weight).fold(0f32, f32::max);
    if !(greatest > 0. && greatest.is_finite()) {
        return Ok(());
    }
    // In f64, where no length of f32 is too short to be divided by.
    let scale = UNITS / f64::from(greatest);
    let m = labels.len();
    let mut pieces = ScratchArray::<u32>::new("pieces.tmp", m, context)?;
    find_pieces(graph, &mut pieces);
    // Threads whose numbers of positions find room in memory. One always works, with a file if need be.
    let budget = &context.run.budget;
    let run = context.run.with_threads(budget.left().saturating_sub(budget.total() / 2) / (4 * m as u64).max(1));
    let (made, free) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let new = || ScratchArray::<u32>::new(&format!("places-{}.tmp", made.fetch_add(1, Relaxed)), m, context);
    let mut moved = BTreeSet::new();
    for pass in 0..PASSES {
        let before = std::mem::take(&mut moved);
        let mut boundaries = boundaries(graph, &pieces, labels);
        boundaries.retain(|(pair, _)| pass == 0 || pair.iter().any(|label| before.contains(label)));
        for round in rounds(&boundaries) {
            let band = LabelledBand { graph, pieces: &pieces, labels, scale };
            let mut begin: Vec<_> = round.iter().map(|(pair, _)| *pair).zip(band.at_boundaries(&round)).collect();
            // The longest first: no thread is left with it in the end.
            sort_by(&mut begin, |a, b| b.1.len().cmp(&a.1.len()));
            let cut = |k: usize, (): &mut ()| {
                let unused = lock(&free).pop();
                let mut place = unused.map_or_else(new, Ok)?;
                let changes = band.cut(begin[k].0, &begin[k].1, &mut place, &run.cancel)?;
                lock(&free).push(place);
                Ok(changes)
            };
            let changes = run.map_chunks(begin.len(), || (), cut)?;
            for ((pair, _), changes) in begin.iter().zip(changes) {
                if !changes.is_empty() {
                    moved.extend(*pair);
                }
                changes.into_iter().for_each(|(node, label)| labels[node as usize] = label);
            }
        }
    }
    Ok(())
}

/// What one cut works on: two labels, the lesser first, and the piece of the band where they touch.
type Boundary = ([u32; 2], u32);

/// Writes to `pieces` (m) the connected piece of the band that each position lies in: its least position.
fn find_pieces(graph: BandGraph<'_>, pieces: &mut [u32]) {
    let mut forest = Forest::over(pieces);
    for position in 0..graph.len() as u32 {
        graph.around(position).iter().filter_map(BandEdge::position).for_each(|to| {
            forest.join(position, to);
        });
    }
    forest.labels();
}

/// All pairs of labels that touch, in each piece where they do, ascending.
fn boundaries(graph: BandGraph<'_>, pieces: &[u32], labels: &[u32]) -> BTreeSet<Boundary> {
    let of = |position: u32| {
        let (own, piece) = (labels[position as usize], pieces[position as usize]);
        let others = graph.around(position).iter().map(|edge| edge.label(labels));
        others.filter(move |&other| other != own).map(move |other| ([own.min(other), own.max(other)], piece))
    };
    (0..labels.len() as u32).flat_map(of).collect()
}

/// The boundaries in rounds, in which no label comes twice in one piece: cuts of one round do not meet. Those that
/// could meet come in the order of [`order_of_pairs`].
fn rounds(boundaries: &BTreeSet<Boundary>) -> Vec<Vec<Boundary>> {
    let mut rounds: Vec<Vec<Boundary>> = Vec::new();
    let mut free: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    for pair in order_of_pairs(boundaries.iter().map(|(pair, _)| *pair).collect()) {
        for &(_, piece) in boundaries.range((pair, 0)..=(pair, u32::MAX)) {
            let keys = pair.map(|label| (label, piece));
            let round = keys.iter().filter_map(|key| free.get(key)).max().copied().unwrap_or(0);
            free.extend(keys.map(|key| (key, round + 1)));
            if round == rounds.len() {
                rounds.push(Vec::new());
            }
            rounds[round].push((pair, piece));
        }
    }
    rounds
}

/// The order of cuts: again and again ascending, past pairs of which a label has just been cut.
fn order_of_pairs(mut pairs: BTreeSet<[u32; 2]>) -> Vec<[u32; 2]> {
    let mut order = Vec::with_capacity(pairs.len());
    while !pairs.is_empty() {
        let mut busy = BTreeSet::new();
        pairs.retain(|pair| {
            let free = pair.iter().all(|label| !busy.contains(label));
            if free {
                busy.extend(*pair);
                order.push(*pair);
            }
            !free
        });
    }
    order
}

/// A band, its labels before a round, and how many units a boundary's cost of 1 is.
struct LabelledBand<'a> {
    graph: BandGraph<'a>,
    /// The piece of each position (m), as [`find_pieces`] finds them.
    pieces: &'a [u32],
    labels: &'a [u32],
    scale: f64,
}

impl LabelledBand<'_> {
    /// The positions on both sides of each boundary of a round, ascending. One pass for the whole round: there can be
    /// thousands.
    fn at_boundaries(&self, round: &[Boundary]) -> Vec<Vec<u32>> {
        let both = round.iter().enumerate();
        let both = both.flat_map(|(k, &([a, b], piece))| [((a, piece), (b, k)), ((b, piece), (a, k))]);
        let partner: BTreeMap<(u32, u32), (u32, usize)> = map_of(both);
        let mut positions = vec![Vec::new(); round.len()];
        for i in 0..self.labels.len() as u32 {
            let own = self.labels[i as usize];
            let mut around = self.graph.around(i).iter().map(|edge| edge.label(self.labels));
            if around.clone().all(|label| label == own) {
                continue;
            }
            if let Some(&(other, k)) = partner.get(&(own, self.pieces[i as usize]))
                && around.any(|label| label == other)
            {
                positions[k].push(i);
            }
        }
        positions
    }

    /// The positions whose labels the minimum cut between the two labels of `pair` changes, and their new labels.
    /// `place` (m) is all 0, before and after.
    fn cut(&self, pair: [u32; 2], at_boundary: &[u32], place: &mut [u32], cancel: &Cancel) -> Result<Vec<(u32, u32)>> {
        let nodes = self.strip(pair, at_boundary, place);
        let mut flow = self.flow_between(pair, &nodes, place);
        nodes.iter().for_each(|&node| place[node as usize] = 0);
        flow.run(cancel)?;
        let label = |k: usize| pair[usize::from(!flow.is_on_source_side(k))];
        let all = nodes.iter().enumerate().map(|(k, &node)| (node, label(k)));
        Ok(all.filter(|&(node, label)| self.labels[node as usize] != label).collect())
    }

    /// The positions of label a or b within [`HOPS`] of the boundary between the two; `place` gets the number of each,
    /// from 1 on.
    fn strip(&self, [a, b]: [u32; 2], at_boundary: &[u32], place: &mut [u32]) -> Vec<u32> {
        let mut nodes = at_boundary.to_vec();
        nodes.iter().zip(1..).for_each(|(&node, number)| place[node as usize] = number);
        let mut ring = 0;
        for _ in 1..HOPS {
            let end = nodes.len();
            for k in ring..end {
                for to in self.graph.around(nodes[k]).iter().filter_map(BandEdge::position) {
                    let own = self.labels[to as usize];
                    if place[to as usize] == 0 && (own == a || own == b) {
                        nodes.push(to);
                        place[to as usize] = nodes.len() as u32;
                    }
                }
            }
            ring = end;
        }
        nodes
    }

    /// The flow from label a to label b through the strip of `nodes`.
    fn flow_between(&self, [a, b]: [u32; 2], nodes: &[u32], place: &[u32]) -> MaxFlow {
        let m = nodes.len();
        let units = |weight: f32| ((f64::from(weight.max(0.)) * self.scale) as i64).max(1);
        let (mut source, mut sink) = (vec![0; m], vec![0; m]);
        let (mut start, mut arcs) = (vec![0], Vec::with_capacity(3 * m));
        for (k, &node) in nodes.iter().enumerate() {
            for edge in self.graph.around(node) {
                let within = edge.position().map_or(0, |to| place[to as usize]);
                if within > 0 {
                    arcs.push((within - 1, units(edge.weight)));
                } else {
                    let label = edge.label(self.labels);
                    source[k] += if label == a { units(edge.weight) } else { 0 };
                    sink[k] += if label == b { units(edge.weight) } else { 0 };
                }
            }
            start.push(arcs.len() as u32);
        }
        MaxFlow::new(source, sink, start, &arcs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{Random, below, stream};
    use crate::store::{Budget, Run, WorkDir};

    /// A band that holds its arrays.
    struct Band {
        start: Vec<u32>,
        edges: Vec<BandEdge>,
    }

    impl Band {
        fn graph(&self) -> BandGraph<'_> {
            BandGraph { start: &self.start, edges: &self.edges }
        }
    }

    /// What `labels` become with `threads`, in memory or in files.
    fn shortened(band: &Band, labels: &[u32], threads: usize, budget: u64) -> Vec<u32> {
        let folder = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(folder.path()).unwrap();
        let run = Run { threads, budget: Budget::new(budget), ..Run::new(&()) };
        let mut labels = labels.to_vec();
        shorten(band.graph(), &mut labels, Context::new(&work, &run)).unwrap();
        labels
    }

    fn pieces(graph: BandGraph<'_>) -> Vec<u32> {
        let mut pieces = vec![0; graph.len()];
        find_pieces(graph, &mut pieces);
        pieces
    }

    /// A band `w` nodes long and `h` across, between fixed nodes of label 0 above and 1 below, with random weights.
    fn band(w: usize, h: usize, random: &mut Random) -> Band {
        let mut weights = BTreeMap::new();
        let mut weight =
            |i: usize, j: usize| *weights.entry((i.min(j), i.max(j))).or_insert_with(|| (1 + below(random, 8)) as f32);
        let (mut start, mut edges) = (vec![0], Vec::new());
        for i in 0..w * h {
            let (x, y) = (i % w, i / w);
            let mut step = |other: Option<usize>, fixed: Option<u32>| match (other, fixed) {
                (Some(j), _) => edges.push(BandEdge::inside(j as u32, weight(i, j))),
                (None, Some(label)) => {
                    edges.push(BandEdge::to_fixed(label, weight(i, w * h + i + label as usize)));
                }
                _ => {}
            };
            step((y > 0).then(|| i - w), Some(0));
            step((x > 0).then(|| i - 1), None);
            step((x + 1 < w).then(|| i + 1), None);
            step((y + 1 < h).then(|| i + w), Some(1));
            start.push(edges.len() as u32);
        }
        Band { start, edges }
    }

    /// What boundaries cost; those between two positions twice.
    fn cost(graph: BandGraph<'_>, labels: &[u32]) -> f32 {
        let of = |i: u32| {
            let apart = graph.around(i).iter().filter(move |edge| edge.label(labels) != labels[i as usize]);
            apart.map(|edge| if edge.position().is_some() { 0.5 * edge.weight } else { edge.weight }).sum::<f32>()
        };
        (0..labels.len() as u32).map(of).sum()
    }

    #[test]
    fn two_parts_get_the_cheapest_boundary_of_all() {
        let (w, h) = (4, 3);
        for seed in 0..40 {
            let mut random = stream(seed, "bands");
            let band = band(w, h, &mut random);
            let labels: Vec<u32> = (0..w * h).map(|_| below(&mut random, 2) as u32).collect();
            let labels = shortened(&band, &labels, 1, 1 << 30);
            let all = (0..1u32 << (w * h)).map(|bits| (0..w * h).map(|i| bits >> i & 1).collect::<Vec<u32>>());
            let least = all.map(|labels| cost(band.graph(), &labels)).fold(f32::INFINITY, f32::min);
            assert_eq!(cost(band.graph(), &labels), least, "{seed}");
        }
    }

    #[test]
    fn several_parts_get_a_boundary_that_is_no_longer() {
        for seed in 0..20 {
            let mut random = stream(seed, "several");
            let band = band(30, 9, &mut random);
            let before: Vec<u32> = (0..270).map(|_| below(&mut random, 4) as u32).collect();
            let after = shortened(&band, &before, 1, 1 << 30);
            assert!(cost(band.graph(), &after) < cost(band.graph(), &before), "{seed}");
        }
    }

    /// Capacities overflowed where 2²⁰ divided by the longest edge was no finite f32.
    #[test]
    fn the_tiniest_boundary_is_shortened_like_any_other() {
        let mut random = stream(0, "tiny");
        let mut band = band(12, 6, &mut random);
        let labels: Vec<u32> = (0..72).map(|_| below(&mut random, 2) as u32).collect();
        let plain = shortened(&band, &labels, 1, 1 << 30);
        band.edges.iter_mut().for_each(|edge| edge.weight *= f32::MIN_POSITIVE / 8.);
        assert_eq!(shortened(&band, &labels, 1, 1 << 30), plain);
    }

    #[test]
    fn a_boundary_is_moved_no_farther_than_told() {
        // Weights fall towards the lower end, where the cheapest boundary is.
        let (w, h) = (6, 40);
        let mut band = band(w, h, &mut stream(0, "far"));
        for i in 0..w * h {
            let fall = |j: u32| 1. + (2 * h - i / w - j as usize / w) as f32;
            let own = &mut band.edges[band.start[i] as usize..band.start[i + 1] as usize];
            own.iter_mut().for_each(|edge| edge.weight = edge.position().map_or(100., fall));
        }
        let labels: Vec<u32> = (0..w * h).map(|i| u32::from(i / w >= 8)).collect();
        let labels = shortened(&band, &labels, 1, 1 << 30);
        let expected: Vec<u32> = (0..w * h).map(|i| u32::from(i / w >= 8 + HOPS * PASSES)).collect();
        assert_eq!(labels, expected);
    }

    #[test]
    fn labels_are_the_same_whatever_threads_and_budget() {
        for seed in 0..10 {
            let mut random = stream(seed, "threads");
            let band = band(60, 20, &mut random);
            let labels: Vec<u32> =
                (0..1200).map(|i| (i % 60 / 10 + 6 * (i / 600)) as u32 + below(&mut random, 2) as u32).collect();
            let [one, four, files] = [(1, 1 << 30), (4, 1 << 30), (4, 0)]
                .map(|(threads, budget)| shortened(&band, &labels, threads, budget));
            assert!(one == four && one == files && one != labels, "{seed}");
        }
    }

    #[test]
    fn one_pass_finds_the_boundaries_of_all_pairs_of_a_round() {
        let mut random = stream(0, "passes");
        let band = band(30, 9, &mut random);
        let labels: Vec<u32> = (0..270).map(|_| below(&mut random, 5) as u32).collect();
        let round = [([0, 3], 0), ([2, 1], 0)];
        let naive = round.map(|([a, b], _)| {
            let touches = |i: u32, label| band.graph().around(i).iter().any(|edge| edge.label(&labels) == label);
            let side = |i: u32| match labels[i as usize] {
                own if own == a => touches(i, b),
                own if own == b => touches(i, a),
                _ => false,
            };
            (0..270).filter(|&i| side(i)).collect::<Vec<u32>>()
        });
        assert!(naive.iter().all(|positions| positions.len() > 20));
        let labelled = LabelledBand { graph: band.graph(), pieces: &pieces(band.graph()), labels: &labels, scale: 1. };
        assert_eq!(labelled.at_boundaries(&round), naive);
    }

    #[test]
    fn all_boundaries_come_in_rounds_that_share_no_label_in_a_piece() {
        let pairs: BTreeSet<[u32; 2]> = (0..6).flat_map(|a| (a + 1..6).map(move |b| [a, b])).collect();
        let boundaries: BTreeSet<Boundary> =
            pairs.iter().flat_map(|&pair| (pair[0]..3).map(move |piece| (pair, piece))).collect();
        let rounds = rounds(&boundaries);
        for round in &rounds {
            let ends: BTreeSet<_> = round.iter().flat_map(|(pair, piece)| pair.map(|label| (label, *piece))).collect();
            assert_eq!(ends.len(), 2 * round.len());
        }
        assert!(rounds[0].len() > 3);
        assert_eq!(rounds.into_iter().flatten().collect::<BTreeSet<_>>(), boundaries);
        assert_eq!(order_of_pairs(pairs.clone()).into_iter().collect::<BTreeSet<_>>(), pairs);
    }

    /// Two bands of the same labels are cut as if each pair were cut everywhere, one after another.
    #[test]
    fn pieces_apart_are_cut_as_the_whole() {
        for seed in 0..30 {
            let mut random = stream(seed, "pieces");
            let [one, other] = [band(24, 9, &mut random), band(20, 7, &mut random)];
            let m = one.start.len() as u32 - 1;
            let shifted = |edge: &BandEdge| match edge.position() {
                Some(to) => BandEdge::inside(to + m, edge.weight),
                None => *edge,
            };
            let both = Band {
                start: one
                    .start
                    .iter()
                    .copied()
                    .chain(other.start[1..].iter().map(|at| at + one.start[m as usize]))
                    .collect(),
                edges: one.edges.iter().copied().chain(other.edges.iter().map(shifted)).collect(),
            };
            let labels: Vec<u32> = (0..both.start.len() - 1).map(|_| below(&mut random, 5) as u32).collect();
            let cut = shortened(&both, &labels, 2, 1 << 30);
            let mut plain = labels.clone();
            let scale = UNITS / f64::from(both.edges.iter().map(|edge| edge.weight).fold(0f32, f32::max));
            let whole = vec![0; plain.len()];
            for _ in 0..PASSES {
                let touching = boundaries(both.graph(), &whole, &plain);
                for pair in order_of_pairs(touching.into_iter().map(|(pair, _)| pair).collect()) {
                    let band = LabelledBand { graph: both.graph(), pieces: &whole, labels: &plain, scale };
                    let begin = band.at_boundaries(&[(pair, 0)]);
                    let changes = band.cut(pair, &begin[0], &mut vec![0; whole.len()], &Cancel::default()).unwrap();
                    changes.into_iter().for_each(|(node, label)| plain[node as usize] = label);
                }
            }
            assert!(cut == plain && cut != labels, "{seed}");
            assert_eq!(pieces(both.graph()).into_iter().collect::<BTreeSet<_>>(), BTreeSet::from([0, m]));
        }
    }
}
