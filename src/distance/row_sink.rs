//! Where finished rows go: to a file, with an entry in its journal; to memory; or to a visitor that sees each row once.
//!
//! A row is held only while it is passed on. Cost: a copy of the row if it goes to a file, the sums ([`RowFacts::of`]),
//! and the visitor's work.

use super::journal::{JobSpec, Journal, JournalEntry, RowFacts, checksum};
use super::sampler::FinishedRows;
use crate::base::parallel::lock;
use crate::base::{Error, Result};
use crate::store::MappedSliceMut;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

/// A finished row, as passed to a visitor.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct VisitedRow<'a> {
    /// Its number.
    pub number: usize,
    /// The landmarks of all earlier rows (`number`).
    pub earlier: &'a [u32],
    /// Distances of all nodes from its landmark (n), infinite where not reached.
    pub distances: &'a [f32],
}

/// Sees each finished row once, on any thread and in any order.
pub type RowVisitor<'a> = &'a (dyn Fn(VisitedRow<'_>) -> Result<()> + Sync);

/// The destination of rows.
pub(super) enum Target<'a> {
    /// To a file; row k of all is slot k / of.
    File { rows: Vec<Mutex<MappedSliceMut<f32>>>, journal: Option<Journal>, path: PathBuf },
    /// To memory, in the same slots.
    Memory(Vec<Mutex<&'a mut [f32]>>),
    /// To a visitor.
    Visitor(RowVisitor<'a>),
}

/// Rows being computed.
pub(super) struct RowSink<'a> {
    pub spec: &'a JobSpec,
    pub target: Target<'a>,
    /// Rows reused from an earlier run.
    pub done: BTreeMap<usize, JournalEntry>,
    /// Landmarks found so far.
    found: Mutex<Vec<u32>>,
}

impl<'a> RowSink<'a> {
    pub fn new(spec: &'a JobSpec, target: Target<'a>, done: BTreeMap<usize, JournalEntry>) -> Self {
        Self { spec, target, done, found: Mutex::default() }
    }

    fn found(&self) -> MutexGuard<'_, Vec<u32>> {
        lock(&self.found)
    }

    /// Whether the search for landmarks may use the space of the last row as its field, since that row is computed only
    /// when all landmarks are known. Requires that rows go to a file, that all of them are wanted, that there are
    /// several, and that none is done yet.
    pub fn last_row_is_free(&self) -> bool {
        let in_file = matches!(&self.target, Target::File { journal: None, .. });
        in_file && self.spec.of == 1 && self.spec.rows > 1 && self.done.is_empty()
    }

    /// Records the landmark of the next row.
    pub fn enter(&self, landmark: u32) {
        self.found().push(landmark);
    }

    /// The slot of a row in memory.
    pub fn held(&self, row: usize) -> Option<MutexGuard<'_, &'a mut [f32]>> {
        let Target::Memory(rows) = &self.target else { return None };
        Some(lock(rows.get(row / self.spec.of)?))
    }

    /// The mapping of a row in a file.
    pub fn take(&self, row: usize) -> Option<MutexGuard<'_, MappedSliceMut<f32>>> {
        let Target::File { rows, .. } = &self.target else { return None };
        Some(lock(rows.get(row / self.spec.of)?))
    }

    /// The file of the rows, if they are in one.
    pub fn path(&self) -> Option<&Path> {
        let Target::File { path, .. } = &self.target else { return None };
        Some(path)
    }

    /// Passes on a row that was computed elsewhere.
    pub fn put(&self, row: usize, landmark: u32, distances: &[f32]) -> Result<JournalEntry> {
        match &self.target {
            Target::File { path, .. } => {
                let Some(mut slot) = self.take(row) else { return Err(Error::internal("a row without a place")) };
                slot.overwrite(distances).map_err(Error::io(path, "write"))?;
                self.close(row, landmark, distances, || slot.sync())
            }
            Target::Memory(_) => {
                let Some(mut slot) = self.held(row) else { return Err(Error::internal("a row without a place")) };
                slot.copy_from_slice(distances);
                self.close(row, landmark, distances, || Ok(()))
            }
            Target::Visitor(visit) => {
                let earlier: Vec<u32> = self.found().iter().take(row).copied().collect();
                visit(VisitedRow { number: row, earlier: &earlier, distances })?;
                Ok(JournalEntry { row, landmark, facts: RowFacts::of(distances), xxh3: 0 })
            }
        }
    }

    /// Sums up a row that was written; if there is a journal, syncs the row with `sync` and records it.
    pub fn close(
        &self,
        row: usize,
        landmark: u32,
        distances: &[f32],
        sync: impl FnOnce() -> std::io::Result<()>,
    ) -> Result<JournalEntry> {
        let facts = RowFacts::of(distances);
        let Target::File { journal: Some(journal), path, .. } = &self.target else {
            return Ok(JournalEntry { row, landmark, facts, xxh3: 0 });
        };
        sync().map_err(Error::io(path, "sync"))?;
        let entry = JournalEntry { row, landmark, facts, xxh3: checksum(distances) };
        journal.append(&entry)?;
        Ok(entry)
    }
}

impl FinishedRows for RowSink<'_> {
    fn landmark(&self, k: usize) -> Option<u32> {
        self.done.get(&k).map(|entry| entry.landmark)
    }

    fn lower(&self, k: usize, field: &mut [f32]) {
        let Some(row) = self.take(k) else { return };
        for (known, &d) in field.iter_mut().zip(row.iter()) {
            *known = if d < *known { d } else { *known };
        }
    }
}
