//! Rows under way: begun, or taken up where a run that was stopped left them.
//!
//! Cost of taking up: one pass over the rows that the journal knows, for their checksums.

use super::journal::{Head, Journal, Line, checksum};
use crate::base::Result;
use crate::store::Context;
use crate::store::rows_file::RowsFile;
use std::collections::BTreeMap;

/// A file of rows, and which of them are there.
#[derive(Debug)]
pub(super) struct Begun {
    pub file: RowsFile<f32>,
    /// Whole rows by number.
    pub done: BTreeMap<usize, Line>,
    /// Where finished rows are entered; in a directory that lasts only.
    pub journal: Option<Journal>,
}

impl Begun {
    /// The rows of `head` in the file `name` of `work` (under its temporary name). Those that the journal `journal` of the
    /// same head tells of are taken over where `sound` and their checksums hold.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub fn new(
        head: &Head,
        (name, journal): (&str, &str),
        sound: impl Fn(&Line) -> bool,
        context: Context<'_>,
    ) -> Result<Self> {
        let (path, journal) = (&context.work.file(name), &context.work.file(journal));
        let earlier = Journal::read(&journal).filter(|(of, _)| context.work.durable() && of == head);
        let taken = earlier.and_then(|(_, lines)| Some((RowsFile::reopen(&path, head.wanted(), head.nodes)?, lines)));
        let (file, mut done) = match taken {
            Some(taken) => taken,
            None => (context.work.rows(name, head.wanted(), head.nodes)?, BTreeMap::new()),
        };
        let whole = |k: usize, line: &Line| file.row(k / head.of).is_ok_and(|row| checksum(&row) == line.xxh3);
        done.retain(|&k, line| head.wants(k) && sound(line) && whole(k, line));
        if !done.is_empty() {
            context.run.progress.note(&format!(
                "rows: {} of {} taken over from an earlier run",
                done.len(),
                head.wanted()
            ));
        }
        let journal = match (context.work.durable(), done.is_empty()) {
            (false, _) => None,
            (true, true) => Some(Journal::create(&journal, head)?),
            (true, false) => Some(Journal::reopen(&journal)?),
        };
        Ok(Self { file, done, journal })
    }
}
