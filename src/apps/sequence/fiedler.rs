//! Fiedler vectors: the exact one of a small mesh, as a reference for other orders, and sweeps that improve an
//! extrapolated one on a mesh of any size.
//!
//! Exact: the Laplacian D − A of a component's vertex graph, numbered along a good order so that its rows are short, is
//! factorised by envelope Cholesky; inverse iteration on [`BLOCK`] vectors with Rayleigh–Ritz steps then finds the
//! second eigenvector to a residual of [`RESIDUAL`]. Memory: 8 bytes per entry of the envelope (vertices × mean front);
//! time: vertices × front². Not computed if the budget does not grant that.
//!
//! Sweeps ([`sweep`], Jacobi's method): every coordinate becomes the mean of itself and its neighbours'. A sweep damps
//! high frequencies and leaves the Fiedler vector nearly unchanged. A component's mean is nearly preserved and its
//! range shrinks: coordinates are `f64`, which tolerates a range of 1e-10. Streamed: a sweep reads graph and
//! coordinates once, some 30 bytes per vertex and nearby neighbours, and writes another 8.

use crate::base::random::{stream, unit};
use crate::base::sort::order_by;
use crate::base::vector::inner_product as dot;
use crate::base::{Cancel, Result};
use crate::graph::VertexAdjacency;
use crate::store::npy::ArrayMut;
use crate::store::{Context, MappedSlice};
use nalgebra::DMatrix;

/// Number of vectors iterated together: more than the number of eigenvalues that are ever close.
const BLOCK: usize = 6;
/// ‖Lx − λx‖ / λ at the end.
const RESIDUAL: f64 = 1e-5;
const STEPS: usize = 200;

/// The Laplacian of a connected graph and its factor.
struct Laplacian<'a> {
    rows: &'a [Vec<u32>],
    /// First column of each row of the envelope.
    first: Vec<usize>,
    /// Where each row starts.
    start: Vec<usize>,
    factor: Vec<f64>,
}

/// Number of entries of the envelope of a graph whose vertices are numbered by their indices in `rows`.
fn envelope(rows: &[Vec<u32>]) -> usize {
    rows.iter()
        .enumerate()
        .map(|(i, row)| i + 1 - row.iter().copied().min().map_or(i, |least| i.min(least as usize)))
        .sum()
}

impl<'a> Laplacian<'a> {
    fn factor(rows: &'a [Vec<u32>], cancel: &Cancel) -> Result<Self> {
        let n = rows.len();
        let first: Vec<usize> = rows
            .iter()
            .enumerate()
            .map(|(i, row)| row.iter().copied().min().map_or(i, |w| i.min(w as usize)))
            .collect();
        let mut start = vec![0; n + 1];
        for i in 0..n {
            start[i + 1] = start[i] + i + 1 - first[i];
        }
        let mut factor = vec![0f64; start[n]];
        for i in 0..n {
            if i % 256 == 0 {
                cancel.check()?;
            }
            let (before, rest) = factor.split_at_mut(start[i]);
            let row = &mut rest[..i + 1 - first[i]];
            for &w in rows[i].iter().filter(|&&w| (w as usize) < i) {
                row[w as usize - first[i]] = -1.;
            }
            // The Laplacian itself is singular; the shift affects only constants, which are projected out.
            row[i - first[i]] = rows[i].len() as f64 + 1e-9;
            for j in first[i]..i {
                let common = first[i].max(first[j]);
                let above = &before[start[j]..start[j + 1]];
                let sum = dot(&row[common - first[i]..j - first[i]], &above[common - first[j]..j - first[j]]);
                row[j - first[i]] = (row[j - first[i]] - sum) / above[j - first[j]];
            }
            let own = i - first[i];
            let square = row[own] - dot(&row[..own], &row[..own]);
            row[own] = square.max(1e-12).sqrt();
        }
        Ok(Self { rows, first, start, factor })
    }

    fn row(&self, i: usize) -> &[f64] {
        &self.factor[self.start[i]..self.start[i + 1]]
    }

    fn solve(&self, x: &mut [f64]) {
        for i in 0..x.len() {
            let (row, first) = (self.row(i), self.first[i]);
            x[i] = (x[i] - dot(&row[..i - first], &x[first..i])) / row[i - first];
        }
        for i in (0..x.len()).rev() {
            let (row, first) = (self.row(i), self.first[i]);
            x[i] /= row[i - first];
            let value = x[i];
            x[first..i].iter_mut().zip(row).for_each(|(x, r)| *x -= value * r);
        }
    }

    fn times(&self, x: &[f64]) -> Vec<f64> {
        let near = |row: &[u32]| row.iter().map(|&w| x[w as usize]).sum::<f64>();
        self.rows.iter().zip(x).map(|(row, &x)| row.len() as f64 * x - near(row)).collect()
    }
}

/// Makes the vectors orthonormal and orthogonal to constants; drops those that vanish.
fn orthonormal(vectors: &mut Vec<Vec<f64>>) {
    let mut done: Vec<Vec<f64>> = Vec::new();
    for mut x in vectors.drain(..) {
        for _ in 0..2 {
            let mean = x.iter().sum::<f64>() / x.len() as f64;
            x.iter_mut().for_each(|x| *x -= mean);
            for y in &done {
                let part = dot(&x, y);
                x.iter_mut().zip(y).for_each(|(x, y)| *x -= part * y);
            }
            let length = dot(&x, &x).sqrt();
            x.iter_mut().for_each(|x| *x /= length.max(1e-300));
        }
        if dot(&x, &x) > 0.5 {
            done.push(x);
        }
    }
    *vectors = done;
}

/// The second eigenvector of the Laplacian of a connected graph, whose rows list neighbours.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
fn fiedler(rows: &[Vec<u32>], cancel: &Cancel) -> Result<Vec<f64>> {
    let n = rows.len();
    if n < 3 {
        return Ok((0..n).map(|i| i as f64).collect());
    }
    let laplacian = Laplacian::factor(rows, cancel)?;
    let mut draw = stream(0, "fiedler");
    // The numbering itself is a good start.
    let mut block: Vec<Vec<f64>> = vec![(0..n).map(|i| i as f64).collect()];
    block.extend((1..BLOCK.min(n - 1)).map(|_| (0..n).map(|_| unit(&mut draw)).collect()));
    orthonormal(&mut block);
    for _ in 0..STEPS {
        cancel.check()?;
        block.iter_mut().for_each(|x| laplacian.solve(x));
        orthonormal(&mut block);
        let images: Vec<Vec<f64>> = block.iter().map(|x| laplacian.times(x)).collect();
        let small = DMatrix::from_fn(block.len(), block.len(), |i, j| dot(&block[i], &images[j]));
        let eigen = nalgebra::SymmetricEigen::new(0.5 * (&small + small.transpose()));
        let order = order_by(block.len(), |a, b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let mix = |vectors: &[Vec<f64>], k: usize| -> Vec<f64> {
            (0..n).map(|i| (0..vectors.len()).map(|e| eigen.eigenvectors[(e, k)] * vectors[e][i]).sum()).collect()
        };
        let (value, image) = (eigen.eigenvalues[order[0]], mix(&images, order[0]));
        block = order.iter().map(|&k| mix(&block, k)).collect();
        let residual: f64 = image.iter().zip(&block[0]).map(|(y, x)| (y - value * x).powi(2)).sum();
        if residual.sqrt() <= RESIDUAL * value {
            break;
        }
    }
    Ok(block.swap_remove(0))
}

/// Maximum number of entries of all envelopes: 256 MiB.
const ENTRIES: usize = 1 << 25;
/// Maximum number of vertices.
const VERTICES: usize = 200_000;

/// Ranks of the vertices of `graph` along the Fiedler vectors of its components, which follow each other by their first
/// vertices in the order `good`, which keeps envelopes small; `None` if the mesh is too large, or memory too small.
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn fiedler_ranks(
    name: &str,
    graph: &VertexAdjacency,
    good: &[u32],
    context: Context<'_>,
) -> Result<Option<MappedSlice<u32>>> {
    let n = graph.len();
    if n > VERTICES {
        return Ok(None);
    }
    let Ok(_grant) = context.run.budget.take("the exact order", 200 * n as u64, 200 * n as u64) else {
        return Ok(None);
    };
    let mut order = vec![0u32; n];
    good.iter().enumerate().for_each(|(v, &rank)| order[rank as usize] = v as u32);
    let mut local = vec![u32::MAX; n];
    let (mut components, mut entries) = (Vec::new(), 0);
    for &seed in &order {
        if local[seed as usize] != u32::MAX {
            continue;
        }
        local[seed as usize] = 0;
        let mut members = vec![seed];
        let mut at = 0;
        while at < members.len() {
            for &w in graph.neighbours(members[at]) {
                if local[w as usize] == u32::MAX {
                    local[w as usize] = 0;
                    members.push(w);
                }
            }
            at += 1;
        }
        members.sort_unstable_by_key(|&v| good[v as usize]);
        members.iter().enumerate().for_each(|(k, &v)| local[v as usize] = k as u32);
        let near = |&v: &u32| graph.neighbours(v).iter().map(|&w| local[w as usize]).collect();
        let rows: Vec<Vec<u32>> = members.iter().map(near).collect();
        entries += envelope(&rows);
        if entries > ENTRIES {
            return Ok(None);
        }
        components.push((members, rows));
    }
    let Ok(_grant) = context.run.budget.take("the exact order", 8 * entries as u64, 8 * entries as u64) else {
        return Ok(None);
    };
    let mut array = context.work.array::<u32>(name, &[n])?;
    let mut next = 0;
    for (members, rows) in components {
        let x = fiedler(&rows, &context.run.cancel)?;
        for k in order_by(members.len(), |a, b| x[a].total_cmp(&x[b])) {
            array.data()[members[k] as usize] = next;
            next += 1;
        }
    }
    array.finish(false).map(Some)
}

const CHUNK: usize = 1 << 14;

/// Applies `times` sweeps to `coordinates` (one per vertex of `graph`); returns the result in one of two arrays.
pub fn sweep(
    graph: &VertexAdjacency,
    mut coordinates: ArrayMut<f64>,
    times: usize,
    context: Context<'_>,
) -> Result<ArrayMut<f64>> {
    let n = graph.len();
    let mut other = context.work.array::<f64>("sweep.tmp", &[n])?;
    for _ in 0..times {
        let from = &coordinates.data()[..];
        let fill = |k: usize, out: &mut [f64], (): &mut ()| {
            for (i, x) in out.iter_mut().enumerate() {
                let v = k * CHUNK + i;
                let near = graph.neighbours(v as u32);
                let sum: f64 = near.iter().map(|&w| from[w as usize]).sum();
                *x = (from[v] + sum) / (near.len() + 1) as f64;
            }
            context.run.progress.advance("sweeps", out.len() as u64);
            Ok(())
        };
        context.run.fill_chunks(&mut other.data()[..], CHUNK, || (), fill)?;
        std::mem::swap(&mut coordinates, &mut other);
    }
    Ok(coordinates)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_vector_is_that_of_a_dense_solver() {
        // A bent strip of a grid, 5 wide, with a hole.
        let (long, wide) = (31u32, 5u32);
        let n = (long * wide) as usize;
        let mut rows: Vec<Vec<u32>> = vec![Vec::new(); n];
        let mut join = |a: u32, b: u32| {
            rows[a as usize].push(b);
            rows[b as usize].push(a);
        };
        for x in 0..long {
            for y in 0..wide {
                let v = x * wide + y;
                if x + 1 < long && (x, y) != (12, 2) {
                    join(v, v + wide);
                }
                if y + 1 < wide {
                    join(v, v + 1);
                }
            }
        }
        let dense = DMatrix::from_fn(n, n, |i, j| {
            if i == j {
                rows[i].len() as f64
            } else if rows[i].contains(&(j as u32)) {
                -1.
            } else {
                0.
            }
        });
        let eigen = nalgebra::SymmetricEigen::new(dense);
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let expected = eigen.eigenvectors.column(order[1]);
        let found = fiedler(&rows, &Cancel::default()).unwrap();
        let cosine: f64 = found.iter().zip(expected.iter()).map(|(a, b)| a * b).sum();
        assert!((cosine.abs() - 1.).abs() < 1e-8, "{cosine}");
        assert_eq!(envelope(&rows[..3]), 1 + 2 + 2);
        for n in 0..4 {
            let ring: Vec<Vec<u32>> = (0..n).map(|i| (0..n).filter(|&j| j != i).collect()).collect();
            assert_eq!(fiedler(&ring, &Cancel::default()).unwrap().len(), n as usize);
        }
    }
}
