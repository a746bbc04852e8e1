//! The size of the mesh in a file, without reading all of it: the basis for planning memory and time.
//!
//! The header of a PLY has the counts, and the file size shows whether they are possible. Cost: microseconds for a PLY,
//! compressed or not; one pass over the text of an OBJ or OFF.

use super::geometry::{Mesh, empty, no_faces, too_many_vertices};
use super::import;
use super::ply::element::Coordinates;
use super::ply::header::{self, CUT_SHORT};
use super::ply::{Encoding, Kind};
use crate::base::{Cancel, Error, Result};
use crate::store::MappedBytes;
use flate2::bufread::MultiGzDecoder;
use serde::Serialize;
use std::io::Read;
use std::path::Path;

/// How many bytes one byte of a gzip file can hold: DEFLATE codes at most 258 bytes in two bits.
const DEFLATE: u64 = 1032;

/// The size of a mesh, and how its file has to be read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MeshSize {
    /// Faces n.
    pub faces: u64,
    /// Vertices.
    pub vertices: u64,
    /// Corners of all faces: exact for binary PLY, OBJ, OFF and STL; three per face where the file does not show it.
    pub corners: u64,
    /// Bytes that decoding (and decompressing) writes; 0 if the file is read in place.
    pub decoded: u64,
    /// Whether the faces are triangle strips, whose lengths headers do not give: `faces` is then an upper bound.
    pub strips: bool,
}

impl MeshSize {
    /// The size of an open mesh, of which nothing has to be decoded any more.
    pub fn of(mesh: &Mesh) -> Self {
        let [faces, vertices, corners] =
            [mesh.faces.len(), mesh.positions.len(), mesh.faces.corner_count()].map(|count| count as u64);
        Self { faces, vertices, corners, decoded: 0, strips: false }
    }
}

/// Whether `path` is a pipe, such as a shell's <(…), or a device: it can be read only once, and has no size.
pub fn is_pipe(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
}

/// Whether the size of the mesh at `path` is known only after reading it: a pipe, or compressed text or STL.
///
/// # Errors
/// [`Error::Io`].
pub fn shows_when_read(path: &Path) -> Result<bool> {
    if is_pipe(path) {
        return Ok(true);
    }
    let bytes = MappedBytes::open(path)?;
    Ok(import::is_compressed(&bytes) && !import::is_ply(path, &head_of(path, &bytes)?))
}

/// Upper bound on the faces of triangle strips in a file of `len` bytes: the header counts strips, and each further
/// vertex makes a face. A vertex takes at least two bytes of text; compressed data are treated as uncompressed.
fn faces_of_strips(header: &header::Header, len: u64) -> u64 {
    let left = len.saturating_sub(header.payload as u64);
    if header.encoding == Encoding::Ascii {
        return left / 2;
    }
    let fixed: u128 = header.elements.iter().map(|element| element.least_bytes(header.encoding)).sum();
    let strips = header.elements.iter().filter(|element| element.is("tristrips"));
    let kinds = strips.flat_map(|element| &element.properties).map(|property| property.kind);
    let items =
        kinds.filter_map(|kind| if let Kind::List { item, .. } = kind { Some(item.size() as u64) } else { None });
    left.saturating_sub(u64::try_from(fixed).unwrap_or(u64::MAX)) / items.min().unwrap_or(4)
}

/// The uncompressed start of `bytes`, the gzip file `path`: its header, and no more than a header may have.
fn head_of(path: &Path, bytes: &[u8]) -> Result<Vec<u8>> {
    let (mut head, mut room) = (Vec::new(), 1 << 16);
    loop {
        head.clear();
        let mut plain = MultiGzDecoder::new(bytes).take(room);
        plain.read_to_end(&mut head).map_err(Error::io(path, "decompress"))?;
        // Nearly always the whole header is there at once.
        if room >= header::LIMIT as u64 || (head.len() as u64) < room || header::parse(path, &head).is_ok() {
            return Ok(head);
        }
        room *= 16;
    }
}

/// The size of the mesh in the file `path`, from its header and the file size. For triangle strips, an upper bound.
///
/// # Errors
/// [`Error::Io`], [`Error::Malformed`], [`Error::Unusable`].
pub fn size_of_mesh(path: &Path, cancel: &Cancel) -> Result<MeshSize> {
    if is_pipe(path) {
        return Err(Error::unusable(path, "is a pipe, whose size is unknown until it is read", "give a file"));
    }
    let bytes = MappedBytes::open(path)?;
    let compressed = import::is_compressed(&bytes);
    let head = if compressed { head_of(path, &bytes)? } else { Vec::new() };
    if bytes.is_empty() || compressed && head.is_empty() {
        return Err(empty(path));
    }
    if !import::is_ply(path, if compressed { &head } else { &bytes[..] }) {
        if compressed {
            let problem = "is compressed and not a PLY, so its size is unknown until it is read";
            return Err(Error::unusable(path, problem, "decompress it first"));
        }
        if let Some(counts) = import::count(path, &bytes, cancel)? {
            if counts.faces == 0 {
                return Err(no_faces(path));
            }
            let import::Counts { vertices, faces, corners, .. } = counts;
            return Ok(MeshSize { faces, vertices, corners, decoded: counts.bytes(), strips: false });
        }
    }
    let header = header::parse(path, if compressed { &head } else { &bytes })?;
    size_of_ply(path, &header, bytes.len() as u64, compressed.then(|| length_in_gzip(&bytes)))
}

/// What a file of gzip says at its end about the length of its content: that of its last member, modulo 2³².
fn length_in_gzip(bytes: &[u8]) -> u64 {
    bytes.last_chunk().map_or(0, |last| u32::from_le_bytes(*last).into())
}

/// The size of the mesh in the PLY file `path` of `len` bytes with this `header`; `expanded` is the
/// [`length_in_gzip`] of a compressed one.
fn size_of_ply(path: &Path, header: &header::Header, len: u64, expanded: Option<u64>) -> Result<MeshSize> {
    let count =
        |name: &str| header.elements.iter().find(|element| element.is(name)).map(|element| element.count as u64);
    let Some(vertices) = count("vertex") else {
        return Err(Error::malformed(path, "header", "there is no vertex element", "export the mesh again"));
    };
    // An empty face element may precede one of strips.
    let some = |name: &str| count(name).filter(|&faces| faces > 0);
    let listed = some("face");
    let in_strips = || some("tristrips").map(|strips| strips.max(faces_of_strips(header, len)));
    let Some(faces) = listed.or_else(in_strips) else { return Err(no_faces(path)) };
    if u32::try_from(vertices).is_err() {
        return Err(too_many_vertices(path));
    }
    if expanded.is_some() {
        check_compressed(header, len, path)?;
    } else {
        header.check_counts(path, len as usize)?;
    }
    let shown = if expanded.is_some() || listed.is_none() { None } else { corners_of_binary(header, len) };
    let likely = shown.unwrap_or_else(|| likely_corners(vertices, faces));
    let spooled = expanded.map_or(0, |told| told.max(least_bytes(header).saturating_add(likely.saturating_mul(4))));
    Ok(MeshSize {
        faces,
        vertices,
        corners: shown.unwrap_or(faces.saturating_mul(3)),
        decoded: spooled.saturating_add(arrays(header, [vertices, faces, likely])),
        strips: listed.is_none(),
    })
}

/// Bytes of the arrays that decoding a file with this `header` writes, with these numbers of vertices, faces and
/// corners.
fn arrays(header: &header::Header, [vertices, faces, corners]: [u64; 3]) -> u64 {
    let triangles = corners == faces.saturating_mul(3);
    let vertex = header.elements.iter().find(|element| element.is("vertex"));
    let coordinates = vertex.and_then(|element| Some(element.coordinates(element.axes()?, header.encoding)));
    let places = match coordinates {
        Some(Coordinates { stride: Some(_), .. }) => 0,
        Some(Coordinates { double: true, .. }) => 24 * vertices,
        _ => 12 * vertices,
    };
    if triangles && header.encoding == Encoding::Little && has_lists_of(header, 4) {
        return places;
    }
    let starts = if triangles { 0 } else { faces.saturating_add(1).saturating_mul(8) };
    places.saturating_add(corners.saturating_mul(4)).saturating_add(starts)
}

/// The least number of bytes that the data after `header` take.
fn least_bytes(header: &header::Header) -> u64 {
    let least: u128 = header.elements.iter().map(|element| element.least_bytes(header.encoding)).sum();
    u64::try_from(least).unwrap_or(u64::MAX)
}

/// Rejects counts that the compressed file `path` of `len` bytes cannot hold.
fn check_compressed(header: &header::Header, len: u64, path: &Path) -> Result<()> {
    let (least, most) = (least_bytes(header), len.saturating_mul(DEFLATE));
    if least <= most {
        return Ok(());
    }
    let problem = format!("the records need at least {least} bytes, but {len} bytes of gzip hold at most {most}");
    Err(Error::malformed(path, "header", problem, CUT_SHORT))
}

/// The corners of all faces of an uncompressed file of `len` bytes; `None` for text, and if anything but the faces has
/// lists.
fn corners_of_binary(header: &header::Header, len: u64) -> Option<u64> {
    let kinds = header.elements.iter().flat_map(|element| element.properties.iter().map(move |p| (element, p.kind)));
    let mut lists = kinds.filter_map(|(element, kind)| match kind {
        Kind::List { item, .. } => Some((element.is("face"), item.size() as u64)),
        Kind::One(_) => None,
    });
    match (header.encoding, lists.next(), lists.next()) {
        (Encoding::Little | Encoding::Big, Some((true, item)), None) => {
            Some(len.saturating_sub(header.payload as u64).saturating_sub(least_bytes(header)) / item)
        }
        _ => None,
    }
}

/// Whether the faces have one list, of items of `size` bytes.
fn has_lists_of(header: &header::Header, size: usize) -> bool {
    header.elements.iter().filter(|element| element.is("face")).all(|element| {
        let lists = element.properties.iter().filter_map(|property| match property.kind {
            Kind::List { item, .. } => Some(item.size()),
            Kind::One(_) => None,
        });
        lists.eq([size])
    })
}

/// An estimate of the corners of `faces` faces. A closed surface has as many edges as vertices and faces together, and
/// twice as many corners; if vertices are not shared, there are as many corners as vertices. Three to four corners per
/// face, and three if the two differ by less than the rim of a surface may contribute.
fn likely_corners(vertices: u64, faces: u64) -> u64 {
    let triangles = faces.saturating_mul(3);
    let all = if vertices >= triangles { vertices } else { vertices.saturating_add(faces).saturating_mul(2) };
    if all < triangles.saturating_add(triangles / 16) { triangles } else { all.min(faces.saturating_mul(4)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::open;
    use crate::store::Run;
    use flate2::Compression;
    use flate2::write::GzEncoder;
    use std::io::Write;

    /// Regression: text was compared with the size of binary records, and only 64 KiB of a compressed header were read.
    #[test]
    fn every_file_that_opens_has_a_size() {
        let dir = tempfile::tempdir().unwrap();
        let header = |more: &str| {
            format!(
                "ply\nformat ascii 1.0\n{more}element vertex 4\nproperty double x\nproperty double y\n\
                 property double z\nproperty double nx\nproperty double ny\nproperty double nz\nelement face 2\n\
                 property list uchar int vertex_indices\nend_header\n"
            )
        };
        let body = "0 0 0 0 0 1\n1 0 0 0 0 1\n1 1 0 0 0 1\n0 1 0 0 0 1\n3 0 1 2\n3 0 2 3\n";
        let long = header(&format!("comment {}\n", "x".repeat(1 << 18))) + body;
        let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
        packed.write_all(long.as_bytes()).unwrap();
        let packed = packed.finish().unwrap();
        for (name, bytes) in [("a.ply", (header("") + body).as_bytes()), ("b.ply.gz", &packed[..])] {
            let path = dir.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            assert!(open(&path, dir.path(), &Run::new(&())).is_ok());
            let size = size_of_mesh(&path, &Cancel::default()).unwrap();
            assert_eq!((size.faces, size.vertices), (2, 4), "{name}");
        }
        let path = dir.path().join("c.ply");
        let many = header("").replace("vertex 4", "vertex 18446744073709551615");
        let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
        packed.write_all(many.as_bytes()).unwrap();
        std::fs::write(&path, packed.finish().unwrap()).unwrap();
        assert!(
            size_of_mesh(&path, &Cancel::default()).unwrap_err().to_string().contains("more than 2^32 − 1 vertices")
        );
        let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
        packed.write_all(header("").replace("face 2", "face 2000000000").as_bytes()).unwrap();
        std::fs::write(&path, packed.finish().unwrap()).unwrap();
        assert!(
            size_of_mesh(&path, &Cancel::default()).unwrap_err().to_string().contains("bytes of gzip hold at most")
        );
        // Faces without properties take no bytes.
        let empty = "ply\nformat ascii 1.0\nelement vertex 0\nelement face 18446744073709551615\nend_header\n";
        std::fs::write(&path, empty).unwrap();
        assert_eq!(size_of_mesh(&path, &Cancel::default()).unwrap().decoded, u64::MAX);
        std::fs::write(&path, header("").replace("face 2", "face 2000") + body).unwrap();
        assert!(
            size_of_mesh(&path, &Cancel::default()).unwrap_err().to_string().contains("2000 records need at least")
        );
    }

    /// Regression: quads and doubles were planned with half of what decoding them writes.
    #[test]
    fn what_decoding_writes_is_planned() {
        let n = 24u32;
        let at = |i: u32| [i % (n + 1), i / (n + 1), 0].map(f64::from);
        for (encoding, scalar, corners) in [
            ("ascii", "float", 3),
            ("ascii", "double", 4),
            ("binary_little_endian", "float", 3),
            ("binary_little_endian", "float", 4),
            ("binary_big_endian", "double", 3),
            ("binary_big_endian", "float", 4),
        ] {
            let cell = |i: u32| [i, i + 1, i + n + 2, i + n + 1].map(|v| v + i / n);
            let faces: Vec<Vec<u32>> = (0..n * n)
                .map(cell)
                .flat_map(
                    |[a, b, c, d]| {
                        if corners == 4 { vec![vec![a, b, c, d]] } else { vec![vec![a, b, c], vec![a, c, d]] }
                    },
                )
                .collect();
            let vertices = (n + 1) * (n + 1);
            let mut file = format!(
                "ply\nformat {encoding} 1.0\nelement vertex {vertices}\nproperty {scalar} x\nproperty {scalar} y\n\
                 property {scalar} z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
                faces.len()
            )
            .into_bytes();
            let mut put = |x: f64, word: &str| match (encoding, word) {
                ("ascii", _) => file.extend(format!("{x} ").bytes()),
                (_, "uchar") => file.push(x as u8),
                ("binary_big_endian", "int") => file.extend((x as i32).to_be_bytes()),
                ("binary_big_endian", "float") => file.extend((x as f32).to_be_bytes()),
                ("binary_big_endian", _) => file.extend(x.to_be_bytes()),
                (_, "int") => file.extend((x as i32).to_le_bytes()),
                (_, "float") => file.extend((x as f32).to_le_bytes()),
                (_, _) => file.extend(x.to_le_bytes()),
            };
            (0..vertices).flat_map(at).for_each(|x| put(x, scalar));
            for face in &faces {
                put(face.len() as f64, "uchar");
                face.iter().for_each(|&v| put(f64::from(v), "int"));
            }
            let dir = tempfile::tempdir().unwrap();
            let (path, scratch) = (dir.path().join("m.ply"), dir.path().join("s"));
            std::fs::create_dir(&scratch).unwrap();
            std::fs::write(&path, file).unwrap();
            let size = size_of_mesh(&path, &Cancel::default()).unwrap();
            let mesh = open(&path, &scratch, &Run::new(&())).unwrap();
            assert_eq!(mesh.faces.len(), faces.len());
            let written: u64 = scratch.read_dir().unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum();
            let heads = 128 * scratch.read_dir().unwrap().count() as u64;
            let what = format!("{encoding}, {scalar}, {corners}: {} planned, {written} written", size.decoded);
            // The rim of the grid has corners that an estimate from the counts cannot know.
            assert!(size.decoded + heads >= written && size.decoded <= written + written / 10, "{what}");
            if encoding != "ascii" {
                assert_eq!(size.corners, mesh.faces.corner_count() as u64, "{what}");
            }
        }
    }
}
