//! Triangle strips, unrolled one vertex at a time; holds two vertices.

/// A triangle strip being unrolled.
#[derive(Default)]
pub(super) struct Strip {
    last: [u32; 2],
    seen: u64,
}

impl Strip {
    /// Takes the next vertex; gives the triangle it closes, unless that repeats a vertex: such
    /// triangles only lead a strip around a corner.
    #[inline]
    pub(super) fn next(&mut self, vertex: u32) -> Option<[u32; 3]> {
        let [a, b] = self.last;
        self.last = [b, vertex];
        self.seen += 1;
        let real = self.seen >= 3 && a != b && b != vertex && a != vertex;
        // Every other triangle of a strip is wound the other way round.
        real.then_some(if self.seen % 2 == 1 { [a, b, vertex] } else { [b, a, vertex] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_alternate_and_leave_out_repeated_vertices() {
        let mut strip = Strip::default();
        let triangles: Vec<_> = [0, 1, 2, 3, 3, 4, 5].into_iter().filter_map(|vertex| strip.next(vertex)).collect();
        assert_eq!(triangles, [[0, 1, 2], [2, 1, 3], [3, 4, 5]]);
    }
}
