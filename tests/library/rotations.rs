//! Surfaces that rotations map onto themselves are cut alike all around.

use nystrom_stream::{Mesh, Segmenter};
use std::collections::BTreeSet;

const TEETH: usize = 16;
/// Points around the gear for each tooth: two at its flanks, two at its corners.
const AROUND: usize = 4;

/// A gear without a hub, in long triangles. Also the tooth of each face, from 1; 0 for the disc.
fn gear() -> (Mesh, Vec<u32>) {
    let n = TEETH * AROUND;
    let angle =
        |k: usize| std::f64::consts::TAU * (k / AROUND) as f64 / TEETH as f64 + [0.0, 0.04, 0.12, 0.16][k % AROUND];
    let at = |k: usize, radius: f64, height: f64| [radius * angle(k).cos(), radius * angle(k).sin(), height];
    let is_out = |k: usize| (1..3).contains(&(k % AROUND));
    // For each height the root circle, the outline, and the hole.
    let mut points = Vec::new();
    for height in [0.0, 0.25] {
        points.extend((0..n).map(|k| at(k, 0.8, height)));
        points.extend((0..n).map(|k| at(k, if is_out(k) { 1.0 } else { 0.8 }, height)));
        points.extend((0..n).map(|k| at(k, 0.15, height)));
    }
    let [root, outline, hole] = [0, 1, 2].map(|ring| move |k: usize| (ring * n + k % n) as u32);
    let up = |k: u32| k + 3 * n as u32;
    let (mut faces, mut of_face) = (Vec::new(), Vec::new());
    let mut quad = |[a, b, c, d]: [u32; 4], tooth: u32| {
        for face in [[a, b, c], [a, c, d]] {
            faces.push(face);
            of_face.push(tooth);
        }
    };
    // Points of the outline on the root circle are those of the root circle.
    let rim = |k: usize| if is_out(k % n) { outline(k) } else { root(k) };
    for k in 0..n {
        let tooth = if k % AROUND == AROUND - 1 { 0 } else { (k / AROUND) as u32 + 1 };
        quad([hole(k + 1), hole(k), root(k), root(k + 1)], 0);
        quad([up(hole(k)), up(hole(k + 1)), up(root(k + 1)), up(root(k))], 0);
        quad([hole(k), hole(k + 1), up(hole(k + 1)), up(hole(k))], 0);
        quad([rim(k + 1), rim(k), up(rim(k)), up(rim(k + 1))], tooth);
        if tooth > 0 {
            quad([root(k + 1), root(k), rim(k), rim(k + 1)], tooth);
            quad([up(root(k)), up(root(k + 1)), up(rim(k + 1)), up(rim(k))], tooth);
        }
    }
    // Without the triangles that repeat a vertex, at the flanks.
    let kept = |face: &[u32; 3]| face[0] != face[1] && face[1] != face[2] && face[2] != face[0];
    let of_face = of_face.into_iter().zip(&faces).filter(|(_, face)| kept(face)).map(|(tooth, _)| tooth).collect();
    faces.retain(kept);
    (Mesh::from_vecs(points, faces).unwrap(), of_face)
}

/// Regression: of 16 teeth half were parts, and the disc was cut into sectors.
#[test]
fn all_teeth_of_a_gear_are_parts_or_none() {
    let (mesh, tooth) = gear();
    for seed in 0..3 {
        let found = Segmenter::new().seed(seed).run(&mesh).unwrap();
        let labels_of = |k: u32| -> BTreeSet<u32> {
            (0..tooth.len()).filter(|&face| tooth[face] == k).map(|face| found.labels()[face]).collect()
        };
        let disc = labels_of(0);
        assert_eq!(disc.len(), 1, "seed {seed}: {disc:?}");
        let own = (1..=TEETH as u32).filter(|&k| labels_of(k).is_disjoint(&disc)).count();
        assert!([0, TEETH].contains(&own), "seed {seed}: {own} teeth of {TEETH} are parts");
        assert!([1, 1 + TEETH].contains(&found.parts()), "seed {seed}: {} parts", found.parts());
    }
}
