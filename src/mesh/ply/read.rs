//! Reading a payload: one pass locates each element, checks it, and decodes what cannot be read in place.
//!
//! Binary elements without lists are skipped in constant time. Little-endian triangles are verified in place, in
//! parallel at memory speed, about 1 ns per face. Everything else is streamed through buffers of [`FLUSH`] numbers into
//! arrays of the scratch folder: triangles, or, from the first other polygon on, corner lists. Triangle strips are
//! unrolled on the way.

use super::element::{Coordinates, Element, Encoding, Kind, Scalar};
use super::header::Header;
use super::values::{Binary, Cursor, Fault, Text};
use crate::base::{Error, Result};
use crate::mesh::geometry::{Faces, check_size};
use crate::mesh::positions::{Positions, StridedLayout};
use crate::store::leftovers::{FACE_STARTS, FACE_VERTICES, TRIANGLES, VERTICES};
use crate::store::npy::{self, ArrayWriter, Item};
use crate::store::{MappedBytes, Run};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Records between two checks of the stop flag.
const CHUNK: usize = 1 << 14;

/// A file being decoded: what to look for, and where to put it.
pub(in crate::mesh) struct Decoder<'a> {
    /// The path as the user gave it.
    pub path: &'a Path,
    pub scratch: &'a Path,
    pub run: &'a Run<'a>,
    pub header: &'a Header,
    pub bytes: &'a MappedBytes,
    /// Number of the vertex element, and of its properties x, y, z.
    pub vertex: usize,
    pub axes: [usize; 3],
    /// Number of the face element, and of its vertex list.
    pub face: usize,
    pub list: usize,
    /// Whether that element holds triangle strips.
    pub strips: bool,
}

/// The result of the pass.
pub(in crate::mesh) struct Decoded {
    pub positions: Positions,
    pub faces: Faces,
    pub ranges: Vec<Range<usize>>,
    pub face_bytes: Option<usize>,
}

/// Runs the pass.
///
/// # Errors
/// [`Error::Malformed`] for payloads cut short, invalid numbers, indices out of range; [`Error::Io`] for the scratch
/// folder; [`Error::Cancelled`].
pub(in crate::mesh) fn decode(decoder: &Decoder) -> Result<Decoded> {
    match decoder.header.encoding {
        Encoding::Ascii => decoder.walk::<Text>(),
        Encoding::Little => decoder.walk::<Binary<false>>(),
        Encoding::Big => decoder.walk::<Binary<true>>(),
    }
}

impl<'a> Decoder<'a> {
    fn walk<C: Cursor<'a>>(&self) -> Result<Decoded> {
        let mut cursor = C::new(self.bytes, self.header.payload);
        let mut ranges = Vec::with_capacity(self.header.elements.len());
        let (mut positions, mut faces, mut face_bytes) = (None, None, None);
        for (number, element) in self.header.elements.iter().enumerate() {
            let start = cursor.seek();
            if number == self.vertex {
                positions = Some(self.vertices(&mut cursor, element)?);
            } else if number == self.face {
                let (found, size) = self.faces(&mut cursor, element)?;
                (faces, face_bytes) = (Some(found), size);
            } else {
                self.skip(&mut cursor, element)?;
            }
            ranges.push(start..cursor.at().max(start));
        }
        match (positions, faces) {
            (Some(positions), Some(faces)) => Ok(Decoded { positions, faces, ranges, face_bytes }),
            _ => Err(Error::unusable(self.path, "has no vertices or no faces", "export the mesh again")),
        }
    }

    /// The error for a record that could not be read.
    fn error(&self, element: &Element, record: usize, fault: Fault) -> Error {
        let place = format!("{} {record}", element.name.escape_debug());
        let (problem, remedy) = fault.explained(element.count);
        Error::malformed(self.path, place, problem, remedy)
    }

    /// The end of a binary element of fixed record size.
    fn end_of_fixed(&self, element: &Element, start: usize) -> Option<Result<usize>> {
        let size = element.fixed_size().filter(|_| self.header.encoding != Encoding::Ascii)?;
        let left = self.bytes.len() - start;
        Some(match element.count.checked_mul(size) {
            Some(bytes) if bytes <= left => Ok(start + bytes),
            _ => Err(self.error(element, left / size.max(1), Fault::End)),
        })
    }

    /// Calls `read(record)` for each record of `element`.
    fn each(&self, element: &Element, mut read: impl FnMut(usize) -> Result<()>) -> Result<()> {
        for start in (0..element.count).step_by(CHUNK) {
            self.run.cancel.check()?;
            for record in start..element.count.min(start + CHUNK) {
                read(record)?;
            }
        }
        Ok(())
    }

    /// Skips an element that the mesh does not need.
    fn skip<C: Cursor<'a>>(&self, cursor: &mut C, element: &Element) -> Result<()> {
        if element.properties.is_empty() {
            return Ok(());
        }
        if let Some(end) = self.end_of_fixed(element, cursor.at()) {
            *cursor = C::new(self.bytes, end?);
            return Ok(());
        }
        self.each(element, |record| {
            let mut all = element.properties.iter();
            all.try_for_each(|property| cursor.skip_value(property.kind))
                .map_err(|fault| self.error(element, record, fault))
        })
    }

    /// The positions: in place if they are packed `float`s or `double`s, else decoded.
    fn vertices<C: Cursor<'a>>(&self, cursor: &mut C, element: &Element) -> Result<Positions> {
        let Coordinates { stride, double } = element.coordinates(self.axes, self.header.encoding);
        if let Some(stride) = stride {
            let start = cursor.at();
            let end = self.end_of_fixed(element, start).unwrap_or(Ok(start))?;
            *cursor = C::new(self.bytes, end);
            let at = self.axes.map(|axis| element.properties[..axis].iter().map(|p| p.kind.least_size()).sum());
            let layout = StridedLayout { offset: start, stride, at, double, len: element.count };
            return Positions::strided(self.path, self.bytes.clone(), layout);
        }
        match double {
            true => self.decode_vertices(cursor, element, |value| value),
            false => self.decode_vertices(cursor, element, |value| value as f32),
        }
    }

    fn decode_vertices<C: Cursor<'a>, T: Item>(
        &self,
        cursor: &mut C,
        element: &Element,
        narrow: impl Fn(f64) -> T,
    ) -> Result<Positions> {
        let path = self.scratch.join(VERTICES);
        let mut writer = ArrayWriter::create(&path, 3)?;
        self.each(element, |record| {
            let mut position = [T::zeroed(); 3];
            for (number, property) in element.properties.iter().enumerate() {
                let axis = self.axes.iter().position(|&axis| axis == number);
                match (axis, property.kind) {
                    (Some(axis), Kind::One(scalar)) => cursor.real(scalar).map(|value| position[axis] = narrow(value)),
                    (_, kind) => cursor.skip_value(kind),
                }
                .map_err(|fault| self.error(element, record, fault))?;
            }
            writer.push(&position)
        })?;
        writer.finish(false)?;
        let layout = StridedLayout::packed(npy::HEADER, size_of::<T>() == 8, element.count);
        Positions::strided(&path, MappedBytes::open(&path)?, layout)
    }

    /// The faces, and the size of their records if it is the same for all.
    fn faces<C: Cursor<'a>>(&self, cursor: &mut C, element: &Element) -> Result<(Faces, Option<usize>)> {
        if let Some(found) = self.triangles_in_place(cursor, element)? {
            return Ok(found);
        }
        let Kind::List { count, item } = element.properties[self.list].kind else {
            return Err(Error::malformed(
                self.path,
                "header",
                "the faces have no vertex list",
                "export the mesh again",
            ));
        };
        let vertices = self.header.elements[self.vertex].count as u64;
        let mut sink = FaceSink::create(self.scratch)?;
        let mut sizes: Option<(usize, bool)> = None;
        let mut reported = 0;
        self.each(element, |record| {
            let start = cursor.at();
            for (number, property) in element.properties.iter().enumerate() {
                if number != self.list {
                    cursor.skip_value(property.kind).map_err(|fault| self.error(element, record, fault))?;
                    continue;
                }
                let size = cursor.length(count).map_err(|fault| self.error(element, record, fault))?;
                let mut strip = Strip::default();
                if !self.strips {
                    sink.begin(size)?;
                }
                for _ in 0..size {
                    let vertex = cursor.integer(item).map_err(|fault| self.error(element, record, fault))?;
                    if self.strips && vertex == -1 {
                        strip = Strip::default();
                    } else if vertex < 0 || vertex as u64 >= vertices {
                        return Err(self.out_of_range(element, record, vertex));
                    } else if !self.strips {
                        sink.corner(vertex as u32)?;
                    } else if let Some(triangle) = strip.next(vertex as u32) {
                        sink.begin(3)?;
                        triangle.into_iter().try_for_each(|corner| sink.corner(corner))?;
                    }
                }
            }
            let size = cursor.at() - start;
            sizes = Some(sizes.map_or((size, true), |(first, equal)| (first, equal && first == size)));
            if sink.faces() >= reported + CHUNK as u64 || record + 1 == element.count {
                self.run.progress.advance("read", sink.faces() - reported);
                reported = sink.faces();
            }
            Ok(())
        })?;
        check_size(sink.faces, sink.corner_count, self.path)?;
        let one_list =
            element.properties.iter().filter(|property| matches!(property.kind, Kind::List { .. })).count() == 1;
        let fixed = sizes.filter(|&(_, equal)| equal && one_list && self.header.encoding != Encoding::Ascii);
        Ok((sink.finish()?, fixed.map(|(size, _)| size)))
    }

    /// The error for a face with a vertex index out of range.
    fn out_of_range(&self, element: &Element, record: usize, vertex: i64) -> Error {
        let vertices = self.header.elements[self.vertex].count;
        Error::malformed(
            self.path,
            format!("{} {record}", element.name.escape_debug()),
            format!("names vertex {vertex}, but there are {vertices}, counted from 0"),
            "repair the mesh or export it again",
        )
    }
}

/// Faces that a thread verifies at a time.
const VERIFIED: usize = 1 << 16;
/// Faces between two checks of the result; a branch per face would double the time.
const BLOCK: usize = 256;

impl<'a> Decoder<'a> {
    /// The fast path: little-endian triangles with 4-byte indices, verified in place.
    fn triangles_in_place<C: Cursor<'a>>(
        &self,
        cursor: &mut C,
        element: &Element,
    ) -> Result<Option<(Faces, Option<usize>)>> {
        let before = element.properties[..self.list].iter();
        let after = element.properties[self.list + 1..].iter();
        let scalars = before.clone().chain(after).all(|property| matches!(property.kind, Kind::One(_)));
        let (Kind::List { count, item: item @ (Scalar::I32 | Scalar::U32) }, Encoding::Little, true, false) =
            (element.properties[self.list].kind, self.header.encoding, scalars, self.strips)
        else {
            return Ok(None);
        };
        let layout = Layout {
            stride: element.least_size() + 12,
            at: before.map(|property| property.kind.least_size()).sum(),
            count: count.size(),
        };
        let start = cursor.at();
        let end = element.count.checked_mul(layout.stride).and_then(|bytes| bytes.checked_add(start));
        let Some(records) = end.and_then(|end| self.bytes.get(start..end)) else { return Ok(None) };
        let most = if item == Scalar::I32 { 1 << 31 } else { u32::MAX };
        let limit = u32::try_from(self.header.elements[self.vertex].count).unwrap_or(u32::MAX).min(most);
        if let Some(odd) = first_odd(self.run, records, layout, limit)? {
            let mut list = C::new(self.bytes, start + odd * layout.stride + layout.at);
            let size = list.length(count).map_err(|fault| self.error(element, odd, fault))?;
            // Another polygon: from here on the assumed record size is wrong, so an apparent error may be none.
            if size != 3 {
                return Ok(None);
            }
            for _ in 0..3 {
                let vertex = list.integer(item).map_err(|fault| self.error(element, odd, fault))?;
                if vertex < 0 || vertex >= i64::from(limit) {
                    return Err(self.out_of_range(element, odd, vertex));
                }
            }
            return Ok(None);
        }
        *cursor = C::new(self.bytes, start + records.len());
        let first = start + layout.at + layout.count;
        let faces = Faces::triangles(self.path, self.bytes.clone(), first, layout.stride, element.count)?;
        Ok(Some((faces, Some(layout.stride))))
    }
}

/// The record layout of triangles of equal size.
#[derive(Clone, Copy, Debug)]
struct Layout {
    /// Bytes from record to record.
    stride: usize,
    /// Bytes from a record's start to the list's count.
    at: usize,
    /// Bytes of the count: 1, 2 or 4; the indices are 4 bytes each.
    count: usize,
}

/// The first record of `records` whose count is not 3 or that has an index of `limit` or more.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
fn first_odd(run: &Run, records: &[u8], layout: Layout, limit: u32) -> Result<Option<usize>> {
    let faces = records.len() / layout.stride.max(1);
    let found = run.map_ranges(faces, VERIFIED, |range| {
        let piece = &records[range.start * layout.stride..range.end * layout.stride];
        let odd = match (layout.count, layout.stride) {
            // The layout of nearly all files has a specialised loop.
            (1, 13) => scan::<1>(piece, 13, 0, limit),
            (1, stride) => scan::<1>(piece, stride, layout.at, limit),
            (2, stride) => scan::<2>(piece, stride, layout.at, limit),
            (_, stride) => scan::<4>(piece, stride, layout.at, limit),
        };
        // The decoder counts the progress of faces that it reads again.
        if odd.is_none() {
            run.progress.advance("read", range.len() as u64);
        }
        Ok(odd.map(|odd| range.start + odd))
    })?;
    Ok(found.into_iter().flatten().next())
}

#[inline(always)]
fn scan<const W: usize>(records: &[u8], stride: usize, at: usize, limit: u32) -> Option<usize> {
    let is_odd = |record: &[u8]| {
        let Some((count, corners)) = record.get(at..).and_then(<[u8]>::split_first_chunk::<W>) else { return true };
        let Some(corners) = corners.first_chunk::<12>() else { return true };
        let count = count.iter().rev().fold(0u32, |value, &byte| value << 8 | u32::from(byte));
        let corner = |k: usize| u32::from_le_bytes([corners[k], corners[k + 1], corners[k + 2], corners[k + 3]]);
        (count != 3) | (corner(0) >= limit) | (corner(4) >= limit) | (corner(8) >= limit)
    };
    for (number, block) in records.chunks(BLOCK * stride).enumerate() {
        let odd = block.chunks_exact(stride).fold(false, |odd, record| odd | is_odd(record));
        if odd {
            return block.chunks_exact(stride).position(is_odd).map(|place| number * BLOCK + place);
        }
    }
    None
}

/// Numbers buffered before they are written.
const FLUSH: usize = 1 << 16;

/// Writes faces into a folder: `triangles.npy` (u32, faces × 3), or `face_starts.npy` (u64, faces + 1) and
/// `face_vertices.npy` (u32).
struct FaceSink {
    folder: PathBuf,
    corners: ArrayWriter<u32>,
    corner_buffer: Vec<u32>,
    starts: Option<ArrayWriter<u64>>,
    start_buffer: Vec<u64>,
    faces: u64,
    corner_count: u64,
}

impl FaceSink {
    /// Starts without faces.
    fn create(folder: &Path) -> Result<Self> {
        Ok(Self {
            folder: folder.to_path_buf(),
            corners: ArrayWriter::create(&folder.join(TRIANGLES), 3)?,
            corner_buffer: Vec::with_capacity(FLUSH),
            starts: None,
            start_buffer: Vec::new(),
            faces: 0,
            corner_count: 0,
        })
    }

    /// Faces so far.
    fn faces(&self) -> u64 {
        self.faces
    }

    /// Begins a face of `size` corners; [`FaceSink::corner`] adds them.
    #[inline]
    fn begin(&mut self, size: u64) -> Result<()> {
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

    /// Adds a corner to the current face.
    #[inline]
    fn corner(&mut self, vertex: u32) -> Result<()> {
        if self.corner_buffer.len() == FLUSH {
            self.corners.push(&self.corner_buffer)?;
            self.corner_buffer.clear();
        }
        self.corner_buffer.push(vertex);
        Ok(())
    }

    /// Converts the triangles so far to polygons.
    fn turn_to_polygons(&mut self) -> Result<()> {
        let path = self.folder.join(TRIANGLES);
        // Whole triangles only: the array that is read back has rows of three.
        self.corners.push(&self.corner_buffer)?;
        self.corner_buffer.clear();
        let polygons = ArrayWriter::create(&self.folder.join(FACE_VERTICES), 1)?;
        let triangles = std::mem::replace(&mut self.corners, polygons).finish(false)?;
        for piece in triangles.chunks(FLUSH) {
            self.corners.push(piece)?;
        }
        drop(triangles);
        std::fs::remove_file(&path).map_err(Error::io(&path, "remove"))?;
        let mut starts = ArrayWriter::create(&self.folder.join(FACE_STARTS), 1)?;
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
    fn finish(mut self) -> Result<Faces> {
        self.corners.push(&self.corner_buffer)?;
        let corners = self.corners.finish(false)?;
        if let Some(mut starts) = self.starts {
            starts.push(&self.start_buffer)?;
            return Ok(Faces::Polygons { starts: starts.finish(false)?, corners });
        }
        let path = self.folder.join(TRIANGLES);
        Faces::triangles(&path, MappedBytes::open(&path)?, npy::HEADER, 12, self.faces as usize)
    }
}

/// A triangle strip being unrolled.
#[derive(Default)]
struct Strip {
    last: [u32; 2],
    seen: u64,
}

impl Strip {
    /// Takes the next vertex; returns the triangle that it completes, unless that repeats a vertex: such degenerate
    /// triangles only steer a strip.
    #[inline]
    fn next(&mut self, vertex: u32) -> Option<[u32; 3]> {
        let [a, b] = self.last;
        self.last = [b, vertex];
        self.seen += 1;
        let real = self.seen >= 3 && a != b && b != vertex && a != vertex;
        // Every other triangle of a strip has the opposite winding.
        real.then_some(if self.seen % 2 == 1 { [a, b, vertex] } else { [b, a, vertex] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_odd_record_is_found_in_any_layout() {
        for (count, at, after) in [(1, 0, 0), (1, 4, 3), (2, 1, 0), (4, 0, 5)] {
            let layout = Layout { stride: at + count + 12 + after, at, count };
            let faces = VERIFIED * 2 + 77;
            let mut records = vec![0u8; faces * layout.stride];
            for record in records.chunks_exact_mut(layout.stride) {
                record[at] = 3;
                record[at + count + 4] = 9;
            }
            let run = Run { threads: 2, ..Run::new(&()) };
            assert_eq!(first_odd(&run, &records, layout, 10).unwrap(), None);
            assert_eq!(first_odd(&run, &records, layout, 9).unwrap(), Some(0));
            records[(VERIFIED + 300) * layout.stride + at + count + 8] = 10;
            assert_eq!(first_odd(&run, &records, layout, 10).unwrap(), Some(VERIFIED + 300));
            records[5 * layout.stride + at] = 4;
            assert_eq!(first_odd(&run, &records, layout, 10).unwrap(), Some(5));
        }
    }

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

    #[test]
    fn strips_alternate_and_leave_out_repeated_vertices() {
        let mut strip = Strip::default();
        let triangles: Vec<_> = [0, 1, 2, 3, 3, 4, 5].into_iter().filter_map(|vertex| strip.next(vertex)).collect();
        assert_eq!(triangles, [[0, 1, 2], [2, 1, 3], [3, 4, 5]]);
    }
}
