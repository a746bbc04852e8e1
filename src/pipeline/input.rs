//! The identity of a work directory's mesh, and the first stages on it, common to all commands. An identity takes a
//! read of two mebibytes, in a kept directory of the whole file if that has changed since; a record takes a kilobyte.

use super::params::{Cluster, SegmentParams};
use super::proxy::ProxyStage;
use crate::base::parallel::lock;
use crate::base::{Cancel, Error, Result};
use crate::graph::{DualGraph, Ordered};
use crate::mesh::Mesh;
use crate::mesh::size::is_pipe;
use crate::store::leftovers::SPOOLED;
use crate::store::manifest::{MANIFEST, checksum};
use crate::store::stage::{StageKey, key_of};
use crate::store::{Context, Run, WorkDir};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::{Value, json};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::Xxh3;

/// Bytes hashed at either end of the file.
const END: u64 = 1 << 20;

/// Identifies an input without reading all of it: size, times of change of content and of status, and a hash of its
/// first and last mebibyte. A difference in times alone proves nothing: the file may have been copied.
///
/// # Errors
/// [`Error::Io`], [`Error::Unusable`] for a pipe.
pub fn identity(path: &Path) -> Result<Value> {
    let metadata = std::fs::metadata(path).map_err(Error::io(path, "open"))?;
    if is_pipe(path) {
        return Err(Error::unusable(path, "is a pipe, which can be read only once", "save it to a file first"));
    }
    let mut file = File::open(path).map_err(Error::io(path, "open"))?;
    let mut hash = Xxh3::new();
    let mut digest = |from: u64| {
        file.seek(SeekFrom::Start(from))?;
        std::io::copy(&mut (&mut file).take(END), &mut hash)
    };
    digest(0).map_err(Error::io(path, "read"))?;
    if metadata.len() > END {
        digest(metadata.len().saturating_sub(END).max(END)).map_err(Error::io(path, "read"))?;
    }
    Ok(json!({
        "file": path.file_name().unwrap_or_default().to_string_lossy(),
        "bytes": metadata.len(),
        "changed": [metadata.mtime(), metadata.mtime_nsec(), metadata.ctime(), metadata.ctime_nsec()],
        "ends": format!("{:016x}", hash.digest()),
    }))
}

/// Identifies the content of the input at `path`, independent of its location and of copying: its size and a hash of
/// all of it, which takes as long as reading it.
///
/// # Errors
/// As [`identity`].
pub fn content(path: &Path) -> Result<Value> {
    content_as_seen(path, &identity(path)?, None, &Cancel::default())
}

/// The same for the file whose [`identity`] is `seen`; taken from `record` if its run saw the same identity.
fn content_as_seen(path: &Path, seen: &Value, record: Option<&Record>, cancel: &Cancel) -> Result<Value> {
    match record.filter(|record| record.seen == *seen) {
        Some(record) => Ok(record.identity.clone()),
        None => Ok(json!({"bytes": seen["bytes"], "whole": checksum(path, cancel)?})),
    }
}

/// The identity of the input at `path` for the work directory `work`. In a kept directory it is the content, taken from
/// the record if nothing has changed since.
///
/// # Errors
/// As [`identity`].
pub fn identity_in(path: &Path, work: &WorkDir) -> Result<Value> {
    let seen = identity(path)?;
    if work.is_temporary() {
        return Ok(seen);
    }
    let content = content_as_seen(path, &seen, Record::read(work).ok().as_ref(), &work.cancel)?;
    // For the record: if the file changes after this point, however long the run takes, the next run reads it again.
    *lock(&work.input) = seen;
    Ok(content)
}

/// [`content`], taken from `record` if nothing has changed since its run began.
///
/// # Errors
/// As [`identity`].
pub fn recorded_or_content(path: &Path, record: Option<&Record>) -> Result<Value> {
    content_as_seen(path, &identity(path)?, record, &Cancel::default())
}

/// Whether two identities in kept work directories denote the same content.
pub fn same(a: &Value, b: &Value) -> bool {
    ["bytes", "whole", "stdin", "content"].iter().all(|key| a[key] == b[key])
}

/// The stage that writes the record.
const RECORD: &str = "record";
/// Version of the record's content.
const RECORD_VERSION: u32 = 2;

/// Which mesh a work directory belongs to, and the options it was made with.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    /// Location of the mesh. A name that is not UTF-8 is stored lossily; the mesh must then be given explicitly.
    #[serde(serialize_with = "lossy_text")]
    pub mesh: PathBuf,
    /// Identity of the input ([`identity_in`]).
    pub identity: Value,
    /// The [`identity`] of its file before the run read it; null for standard input and arrays.
    pub seen: Value,
    /// The options.
    pub params: SegmentParams,
    /// The seed.
    pub seed: u64,
}

fn lossy_text<S: Serializer>(path: &Path, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    path.to_string_lossy().serialize(serializer)
}

impl Record {
    /// The record of a run; the seed is filled in by [`Record::write`].
    pub(super) fn of(opened: &Mesh, identity: &Value, params: &SegmentParams, work: &WorkDir) -> Self {
        let path = opened.path();
        // Standard input was copied into the work directory.
        let path = if identity.get("stdin").is_some() { work.file(SPOOLED) } else { path.to_path_buf() };
        let mesh = std::path::absolute(&path).unwrap_or(path);
        let seen = if identity.get("whole").is_some() { lock(&work.input).clone() } else { Value::Null };
        Self { mesh, identity: identity.clone(), seen, params: params.clone(), seed: 0 }
    }

    /// Writes the record to `work`.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(super) fn write(mut self, context: Context<'_>) -> Result<()> {
        if context.work.is_temporary() {
            return Ok(());
        }
        self.seed = context.run.seed;
        let inputs = json!({"input": self.identity, "params": self.params, "seed": self.seed});
        context.work.record_stage(StageKey::new(RECORD, RECORD_VERSION, inputs), &[], &self, 0.)
    }

    /// Whether the mesh came from standard input and lies in the work directory.
    pub fn is_spooled(&self) -> bool {
        self.identity.get("stdin").is_some()
    }

    /// Location of the mesh; if it came from standard input, inside the work directory, which is now at `folder`.
    pub fn path(&self, folder: &Path) -> PathBuf {
        if self.is_spooled() { folder.join(SPOOLED) } else { self.mesh.clone() }
    }

    /// Whether the file at `path` is still that mesh, or a copy of it.
    ///
    /// # Errors
    /// As [`identity`].
    pub fn is_of(&self, path: &Path) -> Result<bool> {
        match self.identity.get("stdin") {
            Some(sum) => Ok(*sum == checksum(path, &Cancel::default())?),
            None => Ok(same(&recorded_or_content(path, Some(self))?, &self.identity)),
        }
    }

    /// What is wrong with the copy of standard input in the work directory at `folder`, if anything. Other meshes lie
    /// elsewhere, and are checked when they are read.
    ///
    /// # Errors
    /// [`Error::Io`] if the copy cannot be read.
    pub fn problem_of_copy(&self, folder: &Path) -> Result<Option<&'static str>> {
        let path = self.path(folder);
        Ok(match self.is_spooled() {
            true if !path.exists() => Some("is missing"),
            true if !self.is_of(&path)? => Some("has another checksum: it was changed or damaged"),
            _ => None,
        })
    }

    /// The record in `work`.
    ///
    /// # Errors
    /// [`Error::WorkDir`] if there is none.
    pub fn read(work: &WorkDir) -> Result<Self> {
        let remedy = "create it first: stage `record`";
        let stage = work.manifest().stages.remove(RECORD);
        let stage = stage.ok_or_else(|| Error::work_dir(work.path(), "does not record its mesh", remedy))?;
        let (facts, inputs) = (&stage.facts, &stage.inputs);
        let same = [("identity", "input"), ("params", "params"), ("seed", "seed")];
        if stage.version != RECORD_VERSION {
            let problem = "was made by another version of the program";
            return Err(Error::work_dir(work.path(), problem, remedy));
        }
        let made = stage.key == key_of(RECORD, RECORD_VERSION, inputs);
        if !made || same.iter().any(|(a, b)| facts[a] != inputs[b]) {
            return Err(work.damaged(MANIFEST, "has different options than the run"));
        }
        let record: Self = serde_json::from_value(stage.facts)
            .map_err(|error| Error::work_dir(work.path(), format!("its record cannot be read: {error}"), remedy))?;
        if !record.mesh.is_absolute() {
            return Err(work.damaged(MANIFEST, "does not record the path of the mesh"));
        }
        Ok(record)
    }
}

/// Location of the mesh in the record of `work`, whatever program version wrote it; for other versions nothing else is
/// known.
pub fn recorded_mesh(work: &WorkDir) -> Option<PathBuf> {
    work.manifest().stages.remove(RECORD)?.facts["mesh"].as_str().map(PathBuf::from)
}

/// Bytes of graph and normals per triangle, if geometry is stored.
const WITH_ARRAYS: u64 = 80;

/// Whether the graph's geometry is computed from the mesh at each access: in a `temporary` work directory, if stored
/// arrays would exceed what the kernel can keep in memory, by K-means and 2-means, and by the default method on a large
/// mesh.
pub(super) fn computes(params: &SegmentParams, faces: usize, temporary: bool, run: &Run) -> bool {
    temporary
        && (params.contracts(faces) || params.cluster != Cluster::Parts)
        && WITH_ARRAYS * faces as u64 > run.resident
}

/// Orders the mesh, builds its graph and a proxy if its triangles are long or rough, or opens all of it; writes a
/// record of mesh and options for later commands.
///
/// # Errors
/// [`crate::base::Error::Unusable`] for too large meshes, [`crate::base::Error::Io`], [`crate::base::Error::Memory`],
/// [`crate::base::Error::Cancelled`].
pub fn graph(
    opened: &Mesh,
    identity: &Value,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<(Ordered, DualGraph)> {
    let ordered = Ordered::build(opened, params.ordering(opened.faces.len()), identity, context)?;
    let build = if computes(params, ordered.mesh.faces.len(), context.work.is_temporary(), context.run) {
        DualGraph::build_computed
    } else {
        DualGraph::build
    };
    let graph = build(&ordered.mesh, opened.path(), &ordered.identity, context)?;
    // A kept one may be cut by other options later, without the mesh.
    if !context.work.is_temporary() || params.cluster == Cluster::Parts && !params.exact_rows() {
        context.stage(ProxyStage { mesh: &ordered.mesh, graph: &graph })?;
    }
    Record::of(opened, identity, params, context.work).write(context)?;
    Ok((ordered, graph))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The file's identity is taken before its graph is built, so a later replacement is noticed.
    #[test]
    fn a_mesh_that_is_replaced_while_its_graph_is_made_is_another_one_to_the_next_run() {
        let dir = tempfile::tempdir().unwrap();
        let (path, next) = (dir.path().join("a.stl"), dir.path().join("next"));
        let write = |path: &Path, height: u32| {
            let facet = |[a, b, c]: [&str; 3]| format!("facet\nouter loop\nvertex {a}\nvertex {b}\nvertex {c}\nend");
            let top = format!("0 0 {height}");
            let corners = [["0 0 0", "0 1 0", "1 0 0"], ["0 0 0", "1 0 0", &top], ["1 0 0", "0 1 0", &top]];
            let text = corners.map(|corners| facet(corners) + "loop\nendfacet\n").concat();
            std::fs::write(path, format!("solid a\n{text}endsolid a\n")).unwrap();
        };
        write(&path, 1);
        let (work, run) = (WorkDir::open(&dir.path().join("w")).unwrap(), Run::new(&()));
        let look = || identity_in(&path, &work).unwrap();
        let of_first = look();
        let mesh = crate::mesh::open(&path, work.path(), &run).unwrap();
        write(&next, 2);
        std::fs::rename(&next, &path).unwrap();
        let record = || {
            graph(&mesh, &of_first, &SegmentParams::default(), Context::new(&work, &run)).unwrap();
            Record::read(&work).unwrap()
        };
        let made = record();
        assert!(!same(&look(), &of_first) && !made.is_of(&path).unwrap());
        write(&path, 1);
        assert!(same(&look(), &of_first) && made.is_of(&path).unwrap());
        // It has not changed since, so it is not read again.
        assert_eq!(record().seen, identity(&path).unwrap());
    }
}
