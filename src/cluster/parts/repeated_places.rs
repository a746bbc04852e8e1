//! Repeated places: a boundary that could as well be at another place, which is not cut, is dropped.
//!
//! The thread of a screw, a rippled grip or the wire of a spring is cut somewhere if its ends are hardly one part, but
//! each turn looks like the next. So the surface around each boundary is moved along, and fitted to the surface at
//! other places by rigid motions. Where it fits, the surface is the same, and so should be the decision: C is averaged
//! over all such places, cut or not. If there are at least three, one of them is not cut, and that mean is above ½,
//! the two parts are joined. If all are cut, as between beads, or the mean is small, the parts stay.
//!
//! A stretch of surface tells places apart only if it has some hundred cells: shorter ones of thin limbs fit nearly
//! everywhere. On 190 models of the benchmark only the ripples of two grips fit, with a mean distance of .6 to .67 cell
//! radii; the next best, of a smooth handle, have .82 and more (docs/dev/segmentation-experiments.md).
//!
//! Cost: some milliseconds for each boundary whose C is not small: two rows of distances over the cells, and searches
//! for some points each at the places where as much surface lies as at the boundary, more where these fit.

use super::cell_graph::CellGraph;
use super::cell_labels::{compact, majorities};
use super::ensemble::Superfaces;
use super::hierarchy::HALF;
use super::matrix::Square;
use super::symmetry::stretches::{Along, Stretch};
use crate::base::Result;
use crate::base::sort::sort_by;
use crate::base::union_find::Forest;
use crate::base::vector::distance;
use crate::cluster::mirror::{NearestPoint, PointSet};
use crate::store::run::Run;
use std::borrow::Borrow;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Minimum mean of C, a probability, across a boundary that may be dropped: one with less is a place to cut.
const MIN_BOUNDARY_C: f64 = 0.3;
/// Maximum mean distance of the moved surface from the nearest cells, by position and normal, in cell radii.
const FITS: f64 = 0.82;
/// Number of cells around a boundary that are moved.
const CELLS: usize = 100;
/// Minimum distance from the boundary within which cells are moved, in cell radii.
const MIN_REACH: f64 = 4.0;
/// The same as a share of the radius of a circle as long as the boundary.
const MIN_REACH_SHARE: f64 = 0.5;
/// A stretch that reaches farther than this, in cell radii, is too long to be moved.
const MAX_REACH: f64 = 16.0;
/// A stretch with more of its normals along one line is of a sheet or a plate: people cut arms off these, although arms
/// look the same all along. Those of a round limb have a half, those of a plate four times as wide as thick .8.
const FLAT: f64 = 0.7;
/// Minimum number of places that look alike.
const MIN_PLACES: usize = 3;
/// Steps of the distance from the boundary, in cell radii.
const STEP: f64 = 1.0;
/// Minimum share of a place that lies in one part if the place is not cut.
const WHOLE: f64 = 0.8;

/// The boundary between two parts.
#[derive(Debug, Default)]
struct Boundary {
    /// Its pairs of cells, the one of the part with the smaller number first.
    pairs: Vec<[u32; 2]>,
    /// The common length of each pair.
    lengths: Vec<f64>,
}

impl Boundary {
    fn length(&self) -> f64 {
        self.lengths.iter().sum()
    }

    /// The mean by length of a function of the pairs.
    fn mean(&self, of: impl Fn([u32; 2]) -> f64) -> f64 {
        self.pairs.iter().zip(&self.lengths).map(|(&pair, length)| length * of(pair)).sum::<f64>() / self.length()
    }
}

/// A place that looks like that of a boundary.
struct Place {
    centre: [f64; 3],
    /// How far the surface around the boundary reaches.
    reach: f64,
    /// How well it fits ([`FITS`]).
    error: f64,
    /// The parts that the two sides lie in.
    parts: [u32; 2],
    /// The mean of C across it.
    c: f64,
}

impl Place {
    /// Whether the stretches of surface at this and at the other places hardly overlap.
    fn is_apart_from<P: Borrow<Place>>(&self, others: &[P]) -> bool {
        let is_apart = |other: &Place| distance(self.centre, other.centre) > self.reach.max(other.reach);
        others.iter().all(|other| is_apart(other.borrow()))
    }
}

/// Places that look alike.
#[derive(Clone, Default)]
struct Alike<'a> {
    /// The mean of C across each.
    c: Vec<f64>,
    /// Those that are not cut.
    whole: Vec<&'a Place>,
}

impl Alike<'_> {
    fn is_repeated(&self) -> bool {
        !self.whole.is_empty() && self.c.len() >= MIN_PLACES && self.c.iter().sum::<f64>() > HALF * self.c.len() as f64
    }
}

/// A surface, and the probabilities C that its superfaces belong together.
#[derive(Clone, Copy)]
pub(super) struct Repetition<'a> {
    pub(super) cells: &'a CellGraph,
    pub(super) nearest: &'a NearestPoint<'a>,
    pub(super) superfaces: &'a Superfaces,
    pub(super) co_association: &'a Square,
    pub(super) run: &'a Run<'a>,
}

impl Repetition<'_> {
    /// Joins parts whose boundaries are at places that look alike, and are not all cut. Takes labels of the superfaces
    /// (R) and returns them numbered by first appearance.
    ///
    /// # Errors
    /// Cancellation.
    pub(super) fn without_repeated(&self, label: &[u32]) -> Result<Vec<u32>> {
        let (mut label, mut parts) = compact(label);
        let steps = self.steps();
        // Each round leaves fewer parts; more places are not cut then.
        loop {
            let of_cell = self.superfaces.cell_labels(&label);
            let mut joined = Forest::new(parts);
            self.joins(&of_cell, &steps)?.into_iter().for_each(|[a, b]| _ = joined.join(a, b));
            label.iter_mut().for_each(|part| *part = joined.find(*part));
            let before = parts;
            (label, parts) = compact(&label);
            if parts == before {
                return Ok(label);
            }
        }
    }

    /// The parts to be joined: neighbours, given the part of each cell (S).
    fn joins(&self, part: &[u32], steps: &[Vec<(u32, f64)>]) -> Result<Vec<[u32; 2]>> {
        let boundaries: Vec<([u32; 2], Boundary)> = self.boundaries(part).into_iter().collect();
        let c: Vec<f64> = boundaries.iter().map(|(_, boundary)| boundary.mean(|pair| self.c(pair))).collect();
        let places = |k: usize, (): &mut ()| {
            let (parts, boundary) = &boundaries[k];
            Ok(if c[k] < MIN_BOUNDARY_C { Vec::new() } else { self.places(boundary, *parts, part, steps) })
        };
        let places = self.run.map_chunks(boundaries.len(), || (), places)?;
        // Boundaries at places that look alike, and such places that are not cut.
        let mut alike = Forest::new(boundaries.len());
        let mut whole: Vec<(u32, Place)> = Vec::new();
        for (k, place) in (0..).zip(places).flat_map(|(k, places)| places.into_iter().map(move |place| (k, place))) {
            let [a, b] = place.parts;
            if a == b {
                whole.push((k, place));
            } else if let Ok(other) = boundaries.binary_search_by_key(&[a.min(b), a.max(b)], |(parts, _)| *parts) {
                alike.join(k, other as u32);
            }
        }
        sort_by(&mut whole, |a, b| a.1.error.total_cmp(&b.1.error));
        let mut groups: Vec<Alike> = vec![Alike::default(); c.len()];
        for (k, c) in (0..).zip(&c) {
            groups[alike.find(k) as usize].c.push(*c);
        }
        for (k, place) in &whole {
            let group = &mut groups[alike.find(*k) as usize];
            if place.is_apart_from(&group.whole) {
                group.whole.push(place);
                group.c.push(place.c);
            }
        }
        let mut is_repeated = |k: usize| groups[alike.find(k as u32) as usize].is_repeated();
        Ok((0..c.len()).filter(|&k| c[k] >= MIN_BOUNDARY_C && is_repeated(k)).map(|k| boundaries[k].0).collect())
    }

    /// The neighbours of each cell with their distances.
    fn steps(&self) -> Vec<Vec<(u32, f64)>> {
        let centre = |i: u32| self.cells.centre[i as usize];
        let beside =
            |(i, near): (u32, Vec<u32>)| near.into_iter().map(|j| (j, distance(centre(i), centre(j)))).collect();
        (0..).zip(self.cells.neighbours()).map(beside).collect()
    }

    fn boundaries(&self, part: &[u32]) -> BTreeMap<[u32; 2], Boundary> {
        let mut boundaries: BTreeMap<[u32; 2], Boundary> = BTreeMap::new();
        for (&[i, j], &length) in self.cells.pairs.iter().zip(&self.cells.length) {
            let [a, b] = [part[i as usize], part[j as usize]];
            if a != b {
                let pair = if a < b { [i, j] } else { [j, i] };
                let boundary = boundaries.entry([a.min(b), a.max(b)]).or_default();
                boundary.pairs.push(pair);
                boundary.lengths.push(length);
            }
        }
        boundaries
    }

    fn c(&self, cells: [u32; 2]) -> f64 {
        let [x, y] = cells.map(|i| self.superfaces.of_cell[i as usize] as usize);
        if x == y { 1.0 } else { self.co_association[(x, y)] }
    }

    /// The places that look like the `boundary` between two `parts`, apart from each other and from the boundary.
    fn places(&self, boundary: &Boundary, parts: [u32; 2], part: &[u32], steps: &[Vec<(u32, f64)>]) -> Vec<Place> {
        let PointSet { points, shares, radius } = self.nearest.set();
        let along = Along::new(&boundary.pairs, points, shares, steps);
        let Some((around, reach)) = self.around(boundary, parts, part, &along.height) else { return Vec::new() };
        let Some(here) = along.ring(0.0, radius) else { return Vec::new() };
        let stretch = Stretch { nearest: self.nearest, cells: &around };
        if stretch.flatness() > FLAT {
            return Vec::new();
        }
        let centre = stretch.centre(&around);
        let fitted = along.levels(STEP * radius).into_iter().filter_map(|height| {
            let there = along.ring(height, radius).filter(|there| here.may_be(there))?;
            let (error, image) = stretch.fitted(stretch.start(&here, &there)?);
            let moved = stretch.centre(&image);
            (error <= FITS && distance(moved, centre) > reach).then_some((error, image, moved))
        });
        let side = |cell: u32| usize::from(along.height[cell as usize] > 0.0);
        let mut found: Vec<Place> = fitted
            .filter_map(|(error, image, centre)| {
                let parts = cut_at(
                    around
                        .iter()
                        .zip(&image)
                        .map(|(&cell, &image)| (side(cell), part[image as usize], shares[cell as usize])),
                )?;
                let to = |cell: u32| around.binary_search(&cell).map_or(cell, |k| image[k]);
                Some(Place { centre, reach, error, parts, c: boundary.mean(|pair| self.c(pair.map(to))) })
            })
            .collect();
        sort_by(&mut found, |a, b| a.error.total_cmp(&b.error));
        let mut apart: Vec<Place> = Vec::new();
        for place in found {
            if place.is_apart_from(&apart) {
                apart.push(place);
            }
        }
        apart
    }

    /// The cells of the two `parts` around their boundary, ascending, and how far they reach. `None` if there are few.
    fn around(&self, boundary: &Boundary, parts: [u32; 2], part: &[u32], height: &[f64]) -> Option<(Vec<u32>, f64)> {
        let radius = self.nearest.set().radius;
        let mut inside: Vec<u32> = (0..part.len() as u32)
            .filter(|&i| parts.contains(&part[i as usize]) && height[i as usize].is_finite())
            .collect();
        let mut far: Vec<f64> = inside.iter().map(|&i| height[i as usize].abs()).collect();
        sort_by(&mut far, f64::total_cmp);
        let reach = far.get(CELLS)?.max(MIN_REACH * radius).max(MIN_REACH_SHARE * boundary.length() / TAU);
        inside.retain(|&i| height[i as usize].abs() <= reach);
        (reach <= MAX_REACH * radius).then_some((inside, reach))
    }
}

/// The parts in which most of either side of a place lies, from side, part and weight of its cells: one part twice if
/// the place is not cut. `None` if the place is cut elsewhere than between its sides.
fn cut_at(cells: impl Iterator<Item = (usize, u32, f64)>) -> Option<[u32; 2]> {
    let (sides, (part, weight)): (Vec<u32>, (Vec<u32>, Vec<f64>)) =
        cells.map(|(side, part, weight)| (side as u32, (part, weight))).unzip();
    let (most, all) = (majorities(&sides, 2, &part, &weight), weight.iter().sum::<f64>());
    let inside: f64 = part.iter().zip(&weight).filter(|(part, _)| **part == most[0]).map(|(_, weight)| weight).sum();
    (all > 0.0 && (most[0] != most[1] || inside >= WHOLE * all)).then_some([most[0], most[1]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::vector::unit;
    use crate::cluster::mirror::SurfacePoint;
    use crate::cluster::parts::symmetry::mirror_images::cell_points;

    /// Cells around the tube, and rings of a wave.
    const AROUND_TUBE: usize = 36;
    const WAVE: usize = 12;

    /// Labels of superfaces along a rippled tube, each a wave long, where neighbours have the given C, and others
    /// .1; the ripple at the boundary `deep` is deeper.
    fn joined(c: &[f64], label: &[u32], deep: Option<usize>) -> Vec<u32> {
        let waves = c.len() + 1;
        let radius = |k: usize| {
            let is_deep = deep.is_some_and(|deep| (k + WAVE / 2) / WAVE == deep + 1);
            3.0 + if is_deep { 1.2 } else { 0.3 } * (1.0 - libm::cos(TAU * k as f64 / WAVE as f64))
        };
        let mut cells = CellGraph::default();
        let at = |k: usize, j: usize| (k * AROUND_TUBE + j % AROUND_TUBE) as u32;
        for k in 0..waves * WAVE {
            let slope = 2.0 * (radius(k + 1) - radius(k));
            for j in 0..AROUND_TUBE {
                let (y, x) = libm::sincos(TAU * j as f64 / AROUND_TUBE as f64);
                cells.centre.push([radius(k) * x, radius(k) * y, 0.5 * k as f64]);
                cells.normal.push(unit([x, y, -slope]));
                cells.area.push(0.25);
                cells.pairs.push([at(k, j), at(k, j + 1)]);
                if k > 0 {
                    cells.pairs.push([at(k - 1, j), at(k, j)]);
                }
            }
        }
        cells.length = vec![0.5; cells.pairs.len()];
        let superfaces = Superfaces::kept(
            (0..cells.len()).map(|i| (i / AROUND_TUBE / WAVE) as u32).collect(),
            vec![0.25 * (AROUND_TUBE * WAVE) as f64; waves],
        )
        .unwrap();
        let mut all = Square::zeros(waves);
        for i in 0..waves {
            for j in 0..i {
                all.add_both(i, j, if i == j + 1 { c[j] } else { 0.1 });
            }
        }
        let points: Vec<SurfacePoint> = cell_points(&cells);
        let shares = cells.area_shares();
        let nearest = NearestPoint::new(PointSet::new(&points, &shares, cells.total_area()));
        let run = Run::new(&());
        let repetition =
            Repetition { cells: &cells, nearest: &nearest, superfaces: &superfaces, co_association: &all, run: &run };
        repetition.without_repeated(label).unwrap()
    }

    #[test]
    fn a_ripple_of_many_is_no_place_to_cut() {
        assert_eq!(joined(&[0.9, 0.9, 0.7, 0.9, 0.9, 0.9], &[0, 0, 0, 1, 1, 1, 1], None), [0; 7]);
        assert_eq!(joined(&[0.9, 0.4, 0.9, 0.9, 0.6, 0.9], &[0, 0, 1, 1, 1, 2, 2], None), [0; 7], "two of six");
    }

    #[test]
    fn a_place_of_its_own_stays() {
        let once = [0, 0, 0, 1, 1, 1, 1];
        assert_eq!(joined(&[0.9, 0.9, 0.7, 0.9, 0.9, 0.9], &once, Some(2)), once, "a deeper ripple");
        assert_eq!(joined(&[0.9, 0.9, 0.2, 0.9, 0.9, 0.9], &once, None), once, "C is small");
    }

    #[test]
    fn beads_that_are_all_cut_or_mostly_apart_stay() {
        let each: Vec<u32> = (0..7).collect();
        assert_eq!(joined(&[0.6; 6], &each, None), each);
        let all_but_one = [0, 1, 2, 2, 3, 4, 5];
        assert_eq!(joined(&[0.4, 0.4, 0.7, 0.4, 0.4, 0.4], &all_but_one, None), all_but_one);
    }

    #[test]
    fn a_place_that_is_cut_beside_its_middle_tells_nothing() {
        let cells = |parts: [u32; 10]| (0..10).map(move |k| (k / 5, parts[k], 1.0));
        assert_eq!(cut_at(cells([3; 10])), Some([3, 3]));
        assert_eq!(cut_at(cells([3, 3, 3, 3, 4, 4, 4, 4, 4, 4])), Some([3, 4]));
        assert_eq!(cut_at(cells([3, 3, 3, 3, 3, 3, 3, 3, 3, 4])), Some([3, 3]));
        assert_eq!(cut_at(cells([3, 3, 3, 3, 3, 3, 3, 3, 4, 4])), Some([3, 3]));
        assert_eq!(cut_at(cells([4, 4, 3, 3, 3, 3, 3, 3, 3, 4])), None);
        assert_eq!(cut_at([].into_iter()), None);
    }
}
