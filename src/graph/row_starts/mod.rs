//! Where the rows of a graph start, in half a byte per node instead of eight.
//!
//! Nearly every face has three neighbours, so the start of a row follows from its number, corrected for earlier rows
//! with fewer. Rows are therefore grouped in blocks of 64 ([`RowBlock`], 32 bytes): the start of the first one, and the
//! degrees of all in three bits each, one word per bit. If all degrees of a block are three, as in nearly all blocks, a
//! start is the start of the block plus a product: as fast as a plain array. In other blocks bits are counted. A block
//! with a row of more than seven edges has its starts in a table (8 bytes per row).
//!
//! Compared with the plain array this saves 7.5 bytes per face of disk and of memory traffic. Small graphs with varying
//! degrees (contractions, vertices) keep plain starts: counting bits for each node would slow their fronts down.

pub(super) mod writer;

use crate::base::Result;
use crate::store::mapped::{Access, advise, prefetch, will_need};
use crate::store::{MappedSlice, WorkDir};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

/// Rows per block.
pub const ROWS: usize = 64;
/// Words per block.
const WORDS: usize = size_of::<RowBlock>() / 8;
/// The bits of 64 degrees of three.
const THREES: [u64; 3] = [u64::MAX, u64::MAX, 0];
/// Greatest degree that three bits hold.
const MOST: u32 = 7;
/// Flag in [`RowBlock::start`]: the starts are in the table, at the position in `degrees[0]`.
const TABLE: u64 = 1 << 63;
/// Flag in [`RowBlock::start`]: not all degrees are three.
const COUNTED: u64 = 1 << 62;

/// Where 64 rows start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct RowBlock {
    /// First entry of the first row, with [`COUNTED`] or [`TABLE`] if not all 64 degrees are three.
    start: u64,
    /// The degrees, least bits first; bit k of each word belongs to row k.
    degrees: [u64; 3],
}

impl RowBlock {
    /// First entry of the first row.
    #[inline(always)]
    fn start(&self) -> usize {
        (self.start & !(TABLE | COUNTED)) as usize
    }

    /// The position of the rows' starts in the table, if they are there.
    fn place(&self) -> Option<usize> {
        (self.start & TABLE != 0).then_some(self.degrees[0] as usize)
    }

    /// The entries of row `k`, relative to the first of the block; only if degrees are stored as bits.
    #[inline(always)]
    fn counted(&self, k: u32) -> (usize, usize) {
        let before = (1u64 << k) - 1;
        let (mut start, mut degree) = (0, 0);
        for (bit, word) in self.degrees.iter().enumerate() {
            start += ((word & before).count_ones() as usize) << bit;
            degree += ((word >> k & 1) as usize) << bit;
        }
        (start, degree)
    }
}

/// Where the rows of a graph start and end.
#[derive(Clone, Copy, Debug)]
pub enum RowStarts<'a> {
    /// The starts, and the end (n + 1).
    Plain(&'a [u64]),
    /// In blocks.
    Packed(PackedStarts<'a>),
}

/// Where rows start, in blocks.
#[derive(Clone, Copy, Debug)]
pub struct PackedStarts<'a> {
    rows: usize,
    blocks: &'a [RowBlock],
    table: &'a [u64],
}

impl PackedStarts<'_> {
    /// The entries of `row`.
    #[inline(always)]
    fn span(self, row: u32) -> Range<usize> {
        let (block, k) = (&self.blocks[row as usize / ROWS], row % ROWS as u32);
        if block.start < COUNTED {
            let start = block.start as usize + 3 * k as usize;
            return start..start + 3;
        }
        self.uneven(block, k)
    }

    /// [`PackedStarts::span`] of row `k` of a block with varying degrees.
    #[inline(never)]
    fn uneven(self, block: &RowBlock, k: u32) -> Range<usize> {
        if let Some(place) = block.place() {
            let at = place + k as usize;
            return self.table[at] as usize..self.table[at + 1] as usize;
        }
        let (start, degree) = block.counted(k);
        block.start() + start..block.start() + start + degree
    }

    /// The row of `entry`.
    fn row_of(self, entry: usize) -> usize {
        // A block without entries starts where the next one does, so the last block that starts at or before `entry`
        // contains it.
        let block = self.blocks.partition_point(|block| block.start() <= entry) - 1;
        let (mut row, mut after) = (block * ROWS, self.rows.min((block + 1) * ROWS));
        while after - row > 1 {
            let middle = row.midpoint(after);
            if self.span(middle as u32).start <= entry {
                row = middle;
            } else {
                after = middle;
            }
        }
        row
    }
}

impl RowStarts<'_> {
    /// Number of rows n.
    #[inline(always)]
    pub fn len(self) -> usize {
        match self {
            Self::Plain(starts) => starts.len() - 1,
            Self::Packed(packed) => packed.rows,
        }
    }

    /// The entries of `row`.
    #[inline(always)]
    pub fn span(self, row: u32) -> Range<usize> {
        match self {
            Self::Plain(starts) => starts[row as usize] as usize..starts[row as usize + 1] as usize,
            Self::Packed(packed) => packed.span(row),
        }
    }

    /// Calls `visit` with consecutive `rows` and their entries: cheaper than [`RowStarts::span`].
    #[inline(always)]
    pub fn each(self, rows: Range<usize>, mut visit: impl FnMut(usize, Range<usize>)) {
        let mut start = self.entries_of(rows.clone()).start;
        for row in rows {
            // `visit` is called in only one place, so that it is inlined.
            let end = match self {
                Self::Packed(packed) if packed.blocks[row / ROWS].start < COUNTED => start + 3,
                _ => self.span(row as u32).end,
            };
            visit(row, start..end);
            start = end;
        }
    }

    /// Prefetches what [`RowStarts::span`] of `row` reads.
    #[inline(always)]
    pub fn prefetch(self, row: u32) {
        match self {
            Self::Plain(starts) => prefetch(starts, row as usize),
            Self::Packed(packed) => prefetch(packed.blocks, row as usize / ROWS),
        }
    }

    /// Total number of entries.
    pub fn entries(self) -> usize {
        self.len().checked_sub(1).map_or(0, |last| self.span(last as u32).end)
    }

    /// The entries of consecutive `rows`.
    pub fn entries_of(self, rows: Range<usize>) -> Range<usize> {
        match rows.end.checked_sub(1) {
            Some(last) if last >= rows.start => self.span(rows.start as u32).start..self.span(last as u32).end,
            _ => 0..0,
        }
    }

    /// The row of `entry`, and its entries.
    ///
    /// # Panics
    /// If there is no such entry.
    pub fn row_of(self, entry: usize) -> (usize, Range<usize>) {
        let row = match self {
            Self::Plain(starts) => starts.partition_point(|&start| start as usize <= entry) - 1,
            Self::Packed(packed) => packed.row_of(entry),
        };
        (row, self.span(row as u32))
    }

    /// Advises the kernel that the starts of consecutive `rows` are read next.
    pub fn will_need(self, rows: Range<usize>) {
        match self {
            Self::Plain(starts) => will_need(&starts[rows.start..=rows.end]),
            Self::Packed(packed) => will_need(&packed.blocks[rows.start / ROWS..rows.end.div_ceil(ROWS)]),
        }
    }

    /// Advises the kernel how starts are read from now on.
    pub fn advise(self, access: Access) {
        match self {
            Self::Plain(starts) => advise(starts, access),
            Self::Packed(PackedStarts { blocks, table, .. }) => {
                advise(blocks, access);
                advise(table, access);
            }
        }
    }

    /// The starts as plain numbers (n + 1), as other programs use them.
    pub fn plain(self) -> Vec<u64> {
        let starts = (0..self.len() as u32).map(|row| self.span(row).start as u64);
        starts.chain([self.entries() as u64]).collect()
    }

    /// Bytes of the arrays.
    pub fn bytes(self) -> u64 {
        match self {
            Self::Plain(starts) => size_of_val(starts) as u64,
            Self::Packed(PackedStarts { blocks, table, .. }) => (size_of_val(blocks) + size_of_val(table)) as u64,
        }
    }
}

/// The two file formats of row starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartsForm {
    /// [`PLAIN`]: for small graphs with varying degrees.
    Plain,
    /// [`BLOCKS`] and [`LONG_ROWS`]: for the graph of a mesh's faces.
    Packed,
}

impl StartsForm {
    /// Opens the starts of `rows` rows of an earlier run in `work`.
    ///
    /// # Errors
    /// [`crate::base::Error::WorkDir`] if they do not ascend from 0 to `entries`; [`crate::base::Error::Io`].
    pub fn open(self, work: &WorkDir, rows: usize, entries: usize) -> Result<OwnedRowStarts> {
        if self == Self::Plain {
            return Ok(OwnedRowStarts::Plain(work.starts(PLAIN, rows, entries)?));
        }
        let blocks: MappedSlice<u64> = work.array_of(BLOCKS, WORDS * rows.div_ceil(ROWS))?;
        let table: MappedSlice<u64> = work.open_array(LONG_ROWS)?;
        if (PackedStarts { rows, blocks: bytemuck::cast_slice(&blocks), table: &table }).ascend(entries) {
            return Ok(OwnedRowStarts::Packed { rows, blocks, table });
        }
        Err(work.damaged(BLOCKS, format!("does not ascend from 0 to {entries}")))
    }
}

/// Row starts that own their arrays: in files, or in memory.
#[derive(Clone, Debug)]
pub enum OwnedRowStarts {
    /// The starts, and the end (n + 1).
    Plain(MappedSlice<u64>),
    /// In blocks.
    Packed {
        /// Number of rows n.
        rows: usize,
        /// Four words per 64 rows.
        blocks: MappedSlice<u64>,
        /// Starts of blocks with long rows, 65 each.
        table: MappedSlice<u64>,
    },
}

/// The file of plain starts: `u64` (n + 1).
pub const PLAIN: &str = "graph_indptr.npy";
/// The file of the blocks: `u64` (n / 64, 4).
pub const BLOCKS: &str = "graph_row_blocks.npy";
/// The file of the starts of blocks with long rows: `u64`, 65 a block, the end included.
pub const LONG_ROWS: &str = "graph_long_rows.npy";

impl OwnedRowStarts {
    /// Their format.
    pub fn form(&self) -> StartsForm {
        match self {
            Self::Plain(_) => StartsForm::Plain,
            Self::Packed { .. } => StartsForm::Packed,
        }
    }

    /// The starts as raw slices for hot loops.
    #[inline(always)]
    pub fn view(&self) -> RowStarts<'_> {
        match self {
            Self::Plain(starts) => RowStarts::Plain(starts),
            Self::Packed { rows, blocks, table } => {
                RowStarts::Packed(PackedStarts { rows: *rows, blocks: bytemuck::cast_slice(blocks), table })
            }
        }
    }
}

impl PackedStarts<'_> {
    /// Whether the rows ascend from 0 to `entries`, without gaps.
    fn ascend(self, entries: usize) -> bool {
        let (mut end, mut tables) = (0, 0);
        for (k, block) in self.blocks.iter().enumerate() {
            if block.start() != end {
                return false;
            }
            let rows = (self.rows - k * ROWS).min(ROWS);
            if block.start < COUNTED && (rows < ROWS || block.degrees != THREES) {
                return false;
            }
            let sum = match block.place() {
                Some(place) => {
                    let Some(starts) = self.table.get(place..).and_then(|rest| rest.get(..=ROWS)) else { return false };
                    tables += 1;
                    if starts[0] != end as u64 || !starts.is_sorted() {
                        return false;
                    }
                    Some(starts[rows] as usize)
                }
                None => {
                    let (start, degree) = block.counted(rows as u32 - 1);
                    end.checked_add(start + degree)
                }
            };
            let Some(sum) = sum.filter(|sum| *sum <= entries) else { return false };
            end = sum;
        }
        end == entries && self.table.len() == tables * (ROWS + 1)
    }
}
