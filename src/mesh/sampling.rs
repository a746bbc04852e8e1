//! Samples of a mesh: a few scattered faces and their vertices.
//!
//! By default the kernel reads megabytes around a page that is missed, so a sample of a few thousand faces reads all of
//! the file. That is welcome if the mesh stays in memory afterwards. If it is larger than that, samples are taken
//! without reading ahead, and their pages are requested before the first of them is used: the disk then serves them
//! together. Cost: one system call per face or vertex that is requested.

use super::faces::Faces;
use super::geometry::Mesh;
use super::positions::{Positions, StridedLayout};
use crate::store::Run;
use crate::store::mapped::{Access, advise, will_need};
use std::ops::Range;

impl Mesh {
    /// Runs `sample`, which reads a few scattered faces and vertices, and is told whether to request them beforehand.
    pub(crate) fn sampled<R>(&self, run: &Run, sample: impl FnOnce(bool) -> R) -> R {
        if self.positions.mapped_bytes() + self.faces.mapped_bytes() <= run.resident {
            return sample(false);
        }
        let advise = |access| {
            self.positions.advise(access);
            self.faces.advise(access);
        };
        advise(Access::Random);
        let result = sample(true);
        advise(Access::Local);
        result
    }
}

impl Faces {
    fn mapped_bytes(&self) -> u64 {
        match self {
            Self::Triangles { stride, len, .. } => *stride as u64 * *len as u64,
            Self::Polygons { starts, corners } => size_of_val(&starts[..]) as u64 + size_of_val(&corners[..]) as u64,
        }
    }

    /// Advises the kernel how the faces will be read.
    pub(crate) fn advise(&self, access: Access) {
        match self {
            Self::Triangles { bytes, offset, stride, len } => {
                let end = bytes.len().min(offset + len * stride);
                advise(&bytes[*offset..end], access);
            }
            Self::Polygons { starts, corners } => {
                advise(starts, access);
                advise(corners, access);
            }
        }
    }

    /// Asks the kernel to read the faces `range` soon; for polygons, only where their corners begin.
    pub(crate) fn will_need(&self, range: Range<usize>) {
        match self {
            Self::Triangles { bytes, offset, stride, .. } if !range.is_empty() => {
                will_need(&bytes[offset + range.start * stride..offset + (range.end - 1) * stride + 12]);
            }
            Self::Triangles { .. } => (),
            Self::Polygons { starts, .. } => will_need(&starts[range.start..=range.end]),
        }
    }
}

impl Positions {
    fn mapped_bytes(&self) -> u64 {
        self.layout().stride as u64 * self.len() as u64
    }

    fn advise(&self, access: Access) {
        let StridedLayout { offset, stride, len, .. } = self.layout();
        advise(&self.bytes()[offset..offset + len * stride], access);
    }

    /// Asks the kernel to read the position of vertex `v` soon.
    pub(crate) fn will_need(&self, v: u32) {
        let StridedLayout { offset, stride, .. } = self.layout();
        let start = offset + v as usize * stride;
        if let Some(record) = self.bytes().get(start..start + stride) {
            will_need(record);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same results, with every page requested and with none.
    #[test]
    fn samples_do_not_depend_on_what_stays_in_memory() {
        let points: Vec<[f32; 3]> = (0..900).map(|i| [(i % 30) as f32, (i / 30) as f32, 0.]).collect();
        let corner = |i: u32| [[i, i + 1, i + 31], [i, i + 31, i + 30]];
        let triangles: Vec<[u32; 3]> = (0..870).filter(|i| i % 30 < 29).flat_map(corner).collect();
        let polygons: Vec<Vec<u32>> = triangles.iter().map(|face| face[..].repeat(2)[..4].to_vec()).collect();
        let meshes = [Mesh::from_slices(&points, &triangles), Mesh::from_slices(&points, &polygons)];
        for mesh in meshes.map(Result::unwrap) {
            let taken = |resident| {
                let run = Run { resident, ..Run::new(&()) };
                mesh.sampled(&run, |request| {
                    let faces = (0..mesh.faces.len()).step_by(97);
                    if request {
                        faces.clone().for_each(|face| mesh.faces.will_need(face..face + 1));
                        mesh.faces.will_need(5..5);
                        (0..901).for_each(|v| mesh.positions.will_need(v));
                    }
                    let of_face = |face| mesh.faces.with(face, |corners| mesh.positions.get(corners[0]));
                    (request, faces.map(of_face).collect::<Vec<_>>())
                })
            };
            let [(paged, few), (held, all)] = [0, u64::MAX].map(taken);
            assert!(paged && !held && few == all);
        }
    }
}
