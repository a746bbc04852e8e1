//! Orders for streaming a mesh, such that a reader that reads the file once holds few vertices at a time.
//!
//! Every order is a rank of the vertices; faces are ordered by the ranks of their corners, the greatest first
//! ([`places`]), so that a face comes as soon as all its vertices have; vertices are numbered in the order in which
//! faces use them ([`VertexUse`]). Spectral ranks come from coordinates computed by the pipeline ([`ranks_along`]);
//! principal axes, Hilbert's curve, breadth-first search, reverse Cuthill–McKee and random order share the rest.
//! Everything is external sorts within the budget, except searches and sweeps, which use mapped files. How well an
//! order streams: [`StreamMeasures`].
//!
//! Faces are ordered by the ranks of their corners, not by a rank of their own: on a grid along its length this is
//! optimal, while ordering faces by centroids keeps about one more row of vertices waiting.

pub mod fiedler;
mod ranks;
mod sorting;
mod stream_measures;
mod vertex_use;

use crate::base::Result;
use crate::mesh::Mesh;
use crate::store::{Context, MappedSlice, WorkDir};
pub use fiedler::sweep;
pub use ranks::{bfs_ranks, hilbert_ranks, pca_ranks, random_ranks, ranks_along, rcm_ranks};
use serde::{Deserialize, Serialize};
use sorting::{Push, check_items, places_by_record};
use std::fmt;
use std::ops::Range;
pub use stream_measures::{ComparedOrder, StreamMeasures, table};
pub use vertex_use::VertexUse;

/// The criterion of an order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SequenceOrder {
    /// The second vector of the degree-normalised Nyström embedding.
    #[default]
    Spectral,
    /// The longest principal axis of the vertices.
    Pca,
    /// Breadth-first search from a peripheral vertex.
    Bfs,
    /// Reverse Cuthill–McKee.
    Rcm,
    /// Hilbert's curve.
    Hilbert,
    /// A random order.
    Random,
    /// The file's own order of faces.
    Keep,
}

impl SequenceOrder {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Spectral, Self::Pca, Self::Bfs, Self::Rcm, Self::Hilbert, Self::Random, Self::Keep];
}

/// Its name in files, options and reports.
impl fmt::Display for SequenceOrder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// The position of each face of `mesh`, whose vertices have the ranks `rank`: by the greatest rank of its corners, then
/// by the second, then by the least, then by number. Faces without corners come last.
///
/// # Errors
/// As [`bfs_ranks`]; [`crate::base::Error::Parameter`] unless there is a rank for every vertex.
pub fn places(name: &str, mesh: &Mesh, rank: &[u32], context: Context<'_>) -> Result<MappedSlice<u32>> {
    check_items("rank", rank.len(), mesh.positions.len())?;
    let fill = |range: Range<usize>, push: Push<'_, 4>| {
        mesh.faces.try_for_each(range, |face, corners| {
            let (mut first, mut second, mut least) = (None, None, u32::MAX);
            for &v in corners {
                let rank = rank[v as usize];
                least = least.min(rank);
                if first < Some(rank) {
                    (first, second) = (Some(rank), first);
                } else if second < Some(rank) {
                    second = Some(rank);
                }
            }
            push([first.unwrap_or(u32::MAX), second.unwrap_or(0), least, face as u32])
        })
    };
    let advance = |done| context.run.progress.advance("sequence", done);
    places_by_record(name, "ordering faces", mesh.faces.len(), fill, advance, context)
}

/// Number of colour steps; alternate bands are darker, so that the shape of the front is visible.
const STEPS: usize = 240;
/// Steps per band.
const BAND: usize = 12;
/// Colours of the gradient, evenly spaced.
const STOPS: [[f64; 3]; 5] =
    [[38., 60., 140.], [40., 120., 170.], [60., 170., 130.], [150., 200., 80.], [250., 225., 70.]];

/// Labels of faces by their position in steps, as a temporary array of `work`, and the steps' colours.
///
/// # Errors
/// [`crate::base::Error::Io`].
pub fn gradient(places: &[u32], work: &WorkDir) -> Result<(MappedSlice<u32>, Vec<[u8; 3]>)> {
    let n = places.len().max(1) as u64;
    let mut array = work.array::<u32>("gradient.tmp", &[places.len()])?;
    let step = |place: u32| (u64::from(place) * STEPS as u64 / n).min(STEPS as u64 - 1) as u32;
    array.data().iter_mut().zip(places).for_each(|(label, &place)| *label = step(place));
    let colour = |k: usize| {
        let at = k as f64 / (STEPS - 1) as f64 * (STOPS.len() - 1) as f64;
        let (low, part) = ((at as usize).min(STOPS.len() - 2), at - (at as usize).min(STOPS.len() - 2) as f64);
        let shade = if k / BAND % 2 == 1 { 0.8 } else { 1. };
        [0, 1, 2].map(|c| (shade * ((1. - part) * STOPS[low][c] + part * STOPS[low + 1][c])) as u8)
    };
    Ok((array.finish(false)?, (0..STEPS).map(colour).collect()))
}
