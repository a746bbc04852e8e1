//! Weighted K-means for a few thousand points, seeded by greedy k-means++.
//!
//! Points are stored in blocks of sixteen, coordinate by coordinate, so that distances to a few centres at a time are
//! plain vector arithmetic in single precision; centres are summed in double precision and in point order. The result
//! depends only on the points, the weights and the random stream.
//!
//! [`crate::cluster::kmeans`] fits centres to sampled faces, coordinate by coordinate and on all threads. This one
//! labels cells, runs a dozen times in each decision, is vectorised for a single thread, and draws its seeds so that
//! small changes of the points change few of them ([`crate::base::random::weighted_by_key`]). Cost: n k d multiply-adds
//! per round, 8 n d bytes.

use crate::base::random::{Random, weighted_by_key};
use crate::base::simd::{SimdKernel, dispatch};
use rand_xoshiro::rand_core::Rng;

/// Points per block.
const LANES: usize = 16;
/// Number of centres compared with a block at a time, so that loaded points are used several times.
const GROUP: usize = 4;

/// Parameters of a K-means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellKMeans {
    /// Number of clusters; capped at the number of points.
    pub clusters: usize,
    /// Independent starts, of which the one with the least cost is kept.
    pub restarts: usize,
    /// Maximum number of rounds of assigning and averaging.
    pub rounds: usize,
    /// Candidates per seed of the greedy k-means++, the best of which is taken.
    pub candidates: usize,
    /// A run ends when a round lowers its cost by less than this share.
    pub tolerance: f64,
}

/// Points in blocks: block b holds coordinate c of its points at `b·d·16 + c·16`.
struct PointBlocks {
    values: Vec<[f32; LANES]>,
    norm: Vec<[f32; LANES]>,
    /// The same points row by row (n × d).
    rows: Vec<f32>,
    n: usize,
    d: usize,
}

/// Centres in groups of [`GROUP`], coordinate by coordinate; the last group is padded with infinitely distant ones.
#[derive(Default)]
struct CentreGroups {
    values: Vec<[f32; GROUP]>,
    square: Vec<[f32; GROUP]>,
}

impl CentreGroups {
    /// Replaces the centres by `centres`, row-major k × d.
    fn set(&mut self, centres: &[f32], d: usize) {
        let count = centres.len().div_ceil(d * GROUP);
        self.values.clear();
        self.values.resize(count * d, [0.0; GROUP]);
        self.square.clear();
        self.square.resize(count, [f32::INFINITY; GROUP]);
        for (k, centre) in centres.chunks_exact(d).enumerate() {
            let (g, lane) = (k / GROUP, k % GROUP);
            for (slot, x) in self.values[g * d..].iter_mut().zip(centre) {
                slot[lane] = *x;
            }
            self.square[g][lane] = centre.iter().map(|x| x * x).sum();
        }
    }
}

/// Inner products of a block's points with a group of centres.
#[inline(always)]
fn products(block: &[[f32; LANES]], group: &[[f32; GROUP]]) -> [[f32; LANES]; GROUP] {
    // Unrolled by hand: a loop over the four would be vectorised along the wrong axis.
    let [mut a, mut b, mut c, mut d] = [[0.0f32; LANES]; GROUP];
    let group = &group[..block.len()];
    for k in 0..block.len() {
        add_product(&mut a, &block[k], group[k][0]);
        add_product(&mut b, &block[k], group[k][1]);
        add_product(&mut c, &block[k], group[k][2]);
        add_product(&mut d, &block[k], group[k][3]);
    }
    [a, b, c, d]
}

#[inline(always)]
fn add_product(sum: &mut [f32; LANES], x: &[f32; LANES], c: f32) {
    for k in 0..LANES {
        sum[k] += x[k] * c;
    }
}

impl PointBlocks {
    #[inline(always)]
    fn new(points: &[f64], n: usize, d: usize) -> PointBlocks {
        let count = n.div_ceil(LANES);
        let mut values = vec![[0.0; LANES]; count * d];
        let mut norm = vec![[0.0; LANES]; count];
        let rows: Vec<f32> = points.iter().map(|x| *x as f32).collect();
        for ((rows, values), norm) in rows.chunks(LANES * d).zip(values.chunks_exact_mut(d)).zip(&mut norm) {
            for (lane, row) in rows.chunks_exact(d).enumerate() {
                for (slot, x) in values.iter_mut().zip(row) {
                    slot[lane] = *x;
                }
            }
            for x in values {
                for k in 0..LANES {
                    norm[k] += x[k] * x[k];
                }
            }
        }
        PointBlocks { values, norm, rows, n, d }
    }

    #[inline(always)]
    fn point(&self, i: usize) -> &[f32] {
        &self.rows[i * self.d..(i + 1) * self.d]
    }
}

impl CellKMeans {
    /// Clusters `points` (row-major n × d) with `weight` (n, > 0): returns a label below min(clusters, n) per point. If
    /// points coincide, some labels may not occur. Draws depend on `names` (n), the identifiers of the points.
    pub fn run(&self, points: &[f64], weight: &[f64], names: &[u32], random: &mut Random) -> Vec<u32> {
        dispatch(CellKMeansJob { how: self, points, weight, names, random })
    }

    /// Greedy k-means++: each seed is the best of a few drawn by weight × squared distance.
    #[inline(always)]
    fn seeds(&self, x: &PointBlocks, weight: &[f64], names: &[u32], k: usize, random: &mut Random) -> Vec<f32> {
        let mut centres: Vec<f32> = Vec::with_capacity(k * x.d);
        let mut near = vec![[f32::MAX; LANES]; x.norm.len()];
        let mut pulls: Vec<f64> = Vec::with_capacity(x.n);
        let (mut drawn, mut groups) = (Vec::new(), CentreGroups::default());
        for made in 0..k {
            pulls.clear();
            for (i, w) in weight.iter().enumerate() {
                let near = near[i / LANES][i % LANES];
                pulls.push(w * if made == 0 { 1.0 } else { f64::from(near) + 1e-30 });
            }
            drawn.clear();
            for _ in 0..if made == 0 { 1 } else { self.candidates.max(1) } {
                let items = (0..x.n).map(|i| (u64::from(names[i]), pulls[i]));
                drawn.push(weighted_by_key(random.next_u64(), items));
            }
            let candidates: Vec<f32> = drawn.iter().flat_map(|&pick| x.point(pick)).copied().collect();
            groups.set(&candidates, x.d);
            let mut best = (f64::INFINITY, drawn[0], 0);
            for (g, picks) in drawn.chunks(GROUP).enumerate() {
                let cost = costs(x, weight, &near, &groups, g);
                for (lane, (&pick, cost)) in picks.iter().zip(cost).enumerate() {
                    if cost < best.0 {
                        best = (cost, pick, g * GROUP + lane);
                    }
                }
            }
            let (_, pick, candidate) = best;
            centres.extend(x.point(pick));
            let (g, lane) = (candidate / GROUP, candidate % GROUP);
            for (b, near) in near.iter_mut().enumerate() {
                *near = lowered(x, b, near, &groups, g)[lane];
            }
        }
        centres
    }

    /// Lloyd's rounds: returns the last assignment and its cost.
    #[inline(always)]
    fn rounds(&self, x: &PointBlocks, weight: &[f64], centres: &mut [f32]) -> (f64, Vec<u32>) {
        let (d, k) = (x.d, centres.len() / x.d);
        let mut label = vec![[0u32; LANES]; x.norm.len()];
        let mut sums = vec![0.0f64; k * d];
        let mut mass = vec![0.0f64; k];
        let mut last = f64::INFINITY;
        let mut groups = CentreGroups::default();
        for round in 1.. {
            groups.set(centres, d);
            let mut cost = 0.0;
            for (b, part) in weight.chunks(LANES).enumerate() {
                let (nearest, least) = assign(&x.values[b * d..(b + 1) * d], &groups);
                label[b] = nearest;
                for k in 0..part.len() {
                    cost += part[k] * f64::from((least[k] + x.norm[b][k]).max(0.0));
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
                let (c, point) = (label[i / LANES][i % LANES] as usize, x.point(i));
                mass[c] += w;
                let sums = &mut sums[c * d..(c + 1) * d];
                for k in 0..d {
                    sums[k] += w * f64::from(point[k]);
                }
            }
            for c in (0..k).filter(|&c| mass[c] > 1e-30) {
                for (to, s) in centres[c * d..(c + 1) * d].iter_mut().zip(&sums[c * d..(c + 1) * d]) {
                    *to = (s / mass[c]) as f32;
                }
            }
        }
        (last, label.as_flattened()[..x.n].to_vec())
    }
}

/// [`CellKMeans::run`] on wide vectors.
struct CellKMeansJob<'a> {
    how: &'a CellKMeans,
    points: &'a [f64],
    weight: &'a [f64],
    names: &'a [u32],
    random: &'a mut Random,
}

impl SimdKernel for CellKMeansJob<'_> {
    type Output = Vec<u32>;

    #[inline(always)]
    fn run(self) -> Vec<u32> {
        let CellKMeansJob { how, points, weight, names, random } = self;
        let n = weight.len();
        let k = how.clusters.clamp(1, n.max(1));
        let d = points.len().checked_div(n).unwrap_or(0);
        if k == 1 || d == 0 {
            return vec![0; n];
        }
        let blocks = PointBlocks::new(points, n, d);
        let mut best: Option<(f64, Vec<u32>)> = None;
        for _ in 0..how.restarts.max(1) {
            let mut centres = how.seeds(&blocks, weight, names, k, random);
            let (cost, label) = how.rounds(&blocks, weight, &mut centres);
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, label));
            }
        }
        best.map_or_else(|| vec![0; n], |(_, label)| label)
    }
}

/// Squared distances of block `b`'s points to the nearest centre, so far `near`, if each centre of group `g` were
/// added.
#[inline(always)]
fn lowered(x: &PointBlocks, b: usize, near: &[f32; LANES], groups: &CentreGroups, g: usize) -> [[f32; LANES]; GROUP] {
    let d = x.d;
    let (mut sum, norm) = (products(&x.values[b * d..(b + 1) * d], &groups.values[g * d..(g + 1) * d]), &x.norm[b]);
    for c in 0..GROUP {
        for k in 0..LANES {
            sum[c][k] = (norm[k] + groups.square[g][c] - 2.0 * sum[c][k]).max(0.0).min(near[k]);
        }
    }
    sum
}

/// The total cost if each centre of group `g` were added.
#[inline(always)]
fn costs(x: &PointBlocks, weight: &[f64], near: &[[f32; LANES]], groups: &CentreGroups, g: usize) -> [f64; GROUP] {
    let mut cost = [0.0; GROUP];
    for (b, part) in weight.chunks(LANES).enumerate() {
        let low = lowered(x, b, &near[b], groups, g);
        let mut sum = [0.0; GROUP];
        for (k, w) in part.iter().enumerate() {
            for c in 0..GROUP {
                sum[c] += w * f64::from(low[c][k]);
            }
        }
        (0..GROUP).for_each(|c| cost[c] += sum[c]);
    }
    cost
}

/// For each point of a block the nearest centre and its |c|² − 2 x·c.
#[inline(always)]
fn assign(block: &[[f32; LANES]], groups: &CentreGroups) -> ([u32; LANES], [f32; LANES]) {
    let (mut nearest, mut least) = ([0u32; LANES], [f32::MAX; LANES]);
    for (g, square) in groups.square.iter().enumerate() {
        let sum = products(block, &groups.values[g * block.len()..(g + 1) * block.len()]);
        for c in 0..GROUP {
            for k in 0..LANES {
                let value = square[c] - 2.0 * sum[c][k];
                let closer = value < least[k];
                least[k] = if closer { value } else { least[k] };
                nearest[k] = if closer { (g * GROUP + c) as u32 } else { nearest[k] };
            }
        }
    }
    (nearest, least)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::stream;

    const PLAIN: CellKMeans = CellKMeans { clusters: 3, restarts: 2, rounds: 20, candidates: 3, tolerance: 1e-6 };

    fn names(n: u32) -> Vec<u32> {
        (0..n).collect()
    }

    #[test]
    fn three_clumps_are_found() {
        let points: Vec<f64> = (0..60)
            .flat_map(|i| {
                let (x, y) = [(0.0, 0.0), (5.0, 0.0), (0.0, 5.0)][i % 3];
                [x + (i as f64 * 0.7).sin() * 0.3, y + (i as f64 * 1.3).cos() * 0.3]
            })
            .collect();
        let label = PLAIN.run(&points, &[1.0; 60], &names(60), &mut stream(0, "test"));
        for i in 0..60 {
            assert_eq!(label[i], label[i % 3]);
        }
        assert!(label[0] != label[1] && label[1] != label[2] && label[0] != label[2]);
    }

    #[test]
    fn fewer_points_than_clusters_and_equal_points_are_no_trouble() {
        assert_eq!(PLAIN.run(&[], &[], &[], &mut stream(0, "test")), Vec::<u32>::new());
        assert_eq!(PLAIN.run(&[1.0, 2.0], &[1.0], &[0], &mut stream(0, "test")), [0]);
        let label = PLAIN.run(&[1.0, 9.0], &[1.0, 1.0], &names(2), &mut stream(0, "test"));
        assert_ne!(label[0], label[1]);
        assert_eq!(PLAIN.run(&[1.0; 8], &[1.0; 8], &names(8), &mut stream(0, "test")).len(), 8);
    }
}
