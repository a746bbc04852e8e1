//! Floor `distance`.
