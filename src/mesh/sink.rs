//! Where decoded faces go: a file of triangles, or, from the first other polygon on, corner lists.
//!
//! Faces stream through two buffers of [`FLUSH`] numbers; a polygon of any size passes in pieces.

use super::surface::Faces;
use crate::base::{Error, Result};
use crate::store::MappedBytes;
use crate::store::npy::{self, ArrayWriter};
use std::path::{Path, PathBuf};

/// Buffered numbers after which they are written.
const FLUSH: usize = 1 << 16;

/// A writer of faces into a folder: `triangles.npy` (u32, faces × 3), or `face_starts.npy` (u64,
/// faces + 1) and `face_vertices.npy` (u32).
pub(super) struct FaceSink {
    folder: PathBuf,
    corners: ArrayWriter<u32>,
    corner_buffer: Vec<u32>,
    starts: Option<ArrayWriter<u64>>,
    start_buffer: Vec<u64>,
    faces: u64,
    corner_count: u64,
}

impl FaceSink {
    /// A sink without faces.
    pub(super) fn create(folder: &Path) -> Result<Self> {
        Ok(Self {
            folder: folder.to_path_buf(),
            corners: ArrayWriter::create(&folder.join("triangles.npy"), 3)?,
            corner_buffer: Vec::with_capacity(FLUSH),
            starts: None,
            start_buffer: Vec::new(),
            faces: 0,
            corner_count: 0,
        })
    }

    /// Faces so far.
    pub(super) fn faces(&self) -> u64 {
        self.faces
    }

    /// Begins a face of `size` corners, which follow by [`FaceSink::corner`].
    #[inline]
    pub(super) fn begin(&mut self, size: u64) -> Result<()> {
        if size != 3 && self.starts.is_none() {
            self.turn_to_polygons()?;
        }
        self.faces += 1;
        self.corner_count += size;
        if let Some(starts) = &mut self.starts {
            self.start_buffer.push(self.corner_count);
            if self.start_buffer.len() >= FLUSH {
                starts.push(&self.start_buffer)?;
                self.start_buffer.clear();
            }
        }
        Ok(())
    }

    /// The next corner of the face begun last.
    #[inline]
    pub(super) fn corner(&mut self, vertex: u32) -> Result<()> {
        if self.corner_buffer.len() == FLUSH {
            self.corners.push(&self.corner_buffer)?;
            self.corner_buffer.clear();
        }
        self.corner_buffer.push(vertex);
        Ok(())
    }

    /// The triangles so far become the first polygons.
    fn turn_to_polygons(&mut self) -> Result<()> {
        let path = self.folder.join("triangles.npy");
        // Whole triangles only: the array that is read back has rows of three.
        self.corners.push(&self.corner_buffer)?;
        self.corner_buffer.clear();
        let polygons = ArrayWriter::create(&self.folder.join("face_vertices.npy"), 1)?;
        let triangles = std::mem::replace(&mut self.corners, polygons).finish(false)?;
        for piece in triangles.chunks(FLUSH) {
            self.corners.push(piece)?;
        }
        drop(triangles);
        std::fs::remove_file(&path).map_err(Error::io(&path, "remove"))?;
        let mut starts = ArrayWriter::create(&self.folder.join("face_starts.npy"), 1)?;
        self.start_buffer.reserve(FLUSH);
        for face in 0..=self.faces {
            self.start_buffer.push(3 * face);
            if self.start_buffer.len() >= FLUSH {
                starts.push(&self.start_buffer)?;
                self.start_buffer.clear();
            }
        }
        self.starts = Some(starts);
        Ok(())
    }

    /// The faces, mapped.
    pub(super) fn finish(mut self) -> Result<Faces> {
        self.corners.push(&self.corner_buffer)?;
        let corners = self.corners.finish(false)?;
        if let Some(mut starts) = self.starts {
            starts.push(&self.start_buffer)?;
            return Ok(Faces::Polygons { starts: starts.finish(false)?, corners });
        }
        let path = self.folder.join("triangles.npy");
        Faces::triangles(&path, MappedBytes::open(&path)?, npy::HEADER, 12, self.faces as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_polygon_turns_triangles_into_corner_lists() {
        for polygons in [false, true] {
            let dir = tempfile::tempdir().unwrap();
            let mut sink = FaceSink::create(dir.path()).unwrap();
            let faces: u32 = 30_000;
            for f in 0..faces {
                let size = if polygons && f > 25_000 { f % 5 } else { 3 };
                sink.begin(size.into()).unwrap();
                for k in 0..size {
                    sink.corner(f + k).unwrap();
                }
            }
            let mesh = sink.finish().unwrap();
            assert_eq!(mesh.len(), faces as usize);
            mesh.for_each(0..faces as usize, |f, corners| {
                let size = if polygons && f > 25_000 { f % 5 } else { 3 };
                assert_eq!(corners, (0..size).map(|k| (f + k) as u32).collect::<Vec<_>>());
            });
            assert_eq!(dir.path().join("triangles.npy").exists(), !polygons);
        }
    }
}
