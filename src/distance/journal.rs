//! Records which rows are finished: one line per row, appended once the row is on the disk.
//!
//! The first line describes the rows ([`JobSpec`]); if it differs, the journal is started over. A line that a killed
//! run left unfinished, or with a wrong checksum, is skipped, and its row is computed again. Checksums of the rows are
//! recorded, so that a row damaged on the disk is not reused. [`ResumeState`] continues an interrupted run; its cost is
//! one pass over the recorded rows, for their checksums.

use crate::base::parallel::lock;
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::sort::map_of;
use crate::base::{Error, Result};
use crate::store::Context;
use crate::store::new_file;
use crate::store::rows_file::RowsFile;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use xxhash_rust::xxh3::xxh3_64;

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
    /// Whether a row of `nodes` nodes can have these sums: they are read from files.
    pub(super) fn is_sound(&self, nodes: usize) -> bool {
        self.reached <= nodes as u64 && self.sum.is_finite() && self.sum >= 0. && self.farthest.is_finite()
    }

    /// The sums of `row`, added up in blocks of fixed size.
    pub fn of(row: &[f32]) -> Self {
        dispatch(Sums(row))
    }
}

/// [`RowFacts::of`], for [`dispatch`].
struct Sums<'a>(&'a [f32]);

impl SimdKernel for Sums<'_> {
    type Output = RowFacts;

    #[inline(always)]
    fn run(self) -> RowFacts {
        let mut facts = RowFacts::default();
        for block in self.0.chunks(4096) {
            // Branch-free and in lanes, so that it vectorises; infinite distances do not count.
            let (mut sum, mut top, mut reached) = ([0f64; 8], [0f32; 8], [0u32; 8]);
            let (lanes, rest) = block.as_chunks::<8>();
            for lanes in lanes {
                for k in 0..8 {
                    let finite = lanes[k] < f32::INFINITY;
                    let d = if finite { lanes[k] } else { 0. };
                    sum[k] += f64::from(d);
                    top[k] = if d > top[k] { d } else { top[k] };
                    reached[k] += u32::from(finite);
                }
            }
            for (k, &d) in rest.iter().enumerate().filter(|(_, d)| **d < f32::INFINITY) {
                sum[k] += f64::from(d);
                top[k] = top[k].max(d);
                reached[k] += 1;
            }
            facts.sum += sum.iter().sum::<f64>();
            facts.reached += u64::from(reached.iter().sum::<u32>());
            facts.farthest = top.iter().fold(facts.farthest, |a, &b| if b > a { b } else { a });
        }
        facts
    }
}

/// Describes the rows of a journal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobSpec {
    /// Key of the stage.
    pub key: String,
    /// The options that determine the rows.
    pub options: serde_json::Value,
    /// Rows in all.
    pub rows: usize,
    /// Number of nodes, the length of a row.
    pub nodes: usize,
    /// Only the rows k with k mod `of` = `shard` belong to this journal.
    pub shard: usize,
    /// Number of shards.
    pub of: usize,
}

impl JobSpec {
    /// Whether such rows can exist: no more than nodes, and no more shards than rows.
    fn is_sound(&self) -> bool {
        self.nodes <= u32::MAX as usize && self.rows <= self.nodes && self.of <= self.rows && self.shard < self.of
    }

    /// Whether row `k` belongs to this shard.
    pub(super) fn wants(&self, k: usize) -> bool {
        k % self.of == self.shard
    }

    /// How many rows belong to this shard.
    pub(super) fn wanted(&self) -> usize {
        self.rows.saturating_sub(self.shard).div_ceil(self.of)
    }
}

/// A finished row.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JournalEntry {
    /// Its number.
    pub row: usize,
    /// Its landmark.
    pub landmark: u32,
    /// Sums of the row, exact to the bit.
    pub facts: RowFacts,
    /// XXH3 of its bytes.
    pub xxh3: u64,
}

/// The checksum of a row.
pub fn checksum(row: &[f32]) -> u64 {
    xxh3_64(bytemuck::cast_slice(row))
}

/// A journal open for appending.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: Mutex<File>,
}

impl Journal {
    /// Reads the journal at `path`: the job and the recorded rows. `None` if there is no readable first line.
    pub fn read(path: &Path) -> Option<(JobSpec, BTreeMap<usize, JournalEntry>)> {
        let mut text = Vec::new();
        File::open(path).ok()?.read_to_end(&mut text).ok()?;
        let text = String::from_utf8_lossy(&text);
        let mut lines = text.lines().map(|line| {
            let (check, body) = line.split_once(' ')?;
            (u64::from_str_radix(check, 16).ok()? == xxh3_64(body.as_bytes())).then_some(body)
        });
        let spec: JobSpec = serde_json::from_slice(lines.next()??.as_bytes()).ok()?;
        if !spec.is_sound() {
            return None;
        }
        let rows = lines.flatten().filter_map(|body| serde_json::from_slice::<JournalEntry>(body.as_bytes()).ok());
        let rows = rows.filter(|line| {
            line.row < spec.rows && (line.landmark as usize) < spec.nodes && line.facts.is_sound(spec.nodes)
        });
        let rows = map_of(rows.map(|line| (line.row, line)));
        Some((spec, rows))
    }

    /// Starts a new journal.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn create(path: &Path, spec: &JobSpec) -> Result<Self> {
        let file = new_file::create(path)?;
        let journal = Self { path: path.to_path_buf(), file: Mutex::new(file) };
        journal.append(spec)?;
        Ok(journal)
    }

    /// Reopens a journal that was [`Journal::read`].
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn reopen(path: &Path) -> Result<Self> {
        // In append mode, in case another process continues the same shard: neither overwrites the other's lines.
        let mut file = File::options().read(true).append(true).open(path).map_err(Error::io(path, "open"))?;
        let end = file.seek(SeekFrom::End(0)).map_err(Error::io(path, "read"))?;
        let mut last = [b'\n'];
        if end > 0 {
            file.seek(SeekFrom::Start(end - 1)).map_err(Error::io(path, "read"))?;
            file.read_exact(&mut last).map_err(Error::io(path, "read"))?;
        }
        if last != [b'\n'] {
            // An unfinished line is terminated, so that it does not corrupt the next one.
            file.write_all(b"\n").map_err(Error::io(path, "write"))?;
        }
        Ok(Self { path: path.to_path_buf(), file: Mutex::new(file) })
    }

    /// Appends a line and syncs it.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn append(&self, item: &impl Serialize) -> Result<()> {
        let body = serde_json::to_string(item)
            .map_err(|error| Error::internal(&format!("the journal cannot be represented as JSON: {error}")))?;
        let line = format!("{:016x} {body}\n", xxh3_64(body.as_bytes()));
        let mut file = lock(&self.file);
        file.write_all(line.as_bytes()).map_err(Error::io(&self.path, "write"))?;
        file.sync_data().map_err(Error::io(&self.path, "sync"))
    }
}

/// The state of rows in progress: new, or continued from an interrupted run.
#[derive(Debug)]
pub(super) struct ResumeState {
    pub file: RowsFile<f32>,
    /// Complete rows by number.
    pub done: BTreeMap<usize, JournalEntry>,
    /// The journal for finished rows; only in a directory that is kept.
    pub journal: Option<Journal>,
}

impl ResumeState {
    /// The rows of `spec` in the file `name` of `work` (under its temporary name). Rows recorded in the journal
    /// `journal` of the same spec are reused if `sound` and their checksums match.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub fn new(
        spec: &JobSpec,
        (name, journal): (&str, &str),
        sound: impl Fn(&JournalEntry) -> bool,
        context: Context<'_>,
    ) -> Result<Self> {
        let (path, journal) = (&context.work.file(name), &context.work.file(journal));
        let earlier = Journal::read(journal).filter(|(of, _)| context.work.durable() && of == spec);
        let taken =
            earlier.and_then(|(_, entries)| Some((RowsFile::reopen(path, spec.wanted(), spec.nodes)?, entries)));
        let (file, mut done) = match taken {
            Some(taken) => taken,
            None => (context.work.rows(name, spec.wanted(), spec.nodes)?, BTreeMap::new()),
        };
        let whole =
            |k: usize, entry: &JournalEntry| file.row(k / spec.of).is_ok_and(|row| checksum(&row) == entry.xxh3);
        done.retain(|&k, entry| spec.wants(k) && sound(entry) && whole(k, entry));
        if !done.is_empty() {
            context.run.progress.note_of_work(&format!(
                "rows: {} of {} reused from an earlier run",
                done.len(),
                spec.wanted()
            ));
        }
        let journal = match (context.work.durable(), done.is_empty()) {
            (false, _) => None,
            (true, true) => Some(Journal::create(journal, spec)?),
            (true, false) => Some(Journal::reopen(journal)?),
        };
        Ok(Self { file, done, journal })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_and_rows_are_sound_up_to_their_bounds() {
        let facts = RowFacts { sum: 0., reached: 9, farthest: 0. };
        assert!(facts.is_sound(9) && !facts.is_sound(8));
        for wrong in [f64::NAN, f64::INFINITY, -1.] {
            assert!(!RowFacts { sum: wrong, ..facts }.is_sound(9));
        }
        assert!(!RowFacts { farthest: f32::INFINITY, ..facts }.is_sound(9));
        let spec = |rows, nodes, shard, of| JobSpec {
            key: String::new(),
            options: serde_json::Value::Null,
            rows,
            nodes,
            shard,
            of,
        };
        assert!(spec(4, 4, 3, 4).is_sound() && spec(1, u32::MAX as usize, 0, 1).is_sound());
        for wrong in [spec(5, 4, 0, 1), spec(4, 4, 0, 5), spec(4, 4, 2, 2), spec(4, 4, 0, 0), spec(1, 1 << 32, 0, 1)] {
            assert!(!wrong.is_sound(), "{wrong:?}");
        }
    }

    #[test]
    fn torn_and_flipped_lines_are_skipped() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("rows.journal");
        let spec = JobSpec { key: "k".into(), options: serde_json::json!({}), rows: 4, nodes: 9, shard: 0, of: 1 };
        let line = |row| JournalEntry {
            row,
            landmark: 7,
            facts: RowFacts { sum: 0.1 + 0.2, reached: 3, farthest: 0.3 },
            xxh3: u64::MAX - 1,
        };
        assert!(Journal::read(&path).is_none());
        let journal = Journal::create(&path, &spec).unwrap();
        (0..3).for_each(|row| journal.append(&line(row)).unwrap());
        drop(journal);
        let whole = std::fs::read(&path).unwrap();
        let (read, rows) = Journal::read(&path).unwrap();
        assert_eq!((read, rows.len(), rows[&2]), (spec, 3, line(2)));
        // Truncated at any byte after the spec, then resumed.
        for cut in whole.len() - 60..whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            Journal::reopen(&path).unwrap().append(&line(3)).unwrap();
            let rows = Journal::read(&path).unwrap().1;
            assert!(rows.contains_key(&3) && rows.contains_key(&1) && rows.values().all(|l| *l == line(l.row)));
        }
        // Two processes that resume the same journal.
        std::fs::write(&path, &whole).unwrap();
        let both = [(); 2].map(|()| Journal::reopen(&path).unwrap());
        both.iter().zip([0, 3]).for_each(|(one, row)| one.append(&line(row)).unwrap());
        assert_eq!(Journal::read(&path).unwrap().1.len(), 4);
        let mut flipped = whole.clone();
        flipped[whole.len() - 20] ^= 1;
        std::fs::write(&path, &flipped).unwrap();
        assert_eq!(Journal::read(&path).unwrap().1.len(), 2);
    }
}
