//! The tips of a body, and which of them may be mirror images of each other.
//!
//! The mean distance from the whole surface has a local maximum at a tip: ends of limbs, head, tail. Mean distances and
//! distances between tips hardly change with the pose. All involutions of the ten farthest tips that preserve distances
//! are searched.

use super::cell_map::Surface;
use super::cell_paths::Row;
use crate::base::sort::sort_by;

/// Radius within which a tip is a maximum, in units of √(total area), like all lengths here.
const REACH: f32 = 0.12;
/// Maximum difference between the mean distances of images.
const MEAN_SLACK: f32 = 0.1;
/// Maximum difference between distances of tips, absolute plus relative: toes and poses differ.
const SLACK: [f32; 2] = [0.1, 0.1];
/// Cost of an unmatched tip, as a difference of distances.
const ALONE: f32 = 0.05;
/// Maximum number of search steps.
const VISITS: usize = 20_000;

/// The tips of a surface, farthest first, at most `count`.
pub fn tips(surface: &Surface<'_>, count: usize) -> Vec<u32> {
    let Surface { paths, mean, reached, .. } = surface;
    let mut ball = vec![f32::INFINITY; mean.len()];
    let higher =
        |i: u32, j: u32| mean[j as usize] > mean[i as usize] || (mean[j as usize] == mean[i as usize] && j < i);
    let mut found = Vec::new();
    for i in (0..mean.len() as u32).filter(|&i| reached[i as usize]) {
        if paths.steps(i).any(|(j, _)| higher(i, j)) {
            continue;
        }
        let near = paths.lower(i, REACH, &mut ball);
        if !near.iter().any(|&j| higher(i, j)) {
            found.push(i);
        }
        near.iter().for_each(|&j| ball[j as usize] = f32::INFINITY);
    }
    sort_by(&mut found, |&a, &b| mean[b as usize].total_cmp(&mean[a as usize]).then(a.cmp(&b)));
    found.truncate(count);
    found
}

/// An involution of tips.
#[derive(Clone, Debug, PartialEq)]
pub struct Matching {
    /// The image of each tip, possibly itself; `None` if it has none.
    pub image: Vec<Option<usize>>,
    /// The cost: the lower, the more plausible.
    cost: f32,
}

/// Involutions of the tips with at least one pair that preserve distances, the likeliest first. `rows` are the tips'
/// rows, `mean` the mean distances of all cells.
pub fn matchings(tips: &[u32], rows: &[Row], mean: &[f32]) -> Vec<Matching> {
    let between = rows.iter().map(|row| tips.iter().map(|&tip| row[tip as usize]).collect()).collect();
    let mean = tips.iter().map(|&tip| mean[tip as usize]).collect();
    let mut search = Search { between, mean, image: vec![None; tips.len()], visits: 0, found: Vec::new() };
    search.visit(0);
    sort_by(&mut search.found, |a, b| a.cost.total_cmp(&b.cost).then_with(|| a.image.cmp(&b.image)));
    search.found
}

struct Search {
    between: Vec<Vec<f32>>,
    mean: Vec<f32>,
    /// `None` if not yet decided.
    image: Vec<Option<Option<usize>>>,
    visits: usize,
    found: Vec<Matching>,
}

impl Search {
    /// Tips with images, and these images.
    fn mapped(&self) -> impl Iterator<Item = (usize, usize)> {
        self.image.iter().enumerate().filter_map(|(i, image)| image.flatten().map(|j| (i, j)))
    }

    /// Whether tips i and j may be images of each other.
    fn fits(&self, i: usize, j: usize) -> bool {
        let close = |x: f32, y: f32| (x - y).abs() <= SLACK[0] + SLACK[1] * x.max(y);
        let d = &self.between;
        (self.mean[i] - self.mean[j]).abs() <= MEAN_SLACK
            && self.mapped().all(|(a, b)| close(d[i][a], d[j][b]) && close(d[j][a], d[i][b]))
    }

    /// Decides on tip `i` and all after it.
    fn visit(&mut self, i: usize) {
        self.visits += 1;
        if self.visits > VISITS {
            return;
        }
        let Some(decided) = self.image.get(i) else { return self.keep() };
        if decided.is_some() {
            return self.visit(i + 1);
        }
        for j in i..self.image.len() {
            if self.image[j].is_none() && self.fits(i, j) {
                (self.image[i], self.image[j]) = (Some(Some(j)), Some(Some(i)));
                self.visit(i + 1);
                (self.image[i], self.image[j]) = (None, None);
            }
        }
        self.image[i] = Some(None);
        self.visit(i + 1);
        self.image[i] = None;
    }

    fn keep(&mut self) {
        let all: Vec<(usize, usize)> = self.mapped().collect();
        let paired = all.iter().filter(|(i, j)| i != j).count();
        if paired == 0 {
            return;
        }
        let d = &self.between;
        let (mut sum, mut count) = (0.0, 0.0f32);
        for (k, &(a, b)) in all.iter().enumerate() {
            for &(c, e) in &all[..k] {
                sum += (d[a][c] - d[b][e]).abs();
                count += 1.0;
            }
        }
        let cost = sum / count + ALONE * (self.image.len() - paired) as f32;
        self.found.push(Matching { image: self.image.iter().map(|image| image.flatten()).collect(), cost });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// Two feet, two hands, a head; one foot is .1 longer.
    fn body(arms: f32) -> (Vec<u32>, Vec<Row>, Vec<f32>) {
        let limb = [0.6, 0.5, 0.4, arms, 0.2];
        let root = [0.0, 0.0, 0.6, 0.6, 0.7f32];
        let d = |i: usize, j: usize| if i == j { 0.0 } else { limb[i] + limb[j] + (root[i] - root[j]).abs() + 0.1 };
        let rows = (0..5).map(|i| Arc::new((0..5).map(|j| d(i, j)).collect())).collect();
        ((0..5).collect(), rows, vec![0.9, 0.85, 0.8, 0.4 + arms, 0.7])
    }

    #[test]
    fn hands_go_to_hands_and_feet_to_feet() {
        let (tips, rows, mean) = body(0.42);
        let found = matchings(&tips, &rows, &mean);
        assert_eq!(found[0].image, [Some(1), Some(0), Some(3), Some(2), Some(4)]);
        let image = |m: &Matching, i: usize| m.image[i].is_none_or(|j| m.image[j] == Some(i));
        assert!(found.iter().all(|m| (0..5).all(|i| image(m, i))), "involutions all");
        // An arm of half the length is not an image of the other.
        let (tips, rows, mean) = body(0.1);
        assert!(matchings(&tips, &rows, &mean).iter().all(|m| m.image[2] != Some(3)));
    }
}
