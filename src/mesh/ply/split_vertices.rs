//! Writes a labelled mesh whose parts share no vertex, for programs that read only vertex colours: boundaries stay
//! sharp there.
//!
//! A vertex stays with the part of its first face; each other part that meets there gets a copy of it at the end.
//! Positions at full precision, labels, colours and qualities; other properties of the input are dropped. Memory: 4
//! bytes per vertex, and 8 per corner on a boundary, from the budget.

use super::element::{Encoding, Scalar};
use super::header::HeaderWriter;
use super::labelling::{Labelling, PlyForm, VERTEX_PROPERTIES};
use super::names;
use super::plain::counting_corners;
use super::values::Encoder;
use crate::base::Result;
use crate::mesh::geometry::{Mesh, too_many_vertices};
use crate::mesh::output::Gather;
use crate::store::Run;
use crate::store::budget::Grant;
use std::io::Write;
use std::path::Path;

/// Records between two checks of the stop flag.
const CHUNK: usize = 1 << 14;
/// The label of a vertex without a face.
const NONE: u32 = u32::MAX;

/// The vertices of each part.
struct Split {
    /// The part that keeps each vertex (v).
    first: Vec<u32>,
    /// Copies: vertex and part, ascending.
    copies: Vec<(u32, u32)>,
    _grants: [Grant; 2],
}

impl Split {
    fn of(mesh: &Mesh, labels: &[u32], run: &Run) -> Result<Self> {
        let bytes = 4 * mesh.positions.len() as u64;
        let kept = run.budget.take("the vertices of parts", bytes, bytes)?;
        let mut first = vec![NONE; mesh.positions.len()];
        let each = |visit: &mut dyn FnMut(u32, u32)| -> Result<()> {
            for start in (0..labels.len()).step_by(CHUNK) {
                run.cancel.check()?;
                mesh.faces.for_each(start..labels.len().min(start + CHUNK), |face, corners| {
                    corners.iter().for_each(|&v| visit(v, labels[face]));
                });
            }
            Ok(())
        };
        let mut count = 0u64;
        each(&mut |v, label| match &mut first[v as usize] {
            own if *own == NONE => *own = label,
            own => count += u64::from(*own != label),
        })?;
        let copied = run.budget.take("the vertices of parts", 8 * count, 8 * count)?;
        let mut copies = Vec::with_capacity(count as usize);
        each(&mut |v, label| {
            if first[v as usize] != label {
                copies.push((v, label));
            }
        })?;
        copies.sort_unstable();
        copies.dedup();
        Ok(Self { first, copies, _grants: [kept, copied] })
    }

    /// The number of vertex `v` in the part `label`.
    fn number(&self, v: u32, label: u32) -> u32 {
        if self.first[v as usize] == label {
            return v;
        }
        let copy = self.copies.binary_search(&(v, label)).unwrap_or_default();
        (self.first.len() + copy) as u32
    }
}

/// Writes `mesh` to a stream, called `path` in messages.
///
/// # Errors
/// [`crate::base::Error::Memory`], [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub(super) fn stream(
    mesh: &Mesh,
    path: &Path,
    writer: &mut dyn Write,
    labelling: &Labelling,
    form: PlyForm,
    run: &Run,
) -> Result<()> {
    let split = Split::of(mesh, labelling.labels, run)?;
    let double = mesh.positions.is_double();
    let (count, real) = (counting_corners(&mesh.faces), Scalar::coordinate(double));
    let encoder =
        Encoder { target: form.encoding(mesh.document().map_or(Encoding::Little, |own| own.header.encoding)) };
    let mut header = HeaderWriter::new(encoder.target);
    header.remark("comment labelled by nystrom-stream, vertices split along boundaries");
    names::remarks(labelling.names).iter().for_each(|remark| _ = header.remark(remark));
    let vertices = split.first.len() as u64 + split.copies.len() as u64;
    if vertices > u32::MAX.into() {
        return Err(too_many_vertices(path));
    }
    let corner = Scalar::numbering(vertices);
    header.element("vertex", vertices).positions(double);
    VERTEX_PROPERTIES.iter().for_each(|&(name, scalar)| _ = header.property(name, scalar));
    header.element("face", mesh.faces.len() as u64).corners(count, corner);
    labelling.properties().iter().for_each(|&(name, scalar)| _ = header.property(name, scalar));
    let mut out = Gather::new(path, writer);
    out.pass(&header.finish())?;
    let kept = (0u32..).zip(split.first.iter().copied());
    for (record, (v, label)) in kept.chain(split.copies.iter().copied()).enumerate() {
        if record % CHUNK == 0 {
            run.cancel.check()?;
        }
        mesh.positions.get(v).into_iter().for_each(|x| encoder.real(real, x, &mut out.buffer));
        labelling.append_vertex((label != NONE).then_some(label), encoder, &mut out.buffer);
        encoder.end(&mut out.buffer);
        out.flush_if_full()?;
    }
    for start in (0..mesh.faces.len()).step_by(CHUNK) {
        run.cancel.check()?;
        mesh.faces.try_for_each(start..mesh.faces.len().min(start + CHUNK), |face, corners| {
            encoder.integer(count, corners.len() as i64, &mut out.buffer);
            let number = |&v: &u32| split.number(v, labelling.labels[face]);
            corners.iter().for_each(|v| encoder.integer(corner, number(v).into(), &mut out.buffer));
            labelling.append(face, encoder, &mut out.buffer);
            encoder.end(&mut out.buffer);
            out.flush_if_full()
        })?;
    }
    out.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_share_no_vertex_and_everything_stays_in_place() {
        // A fan of six triangles in three parts around a corner, and a vertex without a face.
        let ring = |k: u32| [f64::from(k % 3), f64::from(k / 3), 0.];
        let mut positions: Vec<[f64; 3]> = (0..7).map(ring).collect();
        positions.push([9., 9., 9.]);
        let faces: Vec<[u32; 3]> = (0..6).map(|k| [0, 1 + k, 1 + (k + 1) % 6]).collect();
        let mesh = Mesh::from_slices(&positions, &faces).unwrap();
        let labels = [0, 0, 1, 1, 2, 0];
        let colours = [[255, 0, 0], [0, 255, 0], [0, 0, 255]];
        let labelling =
            Labelling { labels: &labels, colours: &colours, quality: None, names: &["a b".into()], fine: None };
        let mut bytes = Vec::new();
        stream(&mesh, Path::new("x"), &mut bytes, &labelling, PlyForm::Binary, &Run::new(&())).unwrap();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.ply");
        std::fs::write(&path, &bytes).unwrap();
        let again = Mesh::open(&path).unwrap();
        assert_eq!(again.face_property("label", &Run::new(&())).unwrap(), labels);
        let mut part = vec![None; again.positions.len()];
        again.faces.for_each(0..6, |face, corners| {
            for (&new, &old) in corners.iter().zip(&faces[face]) {
                assert_eq!(again.positions.get(new), positions[old as usize]);
                assert_eq!(*part[new as usize].get_or_insert(labels[face]), labels[face], "one part per vertex");
            }
        });
        // The corner is in three parts, and three vertices of the ring in two.
        assert_eq!(again.positions.len(), 8 + 2 + 3);
        assert!(String::from_utf8_lossy(&bytes).contains("comment part 0: a b\n"));
    }
}
