//! Refining an alignment by spectral upsampling (ZoomOut: Melzi, Ren, Rodolà, Sharma, Wonka, Ovsjanikov 2019), and
//! judging the outcomes of several.
//!
//! From the matches of an alignment of a few vectors, two steps alternate on samples of both meshes: the linear map between the first k
//! functions that fits the matches best ([`super::functional`]), and the matches that fit this map best; k grows by
//! [`STEP`] up to all functions. Low functions bring the large parts in place, higher ones the details.
//!
//! Each start is refined on its own, from each of [`FIRST`] as first k. The outcomes are judged by what the starts
//! know little about: how far distances from landmarks differ on both meshes ([`Outcome::distortion`]), and how far the
//! functions of all samples are from those of their matches, both ways ([`Outcome::residual`]).
//!
//! Cost: constant. A step is a matrix product of k × both [`SAMPLES`]: a tenth of a second at k = 100.

use super::align::{Alignment, RIVAL, sample};
use super::functional::{Points, Targets, ToA, fit};
use crate::base::Result;
use crate::distance::DistanceRows;
use crate::graph::Node;
use crate::spectral::local::LocalBasis;
use crate::spectral::nystrom::Point;
use crate::store::Run;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// Sample points of A and of B.
pub const SAMPLES: [usize; 2] = [1500, 2500];
/// Functions of the first step, tried one after the other.
pub const FIRST: [usize; 3] = [8, 16, 28];
/// Functions added in each step.
pub const STEP: usize = 5;

/// Points by which two maps are compared.
const COMPARED: usize = 200;
/// Mean distance between the images of two maps, over √area, from which they are different.
const APART: f64 = 0.1;

/// Whether and in which functions matches are refined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Refine {
    /// Not at all: the paper's way.
    None,
    /// In smooth functions by Nyström's extension from a local sample ([`LocalBasis`]).
    #[default]
    Nystrom,
}

/// A mesh, as refinement sees it.
#[derive(Clone, Copy, Debug)]
pub struct Refinable<'a> {
    /// Its functions.
    pub basis: &'a LocalBasis,
    /// Its vertices in the embedding that was aligned (n).
    pub points: &'a [Point],
    /// Areas of vertices (n).
    pub nodes: &'a [Node],
    /// Distances from its landmarks.
    pub rows: &'a DistanceRows,
    /// 1/√area.
    pub unit: f64,
}

/// A refined map.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// Which alignment it began with.
    pub alignment: usize,
    /// Functions of the first step.
    pub first: usize,
    /// Mean difference between distances from landmark to landmark on either mesh, over √area.
    pub distortion: f64,
    /// Mean square between functions at points and at their matches, both ways, per function.
    pub residual: f64,
    /// Share of B's sample that is some point's match.
    pub covered: f64,
    /// The map C (k × k): Φ_B ≈ C Φ_A.
    #[serde(skip)]
    pub map: DMatrix<f64>,
    /// The matches of A's sample, vertices of B.
    #[serde(skip)]
    pub sample: Vec<u32>,
}

impl Outcome {
    /// What outcomes are ranked by, the least first.
    fn rank(&self) -> f64 {
        self.distortion * self.residual
    }
}

/// Samples of both meshes, ready for refinement.
struct Samples {
    chosen: [Vec<u32>; 2],
    functions: [Points; 2],
    landmarks: [Points; 2],
}

impl Samples {
    fn new(sides: [Refinable<'_>; 2], run: &Run) -> Self {
        let k = sides[0].basis.count.min(sides[1].basis.count);
        let of = |side: Refinable<'_>, vertices: &[u32]| {
            let values = vertices.iter().flat_map(|&v| &side.basis.at(v as usize)[..k]).copied().collect();
            Points { dimensions: k, values }
        };
        let chosen = [0, 1].map(|s| sample(sides[s].nodes, SAMPLES[s], run.seed, "refined points"));
        let functions = [0, 1].map(|s| of(sides[s], &chosen[s]));
        let landmarks = [0, 1].map(|s| of(sides[s], &sides[s].rows.landmarks));
        Self { chosen, functions, landmarks }
    }

    /// From the matches `found` (of A's sample among B's) upwards from `first` functions.
    fn refine(&self, mut found: Vec<u32>, first: usize) -> DMatrix<f64> {
        let [a, b] = &self.functions;
        let most = a.dimensions;
        let queries: Vec<&[f32]> = (0..a.len()).map(|i| a.at(i)).collect();
        let mut k = first.min(most);
        loop {
            let pairs: Vec<(u32, u32)> = found.iter().enumerate().map(|(i, &j)| (i as u32, j)).collect();
            let map = fit(a, b, &pairs, k);
            if k == most {
                return map;
            }
            let carried = ToA::new(&map).carry_all(b);
            let targets = Targets::new((0..b.len()).map(|i| carried.at(i)), k);
            found.clear();
            targets.nearest(&queries, &mut found);
            k = (k + STEP).min(most);
        }
    }

    /// Judges the map `c`.
    fn judge(&self, sides: [Refinable<'_>; 2], c: DMatrix<f64>, alignment: usize, first: usize) -> Outcome {
        let [a, b] = &self.functions;
        let k = c.nrows();
        let to_a = ToA::new(&c);
        let carried = to_a.carry_all(b);
        let in_b = Targets::new((0..b.len()).map(|i| carried.at(i)), k);
        let in_a = Targets::new((0..a.len()).map(|i| a.at(i)), k);
        let nearest = |targets: &Targets, points: &Points| {
            let mut found = Vec::new();
            targets.nearest(&(0..points.len()).map(|i| points.at(i)).collect::<Vec<_>>(), &mut found);
            found
        };
        let square = |x: &[f32], y: &[f32]| x.iter().zip(y).map(|(x, y)| f64::from(x - y).powi(2)).sum::<f64>();
        let (there, back) = (nearest(&in_b, a), nearest(&in_a, &carried));
        let one_way = |found: &[u32], from: &Points, to: &Points| {
            let squares = found.iter().enumerate().map(|(i, &j)| square(from.at(i), to.at(j as usize)));
            squares.sum::<f64>() / (found.len() * k).max(1) as f64
        };
        let residual = one_way(&there, a, &carried) + one_way(&back, &carried, a);
        let mut hit = vec![false; b.len()];
        there.iter().for_each(|&j| hit[j as usize] = true);
        let covered = hit.iter().filter(|&&hit| hit).count() as f64 / b.len().max(1) as f64;
        // Where landmarks of either mesh come to lie on the other.
        let [of_a, of_b] = &self.landmarks;
        let to_b = nearest(&in_b, of_a);
        let to_a = nearest(&in_a, &to_a.carry_all(of_b));
        let [rows_a, rows_b] = sides.map(|side| side.rows);
        let mut sum = 0f64;
        for (i, &image_b) in to_b.iter().enumerate() {
            for (j, &image_a) in to_a.iter().enumerate() {
                let d_a = rows_a.row(i)[self.chosen[0][image_a as usize] as usize];
                let d_b = rows_b.row(j)[self.chosen[1][image_b as usize] as usize];
                sum += (sides[0].unit * f64::from(d_a) - sides[1].unit * f64::from(d_b)).abs();
            }
        }
        let distortion = sum / (to_a.len() * to_b.len()).max(1) as f64;
        let sample = there.iter().map(|&j| self.chosen[1][j as usize]).collect();
        Outcome { alignment, first, distortion, residual, covered, map: c, sample }
    }
}

/// Refines each of `alignments` and judges the outcomes: the best first.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn refine(sides: [Refinable<'_>; 2], alignments: &[Alignment], run: &Run) -> Result<Vec<Outcome>> {
    let samples = Samples::new(sides, run);
    let [a, b] = sides;
    let starts: Vec<(usize, usize)> =
        (0..alignments.len()).flat_map(|at| FIRST.iter().map(move |&first| (at, first))).collect();
    let work = |k: usize, (): &mut ()| {
        let (at, first) = starts[k];
        let dimensions = alignments[at].transform.nrows();
        let targets = samples.chosen[1].iter().map(|&v| &b.points[v as usize][..]);
        let targets = Targets::new(targets.collect::<Vec<_>>().into_iter(), dimensions);
        let moved: Vec<Point> =
            samples.chosen[0].iter().map(|&v| alignments[at].apply(&a.points[v as usize])).collect();
        let mut found = Vec::new();
        targets.nearest(&moved.iter().map(|point| &point[..]).collect::<Vec<_>>(), &mut found);
        Ok(samples.judge(sides, samples.refine(found, first), at, first))
    };
    let mut all = run.map_chunks(starts.len(), || (), work)?;
    all.sort_by(|x, y| x.rank().total_cmp(&y.rank()));
    Ok(all)
}

/// The best of `outcomes` (sorted), and those of the others that take A elsewhere but distort hardly more; `b` tells how
/// far apart two vertices of B are, by its landmarks.
pub fn rivals(outcomes: &[Outcome], b: Refinable<'_>) -> Vec<Outcome> {
    let Some(best) = outcomes.first() else { return Vec::new() };
    // No more than the distance, and with dozens of landmarks nearly that.
    let apart = |v: u32, w: u32| -> f64 {
        let difference = |row: &[f32]| f64::from((row[v as usize] - row[w as usize]).abs());
        (0..b.rows.len()).map(|j| difference(b.rows.row(j))).fold(0., f64::max)
    };
    let elsewhere = |one: &Outcome, other: &Outcome| {
        let step = one.sample.len().div_ceil(COMPARED).max(1);
        let pairs = || one.sample.iter().zip(&other.sample).step_by(step);
        b.unit * pairs().map(|(&v, &w)| apart(v, w)).sum::<f64>() / pairs().count().max(1) as f64 > APART
    };
    let mut found: Vec<Outcome> = Vec::new();
    for one in outcomes {
        let close = one.distortion <= RIVAL * best.distortion && one.residual <= RIVAL * best.residual;
        if found.is_empty() || close && found.iter().all(|other| elsewhere(one, other)) {
            found.push(one.clone());
        }
    }
    found
}
