//! Smooth functions on the cells, and maps of the surface onto itself as matrices in that basis.
//!
//! The functions are eigenfunctions of the Laplacian within the span of Gaussians around samples: a few numbers per
//! cell that do not change with the pose. A map becomes a matrix C with φ(image of x) ≈ Cᵀ φ(x), and a cell is mapped
//! to the cell with the nearest transformed functions. Matrix and map are fitted alternately, with more and more
//! functions (ZoomOut: Melzi et al., 2019), so maps start coarse and end smooth. Cost: some 10 ms for 2,000 cells and
//! 128 samples, and as much for each map.

use super::cell_paths::{CellPaths, Row};
use crate::base::vector::{axpy, distance, square_apart};
use crate::cluster::parts::cell_graph::CellGraph;
use crate::spectral::exp::exp64;
use crate::spectral::laplacian::generalised;
use nalgebra::DMatrix;

/// Maximum number of functions.
const COUNT: usize = 48;
/// Numbers summed in parallel lanes.
const LANES: usize = 8;
/// A Gaussian is 0 beyond this many widths.
const REACH: f32 = 3.0;
/// Iterations towards the orthogonal matrix.
const STEPS: usize = 8;

/// The first functions of a surface, smoothest first.
pub struct Functions {
    /// n × COUNT.
    value: Vec<f32>,
    /// Area shares (S).
    shares: Vec<f32>,
}

/// C, k × k, symmetric, since the map is its own inverse.
#[derive(Clone)]
pub struct FunctionMap {
    k: usize,
    value: Vec<f32>,
}

impl Functions {
    /// The functions of cells with these shares of the area (S); `rows` are those of the samples.
    pub fn new(cells: &CellGraph, shares: &[f64], rows: &[Row]) -> Self {
        let (n, m) = (cells.len(), rows.len());
        let width = 1.0 / (m as f32).sqrt();
        let gaussian = |d: f32| if d < REACH * width { exp64(-f64::from(d / width).powi(2)) } else { 0.0 };
        let mut local = vec![0.0; n * m];
        for (k, row) in rows.iter().enumerate() {
            row.iter().enumerate().for_each(|(i, &d)| local[i * m + k] = gaussian(d));
        }
        let mut flow = vec![0.0; n * m];
        for (pair, length) in cells.pairs.iter().zip(&cells.length) {
            let [i, j] = pair.map(|i| i as usize);
            let weight = length / distance(cells.centre[i], cells.centre[j]).max(1e-9);
            for k in 0..m {
                let difference = weight * (local[i * m + k] - local[j * m + k]);
                flow[i * m + k] += difference;
                flow[j * m + k] -= difference;
            }
        }
        let [mut energy, mut mass] = [0; 2].map(|_| vec![0.0; m * m]);
        for i in 0..n {
            let (own, flow) = (&local[i * m..][..m], &flow[i * m..][..m]);
            // Most samples are too far away.
            for k in (0..m).filter(|&k| own[k] > 0.0) {
                let share = own[k] * shares[i];
                axpy(&mut energy[k * m..][..m], own[k], flow);
                axpy(&mut mass[k * m..][..m], share, own);
            }
        }
        let [energy, mass] = [energy, mass].map(|sums| DMatrix::from_vec(m, m, sums));
        let (_, vectors) = generalised(energy, mass, COUNT);
        let mut value = vec![0.0; n * COUNT];
        for i in 0..n {
            let mut here = [0.0; COUNT];
            for k in (0..m).filter(|&k| local[i * m + k] > 0.0) {
                let vector = vectors.row(k);
                here.iter_mut().zip(&vector).for_each(|(sum, x)| *sum += local[i * m + k] * x);
            }
            value[i * COUNT..][..COUNT].iter_mut().zip(here).for_each(|(value, x)| *value = x as f32);
        }
        Self { value, shares: shares.iter().map(|&share| share as f32).collect() }
    }

    /// The first k functions at a cell.
    fn at(&self, cell: u32, k: usize) -> &[f32] {
        &self.value[cell as usize * COUNT..][..k]
    }

    /// The matrix of the first k functions for a map of cells.
    pub fn fitted(&self, image: &[u32], k: usize) -> FunctionMap {
        self.of_pairs((0..).zip(image).zip(&self.shares).map(|((x, &y), &share)| (x, y, share)), k)
    }

    /// The same for triples of cell, image and weight.
    pub fn of_pairs(&self, pairs: impl Iterator<Item = (u32, u32, f32)>, k: usize) -> FunctionMap {
        let mut value = vec![0.0; k * k];
        for (x, y, weight) in pairs {
            let (here, there) = (self.at(x, k), self.at(y, k));
            for (i, here) in here.iter().enumerate() {
                axpy(&mut value[i * k..][..k], weight * here, there);
            }
        }
        FunctionMap { k, value }.made_symmetric()
    }

    /// The functions of a cell transformed by C.
    pub fn image(&self, cell: u32, c: &FunctionMap) -> Vec<f32> {
        let mut out = vec![0.0; c.k];
        for (i, here) in self.at(cell, c.k).iter().enumerate() {
            axpy(&mut out, *here, &c.value[i * c.k..]);
        }
        out
    }

    /// The index in `among` of the cell whose functions are nearest to `image`.
    pub fn nearest(&self, image: &[f32], among: &[u32]) -> usize {
        let far = among.iter().map(|&cell| square_apart::<LANES>(image, self.at(cell, image.len())));
        let least = |a: (usize, f32), b: (usize, f32)| if b.1 < a.1 { b } else { a };
        far.enumerate().fold((0, f32::INFINITY), least).0
    }

    /// Each cell's image under C, by descent from its current image and those of its neighbours.
    pub fn mapped(&self, c: &FunctionMap, image: &mut [u32], paths: &CellPaths) {
        for x in 0..image.len() as u32 {
            let there = self.image(x, c);
            let mut best = (image[x as usize], f32::INFINITY);
            let look = |best: &mut (u32, f32), y: u32| {
                let far = square_apart::<LANES>(&there, self.at(y, c.k));
                if far < best.1 {
                    *best = (y, far);
                }
            };
            look(&mut best, image[x as usize]);
            paths.steps(x).for_each(|(j, _)| look(&mut best, image[j as usize]));
            loop {
                let from = best.0;
                paths.steps(from).for_each(|(y, _)| look(&mut best, y));
                if best.0 == from {
                    break;
                }
            }
            image[x as usize] = best.0;
        }
    }

    /// Refines the map from `k` functions to all, with matrices made orthogonal or not.
    pub fn refine(&self, image: &mut [u32], mut k: usize, orthogonal: bool, paths: &CellPaths) {
        while k < COUNT {
            k = more(k).min(COUNT);
            let fitted = self.fitted(image, k);
            self.mapped(&if orthogonal { fitted.made_orthogonal() } else { fitted }, image, paths);
        }
    }
}

impl FunctionMap {
    /// Functions keep their sign, or change it if the bit of `signs` is set; the first is constant.
    pub fn of_signs(signs: u32, k: usize) -> Self {
        let mut value = vec![0.0; k * k];
        (0..k).for_each(|i| value[i * k + i] = if (2 * signs) >> i & 1 == 1 { -1.0 } else { 1.0 });
        Self { k, value }
    }

    fn made_symmetric(mut self) -> Self {
        let k = self.k;
        for i in 0..k {
            for j in 0..i {
                let mean = 0.5 * (self.value[i * k + j] + self.value[j * k + i]);
                (self.value[i * k + j], self.value[j * k + i]) = (mean, mean);
            }
        }
        self
    }

    /// Approximately the nearest symmetric orthogonal matrix: C ← (3 C − C³) / 2.
    pub fn made_orthogonal(mut self) -> Self {
        let k = self.k;
        // It converges for norms below √3.
        let norm = self.value.chunks_exact(k).map(|row| row.iter().map(|x| x.abs()).sum::<f32>()).fold(1.7, f32::max);
        self.value.iter_mut().for_each(|x| *x *= 1.7 / norm);
        for _ in 0..STEPS {
            let cubed = times(&times(&self.value, &self.value, k), &self.value, k);
            self.value.iter_mut().zip(cubed).for_each(|(x, cubed)| *x = 1.5 * *x - 0.5 * cubed);
        }
        self
    }
}

/// The next number of functions.
pub fn more(k: usize) -> usize {
    k + (k / 4).max(1)
}

/// The product of two k × k matrices.
fn times(a: &[f32], b: &[f32], k: usize) -> Vec<f32> {
    let mut out = vec![0.0; k * k];
    for (i, row) in out.chunks_exact_mut(k).enumerate() {
        for j in 0..k {
            axpy(row, a[i * k + j], &b[j * k..]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sheet of 24 by 16 squares, and the mirror image of each.
    fn sheet() -> (CellGraph, CellPaths, Functions, Vec<u32>) {
        let (wide, high) = (24, 16);
        let at = |x: u32, y: u32| y * wide + x;
        let all = || (0..high).flat_map(|y| (0..wide).map(move |x| (x, y)));
        let unit = f64::from(wide * high).sqrt();
        let beside = all().filter(|&(x, _)| x + 1 < wide).map(|(x, y)| [at(x, y), at(x + 1, y)]);
        let above = all().filter(|&(_, y)| y + 1 < high).map(|(x, y)| [at(x, y), at(x, y + 1)]);
        let pairs: Vec<[u32; 2]> = beside.chain(above).collect();
        let cells = CellGraph {
            area: all().map(|_| 1.0 / (unit * unit)).collect(),
            centre: all().map(|(x, y)| [f64::from(x) / unit, f64::from(y) / unit, 0.0]).collect(),
            length: vec![1.0 / unit; pairs.len()],
            pairs,
            ..CellGraph::default()
        };
        let paths = CellPaths::new(&cells);
        let samples: Vec<u32> = (0..wide * high).filter(|i| i % 5 == 0).collect();
        let functions = Functions::new(&cells, &cells.area_shares(), &paths.rows(&samples));
        let mirrored = all().map(|(x, y)| at(wide - 1 - x, y)).collect();
        (cells, paths, functions, mirrored)
    }

    #[test]
    fn functions_are_orthonormal_and_begin_with_the_smoothest() {
        let (cells, _, functions, _) = sheet();
        let same: Vec<u32> = (0..cells.len() as u32).collect();
        let c = functions.fitted(&same, 30);
        for (i, row) in c.value.chunks_exact(30).enumerate() {
            row.iter()
                .enumerate()
                .for_each(|(j, x)| assert!((x - f32::from(u8::from(i == j))).abs() < 1e-3, "{i} {j} {x}"));
        }
        // A constant, then half a wave along the sheet.
        let at = |cell: u32| functions.at(cell, 2);
        assert!(same.iter().all(|&cell| at(cell)[0] * at(0)[0] > 0.0));
        assert!(at(0)[1] * at(23)[1] < 0.0 && at(0)[1] * at(360)[1] > 0.0);
    }

    #[test]
    fn a_coarse_map_is_refined() {
        let (cells, paths, functions, mirrored) = sheet();
        for orthogonal in [false, true] {
            // One sign reverses the whole sheet.
            let mut image: Vec<u32> = (0..cells.len() as u32).collect();
            functions.mapped(&FunctionMap::of_signs(1, 2), &mut image, &paths);
            image.iter_mut().zip(&mirrored).filter(|(_, m)| *m % 3 > 0).for_each(|(image, m)| *image = *m);
            functions.refine(&mut image, 6, orthogonal, &paths);
            let near = |(a, b): &(&u32, &u32)| distance(cells.centre[**a as usize], cells.centre[**b as usize]) < 0.13;
            let right = image.iter().zip(&mirrored).filter(near).count();
            assert!(right as f64 > 0.9 * cells.len() as f64, "{right} of {}", cells.len());
        }
    }

    #[test]
    fn matrices_become_orthogonal() {
        let (_, _, functions, mirrored) = sheet();
        let mut blurred = mirrored.clone();
        blurred.chunks_exact_mut(2).for_each(|pair| pair[0] = pair[1]);
        let c = functions.fitted(&blurred, 12).made_orthogonal();
        let product = times(&c.value, &c.value, 12);
        for (k, x) in product.iter().enumerate() {
            assert!((x - f32::from(u8::from(k % 13 == 0))).abs() < 1e-2, "{k} {x}");
        }
        let signs = FunctionMap::of_signs(0b101, 4);
        let diagonal: Vec<f32> = (0..4).map(|i| signs.value[5 * i]).collect();
        assert_eq!(diagonal, [1.0, -1.0, 1.0, -1.0]);
    }

    #[test]
    fn the_nearest_is_found_among_some() {
        let (cells, _, functions, mirrored) = sheet();
        let c = functions.fitted(&mirrored, 20).made_orthogonal();
        let among: Vec<u32> = mirrored.iter().copied().filter(|cell| cell % 2 == 0).collect();
        let image = functions.image(7, &c);
        let found = among[functions.nearest(&image, &among)];
        assert!(distance(cells.centre[found as usize], cells.centre[16]) < 0.13, "{found}");
    }
}
