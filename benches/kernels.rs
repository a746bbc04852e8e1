//! The inner loops, on creatures made in memory: fronts against a binary heap, the kernel's `exp` against the system's,
//! the pass that assigns labels, the building of the graph, and mesh files.
//!
//! `cargo bench -p nystrom-stream-tools --bench kernels`; with `-- --test` each runs once. `NYSTROM_STREAM_BENCH_FACES` sets the size.

#[path = "../tests/common/oracle.rs"]
mod oracle;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nystrom_stream::apps::creature::{Creature, Options};
use nystrom_stream::base::Cancel;
use nystrom_stream::cluster::kmeans::{Assignment, KMeans, KMeansParams, WeightedPoints, assign};
use nystrom_stream::distance::front::mean_weight;
use nystrom_stream::distance::rows::RowParams;
use nystrom_stream::distance::{DistanceRows, Front};
use nystrom_stream::graph::WeightedGraph;
use nystrom_stream::graph::{DualGraph, Metric};
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::mesh::{self, Labelling, Mesh, PlyForm};
use nystrom_stream::spectral::measures::Gamma;
use nystrom_stream::spectral::{Embedding, EmbeddingParams, SampledColumns, exp::exp};
use nystrom_stream::store::Context;
use nystrom_stream::store::{Run, WorkDir};
use serde_json::json;
use std::hint::black_box;
use std::path::Path;

/// A creature with its graph.
struct Prepared {
    opened: Mesh,
    graph: DualGraph,
    weighted: WeightedGraph,
    work: WorkDir,
    folder: tempfile::TempDir,
}

fn prepare(shuffle: bool) -> Prepared {
    let faces = std::env::var("NYSTROM_STREAM_BENCH_FACES").ok().and_then(|n| n.parse().ok()).unwrap_or(200_000);
    let run = Run::new(&());
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("creature.ply");
    // Some noise, so that weights are as uneven as a scan's.
    let creature = Creature::new(&Options { faces, noise: 0.1, shuffle, ..Options::default() }).expect("a creature");
    creature.write_ply(&path, &run).expect("room for a mesh");
    let opened = mesh::open(&path, folder.path(), &run).expect("a mesh");
    let work = WorkDir::temporary(folder.path()).expect("a work directory");
    let graph = DualGraph::build(&opened, &path, &json!(1), Context::new(&work, &run)).expect("a graph");
    let weighted = graph.weighted(Metric::default(), Context::new(&work, &run)).expect("weights");
    Prepared { opened, graph, weighted, work, folder }
}

fn fronts(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("row");
    group.sample_size(10);
    for order in ["scan", "random"] {
        let prepared = prepare(order == "random");
        let graph = prepared.weighted.csr();
        let n = graph.len();
        group.throughput(Throughput::Elements(n as u64));
        let mut front = Front::new(mean_weight(graph));
        let mut field = vec![0f32; n];
        let cancel = Cancel::default();
        group.bench_function(BenchmarkId::new("front", order), |bencher| {
            bencher.iter(|| front.full(graph, 5, &mut field, &cancel));
        });
        group.bench_function(BenchmarkId::new("binary heap", order), |bencher| {
            bencher.iter(|| black_box(oracle::dijkstra(graph, 5)));
        });
        assert_eq!(field, oracle::dijkstra(graph, 5));
    }
    group.finish();
}

fn exponentials(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("exp");
    let distances: Vec<f32> = (0..4096).map(|k| -(k as f32) * 0.004).collect();
    let mut out = vec![0f32; distances.len()];
    group.throughput(Throughput::Elements(distances.len() as u64));
    group.bench_function("ours", |bencher| {
        bencher.iter(|| out.iter_mut().zip(black_box(&distances)).for_each(|(y, &x)| *y = exp(x)));
    });
    group.bench_function("system", |bencher| {
        bencher.iter(|| out.iter_mut().zip(black_box(&distances)).for_each(|(y, &x)| *y = x.exp()));
    });
    group.finish();
}

fn assigning(criterion: &mut Criterion) {
    let prepared = prepare(false);
    let run = Run::new(&());
    let (graph, work) = (&prepared.graph, &prepared.work);
    let params = RowParams { l: 12, sampling: Sampling::Farthest };
    let rows =
        DistanceRows::build(&prepared.weighted, graph.nodes.view(), params, Context::new(work, &run)).expect("rows");
    let columns = SampledColumns::sample(&rows, |face| graph.nodes.at(face).area, &run).unwrap();
    let embedding_params = EmbeddingParams::for_parts(6);
    let embedding = Embedding::fit(&rows, &columns, embedding_params).expect("an embedding");
    let coordinates = embedding.columns(&columns);
    let points = WeightedPoints { coordinates: &coordinates, weights: &columns.shares };
    let centres = KMeans::fit(points, embedding.dimensions, KMeansParams::new(6), &run).expect("centres");
    let gamma = Gamma::new(&rows, embedding_params.kernel, embedding.sigma);
    let (mut labels, mut quality) = (vec![0u32; rows.nodes], vec![0f32; rows.nodes]);
    let mut group = criterion.benchmark_group("assign");
    group.sample_size(10).throughput(Throughput::Elements(rows.nodes as u64));
    for (name, gamma) in [("labels", None), ("labels and gamma", Some(&gamma))] {
        group.bench_function(name, |bencher| {
            let (labels, quality) = (&mut labels[..], &mut quality[..]);
            let assignment = Assignment { rows: &rows, embedding: &embedding, centres: &centres, gamma };
            bencher.iter(|| assign(assignment, labels, quality, &run));
        });
    }
    group.bench_function("fit K-means", |bencher| {
        bencher.iter(|| KMeans::fit(points, embedding.dimensions, KMeansParams::new(6), &run));
    });
    group.finish();
}

fn building(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("graph");
    group.sample_size(10);
    for order in ["scan", "random"] {
        let prepared = prepare(order == "random");
        let run = Run::new(&());
        group.throughput(Throughput::Elements(prepared.opened.faces.len() as u64));
        group.bench_function(order, |bencher| {
            bencher.iter(|| {
                let work = WorkDir::temporary(prepared.folder.path()).expect("a work directory");
                DualGraph::build(&prepared.opened, Path::new("creature"), &json!(1), Context::new(&work, &run))
                    .map(drop)
            });
        });
    }
    group.finish();
}

/// Labelled files written and opened: binary, which is read where it lies, and text.
fn mesh_files(criterion: &mut Criterion) {
    let Prepared { opened, folder, .. } = prepare(false);
    let (run, faces) = (Run::new(&()), opened.faces.len());
    let labels: Vec<u32> = (0..faces as u32).map(|face| face / 1000 % 12).collect();
    let (colours, quality) = (nystrom_stream::apps::colours::assign(12, &[]), vec![0.5; faces]);
    let labelling = Labelling { labels: &labels, colours: &colours, quality: Some(&quality), names: &[], fine: None };
    let mut group = criterion.benchmark_group("mesh file");
    group.sample_size(10).throughput(Throughput::Elements(faces as u64));
    for (name, form) in [("binary", PlyForm::Binary), ("text", PlyForm::Ascii)] {
        let path = folder.path().join(name).with_extension("ply");
        let write = || mesh::write_labelled(&opened, &path, &labelling, form, &run).expect("room");
        write();
        group.bench_function(BenchmarkId::new("write", name), |bencher| bencher.iter(write));
        group.bench_function(BenchmarkId::new("open", name), |bencher| {
            bencher.iter(|| mesh::open(&path, folder.path(), &run).expect("a mesh"));
        });
    }
    group.bench_function("write seg", |bencher| {
        bencher.iter(|| mesh::write_seg(&folder.path().join("out.seg"), &labels, &run).expect("room"));
    });
    group.finish();
}

criterion_group!(kernels, fronts, exponentials, assigning, building, mesh_files);
criterion_main!(kernels);
