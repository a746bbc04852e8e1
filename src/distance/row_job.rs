//! How rows are computed: one thread searches for landmarks, the others run a full front for each.
//!
//! The search sends each landmark through a channel as soon as it is found; the other threads receive them and run full
//! fronts meanwhile. When the search is done, its thread joins them. A finished row is synced, recorded in the journal,
//! and its sums go through a second channel to the calling thread, which collects them and reports progress. The search
//! computes the first landmark's row anyway, so it is not computed again: if the budget has room for a copy, another
//! thread, which would be idle, writes it.
//!
//! Nothing can run in parallel with the first front: 23 of the 126 ms that ten rows over 1.3 M faces take on two
//! threads.
//!
//! Rows recorded in the journal of an earlier run are verified (one pass over them) and reused. In a temporary
//! directory there is no journal and nothing is synced.

use super::block_cache::RowFile;
use super::cached_front::{CachedFront, Division};
use super::front::{Front, typical_weight};
use super::journal::{JobSpec, JournalEntry, ResumeState};
use super::paging::Pages;
use super::row_sink::{RowSink, RowVisitor, Target};
use super::sampler::{FinishedRows, GraphSpace, Sampler, SearchGraph, fill_lengths};
use crate::base::parallel::{catch, spawn};
use crate::base::{Cancel, Error, Result};
use crate::graph::csr::DirectGraph;
use crate::graph::{Csr, NodeView, TriangleAdjacency, WeightedGraph};
use crate::store::mapped::Access;
use crate::store::mapped::AlignedBuffer;
use crate::store::npy::ArrayMut;
use crate::store::rows_file::RowsFile;
use crate::store::{Context, MappedSliceMut};
use crossbeam_channel::{Receiver, Sender};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;

/// Finished rows by number.
type Entries = BTreeMap<usize, JournalEntry>;

/// A set of rows to be computed.
#[derive(Clone, Copy)]
pub(super) struct RowJob<'a> {
    pub weighted: &'a WeightedGraph,
    /// The same graph as raw slices.
    pub graph: Csr<'a>,
    pub nodes: NodeView<'a>,
    /// Chooses the landmarks.
    pub sampler: &'a dyn Sampler,
    /// Describes the rows and which of them are wanted.
    pub spec: &'a JobSpec,
}

/// A request to compute a landmark's row.
struct Request {
    row: usize,
    landmark: u32,
    /// The row, if it is already known and only has to be written.
    known: Option<AlignedBuffer>,
}

/// A thread's buffer for rows, one after the other.
enum Scratch {
    Granted(AlignedBuffer),
    Mapped(ArrayMut<f32>),
    /// None: rows are computed in place, in the file or in memory.
    InPlace,
}

/// A thread's memory for computing rows, created with its first row.
struct ThreadMemory<'a> {
    scratch: Scratch,
    /// For graphs larger than memory.
    cached: Option<CachedFront<'a>>,
}

impl RowJob<'_> {
    /// Computes the rows that the spec wants into the file `name` (still under its temporary name when this returns),
    /// continuing an interrupted run according to the journal `journal`.
    pub fn compute(&self, name: &str, journal: &str, context: Context<'_>) -> Result<(RowsFile<f32>, Entries)> {
        let spec = self.spec;
        let ResumeState { file, done, journal } = ResumeState::new(spec, (name, journal), |_| true, context)?;
        if !done.is_empty() {
            context.run.progress.advance("rows", done.len() as u64);
        }
        let mut held = file.held();
        let target = match &mut held {
            Some(held) => Target::Memory(held.chunks_mut(spec.nodes).map(Mutex::new).collect()),
            None => {
                let row = |slot| Ok(Mutex::new(file.row(slot)?));
                let rows = (0..spec.wanted()).map(row).collect::<Result<Vec<_>>>()?;
                Target::File { rows, journal, path: context.work.file(name) }
            }
        };
        let entries = self.fill(&RowSink::new(spec, target, done), context)?;
        drop(held);
        Ok((file, entries))
    }

    /// Computes the rows that the spec wants, and passes each to `visitor`. None is kept.
    pub fn stream_rows(&self, visitor: RowVisitor<'_>, context: Context<'_>) -> Result<Entries> {
        self.fill(&RowSink::new(self.spec, Target::Visitor(visitor), Entries::new()), context)
    }

    /// Computes the rows that `sink` does not have yet.
    fn fill(&self, sink: &RowSink<'_>, context: Context<'_>) -> Result<Entries> {
        let n = self.spec.nodes;
        if sink.done.len() >= self.spec.wanted() {
            return Ok(sink.done.clone());
        }
        let temporary = format!("nearest-{}.tmp", self.spec.shard);
        let mut own: Option<ArrayMut<f32>> = context.work.array_in_memory(&temporary, &[n]);
        if own.is_none() && !sink.last_row_is_free() {
            own = Some(context.work.array(&temporary, &[n])?);
        }
        let mut field = own.as_mut().map(ArrayMut::data);
        let bytes = (context.run.threads + 1) * n * size_of::<f32>();
        let paged = Pages::needed(self.graph, bytes, context.run);
        let triangles = if paged { None } else { TriangleAdjacency::of(self.graph, context.run)? };
        let graph = Csr { triangles: triangles.as_ref().map_or(&[], TriangleAdjacency::all), ..self.graph };
        // Computed before the kernel's read-ahead is turned off.
        let mean = typical_weight(graph);
        let direct = if paged { self.weighted.direct()? } else { None };
        let each = context.run.budget.left() / 4 * 3 / context.run.threads.max(1) as u64;
        let cached = direct.and_then(|files| Some((files, Division::of(graph, each)?)));
        let running =
            Running { job: RowJob { graph, ..*self }, mean, lengths: None, cached: cached.as_ref(), sink, context };
        Pages::with_pages(self.graph, bytes, context.run, |pages| {
            if self.sampler.needs_lengths() {
                running.with_lengths(field.take(), pages)
            } else {
                running.fronts(field.take(), pages)
            }
        })
    }
}

/// A job in progress: the state shared by its threads.
struct Running<'a, 's> {
    job: RowJob<'a>,
    /// Mean weight of the graph.
    mean: f32,
    /// The graph weighted by length only, for samplers that need it.
    lengths: Option<Csr<'a>>,
    /// The graph's files and their division into blocks, if it is larger than memory.
    cached: Option<&'a (DirectGraph, Division)>,
    sink: &'a RowSink<'s>,
    context: Context<'a>,
}

impl Running<'_, '_> {
    /// [`Running::fronts`] with an additional graph of lengths: 4 bytes per entry in a mapped file.
    fn with_lengths(&self, field: Option<&mut MappedSliceMut<f32>>, pages: Option<Pages>) -> Result<Entries> {
        let (RowJob { graph, nodes, spec, .. }, Context { work, run }) = (self.job, self.context);
        let name = format!("lengths-{}.tmp", spec.shard);
        let mut array: ArrayMut<f32> = work.array(&name, &[graph.weights.len()])?;
        fill_lengths(graph, nodes, array.data(), run)?;
        let lengths = Csr { weights: &array.data()[..], triangles: &[], ..graph };
        Running { lengths: Some(lengths), ..*self }.fronts(field, pages)
    }

    /// Runs search and fronts until all wanted rows are done. The search's field is `field`, or the place of the last
    /// row.
    fn fronts(&self, field: Option<&mut MappedSliceMut<f32>>, pages: Option<Pages>) -> Result<Entries> {
        let run = self.context.run;
        let front = || Front::new(self.mean).paged(pages.clone());
        let (send, receive) = crossbeam_channel::unbounded::<Request>();
        let (done, finished) = crossbeam_channel::unbounded::<Result<JournalEntry>>();
        let mut entries = self.sink.done.clone();
        let missing = self.job.spec.wanted() - entries.len();
        let others = Cancel::default();
        std::thread::scope(|scope| -> Result<()> {
            let (requests, out) = (receive.clone(), done.clone());
            let (mut searching, others) = (front(), &others);
            spawn(scope, move || {
                let ended = catch(|| {
                    match field {
                        Some(field) => self.search(field, &mut searching, (&send, &out), others),
                        None => match self.sink.take(self.job.spec.rows - 1) {
                            Some(mut last) => self.search(&mut last, &mut searching, (&send, &out), others),
                            None => Err(Error::internal("a search without a field")),
                        },
                    }?;
                    drop(send);
                    self.rows(0, &mut searching, &requests, &out)
                });
                // After an error in another thread nobody receives this.
                ended.flatten().unwrap_or_else(|error| drop(out.send(Err(error))));
            })?;
            for thread in 1..run.threads.min(missing) {
                let (requests, out) = (receive.clone(), done.clone());
                let mut front = front();
                // If the system refuses a thread, the others do its work.
                drop(spawn(scope, move || {
                    let ended = catch(|| self.rows(thread, &mut front, &requests, &out));
                    ended.flatten().unwrap_or_else(|error| drop(out.send(Err(error))));
                }));
            }
            drop((receive, done));
            // Moved in, so that the threads see the channel close when this returns early.
            let finished = finished;
            for _ in 0..missing {
                let lost = || Err(Error::internal("all threads ended before all rows were there"));
                let entry = finished.recv().unwrap_or_else(|_| lost()).inspect_err(|_| others.cancel())?;
                entries.insert(entry.row, entry);
                run.progress.advance("rows", 1);
            }
            Ok(())
        })?;
        Ok(entries)
    }

    /// Sends the landmarks whose rows are wanted and missing, until another thread fails.
    fn search(
        &self,
        field: &mut MappedSliceMut<f32>,
        front: &mut Front,
        (requests, done): (&Sender<Request>, &Sender<Result<JournalEntry>>),
        failed: &Cancel,
    ) -> Result<()> {
        let (RowJob { graph, nodes, sampler, spec, .. }, sink, run) = (self.job, self.sink, self.context.run);
        let mut row = 0;
        if front.is_paged() {
            field.advise(Access::Random);
        }
        front.values(field.writeback());
        let others = run.threads > 1 && spec.wanted() > 1;
        let found = &mut |landmark: u32, known: Option<&[f32]>| {
            failed.check()?;
            if landmark as usize >= spec.nodes {
                let problem = format!("chose node {landmark}, but there are {}, counted from 0", spec.nodes);
                return Err(Error::parameter("sampling", problem, "choose nodes of the graph"));
            }
            let k = row;
            row += 1;
            sink.enter(landmark);
            if !spec.wants(k) || sink.landmark(k) == Some(landmark) {
                return Ok(());
            }
            let copy = known.filter(|_| others).and_then(|known| AlignedBuffer::copy_of(&run.budget, known));
            match known {
                Some(known) if copy.is_none() => drop(done.send(sink.put(k, landmark, known))),
                _ => drop(requests.send(Request { row: k, landmark, known: copy })),
            }
            Ok(())
        };
        let search = SearchGraph { graph, nodes, lengths: self.lengths };
        let cost = GraphSpace::new(search, front, sink, run).sample(sampler, spec.rows, field, found)?;
        if row < spec.rows {
            let problem = format!("chose {row} of {} landmarks", spec.rows);
            return Err(Error::parameter("sampling", problem, "choose as many as are requested"));
        }
        if sampler.is_costly() {
            let l = spec.rows;
            run.progress.note_of_work(&format!(
                "landmarks: choosing them took as long as {cost:.1} distance rows, in addition to the {l} rows \
                 themselves"
            ));
        }
        Ok(())
    }

    /// Computes rows until there are no more. In place if the rows are in memory; in a buffer, then copied, if the
    /// budget has room for one; else in place in the mapped file, or in the thread's own mapped file if no rows are
    /// kept.
    fn rows(
        &self,
        thread: usize,
        front: &mut Front,
        requests: &Receiver<Request>,
        done: &Sender<Result<JournalEntry>>,
    ) -> Result<()> {
        let name = format!("row-{}-{thread}.tmp", self.job.spec.shard);
        let mut memory = None;
        for Request { row, landmark, known } in requests {
            // A front over a small graph ends before it looks for a stop.
            self.context.run.cancel.check()?;
            let entry = match known {
                Some(known) => self.sink.put(row, landmark, known.items(self.job.spec.nodes)),
                None => {
                    let memory = match &mut memory {
                        Some(memory) => memory,
                        none => none.insert(self.thread_memory(front, &name)?),
                    };
                    self.row(row, landmark, memory, front)
                }
            };
            if done.send(Ok(entry?)).is_err() {
                break;
            }
        }
        Ok(())
    }

    /// Memory for a thread's rows and their fronts.
    fn thread_memory(&self, front: &Front, name: &str) -> Result<ThreadMemory<'_>> {
        let (scratch, budget) = (self.scratch(front, name)?, &self.context.run.budget);
        let cached = self
            .cached
            .and_then(|(files, division)| CachedFront::new(self.job.graph, files, self.mean, division.clone(), budget));
        Ok(ThreadMemory { scratch, cached })
    }

    /// Memory for a thread's rows.
    fn scratch(&self, front: &Front, name: &str) -> Result<Scratch> {
        let n = self.job.spec.nodes;
        if matches!(self.sink.target, Target::Memory(_)) {
            return Ok(Scratch::InPlace);
        }
        if !front.is_paged()
            && let Some(words) = AlignedBuffer::try_new(&self.context.run.budget, 4 * n)
        {
            return Ok(Scratch::Granted(words));
        }
        Ok(match &self.sink.target {
            Target::File { .. } | Target::Memory(_) => Scratch::InPlace,
            Target::Visitor(_) => Scratch::Mapped(self.context.work.array(name, &[n])?),
        })
    }

    /// Computes a row and passes it on.
    fn row(&self, row: usize, landmark: u32, memory: &mut ThreadMemory<'_>, front: &mut Front) -> Result<JournalEntry> {
        let (sink, ThreadMemory { scratch, cached }) = (self.sink, memory);
        let distances = match scratch {
            Scratch::Granted(words) => words.items_mut::<f32>(self.job.spec.nodes),
            Scratch::Mapped(array) => {
                let path = array.path().to_path_buf();
                self.mapped_row((array.data(), &path), landmark, front, cached.as_mut())?;
                return sink.put(row, landmark, array.data());
            }
            Scratch::InPlace => {
                if let Some(mut slot) = sink.held(row) {
                    front.full(self.job.graph, landmark, &mut slot, &self.context.run.cancel)?;
                    return sink.close(row, landmark, &slot, || Ok(()));
                }
                // Without a buffer, rows that are not in memory must be in the file.
                let (Some(mut slot), Some(path)) = (sink.take(row), sink.path()) else {
                    return Err(Error::internal("a row without a place"));
                };
                self.mapped_row((&mut slot, path), landmark, front, cached.as_mut())?;
                return sink.close(row, landmark, &slot, || slot.sync());
            }
        };
        front.full(self.job.graph, landmark, distances, &self.context.run.cancel)?;
        sink.put(row, landmark, distances)
    }

    /// Computes a row in the mapped file `path`.
    fn mapped_row(
        &self,
        (slot, path): (&mut MappedSliceMut<f32>, &Path),
        landmark: u32,
        front: &mut Front,
        cached: Option<&mut CachedFront<'_>>,
    ) -> Result<()> {
        let cancel = &self.context.run.cancel;
        if let (Some(cached), Some(values)) = (cached, slot.writeback())
            && cached.full(landmark, RowFile { values: &values, path }, cancel)?
        {
            slot.advise(Access::Sequential);
            return Ok(());
        }
        front.values(slot.writeback());
        slot.advise(if front.is_paged() { Access::Random } else { Access::Local });
        let full = front.full(self.job.graph, landmark, slot, cancel);
        slot.advise(Access::Sequential);
        full.map(drop)
    }
}
