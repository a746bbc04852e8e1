//! Connected components in parallel: inside blocks of consecutive nodes, then over the edges between blocks.
//!
//! Nearly all neighbours of a node are close to it in number. So each block has a forest of its own, built by any
//! thread in its cache, and one thread joins the blocks' trees over the edges between them, a few in a hundred. The
//! trees are counted: if one is left, nothing more is to do, otherwise another pass gives each node its final root. If
//! rows are assembled part by part, each is a block, joined while it is in the cache, and the edges to earlier ones
//! follow at once ([`RootsWriter`]). Otherwise this is a pass of its own ([`find_roots`]). Where faces are scattered
//! there are too many such edges; then [`super::components`] processes node by node. A representative is the least
//! member of its set, so both methods give the same roots. That requires that all windings agree: with contradicting
//! parities, the order matters.
//!
//! Cost: about 3 ns per face and thread and 4 bytes written; in a pass of its own also 12 bytes read, and memory of 8
//! bytes per edge between blocks, of which there may be [`MOST_BETWEEN`].

use super::Csr;
use crate::base::Result;
use crate::base::union_find::{Forest, ParityForest};
use crate::store::npy::ArrayMut;
use crate::store::{Run, WorkDir};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// The file of the roots.
pub(super) const FILE: &str = "components.npy";
/// Minimum number of nodes per block, and maximum number of blocks.
const NODES: usize = 1 << 14;
const BLOCKS: usize = 128;
/// Maximum number of edges between blocks.
const MOST_BETWEEN: usize = 1 << 20;
/// Number of edges that a block reserves at a time; divides [`MOST_BETWEEN`].
const RESERVED_EDGES: usize = 1 << 8;
/// Room of a block whose reservation failed.
const FULL: usize = usize::MAX;

/// Fills `roots` (n) with the forest of the components of `graph`, not flattened yet, and returns their number. `None`
/// if memory or the limit on edges is exceeded.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub(super) fn find_roots(graph: Csr<'_>, roots: &mut [u32], run: &Run) -> Result<Option<usize>> {
    // Growing vectors may have twice the capacity that they need.
    let room = 2 * 8 * MOST_BETWEEN as u64;
    let Ok(_grant) = run.budget.take("components", room, room) else { return Ok(None) };
    let size = NODES.max(roots.len().div_ceil(BLOCKS));
    let held = AtomicUsize::new(0);
    let blocks = run.fill_chunks(
        roots,
        size,
        || (),
        |k, parents, ()| {
            if held.load(Relaxed) > MOST_BETWEEN {
                return Ok((0, Vec::new()));
            }
            Ok(block_roots(graph, k * size, parents, &held))
        },
    )?;
    if held.into_inner() > MOST_BETWEEN {
        return Ok(None);
    }
    let (mut forest, mut count) = (Forest::of(roots), 0);
    for (trees, between) in blocks {
        run.cancel.check()?;
        count += trees;
        count -= between.into_iter().filter(|&[a, b]| forest.join(a, b)).count();
    }
    Ok(Some(count))
}

/// Fills `roots` with the first node of each node's component within the block of nodes that starts at `first`; returns
/// the number of these components and the edges to earlier blocks. `held` counts the edges that all blocks have
/// reserved; beyond [`MOST_BETWEEN`] the results are incomplete and must not be used.
fn block_roots(graph: Csr<'_>, first: usize, roots: &mut [u32], held: &AtomicUsize) -> (usize, Vec<[u32; 2]>) {
    let (mut between, mut room) = (Vec::new(), 0);
    let nodes = first..first + roots.len();
    let mut forest = BlockForest::new(first, roots);
    graph.starts.each(nodes, |node, span| {
        // Once the limit is exceeded the result is of no use.
        let row = if room == FULL { &[] } else { &graph.indices[span] };
        let mut push = |edge| {
            if between.len() == room {
                // The limit applies to all threads together.
                room =
                    if held.fetch_add(RESERVED_EDGES, Relaxed) < MOST_BETWEEN { room + RESERVED_EDGES } else { FULL };
            }
            if room < FULL {
                between.push(edge);
            }
        };
        forest.add(node as u32, row, &mut push);
    });
    (forest.finish(), between)
}

/// The components within a block of consecutive nodes.
struct BlockForest<'a> {
    start: u32,
    forest: ParityForest<'a>,
}

impl<'a> BlockForest<'a> {
    /// No nodes yet of the block that starts at `first`; `roots` may be uninitialised.
    fn new(first: usize, roots: &'a mut [u32]) -> Self {
        Self { start: first as u32, forest: ParityForest::new(roots) }
    }

    /// Adds `node`, the next one, whose neighbours ascend in `row`; calls `between` with its edges to earlier blocks.
    #[inline(always)]
    fn add(&mut self, node: u32, row: &[u32], mut between: impl FnMut([u32; 2])) {
        let own = node - self.start;
        self.forest.add(own);
        let mut mine = (own, 0);
        // Rows ascend, and each edge is handled at its later node.
        for &near in row.iter().take_while(|near| **near < node) {
            if near >= self.start {
                mine = self.forest.join(mine, near - self.start, 0);
            } else {
                between([node, near]);
            }
        }
    }

    /// Makes each root that of the block, in numbers global to all blocks. Returns the number of trees.
    fn finish(self) -> usize {
        let (start, roots, mut trees) = (self.start, self.forest.into_parents(), 0);
        // As `flatten`.
        for i in 0..roots.len() {
            let parent = roots[i] as usize;
            trees += usize::from(parent == i);
            roots[i] = if parent == i { start + i as u32 } else { roots[parent] };
        }
        trees
    }
}

/// The components within a block of rows that are being assembled.
pub(super) struct BlockRoots {
    first: usize,
    roots: Vec<u32>,
    /// Number of components within the block.
    trees: usize,
    /// The edges to earlier blocks.
    between: Vec<[u32; 2]>,
}

impl BlockRoots {
    /// Those of the rows of these `degrees`, which begin with that of the node `first`; their neighbours are `indices`.
    pub fn of(first: usize, degrees: &[u32], indices: &[u32]) -> Self {
        let (mut roots, mut between) = (vec![0; degrees.len()], Vec::new());
        let mut forest = BlockForest::new(first, &mut roots);
        let mut rest = indices;
        for (node, degree) in (first as u32..).zip(degrees) {
            let (row, next) = rest.split_at(*degree as usize);
            forest.add(node, row, |edge| between.push(edge));
            rest = next;
        }
        let trees = forest.finish();
        Self { first, roots, trees, between }
    }
}

/// Joins the components of one block after the other, as their rows are assembled. Time: that of the edges between
/// blocks. Nothing is held but the roots, an array of the work directory.
pub(super) struct RootsWriter {
    /// `None` once windings disagreed.
    joined: Option<Joined>,
}

/// A forest of components.
pub(super) struct Joined {
    /// The parent of each node, none greater than its child (n).
    pub parents: ArrayMut<u32>,
    /// Number of components.
    pub count: usize,
}

impl RootsWriter {
    /// For `nodes` nodes.
    pub fn create(nodes: usize, work: &WorkDir) -> Result<Self> {
        Ok(Self { joined: Some(Joined { parents: work.array(FILE, &[nodes])?, count: 0 }) })
    }

    /// Adds the next block; `None` if windings disagree there.
    pub fn push(&mut self, block: Option<BlockRoots>) {
        let (Some(joined), Some(BlockRoots { first, roots, trees, between })) = (&mut self.joined, block) else {
            self.joined = None;
            return;
        };
        let all = &mut joined.parents.data()[..first + roots.len()];
        all[first..].copy_from_slice(&roots);
        let mut forest = Forest::of(all);
        joined.count += trees;
        joined.count -= between.into_iter().filter(|&[a, b]| forest.join(a, b)).count();
    }

    /// The forest of all nodes; `None` if windings disagree anywhere.
    pub fn finish(self) -> Option<Joined> {
        self.joined
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Cancel;
    use crate::base::random::{below, stream};
    use crate::base::union_find::{Forest, flatten};
    use crate::graph::OwnedRowStarts;
    use crate::store::Budget;

    /// A graph of `n` nodes with random edges: most span at most `reach`, `far` per cent are arbitrary.
    fn graph(n: usize, reach: usize, far: usize) -> (OwnedRowStarts, Vec<u32>, Vec<u32>) {
        let mut random = stream(1, "components");
        let mut forest = Forest::new(n);
        let mut rows = vec![Vec::new(); n];
        for _ in 0..n {
            let a = below(&mut random, n);
            let width = if below(&mut random, 100) < far { n } else { reach };
            let b = (a + 1 + below(&mut random, width)) % n;
            rows[a].push(b as u32);
            rows[b].push(a as u32);
            forest.join(a as u32, b as u32);
        }
        rows.iter_mut().for_each(|row| row.sort_unstable());
        (OwnedRowStarts::of(rows.iter().map(Vec::len)), rows.concat(), forest.labels())
    }

    #[test]
    fn blocks_find_what_one_forest_finds() {
        for (n, reach, far) in [(1, 1, 0), (300, 3, 0), (100_000, 3, 0), (100_000, 2, 1), (60_000, 9, 50)] {
            let (starts, indices, expected) = graph(n, reach, far);
            let count = (0u32..).zip(&expected).filter(|(node, root)| node == *root).count();
            for threads in [1, 3] {
                let run = Run { threads, ..Run::new(&()) };
                let mut roots = vec![0; n];
                let found = find_roots(Csr::new(starts.view(), &indices, &[]), &mut roots, &run).unwrap();
                flatten(&mut roots, &run.cancel).unwrap();
                assert!(roots == expected && found == Some(count), "{n} {reach} {far}");
            }
            // The same, joined block by block.
            let work = WorkDir::temporary(&std::env::temp_dir()).unwrap();
            let mut writer = RootsWriter::create(n, &work).unwrap();
            for first in (0..n).step_by(7_000) {
                let nodes = first..n.min(first + 7_000);
                let degrees: Vec<u32> = nodes.clone().map(|i| starts.view().span(i as u32).len() as u32).collect();
                let entries = starts.view().entries_of(nodes);
                writer.push(Some(BlockRoots::of(first, &degrees, &indices[entries])));
            }
            let mut joined = writer.finish().unwrap();
            flatten(joined.parents.data(), &Cancel::default()).unwrap();
            assert!(joined.parents.items() == expected && joined.count == count, "{n} {reach} {far}");
        }
        let work = WorkDir::temporary(&std::env::temp_dir()).unwrap();
        let mut writer = RootsWriter::create(2, &work).unwrap();
        [None, Some(BlockRoots::of(1, &[0], &[]))].into_iter().for_each(|block| writer.push(block));
        assert!(writer.finish().is_none(), "windings disagreed in the first block");
        let run = Run { budget: Budget::new(1 << 20), ..Run::new(&()) };
        assert!(find_roots(Csr::new(OwnedRowStarts::of([0]).view(), &[], &[]), &mut [0], &run).unwrap().is_none());
    }

    /// Regression: each thread could hold as many edges between blocks as all threads together may.
    #[test]
    fn edges_between_blocks_are_counted_over_all_of_them() {
        let n = 1 << 20;
        // Each node has an edge to the node four blocks earlier.
        let far = 4 * NODES;
        let rows = (0..n).map(|i| usize::from(i >= far));
        let indices: Vec<u32> = (0..(n - far) as u32).collect();
        let starts = OwnedRowStarts::of(rows);
        let csr = Csr::new(starts.view(), &indices, &[]);
        let (held, mut roots) = (AtomicUsize::new(MOST_BETWEEN - 3 * RESERVED_EDGES), vec![0; NODES]);
        let found = |k: usize, roots: &mut [u32]| block_roots(csr, k * NODES, roots, &held).1.len();
        assert_eq!([5, 6, 7].map(|k| found(k, &mut roots)), [3 * RESERVED_EDGES, 0, 0]);
    }

    /// A strip of quads: the first triangles from its end to its start, then the second ones from its start to its end.
    /// Each edge joins two blocks, and each join brings a new least root. Regression: the roots formed one long chain,
    /// which was walked for each of them.
    #[test]
    fn roots_of_blocks_that_are_joined_in_a_long_chain_are_found_soon() {
        let quads = 60_000;
        let (mut rows, first, second) = (vec![Vec::new(); 2 * quads], |q: usize| quads - 1 - q, |q: usize| quads + q);
        for q in 0..quads {
            for near in [Some(q), q.checked_sub(1)].into_iter().flatten() {
                rows[first(q)].push(second(near) as u32);
                rows[second(near)].push(first(q) as u32);
            }
        }
        rows.iter_mut().for_each(|row| row.sort_unstable());
        let (starts, indices) = (OwnedRowStarts::of(rows.iter().map(Vec::len)), rows.concat());
        let mut roots = vec![1; 2 * quads];
        let found = find_roots(Csr::new(starts.view(), &indices, &[]), &mut roots, &Run::new(&())).unwrap();
        flatten(&mut roots, &Cancel::default()).unwrap();
        assert!(found == Some(1) && roots.iter().all(|root| *root == 0));
    }

    #[test]
    fn too_many_edges_between_blocks_are_left_to_others() {
        // Each node of the second half is adjacent to three of the first.
        let n = 1 << 20;
        let rows = |i: usize| if i < n / 2 { 0..0 } else { i - n / 2..(i - n / 2 + 3).min(n / 2) };
        let indices: Vec<u32> = (0..n).flat_map(rows).map(|near| near as u32).collect();
        let starts = OwnedRowStarts::of((0..n).map(|i| rows(i).len()));
        let graph = Csr::new(starts.view(), &indices, &[]);
        assert!(find_roots(graph, &mut vec![0; n], &Run::new(&())).unwrap().is_none());
    }
}
