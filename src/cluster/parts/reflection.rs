//! Left and right of a posed body: the map of the surface onto itself that keeps distances along it and turns it over.
//!
//! A body that walks or sits has no mirror plane, but its legs are still as long as each other. Cells are mapped as their distances
//! from anchors say, cells whose images are known. Anchors begin with [`tips`], matched in the few likeliest ways, and one more place:
//! distances from tips alone do not tell front from back, so each likely image of it begins a map of its own. Then more and more
//! samples become anchors, with the images that fit the anchors so far. At last each image is found again from all the others.
//!
//! Where none of these is a reflection beyond doubt ([`super::cell_map`]), [`signs`] searches another way, and begins from them too.
//! Everything is a function of the cells. Cost: .04 to .08 s of processor time and some megabytes for 2,000 cells, whatever the size of
//! the mesh, and as much for the other search.

use super::anchors::Anchors;
use super::cell_graph::CellGraph;
use super::cell_map::CellMap;
use super::cell_paths::{CellPaths, Row, UNREACHED};
use super::signs;
use super::tips::{Matching, matchings, tips};
use super::twins::Twins;
use crate::base::Result;
use crate::base::vector::distance;
use crate::store::run::Run;
use std::f64::consts::PI;

/// Fewer cells have no shape to speak of.
const LEAST_CELLS: usize = 200;
/// Share of the area that must be in one piece.
const WHOLE: f64 = 0.97;
/// Samples, farthest from each other.
const SAMPLES: usize = 64;
/// Samples that become anchors, step by step; those nearer than this length to an anchor, in units of √(total area), are left out.
const GROWTH: [(usize, f32); 3] = [(12, 0.1), (28, 0.06), (SAMPLES, 0.04)];
/// Matchings of tips that are tried.
const MATCHINGS: usize = 4;
/// Likely images of the first sample: how many, how far apart, and how much less likely than the likeliest.
const PLACES: (usize, f64, f32) = (3, 0.08, 0.04);
/// Of the maps of the first samples: how many go on, how far apart they are in the mean, and how much worse than the best.
const GO_ON: (usize, f32, f64) = (2, 0.06, 1.6);
/// Rounds in which images are found again.
const ROUNDS: usize = 4;
/// Nearest anchors that tell the image of an anchor, and of a cell.
const NEAREST: [usize; 2] = [24, 12];
/// Anchors nearer than this count alike.
const NEAR: f32 = 0.05;
/// What the mean distance from all of the surface counts, against 1/d of an anchor at d.
const MEAN: f32 = 4.0;
/// Twins whose distances differ by this many cell radii are none.
const REACH: f64 = 3.0;

/// The reflection of a posed body with cells of `shares` of the area (S); `None` where there is none that is beyond doubt.
///
/// # Errors
/// Cancellation.
pub fn reflection(cells: &CellGraph, shares: &[f64], run: &Run) -> Result<Option<Twins>> {
    let Some(surface) = Surface::new(cells, shares) else { return Ok(None) };
    let begun = surface.begun();
    let places: Vec<u32> = begun.iter().map(|begun| begun.place).collect();
    let rows = surface.paths.rows(&places);
    let started = run.map_chunks(
        begun.len(),
        || (),
        |k, ()| {
            let Begun { anchors, first, place } = &begun[k];
            let mut anchors = anchors.clone();
            anchors.add([surface.samples[*first], *place], [&surface.rows[*first], &rows[k]]);
            surface.grow(&mut anchors, GROWTH[0]);
            Ok(anchors)
        },
    )?;
    let going_on = distinct(started);
    let maps = run.map_chunks(
        going_on.len(),
        || (),
        |k, ()| {
            let mut anchors = going_on[k].clone();
            GROWTH[1..].iter().for_each(|&growth| surface.grow(&mut anchors, growth));
            for _ in 0..ROUNDS {
                let next = surface.again(&anchors);
                let still = next.cell == anchors.cell;
                anchors = next;
                if still {
                    break;
                }
            }
            let map = surface.map(&anchors);
            Ok((surface.is_reflection(&map), map))
        },
    )?;
    let unlike = |map: &CellMap| surface.mean_unlike(map);
    let all = maps.iter().filter(|(found, _)| *found).map(|(_, map)| map);
    let best = all.min_by(|a, b| unlike(a).total_cmp(&unlike(b))).cloned();
    let best = match best {
        Some(map) => Some(map),
        None => signs::reflection(&surface, &maps.into_iter().map(|(_, map)| map.twin).collect::<Vec<_>>(), run)?,
    };
    Ok(best.map(|map| {
        let doubt = map.unlike.iter().zip(&map.back).map(|(unlike, back)| unlike.max(back / 2.0) / REACH);
        Twins { weight: doubt.map(|doubt| (-doubt.powi(4)).exp()).collect(), twin: map.twin }
    }))
}

/// The best of `maps` that differ from each other.
fn distinct(maps: Vec<Anchors>) -> Vec<Anchors> {
    let mut maps: Vec<(f64, Anchors)> = maps.into_iter().map(|anchors| (anchors.error(), anchors)).collect();
    maps.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (most, apart, worse) = GO_ON;
    let limit = worse * maps.first().map_or(0.0, |(best, _)| *best);
    let mut kept: Vec<Anchors> = Vec::new();
    for (error, anchors) in maps {
        if error <= limit && kept.len() < most && kept.iter().all(|other| anchors.apart(other) >= apart) {
            kept.push(anchors);
        }
    }
    kept
}

/// The beginning of a map: matched tips, a sample and its likely image.
struct Begun {
    anchors: Anchors,
    /// Number of the sample.
    first: usize,
    place: u32,
}

/// What maps are found on.
pub struct Surface<'a> {
    pub(super) cells: &'a CellGraph,
    pub(super) shares: &'a [f64],
    /// Of a disk of the mean cell's area.
    pub(super) radius: f64,
    pub(super) paths: CellPaths,
    pub(super) samples: Vec<u32>,
    /// Rows of the samples.
    pub(super) rows: Vec<Row>,
    /// Mean distance of each cell from the whole surface (S).
    pub(super) mean: Vec<f32>,
    /// Whether each cell is on the piece that is mapped (S).
    pub(super) reached: Vec<bool>,
}

impl<'a> Surface<'a> {
    /// `None` where cells are few or in pieces.
    pub(super) fn new(cells: &'a CellGraph, shares: &'a [f64]) -> Option<Self> {
        let n = cells.len();
        if n < LEAST_CELLS {
            return None;
        }
        let mut paths = CellPaths::new(cells);
        let mut near = vec![UNREACHED; n];
        let middle = (0..n).rev().max_by(|&a, &b| shares[a].total_cmp(&shares[b]))?;
        let piece = paths.lower(middle as u32, UNREACHED, &mut near);
        if piece.iter().map(|&i| shares[i as usize]).sum::<f64>() < WHOLE {
            return None;
        }
        let reached: Vec<bool> = near.iter().map(|&d| d < UNREACHED).collect();
        let mut next = *piece.last()?;
        near.fill(UNREACHED);
        let mut order = paths.lower(next, UNREACHED, &mut near);
        order.extend((0..n as u32).filter(|&i| !reached[i as usize]));
        paths.sweep_in(order);
        near.fill(UNREACHED);
        let (mut samples, mut owner) = (Vec::new(), vec![0; n]);
        for k in 0..SAMPLES {
            samples.push(next);
            paths.lower(next, UNREACHED, &mut near).iter().for_each(|&i| owner[i as usize] = k);
            let farther = |a: u32, b: u32| if near[b as usize] > near[a as usize] { b } else { a };
            next = piece.iter().copied().fold(next, farther);
        }
        let rows = paths.rows(&samples);
        let mut mass = [0.0; SAMPLES];
        owner.iter().zip(shares).for_each(|(&k, share)| mass[k] += share);
        let mean_of = |i: usize| rows.iter().zip(mass).map(|(row, m)| m * f64::from(row[i])).sum::<f64>() as f32;
        let mean = (0..n).map(mean_of).collect();
        let radius = (cells.total_area() / (n as f64 * PI)).sqrt();
        Some(Self { cells, shares, radius, paths, samples, rows, mean, reached })
    }

    /// How far apart two cells are.
    pub(super) fn apart(&self, a: u32, b: u32) -> f64 {
        distance(self.cells.centre[a as usize], self.cells.centre[b as usize])
    }

    /// Maps to begin with.
    fn begun(&self) -> Vec<Begun> {
        let tips = tips(&self.paths, &self.mean, |i| self.reached[i as usize]);
        let rows = self.paths.rows(&tips);
        let mut begun = Vec::new();
        for Matching { image, .. } in matchings(&tips, &rows, &self.mean).iter().take(MATCHINGS) {
            let mut anchors = Anchors::default();
            for (i, j) in
                image.iter().enumerate().filter_map(|(i, image)| image.map(|j| (i, j))).filter(|(i, j)| i <= j)
            {
                anchors.add([tips[i], tips[j]], [&rows[i], &rows[j]]);
            }
            let far: Vec<f32> = self.samples.iter().map(|&sample| anchors.distance(sample)).collect();
            let first = (0..SAMPLES).fold(0, |a, b| if far[b] > far[a] { b } else { a });
            for place in self.places(self.samples[first], &anchors) {
                begun.push(Begun { anchors: anchors.clone(), first, place });
            }
        }
        begun
    }

    /// Where `sample` may go.
    fn places(&self, sample: u32, anchors: &Anchors) -> Vec<u32> {
        let unlike = self.unlike(sample, anchors, None);
        let is_least = |&i: &u32| self.paths.steps(i).all(|(j, _)| unlike[j as usize] >= unlike[i as usize]);
        let mut least: Vec<u32> =
            (0..self.paths.len() as u32).filter(|&i| self.reached[i as usize]).filter(is_least).collect();
        least.sort_by(|&a, &b| unlike[a as usize].total_cmp(&unlike[b as usize]));
        let (most, apart, worse) = PLACES;
        let mut places: Vec<u32> = Vec::new();
        for i in least {
            let best = places.first().map_or(i, |&best| best);
            let close = unlike[i as usize] < unlike[best as usize] + worse;
            if close && places.len() < most && places.iter().all(|&other| self.apart(i, other) > apart) {
                places.push(i);
            }
        }
        places
    }

    /// How unlike `cell` is each cell's place among the images of anchors (S), in units of length.
    fn unlike(&self, cell: u32, anchors: &Anchors, except: Option<usize>) -> Vec<f32> {
        let own = self.mean[cell as usize];
        let mut sum: Vec<f32> = self.mean.iter().map(|mean| MEAN * (mean - own).abs()).collect();
        let mut total = MEAN;
        for (d, k) in anchors.nearest(cell, NEAREST[0], except) {
            let weight = (d + NEAR).powi(-2);
            total += weight;
            let image = &anchors.row[anchors.image[k]];
            sum.iter_mut().zip(image.iter()).for_each(|(sum, there)| *sum += weight * (there - d).abs());
        }
        sum.iter_mut().for_each(|sum| *sum /= total);
        sum
    }

    /// The likeliest image of `cell`.
    fn likeliest(&self, cell: u32, anchors: &Anchors, except: Option<usize>) -> u32 {
        let unlike = self.unlike(cell, anchors, except);
        (0..unlike.len()).fold(0, |a, b| if unlike[b] < unlike[a] { b } else { a }) as u32
    }

    /// Makes anchors of the first samples that are farther than `least` from all.
    fn grow(&self, anchors: &mut Anchors, (count, least): (usize, f32)) {
        let more: Vec<usize> = (0..count).filter(|&k| anchors.distance(self.samples[k]) > least).collect();
        let images: Vec<u32> = more.iter().map(|&k| self.likeliest(self.samples[k], anchors, None)).collect();
        for ((&k, &image), row) in more.iter().zip(&images).zip(self.paths.rows(&images)) {
            anchors.add([self.samples[k], image], [&self.rows[k], &row]);
        }
    }

    /// Each second image again, from all other anchors. Most stay where they were, with their rows.
    fn again(&self, anchors: &Anchors) -> Anchors {
        let firsts: Vec<usize> = (0..anchors.cell.len()).filter(|&k| k <= anchors.image[k]).collect();
        let images: Vec<u32> = firsts.iter().map(|&k| self.likeliest(anchors.cell[k], anchors, Some(k))).collect();
        let kept = |(&k, &image): (&usize, &u32)| {
            let at = anchors.image[k];
            (anchors.cell[at] == image).then(|| anchors.row[at].clone())
        };
        let kept: Vec<Option<Row>> = firsts.iter().zip(&images).map(kept).collect();
        let moved: Vec<u32> =
            images.iter().zip(&kept).filter(|(_, kept)| kept.is_none()).map(|(&image, _)| image).collect();
        let mut new = self.paths.rows(&moved).into_iter();
        let mut out = Anchors::default();
        for ((&k, &image), kept) in firsts.iter().zip(&images).zip(kept) {
            if let Some(row) = kept.or_else(|| new.next()) {
                out.add([anchors.cell[k], image], [&anchors.row[k], &row]);
            }
        }
        out
    }

    /// The map of all cells that anchors make.
    fn map(&self, anchors: &Anchors) -> CellMap {
        let n = self.paths.len();
        let (mut twin, mut unlike): (Vec<u32>, Vec<f64>) = ((0..n as u32).collect(), vec![f64::INFINITY; n]);
        for x in (0..n).filter(|&x| self.reached[x]) {
            let nearest = anchors.nearest(x as u32, NEAREST[1], None);
            let Some(&(d, k)) = nearest.first() else { continue };
            // The image is about as far from the image of the nearest anchor.
            let from = &anchors.row[anchors.image[k]];
            let slack = (0.4 * d).max(4.0 * self.radius as f32);
            let (mut least, mut best) = (f32::INFINITY, x);
            let mut look = |y: usize| {
                if (from[y] - d).abs() > slack {
                    return;
                }
                let mut sum = MEAN * (self.mean[x] - self.mean[y]).abs();
                for &(d, k) in &nearest {
                    sum += (anchors.row[anchors.image[k]][y] - d).abs() / (d + NEAR);
                    if sum > least {
                        return;
                    }
                }
                if sum < least || y < best {
                    (least, best) = (sum, y);
                }
            };
            // Images of neighbours are a good guess, so that others are soon too far.
            self.paths.steps(x as u32).for_each(|(j, _)| look(twin[j as usize] as usize));
            (0..n).for_each(&mut look);
            twin[x] = best as u32;
            let total = nearest.iter().map(|(d, _)| 1.0 / (d + NEAR)).sum::<f32>() + MEAN;
            unlike[x] = f64::from(least / total) / self.radius;
        }
        self.measured(twin, unlike)
    }

    /// A map and how unlike cells and their images are, with the way back.
    fn measured(&self, twin: Vec<u32>, unlike: Vec<f64>) -> CellMap {
        let back = |x: u32| self.apart(x, twin[twin[x as usize] as usize]) / self.radius;
        CellMap { back: (0..twin.len() as u32).map(back).collect(), twin, unlike }
    }

    /// A smooth map whose images may be one step off: each takes the likeliest place there, by the images of the samples.
    pub(super) fn polished(&self, mut twin: Vec<u32>) -> CellMap {
        let images: Vec<u32> = self.samples.iter().map(|&sample| twin[sample as usize]).collect();
        let mut anchors = Anchors::default();
        for (k, row) in self.paths.rows(&images).iter().enumerate() {
            anchors.add([self.samples[k], images[k]], [&self.rows[k], row]);
        }
        let mut unlike = vec![f64::INFINITY; twin.len()];
        for x in (0..twin.len()).filter(|&x| self.reached[x]) {
            let nearest = anchors.nearest(x as u32, NEAREST[1], None);
            let sum = |y: u32| {
                let of = |&(d, k): &(f32, usize)| (anchors.row[anchors.image[k]][y as usize] - d).abs() / (d + NEAR);
                MEAN * (self.mean[x] - self.mean[y as usize]).abs() + nearest.iter().map(of).sum::<f32>()
            };
            let at = twin[x];
            let better = |best: (u32, f32), y: u32| {
                let sum = sum(y);
                if sum < best.1 { (y, sum) } else { best }
            };
            let (best, least) = self.paths.steps(at).map(|(y, _)| y).fold((at, sum(at)), better);
            let total = nearest.iter().map(|(d, _)| 1.0 / (d + NEAR)).sum::<f32>() + MEAN;
            (twin[x], unlike[x]) = (best, f64::from(least / total) / self.radius);
        }
        self.measured(twin, unlike)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::base::vector::{dot, minus};
    use std::collections::{BTreeMap, BTreeSet};
    use std::ops::Range;

    type Voxels = BTreeSet<[i32; 3]>;

    fn fill(voxels: &mut Voxels, [x, y, z]: [Range<i32>; 3]) {
        for x in x {
            voxels.extend(y.clone().flat_map(|y| z.clone().map(move |z| [x, y, z])));
        }
    }

    /// A body whose left half stands with its arm stretched out, while the right arm is raised and the right leg walks; it may lack
    /// them.
    pub fn posed(arm: bool, leg: bool) -> CellGraph {
        let mut body = Voxels::new();
        let mut add = |there: bool, blocks: &[[Range<i32>; 3]]| {
            for block in blocks.iter().filter(|_| there) {
                // Twice as fine.
                fill(&mut body, block.clone().map(|range| 2 * range.start..2 * range.end));
            }
        };
        add(true, &[[-3..3, 0..4, 0..12], [-2..2, 0..3, 12..17], [-1..1, -2..0, 13..15]]);
        add(true, &[[3..15, 1..2, 9..10], [1..2, 1..2, -16..0], [1..2, -2..1, -16..-15]]);
        add(arm, &[[-15..-3, 1..2, 9..10]]);
        add(leg, &[[-2..-1, 1..2, -16..0], [-2..-1, -2..1, -16..-15]]);
        let mut cells = surface(&body);
        let unit = 0.5 * (cells.len() as f64).sqrt();
        for (centre, normal) in cells.centre.iter_mut().zip(&mut cells.normal) {
            let at = centre.map(|x| x * unit);
            if at[0] < -5.0 {
                turn(centre, normal, [0, 2], [-5.0 / unit, 9.5 / unit]);
            } else if at[0] < 0.0 && at[2] < -2.0 {
                turn(centre, normal, [1, 2], [1.5 / unit, -2.0 / unit]);
            }
        }
        cells
    }

    /// Turns a place and a direction by .6 about a hinge, in the plane of two axes.
    fn turn(place: &mut [f64; 3], direction: &mut [f64; 3], [a, b]: [usize; 2], hinge: [f64; 2]) {
        let (sin, cos) = 0.6f64.sin_cos();
        for (v, [p, q]) in [(place, hinge), (direction, [0.0; 2])] {
            let (x, y) = (v[a] - p, v[b] - q);
            (v[a], v[b]) = (p + cos * x + sin * y, q + cos * y - sin * x);
        }
    }

    /// A cell for each square that bounds voxels.
    fn surface(body: &Voxels) -> CellGraph {
        let mut cells = CellGraph::default();
        let mut edges: BTreeMap<[i32; 3], Vec<u32>> = BTreeMap::new();
        for &voxel in body {
            for (axis, sign) in [(0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)] {
                let mut beside = voxel;
                beside[axis] += sign;
                if body.contains(&beside) {
                    continue;
                }
                // Twice the positions are whole.
                let mut centre = voxel.map(|x| 2 * x);
                centre[axis] += sign;
                for other in (0..3).filter(|&other| other != axis) {
                    for step in [-1, 1] {
                        let mut edge = centre;
                        edge[other] += step;
                        edges.entry(edge).or_default().push(cells.area.len() as u32);
                    }
                }
                let mut normal = [0.0; 3];
                normal[axis] = f64::from(sign);
                cells.normal.push(normal);
                cells.centre.push(centre.map(|x| 0.5 * f64::from(x)));
                cells.area.push(1.0);
            }
        }
        let unit = 2.0 * (0.25 * cells.area.len() as f64).sqrt();
        cells.centre.iter_mut().for_each(|centre| *centre = centre.map(|x| x / unit));
        cells.area.iter_mut().for_each(|area| *area /= unit * unit);
        cells.pairs = edges.into_values().map(|both| [both[0], both[1]]).collect();
        // How far each turns towards the other, in right angles: above 0 where concave.
        let turning = |&[i, j]: &[u32; 2]| {
            dot(minus(cells.centre[j as usize], cells.centre[i as usize]), cells.normal[i as usize]).signum()
                * (1.0 - dot(cells.normal[i as usize], cells.normal[j as usize]))
        };
        let turning: Vec<f64> = cells.pairs.iter().map(turning).collect();
        cells.concave = turning.iter().map(|turn| turn.max(0.0)).collect();
        cells.convex = turning.iter().map(|turn| (-turn).max(0.0)).collect();
        cells.length = vec![1.0 / unit; cells.pairs.len()];
        cells
    }

    /// Whether a place, in units of the blocks, is on each.
    pub const LEFT_ARM: fn([f64; 3]) -> bool = |x| x[0] > 4.0;
    pub const RIGHT_ARM: fn([f64; 3]) -> bool = |x| x[0] < -3.0 && x[2] > 5.0;
    pub const LEFT_LEG: fn([f64; 3]) -> bool = |x| x[0] > 0.0 && x[2] < -1.0;
    pub const RIGHT_LEG: fn([f64; 3]) -> bool = |x| x[0] < 0.0 && x[2] < 0.0;

    /// The numbers of the cells there.
    pub fn cells_of(cells: &CellGraph, part: fn([f64; 3]) -> bool) -> Vec<usize> {
        let unit = 0.5 * (cells.len() as f64).sqrt();
        (0..cells.len()).filter(|&i| part(cells.centre[i].map(|x| x * unit))).collect()
    }

    fn found(cells: &CellGraph) -> Option<Twins> {
        reflection(cells, &cells.area_shares(), &Run::new(&())).unwrap()
    }

    #[test]
    fn a_posed_body_has_a_left_and_a_right() {
        let cells = posed(true, true);
        let Twins { twin, weight } = found(&cells).unwrap();
        for (from, to) in [(LEFT_ARM, RIGHT_ARM), (LEFT_LEG, RIGHT_LEG)] {
            let (from, to) = (cells_of(&cells, from), cells_of(&cells, to));
            let share = from.iter().filter(|&&i| to.contains(&(twin[i] as usize))).count() as f64 / from.len() as f64;
            assert!(share > 0.95, "{share}");
        }
        assert!(weight.iter().sum::<f64>() > 0.9 * weight.len() as f64);
    }

    #[test]
    fn what_is_on_one_side_only_has_no_twin() {
        let cells = posed(false, true);
        let Twins { weight, .. } = found(&cells).unwrap();
        let mean = |part: Vec<usize>| part.iter().map(|&i| weight[i]).sum::<f64>() / part.len() as f64;
        let (arm, leg) = (mean(cells_of(&cells, |x| x[0] > 8.0)), mean(cells_of(&cells, LEFT_LEG)));
        assert!(arm < 0.1 && leg > 0.9, "{arm} {leg}");
    }

    #[test]
    fn a_body_that_lacks_an_arm_and_a_leg_is_mirrored_without_them() {
        let cells = posed(false, false);
        let Twins { twin, weight } = found(&cells).unwrap();
        let across = |i: usize| 0.5 * (cells.len() as f64).sqrt() * cells.centre[i][0];
        let trunk = cells_of(&cells, |x| x[0].abs() < 3.5 && x[2] > 1.0 && x[2] < 9.0);
        let mirrored = trunk.iter().filter(|&&i| (across(i) + across(twin[i] as usize)).abs() < 2.0).count();
        assert!(mirrored > trunk.len() * 19 / 20, "{mirrored} of {}", trunk.len());
        let arm = cells_of(&cells, |x| x[0] > 4.0 && x[0] < 12.0);
        assert!(arm.iter().map(|&i| weight[i]).sum::<f64>() < 0.2 * arm.len() as f64);
    }

    #[test]
    fn what_has_no_two_sides_or_no_shape_has_no_reflection() {
        // One side is convex where the other is concave.
        let mut cells = posed(true, true);
        for (k, pair) in cells.pairs.iter().enumerate() {
            if cells.centre[pair[0] as usize][0] < 0.0 {
                std::mem::swap(&mut cells.convex[k], &mut cells.concave[k]);
            }
        }
        assert!(found(&cells).is_none());
        // Two pieces, no pieces, a few cells.
        let centre = cells.centre.clone();
        cells.pairs.retain(|pair| pair.iter().all(|&i| centre[i as usize][2] > 0.0));
        assert!(found(&cells).is_none());
        cells.pairs.clear();
        assert!(found(&cells).is_none());
        let few = CellGraph {
            area: vec![1.0; 3],
            centre: vec![[0.0; 3]; 3],
            normal: vec![[0.0; 3]; 3],
            ..CellGraph::default()
        };
        assert!(found(&few).is_none());
    }
}
