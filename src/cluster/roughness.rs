//! Whether a mesh's own normals are too rough for measuring turning: on the whole mesh, or on patches of a large one.
//!
//! The measure is P₀/P_.02, total turning with the faces' own normals over that with normals smoothed at .02 of √(area)
//! ([`super::normals`]). A clean mesh needs no smoothed normals, and computing them is what this test would cost; so a
//! mesh of more than [`SAMPLED`] faces is tested on [`PATCHES`] discs of its surface first. Around the centre of each,
//! breadth-first walks gather faces up to a distance and sum them in a grid of boxes; a smoothed normal is the sum over
//! the boxes, weighted like sums over micro-cells.
//!
//! Cost: a seventh of the faces are visited, some 80 ns each (.6 s on two threads for 100 million faces); one bit of
//! memory per face and thread. If nearly all faces lie in a small region, each disc there would gather nearly all of
//! them: a disc stops at [`MOST`] of all faces, and the whole mesh is tested instead.

use super::area_shares::{AreaShares, SurfaceSum};
use super::normals::{RADII, SmoothingCell, falloff, smooth_normal};
use crate::base::Result;
use crate::graph::angle::between;
use crate::graph::{DualGraph, Node};
use crate::store::Run;
use crate::store::mapped::Access;
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

/// Meshes with more faces are judged by patches, if the result is clear enough.
pub const SAMPLED: usize = 1 << 18;

/// Number of discs.
const PATCHES: usize = 48;
/// Radius of a disc, in units of √(area): near the radius of smoothing, so that a crease in a disc counts with both
/// kinds of normals.
const DISC: f32 = 0.012;
/// How far away the faces are that contribute to a disc's smoothed normals, along the walk.
const REACH: f32 = 0.034;
/// Width of a box.
const BOX: f32 = 0.007;
/// Boxes along an axis: walks stay within [`REACH`] of their centre.
const BOXES: usize = 2 * (REACH / BOX) as usize + 3;
/// Maximum share of all faces gathered around a disc: 35 times the number if all faces had the same size.
const MOST: f64 = 0.125;
/// Approximate number of faces of a disc whose smoothed normals are computed: these vary slowly.
const LOOKS: usize = 512;

/// Estimates of P₀ and P_.02: Σ length · |θ| over the edges with the nodes' own normals and smoothed ones, in units of
/// √(area). `None` if a disc that turns has too many faces to gather.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn sampled_turning(graph: &DualGraph, shares: &AreaShares, run: &Run) -> Result<Option<[f64; 2]>> {
    let n = graph.nodes.len();
    let patches = PATCHES.min(n);
    // The kernel would read megabytes around each of the many small runs of nodes that a walk enters.
    let paged = run.is_paged(graph.edges.indices.as_ref());
    let advise = |access| {
        if paged {
            graph.edges.by_distance().advise(access);
            graph.nodes.view().advise(access);
        }
    };
    advise(Access::Random);
    // One crowded disc is enough: the others need not be walked.
    let is_crowded = AtomicBool::new(false);
    let sums = run.map_chunks(
        patches,
        || Patch::new(graph, shares, paged),
        |k, patch| {
            run.cancel.check()?;
            if is_crowded.load(Ordering::Relaxed) {
                return Ok([0.; 2]);
            }
            // The disc is centred in the middle of one of equal runs of nodes.
            let turning = patch.turn_of_normals((((2 * k + 1) * n) / (2 * patches)) as u32);
            is_crowded.fetch_or(turning.is_none(), Ordering::Relaxed);
            Ok(turning.unwrap_or_default())
        },
    );
    advise(Access::Local);
    let sums = sums?;
    let total = sums.iter().fold([0.; 2], |total, sum| [total[0] + sum[0], total[1] + sum[1]]);
    Ok((!is_crowded.into_inner()).then(|| total.map(|total| total / patches as f64 * n as f64)))
}

/// Whether a mesh's own normals are too rough for measuring turning, given its total turning at radius 0 and .02. Clean
/// meshes have P₀/P_.02 of 1.0–1.3, scans 2.4–3.1, noisy ones up to 30. A surface without any turning is clean.
pub fn is_rough(own: f64, coarse: f64) -> bool {
    own > 1.6 * coarse
}

/// Whether [`sampled_turning`] suffices to rule out [`is_rough`]. Unlike micro-cells, boxes have no seams between them,
/// so a sample's ratio is 1.0 to 4.6 times that of the whole mesh, with a median of 1.4. Of 80 models of the benchmark,
/// refined to 0.2 to 14 million faces, 52 were below 1.75, all of which have 1.28 or less over the whole mesh. A
/// surface without any turning, such as a plane, is clean.
pub fn is_clearly_clean([own, coarse]: [f64; 2]) -> bool {
    own <= 1.75 * coarse
}

/// Whether a mesh with this [`sampled_turning`] is probably rough: a wrong guess only costs time.
pub fn is_likely_rough([own, coarse]: [f64; 2]) -> bool {
    own >= 2.6 * coarse
}

/// The radius of normals for a rough mesh, from its total turning at .01 and .02: an index into
/// [`super::normals::RADII`].
pub fn choose_radius(fine: f64, coarse: f64) -> usize {
    if fine < 1.2 * coarse { 0 } else { 1 }
}

/// A disc of a surface and its surroundings; buffers are reused for each disc.
struct Patch<'a> {
    graph: &'a DualGraph,
    shares: &'a AreaShares,
    /// Whether nodes are requested where the walk enters a page of [`Visited`].
    paged: bool,
    visited: Visited,
    /// The queue of the walk: nodes with their distances.
    walk: VecDeque<(u32, f32)>,
    disc: Vec<u32>,
    /// The faces in each box.
    boxes: Vec<SurfaceSum>,
    /// The boxes that hold any faces.
    cells: Vec<SmoothingCell>,
}

impl<'a> Patch<'a> {
    fn new(graph: &'a DualGraph, shares: &'a AreaShares, paged: bool) -> Self {
        Self {
            graph,
            shares,
            paged,
            visited: Visited::new(graph.nodes.len()),
            walk: VecDeque::new(),
            disc: Vec::new(),
            boxes: Vec::new(),
            cells: Vec::new(),
        }
    }

    /// The mean turning per face in the disc around `middle`; 0 if that is in a tiny component. `None` if the disc
    /// could be gathered only in part, and turns.
    fn turn_of_normals(&mut self, middle: u32) -> Option<[f64; 2]> {
        let Self { graph, shares, .. } = *self;
        if shares.at(middle as usize) <= 0. {
            return Some([0.; 2]);
        }
        let is_whole = self.gather(middle);
        let falloff = falloff(RADII[1], shares);
        let (disc, smooth) = (&self.disc, |node: &Node| smooth_normal(node, self.cells.iter(), falloff));
        let every = disc.len().div_ceil(LOOKS);
        let (mut sums, edges) = ([0f64; 2], graph.edges.shared());
        for (k, &i) in disc.iter().enumerate() {
            let own = graph.nodes.at(i as usize);
            let looked = (k % every == 0).then(|| smooth(&own));
            for (j, edge) in edges.neighbours(i) {
                let node = graph.nodes.at(j as usize);
                let length = f64::from(edge.abs() * shares.unit);
                sums[0] += length * f64::from(between(own.normal, node.normal));
                if let Some(looked) = looked {
                    sums[1] += every as f64 * length * f64::from(between(looked, smooth(&node)));
                }
            }
        }
        // Centres are evenly spread over face numbers, so a disc contributes the mean of its faces. Each edge has two
        // faces.
        (is_whole || sums[0] == 0.).then(|| sums.map(|sum| sum / (2 * disc.len()) as f64))
    }

    /// Walks over the faces around `middle`: puts the near ones into `disc`, and all into `cells`. Returns false if the
    /// walk was cut off at [`MOST`] of the mesh.
    fn gather(&mut self, middle: u32) -> bool {
        let Self { graph, shares, paged, .. } = *self;
        let (lengths, nodes) = (graph.edges.by_distance(), graph.nodes.view());
        let enter = |page: Range<usize>| {
            if paged {
                let page = page.start..page.end.min(nodes.len());
                lengths.will_need_rows(page.clone());
                nodes.will_need(page);
            }
        };
        let scale = 1. / shares.unit;
        let (reach, near, width) = (REACH * scale, DISC * scale, BOX * scale);
        let origin = graph.nodes.at(middle as usize).centroid;
        self.visited.clear();
        self.disc.clear();
        self.boxes.clear();
        self.boxes.resize(BOXES.pow(3), SurfaceSum::default());
        self.visited.insert(middle, enter);
        self.walk.push_back((middle, 0.));
        let mut left = ((graph.nodes.len() as f64 * MOST) as usize).max(1);
        let mut total = 0f64;
        while left > 0
            && let Some((i, distance)) = self.walk.pop_front()
        {
            left -= 1;
            let node = nodes.at(i as usize);
            let share = f64::from(shares.of_node(i as usize, &node));
            total += share;
            let mut at = 0;
            for axis in 0..3 {
                let step = ((node.centroid[axis] - origin[axis]) / width).round() + (BOXES / 2) as f32;
                at = BOXES * at + (step.max(0.) as usize).min(BOXES - 1);
            }
            self.boxes[at].take(&node, share, 0.);
            if distance <= near {
                self.disc.push(i);
            }
            for (j, step) in lengths.neighbours(i) {
                if distance + step <= reach && self.visited.insert(j, enter) {
                    // It will be processed after all nodes already in the queue.
                    nodes.prefetch(j as usize);
                    lengths.prefetch(j);
                    self.walk.push_back((j, distance + step));
                }
            }
        }
        let is_whole = self.walk.is_empty();
        self.walk.clear();
        let held = self.boxes.iter().filter(|sum| sum.share > 0.);
        self.cells.clear();
        self.cells.extend(held.map(|sum| SmoothingCell::of(sum, 1. / total)));
        is_whole
    }
}

/// Which nodes were visited: one bit each, in pages of 4,096 nodes that are allocated on demand.
struct Visited {
    pages: Vec<Option<Box<[u64; 64]>>>,
    made: Vec<u32>,
}

impl Visited {
    fn new(nodes: usize) -> Self {
        Self { pages: vec![None; nodes.div_ceil(4096)], made: Vec::new() }
    }

    /// Marks `node`, and calls `enter` with the nodes of its page if that is new; returns whether the node is new.
    fn insert(&mut self, node: u32, enter: impl Fn(Range<usize>)) -> bool {
        let page = self.pages[node as usize / 4096].get_or_insert_with(|| {
            let number = node / 4096;
            enter(4096 * number as usize..4096 * (number as usize + 1));
            self.made.push(number);
            Box::new([0; 64])
        });
        let (word, bit) = (&mut page[node as usize / 64 % 64], 1 << (node % 64));
        let is_new = *word & bit == 0;
        *word |= bit;
        is_new
    }

    fn clear(&mut self) {
        self.made.drain(..).for_each(|page| self.pages[page as usize] = None);
    }
}

#[cfg(test)]
mod tests {
    use super::{Range, Visited, is_clearly_clean, is_rough};
    use std::cell::RefCell;

    /// Regression: half a million faces at one position were smoothed for a minute.
    #[test]
    fn what_does_not_turn_is_clean() {
        assert!(is_clearly_clean([0., 0.]) && is_clearly_clean([1., 1.]) && !is_clearly_clean([1., 0.]));
        assert!(!is_rough(0., 0.) && !is_rough(1., 1.) && is_rough(1., 0.));
    }

    #[test]
    fn visits_are_remembered_until_they_are_cleared() {
        let mut visited = Visited::new(10_000);
        for _ in 0..2 {
            let entered = RefCell::new(Vec::new());
            let enter = |page: Range<usize>| entered.borrow_mut().push(page);
            for node in [0, 63, 64, 4095, 4096, 9_999] {
                assert!(visited.insert(node, enter) && !visited.insert(node, enter), "{node}");
            }
            visited.clear();
            assert_eq!(*entered.borrow(), [0..4096, 4096..8192, 8192..12_288]);
        }
    }
}
