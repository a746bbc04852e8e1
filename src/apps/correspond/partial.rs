//! Matching a part with a whole: a scan with holes, a crop.
//!
//! What is missing changes every eigenfunction and every mean, so embeddings of a part and of a whole cannot be aligned. Distances along the
//! surface between points that are left hardly change, nor does the scale. So the start comes from these. Some
//! [`ANCHORS`] points far apart on the part are assigned to candidates on the whole, one after the other: a beam of the
//! assignments whose pairwise distances agree best ([`assignments`]). An anchor may stay without, at a price. The distances of a
//! point from the anchors tell its first match.
//!
//! Refinement alternates maps and matches as between wholes ([`super::refine`]), with two differences. Functions up to the same
//! frequency are taken on both; on the part these are fewer, by its share of area (Rodolà and others 2017, *Partial Functional
//! Correspondence*), so that the map C is not square: Φ_whole(match) ≈ C Φ_part. And pairs whose distances from the anchors disagree are
//! left out of the fit. Outcomes are ranked by that disagreement; mirror images are told by local orientation
//! ([`agreement`]).
//!
//! Cost: a front per candidate on the whole and two bases; the rest is constant.

use super::align::{TELLING, sample};
use super::functional::{Points, Targets, ToA, fit_between};
use crate::base::Result;
use crate::base::vector::{cross, dot, minus, wide};
use crate::distance::DistanceRows;
use crate::graph::VertexGraph;
use crate::spectral::local::LocalBasis;
use crate::store::Run;
use nalgebra::DMatrix;
use serde::Serialize;

/// Points of the part that are assigned.
pub const ANCHORS: usize = 16;
/// Points of the whole that they are assigned to.
pub const CANDIDATES: usize = 160;
/// Sample points of the part and of the whole.
const SAMPLES: [usize; 2] = [1000, 2500];
/// Assignments of the first [`LEADING`] anchors that are kept from one to the next.
const BEAM: usize = 20_000;
/// Anchors whose assignments are told apart before the others follow.
const LEADING: usize = 4;
/// Different assignments of these, and how many are kept of each from anchor to anchor.
const BRANCHES: [usize; 2] = [150, 30];
/// Assignments that are refined.
const STARTS: usize = 8;
/// Candidates of an anchor, by the area around.
const LIKELY: usize = 60;
/// Radii within which area is compared, over √area of the whole.
const RADII: [f64; 4] = [0.1, 0.2, 0.3, 0.45];
/// Difference of distances, over √area of the whole, that an anchor without image costs for each other anchor.
const WITHOUT: f64 = 0.12;
/// Mean distance between images, over √area of the whole, from which two assignments differ; that of one image from which those of the
/// leading anchors do.
const APART: [f64; 2] = [0.05, 0.15];
/// Disagreement, over √area of the whole, up to which a pair takes part in a fit.
const AGREEING: f64 = 0.1;
/// Functions of the first step.
const FIRST: usize = 12;
/// A step adds one function, and one more for each so many.
const GROWTH: usize = 12;
/// Points at which orientation is compared, and neighbours of each.
const ORIENTED: [usize; 2] = [500, 6];
/// Functions that tell neighbours.
const FEW: usize = 30;

/// A mesh, as matching of parts sees it.
#[derive(Clone, Copy, Debug)]
pub struct PartialSide<'a> {
    /// Its surface.
    pub graph: &'a VertexGraph,
    /// Its functions, from a kernel of the same width as the other's.
    pub basis: &'a LocalBasis,
    /// Distances from anchors or candidates.
    pub rows: &'a DistanceRows,
    /// What distances are multiplied by: 1 becomes √area of the whole.
    pub unit: f64,
}

/// A refined map from the part to the whole.
#[derive(Clone, Debug, Serialize)]
pub struct PartialOutcome {
    /// Anchors that have an image.
    pub anchors: usize,
    /// Mean difference between the distances of a point and of its match from anchors, over √area of the whole.
    pub disagreement: f64,
    /// Share of the part's sample points whose distances agree with those of their matches.
    pub agreeing: f64,
    /// Agreement of orientation: near 1 right, near −1 mirrored.
    pub orientation: f64,
    /// The map C (functions of the whole × functions of the part): Φ_whole ≈ C Φ_part.
    #[serde(skip)]
    pub map: DMatrix<f64>,
}

impl PartialOutcome {
    fn rank(&self) -> f64 {
        self.disagreement / self.agreeing.max(1e-3)
    }
}

/// An anchor's candidate, or none.
type Image = Option<u32>;

/// Assignments of anchors to candidates, the likeliest first: `within[i][j]` are distances between anchors, `among[c][d]` between
/// candidates, `likely[i]` the candidates of anchor i, distances in the same units; one without image costs `without`.
///
/// ```
/// use nystrom_stream::apps::correspond::partial::assignments;
/// // Points of a line at 0, 3 and 4; the part has the last two.
/// let among = [[0., 3., 4.], [3., 0., 1.], [4., 1., 0.]].map(|row| row.to_vec());
/// let within = [[0., 1.], [1., 0.]].map(|row| row.to_vec());
/// let found = assignments(&within, &among, &[vec![0, 1, 2], vec![0, 1, 2]], 0.5);
/// assert_eq!(found[0], [Some(1), Some(2)]);
/// ```
pub fn assignments(within: &[Vec<f64>], among: &[Vec<f64>], likely: &[Vec<u32>], without: f64) -> Vec<Vec<Image>> {
    let follow = |beam: Vec<(f64, Vec<Image>)>, i: usize, most: usize| {
        let mut next: Vec<(f64, Vec<Image>)> = Vec::with_capacity(beam.len() * (likely[i].len() + 1));
        for (cost, images) in &beam {
            let extended = |image: Image, more: f64| {
                let mut images = images.clone();
                images.push(image);
                (cost + more, images)
            };
            for &c in &likely[i] {
                let mut more = 0.;
                for (j, image) in images.iter().enumerate() {
                    more += image.map_or(0.5 * without * without, |d| {
                        let difference = (within[i][j] - among[c as usize][d as usize]).abs();
                        difference * difference
                    });
                }
                if more <= without * without * i as f64 {
                    next.push(extended(Some(c), more));
                }
            }
            next.push(extended(None, without * without * i.max(1) as f64));
        }
        next.sort_by(|x, y| x.0.total_cmp(&y.0).then_with(|| x.1.cmp(&y.1)));
        next.truncate(most);
        next
    };
    let leading = LEADING.min(likely.len());
    let first = (0..leading).fold(vec![(0., Vec::new())], |beam, i| follow(beam, i, BEAM));
    let mut branches: Vec<(f64, Vec<Image>)> = Vec::new();
    for one in first {
        let most = |other: &Vec<Image>| images_apart(&one.1, other, among).into_iter().fold(0., f64::max);
        if branches.len() < BRANCHES[0] && branches.iter().all(|(_, other)| most(other) > APART[1]) {
            branches.push(one);
        }
    }
    let finish =
        |branch| (leading..likely.len()).fold(vec![branch], |beam, i| follow(beam, i, BRANCHES[1])).swap_remove(0);
    let mut all: Vec<(f64, Vec<Image>)> = branches.into_iter().map(finish).collect();
    all.sort_by(|x, y| x.0.total_cmp(&y.0).then_with(|| x.1.cmp(&y.1)));
    all.into_iter().map(|(_, images)| images).collect()
}

/// Distances between the images of anchors; an image and none are far apart.
fn images_apart(one: &[Image], other: &[Image], among: &[Vec<f64>]) -> Vec<f64> {
    let apart = |(c, d): (&Image, &Image)| match (*c, *d) {
        (Some(c), Some(d)) => among[c as usize][d as usize],
        (None, None) => 0.,
        _ => 2. * APART[1],
    };
    one.iter().zip(other).map(apart).collect()
}

/// Area within each of [`RADII`] around the source of row `i`.
fn areas(side: PartialSide<'_>, i: usize) -> [f64; RADII.len()] {
    let mut sums = [0f64; RADII.len()];
    for (d, node) in side.rows.row(i).iter().zip(&side.graph.nodes[..]) {
        for (sum, radius) in sums.iter_mut().zip(RADII) {
            if side.unit * f64::from(*d) < radius {
                *sum += side.unit * side.unit * f64::from(node.area);
            }
        }
    }
    sums
}

/// How surfaces turn the same way at `pairs` of vertices and those near them: the cosine between the signed areas of triangles of points on
/// both; `near` are other pairs for each.
fn agreement(graphs: [&VertexGraph; 2], pairs: &[(u32, u32)], near: &[Vec<u32>]) -> f64 {
    let at = |s: usize, v: u32| wide(graphs[s].nodes[v as usize].centroid);
    let normal = |s: usize, v: u32| {
        let graph = graphs[s];
        let span = 2 * graph.ring_starts[v as usize] as usize..2 * graph.ring_starts[v as usize + 1] as usize;
        let mut sum = [0f64; 3];
        for pair in graph.ring[span].chunks_exact(2) {
            let one = cross(minus(at(s, pair[0]), at(s, v)), minus(at(s, pair[1]), at(s, v)));
            (0..3).for_each(|k| sum[k] += one[k]);
        }
        let length = dot(sum, sum).sqrt().max(1e-300);
        sum.map(|x| x / length)
    };
    let (mut mixed, mut squares) = (0f64, [0f64; 2]);
    for (&(v, w), others) in pairs.iter().zip(near) {
        let here = [v, w];
        let normals = [normal(0, v), normal(1, w)];
        for (k, &one) in others.iter().enumerate() {
            for &other in &others[k + 1..] {
                let area = |s: usize| {
                    let ends = [one, other].map(|p| {
                        let (v, w) = pairs[p as usize];
                        minus(at(s, [v, w][s]), at(s, here[s]))
                    });
                    dot(normals[s], cross(ends[0], ends[1]))
                };
                let areas = [area(0), area(1)];
                mixed += areas[0] * areas[1];
                (0..2).for_each(|s| squares[s] += areas[s] * areas[s]);
            }
        }
    }
    let norms = (squares[0] * squares[1]).sqrt();
    if norms > 0. { mixed / norms } else { 0. }
}

/// Samples of part and whole.
struct Sampled<'a> {
    sides: [PartialSide<'a>; 2],
    chosen: [Vec<u32>; 2],
    functions: [Points; 2],
}

impl Sampled<'_> {
    /// Functions of the part whose frequencies are those of the first `k` of the whole.
    fn as_high(&self, k: usize) -> usize {
        let [part, whole] = self.sides.map(|side| &side.basis.frequencies);
        part.partition_point(|&frequency| frequency <= whole[k - 1]).max(3).min(part.len())
    }

    /// Over the anchors with images, the median difference of distances from them at `v` of the part and `w` of the whole.
    fn disagreement(&self, images: &[Image], v: u32, w: u32) -> f64 {
        let [part, whole] = self.sides;
        let difference = |(i, image): (usize, &Image)| {
            let of_part = part.unit * f64::from(part.rows.row(i)[v as usize]);
            image.map(|c| (of_part - whole.unit * f64::from(whole.rows.row(c as usize)[w as usize])).abs())
        };
        let mut all: Vec<f64> = images.iter().enumerate().filter_map(difference).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied().unwrap_or(f64::INFINITY)
    }

    /// First matches, by distances from anchors.
    fn begin(&self, images: &[Image]) -> Vec<u32> {
        let kept: Vec<(usize, u32)> = images.iter().enumerate().filter_map(|(i, c)| Some((i, (*c)?))).collect();
        let points = |s: usize| -> Vec<Vec<f32>> {
            let row = |&(i, c): &(usize, u32)| self.sides[s].rows.row(if s == 0 { i } else { c as usize });
            let unit = self.sides[s].unit as f32;
            self.chosen[s].iter().map(|&v| kept.iter().map(|one| unit * row(one)[v as usize]).collect()).collect()
        };
        let (of_part, of_whole) = (points(0), points(1));
        nearest(of_part.iter().map(Vec::as_slice), of_whole.iter().map(Vec::as_slice), kept.len())
    }

    fn matched(&self, c: &DMatrix<f64>) -> Vec<u32> {
        let [part, whole] = &self.functions;
        let carried = ToA::new(&c.transpose()).carry_all(part);
        nearest((0..part.len()).map(|i| carried.at(i)), (0..whole.len()).map(|i| whole.at(i)), c.nrows())
    }

    fn refine(&self, images: &[Image]) -> PartialOutcome {
        let [part, whole] = &self.functions;
        let [in_part, in_whole] = &self.chosen;
        let mut found = self.begin(images);
        let mut k = FIRST.min(whole.dimensions);
        let apart = |found: &[u32]| -> Vec<f64> {
            found.iter().zip(in_part).map(|(&j, &v)| self.disagreement(images, v, in_whole[j as usize])).collect()
        };
        let map = loop {
            let apart = apart(&found);
            let pairs = found.iter().enumerate().map(|(i, &j)| (i as u32, j));
            let agreeing: Vec<(u32, u32)> = pairs.clone().filter(|(i, _)| apart[*i as usize] < AGREEING).collect();
            let few = agreeing.len() * 5 < found.len();
            let pairs = if few { pairs.collect() } else { agreeing };
            let map = fit_between(part, whole, &pairs, [self.as_high(k), k]);
            found = self.matched(&map);
            if k == whole.dimensions {
                break map;
            }
            k = (k + 1 + k / GROWTH).min(whole.dimensions);
        };
        let apart = apart(&found);
        let agreeing = apart.iter().filter(|&&one| one < AGREEING).count();
        let step = found.len().div_ceil(ORIENTED[0]).max(1);
        let some: Vec<usize> = (0..found.len()).step_by(step).filter(|&i| apart[i] < AGREEING).collect();
        let pairs: Vec<(u32, u32)> = some.iter().map(|&i| (in_part[i], in_whole[found[i] as usize])).collect();
        PartialOutcome {
            anchors: images.iter().flatten().count(),
            disagreement: apart.iter().map(|one| one.min(2. * AGREEING)).sum::<f64>() / apart.len().max(1) as f64,
            agreeing: agreeing as f64 / found.len().max(1) as f64,
            orientation: agreement(self.sides.map(|side| side.graph), &pairs, &self.neighbours(&some)),
            map,
        }
    }

    /// For each of `some` sample points of the part the nearest others, as places in `some`.
    fn neighbours(&self, some: &[usize]) -> Vec<Vec<u32>> {
        let points = self.functions[0].first(FEW);
        let square = |i: usize, j: usize| -> f32 {
            points.at(some[i]).iter().zip(points.at(some[j])).map(|(x, y)| (x - y) * (x - y)).sum()
        };
        let near = |i: usize| {
            let mut others: Vec<(f32, u32)> =
                (0..some.len()).filter(|&j| j != i).map(|j| (square(i, j), j as u32)).collect();
            others.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
            others.into_iter().take(ORIENTED[1]).map(|(_, j)| j).collect()
        };
        (0..some.len()).map(near).collect()
    }
}

fn nearest<'a>(
    queries: impl Iterator<Item = &'a [f32]>,
    targets: impl ExactSizeIterator<Item = &'a [f32]>,
    dimensions: usize,
) -> Vec<u32> {
    let targets = Targets::new(targets, dimensions);
    let mut found = Vec::new();
    targets.nearest(&queries.collect::<Vec<_>>(), &mut found);
    found
}

/// Maps of `part` (rows from anchors) to `whole` (rows from candidates), the likeliest first.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn match_part(part: PartialSide<'_>, whole: PartialSide<'_>, run: &Run) -> Result<Vec<PartialOutcome>> {
    let between = |side: PartialSide<'_>| -> Vec<Vec<f64>> {
        let at = |i: usize| {
            let row = side.rows.row(i);
            side.rows.landmarks.iter().map(|&v| side.unit * f64::from(row[v as usize])).collect()
        };
        (0..side.rows.len()).map(at).collect()
    };
    let around = |side: PartialSide<'_>| run.map_chunks(side.rows.len(), || (), |i, ()| Ok(areas(side, i)));
    let (of_part, of_whole) = (around(part)?, around(whole)?);
    let likely = |mine: &[f64; RADII.len()]| -> Vec<u32> {
        // Near a cut there is less around.
        let unlike = |theirs: &[f64; RADII.len()]| -> f64 {
            let one = |(x, y): (&f64, &f64)| if x > y { x - y } else { 0.3 * (y - x) };
            mine.iter().zip(theirs).map(one).zip(RADII).map(|(d, radius)| d / (radius * radius)).sum()
        };
        let mut order: Vec<(f64, u32)> =
            of_whole.iter().enumerate().map(|(c, theirs)| (unlike(theirs), c as u32)).collect();
        order.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        order.into_iter().take(LIKELY).map(|(_, c)| c).collect()
    };
    let likely: Vec<Vec<u32>> = of_part.iter().map(likely).collect();
    let among = between(whole);
    let mut starts: Vec<Vec<Image>> = Vec::new();
    for one in assignments(&between(part), &among, &likely, WITHOUT) {
        let elsewhere = |other: &Vec<Image>| {
            images_apart(&one, other, &among).iter().sum::<f64>() > APART[0] * one.len().max(1) as f64
        };
        if starts.len() < STARTS && starts.iter().all(elsewhere) {
            starts.push(one);
        }
    }
    let sides = [part, whole];
    let chosen = [0, 1].map(|s| sample(&sides[s].graph.nodes, SAMPLES[s], run.seed, "points of parts"));
    let functions = [0, 1].map(|s| Points {
        dimensions: sides[s].basis.count,
        values: chosen[s].iter().flat_map(|&v| sides[s].basis.at(v as usize)).copied().collect(),
    });
    let sampled = Sampled { sides, chosen, functions };
    let mut found = run.map_chunks(starts.len(), || (), |k, ()| Ok(sampled.refine(&starts[k])))?;
    let best = found.iter().map(|one| one.orientation).fold(f64::NEG_INFINITY, f64::max);
    if best >= TELLING {
        found.retain(|one| one.orientation >= 0.5 * best);
    }
    found.sort_by(|x, y| x.rank().total_cmp(&y.rank()));
    Ok(found)
}
