//! The size of the mesh in a file, without reading all of it: the basis for planning memory and time.
//!
//! The header of a PLY has the counts, and the file size shows whether they are possible. Cost: microseconds for a PLY,
//! compressed or not; one pass over the text of an OBJ or OFF.

use super::geometry::{Mesh, empty, no_faces};
use super::import;
use super::ply::{Encoding, Kind, header};
use crate::base::{Error, Result};
use crate::store::MappedBytes;
use flate2::bufread::MultiGzDecoder;
use serde::Serialize;
use std::io::Read;
use std::path::Path;

/// The size of a mesh, and how its file has to be read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MeshSize {
    /// Faces n.
    pub faces: u64,
    /// Vertices.
    pub vertices: u64,
    /// Corners of all faces; three per face if the header does not say.
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
pub fn size_of_mesh(path: &Path) -> Result<MeshSize> {
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
        if let Some(counts) = import::count(path, &bytes)? {
            if counts.faces == 0 {
                return Err(no_faces(path));
            }
            let import::Counts { vertices, faces, corners, .. } = counts;
            return Ok(MeshSize { faces, vertices, corners, decoded: counts.bytes(), strips: false });
        }
    }
    let header = header::parse(path, if compressed { &head } else { &bytes })?;
    let count =
        |name: &str| header.elements.iter().find(|element| element.is(name)).map(|element| element.count as u64);
    let Some(vertices) = count("vertex") else {
        return Err(Error::malformed(path, "header", "there is no vertex element", "export the mesh again"));
    };
    // An empty face element may precede one of strips.
    let some = |name: &str| count(name).filter(|&faces| faces > 0);
    let listed = some("face");
    let in_strips = || some("tristrips").map(|strips| strips.max(faces_of_strips(&header, bytes.len() as u64)));
    let Some(faces) = listed.or_else(in_strips) else { return Err(no_faces(path)) };
    if !compressed {
        header.check_counts(path, bytes.len())?;
    }
    let corners = faces.saturating_mul(3);
    let in_place = header.encoding == Encoding::Little
        && header.elements.iter().filter(|element| element.is("face")).all(|element| {
            let lists = element.properties.iter().filter_map(|property| match property.kind {
                Kind::List { item, .. } => Some(item.size()),
                Kind::One(_) => None,
            });
            lists.eq([4])
        });
    let least: u128 = header.elements.iter().map(|element| element.least_bytes(header.encoding)).sum();
    let plain = u64::try_from(least).unwrap_or(u64::MAX / 4);
    let spooled = if compressed { plain + 4 * corners } else { 0 };
    let decoded = if in_place { 0 } else { 12 * vertices + 4 * corners };
    Ok(MeshSize { faces, vertices, corners, decoded: spooled + decoded, strips: listed.is_none() })
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
            let size = size_of_mesh(&path).unwrap();
            assert_eq!((size.faces, size.vertices), (2, 4), "{name}");
        }
        let path = dir.path().join("c.ply");
        std::fs::write(&path, header("").replace("face 2", "face 2000") + body).unwrap();
        assert!(size_of_mesh(&path).unwrap_err().to_string().contains("2000 records need at least"));
    }
}
