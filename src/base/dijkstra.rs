//! Shortest paths over an in-memory graph of some thousand nodes: Dijkstra's algorithm with a binary heap.
//!
//! The graph is a function from a node to its outgoing edges, so it need not be stored in any particular form. This is
//! our own code because results depend on the order in which nodes are settled: by distance, then by number. Cost: O((n
//! + m) log m) for n nodes and m edges; 8 to 16 bytes for each entry of the heap.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::ops::Add;

/// The length of a path, never negative: `f32` or `f64`.
pub trait Length: Copy + Default + PartialOrd + Add<Output = Self> {
    /// The bits as an integer. The bits of non-negative floats have the same order as the floats.
    type Bits: Copy + Ord;
    /// The bits of a length.
    fn bits(self) -> Self::Bits;
    /// The length with these bits.
    fn of_bits(bits: Self::Bits) -> Self;
}

macro_rules! length {
    ($float:ty, $bits:ty) => {
        impl Length for $float {
            type Bits = $bits;
            #[inline(always)]
            fn bits(self) -> $bits {
                self.to_bits()
            }
            #[inline(always)]
            fn of_bits(bits: $bits) -> Self {
                Self::from_bits(bits)
            }
        }
    };
}
length!(f32, u32);
length!(f64, u64);

/// Lowers each entry of `field` (n) to the distance of the node from the nearest of `sources`, where that is smaller
/// and below `limit`. `steps` lists the neighbours of a node with the lengths of the edges to them; `on_settled` is
/// called with each node whose distance was lowered, nearest first.
pub fn shortest_paths<L: Length, S: Iterator<Item = (u32, L)>>(
    sources: &[u32],
    steps: impl Fn(u32) -> S,
    limit: L,
    field: &mut [L],
    mut on_settled: impl FnMut(u32),
) {
    let mut queue = BinaryHeap::new();
    for &source in sources {
        field[source as usize] = L::default();
        queue.push(Reverse((L::default().bits(), source)));
    }
    while let Some(Reverse((bits, node))) = queue.pop() {
        let length = L::of_bits(bits);
        if length > field[node as usize] {
            continue;
        }
        on_settled(node);
        for (to, step) in steps(node) {
            let through = length + step;
            if through < field[to as usize] && through < limit {
                field[to as usize] = through;
                queue.push(Reverse((through.bits(), to)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shorter_way_round_a_ring_is_found() {
        // 0 to 5 in a ring; the step from 5 to 0 is long.
        let steps = |i: u32| [((i + 1) % 6, if i == 5 { 4. } else { 1. }), ((i + 5) % 6, if i == 0 { 4. } else { 1. })];
        let (mut field, mut order) = ([f32::INFINITY; 6], Vec::new());
        shortest_paths(&[1], |i| steps(i).into_iter(), f32::INFINITY, &mut field, |i| order.push(i));
        assert_eq!((field, order), ([1., 0., 1., 2., 3., 4.], vec![1, 0, 2, 3, 4, 5]));
        let mut near = [9.; 6];
        shortest_paths(&[1, 4], |i| steps(i).into_iter(), 1., &mut near, |_| ());
        assert_eq!(near, [9., 0., 9., 9., 0., 9.], "what is not below the limit stays");
    }
}
