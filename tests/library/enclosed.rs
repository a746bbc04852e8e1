//! Bodies with an inside: a hollow shape is cut like the solid one, and its walls follow.

use crate::common::shapes;
use nystrom_stream::pipeline::Walls;
use nystrom_stream::{Mesh, Segmenter};

const SIDES: u32 = 60;
/// Rings from the closed end to the hole.
const RINGS: u32 = 80;

/// Radius of two unequal balls on a bar at `x`, from −1 to 1.
fn dumbbell(x: f64) -> f64 {
    let ball = |centre: f64, size: f64| (size * size - (x - centre).powi(2)).max(0.).sqrt();
    ball(-0.6, 0.4).max(ball(0.68, 0.32)).max(0.1)
}

/// The surface of revolution through `profile`, closed at the x of its ends.
fn revolved(profile: &[[f64; 2]], sides: u32) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let ends = [profile[0][0], profile[profile.len() - 1][0]];
    let shape = shapes::revolved("revolved", ends, profile, sides);
    let triangle = |face: &Vec<u32>| [face[0], face[1], face[2]];
    (shape.vertices, shape.faces.iter().map(triangle).collect())
}

/// x of ring `ring` of the outside, which ends before 1: there is the hole.
fn along(ring: u32) -> f64 {
    -0.99 + 1.97 * f64::from(ring) / f64::from(RINGS - 1)
}

#[test]
fn a_hollow_dumbbell_is_cut_like_a_solid_one_and_its_inside_follows() {
    let outside: Vec<[f64; 2]> = (0..RINGS).map(|ring| [along(ring), dumbbell(along(ring))]).collect();
    let (positions, faces) = revolved(&outside, SIDES);
    let solid = Segmenter::new().run(&Mesh::from_slices(&positions, &faces).unwrap()).unwrap();
    assert!(solid.report().inside().is_none());
    // The wall has the same rings, the other way round, .04 further in; the hole is as wide as the bar.
    let wall = outside.iter().rev().map(|[x, radius]| [0.96 * x, (radius - 0.04).max(0.05)]);
    let whole: Vec<[f64; 2]> = outside.iter().copied().chain(wall).collect();
    let (positions, faces) = revolved(&whole, SIDES);
    let hollow = Segmenter::new().run(&Mesh::from_slices(&positions, &faces).unwrap()).unwrap();
    let enclosed = hollow.report().decision.as_ref().unwrap().enclosed;
    assert!((0.3..0.5).contains(&enclosed.walls) && enclosed.bodies == 0., "{enclosed:?}");
    assert_eq!(hollow.report().parts.len(), solid.report().parts.len());
    let middle = |face: u32| faces[face as usize].iter().map(|&v| positions[v as usize][0]).sum::<f64>() / 3.;
    let strip = 2 * SIDES;
    let (mut same, mut followed) = (0, 0);
    let outer = (RINGS - 1) * strip;
    for face in 0..outer {
        // Labels are numbered by first appearance, from the same end.
        same += u32::from(hollow.labels()[face as usize] == solid.labels()[face as usize]);
        let ring = 2 * RINGS - 2 - face / strip;
        let inner = ring * strip + face % strip;
        assert!((0.96 * middle(face) - middle(inner)).abs() < 0.03);
        followed += u32::from(hollow.labels()[inner as usize] == hollow.labels()[face as usize]);
    }
    assert!(same * 100 > outer * 95 && followed * 100 > outer * 95, "{same} and {followed} of {outer}");
    // Walls as a part of their own leave the others as they are.
    let apart = Segmenter::new().walls(Walls::Own).run(&Mesh::from_slices(&positions, &faces).unwrap()).unwrap();
    let own = hollow.report().parts.len() as u32;
    assert_eq!((apart.report().walls_label, apart.report().parts.len() as u32), (Some(own), own + 1));
    // Regression: they were told what people would think of the parts with their walls.
    assert!(apart.report().parts.iter().all(|part| part.expected_agreement.is_none()));
    let right = |face: u32| {
        let (whole, apart) = (hollow.labels()[face as usize], apart.labels()[face as usize]);
        apart == if face < outer { whole } else { own }
    };
    let right = (0..2 * outer).filter(|&face| right(face)).count() as u32;
    assert!(right * 100 > 2 * outer * 95, "{right} of {}", 2 * outer);
    // Regression: parts that walls alone would make were parts without a face, and counted.
    let mesh = Mesh::from_slices(&positions, &faces).unwrap();
    for parts in [40, 300] {
        let many = Segmenter::new().parts(parts).walls(Walls::Own).run(&mesh).unwrap();
        let sizes: Vec<u64> = many.report().parts.iter().map(|part| part.faces).collect();
        assert!(sizes.len() == parts + 1 && sizes.iter().all(|faces| *faces > 0), "{parts}: {sizes:?}");
    }
    // Regression: a range that ends beyond the cells was refused.
    let range = Segmenter::new().parts_between(2, 5_000).walls(Walls::Own).run(&mesh).unwrap();
    assert!(range.report().walls_label.is_some());
    let solid = Segmenter::new().walls(Walls::Own).run(&Mesh::creature(3_000).unwrap()).unwrap();
    assert!(solid.report().walls_label.is_none());
}

/// Regression: a cavity that is a closed surface of its own counted as a body within, since every closed component is
/// oriented outward.
#[test]
fn a_closed_cavity_is_a_wall_if_it_is_wound_against_the_outside() {
    for (sides, rings) in [(SIDES, RINGS), (180, 120)] {
        let x = |ring: u32| -0.99 + 1.98 * f64::from(ring) / f64::from(rings - 1);
        let outside: Vec<[f64; 2]> = (0..rings).map(|ring| [x(ring), dumbbell(x(ring))]).collect();
        let within: Vec<[f64; 2]> = outside.iter().map(|[x, radius]| [0.96 * x, (radius - 0.04).max(0.05)]).collect();
        let ([mut positions, inner], [outer, cavity]) = {
            let (a, b) = (revolved(&outside, sides), revolved(&within, sides));
            ([a.0, b.0], [a.1, b.1])
        };
        let solid = Segmenter::new().run(&Mesh::from_slices(&positions, &outer).unwrap()).unwrap();
        let first = positions.len() as u32;
        positions.extend(inner);
        let turned = |faces: &[[u32; 3]], turn: bool| -> Vec<[u32; 3]> {
            faces.iter().map(|&[a, b, c]| if turn { [a, c, b] } else { [a, b, c] }).collect()
        };
        let cavity: Vec<[u32; 3]> = cavity.iter().map(|face| face.map(|v| v + first)).collect();
        for turns in [[false, true], [true, false], [false, false], [true, true]] {
            let faces = [turned(&outer, turns[0]), turned(&cavity, turns[1])].concat();
            let cut = Segmenter::new().run(&Mesh::from_slices(&positions, &faces).unwrap()).unwrap();
            let enclosed = cut.report().decision.as_ref().unwrap().enclosed;
            if turns[0] == turns[1] {
                assert!(enclosed.walls < 0.05, "{turns:?}: {enclosed:?}");
                continue;
            }
            assert!(enclosed.walls > 0.3 && enclosed.bodies == 0., "{turns:?}: {enclosed:?}");
            let (labels, n) = (cut.labels(), outer.len());
            let same = (0..n).filter(|&face| labels[face] == solid.labels()[face]).count();
            let followed = (0..n).filter(|&face| labels[face] == labels[n + face]).count();
            assert!(same * 100 > n * 95 && followed * 100 > n * 90, "{turns:?}: {same} and {followed} of {n}");
        }
    }
}
