//! The coarse quadrilaterals that make up the creature's skin, and how they join.
//!
//! The creature starts as a heap of unit cubes, each belonging to one part (a *polycube*); its outer squares are the
//! patches of the skin. This settles the topology at once: the skin is closed, every edge joins two patches, and a
//! part's border is a ring of edges. The real shape comes later ([`super::relief`]). Cost: negligible, for some 200
//! patches.

use super::shape::Vec3;
use std::collections::BTreeMap;

/// A corner of the cubes' lattice.
type Site = [i32; 3];

/// A side or corner of a patch: the patch, and which of its four.
pub(super) type PatchSide = (usize, usize);

/// A patch. Corners run counter-clockwise seen from outside; side `s` goes from corner `s` to
/// corner `s + 1`; `u` runs along side 0 and `v` against side 3.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    /// Its part.
    pub part: usize,
    /// For each side, the same side seen from the patch across it; it runs in the opposite direction there.
    pub across: [PatchSide; 4],
    /// For each corner, its first appearance in patch order.
    pub first: [PatchSide; 4],
    /// Approximate positions of the corners in space.
    pub rough: [Vec3; 4],
}

/// A box of cubes of one part, and its position in space: `centre` is its middle, `axes` the images of the lattice's
/// unit vectors.
struct Block {
    part: usize,
    low: Site,
    high: Site,
    centre: Vec3,
    axes: [Vec3; 3],
}

impl Block {
    fn place(&self, site: Site) -> Vec3 {
        let offset = |k: usize| f64::from(site[k]) - 0.5 * f64::from(self.low[k] + self.high[k]);
        self.centre + self.axes[0] * offset(0) + self.axes[1] * offset(1) + self.axes[2] * offset(2)
    }
}

/// The blocks of the quadruped, roughly at the positions of its parts in [`super::shape::Shape::quadruped`].
fn blocks() -> Vec<Block> {
    let block = |part, low, high, centre: [f64; 3], axes: [[f64; 3]; 3]| Block {
        part,
        low,
        high,
        centre: centre.into(),
        axes: axes.map(Vec3::from),
    };
    let straight = |x: f64, y: f64, z: f64| [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]];
    let leg = |part, x, y, at: [f64; 2]| {
        block(part, [x, y, -3], [x + 1, y + 1, 0], [at[0], at[1], -0.82], straight(0.38, 0.38, 0.36))
    };
    let ear = |part, y, side: f64| {
        let up = [-0.08, 0.12 * side, 0.24];
        block(
            part,
            [7, y, 3],
            [8, y + 1, 6],
            [1.17, 0.35 * side, 1.40],
            [[0.24, 0.0, 0.08], [0.0, 0.24, -0.12 * side], up],
        )
    };
    vec![
        block(0, [0, 0, 0], [5, 3, 2], [0.0, 0.0, 0.0], straight(0.42, 0.26, 0.36)),
        block(1, [5, 1, 1], [7, 2, 2], [1.10, 0.0, 0.52], [[0.15, 0.0, 0.20], [0.0, 0.3, 0.0], [-0.24, 0.0, 0.18]]),
        block(2, [7, 0, 1], [9, 3, 3], [1.56, 0.0, 0.86], [[0.34, 0.0, -0.06], [0.0, 0.16, 0.0], [0.04, 0.0, 0.22]]),
        ear(3, 2, 1.0),
        ear(4, 0, -1.0),
        leg(5, 4, 2, [0.72, 0.32]),
        leg(6, 4, 0, [0.72, -0.32]),
        leg(7, 0, 2, [-0.66, 0.32]),
        leg(8, 0, 0, [-0.66, -0.32]),
        block(9, [-6, 1, 1], [0, 2, 2], [-1.60, 0.0, 0.24], [[0.19, 0.0, -0.01], [0.0, 0.32, 0.0], [0.0, 0.0, 0.32]]),
    ]
}

/// The four corners of the square between the cube at `cube` and its neighbour along `axis`, counter-clockwise seen
/// from that neighbour.
fn square(cube: Site, axis: usize, forward: bool) -> [Site; 4] {
    let turn = if forward { [(0, 0), (1, 0), (1, 1), (0, 1)] } else { [(0, 0), (0, 1), (1, 1), (1, 0)] };
    turn.map(|(b, c)| {
        let mut site = cube;
        site[axis] += i32::from(forward);
        site[(axis + 1) % 3] += b;
        site[(axis + 2) % 3] += c;
        site
    })
}

/// The patches of the quadruped, part by part.
pub(super) fn patches() -> Vec<Patch> {
    let blocks = blocks();
    let mut cubes: BTreeMap<Site, usize> = BTreeMap::new();
    let mut order: Vec<Site> = Vec::new();
    for (b, block) in blocks.iter().enumerate() {
        for x in block.low[0]..block.high[0] {
            for y in block.low[1]..block.high[1] {
                for z in block.low[2]..block.high[2] {
                    cubes.insert([x, y, z], b);
                    order.push([x, y, z]);
                }
            }
        }
    }
    let mut skin: Vec<(usize, [Site; 4])> = Vec::new();
    // The position of a site according to each block around it.
    let mut rough: BTreeMap<Site, Vec<(usize, Vec3)>> = BTreeMap::new();
    for cube in order {
        for side in 0..6 {
            let (axis, forward) = (side / 2, side % 2 == 1);
            let mut neighbour = cube;
            neighbour[axis] += if forward { 1 } else { -1 };
            if cubes.contains_key(&neighbour) {
                continue;
            }
            let corners = square(cube, axis, forward);
            let b = cubes[&cube];
            for site in corners {
                let places = rough.entry(site).or_default();
                if places.iter().all(|(other, _)| *other != b) {
                    places.push((b, blocks[b].place(site)));
                }
            }
            skin.push((b, corners));
        }
    }
    join_up(
        &skin,
        |b| blocks[b].part,
        |site| {
            let places = &rough[&site];
            places.iter().map(|(_, place)| place).sum::<Vec3>() / places.len() as f64
        },
    )
}

/// Finds what is across each side and which patch has each corner first.
fn join_up(skin: &[(usize, [Site; 4])], part: impl Fn(usize) -> usize, rough: impl Fn(Site) -> Vec3) -> Vec<Patch> {
    let mut sides: BTreeMap<(Site, Site), PatchSide> = BTreeMap::new();
    let mut first: BTreeMap<Site, PatchSide> = BTreeMap::new();
    for (p, (_, corners)) in skin.iter().enumerate() {
        for s in 0..4 {
            sides.insert((corners[s], corners[(s + 1) % 4]), (p, s));
            first.entry(corners[s]).or_insert((p, s));
        }
    }
    let four = [0, 1, 2, 3];
    skin.iter()
        .map(|(b, corners)| Patch {
            part: part(*b),
            across: four.map(|s| sides[&(corners[(s + 1) % 4], corners[s])]),
            first: four.map(|s| first[&corners[s]]),
            rough: four.map(|s| rough(corners[s])),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_side_meets_one_other_and_borders_are_rings_apart() {
        let patches = patches();
        for (p, patch) in patches.iter().enumerate() {
            for s in 0..4 {
                let (q, t) = patch.across[s];
                assert_eq!(patches[q].across[t], (p, s));
                let next = (s + 1) % 4;
                let ring = |s: usize| patches[patch.across[s].0].part != patch.part;
                assert!(!(ring(s) && ring(next)), "patch {p} has two border sides in a row");
            }
        }
    }
}
