//! Small things that labellings need: numbering, intersecting, summing, joining.

/// Renumbers labels 0, 1, … in order of first appearance; also how many there are.
pub fn compact(label: &[u32]) -> (Vec<u32>, usize) {
    let mut number = vec![u32::MAX; label.iter().max().map_or(0, |&m| m as usize + 1)];
    let mut next = 0;
    let out = label
        .iter()
        .map(|&x| {
            let slot = &mut number[x as usize];
            if *slot == u32::MAX {
                *slot = next;
                next += 1;
            }
            *slot
        })
        .collect();
    (out, next as usize)
}

/// The intersections of two labellings of the same things, numbered by first appearance.
pub fn intersect(a: &[u32], b: &[u32]) -> (Vec<u32>, usize) {
    let mut order: Vec<(u32, u32, u32)> = a.iter().zip(b).zip(0u32..).map(|((&a, &b), i)| (a, b, i)).collect();
    order.sort_unstable();
    let mut label = vec![0; a.len()];
    for w in 0..order.len() {
        let same = w > 0 && (order[w].0, order[w].1) == (order[w - 1].0, order[w - 1].1);
        label[order[w].2 as usize] = if same { label[order[w - 1].2 as usize] } else { order[w].2 };
    }
    compact(&label)
}

/// Sum of `value` over each of `n` classes, in order.
pub fn class_sums(label: &[u32], value: &[f64], n: usize) -> Vec<f64> {
    let mut sum = vec![0.0; n];
    for (&k, v) in label.iter().zip(value) {
        sum[k as usize] += v;
    }
    sum
}

/// A forest of disjoint sets whose representative is always the least member.
pub(super) struct Sets(Vec<u32>);

impl Sets {
    /// `n` sets of one.
    pub(super) fn new(n: usize) -> Self {
        Sets((0..n as u32).collect())
    }

    /// The least member of the set of `i`.
    pub(super) fn find(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            self.0[i as usize] = self.0[self.0[i as usize] as usize];
            i = self.0[i as usize];
        }
        i
    }

    /// Joins two sets; whether they were two.
    pub(super) fn join(&mut self, i: u32, j: u32) -> bool {
        let (i, j) = (self.find(i), self.find(j));
        self.0[i.max(j) as usize] = i.min(j);
        i != j
    }

    /// The representative of each.
    pub(super) fn labels(mut self) -> Vec<u32> {
        (0..self.0.len() as u32).map(|i| self.find(i)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intersections_are_numbered_by_first_appearance() {
        assert_eq!(intersect(&[3, 3, 1, 1, 3], &[0, 1, 1, 1, 0]), (vec![0, 1, 2, 2, 0], 3));
    }
}
