//! Computing rows: a thread that searches landmarks, and threads that run a full front each.
//!
//! The searcher sends each landmark down a channel as soon as it is known; the others take them and run full
//! fronts meanwhile; the searcher joins them when it is done. A finished row is brought to the disk, entered in the
//! journal, and goes down a second channel with its sums to the calling thread, which keeps the books. The
//! first landmark's row falls out of the search and is not computed twice: where the budget has room for a copy, a thread
//! that has nothing to do yet writes it.
//!
//! Nothing can run beside the first front: 23 of the 126 ms that ten rows over 1.3 M faces take on two threads.
//!
//! Rows that the journal knows from an earlier run are checked (one pass over them) and taken over. In a
//! temporary directory there is no journal and nothing is synced.

use super::begun::Begun;
use super::front::{Front, mean_weight};
use super::journal::{Head, Journal, Line, checksum};
use super::landmarks::{Finished, Sampling, choose};
use super::paging::Pages;
use super::rows::{RowFacts, RowParams};
use super::sampling::geodesic::fill_lengths;
use crate::base::{Error, Result};
use crate::graph::Node;
use crate::graph::dual::Csr;
use crate::graph::triples::Triples;
use crate::store::mapped::Access;
use crate::store::npy::ArrayMut;
use crate::store::rows_file::RowsFile;
use crate::store::words::Words;
use crate::store::{MappedSliceMut, Run, WorkDir};
use crossbeam_channel::{Receiver, Sender};
use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard};

/// Rows to be computed.
#[derive(Clone, Copy)]
pub(super) struct Task<'a> {
    pub graph: Csr<'a>,
    pub nodes: &'a [Node],
    pub params: RowParams,
    /// What they are of, and which of them are wanted.
    pub head: &'a Head,
}

/// A landmark whose row is wanted.
struct Job {
    row: usize,
    landmark: u32,
    /// The row, where it is known and has only to be written.
    known: Option<Words>,
}

/// Rows while they are computed; row k of all is slot k / of.
struct Slots<'a> {
    head: &'a Head,
    file: &'a RowsFile<f32>,
    /// Their mappings; none where they are held in memory.
    rows: Vec<Mutex<MappedSliceMut<f32>>>,
    /// Rows taken over from an earlier run.
    done: BTreeMap<usize, Line>,
    journal: Option<Journal>,
    path: std::path::PathBuf,
}

impl Slots<'_> {
    fn take(&self, row: usize) -> MutexGuard<'_, MappedSliceMut<f32>> {
        self.rows[row / self.head.of].lock().unwrap_or_else(|poison| poison.into_inner())
    }

    /// Writes a row that was computed elsewhere.
    fn put(&self, row: usize, landmark: u32, distances: &[f32]) -> Result<Line> {
        self.file.write_row(row / self.head.of, distances)?;
        self.close(row, landmark, distances, || self.take(row).sync())
    }

    /// Sums up a row that was written; where there is a journal, brings it to the disk by `sync` and enters it.
    fn close(
        &self,
        row: usize,
        landmark: u32,
        distances: &[f32],
        sync: impl FnOnce() -> std::io::Result<()>,
    ) -> Result<Line> {
        let facts = RowFacts::of(distances);
        let Some(journal) = &self.journal else { return Ok(Line { row, landmark, facts, xxh3: 0 }) };
        sync().map_err(Error::io(&self.path, "sync"))?;
        let line = Line { row, landmark, facts, xxh3: checksum(distances) };
        journal.append(&line)?;
        Ok(line)
    }
}

impl Finished for Slots<'_> {
    fn landmark(&self, k: usize) -> Option<u32> {
        self.done.get(&k).map(|line| line.landmark)
    }

    fn lower(&self, k: usize, field: &mut [f32]) {
        let row = self.take(k);
        for (known, &d) in field.iter_mut().zip(row.iter()) {
            *known = if d < *known { d } else { *known };
        }
    }
}

impl Task<'_> {
    /// Computes the rows that the head wants into the file `name` (still under its temporary name when this returns),
    /// going on where the journal `journal` says that an earlier run was.
    pub fn compute(
        &self,
        name: &str,
        journal: &str,
        work: &WorkDir,
        run: &Run,
    ) -> Result<(RowsFile<f32>, BTreeMap<usize, Line>)> {
        let (head, n) = (self.head, self.head.nodes);
        let Begun { file, done, journal } = Begun::new(head, (name, journal), |_| true, work, run)?;
        if !done.is_empty() {
            run.progress.advance("rows", done.len() as u64);
        }
        let mapped = if file.is_held() { 0 } else { head.wanted() };
        let rows = (0..mapped).map(|slot| Ok(Mutex::new(file.row(slot)?))).collect::<Result<Vec<_>>>()?;
        let mut lines = done.clone();
        let slots = Slots { head, file: &file, rows, done, journal, path: work.file(name) };
        if lines.len() < head.wanted() {
            let temporary = format!("nearest-{}.tmp", head.shard);
            let mut field: ArrayMut<f32> = work.array(&temporary, &[n])?;
            let fields = (run.threads + 1) * n * size_of::<f32>();
            let triples = if Pages::needed(self.graph, fields, run) { None } else { Triples::of(self.graph, run)? };
            let graph = Csr { triples: triples.as_ref().map_or(&[], Triples::all), ..self.graph };
            let task = Task { graph, ..*self };
            let result = Pages::lend(self.graph, fields, run, |pages| {
                if pages.is_some() {
                    field.data().advise(Access::Random);
                }
                if self.params.sampling.needs_lengths() {
                    task.with_lengths(&slots, field.data(), pages, &mut lines, work, run)
                } else {
                    task.fronts(&slots, None, field.data(), pages, &mut lines, run)
                }
            });
            drop(field);
            work.remove(&format!("{temporary}.partial"));
            result?;
        }
        drop(slots);
        Ok((file, lines))
    }

    /// [`Task::fronts`] with the graph of lengths beside: 4 bytes an entry in a mapped file, removed at the end.
    fn with_lengths(
        &self,
        slots: &Slots<'_>,
        field: &mut MappedSliceMut<f32>,
        pages: Option<Pages>,
        lines: &mut BTreeMap<usize, Line>,
        work: &WorkDir,
        run: &Run,
    ) -> Result<()> {
        let name = format!("lengths-{}.tmp", self.head.shard);
        let mut array: ArrayMut<f32> = work.array(&name, &[self.graph.weights.len()])?;
        fill_lengths(self.graph, self.nodes, array.data(), run)?;
        let lengths = Csr { weights: &array.data()[..], triples: &[], ..self.graph };
        let result = self.fronts(slots, Some(lengths), field, pages, lines, run);
        drop(array);
        work.remove(&format!("{name}.partial"));
        result
    }

    /// Runs search and fronts until every wanted row is in `lines`.
    fn fronts(
        &self,
        slots: &Slots<'_>,
        lengths: Option<Csr<'_>>,
        field: &mut MappedSliceMut<f32>,
        pages: Option<Pages>,
        lines: &mut BTreeMap<usize, Line>,
        run: &Run,
    ) -> Result<()> {
        let mean = mean_weight(self.graph);
        let front = || Front::new(mean).paged(pages.clone());
        let (send, receive) = crossbeam_channel::unbounded::<Job>();
        let (done, finished) = crossbeam_channel::unbounded::<Result<Line>>();
        let missing = self.head.wanted() - lines.len();
        std::thread::scope(|scope| -> Result<()> {
            let (jobs, out) = (receive.clone(), done.clone());
            let mut searching = front();
            scope.spawn(move || match self.search(slots, lengths, field, &mut searching, &send, &out, run) {
                Ok(()) => {
                    drop(send);
                    self.rows(slots, &mut searching, jobs, &out, run);
                }
                Err(error) => {
                    let _ = out.send(Err(error));
                }
            });
            for _ in 1..run.threads.min(missing) {
                let (jobs, out) = (receive.clone(), done.clone());
                let mut front = front();
                scope.spawn(move || self.rows(slots, &mut front, jobs, &out, run));
            }
            drop((receive, done));
            for _ in 0..missing {
                let line = finished.recv().unwrap_or(Err(Error::Cancelled))?;
                lines.insert(line.row, line);
                run.progress.advance("rows", 1);
            }
            Ok(())
        })
    }

    /// Sends the landmarks whose rows are wanted and not there yet.
    fn search(
        &self,
        slots: &Slots<'_>,
        lengths: Option<Csr<'_>>,
        field: &mut MappedSliceMut<f32>,
        front: &mut Front,
        jobs: &Sender<Job>,
        done: &Sender<Result<Line>>,
        run: &Run,
    ) -> Result<()> {
        let mut row = 0;
        front.values(field.writeback());
        let RowParams { l, sampling } = self.params;
        let graphs = (self.graph, lengths);
        let others = run.threads > 1 && self.head.wanted() > 1;
        let cost = choose(sampling, l, graphs, self.nodes, field, front, slots, run, |landmark, known| {
            let k = row;
            row += 1;
            if !self.head.wants(k) || slots.landmark(k) == Some(landmark) {
                return Ok(());
            }
            let copy = known.filter(|_| others).and_then(|known| Words::copy_of(&run.budget, known));
            match known {
                Some(known) if copy.is_none() => drop(done.send(slots.put(k, landmark, known))),
                _ => drop(jobs.send(Job { row: k, landmark, known: copy })),
            }
            Ok(())
        })?;
        if !matches!(sampling, Sampling::Farthest | Sampling::Random | Sampling::Uniform) {
            run.progress.note(&format!("landmarks: the search cost {cost:.1} fronts besides the {l} rows"));
        }
        Ok(())
    }

    /// Computes rows until there are no more: in memory and written as a whole where the budget has room for that, else
    /// in the mapped file.
    fn rows(&self, slots: &Slots<'_>, front: &mut Front, jobs: Receiver<Job>, done: &Sender<Result<Line>>, run: &Run) {
        let mut memory = if front.is_paged() { None } else { Words::spare(&run.budget, 4 * self.head.nodes) };
        // What is held has no mapping to compute in.
        let plain = memory.is_none() && slots.file.is_held();
        let mut plain = vec![0.; if plain { self.head.nodes } else { 0 }];
        for Job { row, landmark, known } in jobs {
            let words = memory.as_mut().map(|words| words.items_mut::<f32>(self.head.nodes));
            let line = match (words.or((!plain.is_empty()).then_some(&mut plain[..])), known) {
                (_, Some(known)) => slots.put(row, landmark, known.items(self.head.nodes)),
                (Some(distances), None) => {
                    let full = front.full(self.graph, landmark, distances, &run.cancel);
                    full.and_then(|_| slots.put(row, landmark, distances))
                }
                (None, None) => self.row(slots, row, landmark, front, run),
            };
            let failed = line.is_err();
            if done.send(line).is_err() || failed {
                return;
            }
        }
    }

    /// Computes a row in the mapped file.
    fn row(&self, slots: &Slots<'_>, row: usize, landmark: u32, front: &mut Front, run: &Run) -> Result<Line> {
        let mut slot = slots.take(row);
        front.values(slot.writeback());
        slot.advise(if front.is_paged() { Access::Random } else { Access::Local });
        let full = front.full(self.graph, landmark, &mut slot, &run.cancel);
        slot.advise(Access::Sequential);
        full.and_then(|_| slots.close(row, landmark, &slot, || slot.sync()))
    }
}
