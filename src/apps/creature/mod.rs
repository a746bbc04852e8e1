//! A four-legged creature of any size with exactly known parts: a mesh for trying everything.
//!
//! Real scans of a billion faces with human segmentations do not exist, so this generates one: a closed, smooth,
//! single-piece surface whose body, neck, head, ears, legs and tail meet in concave valleys, with the borders of parts
//! exactly in the valleys. Any face, vertex or label is computed from its number alone, so that a mesh of any size
//! streams to disk in bounded memory, in parallel, in scan order (neighbours have nearby numbers) or in random order.
//!
//! Cubes give the topology (`cage`), an implicit surface the shape (`shape`), a small relaxed grid the points
//! (`relief`), closed formulas the numbers (`numbering`). Records of the file have a fixed size, so threads take chunks
//! of them and write each at its position. Cost: 0.1 s once; some 5 million faces per second and core, 19 bytes per
//! face on disk, half a megabyte of memory per thread.

mod cage;
mod numbering;
mod relief;
mod shape;

use crate::base::random::{self, splitmix_finalise};
use crate::base::{Error, Result, parallel};
use crate::mesh::ply::{Encoding, HeaderWriter, Scalar};
use crate::store::new_file::by_rename;
use crate::store::{Run, npy};
use numbering::{Holes, Numbering, Permutation};
use rand_xoshiro::rand_core::Rng;
use relief::{Relief, relief};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Which creature to make.
#[derive(Clone, Debug)]
pub struct Options {
    /// Minimum number of faces; the next possible number is made, from 3528 on, which is greater by a share of at most
    /// some 40 / √faces.
    pub faces: u64,
    /// Maximum displacement of a vertex along its normal, as a share of the mean edge length.
    pub noise: f64,
    /// Number of round holes, each a third of a patch of the skin (0.15 % of the area).
    pub holes: usize,
    /// Whether faces and vertices come in random order instead of scan order.
    pub shuffle: bool,
    /// Whether the faces of a patch of the skin without a hole are ordered in tiles instead of rows: then the file is
    /// as local as a mesh sorted along a curve, so that it need not be sorted.
    pub tiles: bool,
    /// Seed of noise, holes and order. The shape does not depend on it.
    pub seed: u64,
}

/// Parses a number of faces as people write it: 1300000 or 1.3e6.
///
/// # Errors
/// A description of what is wrong with it.
pub fn parse_faces(text: &str) -> std::result::Result<u64, String> {
    if let Ok(whole) = text.parse::<u64>() {
        return Ok(whole);
    }
    match text.parse::<f64>() {
        Ok(number) if (0.0..1e18).contains(&number) => Ok(number.round() as u64),
        _ => Err("not a number of faces".to_string()),
    }
}

impl Default for Options {
    /// A smooth whole creature of a hundred thousand faces, in scan order.
    fn default() -> Self {
        Self { faces: 100_000, noise: 0.0, holes: 0, shuffle: false, tiles: false, seed: 0 }
    }
}

/// A creature: every face, vertex and label as a function of its number.
#[derive(Debug)]
pub struct Creature {
    relief: &'static Relief,
    numbering: Numbering,
    faces: Holes,
    /// Amplitude of the noise, in units of length, and its key.
    noise: f64,
    noise_key: u64,
    /// From positions in the file to faces and to vertices, if shuffled.
    order: Option<(Permutation, Permutation)>,
}

/// The maximum number of faces or vertices: indices and node numbers have 32 bits, one value is reserved.
const MOST: u64 = u32::MAX as u64 - 1;

impl Creature {
    /// Prepares a creature; allocates nothing proportional to its size.
    ///
    /// ```
    /// use nystrom_stream::apps::creature::{Creature, Options};
    /// let creature = Creature::new(&Options { faces: 5_000, ..Options::default() })?;
    /// assert!(creature.face_count() >= 5_000);
    /// assert!((creature.truth(0) as usize) < Creature::part_names().len());
    /// # Ok::<(), nystrom_stream::base::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Parameter`] if faces or vertices would not fit into 32-bit numbers, if there are more holes than
    /// patches, or if the noise is not a number from 0 to 1.
    pub fn new(options: &Options) -> Result<Self> {
        if !(0.0..=1.0).contains(&options.noise) {
            let problem = format!("{} is not between 0 and 1", options.noise);
            return Err(Error::parameter("noise", problem, "give a share of the mean edge length, such as 0.05"));
        }
        let too_many = || {
            let problem = format!("{} faces and their vertices exceed 32-bit numbers", options.faces);
            Error::parameter("faces", problem, format!("request at most {}", MOST / 100 * 99))
        };
        if options.faces > MOST {
            return Err(too_many());
        }
        let relief = relief();
        let patches = relief.patches.len();
        let mut m = ((options.faces as f64 / (2 * patches) as f64).sqrt() as u64).max(3);
        let faces = loop {
            let faces = Holes::new(patches, m, options.holes, options.tiles, options.seed)?;
            if faces.count() >= options.faces {
                break faces;
            }
            m += 1;
        };
        let numbering = Numbering::new(&relief.patches, m);
        if faces.count().max(numbering.count()) > MOST {
            return Err(too_many());
        }
        let edge = (relief.area / (patches as u64 * m * m) as f64).sqrt() * (2.0 + std::f64::consts::SQRT_2) / 3.0;
        let order = options.shuffle.then(|| {
            let order = |n, purpose| Permutation::new(n, &mut random::stream(options.seed, purpose));
            (order(faces.count(), "creature face order"), order(numbering.count(), "creature vertex order"))
        });
        let noise_key = random::stream(options.seed, "creature noise").next_u64();
        Ok(Self { relief, numbering, faces, noise: options.noise * edge, noise_key, order })
    }

    /// Number of faces.
    pub fn face_count(&self) -> u64 {
        self.faces.count()
    }

    /// Number of vertices; those inside a hole are not used by any face.
    pub fn vertex_count(&self) -> u64 {
        self.numbering.count()
    }

    /// Names of the parts; labels are indices into this list.
    pub fn part_names() -> &'static [&'static str] {
        &shape::NAMES
    }

    /// The part of face `face` of the file, an index into [`Creature::part_names`].
    ///
    /// # Panics
    /// May panic, like the other functions of a number, if `face` is not below [`Creature::face_count`].
    pub fn truth(&self, face: u64) -> u32 {
        let face = self.order.as_ref().map_or(face, |(faces, _)| faces.forward(face));
        self.relief.patches[self.faces.patch(face).0].part as u32
    }

    /// The vertices of face `face` of the file, counter-clockwise seen from outside.
    pub fn face(&self, face: u64) -> [u32; 3] {
        let face = self.order.as_ref().map_or(face, |(faces, _)| faces.forward(face));
        let (p, row, column, half) = self.faces.square(face);
        let second = self.relief.second_diagonal(p, row, column, self.numbering.m());
        // Corners of the square's two halves, as (row, column) steps from its first corner.
        let corners = match (second, half) {
            (false, 0) => [(0, 0), (0, 1), (1, 1)],
            (false, _) => [(0, 0), (1, 1), (1, 0)],
            (true, 0) => [(0, 0), (0, 1), (1, 0)],
            (true, _) => [(0, 1), (1, 1), (1, 0)],
        };
        corners.map(|(down, right)| {
            let vertex = self.numbering.number((p, row + down, column + right));
            self.order.as_ref().map_or(vertex, |(_, vertices)| vertices.backward(vertex)) as u32
        })
    }

    /// The position of vertex `vertex` of the file; the creature is about 4 long, x forward, z up.
    pub fn position(&self, vertex: u64) -> [f32; 3] {
        let vertex = self.order.as_ref().map_or(vertex, |(_, vertices)| vertices.forward(vertex));
        let (p, row, column) = self.numbering.point(vertex);
        let (mut x, normal) = self.relief.place(p, row, column, self.numbering.m());
        if self.noise > 0.0 {
            let random =
                splitmix_finalise(splitmix_finalise(vertex ^ self.noise_key).wrapping_add(self.noise_key)) >> 11;
            x += normal * (self.noise * (random as f64 / (1u64 << 52) as f64 - 1.0));
        }
        [x.x as f32, x.y as f32, x.z as f32]
    }
}

/// Records per chunk.
const CHUNK: usize = 1 << 15;
/// Bytes of a vertex: three floats.
const VERTEX: usize = 12;
/// Bytes of a face: a count and three indices.
const FACE: usize = 13;
/// The stage's name for progress.
const STAGE: &str = "generate";

impl Creature {
    /// Writes the mesh to `path`: binary little-endian PLY with float x, y, z and a list of three indices per face
    /// (`int`, or `uint` beyond 2^31 vertices), 19 bytes per face in all. Uses `run.threads`, each with a chunk of less
    /// than half a megabyte from `run.budget`; the bytes do not depend on either. Progress counts faces and vertices.
    ///
    /// # Errors
    /// [`Error::Io`] (a full disk is detected before the work starts), [`Error::Memory`], [`Error::Cancelled`]; nothing
    /// is left behind then.
    pub fn write_ply(&self, path: &Path, run: &Run) -> Result<()> {
        let (header, total) = (self.header(), self.vertex_count() + self.face_count());
        let bytes = header.len() + self.vertex_count() as usize * VERTEX + self.face_count() as usize * FACE;
        let write = || by_rename(path, bytes as u64, false, |file| self.write_records(&header, path, file, run));
        run.stage(STAGE, "records", total, write).map(drop)
    }

    fn header(&self) -> Vec<u8> {
        let index = Scalar::numbering(self.vertex_count());
        let mut header = HeaderWriter::new(Encoding::Little);
        header.remark("comment a creature with known parts");
        header.element("vertex", self.vertex_count()).positions(false);
        header.element("face", self.face_count()).corners(Scalar::U8, index);
        header.finish()
    }

    fn write_records(&self, header: &[u8], path: &Path, file: &File, run: &Run) -> Result<()> {
        let (vertices, faces) = (self.vertex_count() as usize, self.face_count() as usize);
        let _grant = run.budget.take("generating", (run.threads * CHUNK * FACE) as u64, 0)?;
        let out = Output { path, file, run };
        out.write_at(header, 0)?;
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
        self.each_truth(run, |labels| out.push(labels))?;
        out.finish(false).map(drop)
    }

    /// Writes the label of every face of the file as text, one number per line.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn write_truth_seg(&self, path: &Path, run: &Run) -> Result<()> {
        by_rename(path, 0, false, |file| {
            let mut out = BufWriter::with_capacity(1 << 18, file);
            self.each_truth(run, |labels| {
                labels.iter().try_for_each(|label| writeln!(out, "{label}")).map_err(Error::io(path, "write"))
            })?;
            out.flush().map_err(Error::io(path, "write"))
        })
    }

    /// Passes all labels to `take` in order, chunk by chunk.
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

/// A file to which several threads write, each at its own positions.
struct Output<'a> {
    path: &'a Path,
    file: &'a File,
    run: &'a Run<'a>,
}

impl Output<'_> {
    /// Writes records `0..count`, as appended by `record(number, buffer)`, from byte `start` on.
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
        self.run.map_chunks(chunks, buffer, work).map(|_| ())
    }

    fn write_at(&self, bytes: &[u8], at: u64) -> Result<()> {
        use std::os::unix::fs::FileExt;
        self.file.write_all_at(bytes, at).map_err(Error::io(self.path, "write"))
    }
}
