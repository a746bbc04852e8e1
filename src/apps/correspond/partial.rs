//! Matches a part with a whole: a scan with holes, a crop.
//!
//! Missing regions change every eigenfunction and every mean, so embeddings of a part and of a whole cannot be aligned.
//! Two things hardly change: distances along the surface between remaining points, and the heat kernel at a point until
//! heat reaches the boundary (Sun, Ovsjanikov, Guibas 2009, *A Concise and Provably Informative Multi-Scale
//! Signature*). Some [`ANCHORS`] points far apart on the part are assigned to candidates on the whole, one after the
//! other, by a beam search over the assignments whose pairwise distances and heat agree best ([`assignments`]). An
//! anchor may stay unassigned, at a cost. Each assignment is then improved anchor by anchor, until no anchor has a
//! better candidate.
//!
//! The distances of a point from the anchors determine its match. Maps are ranked by how far these distances differ,
//! by how much of the whole they cover and by heat at matched points; mirror images are recognised by local
//! orientation ([`agreement`]).
//!
//! Distances alone do not distinguish a horse's front from its back: both are a trunk with two legs and one more limb.
//! Heat does. Refining these maps between functions, as for maps of wholes, made them worse on six of seven crops,
//! since holes change functions.
//!
//! Cost: a front per candidate on the whole and two bases; the rest is constant, except for
//! 4 bytes per vertex of the part.

use super::align::{CONCLUSIVE_ORIENTATION, sample};
use super::functional::{Points, Targets};
use crate::base::Result;
use crate::base::sort::sort_by;
use crate::base::vector::{cross, dot, minus, wide};
use crate::distance::{DistanceRows, voronoi};
use crate::graph::VertexGraph;
use crate::spectral::local::LocalBasis;
use crate::store::Run;
use serde::Serialize;

/// Number of points of the part that are assigned.
pub const ANCHORS: usize = 16;
/// Number of points of the whole to which they may be assigned.
pub const CANDIDATES: usize = 160;
/// Number of sample points of the part and of the whole.
const SAMPLES: [usize; 2] = [1000, 2500];
/// Beam width: assignments of the first [`LEADING`] anchors kept from one anchor to the next.
const BEAM: usize = 20_000;
/// Number of anchors that define branches of the search.
const LEADING: usize = 4;
/// Number of branches, and of assignments kept per branch from anchor to anchor.
const BRANCHES: [usize; 2] = [150, 30];
/// Number of assignments that are evaluated.
const STARTS: usize = 8;
/// Number of candidates per anchor, by heat and by surrounding area.
const LIKELY: usize = 60;
/// Radii within which area is compared, over √area of the whole.
const RADII: [f64; 4] = [0.1, 0.2, 0.3, 0.45];
/// Cost of an unassigned anchor per other anchor, as a difference of distances over √area of the whole.
const WITHOUT: f64 = 0.12;
/// Mean distance between images, over √area of the whole, above which two assignments differ; and the distance of one
/// image above which the branches differ.
const APART: [f64; 2] = [0.05, 0.15];
/// Maximum number of improvement passes over an assignment.
const IMPROVEMENTS: usize = 5;
/// Diffusion times, in units of 1 / the highest frequency.
const TIMES: [f64; 5] = [4., 8., 16., 32., 64.];
/// Weights of the squared difference of log heat, capped at 1, and of the excess or lack of area.
const PRICES: [f64; 2] = [0.05, 0.003];
/// Added to the difference of heat, so that random differences do not decide.
const HEAT_FLOOR: f64 = 0.02;
/// Maximum disagreement, over √area of the whole, for a point's distances to agree with those of its match.
const AGREEING: f64 = 0.1;
/// Number of points at which orientation is compared, and of neighbours of each.
const ORIENTED: [usize; 2] = [500, 6];
/// Number of functions for finding neighbours.
const FEW: usize = 30;

/// A mesh, as used by partial matching.
#[derive(Clone, Copy, Debug)]
pub struct PartialSide<'a> {
    /// Its surface.
    pub graph: &'a VertexGraph,
    /// Its functions, from a kernel of the same width as those of the other.
    pub basis: &'a LocalBasis,
    /// Distances from anchors or candidates.
    pub rows: &'a DistanceRows,
    /// The factor for distances, such that 1 becomes √area of the whole.
    pub unit: f64,
}

/// A map from the part to the whole.
#[derive(Clone, Debug, Serialize)]
pub struct PartialOutcome {
    /// Number of anchors with an image.
    pub anchors: usize,
    /// Mean difference between the distances of a point and of its match from anchors, over √area of the whole.
    pub disagreement: f64,
    /// Share of the part's sample points whose distances agree with those of their matches.
    pub agreeing: f64,
    /// Number of different matches, over the part's sample points.
    pub coverage: f64,
    /// Mean difference of log heat between a point and its match.
    pub heat_difference: f64,
    /// Share of points and times at which heat has not reached the boundary, so that it is comparable.
    pub heat_comparable: f64,
    /// Agreement of orientation: near 1 correct, near −1 mirrored.
    pub orientation: f64,
    /// The candidate of each anchor.
    #[serde(skip)]
    pub images: Vec<Image>,
}

impl PartialOutcome {
    fn rank(&self) -> f64 {
        let distances = self.disagreement / (self.agreeing * self.coverage * self.coverage).max(1e-3);
        distances * libm::pow(HEAT_FLOOR + self.heat_difference, self.heat_comparable)
    }
}

/// An anchor's candidate, or none.
pub type Image = Option<u32>;

/// Assignments of anchors to candidates, likeliest first: `within[i][j]` are distances between anchors, `among[c][d]`
/// between candidates, `own[i][c]` is the cost of candidate c for anchor i alone; all in the same units, squared for
/// costs. An unassigned anchor costs `without`².
///
/// ```
/// use nystrom_stream::apps::correspond::partial::assignments;
/// // Points of a line at 0, 3 and 4; the part has the last two.
/// let among = [[0., 3., 4.], [3., 0., 1.], [4., 1., 0.]].map(|row| row.to_vec());
/// let within = [[0., 1.], [1., 0.]].map(|row| row.to_vec());
/// let own = [[0.; 3], [0., 0.1, 0.]].map(|row| row.to_vec());
/// assert_eq!(assignments(&within, &among, &own, 0.5)[0], [Some(1), Some(2)]);
/// ```
pub fn assignments(within: &[Vec<f64>], among: &[Vec<f64>], own: &[Vec<f64>], without: f64) -> Vec<Vec<Image>> {
    let pairs = Costs { within, among, own, without };
    let likely: Vec<Vec<u32>> = own.iter().map(|own| cheapest(own, LIKELY)).collect();
    let follow = |beam: Vec<(f64, Vec<Image>)>, i: usize, most: usize| {
        let mut next: Vec<(f64, Vec<Image>)> = Vec::with_capacity(beam.len() * (likely[i].len() + 1));
        for (cost, images) in &beam {
            let alone = pairs.of(i, None, images, 0..i);
            for image in likely[i].iter().map(|&c| Some(c)).chain([None]) {
                let more = pairs.of(i, image, images, 0..i);
                if image.is_none_or(|c| more <= alone + own[i][c as usize]) {
                    let mut images = images.clone();
                    images.push(image);
                    next.push((cost + more, images));
                }
            }
        }
        sort_by(&mut next, |x, y| x.0.total_cmp(&y.0).then_with(|| x.1.cmp(&y.1)));
        next.truncate(most);
        next
    };
    let leading = LEADING.min(own.len());
    let first = (0..leading).fold(vec![(0., Vec::new())], |beam, i| follow(beam, i, BEAM));
    let mut branches: Vec<(f64, Vec<Image>)> = Vec::new();
    for one in first {
        let most = |other: &Vec<Image>| images_apart(&one.1, other, among).into_iter().fold(0., f64::max);
        if branches.len() < BRANCHES[0] && branches.iter().all(|(_, other)| most(other) > APART[1]) {
            branches.push(one);
        }
    }
    let finish = |branch| {
        let mut beam = (leading..own.len()).fold(vec![branch], |beam, i| follow(beam, i, BRANCHES[1]));
        pairs.improved(beam.swap_remove(0).1)
    };
    let mut all: Vec<(f64, Vec<Image>)> = branches.into_iter().map(finish).collect();
    sort_by(&mut all, |x, y| x.0.total_cmp(&y.0).then_with(|| x.1.cmp(&y.1)));
    all.into_iter().map(|(_, images)| images).collect()
}

/// The indices of the `most` least of `costs`, in ascending order.
fn cheapest(costs: &[f64], most: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..costs.len() as u32).collect();
    sort_by(&mut order, |&c, &d| costs[c as usize].total_cmp(&costs[d as usize]).then(c.cmp(&d)));
    order.truncate(most);
    order
}

/// The costs of assignments; see [`assignments`].
struct Costs<'a> {
    within: &'a [Vec<f64>],
    among: &'a [Vec<f64>],
    own: &'a [Vec<f64>],
    without: f64,
}

impl Costs<'_> {
    /// The cost of `image` for anchor `i`, alone and together with the images of `others`.
    fn of(&self, i: usize, image: Image, images: &[Image], others: std::ops::Range<usize>) -> f64 {
        let price = self.without * self.without;
        let Some(c) = image else { return price * others.filter(|&j| j != i).count().max(1) as f64 };
        let pair = |j: usize| {
            images[j].map_or(0.5 * price, |d| {
                let difference = self.within[i][j] - self.among[c as usize][d as usize];
                difference * difference
            })
        };
        self.own[i][c as usize] + others.filter(|&j| j != i).map(pair).sum::<f64>()
    }

    /// The cost of `images` and the images themselves, after each anchor in turn has taken its best candidate given the
    /// others.
    fn improved(&self, mut images: Vec<Image>) -> (f64, Vec<Image>) {
        let n = images.len();
        for _ in 0..IMPROVEMENTS {
            let before = images.clone();
            for i in 0..n {
                let choices = (0..self.among.len() as u32).map(Some).chain([None]);
                let costs = choices.map(|image| (self.of(i, image, &images, 0..n), image));
                images[i] = costs.min_by(|x, y| x.0.total_cmp(&y.0)).and_then(|(_, image)| image);
            }
            if images == before {
                break;
            }
        }
        ((0..n).map(|i| self.of(i, images[i], &images, 0..i)).sum(), images)
    }
}

/// Distances between the images of anchors in two assignments; an image and none are far apart.
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

/// Whether surfaces have the same orientation at `pairs` of vertices: the cosine between the signed areas of triangles
/// of points on both; `near` are nearby pairs for each.
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

/// How much heat remains near points: the logarithm of the heat kernel at [`TIMES`], relative to the highest frequency
/// of the whole.
struct Heat<'a> {
    sides: [PartialSide<'a>; 2],
    /// Numbers of functions of part and whole, up to the same frequency.
    counts: [usize; 2],
    highest: f64,
    /// Distances from the boundary of the part, within reach of heat; elsewhere infinite (vertices of the part).
    boundary: Vec<f32>,
}

impl<'a> Heat<'a> {
    fn new(sides: [PartialSide<'a>; 2], run: &Run) -> Result<Self> {
        let [part, whole] = sides;
        let [low, all] = sides.map(|side| &side.basis.frequencies);
        let highest = all.last().copied().unwrap_or(1.).max(1e-300);
        let counts = [low.partition_point(|&frequency| frequency <= highest).max(1).min(low.len()), all.len()];
        let graph = part.graph;
        let sources: Vec<u32> = (0..graph.len() as u32).filter(|&v| graph.is_open(v)).collect();
        let mut boundary = vec![f32::INFINITY; graph.len()];
        let most = (0..TIMES.len()).map(|t| reach(whole, t)).fold(0., f64::max) / part.unit;
        voronoi::within(graph.csr(), &sources, most as f32, &mut boundary, run)?;
        Ok(Self { sides, counts, highest, boundary })
    }

    /// The log heat of vertex `v` of the part or the whole.
    fn at(&self, side: usize, v: u32) -> [f64; TIMES.len()] {
        let PartialSide { graph, basis, unit, .. } = self.sides[side];
        let area = (unit * unit * graph.facts.area).max(1e-300);
        let functions = || basis.at(v as usize)[..self.counts[side]].iter().zip(&basis.frequencies);
        TIMES.map(|time| {
            let one = |(x, frequency): (&f32, &f64)| libm::exp(-time * frequency / self.highest) * f64::from(x * x);
            libm::log((functions().map(one).sum::<f64>() / area).max(1e-300))
        })
    }

    /// The times at which heat from `v` of the part has not reached the boundary.
    fn intact(&self, v: u32) -> impl Iterator<Item = usize> {
        let [part, whole] = self.sides;
        let away = part.unit * f64::from(self.boundary[v as usize]);
        (0..TIMES.len()).filter(move |&t| away > reach(whole, t))
    }
}

/// The reach of heat at [`TIMES`]`[t]` on `whole`, over √area: two standard deviations. By Weyl's law, the highest
/// frequency follows from the number of functions.
fn reach(whole: PartialSide<'_>, t: usize) -> f64 {
    2. * (TIMES[t] / (std::f64::consts::TAU * whole.basis.count.max(1) as f64)).sqrt()
}

/// Samples of part and whole.
struct Sampled<'a> {
    sides: [PartialSide<'a>; 2],
    chosen: [Vec<u32>; 2],
    heat: &'a Heat<'a>,
}

impl Sampled<'_> {
    /// The median difference, over the anchors with images, between the distances from them at `v` of the part and `w`
    /// of the whole.
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

    /// Initial matches, by distances from anchors.
    fn begin(&self, images: &[Image]) -> Vec<u32> {
        let kept: Vec<(usize, u32)> = images.iter().enumerate().filter_map(|(i, c)| Some((i, (*c)?))).collect();
        let points = |s: usize| -> Vec<Vec<f32>> {
            let row = |&(i, c): &(usize, u32)| self.sides[s].rows.row(if s == 0 { i } else { c as usize });
            let unit = self.sides[s].unit as f32;
            self.chosen[s].iter().map(|&v| kept.iter().map(|one| unit * row(one)[v as usize]).collect()).collect()
        };
        let (of_part, of_whole) = (points(0), points(1));
        let targets = Targets::new(of_whole.iter().map(Vec::as_slice), kept.len());
        targets.nearest(of_part.iter().map(Vec::as_slice))
    }

    /// Evaluates an assignment by the matches that follow from distances to anchors.
    fn evaluate(&self, images: Vec<Image>) -> PartialOutcome {
        let [in_part, in_whole] = &self.chosen;
        let found = self.begin(&images);
        let pairs: Vec<(u32, u32)> = in_part.iter().zip(&found).map(|(&v, &j)| (v, in_whole[j as usize])).collect();
        let apart: Vec<f64> = pairs.iter().map(|&(v, w)| self.disagreement(&images, v, w)).collect();
        let count = pairs.len().max(1) as f64;
        let (mut heat, mut intact) = (0., 0usize);
        for &(v, w) in &pairs {
            let [of_part, of_whole] = [self.heat.at(0, v), self.heat.at(1, w)];
            for t in self.heat.intact(v) {
                heat += (of_part[t] - of_whole[t]).abs();
                intact += 1;
            }
        }
        let mut hit = found;
        hit.sort_unstable();
        hit.dedup();
        let agreeing = apart.iter().filter(|&&one| one < AGREEING).count();
        let step = pairs.len().div_ceil(ORIENTED[0]).max(1);
        let some: Vec<usize> = (0..pairs.len()).step_by(step).filter(|&i| apart[i] < AGREEING).collect();
        let oriented: Vec<(u32, u32)> = some.iter().map(|&i| pairs[i]).collect();
        PartialOutcome {
            anchors: images.iter().flatten().count(),
            disagreement: apart.iter().map(|one| one.min(2. * AGREEING)).sum::<f64>() / count,
            agreeing: agreeing as f64 / count,
            coverage: hit.len() as f64 / count,
            heat_difference: heat / intact.max(1) as f64,
            heat_comparable: intact as f64 / (count * TIMES.len() as f64),
            orientation: agreement(self.sides.map(|side| side.graph), &oriented, &self.neighbours(&some)),
            images,
        }
    }

    /// For each of `some` sample points of the part the nearest others, as indices into `some`.
    fn neighbours(&self, some: &[usize]) -> Vec<Vec<u32>> {
        let (basis, chosen) = (self.sides[0].basis, &self.chosen[0]);
        let values = chosen.iter().flat_map(|&v| basis.at(v as usize)).copied().collect();
        let points = Points { dimensions: basis.count, values }.first(FEW);
        let square = |i: usize, j: usize| -> f32 {
            points.at(some[i]).iter().zip(points.at(some[j])).map(|(x, y)| (x - y) * (x - y)).sum()
        };
        let near = |i: usize| {
            let mut others: Vec<(f32, u32)> =
                (0..some.len()).filter(|&j| j != i).map(|j| (square(i, j), j as u32)).collect();
            sort_by(&mut others, |x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
            others.into_iter().take(ORIENTED[1]).map(|(_, j)| j).collect()
        };
        (0..some.len()).map(near).collect()
    }
}

/// Maps of `part` (rows from anchors) to `whole` (rows from candidates), likeliest first.
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
    let sides = [part, whole];
    let heat = Heat::new(sides, run)?;
    let of_candidates: Vec<_> = whole.rows.landmarks.iter().map(|&w| heat.at(1, w)).collect();
    let own = |(i, &v): (usize, &u32)| -> Vec<f64> {
        let mine = heat.at(0, v);
        let cost = |(heat_there, around): (&[f64; TIMES.len()], &[f64; RADII.len()])| {
            let squares = heat.intact(v).map(|t| (mine[t] - heat_there[t]).abs().min(1.).powi(2));
            // Near a cut there is less area around.
            let one = |(x, y): (&f64, &f64)| if x > y { x - y } else { 0.3 * (y - x) };
            let unlike = of_part[i].iter().zip(around).map(one).zip(RADII).map(|(d, radius)| d / (radius * radius));
            PRICES[0] * squares.sum::<f64>() + PRICES[1] * unlike.sum::<f64>()
        };
        of_candidates.iter().zip(&of_whole).map(cost).collect()
    };
    let own: Vec<Vec<f64>> = part.rows.landmarks.iter().enumerate().map(own).collect();
    let among = between(whole);
    let mut starts: Vec<Vec<Image>> = Vec::new();
    for one in assignments(&between(part), &among, &own, WITHOUT) {
        let elsewhere = |other: &Vec<Image>| {
            images_apart(&one, other, &among).iter().sum::<f64>() > APART[0] * one.len().max(1) as f64
        };
        if starts.len() < STARTS && starts.iter().all(elsewhere) {
            starts.push(one);
        }
    }
    let chosen = [0, 1].map(|s| sample(&sides[s].graph.nodes, SAMPLES[s], run.seed, "points of parts"));
    let sampled = Sampled { sides, chosen, heat: &heat };
    let mut found = run.map_chunks(starts.len(), || (), |k, ()| Ok(sampled.evaluate(starts[k].clone())))?;
    let best = found.iter().map(|one| one.orientation).fold(f64::NEG_INFINITY, f64::max);
    if best >= CONCLUSIVE_ORIENTATION {
        found.retain(|one| one.orientation >= 0.5 * best);
    }
    sort_by(&mut found, |x, y| x.rank().total_cmp(&y.rank()));
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{stream, unit};

    #[test]
    fn the_first_assignment_is_the_cheapest_of_all() {
        let (anchors, candidates, without) = (4, 6, 0.4);
        for seed in 0..20 {
            let mut draw = stream(seed, "assignments");
            let mut places =
                |n: usize| -> Vec<[f64; 2]> { (0..n).map(|_| [unit(&mut draw), unit(&mut draw)]).collect() };
            let (part, whole) = (places(anchors), places(candidates));
            let between = |p: &[[f64; 2]]| -> Vec<Vec<f64>> {
                let apart = |x: &[f64; 2], y: &[f64; 2]| (x[0] - y[0]).hypot(x[1] - y[1]);
                p.iter().map(|x| p.iter().map(|y| apart(x, y)).collect()).collect()
            };
            let own: Vec<Vec<f64>> =
                (0..anchors).map(|_| (0..candidates).map(|_| 0.1 * unit(&mut draw)).collect()).collect();
            let (within, among) = (between(&part), between(&whole));
            let costs = Costs { within: &within, among: &among, own: &own, without };
            let total = |images: &[Image]| (0..anchors).map(|i| costs.of(i, images[i], images, 0..i)).sum::<f64>();
            let all = (0..(candidates + 1).pow(anchors as u32)).map(|code| -> Vec<Image> {
                let digit = |i: usize| code / (candidates + 1).pow(i as u32) % (candidates + 1);
                (0..anchors).map(|i| (digit(i) < candidates).then_some(digit(i) as u32)).collect()
            });
            let least = all.map(|images| total(&images)).fold(f64::INFINITY, f64::min);
            let found = total(&assignments(&within, &among, &own, without)[0]);
            assert!((found - least).abs() < 1e-12, "seed {seed}: {found} {least}");
        }
    }
}
