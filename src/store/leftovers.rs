//! Files in a kept work directory that no later run reads: those of killed runs, and a decoded mesh without a stage.
//!
//! Cost: one listing of the folder when it is opened, and a few removals when it is closed.

use super::WorkDir;

/// The file to which standard input or a pipe is copied.
pub const SPOOLED: &str = "input";
/// The file to which a compressed mesh is decompressed.
pub const DECOMPRESSED: &str = "input.ply";
/// The PLY to which a mesh of another format is converted.
pub const CONVERTED: &str = "converted.ply";
/// The decoded positions of a mesh.
pub const VERTICES: &str = "vertices.npy";
/// The decoded faces of a mesh of triangles.
pub const TRIANGLES: &str = "triangles.npy";
/// The decoded corners of a mesh of polygons.
pub const FACE_VERTICES: &str = "face_vertices.npy";
/// Where the corners of each polygon start.
pub const FACE_STARTS: &str = "face_starts.npy";

/// What opening a mesh file may write. Each run writes it again, except for [`SPOOLED`], which stages refer to.
const DECODED: [&str; 6] = [DECOMPRESSED, CONVERTED, VERTICES, TRIANGLES, FACE_VERTICES, FACE_STARTS];

/// Prefixes of half-filled row files, of one process and of shards. They are kept: their journal records which rows are
/// complete. A higher layer writes them, but leftovers of a killed run can only be recognised when the directory is
/// opened.
const HALF_FILLED_ROWS: [&str; 2] = ["distances.npy.partial", "rows-"];

impl WorkDir {
    /// Removes what killed runs left: temporary files, and a mesh without a stage.
    pub(super) fn sweep(&self) {
        let Ok(entries) = std::fs::read_dir(self.path()) else { return };
        for entry in entries.flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let rows = HALF_FILLED_ROWS.iter().any(|rows| name.starts_with(rows));
            if name.ends_with(".tmp") || (name.ends_with(".partial") && !rows) {
                self.remove(&name);
            }
        }
        self.remove_mesh_without_stage();
    }

    /// Removes a mesh that was copied or decoded here, if no stage was made of it.
    pub(super) fn remove_mesh_without_stage(&self) {
        if self.manifest_lock().stages.is_empty() {
            self.remove(SPOOLED);
            self.remove_decoded();
        }
    }

    /// Removes what was decoded of a mesh that is not used here. A mesh that is open stays readable: it is mapped.
    pub fn remove_decoded(&self) {
        DECODED.iter().for_each(|name| self.remove(name));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::stage::StageKey;
    use serde_json::json;

    /// Regression: a run that failed before its first stage left the mesh that it had decoded, and its folder.
    #[test]
    fn a_decoded_mesh_stays_with_a_stage_alone() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("w");
        let files = [&[SPOOLED][..], &DECODED].concat();
        let decode = |work: &WorkDir| files.iter().for_each(|name| std::fs::write(work.file(name), "mesh").unwrap());
        let left = || files.iter().filter(|name| path.join(name).exists()).count();
        let work = WorkDir::open(&path).unwrap();
        decode(&work);
        drop(work);
        assert!(!path.exists());
        // A killed run.
        let work = WorkDir::open(&path).unwrap();
        decode(&work);
        std::mem::forget(work);
        std::fs::remove_file(path.join("lock")).unwrap();
        std::fs::write(path.join("lock"), crate::store::folder::MARK).unwrap();
        let work = WorkDir::open(&path).unwrap();
        assert_eq!(left(), 0);
        decode(&work);
        work.record_stage(StageKey::new("s", 1, json!({})), &[], &7, 0.5).unwrap();
        drop(work);
        let work = WorkDir::open(&path).unwrap();
        assert_eq!(left(), files.len());
        // Regression: what was decoded of another mesh stayed when its stages went.
        work.clear().unwrap();
        assert_eq!(left(), 1, "the new mesh may be there already");
        drop(work);
        assert_eq!(left(), 0);
    }
}
