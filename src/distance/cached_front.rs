//! Full fronts over graphs larger than memory, with a block cache instead of mapped files.
//!
//! The same label-correcting search as [`super::front`], with the same values to the bit (tested). Rows come from a
//! [`BlockCache`] instead of mapped files; [`READERS`] threads read ahead of the front.
//!
//! Blocks are as large as memory allows for [`SLOTS`]: large ones are read faster, small ones follow the band more
//! closely. If memory does not suffice even for the smallest, there is no cache. If the band turns out wider than the
//! cache, as in an order that scatters neighbours, blocks have to be read again and again; then the front gives up, and
//! the row is computed over the mapping.
//!
//! Cost at 100 million faces in 1 GiB: some 75 ns per face on the front's thread, since recently read data are not in
//! the processor's caches (50 ns if the graph is in memory); a tenth of that is waiting.

use super::block_cache::{BlockCache, Blocks, Job, Readers, RowFile, aligned, words_of};
use super::front::{FRONT_WIDTH, GATHER};
use super::paging::block_starts;
use super::queue::{Entry, Queue};
use super::steps::{FAR, MID};
use crate::base::parallel::{catch, spawn};
use crate::base::{Cancel, Result};
use crate::graph::Csr;
use crate::graph::csr::DirectGraph;
use crate::store::Budget;
use crate::store::direct::PAGE;
use crate::store::mapped::AlignedBuffer;
use std::sync::Arc;

/// Threads that read blocks for each front: disks are faster with two reads in flight.
const READERS: usize = 2;
/// Block sizes, as powers of two.
const SHIFTS: std::ops::RangeInclusive<u32> = 10..=14;
/// Number of slots, relative to the square root of the number of blocks: a band takes 4 in a good order, and prefetched
/// blocks the rest.
const SLOTS: f64 = 5.;
/// Visits between checks of the stop flag.
const STOP_CHECK: usize = 1 << 16;

/// The division of a graph into blocks, and how many of them fit in memory.
#[derive(Clone, Debug)]
pub(super) struct Division {
    shift: u32,
    slots: usize,
    words: usize,
    starts: Arc<[u64]>,
}

impl Division {
    /// The best division of `graph` for `bytes` of memory; `None` if that is too little. Reads one row start per block.
    pub fn of(graph: Csr<'_>, bytes: u64) -> Option<Self> {
        let division = |shift: u32| {
            let starts = block_starts(graph.starts, shift);
            let words = words_of(&starts);
            let slots = (bytes as usize).saturating_sub(PAGE) / slot_bytes(words, shift);
            Self { shift, slots: slots.min(starts.len() - 1), words, starts: starts.into() }
        };
        let enough = |division: &Self| {
            let blocks = (division.starts.len() - 1) as f64;
            division.slots as f64 >= (SLOTS * blocks.sqrt()).min(blocks)
        };
        SHIFTS.rev().map(division).find(enough)
    }

    /// Bytes of all its slots.
    fn bytes(&self) -> u64 {
        (self.slots * slot_bytes(self.words, self.shift) + PAGE) as u64
    }
}

/// Bytes of a slot: neighbours and weights of `words` words each, and values.
fn slot_bytes(words: usize, shift: u32) -> usize {
    8 * words + (4 << shift)
}

/// A front with a cache, reused for one row after the other.
pub(super) struct CachedFront<'a> {
    graph: Csr<'a>,
    files: &'a DirectGraph,
    division: Division,
    memory: AlignedBuffer,
    queue: Queue,
    batch: Vec<Entry>,
    relaxations: Vec<Entry>,
    gave_up: bool,
}

impl<'a> CachedFront<'a> {
    /// A front over `graph`, whose weights have the mean `mean` and whose arrays lie in `files`; `None` if `budget` has
    /// no memory for the slots of `division`.
    pub fn new(graph: Csr<'a>, files: &'a DirectGraph, mean: f32, division: Division, budget: &Budget) -> Option<Self> {
        let bytes = division.bytes().next_multiple_of(8);
        let memory = AlignedBuffer::of(budget.take("blocks of the graph", bytes, bytes).ok()?);
        let queue = Queue::new(mean * FRONT_WIDTH);
        Some(Self { graph, files, division, memory, queue, batch: Vec::new(), relaxations: Vec::new(), gave_up: false })
    }

    /// Writes the distances from `source` to `row`. Returns false if the front gave up, now or earlier; the content of
    /// `row` is then meaningless.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn full(&mut self, source: u32, row: RowFile<'_>, cancel: &Cancel) -> Result<bool> {
        if self.gave_up {
            return Ok(false);
        }
        let Division { shift, slots, words, starts } = &self.division;
        let blocks = Blocks { graph: self.graph, shift: *shift, starts, words: *words };
        let memory: &mut [u32] = aligned(bytemuck::cast_slice_mut(self.memory.bytes_mut()));
        let (memory, field) = memory.split_at_mut(2 * words * slots);
        let field: &mut [f32] = bytemuck::cast_slice_mut(&mut field[..slots << shift]);
        let (jobs, received) = crossbeam_channel::unbounded::<Job<'_>>();
        let (out, done) = crossbeam_channel::unbounded();
        let files = self.files;
        let (queue, batch, relaxations) = (&mut self.queue, &mut self.batch, &mut self.relaxations);
        let finished = std::thread::scope(|scope| {
            for reader in 0..READERS {
                let (received, out) = (received.clone(), out.clone());
                let started = spawn(scope, move || {
                    for mut job in received {
                        let read = catch(|| blocks.read(&mut job, files)).flatten();
                        if out.send(read.map(|()| job)).is_err() {
                            break;
                        }
                    }
                });
                // If the system refuses further threads, fewer readers do.
                if started.is_err() && reader == 0 {
                    return Ok(false);
                }
            }
            drop((received, out));
            let mut cache = BlockCache::new(blocks, memory, field, Readers { jobs, done }, row);
            let whole = walk(source, &mut cache, (queue, batch, relaxations), cancel)?;
            if whole { cache.finish().map(|()| true) } else { Ok(false) }
        });
        if !matches!(finished, Ok(true)) {
            self.gave_up = true;
            queue.clear();
        }
        finished
    }
}

/// The loop of [`super::front`] over a cache; false if the cache is thrashing.
fn walk(
    source: u32,
    cache: &mut BlockCache<'_, '_>,
    (queue, batch, relaxations): (&mut Queue, &mut Vec<Entry>, &mut Vec<Entry>),
    cancel: &Cancel,
) -> Result<bool> {
    let mut visits_left = STOP_CHECK;
    queue.restart(0.);
    batch.clear();
    *cache.value(source)? = 0.;
    queue.push(Entry { node: source, distance: 0. });
    while queue.pop_bucket(batch) {
        if visits_left <= batch.len() {
            visits_left = STOP_CHECK;
            cancel.check()?;
        } else {
            visits_left -= batch.len();
        }
        let len = batch.len();
        queue.peek(FAR, batch);
        for start in (0..len).step_by(GATHER) {
            if cache.is_thrashing() {
                return Ok(false);
            }
            relaxations.clear();
            for k in start..len.min(start + GATHER) {
                if let Some(entry) = batch.get(k + FAR) {
                    cache.prefetch(entry.node);
                }
                if let Some(entry) = batch.get(k + MID) {
                    cache.prefetch_steps(entry.node);
                }
                cache.steps(batch[k], relaxations)?;
            }
            for &to in relaxations.iter() {
                let known = cache.value(to.node)?;
                if to.distance < *known {
                    *known = to.distance;
                    queue.push(to);
                }
            }
        }
        batch.clear();
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::Result;
    use crate::distance::Front;
    use crate::graph::{OwnedRowStarts, WeightedGraph};
    use crate::store::MappedSlice;
    use crate::store::npy::{self, ArrayMut};
    use std::path::Path;

    const SIDE: usize = 150;

    /// A grid of two disconnected sheets, some of whose nodes have long-range edges, in files.
    fn grid(folder: &Path) -> WeightedGraph {
        let n = SIDE * SIDE;
        let mut steps = vec![Vec::new(); n];
        let mut random = 1u32;
        let mut join = |a: usize, b: usize| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let weight = 0.01 + (random >> 8) as f32 / 1e6;
            steps[a].push((b as u32, weight));
            steps[b].push((a as u32, weight));
        };
        for node in 0..n {
            if node % SIDE + 1 < SIDE {
                join(node, node + 1);
            }
            // There are no edges between the rows 99 and 100.
            if node + SIDE < n && node / SIDE != 99 {
                join(node, node + SIDE);
            }
            if node % 997 == 0 && node < 50 * SIDE {
                join(node, node + 45 * SIDE);
            }
        }
        steps.iter_mut().for_each(|row| row.sort_by_key(|step| step.0));
        let starts = OwnedRowStarts::of(steps.iter().map(|row| row.len()));
        let all: Vec<(u32, f32)> = steps.concat();
        let (indices, weights): (Vec<u32>, Vec<f32>) = all.into_iter().unzip();
        let indices = npy::write(&folder.join("indices.npy"), &indices, 1, false).unwrap();
        let weights = npy::write(&folder.join("weights.npy"), &weights, 1, false).unwrap();
        WeightedGraph::new(folder, starts, indices, weights, String::new()).unwrap()
    }

    /// A row by a cached front in blocks of `1 << shift` nodes, of which `slots` fit; `None` if it gave up.
    fn row(graph: &WeightedGraph, shift: u32, slots: usize, source: u32, folder: &Path) -> Result<Option<Vec<f32>>> {
        let csr = graph.csr();
        let starts = block_starts(csr.starts, shift);
        let division = Division { shift, slots, words: words_of(&starts), starts: starts.into() };
        let files = graph.direct()?.unwrap();
        let mut front = CachedFront::new(csr, &files, 0.1, division, &Budget::new(1 << 30)).unwrap();
        let path = folder.join("row.npy");
        let mut array: ArrayMut<f32> = ArrayMut::create(&path, &[csr.len()])?;
        let values = array.data().writeback().unwrap();
        // The second row finds the memory as the first one left it.
        for source in [source / 2, source] {
            let row = RowFile { values: &values, path: &path };
            if !front.full(source, row, &Cancel::default())? {
                assert!(!front.full(source, row, &Cancel::default())?);
                return Ok(None);
            }
        }
        Ok(Some(array.data().to_vec()))
    }

    #[test]
    fn rows_have_the_bits_of_a_plain_front_however_few_blocks_fit() {
        let dir = tempfile::tempdir().unwrap();
        let graph = grid(dir.path());
        let n = SIDE * SIDE;
        let mut given_up = 0;
        for source in [0, 7_000, n as u32 - 1] {
            let mut expected = vec![0f32; n];
            Front::new(0.1).full(graph.csr(), source, &mut expected, &Cancel::default()).unwrap();
            assert!(expected.contains(&f32::INFINITY));
            for (shift, slots) in [(14, 2), (10, 22), (10, 6), (8, 30), (6, 300), (6, 20), (6, 4), (4, 40), (4, 1)] {
                match row(&graph, shift, slots, source, dir.path()).unwrap() {
                    Some(found) => assert!(found == expected, "{source} {shift} {slots}"),
                    None => given_up += 1,
                }
            }
        }
        assert!((1..20).contains(&given_up), "{given_up}");
    }

    #[test]
    fn damage_and_cancellation_end_a_front() {
        let dir = tempfile::tempdir().unwrap();
        let graph = grid(dir.path());
        let division = Division::of(graph.csr(), 8 << 20).unwrap();
        assert!(division.bytes() <= 8 << 20 && Division::of(graph.csr(), 4096).is_none());
        let files = graph.direct().unwrap().unwrap();
        let budget = Budget::new(1 << 30);
        let mut front = CachedFront::new(graph.csr(), &files, 0.1, division, &budget).unwrap();
        assert!(budget.left() < 1 << 30);
        let path = dir.path().join("row.npy");
        let mut array: ArrayMut<f32> = ArrayMut::create(&path, &[SIDE * SIDE]).unwrap();
        let values = array.data().writeback().unwrap();
        std::fs::OpenOptions::new().write(true).open(dir.path().join("weights.npy")).unwrap().set_len(5000).unwrap();
        let row = RowFile { values: &values, path: &path };
        let error = front.full(3, row, &Cancel::default()).unwrap_err().to_string();
        assert!(error.contains("weights.npy"), "{error}");
        let none = WeightedGraph::new(
            dir.path(),
            OwnedRowStarts::of([1, 1]),
            MappedSlice::from(vec![1, 0]),
            npy::write(&dir.path().join("two.npy"), &[1f32, 1.], 1, false).unwrap(),
            String::new(),
        );
        assert!(none.unwrap().direct().unwrap().is_none());
    }
}
