//! Checks whether the files of a work directory are intact: every byte against its checksum. Lists the files that have
//! none.
//!
//! Cost: one pass over all files, at the speed of the disk.

use super::folder::LOCK;
use super::manifest::MANIFEST;
use super::new_file::partial_name;
use super::workdir::WorkDir;
use crate::base::Result;
use crate::base::sort::map_of;
use crate::store::Context;
use serde::Serialize;
use std::collections::BTreeMap;

/// A file that was checked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Checked {
    /// Its stage.
    pub stage: String,
    /// Its name in the work directory, with the folder if it lies in one: `contracted/cells.npy`.
    pub file: String,
    /// Its size in bytes according to the manifest.
    pub bytes: u64,
    /// What is wrong with it, if anything.
    pub problem: Option<String>,
}

/// Checks every file of every stage in the manifest of `work`, in the manifest's order, then those of nested work
/// directories.
///
/// # Errors
/// [`crate::base::Error::Cancelled`], and those of opening a nested work directory; a file that cannot be read is
/// reported as a problem of that file.
pub fn verify(context: Context<'_>) -> Result<Vec<Checked>> {
    let mut all = stages(context)?;
    for (folder, inner) in context.work.all_inner()? {
        let inside = stages(Context::new(&inner, context.run))?;
        all.extend(inside.into_iter().map(|checked| Checked { file: format!("{folder}/{}", checked.file), ..checked }));
    }
    Ok(all)
}

/// Checks the files of the manifest of `work`.
fn stages(context: Context<'_>) -> Result<Vec<Checked>> {
    let mut all = Vec::new();
    for (stage, record) in context.work.manifest().stages {
        for (name, file) in record.files {
            context.run.cancel.check()?;
            let path = context.work.file(&name);
            let begun = || !path.exists() && partial_name(&path).exists();
            let found = context.work.integrity_error(&name, &file);
            let problem = found.map(|found| if begun() { "is being rebuilt".to_string() } else { found });
            context.run.progress.advance("verify", file.bytes);
            all.push(Checked { stage: stage.clone(), file: name, bytes: file.bytes, problem });
        }
    }
    Ok(all)
}

/// The files in `work` that belong to no stage, with their sizes in bytes: a decoded mesh, a copy of standard input,
/// what a killed run left. What cannot be read is left out.
pub fn unrecorded(work: &WorkDir) -> BTreeMap<String, u64> {
    let manifest = work.manifest();
    let of_stage = |name: &str| manifest.stages.values().any(|stage| stage.files.contains_key(name));
    let file = |entry: std::fs::DirEntry| {
        let (name, metadata) = (entry.file_name().to_string_lossy().into_owned(), entry.metadata().ok()?);
        let is_other = metadata.is_file() && ![MANIFEST, LOCK].contains(&name.as_str()) && !of_stage(&name);
        is_other.then_some((name, metadata.len()))
    };
    let entries = std::fs::read_dir(work.path()).into_iter().flatten().flatten();
    map_of(entries.filter_map(file))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::stage::{StageKey, key_of};
    use crate::store::{Run, npy};
    use serde_json::json;

    #[test]
    fn any_flipped_byte_is_found() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::open(&dir.path().join("w")).unwrap();
        npy::write(&work.file("a.npy"), &[1u32; 100], 1, true).unwrap();
        npy::write(&work.file("b.npy"), &[2f32; 10], 1, true).unwrap();
        let options = json!({});
        let stage = StageKey { name: "s", version: 1, key: key_of("s", 1, &options), inputs: options };
        work.record_stage(stage, &["a.npy", "b.npy"], &(), 0.).unwrap();
        let run = Run::new(&());
        assert!(verify(Context::new(&work, &run)).unwrap().iter().all(|file| file.problem.is_none()));
        let whole = std::fs::read(work.file("a.npy")).unwrap();
        for k in 0..whole.len() {
            let mut flipped = whole.clone();
            flipped[k] ^= 1 << (k % 8);
            std::fs::write(work.file("a.npy"), flipped).unwrap();
            let found = verify(Context::new(&work, &run)).unwrap();
            assert!(found[0].problem.is_some() && found[1].problem.is_none(), "byte {k}");
        }
        std::fs::remove_file(work.file("b.npy")).unwrap();
        assert!(verify(Context::new(&work, &run)).unwrap()[1].problem.is_some());
    }

    /// The files of a contracted mesh lie in a folder of the work directory, those of a proxy in one within it.
    #[test]
    fn files_in_folders_are_checked_too() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::open(&dir.path().join("w")).unwrap();
        let proxy = work.inner("proxy").unwrap();
        proxy.record_stage(StageKey::new("r", 1, json!({})), &[], &(), 0.).unwrap();
        let inner = proxy.inner("contracted").unwrap();
        npy::write(&inner.file("a.npy"), &[1u32; 100], 1, true).unwrap();
        inner.record_stage(StageKey::new("s", 1, json!({})), &["a.npy"], &(), 0.).unwrap();
        let path = inner.file("a.npy");
        drop((inner, proxy));
        let run = Run::new(&());
        let found = || verify(Context::new(&work, &run)).unwrap();
        assert!(found().len() == 1 && found()[0].file == "proxy/contracted/a.npy" && found()[0].problem.is_none());
        std::fs::remove_file(path).unwrap();
        assert!(found()[0].problem.is_some());
    }
}
