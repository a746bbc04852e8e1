//! Surfaces made of squares on a grid, such as those of solid cubes: squares share their corners.

use std::collections::HashMap;

/// Corners, numbered in the order in which squares have them, and two triangles per square.
#[derive(Default)]
pub struct Squares {
    number: HashMap<[i32; 3], u32>,
    /// The corners, as places on the grid.
    pub positions: Vec<[f64; 3]>,
    pub faces: Vec<[u32; 3]>,
}

impl Squares {
    /// Adds the square with these corners, one after the other around it.
    pub fn add(&mut self, corners: [[i32; 3]; 4]) {
        let [a, b, c, d] = corners.map(|corner| {
            *self.number.entry(corner).or_insert_with(|| {
                self.positions.push(corner.map(f64::from));
                self.positions.len() as u32 - 1
            })
        });
        self.faces.extend([[a, b, c], [a, c, d]]);
    }

    /// Adds the surface of the cubes over a square of `size` × `size`, of which there are `height(x, y)` in each column:
    /// by column its top, its bottom, and its sides from the bottom up.
    pub fn add_columns(&mut self, size: i32, height: impl Fn(i32, i32) -> i32) {
        let around = 0..size;
        let at = |x: i32, y: i32| if around.contains(&x) && around.contains(&y) { height(x, y) } else { 0 };
        for (x, y) in (0..size).flat_map(|x| (0..size).map(move |y| (x, y))) {
            let (top, [right, up]) = (at(x, y), [x + 1, y + 1]);
            if top == 0 {
                continue;
            }
            self.add([[x, y, top], [right, y, top], [right, up, top], [x, up, top]]);
            self.add([[x, y, 0], [x, up, 0], [right, up, 0], [right, y, 0]]);
            let sides = [
                (at(x, y - 1), [x, y], [right, y]),
                (at(right, y), [right, y], [right, up]),
                (at(x, up), [right, up], [x, up]),
                (at(x - 1, y), [x, up], [x, y]),
            ];
            for (beside, a, b) in sides {
                for z in beside..top {
                    self.add([[a[0], a[1], z], [b[0], b[1], z], [b[0], b[1], z + 1], [a[0], a[1], z + 1]]);
                }
            }
        }
    }
}
