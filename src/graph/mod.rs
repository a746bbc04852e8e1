//! Floor `graph`.
