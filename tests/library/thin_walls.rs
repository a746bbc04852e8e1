//! Thin walls and towers with sharp edges: their parts were in doubt with rows over all faces, and clear on a contraction.

use crate::common;
use nystrom_stream::{Mesh, Segmenter};
use std::collections::HashMap;

/// Cubes around the axis, outward and upward.
const SIZE: [i32; 3] = [120, 43, 30];

/// Whether a cube of a round castle is solid: a floor, two walls, a keep, and four towers with battlements.
fn is_solid([turn, out, up]: [i32; 3]) -> bool {
    let [turns, wide, high] = SIZE;
    if !(3..wide).contains(&out) || !(0..high).contains(&up) {
        return false;
    }
    let along = turn.rem_euclid(turns / 4);
    let wall = (33..36).contains(&out) && up < 15 || (20..22).contains(&out) && up < 10 || out < 14 && up < 24;
    let in_tower = along < 14 && (29..40).contains(&out);
    let at_rim = !(3..11).contains(&along) || !(32..37).contains(&out);
    let battlement = at_rim && along / 3 % 2 == 0;
    up < 2 || wall || in_tower && (up < high - 4 || battlement)
}

/// The surface of the solid cubes, bent around the axis, so without stairs; two triangles per square.
fn castle() -> Mesh {
    let (mut number, mut points, mut faces) = (HashMap::new(), Vec::new(), Vec::new());
    let mut corner = |[turn, out, up]: [i32; 3]| {
        let turn = turn.rem_euclid(SIZE[0]);
        *number.entry([turn, out, up]).or_insert_with(|| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(turn) / f64::from(SIZE[0])).sin_cos();
            points.push([f64::from(out) * cos, f64::from(out) * sin, f64::from(up)].map(|x| x as f32));
            points.len() as u32 - 1
        })
    };
    let [turns, wide, high] = SIZE;
    for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
        let cubes = (0..turns).flat_map(|a| (0..wide).flat_map(move |b| (0..high).map(move |c| [a, b, c])));
        for cube in cubes.filter(|&cube| is_solid(cube)) {
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
    let segmenter = || Segmenter::new().seed(1);
    let doubt = |cut: &nystrom_stream::Segmentation| cut.report().decision.as_ref().unwrap().expected_disagreement;
    let exact = segmenter().exact(true).run(&mesh).unwrap();
    let (work, again) = (dir.path().join("work"), dir.path().join("again"));
    let cut = segmenter().work_dir(&work).run(&mesh).unwrap();
    assert!(doubt(&cut) < 0.6 * doubt(&exact), "{} {}", doubt(&cut), doubt(&exact));
    // Nothing depends on where that happens, and later cuts are of the same decision.
    for cut in [segmenter().threads(1).run(&mesh).unwrap(), segmenter().work_dir(&work).run(&mesh).unwrap()] {
        assert_eq!(cut.labels(), segmenter().work_dir(&again).run(&mesh).unwrap().labels());
    }
    let six = |segmenter: Segmenter| segmenter.parts(6).run(&mesh).unwrap().labels().to_vec();
    assert_eq!(six(segmenter().work_dir(&work)), six(segmenter()));
    assert_eq!(six(segmenter().work_dir(&work).exact(true)), six(segmenter().exact(true)));
}
