//! Where finished rows go: into a file, entered in its journal; or to somebody who looks at each and lets it go.
//!
//! No row is held here but while it is handed on. Cost: a copy of the row where it goes to a file, the sums
//! ([`RowFacts::of`]), and what the one who looks does with it.

use super::journal::{Head, Journal, Line, checksum};
use super::rows::RowFacts;
use super::sampler::FinishedRows;
use crate::base::{Error, Result};
use crate::store::MappedSliceMut;
use crate::store::rows_file::RowsFile;
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A finished row.
#[derive(Clone, Copy, Debug)]
pub struct Row<'a> {
    /// Its number.
    pub number: usize,
    /// The landmarks of all rows before it (`number`).
    pub earlier: &'a [u32],
    /// Distances of all nodes from its landmark (n), infinite where not reached.
    pub distances: &'a [f32],
}

/// Who looks at finished rows, on any thread and in any order.
pub type Look<'a> = &'a (dyn Fn(Row<'_>) -> Result<()> + Sync);

/// Where rows go.
pub(super) enum Target<'a> {
    /// Into a file; row k of all is slot k / of.
    File {
        file: &'a RowsFile<f32>,
        /// Their mappings; none where they are held in memory.
        rows: Vec<Mutex<MappedSliceMut<f32>>>,
        journal: Option<Journal>,
        path: std::path::PathBuf,
    },
    /// To somebody who looks at each.
    Look(Look<'a>),
}

/// Rows while they are computed.
pub(super) struct Slots<'a> {
    pub head: &'a Head,
    pub target: Target<'a>,
    /// Rows taken over from an earlier run.
    pub done: BTreeMap<usize, Line>,
    /// Landmarks found so far.
    found: Mutex<Vec<u32>>,
}

impl<'a> Slots<'a> {
    pub fn new(head: &'a Head, target: Target<'a>, done: BTreeMap<usize, Line>) -> Self {
        Self { head, target, done, found: Mutex::default() }
    }

    fn found(&self) -> MutexGuard<'_, Vec<u32>> {
        self.found.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Enters the landmark of the next row.
    pub fn enter(&self, landmark: u32) {
        self.found().push(landmark);
    }

    /// The mapping of a row of a file that is not held in memory.
    pub fn take(&self, row: usize) -> Option<MutexGuard<'_, MappedSliceMut<f32>>> {
        let Target::File { rows, .. } = &self.target else { return None };
        Some(rows.get(row / self.head.of)?.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Hands on a row that was computed elsewhere.
    pub fn put(&self, row: usize, landmark: u32, distances: &[f32]) -> Result<Line> {
        match &self.target {
            Target::File { file, .. } => {
                file.write_row(row / self.head.of, distances)?;
                self.close(row, landmark, distances, || self.take(row).map_or(Ok(()), |slot| slot.sync()))
            }
            Target::Look(look) => {
                let earlier: Vec<u32> = self.found().iter().take(row).copied().collect();
                look(Row { number: row, earlier: &earlier, distances })?;
                Ok(Line { row, landmark, facts: RowFacts::of(distances), xxh3: 0 })
            }
        }
    }

    /// Sums up a row that was written; where there is a journal, brings it to the disk by `sync` and enters it.
    pub fn close(
        &self,
        row: usize,
        landmark: u32,
        distances: &[f32],
        sync: impl FnOnce() -> std::io::Result<()>,
    ) -> Result<Line> {
        let facts = RowFacts::of(distances);
        let Target::File { journal: Some(journal), path, .. } = &self.target else {
            return Ok(Line { row, landmark, facts, xxh3: 0 });
        };
        sync().map_err(Error::io(path, "sync"))?;
        let line = Line { row, landmark, facts, xxh3: checksum(distances) };
        journal.append(&line)?;
        Ok(line)
    }
}

impl FinishedRows for Slots<'_> {
    fn landmark(&self, k: usize) -> Option<u32> {
        self.done.get(&k).map(|line| line.landmark)
    }

    fn lower(&self, k: usize, field: &mut [f32]) {
        let Some(row) = self.take(k) else { return };
        for (known, &d) in field.iter_mut().zip(row.iter()) {
            *known = if d < *known { d } else { *known };
        }
    }
}
