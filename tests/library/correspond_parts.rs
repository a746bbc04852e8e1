//! The parts of correspondence against slow, obvious versions.

use crate::common;
use crate::common::oracle;
use nalgebra::DMatrix;
use nystrom_stream::apps::correspond::align::{apply, procrustes};
use nystrom_stream::apps::correspond::{AlignedPair, Alignment, EmbeddingSearch, Matching, accuracy, matches};
use nystrom_stream::base::random::{stream, unit};
use nystrom_stream::base::{Cancel, Progress, eigen};
use nystrom_stream::distance::front::mean_weight;
use nystrom_stream::distance::march::{March, Surface, through};
use nystrom_stream::distance::rows::RowParams;
use nystrom_stream::distance::vertex_rows::{self, Distance};
use nystrom_stream::graph::VertexGraph;
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::mesh::{self, Mesh};
use nystrom_stream::spectral::Kernel;
use nystrom_stream::spectral::nystrom::{Eigenvectors, OrthogonalEmbedding, OrthogonalParams, Point};
use nystrom_stream::store::Context;
use nystrom_stream::store::{Budget, Run, WorkDir};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// A square of n × n vertices in the plane, its diagonals in random directions, slightly bent by `bend`.
fn sheet(n: usize, bend: f64) -> Mesh {
    let mut draw = stream(5, "sheet");
    let at = |i: usize, j: usize| (i * n + j) as u32;
    let points: Vec<[f64; 3]> = (0..n * n)
        .map(|k| {
            let (x, y) = ((k / n) as f64, (k % n) as f64);
            let inside = k / n > 0 && k / n + 1 < n && k % n > 0 && k % n + 1 < n;
            let shift = if inside { 0.3 * (unit(&mut draw) - 0.5) } else { 0. };
            [x + shift, y - shift, bend * (0.7 * x).sin() + 0.4 * bend * y]
        })
        .collect();
    let mut faces = Vec::new();
    for i in 0..n - 1 {
        for j in 0..n - 1 {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            let pair = if unit(&mut draw) < 0.5 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] };
            faces.extend(pair);
        }
    }
    Mesh::from_slices(&points, &faces).unwrap()
}

fn graph(mesh: &Mesh, context: Context<'_>) -> VertexGraph {
    VertexGraph::build(mesh, Path::new("m"), context).unwrap()
}

#[test]
fn rows_and_rings_are_those_of_the_faces_whatever_threads_and_memory() {
    let dir = tempfile::tempdir().unwrap();
    let path = common::creature(dir.path(), 9_000, true);
    let opened = mesh::open(&path, dir.path(), &Run::new(&())).unwrap();
    let mesh = &opened;
    let mut around: Vec<Vec<[u32; 2]>> = vec![Vec::new(); mesh.positions.len()];
    mesh.faces.for_each(0..mesh.faces.len(), |_, c| {
        for k in 0..3 {
            around[c[k] as usize].push([c[(k + 1) % 3], c[(k + 2) % 3]]);
        }
    });
    for (threads, bytes) in [(1, 1 << 30), (3, 3 << 20)] {
        let work = WorkDir::temporary(dir.path()).unwrap();
        let run = Run { threads, budget: Budget::new(bytes), ..Run::new(&()) };
        let graph = graph(mesh, Context::new(&work, &run));
        assert_eq!(graph.facts.components, 1);
        for (v, pairs) in around.iter().enumerate() {
            let mut ring: Vec<[u32; 2]> = graph.ring
                [2 * graph.ring_starts[v] as usize..2 * graph.ring_starts[v + 1] as usize]
                .chunks(2)
                .map(|pair| [pair[0], pair[1]])
                .collect();
            let mut pairs = pairs.clone();
            ring.sort_unstable();
            pairs.sort_unstable();
            assert_eq!(ring, pairs, "vertex {v}");
            let neighbours: BTreeMap<u32, ()> = pairs.iter().flatten().map(|&u| (u, ())).collect();
            let span = graph.csr().span(v as u32);
            assert!(graph.edges.indices[span.clone()].iter().eq(neighbours.keys()));
            for e in span {
                let [p, q] = [v as u32, graph.edges.indices[e]].map(|u| mesh.positions.get(u));
                let length = (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>().sqrt() / graph.frame.scale;
                assert!((f64::from(graph.edges.centroid_distance[e]) - length).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn seams_are_closed_and_pieces_bridged() {
    let dir = tempfile::tempdir().unwrap();
    let run = Run::new(&());
    // Two triangles that share two positions but no vertex, and one apart; a vertex that nothing uses.
    let points = [
        [0., 0., 0.],
        [1., 0., 0.],
        [0., 1., 0.],
        [1., 0., 0.],
        [0., 1., 0.],
        [1., 1., 0.],
        [5., 0., 0.],
        [6., 0., 0.],
        [5., 1., 0.],
        [9., 9., 0.],
    ];
    let mesh = Mesh::from_slices(&points, &[[0u32, 1, 2], [3, 5, 4], [6, 7, 8]]).unwrap();
    let work = WorkDir::temporary(dir.path()).unwrap();
    let graph = graph(&mesh, Context::new(&work, &run));
    assert_eq!((graph.facts.seams, graph.facts.components, graph.facts.boundary_vertices), (2, 3, 9));
    let field = oracle::dijkstra(graph.csr(), 0);
    assert!(field.iter().all(|d| d.is_finite()), "{field:?}");
    assert!((field[5] * graph.frame.scale as f32 - 2.).abs() < 1e-5);
    let flat = Mesh::from_slices(&points[..3], &[[0u32, 0, 1]]).unwrap();
    assert!(VertexGraph::build(&flat, Path::new("m"), Context::new(&work, &run)).is_err());
}

#[test]
fn an_update_is_the_least_over_the_edge() {
    let mut draw = stream(1, "updates");
    for _ in 0..2000 {
        let mut point = || std::array::from_fn(|_| unit(&mut draw) as f32);
        let (x, p, q): ([f32; 3], [f32; 3], [f32; 3]) = (point(), point(), point());
        let length = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt();
        let dp = unit(&mut draw) as f32;
        let dq = dp + (2. * unit(&mut draw) as f32 - 1.) * length(p, q);
        let way = |t: f32| dp + t * (dq - dp) + length(x, std::array::from_fn(|k| p[k] + t * (q[k] - p[k])));
        let least = (0..=2000).map(|i| way(i as f32 / 2000.)).fold(f32::INFINITY, f32::min);
        let found = through(x, p, q, dp, dq).min(way(0.)).min(way(1.));
        assert!((found - least).abs() < 1e-4, "{found} {least}");
    }
}

#[test]
fn marching_is_the_fixed_point_and_nearer_the_truth_than_edges() {
    let dir = tempfile::tempdir().unwrap();
    let run = Run::new(&());
    for bend in [0., 1.] {
        let mesh = sheet(24, bend);
        let work = WorkDir::temporary(dir.path()).unwrap();
        let graph = graph(&mesh, Context::new(&work, &run));
        let surface = Surface::of(&graph);
        let mut march = March::new(mean_weight(surface.graph));
        let mut field = vec![0.; graph.len()];
        march.full(surface, 0, &mut field, &run.cancel).unwrap();
        // Sweeps over all triangles until nothing changes.
        let mut slow = oracle::dijkstra(surface.graph, 0);
        let edges = slow.clone();
        loop {
            let mut changed = false;
            for v in 0..graph.len() {
                for pair in
                    graph.ring[2 * graph.ring_starts[v] as usize..2 * graph.ring_starts[v + 1] as usize].chunks(2)
                {
                    let [p, q] = [pair[0], pair[1]].map(|u| u as usize);
                    let at = |u: usize| graph.nodes[u].centroid;
                    let there = through(at(v), at(p), at(q), slow[p], slow[q]);
                    if there < slow[v] * (1. - 1e-7) {
                        (slow[v], changed) = (there, true);
                    }
                }
                for (near, length) in graph.csr().neighbours(v as u32) {
                    let there = slow[near as usize] + length;
                    if there < slow[v] {
                        (slow[v], changed) = (there, true);
                    }
                }
            }
            if !changed {
                break;
            }
        }
        let (mut marched, mut walked) = (0f64, 0f64);
        for v in 0..graph.len() {
            // Updates against the front's direction, by obtuse triangles, are left out.
            let range = slow[v] * (1. - 1e-4)..=slow[v] * 1.01;
            assert!(range.contains(&field[v]), "{} {}", field[v], slow[v]);
            assert!(field[v] <= edges[v] * 1.00001);
            if bend == 0. && v > 0 {
                let [x, y, _] = mesh.positions.get(v as u32);
                let real = (x * x + y * y).sqrt() / graph.frame.scale;
                marched += (f64::from(field[v]) / real - 1.).abs();
                walked += (f64::from(edges[v]) / real - 1.).abs();
            }
        }
        if bend == 0. {
            assert!(marched < 0.4 * walked, "{marched} {walked}");
        }
        let mut free = vec![f32::INFINITY; graph.len()];
        let targets = [7, 300, 575, 7];
        let found = march.between(surface, 0, &targets, &mut free, &run.cancel).unwrap();
        for (target, d) in targets.into_iter().zip(found) {
            assert!((d - field[target as usize]).abs() <= 1e-3 * d);
        }
        assert!(free.iter().all(|d| *d == f32::INFINITY));
        let pairs = [(7u32, 0u32), (0, 0), (300, 0), (0, 575)];
        let errors = accuracy::distances(&graph, &pairs, &run).unwrap();
        let unit = graph.facts.area.sqrt();
        assert!(errors[1] == 0. && (errors[2] * unit - f64::from(field[300])).abs() < 1e-2, "{errors:?}");
        assert!(accuracy::distances(&graph, &[(0, 100_000)], &run).is_err());
    }
}

#[test]
fn rows_along_edges_are_dijkstras() {
    let dir = tempfile::tempdir().unwrap();
    let run = Run::new(&());
    let mesh = sheet(20, 1.);
    let work = WorkDir::temporary(dir.path()).unwrap();
    let graph = graph(&mesh, Context::new(&work, &run));
    let surface = Surface::of(&graph);
    let params = RowParams { l: 6, sampling: Sampling::Farthest };
    let landmarks = vertex_rows::landmarks(surface, params, Context::new(&work, &run)).unwrap();
    assert_eq!(landmarks, oracle::farthest_points(surface.graph, landmarks[0], 6));
    let rows =
        vertex_rows::rows(surface, landmarks.clone(), Distance::Edges, "r.npy", Context::new(&work, &run)).unwrap();
    for (k, &landmark) in landmarks.iter().enumerate() {
        assert_eq!(rows.row(k), oracle::dijkstra(surface.graph, landmark));
    }
    assert!(vertex_rows::landmarks(surface, RowParams { l: 0, ..params }, Context::new(&work, &run)).is_err());
}

/// Stops everything after some rows.
struct Stop(Cancel, AtomicU64);

impl Progress for Stop {
    fn advance(&self, stage: &str, done: u64) {
        if stage == "rows" && self.1.fetch_sub(done, Ordering::Relaxed) <= 1 {
            self.0.cancel();
        }
    }
}

#[test]
fn rows_that_were_stopped_go_on_where_they_were() {
    let dir = tempfile::tempdir().unwrap();
    let free = Run::new(&());
    let mesh = sheet(20, 1.);
    let params = RowParams { l: 9, sampling: Sampling::Farthest };
    let work = WorkDir::open(&dir.path().join("work")).unwrap();
    let rows = |run: &Run<'_>, key: &str, distance| {
        let graph = VertexGraph::build(&mesh, Path::new("m"), Context::new(&work, run))?;
        vertex_rows::open_or_build(Surface::of(&graph), params, distance, key, Context::new(&work, run))
    };
    let whole = rows(&free, "1", Distance::March).unwrap();
    let all = whole.distances.to_vec();
    drop(whole);
    let cancel = Cancel::default();
    let stop = Stop(cancel.clone(), AtomicU64::new(4));
    let run = Run { cancel, threads: 1, ..Run::new(&stop) };
    assert!(rows(&run, "2", Distance::March).is_err());
    // A row that was torn is made again with those that were not reached.
    let partial = work.file("distances.npy.partial");
    let mut bytes = std::fs::read(&partial).unwrap();
    let at = bytes.len() - 9 * 400 * 4 + 400 * 4;
    bytes[at] ^= 1;
    std::fs::write(&partial, bytes).unwrap();
    let counted = Stop(Cancel::default(), AtomicU64::new(1000));
    let again = rows(&Run::new(&counted), "2", Distance::March).unwrap();
    assert_eq!(again.distances[..], all[..]);
    // Three are told as taken over, six are made.
    assert_eq!(counted.1.load(Ordering::Relaxed), 1000 - 9);
    assert_eq!(rows(&free, "2", Distance::March).unwrap().facts, again.facts);
    assert_ne!(rows(&free, "2", Distance::Edges).unwrap().distances[..], all[..]);
}

#[test]
fn with_every_vertex_a_landmark_the_embedding_is_that_of_the_whole_matrix() {
    let dir = tempfile::tempdir().unwrap();
    let run = Run::new(&());
    let mesh = sheet(9, 1.);
    let work = WorkDir::temporary(dir.path()).unwrap();
    let graph = graph(&mesh, Context::new(&work, &run));
    let n = graph.len();
    let all = (0..n as u32).collect();
    let rows =
        vertex_rows::rows(Surface::of(&graph), all, Distance::Edges, "r.npy", Context::new(&work, &run)).unwrap();
    let kernel = Kernel::Exponential;
    let params = OrthogonalParams { kernel, width: 1., dimensions: 5, eigenvectors: Eigenvectors::Orthogonal };
    let fit = OrthogonalEmbedding::fit(&rows, &graph.nodes, params, &run).unwrap();
    let points = fit.embed(&rows, fit.sigma, "e.npy", Context::new(&work, &run)).unwrap();
    let total: f64 = graph.nodes.iter().map(|node| f64::from(node.area)).sum();
    let root: Vec<f64> = graph.nodes.iter().map(|node| (f64::from(node.area) / total).sqrt()).collect();
    let w = DMatrix::from_fn(n, n, |i, j| root[i] * root[j] * kernel.of(fit.sigma, f64::from(rows.row(i)[j])));
    let (values, vectors) = eigen::symmetric(w);
    for k in 0..5 {
        let faded = values[k] - values[5];
        assert!((faded / fit.variance[k] - 1.).abs() < 1e-3, "{k}: {faded} {}", fit.variance[k]);
        let dot: f64 = (0..n).map(|i| f64::from(points[i][k]) * root[i] * vectors[(i, k)]).sum();
        // A unit vector times √(λ − λ₅), but for its sign and what damping takes away.
        assert!((dot.abs() / faded.sqrt() - 1.).abs() < 1e-3, "{k}: {dot}");
    }
    assert!(points.iter().all(|p| p[5..] == [0.; 3]));
    assert!(OrthogonalEmbedding::fit(&rows, &graph.nodes, OrthogonalParams { dimensions: 9, ..params }, &run).is_err());
    assert!(
        OrthogonalEmbedding::fit(&rows, &graph.nodes, OrthogonalParams { width: f64::NAN, ..params }, &run).is_err()
    );
}

/// Points on a bent sheet in k dimensions, in the order of the sheet's vertices.
fn points_on(graph: &VertexGraph, k: usize) -> Vec<Point> {
    let wave = |v: usize, i: usize| {
        let [x, y, _] = graph.nodes[v].centroid;
        (1. + 0.4 * i as f32) * x + (1.7 - 0.6 * i as f32) * y + 0.05 * (9. * x + i as f32).sin()
    };
    (0..graph.len()).map(|v| std::array::from_fn(|i| if i < k { wave(v, i) } else { 0. })).collect()
}

fn brute(point: &Point, among: &[Point]) -> f32 {
    among.iter().map(|p| p.iter().zip(point).map(|(a, b)| (a - b) * (a - b)).sum::<f32>()).fold(f32::INFINITY, f32::min)
}

#[test]
fn the_nearest_is_the_nearest() {
    let dir = tempfile::tempdir().unwrap();
    let run = Run::new(&());
    let mesh = sheet(40, 1.);
    let work = WorkDir::temporary(dir.path()).unwrap();
    let graph = graph(&mesh, Context::new(&work, &run));
    for k in 2..=8 {
        let points = points_on(&graph, k);
        let whole = EmbeddingSearch::new(&points, graph.csr(), k, Context::new(&work, &run)).unwrap();
        let part = EmbeddingSearch::with_limit(&points, graph.csr(), k, 200, Context::new(&work, &run)).unwrap();
        let mut right = 0;
        for v in (0..graph.len()).step_by(7) {
            let query: Point = std::array::from_fn(|i| if i < k { points[v][i] + 0.01 * i as f32 } else { 0. });
            let least = brute(&query, &points);
            assert!((whole.nearest(&query).square - least).abs() < 1e-6);
            let nearest = whole.k_nearest(&query, 5);
            assert!(nearest.len() == 5 && nearest.windows(2).all(|w| w[0].square <= w[1].square));
            right += u32::from((part.nearest(&query).square - least).abs() < 1e-6);
        }
        // A walk over a smooth sheet seldom gets stuck.
        assert!(right * 100 >= 95 * graph.len().div_ceil(7) as u32, "{k}: {right}");
    }
    // Many vertices at one place do no harm, and a budget too small is said.
    let same = vec![[0.5f32; 8]; graph.len()];
    let found = EmbeddingSearch::new(&same, graph.csr(), 8, Context::new(&work, &run)).unwrap().nearest(&[0.5; 8]);
    assert_eq!(found.square, 0.);
    let poor = Run { budget: Budget::new(1000), ..Run::new(&()) };
    assert!(EmbeddingSearch::new(&same, graph.csr(), 8, Context::new(&work, &poor)).is_err());
}

#[test]
fn mutual_matches_are_mutual_and_one_to_one_ones_stable() {
    let dir = tempfile::tempdir().unwrap();
    let run = Run::new(&());
    let mesh = sheet(20, 1.);
    let work = WorkDir::temporary(dir.path()).unwrap();
    let graph = graph(&mesh, Context::new(&work, &run));
    let b = points_on(&graph, 3);
    let mut draw = stream(2, "shift");
    let a: Vec<Point> = b
        .iter()
        .map(|p| std::array::from_fn(|i| if i < 3 { p[i] + 0.05 * unit(&mut draw) as f32 } else { 0. }))
        .collect();
    let alignment =
        Alignment { transform: DMatrix::identity(3, 3), cost: 0., transport: None, distortion: None, orientation: 1. };
    let in_a = EmbeddingSearch::new(&a, graph.csr(), 3, Context::new(&work, &run)).unwrap();
    let in_b = EmbeddingSearch::new(&b, graph.csr(), 3, Context::new(&work, &run)).unwrap();
    let pair =
        AlignedPair { a: &a, b: &b, graph_a: &graph, graph_b: &graph, alignment: &alignment, in_b: &in_b, in_a: &in_a };
    let of = |matching| matches(&pair, matching, "m.npy", Context::new(&work, &run)).unwrap().to_vec();
    let square = |p: &Point, q: &Point| p.iter().zip(q).map(|(x, y)| (x - y) * (x - y)).sum::<f32>();
    let all = of(Matching::All);
    for (v, one) in all.iter().enumerate() {
        assert!((one.distance.powi(2) - brute(&a[v], &b)).abs() < 1e-6);
        assert!((0. ..=1.).contains(&one.confidence));
    }
    for (v, one) in of(Matching::Mutual).iter().enumerate() {
        let target = all[v].vertex().unwrap() as usize;
        let mutual = square(&a[v], &b[target]) <= brute(&b[target], &a) + 1e-9;
        assert_eq!(one.vertex().is_some(), mutual, "vertex {v}");
    }
    let single = of(Matching::OneToOne);
    let mut holder = BTreeMap::new();
    for (v, one) in single.iter().enumerate() {
        if let Some(target) = one.vertex() {
            assert!(holder.insert(target, v).is_none(), "twice");
        }
    }
    assert!(holder.len() > 300);
    // No two that would rather have each other.
    for (v, one) in single.iter().enumerate() {
        for (&target, &held) in &holder {
            let there = square(&a[v], &b[target as usize]);
            let better_for_v = one.vertex().is_some() && there + 1e-7 < one.distance.powi(2);
            assert!(!better_for_v || square(&a[held], &b[target as usize]) <= there, "{v} and {target}");
        }
    }
}

#[test]
fn procrustes_finds_the_rotation() {
    let mut draw = stream(3, "rotation");
    let turn = DMatrix::from_fn(5, 5, |_, _| unit(&mut draw) - 0.5).qr().q();
    let points: Vec<Point> =
        (0..40).map(|_| std::array::from_fn(|i| if i < 5 { unit(&mut draw) as f32 } else { 0. })).collect();
    let found = procrustes(points.iter().map(|p| (*p, apply(&turn, p))), 5);
    assert!((found - turn).norm() < 1e-5);
}
