//! Reflections found from signs of smooth functions.
//!
//! Each of the first functions of a symmetric surface is either even or odd under the reflection, so a reflection can
//! be found from one of few combinations of signs. No tips are needed: those of an armadillo differ by more than the
//! matching tolerates. Each combination gives a map of samples; the likeliest are refined together with the maps from
//! tips. Those that preserve distances best and reverse orientation are refined on all cells, and the first that is a
//! reflection beyond doubt is taken. If there is none, the best and the best from tips are refitted to distances,
//! since smooth functions cannot follow thin limbs. What they turn instead of reflecting is grown again. Cost: .05 to
//! .12 s of processor time for 2,000 cells.

use super::cell_map::{CellMap, FarthestSamples, Surface};
use super::cell_paths::Row;
use super::functions::{FunctionMap, Functions, more};
use super::tips::tips;
use crate::base::Result;
use crate::base::sort::sort_by;
use crate::store::run::Run;

/// Number of samples, chosen as farthest points.
const SAMPLES: usize = 128;
/// Number of functions whose sign may change.
const SIGNS: usize = 7;
/// Number of sign combinations that are refined.
const STARTS: usize = 24;
/// Number of functions up to which maps of samples are refined.
const ENOUGH: usize = 20;
/// A sample that moves less than this (first), in units of √(total area), counts as staying in place; maximum share of
/// the area that may stay.
const STAYS: (f32, f32) = (0.15, 0.6);
/// Number of maps examined, and of those refined on all cells.
const EXAMINED: [usize; 2] = [8, 2];
/// Two maps are the same if all but this share (first) of the area is mapped to within this length (second) of each
/// other.
const SAME: (f32, f32) = (0.15, 0.1);
/// Maximum number of tips of which half must move in a refitted map.
const TIPS: usize = 10;
/// Maximum orientation of maps of few functions: it must be reversed on most of the surface.
const TURNED: f64 = -0.3;

/// The samples of a surface.
struct Samples {
    cell: Vec<u32>,
    rows: Vec<Row>,
    /// The nearest sample of each cell (S).
    owner: Vec<usize>,
    /// Area share of each sample's cells.
    mass: Vec<f32>,
}

/// A map of samples, its matrix, and how poorly it preserves distances.
struct Start {
    image: Vec<usize>,
    matrix: FunctionMap,
    error: f32,
}

/// A reflection found from signs or from the maps `initial`; `None` if there is none beyond doubt.
///
/// # Errors
/// Cancellation.
pub fn reflection(surface: &Surface, initial: &[CellMap], run: &Run) -> Result<Option<CellMap>> {
    let samples = Samples::new(surface);
    let functions = Functions::new(surface.cells, surface.shares, &samples.rows);
    run.cancel.check()?;
    let mut examined: Vec<Start> = Vec::new();
    let mut likely = Vec::new();
    for start in samples.starts(&functions, initial) {
        if likely.len() == EXAMINED[1] || examined.len() == EXAMINED[0] {
            break;
        }
        if examined.iter().any(|other| samples.are_same(&start, other)) {
            continue;
        }
        let mut image: Vec<u32> = samples.owner.iter().map(|&owner| samples.cell[start.image[owner]]).collect();
        functions.mapped(&start.matrix, &mut image, &surface.paths);
        if surface.turning(&image) <= TURNED && surface.moves_far(&image) {
            likely.push(image);
        }
        examined.push(start);
    }
    let mut best: Option<(f64, CellMap)> = None;
    for (image, orthogonal) in likely.iter().flat_map(|image| [(image, false), (image, true)]) {
        run.cancel.check()?;
        let mut image = image.clone();
        functions.refine(&mut image, ENOUGH, orthogonal, &surface.paths);
        let map = surface.polished(image);
        if surface.is_smooth_reflection(&map) {
            return Ok(Some(map));
        }
        let dissimilarity = surface.mean_dissimilarity(&map);
        if best.as_ref().is_none_or(|(least, _)| dissimilarity < *least) {
            best = Some((dissimilarity, map));
        }
    }
    let turned = initial.iter().filter(|map| surface.turning(&map.image) <= TURNED);
    let dissimilarity = |map: &CellMap| surface.mean_dissimilarity(map);
    let from_tips = turned.min_by(|a, b| dissimilarity(a).total_cmp(&dissimilarity(b)));
    let tips = tips(surface, TIPS);
    for map in best.map(|(_, map)| map).iter().chain(from_tips).filter(|map| surface.may_be_reflection(map)) {
        run.cancel.check()?;
        let refitted = surface.refitted(&map.image);
        if surface.is_reflection_of_trunk(&refitted, &tips) {
            return Ok(Some(refitted));
        }
        if surface.may_be_reflection(&refitted) {
            let regrown = surface.regrown(&refitted.image);
            if surface.is_regrown_reflection(&regrown, &tips) {
                return Ok(Some(regrown));
            }
        }
    }
    Ok(None)
}

impl Samples {
    fn new(surface: &Surface) -> Self {
        let mut samples = surface.samples.clone();
        let reached = (0..surface.paths.len() as u32).filter(|&i| surface.reached[i as usize]);
        samples.extend(SAMPLES, reached, &surface.paths);
        let FarthestSamples { cell, owner, .. } = samples;
        let mut rows = surface.rows.clone();
        rows.extend(surface.paths.rows(&cell[rows.len()..]));
        let mut mass = vec![0.0; SAMPLES];
        owner.iter().zip(surface.shares).for_each(|(&k, &share)| mass[k] += share as f32);
        Self { cell, rows, owner, mass }
    }

    fn apart(&self, a: usize, b: usize) -> f32 {
        self.rows[a][self.cell[b] as usize]
    }

    /// Maps that move the surface, best first.
    fn starts(&self, functions: &Functions, initial: &[CellMap]) -> Vec<Start> {
        let k = SIGNS + 1;
        let signs = (1..1 << SIGNS).map(|signs| self.start(functions, FunctionMap::of_signs(signs, k)));
        let mut best: Vec<Start> = signs.filter(|start| self.moves(start)).collect();
        sort_by(&mut best, |a, b| a.error.total_cmp(&b.error));
        best.truncate(STARTS);
        let matrices = best
            .into_iter()
            .map(|start| start.matrix)
            .chain(initial.iter().map(|map| functions.fitted(&map.image, k).made_orthogonal()));
        let refined = matrices.map(|matrix| {
            let mut start = self.start(functions, matrix);
            let mut k = k;
            while k < ENOUGH {
                k = more(k).min(ENOUGH);
                let pairs = start.image.iter().enumerate().map(|(x, &y)| (self.cell[x], self.cell[y], self.mass[x]));
                start = self.start(functions, functions.of_pairs(pairs, k).made_orthogonal());
            }
            start
        });
        let mut all: Vec<Start> = refined.filter(|start| self.moves(start)).collect();
        sort_by(&mut all, |a, b| a.error.total_cmp(&b.error));
        all
    }

    /// The map of samples given by a matrix.
    fn start(&self, functions: &Functions, matrix: FunctionMap) -> Start {
        let image = |&cell: &u32| functions.nearest(&functions.image(cell, &matrix), &self.cell);
        let image: Vec<usize> = self.cell.iter().map(image).collect();
        let mut error = 0.0;
        for (i, &a) in image.iter().enumerate() {
            let dissimilarity = |(j, &b): (usize, &usize)| self.mass[j] * (self.apart(i, j) - self.apart(a, b)).abs();
            error += self.mass[i] * image[..i].iter().enumerate().map(dissimilarity).sum::<f32>();
        }
        Start { image, matrix, error }
    }

    fn moves(&self, start: &Start) -> bool {
        let stay = |&(i, &image): &(usize, &usize)| self.apart(i, image) < STAYS.0;
        start.image.iter().enumerate().filter(stay).map(|(i, _)| self.mass[i]).sum::<f32>() < STAYS.1
    }

    fn are_same(&self, a: &Start, b: &Start) -> bool {
        let images = a.image.iter().zip(&b.image);
        let differ = images.zip(&self.mass).filter(|((a, b), _)| self.apart(**a, **b) > SAME.1);
        differ.map(|(_, mass)| mass).sum::<f32>() <= SAME.0
    }
}

#[cfg(test)]
mod tests {
    use super::super::cell_paths::UNREACHED;
    use super::super::posed_body::{LEFT_ARM, LEFT_LEG, RIGHT_ARM, RIGHT_LEG, cells_of, on_surface};
    use super::*;

    #[test]
    fn limbs_go_to_limbs() {
        on_surface(|cells, surface| {
            let map = reflection(surface, &[], &Run::new(&())).unwrap().unwrap();
            let image = &map.image;
            // A leg of this body is a stick, as long as the other and alike in front and at the back: it may be its own
            // image.
            for (from, to) in [(LEFT_ARM, vec![RIGHT_ARM]), (LEFT_LEG, vec![LEFT_LEG, RIGHT_LEG])] {
                let from = cells_of(cells, from);
                let to: Vec<usize> = to.into_iter().flat_map(|limb| cells_of(cells, limb)).collect();
                let reached = from.iter().filter(|&&i| to.contains(&(image[i] as usize)));
                let share = reached.count() as f64 / from.len() as f64;
                assert!(share > 0.95, "{share}");
            }
            assert!(surface.turning(image) < -0.7 && surface.moves_far(image));
            let moved = |&x: &u32| surface.apart(x, image[x as usize]);
            let by_distance = |a: &u32, b: &u32| moved(a).total_cmp(&moved(b));
            let farthest = (0..image.len() as u32).max_by(by_distance).unwrap();
            let nearest = (0..image.len() as u32).min_by(by_distance).unwrap();
            assert!(surface.is_reflection_of_trunk(&map, &[farthest, nearest]));
            assert!(!surface.is_reflection_of_trunk(&map, &[nearest]), "no tip moves");
        });
    }

    #[test]
    fn every_cell_belongs_to_its_nearest_sample() {
        on_surface(|_, surface| {
            let samples = Samples::new(surface);
            for (i, &owner) in samples.owner.iter().enumerate() {
                let least = samples.rows.iter().map(|row| row[i]).fold(UNREACHED, f32::min);
                assert!((samples.rows[owner][i] - least).abs() < 1e-5, "{i}");
            }
            assert!((samples.mass.iter().sum::<f32>() - 1.0).abs() < 1e-4);
        });
    }
}
