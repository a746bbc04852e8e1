//! Labels carried to other meshes of the same shape: exact against a slow search, right on
//! known parts, bounded, steady.

use crate::common;
use nystrom_stream::apps::creature::{Creature, Options};
use nystrom_stream::apps::transfer::closest_faces::{
    Agreement, Probe, TriangleTree, UnitFrame, distance_2, normal, unit, unpack, window,
};
use nystrom_stream::apps::transfer::transfer;
use nystrom_stream::base::Error;
use nystrom_stream::mesh::{self, Mesh, UNLABELLED};
use nystrom_stream::store::Context;
use nystrom_stream::store::{Budget, Run, WorkDir};
use std::path::Path;

fn run() -> Run<'static> {
    Run { threads: 2, ..Run::new(&()) }
}

fn open(path: &Path, scratch: &Path) -> Mesh {
    mesh::open(path, scratch, &run()).unwrap()
}

/// The parts of the creature that [`common::creature`] writes.
fn truth(faces: u64, shuffle: bool) -> Vec<u32> {
    let creature = Creature::new(&Options { faces, shuffle, ..Options::default() }).unwrap();
    (0..creature.face_count()).map(|face| creature.truth(face)).collect()
}

fn agreement(a: &[u32], b: &[u32]) -> f64 {
    a.iter().zip(b).filter(|(a, b)| a == b).count() as f64 / a.len() as f64
}

/// A labelling by place that no mesh shows: eight boxes around the middle.
fn octants(mesh: &Mesh) -> Vec<u32> {
    let mut labels = Vec::new();
    mesh.faces.for_each(0..mesh.faces.len(), |_, corners| {
        let mut sum = [0.; 3];
        for &v in corners {
            let p = mesh.positions.get(v);
            (0..3).for_each(|k| sum[k] += p[k]);
        }
        labels.push((0..3).map(|k| u32::from(sum[k] > 0.) << k).sum());
    });
    labels
}

#[test]
fn the_tree_finds_what_a_look_at_every_face_finds() {
    let dir = tempfile::tempdir().unwrap();
    let (fine, coarse) = (common::creature(dir.path(), 3_000, false), common::creature(dir.path(), 1_000, false));
    let (from, to) = (open(&fine, dir.path()), open(&coarse, dir.path()));
    let frame = UnitFrame::of(&from, &run()).unwrap();
    let mut triangles = Vec::new();
    frame.triangles(&from, 0..from.faces.len(), |face, triangle| triangles.push((face, triangle)));
    let mut probes = Vec::new();
    frame.triangles(&to, 0..to.faces.len(), |_, t| {
        let place = [0, 1, 2].map(|k| (t[0][k] + t[1][k] + t[2][k]) / 3.);
        probes.push(Probe { place, normal: unit(normal(&t)) });
    });
    let slack = 0.02;
    for block in [from.faces.len(), 700] {
        let mut found = vec![[u64::MAX; 2]; probes.len()];
        for start in (0..from.faces.len()).step_by(block) {
            let range = start..from.faces.len().min(start + block);
            let tree = TriangleTree::of(&from, &frame, std::iter::once(range));
            tree.improve_all(|i| probes[i], Agreement { sign: 1., slack, far: f32::INFINITY }, &mut found, &run())
                .unwrap();
        }
        for (probe, found) in probes.iter().zip(&found) {
            let all = triangles.iter().map(|(face, t)| (distance_2(t, probe.place), *face, unit(normal(t))));
            let least = |some: &mut dyn Iterator<Item = (f32, u32, [f32; 3])>| {
                some.map(|(d, face, _)| (d, face)).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
            };
            let nearest = least(&mut all.clone()).unwrap();
            assert_eq!(unpack(found[0]), Some(nearest));
            let agrees = |n: [f32; 3]| (0..3).map(|k| n[k] * probe.normal[k]).sum::<f32>() >= 0.5;
            let near = window(nearest.0.sqrt(), slack).powi(2);
            let agreeing = least(&mut all.filter(|(d, _, n)| *d <= near && agrees(*n)));
            assert_eq!(unpack(found[1]).filter(|(d, _)| *d <= near), agreeing);
        }
    }
}

#[test]
fn distances_to_a_triangle_are_those_to_its_nearest_point() {
    let triangle = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]];
    for (place, expected) in [
        ([0.25, 0.25, 2.], 4.),
        ([-1., 0.5, 0.], 1.),
        ([2., -1., 0.], 2.),
        ([1., 1., 0.], 0.5),
        ([-3., -4., 0.], 25.),
        ([0.5, 0.2, 0.], 0.),
    ] {
        assert!((distance_2(&triangle, place) - expected).abs() < 1e-6, "{place:?}");
    }
    assert_eq!(distance_2(&[[1.; 3]; 3], [1., 1., 3.]), 4.);
}

#[test]
fn a_mesh_gets_its_own_labels_back_and_another_resolution_nearly() {
    let dir = tempfile::tempdir().unwrap();
    let sizes = [3_000, 12_000, 50_000];
    let paths = sizes.map(|faces| common::creature(dir.path(), faces, faces == 12_000));
    let truths = sizes.map(|faces| truth(faces, faces == 12_000));
    for (a, from) in paths.iter().enumerate() {
        for (b, to) in paths.iter().enumerate() {
            let (work, scratch) = (WorkDir::temporary(dir.path()).unwrap(), tempfile::tempdir().unwrap());
            let (from, to) = (open(from, scratch.path()), open(to, work.path()));
            for (labels, wanted) in [(truths[a].clone(), truths[b].clone()), (octants(&from), octants(&to))] {
                let work = WorkDir::temporary(dir.path()).unwrap();
                let result = transfer(&from, &labels, &to, Context::new(&work, &run())).unwrap();
                let share = agreement(&result.labels, &wanted);
                let facts = result.facts;
                if a == b {
                    assert!(share == 1. && facts.uncertain == 0, "{a} {b} {share} {facts:?}");
                } else {
                    eprintln!("{sizes:?} {a} to {b}: {share:.4} {facts:?}");
                    assert!(share > 0.97, "{a} {b} {share} {facts:?}");
                    assert!((facts.uncertain as f64) < 0.15 * wanted.len() as f64, "{a} {b} {facts:?}");
                }
            }
        }
    }
}

/// Regression: sizes of labels were kept whatever the budget.
#[test]
fn what_many_labels_take_must_fit_the_budget() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = open(&common::creature(dir.path(), 50_000, false), dir.path());
    let labels: Vec<u32> = (0..mesh.faces.len() as u32).collect();
    let carried = |memory| {
        let run = Run { budget: Budget::new(memory), ..run() };
        let work = WorkDir::temporary(dir.path()).unwrap();
        transfer(&mesh, &labels, &mesh, Context::new(&work, &run)).map(|found| found.labels.to_vec())
    };
    let error = carried(1 << 20).unwrap_err();
    assert!(matches!(error, Error::Memory { .. }) && error.to_string().contains("so many labels"), "{error}");
    assert_eq!(carried(64 << 20).unwrap(), labels);
}

#[test]
fn threads_and_memory_change_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let (fine, coarse) = (common::creature(dir.path(), 20_000, false), common::creature(dir.path(), 9_000, true));
    let (from, to) = (open(&fine, dir.path()), open(&coarse, dir.path()));
    let labels = truth(20_000, false);
    let mut first: Option<(Vec<u32>, Vec<f32>)> = None;
    for (threads, memory) in [(2, 1 << 30), (1, 1 << 30), (2, 2 << 20)] {
        let run = Run { threads, budget: Budget::new(memory), ..Run::new(&()) };
        let work = WorkDir::temporary(dir.path()).unwrap();
        let result = transfer(&from, &labels, &to, Context::new(&work, &run)).unwrap();
        let now = (result.labels.to_vec(), result.quality.to_vec());
        assert!(*first.get_or_insert_with(|| now.clone()) == now, "{threads} {memory}");
    }
}

/// Two sheets close together, wound apart, each of `side`² squares; `turned` winds both the other way.
fn sheets(folder: &Path, side: u32, turned: bool) -> Mesh {
    let mut text = format!("OFF\n{} {} 0\n", 2 * (side + 1).pow(2), 4 * side * side);
    for sheet in 0..2 {
        for k in 0..(side + 1).pow(2) {
            let (x, y) = (k % (side + 1), k / (side + 1));
            text += &format!(
                "{} {} {}\n",
                f64::from(x) / f64::from(side),
                f64::from(y) / f64::from(side),
                0.001 * f64::from(sheet)
            );
        }
    }
    for sheet in 0..2 {
        for k in 0..side * side {
            let a = sheet * (side + 1).pow(2) + k / side * (side + 1) + k % side;
            let (b, c, d) = (a + 1, a + side + 2, a + side + 1);
            match (sheet == 0) != turned {
                true => text += &format!("3 {a} {c} {b}\n3 {a} {d} {c}\n"),
                false => text += &format!("3 {a} {b} {c}\n3 {a} {c} {d}\n"),
            }
        }
    }
    let path = folder.join(format!("sheets_{side}_{turned}.off"));
    std::fs::write(&path, text).unwrap();
    let scratch = folder.join(format!("scratch_{side}_{turned}"));
    std::fs::create_dir_all(&scratch).unwrap();
    open(&path, &scratch)
}

#[test]
fn thin_walls_keep_their_sides_even_wound_the_other_way() {
    let dir = tempfile::tempdir().unwrap();
    let from = sheets(dir.path(), 20, false);
    let labels: Vec<u32> = (0..1600).map(|face| face / 800).collect();
    for turned in [false, true] {
        let to = sheets(dir.path(), 33, turned);
        // Bent towards each other, so that the nearest face of all is often the wrong one.
        let work = WorkDir::temporary(dir.path()).unwrap();
        let result = transfer(&from, &labels, &to, Context::new(&work, &run())).unwrap();
        let half = result.labels.len() / 2;
        assert!(result.labels[..half].iter().all(|&label| label == 0), "{turned}");
        assert!(result.labels[half..].iter().all(|&label| label == 1), "{turned}");
        assert_eq!(result.facts.opposite_normals, turned);
    }
}

#[test]
fn unlabelled_faces_are_filled_in_and_strangers_refused() {
    let dir = tempfile::tempdir().unwrap();
    let from = sheets(dir.path(), 30, false);
    let mut labels: Vec<u32> = (0..3600).map(|face| 5 + face / 1800).collect();
    labels[100..200].fill(UNLABELLED);
    let to = sheets(dir.path(), 25, false);
    let work = WorkDir::temporary(dir.path()).unwrap();
    let result = transfer(&from, &labels, &to, Context::new(&work, &run())).unwrap();
    assert!(result.facts.filled > 20 && result.facts.uncertain >= result.facts.filled, "{:?}", result.facts);
    assert!(result.labels.iter().enumerate().all(|(face, &label)| label == 5 + u32::from(face >= 1250)));
    assert!(transfer(&from, &labels[1..], &to, Context::new(&work, &run())).is_err());

    let path = dir.path().join("far.off");
    std::fs::write(&path, "OFF\n3 1 0\n9 9 9\n9.1 9 9\n9 9.1 9\n3 0 1 2\n").unwrap();
    let far = open(&path, work.path());
    let message = transfer(&from, &labels, &far, Context::new(&work, &run())).unwrap_err().to_string();
    assert!(message.contains("same position and units") && !message.contains('\n'), "{message}");
}

/// Regression: faces near unlabelled ones counted as far away, so a mesh with few labels was blamed for its position.
#[test]
fn few_labels_are_enough() {
    let dir = tempfile::tempdir().unwrap();
    let from = sheets(dir.path(), 20, false);
    let mut labels = vec![UNLABELLED; 1600];
    labels[..100].fill(3);
    let work = WorkDir::temporary(dir.path()).unwrap();
    let result = transfer(&from, &labels, &from, Context::new(&work, &run())).unwrap();
    assert!(result.labels[..800].iter().all(|&label| label == 3));
}

/// Regression: the area of a sliver is a small difference of large products, which is lost in single precision.
#[test]
fn slivers_keep_their_labels() {
    let (n, width) = (4000u32, 1e-4);
    let points: Vec<[f64; 3]> = (0..2 * n + 2).map(|v| [f64::from(v % 2), width * f64::from(v / 2), 0.]).collect();
    let faces: Vec<[u32; 3]> =
        (0..n).flat_map(|k| [[2 * k, 2 * k + 1, 2 * k + 3], [2 * k, 2 * k + 3, 2 * k + 2]]).collect();
    let (mesh, labels) = (Mesh::from_slices(&points, &faces).unwrap(), (0..2 * n).collect::<Vec<u32>>());
    let dir = tempfile::tempdir().unwrap();
    let work = WorkDir::temporary(dir.path()).unwrap();
    let found = transfer(&mesh, &labels, &mesh, Context::new(&work, &run())).unwrap();
    let other = found.labels.iter().zip(&labels).filter(|(found, label)| found != label).count();
    assert_eq!(other, 0);
}

#[test]
fn doubtful_transfers_are_noted() {
    // Regression: onto a mesh in other units labels were carried without a word, if it was near enough.
    let sheet = |z: f32| {
        let points: Vec<[f32; 3]> = (0..100).map(|v| [(v % 10) as f32, (v / 10) as f32, z]).collect();
        let corner = (0..90).filter(|v| v % 10 < 9);
        let faces: Vec<[u32; 3]> = corner.flat_map(|v| [[v, v + 1, v + 10], [v + 1, v + 11, v + 10]]).collect();
        Mesh::from_slices(&points, &faces).unwrap()
    };
    let dir = tempfile::tempdir().unwrap();
    for (z, noted) in [(0.1, false), (4., true)] {
        let work = WorkDir::temporary(dir.path()).unwrap();
        let found = transfer(&sheet(0.), &[3; 162], &sheet(z), Context::new(&work, &run())).unwrap();
        let note = found.facts.note("scan.ply".as_ref());
        let is_told = |note: &str| note.starts_with("scan.ply: the labels of 100 % of the faces are uncertain");
        assert_eq!(note.as_deref().map(is_told), noted.then_some(true), "{note:?}");
    }
}

#[test]
fn the_command_carries_labels_from_file_to_file() {
    let dir = tempfile::tempdir().unwrap();
    let (fine, coarse) = (common::creature(dir.path(), 24_000, false), common::creature(dir.path(), 1_000, false));
    let (labelled, seg) = (dir.path().join("fine.ply"), dir.path().join("fine.seg"));
    common::segment(&fine, &["-q", "-k", "4", "-o", common::word(&labelled), "-o", common::word(&seg)]);
    let out = ["a.seg", "b.seg"].map(|name| dir.path().join(name));
    let [coarse, fine, labelled, seg, a, b] =
        [&coarse, &fine, &labelled, &seg, &out[0], &out[1]].map(|p| common::word(p));
    let first = common::run(&["transfer-labels", labelled, coarse, "-o", a, "--json"]);
    assert!(first.status.success(), "{}", common::errors(&first));
    let report: serde_json::Value = serde_json::from_slice(&first.stdout).unwrap();
    assert!(report["uncertain_share"].as_f64().unwrap() < 0.2 && report["transfer"]["points"] == 4, "{report}");
    assert!(common::run(&["transfer-labels", fine, coarse, "--labels", seg, "-o", b, "-q"]).status.success());
    assert_eq!(std::fs::read(&out[0]).unwrap(), std::fs::read(&out[1]).unwrap());
    let refused = common::run(&["transfer-labels", fine, coarse, "-o", a]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(common::errors(&refused).contains("no face property `label`"));
}
