//! K-means and 2-means on the contraction of a large mesh: as good as with rows over all faces,
//! the same bytes in any run.

use crate::common;
use nystrom_stream::apps::creature::{Creature, Options};
use nystrom_stream::apps::evaluate::{contingency, rand};
use nystrom_stream::base::RunLog;
use nystrom_stream::cluster::parts::{PartCount, PartsParams};
use nystrom_stream::mesh::{self, Mesh};
use nystrom_stream::pipeline::report::Report;
use nystrom_stream::pipeline::{Cluster, SegmentParams, SegmentedMesh, segment};
use nystrom_stream::store::{Budget, Context, Run, WorkDir};
use serde_json::json;
use std::path::Path;

fn params(cluster: Cluster, parts: usize) -> SegmentParams {
    let count = PartCount::Exactly(parts);
    SegmentParams::default().cluster(cluster).parts(PartsParams { count, ..PartsParams::default() })
}

fn cut(mesh: &Mesh, params: &SegmentParams, run: &Run, folder: &Path) -> SegmentedMesh {
    let work = WorkDir::temporary(folder).unwrap();
    let result = segment(mesh, &json!(1), params, Context::new(&work, run)).unwrap();
    // The parts are told as they are: every face once, every area.
    let mut faces = vec![0; result.numbers.faces.len()];
    result.labels.iter().for_each(|&label| faces[label as usize] += 1);
    assert_eq!(faces, result.numbers.faces);
    let area: f64 = result.numbers.area.iter().sum();
    assert!((area / result.graph.area - 1.).abs() < 1e-4, "{area}, {}", result.graph.area);
    result
}

#[test]
fn parts_are_those_of_the_creature() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("creature.ply");
    let run = Run { threads: 2, ..Run::new(&()) };
    let creature = Creature::new(&Options { faces: 100_000, ..Options::default() }).unwrap();
    creature.write_ply(&path, &run).unwrap();
    let truth: Vec<u32> = (0..creature.face_count()).map(|face| creature.truth(face)).collect();
    let mesh = mesh::open(&path, folder.path(), &run).unwrap();
    for cluster in [Cluster::KMeans, Cluster::TwoMeans] {
        let params = params(cluster, 10);
        let found = cut(&mesh, &params, &run, folder.path());
        assert_eq!((found.colours.len(), found.numbers.landmarks.len()), (10, 60));
        let apart = |labels: &[u32], others: &[u32]| rand(&contingency(labels, others, None).unwrap());
        let exact = cut(&mesh, &params.clone().exact(true), &run, folder.path());
        assert_eq!(exact.numbers.landmarks.len(), 20);
        let (own, its) = (apart(&found.labels, &truth), apart(&exact.labels, &truth));
        assert!(own < its + 0.01 && own < 0.05, "{cluster:?}: {own}, with rows over all faces {its}");
        for (threads, budget) in [(1, 1 << 30), (3, 6 << 20)] {
            let other = Run { threads, budget: Budget::new(budget), ..Run::new(&()) };
            let again = cut(&mesh, &params, &other, folder.path());
            assert!(again.labels[..] == found.labels[..] && again.quality[..] == found.quality[..], "{threads}");
            assert_eq!(again.numbers, found.numbers, "{threads} threads, {budget} bytes");
        }
    }
}

/// Regression: Γ over the contraction was divided by the faces of the file, and fell as a mesh was subdivided.
#[test]
fn quality_of_a_sample_does_not_depend_on_the_tessellation() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run { threads: 2, ..Run::new(&()) };
    let per_face = [62_000, 180_000].map(|faces| {
        let path = common::creature(folder.path(), faces, false);
        let mesh = mesh::open(&path, folder.path(), &run).unwrap();
        let params = params(Cluster::KMeans, 6);
        let work = WorkDir::temporary(folder.path()).unwrap();
        let context = Context::new(&work, &run);
        let result = segment(&mesh, &json!(1), &params, context).unwrap();
        Report::new(&path, &params, &result, context, &RunLog::default(), None).unwrap().gamma_per_face.unwrap()
    });
    assert!((per_face[0] / per_face[1] - 1.).abs() < 0.1, "{per_face:?}");
}

#[test]
fn more_parts_than_a_contraction_can_have_are_found_among_the_faces() {
    let folder = tempfile::tempdir().unwrap();
    let path = common::creature(folder.path(), 62_000, false);
    let run = Run { threads: 2, ..Run::new(&()) };
    let mesh = mesh::open(&path, folder.path(), &run).unwrap();
    for (parts, landmarks) in [(1_000, 512), (1_001, 512)] {
        let params = params(Cluster::KMeans, parts);
        assert_eq!(params.contracts(mesh.faces.len()), parts == 1_000);
        assert_eq!(params.landmarks_of(mesh.faces.len()), landmarks);
    }
    // Few landmarks: with many, most of the time is K-means among as many parts.
    let params = params(Cluster::KMeans, 1_001).landmarks(Some(6));
    assert_eq!(cut(&mesh, &params, &run, folder.path()).colours.len(), 1_001);
}
