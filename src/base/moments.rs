//! Second moments in space, each stored as (xx, yy, zz, xy, xz, yz), and the eigenvalues and axes of their 3 × 3
//! matrix.

use super::eigen;
use nalgebra::DMatrix;

/// The products xx, yy, zz, xy, xz and yz of a point: the order of all second moments here.
pub fn products(x: [f64; 3]) -> [f64; 6] {
    [x[0] * x[0], x[1] * x[1], x[2] * x[2], x[0] * x[1], x[0] * x[2], x[1] * x[2]]
}

/// The second moments about the mean, of points with the given `mean` and means of their products, `second`.
pub fn about_mean(mean: [f64; 3], second: [f64; 6]) -> [f64; 6] {
    let of_mean = products(mean);
    std::array::from_fn(|k| second[k] - of_mean[k])
}

/// Eigenvalues of the symmetric 3 × 3 matrix of moments, greatest first. Uses Jacobi rotations, which are accurate to
/// rounding however close the eigenvalues are.
pub fn eigenvalues(m: [f64; 6]) -> [f64; 3] {
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

/// Eigenvalues, the greatest first, and unit eigenvectors of the symmetric 3 × 3 matrix of finite moments.
pub fn principal_axes([xx, yy, zz, xy, xz, yz]: [f64; 6]) -> ([f64; 3], [[f64; 3]; 3]) {
    let (values, vectors) = eigen::symmetric(DMatrix::from_row_slice(3, 3, &[xx, xy, xz, xy, yy, yz, xz, yz, zz]));
    let axes = [0, 1, 2].map(|k| [vectors[(0, k)], vectors[(1, k)], vectors[(2, k)]]);
    ([values[0], values[1], values[2]], axes)
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
        for (e, expected) in eigenvalues(m).iter().zip([6.0, 3.0, 2.0]) {
            assert!((e - expected).abs() < 1e-14);
        }
        assert_eq!(eigenvalues([0.0; 6]), [0.0; 3]);
    }

    #[test]
    fn products_are_those_of_each_pair() {
        assert_eq!(products([2.0, 3.0, 5.0]), [4.0, 9.0, 25.0, 6.0, 10.0, 15.0]);
    }
}
