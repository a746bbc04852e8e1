//! Maps of a surface onto itself, and the criteria for a reflection.
//!
//! A map counts as a reflection if it preserves distances, is its own inverse, moves most of the surface, maps convex
//! to convex and, for a smooth map, thick to thick, and reverses orientation: a swap of front and back, or a half turn,
//! preserves the order of neighbours around a cell. On thin limbs that order says little. For measurements see
//! `docs/dev/segmentation-experiments.md`. Cost: 1 or 2 ms for 2,000 cells.

use super::cell_paths::{CellPaths, Row, UNREACHED};
use crate::base::vector::{MapEach, cross, distance, dot, minus};
use crate::cluster::parts::cell_graph::CellGraph;
use crate::spectral::exp::exp64;
use std::f64::consts::PI;

/// With fewer cells, the shape is too coarse.
const LEAST_CELLS: usize = 200;
/// Minimum share of the area that must be in one piece.
const WHOLE: f64 = 0.97;
/// Number of samples, chosen as farthest points.
pub const SAMPLES: usize = 64;
/// Maximum mean difference of distances for a map to preserve them, in cell radii.
const CLOSE: f64 = 1.25;
/// Maximum mean distance from a cell to the image of its image, in cell radii.
const BACK: f64 = 1.25;
/// Cells that are mapped farther than this many radii count as moved, and the share of the area that must be.
const MOVED: (f64, f64) = (4.0, 0.6);
/// Maximum orientation: −1 if it is reversed everywhere, 1 if nowhere.
const TURNED: f64 = -0.7;
/// The same if cells count by the square of their thickness.
const TRUNK_TURNED: f64 = -0.8;
/// Minimum correlation between the convexity of cells and of their images.
const SHAPE: f64 = 0.4;
/// Distance, in units of √(total area), farther than which smooth maps, also refitted ones, must move a certain share
/// of the area: swapping front and back moves less.
const FAR: f64 = 0.15;
/// What smooth maps must fulfil.
const EVEN: Bounds = Bounds { dissimilarity: 1.15, back: BACK, moved: 0.42, shape: SHAPE, thickness: 0.3 };
/// The same if sides differ in length, such as those of an armadillo: distances may change more, but most of the
/// surface must move far, shapes must agree better, and orientation must be reversed everywhere. Maps of hands, thumb
/// for little finger, move .62 of the area far.
const UNEVEN: Bounds = Bounds { dissimilarity: 1.45, back: 1.4, moved: 0.7, shape: 0.65, thickness: 0.33 };
/// Maximum difference in thickness of a refitted map that is worth another fit.
const LIKELY_THICKNESS: f64 = 0.45;

/// Bounds for smooth maps.
struct Bounds {
    /// Maximum mean difference of distances, in cell radii.
    dissimilarity: f64,
    /// Maximum mean distance from a cell to the image of its image, in cell radii.
    back: f64,
    /// Minimum share of the area that moves farther than [`FAR`].
    moved: f64,
    /// Minimum correlation of convexity.
    shape: f64,
    /// Maximum mean difference in thickness between cells and their images, in units of its mean deviation.
    thickness: f64,
}

/// The surface on which maps are sought.
pub struct Surface<'a> {
    /// Its cells.
    pub cells: &'a CellGraph,
    /// Their shares of the area (S).
    pub shares: &'a [f64],
    /// Logarithm of the thickness behind each cell (S).
    log_thickness: &'a [f64],
    /// Radius of a disc of the mean cell's area.
    pub radius: f64,
    /// Paths between cells.
    pub paths: CellPaths,
    /// Cells far from each other.
    pub samples: FarthestSamples,
    /// Rows of the samples.
    pub rows: Vec<Row>,
    /// Mean distance of each cell from the whole surface (S).
    pub mean: Vec<f32>,
    /// Whether each cell is on the piece that is mapped (S).
    pub reached: Vec<bool>,
}

/// Farthest-point samples of a surface.
#[derive(Clone)]
pub struct FarthestSamples {
    /// The cell of each sample.
    pub cell: Vec<u32>,
    /// The nearest sample of each cell (S).
    pub owner: Vec<usize>,
    /// Its distance (S).
    near: Vec<f32>,
}

impl FarthestSamples {
    /// Starts with one sample.
    fn beginning(first: u32, paths: &CellPaths) -> Self {
        let (owner, near) = (vec![0; paths.len()], vec![UNREACHED; paths.len()]);
        let mut samples = Self { cell: Vec::new(), owner, near };
        samples.add(first, paths);
        samples
    }

    /// Adds samples among these cells, up to `count` in all.
    pub fn extend(&mut self, count: usize, among: impl Iterator<Item = u32> + Clone, paths: &CellPaths) {
        while let Some(&last) = self.cell.last().filter(|_| self.cell.len() < count) {
            let farther = |a: u32, b: u32| if self.near[b as usize] > self.near[a as usize] { b } else { a };
            self.add(among.clone().fold(last, farther), paths);
        }
    }

    fn add(&mut self, cell: u32, paths: &CellPaths) {
        let k = self.cell.len();
        self.cell.push(cell);
        paths.lower(cell, UNREACHED, &mut self.near).iter().for_each(|&i| self.owner[i as usize] = k);
    }
}

/// A map of the cells.
#[derive(Clone, Debug)]
pub struct CellMap {
    /// The image of each cell (S).
    pub image: Vec<u32>,
    /// Mean difference between the distances of each cell and those of its image, in cell radii (S).
    pub dissimilarity: Vec<f64>,
    /// Distance from each cell to the image of its image, in cell radii (S).
    pub back: Vec<f64>,
}

impl<'a> Surface<'a> {
    /// `None` if there are too few cells or the surface is in pieces.
    pub fn new(cells: &'a CellGraph, shares: &'a [f64], log_thickness: &'a [f64]) -> Option<Self> {
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
        let end = *piece.last()?;
        near.fill(UNREACHED);
        let mut order = paths.lower(end, UNREACHED, &mut near);
        order.extend((0..n as u32).filter(|&i| !reached[i as usize]));
        paths.sweep_in(order);
        let mut samples = FarthestSamples::beginning(end, &paths);
        samples.extend(SAMPLES, piece.iter().copied(), &paths);
        let rows = paths.rows(&samples.cell);
        let mut mass = [0.0; SAMPLES];
        samples.owner.iter().zip(shares).for_each(|(&k, share)| mass[k] += share);
        let mean_of = |i: usize| rows.iter().zip(mass).map(|(row, m)| m * f64::from(row[i])).sum::<f64>() as f32;
        let mean = (0..n).map(mean_of).collect();
        let radius = (cells.total_area() / (n as f64 * PI)).sqrt();
        Some(Self { cells, shares, log_thickness, radius, paths, samples, rows, mean, reached })
    }

    /// The distance between two cells.
    pub fn apart(&self, a: u32, b: u32) -> f64 {
        distance(self.cells.centre[a as usize], self.cells.centre[b as usize])
    }

    /// A map with the differences between cells and images, and the distances to the images of images.
    pub fn measured(&self, image: Vec<u32>, dissimilarity: Vec<f64>) -> CellMap {
        let back = |x: u32| self.apart(x, image[image[x as usize] as usize]) / self.radius;
        CellMap { back: (0..image.len() as u32).map(back).collect(), image, dissimilarity }
    }

    /// Area-weighted mean of values in cell radii, each capped at ten.
    fn mean_of(&self, values: &[f64]) -> f64 {
        values.iter().zip(self.shares).map(|(value, share)| share * value.min(10.0)).sum()
    }

    /// Mean difference between cells and their images.
    pub fn mean_dissimilarity(&self, map: &CellMap) -> f64 {
        self.mean_of(&map.dissimilarity)
    }

    /// Whether a map is a reflection beyond doubt.
    pub fn is_reflection(&self, map: &CellMap) -> bool {
        self.turns_over(map) && self.mean_dissimilarity(map) <= CLOSE && self.shape(map) >= SHAPE
    }

    /// The same for a smooth map: its images are not optimised one by one, so distances must be preserved better.
    pub fn is_smooth_reflection(&self, map: &CellMap) -> bool {
        self.fits(map, &EVEN) && self.turns_over(map)
    }

    /// The same for a refitted map, whose images may be on the wrong side of a thin limb: orientation is that of thick
    /// parts, unless sides are uneven. Half of the `tips` must move, since distances also allow front and back of a
    /// plump body to be swapped.
    pub fn is_reflection_of_trunk(&self, map: &CellMap, tips: &[u32]) -> bool {
        (self.fits(map, &EVEN) || (self.fits(map, &UNEVEN) && self.turning(&map.image) <= TURNED))
            && self.turning_of_trunk(&map.image) <= TRUNK_TURNED
            && self.moves_tips(map, tips)
    }

    /// The same for a regrown map: it had to reverse orientation, so it must do so everywhere. Octopuses have maps that
    /// swap most arms in the order of a reflection, but others not.
    pub fn is_regrown_reflection(&self, map: &CellMap, tips: &[u32]) -> bool {
        self.turning(&map.image) <= TURNED && self.is_reflection_of_trunk(map, tips)
    }

    /// Whether a map moves much of the surface far, preserves distances, is its own inverse, and maps convex to convex
    /// and thick to thick.
    fn fits(&self, map: &CellMap, bounds: &Bounds) -> bool {
        self.moved(&map.image, FAR) >= bounds.moved
            && self.mean_dissimilarity(map) <= bounds.dissimilarity
            && self.mean_of(&map.back) <= bounds.back
            && self.shape(map) >= bounds.shape
            && self.thickness_dissimilarity(&map.image) <= bounds.thickness
    }

    /// Whether a map moves half of the tips far along the surface: those of legs may be side by side.
    fn moves_tips(&self, map: &CellMap, tips: &[u32]) -> bool {
        let rows = self.paths.rows(tips);
        let moves = |(tip, row): &(&u32, &Row)| f64::from(row[map.image[**tip as usize] as usize]) > FAR;
        2 * tips.iter().zip(&rows).filter(moves).count() >= tips.len()
    }

    /// Whether a map may pass all checks once it preserves distances and reverses orientation better.
    pub fn may_be_reflection(&self, map: &CellMap) -> bool {
        self.moves_far(&map.image)
            && self.shape(map) >= SHAPE
            && self.thickness_dissimilarity(&map.image) <= LIKELY_THICKNESS
    }

    /// Whether a map moves the surface, reverses orientation and is its own inverse.
    fn turns_over(&self, map: &CellMap) -> bool {
        self.moved(&map.image, MOVED.0 * self.radius) >= MOVED.1
            && self.mean_of(&map.back) <= BACK
            && self.turning(&map.image) <= TURNED
    }

    /// Share of the area that a map moves farther than `far`.
    fn moved(&self, image: &[u32], far: f64) -> f64 {
        (0..image.len()).filter(|&x| self.apart(x as u32, image[x]) > far).map(|x| self.shares[x]).sum()
    }

    /// Whether a map moves regions far from the middle: swapping front and back does not.
    pub fn moves_far(&self, image: &[u32]) -> bool {
        self.moved(image, FAR) >= EVEN.moved
    }

    /// Mean difference between the logarithms of the thickness of cells and of their images, in units of its mean
    /// deviation. Distances and convexity may also allow a head to be mapped front to back, but the two differ in
    /// thickness.
    fn thickness_dissimilarity(&self, image: &[u32]) -> f64 {
        let thickness = self.log_thickness;
        let mean_of =
            |value: &dyn Fn(usize) -> f64| (0..thickness.len()).map(|x| self.shares[x] * value(x)).sum::<f64>();
        let mean = mean_of(&|x| thickness[x]);
        let spread = mean_of(&|x| (thickness[x] - mean).abs());
        mean_of(&|x| (thickness[x] - thickness[image[x] as usize]).abs()) / spread.max(1e-9)
    }

    /// The correlation between the convexity around cells and around their images: a terrain without distinct features
    /// is also mapped onto itself, but with mountains on valleys.
    fn shape(&self, map: &CellMap) -> f64 {
        let (cells, n) = (self.cells, self.paths.len());
        let mut around = vec![[0.0; 2]; n];
        for (k, pair) in cells.pairs.iter().enumerate() {
            for &i in pair {
                let [sum, length] = &mut around[i as usize];
                *sum += cells.length[k] * (cells.convex[k] - cells.concave[k]);
                *length += cells.length[k];
            }
        }
        let own: Vec<f64> = around.iter().map(|[sum, length]| sum / length.max(1e-300)).collect();
        let mut wide: Vec<[f64; 2]> = own.iter().zip(self.shares).map(|(x, share)| [share * x, *share]).collect();
        for &[i, j] in &cells.pairs {
            for (i, j) in [(i as usize, j as usize), (j as usize, i as usize)] {
                wide[i][0] += self.shares[j] * own[j];
                wide[i][1] += self.shares[j];
            }
        }
        let wide: Vec<f64> = wide.iter().map(|[sum, share]| sum / share.max(1e-300)).collect();
        let there: Vec<f64> = map.image.iter().map(|&image| wide[image as usize]).collect();
        let mean = |x: &[f64], y: &[f64]| (0..n).map(|i| self.shares[i] * x[i] * y[i]).sum::<f64>();
        let ones = vec![1.0; n];
        let (a, b) = (mean(&wide, &ones), mean(&there, &ones));
        let (aa, bb, ab) = (mean(&wide, &wide) - a * a, mean(&there, &there) - b * b, mean(&wide, &there) - a * b);
        if aa * bb > 1e-24 { ab / (aa * bb).sqrt() } else { 1.0 }
    }

    /// Whether a map preserves the order of cells around each other: 1, or reverses it: −1.
    pub fn turning(&self, image: &[u32]) -> f64 {
        self.turning_by(image, |x| self.shares[x])
    }

    /// The same, cells weighted by the square of their thickness.
    fn turning_of_trunk(&self, image: &[u32]) -> f64 {
        let thickness = |x: usize| self.log_thickness[x].min(self.log_thickness[image[x] as usize]);
        self.turning_by(image, |x| self.shares[x] * exp64(2.0 * thickness(x).min(0.0)))
    }

    fn turning_by(&self, image: &[u32], weight: impl Fn(usize) -> f64) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for x in 0..image.len() {
            let [turn, size] = self.turn_at(x as u32, image);
            sum += weight(x) * turn;
            total += weight(x) * size;
        }
        if total > 0.0 { sum / total } else { 1.0 }
    }

    /// The same around each sample.
    pub fn turning_at_samples(&self, image: &[u32]) -> Vec<f64> {
        let mut sums = vec![[0.0; 2]; self.samples.cell.len()];
        for (x, &owner) in self.samples.owner.iter().enumerate() {
            let turn = self.turn_at(x as u32, image);
            (0..2).for_each(|k| sums[owner][k] += self.shares[x] * turn[k]);
        }
        sums.iter().map(|[sum, total]| if *total > 0.0 { sum / total } else { 1.0 }).collect()
    }

    /// Products of triangles around a cell and of their images: the sum, and that of absolute values.
    fn turn_at(&self, x: u32, image: &[u32]) -> [f64; 2] {
        let spin = |[x, u, v]: [u32; 3]| {
            let [at, u, v] = [x, u, v].map_each(|cell| self.cells.centre[cell as usize]);
            dot(cross(minus(u, at), minus(v, at)), self.cells.normal[x as usize])
        };
        let ring: Vec<u32> = self.paths.steps(x).map(|(j, _)| j).collect();
        let (mut sum, mut total) = (0.0, 0.0);
        for (k, &u) in ring.iter().enumerate() {
            for between in [1, 3] {
                let turn = [x, u, ring[(k + between) % ring.len()]];
                let both = spin(turn) * spin(turn.map_each(|cell| image[cell as usize]));
                sum += both;
                total += both.abs();
            }
        }
        [sum, total]
    }
}

#[cfg(test)]
mod tests {
    use super::super::posed_body::{LEFT_ARM, LEFT_LEG, RIGHT_LEG, cells_of, on_surface};
    use super::super::signs::reflection;
    use super::*;
    use crate::store::run::Run;

    #[test]
    fn what_stays_is_as_thick_and_turns_nothing_over() {
        on_surface(|cells, surface| {
            let same: Vec<u32> = (0..cells.len() as u32).collect();
            assert!(surface.thickness_dissimilarity(&same) < 1e-12);
            assert!(surface.turning(&same) > 0.99 && surface.moved(&same, 0.0) == 0.0);
            assert!(!surface.moves_far(&same));
            // Arms are a quarter as thick as the trunk.
            let (thick, thin) = (|x: &[f64; 3]| x[2] > 0.0 && x[0].abs() < 0.1, |x: &[f64; 3]| x[0] > 0.3);
            let arm = cells.centre.iter().position(thin).unwrap() as u32;
            let moved: Vec<u32> =
                same.iter().map(|&x| if thick(&cells.centre[x as usize]) { arm } else { x }).collect();
            assert!(surface.thickness_dissimilarity(&moved) > EVEN.thickness);
            let map = surface.polished(same);
            assert!(!surface.is_smooth_reflection(&map));
        });
    }

    #[test]
    fn tips_side_by_side_are_far_apart_along_the_surface() {
        on_surface(|cells, surface| {
            let unit = 0.5 * (cells.len() as f64).sqrt();
            let on = |leg: fn([f64; 3]) -> bool| {
                let far = |&i: &usize| (cells.centre[i][2] * unit + 3.0).abs();
                cells_of(cells, leg).into_iter().min_by(|a, b| far(a).total_cmp(&far(b))).unwrap() as u32
            };
            let [left, right] = [on(LEFT_LEG), on(RIGHT_LEG)];
            let mut image: Vec<u32> = (0..cells.len() as u32).collect();
            image[left as usize] = right;
            assert!(surface.apart(left, right) < FAR);
            let map = surface.measured(image, vec![0.0; cells.len()]);
            assert!(surface.moves_tips(&map, &[left]) && surface.moves_tips(&map, &[left, right]));
            assert!(!surface.moves_tips(&map, &[right]));
        });
    }

    #[test]
    fn sides_of_unequal_lengths_must_otherwise_agree_better() {
        on_surface(|cells, surface| {
            let map = reflection(surface, &[], &Run::new(&())).unwrap().unwrap();
            let off = |radii: f64| CellMap { dissimilarity: vec![radii; cells.len()], ..map.clone() };
            assert!(surface.fits(&off(1.1), &EVEN) && !surface.fits(&off(1.3), &EVEN));
            // Half of this body moves far.
            assert!(!surface.fits(&off(1.3), &UNEVEN));
            assert!(surface.fits(&off(1.3), &Bounds { moved: 0.45, ..UNEVEN }));
            assert!(!surface.fits(&off(1.5), &Bounds { moved: 0.45, ..UNEVEN }));
            assert!(!surface.fits(&off(1.3), &Bounds { moved: 0.45, shape: 1.01, ..UNEVEN }));
            assert!(!surface.fits(&off(1.3), &Bounds { moved: 0.45, thickness: 0.0, ..UNEVEN }));
            let back = CellMap { back: vec![1.5; cells.len()], ..off(1.3) };
            assert!(!surface.fits(&back, &Bounds { moved: 0.45, ..UNEVEN }));
        });
    }

    #[test]
    fn a_regrown_map_must_reflect_limbs_too() {
        on_surface(|cells, surface| {
            let mut map = reflection(surface, &[], &Run::new(&())).unwrap().unwrap();
            let far = |i: &usize| cells.centre[*i][0];
            let tip = cells_of(cells, LEFT_ARM).into_iter().max_by(|a, b| far(a).total_cmp(&far(b))).unwrap() as u32;
            assert!(surface.is_reflection_of_trunk(&map, &[tip]) && surface.is_regrown_reflection(&map, &[tip]));
            // Images on limbs are off by a step.
            let before = map.image.clone();
            for i in cells_of(cells, |x| x[0].abs() > 4.0 || x[2] < -1.0) {
                let steps: Vec<u32> = surface.paths.steps(i as u32).map(|(j, _)| j).collect();
                map.image[i] = before[steps[7 * i % steps.len()] as usize];
            }
            let turning = [surface.turning(&map.image), surface.turning_of_trunk(&map.image)];
            assert!(surface.is_reflection_of_trunk(&map, &[tip]), "{turning:?}");
            assert!(!surface.is_regrown_reflection(&map, &[tip]), "{turning:?}");
        });
    }

    #[test]
    fn thin_limbs_hardly_count_for_the_orientation_of_the_trunk() {
        on_surface(|cells, surface| {
            // Head and trunk are mirrored, limbs stay.
            let unit = 0.5 * (cells.len() as f64).sqrt();
            let nearest = |place: [f64; 3]| {
                let far = |&i: &u32| distance(cells.centre[i as usize], place);
                (0..cells.len() as u32).min_by(|a, b| far(a).total_cmp(&far(b))).unwrap()
            };
            let image = |i: u32| {
                let at = cells.centre[i as usize];
                let is_on_limb = at[0].abs() * unit > 3.1 || at[2] < 0.0;
                if is_on_limb { i } else { nearest([-at[0], at[1], at[2]]) }
            };
            let image: Vec<u32> = (0..cells.len() as u32).map(image).collect();
            let (all, trunk) = (surface.turning(&image), surface.turning_of_trunk(&image));
            assert!(all > -0.1 && trunk < -0.4, "{all} {trunk}");
        });
    }
}
