//! Distances over the graph: fronts and rows.
//!
//! [`front`] is the engine; a [`sampler`] picks sample faces while [`rows`] runs one full front a landmark on the other threads and writes `[A B]`'s distances, or hands each to somebody who
//! looks at it ([`slots`]).

mod begun;
mod carry;
mod compute;
pub mod front;
pub mod journal;
pub mod march;
pub mod oracle;
pub mod paging;
pub mod queue;
mod rounds;
pub mod rows;
pub mod sampler;
pub mod shard;
pub mod slots;
mod steps;
pub mod vertex_rows;
pub mod voronoi;

pub use front::Front;
pub use march::March;
pub use rows::{DistanceRows, RowFacts};
