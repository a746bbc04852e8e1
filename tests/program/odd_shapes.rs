//! Small meshes, plain and odd: exactly K parts and finite numbers, by the library and by the program.

use crate::common;
use crate::common::shapes::{self, Shape};
use nystrom_stream::cluster::parts::{PartCount, PartsParams};
use nystrom_stream::graph::Metric;
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::mesh;
use nystrom_stream::pipeline::{Cluster, SegmentParams, input, segment};
use nystrom_stream::spectral::embedding::KernelWidth;
use nystrom_stream::spectral::{EmbeddingParams, Kernel, Normalisation};
use nystrom_stream::store::{Context, Run, WorkDir};
use std::path::Path;

/// Exactly `parts` parts.
fn exactly(parts: usize) -> PartsParams {
    PartsParams { count: PartCount::Exactly(parts), ..PartsParams::default() }
}

/// Segments by the library in a folder of its own; everything that comes out is checked.
fn check(shape: &Shape, path: &Path, params: SegmentParams) {
    check_in(common::in_memory().path(), shape, path, params);
}

fn check_in(folder: &Path, shape: &Shape, path: &Path, params: SegmentParams) {
    let run = Run { threads: 2, ..Run::new(&()) };
    // One that lasts: a temporary one gives up the weights, which are looked at below.
    let work = WorkDir::open(&folder.join("work")).unwrap();
    let opened = mesh::open(path, work.path(), &run).unwrap();
    let told = format!("{} {params:?}", shape.name);
    let result = segment(&opened, &input::identity(path).unwrap(), &params, Context::new(&work, &run))
        .unwrap_or_else(|error| panic!("{told}: {error}"));
    let (n, found) = (shape.faces.len(), result.numbers.faces.len());
    let parts = match params.parts.count {
        PartCount::Exactly(parts) => parts,
        PartCount::Between(least, most) => found.clamp(least.min(n), most),
        PartCount::Found => found,
    };
    assert_eq!((result.labels.len(), result.quality.len()), (n, n), "{told}");
    let mut faces = vec![0u64; parts];
    result.labels.iter().for_each(|&label| faces[label as usize] += 1);
    assert!(faces.iter().all(|&count| count > 0), "{told}: {faces:?}");
    assert_eq!(faces, result.numbers.faces, "{told}");
    assert!(result.quality.iter().all(|q| (0. ..=1.).contains(q)), "{told}");
    assert!(result.numbers.area.iter().all(|a| a.is_finite() && *a >= 0.), "{told}: {:?}", result.numbers.area);
    let numbers = &result.numbers;
    assert!(numbers.eigenvalues.iter().all(|x| x.is_finite()), "{told}: {:?}", numbers.eigenvalues);
    assert!(numbers.sigma.is_finite() && numbers.gamma.is_finite(), "{told}: {} {}", numbers.sigma, numbers.gamma);
    let distinct: std::collections::BTreeSet<_> = numbers.landmarks.iter().collect();
    assert_eq!(distinct.len(), numbers.landmarks.len(), "{told}: landmarks twice");
    // Of meshes of long triangles, rows are in a nested directory.
    let inner = work.all_inner().unwrap();
    for name in ["distances.npy", "graph_weights.npy"] {
        let holding: Vec<&WorkDir> = std::iter::once(&work)
            .chain(inner.values().map(|inner| &**inner))
            .filter(|work| work.holds(name))
            .collect();
        assert!(!holding.is_empty(), "{told}: {name}");
        for work in holding {
            let values = work.open_array::<f32>(name).unwrap();
            assert!(values.iter().all(|x| x.is_finite() && *x >= 0.), "{told}: {name}");
        }
    }
}

#[test]
fn every_shape_falls_into_exactly_k_parts() {
    let dir = common::in_memory();
    for (turn, shape) in shapes::all().into_iter().enumerate() {
        let path = shape.write(dir.path());
        let n = shape.faces.len();
        for (k, parts) in [1, 2, 3, 7, n.min(40)].into_iter().filter(|&parts| parts <= n).enumerate() {
            // Of the two methods one after the other, by turns that differ from shape to shape.
            let both = [Cluster::KMeans, Cluster::TwoMeans];
            for cluster in both.into_iter().skip((k + turn) % common::stride(2)).step_by(common::stride(2)) {
                check(&shape, &path, SegmentParams::default().parts(exactly(parts)).cluster(cluster));
            }
        }
    }
}

#[test]
fn every_shape_falls_into_the_parts_that_are_found_or_asked_for() {
    let dir = common::in_memory();
    for shape in shapes::all() {
        let path = shape.write(dir.path());
        let n = shape.faces.len();
        // One hierarchy for all, which takes most of the time, or one for each.
        let work = common::in_memory();
        check_in(work.path(), &shape, &path, SegmentParams::default());
        for count in [PartCount::Exactly(n.min(5)), PartCount::Exactly(n.min(40)), PartCount::Between(1, 3)] {
            let parts = PartsParams { count, ..PartsParams::default() };
            let other = common::every_case().then(common::in_memory);
            let folder = other.as_ref().unwrap_or(&work).path();
            check_in(folder, &shape, &path, SegmentParams::default().parts(parts));
        }
    }
}

#[test]
fn every_option_suits_every_shape() {
    let dir = common::in_memory();
    let kernels =
        [Kernel::Gaussian, Kernel::Exponential, Kernel::Polynomial { degree: 3 }, Kernel::InverseMultiquadric];
    let normalisations = [Normalisation::None, Normalisation::Degree, Normalisation::Anchor];
    let metrics = [Metric::default(), Metric::paper(), Metric::Geodesic];
    for (turn, shape) in shapes::all().iter().enumerate() {
        let path = shape.write(dir.path());
        let parts = 3.min(shape.faces.len());
        for (k, kernel) in kernels.into_iter().enumerate() {
            for (j, normalisation) in normalisations.into_iter().enumerate() {
                // Five shares no factor with the cycles of options below, of two, three and four.
                if (12 * turn + 3 * k + j) % common::stride(5) != 0 {
                    continue;
                }
                let embedding = EmbeddingParams {
                    kernel,
                    normalisation,
                    width: KernelWidth::Mean([0.25, 1., 1e-18, 1e5][(k + j) % 4]),
                    unit_rows: (k + j + turn) % 2 == 0,
                    ..EmbeddingParams::for_parts(parts)
                };
                let params = SegmentParams::default()
                    .parts(exactly(parts))
                    .cluster(Cluster::KMeans)
                    .landmarks(Some([1, 4, 100][(j + turn) % 3]))
                    .sampling(Some(if (k + turn) % 2 == 0 { Sampling::Random } else { Sampling::Farthest }))
                    .metric(metrics[(k + j + turn) % 3])
                    .embedding(Some(embedding));
                check(shape, &path, params);
            }
        }
    }
}

#[test]
fn the_program_agrees() {
    let dir = common::in_memory();
    for shape in shapes::all() {
        let path = shape.write(dir.path());
        let parts = 4.min(shape.faces.len());
        let output = common::segment(&path, &["-q", "-k", &parts.to_string(), "--json"]);
        let told = shape.name;
        assert!(output.stderr.is_empty(), "{told}: {}", common::errors(&output));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let listed = report["parts"].as_array().unwrap();
        assert_eq!(listed.len(), parts, "{told}");
        let faces: u64 = listed.iter().map(|part| part["faces"].as_u64().unwrap()).sum();
        assert_eq!(faces, shape.faces.len() as u64, "{told}");
        assert_eq!(report["input"]["faces"], shape.faces.len(), "{told}");
        assert_eq!(report["input"]["vertices"], shape.vertices.len(), "{told}");
        // The labelled mesh opens again with the same faces.
        let labelled = dir.path().join(format!("{told}.segmented.ply"));
        let run = Run::new(&());
        let opened = mesh::open(&labelled, dir.path(), &run).unwrap();
        assert_eq!(opened.faces.len(), shape.faces.len(), "{told}");
    }
}

#[test]
fn the_report_counts_what_is_there() {
    let dir = common::in_memory();
    let report = |shape: &Shape| -> serde_json::Value {
        let path = shape.write(dir.path());
        let output = common::segment(&path, &["-q", "-k", "1", "--json"]);
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap()["input"].take()
    };
    let of = |name: &str| shapes::all().into_iter().find(|shape| shape.name == name).unwrap();
    let columns = ["components", "boundary_edges", "nonmanifold_edges", "degenerate_faces", "welded_edges"];
    for (name, expected) in [
        ("tetrahedron", [1, 0, 0, 0, 0]),
        ("grid", [1, 32, 0, 0, 0]),
        ("single", [1, 3, 0, 0, 0]),
        ("pillow", [1, 0, 0, 0, 0]),
        // Three of its four faces are duplicates of the first, which is open.
        ("duplicates", [1, 3, 0, 0, 0]),
        ("three_on_an_edge", [1, 6, 1, 0, 0]),
        ("two_components", [2, 16, 0, 0, 0]),
        ("moebius", [1, 48, 0, 0, 0]),
        ("soup", [1, 0, 0, 0, 3 * of("soup").faces.len()]),
        ("all_nan", [1, 12, 0, 18, 0]),
        ("book", [1, 200, 1, 0, 0]),
        ("unreferenced", [1, 0, 0, 0, 0]),
        ("dust", [1000, 3000, 0, 0, 0]),
        ("a_speck", [2, 0, 0, 0, 0]),
        ("huge", [1, 0, 0, 0, 0]),
        ("beyond_float", [1, 0, 0, 0, 0]),
        ("as_far_as_doubles_go", [1, 0, 0, 0, 0]),
        ("tiny", [1, 0, 0, 0, 0]),
        ("subnormal", [1, 0, 0, 0, 0]),
        ("far_off", [1, 0, 0, 0, 0]),
    ] {
        let input = report(&of(name));
        for (column, expected) in columns.iter().zip(expected) {
            assert_eq!(input[column], expected, "{name}: {column} in {input}");
        }
    }
}

#[test]
fn the_unit_of_length_does_not_matter() {
    let dir = common::in_memory();
    let labels = |shape: &Shape| {
        let (path, labels) = (shape.write(dir.path()), dir.path().join("labels.seg"));
        common::segment(&path, &["-q", "-k", "3", "-o", common::word(&labels)]);
        std::fs::read(labels).unwrap()
    };
    let expected = labels(&shapes::dumbbell());
    for exponent in [-1000, -100, 1, 100, 1020] {
        // A power of two changes no digit.
        let mut shape = shapes::dumbbell();
        shape.vertices.iter_mut().flatten().for_each(|x| *x *= 2f64.powi(exponent));
        assert_eq!(labels(&shape), expected, "2^{exponent}");
    }
}
