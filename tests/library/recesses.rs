//! Pockets in a block: their floors and walls are no parts.

use nystrom_stream::{Mesh, Segmenter};
use std::collections::HashMap;

/// Squares along the sides of the block.
const SIZE: usize = 48;
/// Its height.
const HEIGHT: usize = 14;

/// The surface of a block of cubes with the given height over each square.
fn block(height: impl Fn(usize, usize) -> usize) -> Mesh {
    let (mut number, mut positions, mut faces) = (HashMap::new(), Vec::new(), Vec::new());
    let mut square = |corners: [[usize; 3]; 4]| {
        let [a, b, c, d] = corners.map(|corner| {
            *number.entry(corner).or_insert_with(|| {
                positions.push(corner.map(|x| x as f64));
                positions.len() as u32 - 1
            })
        });
        faces.extend([[a, b, c], [a, c, d]]);
    };
    // Squares are counted from 1, so that those around the block have a number.
    let at = |x: usize, y: usize| if x.min(y) > 0 && x.max(y) <= SIZE { height(x - 1, y - 1) } else { 0 };
    for (x, y) in (1..=SIZE).flat_map(|x| (1..=SIZE).map(move |y| (x, y))) {
        let (top, [right, up]) = (at(x, y), [x + 1, y + 1]);
        square([[x, y, top], [right, y, top], [right, up, top], [x, up, top]]);
        square([[x, y, 0], [x, up, 0], [right, up, 0], [right, y, 0]]);
        let sides = [
            (at(x, y - 1), [x, y], [right, y]),
            (at(right, y), [right, y], [right, up]),
            (at(x, up), [right, up], [x, up]),
            (at(x - 1, y), [x, up], [x, y]),
        ];
        for (beside, a, b) in sides {
            for z in beside..top {
                square([[a[0], a[1], z], [b[0], b[1], z], [b[0], b[1], z + 1], [a[0], a[1], z + 1]]);
            }
        }
    }
    Mesh::from_vecs(positions, faces).unwrap()
}

fn parts(mesh: &Mesh, seed: u64) -> usize {
    Segmenter::new().seed(seed).run(mesh).unwrap().parts()
}

/// Regression: floor and walls of each pocket were parts, 17 to 21 of them.
#[test]
fn a_block_with_four_pockets_is_one_part() {
    let is_deep = |x: usize| (9..19).contains(&x) || (29..39).contains(&x);
    let mesh = block(|x, y| if is_deep(x) && is_deep(y) { HEIGHT - 9 } else { HEIGHT });
    for seed in 0..2 {
        assert_eq!(parts(&mesh, seed), 1, "seed {seed}");
    }
}

/// Regression: a step inside a bore was a part, and so was the floor below it.
#[test]
fn so_is_a_block_with_a_stepped_pocket() {
    let within = |margin: usize, x: usize, y: usize| x.min(y) >= margin && x.max(y) < SIZE - margin;
    let mesh = block(|x, y| match (within(18, x, y), within(12, x, y)) {
        (true, _) => HEIGHT - 12,
        (_, true) => HEIGHT - 6,
        _ => HEIGHT,
    });
    assert_eq!(parts(&mesh, 0), 1);
}

/// The knob rises above its mouth.
#[test]
fn a_knob_in_a_pocket_is_a_part() {
    let within = |margin: usize, x: usize, y: usize| x.min(y) >= margin && x.max(y) < SIZE - margin;
    let mesh = block(|x, y| match (within(20, x, y), within(8, x, y)) {
        (true, _) => HEIGHT + 20,
        (_, true) => HEIGHT - 6,
        _ => HEIGHT,
    });
    assert_eq!(parts(&mesh, 0), 2);
}
