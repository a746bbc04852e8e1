//! Floor `cluster`.
