//! Where the rows of a graph begin, in half a byte per node instead of eight.
//!
//! Nearly every face has three neighbours, so the start of a row follows from its number, corrected for the rows before
//! it that have fewer. Rows are therefore counted in blocks of 64 ([`RowBlock`], 32 bytes): the start of the first one,
//! and the degrees of all in three bits each, one word per bit. In a block whose degrees are all three, as in nearly
//! all, a start is the start of the block plus a product: as quick as a plain array. In the others bits are counted. A
//! block with a row of more than seven steps has its starts in a table (8 bytes per row).
//!
//! Beside the plain array this saves 7.5 bytes per face of disk, and fronts touch as many fewer. Small graphs of many
//! degrees (contractions, vertices) stay with plain starts: counting bits for each node would slow their fronts down.

use crate::base::{Error, Result};
use crate::store::mapped::{Access, advise, prefetch, will_need};
use crate::store::npy::ArrayWriter;
use crate::store::{MappedSlice, WorkDir};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

/// Rows a block.
pub const ROWS: usize = 64;
/// Words a block.
const WORDS: usize = size_of::<RowBlock>() / 8;
/// Degrees of three alone.
const THREES: [u64; 3] = [u64::MAX, u64::MAX, 0];
/// Greatest degree that three bits hold.
const MOST: u32 = 7;
/// In [`RowBlock::start`]: the starts are in the table, from the place in `degrees[0]` on.
const TABLE: u64 = 1 << 63;
/// In [`RowBlock::start`]: the degrees are not all three.
const COUNTED: u64 = 1 << 62;

/// Where 64 rows begin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct RowBlock {
    /// First entry of the first row, with [`COUNTED`] or [`TABLE`] where not all 64 degrees are three.
    start: u64,
    /// The degrees, least bits first; bit k is of row k.
    degrees: [u64; 3],
}

impl RowBlock {
    /// First entry of the first row.
    #[inline(always)]
    fn start(&self) -> usize {
        (self.start & !(TABLE | COUNTED)) as usize
    }

    /// Where the starts of the rows lie in the table, if they are there.
    fn place(&self) -> Option<usize> {
        (self.start & TABLE != 0).then_some(self.degrees[0] as usize)
    }

    /// The entries of row `k`, counted from the first of the block; where degrees are in bits.
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

/// Where the rows of a graph begin and end.
#[derive(Clone, Copy, Debug)]
pub enum RowStarts<'a> {
    /// The starts, and the end (n + 1).
    Plain(&'a [u64]),
    /// In blocks.
    Packed(PackedStarts<'a>),
}

/// Where rows begin, in blocks.
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

    /// [`PackedStarts::span`] of row `k` of a block whose rows differ.
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
        // Blocks without entries start where the next one does, so the last that starts here or before has it.
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

    /// Whether there are none.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// The entries of `row`.
    #[inline(always)]
    pub fn span(self, row: u32) -> Range<usize> {
        match self {
            Self::Plain(starts) => starts[row as usize] as usize..starts[row as usize + 1] as usize,
            Self::Packed(packed) => packed.span(row),
        }
    }

    /// Shows consecutive `rows` and their entries to `see`: what [`RowStarts::span`] gives, for less.
    #[inline(always)]
    pub fn each(self, rows: Range<usize>, mut see: impl FnMut(usize, Range<usize>)) {
        let mut start = self.entries_of(rows.clone()).start;
        for row in rows {
            // One place where `see` is called, so that it is inlined.
            let end = match self {
                Self::Packed(packed) if packed.blocks[row / ROWS].start < COUNTED => start + 3,
                _ => self.span(row as u32).end,
            };
            see(row, start..end);
            start = end;
        }
    }

    /// Asks the processor to fetch what [`RowStarts::span`] of `row` reads.
    #[inline(always)]
    pub fn prefetch(self, row: u32) {
        match self {
            Self::Plain(starts) => prefetch(starts, row as usize),
            Self::Packed(packed) => prefetch(packed.blocks, row as usize / ROWS),
        }
    }

    /// Entries in all.
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
    /// Where there is no such entry.
    pub fn row_of(self, entry: usize) -> (usize, Range<usize>) {
        let row = match self {
            Self::Plain(starts) => starts.partition_point(|&start| start as usize <= entry) - 1,
            Self::Packed(packed) => packed.row_of(entry),
        };
        (row, self.span(row as u32))
    }

    /// Tells the kernel that the starts of consecutive `rows` are read next.
    pub fn will_need(self, rows: Range<usize>) {
        match self {
            Self::Plain(starts) => will_need(&starts[rows.start..=rows.end]),
            Self::Packed(packed) => will_need(&packed.blocks[rows.start / ROWS..rows.end.div_ceil(ROWS)]),
        }
    }

    /// Tells the kernel how starts are read from now on.
    pub fn advise(self, access: Access) {
        match self {
            Self::Plain(starts) => advise(starts, access),
            Self::Packed(PackedStarts { blocks, table, .. }) => {
                advise(blocks, access);
                advise(table, access);
            }
        }
    }

    /// The starts as plain numbers (n + 1), as other programs know them.
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

/// The two forms of row starts in files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartsForm {
    /// [`PLAIN`]: for small graphs of many degrees.
    Plain,
    /// [`BLOCKS`] and [`LONG_ROWS`]: for the graph of a mesh's faces.
    Packed,
}

impl StartsForm {
    /// Opens the starts of `rows` rows that an earlier run left in `work`.
    ///
    /// # Errors
    /// [`crate::base::Error::WorkDir`] where they do not ascend from 0 to `entries`; [`crate::base::Error::Io`].
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
        /// Four words for each 64 rows.
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
    /// Packed, in memory, from the degrees of all rows.
    pub fn of(degrees: impl IntoIterator<Item = usize>) -> Self {
        let (mut packer, mut blocks, mut rows) = (Packer::default(), Vec::new(), 0);
        for degree in degrees {
            rows += 1;
            blocks.extend(packer.push(degree as u32));
        }
        blocks.extend(packer.finish());
        Self::Packed { rows, blocks: bytemuck::cast_slice(&blocks).to_vec().into(), table: packer.table.into() }
    }

    /// Their form.
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
    /// Whether the rows ascend from 0 to `entries`, one behind another.
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

/// Packs degrees into blocks.
#[derive(Debug, Default)]
pub(super) struct Packer {
    degrees: Vec<u32>,
    end: u64,
    /// Starts of the blocks with long rows, and how many there were before.
    table: Vec<u64>,
    before: usize,
}

impl Packer {
    /// Adds a row; gives a block that is full.
    #[inline]
    fn push(&mut self, degree: u32) -> Option<RowBlock> {
        self.degrees.push(degree);
        if self.degrees.len() == ROWS { self.finish() } else { None }
    }

    /// The block of the rows so far, if there are any.
    fn finish(&mut self) -> Option<RowBlock> {
        if self.degrees.is_empty() {
            return None;
        }
        let mut block = RowBlock { start: self.end, degrees: [0; 3] };
        if self.degrees.iter().all(|degree| *degree <= MOST) {
            for (k, &degree) in self.degrees.iter().enumerate() {
                for (bit, word) in block.degrees.iter_mut().enumerate() {
                    *word |= u64::from(degree >> bit & 1) << k;
                }
                self.end += u64::from(degree);
            }
            if block.degrees != THREES {
                block.start |= COUNTED;
            }
        } else {
            block.start |= TABLE;
            block.degrees[0] = (self.before + self.table.len()) as u64;
            for k in 0..=ROWS {
                self.table.push(self.end);
                self.end += self.degrees.get(k).map_or(0, |degree| u64::from(*degree));
            }
        }
        self.degrees.clear();
        Some(block)
    }

    /// Adds what was packed elsewhere behind whole blocks.
    fn append(&mut self, part: &mut PackedPart) {
        for block in &mut part.blocks {
            block.start += self.end;
            if block.start & TABLE != 0 {
                block.degrees[0] += (self.before + self.table.len()) as u64;
            }
        }
        self.table.extend(part.table.iter().map(|start| start + self.end));
        self.end += part.entries;
    }

    /// Writes what of the table is there.
    fn hand_over(&mut self, out: &mut ArrayWriter<u64>) -> Result<()> {
        self.before += self.table.len();
        let result = out.push(&self.table);
        self.table.clear();
        result
    }
}

/// Row starts of consecutive rows, whole blocks of them but at the end of all, counted from the first.
#[derive(Debug)]
pub(super) struct PackedPart {
    blocks: Vec<RowBlock>,
    table: Vec<u64>,
    rows: usize,
    entries: u64,
}

impl PackedPart {
    /// Those of rows of the given degrees.
    pub fn of(degrees: impl ExactSizeIterator<Item = u32>) -> Self {
        let (mut packer, rows) = (Packer::default(), degrees.len());
        let mut blocks = Vec::with_capacity(rows.div_ceil(ROWS));
        degrees.for_each(|degree| blocks.extend(packer.push(degree)));
        blocks.extend(packer.finish());
        Self { blocks, rows, entries: packer.end, table: packer.table }
    }
}

/// Writes row starts from front to back.
#[derive(Debug)]
pub(super) enum RowStartsWriter {
    Plain { starts: ArrayWriter<u64>, end: u64 },
    Packed { packer: Packer, rows: usize, blocks: ArrayWriter<u64>, table: ArrayWriter<u64> },
}

impl RowStartsWriter {
    /// For `rows` rows.
    pub fn create(form: StartsForm, rows: usize, work: &WorkDir) -> Result<Self> {
        if form == StartsForm::Plain {
            let mut starts = work.writer_of(PLAIN, 1, rows + 1)?;
            starts.push(&[0])?;
            return Ok(Self::Plain { starts, end: 0 });
        }
        Ok(Self::Packed {
            packer: Packer::default(),
            rows: 0,
            blocks: work.writer_of(BLOCKS, WORDS, WORDS * rows.div_ceil(ROWS))?,
            table: work.writer(LONG_ROWS, 1)?,
        })
    }

    /// Appends rows of the given degrees.
    pub fn push(&mut self, degrees: &[u32]) -> Result<()> {
        match self {
            Self::Plain { starts, end } => {
                let ends = degrees.iter().map(|&degree| {
                    *end += u64::from(degree);
                    *end
                });
                starts.push(&ends.collect::<Vec<u64>>())
            }
            Self::Packed { packer, rows, blocks, table } => {
                *rows += degrees.len();
                let full: Vec<RowBlock> = degrees.iter().filter_map(|&degree| packer.push(degree)).collect();
                blocks.push(bytemuck::cast_slice(&full))?;
                packer.hand_over(table)
            }
        }
    }

    /// Appends packed rows behind whole blocks; returns where they end.
    pub fn push_part(&mut self, mut part: PackedPart) -> Result<u64> {
        let Self::Packed { packer, rows, blocks, table } = self else {
            return Err(Error::internal("packed rows among plain ones"));
        };
        *rows += part.rows;
        packer.append(&mut part);
        blocks.push(bytemuck::cast_slice(&part.blocks))?;
        packer.hand_over(table)?;
        Ok(packer.end)
    }

    pub fn finish(self) -> Result<OwnedRowStarts> {
        match self {
            Self::Plain { starts, .. } => Ok(OwnedRowStarts::Plain(starts.finish(false)?)),
            Self::Packed { mut packer, rows, mut blocks, mut table } => {
                if let Some(last) = packer.finish() {
                    blocks.push(bytemuck::cast_slice(&[last]))?;
                }
                packer.hand_over(&mut table)?;
                Ok(OwnedRowStarts::Packed { rows, blocks: blocks.finish(false)?, table: table.finish(false)? })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream};

    /// Degrees of many kinds of rows: threes, none, polygons, long ones here and there.
    fn degrees(n: usize, seed: u64) -> Vec<usize> {
        let mut random = stream(seed, "degrees");
        let kind = |k: usize| (k / 150 + seed as usize) % 6;
        let mut degree = |k: usize| match kind(k) {
            0 => 3,
            1 => 3 - usize::from(below(&mut random, 40) == 0),
            2 => 0,
            3 => below(&mut random, 8),
            4 => below(&mut random, 9),
            _ => {
                if below(&mut random, 30) == 0 {
                    5_000
                } else {
                    3
                }
            }
        };
        (0..n).map(&mut degree).collect()
    }

    #[test]
    fn packed_starts_are_the_sums_of_degrees() {
        let dir = tempfile::tempdir().unwrap();
        for (round, n) in [0, 1, 63, 64, 65, 128, 1_000, 5_003].into_iter().enumerate() {
            let degrees = degrees(n, round as u64);
            let mut plain = vec![0u64];
            plain.extend(degrees.iter().scan(0, |end, &degree| {
                *end += degree as u64;
                Some(*end)
            }));
            let owned = OwnedRowStarts::of(degrees.iter().copied());
            let starts = owned.view();
            assert_eq!(starts.plain(), plain);
            let other = RowStarts::Plain(&plain);
            assert!(other.len() == starts.len() && other.entries() == starts.entries());
            for (row, ends) in plain.windows(2).enumerate() {
                let span = ends[0] as usize..ends[1] as usize;
                assert_eq!(starts.span(row as u32), span, "row {row} of {n}");
                for entry in [span.start, span.end.saturating_sub(1)].into_iter().filter(|e| span.contains(e)) {
                    assert_eq!(starts.row_of(entry), (row, span.clone()));
                    assert_eq!(other.row_of(entry), (row, span.clone()));
                }
            }
            for rows in [0..n, n / 3..n / 2, n / 2..n / 2] {
                let entries = plain[rows.start] as usize..plain[rows.end] as usize;
                assert!(starts.entries_of(rows.clone()) == entries || rows.is_empty());
            }

            let work = WorkDir::temporary(dir.path()).unwrap();
            for form in [StartsForm::Plain, StartsForm::Packed] {
                let mut writer = RowStartsWriter::create(form, n, &work).unwrap();
                let few: Vec<u32> = degrees.iter().map(|degree| *degree as u32).collect();
                few.chunks(77).for_each(|some| writer.push(some).unwrap());
                let written = writer.finish().unwrap();
                assert!(written.form() == form && written.view().plain() == plain);
                let entries = plain[n] as usize;
                assert_eq!(form.open(&work, n, entries).unwrap().view().plain(), plain);
                assert!(form.open(&work, n, entries + 1).is_err());
                assert!(form.open(&work, n + ROWS, entries).is_err());
            }
        }
    }

    #[test]
    fn altered_starts_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap();
        let degrees: Vec<usize> = (0..200).map(|k| if k == 70 { 9 } else { 3 }).collect();
        let owned = OwnedRowStarts::of(degrees.iter().copied());
        let entries = owned.view().entries();
        let OwnedRowStarts::Packed { blocks: owned_blocks, table: owned_table, .. } = &owned else { unreachable!() };
        let sound = |blocks: &[u64], table: &[u64]| {
            work.write(BLOCKS, blocks, WORDS).unwrap();
            work.write(LONG_ROWS, table, 1).unwrap();
            StartsForm::Packed.open(&work, 200, entries).is_ok()
        };
        assert!(sound(owned_blocks, owned_table));
        for word in 0..owned_blocks.len() {
            // The last two words of the block with a table are not read.
            if ![6, 7].contains(&word) {
                let mut blocks = owned_blocks.to_vec();
                blocks[word] ^= 1;
                assert!(!sound(&blocks, owned_table), "word {word}");
            }
        }
        for (word, value) in [(0, 0), (3, u64::MAX), (64, 0), (64, 1 << 40)] {
            let mut table = owned_table.to_vec();
            table[word] = value;
            assert!(!sound(owned_blocks, &table), "word {word}");
        }
        assert!(!sound(owned_blocks, &owned_table[1..]));
    }
}
