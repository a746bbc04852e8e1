//! Floor `apps`.
