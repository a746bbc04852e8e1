//! A front: shortest distances from sources to every node, the program's innermost loop.
//!
//! Label-correcting Dijkstra on [`Queue`]'s buckets. The least fixed point of d(v) = min fl(d(u) + w) in `f32` is
//! unique, so any order of visits gives the same bits as a binary heap would (tested). If the field already holds
//! distances, they are lowered only where the new sources are nearer: this is the *pruned* front of the landmark
//! search, by the same code.
//!
//! Its cost is branch mispredictions and cache misses: whether an edge shortens a path is practically random. So the
//! edges of [`GATHER`] entries are first gathered without branching and then followed, where nearly all are shorter:
//! 9–13 % less time on scans. The data of entries are prefetched in stages, at most [`FAR`] entries ahead
//! ([`super::steps`]), also across the end of a bucket. If the graph has a [triangle
//! adjacency](crate::graph::TriangleAdjacency), that is used instead of the matrix. Measured (`benches/records`): 14–20
//! ns per face on scans with it on large pages, 27–31 with the matrix. Reading its 28 bytes once would take 1 ns per
//! face at a thread's 27 GB/s (measured): the rest is arithmetic, the queue, and random access.

use super::paging::{Paged, Pager, Pages};
use super::queue::{Entry, Queue};
use super::steps::{FAR, LONG_ROW, Packed, Plain, Steps, look_ahead, warm_up};
use super::ties::Ties;
use crate::base::{Cancel, Result};
use crate::graph::csr::SampledMean;
use crate::graph::{Csr, RowStarts};
use crate::store::mapped::{Access, Writeback, advise, will_need};

/// Entries whose shorter paths are gathered before any is followed.
pub(super) const GATHER: usize = 32;
/// Bucket width of a front over all nodes, relative to the mean weight.
pub const FRONT_WIDTH: f32 = 0.125;
/// Visits between checks of the stop flag.
const STOP_CHECK: usize = 1 << 16;

/// An edge that shortens the path to a node, and the node it comes from.
#[derive(Clone, Copy, Debug, Default)]
struct Relaxation {
    to: Entry,
    from: u32,
}

/// What a front carries along its paths besides distances: nothing, a limit, or the label of the nearest source.
trait PathLabel {
    /// Whether a node at this distance may be visited.
    #[inline(always)]
    fn admits(&self, _distance: f32) -> bool {
        true
    }
    /// Whether the label decides between paths of equal length.
    #[inline(always)]
    fn resolves_ties(&self) -> bool {
        false
    }
    /// Whether the label of `from` should replace that of `to` at an equal distance.
    fn wins_tie(&mut self, from: u32, to: u32) -> bool;
    /// Copies the label of `from` to `to`.
    fn copy(&mut self, from: u32, to: u32);
}

impl PathLabel for () {
    #[inline(always)]
    fn wins_tie(&mut self, _: u32, _: u32) -> bool {
        false
    }
    #[inline(always)]
    fn copy(&mut self, _: u32, _: u32) {}
}

/// No label; nodes at the limit or beyond keep their values.
struct Within(f32);

impl PathLabel for Within {
    #[inline(always)]
    fn admits(&self, distance: f32) -> bool {
        distance < self.0
    }
    #[inline(always)]
    fn wins_tie(&mut self, _: u32, _: u32) -> bool {
        false
    }
    #[inline(always)]
    fn copy(&mut self, _: u32, _: u32) {}
}

/// The label of the nearest source; at equal distances the smaller label wins, so given final distances the labels are
/// a unique fixed point too.
struct NearestSource<'a> {
    label: &'a mut [u32],
    /// Nodes that met a tie which they had already won.
    ties: Vec<u32>,
    /// Maximum number of listed ties.
    most: usize,
}

impl<'a> NearestSource<'a> {
    fn new(label: &'a mut [u32], graph: Csr<'_>) -> Self {
        Self { label, ties: Vec::new(), most: Ties::most(graph) }
    }

    fn into_ties(self) -> Ties {
        Ties::of(self.ties, self.most)
    }
}

impl PathLabel for NearestSource<'_> {
    #[inline(always)]
    fn resolves_ties(&self) -> bool {
        true
    }
    #[inline(always)]
    fn wins_tie(&mut self, from: u32, to: u32) -> bool {
        let (from, own) = (self.label[from as usize], self.label[to as usize]);
        if from > own && self.ties.len() < 2 * self.most {
            self.ties.push(to);
        }
        from < own
    }
    #[inline(always)]
    fn copy(&mut self, from: u32, to: u32) {
        self.label[to as usize] = self.label[from as usize];
    }
}

/// Clears the labels of all nodes that a front reached (those where `field` (n) is neither 0 nor infinite), so that
/// another front over the same distances recomputes them from scratch.
pub(super) fn clear_labels(field: &[f32], label: &mut [u32]) {
    for (label, &distance) in label.iter_mut().zip(field) {
        if distance > 0. && distance < f32::INFINITY {
            *label = u32::MAX;
        }
    }
}

/// A reusable front. Scratch memory is proportional to the front and kept between runs.
///
/// ```
/// use nystrom_stream::base::Cancel;
/// use nystrom_stream::distance::Front;
/// use nystrom_stream::distance::front::mean_weight;
/// use nystrom_stream::graph::{Csr, OwnedRowStarts};
///
/// // The path 0 – 1 – 2 with steps of 1 and 2.
/// let starts = OwnedRowStarts::of([1, 2, 1]);
/// let graph = Csr::new(starts.view(), &[1, 0, 2, 1], &[1., 1., 2., 2.]);
/// let mut field = [0f32; 3];
/// Front::new(mean_weight(graph)).full(graph, 0, &mut field, &Cancel::default())?;
/// assert_eq!(field, [0., 1., 3.]);
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
#[derive(Debug)]
pub struct Front {
    queue: Queue,
    batch: Vec<Entry>,
    relaxations: Vec<Relaxation>,
    pages: Option<Pages>,
}

/// Statistics of a front.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Visits {
    /// Nodes expanded, some of them more than once.
    pub expanded: u64,
}

impl std::ops::Add for Visits {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { expanded: self.expanded + other.expanded }
    }
}

/// The mean weight of a graph, from 65,536 to 131,071 evenly spread entries, or from all if there are fewer. These may
/// touch the whole file of a mapped graph: use [`typical_weight`] for bucket widths.
pub fn mean_weight(graph: Csr<'_>) -> f32 {
    SampledMean::mean(SampledMean::of(graph.weights.len()).sample(0, graph.weights))
}

/// Number of runs of entries sampled for a typical weight, and entries in each.
const RUNS: usize = 1_024;
const RUN: usize = 64;

/// Approximately the mean weight of a graph, from evenly spread runs of entries: a bucket width needs no more, and in a
/// mapped graph each run reads only one page, all requested at once.
pub fn typical_weight(graph: Csr<'_>) -> f32 {
    let entries = graph.weights.len();
    if entries <= RUNS * RUN {
        return mean_weight(graph);
    }
    let run = |k: usize| &graph.weights[k * (entries - RUN) / (RUNS - 1)..][..RUN];
    (0..RUNS).for_each(|k| will_need(run(k)));
    let sum: f64 = (0..RUNS).flat_map(run).map(|&weight| f64::from(weight)).sum();
    (sum / (RUNS * RUN) as f64) as f32
}

impl Front {
    /// A front over `graph`, with a bucket width that suits its weights.
    pub fn over(graph: Csr<'_>) -> Self {
        Self::new(typical_weight(graph))
    }

    /// A front for graphs whose weights have the given mean.
    pub fn new(mean_weight: f32) -> Self {
        Self::with_width(mean_weight * FRONT_WIDTH)
    }

    /// A front with buckets of the given width.
    pub fn with_width(width: f32) -> Self {
        Self { queue: Queue::new(width), batch: Vec::new(), relaxations: Vec::new(), pages: None }
    }

    /// The same for a graph larger than memory: `pages` announces to the operating system what will be read next.
    #[must_use]
    pub fn paged(self, pages: Option<Pages>) -> Self {
        Self { pages, ..self }
    }

    /// Whether the front manages paging.
    pub fn is_paged(&self) -> bool {
        self.pages.is_some()
    }

    /// Advises the kernel how `field` will be used from now on, if the front manages paging.
    pub fn advise(&self, field: &[f32], access: Access) {
        if self.is_paged() {
            advise(field, access);
        }
    }

    /// Sets the file of the next fields, if the front manages paging.
    pub fn values(&mut self, values: Option<Writeback>) {
        if let Some(pages) = &mut self.pages {
            pages.values(values);
        }
    }

    /// Distances from one node: `field` (n) is overwritten, with infinity where unreached.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn full(&mut self, graph: Csr<'_>, source: u32, field: &mut [f32], cancel: &Cancel) -> Result<Visits> {
        let Some(mut pages) = self.pages.take() else {
            field.fill(f32::INFINITY);
            return self.lower(graph, &[source], field, cancel);
        };
        pages.restart();
        let empty = |block: &mut [f32]| {
            // All pages at once: faulting in never-written pages one by one costs more than the front.
            will_need(block);
            block.fill(f32::INFINITY);
        };
        if let Some(block) = pages.enter(graph, source) {
            empty(&mut field[block]);
        }
        self.start(&[source], field);
        let result = self.walk(graph, field, &mut (), &mut Paged { graph, pages: &mut pages, on_enter: empty }, cancel);
        pages.not_entered().for_each(|block| empty(&mut field[block]));
        pages.send_all();
        self.pages = Some(pages);
        result
    }

    /// Lowers `field` (n) to the distances from `sources` where those are smaller; visits only nodes that are lowered.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn lower(&mut self, graph: Csr<'_>, sources: &[u32], field: &mut [f32], cancel: &Cancel) -> Result<Visits> {
        self.lowered(graph, sources, field, &mut (), cancel)
    }

    /// Distances to the nearest of many sources, and which one: `label` (n) gets the index in `sources` of the nearest
    /// (the smaller index at a tie), `u32::MAX` where none is reached.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn nearest_source(
        &mut self,
        graph: Csr<'_>,
        sources: &[u32],
        field: &mut [f32],
        label: &mut [u32],
        cancel: &Cancel,
    ) -> Result<Visits> {
        field.fill(f32::INFINITY);
        let (visits, ties) = self.front_with_labels(graph, sources, field, label, cancel)?;
        if ties.correct_labels(graph, field, label, false, cancel)? {
            return Ok(visits);
        }
        // A second front over the final distances: only labels change, and none can become stale.
        let (again, _) = self.front_with_labels(graph, sources, field, label, cancel)?;
        Ok(visits + again)
    }

    /// Runs the front with labels. Also returns the nodes whose label may be stale.
    fn front_with_labels(
        &mut self,
        graph: Csr<'_>,
        sources: &[u32],
        field: &mut [f32],
        label: &mut [u32],
        cancel: &Cancel,
    ) -> Result<(Visits, Ties)> {
        label.fill(u32::MAX);
        for (k, &source) in sources.iter().enumerate().rev() {
            label[source as usize] = k as u32;
        }
        self.start(sources, field);
        let mut nearest = NearestSource::new(label, graph);
        let visits = self.spread(graph, field, &mut nearest, cancel)?;
        Ok((visits, nearest.into_ties()))
    }

    /// Like [`Front::lower`], but nodes at `limit` or beyond are not visited and keep their values.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn within(
        &mut self,
        graph: Csr<'_>,
        sources: &[u32],
        limit: f32,
        field: &mut [f32],
        cancel: &Cancel,
    ) -> Result<Visits> {
        self.lowered(graph, sources, field, &mut Within(limit), cancel)
    }

    /// Propagates the labels of `sources` to the nodes where `field` (n) is infinite; it must be 0 at all others, of
    /// which the sources are the boundary. At equal distances the smaller label wins. Unreached nodes keep their
    /// labels.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn propagate_labels(
        &mut self,
        graph: Csr<'_>,
        sources: &[u32],
        field: &mut [f32],
        label: &mut [u32],
        cancel: &Cancel,
    ) -> Result<Visits> {
        let mut nearest = NearestSource::new(label, graph);
        let visits = self.lowered(graph, sources, field, &mut nearest, cancel)?;
        if nearest.into_ties().correct_labels(graph, field, label, self.is_paged(), cancel)? {
            return Ok(visits);
        }
        // As in `nearest_source`.
        clear_labels(field, label);
        let again = self.lowered(graph, sources, field, &mut NearestSource::new(label, graph), cancel)?;
        Ok(visits + again)
    }

    /// A front that starts from the content of `field`.
    fn lowered(
        &mut self,
        graph: Csr<'_>,
        sources: &[u32],
        field: &mut [f32],
        label: &mut impl PathLabel,
        cancel: &Cancel,
    ) -> Result<Visits> {
        let Some(mut pages) = self.pages.take() else {
            self.start(sources, field);
            return self.spread(graph, field, label, cancel);
        };
        pages.restart();
        for block in sources.iter().filter_map(|&source| pages.enter(graph, source)) {
            will_need(&field[block]);
        }
        self.start(sources, field);
        let mut paged = Paged { graph, pages: &mut pages, on_enter: |block: &mut [f32]| will_need(block) };
        let result = self.walk(graph, field, label, &mut paged, cancel);
        pages.send_all();
        self.pages = Some(pages);
        result
    }

    fn start(&mut self, sources: &[u32], field: &mut [f32]) {
        self.queue.restart(0.);
        for &node in sources {
            field[node as usize] = 0.;
            self.queue.push(Entry { node, distance: 0. });
        }
    }

    fn spread(
        &mut self,
        graph: Csr<'_>,
        field: &mut [f32],
        label: &mut impl PathLabel,
        cancel: &Cancel,
    ) -> Result<Visits> {
        if let RowStarts::Plain(starts) = graph.starts {
            // Deciding this outside the loop saves a tenth of its time.
            return self.walk(Plain { starts, csr: graph }, field, label, &mut (), cancel);
        }
        if graph.triangles.is_empty() {
            return self.walk(graph, field, label, &mut (), cancel);
        }
        let packed = Packed { csr: &graph, triangles: graph.triangles };
        self.walk(packed, field, label, &mut (), cancel)
    }

    /// The loop itself, generic over `steps`; `pager` receives its position. A separate function for each form: in a
    /// single one the loop's variables do not stay in registers.
    #[inline(never)]
    fn walk(
        &mut self,
        steps: impl Steps,
        field: &mut [f32],
        label: &mut impl PathLabel,
        pager: &mut impl Pager,
        cancel: &Cancel,
    ) -> Result<Visits> {
        let Self { queue, batch, relaxations, .. } = self;
        let mut visits = Visits::default();
        let mut visits_left = STOP_CHECK;
        batch.clear();
        // The first entry after the batch, if its data were already prefetched.
        let mut fetched = None;
        while queue.pop_bucket(batch) {
            if visits_left <= batch.len() {
                visits_left = STOP_CHECK;
                if cancel.is_cancelled() {
                    queue.clear();
                    cancel.check()?;
                }
            } else {
                visits_left -= batch.len();
            }
            if fetched != Some(batch[0].node) {
                warm_up(batch, steps, field);
            }
            // Prefetching continues past the end of the batch.
            let len = batch.len();
            queue.peek(FAR, batch);
            fetched = batch.get(len).map(|entry| entry.node);
            for start in (0..len).step_by(GATHER) {
                let mut count = 0;
                for k in start..len.min(start + GATHER) {
                    look_ahead(batch, k, steps, field);
                    let Entry { node, distance } = batch[k];
                    // A stale entry, lowered since it was pushed, is useless: a later entry does the work.
                    let useful = field[node as usize] >= distance;
                    visits.expanded += u64::from(useful);
                    let edges = steps.count(node);
                    if edges > LONG_ROW && !useful {
                        continue;
                    }
                    let most = count + edges;
                    if most > relaxations.len() {
                        relaxations.resize(most + 4 * GATHER, Relaxation::default());
                    }
                    steps.each(node, |next, weight| {
                        let there = distance + weight;
                        pager.follow_edge(node, next, field);
                        relaxations[count] = Relaxation { to: Entry { node: next, distance: there }, from: node };
                        let known = field[next as usize];
                        let shorter = (there < known) | (label.resolves_ties() & (there == known));
                        count += usize::from(useful & shorter & label.admits(there));
                    });
                }
                for &Relaxation { to, from } in &relaxations[..count] {
                    let known = &mut field[to.node as usize];
                    if to.distance < *known {
                        *known = to.distance;
                        label.copy(from, to.node);
                        queue.push(to);
                    } else if to.distance == *known && label.wins_tie(from, to.node) {
                        label.copy(from, to.node);
                        queue.push(to);
                    }
                }
            }
            batch.clear();
        }
        Ok(visits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::OwnedRowStarts;

    #[test]
    fn a_typical_weight_is_near_the_mean() {
        for entries in [10, RUNS * RUN, RUNS * RUN + 1, 3_000_000] {
            // From 1 at the beginning to 2 at the end.
            let weights: Vec<f32> = (0..entries).map(|e| 1. + (e as f32 + 0.5) / entries as f32).collect();
            let (starts, indices) = (OwnedRowStarts::of(std::iter::repeat_n(1, entries)), vec![0; entries]);
            let graph = Csr::new(starts.view(), &indices, &weights);
            for weight in [typical_weight(graph), mean_weight(graph)] {
                assert!((weight / 1.5 - 1.).abs() < 1e-3, "{entries}: {weight}");
            }
        }
    }
}
