//! The rows of `[A B]`: one front a landmark, written straight into the mapped file.
//!
//! One thread searches landmarks and sends each down a channel as soon as it is known; the others take
//! them and run full fronts meanwhile; the searcher joins them when it is done. A finished row goes
//! down a second channel with its sums to the calling thread, which hands it to a listener (cells
//! average it there) and keeps the books. The first landmark's row falls out of the search and is not
//! computed twice.
//!
//! *Distances* are stored, not affinities: σ, kernel and K can change without a new front. A row is
//! a slice of the mapped array, so the kernel may write it back and reclaim it at any time:
//! allocated are only the fronts' queues. Cost: a row is ~40 ns a face and thread, 4 bytes a face on disk.

use super::front::{Front, mean_weight};
use super::landmarks::{Sampling, choose};
use crate::base::parallel::chunk_range;
use crate::base::{Error, Result};
use crate::graph::Node;
use crate::graph::dual::{Csr, Weighted};
use crate::store::npy::ArrayMut;
use crate::store::workdir::key_of;
use crate::store::{MappedSlice, Run, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::sync::Mutex;

/// Sums of a finished row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RowFacts {
    /// Sum of the finite distances.
    pub sum: f64,
    /// Number of finite distances.
    pub reached: u64,
    /// Greatest finite distance.
    pub farthest: f32,
}

impl RowFacts {
    /// The sums of `row`, added up in blocks of fixed size.
    pub fn of(row: &[f32]) -> Self {
        let mut facts = Self::default();
        for block in row.chunks(4096) {
            let mut sum = [0f64; 8];
            for lanes in block.chunks(8) {
                for (s, &d) in sum.iter_mut().zip(lanes) {
                    if d < f32::INFINITY {
                        *s += f64::from(d);
                    }
                }
            }
            facts.sum += sum.iter().sum::<f64>();
            facts.reached += block.iter().filter(|d| **d < f32::INFINITY).count() as u64;
            facts.farthest =
                block.iter().fold(facts.farthest, |top, &d| if d > top && d < f32::INFINITY { d } else { top });
        }
        facts
    }
}

/// The sampled rows of the distance matrix: l × n, and who the landmarks are.
#[derive(Clone, Debug)]
pub struct DistanceRows {
    /// Landmark nodes (l).
    pub landmarks: Vec<u32>,
    /// Distances, row k at `k * n` (l × n).
    pub distances: MappedSlice<f32>,
    /// Sums of each row (l).
    pub facts: Vec<RowFacts>,
    /// Number of nodes n.
    pub nodes: usize,
    /// Key of the stage.
    pub key: String,
}

/// What the manifest keeps of the stage.
#[derive(Debug, Serialize, Deserialize)]
struct Facts {
    rows: Vec<RowFacts>,
}

/// What to sample.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct RowParams {
    /// Number of landmarks wanted; capped at the number of nodes.
    pub l: usize,
    /// How they are chosen.
    pub sampling: Sampling,
}

/// A finished row on its way to the caller.
struct Finished {
    row: usize,
    landmark: u32,
    facts: RowFacts,
}

impl DistanceRows {
    /// Row `k` (n).
    pub fn row(&self, k: usize) -> &[f32] {
        &self.distances[k * self.nodes..(k + 1) * self.nodes]
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.landmarks.len()
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.landmarks.is_empty()
    }

    /// Mean of all finite distances: the paper's σ.
    pub fn mean(&self) -> f64 {
        let (sum, count) = self.facts.iter().fold((0., 0), |(s, c), row| (s + row.sum, c + row.reached));
        sum / (count.max(1)) as f64
    }

    /// Computes the rows in `work`, or opens them where that was done.
    ///
    /// # Errors
    /// [`Error::Parameter`] for l = 0, [`Error::Io`], [`Error::Cancelled`].
    pub fn build(graph: &Weighted, nodes: &[Node], params: RowParams, work: &WorkDir, run: &Run) -> Result<Self> {
        if params.l == 0 {
            return Err(Error::parameter("-l", "0 landmarks", "choose at least 1"));
        }
        let options = json!({"stage": "rows", "weights": graph.key, "params": params, "seed": run.seed});
        let key = key_of(&options);
        let n = nodes.len();
        if let Ok(facts) = work.reuse::<Facts>("rows", &key) {
            run.progress.note("rows: reused");
            let landmarks = work.open_array::<u32>("landmarks.npy")?.to_vec();
            return Ok(Self { landmarks, distances: work.open_array("distances.npy")?, facts: facts.rows, nodes: n, key });
        }
        let l = params.l.min(n);
        let (rows, seconds) = run.stage("rows", "rows", l as u64, || Self::make(graph.csr(), nodes, l, params, work, run, key))?;
        let facts = Facts { rows: rows.facts.clone() };
        work.stamp("rows", &rows.key, &options, &["landmarks.npy", "distances.npy"], &facts, seconds)?;
        Ok(rows)
    }

    fn make(
        graph: Csr<'_>,
        nodes: &[Node],
        l: usize,
        params: RowParams,
        work: &WorkDir,
        run: &Run,
        key: String,
    ) -> Result<Self> {
        let n = nodes.len();
        let mean = mean_weight(graph);
        let mut array: ArrayMut<f32> = work.array("distances.npy", &[l, n])?;
        let mut field: ArrayMut<f32> = work.array("nearest.tmp", &[n])?;
        let mut landmarks = vec![0u32; l];
        let mut facts = vec![RowFacts::default(); l];
        {
            let slots: Vec<Mutex<&mut [f32]>> = array.data().chunks_mut(n).map(Mutex::new).collect();
            let field = &mut field.data()[..];
            let (send, receive) = crossbeam_channel::unbounded::<(usize, u32)>();
            let (done, finished) = crossbeam_channel::unbounded::<Result<Finished>>();
            let take = |row: usize| slots[row].lock().unwrap_or_else(|poison| poison.into_inner());
            let report = |row: usize, landmark: u32, distances: &[f32]| {
                let _ = done.send(Ok(Finished { row, landmark, facts: RowFacts::of(distances) }));
            };
            let work_rows = |receive: crossbeam_channel::Receiver<(usize, u32)>| {
                let mut front = Front::new(mean);
                for (row, landmark) in receive {
                    let mut slot = take(row);
                    match front.full(graph, landmark, &mut slot, &run.cancel) {
                        Ok(_) => report(row, landmark, &slot),
                        Err(error) => {
                            let _ = done.send(Err(error));
                            return;
                        }
                    }
                }
            };
            std::thread::scope(|scope| -> Result<()> {
                let search = {
                    let (receive, report, take, work_rows, done) = (receive.clone(), &report, &take, &work_rows, &done);
                    move || {
                        let mut row = 0;
                        let result = choose(params.sampling, l, graph, nodes, run.seed, field, mean, &run.cancel, |landmark, known| {
                            if let Some(known) = known {
                                let mut slot = take(row);
                                slot.copy_from_slice(known);
                                report(row, landmark, &slot);
                            } else {
                                let _ = send.send((row, landmark));
                            }
                            row += 1;
                            Ok(())
                        });
                        drop(send);
                        match result {
                            Ok(()) => work_rows(receive),
                            Err(error) => {
                                let _ = done.send(Err(error));
                            }
                        }
                    }
                };
                scope.spawn(search);
                for _ in 1..run.threads.min(l) {
                    let (receive, work_rows) = (receive.clone(), &work_rows);
                    scope.spawn(move || work_rows(receive));
                }
                drop(receive);
                for _ in 0..l {
                    let row = finished.recv().unwrap_or(Err(Error::Cancelled))?;
                    landmarks[row.row] = row.landmark;
                    facts[row.row] = row.facts;
                    run.progress.advance("rows", 1);
                }
                Ok(())
            })?;
        }
        drop(field);
        work.remove("nearest.tmp.partial");
        crate::store::npy::write(&work.file("landmarks.npy"), &landmarks, 1, false)?;
        let distances = array.finish(false)?;
        Ok(Self { landmarks, distances, facts, nodes: n, key })
    }

    /// The columns of a chunk: calls `visit(row, its part)` for each row over `range` of the nodes.
    pub fn for_columns(&self, chunk: usize, size: usize, mut visit: impl FnMut(usize, &[f32])) {
        let range = chunk_range(self.nodes, size, chunk);
        for k in 0..self.len() {
            visit(k, &self.row(k)[range.clone()]);
        }
    }
}
