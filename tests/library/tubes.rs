//! Tubes are not cut at arbitrary places.

use nystrom_stream::{Mesh, Segmenter};

/// Points around the tube.
const AROUND: usize = 16;
const LENGTH: usize = 400;

type Arrays = (Vec<[f64; 3]>, Vec<[u32; 3]>);

/// A place on a helix, and two directions at right angles to it: outward and up.
type Place = [[f64; 3]; 3];

/// The place of a helix of radius 1 at this angle.
fn helix(pitch: f64, angle: f64) -> Place {
    let norm = 1f64.hypot(pitch);
    let (sin, cos) = angle.sin_cos();
    [[cos, sin, pitch * angle], [cos, sin, 0.], [pitch * sin / norm, -pitch * cos / norm, 1. / norm]]
}

/// A closed tube through these places, of the given radius at each.
fn tube(places: &[(Place, f64)], mesh: &mut Arrays) {
    let (positions, faces) = mesh;
    let first = positions.len();
    for ([centre, out, up], radius) in places {
        for j in 0..AROUND {
            let (b, a) = (std::f64::consts::TAU * j as f64 / AROUND as f64).sin_cos();
            positions.push([0, 1, 2].map(|axis| centre[axis] + radius * (a * out[axis] + b * up[axis])));
        }
    }
    close(first, places.len(), faces);
}

/// A closed tube around a helix of 30 radians, of the given radius along it, at `x`.
fn spring(x: f64, radius: impl Fn(f64) -> f64, mesh: &mut Arrays) {
    let place = |k: usize| {
        let share = k as f64 / (LENGTH - 1) as f64;
        let [centre, out, up] = helix(0.1, 30. * share);
        ([[x + centre[0], centre[1], centre[2]], out, up], radius(share))
    };
    tube(&(0..LENGTH).map(place).collect::<Vec<_>>(), mesh);
}

/// The faces of a tube of `rings` rings whose points begin with `first`.
fn close(first: usize, rings: usize, faces: &mut Vec<[u32; 3]>) {
    let at = |k: usize, j: usize| (first + k * AROUND + j % AROUND) as u32;
    for (k, j) in (1..rings).flat_map(|k| (0..AROUND).map(move |j| (k, j))) {
        faces.push([at(k - 1, j), at(k, j), at(k, j + 1)]);
        faces.push([at(k - 1, j), at(k, j + 1), at(k - 1, j + 1)]);
    }
    for j in 1..AROUND - 1 {
        faces.push([at(0, 0), at(0, j), at(0, j + 1)]);
        faces.push([at(rings - 1, 0), at(rings - 1, j + 1), at(rings - 1, j)]);
    }
}

/// Regression: a spring had 13 parts, other ones under each seed.
#[test]
fn a_spring_is_left_whole_and_can_be_cut_on_request() {
    let mut mesh = (Vec::new(), Vec::new());
    spring(0., |_| 0.12, &mut mesh);
    let mesh = Mesh::from_vecs(mesh.0, mesh.1).unwrap();
    for seed in 0..2 {
        assert_eq!(Segmenter::new().seed(seed).run(&mesh).unwrap().parts(), 1, "seed {seed}");
    }
    assert_eq!(Segmenter::new().parts(4).run(&mesh).unwrap().parts(), 4);
}

#[test]
fn each_of_two_springs_is_left_whole() {
    let mut mesh = (Vec::new(), Vec::new());
    spring(0., |_| 0.12, &mut mesh);
    spring(4., |_| 0.12, &mut mesh);
    let one = mesh.1.len() / 2;
    let mesh = Mesh::from_vecs(mesh.0, mesh.1).unwrap();
    let found = Segmenter::new().run(&mesh).unwrap();
    assert_eq!(found.parts(), 2);
    assert!(found.labels()[..one].iter().all(|&label| label == found.labels()[0]));
    assert_ne!(found.labels()[0], found.labels()[one]);
}

#[test]
fn the_thick_ends_of_a_spring_are_parts() {
    let thick = |share: f64| if (0.06..0.94).contains(&share) { 0.1 } else { 0.3 };
    let mut mesh = (Vec::new(), Vec::new());
    spring(0., thick, &mut mesh);
    let faces = mesh.1.len();
    let mesh = Mesh::from_vecs(mesh.0, mesh.1).unwrap();
    let found = Segmenter::new().run(&mesh).unwrap();
    let of = |share: f64| found.labels()[(share * faces as f64) as usize];
    // Regression: its wire had up to ten parts.
    assert_eq!(found.parts(), 3);
    assert!(of(0.03) != of(0.5) && of(0.97) != of(0.5) && of(0.03) != of(0.97));
}

/// Regression: the rod is long, and what is uncertain within it hid what the cut explains.
#[test]
fn the_head_of_a_match_is_a_part() {
    let (mut positions, mut faces) = (Vec::new(), Vec::new());
    let (length, radius) = (6., 0.32);
    for k in 0..LENGTH {
        let z = length * k as f64 / (LENGTH - 1) as f64;
        let off = (z - length + radius) / radius;
        let r = f64::max(if off > 0. { 1e-4 } else { 0.2 }, radius * (1. - off * off).max(0.).sqrt());
        positions.extend((0..AROUND).map(|j| {
            let (sin, cos) = (std::f64::consts::TAU * j as f64 / AROUND as f64).sin_cos();
            [r * cos, r * sin, z]
        }));
    }
    close(0, LENGTH, &mut faces);
    let head = faces.len() - 1 - AROUND;
    let mesh = Mesh::from_vecs(positions, faces).unwrap();
    for seed in 0..2 {
        let found = Segmenter::new().seed(seed).run(&mesh).unwrap();
        assert_eq!(found.parts(), 2, "seed {seed}");
        assert_ne!(found.labels()[head], found.labels()[0]);
    }
}

/// Regression: a rippled grip had 5 to 7 parts, other ones under each seed.
#[test]
fn a_grip_is_not_cut_at_its_ripples_and_beads_are_parts() {
    let lathe = |radius: &dyn Fn(f64) -> f64| {
        let mut mesh = (Vec::new(), Vec::new());
        for k in 0..LENGTH {
            let share = k as f64 / (LENGTH - 1) as f64;
            for j in 0..AROUND {
                let (y, x) = (std::f64::consts::TAU * j as f64 / AROUND as f64).sin_cos();
                mesh.0.push([radius(share) * x, radius(share) * y, 8. * share]);
            }
        }
        close(0, LENGTH, &mut mesh.1);
        Mesh::from_vecs(mesh.0, mesh.1).unwrap()
    };
    let ripples = |share: f64| 0.5 + 0.05 * (20. * std::f64::consts::PI * share).sin();
    let grip = lathe(&|share| if share < 0.35 { 0.18 } else { ripples(share) });
    let beads = lathe(&|share| 0.0225_f64.max(0.25 - ((8. * share).fract() - 0.5).powi(2)).sqrt());
    for seed in 0..2 {
        let parts = Segmenter::new().seed(seed).run(&grip).unwrap().parts();
        assert!((2..=3).contains(&parts), "{parts} parts, seed {seed}");
        assert_eq!(Segmenter::new().seed(seed).run(&beads).unwrap().parts(), 8, "seed {seed}");
    }
}

/// Regression: the thin tail of a coiled body was in one part with the last turn, in whose line it lies.
#[test]
fn the_thin_tail_of_a_coil_is_a_part() {
    let (turn, taper, tail, step) = (40., 1., 2., 0.07);
    let pitch = 0.1;
    let length = turn * 1f64.hypot(pitch);
    let smooth = |t: f64| t * t * (3. - 2. * t);
    let rings = ((length + tail) / step) as usize;
    let place = |k: usize| {
        let s = k as f64 * step;
        let radius = 0.2 - 0.17 * smooth(((s - length + taper) / taper).clamp(0., 1.));
        let [mut centre, out, up] = helix(pitch, s.min(length) / 1f64.hypot(pitch));
        // Straight on from where the helix ends: along the cross product of up and out.
        let ahead = [1, 2, 0].map(|i| up[i] * out[(i + 1) % 3] - up[(i + 1) % 3] * out[i]);
        (0..3).for_each(|axis| centre[axis] += ahead[axis] * (s - length).max(0.));
        ([centre, out, up], radius)
    };
    let mut mesh = (Vec::new(), Vec::new());
    tube(&(0..rings).map(place).collect::<Vec<_>>(), &mut mesh);
    let mesh = Mesh::from_vecs(mesh.0, mesh.1).unwrap();
    let ring = |face: usize| face / (2 * AROUND);
    let first = (length / step) as usize;
    for seed in 0..2 {
        let found = Segmenter::new().seed(seed).run(&mesh).unwrap();
        let labels = &found.labels()[..2 * AROUND * (rings - 1)];
        let of_tail = *labels.last().unwrap();
        let begins = labels.iter().position(|&label| label == of_tail).map_or(0, ring);
        let tapers = first - (taper / step) as usize..=first;
        assert!(tapers.contains(&begins), "the tail begins at ring {begins}, not in {tapers:?}, seed {seed}");
        let mut beyond = labels[2 * AROUND * (first + 1)..].iter();
        assert!(beyond.all(|&label| label == of_tail), "the tail is cut, seed {seed}");
    }
}
