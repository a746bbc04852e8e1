//! Refines an alignment by spectral upsampling (ZoomOut: Melzi, Ren, Rodolà, Sharma, Wonka, Ovsjanikov 2019), and ranks
//! the results of several starts.
//!
//! Starting from the matches of an alignment in a few functions, two steps alternate on samples of both meshes: the
//! linear map between the first k functions that fits the matches best ([`super::functional`]), and the matches that
//! fit this map best; k grows up to all functions. Low frequencies bring the large parts in place, higher ones the
//! details.
//!
//! Each start is refined independently, with each of [`FIRST`] as first k; the best halfway are refined further.
//! Results are ranked by criteria that the starts hardly optimise: the difference of distances from landmarks on both
//! meshes ([`Outcome::distortion`]), and the distance of the functions of all samples from those of their matches, in
//! both directions ([`Outcome::residual`]). After refinement, neither distinguishes a horse's head from its tail; the
//! start's cost of one-to-one transport of area does.
//!
//! The chosen map is refitted with the matches of more sample points ([`refit`]).
//!
//! Cost: constant. A step is a matrix product of k × both [`SAMPLES`], a tenth of a second at k = 100; each of the last
//! three, with more sample points, takes a third of a second and 20 MB.

use super::align::{Alignment, CONCLUSIVE_ORIENTATION, RIVAL, procrustes, sample};
use super::functional::{Points, Targets, ToA, fit};
use super::orientation::Tensor;
use crate::base::Result;
use crate::base::sort::sort_by;
use crate::distance::DistanceRows;
use crate::graph::Node;
use crate::spectral::local::LocalBasis;
use crate::spectral::nystrom::Point;
use crate::store::Run;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

/// Number of sample points of A and of B.
pub const SAMPLES: [usize; 2] = [1500, 2500];
/// Numbers of functions of the first step, tried one after the other.
pub const FIRST: [usize; 4] = [5, 9, 20, 40];
/// A step adds one function, plus one for every [`GROWTH`] in use.
const GROWTH: usize = 16;
/// Up to [`HALFWAY`] functions, all starts are refined on every [`THINNED`]-th sample point.
const THINNED: usize = 2;
/// Number of functions at the first ranking.
const HALFWAY: usize = 40;
/// Number of results of the first ranking that are refined on all sample points with all functions.
const FINISHED: usize = 5;
/// Numbers of sample points of A and of B with which the chosen map is refitted, and how often.
const MORE: ([usize; 2], usize) = ([3000, 1 << 14], 3);

/// Cost of transport below which costs are equal for ranking.
const LEAST_TRANSPORT: f64 = 1e-12;
/// Weight of a given pair of landmarks.
const WEIGHT: usize = 20;
/// Number of given landmarks whose distances locate a vertex.
const LOCATING: usize = 4;
/// Number of functions for finding the sample point nearest to a vertex.
const FEW: usize = 40;
/// Number of points by which two maps are compared.
const COMPARED: usize = 200;
/// Mean distance between the images of two maps, over √area, above which they are different.
const APART: f64 = 0.1;
/// Mean distance up to which they are the same.
const SAME: f64 = 0.005;

/// Whether matches are refined, and with which functions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Refine {
    /// No refinement: the paper's method.
    None,
    /// In smooth functions by Nyström's extension from a local sample ([`LocalBasis`]).
    #[default]
    Nystrom,
    /// In eigenfunctions of the Laplace–Beltrami operator ([`LocalBasis::laplacian`]).
    Laplacian,
}

/// A mesh, as used by refinement.
#[derive(Clone, Copy, Debug)]
pub struct Refinable<'a> {
    /// Its functions.
    pub basis: &'a LocalBasis,
    /// Its vertices in the aligned embedding (n).
    pub points: &'a [Point],
    /// Its orientation tensor there; without it orientation is not tested.
    pub tensor: Option<&'a Tensor>,
    /// Areas of vertices (n).
    pub nodes: &'a [Node],
    /// Distances from its landmarks.
    pub rows: &'a DistanceRows,
    /// 1/√area.
    pub unit: f64,
}

/// Prior knowledge of the map.
#[derive(Clone, Copy, Debug, Default)]
pub struct Prior<'a> {
    /// Pairs of corresponding vertices of A and B.
    pub pairs: &'a [(u32, u32)],
    /// Distances from these, on A and on B.
    pub rows: Option<[&'a DistanceRows; 2]>,
    /// An additional initial map: for each vertex of A one of B.
    pub map: Option<&'a [Option<u32>]>,
}

/// The start of a refinement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// An alignment, by its number.
    Alignment(usize),
    /// Distances from the given landmarks.
    Landmarks,
    /// The given map.
    Map,
}

/// A refined map.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// Its start.
    pub start: Start,
    /// Number of functions of the first step.
    pub initial_functions: usize,
    /// Mean difference between distances of landmarks on either mesh, over √area.
    pub distortion: f64,
    /// Mean squared difference between functions at points and at their matches, in both directions, per function.
    pub residual: f64,
    /// Share of B's sample points that are the match of some point.
    pub coverage: f64,
    /// [`Alignment::transport`] of the start; for other starts than alignments, that of the best.
    pub transport: f64,
    /// Mean distance from the images of given landmarks to their pairs, over √area.
    pub landmarks: Option<f64>,
    /// Agreement of orientation after refinement, as [`Alignment::orientation`].
    pub orientation: Option<f64>,
    /// The map C (k × k): Φ_B ≈ C Φ_A.
    #[serde(skip)]
    pub map: DMatrix<f64>,
    /// The matches of A's sample: vertices of the mesh used for B.
    #[serde(skip)]
    pub(super) sample: Vec<u32>,
}

impl Outcome {
    /// The ranking criterion of results, least first.
    pub fn rank(&self) -> f64 {
        // At a cost of exactly 0, that of a mesh and itself, all results of a start would rank alike.
        let transport = self.transport.max(LEAST_TRANSPORT);
        // Given landmarks are accurate to about a hundredth.
        self.distortion * self.residual * transport * (0.02 + self.landmarks.unwrap_or(0.))
    }
}

/// The start of a refinement.
#[derive(Clone, Copy)]
struct Origin {
    start: Start,
    /// Number of functions of the first step.
    initial_functions: usize,
    /// As [`Outcome::transport`].
    transport: f64,
}

/// Samples of both meshes, ready for refinement.
struct Samples {
    chosen: [Vec<u32>; 2],
    functions: [Points; 2],
    landmarks: [Points; 2],
    /// Number of given pairs, which come last.
    fixed: usize,
}

impl Samples {
    fn new(sides: [Refinable<'_>; 2], pairs: &[(u32, u32)], counts: [usize; 2], run: &Run) -> Self {
        let k = sides[0].basis.count.min(sides[1].basis.count);
        let of = |side: Refinable<'_>, vertices: &[u32]| {
            let values = vertices.iter().flat_map(|&v| &side.basis.at(v as usize)[..k]).copied().collect();
            Points { dimensions: k, values }
        };
        let mut chosen = [0, 1].map(|s| sample(sides[s].nodes, counts[s], run.seed, "refined points"));
        for &(of_a, of_b) in pairs {
            chosen[0].push(of_a);
            chosen[1].push(of_b);
        }
        let functions = [0, 1].map(|s| of(sides[s], &chosen[s]));
        let landmarks = [0, 1].map(|s| of(sides[s], &sides[s].rows.landmarks));
        Self { chosen, functions, landmarks, fixed: pairs.len() }
    }

    /// Every `step`-th sample point, and all given pairs.
    fn thinned(&self, step: usize) -> Self {
        let kept = |n: usize| (0..n - self.fixed).step_by(step).chain(n - self.fixed..n);
        let thin = |points: &Points| {
            let values = kept(points.len()).flat_map(|i| points.at(i)).copied().collect();
            Points { dimensions: points.dimensions, values }
        };
        Self {
            chosen: self.chosen.each_ref().map(|chosen| kept(chosen.len()).map(|i| chosen[i]).collect()),
            functions: self.functions.each_ref().map(thin),
            landmarks: self.landmarks.clone(),
            fixed: self.fixed,
        }
    }

    /// Overrides the matches of given pairs.
    fn fix(&self, found: &mut [u32]) {
        let (n_a, n_b) = (found.len(), self.functions[1].len());
        (0..self.fixed).for_each(|p| found[n_a - self.fixed + p] = (n_b - self.fixed + p) as u32);
    }

    /// The pairs for fitting a map: given ones count [`WEIGHT`] times.
    fn pairs(&self, found: &[u32]) -> Vec<(u32, u32)> {
        let all = found.iter().enumerate().map(|(i, &j)| (i as u32, j));
        let given = all.clone().skip(found.len() - self.fixed);
        all.chain((1..WEIGHT).flat_map(|_| given.clone())).collect()
    }

    /// The matches of A's sample among B's under the map `c`.
    fn matched(&self, c: &DMatrix<f64>) -> Vec<u32> {
        let [a, b] = &self.functions;
        let b_in_a = ToA::new(c).apply_all(b);
        let mut found = Targets::new(b_in_a.iter(), c.nrows()).nearest(a.iter());
        self.fix(&mut found);
        found
    }

    /// The same with the nearest of `of_b` to each of `of_a`, for arbitrary coordinates of the samples.
    fn nearest(&self, of_a: &[Vec<f32>], of_b: &[Vec<f32>]) -> Vec<u32> {
        let dimensions = of_b.first().map_or(0, Vec::len);
        let targets = Targets::new(of_b.iter().map(Vec::as_slice), dimensions);
        let mut found = targets.nearest(of_a.iter().map(Vec::as_slice));
        self.fix(&mut found);
        found
    }

    /// Refines the matches `found` (of A's sample among B's) from `first` to `last` functions.
    fn refine(&self, mut found: Vec<u32>, first: usize, last: usize) -> DMatrix<f64> {
        let [a, b] = &self.functions;
        let most = last.min(a.dimensions);
        let mut k = first.min(most);
        loop {
            let map = fit(a, b, &self.pairs(&found), k);
            if k == most {
                return map;
            }
            found = self.matched(&map);
            k = (k + 1 + k / GROWTH).min(most);
        }
    }

    /// The matches under a given `map`: for each point of A's sample, B's sample point nearest to its image in a few
    /// functions.
    fn by_map(&self, sides: [Refinable<'_>; 2], map: &[Option<u32>]) -> Vec<u32> {
        let [in_a, in_b] = &self.chosen;
        let k = FEW.min(sides[1].basis.count);
        let at = |v: u32| sides[1].basis.at(v as usize)[..k].to_vec();
        // A vertex without an image takes that of the previous point.
        let mut last = map.iter().flatten().next().copied().unwrap_or(0);
        let images = in_a.iter().map(|&v| {
            last = map.get(v as usize).copied().flatten().unwrap_or(last);
            at(last)
        });
        self.nearest(&images.collect::<Vec<_>>(), &in_b.iter().map(|&v| at(v)).collect::<Vec<_>>())
    }

    /// Evaluates the map `c`.
    fn evaluate(&self, sides: [Refinable<'_>; 2], prior: Prior<'_>, c: DMatrix<f64>, origin: Origin) -> Outcome {
        let [a, b] = &self.functions;
        let k = c.nrows();
        let to_a = ToA::new(&c);
        let b_in_a = to_a.apply_all(b);
        let in_b = Targets::new(b_in_a.iter(), k);
        let in_a = Targets::new(a.iter(), k);
        let square = |x: &[f32], y: &[f32]| x.iter().zip(y).map(|(x, y)| f64::from(x - y).powi(2)).sum::<f64>();
        let (there, back) = (in_b.nearest(a.iter()), in_a.nearest(b_in_a.iter()));
        let one_way = |found: &[u32], from: &Points, to: &Points| {
            let squares = found.iter().enumerate().map(|(i, &j)| square(from.at(i), to.at(j as usize)));
            squares.sum::<f64>() / (found.len() * k).max(1) as f64
        };
        let residual = one_way(&there, a, &b_in_a) + one_way(&back, &b_in_a, a);
        let mut hit = vec![false; b.len()];
        there.iter().for_each(|&j| hit[j as usize] = true);
        let coverage = hit.iter().filter(|&&hit| hit).count() as f64 / b.len().max(1) as f64;
        // The images of landmarks of either mesh on the other.
        let [of_a, of_b] = &self.landmarks;
        let to_b = in_b.nearest(of_a.iter());
        let to_a = in_a.nearest(to_a.apply_all(of_b).iter());
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
        let landmarks = prior.rows.filter(|_| self.fixed > 0).map(|[_, rows]| {
            let n = there.len() - self.fixed;
            let missed = |p: usize| f64::from(rows.row(p)[self.chosen[1][there[n + p] as usize] as usize]);
            sides[1].unit * (0..self.fixed).map(missed).sum::<f64>() / self.fixed as f64
        });
        let orientation = sides[0].tensor.zip(sides[1].tensor).map(|(of_a, of_b)| {
            let k = of_a.dimensions().min(of_b.dimensions());
            let first = |point: &Point| -> Point { std::array::from_fn(|i| if i < k { point[i] } else { 0. }) };
            let place = |s: usize, i: usize| first(&sides[s].points[self.chosen[s][i] as usize]);
            let pairs = there.iter().enumerate().map(|(i, &j)| (place(0, i), place(1, j as usize)));
            of_a.of_first(k).turned(&procrustes(pairs, k)).agreement(&of_b.of_first(k))
        });
        let sample = there.iter().map(|&j| self.chosen[1][j as usize]).collect();
        let Origin { start, initial_functions, transport } = origin;
        Outcome {
            start,
            initial_functions,
            distortion,
            residual,
            coverage,
            transport,
            landmarks,
            orientation,
            map: c,
            sample,
        }
    }
}

/// Refines each of `alignments`, and the maps that `prior` suggests, and ranks the results: best first.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn refine(
    sides: [Refinable<'_>; 2],
    alignments: &[Alignment],
    prior: Prior<'_>,
    run: &Run,
) -> Result<Vec<Outcome>> {
    let samples = Samples::new(sides, prior.pairs, SAMPLES, run);
    let [a, b] = sides;
    let mut begins: Vec<Start> = (0..alignments.len()).map(Start::Alignment).collect();
    if prior.map.is_some() {
        begins.push(Start::Map);
    } else if prior.pairs.len() >= LOCATING {
        begins.push(Start::Landmarks);
    }
    let costs: Vec<f64> = alignments.iter().map(|one| one.transport.unwrap_or(1.)).collect();
    let least = costs.iter().copied().fold(f64::INFINITY, f64::min).min(1.);
    let origins = begins.into_iter().flat_map(|start| {
        let transport = if let Start::Alignment(at) = start { costs[at] } else { least };
        FIRST.map(|initial_functions| Origin { start, initial_functions, transport })
    });
    let origins: Vec<Origin> = origins.collect();
    let few = samples.thinned(THINNED);
    let begin = |k: usize, (): &mut ()| {
        let [in_a, in_b] = &few.chosen;
        let found = match (origins[k].start, prior.rows, prior.map) {
            (Start::Alignment(at), ..) => {
                let (one, dimensions) = (&alignments[at], alignments[at].transform.nrows());
                let of_b = in_b.iter().map(|&v| b.points[v as usize][..dimensions].to_vec());
                let of_a = in_a.iter().map(|&v| one.apply(&a.points[v as usize])[..dimensions].to_vec());
                few.nearest(&of_a.collect::<Vec<_>>(), &of_b.collect::<Vec<_>>())
            }
            (Start::Landmarks, Some(rows), _) => {
                let [of_a, of_b] = [0, 1].map(|s| {
                    let at = |v: u32| {
                        (0..rows[s].len()).map(|j| sides[s].unit as f32 * rows[s].row(j)[v as usize]).collect()
                    };
                    few.chosen[s].iter().map(|&v| at(v)).collect::<Vec<Vec<f32>>>()
                });
                few.nearest(&of_a, &of_b)
            }
            (_, _, Some(map)) => few.by_map(sides, map),
            _ => Vec::new(),
        };
        Ok(few.evaluate(sides, prior, few.refine(found, origins[k].initial_functions, HALFWAY), origins[k]))
    };
    let mut begun = run.map_chunks(origins.len(), || (), begin)?;
    let rank = |x: &Outcome, y: &Outcome| x.rank().total_cmp(&y.rank());
    sort_by(&mut begun, rank);
    let begun = different(oriented(begun), b);
    let finish = |k: usize, (): &mut ()| {
        let Outcome { start, initial_functions, transport, ref map, .. } = begun[k];
        let map = samples.refine(samples.matched(map), map.nrows(), usize::MAX);
        Ok(samples.evaluate(sides, prior, map, Origin { start, initial_functions, transport }))
    };
    let mut all = run.map_chunks(begun.len(), || (), finish)?;
    sort_by(&mut all, rank);
    Ok(oriented(all))
}

/// Refits the map `c` with the matches of more sample points; `pairs` are given landmarks.
pub fn refit(sides: [Refinable<'_>; 2], c: &DMatrix<f64>, pairs: &[(u32, u32)], run: &Run) -> DMatrix<f64> {
    let (counts, times) = MORE;
    let samples = Samples::new(sides, pairs, counts, run);
    let [a, b] = &samples.functions;
    (0..times).fold(c.clone(), |c, _| fit(a, b, &samples.pairs(&samples.matched(&c)), c.nrows()))
}

/// Drops results that refinement has turned into mirror images, if that can be decided: a pose may fit its own mirror
/// image better.
fn oriented(mut all: Vec<Outcome>) -> Vec<Outcome> {
    let best = all.iter().filter_map(|one| one.orientation).fold(f64::NEG_INFINITY, f64::max);
    if best >= CONCLUSIVE_ORIENTATION {
        all.retain(|one| one.orientation.is_none_or(|orientation| orientation >= 0.5 * best));
    }
    all
}

/// Mean distance between the vertices of `pairs`, over √area, estimated by the landmarks of `rows`; `unit` is that of
/// distances.
pub fn mean_apart(pairs: impl Iterator<Item = (u32, u32)>, rows: &DistanceRows, unit: f64) -> f64 {
    // A lower bound on the distance, and with dozens of landmarks nearly equal to it.
    let apart = |v: u32, w: u32| -> f64 {
        let difference = |row: &[f32]| f64::from((row[v as usize] - row[w as usize]).abs());
        (0..rows.len()).map(|j| difference(rows.row(j))).fold(0., f64::max)
    };
    let (sum, count) = pairs.fold((0., 0u32), |(sum, count), (v, w)| (sum + apart(v, w), count + 1));
    unit * sum / f64::from(count.max(1))
}

/// [`mean_apart`] of two maps of the same sample.
fn apart(one: &Outcome, other: &Outcome, b: Refinable<'_>) -> f64 {
    let step = one.sample.len().div_ceil(COMPARED).max(1);
    let pairs = one.sample.iter().zip(&other.sample).step_by(step);
    mean_apart(pairs.map(|(&v, &w)| (v, w)), b.rows, b.unit)
}

/// The first [`FINISHED`] of `sorted`, without repeating a map.
fn different(sorted: Vec<Outcome>, b: Refinable<'_>) -> Vec<Outcome> {
    let mut kept: Vec<Outcome> = Vec::new();
    for one in sorted {
        if kept.len() < FINISHED && kept.iter().all(|other| apart(&one, other, b) > SAME) {
            kept.push(one);
        }
    }
    kept
}

/// The best of `outcomes` (sorted), and those of the others that map A differently but are hardly more distorted;
/// distances on `b` are estimated by its landmarks.
pub fn rivals(outcomes: &[Outcome], b: Refinable<'_>) -> Vec<Outcome> {
    let Some(best) = outcomes.first() else { return Vec::new() };
    let mut found: Vec<Outcome> = Vec::new();
    for one in outcomes {
        let close = one.distortion <= RIVAL * best.distortion && one.residual <= RIVAL * best.residual;
        if found.is_empty() || close && found.iter().all(|other| apart(one, other, b) > APART) {
            found.push(one.clone());
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: of a mesh and itself the transport costs exactly 0, so that results of one start ranked alike, and a
    /// mesh with spikes was mapped onto itself by the worst of them.
    #[test]
    fn results_of_one_start_are_ranked_even_if_transport_costs_nothing() {
        let outcome = |distortion, transport| Outcome {
            start: Start::Alignment(0),
            initial_functions: FIRST[0],
            distortion,
            residual: 0.3,
            coverage: 0.7,
            transport,
            landmarks: None,
            orientation: None,
            map: DMatrix::identity(1, 1),
            sample: Vec::new(),
        };
        assert!(outcome(0.24, 0.).rank() < outcome(0.38, 0.).rank());
        assert!(outcome(0.38, 0.).rank() < outcome(0.38, 0.01).rank());
    }
}
