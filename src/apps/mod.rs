//! Floor `apps`.
pub mod creature;
