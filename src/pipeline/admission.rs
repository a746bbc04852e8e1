//! Whether a work directory may be used for a mesh: a kept one is bound to its mesh, or to its two meshes.
//!
//! For another mesh everything in it would be rebuilt, and a wrong path would destroy hours of work. So this is refused
//! before anything changes, unless it is requested. Cost: reading the manifest.

#[cfg(feature = "correspondence")]
use super::input::content;
use super::input::{Record, recorded_mesh, same};
use crate::base::{Error, Result};
use crate::store::{Context, WorkDir};
use serde_json::Value;
use std::path::Path;

/// Refuses to work on the mesh at `path`, whose identity is `identity`, in a work directory of another mesh, or of an
/// earlier content of that file; with `force` the directory is emptied instead.
///
/// # Errors
/// [`Error::WorkDir`] naming the mesh that the directory belongs to; [`Error::Io`].
pub fn admit(path: &Path, identity: &Value, force: bool, context: Context<'_>) -> Result<()> {
    admitted(force, context, |work| {
        if work.is_of_two() {
            return Err(of_another(path, "belongs to two meshes: it was made by `correspond`".into(), work));
        }
        let here = std::path::absolute(path).unwrap_or(path.to_path_buf());
        let Ok(record) = Record::read(work) else {
            return match recorded_mesh(work) {
                Some(mesh) if mesh != here => {
                    Err(of_another(path, format!("belongs to another mesh, {}", mesh.display()), work))
                }
                // A directory without a record is not protected: the stages check their own inputs.
                _ => Ok(()),
            };
        };
        if same(identity, &record.identity) {
            return Ok(());
        }
        let has = |key: &str| record.identity.get(key).is_some();
        let problem = match record.mesh.display() {
            _ if has("content") => "belongs to another mesh, made from arrays".into(),
            _ if has("stdin") => "belongs to another mesh, from standard input".into(),
            mesh if record.mesh == here => format!("belongs to an earlier version of {mesh}"),
            mesh => format!("belongs to another mesh, {mesh}"),
        };
        Err(of_another(path, problem, work))
    })
}

/// Refuses to match the meshes at `paths`, whose identities are `identities`, in a work directory of one mesh or of two
/// others. With `force` that of one mesh is emptied instead, and in that of two the stages of another mesh are rebuilt.
///
/// # Errors
/// [`Error::WorkDir`] naming the mesh that the directory belongs to; [`Error::Io`].
#[cfg(feature = "correspondence")]
pub fn admit_two(paths: [&Path; 2], identities: &[Value; 2], force: bool, context: Context<'_>) -> Result<()> {
    admitted(force, context, |work| {
        if let Some(mesh) = recorded_mesh(work) {
            return Err(of_another(paths[0], format!("belongs to one mesh, {}", mesh.display()), work));
        }
        for ((path, identity), side) in paths.into_iter().zip(identities).zip(["a", "b"]) {
            let folder = work.file(side);
            if force || !folder.is_dir() {
                continue;
            }
            let inner = WorkDir::open(&folder)?;
            let Some(stage) = inner.manifest().stages.remove("vertex graph") else { continue };
            if !same(identity, &stage.inputs["input"]) {
                let problem = match stage.inputs["input"]["file"].as_str() {
                    Some(name) => format!("belongs to another mesh, {name}, or to an earlier version of it"),
                    None => "belongs to another mesh".into(),
                };
                return Err(of_another(path, problem, &inner));
            }
        }
        Ok(())
    })
}

/// The identity of the mesh at `path` as one of two in a kept work directory: its content and its name, which `info`
/// shows.
///
/// # Errors
/// As [`content`].
#[cfg(feature = "correspondence")]
pub fn identity_of_two(path: &Path) -> Result<Value> {
    let mut identity = content(path)?;
    identity["file"] = path.file_name().unwrap_or_default().to_string_lossy().into();
    Ok(identity)
}

/// The result of `check` for a kept directory; with `force` a refused one is emptied.
fn admitted(force: bool, context: Context<'_>, check: impl FnOnce(&WorkDir) -> Result<()>) -> Result<()> {
    let Context { work, run } = context;
    if work.is_temporary() {
        return Ok(());
    }
    match check(work) {
        Err(Error::WorkDir { .. }) if force => {
            run.progress
                .note_of_work(&format!("{}: emptied, since it belonged to another mesh", work.path().display()));
            work.clear()
        }
        checked => checked,
    }
}

/// The error for working on the mesh at `path` in `work`, which belongs to another mesh; `problem` describes that.
fn of_another(path: &Path, problem: String, work: &WorkDir) -> Error {
    let remedy = format!("choose another folder, or reuse this one for {} with `force`", path.display());
    Error::work_dir(work.path(), problem, remedy)
}
