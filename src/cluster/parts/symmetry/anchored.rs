//! Maps of a surface onto itself, starting from tips of limbs.
//!
//! A cell is mapped by its distances from anchors, cells whose images are known. Anchors start with [`tips`], matched
//! in the few likeliest ways, and one more sample: distances from tips alone do not distinguish front from back, so
//! each likely image of that sample starts a map of its own. Then more and more samples become anchors, with the images
//! that fit the anchors so far. Finally each image is recomputed from all the others. Cost: .04 to .08 s of processor
//! time and some megabytes for 2,000 cells.

use super::anchors::Anchors;
use super::cell_map::{CellMap, SAMPLES, Surface};
use super::cell_paths::Row;
use super::tips::{Matching, matchings, tips};
use crate::base::Result;
use crate::base::sort::sort_by;
use crate::store::run::Run;

/// Number of samples considered as anchors in each step; those nearer than this length to an anchor, in units of
/// √(total area), are skipped.
const GROWTH: [(usize, f32); 3] = [(12, 0.1), (28, 0.06), (SAMPLES, 0.04)];
/// Maximum number of tips: all their matchings are searched.
const TIPS: usize = 10;
/// Number of matchings that are tried.
const MATCHINGS: usize = 4;
/// Likely images of the first sample: how many, how far apart, and how much less likely than the likeliest.
const PLACES: (usize, f64, f32) = (3, 0.08, 0.04);
/// Which maps of the first samples are continued: how many, their minimum mean distance from each other, and the
/// maximum error relative to the best.
const CONTINUED: (usize, f32, f64) = (2, 0.06, 1.6);
/// Maximum orientation around a sample that a map reflects.
const REFLECTED: f64 = -0.4;
/// Rounds in which images are recomputed.
const ROUNDS: usize = 4;
/// Number of nearest anchors that determine the image of an anchor, and of a cell.
const NEAREST: [usize; 2] = [24, 12];
/// Anchors nearer than this have equal weight.
const NEAR: f32 = 0.05;
/// Weight of the mean distance from the whole surface, compared with 1/d for an anchor at d.
const MEAN: f32 = 4.0;

/// The likeliest maps of a surface, at most two.
///
/// # Errors
/// Cancellation.
pub fn maps(surface: &Surface<'_>, run: &Run) -> Result<Vec<CellMap>> {
    let initial = surface.initial_maps();
    let places: Vec<u32> = initial.iter().map(|map| map.place).collect();
    let rows = surface.paths.rows(&places);
    let started = run.map_chunks(
        initial.len(),
        || (),
        |k, ()| {
            let InitialMap { anchors, first, place } = &initial[k];
            let mut anchors = anchors.clone();
            anchors.add([surface.samples.cell[*first], *place], [&surface.rows[*first], &rows[k]]);
            surface.grow(&mut anchors, GROWTH[0]);
            Ok(anchors)
        },
    )?;
    let going_on = distinct(started);
    run.map_chunks(
        going_on.len(),
        || (),
        |k, ()| {
            let mut anchors = going_on[k].clone();
            GROWTH[1..].iter().for_each(|&growth| surface.grow(&mut anchors, growth));
            Ok(surface.map(&surface.settled(anchors)))
        },
    )
}

/// The best of `maps`, of which no two are nearly equal.
fn distinct(maps: Vec<Anchors>) -> Vec<Anchors> {
    let mut maps: Vec<(f64, Anchors)> = maps.into_iter().map(|anchors| (anchors.error(), anchors)).collect();
    sort_by(&mut maps, |a, b| a.0.total_cmp(&b.0));
    let (most, apart, worse) = CONTINUED;
    let limit = worse * maps.first().map_or(0.0, |(best, _)| *best);
    let mut kept: Vec<Anchors> = Vec::new();
    for (error, anchors) in maps {
        if error <= limit && kept.len() < most && kept.iter().all(|other| anchors.apart(other) >= apart) {
            kept.push(anchors);
        }
    }
    kept
}

/// The start of a map: matched tips, a sample and its likely image.
struct InitialMap {
    anchors: Anchors,
    /// Number of the sample.
    first: usize,
    place: u32,
}

impl Surface<'_> {
    /// The initial maps.
    fn initial_maps(&self) -> Vec<InitialMap> {
        let tips = tips(self, TIPS);
        let rows = self.paths.rows(&tips);
        let mut initial = Vec::new();
        for Matching { image, .. } in matchings(&tips, &rows, &self.mean).iter().take(MATCHINGS) {
            let mut anchors = Anchors::default();
            for (i, j) in
                image.iter().enumerate().filter_map(|(i, image)| image.map(|j| (i, j))).filter(|(i, j)| i <= j)
            {
                anchors.add([tips[i], tips[j]], [&rows[i], &rows[j]]);
            }
            let far: Vec<f32> = self.samples.cell.iter().map(|&sample| anchors.distance(sample)).collect();
            let first = (0..SAMPLES).fold(0, |a, b| if far[b] > far[a] { b } else { a });
            for place in self.places(self.samples.cell[first], &anchors) {
                initial.push(InitialMap { anchors: anchors.clone(), first, place });
            }
        }
        initial
    }

    /// The likely images of `sample`.
    fn places(&self, sample: u32, anchors: &Anchors) -> Vec<u32> {
        let dissimilarity = self.dissimilarity(sample, anchors, None);
        let is_least =
            |&i: &u32| self.paths.steps(i).all(|(j, _)| dissimilarity[j as usize] >= dissimilarity[i as usize]);
        let mut least: Vec<u32> =
            (0..self.paths.len() as u32).filter(|&i| self.reached[i as usize]).filter(is_least).collect();
        sort_by(&mut least, |&a, &b| dissimilarity[a as usize].total_cmp(&dissimilarity[b as usize]));
        let (most, apart, worse) = PLACES;
        let mut places: Vec<u32> = Vec::new();
        for i in least {
            let best = places.first().map_or(i, |&best| best);
            let close = dissimilarity[i as usize] < dissimilarity[best as usize] + worse;
            if close && places.len() < most && places.iter().all(|&other| self.apart(i, other) > apart) {
                places.push(i);
            }
        }
        places
    }

    /// The misfit of each cell as the image of `cell`, given the images of anchors (S), in units of length.
    fn dissimilarity(&self, cell: u32, anchors: &Anchors, except: Option<usize>) -> Vec<f32> {
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
        let dissimilarity = self.dissimilarity(cell, anchors, except);
        (0..dissimilarity.len()).fold(0, |a, b| if dissimilarity[b] < dissimilarity[a] { b } else { a }) as u32
    }

    /// Turns the first samples that are farther than `least` from all anchors into anchors.
    fn grow(&self, anchors: &mut Anchors, (count, least): (usize, f32)) {
        let more: Vec<usize> = (0..count).filter(|&k| anchors.distance(self.samples.cell[k]) > least).collect();
        let images: Vec<u32> = more.iter().map(|&k| self.likeliest(self.samples.cell[k], anchors, None)).collect();
        for ((&k, &image), row) in more.iter().zip(&images).zip(self.paths.rows(&images)) {
            anchors.add([self.samples.cell[k], image], [&self.rows[k], &row]);
        }
    }

    /// Recomputes every second image from all other anchors. Most stay where they were and keep their rows.
    fn recompute_images(&self, anchors: &Anchors) -> Anchors {
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

    /// Recomputes images until they stay, at most [`ROUNDS`] times.
    fn settled(&self, mut anchors: Anchors) -> Anchors {
        for _ in 0..ROUNDS {
            let next = self.recompute_images(&anchors);
            let still = next.cell == anchors.cell;
            anchors = next;
            if still {
                break;
            }
        }
        anchors
    }

    /// The weighted mismatch between the distances of `y` from the images of the `nearest` anchors of `x` and those of
    /// `x` from these anchors; the sum stops early beyond `limit`.
    #[inline(always)]
    fn misfit(&self, [x, y]: [usize; 2], nearest: &[(f32, usize)], anchors: &Anchors, limit: f32) -> f32 {
        let mut sum = MEAN * (self.mean[x] - self.mean[y]).abs();
        for &(d, k) in nearest {
            sum += (anchors.row[anchors.image[k]][y] - d).abs() / (d + NEAR);
            if sum > limit {
                break;
            }
        }
        sum
    }

    /// A misfit as the mean difference of distances, in cell radii.
    fn in_radii(&self, misfit: f32, nearest: &[(f32, usize)]) -> f64 {
        let total = nearest.iter().map(|(d, _)| 1.0 / (d + NEAR)).sum::<f32>() + MEAN;
        f64::from(misfit / total) / self.radius
    }

    /// The map of all cells that the anchors determine.
    fn map(&self, anchors: &Anchors) -> CellMap {
        let n = self.paths.len();
        let (mut image, mut dissimilarity): (Vec<u32>, Vec<f64>) = ((0..n as u32).collect(), vec![f64::INFINITY; n]);
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
                let sum = self.misfit([x, y], &nearest, anchors, least);
                if sum < least || (sum == least && y < best) {
                    (least, best) = (sum, y);
                }
            };
            // Images of neighbours are good initial guesses, so that others soon exceed the limit.
            self.paths.steps(x as u32).for_each(|(j, _)| look(image[j as usize] as usize));
            (0..n).for_each(&mut look);
            image[x] = best as u32;
            dissimilarity[x] = self.in_radii(least, &nearest);
        }
        self.measured(image, dissimilarity)
    }

    /// The samples with their images under a map.
    fn anchors_of(&self, image: &[u32]) -> Anchors {
        let images: Vec<u32> = self.samples.cell.iter().map(|&sample| image[sample as usize]).collect();
        let mut anchors = Anchors::default();
        for (k, row) in self.paths.rows(&images).iter().enumerate() {
            anchors.add([self.samples.cell[k], images[k]], [&self.rows[k], row]);
        }
        anchors
    }

    /// The map that preserves distances from the samples best, starting from their images under a smooth map, which
    /// cannot follow thin limbs.
    pub fn refitted(&self, image: &[u32]) -> CellMap {
        self.map(&self.settled(self.anchors_of(image)))
    }

    /// Another fit of a map that turns parts of the surface instead of reflecting them: an abdomen behind a thin waist
    /// is as far from everything else either way. There, images are found again from those of the other samples.
    pub fn regrown(&self, image: &[u32]) -> CellMap {
        let turning = self.turning_at_samples(image);
        let is_reflected = |cell: u32| turning[self.samples.owner[cell as usize]] <= REFLECTED;
        let all = self.anchors_of(image);
        let mut anchors = Anchors::default();
        for (a, &b) in all.image.iter().enumerate().filter(|&(a, &b)| a <= b) {
            let pair = [all.cell[a], all.cell[b]];
            if pair.iter().all(|&cell| is_reflected(cell)) {
                anchors.add(pair, [&all.row[a], &all.row[b]]);
            }
        }
        GROWTH.iter().for_each(|&growth| self.grow(&mut anchors, growth));
        self.map(&self.settled(anchors))
    }

    /// Refines a smooth map whose images may be one step off: each is replaced by the likeliest nearby cell, given the
    /// images of the samples.
    pub fn polished(&self, mut image: Vec<u32>) -> CellMap {
        let anchors = self.anchors_of(&image);
        let mut dissimilarity = vec![f64::INFINITY; image.len()];
        for x in (0..image.len()).filter(|&x| self.reached[x]) {
            let nearest = anchors.nearest(x as u32, NEAREST[1], None);
            let mut best = (image[x], self.misfit([x, image[x] as usize], &nearest, &anchors, f32::INFINITY));
            for (y, _) in self.paths.steps(image[x]) {
                let sum = self.misfit([x, y as usize], &nearest, &anchors, best.1);
                if sum < best.1 {
                    best = (y, sum);
                }
            }
            (image[x], dissimilarity[x]) = (best.0, self.in_radii(best.1, &nearest));
        }
        self.measured(image, dissimilarity)
    }
}

#[cfg(test)]
mod tests {
    use super::super::posed_body::{cells_of, on_surface};
    use super::*;

    #[test]
    fn a_part_that_a_map_turns_is_reflected_again() {
        on_surface(|cells, surface| {
            let maps = maps(surface, &Run::new(&())).unwrap();
            let right = maps.iter().find(|map| surface.is_reflection(map)).unwrap();
            let head = cells_of(cells, |x| x[2] > 11.0);
            let mut image = right.image.clone();
            head.iter().for_each(|&i| image[i] = i as u32);
            let turning = |image: &[u32]| {
                let all = surface.turning_at_samples(image);
                let mut at: Vec<usize> = head.iter().map(|&i| surface.samples.owner[i]).collect();
                at.dedup();
                at.iter().map(|&k| all[k]).sum::<f64>() / at.len() as f64
            };
            assert!(turning(&right.image) < -0.6, "{}", turning(&right.image));
            assert!(turning(&image) > 0.5, "{}", turning(&image));
            let regrown = surface.regrown(&image);
            assert!(turning(&regrown.image) < -0.6, "{}", turning(&regrown.image));
            assert!(surface.mean_dissimilarity(&regrown) < 1.25);
        });
    }
}
