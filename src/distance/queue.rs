//! The front's queue: a ring of buckets of equal width, first in, first out within a bucket, and a heap for entries
//! beyond the ring.
//!
//! Real weights are heavy-tailed (mean 6–8 times the median, maximum 100 times the mean), so order inside a bucket
//! matters: last-in-first-out needs an exploding number of visits, first-in-first-out 1.0–1.5 per node for widths from
//! .03 to .5 of the mean weight (measured).
//!
//! Entries are stored in blocks of [`BLOCK_ENTRIES`] from a pool, so the queue's memory is that of the front (O(√n)
//! entries) plus at most one partly filled block per busy bucket, 8 MB.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Buckets in the ring; a power of two.
pub const RING: usize = 1 << 14;
/// Entries per block.
pub const BLOCK_ENTRIES: usize = 62;
const NONE: u32 = u32::MAX;

/// A node reached at a distance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Entry {
    /// The node.
    pub node: u32,
    /// Its tentative distance when it was pushed.
    pub distance: f32,
}

#[derive(Clone, Debug)]
struct Block {
    entries: [Entry; BLOCK_ENTRIES],
    len: u32,
    next: u32,
}

/// A monotone bucket queue.
#[derive(Debug)]
pub struct Queue {
    /// Buckets per unit of distance.
    inverse_width: f32,
    heads: Vec<u32>,
    tails: Vec<u32>,
    /// One bit per bucket: whether it holds entries.
    busy: Vec<u64>,
    pool: Vec<Block>,
    free: u32,
    /// Number of the first bucket that may hold entries.
    current: u64,
    /// Entries beyond the ring, nearest first; the bits of non-negative `f32`s have the same order as the numbers.
    far: BinaryHeap<Reverse<(u32, u32)>>,
}

impl Queue {
    /// An empty queue of buckets `width` wide.
    pub fn new(width: f32) -> Self {
        Self {
            inverse_width: if width > 0. { (1. / width).min(1e30) } else { 1. },
            heads: vec![NONE; RING],
            tails: vec![NONE; RING],
            busy: vec![0; RING / 64],
            pool: Vec::new(),
            free: NONE,
            current: 0,
            far: BinaryHeap::new(),
        }
    }

    /// The number of the bucket for a distance; monotonic, saturating. Via `i32`, which processors convert to directly.
    #[inline]
    fn bucket(&self, distance: f32) -> u64 {
        (distance * self.inverse_width) as i32 as u64
    }

    /// Restarts for a front whose least source distance is `distance`. The queue must be empty.
    pub fn restart(&mut self, distance: f32) {
        self.current = self.bucket(distance);
    }

    /// Adds an entry; its distance must not lie below the bucket being emptied.
    #[inline]
    pub fn push(&mut self, entry: Entry) {
        self.push_at(self.bucket(entry.distance), entry);
    }

    /// Adds an entry whose distance may lie below the bucket being emptied; it then comes next.
    #[inline]
    pub fn push_late(&mut self, entry: Entry) {
        self.push_at(self.bucket(entry.distance).max(self.current), entry);
    }

    #[inline(always)]
    fn push_at(&mut self, bucket: u64, entry: Entry) {
        if bucket >= self.current + RING as u64 {
            self.far.push(Reverse((entry.distance.to_bits(), entry.node)));
            return;
        }
        let slot = bucket as usize % RING;
        let tail = self.tails[slot];
        if tail != NONE {
            let block = &mut self.pool[tail as usize];
            if (block.len as usize) < BLOCK_ENTRIES {
                block.entries[block.len as usize] = entry;
                block.len += 1;
                return;
            }
        }
        self.push_block(slot, entry);
    }

    #[cold]
    fn push_block(&mut self, slot: usize, entry: Entry) {
        let id = if self.free == NONE {
            self.pool.push(Block { entries: [Entry::default(); BLOCK_ENTRIES], len: 0, next: NONE });
            (self.pool.len() - 1) as u32
        } else {
            let id = self.free;
            self.free = self.pool[id as usize].next;
            id
        };
        let block = &mut self.pool[id as usize];
        block.entries[0] = entry;
        block.len = 1;
        block.next = NONE;
        if self.heads[slot] == NONE {
            self.heads[slot] = id;
            self.busy[slot / 64] |= 1 << (slot % 64);
        } else {
            let tail = self.tails[slot];
            self.pool[tail as usize].next = id;
        }
        self.tails[slot] = id;
    }

    /// Moves the entries of the first non-empty bucket to the end of `out`; false if the queue is empty. Entries pushed
    /// into that bucket meanwhile are returned by the next call.
    pub fn pop_bucket(&mut self, out: &mut Vec<Entry>) -> bool {
        loop {
            let near = self.next_busy();
            let far = self.far.peek().map(|Reverse((bits, _))| self.bucket(f32::from_bits(*bits)));
            if let Some(near) = near
                && far.is_none_or(|far| far > near)
            {
                self.current = near;
                self.take(near as usize % RING, out);
                return true;
            }
            let Some(far) = far else { return false };
            self.current = far;
            self.bring_near();
        }
    }

    /// Discards all entries, after a front was aborted.
    pub fn clear(&mut self) {
        let mut dropped = Vec::new();
        while self.pop_bucket(&mut dropped) {
            dropped.clear();
        }
    }

    /// Moves entries from the heap to the part of the ring that now covers them.
    fn bring_near(&mut self) {
        while let Some(&Reverse((bits, node))) = self.far.peek() {
            let distance = f32::from_bits(bits);
            if self.bucket(distance) >= self.current + RING as u64 {
                break;
            }
            self.far.pop();
            self.push(Entry { node, distance });
        }
    }

    /// The first bucket from the current one on that holds entries.
    fn next_busy(&self) -> Option<u64> {
        let start = self.current as usize % RING;
        let words = RING / 64;
        let first = self.busy[start / 64] & (u64::MAX << (start % 64));
        for step in 0..=words {
            let index = (start / 64 + step) % words;
            let word = match step {
                0 => first,
                _ if step == words => self.busy[index] & !(u64::MAX << (start % 64)),
                _ => self.busy[index],
            };
            if word != 0 {
                let slot = index * 64 + word.trailing_zeros() as usize;
                return Some(self.current + ((slot + RING - start) % RING) as u64);
            }
        }
        None
    }

    /// Copies up to `most` of the next entries to the end of `out`; none of those beyond the ring.
    pub fn peek(&self, most: usize, out: &mut Vec<Entry>) {
        if let Some(near) = self.next_busy() {
            let block = &self.pool[self.heads[near as usize % RING] as usize];
            out.extend_from_slice(&block.entries[..(block.len as usize).min(most)]);
        }
    }

    fn take(&mut self, slot: usize, out: &mut Vec<Entry>) {
        let mut id = self.heads[slot];
        self.heads[slot] = NONE;
        self.tails[slot] = NONE;
        self.busy[slot / 64] &= !(1 << (slot % 64));
        while id != NONE {
            let block = &mut self.pool[id as usize];
            out.extend_from_slice(&block.entries[..block.len as usize]);
            let next = block.next;
            block.next = self.free;
            self.free = id;
            id = next;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_come_bucket_by_bucket_in_order_of_arrival_near_and_far() {
        let mut queue = Queue::new(1.);
        queue.restart(0.);
        let distances = [5.5, 0.5, 1e9, 5.1, 20_000., 0.1, 1e9 + 64., 40_000.];
        for (node, &distance) in distances.iter().enumerate() {
            queue.push(Entry { node: node as u32, distance });
        }
        let mut seen = Vec::new();
        let mut out = Vec::new();
        while queue.pop_bucket(&mut out) {
            seen.extend(out.drain(..).map(|e| e.node));
        }
        assert_eq!(seen, [1, 5, 0, 3, 4, 7, 2, 6]);
    }

    #[test]
    fn many_entries_in_one_bucket_keep_their_order() {
        let mut queue = Queue::new(1.);
        queue.restart(3.);
        for node in 0..1000 {
            queue.push(Entry { node, distance: 3.5 });
        }
        let mut out = Vec::new();
        assert!(queue.pop_bucket(&mut out));
        assert_eq!(out.iter().map(|e| e.node).collect::<Vec<_>>(), (0..1000).collect::<Vec<_>>());
        assert!(!queue.pop_bucket(&mut out));
    }
}
