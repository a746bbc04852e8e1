//! Max–min farthest points, starting from an extremity (§6.2).
//!
//! Each landmark lowers the field "distance to the nearest landmark so far" by a pruned front. This is exact, and the
//! i-th costs about 1/i of a full front (50 landmarks at 1.3 M faces: 4.5 fronts).

use super::{Found, Sampler, Space};
use crate::base::parallel::map_ranges;
use crate::base::random::{below, stream};
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::{Cancel, Result};
use crate::graph::NodeView;
use crate::store::mapped::Access;

/// Rounds of "farthest from the last" before the first landmark is chosen.
pub const SEEDING_ROUNDS: usize = 2;

/// The sampler. At the end, `field` is the distance to the nearest of all landmarks but the last. `found` receives it
/// right after the first landmark's full front, as that landmark's row.
pub struct Farthest;

impl Sampler for Farthest {
    fn choose(
        &self,
        l: usize,
        seed: u64,
        space: &mut dyn Space,
        field: &mut [f32],
        found: &mut Found<'_>,
    ) -> Result<()> {
        one_by_one(l, seed, space, field, found, &farthest_in)
    }

    fn is_costly(&self) -> bool {
        false
    }
}

/// Chooses each landmark with `next`, given the distances to the nearest landmark so far. The first is an extremity.
/// `field` and `found` are used as in [`Farthest`].
pub(super) fn one_by_one(
    l: usize,
    seed: u64,
    space: &mut dyn Space,
    field: &mut [f32],
    found: &mut Found<'_>,
    next: &dyn Fn(&mut dyn Space, &[f32]) -> u32,
) -> Result<()> {
    let mut landmark = space.finished(0).unwrap_or_else(|| extremity(space.nodes(), seed, space.threads()));
    field.fill(f32::INFINITY);
    for k in 0..l {
        if k == 0 {
            space.lower(k, landmark, field)?;
            space.advise(field, Access::Sequential);
            found(landmark, Some(field))?;
            continue;
        }
        landmark = next(space, field);
        // Announced before its own front, so that its row can be computed meanwhile.
        found(landmark, None)?;
        if k + 1 < l {
            space.lower(k, landmark, field)?;
        }
    }
    Ok(())
}

/// Farthest points by length only, for rows in a metric that includes turning.
///
/// In a combined metric, max–min picks outliers: a single face across a sharp crease is far from everything and
/// represents nothing. By length only, the samples spread over the surface.
pub struct GeodesicFarthest;

impl Sampler for GeodesicFarthest {
    fn choose(
        &self,
        l: usize,
        seed: u64,
        space: &mut dyn Space,
        field: &mut [f32],
        found: &mut Found<'_>,
    ) -> Result<()> {
        field.fill(f32::INFINITY);
        for k in 0..l {
            let landmark = match k {
                0 => extremity(space.nodes(), seed, space.threads()),
                _ => farthest_in(space, field),
            };
            found(landmark, None)?;
            if k + 1 < l {
                space.lower_by_length(landmark, field)?;
            }
        }
        Ok(())
    }

    fn needs_lengths(&self) -> bool {
        true
    }
}

/// An extremity of the shape: starting from a random face, go to the farthest face in space for [`SEEDING_ROUNDS`]
/// rounds; of several, the first. Distances in space find an extremity as well as those along the surface, and need two
/// passes over centroids on all `threads` instead of full fronts, in parallel with which nothing can run.
pub fn extremity(nodes: NodeView<'_>, seed: u64, threads: usize) -> u32 {
    let mut at = below(&mut stream(seed, "first landmark"), nodes.len());
    for _ in 0..SEEDING_ROUNDS {
        at = farthest_in_space(nodes, at, threads);
    }
    at as u32
}

/// The first of the nodes farthest in space from node `from`.
fn farthest_in_space(nodes: NodeView<'_>, from: usize, threads: usize) -> usize {
    const CHUNK: usize = 1 << 16;
    let from = nodes.at(from).centroid;
    // A fraction of a row: too short to need cancelling.
    let farthest = map_ranges(threads, &Cancel::default(), nodes.len(), CHUNK, |range| {
        let mut farthest = (-1f32, range.start);
        nodes.each(range, |i, node| {
            let (x, y, z) = (node.centroid[0] - from[0], node.centroid[1] - from[1], node.centroid[2] - from[2]);
            let square = x * x + y * y + z * z;
            if square > farthest.0 {
                farthest = (square, i);
            }
        });
        Ok(farthest)
    });
    let first = |best: (f32, usize), next: (f32, usize)| if next.0 > best.0 { next } else { best };
    farthest.into_iter().flatten().fold((-1., 0), first).1
}

/// [`farthest_node`], between fronts over `space`.
fn farthest_in(space: &mut dyn Space, field: &[f32]) -> u32 {
    // Otherwise pages would be read one by one.
    space.advise(field, Access::Sequential);
    let farthest = farthest_node(field);
    space.advise(field, Access::Random);
    farthest
}

/// The first node of greatest distance; infinite counts as the greatest.
fn farthest_node(field: &[f32]) -> u32 {
    let (best, at) = dispatch(FarthestBlock(field));
    let block = &field[at * BLOCK..field.len().min((at + 1) * BLOCK)];
    (at * BLOCK + block.iter().position(|&d| d == best).unwrap_or(0)) as u32
}

/// Distances examined together.
const BLOCK: usize = 4096;

/// The greatest distance and the first block that contains it, for [`dispatch`]; the position within the block is
/// searched only once.
struct FarthestBlock<'a>(&'a [f32]);

impl SimdKernel for FarthestBlock<'_> {
    type Output = (f32, usize);

    #[inline(always)]
    fn run(self) -> (f32, usize) {
        let greater = |a: f32, b: f32| if b > a { b } else { a };
        let (mut best, mut at) = (f32::NEG_INFINITY, 0);
        for (k, block) in self.0.chunks(BLOCK).enumerate() {
            // In lanes: a single maximum would be a serial dependency chain.
            let mut tops = [f32::NEG_INFINITY; 32];
            let (lanes, rest) = block.as_chunks::<32>();
            for lanes in lanes {
                for lane in 0..32 {
                    tops[lane] = greater(tops[lane], lanes[lane]);
                }
            }
            let mut top = f32::NEG_INFINITY;
            for d in tops.iter().chain(rest) {
                top = greater(top, *d);
            }
            if top > best {
                (best, at) = (top, k);
            }
        }
        (best, at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn first_greatest(field: &[f32]) -> u32 {
        (0..field.len()).rev().max_by(|&a, &b| field[a].total_cmp(&field[b])).unwrap() as u32
    }

    #[test]
    fn the_farthest_node_is_the_first_of_the_greatest() {
        let mut field: Vec<f32> = (0..10_000).map(|i| ((i * 7919) % 10_007) as f32).collect();
        assert_eq!(farthest_node(&field), first_greatest(&field));
        field[9_000] = f32::INFINITY;
        field[9_500] = f32::INFINITY;
        assert_eq!(farthest_node(&field), 9_000);
    }
}
