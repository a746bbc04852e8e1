//! Flat plates: front and back of a thin arm are one part, whatever the seed.

use nystrom_stream::{Mesh, Segmenter};
use std::collections::HashMap;

/// Squares of a plate along its sides, and how many it is thick.
const SIZE: usize = 60;
const THICK: usize = 4;
/// Where an arm in the middle lies.
const MIDDLE: std::ops::Range<usize> = 24..36;

/// Vertices and triangles of a plate that consists of the squares for which `is_solid` holds.
#[derive(Default)]
struct Plate {
    number: HashMap<[usize; 3], u32>,
    positions: Vec<[f64; 3]>,
    faces: Vec<[u32; 3]>,
}

impl Plate {
    fn new(is_solid: impl Fn(usize, usize) -> bool) -> Self {
        let solid = |x: usize, y: usize| (1..=SIZE).contains(&x) && (1..=SIZE).contains(&y) && is_solid(x - 1, y - 1);
        let mut plate = Self::default();
        for (x, y) in (1..=SIZE).flat_map(|x| (1..=SIZE).map(move |y| (x, y))).filter(|&(x, y)| solid(x, y)) {
            plate.square([[x, y, THICK], [x + 1, y, THICK], [x + 1, y + 1, THICK], [x, y + 1, THICK]]);
            plate.square([[x, y, 0], [x, y + 1, 0], [x + 1, y + 1, 0], [x + 1, y, 0]]);
            let sides = [
                (solid(x, y - 1), [x, y], [x + 1, y]),
                (solid(x + 1, y), [x + 1, y], [x + 1, y + 1]),
                (solid(x, y + 1), [x + 1, y + 1], [x, y + 1]),
                (solid(x - 1, y), [x, y + 1], [x, y]),
            ];
            for (_, a, b) in sides.into_iter().filter(|(is_inside, ..)| !is_inside) {
                for z in 0..THICK {
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

    /// The number of parts under each of four seeds.
    fn parts(&self) -> Vec<usize> {
        let mesh = Mesh::from_slices(&self.positions, &self.faces).unwrap();
        (0..4).map(|seed| Segmenter::new().seed(seed).run(&mesh).unwrap().parts()).collect()
    }
}

/// Both sides of an arm were clusters of their own: the plus had 2, 4, 2 and 4 parts, the H 1, 2, 2 and 2.
#[test]
fn arms_of_thin_plates_are_parts_under_all_seeds() {
    assert_eq!(Plate::new(|x, y| MIDDLE.contains(&x) || MIDDLE.contains(&y)).parts(), [4; 4]);
    let is_leg = |x: usize| x < MIDDLE.len() || x >= SIZE - MIDDLE.len();
    assert_eq!(Plate::new(|x, y| is_leg(x) || MIDDLE.contains(&y)).parts(), [3; 4]);
}
