//! Parts of a surface that rotations map onto itself: all teeth of a gear are cut, or none.
//!
//! The co-association is averaged over the rotations ([`super::mirror_images`]), but what is a close call may still be
//! cut in some places only, and a disc breaks into arbitrary sectors. The majority decides: a part stays if at least
//! half of its images are parts; then the others are cut out of the parts that they lie in. Otherwise, or if an image
//! overlaps the part itself, as of a sector, it joins the neighbour with which most of its images lie in one part.
//!
//! This works on cells, since a superface may contain a tooth and what is beside it. Cost: S times the number of
//! rotations for each of a few rounds, and S for each image that is not a part.

use super::mirror_images::{CellImages, superface_images};
use crate::base::union_find::Forest;
use crate::cluster::parts::cell_graph::CellGraph;
use crate::cluster::parts::cell_labels::{class_sums, compact};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Minimum intersection over union of an image and a part for the image to be that part.
const SAME: f64 = 0.6;
/// Minimum share of the images of a part that are parts.
const MAJORITY: f64 = 0.5;
/// Share of the part itself in an image, between these, for a part that overlaps its image.
const OVERLAP: Range<f64> = 0.3..0.7;
/// Minimum share of an image that lies in the part out of which it is cut.
const INSIDE: f64 = 0.7;
/// Minimum area that is left of that part, relative to the image.
const REST: f64 = 0.5;

/// Maximum number of rounds in which images are cut out.
const ROUNDS: usize = 4;

/// A surface and the rotations that map it onto itself.
pub struct Turns<'a> {
    /// The cells.
    pub cells: &'a CellGraph,
    /// Their shares of the area (S).
    pub shares: &'a [f64],
    /// The images of cells under the rotations by 1/n, …, (n − 1)/n of a turn.
    pub maps: &'a [CellImages],
}

/// How the parts of a labelling are mapped.
struct Mapped {
    /// Share of each part's images that are parts; 0 if an image overlaps the part (P).
    support: Vec<f64>,
    /// Images that are not parts: the part, and the rotation, counted from 0.
    missing: Vec<(usize, usize)>,
    /// Parts that touch each other, and how often their images lie in one part.
    touching: Vec<([u32; 2], f64)>,
}

impl Mapped {
    /// The parts without a majority, each with the neighbour that its images lie with most often.
    fn joins(&self) -> impl Iterator<Item = [u32; 2]> {
        let mut best: BTreeMap<u32, (f64, u32)> = BTreeMap::new();
        for &([a, b], together) in &self.touching {
            for (part, other) in
                [(a, b), (b, a)].into_iter().filter(|(part, _)| self.support[*part as usize] < MAJORITY)
            {
                let before = best.entry(part).or_insert((together, other));
                if together > before.0 {
                    *before = (together, other);
                }
            }
        }
        best.into_iter().map(|(part, (_, other))| [part, other])
    }
}

impl Turns<'_> {
    /// The labels `label` (S) of the cells, made equal under all rotations by majority.
    pub fn alike(&self, label: &[u32]) -> Vec<u32> {
        let (mut label, mut parts) = compact(label);
        let mut mapped = self.mapped(&label, parts);
        // Each round leaves fewer parts.
        loop {
            let joins: Vec<[u32; 2]> = mapped.joins().collect();
            if joins.is_empty() {
                break;
            }
            let mut joined = Forest::new(parts);
            joins.into_iter().for_each(|[a, b]| _ = joined.join(a, b));
            label.iter_mut().for_each(|part| *part = joined.find(*part));
            (label, parts) = compact(&label);
            mapped = self.mapped(&label, parts);
        }
        // Of inexact images there may be no end.
        for _ in 0..ROUNDS {
            let before = parts;
            for (part, k) in mapped.missing {
                if let Some(piece) = self.piece(&label, part as u32, k) {
                    piece.into_iter().for_each(|cell| label[cell] = parts as u32);
                    parts += 1;
                }
            }
            if parts == before {
                break;
            }
            (label, parts) = compact(&label);
            mapped = self.mapped(&label, parts);
        }
        label
    }

    fn mapped(&self, label: &[u32], parts: usize) -> Mapped {
        let area = class_sums(label, self.shares, parts);
        let (mut support, mut all) = (vec![1.0; parts], vec![1.0; parts]);
        let (mut missing, mut overlaps) = (Vec::new(), vec![false; parts]);
        let sides = self.cells.pairs.iter().map(|pair| pair.map(|cell| label[cell as usize]));
        let different: BTreeSet<[u32; 2]> = sides.filter(|[a, b]| a != b).map(|[a, b]| [a.min(b), a.max(b)]).collect();
        let mut touching: Vec<([u32; 2], f64)> = different.into_iter().map(|pair| (pair, 0.0)).collect();
        for (k, map) in self.maps.iter().enumerate() {
            // Where only some of a part is mapped, its image is taken for that of the whole.
            let (images, sure) = superface_images(parts, label, self.shares, map);
            for part in 0..parts {
                let is_same = |&(other, share): &(u32, f64)| {
                    let common = share * area[part];
                    common >= SAME * (area[part] + area[other as usize] - common)
                };
                let on_itself =
                    images[part].iter().any(|&(other, share)| other as usize == part && OVERLAP.contains(&share));
                all[part] += sure[part];
                overlaps[part] |= sure[part] >= INSIDE && on_itself;
                if images[part].iter().any(is_same) {
                    support[part] += sure[part];
                } else if sure[part] >= INSIDE {
                    missing.push((part, k));
                }
            }
            for ([a, b], together) in &mut touching {
                let [a, b] = [&images[*a as usize], &images[*b as usize]];
                let in_b = |part: u32| b.iter().find(|(other, _)| *other == part).map_or(0.0, |(_, share)| *share);
                *together += a.iter().map(|&(part, share)| share * in_b(part)).sum::<f64>();
            }
        }
        for part in 0..parts {
            support[part] = if overlaps[part] { 0.0 } else { support[part] / all[part] };
        }
        Mapped { support, missing, touching }
    }

    /// The cells of the `k`-th image of `part`, if they are to be cut out of another part.
    fn piece(&self, label: &[u32], part: u32, k: usize) -> Option<Vec<usize>> {
        let back = &self.maps[self.maps.len() - 1 - k];
        let sign = |cell: usize| {
            let comes = label[back.image[cell] as usize] == part && back.weight[cell] > 0.0;
            if comes { self.shares[cell] } else { -self.shares[cell] }
        };
        // Images are off by a cell or two: majorities among neighbours decide.
        let mut votes: Vec<f64> = (0..label.len()).map(sign).collect();
        for &[i, j] in &self.cells.pairs {
            votes[i as usize] += sign(j as usize);
            votes[j as usize] += sign(i as usize);
        }
        let image: Vec<usize> = (0..label.len()).filter(|&cell| votes[cell] > 0.0).collect();
        let parts = label.iter().map(|&k| k as usize + 1).max()?;
        let area = class_sums(label, self.shares, parts);
        let mut inside = vec![0.0; parts];
        image.iter().for_each(|&cell| inside[label[cell] as usize] += self.shares[cell]);
        let container = (0..parts).max_by(|&a, &b| inside[a].total_cmp(&inside[b]).then(b.cmp(&a)))?;
        let covered: f64 = image.iter().map(|&cell| self.shares[cell]).sum();
        let (most, least) = (inside[container], INSIDE * covered.max(area[part as usize]));
        let is_cut = most >= least && area[container] - most >= REST * covered;
        is_cut.then(|| image.into_iter().filter(|&cell| label[cell] == container as u32).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells per tooth and per sector of the disc.
    const EACH: usize = 6;

    /// A disc of `n` sectors in a ring with a tooth on each. Sector k has the cells 2 k · EACH …, its tooth the next.
    fn gear(n: usize) -> (CellGraph, Vec<CellImages>) {
        let all = 2 * n * EACH;
        let mut cells = CellGraph { area: vec![1.0 / all as f64; all], ..CellGraph::default() };
        let mut pair = |i: usize, j: usize| cells.pairs.push([i as u32, j as u32]);
        for sector in 0..n {
            let (disc, tooth, next) = (2 * sector * EACH, (2 * sector + 1) * EACH, 2 * (sector + 1) % (2 * n) * EACH);
            (1..EACH).for_each(|i| pair(disc + i - 1, disc + i));
            (1..EACH).for_each(|i| pair(tooth + i - 1, tooth + i));
            (0..EACH).for_each(|i| pair(disc + i, next + i));
            [0, 1].into_iter().for_each(|i| pair(disc + i, tooth + i));
        }
        cells.length = vec![0.1; cells.pairs.len()];
        let image = |k: usize| (0..all).map(|cell| ((cell + 2 * k * EACH) % all) as u32).collect();
        let maps = (1..n).map(|k| CellImages { image: image(k), weight: vec![0.95; all] }).collect();
        (cells, maps)
    }

    fn alike(cells: &CellGraph, maps: &[CellImages], label: &[u32]) -> Vec<u32> {
        Turns { cells, shares: &cells.area_shares(), maps }.alike(label)
    }

    /// Labels of a disc in one part, of which `cut` teeth are parts.
    fn teeth(n: usize, cut: &[usize]) -> Vec<u32> {
        let tooth = |k: usize| cut.iter().position(|&tooth| tooth == k).map_or(0, |part| part as u32 + 1);
        (0..2 * n * EACH).map(|cell| if cell / EACH % 2 == 1 { tooth(cell / EACH / 2) } else { 0 }).collect()
    }

    /// Regression: 8 of 16 teeth of a gear were parts.
    #[test]
    fn all_teeth_are_cut_or_none() {
        let (cells, maps) = gear(8);
        let all = teeth(8, &[0, 1, 2, 3, 4, 5, 6, 7]);
        let same = |label: Vec<u32>, expected: &[u32]| assert_eq!(compact(&label), compact(expected));
        same(alike(&cells, &maps, &teeth(8, &[0, 1, 3, 4, 6])), &all);
        same(alike(&cells, &maps, &teeth(8, &[2, 5, 6])), &teeth(8, &[]));
        same(alike(&cells, &maps, &all), &all);
    }

    /// Regression: the disc of a gear without a hub was cut into sectors.
    #[test]
    fn sectors_are_joined_unless_there_is_one_for_each_rotation() {
        let (cells, maps) = gear(8);
        let all = teeth(8, &[0, 1, 2, 3, 4, 5, 6, 7]);
        // Of three sectors of two and six turns.
        let in_sectors = |start: [usize; 3]| -> Vec<u32> {
            let sector = |cell: usize| start.iter().filter(|&&from| cell / EACH / 2 >= from).count() as u32;
            all.iter().enumerate().map(|(cell, &k)| if k == 0 { 20 + sector(cell) } else { k }).collect()
        };
        assert_eq!(compact(&alike(&cells, &maps, &in_sectors([2, 3, 6]))), compact(&all));
        let each: Vec<u32> = (0..all.len()).map(|cell| (cell / EACH) as u32).collect();
        assert_eq!(alike(&cells, &maps, &each), each);
    }

    #[test]
    fn images_off_by_a_cell_and_what_is_on_one_side_only_change_nothing() {
        let (cells, mut maps) = gear(8);
        // The last tooth is a part of its own that no rotation maps onto anything.
        for map in &mut maps {
            map.weight[15 * EACH..].fill(0.0);
            map.image.swap(3, 2 * EACH + 1);
            map.image.swap(5 * EACH, 6 * EACH + 3);
        }
        assert_eq!(alike(&cells, &maps, &teeth(8, &[7])), teeth(8, &[7]));
        assert_eq!(alike(&cells, &maps, &teeth(8, &[])), teeth(8, &[]));
        // Whatever the maps, it ends.
        maps.iter_mut().enumerate().for_each(|(k, map)| map.image.rotate_left(7 * k + 5));
        let label = alike(&cells, &maps, &teeth(8, &[0, 1, 3, 4, 6]));
        assert_eq!(label.len(), 16 * EACH);
        assert_eq!(alike(&cells, &[], &teeth(8, &[1])), teeth(8, &[1]));
    }
}
