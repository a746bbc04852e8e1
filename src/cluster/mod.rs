//! Floor `cluster`.

pub mod parts;
