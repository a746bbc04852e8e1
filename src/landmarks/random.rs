//! Random landmarks: by area, or uniformly. No distances are needed.
//!
//! By area: two passes over the nodes, and one more if a node was drawn twice. Uniformly: O(l). Memory: only the
//! landmarks.

use super::{Found, Sampler, Space, distinct};
use crate::base::Result;
use crate::base::random::{stream, unit};
use crate::base::sort::sort_by;
use crate::graph::NodeView;

/// A node's probability is proportional to its area, so that the sampling does not depend on the density of the mesh.
pub struct ByArea;

/// Every node has the same chance.
pub struct Uniform;

impl Sampler for ByArea {
    fn choose(&self, l: usize, seed: u64, space: &mut dyn Space, _: &mut [f32], found: &mut Found<'_>) -> Result<()> {
        by_area(l, space.nodes(), seed).into_iter().try_for_each(|landmark| found(landmark, None))
    }

    fn is_costly(&self) -> bool {
        false
    }
}

impl Sampler for Uniform {
    fn choose(&self, l: usize, seed: u64, space: &mut dyn Space, _: &mut [f32], found: &mut Found<'_>) -> Result<()> {
        let drawn = distinct(space.nodes().len(), l, seed, "uniform landmarks");
        drawn.into_iter().try_for_each(|landmark| found(landmark, None))
    }

    fn is_costly(&self) -> bool {
        false
    }
}

/// `l` distinct random nodes by area (spread evenly if there is none), in two passes over the nodes.
fn by_area(l: usize, nodes: NodeView<'_>, seed: u64) -> Vec<u32> {
    let mut draw = stream(seed, "random landmarks");
    let mut total = 0f64;
    nodes.each(0..nodes.len(), |_, node| total += f64::from(node.area));
    let mut chosen: Vec<u32> = Vec::with_capacity(l);
    let mut rounds = 0;
    while chosen.len() < l && rounds < 64 && total > 0. {
        rounds += 1;
        let mut targets: Vec<(f64, usize)> = (chosen.len()..l).map(|k| (unit(&mut draw) * total, k)).collect();
        sort_by(&mut targets, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (mut sum, mut next) = (0f64, 0);
        let mut picks = Vec::with_capacity(targets.len());
        nodes.each(0..nodes.len(), |node, geometry| {
            sum += f64::from(geometry.area);
            while next < targets.len() && targets[next].0 < sum {
                picks.push((targets[next].1, node as u32));
                next += 1;
            }
        });
        picks.sort_unstable();
        for (_, node) in picks {
            if !chosen.contains(&node) {
                chosen.push(node);
            }
        }
    }
    // Nearly all nodes drawn, or hardly any area: fill up in order, faces with area first.
    let missing = l - chosen.len();
    let (mut with, mut without) = (Vec::new(), Vec::new());
    for node in (0..nodes.len() as u32).filter(|node| !chosen.contains(node)) {
        if with.len() == missing {
            break;
        }
        // At most as many as are missing: a large mesh may have hardly any area.
        let kind = if nodes.at(node as usize).area > 0. { &mut with } else { &mut without };
        if kind.len() < missing {
            kind.push(node);
        }
    }
    chosen.extend(with.into_iter().chain(without).take(missing));
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::Node;

    #[test]
    fn random_landmarks_are_distinct_and_avoid_faces_without_area() {
        let mut nodes = vec![Node::default(); 100];
        for (k, node) in nodes.iter_mut().enumerate() {
            node.area = if k % 2 == 0 { 1. } else { 0. };
        }
        let mut chosen = by_area(50, nodes[..].into(), 3);
        chosen.sort_unstable();
        assert_eq!(chosen, (0..50).map(|k| 2 * k).collect::<Vec<_>>());
        assert_eq!(by_area(3, [Node::default(); 3][..].into(), 0).len(), 3);
    }
}
