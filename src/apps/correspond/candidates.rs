//! First guesses of the change of coordinates between two embeddings: signs, order, and turns of near-equal axes.
//!
//! An eigenvector is known up to its sign, and two whose eigenvalues are nearly equal up to a turn in their plane,
//! so that on another mesh they come in another order or mixed. The guesses are all signs of all axes but the first,
//! times turns by 0°, ±45° and 90° of disjoint neighbouring pairs whose variances are within [`NEAR`] of each
//! other. Some 2^(k−1) to [`MOST_TURNS`] 2^(k−1) matrices.

use nalgebra::DMatrix;

/// Least ratio of the variances of axes that may be turned into each other.
pub const NEAR: f64 = 0.7;
/// Turns tried at the most; the likeliest pairs come first.
pub const MOST_TURNS: usize = 32;

/// Guesses for axes of these variances on either mesh (k each).
pub fn candidates(a: &[f64], b: &[f64]) -> Vec<DMatrix<f64>> {
    let k = a.len().min(b.len());
    let ratio = |v: &[f64], i: usize| if v[i] > 0. { v[i + 1] / v[i] } else { 0. };
    let mut pairs: Vec<(usize, f64)> = (1..k.saturating_sub(1))
        .map(|i| (i, ratio(a, i).max(ratio(b, i))))
        .filter(|(_, ratio)| *ratio > NEAR)
        .collect();
    pairs.sort_by(|x, y| y.1.total_cmp(&x.1).then(x.0.cmp(&y.0)));
    let mut turns = vec![(DMatrix::<f64>::identity(k, k), vec![false; k])];
    for (i, _) in pairs {
        let known = turns.len();
        for t in 0..known {
            if turns[t].1[i] || turns[t].1[i + 1] || turns.len() + 3 > MOST_TURNS {
                continue;
            }
            for degrees in [90f64, 45., -45.] {
                let (sin, cos) = degrees.to_radians().sin_cos();
                let mut turn = DMatrix::identity(k, k);
                turn[(i, i)] = cos;
                turn[(i + 1, i + 1)] = cos;
                turn[(i, i + 1)] = -sin;
                turn[(i + 1, i)] = sin;
                let mut used = turns[t].1.clone();
                (used[i], used[i + 1]) = (true, true);
                turns.push((turn * &turns[t].0, used));
            }
        }
    }
    let mut all = Vec::with_capacity(turns.len() << k.saturating_sub(1));
    for (turn, _) in turns {
        for signs in 0..1usize << k.saturating_sub(1) {
            let mut guess = turn.clone();
            for i in (1..k).filter(|i| signs >> (i - 1) & 1 == 1) {
                guess.column_mut(i).neg_mut();
            }
            all.push(guess);
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn guesses_are_orthogonal_and_cover_signs_swaps_and_turns() {
        let apart = candidates(&[9., 4., 2., 1.], &[9., 4., 2., 1.]);
        assert_eq!(apart.len(), 8);
        let near = candidates(&[9., 4., 3.9, 1.], &[9., 4., 2., 1.]);
        assert_eq!(near.len(), 32);
        for guess in apart.iter().chain(&near) {
            assert!((guess * guess.transpose() - DMatrix::identity(4, 4)).norm() < 1e-12);
            assert_eq!(guess[(0, 0)], 1.);
        }
        let swap = DMatrix::from_row_slice(4, 4, &[1., 0., 0., 0., 0., 0., 1., 0., 0., 1., 0., 0., 0., 0., 0., 1.]);
        assert!(near.iter().any(|guess| (guess - &swap).norm() < 1e-12));
        assert!(candidates(&[1.; 8], &[1.; 8]).len() <= MOST_TURNS << 7);
    }
}
