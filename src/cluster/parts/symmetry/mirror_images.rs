//! Mirror images of cells, and a co-association that is equal on both sides of a mirror plane, and on similar limbs.
//!
//! C is averaged with that of the images, so that both sides are decided alike. If there is a plane, cells come in
//! pairs ([`crate::cluster::mirror`]), so images of superfaces are exact up to the triangulation. Cost: some
//! milliseconds for the planes; for each of them R², plus R times the number of pairs of superfaces and images that
//! overlap.

use crate::base::tally::add_weight;
use crate::base::vector::axpy;
use crate::cluster::mirror::{NearestPoint, PointSet, SurfacePoint, mirror_planes};
use crate::cluster::parts::cell_graph::CellGraph;
use crate::cluster::parts::cell_labels::{class_sums, compact, intersect};
use crate::cluster::parts::matrix::Square;
use crate::spectral::exp::exp64;

/// If the best plane has less [`CellImages::likeness`], the surface may be posed.
pub const LEAST_LIKENESS: f64 = 0.9;
/// A superface is cut if both pieces have at least this share of it: less is within the inaccuracy of images.
const CUT: f64 = 0.3;
/// Distance between an image and its nearest cell, in cell radii, at which the weight has fallen to e⁻¹.
const REACH: f64 = 2.0;

/// The image of each cell under one plane, under a [`super::reflection`], or on another of several [`super::limbs`].
#[derive(Clone, Debug)]
pub struct CellImages {
    /// The cell nearest to each cell's mirror image (S).
    pub image: Vec<u32>,
    /// How well it matches: 1 for a pair at the same position, e⁻¹ two radii apart, nearly 0 from three on (S).
    pub weight: Vec<f64>,
}

impl CellImages {
    /// How symmetric the surface is: the mean weight by area; `shares` are the cells' areas (S).
    pub fn likeness(&self, shares: &[f64]) -> f64 {
        self.weight.iter().zip(shares).map(|(weight, share)| weight * share).sum()
    }

    /// Cuts superfaces at the images of part boundaries, so that both sides can be cut alike. `of_cell` is the
    /// superface of each cell (S), `part` its part (S). Returns the new superfaces, and their number. Since images are
    /// off by a cell or two, majorities among neighbours decide, and small pieces stay with the largest of their
    /// superface.
    pub fn cut_at_images(&self, cells: &CellGraph, shares: &[f64], of_cell: &[u32], part: &[u32]) -> (Vec<u32>, usize) {
        let image = |cell: usize| part[self.image[cell] as usize];
        let mut votes: Vec<Vec<(u32, f64)>> = (0..cells.len()).map(|cell| vec![(image(cell), shares[cell])]).collect();
        for &[i, j] in &cells.pairs {
            votes[i as usize].push((image(j as usize), shares[j as usize]));
            votes[j as usize].push((image(i as usize), shares[i as usize]));
        }
        let most = |votes: &Vec<(u32, f64)>| {
            let sum = |part: u32| votes.iter().filter(|vote| vote.0 == part).map(|vote| vote.1).sum::<f64>();
            votes.iter().map(|vote| vote.0).max_by(|&a, &b| sum(a).total_cmp(&sum(b)).then(b.cmp(&a))).unwrap_or(0)
        };
        let image_part: Vec<u32> = votes.iter().map(most).collect();
        divided(of_cell, &image_part, shares)
    }

    /// The images of all cells under a motion: the cells `nearest` to them.
    pub fn under(motion: impl Fn(SurfacePoint) -> SurfacePoint, nearest: &NearestPoint<'_>) -> Self {
        let PointSet { points, radius, .. } = nearest.set();
        let seen = points.iter().zip(0u32..).map(|(p, k)| nearest.find(motion(*p)).unwrap_or((k, f64::INFINITY)));
        let (image, far): (Vec<u32>, Vec<f64>) = seen.unzip();
        let reach = REACH * radius;
        Self { image, weight: far.iter().map(|d| exp64(-(d / reach).powi(4))).collect() }
    }
}

/// Superfaces, `of_cell` (S), divided where the classes `class` (S) of cells with areas `shares` (S) end. Small pieces
/// stay with the largest of their superface. Returns the new superface of each cell, and their number.
pub fn divided(of_cell: &[u32], class: &[u32], shares: &[f64]) -> (Vec<u32>, usize) {
    let (pieces, count) = intersect(of_cell, class);
    let area = class_sums(&pieces, shares, count);
    let superfaces = of_cell.iter().map(|&x| x as usize + 1).max().unwrap_or(0);
    let whole = class_sums(of_cell, shares, superfaces);
    let mut largest = vec![None; superfaces];
    for (&piece, &superface) in pieces.iter().zip(of_cell) {
        let best: &mut Option<u32> = &mut largest[superface as usize];
        if best.is_none_or(|best| area[piece as usize] > area[best as usize]) {
            *best = Some(piece);
        }
    }
    let large = |(&piece, &superface): (&u32, &u32)| {
        let is_large = area[piece as usize] >= CUT * whole[superface as usize];
        if is_large { piece } else { largest[superface as usize].unwrap_or(piece) }
    };
    compact(&pieces.iter().zip(of_cell).map(large).collect::<Vec<_>>())
}

/// The centres and normals of all cells.
pub fn cell_points(cells: &CellGraph) -> Vec<SurfacePoint> {
    let point = |(&position, &normal): (&[f64; 3], &[f64; 3])| SurfacePoint { position, normal };
    cells.centre.iter().zip(&cells.normal).map(point).collect()
}

/// The images of all cells under each mirror plane, the best plane first. Cells are searched by `nearest`.
pub fn mirror_images(nearest: &NearestPoint<'_>) -> Vec<CellImages> {
    let planes = mirror_planes(nearest).into_iter();
    planes.map(|plane| CellImages::under(|point| plane.image(point), nearest)).collect()
}

/// The co-association of superfaces, C (R × R), averaged with those of their images under each of `maps`: `of_cell` is
/// the superface of each cell (S), `shares` are the cells' areas (S).
pub fn symmetrised(c: &Square, of_cell: &[u32], shares: &[f64], maps: &[CellImages]) -> Square {
    let n = c.len();
    let maps: Vec<_> = maps.iter().map(|map| superface_images(n, of_cell, shares, map)).collect();
    let mut mean = c.clone();
    // Σ share · C from the images of one superface to all others.
    let (mut half, mut weight) = (vec![0.0; n], vec![0.0; n]);
    for x in 0..n {
        weight.fill(1.0);
        for (images, sure) in &maps {
            half.fill(0.0);
            for &(y, share) in &images[x] {
                axpy(&mut half, share, c.row(y as usize));
            }
            for y in (0..x).filter(|&y| sure[x] * sure[y] > 0.0) {
                let image: f64 = images[y].iter().map(|&(b, share)| share * half[b as usize]).sum();
                let w = sure[x] * sure[y];
                mean[(x, y)] += w * image;
                weight[y] += w;
            }
        }
        for y in 0..x {
            let value = mean[(x, y)] / weight[y];
            (mean[(x, y)], mean[(y, x)]) = (value, value);
        }
    }
    mean
}

/// For each of `n` superfaces, the shares of its image in other superfaces, which sum to 1, and how well it matches
/// (R).
pub(in crate::cluster::parts) fn superface_images(
    n: usize,
    of_cell: &[u32],
    shares: &[f64],
    map: &CellImages,
) -> (Vec<Vec<(u32, f64)>>, Vec<f64>) {
    let mut images: Vec<Vec<(u32, f64)>> = vec![Vec::new(); n];
    let (mut sure, area) = (vec![0.0; n], class_sums(of_cell, shares, n));
    for (k, &x) in of_cell.iter().enumerate().filter(|(k, _)| map.weight[*k] > 0.0) {
        let (y, w) = (of_cell[map.image[k] as usize], shares[k] * map.weight[k]);
        add_weight(&mut images[x as usize], y, w);
        sure[x as usize] += w;
    }
    for x in 0..n {
        images[x].iter_mut().for_each(|(_, share)| *share /= sure[x].max(1e-300));
        sure[x] /= area[x].max(1e-300);
    }
    (images, sure)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream, unit};

    #[test]
    fn superfaces_end_where_images_of_parts_do() {
        // A strip of 12 cells that is its own mirror image, cut at 3: so it must be cut at 9 too, although one cell is
        // mapped wrongly.
        let cells =
            CellGraph { pairs: (1..12).map(|i| [i - 1, i]).collect(), area: vec![1.0; 12], ..CellGraph::default() };
        let mut mirror = CellImages { image: (0..12).rev().collect(), weight: vec![1.0; 12] };
        mirror.image[6] = 0;
        let part: Vec<u32> = (0..12).map(|i| u32::from(i >= 3)).collect();
        let (of_cell, count) = mirror.cut_at_images(&cells, &[1.0 / 12.0; 12], &part, &part);
        assert_eq!((of_cell, count), (vec![0, 0, 0, 1, 1, 1, 1, 1, 1, 2, 2, 2], 3));
        // A fifth of a superface is within the inaccuracy of images.
        let part: Vec<u32> = (0..12).map(|i| u32::from(i >= 2)).collect();
        assert_eq!(mirror.cut_at_images(&cells, &[1.0 / 12.0; 12], &part, &part), (part.clone(), 2));
        mirror.weight[..6].fill(0.5);
        assert!((mirror.likeness(&[1.0 / 12.0; 12]) - 0.75).abs() < 1e-12);
    }

    #[test]
    fn images_are_averaged_as_matrices_say() {
        let (mut random, cells, n) = (stream(1, "test"), 30, 6);
        let of_cell: Vec<u32> =
            (0..cells).map(|k| if k < n { k as u32 } else { below(&mut random, n) as u32 }).collect();
        let shares: Vec<f64> = (0..cells).map(|_| 0.1 + unit(&mut random)).collect();
        let mirror = CellImages {
            image: (0..cells).map(|_| below(&mut random, cells) as u32).collect(),
            weight: (0..cells).map(|_| unit(&mut random)).collect(),
        };
        let mut c = Square::zeros(n);
        for i in 0..n {
            for j in 0..=i {
                let x = unit(&mut random);
                (c[(i, j)], c[(j, i)]) = (x, x);
            }
        }
        let got = symmetrised(&c, &of_cell, &shares, std::slice::from_ref(&mirror));
        // T: from the area of a superface to that of its image, row by row.
        let mut t = Square::zeros(n);
        let mut area = vec![0.0; n];
        for k in 0..cells {
            t[(of_cell[k] as usize, of_cell[mirror.image[k] as usize] as usize)] += shares[k] * mirror.weight[k];
            area[of_cell[k] as usize] += shares[k];
        }
        let sum = |x: usize| t.row(x).iter().sum::<f64>();
        for x in 0..n {
            for y in 0..n {
                let w = sum(x) / area[x] * (sum(y) / area[y]);
                let image: f64 = (0..n * n).map(|k| t[(x, k / n)] * c[(k / n, k % n)] * t[(y, k % n)]).sum();
                let image = image / (sum(x) * sum(y));
                let expected = if x == y { c[(x, x)] } else { (c[(x, y)] + w * image) / (1.0 + w) };
                assert!((got[(x, y)] - expected).abs() < 1e-12, "{x} {y}");
            }
        }
    }
}
