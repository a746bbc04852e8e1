//! Bodies with an inside: a hollow shape is cut like the solid one, and its walls follow.

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

/// Triangles of a surface of revolution about x through `profile`: (x, radius), from a closed end to an open or a closed one. Normals point to the left of
/// the profile, away from the axis where x grows.
fn revolved(profile: &[[f64; 2]]) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let mut positions = Vec::new();
    for [x, radius] in profile {
        for side in 0..SIDES {
            let angle = std::f64::consts::TAU * f64::from(side) / f64::from(SIDES);
            positions.push([*x, radius * angle.cos(), 0.9 * radius * angle.sin()]);
        }
    }
    let at = |ring: u32, side: u32| ring * SIDES + side % SIDES;
    let mut faces = Vec::new();
    for ring in 0..profile.len() as u32 - 1 {
        for side in 0..SIDES {
            faces.push([at(ring, side), at(ring, side + 1), at(ring + 1, side + 1)]);
            faces.push([at(ring, side), at(ring + 1, side + 1), at(ring + 1, side)]);
        }
    }
    // The closed ends: vertices of their own, which lie on the axis.
    let mut close = |ring: u32, turned: bool| {
        let pole = positions.len() as u32;
        positions.push([profile[ring as usize][0], 0., 0.]);
        for side in 0..SIDES {
            let [a, b] = [at(ring, side), at(ring, side + 1)];
            faces.push(if turned { [pole, a, b] } else { [pole, b, a] });
        }
    };
    close(0, false);
    close(profile.len() as u32 - 1, true);
    (positions, faces)
}

/// x of ring `ring` of the outside, which ends before 1: there is the hole.
fn along(ring: u32) -> f64 {
    -0.99 + 1.97 * f64::from(ring) / f64::from(RINGS - 1)
}

#[test]
fn a_hollow_dumbbell_is_cut_like_a_solid_one_and_its_inside_follows() {
    let outside: Vec<[f64; 2]> = (0..RINGS).map(|ring| [along(ring), dumbbell(along(ring))]).collect();
    let (positions, faces) = revolved(&outside);
    let solid = Segmenter::new().run(&Mesh::from_slices(&positions, &faces).unwrap()).unwrap();
    assert!(solid.report().inside().is_none());
    // The wall has the same rings, the other way round, .04 further in; the hole is as wide as the bar.
    let wall = outside.iter().rev().map(|[x, radius]| [0.96 * x, (radius - 0.04).max(0.05)]);
    let whole: Vec<[f64; 2]> = outside.iter().copied().chain(wall).collect();
    let (positions, faces) = revolved(&whole);
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
    let right = |face: u32| {
        let (whole, apart) = (hollow.labels()[face as usize], apart.labels()[face as usize]);
        apart == if face < outer { whole } else { own }
    };
    let right = (0..2 * outer).filter(|&face| right(face)).count() as u32;
    assert!(right * 100 > 2 * outer * 95, "{right} of {}", 2 * outer);
    let solid = Segmenter::new().walls(Walls::Own).run(&Mesh::creature(3_000).unwrap()).unwrap();
    assert!(solid.report().walls_label.is_none());
}
