//! Patches tell clean surfaces from rough ones.

use nystrom_stream::apps::creature::{Creature, Options};
use nystrom_stream::cluster::area_shares::AreaShares;
use nystrom_stream::cluster::roughness::{is_clearly_clean, is_likely_rough, sampled_turning};
use nystrom_stream::graph::DualGraph;
use nystrom_stream::mesh;
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
    sampled_turning(&graph, &AreaShares::of(&graph, context).unwrap(), &run).unwrap()
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
