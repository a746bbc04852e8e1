//! Symmetric eigenproblems of the size of the sample, in `f64`.
//!
//! The signs of the eigenvectors are normalised, so that results do not depend on the solver's path. O(n³) time; memory
//! for four n × n matrices.

use crate::base::sort::order_by;
use nalgebra::DMatrix;

/// Eigenvalues in descending order and eigenvectors as columns, each with its largest entry positive, so
/// that signs do not depend on the solver's path.
pub fn symmetric(matrix: DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let n = matrix.nrows();
    let symmetrised = DMatrix::from_fn(n, n, |i, j| 0.5 * (matrix[(i, j)] + matrix[(j, i)]));
    let eigen = nalgebra::SymmetricEigen::new(symmetrised);
    let order = order_by(n, |a, b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let values = order.iter().map(|&k| eigen.eigenvalues[k]).collect();
    let mut vectors = DMatrix::zeros(n, n);
    for (to, &from) in order.iter().enumerate() {
        let column = eigen.eigenvectors.column(from);
        let largest = column.iter().fold(0f64, |top, &x| if x.abs() > top.abs() + 1e-12 { x } else { top });
        let sign = if largest < 0. { -1. } else { 1. };
        for i in 0..n {
            vectors[(i, to)] = sign * column[i];
        }
    }
    (values, vectors)
}
