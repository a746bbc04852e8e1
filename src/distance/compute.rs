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
use super::journal::{Head, Line};
use super::paging::Pages;
use super::sampler::{FinishedRows, GraphSpace, Sampler, SearchGraph, fill_lengths};
use super::slots::{Look, Slots, Target};
use crate::base::{Error, Result};
use crate::graph::Node;
use crate::graph::dual::Csr;
use crate::graph::triangle_adjacency::TriangleAdjacency;
use crate::store::in_memory::AlignedBuffer;
use crate::store::mapped::Access;
use crate::store::npy::ArrayMut;
use crate::store::rows_file::RowsFile;
use crate::store::{Context, MappedSliceMut, Run};
use crossbeam_channel::{Receiver, Sender};
use std::collections::BTreeMap;
use std::sync::Mutex;

/// Rows to be computed.
#[derive(Clone, Copy)]
pub(super) struct Task<'a> {
    pub graph: Csr<'a>,
    pub nodes: &'a [Node],
    /// Who chooses the landmarks.
    pub sampler: &'a dyn Sampler,
    /// What they are of, and which of them are wanted.
    pub head: &'a Head,
}

/// A landmark whose row is wanted.
struct Job {
    row: usize,
    landmark: u32,
    /// The row, where it is known and has only to be written.
    known: Option<AlignedBuffer>,
}

/// Memory that a thread computes rows in, one after the other.
enum Scratch {
    Granted(AlignedBuffer),
    Plain(Vec<f32>),
    Mapped(ArrayMut<f32>),
    /// None: rows are computed where they lie in the file.
    InPlace,
}

impl Task<'_> {
    /// Computes the rows that the head wants into the file `name` (still under its temporary name when this returns),
    /// going on where the journal `journal` says that an earlier run was.
    pub fn compute(
        &self,
        name: &str,
        journal: &str,
        context: Context<'_>,
    ) -> Result<(RowsFile<f32>, BTreeMap<usize, Line>)> {
        let head = self.head;
        let Begun { file, done, journal } = Begun::new(head, (name, journal), |_| true, context)?;
        if !done.is_empty() {
            context.run.progress.advance("rows", done.len() as u64);
        }
        let mapped = if file.is_in_memory() { 0 } else { head.wanted() };
        let rows = (0..mapped).map(|slot| Ok(Mutex::new(file.row(slot)?))).collect::<Result<Vec<_>>>()?;
        let target = Target::File { file: &file, rows, journal, path: context.work.file(name) };
        let lines = self.fill(&Slots::new(head, target, done), context)?;
        Ok((file, lines))
    }

    /// Computes the rows that the head wants, and lets `look` see each. None is kept.
    pub fn pass(&self, look: Look<'_>, context: Context<'_>) -> Result<BTreeMap<usize, Line>> {
        self.fill(&Slots::new(self.head, Target::Look(look), BTreeMap::new()), context)
    }

    /// Computes the rows that `slots` does not have yet.
    fn fill(&self, slots: &Slots<'_>, context: Context<'_>) -> Result<BTreeMap<usize, Line>> {
        let (head, n) = (self.head, self.head.nodes);
        let mut lines = slots.done.clone();
        if lines.len() < head.wanted() {
            let temporary = format!("nearest-{}.tmp", head.shard);
            let mut field: ArrayMut<f32> = context.work.array(&temporary, &[n])?;
            let fields = (context.run.threads + 1) * n * size_of::<f32>();
            let triples = if Pages::needed(self.graph, fields, context.run) {
                None
            } else {
                TriangleAdjacency::of(self.graph, context.run)?
            };
            let graph = Csr { triples: triples.as_ref().map_or(&[], TriangleAdjacency::all), ..self.graph };
            let task = Task { graph, ..*self };
            let result = Pages::lend(self.graph, fields, context.run, |pages| {
                if pages.is_some() {
                    field.data().advise(Access::Random);
                }
                if self.sampler.needs_lengths() {
                    task.with_lengths(slots, field.data(), pages, &mut lines, context)
                } else {
                    task.fronts(slots, None, field.data(), pages, &mut lines, context)
                }
            });
            drop(field);
            context.work.remove(&format!("{temporary}.partial"));
            result?;
        }
        Ok(lines)
    }

    /// [`Task::fronts`] with the graph of lengths beside: 4 bytes an entry in a mapped file, removed at the end.
    fn with_lengths(
        &self,
        slots: &Slots<'_>,
        field: &mut MappedSliceMut<f32>,
        pages: Option<Pages>,
        lines: &mut BTreeMap<usize, Line>,
        context: Context<'_>,
    ) -> Result<()> {
        let name = format!("lengths-{}.tmp", self.head.shard);
        let mut array: ArrayMut<f32> = context.work.array(&name, &[self.graph.weights.len()])?;
        fill_lengths(self.graph, self.nodes, array.data(), context.run)?;
        let lengths = Csr { weights: &array.data()[..], triples: &[], ..self.graph };
        let result = self.fronts(slots, Some(lengths), field, pages, lines, context);
        drop(array);
        context.work.remove(&format!("{name}.partial"));
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
        context: Context<'_>,
    ) -> Result<()> {
        let mean = mean_weight(self.graph);
        let front = || Front::new(mean).paged(pages.clone());
        let (send, receive) = crossbeam_channel::unbounded::<Job>();
        let (done, finished) = crossbeam_channel::unbounded::<Result<Line>>();
        let missing = self.head.wanted() - lines.len();
        std::thread::scope(|scope| -> Result<()> {
            let (jobs, out) = (receive.clone(), done.clone());
            let mut searching = front();
            scope.spawn(move || match self.search(slots, lengths, field, &mut searching, &send, &out, context.run) {
                Ok(()) => {
                    drop(send);
                    self.rows(slots, 0, &mut searching, jobs, &out, context);
                }
                Err(error) => {
                    let _ = out.send(Err(error));
                }
            });
            for thread in 1..context.run.threads.min(missing) {
                let (jobs, out) = (receive.clone(), done.clone());
                let mut front = front();
                scope.spawn(move || self.rows(slots, thread, &mut front, jobs, &out, context));
            }
            drop((receive, done));
            for _ in 0..missing {
                let line = finished.recv().unwrap_or(Err(Error::Cancelled))?;
                lines.insert(line.row, line);
                context.run.progress.advance("rows", 1);
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
        let l = self.head.rows;
        let graph = SearchGraph { graph: self.graph, nodes: self.nodes, lengths };
        let others = run.threads > 1 && self.head.wanted() > 1;
        let cost =
            GraphSpace::new(graph, front, slots, run).sample(self.sampler, l, field, &mut |landmark, known| {
                let k = row;
                row += 1;
                slots.enter(landmark);
                if !self.head.wants(k) || slots.landmark(k) == Some(landmark) {
                    return Ok(());
                }
                let copy = known.filter(|_| others).and_then(|known| AlignedBuffer::copy_of(&run.budget, known));
                match known {
                    Some(known) if copy.is_none() => drop(done.send(slots.put(k, landmark, known))),
                    _ => drop(jobs.send(Job { row: k, landmark, known: copy })),
                }
                Ok(())
            })?;
        if self.sampler.is_costly() {
            run.progress.note(&format!("landmarks: the search cost {cost:.1} fronts besides the {l} rows"));
        }
        Ok(())
    }

    /// Computes rows until there are no more: in memory and handed on as a whole where the budget has room for that, else
    /// where they lie in the mapped file, or in a mapped file of the thread's own.
    fn rows(
        &self,
        slots: &Slots<'_>,
        thread: usize,
        front: &mut Front,
        jobs: Receiver<Job>,
        done: &Sender<Result<Line>>,
        context: Context<'_>,
    ) {
        let name = format!("row-{}-{thread}.tmp", self.head.shard);
        let mut scratch = None;
        for Job { row, landmark, known } in jobs {
            let line = match known {
                Some(known) => slots.put(row, landmark, known.items(self.head.nodes)),
                None => match &mut scratch {
                    Some(scratch) => self.row(slots, row, landmark, front, scratch, context.run),
                    None => self
                        .scratch(slots, front, &name, context)
                        .and_then(|made| self.row(slots, row, landmark, front, scratch.insert(made), context.run)),
                },
            };
            let failed = line.is_err();
            if done.send(line).is_err() || failed {
                break;
            }
        }
        if let Some(Scratch::Mapped(array)) = scratch {
            drop(array);
            context.work.remove(&format!("{name}.partial"));
        }
    }

    /// Memory for a thread's rows.
    fn scratch(&self, slots: &Slots<'_>, front: &Front, name: &str, context: Context<'_>) -> Result<Scratch> {
        let n = self.head.nodes;
        if !front.is_paged()
            && let Some(words) = AlignedBuffer::spare(&context.run.budget, 4 * n)
        {
            return Ok(Scratch::Granted(words));
        }
        Ok(match &slots.target {
            // What is held has no mapping to compute in.
            Target::File { file, .. } if file.is_in_memory() => Scratch::Plain(vec![0.; n]),
            Target::File { .. } => Scratch::InPlace,
            Target::Look(_) => Scratch::Mapped(context.work.array(name, &[n])?),
        })
    }

    /// Computes a row and hands it on.
    fn row(
        &self,
        slots: &Slots<'_>,
        row: usize,
        landmark: u32,
        front: &mut Front,
        scratch: &mut Scratch,
        run: &Run,
    ) -> Result<Line> {
        let distances = match scratch {
            Scratch::Granted(words) => words.items_mut::<f32>(self.head.nodes),
            Scratch::Plain(row) => row,
            Scratch::Mapped(array) => {
                self.mapped_row(array.data(), landmark, front, run)?;
                return slots.put(row, landmark, array.data());
            }
            Scratch::InPlace => {
                // Nothing but a file has rows in place, and a file that is not held has a mapping of each.
                let Some(mut slot) = slots.take(row) else { return Err(Error::Cancelled) };
                self.mapped_row(&mut slot, landmark, front, run)?;
                return slots.close(row, landmark, &slot, || slot.sync());
            }
        };
        front.full(self.graph, landmark, distances, &run.cancel)?;
        slots.put(row, landmark, distances)
    }

    /// Computes a row in a mapped file.
    fn mapped_row(&self, slot: &mut MappedSliceMut<f32>, landmark: u32, front: &mut Front, run: &Run) -> Result<()> {
        front.values(slot.writeback());
        slot.advise(if front.is_paged() { Access::Random } else { Access::Local });
        let full = front.full(self.graph, landmark, slot, &run.cancel);
        slot.advise(Access::Sequential);
        full.map(drop)
    }
}
