//! Slow, obvious versions that the fast ones are tested and raced against.
#![allow(dead_code)]

use nystrom_stream::graph::Csr;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Dijkstra's algorithm with a binary heap of (distance, node): distances from `source` to every
/// node, infinite where unreached. What `Front::full` must equal to the bit.
pub fn dijkstra(graph: Csr<'_>, source: u32) -> Vec<f32> {
    let mut field = vec![f32::INFINITY; graph.len()];
    field[source as usize] = 0.;
    // Distances are not negative, so their bits order as they do.
    let mut heap = BinaryHeap::from([Reverse((0f32.to_bits(), source))]);
    while let Some(Reverse((bits, node))) = heap.pop() {
        let distance = f32::from_bits(bits);
        if distance > field[node as usize] {
            continue;
        }
        for (next, weight) in graph.neighbours(node) {
            let there = distance + weight;
            if there < field[next as usize] {
                field[next as usize] = there;
                heap.push(Reverse((there.to_bits(), next)));
            }
        }
    }
    field
}

/// The first node of greatest value; unreached (infinite) ones count as the greatest.
pub fn farthest(field: &[f32]) -> u32 {
    let mut best = 0;
    for (node, &distance) in field.iter().enumerate() {
        if distance > field[best] {
            best = node;
        }
    }
    best as u32
}

/// Farthest-point sampling by definition: the first of `l` landmarks is given, each next one has the
/// greatest distance to the nearest before it. O(l) full fronts.
pub fn farthest_points(graph: Csr<'_>, first: u32, l: usize) -> Vec<u32> {
    let mut landmarks = vec![first];
    let mut nearest = dijkstra(graph, first);
    while landmarks.len() < l {
        let next = farthest(&nearest);
        landmarks.push(next);
        for (near, there) in nearest.iter_mut().zip(dijkstra(graph, next)) {
            *near = near.min(there);
        }
    }
    landmarks
}
