//! Max–min farthest points from an extremity (§6.2).
//!
//! The field "distance to the nearest landmark so far" is lowered by a pruned front a landmark: exact, and the
//! i-th costs about 1/i of a full front (50 landmarks at 1.3 M faces: 4.5 fronts).

use super::{Found, Sampler, Space};
use crate::base::parallel::map_ranges;
use crate::base::random::{below, stream};
use crate::base::simd::{SimdKernel, dispatch};
use crate::base::{Cancel, Result};
use crate::graph::NodeView;
use crate::store::mapped::Access;

/// Rounds of "farthest from the last" before the first landmark is taken.
pub const SEEDING_ROUNDS: usize = 2;

/// The sampler. `field` ends as the distance to the nearest of all but the last landmark, and `found` sees it
/// right after the first landmark's own full front, as that landmark's row.
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
}

/// Landmarks that each depend on the distances from those before, which `next` looks at. The first is an extremity.
/// `field` and `found` are those of [`Farthest`].
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
        // Known before its own front: its row can start meanwhile.
        found(landmark, None)?;
        if k + 1 < l {
            space.lower(k, landmark, field)?;
        }
    }
    Ok(())
}

/// Farthest points in length alone, for rows in a metric that counts turning.
///
/// Max–min in a combined metric picks outliers: a lone face across a sharp crease is far from everything and
/// represents nothing. In length alone the samples spread over the surface.
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
}

/// An extremity of the shape: from a random face to the face farthest from it in space, and on from there for
/// [`SEEDING_ROUNDS`] rounds; the first of equally far ones. In space instead of along the surface: as much of an
/// extremity, for two passes over centroids on all `threads` instead of full fronts that nothing can run beside.
pub fn extremity(nodes: NodeView<'_>, seed: u64, threads: usize) -> u32 {
    let mut at = below(&mut stream(seed, "first landmark"), nodes.len());
    for _ in 0..SEEDING_ROUNDS {
        at = farthest_in_space(nodes, at, threads);
    }
    at as u32
}

/// The first of the nodes that are farthest in space from node `from`.
fn farthest_in_space(nodes: NodeView<'_>, from: usize, threads: usize) -> usize {
    const CHUNK: usize = 1 << 16;
    let from = nodes.at(from).centroid;
    // A fraction of a row: nobody waits for it to be stopped.
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

/// [`farthest_node`] between fronts over `space`.
fn farthest_in(space: &mut dyn Space, field: &[f32]) -> u32 {
    // Pages are waited for one by one otherwise.
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

/// Distances that are looked at together.
const BLOCK: usize = 4096;

/// The greatest distance and the first block that has it, for [`dispatch`]: the place in the block is searched once.
struct FarthestBlock<'a>(&'a [f32]);

impl SimdKernel for FarthestBlock<'_> {
    type Output = (f32, usize);

    #[inline(always)]
    fn run(self) -> (f32, usize) {
        let greater = |a: f32, b: f32| if b > a { b } else { a };
        let (mut best, mut at) = (f32::NEG_INFINITY, 0);
        for (k, block) in self.0.chunks(BLOCK).enumerate() {
            // In lanes: a single maximum would wait for itself.
            let mut tops = [f32::NEG_INFINITY; 32];
            let (lanes, rest) = block.as_chunks::<32>();
            for lanes in lanes {
                for (top, &d) in tops.iter_mut().zip(lanes) {
                    *top = greater(*top, d);
                }
            }
            let top = tops.iter().chain(rest).copied().fold(f32::NEG_INFINITY, greater);
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
