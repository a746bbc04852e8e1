//! A square matrix of numbers, row-major.
//!
//! This is our own code because rows are read as slices and added to each other in a fixed order. Memory: n² numbers of
//! 8 bytes.

use std::ops::{Index, IndexMut};

/// An n × n matrix.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Square {
    n: usize,
    values: Vec<f64>,
}

impl Square {
    /// All zeros.
    pub fn zeros(n: usize) -> Square {
        Square { n, values: vec![0.0; n * n] }
    }

    /// From n² values, row-major; missing ones are zero.
    pub fn from_values(n: usize, mut values: Vec<f64>) -> Square {
        values.resize(n * n, 0.0);
        Square { n, values }
    }

    /// All values, row-major (n²).
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The same, to change.
    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// Rows (and columns).
    pub fn len(&self) -> usize {
        self.n
    }

    /// Row `i`.
    pub fn row(&self, i: usize) -> &[f64] {
        &self.values[i * self.n..(i + 1) * self.n]
    }

    /// Row `i`, to change.
    pub fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.values[i * self.n..(i + 1) * self.n]
    }

    /// Adds `x` at (i, j) and, off the diagonal, at (j, i).
    pub fn add_both(&mut self, i: usize, j: usize, x: f64) {
        self[(i, j)] += x;
        if i != j {
            self[(j, i)] += x;
        }
    }

    /// Adds row and column `j` to row and column `i` (so (i, i) gains (i, j), (j, i) and (j, j)).
    pub fn fold(&mut self, i: usize, j: usize) {
        for k in 0..self.n {
            let x = self[(j, k)];
            self[(i, k)] += x;
        }
        for k in 0..self.n {
            let x = self[(k, j)];
            self[(k, i)] += x;
        }
    }
}

impl Index<(usize, usize)> for Square {
    type Output = f64;
    fn index(&self, (i, j): (usize, usize)) -> &f64 {
        &self.values[i * self.n + j]
    }
}

impl IndexMut<(usize, usize)> for Square {
    fn index_mut(&mut self, (i, j): (usize, usize)) -> &mut f64 {
        &mut self.values[i * self.n + j]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folding_keeps_the_sum() {
        let mut m = Square::from_values(3, (0..9).map(f64::from).collect());
        m.fold(0, 2);
        assert_eq!(m[(0, 0)], 0.0 + 2.0 + 6.0 + 8.0);
        assert_eq!(m[(0, 1)], 1.0 + 7.0);
    }
}
