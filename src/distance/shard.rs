//! Rows by several processes, on one machine or on several that share a folder.
//!
//! Shard i of n computes the rows k with k mod n = i into its own file with its own journal; the search for landmarks
//! is deterministic and cheap compared with the rows (2–5 fronts), so each shard repeats it. [`merge`] combines the
//! rows into the file that a single process would have written, byte for byte, and records the stage under the same
//! key, so that every later command reuses it.
//!
//! Both may be repeated at any time: a shard that is finished or already merged is recognised, and so is a finished
//! merge.
//!
//! Cost: a shard searches landmarks like a whole run, and computes its part of the rows with the memory stated in
//! [`super::row_job`]. Merging reads and writes 4 bytes per row and face once, through mappings; until it ends, the
//! disk holds the rows twice.

use super::journal::{JobSpec, Journal, JournalEntry, checksum};
use super::row_job::RowJob;
use super::rows::{DistanceRows, ROWS, RowParams, job_spec};
use super::sampler::Sampler;
use crate::base::printable::counted;
use crate::base::sort::sort_by;
use crate::base::{Error, Result};
use crate::graph::NodeView;
use crate::graph::WeightedGraph;
use crate::store::rows_file::RowsFile;
use crate::store::{Context, MappedSlice, WorkDir};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The name of a shard's files, without extension.
fn stem(shard: usize, of: usize) -> String {
    format!("rows-{shard}-of-{of}")
}

/// Computes shard `shard` of `of` in `work`, or finds it finished, alone or merged; returns its number of rows.
///
/// # Errors
/// [`Error::Parameter`] for a shard that does not exist, [`Error::Io`], [`Error::Cancelled`].
pub fn compute(
    graph: &WeightedGraph,
    nodes: NodeView<'_>,
    params: RowParams<impl Sampler + Serialize>,
    (shard, of): (usize, usize),
    context: Context<'_>,
) -> Result<usize> {
    let whole = job_spec(&graph.key, nodes.len(), &params, context.run);
    if shard >= of || of > whole.rows {
        let problem = format!("{shard}/{of} is not a shard of {}", counted(whole.rows, "row"));
        return Err(Error::parameter("shard", problem, "count shards from 0, and use at most one per row"));
    }
    let spec = JobSpec { shard, of, ..whole };
    if DistanceRows::is_done(&spec, context.work) {
        context.run.progress.note_of_work(&format!("rows: shard {shard}/{of} is already merged"));
        return Ok(spec.wanted());
    }
    let stem = stem(shard, of);
    let (array, journal) = (format!("{stem}.npy"), format!("{stem}.journal"));
    let wanted = spec.wanted();
    let done = Journal::read(&context.work.file(&journal))
        .is_some_and(|(found, entries)| found == spec && entries.len() >= wanted);
    if done && context.work.file(&array).exists() {
        context.run.progress.note_of_work(&format!("rows: shard {shard}/{of} is already done"));
        return Ok(wanted);
    }
    // A file of other options must go: if a run is killed after its journal is complete and before its file is renamed,
    // the next one would mistake this file for its own.
    context.work.remove(&array);
    let job = RowJob { weighted: graph, graph: graph.csr(), nodes, sampler: &params.sampling, spec: &spec };
    context
        .run
        .stage("rows", "rows", wanted as u64, || job.compute(&array, &journal, context)?.0.finish(true).map(drop))?;
    Ok(wanted)
}

/// A finished shard.
struct Shard {
    spec: JobSpec,
    entries: BTreeMap<usize, JournalEntry>,
    rows: MappedSlice<f32>,
}

/// Merges the shards in `work` and removes their files. Every row's checksum is verified. If rows are finished and
/// there are no shards, or only some of the same rows, those of an earlier call or of a single process are returned.
///
/// # Errors
/// [`Error::WorkDir`] if shards are missing, unfinished, damaged, or of different options; [`Error::Io`].
pub fn merge(context: Context<'_>) -> Result<DistanceRows> {
    let shards = match find(context.work) {
        Ok(shards) => shards,
        Err(error) => {
            let Some(rows) = DistanceRows::finished(context.work) else { return Err(error) };
            remove_of(&rows.key, context.work)?;
            if any(context.work)? {
                return Err(error);
            }
            context.run.progress.note_of_work("merge: already done");
            return Ok(rows);
        }
    };
    let spec = JobSpec { shard: 0, of: 1, ..shards[0].spec.clone() };
    let make = || {
        let file = RowsFile::<f32>::create(&context.work.file(ROWS), spec.rows, spec.nodes)?;
        let mut entries = Vec::with_capacity(spec.rows);
        for k in 0..spec.rows {
            context.run.cancel.check()?;
            let shard = &shards[k % shards.len()];
            let start = k / shards.len() * spec.nodes;
            let row = &shard.rows[start..start + spec.nodes];
            let entry = shard.entries.get(&k).filter(|entry| entry.xxh3 == checksum(row));
            let Some(entry) = entry else {
                return Err(damaged(context.work, shard.spec.shard, shard.spec.of, &format!("row {k} is damaged")));
            };
            file.row(k)?.copy_from_slice(row);
            entries.push(*entry);
            context.run.progress.advance("merge", 1);
        }
        DistanceRows::finish(file, &entries, &spec, context.work)
    };
    let (rows, seconds) = context.run.stage("merge", "rows", spec.rows as u64, make)?;
    rows.record_stage(&spec, seconds, context.work)?;
    // Merged shards are removed even if their journals cannot be read again, and so are those of another division of
    // the same rows.
    for shard in shards {
        remove(&shard.spec, context.work);
    }
    remove_of(&spec.key, context.work)?;
    Ok(rows)
}

/// Removes the shards in `work` of the rows `key`.
fn remove_of(key: &str, work: &WorkDir) -> Result<()> {
    let read = journals(work)?.into_iter().filter_map(|path| Journal::read(&path));
    read.filter(|(spec, _)| spec.key == key).for_each(|(spec, _)| remove(&spec, work));
    Ok(())
}

/// Removes a shard.
fn remove(spec: &JobSpec, work: &WorkDir) {
    let stem = stem(spec.shard, spec.of);
    ["npy", "npy.partial", "journal"].iter().for_each(|end| work.remove(&format!("{stem}.{end}")));
}

/// Whether `work` has shards, complete or not.
///
/// # Errors
/// [`Error::Io`].
pub fn any(work: &WorkDir) -> Result<bool> {
    Ok(!journals(work)?.is_empty())
}

fn damaged(work: &WorkDir, shard: usize, of: usize, problem: &str) -> Error {
    let name = stem(shard, of);
    let remedy = format!("delete {name}.npy and {name}.journal and compute rows with `shard` {shard}/{of} again");
    Error::work_dir(work.file(&format!("{name}.npy")), problem, remedy)
}

/// The journals of shards in `work`.
fn journals(work: &WorkDir) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(work.path()).map_err(Error::io(work.path(), "list"))?;
    let of_shard = |path: &PathBuf| {
        path.extension().is_some_and(|end| end == "journal")
            && path.file_stem().is_some_and(|stem| stem.to_string_lossy().contains("-of-"))
    };
    Ok(entries.flatten().map(|entry| entry.path()).filter(of_shard).collect())
}

/// The shards in `work`, complete and of the same rows.
fn find(work: &WorkDir) -> Result<Vec<Shard>> {
    let mut found: Vec<(JobSpec, BTreeMap<usize, JournalEntry>)> =
        journals(work)?.iter().filter_map(|path| Journal::read(path)).collect();
    // There may be two unfinished divisions: the one with more finished rows counts.
    let rows =
        |of: usize| found.iter().filter(|(spec, _)| spec.of == of).map(|(_, entries)| entries.len()).sum::<usize>();
    let division = found.iter().map(|(spec, _)| spec.of).max_by_key(|&of| (rows(of), of));
    found.retain(|(spec, _)| Some(spec.of) == division);
    sort_by(&mut found, |(a, _), (b, _)| a.shard.cmp(&b.shard));
    let Some(first) = found.first().map(|(spec, _)| spec.clone()) else {
        return Err(Error::work_dir(work.path(), "holds no shards of rows", "compute rows with `shard` i/n"));
    };
    for shard in 0..first.of {
        let same = |spec: &JobSpec| *spec == JobSpec { shard, ..first.clone() };
        match found.get(shard) {
            Some((spec, entries)) if same(spec) && entries.len() == spec.wanted() => {}
            Some((spec, entries)) if same(spec) => {
                let problem = format!("only {} of {} rows are finished", entries.len(), spec.wanted());
                return Err(damaged(work, shard, first.of, &problem));
            }
            Some((spec, _)) if spec.key != first.key => {
                return Err(damaged(work, spec.shard, spec.of, "it was computed with different options than shard 0"));
            }
            _ => {
                let remedy = format!("compute rows with `shard` {shard}/{} and the options of the others", first.of);
                let file = work.file(&format!("{}.npy", stem(shard, first.of)));
                return Err(Error::work_dir(file, "this shard is missing", remedy));
            }
        }
    }
    if found.len() > first.of {
        return Err(damaged(
            work,
            found[first.of].0.shard,
            found[first.of].0.of,
            "it belongs to a different division into shards",
        ));
    }
    let open = |(spec, entries): (JobSpec, _)| {
        let rows = work.open_array::<f32>(&format!("{}.npy", stem(spec.shard, spec.of)))?;
        if rows.len() != spec.wanted() * spec.nodes {
            return Err(damaged(work, spec.shard, spec.of, "its size is wrong"));
        }
        Ok(Shard { spec, entries, rows })
    };
    found.into_iter().map(open).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distance::sampler::{Found, Space};
    use crate::graph::{DualGraph, Metric};
    use crate::mesh::Mesh;
    use crate::store::Run;
    use serde_json::Value;

    /// Chooses consecutive faces, starting at one that depends on the seed.
    #[derive(Serialize)]
    struct BySeed;

    impl Sampler for BySeed {
        fn choose(
            &self,
            l: usize,
            seed: u64,
            space: &mut dyn Space,
            _: &mut [f32],
            found: &mut Found<'_>,
        ) -> Result<()> {
            let n = space.nodes().len();
            (0..l).try_for_each(|k| found(((seed as usize + k) % n) as u32, None))
        }
    }

    /// The graph of a tetrahedron, without and with weights.
    fn tetrahedron(context: Context<'_>) -> (DualGraph, WeightedGraph) {
        let points = [[0f32, 0., 0.], [2., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        let mesh = Mesh::from_slices(&points, &[[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]).unwrap();
        let graph = DualGraph::build(&mesh, "mesh".as_ref(), &Value::Null, context).unwrap();
        let weighted = graph.weighted(Metric::Geodesic, context).unwrap();
        (graph, weighted)
    }

    /// Chooses these faces, whatever is asked for.
    #[derive(Serialize)]
    struct These([u32; 3]);

    impl Sampler for These {
        fn choose(&self, _: usize, _: u64, _: &mut dyn Space, _: &mut [f32], found: &mut Found<'_>) -> Result<()> {
            self.0.iter().try_for_each(|&face| found(face, None))
        }
    }

    /// Regression: a caller's sampler that chose too few faces, or one that does not exist, was reported as a bug of
    /// this library; the latter as a panic.
    #[test]
    fn a_callers_sampler_that_errs_is_told_so() {
        let work = WorkDir::temporary(&std::env::temp_dir()).unwrap();
        let run = Run::new(&());
        let context = Context::new(&work, &run);
        let (graph, weighted) = tetrahedron(context);
        let rows = |l, faces| {
            DistanceRows::build(&weighted, graph.nodes.view(), RowParams::new(l, These(faces)), context)
                .map(|rows| rows.landmarks)
                .map_err(|error| error.to_string())
        };
        assert_eq!(rows(3, [2, 0, 3]), Ok(vec![2, 0, 3]));
        let told = "sampling: chose node 4, but there are 4, counted from 0; choose nodes of the graph";
        assert_eq!(rows(3, [1, 4, 0]), Err(told.into()));
        let told = "sampling: chose 3 of 4 landmarks; choose as many as are requested";
        assert_eq!(rows(4, [1, 2, 0]), Err(told.into()));
    }

    #[test]
    fn a_shard_that_is_killed_leaves_no_rows_of_other_options() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::open(dir.path()).unwrap();
        let run = Run::new(&());
        let context = Context::new(&work, &run);
        let (graph, weighted) = tetrahedron(context);
        let rows = |run: &Run| {
            let params = RowParams::new(4, BySeed);
            compute(&weighted, graph.nodes.view(), params, (0, 2), Context::new(&work, run))
        };
        let file = dir.path().join("rows-0-of-2.npy");
        assert!(rows(&run).is_ok() && file.exists());
        let killed = Run { seed: 1, ..Run::new(&()) };
        killed.cancel.cancel();
        assert!(rows(&killed).is_err() && !file.exists());
        assert!(rows(&Run { seed: 1, ..Run::new(&()) }).is_ok() && file.exists());
    }
}
