//! Thin walls and towers with sharp edges: their parts were in doubt with rows over all faces, and clear on a contraction.

use crate::common;
use nystrom_stream::{Mesh, Segmenter};
use std::collections::HashMap;

/// Height of the towers.
const TOP: i32 = 34;
/// Side of the floor.
const SIDE: i32 = 72;

/// Whether a cube of a castle is solid: a floor, walls, four towers and a keep, round, hollow and notched at the top.
fn is_solid([x, y, z]: [i32; 3]) -> bool {
    if ![x, y].iter().all(|k| (0..SIDE).contains(k)) || !(0..TOP).contains(&z) {
        return false;
    }
    let radius = 0.13 * f64::from(SIDE);
    let towers = [(radius, radius), (radius, -radius), (-radius, radius), (-radius, -radius)]
        .map(|(a, b)| [a, b].map(|k| if k < 0. { f64::from(SIDE) + k } else { k }))
        .map(|at| (at, radius));
    let keep = ([f64::from(SIDE) / 2.; 2], 0.16 * f64::from(SIDE));
    for ([a, b], radius) in towers.into_iter().chain([keep]) {
        let (dx, dy) = (f64::from(x) - a, f64::from(y) - b);
        let notch = ((dy.atan2(dx) / std::f64::consts::TAU * 16.).floor() as i32).rem_euclid(2) == 0;
        if dx.hypot(dy) < radius {
            return z < TOP - 4 || dx.hypot(dy) >= radius - 3. && !notch;
        }
    }
    let wall = |k: i32| [8, 61].iter().any(|first| (*first..first + 3).contains(&k));
    z < 2 || z < 16 && (wall(x) || wall(y))
}

/// The surface of the solid cubes, two triangles per square.
fn castle() -> Mesh {
    let (mut number, mut points, mut faces) = (HashMap::new(), Vec::new(), Vec::new());
    let mut corner = |at: [i32; 3]| {
        *number.entry(at).or_insert_with(|| {
            points.push(at.map(f64::from));
            points.len() as u32 - 1
        })
    };
    let cubes = (0..SIDE).flat_map(|x| (0..SIDE).flat_map(move |y| (0..TOP).map(move |z| [x, y, z])));
    for cube in cubes.filter(|&cube| is_solid(cube)) {
        for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
            let mut next = cube;
            next[axis] += 2 * side - 1;
            if is_solid(next) {
                continue;
            }
            let [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
            let mut square = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[i, j]| {
                let mut at = cube;
                (at[axis], at[a], at[b]) = (at[axis] + side, at[a] + i, at[b] + j);
                corner(at)
            });
            if side == 0 {
                square.reverse();
            }
            let [p, q, r, s] = square;
            faces.extend([[p, q, r], [p, r, s]]);
        }
    }
    Mesh::from_slices(&points, &faces).unwrap()
}

#[test]
fn parts_in_doubt_over_all_faces_are_decided_on_a_contraction() {
    let (mesh, dir) = (castle(), common::in_memory());
    let doubt = |cut: &nystrom_stream::Segmentation| cut.report().decision.as_ref().unwrap().expected_disagreement;
    let exact = Segmenter::new().exact(true).run(&mesh).unwrap();
    let (work, again) = (dir.path().join("work"), dir.path().join("again"));
    let cut = Segmenter::new().work_dir(&work).run(&mesh).unwrap();
    assert!(doubt(&cut) < 0.6 * doubt(&exact), "{} {}", doubt(&cut), doubt(&exact));
    // Nothing depends on where that happens, and later cuts are of the same decision.
    for cut in [Segmenter::new().threads(1).run(&mesh).unwrap(), Segmenter::new().work_dir(&work).run(&mesh).unwrap()] {
        assert_eq!(cut.labels(), Segmenter::new().work_dir(&again).run(&mesh).unwrap().labels());
    }
    let six = |segmenter: Segmenter| segmenter.parts(6).run(&mesh).unwrap().labels().to_vec();
    assert_eq!(six(Segmenter::new().work_dir(&work)), six(Segmenter::new()));
    assert_eq!(six(Segmenter::new().work_dir(&work).exact(true)), six(Segmenter::new().exact(true)));
}
