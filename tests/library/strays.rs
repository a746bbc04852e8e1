//! Stray vertices: however far one vertex or ten lie outside, the results are those of the mesh with these vertices
//! amid their neighbours, byte for byte.

use super::common;
use nystrom_stream::apps::measure;
use nystrom_stream::pipeline::{Cluster, TinyComponents};
use nystrom_stream::store::{Context, Run, WorkDir};
use nystrom_stream::{LabelTransfer, Mesh, Segmenter, Sequencer};
use std::collections::BTreeSet;

type Arrays = (Vec<[f64; 3]>, Vec<[u32; 3]>);

/// `count` vertices, no two of them with a common neighbour.
fn apart((points, faces): &Arrays, count: usize) -> Vec<u32> {
    let mut taken: BTreeSet<u32> = BTreeSet::new();
    let mut chosen = Vec::new();
    for k in 0.. {
        let v = (977 * (k + 1) % points.len()) as u32;
        let ring: BTreeSet<u32> = faces.iter().filter(|face| face.contains(&v)).flatten().copied().collect();
        if !ring.is_empty() && ring.iter().all(|w| !taken.contains(w)) {
            taken.extend(ring);
            chosen.push(v);
        }
        if chosen.len() == count {
            break;
        }
    }
    chosen
}

/// The mesh with `vertices` at `distance` diagonals from its middle, each in a direction of its own.
fn with_strays((points, faces): &Arrays, vertices: &[u32], distance: f64) -> Mesh {
    let bound = |axis: usize, pick: fn(f64, f64) -> f64| points.iter().map(|p| p[axis]).reduce(pick).unwrap();
    let box_of = [0, 1, 2].map(|axis| (bound(axis, f64::min), bound(axis, f64::max)));
    let diagonal = box_of.iter().map(|(low, high)| (high - low).powi(2)).sum::<f64>().sqrt();
    let mut points = points.clone();
    for (k, &v) in vertices.iter().enumerate() {
        let (turn, rise) = (2.4 * k as f64, (k as f64 + 0.5) / vertices.len() as f64 * 2. - 1.);
        let flat = (1. - rise * rise).sqrt();
        let direction = [flat * turn.cos(), flat * turn.sin(), rise];
        points[v as usize] =
            [0, 1, 2].map(|axis| (box_of[axis].0 + box_of[axis].1) / 2. + distance * diagonal * direction[axis]);
    }
    Mesh::from_vecs(points, faces.clone()).unwrap()
}

/// The mesh with `vertices` at the mean of their neighbours.
fn amid((points, faces): &Arrays, vertices: &[u32]) -> Mesh {
    let mut points = points.clone();
    for &v in vertices {
        let beside: BTreeSet<u32> =
            faces.iter().filter(|face| face.contains(&v)).flatten().copied().filter(|&w| w != v).collect();
        let sum = beside.iter().fold([0.; 3], |sum, &w| [0, 1, 2].map(|axis| sum[axis] + points[w as usize][axis]));
        points[v as usize] = sum.map(|x| x / beside.len() as f64);
    }
    Mesh::from_vecs(points, faces.clone()).unwrap()
}

fn same_at_any_distance(mesh: &Arrays, segmenter: &Segmenter, name: &str) {
    for count in [1, 10] {
        let vertices = apart(mesh, count);
        let expected = segmenter.run(&amid(mesh, &vertices)).unwrap();
        assert_eq!(expected.report().input.stray_vertices, 0);
        for distance in [10., 100., 1e4, 1e10, 1e30].into_iter().step_by(common::stride(4)) {
            let found = segmenter.run(&with_strays(mesh, &vertices, distance)).unwrap();
            assert_eq!(found.report().input.stray_vertices, count as u64, "{name}, {count} at {distance}");
            assert!(found.labels() == expected.labels(), "{name}: {count} vertices {distance} diagonals away");
        }
    }
}

#[test]
fn labels_do_not_depend_on_where_strays_are() {
    let mesh = common::arrays(&Mesh::creature(12_700).unwrap());
    same_at_any_distance(&mesh, &Segmenter::new(), "default");
    same_at_any_distance(&mesh, &Segmenter::new().method(Cluster::KMeans).parts(6), "K-means");
}

#[test]
fn contracted_and_sorted_meshes_neither() {
    let mesh = common::arrays(&Mesh::creature(64_000).unwrap());
    let sorted = Segmenter::new().order(nystrom_stream::graph::Order::Hilbert);
    same_at_any_distance(&mesh, &sorted, "contracted");
}

#[test]
fn orders_neither() {
    let mesh = common::arrays(&Mesh::creature(12_700).unwrap());
    let vertices = apart(&mesh, 10);
    let expected = Sequencer::new().run(&amid(&mesh, &vertices)).unwrap();
    for distance in [10., 1e4, 1e30] {
        let found = Sequencer::new().run(&with_strays(&mesh, &vertices, distance)).unwrap();
        assert!(found.places() == expected.places(), "{distance}");
    }
}

#[test]
fn models_and_scans_neither() {
    let Some(data) = common::data() else { return };
    for name in ["psb/126.ply", "real/horse_paper_39698.ply"].into_iter().step_by(common::stride(2)) {
        let mesh = common::arrays(&Mesh::open(data.join(name)).unwrap());
        same_at_any_distance(&mesh, &Segmenter::new(), name);
    }
}

#[test]
fn outputs_keep_the_positions_of_the_file() {
    let mesh = common::arrays(&Mesh::creature(4_000).unwrap());
    let strays = with_strays(&mesh, &apart(&mesh, 2), 1e6);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("labelled.ply");
    Segmenter::new().run(&strays).unwrap().save(&path).unwrap();
    let again = Mesh::open(&path).unwrap();
    assert!((0..strays.positions.len() as u32).all(|v| again.positions.get(v) == strays.positions.get(v)));
    assert_eq!(again.without_strays(&Run::new(&())).unwrap().strays(), 2);
}

/// Regression: to move strays a second time put them back where they were, and meshes that a caller had passed through
/// [`Mesh::without_strays`] were cut with their strays.
#[test]
fn strays_that_were_moved_stay_where_they_are() {
    let mesh = common::arrays(&Mesh::creature(4_000).unwrap());
    let mesh = with_strays(&mesh, &apart(&mesh, 2), 1e6);
    let run = Run::new(&());
    let once = mesh.without_strays(&run).unwrap();
    let twice = once.without_strays(&run).unwrap();
    assert_eq!((once.strays(), twice.strays()), (2, 2));
    assert!((0..mesh.positions.len() as u32).all(|v| twice.positions.get(v) == once.positions.get(v)));
    let labels = |mesh: &Mesh| Segmenter::new().run(mesh).unwrap().labels().to_vec();
    assert!(labels(&once) == labels(&mesh));
}

/// A tenth of the vertices at the origin, and of no face, while the mesh lies where a survey puts it: the box held both,
/// the mesh was a speck in it and was left whole, its volume was a quarter, and labels came from wrong faces.
#[test]
fn vertices_of_no_face_change_nothing() {
    let (points, faces) = common::arrays(&Mesh::creature(6_000).unwrap());
    let points: Vec<[f64; 3]> = points.iter().map(|p| [p[0] + 5e5, p[1] + 5e6, p[2] + 100.]).collect();
    let crowd = [points.clone(), vec![[0.; 3]; points.len() / 10]].concat();
    let mut far = crowd.clone();
    far[7] = [1e9; 3];
    let [plain, crowd, far] = [points, crowd, far].map(|points| Mesh::from_vecs(points, faces.clone()).unwrap());
    let labels = |mesh: &Mesh| Segmenter::new().run(mesh).unwrap().labels().to_vec();
    let expected = labels(&plain);
    assert!(expected.iter().max() > Some(&4));
    assert!(labels(&crowd) == expected);
    assert_eq!(far.without_strays(&Run::new(&())).unwrap().strays(), 1, "strays are found among them");
    let carried = LabelTransfer::new().run(&plain, &expected, &crowd).unwrap();
    assert!(carried.labels[..] == expected[..]);
    let (dir, run) = (tempfile::tempdir().unwrap(), Run::new(&()));
    let volume = |mesh: &Mesh| {
        let work = WorkDir::temporary(dir.path()).unwrap();
        measure::mesh(mesh, Context::new(&work, &run)).unwrap().all.volume.unwrap()
    };
    assert_eq!(volume(&plain), volume(&crowd));
}

/// Three beads on a string, of 1,152 faces.
fn beads() -> Arrays {
    let (rings, around) = (37, 16);
    let place = |k: u32, j: u32| {
        let (along, turn) =
            (f64::from(k) / f64::from(rings - 1), f64::from(j) / f64::from(around) * std::f64::consts::TAU);
        let radius = 0.1 + 0.4 * (3. * std::f64::consts::PI * along).sin().abs();
        [3. * along, radius * turn.cos(), radius * turn.sin()]
    };
    let points = (0..rings).flat_map(|k| (0..around).map(move |j| place(k, j))).collect();
    let quad = |k: u32, j: u32| {
        let next = (j + 1) % around;
        let [a, b, c, d] = [k * around + j, k * around + next, (k + 1) * around + next, (k + 1) * around + j];
        [[a, b, c], [a, c, d]]
    };
    (points, (0..rings - 1).flat_map(|k| (0..around).flat_map(move |j| quad(k, j))).collect())
}

/// Small meshes are their own cells, and specks beside one were, too: with two parts the second was a speck.
#[test]
fn a_number_of_parts_of_a_small_mesh_is_not_made_up_by_specks() {
    let (mut points, mut faces) = beads();
    let expected = Segmenter::new().parts(3).run(&Mesh::from_slices(&points, &faces).unwrap()).unwrap();
    let n = points.len() as u32;
    assert!(faces.len() < 2_000);
    points.extend([[3., 0., 0.], [3., 0., 1e-4], [3., 1e-4, 0.]]);
    faces.extend([[5, 5, 5], [n, n + 1, n + 2]]);
    let mesh = Mesh::from_vecs(points, faces).unwrap();
    for (tiny, all) in [(TinyComponents::Join, 3), (TinyComponents::Own, 4)] {
        let cut = Segmenter::new().parts(3).tiny_components(tiny).run(&mesh).unwrap();
        let real = &cut.labels()[..expected.labels().len()];
        assert!(real == expected.labels());
        assert_eq!((cut.parts(), real.iter().max()), (all, Some(&2)));
        let specks = &cut.labels()[real.len()..];
        assert!(specks.iter().all(|&label| (label == 3) == (all == 4)), "{specks:?}");
    }
}
