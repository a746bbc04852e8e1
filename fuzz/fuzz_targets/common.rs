//! What the targets share: a folder in memory, a budget that hostile sizes must stay within, and files of given bytes.

#![allow(dead_code)] // Not every target uses all of it.

use nystrom_stream::store::{Budget, Run};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Bytes that a run may allocate; libFuzzer's own limit (`-rss_limit_mb`) is far above it and catches what does not count.
pub const BUDGET: u64 = 64 << 20;

static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let memory = Path::new("/dev/shm");
    let parent = if memory.is_dir() { memory.to_path_buf() } else { std::env::temp_dir() };
    tempfile::Builder::new().prefix("nystrom-fuzz").tempdir_in(parent).expect("a folder for scratch files")
});

/// The folder of this process.
pub fn folder() -> &'static Path {
    FOLDER.path()
}

/// A silent run on one thread within [`BUDGET`]; asking the system for its memory would take longer than most inputs.
pub fn run() -> &'static Run<'static> {
    static RUN: LazyLock<Run<'static>> = LazyLock::new(|| {
        let mut run = Run::new(&());
        (run.threads, run.budget) = (1, Budget::new(BUDGET));
        run
    });
    &RUN
}

/// A file of the given ending and bytes; the same path at each call.
pub fn file(ending: &str, bytes: &[u8]) -> PathBuf {
    let path = folder().join(format!("input.{ending}"));
    std::fs::write(&path, bytes).expect("the scratch file is written");
    path
}

/// Errors are one line that says something.
pub fn check(error: &nystrom_stream::Error) {
    let text = error.to_string();
    assert!(!text.is_empty() && !text.contains('\n'), "{text}");
    assert!(!matches!(error, nystrom_stream::Error::Internal { .. }), "{text}");
}
