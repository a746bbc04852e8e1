//! Weighted K-means for a few thousand points, seeded by greedy k-means++.
//!
//! Points lie in blocks of sixteen, one coordinate after the other, so that distances to a centre
//! are plain vector arithmetic in single precision; centres are summed in double precision and in
//! point order. The result depends on the points, the weights and the random stream alone.

use crate::base::random::{Random, unit};

/// Points a block.
const LANES: usize = 16;

/// How to run a K-means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KMeans {
    /// Clusters wanted; no more than there are points are made.
    pub clusters: usize,
    /// Independent starts, of which the cheapest is kept.
    pub restarts: usize,
    /// Rounds of assigning and averaging at most.
    pub rounds: usize,
    /// Candidates a seed of the greedy k-means++, the best of which is taken.
    pub candidates: usize,
    /// A run ends when a round lowers its cost by less than this share.
    pub tolerance: f64,
}

/// Points in blocks: block b holds coordinate c of its points at `b·d·16 + c·16`.
struct Blocks {
    values: Vec<[f32; LANES]>,
    norm: Vec<[f32; LANES]>,
    n: usize,
    d: usize,
}

impl Blocks {
    fn new(points: &[f64], n: usize, d: usize) -> Blocks {
        let count = n.div_ceil(LANES);
        let mut values = vec![[0.0; LANES]; count * d];
        let mut norm = vec![[0.0; LANES]; count];
        for i in 0..n {
            for c in 0..d {
                let x = points[i * d + c] as f32;
                values[i / LANES * d + c][i % LANES] = x;
                norm[i / LANES][i % LANES] += x * x;
            }
        }
        Blocks { values, norm, n, d }
    }

    fn block(&self, b: usize) -> &[[f32; LANES]] {
        &self.values[b * self.d..(b + 1) * self.d]
    }

    fn point(&self, i: usize) -> impl Iterator<Item = f32> + '_ {
        self.block(i / LANES).iter().map(move |x| x[i % LANES])
    }

    /// Squared distances of block `b`'s points from a centre, up to rounding ≥ 0.
    fn squares(&self, b: usize, centre: &[f32], square: f32) -> [f32; LANES] {
        let mut sum = [0.0f32; LANES];
        for (x, c) in self.block(b).iter().zip(centre) {
            for k in 0..LANES {
                sum[k] += x[k] * c;
            }
        }
        let norm = &self.norm[b];
        std::array::from_fn(|k| (norm[k] + square - 2.0 * sum[k]).max(0.0))
    }
}

impl KMeans {
    /// Clusters `points` (row-major n × d) under `weight` (n, > 0): a label below
    /// min(clusters, n) a point. Not every label need occur where points coincide.
    pub fn run(&self, points: &[f64], weight: &[f64], random: &mut Random) -> Vec<u32> {
        let n = weight.len();
        let k = self.clusters.clamp(1, n.max(1));
        let d = points.len().checked_div(n).unwrap_or(0);
        if k == 1 || d == 0 {
            return vec![0; n];
        }
        let blocks = Blocks::new(points, n, d);
        let mut best: Option<(f64, Vec<u32>)> = None;
        for _ in 0..self.restarts.max(1) {
            let mut centres = self.seeds(&blocks, weight, k, random);
            let (cost, label) = self.rounds(&blocks, weight, &mut centres);
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, label));
            }
        }
        best.map_or_else(|| vec![0; n], |(_, label)| label)
    }

    /// Greedy k-means++: each seed is the best of a few drawn by weight × squared distance.
    fn seeds(&self, x: &Blocks, weight: &[f64], k: usize, random: &mut Random) -> Vec<f32> {
        let mut centres = Vec::with_capacity(k * x.d);
        let mut near = vec![[f32::MAX; LANES]; x.norm.len()];
        let mut sums: Vec<f64> = Vec::with_capacity(x.n);
        for made in 0..k {
            let mut total = 0.0;
            sums.clear();
            sums.extend((0..x.n).map(|i| {
                let square = if made == 0 { 1.0 } else { f64::from(near[i / LANES][i % LANES]) + 1e-30 };
                total += weight[i] * square;
                total
            }));
            let mut best: Option<(f64, usize, Vec<[f32; LANES]>)> = None;
            for _ in 0..if made == 0 { 1 } else { self.candidates.max(1) } {
                let target = unit(random) * total;
                let pick = sums.partition_point(|&s| s <= target).min(x.n - 1);
                let centre: Vec<f32> = x.point(pick).collect();
                let square = x.norm[pick / LANES][pick % LANES];
                let mut cost = 0.0;
                let trial: Vec<[f32; LANES]> = (0..near.len())
                    .map(|b| {
                        let d = x.squares(b, &centre, square);
                        let low: [f32; LANES] = std::array::from_fn(|i| d[i].min(near[b][i]));
                        let part = &weight[b * LANES..x.n.min((b + 1) * LANES)];
                        cost += part.iter().zip(&low).map(|(w, l)| w * f64::from(*l)).sum::<f64>();
                        low
                    })
                    .collect();
                if best.as_ref().is_none_or(|(least, ..)| cost < *least) {
                    best = Some((cost, pick, trial));
                }
            }
            if let Some((_, pick, trial)) = best {
                centres.extend(x.point(pick));
                near = trial;
            }
        }
        centres
    }

    /// Lloyd's rounds: the last assignment and its cost.
    fn rounds(&self, x: &Blocks, weight: &[f64], centres: &mut [f32]) -> (f64, Vec<u32>) {
        let (d, k) = (x.d, centres.len() / x.d);
        let mut label = vec![0u32; x.norm.len() * LANES];
        let mut sums = vec![0.0f64; k * d];
        let mut mass = vec![0.0f64; k];
        let mut last = f64::INFINITY;
        for round in 1.. {
            let squares: Vec<f32> = centres.chunks_exact(d).map(|c| c.iter().map(|x| x * x).sum()).collect();
            let mut cost = 0.0;
            for b in 0..x.norm.len() {
                let (nearest, least) = assign(x.block(b), centres, &squares);
                label[b * LANES..(b + 1) * LANES].copy_from_slice(&nearest);
                let part = &weight[b * LANES..x.n.min((b + 1) * LANES)];
                for ((w, low), norm) in part.iter().zip(&least).zip(&x.norm[b]) {
                    cost += w * f64::from((low + norm).max(0.0));
                }
            }
            if round >= self.rounds.max(1) || last - cost < self.tolerance * last {
                last = cost;
                break;
            }
            last = cost;
            sums.fill(0.0);
            mass.fill(0.0);
            for (i, w) in weight.iter().enumerate() {
                let c = label[i] as usize;
                mass[c] += w;
                for (s, v) in sums[c * d..(c + 1) * d].iter_mut().zip(x.point(i)) {
                    *s += w * f64::from(v);
                }
            }
            for c in (0..k).filter(|&c| mass[c] > 1e-30) {
                for (to, s) in centres[c * d..(c + 1) * d].iter_mut().zip(&sums[c * d..(c + 1) * d]) {
                    *to = (s / mass[c]) as f32;
                }
            }
        }
        label.truncate(x.n);
        (last, label)
    }
}

/// For each point of a block the nearest centre and its |c|² − 2 x·c, two centres at a time.
fn assign(block: &[[f32; LANES]], centres: &[f32], squares: &[f32]) -> ([u32; LANES], [f32; LANES]) {
    let d = block.len();
    let (mut nearest, mut least) = ([0u32; LANES], [f32::MAX; LANES]);
    for (c, (centre, square)) in centres.chunks_exact(d).zip(squares).enumerate() {
        let mut sum = [0.0f32; LANES];
        for (x, c) in block.iter().zip(centre) {
            for k in 0..LANES {
                sum[k] += x[k] * c;
            }
        }
        for k in 0..LANES {
            let value = square - 2.0 * sum[k];
            let closer = value < least[k];
            least[k] = if closer { value } else { least[k] };
            nearest[k] = if closer { c as u32 } else { nearest[k] };
        }
    }
    (nearest, least)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::stream;

    const PLAIN: KMeans = KMeans { clusters: 3, restarts: 2, rounds: 20, candidates: 3, tolerance: 1e-6 };

    #[test]
    fn three_clumps_are_found() {
        let points: Vec<f64> = (0..60)
            .flat_map(|i| {
                let (x, y) = [(0.0, 0.0), (5.0, 0.0), (0.0, 5.0)][i % 3];
                [x + (i as f64 * 0.7).sin() * 0.3, y + (i as f64 * 1.3).cos() * 0.3]
            })
            .collect();
        let label = PLAIN.run(&points, &[1.0; 60], &mut stream(0, "test"));
        for i in 0..60 {
            assert_eq!(label[i], label[i % 3]);
        }
        assert!(label[0] != label[1] && label[1] != label[2] && label[0] != label[2]);
    }

    #[test]
    fn fewer_points_than_clusters_and_equal_points_are_no_trouble() {
        assert_eq!(PLAIN.run(&[], &[], &mut stream(0, "test")), Vec::<u32>::new());
        assert_eq!(PLAIN.run(&[1.0, 2.0], &[1.0], &mut stream(0, "test")), [0]);
        let label = PLAIN.run(&[1.0, 9.0], &[1.0, 1.0], &mut stream(0, "test"));
        assert_ne!(label[0], label[1]);
        assert_eq!(PLAIN.run(&[1.0; 8], &[1.0; 8], &mut stream(0, "test")).len(), 8);
    }
}
