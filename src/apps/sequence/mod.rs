//! Orders to stream a mesh in: so that a reader that goes over the file once holds few vertices at a time.
//!
//! Every order is a rank of the vertices; faces follow by the ranks of their corners, the greatest first ([`places`]),
//! so that a face comes as soon as all its vertices have; vertices are numbered as faces use them
//! ([`VertexUse`]). Spectral ranks come from coordinates made by the pipeline ([`ranks_along`]); principal axes, Hilbert's
//! curve, breadth-first search, reverse Cuthill–McKee and chance share all the rest. All of it is external sorts within
//! the budget, but for searches and sweeps, which go over mapped files. How well an order streams: [`Measures`].
//!
//! Faces by the ranks of their corners, not by a rank of their own: on a grid along its length this is the optimum, while
//! faces by centroids keep about one more row of vertices waiting.

pub mod exact;
mod fiedler;
mod first_use;
mod gradient;
mod measures;
mod positions;
mod sorting;
mod sweeps;
pub mod table;
mod traverse;

pub use first_use::VertexUse;
pub use gradient::gradient;
pub use measures::Measures;
pub use positions::{hilbert_ranks, pca_ranks, random_ranks};
pub use sweeps::sweep;

use crate::base::Result;
use crate::graph::VertexAdjacency;
use crate::mesh::Mesh;
use crate::store::{Context, MappedSlice};
use serde::{Deserialize, Serialize};
use sorting::{Push, Scatter, ordered, sorted};
use std::ops::Range;

/// What to order by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SequenceOrder {
    /// The second vector of the degree-normalised Nyström embedding.
    #[default]
    Spectral,
    /// The longest principal axis of the vertices.
    Pca,
    /// Breadth-first search from a vertex far out.
    Bfs,
    /// Reverse Cuthill–McKee.
    Rcm,
    /// Hilbert's curve.
    Hilbert,
    /// Chance.
    Random,
    /// The file's own order of faces.
    Keep,
}

impl SequenceOrder {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Spectral, Self::Pca, Self::Bfs, Self::Rcm, Self::Hilbert, Self::Random, Self::Keep];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Spectral => "spectral",
            Self::Pca => "pca",
            Self::Bfs => "bfs",
            Self::Rcm => "rcm",
            Self::Hilbert => "hilbert",
            Self::Random => "random",
            Self::Keep => "keep",
        }
    }
}

/// Breadth-first ranks of the vertices of `graph`, as the array `name` of `work`.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Memory`], [`crate::base::Error::Cancelled`].
pub fn bfs_ranks(name: &str, graph: &VertexAdjacency, context: Context<'_>) -> Result<MappedSlice<u32>> {
    traverse::ranks(name, graph, false, context)
}

/// Reverse Cuthill–McKee ranks.
///
/// # Errors
/// As [`bfs_ranks`].
pub fn rcm_ranks(name: &str, graph: &VertexAdjacency, context: Context<'_>) -> Result<MappedSlice<u32>> {
    traverse::ranks(name, graph, true, context)
}

/// Ranks of `n` vertices by component, then coordinate, ties by a second one, then by number.
///
/// # Errors
/// As [`bfs_ranks`].
pub fn ranks_along(
    name: &str,
    n: usize,
    key: impl Fn(usize) -> (u32, f64, f32) + Sync,
    context: Context<'_>,
) -> Result<MappedSlice<u32>> {
    let words = |v: usize| {
        let (component, first, second) = key(v);
        let ([high, low], [next, _]) = (ordered(first), ordered(f64::from(second)));
        [component, high, low, next]
    };
    sorting::ranks(name, n, words, context)
}

/// The place of each face of `mesh`, whose vertices have the ranks `rank`: by the greatest rank of its corners, then by
/// the second, then by the least, then by number. Faces without corners come last.
///
/// # Errors
/// As [`bfs_ranks`].
pub fn places(name: &str, mesh: &Mesh, rank: &[u32], context: Context<'_>) -> Result<MappedSlice<u32>> {
    let n = mesh.faces.len();
    let scatter = Scatter::new(name, n, context)?;
    let mut out = scatter.producer();
    let mut next = 0;
    let fill = |range: Range<usize>, push: Push<'_, 4>| {
        let mut result = Ok(());
        mesh.faces.for_each(range, |face, corners| {
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
            if result.is_ok() {
                result = push([first.unwrap_or(u32::MAX), second.unwrap_or(0), least, face as u32]);
            }
        });
        result
    };
    sorted("ordering faces", (n, n as u64), fill, context, |records| {
        context.run.progress.advance("sequence", records.len() as u64);
        records.iter().try_for_each(|record| {
            next += 1;
            scatter.put(&mut out, record[3], next - 1)
        })
    })?;
    out.finish()?;
    scatter.finish()
}
