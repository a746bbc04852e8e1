//! Islands dissolved: what has its part's label but no way to the part's core takes the label it lies in.
//!
//! The cores' labels spread over nodes of the same label first, then, ring by ring, over what is left; a node between two labels
//! takes the smaller. Rings are sets, so the result does not depend on the order of visits. Visits every node of the bands
//! once; memory: a ring, 8 bytes a node of it.

use crate::base::Result;
use crate::graph::dual::Csr;
use crate::store::Run;

/// Steps between looks at the stop flag.
const PATIENCE: usize = 1 << 10;
/// What `field` holds at nodes that a core has reached: more than at the core itself, less than any way.
const REACHED: f32 = f32::MIN_POSITIVE;

/// Dissolves islands of `labels` (n) among the nodes where `field` (n) is infinite; cores are 0 there, `rim` is where they
/// end. What a core reaches ends up with a positive, finite field.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn dissolve(graph: Csr<'_>, rim: &[u32], field: &mut [f32], labels: &mut [u32], run: &Run) -> Result<()> {
    let neighbours = |i: u32| &graph.indices[graph.indptr[i as usize] as usize..graph.indptr[i as usize + 1] as usize];
    // Nodes beside an island, and the label they would give it.
    let mut shore: Vec<(u32, u32)> = Vec::new();
    let mut ring: Vec<u32> = rim.to_vec();
    for round in 0.. {
        if round % PATIENCE == 0 {
            run.cancel.check()?;
        }
        let mut next = Vec::new();
        for &i in &ring {
            for &j in neighbours(i) {
                if field[j as usize] < f32::INFINITY {
                    continue;
                }
                if labels[j as usize] == labels[i as usize] {
                    field[j as usize] = REACHED;
                    next.push(j);
                } else {
                    shore.push((j, labels[i as usize]));
                }
            }
        }
        if next.is_empty() {
            break;
        }
        ring = next;
    }
    while !shore.is_empty() {
        run.cancel.check()?;
        shore.retain(|&(j, _)| field[j as usize] == f32::INFINITY);
        shore.sort_unstable();
        shore.dedup_by_key(|entry| entry.0);
        for &(j, label) in &shore {
            labels[j as usize] = label;
            field[j as usize] = REACHED;
        }
        let mut next = Vec::new();
        for &(i, label) in &shore {
            let open = neighbours(i).iter().filter(|&&j| field[j as usize] == f32::INFINITY);
            next.extend(open.map(|&j| (j, label)));
        }
        shore = next;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream};

    /// A grid of w × h nodes with four neighbours each.
    fn grid(w: usize, h: usize) -> (Vec<u64>, Vec<u32>) {
        let (mut indptr, mut indices) = (vec![0], Vec::new());
        for i in 0..w * h {
            let (x, y) = (i % w, i / w);
            let sides =
                [(y > 0, i.wrapping_sub(w)), (x > 0, i.wrapping_sub(1)), (x + 1 < w, i + 1), (y + 1 < h, i + w)];
            indices.extend(sides.iter().filter(|side| side.0).map(|side| side.1 as u32));
            indptr.push(indices.len() as u64);
        }
        (indptr, indices)
    }

    /// By the definition: reached within the label; else ring by ring the smallest label beside it.
    fn oracle(graph: Csr<'_>, field: &[f32], labels: &[u32]) -> Vec<u32> {
        let n = labels.len();
        let of = |i: usize| {
            graph.indices[graph.indptr[i] as usize..graph.indptr[i + 1] as usize].iter().map(|&j| j as usize)
        };
        let (mut out, mut done) = (labels.to_vec(), field.iter().map(|&d| d == 0.).collect::<Vec<_>>());
        while let Some(i) = (0..n).find(|&i| !done[i] && of(i).any(|j| done[j] && labels[j] == labels[i])) {
            done[i] = true;
        }
        loop {
            let before = done.clone();
            for i in (0..n).filter(|&i| !before[i]) {
                if let Some(label) = of(i).filter(|&j| before[j]).map(|j| out[j]).min() {
                    (out[i], done[i]) = (label, true);
                }
            }
            if done == before {
                return out;
            }
        }
    }

    #[test]
    fn islands_take_the_label_they_lie_in() {
        let (w, h) = (23, 17);
        let (indptr, indices) = grid(w, h);
        let weights = vec![1f32; indices.len()];
        let graph = Csr::new(&indptr, &indices, &weights);
        for seed in 0..60 {
            let mut random = stream(seed, "islands");
            let field: Vec<f32> =
                (0..w * h).map(|i| if i % w < 4 || i % w > 18 { 0. } else { f32::INFINITY }).collect();
            let labels: Vec<u32> = (0..w * h)
                .map(|i| {
                    if field[i] == 0. {
                        u32::from(i % w > 4) + 2 * u32::from(i / w > 9)
                    } else {
                        below(&mut random, 4) as u32
                    }
                })
                .collect();
            let rim: Vec<u32> = (0..(w * h) as u32).filter(|i| matches!(*i as usize % w, 3 | 19)).collect();
            let (mut found, mut reached) = (labels.clone(), field.clone());
            dissolve(graph, &rim, &mut reached, &mut found, &Run::new(&())).unwrap();
            assert_eq!(found, oracle(graph, &field, &labels), "{seed}");
            assert!(reached.iter().all(|d| d.is_finite()));
        }
    }
}
