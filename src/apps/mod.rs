//! Floor `apps`.

pub mod evaluate;
