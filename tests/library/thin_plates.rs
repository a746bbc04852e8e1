//! Flat plates and sheets: front and back of a thin arm are one part, whatever the seed.

use crate::common::squares::Squares;
use nystrom_stream::{Mesh, Segmenter};
use std::collections::BTreeSet;

/// Squares of a plate along its sides.
const SIZE: i32 = 60;
/// Where an arm in the middle lies.
const MIDDLE: std::ops::Range<i32> = 24..36;
/// Its width.
const WIDTH: i32 = MIDDLE.end - MIDDLE.start;

/// A plate or a sheet.
struct Plate {
    surface: Squares,
}

impl Plate {
    /// A plate, `thick` squares thick, of those squares for which `is_solid` holds.
    fn new(thick: i32, is_solid: impl Fn(i32, i32) -> bool) -> Self {
        let mut surface = Squares::default();
        surface.add_columns(SIZE, |x, y| if is_solid(x, y) { thick } else { 0 });
        Self { surface }
    }

    /// A sheet of triangles in a plane.
    fn sheet(is_solid: impl Fn(i32, i32) -> bool) -> Self {
        let mut surface = Squares::default();
        for (x, y) in (0..SIZE).flat_map(|x| (0..SIZE).map(move |y| (x, y))).filter(|&(x, y)| is_solid(x, y)) {
            surface.add([[x, y, 0], [x + 1, y, 0], [x + 1, y + 1, 0], [x, y + 1, 0]]);
        }
        Self { surface }
    }

    /// The labels under each of four seeds.
    fn labels(&self) -> Vec<Vec<u32>> {
        let mesh = Mesh::from_slices(&self.surface.positions, &self.surface.faces).unwrap();
        (0..4).map(|seed| Segmenter::new().seed(seed).run(&mesh).unwrap().labels().to_vec()).collect()
    }

    /// The labels of the front and of the back at a square.
    fn sides(&self, labels: &[u32], [x, y]: [i32; 2]) -> BTreeSet<u32> {
        let corner = [f64::from(x), f64::from(y)];
        let is_there = |face: &[u32; 3]| {
            let corners = face.map(|v| self.surface.positions[v as usize]);
            corners.iter().all(|p| p[2] == corners[0][2] && (0..2).all(|k| (0. ..=1.).contains(&(p[k] - corner[k]))))
        };
        self.surface.faces.iter().zip(labels).filter(|(face, _)| is_there(face)).map(|(_, label)| *label).collect()
    }
}

/// Both sides of an arm were clusters of their own: the plus had 2, 4, 2 and 4 parts, the H 1, 2, 2 and 2. Plates half
/// or three quarters as thick were one part.
#[test]
fn arms_of_thin_plates_are_parts_under_all_seeds() {
    let is_leg = |x: i32| !(WIDTH..SIZE - WIDTH).contains(&x);
    for labels in Plate::new(4, |x, y| is_leg(x) || MIDDLE.contains(&y)).labels() {
        assert_eq!(labels.iter().max(), Some(&2));
    }
    for thick in [2, 3, 4] {
        assert_arms_are_parts(&Plate::new(thick, is_plus), &format!("{thick} thick"));
    }
}

/// A planar mesh was one part, whatever its outline.
#[test]
fn arms_of_planar_meshes_are_parts_under_all_seeds() {
    assert_arms_are_parts(&Plate::sheet(is_plus), "a sheet");
    for labels in Plate::sheet(|_, y| y < 2 * WIDTH).labels() {
        assert_eq!(labels.iter().max(), Some(&0), "a rectangle is left whole");
    }
}

fn is_plus(x: i32, y: i32) -> bool {
    MIDDLE.contains(&x) || MIDDLE.contains(&y)
}

/// Asserts that the arms of a plus and its middle are its parts, in front as behind.
fn assert_arms_are_parts(plus: &Plate, which: &str) {
    for labels in plus.labels() {
        let tips = [[2, 30], [57, 30], [30, 2], [30, 57]].map(|tip| plus.sides(&labels, tip));
        assert!(tips.iter().all(|sides| sides.len() == 1), "front and back differ: {tips:?}, {which}");
        assert_eq!(tips.iter().flatten().collect::<BTreeSet<_>>().len(), 4, "{tips:?}, {which}");
        assert_eq!(labels.iter().max(), Some(&4), "the arms and the middle, {which}");
    }
}
