//! Fig. 1 of the paper: do Γ and the norm of the Schur complement rank samples in the same way?
//!
//! A run draws points in the plane from a normal distribution and two random samples of them; its marker is at (η(S₁) −
//! η(S₂), Γ(S₁) − Γ(S₂)), with the sign chosen so that agreement is the first or third quadrant. Gaussian kernel of the
//! *Euclidean* distance: eq. 3's squared norm is a misprint, with which the measures agree in only 5–9 % of runs. σ is
//! the mean distance between different points. O(n³) per run, for the nuclear norm.

use crate::base::Result;
use crate::base::random::{below, stream, unit};
use crate::spectral::affinity::DenseBlock;
use crate::spectral::kernel::Kernel;
use crate::spectral::measures::{measure, schur_norms};
use crate::store::Run;
use nalgebra::DMatrix;
use serde::Serialize;

/// Parameters of the runs.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct PointsParams {
    /// Points n.
    pub points: usize,
    /// Sample size l.
    pub landmarks: usize,
    /// Runs per seed.
    pub runs: usize,
}

impl Default for PointsParams {
    fn default() -> Self {
        Self { points: 500, landmarks: 10, runs: 100 }
    }
}

crate::base::setters::setters!(PointsParams { points: usize, landmarks: usize, runs: usize });

/// Relative tolerance for kept eigenvalues of a positive kernel in `f64`.
pub const TOLERANCE: f64 = 1e-10;

/// Γ and the norms of the Schur complement of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SampleMeasures {
    /// Γ.
    pub gamma: f64,
    /// Frobenius norm of the Schur complement.
    pub frobenius: f64,
    /// Its spectral norm.
    pub spectral: f64,
    /// Its nuclear norm.
    pub nuclear: f64,
}

/// A run: two samples of the same points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SamplePair {
    /// The samples.
    pub samples: [SampleMeasures; 2],
}

impl SamplePair {
    /// The marker for a norm: (η(S₁) − η(S₂), γ(S₂) − γ(S₁)) with γ = Γ as a quality, so that agreement is a positive
    /// product.
    pub fn marker(&self, norm: impl Fn(&SampleMeasures) -> f64) -> (f64, f64) {
        let [a, b] = &self.samples;
        (norm(a) - norm(b), b.gamma - a.gamma)
    }
}

/// Share of markers in the first and third quadrants, 0 to 1.
pub fn agreement(pairs: &[SamplePair], norm: impl Fn(&SampleMeasures) -> f64) -> f64 {
    let agree = pairs.iter().map(|pair| pair.marker(&norm)).filter(|(x, y)| x * y > 0.).count();
    agree as f64 / pairs.len().max(1) as f64
}

/// Gaussian affinities of points in the plane; σ is the mean distance between different points.
pub fn affinities(points: &[[f64; 2]]) -> DMatrix<f64> {
    let n = points.len();
    let distance = |i: usize, j: usize| (points[i][0] - points[j][0]).hypot(points[i][1] - points[j][1]);
    let mut sum = 0.;
    for i in 0..n {
        for j in 0..i {
            sum += distance(i, j);
        }
    }
    let sigma = 2. * sum / ((n * n).saturating_sub(n)).max(1) as f64;
    DMatrix::from_fn(n, n, |i, j| Kernel::Gaussian.of(sigma, distance(i, j)))
}

/// Evaluates the sample `landmarks` of points with the affinities `w`.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn evaluate_sample(w: &DMatrix<f64>, landmarks: &[u32], run: &Run) -> Result<SampleMeasures> {
    let rows = DMatrix::from_fn(landmarks.len(), w.ncols(), |k, j| w[(landmarks[k] as usize, j)]);
    let block = DenseBlock { landmarks: landmarks.to_vec(), rows };
    let [frobenius, spectral, nuclear] = schur_norms(w, &block, TOLERANCE);
    Ok(SampleMeasures { gamma: measure(&block, None, TOLERANCE, run)?.gamma, frobenius, spectral, nuclear })
}

/// All runs of one seed.
///
/// ```
/// use nystrom_stream::apps::study::points::{PointsParams, agreement, pairs};
/// use nystrom_stream::store::Run;
/// let params = PointsParams::default().points(40).landmarks(4).runs(5);
/// let runs = pairs(params, 0, &Run::new(&()))?;
/// assert!(runs.len() == 5 && agreement(&runs, |sample| sample.nuclear) <= 1.);
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
///
/// # Errors
/// [`crate::base::Error::Memory`] if there is no room for one run, [`crate::base::Error::Cancelled`].
pub fn pairs(params: PointsParams, seed: u64, run: &Run) -> Result<Vec<SamplePair>> {
    // The affinities and what the comparison with all of them makes.
    let bytes = 5 * 8 * (params.points as u64).pow(2);
    run.budget.take_or("a run over all points", bytes, "take fewer points")?;
    let (run, _grant) = run.threads_within(bytes);
    let inner = Run {
        threads: 1,
        budget: run.budget.clone(),
        resident: run.resident,
        progress: &(),
        cancel: run.cancel.clone(),
        seed,
    };
    run.map_chunks(
        params.runs,
        || (),
        |k, ()| {
            let mut draw = stream(seed, &format!("points of run {k}"));
            let points: Vec<[f64; 2]> = (0..params.points).map(|_| normal(&mut draw)).collect();
            let w = affinities(&points);
            let mut sample = || {
                let mut places: Vec<u32> = (0..params.points as u32).collect();
                let l = params.landmarks.min(params.points);
                for k in 0..l {
                    places.swap(k, k + below(&mut draw, params.points - k));
                }
                places.truncate(l);
                places
            };
            let samples = [sample(), sample()];
            Ok(SamplePair {
                samples: [evaluate_sample(&w, &samples[0], &inner)?, evaluate_sample(&w, &samples[1], &inner)?],
            })
        },
    )
}

/// Two independent normally distributed numbers (Box and Muller).
fn normal(draw: &mut crate::base::random::Random) -> [f64; 2] {
    let radius = (-2. * libm::log(1. - unit(draw))).sqrt();
    let (sin, cos) = libm::sincos(std::f64::consts::TAU * unit(draw));
    [radius * cos, radius * sin]
}
