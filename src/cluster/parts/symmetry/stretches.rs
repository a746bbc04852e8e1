//! Stretches of a surface around a boundary, and the rigid motions that fit them to the surface elsewhere.
//!
//! Seen from a boundary, the surface is a stack of rings, by their distance along the surface. The centres of rings
//! tell where a limb is and in which direction it goes, wherever it bends, so a motion starts from one ring and its
//! direction to another's, at several angles about it, and is improved by pairs of nearest points (ICP: Besl and McKay
//! 1992).
//!
//! Cost: two rows of distances over the cells; for each ring that has as much surface as the first, spread as far, some
//! twenty searches for each angle, and a hundred for each step where the best may fit.

use super::rigid_motion::{PointPair, RigidMotion};
use crate::base::dijkstra::shortest_paths;
use crate::base::moments::{eigenvalues, products};
use crate::base::sort::sort_by;
use crate::base::vector::{add_scaled, distance, dot, length, minus};
use crate::cluster::mirror::{NearestPoint, PointSet, REACH, SurfacePoint, apart};
use std::f64::consts::TAU;

/// Maximum error of a motion that is improved further, in cell radii: before the first step, after it, and later.
const MAY_FIT: [f64; 3] = [2.4, 2.0, 1.4];
/// Half the height of the rings whose centres give the direction along the surface, in cell radii.
const RING: f64 = 2.5;
/// Ratio of the areas of halves of two rings, or of their moments, beyond which one does not fit the other.
const ALIKE: f64 = 1.5;
/// Number of angles about that direction that are tried.
const ANGLES: usize = 8;
/// One in this many cells is searched for each angle.
const SAMPLE: usize = 5;
/// Number of steps that improve a motion.
const IMPROVEMENTS: usize = 4;

/// The surface as seen from a boundary: the distance of each cell from it, negative on one side.
pub struct Along {
    /// Signed distance (S), infinite if not reached; never 0.
    pub height: Vec<f64>,
    /// The heights of all cells, ascending.
    sorted: Vec<f64>,
    /// Sums over the cells before each in that order (S + 1).
    before: Vec<Sums>,
}

/// Area, and the integrals of the position and of its square.
#[derive(Clone, Copy, Default)]
struct Sums {
    area: f64,
    position: [f64; 3],
    square: f64,
}

impl Sums {
    fn centre(&self) -> [f64; 3] {
        self.position.map(|x| x / self.area)
    }

    /// Mean squared distance from the centre.
    fn spread(&self) -> f64 {
        let centre = self.centre();
        self.square / self.area - dot(centre, centre)
    }

    fn minus(&self, other: &Sums) -> Sums {
        let position = minus(self.position, other.position);
        Sums { area: self.area - other.area, position, square: self.square - other.square }
    }
}

/// A ring of surface at some height.
pub struct Ring {
    /// The halves below and above.
    halves: [Sums; 2],
    centre: [f64; 3],
    /// Unit vector along the surface, upwards.
    direction: [f64; 3],
}

impl Ring {
    /// Whether both halves have as much surface, spread as far.
    pub fn may_be(&self, other: &Ring) -> bool {
        let is_alike = |a: f64, b: f64| a <= ALIKE * b && b <= ALIKE * a;
        let mut halves = self.halves.iter().zip(&other.halves);
        halves.all(|(a, b)| is_alike(a.area, b.area) && is_alike(a.spread(), b.spread()))
    }
}

impl Along {
    /// The surface as seen from the boundary between `pairs` of cells, with the `steps` from each cell to its
    /// neighbours.
    pub fn new(pairs: &[[u32; 2]], points: &[SurfacePoint], shares: &[f64], steps: &[Vec<(u32, f64)>]) -> Self {
        let [below, above] = [0, 1].map(|side| {
            let mut sources: Vec<u32> = pairs.iter().map(|pair| pair[side]).collect();
            sources.sort_unstable();
            sources.dedup();
            let mut far = vec![f64::INFINITY; points.len()];
            let to = |i: u32| steps[i as usize].iter().copied();
            shortest_paths(&sources, to, f64::INFINITY, &mut far, |_| ());
            far
        });
        // The cells beside the boundary are half a step away from it.
        let centre = |cell: u32| points[cell as usize].position;
        let apart: f64 = pairs.iter().map(|&[a, b]| distance(centre(a), centre(b))).sum();
        let beside = 0.5 * apart / pairs.len() as f64;
        let signed = |(b, a): (f64, f64)| if b < a { -b - beside } else { a + beside };
        let height: Vec<f64> = below.into_iter().zip(above).map(signed).collect();
        let mut order: Vec<usize> = (0..height.len()).filter(|&i| height[i].is_finite()).collect();
        sort_by(&mut order, |&i, &j| height[i].total_cmp(&height[j]));
        let mut before = vec![Sums::default()];
        for &i in &order {
            let (Sums { area, position, square }, share, x) = (before[before.len() - 1], shares[i], points[i].position);
            let square = square + share * dot(x, x);
            before.push(Sums { area: area + share, position: add_scaled(position, share, x), square });
        }
        let sorted = order.iter().map(|&i| height[i]).collect();
        Self { height, sorted, before }
    }

    /// Heights in equal steps, without those that no cell is near, as beside a stray vertex: at most S.
    pub fn levels(&self, step: f64) -> Vec<f64> {
        let low = self.sorted.first().copied().unwrap_or(0.0);
        let mut levels: Vec<f64> = self.sorted.iter().map(|height| ((height - low) / step).floor()).collect();
        levels.dedup();
        levels.iter().map(|k| low + k * step).collect()
    }

    /// The cells between two heights; `None` if there are none.
    fn between(&self, low: f64, high: f64) -> Option<Sums> {
        let [i, j] = [low, high].map(|height| self.sorted.partition_point(|&x| x < height));
        (j > i).then(|| self.before[j].minus(&self.before[i]))
    }

    /// The ring at some height; `None` if it is none. `radius` is that of a cell.
    pub fn ring(&self, height: f64, radius: f64) -> Option<Ring> {
        let half = RING * radius;
        let [below, above] = [self.between(height - half, height)?, self.between(height, height + half)?];
        let all = self.between(height - half, height + half)?;
        let up = minus(above.centre(), below.centre());
        let far = length(up);
        // The centres of two halves that are no rings, but patches around a point, may coincide.
        (far > 0.3 * half).then(|| Ring {
            halves: [below, above],
            centre: all.centre(),
            direction: up.map(|x| x / far),
        })
    }
}

/// Cells that are moved to other places.
pub struct Stretch<'a> {
    /// The surface.
    pub nearest: &'a NearestPoint<'a>,
    /// The cells that are moved.
    pub cells: &'a [u32],
}

impl Stretch<'_> {
    /// The centroid of the images of the cells, weighted by the areas of the cells.
    pub fn centre(&self, images: &[u32]) -> [f64; 3] {
        let PointSet { points, shares, .. } = self.nearest.set();
        let (mut sum, mut all) = ([0.0; 3], 0.0);
        for (&cell, &image) in self.cells.iter().zip(images) {
            sum = add_scaled(sum, shares[cell as usize], points[image as usize].position);
            all += shares[cell as usize];
        }
        sum.map(|x| x / all)
    }

    /// The greatest share of squared normals along one line: from a third to 1, for a plane.
    pub fn flatness(&self) -> f64 {
        let PointSet { points, shares, .. } = self.nearest.set();
        let (mut moments, mut all) = ([0.0; 6], 0.0);
        for &cell in self.cells {
            let (share, normal) = (shares[cell as usize], points[cell as usize].normal);
            moments.iter_mut().zip(products(normal)).for_each(|(sum, product)| *sum += share * product);
            all += share * dot(normal, normal);
        }
        eigenvalues(moments)[0] / all
    }

    /// The mean distance, by position and normal, in radii, between the images of every `step`-th cell and the nearest
    /// cells; those without one count as [`REACH`]. `on_pair` is called with each cell and the nearest one.
    fn error(&self, motion: &RigidMotion, step: usize, mut on_pair: impl FnMut(u32, Option<u32>)) -> f64 {
        let PointSet { points, shares, radius } = self.nearest.set();
        let (mut sum, mut all) = (0.0, 0.0);
        for &cell in self.cells.iter().step_by(step) {
            let image = motion.image(points[cell as usize]);
            let found = self.nearest.find(image).map(|(k, _)| k);
            let far = found.map_or(REACH, |k| apart(points[k as usize], image, radius).sqrt() / radius);
            sum += shares[cell as usize] * far.min(REACH);
            all += shares[cell as usize];
            on_pair(cell, found);
        }
        sum / all
    }

    /// The best motion from one ring to another, of some angles; `None` if none may fit.
    pub fn start(&self, here: &Ring, there: &Ring) -> Option<RigidMotion> {
        let least = RigidMotion::between(here.centre, here.direction, there.centre, there.direction)?;
        let turned = (0..ANGLES).map(|k| least.turned(there.direction, TAU * k as f64 / ANGLES as f64));
        let with_error = turned.map(|motion| (self.error(&motion, SAMPLE, |_, _| ()), motion));
        let best = with_error.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 <= MAY_FIT[0]).then_some(best.1)
    }

    /// The motion improved: its error, and the image of each cell.
    pub fn fitted(&self, mut motion: RigidMotion) -> (f64, Vec<u32>) {
        let PointSet { points, shares, .. } = self.nearest.set();
        let mut best = (f64::INFINITY, Vec::new());
        for k in 0..=IMPROVEMENTS {
            let (mut pairs, mut image) = (Vec::new(), Vec::new());
            let error = self.error(&motion, 1, |cell, found| {
                if let Some(k) = found {
                    let [from, to] = [cell, k].map(|i| points[i as usize].position);
                    pairs.push(PointPair { from, to, weight: shares[cell as usize] });
                }
                image.push(found.unwrap_or(cell));
            });
            if error < best.0 {
                best = (error, image);
            }
            let may_fit = k < IMPROVEMENTS && error <= MAY_FIT[k.min(2)];
            let Some(next) = may_fit.then(|| motion.improved(&pairs)).flatten() else { break };
            motion = next;
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::vector::unit;

    /// Points in each ring.
    const AROUND: usize = 36;

    /// Points of a tube of this radius at each ring, half a unit apart, around an axis that bends by `bend` from one to
    /// the next.
    fn tube(radius: &[f64], bend: f64) -> Vec<SurfacePoint> {
        let (mut points, mut at, mut turn) = (Vec::new(), [0.0; 3], 0.0);
        for (k, &radius) in radius.iter().enumerate() {
            let (sin, cos) = libm::sincos(turn);
            let slope = (radius_at(k + 1) - radius_at(k)) * 2.0;
            for j in 0..AROUND {
                let (b, a) = libm::sincos(TAU * j as f64 / AROUND as f64);
                let out = [a * cos, b, -a * sin];
                let normal = unit(add_scaled(out, -slope, [sin, 0.0, cos]));
                points.push(SurfacePoint { position: add_scaled(at, radius, out), normal });
            }
            at = add_scaled(at, 0.5, [sin, 0.0, cos]);
            turn += bend;
        }
        points
    }

    fn radius_at(k: usize) -> f64 {
        3.0 + 0.6 * libm::cos(TAU * k as f64 / 12.0)
    }

    /// The neighbours of each point of a tube of `rings`, at distance ½.
    fn steps(rings: usize) -> Vec<Vec<(u32, f64)>> {
        let at = |k: usize, j: usize| ((k * AROUND + j % AROUND) as u32, 0.5);
        let beside = |k: usize, j: usize| {
            let (below, above) = (k.checked_sub(1), Some(k + 1).filter(|k| *k < rings));
            let along = below.into_iter().chain(above).map(move |k| at(k, j));
            [at(k, j + 1), at(k, j + AROUND - 1)].into_iter().chain(along).collect()
        };
        (0..rings * AROUND).map(|i| beside(i / AROUND, i % AROUND)).collect()
    }

    #[test]
    fn a_ripple_fits_the_next_ones_and_nothing_in_between() {
        for bend in [0.0, 0.03] {
            let rings = 72;
            let points = tube(&(0..rings).map(radius_at).collect::<Vec<_>>(), bend);
            let shares = vec![1.0 / points.len() as f64; points.len()];
            let nearest = NearestPoint::new(PointSet { points: &points, shares: &shares, radius: 0.3 });
            let pairs: Vec<[u32; 2]> =
                (0..AROUND).map(|j| [29 * AROUND + j, 30 * AROUND + j].map(|i| i as u32)).collect();
            let along = Along::new(&pairs, &points, &shares, &steps(rings));
            assert!((along.height[0] + 14.75).abs() < 0.1, "{}", along.height[0]);
            assert_eq!(along.levels(0.5).len(), rings);
            let cells: Vec<u32> = (0..points.len() as u32).filter(|&i| along.height[i as usize].abs() < 2.0).collect();
            let stretch = Stretch { nearest: &nearest, cells: &cells };
            assert!(stretch.flatness() < 0.55, "{}", stretch.flatness());
            let here = along.ring(0.0, 0.4).unwrap();
            let error = |height: f64| {
                let there = along.ring(height, 0.4).filter(|there| here.may_be(there));
                there.and_then(|there| stretch.start(&here, &there)).map_or(REACH, |motion| stretch.fitted(motion).0)
            };
            assert!(error(6.0) < 0.3 && error(-6.0) < 0.3, "{bend} {} {}", error(6.0), error(-6.0));
            assert!(error(3.0) > 0.6, "{bend} {}", error(3.0));
        }
    }

    #[test]
    fn levels_leave_out_what_is_far_from_all_cells() {
        let points = [0.0, 1.0, 2.0, 1e9].map(|x| SurfacePoint { position: [x, 0.0, 0.0], normal: [0.0; 3] });
        let step = |i: u32, j: u32| (j, (points[i as usize].position[0] - points[j as usize].position[0]).abs());
        let steps =
            vec![vec![step(0, 1)], vec![step(1, 0), step(1, 2)], vec![step(2, 1), step(2, 3)], vec![step(3, 2)]];
        let along = Along::new(&[[0, 1]], &points, &[0.25; 4], &steps);
        assert_eq!(along.height, [-0.5, 0.5, 1.5, 1e9 - 0.5]);
        assert_eq!(along.levels(0.5).len(), 4);
        assert!(along.ring(1e6, 0.5).is_none());
    }
}
