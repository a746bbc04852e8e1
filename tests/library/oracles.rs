//! The fast ways against slow, obvious ones: graph, weights, fronts, landmarks, embeddings, Γ.

use crate::common::shapes::{self, Shape};
use crate::common::{self, oracle, stride};
use nalgebra::{DMatrix, DVector};
use nystrom_stream::base::random::{below, stream, unit};
use nystrom_stream::base::{Cancel, Error};
use nystrom_stream::distance::front::mean_weight;
use nystrom_stream::distance::paging::Pages;
use nystrom_stream::distance::rows::RowParams;
use nystrom_stream::distance::sampler::{GraphSpace, SearchGraph};
use nystrom_stream::distance::{DistanceRows, Front, voronoi};
use nystrom_stream::graph::{Csr, OwnedRowStarts, WeightedGraph};
use nystrom_stream::graph::{DualGraph, Metric};
use nystrom_stream::landmarks::{Sampling, farthest::extremity};
use nystrom_stream::mesh::{self, Mesh};
use nystrom_stream::spectral::embedding::KernelWidth;
use nystrom_stream::spectral::measures::Gamma;
use nystrom_stream::spectral::{Embedding, EmbeddingParams, Kernel, Normalisation, SampledColumns};
use nystrom_stream::store::Context;
use nystrom_stream::store::{Budget, Run, WorkDir};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;

/// A mesh with its graph in a folder of its own.
struct Built {
    graph: DualGraph,
    mesh: Mesh,
    work: WorkDir,
    run: Run<'static>,
    _dir: tempfile::TempDir,
}

fn build_in(run: Run<'static>, make: impl FnOnce(&Path) -> Mesh) -> Built {
    let dir = tempfile::tempdir().unwrap();
    let mesh = make(dir.path());
    let work = WorkDir::temporary(dir.path()).unwrap();
    let graph =
        DualGraph::build(&mesh, Path::new("made in code"), &serde_json::json!(1), Context::new(&work, &run)).unwrap();
    Built { graph, mesh, work, run, _dir: dir }
}

fn two_threads() -> Run<'static> {
    Run { threads: 2, ..Run::new(&()) }
}

fn build(shape: &Shape) -> Built {
    build_in(two_threads(), |_| Mesh::from_slices(&shape.vertices, &shape.faces).unwrap())
}

impl Built {
    fn weighted(&self, metric: Metric) -> WeightedGraph {
        self.graph.weighted(metric, Context::new(&self.work, &self.run)).unwrap()
    }

    fn rows(&self, l: usize) -> DistanceRows {
        let params = RowParams { l, sampling: Sampling::Farthest };
        DistanceRows::build(
            &self.weighted(Metric::default()),
            self.graph.nodes.view(),
            params,
            Context::new(&self.work, &self.run),
        )
        .unwrap()
    }
}

/// The test meshes small enough for slow algorithms, and all shapes made in code.
fn meshes() -> Vec<(String, Built)> {
    let mut all: Vec<_> = shapes::all().iter().map(|shape| (shape.name.to_string(), build(shape))).collect();
    if let Some(data) = common::data() {
        for name in ["real/horse_4k.ply", "nasty/dragon_res4_11k.ply", "nasty/doorman.ply", "nasty/abominevole.ply"] {
            let open = |folder: &Path| mesh::open(&data.join(name), folder, &Run::new(&())).unwrap();
            all.push((name.to_string(), build_in(two_threads(), open)));
        }
    }
    all
}

fn bits(field: &[f32]) -> Vec<u32> {
    field.iter().map(|d| d.to_bits()).collect()
}

// ---------------------------------------------------------------------------------------------- fronts

/// A graph in memory.
#[derive(Clone, Debug)]
struct Arrays {
    starts: OwnedRowStarts,
    indices: Vec<u32>,
    weights: Vec<f32>,
}

impl Arrays {
    /// The graph of undirected `edges` on `n` nodes; of several between two nodes the last counts.
    fn of(n: usize, edges: &[(usize, usize, f32)]) -> Self {
        let mut rows = vec![BTreeMap::new(); n];
        for &(a, b, w) in edges {
            let (a, b) = (a % n, b % n);
            if a != b {
                rows[a].insert(b as u32, w);
                rows[b].insert(a as u32, w);
            }
        }
        let starts = OwnedRowStarts::of(rows.iter().map(BTreeMap::len));
        let mut arrays = Self { starts, indices: Vec::new(), weights: Vec::new() };
        for row in rows {
            arrays.indices.extend(row.keys());
            arrays.weights.extend(row.values());
        }
        arrays
    }

    fn csr(&self) -> Csr<'_> {
        Csr::new(self.starts.view(), &self.indices, &self.weights)
    }
}

/// Who owns each node, by definition: the smallest source from which a chain of exact steps leads there.
fn owners(graph: Csr<'_>, sources: &[u32], field: &[f32]) -> Vec<u32> {
    let mut owner = vec![u32::MAX; graph.len()];
    for (k, &source) in sources.iter().enumerate() {
        let mut stack = vec![source];
        while let Some(node) = stack.pop() {
            if owner[node as usize] != u32::MAX {
                continue;
            }
            owner[node as usize] = k as u32;
            for (next, weight) in graph.neighbours(node) {
                if field[node as usize] + weight == field[next as usize] {
                    stack.push(next);
                }
            }
        }
    }
    owner
}

/// Full, lowered and owned fronts from a few sources, at several bucket widths.
fn check_fronts(graph: Csr<'_>, sources: &[u32], told: &str) {
    let cancel = Cancel::default();
    let n = graph.len();
    let mean = mean_weight(graph);
    let exact: Vec<Vec<f32>> = sources.iter().map(|&source| oracle::dijkstra(graph, source)).collect();
    let mut nearest = vec![f32::INFINITY; n];
    exact.iter().for_each(|row| nearest.iter_mut().zip(row).for_each(|(a, b)| *a = a.min(*b)));
    let owned = owners(graph, sources, &nearest);
    let paged = Front::new(mean).paged(Some(Pages::of(graph)));
    for mut front in [Front::new(mean), Front::with_width(mean * 3.), Front::with_width(mean * 1e-5), paged] {
        let mut field = vec![0f32; n];
        for (source, row) in sources.iter().zip(&exact) {
            front.full(graph, *source, &mut field, &cancel).unwrap();
            assert_eq!(bits(&field), bits(row), "{told}: from {source}");
        }
        // One source after another, pruned; then all at once.
        field.fill(f32::INFINITY);
        for &source in sources {
            front.lower(graph, &[source], &mut field, &cancel).unwrap();
        }
        assert_eq!(bits(&field), bits(&nearest), "{told}: pruned");
        let mut owner = vec![0u32; n];
        front.nearest_source(graph, sources, &mut field, &mut owner, &cancel).unwrap();
        assert_eq!(bits(&field), bits(&nearest), "{told}: owned");
        assert_eq!(owner, owned, "{told}: owners");
        // Small blocks make many blocks.
        for (block, threads) in [(1 + n / 50, 3), (1 + n / 7, 2), (voronoi::PIECE_NODES, 1)] {
            let blocks = voronoi::BlockDijkstra::new(graph, block, threads, &cancel);
            blocks.nearest_source(sources, &mut field, &mut owner).unwrap();
            assert_eq!(bits(&field), bits(&nearest), "{told}: cells by blocks of {block}");
            assert_eq!(owner, owned, "{told}: owners by blocks of {block}");
        }
        check_bands(graph, &mut front, (&nearest, &owned), told);
    }
}

/// Bands around the cells of `owned` (n), whose seeds lie at the distances `nearest` (n): what is nearer than a limit,
/// and three labels grown from cores.
fn check_bands(graph: Csr<'_>, front: &mut Front, (nearest, owned): (&[f32], &[u32]), told: &str) {
    let cancel = Cancel::default();
    let n = graph.len();
    let limit = nearest.iter().filter(|d| d.is_finite()).fold(0f32, |most, d| most.max(*d)) / 3.;
    let core: Vec<bool> = nearest.iter().map(|&d| d <= limit).collect();
    let rim: Vec<u32> =
        (0..n as u32).filter(|&i| core[i as usize] && graph.neighbours(i).any(|(j, _)| !core[j as usize])).collect();
    let label = |i: usize| if core[i] { owned[i] % 3 } else { 7 };
    // By label, so that the smaller of two sources has the smaller label.
    let mut sources = rim.clone();
    sources.sort_by_key(|&i| label(i as usize));
    let (mut depth, mut owner) = (vec![0f32; n], vec![0u32; n]);
    front.nearest_source(graph, &sources, &mut depth, &mut owner, &cancel).unwrap();
    let expected: Vec<u32> = (0..n)
        .map(|i| if core[i] || owner[i] == u32::MAX { label(i) } else { label(sources[owner[i] as usize] as usize) })
        .collect();
    let inside: Vec<f32> = depth.iter().map(|&d| if d < limit { d } else { f32::INFINITY }).collect();
    let band: Vec<f32> = (0..n).map(|i| if core[i] { 0. } else { depth[i] }).collect();
    let start = || {
        let field: Vec<f32> = core.iter().map(|&core| if core { 0. } else { f32::INFINITY }).collect();
        (field, (0..n).map(label).collect::<Vec<u32>>())
    };
    let mut field = vec![f32::INFINITY; n];
    front.within(graph, &rim, limit, &mut field, &cancel).unwrap();
    assert_eq!(bits(&field), bits(&inside), "{told}: within a limit");
    let (mut field, mut labels) = start();
    front.propagate_labels(graph, &rim, &mut field, &mut labels, &cancel).unwrap();
    assert_eq!((bits(&field), &labels), (bits(&band), &expected), "{told}: labels grown");
    for (block, threads) in [(1 + n / 50, 3), (1 + n / 7, 2), (voronoi::PIECE_NODES, 1)] {
        let blocks = voronoi::BlockDijkstra::new(graph, block, threads, &cancel);
        let mut field = vec![f32::INFINITY; n];
        blocks.within(&rim, limit, &mut field).unwrap();
        assert_eq!(bits(&field), bits(&inside), "{told}: within a limit by blocks of {block}");
        let mut field = vec![7.; n];
        let visited = blocks.within_fresh(&rim, limit, &mut field).unwrap();
        for i in 0..n {
            assert!(visited.has(i) || (inside[i], field[i]) == (f32::INFINITY, 7.), "{told}: {i} by blocks of {block}");
            assert!(!visited.has(i) || field[i].to_bits() == inside[i].to_bits(), "{told}: {i} by blocks of {block}");
        }
        let (mut field, mut labels) = start();
        blocks.propagate_labels(&rim, &mut field, &mut labels).unwrap();
        assert_eq!((bits(&field), &labels), (bits(&band), &expected), "{told}: labels grown by blocks of {block}");
    }
}

#[test]
fn fronts_equal_a_binary_heap_to_the_bit_on_meshes() {
    for (k, (name, built)) in meshes().into_iter().enumerate() {
        // Fronts do not know where weights come from: one of the metrics a mesh, by turns, or all of them.
        let metrics = [Metric::default(), Metric::paper(), Metric::Geodesic];
        for metric in metrics.into_iter().skip(k % stride(3)).step_by(stride(3)) {
            let weighted = built.weighted(metric);
            let graph = weighted.csr();
            let mut draw = stream(1, &name);
            let sources: Vec<u32> = (0..4).map(|_| below(&mut draw, graph.len()) as u32).collect();
            check_fronts(graph, &sources, &format!("{name} {metric:?}"));
        }
    }
}

#[test]
fn equal_distances_go_to_the_smaller_source() {
    // A square lattice of unit steps: ties everywhere.
    let n = 40;
    let mut edges = Vec::new();
    for i in 0..n {
        for j in 0..n {
            edges.push((i * n + j, (i + 1).min(n - 1) * n + j, 1.));
            edges.push((i * n + j, i * n + (j + 1).min(n - 1), 1.));
        }
    }
    let arrays = Arrays::of(n * n, &edges);
    for sources in [&[0u32, 1599][..], &[1599, 0], &[39, 0, 1560, 1599, 820], &[5, 5, 7]] {
        check_fronts(arrays.csr(), sources, "lattice");
    }
}

/// Weights from nothing to a thousand times the usual, with many ties.
fn weight() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => (0f32..1.).prop_map(|x| (8. * x).exp() * 1e-3),
        3 => (1u8..4).prop_map(f32::from),
        1 => Just(0.),
        1 => Just(1e-9),
        1 => Just(1e-30),
        1 => Just(1e6),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300 / stride(5) as u32) })]

    #[test]
    fn fronts_equal_a_binary_heap_to_the_bit_on_any_graph(
        n in 1usize..80,
        // Few edges leave the graph in pieces, many make it dense.
        edges in proptest::collection::vec((0usize..1000, 0usize..1000, weight()), 0..300),
        sources in proptest::collection::vec(0u32..1000, 1..6),
    ) {
        let arrays = Arrays::of(n, &edges);
        let sources: Vec<u32> = sources.into_iter().map(|s| s % n as u32).collect();
        check_fronts(arrays.csr(), &sources, "random");
    }

    #[test]
    fn long_chains_leave_the_ring_of_buckets_and_come_back(
        steps in proptest::collection::vec(weight(), 1..400),
        source in 0usize..400,
    ) {
        let edges: Vec<_> = steps.iter().enumerate().map(|(k, &w)| (k, k + 1, w)).collect();
        let arrays = Arrays::of(steps.len() + 1, &edges);
        check_fronts(arrays.csr(), &[(source % (steps.len() + 1)) as u32, 0], "chain");
    }
}

// ------------------------------------------------------------------------------------------- landmarks

#[test]
fn landmarks_and_rows_equal_the_plain_algorithm() {
    for (name, built) in meshes() {
        let weighted = built.weighted(Metric::default());
        let graph = weighted.csr();
        let l = 20.min(graph.len());
        for seed in [0, 1] {
            // From an extremity, farthest first.
            let run = Run { seed, ..Run::new(&()) };
            let first = extremity(built.graph.nodes.view(), seed, 1);
            assert_eq!(extremity(built.graph.nodes.view(), seed, 3), first);
            let expected = oracle::farthest_points(graph, first, l);
            let mut field = vec![0f32; graph.len()];
            let mut found = Vec::new();
            let mut front = Front::new(mean_weight(graph));
            let search = SearchGraph { graph, nodes: built.graph.nodes.view(), lengths: None };
            let mut space = GraphSpace::new(search, &mut front, &(), &run);
            let keep = &mut |x, _: Option<&[f32]>| {
                found.push(x);
                Ok(())
            };
            space.sample(&Sampling::Farthest, l, &mut field, keep).unwrap();
            assert_eq!(found, expected, "{name}");
        }
        let rows = built.rows(l);
        for (k, &landmark) in rows.landmarks.iter().enumerate() {
            let exact = oracle::dijkstra(graph, landmark);
            assert_eq!(bits(rows.row(k)), bits(&exact), "{name}: row {k}");
            let facts = rows.facts[k];
            let sum: f64 = exact.iter().map(|&d| f64::from(d)).sum();
            assert!((facts.sum - sum).abs() <= 1e-9 * sum && facts.reached == exact.len() as u64, "{name}");
            assert_eq!(facts.farthest, exact.iter().copied().fold(0., f32::max), "{name}");
        }
    }
}

/// Regression: the search went on to the last landmark, for minutes if they were many, since it needs no front once it
/// has kept all rows, and only fronts asked for the stop flag.
#[test]
fn a_greedy_search_ends_when_it_is_cancelled() {
    let built = build(&shapes::grid(5));
    let weighted = built.weighted(Metric::default());
    let graph = weighted.csr();
    for sampling in [Sampling::Greedy, Sampling::PooledGreedy] {
        let (run, mut found) = (Run::new(&()), 0);
        let mut front = Front::new(mean_weight(graph));
        let search = SearchGraph { graph, nodes: built.graph.nodes.view(), lengths: None };
        let mut space = GraphSpace::new(search, &mut front, &(), &run);
        let cancel_at_first = &mut |_, _: Option<&[f32]>| {
            found += 1;
            run.cancel.cancel();
            Ok(())
        };
        let stopped = space.sample(&sampling, 40, &mut vec![0f32; graph.len()], cancel_at_first);
        assert!(matches!(stopped, Err(Error::Cancelled)) && found == 1, "{sampling:?}: {found} landmarks");
    }
}

#[test]
fn rows_are_the_same_whatever_the_threads_and_the_memory() {
    // Three blocks of pages and a bit.
    let shape = shapes::grid(160);
    let make = |_: &Path| Mesh::from_slices(&shape.vertices, &shape.faces).unwrap();
    let mut first: Option<(Vec<u32>, Vec<u32>, Vec<u32>)> = None;
    for (threads, megabytes, resident) in
        [(1, 1000, u64::MAX), (2, 1000, 0), (7, 1000, u64::MAX), (1, 1, 0), (3, 1, 10), (2, 1, u64::MAX)]
    {
        let run = Run { threads, budget: Budget::new(megabytes << 20), resident, ..Run::new(&()) };
        let built = build_in(run, make);
        let rows = built.rows(12);
        let indices = built.graph.edges.indices.to_vec();
        let result = (indices, rows.landmarks.clone(), bits(&rows.distances));
        assert!(
            *first.get_or_insert_with(|| result.clone()) == result,
            "{threads} threads, {megabytes} MiB, {resident} resident"
        );
    }
}

// ----------------------------------------------------------------------------------------------- graph

/// Faces as corner lists.
fn faces_of(mesh: &Mesh) -> Vec<Vec<u32>> {
    let mut faces = Vec::new();
    mesh.faces.for_each(0..mesh.faces.len(), |_, corners| faces.push(corners.to_vec()));
    faces
}

/// The ends of an edge.
type Ends = [[f64; 3]; 2];

/// The links among the faces of an edge that lie in the same places with opposite windings, each at an angle: of each
/// sector that is bounded from inside, from the face that opens it to the one that closes it. `None` without such faces.
fn sectors(sides: &[(u32, Ends)], faces: &[Vec<u32>], mesh: &Mesh) -> Option<Vec<[usize; 2]>> {
    let place = |face: u32| {
        let corners = &faces[face as usize];
        let at: BTreeSet<_> = corners.iter().map(|&v| mesh.positions.get(v).map(|x| (x + 0.).to_bits())).collect();
        let is_finite = at.iter().flatten().all(|x| f64::from_bits(*x).is_finite());
        (is_finite && at.len() == corners.len()).then_some(at)
    };
    let opposite = |a: &(u32, Ends), b: &(u32, Ends)| place(a.0).is_some() && place(a.0) == place(b.0) && a.1 != b.1;
    if !sides.iter().any(|a| sides.iter().any(|b| opposite(a, b))) {
        return None;
    }
    let [low, high] = sides[0].1;
    let axis = minus(high, low);
    let third = |side: &(u32, Ends)| {
        let at: Vec<_> = faces[side.0 as usize].iter().map(|&v| mesh.positions.get(v)).collect();
        let is_edge = |&k: &usize| [at[k], at[(k + 1) % at.len()]] == side.1;
        let slot = (0..at.len()).find(is_edge).unwrap_or(0);
        minus(at[(slot + 2) % at.len()], low)
    };
    let thirds: Vec<_> = sides.iter().map(third).collect();
    if !thirds.iter().all(|out| length(cross(axis, *out)) > 0.) {
        return None;
    }
    let right = cross(cross(axis, thirds[0]), axis);
    let up = cross(axis, right);
    let scale = length(right) / length(up);
    let angle = |k: usize| (scale * dot(thirds[k], up)).atan2(dot(thirds[k], right)).rem_euclid(std::f64::consts::TAU);
    let closes = |k: usize| sides[k].1 == sides[0].1;
    let mut order: Vec<usize> = (0..sides.len()).collect();
    order.sort_by(|&a, &b| {
        let near = (angle(a) - angle(b)).abs() < 1e-9;
        let by_angle = if near { std::cmp::Ordering::Equal } else { angle(a).total_cmp(&angle(b)) };
        by_angle.then(closes(b).cmp(&closes(a))).then(a.cmp(&b))
    });
    let mut found = Vec::new();
    for first in (0..order.len()).filter(|&i| !closes(order[i])) {
        let mut depth = 0;
        for step in 0..order.len() {
            let k = order[(first + step) % order.len()];
            depth += if closes(k) { -1 } else { 1 };
            if depth == 0 {
                found.push([order[first], k]);
                break;
            }
        }
    }
    Some(found)
}

/// The links among the `sides` of an edge, in the order of the file: see `sectors`, or a chain whose directions alternate,
/// and those left over.
fn links(sides: &[(u32, Ends)], faces: &[Vec<u32>], mesh: &Mesh) -> Vec<[usize; 2]> {
    let (ahead, back): (Vec<usize>, Vec<usize>) = (0..sides.len()).partition(|&k| sides[k].1 == sides[0].1);
    let (more, fewer) = if back.len() > ahead.len() { (&back, &ahead) } else { (&ahead, &back) };
    let mut links = sectors(sides, faces, mesh).unwrap_or_else(|| {
        let chain = more.iter().zip(fewer).flat_map(|(a, b)| [*a, *b]).chain(more.get(fewer.len()).copied());
        chain.collect::<Vec<_>>().windows(2).map(|two| [two[0], two[1]]).collect()
    });
    let is_free = |k: &usize| !links.iter().flatten().any(|of| of == k);
    let rest: Vec<usize> = (0..sides.len()).filter(is_free).collect();
    let others = if rest.first().is_some_and(|k| more.contains(k)) { fewer } else { more };
    for (k, &one) in rest.iter().enumerate() {
        if k < 4 * others.len() {
            links.push([one, others[k % others.len()]]);
        } else if k > 0 {
            links.push([rest[k - 1], one]);
        }
    }
    links
}

/// Pairs of neighbouring faces with the edges between them, by the rules in words: faces along one edge are linked as
/// `links` has it; an edge with one face joins others at exactly its position. A duplicate has one edge only, to the
/// face that it duplicates or hangs on.
fn neighbours(Built { mesh, graph, .. }: &Built) -> BTreeMap<(u32, u32), Vec<Ends>> {
    let faces = faces_of(mesh);
    let first = |face: usize| graph.duplicates.as_ref().and_then(|of| of[face].checked_sub(1));
    let mut edges: HashMap<(u32, u32), Vec<(u32, Ends)>> = HashMap::new();
    for (face, corners) in faces.iter().enumerate().filter(|(face, _)| first(*face).is_none()) {
        for (slot, &a) in corners.iter().enumerate() {
            let b = corners[(slot + 1) % corners.len()];
            let ends = [a, b].map(|v| mesh.positions.get(v));
            if a != b {
                edges.entry((a.min(b), a.max(b))).or_default().push((face as u32, ends));
            }
        }
    }
    let mut welded: HashMap<Vec<u64>, Vec<(u32, Ends)>> = HashMap::new();
    let mut runs = Vec::new();
    let mut open: Vec<_> = edges.into_values().collect();
    open.sort_by_key(|run| run[0].0);
    for run in open {
        let ends = run[0].1;
        if run.len() > 1 {
            runs.push(run);
        } else if ends.iter().flatten().all(|x| x.is_finite()) && ends[0] != ends[1] {
            let mut key = ends.map(|p| p.map(|x| (x + 0.).to_bits()));
            key.sort_unstable();
            welded.entry(key.as_flattened().to_vec()).or_default().push(run[0]);
        }
    }
    runs.extend(welded.into_values().filter(|run| run.len() > 1));
    let mut pairs: BTreeMap<(u32, u32), Vec<Ends>> = BTreeMap::new();
    for (face, corners) in faces.iter().enumerate() {
        let sorted = |face: &[u32]| BTreeSet::from_iter(face.iter().map(|&v| mesh.positions.get(v).map(f64::to_bits)));
        if let Some(first) = first(face) {
            let common: Vec<_> = corners.iter().filter(|&&v| faces[first as usize].contains(&v)).collect();
            assert!(sorted(corners) == sorted(&faces[first as usize]) || common.len() == 2);
            let ends = if common.len() == 2 { [*common[0], *common[1]] } else { [corners[0], corners[1]] };
            let pair = (first.min(face as u32), first.max(face as u32));
            pairs.entry(pair).or_default().push(ends.map(|v| mesh.positions.get(v)));
        }
    }
    for mut run in runs {
        run.sort_by_key(|side| side.0);
        for [a, b] in links(&run, &faces, mesh).into_iter().map(|pair| pair.map(|k| run[k])).filter(|[a, b]| a.0 != b.0)
        {
            pairs.entry((a.0.min(b.0), a.0.max(b.0))).or_default().push(if a.0 < b.0 { a.1 } else { b.1 });
        }
    }
    pairs
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| a[axis] - b[axis])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3])
}

fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// The rows as pairs, checked to be sorted, without duplicates and symmetric to the bit.
fn entries(built: &Built, weights: &[f32], told: &str) -> BTreeMap<(u32, u32), (f32, f32, f32)> {
    let rows = &built.graph.edges;
    let mut all = BTreeMap::new();
    for i in 0..built.graph.nodes.len() {
        let span = rows.by_distance().span(i as u32);
        assert!(rows.indices[span.clone()].windows(2).all(|w| w[0] < w[1]), "{told}: row {i} is not sorted");
        for e in span {
            assert_ne!(rows.indices[e] as usize, i, "{told}: loop");
            all.insert((i as u32, rows.indices[e]), (rows.centroid_distance[e], rows.edge[e], weights[e]));
        }
    }
    for (&(a, b), &(centroid_distance, edge, w)) in &all {
        let back = all.get(&(b, a)).unwrap_or_else(|| panic!("{told}: {a} → {b} goes one way"));
        let same = [centroid_distance, edge, w].map(f32::to_bits) == [back.0, back.1, back.2].map(f32::to_bits);
        assert!(same, "{told}: {a} ↔ {b}: {:?} {back:?}", (centroid_distance, edge, w));
        assert!(w > 0. && w.is_finite(), "{told}: {a} → {b}: {w}");
    }
    all
}

#[test]
fn the_graph_equals_a_naive_adjacency() {
    for (name, built) in meshes() {
        let weighted = built.weighted(Metric::Geodesic);
        let all = entries(&built, weighted.csr().weights, &name);
        let pairs = neighbours(&built);
        assert!(built.graph.duplicates.is_some() || !name.starts_with("duplicates"), "{name}");
        for pair in pairs.keys() {
            assert!(all.contains_key(pair), "{name}: {pair:?} is missing");
        }
        let facts = &built.graph.facts;
        let added: Vec<_> = all.keys().filter(|(a, b)| a < b && !pairs.contains_key(&(*a, *b))).collect();
        assert_eq!(added.len() as u64, facts.bridges, "{name}");
        assert_eq!(facts.bridges + 1, facts.components, "{name}");
        assert_eq!(facts.edges as usize * 2, all.len(), "{name}");
        // Bridged: everything is within reach.
        let field = oracle::dijkstra(weighted.csr(), 0);
        assert!(field.iter().all(|d| d.is_finite()), "{name}");
        // Components by another way: flooding without the bridges.
        let mut component = vec![u32::MAX; built.graph.nodes.len()];
        let mut touching: HashMap<u32, Vec<u32>> = HashMap::new();
        for &(a, b) in pairs.keys() {
            touching.entry(a).or_default().push(b);
            touching.entry(b).or_default().push(a);
        }
        let mut count = 0;
        for start in 0..component.len() as u32 {
            let mut stack = vec![start];
            count += u64::from(component[start as usize] == u32::MAX);
            while let Some(node) = stack.pop() {
                if component[node as usize] == u32::MAX {
                    component[node as usize] = start;
                    stack.extend(touching.get(&node).into_iter().flatten());
                }
            }
        }
        assert_eq!(count, facts.components, "{name}");
    }
}

#[test]
fn steps_and_weights_equal_a_formula_in_double_precision() {
    let mut checked = 0;
    for (name, built) in meshes() {
        let (graph, frame) = (&built.graph, &built.graph.facts.frame);
        let faces = faces_of(&built.mesh);
        let place = |v: u32| frame.place(built.mesh.positions.get(v));
        let whole: Vec<bool> = faces
            .iter()
            .map(|face| face.len() > 2 && face.iter().all(|&v| place(v).iter().all(|x| x.is_finite())))
            .collect();
        // Faces in the frame, in double precision.
        let centroids: Vec<[f64; 3]> = faces
            .iter()
            .map(|face| [0, 1, 2].map(|axis| face.iter().map(|&v| place(v)[axis]).sum::<f64>() / face.len() as f64))
            .collect();
        let vectors: Vec<[f64; 3]> = faces
            .iter()
            .map(|face| {
                (1..face.len().max(2) - 1).fold([0.; 3], |sum, k| {
                    let next = cross(minus(place(face[k]), place(face[0])), minus(place(face[k + 1]), place(face[0])));
                    [0, 1, 2].map(|axis| sum[axis] + next[axis])
                })
            })
            .collect();
        let counts = |f: usize| whole[f] && graph.duplicates.as_ref().is_none_or(|of| of[f] == 0);
        let area: f64 = (0..faces.len()).filter(|&f| counts(f)).map(|f| length(vectors[f]) / 2.).sum();
        assert!((graph.facts.area - area).abs() < 1e-5 * area + 1e-30, "{name}: {} {area}", graph.facts.area);
        // Normals as the graph turned them; a direction is certain only where there is area.
        let normals: Vec<Option<[f64; 3]>> = (0..faces.len())
            .map(|f| {
                let kept = graph.nodes.at(f).normal.map(f64::from);
                let normal = vectors[f].map(|x| x / length(vectors[f]));
                let sure = whole[f] && length(vectors[f]) > 1e-12;
                sure.then(|| if dot(normal, kept) < 0. { normal.map(|x| -x) } else { normal })
            })
            .collect();
        for f in (0..faces.len()).filter(|&f| whole[f]) {
            let node = graph.nodes.at(f);
            let far = length(minus(node.centroid.map(f64::from), centroids[f]));
            assert!(far < 1e-6, "{name}: centroid of {f}: {far}");
            if let Some(normal) = normals[f] {
                let turned = length(minus(node.normal.map(f64::from), normal));
                assert!(turned < 1e-5, "{name}: normal of {f}: {turned}");
            }
        }
        let pairs = neighbours(&built);
        let metrics = [Metric::Geodesic, Metric::default(), Metric::paper()];
        let weights = metrics.map(|metric| entries(&built, built.weighted(metric).csr().weights, &name));
        // Per pair: the length of the step, the angle, whether it is concave for sure, or convex for sure.
        let mut steps = Vec::new();
        for (&(a, b), edges) in &pairs {
            let (f, g) = (a as usize, b as usize);
            let (Some(n), Some(m)) = (normals[f], normals[g]) else { continue };
            let centroid_distance = edges
                .iter()
                .map(|ends| {
                    let ends = ends.map(|p| frame.place(p));
                    let mid = [0, 1, 2].map(|axis| (ends[0][axis] + ends[1][axis]) / 2.);
                    length(minus(centroids[f], mid)) + length(minus(centroids[g], mid))
                })
                .fold(f64::INFINITY, f64::min);
            let angle = length(cross(n, m)).atan2(dot(n, m));
            let lean = dot(minus(n, m), minus(centroids[g], centroids[f]));
            let (told_gd, told_edge, _) = weights[0][&(a, b)];
            assert!(
                (f64::from(told_gd) - centroid_distance).abs() < 1e-6 + 1e-5 * centroid_distance,
                "{name}: {a}–{b}: {told_gd} {centroid_distance}"
            );
            let unoriented = told_edge < 0.;
            steps.push(((a, b), centroid_distance, angle, if unoriented { 1. } else { lean }));
        }
        let agrees = |told: f32, slack: f64, formula: &dyn Fn(f64) -> f64, eta: f64, lean: f64| {
            let near = |w: f64| (f64::from(told) - w).abs() <= slack + 1e-4 * w;
            // So flat that rounding decides the sign: either will do.
            if lean.abs() < 5e-7 {
                near(formula(1.)) || near(formula(eta))
            } else {
                near(formula(if lean > 0. { 1. } else { eta }))
            }
        };
        for &(pair, centroid_distance, angle, lean) in &steps {
            let scaled = centroid_distance / area.sqrt();
            let (told, formula) = (weights[0][&pair].2, |_: f64| scaled.max(1e-9));
            assert!(agrees(told, 1e-8 + 2e-6 / area.sqrt(), &formula, 1., 1.), "{name}: {pair:?}: {told} {scaled}");
            let (told, formula) = (weights[1][&pair].2, |factor: f64| scaled + 5. * factor * angle);
            // Near a full turn the arc sine is steep: rounding of the normals costs half the digits there.
            let slack = 2e-5 + 2e-6 / area.sqrt() + if angle > 3.1 { 5e-3 } else { 0. };
            assert!(agrees(told, slack, &formula, 0.05, lean), "{name}: {pair:?}: {told}, {scaled} and {angle}");
            checked += 1;
        }
        // The paper's form has means over all edges; where every edge is certain they are the same.
        let certain = steps.iter().all(|step| step.3.abs() > 5e-7);
        if steps.len() as u64 == graph.facts.edges && certain {
            let count = steps.len() as f64;
            let turning = |step: &((u32, u32), f64, f64, f64)| (1. - step.2.cos()) * if step.3 > 0. { 1. } else { 0.1 };
            let mean_gd = steps.iter().map(|step| step.1).sum::<f64>() / count;
            let mean_angle = steps.iter().map(turning).sum::<f64>() / count;
            for step in &steps {
                let w = 0.03 * step.1 / mean_gd + 0.97 * turning(step) / mean_angle;
                let told = f64::from(weights[2][&step.0].2);
                assert!((told - w).abs() < 1e-4 * (w + 1.), "{name}: {:?}: {told} {w}", step.0);
                checked += 1;
            }
        }
    }
    assert!(checked > 5_000, "{checked}");
}

// ------------------------------------------------------------------------------------------ embeddings

/// Shapes without symmetry, so that eigenvectors are unique up to their sign.
fn lopsided() -> Vec<(&'static str, Built)> {
    let bent = |mut shape: Shape| {
        shape.vertices.iter_mut().for_each(|[x, y, z]| *y += 0.3 * *x * *x + 0.1 * *z * *x);
        shape
    };
    vec![("dumbbell", build(&bent(shapes::dumbbell()))), ("grid", build(&bent(shapes::grid(12))))]
}

/// Affinities of all faces with the landmarks (n × l) and among the landmarks (l × l).
fn affinities(rows: &DistanceRows, kernel: impl Fn(f64) -> f64) -> (DMatrix<f64>, DMatrix<f64>) {
    let d = |face: usize, k: usize| f64::from(rows.row(k)[face]);
    let all = DMatrix::from_fn(rows.nodes, rows.len(), |face, k| kernel(d(face, k)));
    let at = |k: usize| rows.landmarks[k] as usize;
    let among = DMatrix::from_fn(rows.len(), rows.len(), |i, j| kernel(0.5 * (d(at(i), j) + d(at(j), i))));
    (all, among)
}

/// Eigenpairs, descending.
fn eigen(matrix: &DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let found = nalgebra::SymmetricEigen::new(matrix.clone());
    let mut order: Vec<usize> = (0..matrix.nrows()).collect();
    order.sort_by(|&a, &b| found.eigenvalues[b].total_cmp(&found.eigenvalues[a]));
    let values = order.iter().map(|&k| found.eigenvalues[k]).collect();
    let columns: Vec<DVector<f64>> = order.iter().map(|&k| found.eigenvectors.column(k).into_owned()).collect();
    (values, DMatrix::from_columns(&columns))
}

/// How many eigenvalues stay.
fn kept(values: &[f64], kernel: Kernel) -> usize {
    let cut = kernel.tolerance(values.len()) * values[0];
    values.iter().filter(|&&v| v > cut && v > 0.).count()
}

/// The pseudo-inverse on the kept eigenpairs.
fn pseudo_inverse(a: &DMatrix<f64>, kernel: Kernel) -> DMatrix<f64> {
    let (values, vectors) = eigen(a);
    let kept = kept(&values, kernel);
    (0..kept).fold(DMatrix::zeros(a.nrows(), a.nrows()), |sum, e| {
        sum + vectors.column(e) * vectors.column(e).transpose() / values[e]
    })
}

/// Compares coordinates (d rows of n) with columns, up to the sign of each, to 1e-4 of the column's largest.
fn assert_columns(told: &str, found: &[f32], expected: &DMatrix<f64>) {
    let n = expected.nrows();
    assert_eq!(found.len(), n * expected.ncols(), "{told}");
    for e in 0..expected.ncols() {
        let (row, column) = (&found[e * n..(e + 1) * n], expected.column(e));
        let product: f64 = row.iter().zip(column.iter()).map(|(&x, y)| f64::from(x) * y).sum();
        let top = column.amax();
        let worst = row.iter().zip(column.iter()).map(|(&x, y)| (f64::from(x) - product.signum() * y).abs());
        let worst = worst.fold(0., f64::max);
        assert!(worst < 1e-4 * top, "{told}: coordinate {e} is off by {worst} of {top}");
    }
}

const KERNELS: [Kernel; 2] = [Kernel::Gaussian, Kernel::Exponential];

fn exact(kernel: Kernel, sigma: f64, d: f64) -> f64 {
    match kernel {
        Kernel::Gaussian => (-d * d / (2. * sigma * sigma)).exp(),
        Kernel::Exponential => (-d / sigma).exp(),
        _ => unreachable!(),
    }
}

fn fit(
    rows: &DistanceRows,
    built: &Built,
    kernel: Kernel,
    normalisation: Normalisation,
    d: usize,
) -> (Embedding, SampledColumns, Vec<f32>) {
    let columns = SampledColumns::sample(rows, |face| built.graph.nodes.at(face).area, &Run::new(&())).unwrap();
    assert_eq!(columns.len(), rows.nodes, "all columns of a small mesh");
    let width = KernelWidth::Mean(if normalisation == Normalisation::Anchor { 0.25 } else { 1. });
    let params = EmbeddingParams { kernel, width, normalisation, dimensions: d, unit_rows: false };
    let embedding = Embedding::fit(rows, &columns, params).unwrap();
    let coordinates = embedding.columns(&columns);
    (embedding, columns, coordinates)
}

#[test]
fn extrapolated_eigenvectors_equal_a_dense_computation() {
    for (name, built) in lopsided() {
        let rows = built.rows(12);
        for kernel in KERNELS {
            let (embedding, _, coordinates) = fit(&rows, &built, kernel, Normalisation::None, 5);
            assert!((embedding.sigma - rows.mean()).abs() < 1e-12);
            let (c, a) = affinities(&rows, |d| exact(kernel, embedding.sigma, d));
            let (values, vectors) = eigen(&a);
            let d = embedding.dimensions;
            assert_eq!(embedding.dropped, 12 - kept(&values, kernel), "{name}");
            assert!(d == 5.min(kept(&values, kernel)) && d > 2, "{name}: {d}");
            for (told, value) in embedding.eigenvalues.iter().zip(&values) {
                assert!((told - value).abs() < 1e-9 * values[0], "{name}");
            }
            // Ū = C U Λ⁻¹: on the landmarks this is U itself.
            let columns: Vec<DVector<f64>> = (0..d).map(|e| &c * vectors.column(e) / values[e]).collect();
            assert_columns(&format!("{name} {kernel:?}"), &coordinates, &DMatrix::from_columns(&columns));
        }
    }
}

#[test]
fn degree_normalised_coordinates_equal_a_dense_computation() {
    for (name, built) in lopsided() {
        let rows = built.rows(12);
        for kernel in KERNELS {
            let (embedding, columns, coordinates) = fit(&rows, &built, kernel, Normalisation::Degree, 5);
            let (c, a) = affinities(&rows, |d| exact(kernel, embedding.sigma, d));
            let n = rows.nodes as f64;
            // Row sums of W, each face counted by its share of the area.
            let shares = DVector::from_vec(columns.shares.clone());
            let sums = c.transpose() * shares * n;
            let degrees = &c * pseudo_inverse(&a, kernel) * &sums;
            let floor = 1e-3 * sums.mean();
            let root = |x: f64| 1. / x.max(floor).sqrt();
            let landmark_roots = DMatrix::from_diagonal(&sums.map(root));
            let face_roots = DMatrix::from_diagonal(&degrees.map(root));
            let (values, vectors) = eigen(&(&landmark_roots * &a * &landmark_roots));
            let normalised = face_roots * c * landmark_roots;
            let d = embedding.dimensions;
            let expected: Vec<_> = (0..d).map(|e| &normalised * vectors.column(e) / values[e]).collect();
            assert!(d > 2, "{name}: {d}");
            assert_columns(&format!("{name} {kernel:?}"), &coordinates, &DMatrix::from_columns(&expected));
        }
    }
}

#[test]
fn anchor_graph_coordinates_equal_a_dense_computation() {
    for (name, built) in lopsided() {
        let rows = built.rows(12);
        for kernel in KERNELS {
            let (embedding, columns, coordinates) = fit(&rows, &built, kernel, Normalisation::Anchor, 5);
            let (c, _) = affinities(&rows, |d| exact(kernel, embedding.sigma, d));
            let (n, l) = (rows.nodes, rows.len());
            let shares = &columns.shares;
            // v: the share of area nearest to each landmark.
            let mut v = vec![0f64; l];
            for face in 0..n {
                let nearest = (0..l).min_by(|&a, &b| rows.row(a)[face].total_cmp(&rows.row(b)[face])).unwrap();
                v[nearest] += shares[face];
            }
            let mut v: Vec<f64> = v.into_iter().map(|v| v.max(1e-4)).collect();
            let sum: f64 = v.iter().sum();
            v.iter_mut().for_each(|v| *v /= sum);
            let mean: f64 = (0..n).map(|face| shares[face] * (0..l).map(|k| v[k] * c[(face, k)]).sum::<f64>()).sum();
            // Each face's shares of the anchors, and the anchors' masses.
            let mut z = DMatrix::from_fn(n, l, |face, k| v[k] * (c[(face, k)] + 0.01 * mean));
            for mut row in z.row_iter_mut() {
                let sum = row.sum();
                row /= sum;
            }
            let masses: Vec<f64> = (0..l).map(|k| (0..n).map(|face| z[(face, k)] * shares[face]).sum()).collect();
            let phi = DMatrix::from_fn(n, l, |face, k| z[(face, k)] / masses[k].sqrt());
            let gram = phi.transpose() * DMatrix::from_diagonal(&DVector::from_vec(shares.clone())) * &phi;
            let (values, vectors) = eigen(&gram);
            // A walk on the anchors: the greatest eigenvalue is 1, its coordinate the same everywhere.
            assert!((values[0] - 1.).abs() < 1e-9, "{name}: {}", values[0]);
            let expected: Vec<_> = (0..5).map(|e| &phi * vectors.column(e) / values[0].sqrt()).collect();
            assert_columns(&format!("{name} {kernel:?}"), &coordinates, &DMatrix::from_columns(&expected));
            let constant = &coordinates[..n];
            assert!(constant.iter().all(|x| (x.abs() - 1.).abs() < 1e-4), "{name}");
        }
    }
}

#[test]
fn chunks_of_any_size_embed_alike_and_unit_rows_have_length_one() {
    let (_, built) = lopsided().swap_remove(0);
    let rows = built.rows(12);
    let columns = SampledColumns::sample(&rows, |face| built.graph.nodes.at(face).area, &Run::new(&())).unwrap();
    for normalisation in [Normalisation::None, Normalisation::Degree, Normalisation::Anchor] {
        for unit_rows in [false, true] {
            let params = EmbeddingParams { normalisation, unit_rows, ..EmbeddingParams::for_parts(5) };
            let embedding = Embedding::fit(&rows, &columns, params).unwrap();
            let (n, d) = (rows.nodes, embedding.dimensions);
            let whole = embedding.columns(&columns);
            for size in [1, 7, 64, n] {
                for start in (0..n).step_by(size) {
                    let m = size.min(n - start);
                    let mut out = vec![0f32; d * m];
                    let mut affinities = vec![0.; rows.len() * m];
                    embedding.chunk(m, |k| &rows.row(k)[start..start + m], &mut affinities, &mut out);
                    for e in 0..d {
                        let expected = &whole[e * n + start..e * n + start + m];
                        assert_eq!(bits(&out[e * m..(e + 1) * m]), bits(expected), "{normalisation:?} {size}");
                    }
                }
            }
            if unit_rows {
                for face in 0..n {
                    let square: f32 = (0..d).map(|e| whole[e * n + face].powi(2)).sum();
                    assert!((square - 1.).abs() < 1e-5, "{normalisation:?}: {square}");
                }
            }
        }
    }
}

#[test]
fn gamma_equals_the_dense_trace() {
    for (name, built) in lopsided() {
        let rows = built.rows(12);
        for kernel in KERNELS {
            for factor in [0.25, 1.] {
                let sigma = factor * rows.mean();
                let (c, a) = affinities(&rows, |d| exact(kernel, sigma, d));
                let landmarks: BTreeSet<usize> = rows.landmarks.iter().map(|&k| k as usize).collect();
                let others: Vec<usize> = (0..rows.nodes).filter(|face| !landmarks.contains(face)).collect();
                let b = DMatrix::from_fn(rows.len(), others.len(), |k, face| c[(others[face], k)]);
                let trace = (b.transpose() * pseudo_inverse(&a, kernel) * &b).trace();
                let gamma = Gamma::new(&rows, kernel, sigma);
                let sum: f64 = (0..rows.nodes)
                    .step_by(100)
                    .map(|start| {
                        let m = 100.min(rows.nodes - start);
                        let mut affinities = vec![0.; rows.len() * m];
                        for (k, out) in affinities.chunks_exact_mut(m).enumerate() {
                            kernel.apply(sigma as f32, &rows.row(k)[start..start + m], out);
                        }
                        gamma.chunk(m, &affinities)
                    })
                    .sum();
                let found = gamma.of_sum(sum);
                assert!((found - trace).abs() < 1e-4 * trace, "{name} {kernel:?} {factor}: {found} {trace}");
            }
        }
    }
}

// ------------------------------------------------------------------------------------------------ SciPy

#[test]
fn rows_agree_with_scipy() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/check_rows.py");
    let importable = std::process::Command::new("python3").args(["-c", "import numpy, scipy"]).output();
    if !importable.is_ok_and(|output| output.status.success()) {
        assert!(std::env::var_os("NYSTROM_STREAM_REQUIRE_SCIPY").is_none(), "no python3 with numpy and scipy");
        eprintln!("skipped: python3 with numpy and scipy is not there");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let mut paths = vec![common::creature(dir.path(), 20_000, false), shapes::dumbbell().write(dir.path())];
    if let Some(data) = common::data() {
        paths.extend(["real/kitten_25k.ply", "nasty/dragon_res4_11k.ply"].map(|name| data.join(name)));
    }
    for (k, mesh) in paths.iter().enumerate() {
        let (work, out) = (dir.path().join(format!("work{k}")), dir.path().join("x.seg"));
        common::segment(
            mesh,
            &["-q", "-k", "4", "--exact", "--work-dir", common::word(&work), "-o", common::word(&out)],
        );
        let output = std::process::Command::new("python3").arg(&script).arg(mesh).arg(&work).output().unwrap();
        let told = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{}: {told}{}", mesh.display(), common::errors(&output));
        eprint!("{told}");
    }
}

// Two numbers that the tests above rely on.
#[test]
fn draws_are_what_the_oracles_take_them_for() {
    let mut draw = stream(0, "x");
    assert!((0..1000).all(|_| (0. ..1.).contains(&unit(&mut draw)) && below(&mut draw, 3) < 3));
}
