//! Packs the degrees of rows into blocks, in memory or into files, from front to back.
//!
//! One pass over the degrees; buffers the part of the table that is not yet written.

use super::{
    BLOCKS, COUNTED, LONG_ROWS, MOST, OwnedRowStarts, PLAIN, ROWS, RowBlock, StartsForm, TABLE, THREES, WORDS,
};
use crate::base::{Error, Result};
use crate::store::WorkDir;
use crate::store::npy::ArrayWriter;

/// Packs degrees into blocks.
#[derive(Debug, Default)]
pub(in crate::graph) struct Packer {
    degrees: Vec<u32>,
    end: u64,
    /// Starts of the blocks with long rows, and how many were written before.
    table: Vec<u64>,
    before: usize,
}

impl Packer {
    /// Adds a row; returns a block when it is full.
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

    /// Appends rows packed elsewhere; only whole blocks may precede them.
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

    /// Writes the buffered part of the table.
    fn flush_table(&mut self, out: &mut ArrayWriter<u64>) -> Result<()> {
        self.before += self.table.len();
        let result = out.push(&self.table);
        self.table.clear();
        result
    }
}

impl OwnedRowStarts {
    /// Packs the degrees of all rows in memory.
    pub fn of(degrees: impl IntoIterator<Item = usize>) -> Self {
        let (mut packer, mut blocks, mut rows) = (Packer::default(), Vec::new(), 0);
        for degree in degrees {
            rows += 1;
            blocks.extend(packer.push(degree as u32));
        }
        blocks.extend(packer.finish());
        Self::Packed { rows, blocks: bytemuck::cast_slice(&blocks).to_vec().into(), table: packer.table.into() }
    }
}

/// Row starts of consecutive rows, counted from the first; whole blocks, except at the end of all rows.
#[derive(Debug)]
pub(in crate::graph) struct PackedPart {
    blocks: Vec<RowBlock>,
    table: Vec<u64>,
    rows: usize,
    entries: u64,
}

impl PackedPart {
    /// Packs rows of the given degrees.
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
pub(in crate::graph) enum RowStartsWriter {
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
                packer.flush_table(table)
            }
        }
    }

    /// Appends packed rows after whole blocks; returns where they end.
    pub fn push_part(&mut self, mut part: PackedPart) -> Result<u64> {
        let Self::Packed { packer, rows, blocks, table } = self else {
            return Err(Error::internal("packed rows among plain ones"));
        };
        *rows += part.rows;
        packer.append(&mut part);
        blocks.push(bytemuck::cast_slice(&part.blocks))?;
        packer.flush_table(table)?;
        Ok(packer.end)
    }

    pub fn finish(self) -> Result<OwnedRowStarts> {
        match self {
            Self::Plain { starts, .. } => Ok(OwnedRowStarts::Plain(starts.finish(false)?)),
            Self::Packed { mut packer, rows, mut blocks, mut table } => {
                if let Some(last) = packer.finish() {
                    blocks.push(bytemuck::cast_slice(&[last]))?;
                }
                packer.flush_table(&mut table)?;
                Ok(OwnedRowStarts::Packed { rows, blocks: blocks.finish(false)?, table: table.finish(false)? })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::RowStarts;
    use super::*;
    use crate::base::random::{below, stream};

    /// Degrees in runs of different kinds: triangles, isolated nodes, polygons, occasional long rows.
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
