//! Weighted logistic regression by Newton's method, with a ridge on standardised features.

use nalgebra::{DMatrix, DVector};

/// Rounds of Newton's method at most; some eight suffice.
const ROUNDS: usize = 50;
/// Steps below this are the end.
const SMALL: f64 = 1e-10;

/// A case: what is known, what it should lead to (0 to 1), and how much it counts.
pub struct Case {
    pub features: Vec<f64>,
    pub target: f64,
    pub weight: f64,
}

/// Constant term and weights of the features that minimise the mean loss (the weighted cross-entropy in nats) plus
/// `ridge` / 2 times the sum of the squared weights of the features divided by their deviations.
pub fn fit(cases: &[Case], ridge: f64) -> Vec<f64> {
    let width = cases.first().map_or(0, |case| case.features.len());
    let total: f64 = cases.iter().map(|case| case.weight).sum();
    let mean = |of: &dyn Fn(&Case) -> f64| cases.iter().map(|case| case.weight * of(case)).sum::<f64>() / total;
    let centre: Vec<f64> = (0..width).map(|k| mean(&|case| case.features[k])).collect();
    let deviation = |k: usize| mean(&|case| (case.features[k] - centre[k]).powi(2)).sqrt().max(1e-12);
    let deviation: Vec<f64> = (0..width).map(deviation).collect();
    let standard =
        |case: &Case, k: usize| if k == 0 { 1. } else { (case.features[k - 1] - centre[k - 1]) / deviation[k - 1] };
    let rows: Vec<Vec<f64>> = cases.iter().map(|case| (0..=width).map(|k| standard(case, k)).collect()).collect();
    let mut beta = DVector::<f64>::zeros(width + 1);
    for _ in 0..ROUNDS {
        let mut hessian = DMatrix::<f64>::from_diagonal_element(width + 1, width + 1, ridge);
        hessian[(0, 0)] = 1e-12;
        let mut gradient = -ridge * &beta;
        gradient[0] = 0.;
        for (row, case) in rows.iter().zip(cases) {
            let z: f64 = row.iter().zip(beta.iter()).map(|(x, b)| x * b).sum();
            let p = 1. / (1. + (-z).exp());
            let (pull, curve) = (case.weight * (case.target - p) / total, case.weight * p * (1. - p) / total);
            for (i, x) in row.iter().enumerate() {
                gradient[i] += pull * x;
                for (j, y) in row[..=i].iter().enumerate() {
                    hessian[(i, j)] += curve * x * y;
                    if j < i {
                        hessian[(j, i)] = hessian[(i, j)];
                    }
                }
            }
        }
        let Some(step) = hessian.cholesky().map(|factor| factor.solve(&gradient)) else { break };
        // A step of more than a few deviations' worth of log odds overshoots.
        let scale = (3. / step.amax()).min(1.);
        beta += scale * &step;
        if step.amax() < SMALL {
            break;
        }
    }
    let weights: Vec<f64> = (0..width).map(|k| beta[k + 1] / deviation[k]).collect();
    let constant = beta[0] - weights.iter().zip(&centre).map(|(w, c)| w * c).sum::<f64>();
    std::iter::once(constant).chain(weights).collect()
}
