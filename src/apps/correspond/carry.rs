//! Transfers data of B to A by matches: properties of vertices, properties of faces, colours (§7.1).
//!
//! A vertex takes the value of its match. A face takes the most frequent value of its corners' matches, where a vertex
//! of B represents the first face around it; so borders of labels are accurate to within an edge. Corners without a
//! match do not count. A vertex or face without any match gets −1, which is no label, NaN in a floating-point column, 0
//! in an unsigned one, or grey as its colour. One column is 8 bytes per vertex of B on disk.

use super::matches::Match;
use crate::apps::labelled_faces::LabelledFaces;
use crate::base::{Error, Result};
use crate::mesh::Mesh;
use crate::mesh::ply::labelled::{GREY, colour_of};
use crate::mesh::ply::{Column, ElementKind, Scalar};
use crate::store::{Context, MappedSlice, WorkDir};
use std::cmp::Reverse;

/// Up to this number of values, each is compared with all others: a face may have millions of corners.
const FEW: usize = 16;

/// Faces between two checks of the stop flag.
const STOP_CHECK: usize = 1 << 18;

/// A property of B on its vertices, ready to be transferred.
#[derive(Clone, Debug)]
pub struct Property {
    name: String,
    scalar: Scalar,
    /// Whether it belongs to vertices or faces.
    pub of: ElementKind,
    /// One number per vertex of B.
    values: MappedSlice<f64>,
}

/// The value of anything without a match; a column of an unsigned type turns −1 into 0.
fn missing(scalar: Scalar) -> f64 {
    if scalar.is_real() { f64::NAN } else { -1. }
}

/// For each vertex of `mesh` (n) the first face around it, `u32::MAX` if there is none.
fn first_faces(mesh: &Mesh, context: Context<'_>) -> Result<MappedSlice<u32>> {
    let mut array = context.work.array::<u32>("first_faces.npy", &[mesh.positions.len()])?;
    let of = &mut array.data()[..];
    of.fill(u32::MAX);
    let n = mesh.faces.len();
    for start in (0..n).step_by(STOP_CHECK) {
        context.run.cancel.check()?;
        mesh.faces.for_each(start..n.min(start + STOP_CHECK), |face, corners| {
            corners.iter().for_each(|&v| of[v as usize] = of[v as usize].min(face as u32));
        });
    }
    array.finish(false)
}

impl Property {
    /// Reads the property `name` of the vertices of `b`, or else of its faces.
    ///
    /// # Errors
    /// [`Error::Unusable`] if neither have it, [`Error::Io`], [`Error::Cancelled`].
    pub fn read(b: &Mesh, name: &str, context: Context<'_>) -> Result<Self> {
        let found = [ElementKind::Vertices, ElementKind::Faces]
            .into_iter()
            .find_map(|of| Some((of, b.document()?.property(of, name)?)));
        let Some((of, property)) = found else {
            let problem = format!("neither its vertices nor its faces have a numeric property {name:?}");
            return Err(Error::unusable(b.path(), problem, "name a property listed in its header"));
        };
        // The property's name comes from the user and must not be used as a file name.
        let mut writer = context.work.writer::<f64>("property.npy", 1)?;
        property.for_each(context.run, |_, number| writer.push(&[number]))?;
        let mut values = writer.finish(false)?;
        if of == ElementKind::Faces {
            let faces = first_faces(b, context)?;
            let mut writer = context.work.writer::<f64>("property.npy", 1)?;
            let missing = missing(property.scalar);
            for (k, &face) in faces.iter().enumerate() {
                if k % (1 << 16) == 0 {
                    context.run.cancel.check()?;
                }
                writer.push(&[values.get(face as usize).copied().unwrap_or(missing)])?;
            }
            values = writer.finish(false)?;
        }
        Ok(Self { name: name.to_owned(), scalar: property.scalar, of, values })
    }

    /// The value of B's vertex that `one` points to.
    fn value(&self, one: &Match) -> f64 {
        one.vertex().and_then(|v| self.values.get(v as usize)).copied().unwrap_or(missing(self.scalar))
    }

    /// The column for A, given `matches`: on its vertices or on its faces, as on B.
    pub fn column<'a>(&'a self, a: &'a Mesh, matches: &'a [Match]) -> Column<'a> {
        let value: Box<dyn Fn(usize) -> f64 + 'a> = match self.of {
            ElementKind::Vertices => Box::new(|v| self.value(&matches[v])),
            ElementKind::Faces => Box::new(|face| {
                a.faces.with(face, |corners| {
                    let found = corners.iter().map(|&v| &matches[v as usize]).filter(|one| one.vertex().is_some());
                    most(found.map(|one| self.value(one))).unwrap_or(missing(self.scalar))
                })
            }),
        };
        Column { name: self.name.clone(), scalar: self.scalar, value }
    }
}

/// The most frequent value; the first of several.
fn most(values: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    if values.clone().nth(FEW).is_some() {
        let mut sorted: Vec<(u64, usize)> = values.map(f64::to_bits).zip(0..).collect();
        sorted.sort_unstable();
        let same = sorted.chunk_by(|a, b| a.0 == b.0);
        let best = same.max_by_key(|same| (same.len(), Reverse(same[0].1)));
        return best.map(|same| f64::from_bits(same[0].0));
    }
    let mut best = (0, None);
    for value in values.clone() {
        let count = values.clone().filter(|other| other.to_bits() == value.to_bits()).count();
        if count > best.0 {
            best = (count, Some(value));
        }
    }
    best.1
}

/// Colours of B's vertices.
#[derive(Clone, Debug)]
pub struct Colours(MappedSlice<[u8; 3]>);

impl Colours {
    /// By position: red, green and blue along the sides of the bounding box.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn by_position(b: &Mesh, context: Context<'_>) -> Result<Self> {
        let n = b.positions.len();
        let mut bounds = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
        let all = || (0..n as u32).map(|v| b.positions.get(v));
        for p in all().filter(|p| p.iter().all(|x| x.is_finite())) {
            for (bound, x) in bounds.iter_mut().zip(p) {
                *bound = [bound[0].min(x), bound[1].max(x)];
            }
        }
        context.run.cancel.check()?;
        let most = bounds.iter().map(|b| b[1] - b[0]).fold(0., f64::max);
        let channel = |axis: usize, x: f64| {
            let [low, high] = bounds[axis];
            // A flat side would show noise in full colour.
            let share = (x - low) / (high - low).max(0.05 * most);
            if share.is_finite() { (40. + 215. * share.clamp(0., 1.)) as u8 } else { GREY[axis] }
        };
        Self::of(all().map(|p| std::array::from_fn(|axis| channel(axis, p[axis]))), context.work)
    }

    /// By parts: the labels of B's faces, in the colours that its file gives to parts, or else in default colours.
    ///
    /// # Errors
    /// [`Error::Unusable`] if B's faces have no labels, [`Error::Io`], [`Error::Cancelled`].
    pub fn by_parts(b: &Mesh, context: Context<'_>) -> Result<Self> {
        let mut found = LabelledFaces::needed_of_mesh(b, "segment it first, or colour by position", context)?;
        let labels = found.labels.clone();
        let palette = found.colours(b, &labels, context.run)?;
        let faces = first_faces(b, context)?;
        let label = |face: u32| labels.get(face as usize).map_or(GREY, |&label| colour_of(&palette, label));
        Self::of(faces.iter().map(|&face| label(face)), context.work)
    }

    fn of(colours: impl Iterator<Item = [u8; 3]>, work: &WorkDir) -> Result<Self> {
        let mut writer = work.writer::<[u8; 3]>("colours.npy", 3)?;
        let mut buffer = Vec::with_capacity(1 << 16);
        for colour in colours {
            buffer.push(colour);
            if buffer.len() == 1 << 16 {
                writer.push(&buffer)?;
                buffer.clear();
            }
        }
        writer.push(&buffer)?;
        Ok(Self(writer.finish(false)?))
    }

    /// The colour of a vertex of B.
    pub fn of_b(&self, vertex: usize) -> [u8; 3] {
        self.0.get(vertex).copied().unwrap_or(GREY)
    }

    /// The colour that a match transfers to A.
    pub fn of_match(&self, one: &Match) -> [u8; 3] {
        one.vertex().map_or(GREY, |vertex| self.of_b(vertex as usize))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    #[test]
    fn the_most_frequent_value_wins_and_the_first_of_equals() {
        assert_eq!(most([1., 2., 2.].into_iter()), Some(2.));
        assert_eq!(most([3., 1., 2.].into_iter()), Some(3.));
        assert_eq!(most([].into_iter()), None);
        let many = |n: usize| (0..n).map(|k| [3., 1., 2., 1., 2.][k % 5]);
        assert_eq!([15, 100, 101].map(|n| most(many(n))), [Some(1.); 3]);
        assert_eq!(most((0..100).map(|k| if k < 50 { 2. } else { 1. })), Some(2.));
    }

    /// Regression: corners without a match counted, with the value 0. So a face with one match of three had the label
    /// 0, which is a part, as had faces without any.
    #[test]
    fn what_has_no_match_has_no_label() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap();
        let mut writer = work.writer::<f64>("property.npy", 1).unwrap();
        writer.push(&[7.; 3]).unwrap();
        let values = writer.finish(false).unwrap();
        let corners = [[0f64; 3], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.], [1., 1., 1.]];
        let a = Mesh::from_slices(&corners, &[[0u32, 1, 2], [2, 3, 4]]).unwrap();
        let mut matches = [Match::NONE; 5];
        matches[0] = Match { target: 1, distance: 0., confidence: 1. };
        let value = |scalar, of, k| {
            let property = Property { name: "label".into(), scalar, of, values: values.clone() };
            (property.column(&a, &matches).value)(k)
        };
        assert_eq!([0, 1].map(|face| value(Scalar::I32, ElementKind::Faces, face)), [7., -1.]);
        assert_eq!([0, 1].map(|vertex| value(Scalar::I32, ElementKind::Vertices, vertex)), [7., -1.]);
        assert_eq!(value(Scalar::F32, ElementKind::Faces, 0), 7.);
        assert!(value(Scalar::F32, ElementKind::Faces, 1).is_nan());
        assert_eq!(Scalar::U8.saturated(missing(Scalar::U8)), 0);
    }

    /// Regression: each value was compared with all others.
    #[test]
    fn a_face_of_many_corners_takes_no_time_of_their_square() {
        let seen = Cell::new(0);
        let count = |k: usize| {
            seen.set(seen.get() + 1);
            k as f64
        };
        assert_eq!(most((0..1_000).map(count)), Some(0.));
        assert!(seen.get() <= 2_000, "{} values looked at", seen.get());
    }
}
