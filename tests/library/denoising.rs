//! Rough meshes and the stairs of voxels: parts are decided on a denoised surface, and labels are those of the faces.

use nystrom_stream::apps::creature::{Creature, Options};
use nystrom_stream::apps::evaluate::compare;
use nystrom_stream::store::Run;
use nystrom_stream::{Mesh, SaveOptions, Segmenter};
use std::collections::HashMap;

/// 1 − Rand index of two labellings.
fn apart(a: &[u32], b: &[u32]) -> f64 {
    compare(None, a, b).unwrap().rand
}

/// Solid voxels: two balls of radius 9 at the ends of a rod of radius 3.
fn is_solid([x, y, z]: [i32; 3]) -> bool {
    let square = |x: i32| f64::from(x * x) + 0.5;
    let ball = |at: i32| square(x - at) + square(y) + square(z) < 81.;
    ball(-21) || ball(21) || (x.abs() < 21 && square(y) + square(z) < 9.)
}

/// The squares around the solid voxels, and the body of each: a ball, the rod or the other ball.
fn dumbbell() -> (Mesh, Vec<u32>) {
    let (mut number, mut points, mut starts, mut corners) = (HashMap::new(), Vec::new(), vec![0], Vec::new());
    let mut body = Vec::new();
    let all = (-32..32).flat_map(|x| (-11..11).flat_map(move |y| (-11..11).map(move |z| [x, y, z])));
    for voxel in all.filter(|&voxel| is_solid(voxel)) {
        for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
            let mut beside = voxel;
            beside[axis] += 2 * side - 1;
            if is_solid(beside) {
                continue;
            }
            let ring = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[a, b]| {
                let mut corner = voxel;
                corner[axis] += side;
                corner[(axis + 1) % 3] += a;
                corner[(axis + 2) % 3] += b;
                *number.entry(corner).or_insert_with(|| {
                    points.push(corner.map(f64::from));
                    points.len() as u32 - 1
                })
            });
            corners.extend(if side == 1 { ring } else { [ring[3], ring[2], ring[1], ring[0]] });
            starts.push(corners.len() as u64);
            body.push(if voxel[0].abs() < 13 { 1 } else { 1 + voxel[0].signum() } as u32);
        }
    }
    (Mesh::from_polygons(points, starts, corners).unwrap(), body)
}

#[test]
fn a_dumbbell_of_voxels_has_three_parts() {
    let (mesh, body) = dumbbell();
    let found = Segmenter::new().run(&mesh).unwrap();
    assert_eq!(found.parts(), 3);
    let error = apart(found.labels(), &body);
    let own = apart(Segmenter::new().exact(true).run(&mesh).unwrap().labels(), &body);
    assert!(error < 0.01 && own > 0.02, "{error} {own}");
}

/// A creature with noise of 60 % of an edge has nearly the parts of the clean one, decided on the proxy, whose folder a
/// work directory keeps. Faces are split along straightened boundaries, as on other meshes.
#[test]
fn parts_are_decided_on_the_denoised_surface_and_written_on_that_of_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let made = |noise: f64| {
        let path = dir.path().join(format!("{noise}.ply"));
        let options = Options { faces: 12_000, noise, ..Options::default() };
        Creature::new(&options).unwrap().write_ply(&path, &Run::new(&())).unwrap();
        Mesh::open(&path).unwrap()
    };
    let (clean, noisy) = (made(0.), made(0.6));
    let proxy_of = |mesh: &Mesh, name: &str| {
        let cut = Segmenter::new().work_dir(dir.path().join(name)).run(mesh).unwrap();
        assert_eq!(cut.labels(), Segmenter::new().run(mesh).unwrap().labels());
        (cut, dir.path().join(name).join("proxy").exists())
    };
    let [(expected, none), (found, denoised)] =
        [(&clean, "clean"), (&noisy, "noisy")].map(|(m, name)| proxy_of(m, name));
    assert!(!none && denoised);
    let error = apart(found.labels(), expected.labels());
    assert!(error < 0.02, "{error}");
    assert!(found.labelling().fine.is_none());
    let path = dir.path().join("split.ply");
    found.save_with(&path, &SaveOptions::new().split_faces(true)).unwrap();
    assert!(Mesh::open(&path).unwrap().faces.len() > noisy.faces.len());
}
