//! Boundary edges at exactly the same position are one edge.
//!
//! Exporters duplicate vertices along texture seams, and STL-like soups give every face vertices of
//! its own; by index alone such meshes fall to pieces. Only half-edges that found no partner
//! by index are looked at, so a mesh that is whole costs nothing, and an edge that is matched is
//! never changed. Positions are compared as numbers (−0 equals 0), by a 95-bit hash of both
//! ends: at 3·10⁹ open half-edges a false match has a chance below 1e-9.
//!
//! Memory and disk: 16 B an open half-edge, in memory where the budget allows.

use super::adjacency::{Counters, Side, chain};
use super::half_edge_pairs::{Adding, HalfEdgePairs};
use crate::base::Result;
use crate::base::parallel::each_chunk;
use crate::mesh::Mesh;
use crate::store::Context;
use crate::store::shuffle::BudgetedShuffle;
use crate::store::shuffle::{Producer, Shuffle};
use bytemuck::{Pod, Zeroable};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use xxhash_rust::xxh3::xxh3_128;

/// An open half-edge under the hash of its two end positions; the hash's last bit is its direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
struct Place {
    hash: [u32; 3],
    corner: u32,
}

impl Place {
    fn edge(&self) -> [u32; 3] {
        [self.hash[0], self.hash[1], self.hash[2] | 1]
    }

    fn side(&self) -> Side {
        Side { corner: self.corner, ascending: self.hash[2] & 1 != 0 }
    }
}

/// Links the half-edges of `boundary` (corner numbers) that coincide; returns how many found a
/// partner.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
pub(super) fn weld(
    mesh: &Mesh,
    boundary: &Shuffle<u32>,
    links: &HalfEdgePairs,
    counters: &Counters,
    context: Context<'_>,
) -> Result<u64> {
    let copies = 2 * context.run.threads as u64;
    let sized = BudgetedShuffle::<Place>::new(
        &context.work.file("places.tmp"),
        "welding",
        boundary.len(),
        copies,
        2,
        context.run,
    )?;
    let (places, buckets) = (&sized.shuffle, sized.shuffle.buckets());
    each_chunk(
        context.run.threads,
        &context.run.cancel,
        boundary.buckets(),
        || places.producer(),
        |bucket, out| {
            boundary.take(bucket)?.into_iter().try_for_each(|corner| match place(mesh, corner) {
                Some(place) => out.push(((u64::from(place.hash[0]) * buckets as u64) >> 32) as usize, place),
                None => Ok(()),
            })
        },
        Producer::finish,
    )?;
    let welded = AtomicU64::new(0);
    each_chunk(
        context.run.threads,
        &context.run.cancel,
        buckets,
        || links.adding(),
        |bucket, out| {
            let mut sorted = places.take(bucket)?;
            sorted.sort_unstable_by_key(|place| (place.edge(), place.corner));
            for same in sorted.chunk_by(|a, b| a.edge() == b.edge()) {
                if same.len() > 1 {
                    welded.fetch_add(same.len() as u64, Relaxed);
                    chain(mesh, same.iter().map(Place::side), out, counters)?;
                }
            }
            Ok(())
        },
        Adding::finish,
    )?;
    Ok(welded.into_inner())
}

/// The hash of a half-edge's ends, in either direction; `None` where a coordinate is no number
/// or both ends coincide.
fn place(mesh: &Mesh, corner: u32) -> Option<Place> {
    let face = mesh.faces.face_of_corner(corner as usize);
    let slot = corner as usize - mesh.faces.corner_range(face).start;
    let (a, b) = mesh.faces.with(face, |corners| (corners[slot], corners[(slot + 1) % corners.len()]));
    // Adding zero turns −0 into 0.
    let ends = [mesh.positions.get(a), mesh.positions.get(b)].map(|p| p.map(|x| x + 0.));
    if ends.iter().flatten().any(|x| !x.is_finite()) || ends[0] == ends[1] {
        return None;
    }
    let mut bits = ends.map(|p| p.map(f64::to_bits));
    let ascending = u32::from(bits[0] < bits[1]);
    bits.sort_unstable();
    let hash = xxh3_128(bytemuck::bytes_of(&bits));
    Some(Place { hash: [hash as u32, (hash >> 32) as u32, (hash >> 64) as u32 & !1 | ascending], corner })
}
