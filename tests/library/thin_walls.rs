//! Thin walls and towers with sharp edges: their parts were in doubt with rows over all faces, and clear on a contraction.

use crate::common::{self, squares::Squares};
use nystrom_stream::{Mesh, Segmenter};

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
    let mut surface = Squares::default();
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
                at[0] = at[0].rem_euclid(turns);
                at
            });
            if side == 0 {
                square.reverse();
            }
            surface.add(square);
        }
    }
    let bent = |[turn, out, up]: [f64; 3]| {
        let (sin, cos) = (std::f64::consts::TAU * turn / f64::from(turns)).sin_cos();
        [out * cos, out * sin, up].map(|x| x as f32)
    };
    let points: Vec<[f32; 3]> = surface.positions.into_iter().map(bent).collect();
    Mesh::from_slices(&points, &surface.faces).unwrap()
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
