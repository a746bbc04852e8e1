//! The faces at the places of edits.
//!
//! A point denotes the face nearest to it, measured to the face itself, since faces may be long and thin. The mesh is
//! taken as it is processed and shown: without stray vertices and unused vertices. Cost: two passes over the faces, one
//! of which is for the bounding box; in the other a face looks up the points it may be nearest to in a tree. 24 bytes
//! per point and thread.

use super::data::{Edit, Edits, Place};
use crate::base::bounds::{BoundingBox, EMPTY, around, centre, grow, half_sides};
use crate::base::parallel::{chunk_count, chunk_range, lock};
use crate::base::printable::{Significant, counted};
use crate::base::vector::{add_scaled, finite, length, minus, triangle_distance};
use crate::base::{Error, Result};
use crate::mesh::{Mesh, polygon};
use crate::store::Run;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Mutex;

/// Faces that a thread processes at once.
const CHUNK: usize = 1 << 15;
/// A point farther from all faces than this, in diagonals of the mesh, is not on it.
const FAR: f64 = 0.1;
/// A mesh is in other units than the edits if the ratio of its diagonal to that of their box is above this, or below
/// its inverse.
const OTHER_UNITS: f64 = 1.5;

/// Edits with the faces of a mesh at their places.
#[derive(Clone, Debug)]
pub struct PlacedEdits<'a> {
    /// The edits.
    pub edits: &'a Edits,
    /// For each edit the face of the file at each of its places, in order.
    pub faces: Vec<Vec<u32>>,
}

impl Edits {
    /// Finds the places of the edits on `mesh`.
    ///
    /// ```
    /// use nystrom_stream::{apps::edits::Edits, mesh::Mesh, store::Run};
    /// # fn main() -> nystrom_stream::base::Result<()> {
    /// let corners = [[0., 0., 0.], [9., 0., 0.], [9., 1., 0.], [0., 1., 0.]];
    /// let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]])?;
    /// let drop = r#"{"edit": "drop", "at": [1, 0.9, 0]}"#;
    /// let text = format!(r#"{{"format": "nystrom-stream edits", "version": 1, "edits": [{drop}]}}"#);
    /// let edits = Edits::of_text(text.as_bytes(), "edits.json".as_ref())?;
    /// assert_eq!(edits.on(&mesh, &Run::new(&()))?.faces, [[1]]);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`Error::Malformed`] for a face that does not exist or a point that is not on the mesh; [`Error::Cancelled`].
    pub fn on(&self, mesh: &Mesh, run: &Run) -> Result<PlacedEdits<'_>> {
        let places = || self.edits.iter().flat_map(Edit::places);
        let points: Vec<[f64; 3]> =
            places().filter_map(|place| if let Place::Point(p) = place { Some(*p) } else { None }).collect();
        let mut unit = 1.;
        let mut found = Vec::new().into_iter();
        if !points.is_empty() {
            let mesh = &mesh.without_strays(run)?;
            let extent = Extent::around(bounds(mesh, run)?);
            let points: Vec<[f64; 3]> =
                points.into_iter().map(|p| extent.place(scaled(self.bounds, &extent, p))).collect();
            unit = extent.diagonal;
            found = nearest(mesh, &extent, &points, run)?.into_iter();
        }
        let mut face = |number: usize, place: &Place| match place {
            Place::Face(face) if *face < mesh.faces.len() as u64 => Ok(*face as u32),
            Place::Face(face) => {
                let problem = format!("there is no face {face}: the mesh has {}", counted(mesh.faces.len(), "face"));
                Err(self.wrong(number, problem, "count faces from 0, or name a point on the surface"))
            }
            Place::Point(_) => match found.next() {
                Some((distance, face)) if distance <= FAR => Ok(face),
                Some((distance, _)) => {
                    let problem =
                        format!("the place {place} is {:.5} away from the mesh", Significant(distance * unit));
                    Err(self.wrong(number, problem, "give a point on the surface, in the units of the mesh file"))
                }
                None => Err(Error::internal("a place was not looked for")),
            },
        };
        let mut faces = Vec::with_capacity(self.edits.len());
        for (number, edit) in self.edits.iter().enumerate() {
            faces.push(edit.places().iter().map(|place| face(number, place)).collect::<Result<Vec<u32>>>()?);
        }
        Ok(PlacedEdits { edits: self, faces })
    }

    /// The same edits with their places in units of `mesh`, and its box: more edits can be added to them. Without a
    /// box, places are in these units already.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn in_units_of(&self, mesh: &Mesh, run: &Run) -> Result<Self> {
        let mut edits = self.clone();
        if self.bounds.is_some() {
            let mesh = &mesh.without_strays(run)?;
            let own = bounds(mesh, run)?;
            let extent = Extent::around(own);
            for place in edits.edits.iter_mut().flat_map(Edit::places_mut) {
                if let Place::Point(p) = place {
                    *p = scaled(self.bounds, &extent, *p);
                }
            }
            edits.bounds = Some(own).filter(|[low, high]| low[0] <= high[0]);
        }
        Ok(edits)
    }
}

/// Least and greatest corner of the box around the faces of `mesh` whose corners are all finite; infinite, and the
/// least above the greatest, if there are none. One pass.
///
/// # Errors
/// [`Error::Cancelled`].
pub fn bounds(mesh: &Mesh, run: &Run) -> Result<[[f64; 3]; 2]> {
    let boxes = run.map_ranges(mesh.faces.len(), CHUNK, |range| {
        let mut all = EMPTY;
        mesh.faces.for_each(range, |_, corners| {
            let mut own = EMPTY;
            let mut whole = true;
            for &v in corners {
                let p = mesh.positions.get(v);
                whole &= finite(p);
                grow(&mut own, p, p);
            }
            if whole {
                grow(&mut all, own[0], own[1]);
            }
        });
        Ok(all)
    })?;
    Ok(around(boxes))
}

/// The centre of a mesh and its diagonal, not 0: they transform its coordinates to a box of diagonal 1.
struct Extent {
    middle: [f64; 3],
    diagonal: f64,
}

impl Extent {
    /// Of the mesh in the box `bounds`, which [`bounds`] gave.
    fn around(bounds: BoundingBox) -> Self {
        if bounds[0][0] > bounds[1][0] {
            return Self { middle: [0.; 3], diagonal: 1. };
        }
        let diagonal = diagonal(bounds).min(f64::MAX);
        Self { middle: centre(bounds), diagonal: if diagonal > 0. { diagonal } else { 1. } }
    }

    fn place(&self, p: [f64; 3]) -> [f64; 3] {
        minus(p, self.middle).map(|x| x / self.diagonal)
    }
}

/// The diagonal of a box; correct even if its square overflows or underflows.
fn diagonal(bounds: BoundingBox) -> f64 {
    let [x, y, z] = half_sides(bounds);
    2. * x.hypot(y).hypot(z)
}

/// A point of edits made on a mesh with the box `bounds`, in units of this mesh.
fn scaled(bounds: Option<[[f64; 3]; 2]>, extent: &Extent, p: [f64; 3]) -> [f64; 3] {
    let Some(bounds) = bounds else { return p };
    let ratio = extent.diagonal / diagonal(bounds);
    if !ratio.is_finite() || (1. / OTHER_UNITS..OTHER_UNITS).contains(&ratio) {
        return p;
    }
    add_scaled(extent.middle, ratio, minus(p, centre(bounds)))
}

/// The face nearest to each of `points`, and its distance, all in the box of diagonal 1; of several equally near ones,
/// the first.
fn nearest(mesh: &Mesh, extent: &Extent, points: &[[f64; 3]], run: &Run) -> Result<Vec<(f64, u32)>> {
    let n = mesh.faces.len();
    let tree = PointTree::of(points);
    let all = Mutex::new(vec![NOT_FOUND; points.len()]);
    let keep = |best: &mut (f64, u32), found: (f64, u32)| {
        if found < *best {
            *best = found;
        }
    };
    run.each_chunk(
        chunk_count(n, CHUNK),
        || (tree.nothing_found(), Vec::new()),
        |k, (found, at)| {
            mesh.faces.for_each(chunk_range(n, CHUNK, k), |face, corners| {
                at.clear();
                at.extend(corners.iter().map(|&v| extent.place(mesh.positions.get(v))));
                let mut own = EMPTY;
                at.iter().for_each(|&p| grow(&mut own, p, p));
                tree.visit(own, found, &mut |p, least, best| {
                    polygon::triangles(at, |triangle| {
                        let triangle = triangle.map(|k| at[k]);
                        if triangle.iter().all(|&corner| finite(corner)) {
                            // At least the bound used for skipping faces, so that the order of faces does not matter.
                            keep(best, (triangle_distance(triangle, p).max(least), face as u32));
                        }
                    });
                });
            });
            Ok(())
        },
        |(own, _)| {
            lock(&all).iter_mut().zip(own.best).for_each(|(best, found)| keep(best, found));
            Ok(())
        },
    )?;
    let found = lock(&all).clone();
    Ok(tree.order.iter().zip(found).collect::<BTreeMap<_, _>>().into_values().collect())
}

/// Distance and number of no face.
const NOT_FOUND: (f64, u32) = (f64::INFINITY, u32::MAX);
/// Maximum number of points in a leaf of a [`PointTree`].
const LEAF: usize = 4;

/// A balanced tree over points. A face examines only those to which it may be the nearest: there may be thousands of
/// points, and a hundred million faces.
struct PointTree {
    /// The points, in the order of the leaves.
    points: Vec<[f64; 3]>,
    /// Where each of them was.
    order: Vec<usize>,
    /// The box of each node; the halves of node k are nodes 2 k + 1 and 2 k + 2.
    boxes: Vec<BoundingBox>,
}

/// What was found so far: per point of a [`PointTree`] the nearest face, and per node the greatest of its distances.
struct FoundFaces {
    best: Vec<(f64, u32)>,
    farthest: Vec<f64>,
}

impl PointTree {
    fn of(points: &[[f64; 3]]) -> Self {
        let mut order: Vec<usize> = (0..points.len()).collect();
        let mut boxes = Vec::new();
        Self::divide(&mut order, points, 0, &mut boxes);
        Self { points: order.iter().map(|&k| points[k]).collect(), order, boxes }
    }

    /// Makes the node `k` of `order`, and those below.
    fn divide(order: &mut [usize], points: &[[f64; 3]], k: usize, boxes: &mut Vec<BoundingBox>) {
        let own = around(order.iter().map(|&i| [points[i]; 2]));
        boxes.resize(boxes.len().max(k + 1), EMPTY);
        boxes[k] = own;
        if order.len() > LEAF {
            let size = minus(own[1], own[0]);
            let axis = (0..3).fold(0, |widest, axis| if size[axis] > size[widest] { axis } else { widest });
            let middle = order.len() / 2;
            order.select_nth_unstable_by(middle, |&i, &j| points[i][axis].total_cmp(&points[j][axis]).then(i.cmp(&j)));
            let (left, right) = order.split_at_mut(middle);
            Self::divide(left, points, 2 * k + 1, boxes);
            Self::divide(right, points, 2 * k + 2, boxes);
        }
    }

    fn nothing_found(&self) -> FoundFaces {
        FoundFaces { best: vec![NOT_FOUND; self.points.len()], farthest: vec![f64::INFINITY; self.boxes.len()] }
    }

    /// Calls `improve` with the points that something in `around` may be nearest to, a lower bound of the distance, and
    /// what was found for the point.
    fn visit(
        &self,
        around: BoundingBox,
        found: &mut FoundFaces,
        improve: &mut impl FnMut([f64; 3], f64, &mut (f64, u32)),
    ) {
        self.visit_node(0, 0..self.points.len(), around, found, improve);
    }

    fn visit_node(
        &self,
        k: usize,
        range: Range<usize>,
        around: BoundingBox,
        found: &mut FoundFaces,
        improve: &mut impl FnMut([f64; 3], f64, &mut (f64, u32)),
    ) {
        if between(around, self.boxes[k]) > found.farthest[k] {
            return;
        }
        if range.len() <= LEAF {
            for i in range.clone() {
                let (p, best) = (self.points[i], &mut found.best[i]);
                let least = between(around, [p; 2]);
                if least <= best.0 {
                    improve(p, least, best);
                }
            }
            found.farthest[k] = found.best[range].iter().fold(0., |most, best| most.max(best.0));
        } else {
            let middle = range.start + range.len() / 2;
            self.visit_node(2 * k + 1, range.start..middle, around, found, improve);
            self.visit_node(2 * k + 2, middle..range.end, around, found, improve);
            found.farthest[k] = found.farthest[2 * k + 1].max(found.farthest[2 * k + 2]);
        }
    }
}

/// The distance between two boxes. It never grows with either of them, also as rounded.
fn between([a, b]: BoundingBox, [c, d]: BoundingBox) -> f64 {
    length([0, 1, 2].map(|k| (a[k] - d[k]).max(c[k] - b[k]).max(0.)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{stream, unit};

    /// The faces at the points of edits made on a mesh with the box `bounds`.
    fn faces(mesh: &Mesh, points: &[[f64; 3]], bounds: Option<[[f64; 3]; 2]>, threads: usize) -> Result<Vec<u32>> {
        let edits = points.iter().map(|&p| Edit::Drop { at: Place::Point(p) }).collect();
        let edits = Edits { edits, bounds, ..Edits::default() };
        let run = Run { threads, ..Run::new(&()) };
        Ok(edits.on(mesh, &run)?.faces.concat())
    }

    /// An axle: a prism with `n` sides, radius 2 and length 60, a ring at its end and a wider prism of length 4.
    fn axle(n: u32) -> Mesh {
        let ring = |&(r, z): &(f64, f64)| {
            (0..n)
                .map(move |i| f64::from(i) * std::f64::consts::TAU / f64::from(n))
                .map(move |t| [r * t.cos(), r * t.sin(), z])
        };
        let points: Vec<[f64; 3]> = [(2., 0.), (2., 60.), (5., 60.), (5., 64.)].iter().flat_map(ring).collect();
        let quad = |k: u32, i: u32| vec![k * n + i, k * n + (i + 1) % n, (k + 1) * n + (i + 1) % n, (k + 1) * n + i];
        let mut quads: Vec<Vec<u32>> = (0..3).flat_map(|k| (0..n).map(move |i| quad(k, i))).collect();
        quads.extend([(0..n).rev().collect(), (3 * n..4 * n).collect()]);
        Mesh::from_slices(&points, &quads).unwrap()
    }

    #[test]
    fn a_point_on_a_long_face_is_on_it() {
        // Regression: faces counted as discs of their area, so that a point on such a quad had a distance of 12.765.
        let mesh = axle(48);
        let on_sides: Vec<[f64; 3]> = (0..48u32)
            .map(|face| {
                let share = f64::from(face + 1) / 50.;
                mesh.faces.with(face as usize, |corners| {
                    let [a, b, c, _] = [0, 1, 2, 3].map(|k| mesh.positions.get(corners[k]));
                    [0, 1, 2].map(|k| a[k] + 0.5 * (b[k] - a[k]) + share * (c[k] - b[k]))
                })
            })
            .collect();
        let expected: Vec<u32> = (0..48).collect();
        for threads in [1, 3] {
            assert_eq!(faces(&mesh, &on_sides, None, threads).unwrap(), expected);
        }
        assert!(faces(&mesh, &[[2., 0., 15.]], None, 1).is_ok());
        let error = faces(&mesh, &[[20., 0., 15.]], None, 1).unwrap_err().to_string();
        assert!(error.contains("[20, 0, 15] is 18.000 away"), "{error}");
        assert!(faces(&mesh, &[[f64::MAX; 3]], None, 1).is_err());
    }

    #[test]
    fn thousands_of_points_find_the_faces_that_each_finds_by_itself() {
        let (mesh, run) = (axle(97), Run::new(&()));
        let extent = Extent::around(bounds(&mesh, &run).unwrap());
        let mut random = stream(0, "places");
        let points: Vec<[f64; 3]> = (0..500).map(|_| [(); 3].map(|()| unit(&mut random) - 0.5)).collect();
        let single: Vec<(f64, u32)> =
            points.iter().flat_map(|&p| nearest(&mesh, &extent, &[p], &run).unwrap()).collect();
        assert_eq!(nearest(&mesh, &extent, &points, &run).unwrap(), single);
        let same = vec![points[7]; 30];
        assert_eq!(nearest(&mesh, &extent, &same, &run).unwrap(), vec![single[7]; 30]);
    }

    #[test]
    fn neither_strays_nor_vertices_without_a_face_change_the_units() {
        // Regression: they enlarged the box of the mesh compared with that of its edits, so that places were scaled.
        let w = 20u32;
        let mut points: Vec<[f64; 3]> = (0..w * w).map(|i| [f64::from(i % w), f64::from(i / w), 0.]).collect();
        let quads: Vec<[u32; 4]> =
            (0..w * (w - 1)).filter(|i| i % w < w - 1).map(|i| [i, i + 1, i + w + 1, i + w]).collect();
        let bounds = Some([[0.; 3], [19., 19., 0.]]);
        let place = [3.4, 2.2, 0.];
        let face = faces(&Mesh::from_slices(&points, &quads).unwrap(), &[place], bounds, 1).unwrap();
        points[210] = [3e3, 0., 7.];
        points.push([60., 60., 60.]);
        let odd = Mesh::from_slices(&points, &quads).unwrap();
        assert_eq!(faces(&odd, &[place], bounds, 1).unwrap(), face);
        // In millimetres they must be scaled.
        let large: Vec<[f64; 3]> = points.iter().map(|p| p.map(|x| 1e3 * x)).collect();
        assert_eq!(faces(&Mesh::from_slices(&large, &quads).unwrap(), &[place], bounds, 1).unwrap(), face);
    }

    #[test]
    fn coordinates_of_any_size_and_none() {
        for scale in [1e-300, 1e300] {
            let points = [[0., 0., 0.], [scale, 0., 0.], [scale, scale, 0.], [0., scale, 0.], [f64::NAN; 3]];
            let mesh = Mesh::from_slices(&points, &[[0u32, 1, 4], [0, 1, 2], [0, 2, 3]]).unwrap();
            let place = [0.1 * scale, 0.9 * scale, 0.];
            assert_eq!(faces(&mesh, &[place], None, 1).unwrap(), [2]);
            assert_eq!(faces(&mesh, &[[0.1, 0.9, 0.]], Some([[0.; 3], [1., 1., 0.]]), 1).unwrap(), [2]);
        }
        let nowhere = Mesh::from_slices(&[[f64::NAN; 3]; 3], &[[0u32, 1, 2]]).unwrap();
        assert!(faces(&nowhere, &[[0.; 3]], None, 1).is_err());
    }
}
