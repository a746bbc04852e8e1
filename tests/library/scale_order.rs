//! Reordering along the curve: the same graph under other numbers, the same labels, in any budget.

use crate::common::{creature, data, every_case};
use nystrom_stream::apps::evaluate::{contingency, rand};
use nystrom_stream::base::random::{below, stream};
use nystrom_stream::cluster::parts::{PartCount, PartsParams};
use nystrom_stream::graph::{DualGraph, Order, OrderParams, Ordered};
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::mesh::{self, Mesh};
use nystrom_stream::pipeline::{Cluster, SegmentParams, SegmentedMesh, segment};
use nystrom_stream::store::{Budget, Context, Run, WorkDir};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;

const HILBERT: OrderParams = OrderParams { order: Order::Hilbert, has_rows: true };

fn quiet(budget: u64) -> Run<'static> {
    Run { threads: 3, budget: Budget::new(budget), ..Run::new(&()) }
}

/// Edges of a graph between faces of the file, with their step and edge lengths.
fn edges(mesh: &Mesh, order: Order, run: &Run, folder: &Path) -> BTreeMap<(u32, u32), [u32; 2]> {
    let work = WorkDir::temporary(folder).unwrap();
    let ordered =
        Ordered::build(mesh, OrderParams { order, has_rows: true }, &json!(1), Context::new(&work, run)).unwrap();
    assert_eq!(ordered.order.is_some(), order == Order::Hilbert);
    let graph =
        DualGraph::build(&ordered.mesh, Path::new("mesh"), &ordered.identity, Context::new(&work, run)).unwrap();
    let rows = &graph.edges;
    let mut edges = BTreeMap::new();
    for i in 0..graph.nodes.len() {
        for e in rows.by_distance().span(i as u32) {
            let pair = (ordered.face(i as u32), ordered.face(rows.indices[e]));
            edges.insert(pair, [rows.centroid_distance[e].to_bits(), rows.edge[e].to_bits()]);
        }
    }
    edges
}

#[test]
fn a_shuffled_creature_has_the_same_graph_in_any_budget() {
    let dir = tempfile::tempdir().unwrap();
    let run = quiet(1 << 30);
    let opened = mesh::open(&creature(dir.path(), 60_000, true), dir.path(), &run).unwrap();
    let kept = edges(&opened, Order::Keep, &run, dir.path());
    for budget in [1 << 30, 4 << 20, 2 << 20] {
        let curve = edges(&opened, Order::Hilbert, &quiet(budget), dir.path());
        assert!(kept == curve, "budget {budget}");
    }
}

#[test]
fn random_polygons_have_the_same_graph() {
    let mut draw = stream(7, "polygons");
    for round in 0..12 {
        let dir = tempfile::tempdir().unwrap();
        let vertices: Vec<[f64; 3]> =
            (0..40 + 300 * round).map(|_| [0; 3].map(|_| below(&mut draw, 1000) as f64)).collect();
        let faces: Vec<Vec<u32>> = (0..20 + 900 * round)
            .map(|_| (0..below(&mut draw, 7)).map(|_| below(&mut draw, vertices.len()) as u32).collect())
            .collect();
        let mesh = Mesh::from_slices(&vertices, &faces).unwrap();
        for budget in [1 << 30, 2 << 20, 500_000] {
            let work = WorkDir::temporary(dir.path()).unwrap();
            let ordered = Ordered::build(&mesh, HILBERT, &json!(1), Context::new(&work, &quiet(budget))).unwrap();
            let mut seen = vec![false; faces.len()];
            ordered.mesh.faces.for_each(0..faces.len(), |node, corners| {
                let face = ordered.face(node as u32) as usize;
                assert!(!std::mem::replace(&mut seen[face], true));
                let old = faces[face].iter().map(|&v| mesh.positions.get(v));
                assert!(old.eq(corners.iter().map(|&v| ordered.mesh.positions.get(v))), "face {face}");
            });
            assert!(seen.iter().all(|&seen| seen));
        }
    }
}

#[test]
fn labels_come_back_in_the_order_of_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let run = quiet(1 << 30);
    let opened = mesh::open(&creature(dir.path(), 40_000, true), dir.path(), &run).unwrap();
    let labels = |order: Order, budget: u64| {
        let work = WorkDir::temporary(dir.path()).unwrap();
        let parts = PartsParams { count: PartCount::Exactly(6), ..PartsParams::default() };
        let params = SegmentParams::default().parts(parts).cluster(Cluster::KMeans).order(order);
        let result = segment(&opened, &json!(1), &params, Context::new(&work, &quiet(budget))).unwrap();
        (result.labels.to_vec(), result.quality.to_vec(), result.numbers.landmarks)
    };
    let kept = labels(Order::Keep, 1 << 30);
    let curve = labels(Order::Hilbert, 1 << 30);
    let agreement = 1. - rand(&contingency(&kept.0, &curve.0, None).unwrap());
    assert!(agreement > 0.99, "{agreement}");
    assert!(labels(Order::Hilbert, 6 << 20) == curve, "the budget changes nothing");
}

#[test]
fn labels_are_the_same_when_the_kernel_can_keep_nothing_in_memory() {
    // A few blocks of pages; fronts tell what they need, cells are made block by block.
    let dir = tempfile::tempdir().unwrap();
    let opened = mesh::open(&creature(dir.path(), 200_000, false), dir.path(), &quiet(1 << 30)).unwrap();
    for (cluster, exact) in [(Cluster::Parts, false), (Cluster::KMeans, false), (Cluster::KMeans, true)] {
        let labels = |resident: u64| {
            let work = WorkDir::temporary(dir.path()).unwrap();
            let parts = PartsParams { count: PartCount::Exactly(6), ..PartsParams::default() };
            let params = SegmentParams::default().parts(parts).cluster(cluster).exact(exact).landmarks(Some(10));
            let run = Run { resident, ..quiet(1 << 30) };
            let result = segment(&opened, &json!(1), &params, Context::new(&work, &run)).unwrap();
            (result.labels.to_vec(), result.quality.to_vec(), result.numbers.landmarks)
        };
        assert!(labels(u64::MAX) == labels(0), "{cluster:?}, exact {exact}");
    }
}

#[test]
fn scans_have_the_same_labels_where_geometry_is_computed() {
    let Some(data) = data() else { return };
    let dir = tempfile::tempdir().unwrap();
    // Holes and a rough surface; a seam; 151 components, in no order at all, if every case is asked for.
    let scans = ["bun_zipper_orig_ascii", "lucy_100k_orig", "dragon_vrip_orig_ascii"];
    for (number, name) in scans.into_iter().enumerate().take(if every_case() { 3 } else { 2 }) {
        let opened = mesh::open(&data.join(format!("real/{name}.ply")), dir.path(), &quiet(1 << 30)).unwrap();
        let labels = |params: &SegmentParams, resident: u64| {
            let work = WorkDir::temporary(dir.path()).unwrap();
            let run = Run { resident, ..quiet(1 << 30) };
            let result = segment(&opened, &json!(1), params, Context::new(&work, &run)).unwrap();
            assert_eq!(work.file("node_geometry.npy").exists(), resident > 0, "{name}");
            for given_up in ["graph_weights.npy", "normals_01.npy", "normals_02.npy"] {
                assert!(!work.file(given_up).exists(), "{name}: {given_up}");
            }
            let (SegmentedMesh { labels, quality, colours, .. }, area) = (&result, &result.numbers.area);
            (labels.to_vec(), quality.to_vec(), colours.clone(), area.clone(), result.numbers.landmarks)
        };
        let by_default = SegmentParams::default();
        let six = PartsParams { count: PartCount::Exactly(6), ..PartsParams::default() };
        let means = by_default.clone().parts(six).landmarks(Some(10));
        let ways = [
            by_default.clone(),
            means.clone().cluster(Cluster::KMeans),
            means.clone().cluster(Cluster::KMeans).exact(true),
            by_default.clone().cluster(Cluster::TwoMeans).landmarks(Some(10)).sampling(Some(Sampling::Random)),
            means
                .clone()
                .cluster(Cluster::KMeans)
                .exact(true)
                .order(Order::Hilbert)
                .sampling(Some(Sampling::GeodesicFarthest)),
        ];
        // The default on each scan; the others on the two smaller ones by turns, or on each as well.
        for (way, params) in ways.into_iter().enumerate() {
            if way > 0 && number != way % 2 && !every_case() {
                continue;
            }
            assert!(labels(&params, u64::MAX) == labels(&params, 0), "{name}, {params:?}");
        }
    }
}

#[test]
fn a_temporary_directory_that_gave_up_files_cuts_again() {
    let dir = tempfile::tempdir().unwrap();
    let run = quiet(1 << 30);
    let opened = mesh::open(&creature(dir.path(), 30_000, true), dir.path(), &run).unwrap();
    for cluster in [Cluster::Parts, Cluster::KMeans] {
        let labels = |work: &WorkDir, parts: usize| {
            let parts = PartsParams { count: PartCount::Exactly(parts), ..PartsParams::default() };
            let order = Order::Hilbert;
            let params = SegmentParams::default().parts(parts).cluster(cluster).order(order).landmarks(Some(10));
            segment(&opened, &json!(1), &params, Context::new(work, &run)).unwrap().labels.to_vec()
        };
        let temporary = WorkDir::temporary(dir.path()).unwrap();
        let lasting = WorkDir::open(&dir.path().join(format!("{cluster:?}"))).unwrap();
        for parts in [6, 4, 4] {
            assert!(labels(&temporary, parts) == labels(&lasting, parts), "{cluster:?} {parts}");
        }
        assert!(lasting.file("curve_vertices.npy").exists() && !temporary.file("curve_vertices.npy").exists());
        assert!(!temporary.file("graph_weights.npy").exists());
        assert!(lasting.file("graph_weights.npy").exists());
    }
}
