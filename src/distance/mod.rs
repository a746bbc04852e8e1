//! Distances over the graph: fronts, landmarks, rows.
//!
//! [`front`] is the engine; [`landmarks`] picks sample faces by one of several [`sampling`]s while
//! [`rows`] runs one full front a landmark on the other threads and writes `[A B]`'s distances, or hands each to somebody who
//! looks at it ([`slots`]).

mod begun;
mod carry;
mod compute;
pub mod exp;
pub mod front;
pub mod journal;
pub mod kernel;
pub mod landmarks;
pub mod march;
pub mod oracle;
pub mod paging;
pub mod queue;
mod rounds;
pub mod rows;
pub mod sampling;
pub mod shard;
pub mod slots;
mod steps;
pub mod vertex_rows;
pub mod voronoi;

pub use front::Front;
pub use march::March;
pub use rows::{DistanceRows, RowFacts};
