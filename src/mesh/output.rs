//! Output files appear complete or not at all: they are written as `NAME.partial`, then renamed.
//!
//! Bytes are gathered in a buffer of one mebibyte, so that a writer may append a few at a time.

use crate::base::{Error, Result};
use crate::store::new_file::by_rename;
use std::fs::File;
use std::io::Write;
use std::path::Path;

/// Bytes gathered before they are written.
const FLUSH: usize = 1 << 20;

/// Whether the extension of `path` is `extension`, ignoring case.
pub fn ends_with(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension))
}

/// Calls `write` to fill the output `path`, with `bytes` reserved, under another name until it is complete and synced.
/// Leaves nothing behind on failure.
///
/// # Errors
/// Those of `write`; [`Error::Io`].
pub(crate) fn publish(path: &Path, bytes: u64, write: impl FnOnce(&mut File) -> Result<()>) -> Result<()> {
    by_rename(path, bytes, true, write)
}

/// A buffered writer for appending numbers without a call for each.
pub(crate) struct Gather<'a> {
    path: &'a Path,
    writer: &'a mut dyn Write,
    /// What is not written yet.
    pub buffer: Vec<u8>,
}

impl<'a> Gather<'a> {
    /// Wraps `writer`; `path` names it in errors.
    pub(crate) fn new(path: &'a Path, writer: &'a mut dyn Write) -> Self {
        Self { path, writer, buffer: Vec::with_capacity(FLUSH + FLUSH / 8) }
    }

    /// Writes if enough is gathered; call it about once per record.
    #[inline]
    pub(crate) fn flush_if_full(&mut self) -> Result<()> {
        if self.buffer.len() < FLUSH { Ok(()) } else { self.write_out() }
    }

    fn write_out(&mut self) -> Result<()> {
        self.writer.write_all(&self.buffer).map_err(Error::io(self.path, "write"))?;
        self.buffer.clear();
        Ok(())
    }

    /// Writes bytes directly, past the buffer.
    pub(crate) fn pass(&mut self, bytes: &[u8]) -> Result<()> {
        self.write_out()?;
        self.writer.write_all(bytes).map_err(Error::io(self.path, "write"))
    }

    /// Writes all that is left.
    pub(crate) fn finish(mut self) -> Result<()> {
        self.write_out()?;
        self.writer.flush().map_err(Error::io(self.path, "write"))
    }

    /// Appends an integer as text.
    #[inline]
    pub(crate) fn decimal(&mut self, value: impl itoa::Integer) {
        self.buffer.extend_from_slice(itoa::Buffer::new().format(value).as_bytes());
    }
}
