//! A square matrix of numbers, row-major, and second moments in space with the eigenvalues of their 3 × 3 matrix.
//!
//! Own code because rows are read as slices and folded into each other in a fixed order; n² numbers of 8 bytes.

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

    /// From n² values, row-major; what is missing is zero.
    pub fn from_values(n: usize, mut values: Vec<f64>) -> Square {
        values.resize(n * n, 0.0);
        Square { n, values }
    }

    /// All values, row-major (n²).
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Rows (and columns).
    pub fn len(&self) -> usize {
        self.n
    }

    /// Whether it has no rows.
    pub fn is_empty(&self) -> bool {
        self.n == 0
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

/// The products xx, yy, zz, xy, xz and yz of a point: the order of all second moments here.
pub fn products(x: [f64; 3]) -> [f64; 6] {
    [x[0] * x[0], x[1] * x[1], x[2] * x[2], x[0] * x[1], x[0] * x[2], x[1] * x[2]]
}

/// Eigenvalues of a symmetric 3 × 3 matrix given as (xx, yy, zz, xy, xz, yz), greatest first.
/// Jacobi rotations: exact to rounding however close the values lie.
pub fn eigenvalues3(m: [f64; 6]) -> [f64; 3] {
    let mut a = [[m[0], m[3], m[4]], [m[3], m[1], m[5]], [m[4], m[5], m[2]]];
    for _ in 0..32 {
        let off = a[0][1].abs() + a[0][2].abs() + a[1][2].abs();
        let on = a[0][0].abs() + a[1][1].abs() + a[2][2].abs();
        if off <= 1e-18 * on || off == 0.0 {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            let t = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let t = t.signum() / (t.abs() + (t * t + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let (s, r) = (t * c, 3 - p - q);
            a[p][p] -= t * a[p][q];
            a[q][q] += t * a[p][q];
            (a[p][q], a[q][p]) = (0.0, 0.0);
            let (x, y) = (a[r][p], a[r][q]);
            (a[r][p], a[r][q]) = (c * x - s * y, s * x + c * y);
            (a[p][r], a[q][r]) = (a[r][p], a[r][q]);
        }
    }
    let mut e = [a[0][0], a[1][1], a[2][2]];
    e.sort_by(f64::total_cmp);
    e.reverse();
    e
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvalues_of_a_known_matrix() {
        // 2, 3 and 6 turned by the orthogonal (1,1,1)/√3, (1,−1,0)/√2, (1,1,−2)/√6.
        let axes = [[1.0, 1.0, 1.0], [1.0, -1.0, 0.0], [1.0, 1.0, -2.0]];
        let mut m = [0.0; 6];
        for (value, v) in [6.0, 3.0, 2.0].iter().zip(axes) {
            let square: f64 = v.iter().map(|x| x * x).sum();
            for (slot, (i, j)) in m.iter_mut().zip([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]) {
                *slot += value * v[i] * v[j] / square;
            }
        }
        for (e, expected) in eigenvalues3(m).iter().zip([6.0, 3.0, 2.0]) {
            assert!((e - expected).abs() < 1e-14);
        }
        assert_eq!(eigenvalues3([0.0; 6]), [0.0; 3]);
    }

    #[test]
    fn products_are_those_of_each_pair() {
        assert_eq!(products([2.0, 3.0, 5.0]), [4.0, 9.0, 25.0, 6.0, 10.0, 15.0]);
    }

    #[test]
    fn folding_keeps_the_sum() {
        let mut m = Square::from_values(3, (0..9).map(f64::from).collect());
        m.fold(0, 2);
        assert_eq!(m[(0, 0)], 0.0 + 2.0 + 6.0 + 8.0);
        assert_eq!(m[(0, 1)], 1.0 + 7.0);
    }
}
