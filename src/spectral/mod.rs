//! Floor `spectral`.
