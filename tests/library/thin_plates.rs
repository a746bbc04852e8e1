//! Flat plates and sheets: front and back of a thin arm are one part, whatever the seed.

use nystrom_stream::{Mesh, Segmenter};
use std::collections::{BTreeSet, HashMap};

/// Squares of a plate along its sides.
const SIZE: usize = 60;
/// Where an arm in the middle lies.
const MIDDLE: std::ops::Range<usize> = 24..36;

/// Vertices and triangles of a plate, `thick` squares thick, that consists of those for which `is_solid` holds.
#[derive(Default)]
struct Plate {
    number: HashMap<[usize; 3], u32>,
    positions: Vec<[f64; 3]>,
    faces: Vec<[u32; 3]>,
}

impl Plate {
    fn new(thick: usize, is_solid: impl Fn(usize, usize) -> bool) -> Self {
        let solid = |x: usize, y: usize| (1..=SIZE).contains(&x) && (1..=SIZE).contains(&y) && is_solid(x - 1, y - 1);
        let mut plate = Self::default();
        for (x, y) in (1..=SIZE).flat_map(|x| (1..=SIZE).map(move |y| (x, y))).filter(|&(x, y)| solid(x, y)) {
            plate.square([[x, y, thick], [x + 1, y, thick], [x + 1, y + 1, thick], [x, y + 1, thick]]);
            plate.square([[x, y, 0], [x, y + 1, 0], [x + 1, y + 1, 0], [x + 1, y, 0]]);
            let sides = [
                (solid(x, y - 1), [x, y], [x + 1, y]),
                (solid(x + 1, y), [x + 1, y], [x + 1, y + 1]),
                (solid(x, y + 1), [x + 1, y + 1], [x, y + 1]),
                (solid(x - 1, y), [x, y + 1], [x, y]),
            ];
            for (_, a, b) in sides.into_iter().filter(|(is_inside, ..)| !is_inside) {
                for z in 0..thick {
                    plate.square([[a[0], a[1], z], [b[0], b[1], z], [b[0], b[1], z + 1], [a[0], a[1], z + 1]]);
                }
            }
        }
        plate
    }

    fn square(&mut self, corners: [[usize; 3]; 4]) {
        let [a, b, c, d] = corners.map(|corner| {
            *self.number.entry(corner).or_insert_with(|| {
                self.positions.push(corner.map(|x| x as f64));
                self.positions.len() as u32 - 1
            })
        });
        self.faces.extend([[a, b, c], [a, c, d]]);
    }

    /// A sheet of triangles in a plane.
    fn sheet(is_solid: impl Fn(usize, usize) -> bool) -> Self {
        let mut sheet = Self::default();
        for (x, y) in (0..SIZE).flat_map(|x| (0..SIZE).map(move |y| (x, y))).filter(|&(x, y)| is_solid(x, y)) {
            let (right, up) = (x + 1, y + 1);
            sheet.square([[x, y, 0], [right, y, 0], [right, up, 0], [x, up, 0]].map(|[x, y, z]| [x + 1, y + 1, z]));
        }
        sheet
    }

    /// The labels under each of four seeds.
    fn labels(&self) -> Vec<Vec<u32>> {
        let mesh = Mesh::from_slices(&self.positions, &self.faces).unwrap();
        (0..4).map(|seed| Segmenter::new().seed(seed).run(&mesh).unwrap().labels().to_vec()).collect()
    }

    /// The labels of the front and of the back at a square.
    fn sides(&self, labels: &[u32], [x, y]: [usize; 2]) -> BTreeSet<u32> {
        let corner = [x as f64 + 1., y as f64 + 1.];
        let is_there = |face: &[u32; 3]| {
            let corners = face.map(|v| self.positions[v as usize]);
            corners.iter().all(|p| p[2] == corners[0][2] && (0..2).all(|k| (0. ..=1.).contains(&(p[k] - corner[k]))))
        };
        self.faces.iter().zip(labels).filter(|(face, _)| is_there(face)).map(|(_, label)| *label).collect()
    }
}

/// Both sides of an arm were clusters of their own: the plus had 2, 4, 2 and 4 parts, the H 1, 2, 2 and 2. Plates half
/// or three quarters as thick were one part.
#[test]
fn arms_of_thin_plates_are_parts_under_all_seeds() {
    let is_leg = |x: usize| x < MIDDLE.len() || x >= SIZE - MIDDLE.len();
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
    for labels in Plate::sheet(|_, y| y < 2 * MIDDLE.len()).labels() {
        assert_eq!(labels.iter().max(), Some(&0), "a rectangle is left whole");
    }
}

fn is_plus(x: usize, y: usize) -> bool {
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
