//! Landmarks: which faces are sampled (§6 of the paper).
//!
//! [`Sampling::Farthest`], §6.2: a random face q, the face p farthest from it, and back and forth for a few
//! rounds put the first landmark at an extremity ([`extremity`]); each next one is the face farthest from those
//! before it. The field "distance to the nearest landmark so far" is lowered by a pruned front a
//! landmark: exact, and the i-th costs about 1/i of a full front (50 landmarks at 1.3 M
//! faces: 4.5 fronts). [`Sampling::Random`] draws faces by area.
//!
//! Landmarks are sent as soon as they are known, so rows can start. Memory: the field, 4 bytes a
//! node in a mapped file.

use super::front::Front;
use crate::base::random::{below, stream, unit};
use crate::base::{Cancel, Result};
use crate::graph::Node;
use crate::graph::dual::Csr;
use crate::store::mapped::Access;
use serde::{Deserialize, Serialize};

/// How landmarks are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampling {
    /// Max–min farthest points from an extremity.
    #[default]
    Farthest,
    /// Faces at random, a face's chance in proportion to its area.
    Random,
}

/// Rows that an earlier run finished: their landmarks are known, and their distances spare the search its fronts.
pub trait Finished {
    /// The landmark of row `k`, where that row is finished.
    fn landmark(&self, k: usize) -> Option<u32>;
    /// Lowers `field` to the distances of the finished row `k` where those are smaller.
    fn lower(&self, k: usize, field: &mut [f32]);
}

impl Finished for () {
    fn landmark(&self, _: usize) -> Option<u32> {
        None
    }
    fn lower(&self, _: usize, _: &mut [f32]) {}
}

/// Rounds of "farthest from the last" before the first landmark is taken.
pub const SEEDING_ROUNDS: usize = 2;

/// An extremity of the shape: from a random face to the face farthest from it in space, and on from there for
/// [`SEEDING_ROUNDS`] rounds; the first of equally far ones. In space instead of along the surface: as
/// much of an extremity, for two passes over centroids instead of full fronts that nothing can run beside.
pub fn extremity(nodes: &[Node], seed: u64) -> u32 {
    let mut at = below(&mut stream(seed, "first landmark"), nodes.len());
    for _ in 0..SEEDING_ROUNDS {
        let from = nodes[at].centroid;
        let mut most = -1.;
        for (k, node) in nodes.iter().enumerate() {
            let to = node.centroid;
            let (x, y, z) = (to[0] - from[0], to[1] - from[1], to[2] - from[2]);
            let square = x * x + y * y + z * z;
            if square > most {
                (most, at) = (square, k);
            }
        }
    }
    at as u32
}

/// Sends up to `l` distinct landmarks to `found` (fewer only where there are fewer nodes). With
/// farthest points, `field` (n) ends as the distance to the nearest of all but the last landmark, and
/// `found` sees it right after the first landmark's own full front, as that landmark's row. Rows in `finished` are
/// taken over: the field is the minimum of the rows so far, however these were computed, so the landmarks are
/// the same as without. `front` is one for this graph.
///
/// # Errors
/// [`crate::base::Error::Cancelled`], or an error of `found`.
pub fn choose(
    sampling: Sampling,
    l: usize,
    graph: Csr<'_>,
    nodes: &[Node],
    seed: u64,
    field: &mut [f32],
    front: &mut Front,
    cancel: &Cancel,
    finished: &impl Finished,
    mut found: impl FnMut(u32, Option<&[f32]>) -> Result<()>,
) -> Result<()> {
    let l = l.min(graph.len());
    match sampling {
        Sampling::Farthest => farthest(l, graph, nodes, seed, field, front, cancel, finished, found),
        Sampling::Random => random(l, nodes, seed).into_iter().try_for_each(|landmark| found(landmark, None)),
    }
}

fn farthest(
    l: usize,
    graph: Csr<'_>,
    nodes: &[Node],
    seed: u64,
    field: &mut [f32],
    front: &mut Front,
    cancel: &Cancel,
    finished: &impl Finished,
    mut found: impl FnMut(u32, Option<&[f32]>) -> Result<()>,
) -> Result<()> {
    if let Some(first) = finished.landmark(0) {
        field.fill(f32::INFINITY);
        finished.lower(0, field);
        found(first, None)?;
    } else {
        let landmark = extremity(nodes, seed);
        front.full(graph, landmark, field, cancel)?;
        front.advise(field, Access::Sequential);
        found(landmark, Some(field))?;
    }
    for k in 1..l {
        cancel.check()?;
        // Pages are waited for one by one otherwise.
        front.advise(field, Access::Sequential);
        let landmark = farthest_node(field);
        front.advise(field, Access::Random);
        found(landmark, None)?;
        if k + 1 == l {
            break;
        }
        if finished.landmark(k) == Some(landmark) {
            finished.lower(k, field);
        } else {
            front.lower(graph, &[landmark], field, cancel)?;
        }
    }
    Ok(())
}

/// The first node of greatest distance; infinite counts as the greatest.
pub fn farthest_node(field: &[f32]) -> u32 {
    // Blocks first: the inner maximum vectorises, the search for its place runs once.
    const BLOCK: usize = 4096;
    let (mut best, mut at) = (f32::NEG_INFINITY, 0);
    for (k, block) in field.chunks(BLOCK).enumerate() {
        let top = block.iter().fold(f32::NEG_INFINITY, |a, &b| if b > a { b } else { a });
        if top > best {
            (best, at) = (top, k);
        }
    }
    let block = &field[at * BLOCK..field.len().min((at + 1) * BLOCK)];
    (at * BLOCK + block.iter().position(|&d| d == best).unwrap_or(0)) as u32
}

/// `l` distinct nodes at random by area (evenly where there is none), by two passes over the nodes.
fn random(l: usize, nodes: &[Node], seed: u64) -> Vec<u32> {
    let mut draw = stream(seed, "random landmarks");
    let total: f64 = nodes.iter().map(|node| f64::from(node.area)).sum();
    let mut chosen: Vec<u32> = Vec::with_capacity(l);
    let mut rounds = 0;
    while chosen.len() < l && rounds < 64 && total > 0. {
        rounds += 1;
        let mut targets: Vec<(f64, usize)> = (chosen.len()..l).map(|k| (unit(&mut draw) * total, k)).collect();
        targets.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (mut sum, mut next) = (0f64, 0);
        let mut picks = Vec::with_capacity(targets.len());
        for (node, geometry) in nodes.iter().enumerate() {
            sum += f64::from(geometry.area);
            while next < targets.len() && targets[next].0 < sum {
                picks.push((targets[next].1, node as u32));
                next += 1;
            }
        }
        picks.sort_unstable();
        for (_, node) in picks {
            if !chosen.contains(&node) {
                chosen.push(node);
            }
        }
    }
    // Nearly all drawn, or hardly any area: fill up in order, faces with area first.
    let (with, without): (Vec<u32>, Vec<u32>) = match l - chosen.len() {
        0 => Default::default(),
        _ => (0..nodes.len() as u32)
            .filter(|node| !chosen.contains(node))
            .partition(|&node| nodes[node as usize].area > 0.),
    };
    chosen.extend(with.into_iter().chain(without).take(l - chosen.len()));
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_farthest_node_is_the_first_of_the_greatest() {
        let mut field: Vec<f32> = (0..10_000).map(|i| ((i * 7919) % 10_007) as f32).collect();
        assert_eq!(farthest_node(&field), crate::distance::oracle::farthest(&field));
        field[9_000] = f32::INFINITY;
        field[9_500] = f32::INFINITY;
        assert_eq!(farthest_node(&field), 9_000);
    }

    #[test]
    fn random_landmarks_are_distinct_and_avoid_faces_without_area() {
        let mut nodes = vec![Node::default(); 100];
        for (k, node) in nodes.iter_mut().enumerate() {
            node.area = if k % 2 == 0 { 1. } else { 0. };
        }
        let mut chosen = random(50, &nodes, 3);
        chosen.sort_unstable();
        assert_eq!(chosen, (0..50).map(|k| 2 * k).collect::<Vec<_>>());
        assert_eq!(random(3, &[Node::default(); 3], 0).len(), 3);
    }
}
