//! The blocks of a graph that a front is currently in, cached in the program's own memory: for graphs larger than
//! memory.
//!
//! A front is a narrow band, so few blocks of consecutive nodes are in use at a time: some 4 √(blocks) of them in a
//! good order. Each has a slot here with the edges of its nodes, read past the page cache ([`DirectArray`]), and its
//! part of the row, which starts at infinity and is written to the row's file when the slot is needed for another
//! block. Reader threads load the blocks that the front enters, and prefetch those that its edges lead to. A clock
//! algorithm evicts the first block that was not used since the hand last passed. None of this affects the values.
//!
//! Compared with the mapping ([`super::paging`]) this saves the kernel's share, half of the processor time, and the
//! waits for blocks that are requested only when they are entered. Memory: 28 bytes per node of a slot, 6 per block.

use super::queue::Entry;
use crate::base::{Error, Result};
use crate::graph::Csr;
use crate::graph::csr::DirectGraph;
use crate::store::direct::{DirectArray, PAGE};
use crate::store::mapped::{Writeback, prefetch};
use crossbeam_channel::{Receiver, Sender};
use std::ops::Range;
use std::path::Path;

/// No slot.
const NONE: u32 = u32::MAX;
/// Flag in the table: the block was prefetched, but the front has not entered it yet.
const AHEAD: u32 = 1 << 31;
/// At most one in this many slots may hold prefetched blocks that the front has not entered.
const WAITING: usize = 3;

/// A graph in blocks of `1 << shift` nodes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blocks<'a> {
    pub graph: Csr<'a>,
    pub shift: u32,
    /// First entry of each block's rows, followed by the number of entries (blocks + 1).
    pub starts: &'a [u64],
    /// Words in a slot for the neighbours of a block, and as many for the weights.
    pub words: usize,
}

impl Blocks<'_> {
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    fn nodes(&self, block: u32) -> Range<usize> {
        let first = (block as usize) << self.shift;
        first..(first + (1 << self.shift)).min(self.graph.len())
    }

    /// Reads the rows of a block into the buffer of `job`.
    pub fn read(&self, job: &mut Job<'_>, files: &DirectGraph) -> Result<()> {
        let entries = self.starts[job.block as usize] as usize..self.starts[job.block as usize + 1] as usize;
        let (neighbours, weights) = job.memory.split_at_mut(self.words);
        let first = files.indices.read(entries.clone(), neighbours)?;
        job.first = [first, self.words + files.weights.read(entries.clone(), weights)?];
        let mut last = job.block;
        for next in &neighbours[first..first + entries.len()] {
            let block = next >> self.shift;
            if block != last && block != job.block && !job.beside.contains(&block) {
                job.beside.push(block);
            }
            last = block;
        }
        Ok(())
    }
}

/// A block to be read.
pub(super) struct Job<'m> {
    slot: u32,
    block: u32,
    memory: &'m mut [u32],
    /// Words at which neighbours and weights start, once they are read.
    first: [usize; 2],
    /// Blocks that its edges lead to.
    beside: Vec<u32>,
}

struct Slot<'m> {
    block: u32,
    used: bool,
    /// Empty while it is being read.
    memory: &'m mut [u32],
    first: [usize; 2],
    /// First entry of the block's rows.
    entry: usize,
    beside: Vec<u32>,
}

impl Slot<'_> {
    fn is_waiting(&self) -> bool {
        self.memory.is_empty()
    }

    /// Whether the block is loaded and its neighbours were requested.
    #[inline(always)]
    fn is_quiet(&self) -> bool {
        !self.is_waiting() & self.beside.is_empty()
    }
}

/// Threads that read blocks: the channels for jobs and for results.
pub(super) struct Readers<'m> {
    pub jobs: Sender<Job<'m>>,
    pub done: Receiver<Result<Job<'m>>>,
}

/// The file of a row.
#[derive(Clone, Copy)]
pub(super) struct RowFile<'a> {
    pub values: &'a Writeback,
    /// The file, for errors.
    pub path: &'a Path,
}

/// Blocks in memory.
pub(super) struct BlockCache<'m, 'a> {
    blocks: Blocks<'a>,
    mask: u32,
    /// Slot of each block, possibly with [`AHEAD`], or [`NONE`].
    table: Vec<u32>,
    /// Whether a block's values have been written to the file.
    written: Vec<bool>,
    slots: Vec<Slot<'m>>,
    /// Values, slot by slot.
    field: &'m mut [f32],
    hand: usize,
    waiting: usize,
    /// Number of blocks read again after eviction.
    again: usize,
    readers: Readers<'m>,
    row: RowFile<'a>,
}

impl<'m, 'a> BlockCache<'m, 'a> {
    /// A cache of as many blocks as `memory` holds; `field` has room for their values, which are written to `row`.
    pub fn new(
        blocks: Blocks<'a>,
        memory: &'m mut [u32],
        field: &'m mut [f32],
        readers: Readers<'m>,
        row: RowFile<'a>,
    ) -> Self {
        let slot = |memory| Slot { block: NONE, used: false, memory, first: [0; 2], entry: 0, beside: Vec::new() };
        Self {
            blocks,
            mask: (1 << blocks.shift) - 1,
            table: vec![NONE; blocks.len()],
            written: vec![false; blocks.len()],
            slots: memory.chunks_exact_mut(2 * blocks.words).map(slot).collect(),
            field,
            hand: 0,
            waiting: 0,
            again: 0,
            readers,
            row,
        }
    }

    /// Whether blocks have been reread so often that plain fronts would be cheaper.
    pub fn is_thrashing(&self) -> bool {
        self.again > self.blocks.len() + self.slots.len()
    }

    /// The slot of the block of `node`; the front enters the block if it has not yet.
    #[inline(always)]
    fn slot(&mut self, node: u32) -> Result<usize> {
        let slot = self.table[(node >> self.blocks.shift) as usize];
        if slot < AHEAD { Ok(slot as usize) } else { self.enter_block(node >> self.blocks.shift) }
    }

    /// The index of the value of `node` in the slot `slot`.
    #[inline(always)]
    fn place(&self, slot: usize, node: u32) -> usize {
        slot << self.blocks.shift | (node & self.mask) as usize
    }

    /// The value of `node`.
    #[inline(always)]
    pub fn value(&mut self, node: u32) -> Result<&mut f32> {
        let slot = self.slot(node)?;
        let place = self.place(slot, node);
        Ok(&mut self.field[place])
    }

    /// Prefetches the row start of `node`, and its value if its block is loaded.
    #[inline(always)]
    pub fn prefetch(&self, node: u32) {
        self.blocks.graph.starts.prefetch(node);
        let slot = self.table[(node >> self.blocks.shift) as usize];
        if slot < AHEAD {
            prefetch(self.field, self.place(slot as usize, node));
        }
    }

    /// Prefetches the edges of `node` if its block is loaded.
    #[inline(always)]
    pub fn prefetch_steps(&self, node: u32) {
        if let Some(slot) = self.slots.get(self.table[(node >> self.blocks.shift) as usize] as usize) {
            let at = self.blocks.graph.span(node).start.wrapping_sub(slot.entry);
            prefetch(slot.memory, slot.first[0].wrapping_add(at));
            prefetch(slot.memory, slot.first[1].wrapping_add(at));
            prefetch(slot.memory, slot.first[1].wrapping_add(at + 2));
        }
    }

    /// Appends the neighbours of `node` that this entry can still improve, or nothing if the entry is stale. Waits for
    /// the block.
    #[inline(always)]
    pub fn steps(&mut self, Entry { node, distance }: Entry, out: &mut Vec<Entry>) -> Result<()> {
        let slot = self.slot(node)?;
        // Stale: the value was lowered since this entry was pushed, and a later entry does the work.
        if self.field[self.place(slot, node)] < distance {
            return Ok(());
        }
        let slot = if self.slots[slot].is_quiet() { slot } else { self.wait(node)? };
        let block = node >> self.blocks.shift;
        let first = slot << self.blocks.shift;
        let slot = &mut self.slots[slot];
        slot.used = true;
        let span = self.blocks.graph.span(node);
        let at = span.start - slot.entry;
        let neighbours = &slot.memory[slot.first[0] + at..][..span.len()];
        let weights = &slot.memory[slot.first[1] + at..][..span.len()];
        for (&node, &weight) in neighbours.iter().zip(weights) {
            let to = Entry { node, distance: distance + f32::from_bits(weight) };
            let beyond = node >> self.blocks.shift != block;
            if beyond || to.distance < self.field[first | (node & self.mask) as usize] {
                out.push(to);
            }
        }
        Ok(())
    }

    /// Waits for the block of `node`, and requests its neighbouring blocks, but only once: if slots are scarce, loading
    /// those may evict the block itself.
    #[cold]
    #[inline(never)]
    fn wait(&mut self, node: u32) -> Result<usize> {
        let mut asked = false;
        loop {
            let slot = self.slot(node)?;
            self.slots[slot].used = true;
            if self.slots[slot].is_waiting() {
                self.receive()?;
            } else if !asked && !self.slots[slot].beside.is_empty() {
                asked = true;
                self.look_ahead(slot)?;
            } else {
                return Ok(slot);
            }
        }
    }

    /// The front enters a block.
    #[cold]
    #[inline(never)]
    fn enter_block(&mut self, block: u32) -> Result<usize> {
        let known = self.table[block as usize];
        let slot = if known == NONE { self.load(block)? } else { (known & !AHEAD) as usize };
        self.table[block as usize] = slot as u32;
        self.slots[slot].used = true;
        Ok(slot)
    }

    /// Prefetches the blocks next to that of `slot` that the front has not entered.
    #[cold]
    #[inline(never)]
    fn look_ahead(&mut self, slot: usize) -> Result<()> {
        for block in std::mem::take(&mut self.slots[slot].beside) {
            if self.table[block as usize] == NONE
                && !self.written[block as usize]
                && self.waiting < self.slots.len() / WAITING
            {
                let slot = self.load(block)?;
                self.slots[slot].used = true;
                self.table[block as usize] = slot as u32 | AHEAD;
            }
        }
        Ok(())
    }

    /// Requests a block, after evicting another one.
    fn load(&mut self, block: u32) -> Result<usize> {
        while let Ok(job) = self.readers.done.try_recv() {
            self.install(job?);
        }
        let slot = self.free()?;
        let nodes = self.blocks.nodes(block);
        self.blocks.graph.starts.will_need(nodes.clone());
        let field = &mut self.field[slot << self.blocks.shift..][..nodes.len()];
        if self.written[block as usize] {
            self.again += 1;
            self.row.values.read(nodes.start, field).map_err(Error::io(self.row.path, "read"))?;
        } else {
            field.fill(f32::INFINITY);
        }
        let own = &mut self.slots[slot];
        (own.block, own.entry) = (block, self.blocks.starts[block as usize] as usize);
        own.beside.clear();
        let (memory, beside) = (std::mem::take(&mut own.memory), std::mem::take(&mut own.beside));
        self.waiting += 1;
        let job = Job { slot: slot as u32, block, memory, first: [0; 2], beside };
        self.readers.jobs.send(job).map_err(|_| Error::internal("nobody reads blocks"))?;
        Ok(slot)
    }

    /// A free slot, evicting its block if necessary.
    fn free(&mut self) -> Result<usize> {
        let mut moves = 0;
        loop {
            // Two full turns without an unused block: all are being read.
            if moves == 2 * self.slots.len() {
                self.receive()?;
                moves = 0;
            }
            moves += 1;
            self.hand = (self.hand + 1) % self.slots.len();
            let slot = &mut self.slots[self.hand];
            if slot.is_waiting() || std::mem::take(&mut slot.used) {
                continue;
            }
            self.evict(self.hand)?;
            return Ok(self.hand);
        }
    }

    /// Evicts the block in `slot`; its values are written to the file.
    fn evict(&mut self, slot: usize) -> Result<()> {
        let block = std::mem::replace(&mut self.slots[slot].block, NONE);
        if block == NONE {
            return Ok(());
        }
        // A block that the front never entered has no values.
        if std::mem::replace(&mut self.table[block as usize], NONE) < AHEAD {
            let nodes = self.blocks.nodes(block);
            let field = &self.field[slot << self.blocks.shift..][..nodes.len()];
            self.row.values.write(nodes.start, field).map_err(Error::io(self.row.path, "write"))?;
            self.row.values.start(nodes);
            self.written[block as usize] = true;
        }
        Ok(())
    }

    /// Waits for one block.
    #[cold]
    #[inline(never)]
    fn receive(&mut self) -> Result<()> {
        let job = self.readers.done.recv().map_err(|_| Error::internal("nobody reads blocks"))??;
        self.install(job);
        Ok(())
    }

    /// Installs a block that was read.
    fn install(&mut self, job: Job<'m>) {
        self.waiting -= 1;
        let slot = &mut self.slots[job.slot as usize];
        (slot.memory, slot.first, slot.beside) = (job.memory, job.first, job.beside);
    }

    /// Writes the remaining values; nodes of blocks that the front never entered are infinitely far.
    pub fn finish(mut self) -> Result<()> {
        for slot in 0..self.slots.len() {
            self.evict(slot)?;
        }
        let empty = vec![f32::INFINITY; 1 << self.blocks.shift];
        for block in (0..self.blocks.len() as u32).filter(|&block| !self.written[block as usize]) {
            let nodes = self.blocks.nodes(block);
            self.row.values.write(nodes.start, &empty[..nodes.len()]).map_err(Error::io(self.row.path, "write"))?;
            self.row.values.start(nodes);
        }
        Ok(())
    }
}

/// The maximum number of words for the neighbours of the nodes of one block.
pub(super) fn words_of(starts: &[u64]) -> usize {
    let most = starts.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap_or(0);
    DirectArray::words(most as usize)
}

/// The part of `memory` that starts at a multiple of [`PAGE`].
pub(super) fn aligned(memory: &mut [u32]) -> &mut [u32] {
    let skip = memory.as_ptr().align_offset(PAGE).min(memory.len());
    &mut memory[skip..]
}
