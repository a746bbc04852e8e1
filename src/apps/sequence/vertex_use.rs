//! From positions of faces to numbers of vertices: each vertex is numbered when a face first uses it.
//!
//! Two external sorts: uses by vertex, of which the first and last matter, then vertices by first use. Unused vertices
//! come last, in file order. 12 bytes per corner and per vertex through the sorts, 12 per vertex kept temporarily.

use super::sorting::{Push, check_items, places_by_record, sorted};
use crate::base::Result;
use crate::mesh::Mesh;
use crate::store::npy::ArrayWriter;
use crate::store::{Context, MappedSlice, WorkDir};
use std::ops::Range;

/// When vertices are used, and their resulting numbers. All indexed by the numbers in the mesh's file.
#[derive(Clone, Debug)]
pub struct VertexUse {
    /// Position of the first face that uses a vertex (v); `u32::MAX` if none does.
    pub first: MappedSlice<u32>,
    /// Position of the last one (v).
    pub last: MappedSlice<u32>,
    /// New number of each vertex (v).
    pub rank: MappedSlice<u32>,
}

/// The temporary files behind a [`VertexUse`].
const FILES: [&str; 4] = ["first_use.tmp", "first_slot.tmp", "last_use.tmp", "vertex_number.tmp"];

impl VertexUse {
    /// Uses of the vertices of `mesh`, whose face f has the position `place[f]`.
    ///
    /// # Errors
    /// [`crate::base::Error::Parameter`] unless there is a position for every face; [`crate::base::Error::Io`],
    /// [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
    pub fn of(mesh: &Mesh, place: &[u32], context: Context<'_>) -> Result<Self> {
        check_items("place", place.len(), mesh.faces.len())?;
        let n = mesh.positions.len();
        let (first, slot, last) = uses(mesh, place, context)?;
        let fill = |range: Range<usize>, push: Push<'_, 3>| {
            range.into_iter().try_for_each(|v| push([first[v], slot[v], v as u32]))
        };
        let rank = places_by_record(FILES[3], "numbering vertices", n, fill, |_| (), context)?;
        drop(slot);
        context.work.remove(FILES[1]);
        Ok(Self { first, last, rank })
    }

    /// Removes its files.
    pub fn remove(work: &WorkDir) {
        FILES.iter().for_each(|name| work.remove(name));
    }
}

/// A vertex use being collected: vertex, first position and slot, last position.
struct Gathered {
    writers: [ArrayWriter<u32>; 3],
    current: Option<[u32; 4]>,
    done: usize,
}

impl Gathered {
    /// Writes the collected vertex, and the unused ones before `next`.
    fn close(&mut self, next: usize) -> Result<()> {
        if let Some([v, first, slot, last]) = self.current.take() {
            self.unused(v as usize)?;
            self.push([first, slot, last])?;
        }
        self.unused(next)
    }

    fn unused(&mut self, next: usize) -> Result<()> {
        while self.done < next {
            self.push([u32::MAX; 3])?;
        }
        Ok(())
    }

    fn push(&mut self, values: [u32; 3]) -> Result<()> {
        self.done += 1;
        self.writers.iter_mut().zip(values).try_for_each(|(writer, value)| writer.push(&[value]))
    }
}

type Three = (MappedSlice<u32>, MappedSlice<u32>, MappedSlice<u32>);

/// First positions, the slots there, and last positions, by vertex.
fn uses(mesh: &Mesh, place: &[u32], context: Context<'_>) -> Result<Three> {
    let writers =
        [context.work.writer(FILES[0], 1)?, context.work.writer(FILES[1], 1)?, context.work.writer(FILES[2], 1)?];
    let mut gathered = Gathered { writers, current: None, done: 0 };
    let fill = |range: Range<usize>, push: Push<'_, 3>| {
        mesh.faces.try_for_each(range, |face, corners| {
            (0..).zip(corners).try_for_each(|(slot, &v)| push([v, place[face], slot]))
        })
    };
    let counts = (mesh.faces.len(), mesh.faces.corner_count() as u64);
    // A vertex's uses may be in two buckets, so this state spans buckets.
    sorted("uses of vertices", counts, fill, context, |records| {
        for &[v, place, slot] in records {
            match &mut gathered.current {
                Some(current) if current[0] == v => current[3] = place,
                _ => {
                    gathered.close(0)?;
                    gathered.current = Some([v, place, slot, place]);
                }
            }
        }
        Ok(())
    })?;
    gathered.close(mesh.positions.len())?;
    let [first, slot, last] = gathered.writers;
    Ok((first.finish(false)?, slot.finish(false)?, last.finish(false)?))
}
