//! A creature to files: a binary PLY written in parallel, its labels as `.npy` or `.seg`.
//!
//! Records have a fixed size, so threads take chunks of them and write each at its place. Files
//! are written under `NAME.partial`, space reserved first, and renamed when whole.

use super::Creature;
use crate::base::{Error, Result, parallel};
use crate::store::{Run, npy};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Records a chunk.
const CHUNK: usize = 1 << 15;
/// Bytes of a vertex: three floats.
const VERTEX: usize = 12;
/// Bytes of a face: a count and three indices.
const FACE: usize = 13;
/// The stage's name for progress.
const STAGE: &str = "generate";

impl Creature {
    /// Writes the mesh to `path`: binary little-endian PLY with float x, y, z and a list of three
    /// indices a face (`int`, or `uint` beyond 2^31 vertices), 19 bytes a face in all. Uses
    /// `run.threads`, a chunk of under half a megabyte each out of `run.budget`; the bytes do not depend on
    /// either. Progress counts faces and vertices.
    ///
    /// # Errors
    /// [`Error::Io`] (a full disk shows before the work), [`Error::Memory`],
    /// [`Error::Cancelled`]; nothing is left behind then.
    pub fn write_ply(&self, path: &Path, run: &Run) -> Result<()> {
        let partial = npy::partial_name(path);
        let total = self.vertex_count() + self.face_count();
        let result = run.stage(STAGE, "records", total, || {
            self.write_records(&partial, run)?;
            std::fs::rename(&partial, path).map_err(Error::io(path, "rename a partial file to"))
        });
        if result.is_err() {
            let _ = std::fs::remove_file(&partial);
        }
        result.map(|_| ())
    }

    fn header(&self) -> String {
        let (vertices, faces) = (self.vertex_count(), self.face_count());
        let index = if vertices > 1 << 31 { "uint" } else { "int" };
        format!(
            "ply\nformat binary_little_endian 1.0\ncomment a creature with known parts\n\
             element vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {faces}\nproperty list uchar {index} vertex_indices\nend_header\n"
        )
    }

    fn write_records(&self, partial: &Path, run: &Run) -> Result<()> {
        let header = self.header();
        let (vertices, faces) = (self.vertex_count() as usize, self.face_count() as usize);
        let bytes = header.len() + vertices * VERTEX + faces * FACE;
        let _grant = run.budget.take("generating", (run.threads * CHUNK * FACE) as u64, 0)?;
        let file = npy::reserve_file(partial, bytes as u64)?;
        let out = Output { path: partial, file: &file, run };
        out.write_at(header.as_bytes(), 0)?;
        out.records(header.len(), vertices, |vertex, buffer| {
            buffer.extend_from_slice(bytemuck::cast_slice(&self.position(vertex).map(f32::to_le_bytes)));
        })?;
        out.records(header.len() + vertices * VERTEX, faces, |face, buffer| {
            buffer.push(3);
            buffer.extend_from_slice(bytemuck::cast_slice(&self.face(face).map(u32::to_le_bytes)));
        })
    }

    /// Writes the label of every face of the file as a `.npy` array of `u32`.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn write_truth_npy(&self, path: &Path, run: &Run) -> Result<()> {
        let mut out = npy::ArrayWriter::<u32>::create(path, 1)?;
        let mut written = self.each_truth(run, |labels| out.push(labels));
        if written.is_ok() {
            written = out.finish(false).map(|_| ());
        }
        if written.is_err() {
            let _ = std::fs::remove_file(npy::partial_name(path));
        }
        written
    }

    /// Writes the label of every face of the file as text, a number a line.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn write_truth_seg(&self, path: &Path, run: &Run) -> Result<()> {
        let partial = npy::partial_name(path);
        let write = || {
            let file = File::create(&partial).map_err(Error::io(&partial, "create"))?;
            let mut out = BufWriter::with_capacity(1 << 18, file);
            self.each_truth(run, |labels| {
                labels.iter().try_for_each(|label| writeln!(out, "{label}")).map_err(Error::io(&partial, "write"))
            })?;
            out.flush().map_err(Error::io(&partial, "write"))?;
            std::fs::rename(&partial, path).map_err(Error::io(path, "rename a partial file to"))
        };
        let result = write();
        if result.is_err() {
            let _ = std::fs::remove_file(&partial);
        }
        result
    }

    /// Hands all labels to `take` in order, a chunk at a time.
    fn each_truth(&self, run: &Run, mut take: impl FnMut(&[u32]) -> Result<()>) -> Result<()> {
        let faces = self.face_count() as usize;
        let mut labels = Vec::with_capacity(CHUNK);
        for k in 0..parallel::chunk_count(faces, CHUNK) {
            run.cancel.check()?;
            labels.clear();
            labels.extend(parallel::chunk_range(faces, CHUNK, k).map(|face| self.truth(face as u64)));
            take(&labels)?;
        }
        Ok(())
    }
}

/// A file that several threads write to, each at its own places.
struct Output<'a> {
    path: &'a Path,
    file: &'a File,
    run: &'a Run<'a>,
}

impl Output<'_> {
    /// Writes records `0..count`, as `record(number, buffer)` appends them, from byte `start` on.
    fn records(&self, start: usize, count: usize, record: impl Fn(u64, &mut Vec<u8>) + Sync) -> Result<()> {
        let work = |k: usize, buffer: &mut Vec<u8>| {
            let range = parallel::chunk_range(count, CHUNK, k);
            buffer.clear();
            range.clone().for_each(|number| record(number as u64, buffer));
            let size = buffer.len() / range.len().max(1);
            self.write_at(buffer, (start + range.start * size) as u64)?;
            self.run.progress.advance(STAGE, range.len() as u64);
            Ok(())
        };
        let chunks = parallel::chunk_count(count, CHUNK);
        let buffer = || Vec::with_capacity(CHUNK * FACE);
        parallel::map_chunks(self.run.threads, &self.run.cancel, chunks, buffer, work).map(|_| ())
    }

    #[cfg(unix)]
    fn write_at(&self, bytes: &[u8], at: u64) -> Result<()> {
        use std::os::unix::fs::FileExt;
        self.file.write_all_at(bytes, at).map_err(Error::io(self.path, "write"))
    }

    #[cfg(windows)]
    fn write_at(&self, mut bytes: &[u8], mut at: u64) -> Result<()> {
        use std::os::windows::fs::FileExt;
        while !bytes.is_empty() {
            let written = self.file.seek_write(bytes, at).map_err(Error::io(self.path, "write"))?;
            bytes = &bytes[written..];
            at += written as u64;
        }
        Ok(())
    }
}
