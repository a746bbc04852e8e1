//! Part colours that everyone can distinguish and that differ between adjacent parts.
//!
//! The first [`BASE`] colours are those of Okabe and Ito (without black), with darker and lighter ones in between; more
//! are picked from a grid of sRGB, each as far as possible from all earlier ones. Distances are OKLab distances, the
//! least over normal sight, protanopia and deuteranopia (simulated after Machado et al. 2009). Cost: milliseconds;
//! [`colours_for`], which determines the adjacency of parts, makes one pass in file order and uses 4 bytes per vertex.

use crate::base::Result;
use crate::base::sort::order_by;
use crate::mesh::ply::labelled::REPEATED;
use crate::mesh::{Mesh, UNLABELLED};
use crate::store::Run;
use std::collections::BTreeMap;

/// Number of colours fixed by hand.
pub const BASE: usize = 12;
/// Maximum number of distinct colours; more parts share colours, but not adjacent ones.
pub const MOST: usize = 256;
/// Distance at which two colours are clearly different; more is no better.
const PLAIN: f32 = 0.2;

const HAND_PICKED: [[u8; 3]; BASE] = [
    [0xe6, 0x9f, 0x00],
    [0x56, 0xb4, 0xe9],
    [0x00, 0x9e, 0x73],
    [0xf0, 0xe4, 0x42],
    [0x00, 0x72, 0xb2],
    [0xd5, 0x5e, 0x00],
    [0xcc, 0x79, 0xa7],
    [0x33, 0x22, 0x88],
    [0xdd, 0xdd, 0xdd],
    [0x88, 0x22, 0x55],
    [0x0b, 0x4f, 0x2c],
    [0x5a, 0x87, 0xff],
];

type Row = [f32; 3];

/// Transformations of linear RGB by protanopia and deuteranopia.
const COLOUR_VISION: [[Row; 3]; 3] = [
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
];

/// A colour in OKLab, for the three kinds of sight.
type Seen = [Row; 3];

fn times(matrix: &[Row; 3], v: Row) -> Row {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// One sRGB channel, a stored byte, as linear light.
pub(super) fn linear(part: u8) -> f32 {
    let part = f32::from(part) / 255.0;
    if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) }
}

fn seen(colour: [u8; 3]) -> Seen {
    let linear = colour.map(linear);
    COLOUR_VISION.map(|sight| {
        let cones = times(
            &[
                [0.412_221_46, 0.536_332_55, 0.051_445_995],
                [0.211_903_5, 0.680_699_5, 0.107_396_96],
                [0.088_302_46, 0.281_718_85, 0.629_978_7],
            ],
            times(&sight, linear).map(|part| part.clamp(0.0, 1.0)),
        );
        times(
            &[
                [0.210_454_26, 0.793_617_8, -0.004_072_047],
                [1.977_998_5, -2.428_592_2, 0.450_593_7],
                [0.025_904_037, 0.782_771_77, -0.808_675_77],
            ],
            cones.map(f32::cbrt),
        )
    })
}

/// The distance of two colours in OKLab for the kind of sight that distinguishes them least.
fn distance(a: &Seen, b: &Seen) -> f32 {
    let apart = |(a, b): (&Row, &Row)| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt();
    a.iter().zip(b).map(apart).fold(f32::INFINITY, f32::min)
}

/// The first `count` colours, at most [`MOST`], all distinct.
pub fn palette(count: usize) -> Vec<[u8; 3]> {
    let mut colours = HAND_PICKED.to_vec();
    if count > BASE {
        const STEPS: [u8; 9] = [0, 32, 64, 96, 128, 160, 192, 224, 255];
        let grid = STEPS.iter().flat_map(|&r| STEPS.iter().flat_map(move |&g| STEPS.iter().map(move |&b| [r, g, b])));
        let mut candidates: Vec<([u8; 3], Seen, f32)> = grid
            .map(|colour| (colour, seen(colour)))
            // Shading is invisible on colours close to black or white.
            .filter(|(_, seen)| (0.3..0.95).contains(&seen[0][0]))
            .map(|(colour, seen)| (colour, seen, f32::INFINITY))
            .collect();
        let mut taken = 0;
        while colours.len() < count.min(MOST) {
            for new in colours[taken..].iter().map(|&colour| seen(colour)) {
                candidates.iter_mut().for_each(|(_, seen, far)| *far = far.min(distance(seen, &new)));
            }
            taken = colours.len();
            let best = candidates.iter().reduce(|best, one| if one.2 > best.2 { one } else { best });
            let Some(&(colour, ..)) = best else { break };
            colours.push(colour);
        }
    }
    colours.truncate(count);
    colours
}

/// One colour per part such that adjacent parts differ. `touching` lists pairs of parts and the length of their
/// contact, each pair once or twice; pairs beyond `parts` are ignored.
///
/// Parts are processed in descending order of contact and choose among the least-used colours: so all [`MOST`] colours
/// are used before one is used twice.
///
/// ```
/// use nystrom_stream::apps::colours::assign;
/// // Parts 0 and 1 touch along a border of length 2.
/// let colours = assign(3, &[(0, 1, 2.)]);
/// assert!(colours.len() == 3 && colours[0] != colours[1]);
/// ```
pub fn assign(parts: usize, touching: &[(u32, u32, f64)]) -> Vec<[u8; 3]> {
    let colours = palette(parts.clamp(BASE, MOST));
    let seen: Vec<Seen> = colours.iter().map(|&colour| seen(colour)).collect();
    let mut neighbours: Vec<Vec<usize>> = vec![Vec::new(); parts];
    let mut contact = vec![0.0f64; parts];
    for &(a, b, length) in touching {
        let (a, b) = (a as usize, b as usize);
        if a < parts && b < parts && a != b {
            neighbours[a].push(b);
            neighbours[b].push(a);
            contact[a] += length;
            contact[b] += length;
        }
    }
    let order = order_by(parts, |a, b| contact[b].total_cmp(&contact[a]));
    let mut chosen: Vec<Option<usize>> = vec![None; parts];
    let mut uses = vec![0usize; colours.len()];
    for part in order {
        let near: Vec<usize> = neighbours[part].iter().filter_map(|&other| chosen[other]).collect();
        // The least-used colours first, but never a neighbour's if there is another.
        let unlike =
            |colour: usize| near.iter().map(|&other| distance(&seen[colour], &seen[other])).fold(PLAIN, f32::min);
        let score = |colour: usize| {
            let apart = unlike(colour);
            (apart > 0.0, std::cmp::Reverse(uses[colour]), apart)
        };
        let better = |best: (usize, (bool, std::cmp::Reverse<usize>, f32)), colour: usize| {
            let score = score(colour);
            if score.partial_cmp(&best.1).is_some_and(std::cmp::Ordering::is_gt) { (colour, score) } else { best }
        };
        let (colour, _) = (1..colours.len()).fold((0, score(0)), better);
        chosen[part] = Some(colour);
        uses[colour] += 1;
    }
    chosen.into_iter().map(|colour| colours[colour.unwrap_or(0)]).collect()
}

/// Faces between two checks of the stop flag.
const CHUNK: usize = 1 << 16;
/// Above this number, parts take colours cyclically.
const MOST_DISTINCT: usize = 2048;

/// One colour per label, suitable for colour-blind people, different for adjacent parts; at most [`REPEATED`], which
/// greater labels take in turn ([`colour_of`](crate::mesh::ply::labelled::colour_of)).
///
/// # Errors
/// [`crate::base::Error::Cancelled`], [`crate::base::Error::Memory`].
pub fn colours_for(mesh: &Mesh, labels: &[u32], run: &Run) -> Result<Vec<[u8; 3]>> {
    let parts = labels.iter().copied().filter(|&label| label != UNLABELLED).max().map_or(0, |most| most as usize + 1);
    if parts > MOST_DISTINCT {
        let some = palette(MOST);
        return Ok((0..parts.min(REPEATED)).map(|part| some[part % some.len()]).collect());
    }
    let bytes = 4 * mesh.positions.len() as u64;
    let _grant = run.budget.take("the parts at vertices", bytes, bytes)?;
    let mut first = vec![UNLABELLED; mesh.positions.len()];
    let mut touching: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    let n = mesh.faces.len();
    for start in (0..n).step_by(CHUNK) {
        run.cancel.check()?;
        mesh.faces.for_each(start..n.min(start + CHUNK), |face, corners| {
            let label = labels.get(face).copied().unwrap_or(UNLABELLED);
            for &corner in corners {
                let Some(known) = first.get_mut(corner as usize) else { continue };
                if *known == UNLABELLED {
                    *known = label;
                } else if *known != label && label != UNLABELLED {
                    *touching.entry(((*known).min(label), (*known).max(label))).or_default() += 1.0;
                }
            }
        });
    }
    let touching: Vec<_> = touching.into_iter().map(|((a, b), count)| (a, b, count)).collect();
    Ok(assign(parts, &touching))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream};
    use std::collections::HashSet;

    fn least_contrast(colours: &[[u8; 3]], touching: &[(u32, u32, f64)]) -> f32 {
        let apart = |&(a, b, _): &(u32, u32, f64)| distance(&seen(colours[a as usize]), &seen(colours[b as usize]));
        touching.iter().filter(|(a, b, _)| a != b).map(apart).fold(f32::INFINITY, f32::min)
    }

    #[test]
    fn the_palette_is_distinct_and_always_the_same() {
        let all = palette(MOST);
        assert_eq!(all.iter().collect::<HashSet<_>>().len(), MOST);
        assert_eq!(palette(40), all[..40]);
        assert_eq!(palette(5), HAND_PICKED[..5]);
        for k in 0..BASE {
            for other in &all[..k] {
                let apart = distance(&seen(all[k]), &seen(*other));
                assert!(apart > 0.05, "{:?} {other:?} {apart}", all[k]);
            }
        }
    }

    #[test]
    fn neighbours_are_unlike_for_every_sight() {
        // A tree of limbs, a ring, a body adjacent to all, and random contacts, six per part.
        let tree: Vec<_> = (1..12).map(|k| (k / 2, k, 1.0)).collect();
        let ring: Vec<_> = (0..12).map(|k| (k, (k + 1) % 12, 1.0)).collect();
        let star: Vec<_> = (1..12).map(|k| (0, k, f64::from(k))).collect();
        for touching in [tree, ring, star] {
            let colours = assign(12, &touching);
            assert_eq!(colours.iter().collect::<HashSet<_>>().len(), 12);
            let least = least_contrast(&colours, &touching);
            assert!(least > 0.1, "{least}");
        }
        let mut random = stream(1, "contacts");
        for parts in [30usize, 200, 1000] {
            let touching: Vec<_> = (0..3 * parts)
                .map(|_| (below(&mut random, parts) as u32, below(&mut random, parts) as u32, 1.0))
                .collect();
            let colours = assign(parts, &touching);
            assert_eq!(colours.iter().collect::<HashSet<_>>().len(), parts.min(MOST));
            let least = least_contrast(&colours, &touching);
            assert!(least > 0.03, "{parts} parts: {least}");
        }
    }

    /// Regression: there were three bytes for each number up to the greatest label, 12 GB for labels in the billions.
    #[test]
    fn great_labels_take_colours_in_turn() {
        use crate::mesh::ply::labelled::colour_of;
        let mesh = Mesh::from_slices(&[[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.]], &[[0u32, 1, 2]; 3]).unwrap();
        let mut run = Run::new(&());
        run.budget = crate::store::Budget::new(1 << 20);
        let labels = [4_000_000_000, 70_000, UNLABELLED];
        let colours = colours_for(&mesh, &labels, &run).unwrap();
        assert_eq!(colours.len(), REPEATED);
        let some = palette(MOST);
        let expected = [some[4_000_000_000 % MOST], some[70_000 % MOST], [128; 3]];
        assert_eq!(labels.map(|label| colour_of(&colours, label)), expected);
        assert_eq!(colour_of(&colours[..9], 9), [128; 3]);
        assert_eq!(colours_for(&mesh, &[0, 2999, 1], &run).unwrap().len(), 3000);
    }

    #[test]
    fn odd_contacts_do_no_harm() {
        assert_eq!(assign(0, &[]), Vec::<[u8; 3]>::new());
        assert_eq!(assign(2, &[(0, 9, 1.0), (1, 1, f64::NAN)]), HAND_PICKED[..2]);
    }
}
