//! Flat plates and sheets: surfaces of two flat sides within a thin slab, or of one.
//!
//! Arms of a flat plate, such as a laser-cut starfish, are as plain to people as those of a round one, but none of the
//! measures of a region shows where they begin. So regions of plates are compared on an inflated shape
//! ([`super::inflation`]), which needs to know the sides and the rim. What is found about a place then holds for the
//! place opposite too ([`Plate::sides_as_one`]). A flat sheet, such as a planar triangulation, is treated as a plate
//! without thickness: it gets a back ([`sheet_with_back`]).
//!
//! Cost for S cells and R superfaces: moments of the cells, and of a plate S² distances and R² times the overlaps with
//! opposite superfaces: some milliseconds. One matrix of R × R.

use super::cell_graph::CellGraph;
use super::cell_labels::connected_pieces;
use super::matrix::Square;
use super::symmetry::mirror_images::{CellImages, superface_images};
use super::thickness::tangents;
use crate::base::moments::{about_mean, principal_axes, products};
use crate::base::vector::{axpy, dot, minus};
use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2, TAU};

/// A plate lies within a slab of this thickness, in units of √(total area).
const SLAB: f64 = 0.12;
/// Cosine of the angle with the axis of the slab below which a cell belongs to the rim.
const RIM: f64 = 0.7;
/// Cosine of that angle from which a cell is flat, and the minimum share of the area of both sides that is: terrain in
/// relief is no plate.
const FLAT: (f64, f64) = (0.97, 0.8);
/// Minimum share of either side in the area.
const SIDE: f64 = 0.25;
/// The thickness of the slab of a sheet, and the minimum share of its area that is flat and faces the same way.
const SHEET: (f64, f64) = (0.02, 0.98);
/// A cell of a sheet belongs to the rim if there is no cell within two steps of it in a sector of this angle.
const OPEN: f64 = 2.1;

/// A surface that consists of two flat sides and a rim, within a thin slab.
#[derive(Clone, Debug)]
pub struct Plate {
    slab: Slab,
    /// Whether each cell belongs to the rim (S).
    is_rim: Vec<bool>,
}

/// The thinnest slab around a surface, across the least of its principal axes.
#[derive(Clone, Debug)]
struct Slab {
    /// Direction across the slab, a unit vector.
    axis: [f64; 3],
    /// For each cell, the cosine of the angle between its normal and the axis (S).
    side: Vec<f64>,
}

impl Slab {
    /// The slab of `cells`, if it is at most as thick as `thickness`, in units of √(total area).
    fn of(cells: &CellGraph, thickness: f64) -> Option<Slab> {
        let (total, mut mean, mut second) = (cells.total_area(), [0.0; 3], [0.0; 6]);
        for (&x, area) in cells.centre.iter().zip(&cells.area) {
            axpy(&mut mean, area / total, &x);
            axpy(&mut second, area / total, &products(x));
        }
        let moments = about_mean(mean, second);
        if !moments.iter().all(|x| x.is_finite()) {
            return None;
        }
        let [.., axis] = principal_axes(moments).1;
        let heights = cells.centre.iter().map(|&x| dot(x, axis));
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        let side = || cells.normal.iter().map(|&normal| dot(normal, axis)).collect();
        (high - low < thickness * total.sqrt()).then(|| Slab { axis, side: side() })
    }

    /// The share of the area of `cells` whose side is as wanted.
    fn share(&self, cells: &CellGraph, is_wanted: impl Fn(f64) -> bool) -> f64 {
        let total = cells.total_area();
        self.side.iter().zip(&cells.area).filter(|(side, _)| is_wanted(**side)).map(|(_, area)| area / total).sum()
    }
}

impl Plate {
    /// The plate that `cells` form, if they do.
    pub fn of(cells: &CellGraph) -> Option<Plate> {
        let slab = Slab::of(cells, SLAB)?;
        let (front, back) = (slab.share(cells, |side| side >= RIM), slab.share(cells, |side| side <= -RIM));
        if front.min(back) < SIDE || slab.share(cells, |side| side.abs() >= FLAT.0) < FLAT.1 * (front + back) {
            return None;
        }
        let side = &slab.side;
        let mut is_rim: Vec<bool> = side.iter().map(|side| side.abs() < RIM).collect();
        for &[i, j] in &cells.pairs {
            let (i, j) = (i as usize, j as usize);
            // Front and back meet: there the rim is narrower than a cell.
            if side[i].min(side[j]) <= -RIM && side[i].max(side[j]) >= RIM {
                (is_rim[i], is_rim[j]) = (true, true);
            }
        }
        Some(Plate { slab, is_rim })
    }

    /// Direction across the plate, a unit vector.
    pub fn axis(&self) -> [f64; 3] {
        self.slab.axis
    }

    /// Whether each cell belongs to the rim (S).
    pub fn is_rim(&self) -> &[bool] {
        &self.is_rim
    }

    /// The direction along the axis that leads out of the plate at a cell.
    pub fn outward(&self, cell: usize) -> [f64; 3] {
        self.slab.axis.map(|x| x * self.slab.side[cell].signum())
    }

    /// For each cell of a side, the cell of the other side nearest to its mirror image, in the same connected piece;
    /// cells of the rim have none.
    fn opposite(&self, cells: &CellGraph) -> CellImages {
        let inside = |i: usize| !self.is_rim[i];
        // Plates may lie on each other.
        let (piece, _) = connected_pieces(&cells.pairs, &vec![0; cells.len()]);
        let nearest = |i: usize| {
            let along = |j: usize| {
                let way = minus(cells.centre[j], cells.centre[i]);
                let across = dot(way, self.slab.axis);
                dot(way, way) - across * across
            };
            let is_other =
                |&j: &usize| inside(j) && piece[i] == piece[j] && self.slab.side[i] * self.slab.side[j] < 0.0;
            (0..cells.len()).filter(is_other).min_by(|&a, &b| along(a).total_cmp(&along(b)))
        };
        let found: Vec<Option<usize>> =
            (0..cells.len()).map(|i| Some(i).filter(|&i| inside(i)).and_then(nearest)).collect();
        CellImages {
            image: found.iter().zip(0u32..).map(|(j, i)| j.map_or(i, |j| j as u32)).collect(),
            weight: found.iter().map(|j| f64::from(u8::from(j.is_some()))).collect(),
        }
    }

    /// The co-association C of superfaces (R × R) with both sides as one place: the mean of C over either superface and
    /// what lies opposite. `of_cell` is the superface of each of the `cells` (S).
    pub fn sides_as_one(&self, cells: &CellGraph, of_cell: &[u32], c: &Square) -> Square {
        let n = c.len();
        let (images, sure) = superface_images(n, of_cell, &cells.area_shares(), &self.opposite(cells));
        // The mean over the rows of a superface and of what lies opposite; C is symmetric.
        let averaged = |c: &Square| {
            let mut out = Square::zeros(n);
            let mut row = vec![0.0; n];
            for x in 0..n {
                row.copy_from_slice(c.row(x));
                images[x].iter().for_each(|&(y, share)| axpy(&mut row, sure[x] * share, c.row(y as usize)));
                row.iter().enumerate().for_each(|(y, value)| out[(y, x)] = value / (1.0 + sure[x]));
            }
            out
        };
        let mut out = averaged(&averaged(c));
        for x in 0..n {
            for y in 0..x {
                out[(y, x)] = out[(x, y)];
            }
            out[(x, x)] = c[(x, x)];
        }
        out
    }
}

/// The cells of a flat sheet and, after them, those of its back, joined at the rim, in units of their own area: a plate
/// without thickness. Angles are 0, until it is inflated. `None` for other surfaces.
pub fn sheet_with_back(cells: &CellGraph) -> Option<CellGraph> {
    let slab = Slab::of(cells, SHEET.0)?;
    if slab.share(cells, |side| side >= FLAT.0).max(slab.share(cells, |side| side <= -FLAT.0)) < SHEET.1 {
        return None;
    }
    let (n, radii) = (cells.len() as u32, cells.radii());
    let gaps = widest_gaps(cells, slab.axis).into_iter().zip(0u32..);
    let rim: Vec<u32> = gaps.filter(|(gap, _)| *gap >= OPEN).map(|(_, i)| i).collect();
    let (behind, turned) = (|pair: &[u32; 2]| pair.map(|i| i + n), |n: &[f64; 3]| n.map(|x| -x));
    let (centre, length) = (cells.centre.iter().chain(&cells.centre), cells.length.iter().chain(&cells.length));
    let pairs = cells.pairs.iter().copied().chain(cells.pairs.iter().map(behind));
    let pairs: Vec<[u32; 2]> = pairs.chain(rim.iter().map(|&i| [i, i + n])).collect();
    let flat = vec![0.0; pairs.len()];
    Some(CellGraph {
        seed: Vec::new(),
        flipped: Vec::new(),
        area: cells.area.iter().chain(&cells.area).map(|x| 0.5 * x).collect(),
        centre: centre.map(|x| x.map(|x| FRAC_1_SQRT_2 * x)).collect(),
        normal: cells.normal.iter().copied().chain(cells.normal.iter().map(turned)).collect(),
        pairs,
        length: length.map(|x| FRAC_1_SQRT_2 * x).chain(rim.iter().map(|&i| SQRT_2 * radii[i as usize])).collect(),
        concave: flat.clone(),
        convex: flat.clone(),
        convex04: flat,
    })
}

/// For each cell of a sheet across this `axis`, the widest angle between the directions in which cells within two steps
/// of it lie (S). On a planar plus it is 2.35 or more for 95 % of the cells at the open boundary, and below 1.17
/// for 95 % of those away from it. With direct neighbours only, these are 2.61 and 2.42.
fn widest_gaps(cells: &CellGraph, axis: [f64; 3]) -> Vec<f64> {
    let [first, second] = tangents(axis);
    let beside = cells.neighbours();
    let gap = |i: usize| {
        let direction = |&j: &u32| {
            let way = minus(cells.centre[j as usize], cells.centre[i]);
            libm::atan2(dot(way, second), dot(way, first))
        };
        let farther = beside[i].iter().flat_map(|&j| &beside[j as usize]).filter(|&&j| j as usize != i);
        let mut around: Vec<f64> = beside[i].iter().chain(farther).map(direction).collect();
        around.sort_by(f64::total_cmp);
        let past = around.first().map(|first| first + TAU);
        let next = around.iter().skip(1).chain(&past);
        around.iter().zip(next).map(|(from, to)| to - from).fold(0.0, f64::max)
    };
    (0..cells.len()).map(gap).collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::base::random::{below, stream, unit as random_unit};
    use crate::base::vector::unit;

    /// Both sides of a disc of radius 1, as a grid of cells of this width, with the cells beyond the radius as rim.
    pub fn disc(width: f64) -> CellGraph {
        let half = (1.0 / width) as i32 + 1;
        let mut cells = CellGraph::default();
        let mut number = std::collections::BTreeMap::new();
        for (side, x, y) in
            [1, -1].iter().flat_map(|s| (-half..=half).flat_map(move |x| (-half..=half).map(move |y| (s, x, y))))
        {
            let at = [f64::from(x) * width, f64::from(y) * width, 0.05 * f64::from(*side)];
            let from_middle = at[0].hypot(at[1]);
            if from_middle >= 1.0 + width {
                continue;
            }
            number.insert((*side, x, y), cells.area.len() as u32);
            let is_rim = from_middle >= 1.0;
            cells.area.push(width * width);
            cells.normal.push(if is_rim {
                [at[0] / from_middle, at[1] / from_middle, 0.0]
            } else {
                [0.0, 0.0, f64::from(*side)]
            });
            cells.centre.push(at);
        }
        for (&(side, x, y), &i) in &number {
            let is_rim = cells.normal[i as usize][2] == 0.0;
            let across = (is_rim && side == 1).then_some((-1, x, y));
            for other in [(side, x + 1, y), (side, x, y + 1)].into_iter().chain(across) {
                if let Some(&j) = number.get(&other) {
                    cells.pairs.push([i, j]);
                }
            }
        }
        cells.length = vec![width; cells.pairs.len()];
        let flat = || vec![0.0; cells.pairs.len()];
        (cells.concave, cells.convex, cells.convex04) = (flat(), flat(), flat());
        cells
    }

    /// The front of that disc, without the rim.
    pub fn sheet(width: f64) -> CellGraph {
        let disc = disc(width);
        let front = |&i: &u32| disc.normal[i as usize][2] == 1.0;
        let kept: Vec<u32> = (0..disc.len() as u32).filter(front).collect();
        let mut cells = disc.subset(&kept);
        let (area, unit) = (width * width / cells.area[0], width / cells.length[0]);
        cells.area.iter_mut().for_each(|x| *x *= area);
        cells.length.iter_mut().for_each(|x| *x *= unit);
        cells.centre.iter_mut().for_each(|x| *x = x.map(|x| x * unit));
        cells
    }

    #[test]
    fn a_sheet_gets_a_back_that_is_joined_at_its_rim() {
        let cells = sheet(0.05);
        let both = sheet_with_back(&cells).unwrap();
        let n = cells.len();
        assert_eq!(both.len(), 2 * n);
        assert!((both.total_area() - cells.total_area()).abs() < 1e-9);
        let joined: Vec<[u32; 2]> = both.pairs[2 * cells.pairs.len()..].to_vec();
        let from_middle = |i: usize| cells.centre[i][0].hypot(cells.centre[i][1]);
        assert!(joined.iter().all(|&[i, j]| j == i + n as u32 && from_middle(i as usize) > 0.85));
        let at_rim = (0..n).filter(|&i| from_middle(i) > 0.97).count();
        assert!(joined.len() > at_rim && at_rim >= 50, "{} {at_rim}", joined.len());
        assert!(both.cleaned().is_ok_and(|cleaned| cleaned.pairs == both.pairs));
        assert!(sheet_with_back(&disc(0.05)).is_none(), "a plate");
        let bent = cells.centre.iter().map(|x| [x[0], x[1], 0.1 * x[0] * x[0]]).collect();
        assert!(sheet_with_back(&CellGraph { centre: bent, ..cells }).is_none());
        assert!(sheet_with_back(&CellGraph::default()).is_none());
    }

    #[test]
    fn other_shapes_are_no_plates() {
        let plate = disc(0.1);
        assert!(Plate::of(&plate).is_some());
        let thick = plate.centre.iter().map(|x| [x[0], x[1], 6.0 * x[2]]).collect();
        assert!(Plate::of(&CellGraph { centre: thick, ..plate.clone() }).is_none(), "a box");
        let sheet = plate.normal.iter().map(|n| [n[0], n[1], n[2].abs()]).collect();
        assert!(Plate::of(&CellGraph { normal: sheet, ..plate.clone() }).is_none(), "a single sheet");
        let relief =
            |(n, x): (&[f64; 3], &[f64; 3])| if n[2] > 0.5 { unit([0.5 * (9.0 * x[0]).sin(), 0.0, 1.0]) } else { *n };
        let relief = plate.normal.iter().zip(&plate.centre).map(relief).collect();
        assert!(Plate::of(&CellGraph { normal: relief, ..plate.clone() }).is_none(), "a relief");
        let lost = vec![[f64::NAN; 3]; plate.len()];
        assert!(Plate::of(&CellGraph { centre: lost, ..plate }).is_none());
        assert!(Plate::of(&CellGraph::default()).is_none());
    }

    #[test]
    fn both_sides_are_averaged_as_matrices_say() {
        let (mut random, cells, n) = (stream(5, "plates"), disc(0.2), 7);
        let plate = Plate::of(&cells).unwrap();
        let of_cell: Vec<u32> =
            (0..cells.len()).map(|k| if k < n { k as u32 } else { below(&mut random, n) as u32 }).collect();
        let mut c = Square::zeros(n);
        for i in 0..n {
            (0..i).for_each(|j| c.add_both(i, j, random_unit(&mut random)));
            c[(i, i)] = 1.0;
        }
        let got = plate.sides_as_one(&cells, &of_cell, &c);
        // M: from the area of a superface to itself and what lies opposite. The grid has a cell at each opposite place.
        let (mut m, mut area) = (Square::zeros(n), vec![0.0; n]);
        for (k, &x) in of_cell.iter().enumerate() {
            area[x as usize] += cells.area[k];
            if !plate.is_rim[k] {
                let opposite = (0..cells.len()).find(|&j| {
                    let [a, b] = [cells.centre[k], cells.centre[j]];
                    a[..2] == b[..2] && a[2] != b[2]
                });
                m[(x as usize, of_cell[opposite.unwrap()] as usize)] += cells.area[k];
            }
        }
        for x in 0..n {
            let sure: f64 = m.row(x).iter().sum::<f64>() / area[x];
            m.row_mut(x).iter_mut().for_each(|share| *share /= area[x]);
            m[(x, x)] += 1.0;
            m.row_mut(x).iter_mut().for_each(|share| *share /= 1.0 + sure);
        }
        for x in 0..n {
            for y in 0..x {
                let mean: f64 = (0..n * n).map(|k| m[(x, k / n)] * c[(k / n, k % n)] * m[(y, k % n)]).sum();
                assert!(
                    (got[(x, y)] - mean).abs() < 1e-12 && got[(x, y)] == got[(y, x)],
                    "{x} {y}: {} {mean}",
                    got[(x, y)]
                );
            }
        }
    }
}
