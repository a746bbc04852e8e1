//! Patches tell clean surfaces from rough ones.

use nystrom_stream::apps::creature::{Creature, Options};
use nystrom_stream::cluster::area_shares::AreaShares;
use nystrom_stream::cluster::roughness::{is_clearly_clean, is_likely_rough, sampled_turning};
use nystrom_stream::graph::DualGraph;
use nystrom_stream::mesh::{self, Mesh};
use nystrom_stream::store::{Context, Run, WorkDir};
use serde_json::Value;

/// Sampled turning of a creature.
fn sample(options: Options, threads: usize) -> [f64; 2] {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("creature.ply");
    let run = Run { threads, ..Run::new(&()) };
    Creature::new(&options).unwrap().write_ply(&path, &run).unwrap();
    let work = WorkDir::temporary(folder.path()).unwrap();
    let context = Context::new(&work, &run);
    let mesh = mesh::open(&path, work.path(), &run).unwrap();
    let graph = DualGraph::build(&mesh, &path, &Value::Null, context).unwrap();
    sampled_turning(&graph, &AreaShares::of(&graph, context).unwrap(), &run).unwrap().unwrap()
}

#[test]
fn patches_tell_clean_from_rough_in_any_order_of_faces() {
    let of = |noise, shuffle| Options { faces: 120_000, noise, shuffle, ..Options::default() };
    let clean = sample(of(0., false), 2);
    assert!(is_clearly_clean(clean) && !is_likely_rough(clean), "{clean:?}");
    assert_eq!(clean, sample(of(0., false), 1));
    let shuffled = sample(of(0., true), 2);
    assert!(is_clearly_clean(shuffled), "{shuffled:?}");
    let rough = sample(of(0.3, false), 2);
    assert!(is_likely_rough(rough) && !is_clearly_clean(rough), "{rough:?}");
    // What is smoothed has none of the noise.
    assert!(rough[0] > 5. * clean[0] && rough[1] < 2. * clean[1], "{clean:?} {rough:?}");
}

/// Sampled turning of a square of 200 × 200 vertices, 190 × 190 of which lie in a corner of .005; `bumps` high.
fn crowded(bumps: f64) -> Option<[f64; 2]> {
    const SIDE: u32 = 200;
    let at = |i: u32| if i < 190 { 0.005 / 190. * f64::from(i) } else { 0.005 + 0.0995 * f64::from(i - 189) };
    let point = |k: u32| [at(k / SIDE), at(k % SIDE), bumps * f64::from(k * k % 7)];
    let quad = |k: u32| [[k, k + SIDE, k + SIDE + 1], [k, k + SIDE + 1, k + 1]];
    let corners = (0..SIDE * (SIDE - 1)).filter(|k| k % SIDE < SIDE - 1);
    let mesh = Mesh::from_vecs((0..SIDE * SIDE).map(point).collect(), corners.flat_map(quad).collect()).unwrap();
    let (folder, run) = (tempfile::tempdir().unwrap(), Run::new(&()));
    let work = WorkDir::temporary(folder.path()).unwrap();
    let context = Context::new(&work, &run);
    let graph = DualGraph::build(&mesh, "a square".as_ref(), &Value::Null, context).unwrap();
    sampled_turning(&graph, &AreaShares::of(&graph, context).unwrap(), &run).unwrap()
}

/// Regression: each of 48 discs gathered nearly all faces, which took 48 times as long and a list of them per thread.
#[test]
fn a_mesh_with_nearly_all_faces_in_one_place_is_not_judged_by_patches() {
    assert_eq!(crowded(1e-5), None);
    // What does not turn is clean however many faces there are.
    assert!(crowded(0.).is_some_and(is_clearly_clean));
}
