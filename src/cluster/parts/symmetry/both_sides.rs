//! Parts of two sides: which part is whose twin, and what one side has and the other has not.
//!
//! The co-association is averaged over both sides ([`super::mirror_images`]), but less where images match poorly, and
//! the images of superfaces are not exact. So what is a close call may still be cut on one side only: one leg at the
//! knee, the other not. Where the image of a part is a piece of a larger part, the piece is cut off there, or the part
//! joins its neighbour here, whichever leads to the greater expected Rand index.
//!
//! Cost: R² for each part that has such an image, and R times the number of images for each change. Twins: R times the
//! number of images.

use super::mirror_images::{CellImages, superface_images};
use crate::base::sort::order_by;
use crate::base::vector::MapEach;
use crate::cluster::parts::cell_labels::{class_sums, compact};
use crate::cluster::parts::ensemble::Superfaces;
use crate::cluster::parts::hierarchy::HALF;
use crate::cluster::parts::matrix::Square;

/// Minimum share of a part whose image lies in one other part.
const INSIDE: f64 = 0.8;
/// Maximum difference in area between a part and its image, as a share of the part.
const DIFFERENCE: f64 = 0.35;
/// What is left of the larger part has at least this share of the area of the piece.
const REST: f64 = 0.2;
/// Maximum difference of the mean of C from ½ between what is cut or joined: if C is clearer, the images are wrong.
const CLOSE: f64 = 0.15;

/// Minimum share of each of two parts whose image lies in the other, if they are twins.
const TWIN: f64 = 0.5;

/// The superfaces of a surface with two sides.
#[derive(Clone, Debug)]
pub struct Sides {
    /// Share of the area (R).
    share: Vec<f64>,
    /// Shares of the image of each superface in others, times how well it matches (R).
    images: Vec<Vec<(u32, f64)>>,
}

/// A part that is a piece of a larger one on the other side.
struct OneSided {
    part: u32,
    /// The part that it would join, the twin of the rest of the larger one.
    beside: u32,
    /// Its image, superfaces of the larger part.
    piece: Vec<usize>,
    joins: bool,
}

impl Sides {
    /// The two sides of `superfaces` under `map`. `shares` are the areas of the cells (S).
    pub fn new(superfaces: &Superfaces, shares: &[f64], map: &CellImages) -> Sides {
        let n = superfaces.len();
        let (mut images, sure) = superface_images(n, &superfaces.of_cell, shares, map);
        for (images, sure) in images.iter_mut().zip(sure) {
            images.iter_mut().for_each(|(_, share)| *share *= sure);
        }
        Sides { share: class_sums(&superfaces.of_cell, shares, n), images }
    }

    /// The labels `label` (R) of the superfaces, with both sides cut alike where either way is a close call. C is
    /// R × R.
    pub fn cut_alike(&self, label: &[u32], co_association: &Square) -> Vec<u32> {
        let (mut label, mut parts) = compact(label);
        // Each change makes two parts alike; of wrong images there may be no end.
        for _ in 0..2 * parts {
            let Some(found) = self.one_sided(&label, parts, co_association) else { break };
            let OneSided { part, beside, piece, joins } = found;
            if joins {
                label.iter_mut().filter(|k| **k == part).for_each(|k| *k = beside);
            } else {
                piece.iter().for_each(|&x| label[x] = parts as u32);
            }
            (label, parts) = compact(&label);
        }
        label
    }

    /// The twin of each of the `parts` in `label` (R): the part on the other side that is its image, as it is that
    /// one's. Parts without a twin, and those that are their own image, are their own twins.
    pub fn twins(&self, label: &[u32], parts: usize) -> Vec<usize> {
        let area = class_sums(label, &self.share, parts);
        let mut seen = vec![Vec::new(); parts];
        for (x, &part) in label.iter().enumerate() {
            seen[part as usize].extend(self.image_of(x, label));
        }
        let image: Vec<Option<usize>> = (seen.into_iter().zip(&area))
            .map(|(seen, area)| {
                let (other, there) = greatest(parts, seen.into_iter());
                (there > TWIN * area).then_some(other as usize)
            })
            .collect();
        let mutual = |part: usize| image[part].filter(|&other| image[other] == Some(part)).unwrap_or(part);
        (0..parts).map(mutual).collect()
    }

    /// The parts in `label` (R) in which the image of superface `x` lies, with the area there.
    fn image_of<'a>(&'a self, x: usize, label: &'a [u32]) -> impl Iterator<Item = (u32, f64)> + 'a {
        self.images[x].iter().map(move |&(y, share)| (label[y as usize], share * self.share[x]))
    }

    /// The largest part that is cut on one side only, of the `parts` in `label`.
    fn one_sided(&self, label: &[u32], parts: usize, c: &Square) -> Option<OneSided> {
        let area = class_sums(label, &self.share, parts);
        let image: Vec<u32> = (0..label.len()).map(|x| greatest(parts, self.image_of(x, label)).0).collect();
        let members = |part: u32| (0..label.len()).filter(move |&x| label[x] == part);
        let found = |part: usize| {
            let own: Vec<usize> = members(part as u32).collect();
            let (larger, there) = greatest(parts, own.iter().flat_map(|&x| self.image_of(x, label)));
            let (piece, rest): (Vec<usize>, Vec<usize>) = members(larger).partition(|&x| image[x] == part as u32);
            let (beside, _) = greatest(parts, rest.iter().map(|&x| (image[x], self.share[x])));
            let [piece_area, rest_area] =
                [&piece, &rest].map_each(|some| some.iter().map(|&x| self.share[x]).sum::<f64>());
            let is_piece = there >= INSIDE * area[part]
                && (piece_area - area[part]).abs() <= DIFFERENCE * area[part]
                && rest_area >= REST * piece_area;
            if !is_piece || [larger, beside].contains(&(part as u32)) {
                return None;
            }
            let neighbour: Vec<usize> = members(beside).collect();
            let (inside, across) = (self.mean(c, &piece, &rest), self.mean(c, &own, &neighbour));
            let together =
                piece_area * rest_area * (inside - HALF) + area[part] * area[beside as usize] * (across - HALF);
            let joins = together >= 0.0;
            let is_close = (if joins { across } else { inside } - HALF).abs() <= CLOSE;
            is_close.then_some(OneSided { part: part as u32, beside, piece, joins })
        };
        order_by(parts, |a, b| area[b].total_cmp(&area[a])).into_iter().find_map(found)
    }

    /// The mean of C between two sets of superfaces, by area.
    fn mean(&self, c: &Square, a: &[usize], b: &[usize]) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for &x in a {
            for &y in b {
                let pairs = self.share[x] * self.share[y];
                sum += pairs * c[(x, y)];
                weight += pairs;
            }
        }
        sum / weight
    }
}

/// The part of greatest weight, and its weight, of a list of parts and weights.
fn greatest(parts: usize, list: impl Iterator<Item = (u32, f64)>) -> (u32, f64) {
    let mut sums = vec![0.0; parts];
    list.for_each(|(part, weight)| sums[part as usize] += weight);
    let mut best = (0, 0.0);
    for (part, &sum) in (0..).zip(&sums) {
        if sum > best.1 {
            best = (part, sum);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of four superfaces of one cell each that is its own mirror image, with C between neighbours and between
    /// others, and labels before and after.
    fn alike_if(areas: [f64; 4], between: [f64; 3], others: f64, label: [u32; 4]) -> Vec<u32> {
        let superfaces = Superfaces::kept(vec![0, 1, 2, 3], areas.to_vec()).unwrap();
        let value = |k: usize| match (k / 4).abs_diff(k % 4) {
            0 => 1.0,
            1 => between[(k / 4).min(k % 4)],
            _ => others,
        };
        let c = Square::from_values(4, (0..16).map(value).collect());
        let map = CellImages { image: vec![3, 2, 1, 0], weight: vec![0.9; 4] };
        Sides::new(&superfaces, &areas, &map).cut_alike(&label, &c)
    }

    fn alike(areas: [f64; 4], between: [f64; 3], label: [u32; 4]) -> Vec<u32> {
        alike_if(areas, between, 0.1, label)
    }

    /// Regression: a leg of four-legged 390, and a piece of chair 110, were cut on one side only.
    #[test]
    fn both_sides_are_cut_or_neither() {
        let areas = [0.2, 0.3, 0.3, 0.2];
        assert_eq!(alike(areas, [0.55, 0.1, 0.47], [0, 0, 1, 2]), [0, 0, 1, 1]);
        assert_eq!(alike(areas, [0.52, 0.1, 0.46], [0, 0, 1, 2]), [0, 1, 2, 3]);
        // A limb that is a part, and one that belongs to the trunk, which is its own image.
        assert_eq!(alike_if(areas, [0.45, 0.9, 0.52], 0.5, [0, 1, 1, 1]), [0, 1, 1, 2]);
        assert_eq!(alike_if(areas, [0.48, 0.9, 0.55], 0.5, [0, 1, 1, 1]), [0, 0, 0, 0]);
    }

    #[test]
    fn twins_are_images_of_each_other() {
        let areas = [0.2, 0.3, 0.3, 0.2];
        let superfaces = Superfaces::kept(vec![0, 1, 2, 3], areas.to_vec()).unwrap();
        let mut map = CellImages { image: vec![3, 2, 1, 0], weight: vec![0.9; 4] };
        let twins = |map: &CellImages, label: &[u32], parts| Sides::new(&superfaces, &areas, map).twins(label, parts);
        assert_eq!(twins(&map, &[0, 1, 2, 3], 4), [3, 2, 1, 0]);
        assert_eq!(twins(&map, &[0, 1, 1, 2], 3), [2, 1, 0]);
        // A limb that is cut off on one side only has no twin.
        assert_eq!(twins(&map, &[0, 1, 1, 1], 2), [0, 1]);
        map.weight[0] = 0.4;
        assert_eq!(twins(&map, &[0, 1, 2, 3], 4), [0, 2, 1, 3]);
    }

    #[test]
    fn what_is_alike_or_clear_stays() {
        let areas = [0.2, 0.3, 0.3, 0.2];
        assert_eq!(alike(areas, [0.55, 0.1, 0.55], [0, 0, 1, 1]), [0, 0, 1, 1]);
        assert_eq!(alike(areas, [0.45, 0.1, 0.45], [0, 1, 2, 3]), [0, 1, 2, 3]);
        // The images must be wrong.
        assert_eq!(alike(areas, [0.9, 0.1, 0.3], [0, 0, 1, 2]), [0, 0, 1, 2]);
        // Twins of different size are none.
        assert_eq!(alike([0.2, 0.3, 0.1, 0.4], [0.55, 0.1, 0.47], [0, 0, 1, 2]), [0, 0, 1, 2]);
    }
}
