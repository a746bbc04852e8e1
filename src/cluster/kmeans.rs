//! K-means on the sampled columns, and labels for every face in one pass over `[A B]`.
//!
//! [`KMeans::fit`] is weighted by area and seeded by greedy k-means++. It runs on at most
//! [`crate::spectral::embedding::MOST_COLUMNS`] points, so its cost does not grow with the mesh. Sums are formed in
//! chunk order, so the result does not depend on threads. No cluster ends up empty if there are K distinct points. Cost
//! for s points of d coordinates: some 8 s d K (2 + ln K) multiply-adds for the first centres, and s d K for a round of
//! each start. With d = K, hundreds of parts take minutes.
//!
//! [`assign`] extrapolates every face (eq. 2), takes the nearest centre and counts; Γ's sum (eq. 6) is computed in the
//! same pass. Chunks of columns are independent. Cost: 4 l bytes read and l exponentials per face, which Γ shares. Then
//! [`fill_empty_parts`] makes sure that no part is empty.

use super::part_totals::{PartTotals, block_size};
use crate::base::parallel::chunk_range;
use crate::base::random::{stream, weighted};
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::sort::sort_by;
use crate::base::{Cancel, Result};
use crate::distance::DistanceRows;
use crate::graph::NodeView;
use crate::spectral::Embedding;
use crate::spectral::measures::Gamma;
use crate::store::Run;
use libm::log as ln;
use serde::{Deserialize, Serialize};

const POINTS_PER_CHUNK: usize = 4096;
/// Number of rounds after which starts are compared.
const FIRST_ROUNDS: usize = 4;
/// Number of starts that are continued to the end.
const FINISHED: usize = 2;

/// Parameters of K-means.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KMeansParams {
    /// Number of clusters.
    pub k: usize,
    /// Number of starts. All run four rounds; the best two are continued, and the better one is kept.
    pub starts: usize,
    /// Maximum number of Lloyd rounds after the first four.
    pub rounds: usize,
}

impl KMeansParams {
    /// The default for `k` clusters.
    pub fn new(k: usize) -> Self {
        Self { k, starts: 8, rounds: 50 }
    }
}

/// Fitted centres.
#[derive(Clone, Debug, PartialEq)]
pub struct KMeans {
    /// Centres, K rows of d.
    pub centres: Vec<f32>,
    /// Coordinates d.
    pub dimensions: usize,
    /// Weighted sum of squared distances to the nearest centre, before the last round moved the centres.
    pub cost: f64,
}

/// Points in rows of coordinates (d rows of s) with weights (s).
#[derive(Clone, Copy, Debug)]
pub struct WeightedPoints<'a> {
    /// d rows of s.
    pub coordinates: &'a [f32],
    /// Weights (s), summing to 1.
    pub weights: &'a [f64],
}

impl WeightedPoints<'_> {
    fn len(&self) -> usize {
        self.weights.len()
    }

    fn point(&self, j: usize) -> impl Iterator<Item = f32> + '_ {
        self.coordinates.iter().skip(j).step_by(self.len()).copied()
    }
}

/// Squared distances (s) from one centre to the points.
fn squares(points: WeightedPoints<'_>, centre: &[f32], out: &mut [f32]) {
    out.fill(0.);
    for (row, &c) in points.coordinates.chunks_exact(points.len()).zip(centre) {
        add_squares(out, c, row);
    }
}

/// Centres, row-major.
#[derive(Clone, Copy, Debug)]
pub struct Centres<'a> {
    /// K rows of d.
    pub values: &'a [f32],
    /// Coordinates d.
    pub dimensions: usize,
}

impl Centres<'_> {
    /// The nearest centre of each of m points: its number in `label`, and the squared distances to the nearest and
    /// second nearest (m each). `rows(e)` returns coordinate e (m). Ties go to the lower centre.
    pub fn nearest<'a>(
        self,
        rows: impl Fn(usize) -> &'a [f32],
        label: &mut [u32],
        first: &mut [f32],
        second: &mut [f32],
    ) {
        let rows: Vec<&[f32]> = (0..self.dimensions).map(rows).collect();
        dispatch(NearestCentres { centres: self, rows: &rows, label, first, second });
    }
}

/// [`Centres::nearest`], for [`dispatch`].
struct NearestCentres<'a> {
    centres: Centres<'a>,
    rows: &'a [&'a [f32]],
    label: &'a mut [u32],
    first: &'a mut [f32],
    second: &'a mut [f32],
}

impl SimdKernel for NearestCentres<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { centres: Centres { values, dimensions }, rows, label, first, second } = self;
        first.fill(f32::INFINITY);
        second.fill(f32::INFINITY);
        label.fill(0);
        let mut square = vec![0f32; label.len()];
        for (k, centre) in values.chunks_exact(dimensions.max(1)).enumerate() {
            square.fill(0.);
            for (&c, row) in centre.iter().zip(rows) {
                add_squares(&mut square, c, row);
            }
            keep_nearest(&square, k as u32, label, first, second);
        }
    }
}

// Functions of their own: the compiler knows that their arguments do not overlap.

#[inline(always)]
fn add_squares(sum: &mut [f32], c: f32, x: &[f32]) {
    let x = &x[..sum.len()];
    for i in 0..sum.len() {
        sum[i] += (x[i] - c) * (x[i] - c);
    }
}

/// Takes centre `k` into account, which is as far as `square` says (squared).
#[inline(always)]
fn keep_nearest(square: &[f32], k: u32, label: &mut [u32], first: &mut [f32], second: &mut [f32]) {
    let n = square.len();
    let (label, first, second) = (&mut label[..n], &mut first[..n], &mut second[..n]);
    for i in 0..n {
        let nearer = square[i] < first[i];
        second[i] = if nearer { first[i] } else { square[i].min(second[i]) };
        label[i] = if nearer { k } else { label[i] };
        first[i] = if nearer { square[i] } else { first[i] };
    }
}

impl KMeans {
    /// A view of the centres.
    pub fn centres(&self) -> Centres<'_> {
        Centres { values: &self.centres, dimensions: self.dimensions }
    }

    /// Fits K centres to weighted points with `dimensions` coordinates.
    ///
    /// ```
    /// use nystrom_stream::cluster::kmeans::{KMeans, KMeansParams, WeightedPoints};
    /// use nystrom_stream::store::Run;
    ///
    /// # fn main() -> nystrom_stream::base::Result<()> {
    /// let points = WeightedPoints { coordinates: &[0., 1., 8., 9.], weights: &[0.25; 4] };
    /// let fitted = KMeans::fit(points, 1, KMeansParams::new(2), &Run::new(&()))?;
    /// let mut centres = fitted.centres;
    /// centres.sort_by(f32::total_cmp);
    /// assert_eq!(centres, [0.5, 8.5]);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn fit(points: WeightedPoints<'_>, dimensions: usize, params: KMeansParams, run: &Run) -> Result<Self> {
        // Starts run in parallel, on one thread each, since the seeds of a start are drawn one after another.
        let one = run.with_threads(1);
        let begin = |start: usize, (): &mut ()| {
            let centres = seed_centres(points, dimensions, params.k, &format!("k-means {start}"), run)?;
            lloyd(points, dimensions, centres, params.rounds.min(FIRST_ROUNDS), &one)
        };
        let mut begun = run.map_chunks(params.starts.max(1), || (), begin)?;
        // A stable sort: of equal ones the first wins.
        sort_by(&mut begun, |a, b| a.cost.total_cmp(&b.cost));
        let mut best: Option<Self> = None;
        for start in begun.into_iter().take(FINISHED) {
            let fitted = lloyd(points, dimensions, start.centres, params.rounds, run)?;
            if best.as_ref().is_none_or(|best| fitted.cost < best.cost) {
                best = Some(fitted);
            }
        }
        Ok(best.unwrap_or(Self { centres: Vec::new(), dimensions, cost: 0. }))
    }
}

/// Greedy k-means++: each new centre is the best of a few points drawn by weight times squared distance.
fn seed_centres(points: WeightedPoints<'_>, dimensions: usize, k: usize, purpose: &str, run: &Run) -> Result<Vec<f32>> {
    let s = points.len();
    let mut draw = stream(run.seed, purpose);
    let mut centres: Vec<f32> = Vec::with_capacity(k * dimensions);
    let mut near = vec![f32::INFINITY; s];
    // The candidate, and the best so far.
    let (mut trial, mut chosen) = (vec![0f32; s], vec![0f32; s]);
    while centres.len() < k * dimensions {
        run.cancel.check()?;
        let (mut sum, mut sums) = (0., Vec::with_capacity(s));
        for (i, w) in points.weights.iter().enumerate() {
            sum += if centres.is_empty() { *w } else { w * f64::from(near[i]) };
            sums.push(sum);
        }
        let candidates = if centres.is_empty() { 1 } else { 2 + ln(k as f64) as usize };
        let mut best: Option<(f64, usize)> = None;
        for _ in 0..candidates {
            let j = weighted(&sums, &mut draw);
            let centre: Vec<f32> = points.point(j).collect();
            squares(points, &centre, &mut trial);
            let cost: f64 = (0..s).map(|i| points.weights[i] * f64::from(trial[i].min(near[i]))).sum();
            if best.is_none_or(|(least, _)| cost < least) {
                best = Some((cost, j));
                std::mem::swap(&mut trial, &mut chosen);
            }
        }
        near.iter_mut().zip(&chosen).for_each(|(n, &t)| *n = n.min(t));
        centres.extend(points.point(best.map_or(0, |(_, j)| j)));
    }
    Ok(centres)
}

/// Sums of one chunk of a Lloyd round.
struct LloydSums {
    mass: Vec<f64>,
    sums: Vec<f64>,
    cost: f64,
    /// The chunk's point of greatest weighted distance, used to refill an empty cluster.
    worst: (f64, usize),
}

fn lloyd(points: WeightedPoints<'_>, d: usize, mut centres: Vec<f32>, rounds: usize, run: &Run) -> Result<KMeans> {
    let s = points.len();
    let k = centres.len() / d.max(1);
    let mut last = f64::INFINITY;
    let mut cost = 0.;
    for _ in 0..rounds.max(1) {
        let sums = |range| Ok(chunk_sums(points, range, d, &centres));
        let chunks = run.map_ranges(s, POINTS_PER_CHUNK, sums)?;
        let (mut mass, mut sums, mut worst) = (vec![0f64; k], vec![0f64; k * d], (-1., 0));
        cost = 0.;
        for part in chunks {
            cost += part.cost;
            mass.iter_mut().zip(&part.mass).for_each(|(a, b)| *a += b);
            sums.iter_mut().zip(&part.sums).for_each(|(a, b)| *a += b);
            if part.worst.0 > worst.0 {
                worst = part.worst;
            }
        }
        for c in 0..k {
            if mass[c] > 0. {
                (0..d).for_each(|e| centres[c * d + e] = (sums[c * d + e] / mass[c]) as f32);
            } else if worst.0 > 0. {
                // An empty cluster takes the point with the worst fit to its own centre; one such refill per round.
                points.point(worst.1).enumerate().for_each(|(e, x)| centres[c * d + e] = x);
                worst.0 = -1.;
            }
        }
        if last - cost <= 1e-6 * cost {
            break;
        }
        last = cost;
    }
    Ok(KMeans { centres, dimensions: d, cost })
}

fn chunk_sums(points: WeightedPoints<'_>, range: std::ops::Range<usize>, d: usize, centres: &[f32]) -> LloydSums {
    let m = range.len();
    let k = centres.len() / d.max(1);
    let (mut label, mut first, mut second) = (vec![0u32; m], vec![0f32; m], vec![0f32; m]);
    let row = |e: usize| &points.coordinates[e * points.len()..][range.clone()];
    Centres { values: centres, dimensions: d }.nearest(row, &mut label, &mut first, &mut second);
    let mut out = LloydSums { mass: vec![0.; k], sums: vec![0.; k * d], cost: 0., worst: (-1., 0) };
    for i in 0..m {
        let (c, weight) = (label[i] as usize, points.weights[range.start + i]);
        let cost = weight * f64::from(first[i]);
        out.mass[c] += weight;
        out.cost += cost;
        if cost > out.worst.0 {
            out.worst = (cost, range.start + i);
        }
        // All coordinates of a point at once: each sum adds its points in order, and the sums are independent.
        for (e, sum) in out.sums[c * d..(c + 1) * d].iter_mut().enumerate() {
            *sum += weight * f64::from(points.coordinates[e * points.len() + range.start + i]);
        }
    }
    out
}

/// Faces per chunk: what fits the cache at l = 60. It affects results only in the last digits of Γ.
pub const FACES_PER_CHUNK: usize = 2048;

/// Inputs for labelling every face.
#[derive(Clone, Copy, Debug)]
pub struct Assignment<'a> {
    /// Distances of the faces from the landmarks.
    pub rows: &'a DistanceRows,
    /// The embedding that is extrapolated to them.
    pub embedding: &'a Embedding,
    /// Centres in it.
    pub centres: &'a KMeans,
    /// Γ, if requested.
    pub gamma: Option<&'a Gamma>,
}

/// The certainty of the labels of points (m), from the squared distances to the nearest and the second nearest centre,
/// for [`dispatch`].
struct Margins<'a> {
    first: &'a [f32],
    second: &'a [f32],
    out: &'a mut [f32],
}

impl SimdKernel for Margins<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { first, second, out } = self;
        let (first, second) = (&first[..out.len()], &second[..out.len()]);
        for i in 0..out.len() {
            let (first, second) = (first[i].sqrt(), second[i].sqrt());
            let known = second > 0. && second.is_finite();
            out[i] = (if known { 1. - first / second } else { 1. }).clamp(0., 1.);
        }
    }
}

/// Number of chunks whose distances are requested at a time.
const CHUNKS_ASKED: usize = 16;

/// Labels every face with its nearest centre in `labels` (n). Returns totals of the clusters, and Γ's sum over all
/// columns, or 0 if not requested. `areas_to_confidences` (n) holds the faces' areas on input and the certainty of each
/// label on output, from 0 halfway between two centres to 1 on a centre: this saves one array of the size of the mesh.
/// Memory: 4 (l + d) bytes for each of 2,048 faces per thread; the budget may limit the number of threads.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn assign(
    assignment: Assignment<'_>,
    labels: &mut [u32],
    areas_to_confidences: &mut [f32],
    run: &Run,
) -> Result<(PartTotals, f64)> {
    let Assignment { rows, embedding, centres, gamma } = assignment;
    let parts = centres.centres.len() / centres.dimensions.max(1);
    let n = rows.nodes;
    let d = embedding.dimensions;
    struct Scratch {
        affinities: Vec<f32>,
        coordinates: Vec<f32>,
        first: Vec<f32>,
        second: Vec<f32>,
    }
    let scratch = || Scratch {
        affinities: vec![0.; FACES_PER_CHUNK * rows.len()],
        coordinates: vec![0.; FACES_PER_CHUNK * d],
        first: vec![0.; FACES_PER_CHUNK],
        second: vec![0.; FACES_PER_CHUNK],
    };
    let outputs = (labels, areas_to_confidences);
    let (run, _grant) = run.threads_within((4 * FACES_PER_CHUNK * (rows.len() + d + 2)) as u64);
    let block = block_size(n, FACES_PER_CHUNK, parts);
    let blocks = run.fill_two(outputs, block, scratch, |k, labels, areas_to_confidences, s| {
        let (mut totals, mut gamma_sum) = (PartTotals::new(parts), 0.);
        let chunks = labels.chunks_mut(FACES_PER_CHUNK).zip(areas_to_confidences.chunks_mut(FACES_PER_CHUNK));
        for (chunk, (labels, areas_to_confidences)) in (k * (block / FACES_PER_CHUNK)..).zip(chunks) {
            run.cancel.check()?;
            let m = labels.len();
            let range = chunk_range(n, FACES_PER_CHUNK, chunk);
            if chunk % CHUNKS_ASKED == 0 {
                let end = n.min(range.start + CHUNKS_ASKED * FACES_PER_CHUNK);
                (0..rows.len()).for_each(|row| run.will_need_pages(rows.row(row), range.start..end));
            }
            let distances = |row: usize| &rows.row(row)[range.clone()];
            let affinities = &mut s.affinities[..m * rows.len()];
            embedding.chunk(m, distances, affinities, &mut s.coordinates[..m * d]);
            let coordinates = &s.coordinates;
            let row = |e: usize| &coordinates[e * m..(e + 1) * m];
            centres.centres().nearest(row, labels, &mut s.first[..m], &mut s.second[..m]);
            let mut first = 0;
            for same in labels.chunk_by(|a, b| a == b) {
                // Summed in face order, but in a register: consecutive faces mostly have the same label.
                let part = same[0] as usize;
                let areas = &areas_to_confidences[first..first + same.len()];
                totals.faces[part] += areas.len() as u64;
                totals.area[part] = areas.iter().fold(totals.area[part], |sum, &area| sum + f64::from(area));
                first += same.len();
            }
            dispatch(Margins { first: &s.first[..m], second: &s.second[..m], out: areas_to_confidences });
            run.progress.advance("assign", m as u64);
            gamma_sum += gamma.map_or(0., |gamma| gamma.chunk(m, &s.affinities[..m * rows.len()]));
        }
        Ok((totals, gamma_sum))
    })?;
    let (mut totals, mut gamma_sum) = (PartTotals::new(parts), 0.);
    for (block, gamma) in blocks {
        totals.add(&block);
        gamma_sum += gamma;
    }
    Ok((totals, gamma_sum))
}

/// Gives each empty part the least certain face, by `quality` (n), of the part with most faces. Parts are empty only if
/// the embedding has fewer distinct points than parts (a cube, four faces in four parts). Some stay empty if there are
/// fewer faces than parts. Cost: one pass over the faces per empty part.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn fill_empty_parts(
    totals: &mut PartTotals,
    nodes: NodeView<'_>,
    labels: &mut [u32],
    quality: &[f32],
    cancel: &Cancel,
) -> Result<()> {
    while let Some(empty) = totals.faces.iter().position(|&faces| faces == 0) {
        cancel.check()?;
        let mut most = 0;
        for part in 1..totals.faces.len() {
            if totals.faces[part] > totals.faces[most] {
                most = part;
            }
        }
        let mut worst: Option<usize> = None;
        for (face, &label) in labels.iter().enumerate() {
            if label as usize == most && worst.is_none_or(|w| quality[face] < quality[w]) {
                worst = Some(face);
            }
        }
        let Some(face) = worst.filter(|_| totals.faces[most] > 1) else { return Ok(()) };
        let area = f64::from(nodes.at(face).area);
        labels[face] = empty as u32;
        totals.faces[most] -= 1;
        totals.area[most] -= area;
        totals.faces[empty] += 1;
        totals.area[empty] += area;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::unit;
    use crate::graph::Node;

    /// Three blobs on a line.
    fn blobs() -> (Vec<f32>, Vec<f64>) {
        let points: Vec<f32> = (0..300).map(|i| (i / 100) as f32 * 10. + (i % 100) as f32 * 0.01).collect();
        (points, vec![1. / 300.; 300])
    }

    #[test]
    fn separate_blobs_are_found_whatever_the_threads() {
        let (coordinates, weights) = blobs();
        let points = WeightedPoints { coordinates: &coordinates, weights: &weights };
        let mut run = Run::new(&());
        let mut results = Vec::new();
        for threads in [1, 3] {
            run.threads = threads;
            results.push(KMeans::fit(points, 1, KMeansParams::new(3), &run).unwrap());
        }
        assert_eq!(results[0], results[1]);
        let mut centres = results[0].centres.clone();
        centres.sort_by(f32::total_cmp);
        for (k, c) in centres.iter().enumerate() {
            assert!((c - (k as f32 * 10. + 0.495)).abs() < 1e-3);
        }
    }

    #[test]
    fn more_clusters_than_distinct_points_is_survived() {
        let points = WeightedPoints { coordinates: &[1., 1., 2.], weights: &[0.4, 0.3, 0.3] };
        let fitted = KMeans::fit(points, 1, KMeansParams::new(3), &Run::new(&())).unwrap();
        assert_eq!(fitted.centres.len(), 3);
        // Both positions have a centre.
        assert!(fitted.centres.contains(&1.) && fitted.centres.contains(&2.), "{:?}", fitted.centres);
    }

    #[test]
    fn no_cluster_ends_empty_while_there_are_as_many_points() {
        let mut random = stream(1, "points");
        for (s, k, seed) in (0..60).map(|i| (12 + i, 3 + i % 10, i as u64)) {
            // Points in a plane, many of them close to each other.
            let coordinates: Vec<f32> = (0..2 * s).map(|_| unit(&mut random).powi(4) as f32).collect();
            let weights = vec![1. / s as f64; s];
            let points = WeightedPoints { coordinates: &coordinates, weights: &weights };
            let run = Run { seed, ..Run::new(&()) };
            let fitted = KMeans::fit(points, 2, KMeansParams::new(k), &run).unwrap();
            let (mut label, mut first, mut second) = (vec![0; s], vec![0.; s], vec![0.; s]);
            fitted.centres().nearest(|e| &coordinates[e * s..(e + 1) * s], &mut label, &mut first, &mut second);
            assert!((0..k as u32).all(|cluster| label.contains(&cluster)), "{s} points, {k} clusters: {label:?}");
        }
    }

    #[test]
    fn a_round_gives_an_empty_cluster_the_point_that_suits_its_own_least() {
        let points = WeightedPoints { coordinates: &[0., 1., 9.], weights: &[1. / 3.; 3] };
        let fitted = lloyd(points, 1, vec![0., 100., 101.], 50, &Run::new(&())).unwrap();
        assert_eq!(fitted.centres, [1., 9., 0.]);
    }

    /// Regression: with a thousand parts, a cancelled run stopped only after all centres of a start were drawn, minutes
    /// later.
    #[test]
    fn drawing_centres_stops_when_the_run_does() {
        let (coordinates, weights) = blobs();
        let points = WeightedPoints { coordinates: &coordinates, weights: &weights };
        let run = Run::new(&());
        assert_eq!(seed_centres(points, 1, 3, "test", &run).unwrap().len(), 3);
        run.cancel.cancel();
        assert!(matches!(seed_centres(points, 1, 3, "test", &run), Err(crate::base::Error::Cancelled)));
    }

    #[test]
    fn empty_parts_get_the_least_certain_faces_of_the_largest() {
        let nodes: Vec<Node> = (1..7).map(|area| Node { area: area as f32, ..Node::default() }).collect();
        let mut labels = [0, 0, 0, 0, 2, 2];
        let quality = [0.9, 0.2, 0.5, 0.3, 0.1, 0.];
        let mut totals = PartTotals { faces: vec![4, 0, 2, 0], area: vec![10., 0., 11., 0.] };
        let cancel = Cancel::default();
        fill_empty_parts(&mut totals, nodes[..].into(), &mut labels, &quality, &cancel).unwrap();
        assert_eq!(labels, [0, 1, 0, 3, 2, 2]);
        assert_eq!(totals, PartTotals { faces: vec![2, 1, 2, 1], area: vec![4., 2., 11., 4.] });
        // Parts beyond the faces stay empty.
        let mut totals = PartTotals { faces: vec![1, 0], area: vec![1., 0.] };
        fill_empty_parts(&mut totals, nodes[..1].into(), &mut labels[..1], &quality[..1], &cancel).unwrap();
        assert_eq!(totals.faces, [1, 0]);
    }

    /// Regression: a cancelled run stopped only when every part had its face, each of which takes a pass over all
    /// faces.
    #[test]
    fn filling_empty_parts_stops_when_the_run_does() {
        let (nodes, cancel) = ([Node::default(); 3], Cancel::default());
        let mut totals = PartTotals { faces: vec![3, 0], area: vec![0.; 2] };
        cancel.cancel();
        let filled = fill_empty_parts(&mut totals, nodes[..].into(), &mut [0; 3], &[0.; 3], &cancel);
        assert!(matches!(filled, Err(crate::base::Error::Cancelled)));
    }
}
