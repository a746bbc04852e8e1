//! Which mesh a work directory is of, and the first stages over it, common to all commands.

use super::params::{Cluster, SegmentParams};
use crate::base::parallel::lock;
use crate::base::{Error, Result};
use crate::graph::{DualGraph, Ordered};
use crate::mesh::Mesh;
use crate::mesh::size::is_pipe;
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

/// What standard input is spooled to in a work directory.
pub const SPOOLED: &str = "input";
/// Bytes hashed at either end of the file.
const END: u64 = 1 << 20;

/// What identifies an input without reading all of it: size, times of change of content and of status, and a hash of
/// its first and last mebibyte. Times that differ say nothing: the file may have been copied.
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

/// What identifies the content of the input at `path`, wherever it lies and whenever it was copied there: its size and
/// a hash of all of it, which takes as long as reading it.
///
/// # Errors
/// As [`identity`].
pub fn content(path: &Path) -> Result<Value> {
    content_as_seen(path, &identity(path)?, None)
}

/// The same of the file whose [`identity`] is `seen`, as `record` has it where that is what its run saw.
fn content_as_seen(path: &Path, seen: &Value, record: Option<&Record>) -> Result<Value> {
    match record.filter(|record| record.seen == *seen) {
        Some(record) => Ok(record.identity.clone()),
        None => Ok(json!({"bytes": seen["bytes"], "whole": checksum(path)?})),
    }
}

/// What identifies the input at `path` in the work directory `work`: its content in one that lasts, as the record has
/// it where nothing has changed since that was made.
///
/// # Errors
/// As [`identity`].
pub fn identity_in(path: &Path, work: &WorkDir) -> Result<Value> {
    let seen = identity(path)?;
    if work.is_temporary() {
        return Ok(seen);
    }
    let content = content_as_seen(path, &seen, Record::read(work).ok().as_ref())?;
    // For the record: a file that changed since it was seen, however long the run takes, is read anew by the next one.
    *lock(&work.input) = seen;
    Ok(content)
}

/// [`content`], as `record` has it where nothing has changed since the run that made it began.
///
/// # Errors
/// As [`identity`].
pub fn recorded_or_content(path: &Path, record: Option<&Record>) -> Result<Value> {
    content_as_seen(path, &identity(path)?, record)
}

/// Whether two identities in work directories that last are of the same content.
pub fn same(a: &Value, b: &Value) -> bool {
    ["bytes", "whole", "stdin", "content"].iter().all(|key| a[key] == b[key])
}

/// The stage that leaves the record.
const RECORD: &str = "record";
/// Version of what the record tells.
const RECORD_VERSION: u32 = 2;

/// Which mesh a work directory is of, and under which options it was made.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    /// Where the mesh lies. A name that is no UTF-8 is kept with what of it can be told; the mesh has to be named then.
    #[serde(serialize_with = "told")]
    pub mesh: PathBuf,
    /// Which input it is ([`identity_in`]).
    pub identity: Value,
    /// The [`identity`] of its file before the run read it; null for standard input and arrays.
    pub seen: Value,
    /// The options.
    pub params: SegmentParams,
    /// The seed.
    pub seed: u64,
}

fn told<S: Serializer>(path: &Path, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    path.to_string_lossy().serialize(serializer)
}

impl Record {
    /// The record of a run; the seed is filled in by [`Record::stamp`].
    pub(super) fn of(opened: &Mesh, identity: &Value, params: &SegmentParams, work: &WorkDir) -> Self {
        let path = opened.path();
        // Standard input lies in the work directory, where it was spooled to.
        let path = if identity.get("stdin").is_some() { work.file(SPOOLED) } else { path.to_path_buf() };
        let mesh = std::path::absolute(&path).unwrap_or(path);
        let seen = if identity.get("whole").is_some() { lock(&work.input).clone() } else { Value::Null };
        Self { mesh, identity: identity.clone(), seen, params: params.clone(), seed: 0 }
    }

    /// Leaves the record in `work`.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(super) fn stamp(mut self, context: Context<'_>) -> Result<()> {
        if context.work.is_temporary() {
            return Ok(());
        }
        self.seed = context.run.seed;
        let inputs = json!({"input": self.identity, "params": self.params, "seed": self.seed});
        context.work.stamp(StageKey::new(RECORD, RECORD_VERSION, inputs), &[], &self, 0.)
    }

    /// Whether the mesh came from standard input, and lies in the work directory.
    pub fn is_spooled(&self) -> bool {
        self.identity.get("stdin").is_some()
    }

    /// Where the mesh lies: what came from standard input in the work directory, which is in `folder` by now.
    pub fn path(&self, folder: &Path) -> PathBuf {
        if self.is_spooled() { folder.join(SPOOLED) } else { self.mesh.clone() }
    }

    /// Whether the file at `path` is the mesh still, or a copy of it.
    ///
    /// # Errors
    /// As [`identity`].
    pub fn is_of(&self, path: &Path) -> Result<bool> {
        match self.identity.get("stdin") {
            Some(sum) => Ok(*sum == checksum(path)?),
            None => Ok(same(&recorded_or_content(path, Some(self))?, &self.identity)),
        }
    }

    /// The record in `work`.
    ///
    /// # Errors
    /// [`Error::WorkDir`] where there is none.
    pub fn read(work: &WorkDir) -> Result<Self> {
        let remedy = "make it first: stage `record`";
        let stage = work.manifest().stages.remove(RECORD);
        let stage = stage.ok_or_else(|| Error::work_dir(work.path(), "does not say which mesh it is of", remedy))?;
        let (facts, inputs) = (&stage.facts, &stage.inputs);
        let same = [("identity", "input"), ("params", "params"), ("seed", "seed")];
        if stage.version != RECORD_VERSION {
            let problem = "was made by another version of the program";
            return Err(Error::work_dir(work.path(), problem, remedy));
        }
        let made = stage.key == key_of(RECORD, RECORD_VERSION, inputs);
        if !made || same.iter().any(|(a, b)| facts[a] != inputs[b]) {
            return Err(work.damaged(MANIFEST, "tells of other options than those of the run"));
        }
        let record: Self = serde_json::from_value(stage.facts)
            .map_err(|error| Error::work_dir(work.path(), format!("its record cannot be read: {error}"), remedy))?;
        if !record.mesh.is_absolute() {
            return Err(work.damaged(MANIFEST, "does not say where the mesh lies"));
        }
        Ok(record)
    }
}

/// Where the mesh of the record in `work` lies, whatever version of the program made it: of the record of another one
/// nothing else is known.
pub fn recorded_mesh(work: &WorkDir) -> Option<PathBuf> {
    work.manifest().stages.remove(RECORD)?.facts["mesh"].as_str().map(PathBuf::from)
}

/// Bytes of graph and normals a triangle, where geometry is an array.
const WITH_ARRAYS: u64 = 80;

/// Whether the graph's geometry is computed from the mesh at each look: by the default method on a large
/// mesh, by K-means and 2-means, if arrays would be more than the kernel can keep in memory, in a work
/// directory that is `temporary`.
pub(super) fn computes(params: &SegmentParams, faces: usize, temporary: bool, run: &Run) -> bool {
    temporary
        && (params.contracts(faces) || params.cluster != Cluster::Parts)
        && WITH_ARRAYS * faces as u64 > run.resident
}

/// Orders the mesh and builds its graph, or opens both; leaves a record of mesh and options for later commands.
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
    Record::of(opened, identity, params, context.work).stamp(context)?;
    Ok((ordered, graph))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a file was is told by when it was seen last, and that was after its graph was made.
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
        // It has not changed since: it is not read again.
        assert_eq!(record().seen, identity(&path).unwrap());
    }
}
