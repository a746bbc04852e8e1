//! Pockets in a block: their floors and walls are no parts.

use crate::common::squares::Squares;
use nystrom_stream::{Mesh, Segmenter};

/// Squares along the sides of the block.
const SIZE: i32 = 48;
/// Its height.
const HEIGHT: i32 = 14;

/// The surface of a block of cubes with the given height over each square.
fn block(height: impl Fn(i32, i32) -> i32) -> Mesh {
    let mut surface = Squares::default();
    surface.add_columns(SIZE, height);
    Mesh::from_vecs(surface.positions, surface.faces).unwrap()
}

fn parts(mesh: &Mesh, seed: u64) -> usize {
    Segmenter::new().seed(seed).run(mesh).unwrap().parts()
}

/// Regression: floor and walls of each pocket were parts, 17 to 21 of them.
#[test]
fn a_block_with_four_pockets_is_one_part() {
    let is_deep = |x: i32| (9..19).contains(&x) || (29..39).contains(&x);
    let mesh = block(|x, y| if is_deep(x) && is_deep(y) { HEIGHT - 9 } else { HEIGHT });
    for seed in 0..2 {
        assert_eq!(parts(&mesh, seed), 1, "seed {seed}");
    }
}

/// Regression: a step inside a bore was a part, and so was the floor below it.
#[test]
fn so_is_a_block_with_a_stepped_pocket() {
    let within = |margin: i32, x: i32, y: i32| x.min(y) >= margin && x.max(y) < SIZE - margin;
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
    let within = |margin: i32, x: i32, y: i32| x.min(y) >= margin && x.max(y) < SIZE - margin;
    let mesh = block(|x, y| match (within(20, x, y), within(8, x, y)) {
        (true, _) => HEIGHT + 20,
        (_, true) => HEIGHT - 6,
        _ => HEIGHT,
    });
    assert_eq!(parts(&mesh, 0), 2);
}
