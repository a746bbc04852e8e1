//! Files of matches: `.npy` (records of match, distance, confidence), `.csv` and `.parquet` (the same in columns, with
//! the vertex first). Any vector of integers can be read as a true map of vertices.

use super::matches::Match;
use crate::apps::integers::read_integers;
use crate::base::{Error, Result};
use crate::mesh::output::publish;
use crate::store::npy;
use crate::store::{MappedBytes, Run};
use std::ffi::OsStr;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// The supported file extensions, for messages.
pub const EXTENSIONS: &str = if cfg!(feature = "parquet") { ".npy, .csv or .parquet" } else { ".npy or .csv" };

const TITLES: &str = "vertex,match,distance,confidence";

/// A file's extension, in lower case.
fn extension(path: &Path) -> Option<String> {
    path.extension().and_then(OsStr::to_str).map(str::to_ascii_lowercase)
}

/// Writes matches to `path`, `.npy`, `.csv` or `.parquet`, by rename.
///
/// ```
/// use nystrom_stream::apps::correspond::{Match, files};
/// use nystrom_stream::store::{Run, WorkDir};
/// let work = WorkDir::temporary(&std::env::temp_dir())?;
/// let matches = [Match { target: 4, distance: 0.1, confidence: 0.9 }, Match::NONE];
/// files::write(&work.file("matches.csv"), &matches, &Run::new(&()))?;
/// assert_eq!(files::read(&work.file("matches.csv"))?, [Some(4), None]);
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
///
/// # Errors
/// [`Error::Parameter`] for another extension; [`Error::Io`], [`Error::Memory`], [`Error::Cancelled`].
pub fn write(path: &Path, matches: &[Match], run: &Run) -> Result<()> {
    match extension(path).as_deref() {
        Some("npy") => npy::write(path, matches, 1, true).map(drop),
        Some("csv") => publish(path, 0, |file| write_csv(path, file, matches, run)),
        #[cfg(feature = "parquet")]
        Some("parquet") => parquet_table::write(path, matches, run),
        _ => Err(Error::extension("output", path, format!("use {EXTENSIONS}"))),
    }
}

/// Matches as a Parquet table.
#[cfg(feature = "parquet")]
mod parquet_table {
    use super::{File, Match, Path, Result, Run, publish};
    use crate::apps::export::parquet::{GROUP, Writer, column, threads_for_groups};
    use parquet::basic::Encoding;
    use parquet::data_type::{FloatType, Int32Type, Int64Type};
    use parquet::file::properties::WriterProperties;
    use parquet::schema::types::ColumnPath;

    pub(super) fn write(path: &Path, matches: &[Match], run: &Run) -> Result<()> {
        let (run, _grant) = threads_for_groups(matches.len(), 0, run)?;
        publish(path, 0, |file| fill(path, file, matches, &run))
    }

    fn fill(path: &Path, file: &mut File, matches: &[Match], run: &Run) -> Result<()> {
        let schema = "message matches { required int32 vertex (INTEGER(32, false)); required int64 match; \
                  required float distance; required float confidence; }";
        let properties = WriterProperties::builder()
            .set_dictionary_enabled(false)
            .set_column_encoding(ColumnPath::from("vertex"), Encoding::DELTA_BINARY_PACKED);
        let mut writer = Writer::new(path, file, schema, properties)?;
        for (k, rows) in matches.chunks(GROUP).enumerate() {
            run.cancel.check()?;
            let first = k * GROUP;
            let columns = [
                column::<Int32Type, _>(|| (first..first + rows.len()).map(|v| v as u32 as i32)),
                column::<Int64Type, _>(|| rows.iter().map(|one| one.target)),
                column::<FloatType, _>(|| rows.iter().map(|one| one.distance)),
                column::<FloatType, _>(|| rows.iter().map(|one| one.confidence)),
            ];
            writer.group(&columns, run)?;
        }
        writer.finish()
    }
}

fn write_csv(path: &Path, file: &mut File, matches: &[Match], run: &Run) -> Result<()> {
    let failed = || Error::io(path, "write");
    let mut out = BufWriter::with_capacity(1 << 18, file);
    writeln!(out, "{TITLES}").map_err(failed())?;
    for (v, one) in matches.iter().enumerate() {
        if v % (1 << 16) == 0 {
            run.cancel.check()?;
        }
        let Match { target, distance, confidence } = one;
        writeln!(out, "{v},{target},{distance},{confidence}").map_err(failed())?;
    }
    out.flush().map_err(failed())
}

/// Reads the match of each vertex, `None` if it has none: from matches as written here, or from a vector of integers
/// (`.npy`; negative for none).
///
/// # Errors
/// [`Error::Unusable`] for another extension, [`Error::Malformed`] naming the item or line, [`Error::Io`].
pub fn read(path: &Path) -> Result<Vec<Option<u32>>> {
    match extension(path).as_deref() {
        Some("npy") => read_npy(path),
        Some("csv") => read_csv(path),
        _ => Err(Error::unusable(path, "unknown extension for matches", "give a .npy or .csv file")),
    }
}

fn read_npy(path: &Path) -> Result<Vec<Option<u32>>> {
    if let Ok(matches) = npy::open::<Match>(path) {
        return Ok(matches.iter().map(Match::vertex).collect());
    }
    let vertex = |item: i128| if item < 0 { Some(None) } else { u32::try_from(item).ok().map(Some) };
    read_integers(path, vertex, "beyond 32 bits", "give matches, or a vector of integers")
}

fn read_csv(path: &Path) -> Result<Vec<Option<u32>>> {
    let bytes = MappedBytes::open(path)?;
    let text = std::str::from_utf8(&bytes)
        .map_err(|error| Error::malformed(path, "text", error.to_string(), "give a file of matches"))?;
    let mut lines = text.lines();
    if lines.next().map(str::trim) != Some(TITLES) {
        let problem = format!("does not begin with {TITLES}");
        return Err(Error::malformed(path, "line 1", problem, "give a file that correspond wrote"));
    }
    let row = |(k, line): (usize, &str)| {
        let mut fields = line.split(',').map(|field| field.trim().parse::<i64>().ok());
        match (fields.next().flatten(), fields.next().flatten()) {
            (Some(vertex), Some(target)) if vertex == k as i64 && target <= u32::MAX.into() => {
                Ok(u32::try_from(target).ok())
            }
            _ => Err(Error::malformed(
                path,
                format!("line {}", k + 2),
                format!("is not vertex {k} and its match"),
                "give a file that correspond wrote",
            )),
        }
    };
    lines.enumerate().map(row).collect()
}
