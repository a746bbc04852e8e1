//! Where the test meshes are, shared by the integration tests.
#![allow(dead_code)]

use std::path::{Path, PathBuf};
use std::process::Command;

/// The folder of unpacked test meshes (`real/`, `flavour/`, `nasty/`, …), or `None`, saying so,
/// where they are missing. `NYSTROM_STREAM_DATA` names the packed folder if it is elsewhere.
pub fn data() -> Option<PathBuf> {
    static DATA: std::sync::OnceLock<Option<PathBuf>> = std::sync::OnceLock::new();
    let found = DATA.get_or_init(unpack);
    if found.is_none() {
        eprintln!("skipped: no test meshes");
    }
    found.clone()
}

/// The packed folder, with `MANIFEST.tsv` and `unpack`.
pub fn packed() -> PathBuf {
    std::env::var_os("NYSTROM_STREAM_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from)
}

fn unpack() -> Option<PathBuf> {
    let script = packed().join("unpack");
    if !script.is_file() {
        return None;
    }
    let target = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("target"), PathBuf::from);
    let folder = target.join("test-data");
    std::fs::create_dir_all(&folder).ok()?;
    // Test binaries may run side by side: the first unpacks, the others wait.
    let lock = std::fs::File::create(target.join("test-data.lock")).ok()?;
    lock.lock().ok()?;
    let done = Command::new("bash").arg(script).arg(&folder).status().ok()?.success();
    done.then_some(folder)
}
