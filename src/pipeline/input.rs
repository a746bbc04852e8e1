//! Which mesh a work directory is of, and the first stages over it, common to all commands.

use super::params::{Cluster, SegmentParams};
use crate::base::{Error, Result};
use crate::graph::half_edges::check_size;
use crate::graph::{DualGraph, Ordered};
use crate::mesh::Mesh;
use crate::mesh::size::is_pipe;
use crate::store::manifest::MANIFEST;
use crate::store::stage::{StageKey, key_of};
use crate::store::{Context, Run, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::Xxh3;

/// Bytes hashed at either end of the file.
const END: u64 = 1 << 20;

/// What identifies an input without reading all of it: size, time of change, and a hash of its first and last
/// mebibyte. A file edited in place in its middle within the clock's resolution goes unnoticed; nothing else does.
///
/// # Errors
/// [`Error::Io`], [`Error::Unusable`] for a pipe.
pub fn identity(path: &Path) -> Result<Value> {
    let metadata = std::fs::metadata(path).map_err(Error::io(path, "open"))?;
    if is_pipe(path) {
        return Err(Error::unusable(path, "is a pipe, which can be read only once", "save it to a file first"));
    }
    let mut file = File::open(path).map_err(Error::io(path, "open"))?;
    let changed = metadata
        .modified()
        .ok()
        .and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok())
        .map_or(0, |age| age.as_nanos() as u64);
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
        "changed": changed,
        "ends": format!("{:016x}", hash.digest()),
    }))
}

/// Whether two identities are of the same content, wherever it lies and whenever it was copied there.
pub fn same(a: &Value, b: &Value) -> bool {
    ["bytes", "ends", "stdin", "content"].iter().all(|key| a[key] == b[key])
}

/// The stage that leaves the record.
const RECORD: &str = "record";
/// Version of what the record tells.
const RECORD_VERSION: u32 = 1;

/// Which mesh a work directory is of, and under which options it was made.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Record {
    /// Where the mesh lies.
    pub mesh: PathBuf,
    /// Which input it is ([`identity`]).
    pub identity: Value,
    /// The options.
    pub params: SegmentParams,
    /// The seed.
    pub seed: u64,
}

impl Record {
    /// The record of a run; the seed is filled in by [`Record::stamp`].
    pub(super) fn of(opened: &Mesh, identity: &Value, params: &SegmentParams, work: &WorkDir) -> Self {
        let path = opened.path();
        // Standard input lies in the work directory, where it was spooled to.
        let path = if identity.get("stdin").is_some() { work.file("input") } else { path.to_path_buf() };
        let mesh = std::path::absolute(&path).unwrap_or(path);
        Self { mesh, identity: identity.clone(), params: params.clone(), seed: 0 }
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

    /// The record in `work`.
    ///
    /// # Errors
    /// [`Error::WorkDir`] where there is none.
    pub fn read(work: &WorkDir) -> Result<Self> {
        let remedy = "make it first: nystrom-stream segment MESH --work-dir …";
        let stage = work.manifest().stages.remove(RECORD);
        let stage = stage.ok_or_else(|| Error::work_dir(work.path(), "does not say which mesh it is of", remedy))?;
        let (facts, inputs) = (&stage.facts, &stage.inputs);
        let same = [("identity", "input"), ("params", "params"), ("seed", "seed")];
        let made = stage.version != RECORD_VERSION
            || (stage.key == key_of(RECORD, RECORD_VERSION, inputs) && same.iter().all(|(a, b)| facts[a] == inputs[b]));
        if !made {
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
    // Before the mesh is sorted for nothing.
    check_size(opened.faces.len() as u64, opened.faces.corner_count() as u64, opened.path())?;
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
