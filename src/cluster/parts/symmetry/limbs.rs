//! Limbs, and similar ones, which are then cut alike: eight arms of an octopus, two legs in different poses.
//!
//! A mirror plane or a reflection pairs the whole surface, but often there is neither. A single limb needs less: it is
//! characterised by its area within each distance from its tip, whatever the pose. A limb ends where that area over the
//! squared distance is least: on a tube the ratio falls, on the trunk it rises again. Limbs with similar areas are
//! mapped onto each other by the area between their tips and a cell. This gives the position along a limb, but not
//! around it, which is enough for cuts across. Pairs with a cell that is on no limb are left as they are.
//!
//! For measurements see `docs/dev/segmentation-experiments.md`. Cost: 5 ms for 2,000 cells, given the surface that
//! reflections use too.

use super::cell_map::Surface;
use super::cell_paths::{Row, UNREACHED};
use super::mirror_images::CellImages;
use super::tips::tips;
use crate::base::sort::sort_by;

/// Maximum number of tips.
const TIPS: usize = 16;
/// Resolution of distances from a tip, in units of √(total area).
const STEP: f32 = 0.03;
/// Minimum length of a limb in steps.
const SHORTEST: usize = 5;
/// Maximum length of a limb in steps, some 500 √(total area). A wire or a strip without a width may be longer and is
/// then truncated: memory for a limb must not grow with its length.
const LONGEST: usize = 1 << 14;
/// A limb has ended where its area over squared distance is this many times the minimum.
const RISE: f64 = 1.05;
/// Maximum area over squared distance of a limb. The corner of a plate has π/4, a flat place π.
const SLENDER: f64 = 0.76;
/// Maximum difference of the areas of similar limbs within a distance, as a share of their total.
const SLACK: f64 = 0.2;
/// Maximum ratio of the lengths of similar limbs.
const LENGTHS: f64 = 1.6;

/// A part of the surface around a tip.
struct Limb {
    /// Distances of all cells from the tip (S).
    row: Row,
    /// Area within 1, 2, … steps from the tip, as shares of the total.
    within: Vec<f64>,
    /// Number of steps from the tip to its end.
    steps: usize,
}

impl Limb {
    fn new(row: Row, shares: &[f64]) -> Self {
        let mut within: Vec<f64> = Vec::new();
        for (d, share) in row.iter().zip(shares).filter(|(d, _)| **d < UNREACHED) {
            let step = (d / STEP) as usize;
            if step >= LONGEST {
                continue;
            }
            within.resize(within.len().max(step + 1), 0.0);
            within[step] += share;
        }
        (1..within.len()).for_each(|k| within[k] += within[k - 1]);
        let flat = |steps: usize| within[steps - 1] / (steps as f64).powi(2);
        let mut steps = SHORTEST.min(within.len());
        for next in steps + 1..=within.len() {
            if flat(next) <= flat(steps) {
                steps = next;
            } else if flat(next) > RISE * flat(steps) {
                break;
            }
        }
        Self { row, within, steps }
    }

    /// The greatest difference of two limbs' areas within a distance, as a share of the shorter one's; infinite if one
    /// is much longer.
    fn dissimilarity(&self, other: &Limb) -> f64 {
        let (a, b) = (&self.within, &other.within);
        let steps = self.steps.min(other.steps);
        if self.steps.max(other.steps) as f64 > LENGTHS * steps as f64 {
            return f64::INFINITY;
        }
        let most = (0..steps).map(|k| (a[k] - b[k]).abs()).fold(0.0, f64::max);
        most / a[steps - 1].max(b[steps - 1])
    }

    /// The cells nearer than `end` to the tip, each with the area of those before it plus half of its own.
    fn cells(&self, end: f32, shares: &[f64]) -> Vec<(u32, f64)> {
        let mut cells: Vec<u32> = (0..self.row.len() as u32).filter(|&i| self.row[i as usize] < end).collect();
        sort_by(&mut cells, |&a, &b| self.row[a as usize].total_cmp(&self.row[b as usize]).then(a.cmp(&b)));
        let mut sum = 0.0;
        let middle = |i: u32| {
            sum += shares[i as usize];
            (i, sum - 0.5 * shares[i as usize])
        };
        cells.into_iter().map(middle).collect()
    }
}

/// The limbs of a surface, one for each tip.
pub struct Limbs {
    tips: Vec<u32>,
    limbs: Vec<Limb>,
}

/// Where a limb is, and how slender.
#[derive(Clone, Debug, PartialEq)]
pub struct LimbRegion {
    /// Its cells, from the tip on.
    pub cells: Vec<u32>,
    /// Its share of the total area.
    pub area: f64,
    /// Its area over its squared length: 2πr/length for a tube of radius r, π/4 for the corner of a plate.
    pub flatness: f64,
}

impl Limbs {
    /// Those of `surface`.
    pub fn of(surface: &Surface<'_>) -> Self {
        let tips = tips(surface, TIPS);
        let rows = surface.paths.rows(&tips);
        let limbs = rows.into_iter().map(|row| Limb::new(row, surface.shares)).collect();
        Self { tips, limbs }
    }

    /// Their regions on a surface with cells of the areas `shares` (S).
    pub fn regions(&self, shares: &[f64]) -> Vec<LimbRegion> {
        let region = |limb: &Limb| {
            let end = limb.steps as f32 * STEP;
            let cells: Vec<u32> = limb.cells(end, shares).into_iter().map(|(i, _)| i).collect();
            let area = cells.iter().map(|&i| shares[i as usize]).sum::<f64>();
            LimbRegion { cells, area, flatness: area / f64::from(end).powi(2) }
        };
        self.limbs.iter().map(region).collect()
    }

    /// For each group of similar limbs, the maps that take every limb to another one, such that each is taken to each
    /// of the others: one map fewer than limbs. Cells on no limb are their own image, with weight 0.
    pub fn maps(&self, shares: &[f64]) -> Vec<Vec<CellImages>> {
        let groups = group_similar(&self.limbs).into_iter().filter(|group| group.len() > 1);
        groups.filter_map(|group| maps(&group, &self.limbs, &self.tips, shares)).collect()
    }
}

/// Groups of limbs in which any two are similar; the most similar are joined first.
fn group_similar(limbs: &[Limb]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = (0..limbs.len()).map(|k| vec![k]).collect();
    let dissimilarity: Vec<Vec<f64>> =
        limbs.iter().map(|a| limbs.iter().map(|b| a.dissimilarity(b)).collect()).collect();
    loop {
        let mut best: Option<(f64, usize, usize)> = None;
        for b in 0..groups.len() {
            for a in 0..b {
                let pairs = groups[a].iter().flat_map(|&i| groups[b].iter().map(move |&j| (i, j)));
                let most = pairs.map(|(i, j)| dissimilarity[i][j]).fold(0.0, f64::max);
                if most < best.map_or(SLACK, |best| best.0) {
                    best = Some((most, a, b));
                }
            }
        }
        let Some((_, a, b)) = best else { return groups };
        let joined = groups.remove(b);
        groups[a].extend(joined);
    }
}

/// The maps of a `group` of `limbs` with these `tips`; `None` if they are not slender enough to be limbs.
fn maps(group: &[usize], limbs: &[Limb], tips: &[u32], shares: &[f64]) -> Option<Vec<CellImages>> {
    // Limbs are also cut off where they would overlap.
    let others = |i: usize| group.iter().filter(move |&&j| j != i).map(move |&j| 0.5 * limbs[i].row[tips[j] as usize]);
    let end = group.iter().flat_map(|&i| others(i).chain([limbs[i].steps as f32 * STEP])).fold(UNREACHED, f32::min);
    let members: Vec<Vec<(u32, f64)>> = group.iter().map(|&k| limbs[k].cells(end, shares)).collect();
    let area: Vec<f64> =
        members.iter().map(|cells| cells.iter().map(|&(i, _)| shares[i as usize]).sum::<f64>()).collect();
    let most = SLENDER * f64::from(end).powi(2);
    if members.iter().any(Vec::is_empty) || area.iter().any(|&area| area > most) {
        return None;
    }
    let n = shares.len();
    let shifted = |shift: usize| {
        let (mut image, mut weight): (Vec<u32>, _) = ((0..n as u32).collect(), vec![0.0; n]);
        for (k, from) in members.iter().enumerate() {
            let target = (k + shift) % members.len();
            let (to, scale) = (&members[target], area[target] / area[k].max(1e-300));
            for &(i, before) in from {
                let before = before * scale;
                let next = to.partition_point(|cell| cell.1 < before).min(to.len() - 1);
                let last = next.saturating_sub(1);
                let nearest = if before - to[last].1 <= to[next].1 - before { last } else { next };
                image[i as usize] = to[nearest].0;
                weight[i as usize] = 1.0;
            }
        }
        CellImages { image, weight }
    };
    Some((1..members.len()).map(shifted).collect())
}

#[cfg(test)]
mod tests {
    use super::super::mirror_images::symmetrised;
    use super::super::posed_body::{LEFT_ARM, LEFT_LEG, RIGHT_ARM, RIGHT_LEG, cells_of, on_surface};
    use super::*;
    use crate::base::random::{stream, unit};
    use crate::cluster::parts::matrix::Square;
    use std::sync::Arc;

    #[test]
    fn limbs_are_mapped_onto_limbs() {
        on_surface(|cells, surface| {
            let groups = Limbs::of(surface).maps(surface.shares);
            let share = |from: fn([f64; 3]) -> bool, to: fn([f64; 3]) -> bool| {
                let (from, to) = (cells_of(cells, from), cells_of(cells, to));
                let there = |map: &CellImages| {
                    let comes = |&&i: &&usize| map.weight[i] > 0.0 && to.contains(&(map.image[i] as usize));
                    from.iter().filter(comes).count() as f64 / from.len() as f64
                };
                groups.iter().flatten().map(there).fold(0.0, f64::max)
            };
            // Legs are half as long again, and as thick: they match arms over the length of an arm.
            for (from, to, least) in [(LEFT_ARM, RIGHT_ARM, 0.9), (LEFT_ARM, LEFT_LEG, 0.9), (LEFT_LEG, RIGHT_LEG, 0.6)]
            {
                assert!(share(from, to) > least, "{}", share(from, to));
            }
            // The middle of the trunk is on no limb.
            let trunk = cells_of(cells, |x| x[0].abs() < 2.0 && x[2] > 3.0 && x[2] < 6.0);
            assert!(!trunk.is_empty());
            assert!(groups.iter().flatten().all(|map| trunk.iter().all(|&i| map.weight[i] == 0.0)));
        });
    }

    #[test]
    fn a_limb_ends_where_it_widens_and_corners_are_none() {
        let shares = |area: &dyn Fn(f64) -> f64| {
            let place = |k: usize| 0.001 + 0.002 * k as f64;
            let row: Vec<f32> = (0..510).map(|k| place(k) as f32).collect();
            let shares: Vec<f64> = (0..510).map(|k| area(place(k) + 0.001) - area(place(k) - 0.001)).collect();
            Limb::new(Arc::new(row), &shares)
        };
        // A tube of circumference .2, on a plane from .6 on.
        let tube = shares(&|d: f64| 0.2 * d + if d > 0.6 { 3.0 * (d - 0.6).powi(2) } else { 0.0 });
        assert!((20..=24).contains(&tube.steps), "{}", tube.steps);
        let longer = shares(&|d: f64| 0.21 * d + if d > 0.66 { 3.0 * (d - 0.66).powi(2) } else { 0.0 });
        let thicker = shares(&|d: f64| 0.3 * d + if d > 0.6 { 3.0 * (d - 0.6).powi(2) } else { 0.0 });
        assert!(tube.dissimilarity(&longer) < SLACK && tube.dissimilarity(&thicker) > SLACK);
        assert_eq!(group_similar(&[tube, thicker, longer]), [vec![0, 2], vec![1]]);
        let corner = shares(&|d: f64| std::f64::consts::FRAC_PI_4 * d * d);
        let flat = corner.within[corner.steps - 1] / f64::from(corner.steps as f32 * STEP).powi(2);
        assert!(flat > SLENDER, "{flat}");
    }

    #[test]
    fn what_is_held_for_a_limb_does_not_grow_with_its_length() {
        // A strip 3·10¹¹ times as long as wide, of 600 cells: ten million steps.
        let (row, shares) = ((0..600).map(|k| 500. * k as f32).collect(), [1. / 600.; 600]);
        let limb = Limb::new(Arc::new(row), &shares);
        assert!(limb.within.len() <= LONGEST && limb.steps <= LONGEST, "{} steps", limb.within.len());
    }

    #[test]
    fn each_limb_comes_to_each_other_at_the_same_share_of_its_area() {
        // Three arms of ten cells each in a row around one cell, the second with cells twice as large.
        let shares: Vec<f64> = (0..31).map(|i| if (10..20).contains(&i) { 0.01 } else { 0.005 }).collect();
        let row = |arm: usize| {
            let far = |i: usize| if i / 10 == arm { 0.05 * (i % 10) as f32 } else { 0.5 + 0.05 * (10 - i % 10) as f32 };
            Arc::new((0..31).map(far).collect::<Vec<f32>>())
        };
        let limbs: Vec<Limb> = (0..3).map(|arm| Limb { row: row(arm), within: vec![0.1; 17], steps: 17 }).collect();
        let found = maps(&[0, 1, 2], &limbs, &[0, 10, 20], &shares).unwrap();
        assert_eq!(found.len(), 2);
        for (shift, map) in (1..).zip(&found) {
            let expected: Vec<u32> =
                (0..31).map(|i| if i == 30 { 30 } else { (i / 10 + shift) % 3 * 10 + i % 10 }).collect();
            assert_eq!(map.image, expected);
            assert_eq!(map.weight, [vec![1.0; 30], vec![0.0]].concat());
        }
        // So whatever the co-association was, it is the same along each of them.
        let (mut draw, mut c) = (stream(3, "test"), Square::zeros(31));
        for (i, j) in (0..31).flat_map(|i| (0..i).map(move |j| (i, j))) {
            let drawn = unit(&mut draw);
            (c[(i, j)], c[(j, i)]) = (drawn, drawn);
        }
        let of_cell: Vec<u32> = (0..31).collect();
        let alike = symmetrised(&c, &of_cell, &shares, &found);
        for (i, j) in (0..10).flat_map(|i| (0..i).map(move |j| (i, j))) {
            let mean = (0..3).map(|arm| c[(10 * arm + i, 10 * arm + j)]).sum::<f64>() / 3.0;
            assert!((0..3).all(|arm| (alike[(10 * arm + i, 10 * arm + j)] - mean).abs() < 1e-12));
            assert_eq!(alike[(30, j)], c[(30, j)]);
        }
    }
}
