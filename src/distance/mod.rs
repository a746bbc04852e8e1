//! Distances over the graph: fronts and rows.
//!
//! A [`front`] is a wave of shortest distances from one or more sources over the whole graph; a *row* is the distances
//! from one landmark to every node, a row of `[A B]`. A [`sampler`] picks landmarks while [`rows`] runs one full front
//! per landmark on the other threads and writes its distances, or passes each row to a visitor ([`row_sink`]). Fronts
//! from many sources label nodes with the nearest one ([`voronoi`]); a [`march`] crosses triangles instead of following
//! edges.

mod block_cache;
mod block_front;
mod cached_front;
pub mod front;
pub mod journal;
pub mod local_rows;
pub mod march;
pub mod paging;
pub mod queue;
mod row_job;
pub mod row_sink;
pub mod rows;
pub mod sampler;
pub mod shard;
pub mod shared_front;
mod steps;
mod ties;
pub mod vertex_rows;
pub mod voronoi;

pub use front::Front;
pub use journal::RowFacts;
pub use march::March;
pub use row_sink::VisitedRow;
pub use rows::{DistanceRows, RowParams};
pub use shared_front::SharedFront;
