//! Where arrays lie changes nothing: held in memory, or in files; a table of half-edge pairs, or a
//! shuffle; triangle adjacency, or the matrix.

use crate::common::oracle;
use nystrom_stream::apps::creature::{Creature, Options};
use nystrom_stream::distance::front::mean_weight;
use nystrom_stream::distance::rows::RowParams;
use nystrom_stream::distance::{DistanceRows, Front};
use nystrom_stream::graph::Csr;
use nystrom_stream::graph::csr::{TriangleAdjacency, WeightedGraph};
use nystrom_stream::graph::{DualGraph, Metric};
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::mesh;
use nystrom_stream::store::{Budget, Context, Run, WorkDir};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// The graph of the mesh at `path` in `work`, and its weights.
fn weighted(path: &Path, work: &WorkDir, run: &Run) -> (DualGraph, WeightedGraph) {
    let (mesh, context) = (mesh::open(path, work.path(), run).unwrap(), Context::new(work, run));
    let graph = DualGraph::build(&mesh, path, &Value::Null, context).unwrap();
    let weights = graph.weighted(Metric::default(), context).unwrap();
    (graph, weights)
}

fn creature(folder: &Path) -> PathBuf {
    let path = folder.join("creature.ply");
    Creature::new(&Options { faces: 60_000, noise: 0.2, ..Options::default() })
        .unwrap()
        .write_ply(&path, &Run::new(&()))
        .unwrap();
    path
}

/// A fan of seven triangles on one edge, a lone triangle, and a strip: rows of no, few and many steps.
fn tangled(folder: &Path) -> PathBuf {
    let mut text = String::from("OFF\n30 16 0\n0 0 0\n0 0 1\n");
    for k in 0..28 {
        let turn = k as f64 * 0.7;
        text += &format!("{} {} {}\n", turn.cos(), turn.sin(), 0.1 * k as f64);
    }
    (0..7).for_each(|k| text += &format!("3 0 1 {}\n", k + 2));
    text += "3 10 11 12\n";
    (0..8).for_each(|k| text += &format!("3 {} {} {}\n", 14 + k, 15 + k, 16 + k));
    let path = folder.join("tangled.off");
    std::fs::write(&path, text).unwrap();
    path
}

/// The graph of `path` under a budget: row starts, neighbours, lengths and weights.
fn graph(path: &Path, budget: u64, holding: bool, folder: &Path) -> (Vec<u64>, Vec<u32>, Vec<f32>, Vec<f32>) {
    let run = Run { budget: Budget::new(budget), ..Run::new(&()) };
    let mut work = WorkDir::temporary(folder).unwrap();
    if holding {
        work = work.holding(&run.budget);
    }
    let (graph, weighted) = weighted(path, &work, &run);
    let csr = weighted.csr();
    // Regression: two of these were files even where all arrays had room, and `plan` told nothing of them.
    for name in ["graph_indices.npy", "graph_centroid_distances.npy", "graph_shared_edge_lengths.npy"] {
        assert_eq!(work.file(name).exists(), !holding, "{name}");
    }
    (csr.starts.plain(), csr.indices.to_vec(), graph.edges.centroid_distance.to_vec(), csr.weights.to_vec())
}

#[test]
fn graphs_are_the_same_in_memory_and_in_files() {
    let dir = tempfile::tempdir().unwrap();
    for path in [creature(dir.path()), tangled(dir.path())] {
        // 4 MiB leave no room for a table of links of the creature.
        let shuffled = graph(&path, 4 << 20, false, dir.path());
        assert!(shuffled == graph(&path, 1 << 30, false, dir.path()), "{}", path.display());
        assert!(shuffled == graph(&path, 1 << 30, true, dir.path()), "{}", path.display());
    }
}

#[test]
fn rows_that_pass_are_the_rows_that_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let path = creature(dir.path());
    let kept_run = Run::new(&());
    let work = WorkDir::open(&dir.path().join("work")).unwrap();
    let (graph, weighted) = weighted(&path, &work, &kept_run);
    let n = graph.nodes.len();
    for sampling in [Sampling::Farthest, Sampling::Random, Sampling::GeodesicFarthest] {
        let params = RowParams { l: 7, sampling };
        let kept = DistanceRows::build(&weighted, graph.nodes.view(), params, Context::new(&work, &kept_run)).unwrap();
        // In memory; in a file of each thread's own; the same with pages, where the graph does not fit either.
        for (threads, budget, holding) in [(1, 1 << 30, true), (2, 1 << 30, true), (2, 1 << 20, false), (3, 1, false)] {
            let run = Run { threads, budget: Budget::new(budget), ..Run::new(&()) };
            let mut passing = WorkDir::temporary(dir.path()).unwrap();
            if holding {
                passing = passing.holding(&run.budget);
            }
            let seen = Mutex::new(vec![Vec::new(); params.l]);
            let look = |row: nystrom_stream::distance::VisitedRow<'_>| {
                assert_eq!(*row.earlier, kept.landmarks[..row.number], "who came before is known");
                let known = std::mem::replace(&mut seen.lock().unwrap()[row.number], row.distances.to_vec());
                assert!(known.is_empty(), "each row passes once");
                Ok(())
            };
            let landmarks =
                DistanceRows::stream_rows(&weighted, graph.nodes.view(), params, &look, Context::new(&passing, &run))
                    .unwrap();
            assert_eq!((&landmarks.nodes, &landmarks.facts), (&kept.landmarks, &kept.facts));
            assert!((0..params.l).all(|k| seen.lock().unwrap()[k] == kept.row(k)), "{sampling:?}, {budget} bytes");
            let left = std::fs::read_dir(passing.path()).unwrap().count();
            assert_eq!(left, 1, "nothing but the lock is left of {n} nodes");
        }
    }
}

#[test]
fn what_a_look_at_a_row_fails_with_ends_the_rows() {
    let dir = tempfile::tempdir().unwrap();
    let run = Run { threads: 2, ..Run::new(&()) };
    let work = WorkDir::temporary(dir.path()).unwrap();
    let (graph, weighted) = weighted(&creature(dir.path()), &work, &run);
    let params = RowParams { l: 9, sampling: Sampling::Farthest };
    let look = |row: nystrom_stream::distance::VisitedRow<'_>| match row.number {
        3 => Err(nystrom_stream::base::Error::parameter("--look", "seen enough", "look away")),
        _ => Ok(()),
    };
    let error =
        DistanceRows::stream_rows(&weighted, graph.nodes.view(), params, &look, Context::new(&work, &run)).unwrap_err();
    assert!(error.to_string().contains("seen enough"), "{error}");
}

#[test]
fn an_array_that_does_not_fit_becomes_a_file_and_is_given_up_alike() {
    let dir = tempfile::tempdir().unwrap();
    let budget = Budget::new(10_000);
    let work = WorkDir::temporary(dir.path()).unwrap().holding(&budget);
    for (name, items, held) in [("small.npy", 1000usize, true), ("large.npy", 2000, false)] {
        let mut array = work.array::<u32>(name, &[items]).unwrap();
        array.data().fill(7);
        let finished = array.finish(false).unwrap();
        assert_eq!((finished.len(), finished[items - 1], work.file(name).exists()), (items, 7, !held));
        assert_eq!(work.open_array::<u32>(name).unwrap()[..], finished[..]);
    }
    let left = budget.left();
    work.remove("small.npy");
    assert_eq!(budget.left(), left + 4000, "the budget has its bytes back");
    assert!(work.open_array::<u32>("small.npy").is_err());
}

/// An array may become longer than was announced: in memory while there is room, then in a file.
#[test]
fn arrays_may_outgrow_what_was_announced() {
    let dir = tempfile::tempdir().unwrap();
    let work = WorkDir::temporary(dir.path()).unwrap().holding(&Budget::new(8 << 20));
    for (name, more, held) in [("longer.npy", 2, true), ("longest.npy", 3 << 20, false)] {
        let mut writer = work.writer_of::<f32>(name, 1, 4).unwrap();
        writer.push(&[1., 2., 3.]).unwrap();
        let rest: Vec<f32> = (0..more).map(|k| 4. + k as f32).collect();
        writer.push(&rest).unwrap();
        let finished = writer.finish(false).unwrap();
        assert_eq!((&finished[..3], &finished[3..], work.file(name).exists()), (&[1., 2., 3.][..], &rest[..], !held));
    }
}

#[test]
fn fronts_over_triangle_adjacency_give_the_same_distances() {
    let dir = tempfile::tempdir().unwrap();
    let run = Run::new(&());
    for path in [creature(dir.path()), tangled(dir.path())] {
        let work = WorkDir::temporary(dir.path()).unwrap();
        let (_graph, weighted) = weighted(&path, &work, &run);
        let triangles = TriangleAdjacency::of(weighted.csr(), &run).unwrap().unwrap();
        let csr = Csr { triangles: triangles.all(), ..weighted.csr() };
        let mut front = Front::new(mean_weight(csr));
        for source in [0, csr.len() as u32 / 2, csr.len() as u32 - 1] {
            let mut field = vec![0.; csr.len()];
            front.full(csr, source, &mut field, &run.cancel).unwrap();
            assert!(field == oracle::dijkstra(weighted.csr(), source), "{} from {source}", path.display());
        }
    }
    let none = Run { budget: Budget::new(1 << 10), ..Run::new(&()) };
    let work = WorkDir::temporary(dir.path()).unwrap();
    let (_graph, weighted) = weighted(&creature(dir.path()), &work, &run);
    assert!(TriangleAdjacency::of(weighted.csr(), &none).unwrap().is_none());
}
