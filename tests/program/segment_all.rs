//! Every test mesh through the program: labels, colours and report come out right, or it is refused in one line.

use crate::common;
use nystrom_stream::mesh::{self, Mesh};
use nystrom_stream::store::{Run, npy};
use ply_rs_bw::ply::{DefaultElement, Property};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// Meshes whose labels another reader confirmed.
static READ_BY_ANOTHER: AtomicUsize = AtomicUsize::new(0);

/// A line of the list of test meshes.
struct Listed {
    name: String,
    vertices: Option<u64>,
    triangles: Option<u64>,
    components: Option<u64>,
    remark: String,
}

fn listed(folder: &str) -> Vec<Listed> {
    let text = std::fs::read_to_string(common::packed().join("MANIFEST.tsv")).unwrap();
    let lines = text.lines().skip(1).map(|line| {
        let columns: Vec<&str> = line.split('\t').collect();
        Listed {
            name: columns[0].trim_end_matches(".xz").to_owned(),
            vertices: columns[1].parse().ok(),
            triangles: columns[2].parse().ok(),
            components: columns[4].parse().ok(),
            remark: columns[columns.len() - 1].to_owned(),
        }
    });
    lines.filter(|listed| listed.name.starts_with(folder)).collect()
}

/// Pairs of faces that share an edge by vertex numbers, each once.
fn touching(mesh: &Mesh) -> Vec<(u32, u32)> {
    let mut edges: Vec<(u32, u32, u32)> = Vec::with_capacity(mesh.faces.corner_count());
    mesh.faces.for_each(0..mesh.faces.len(), |face, corners| {
        for (slot, &a) in corners.iter().enumerate() {
            let b = corners[(slot + 1) % corners.len()];
            if a != b {
                edges.push((a.min(b), a.max(b), face as u32));
            }
        }
    });
    edges.sort_unstable();
    edges.windows(2).filter(|w| (w[0].0, w[0].1) == (w[1].0, w[1].1)).map(|w| (w[0].2, w[1].2)).collect()
}

/// Area of every face in `f64`, and NaN-free.
fn areas(mesh: &Mesh) -> Vec<f64> {
    let mut areas = Vec::new();
    mesh.faces.for_each(0..mesh.faces.len(), |_, corners| {
        let p: Vec<[f64; 3]> = corners.iter().map(|&v| mesh.positions.get(v)).collect();
        let mut normal = [0f64; 3];
        for k in 1..p.len().max(1) - 1 {
            let (u, v) = ([0, 1, 2].map(|a| p[k][a] - p[0][a]), [0, 1, 2].map(|a| p[k + 1][a] - p[0][a]));
            for a in 0..3 {
                normal[a] += u[(a + 1) % 3] * v[(a + 2) % 3] - u[(a + 2) % 3] * v[(a + 1) % 3];
            }
        }
        let area = normal.iter().map(|x| x * x).sum::<f64>().sqrt() / 2.;
        areas.push(if area.is_finite() { area } else { 0. });
    });
    areas
}

/// Labels, colours and qualities of a labelled PLY as another reader sees them; `None` where that reader is too
/// strict for the file.
fn labelled(path: &Path) -> Option<Vec<(u32, [u8; 3], f32)>> {
    let faces = common::reference(path)?.payload.swap_remove("face")?;
    let byte = |property: &Property| if let Property::UChar(x) = property { *x } else { panic!("{property:?}") };
    let read = |face: &DefaultElement| {
        let (Property::Int(label), Property::Float(quality)) = (&face["label"], &face["quality"]) else {
            panic!("{:?} {:?}", face["label"], face["quality"])
        };
        (*label as u32, ["red", "green", "blue"].map(|name| byte(&face[name])), *quality)
    };
    Some(faces.iter().map(read).collect())
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

/// Segments one mesh of the list, `how` being what else is asked for, and checks all that comes out.
fn check(path: &Path, listed: &Listed, how: &[&str]) {
    let name = &format!("{} {how:?}", listed.name);
    let folder = || if is_large(path) { tempfile::tempdir().unwrap() } else { common::in_memory() };
    let dir = folder();
    let file = |name: &str| dir.path().join(name);
    let run = Run::new(&());
    let opened = match mesh::open(path, dir.path(), &run) {
        Ok(opened) => opened,
        Err(refusal) => return refused(path, listed, &refusal.to_string()),
    };
    let mesh = &opened;
    let n = mesh.faces.len();
    let parts = 7.min(n);
    let l = if n > 200_000 { "5" } else { "9" };
    let (ply, seg, report, work) = (file("out.ply"), file("out.seg"), file("report.json"), file("work"));
    let json = format!("--json={}", report.display());
    let outputs = ["-o", common::word(&ply), "-o", common::word(&seg), &json, "--work-dir", common::word(&work)];
    let k = parts.to_string();
    let kmeans = how.contains(&"kmeans");
    let output = common::segment(path, &[&["-q", "-k", &k, "-l", l][..], how, &outputs[..]].concat());
    assert!(output.stdout.is_empty() && output.stderr.is_empty(), "{name}: {}", common::errors(&output));

    // Labels: exactly K parts, a label a face, the same everywhere.
    let labels = mesh::read_seg(&seg).unwrap();
    assert_eq!(labels.len(), n, "{name}");
    assert_eq!(labels.iter().collect::<BTreeSet<_>>().len(), parts, "{name}");
    assert_eq!(*npy::open::<u32>(&work.join("labels.npy")).unwrap(), labels[..], "{name}");
    let quality = npy::open::<f32>(&work.join("quality.npy")).unwrap();
    assert!(quality.len() == n && quality.iter().all(|q| (0. ..=1.).contains(q)), "{name}");

    // The report.
    let report: Value = serde_json::from_str(&std::fs::read_to_string(report).unwrap()).unwrap();
    let input = &report["input"];
    let count = |key: &str| input[key].as_u64().unwrap_or_else(|| panic!("{name}: {key} in {input}"));
    assert_eq!(count("faces"), n as u64, "{name}");
    assert_eq!(count("vertices"), mesh.positions.len() as u64, "{name}");
    let mut triangles = 0;
    mesh.faces.for_each(0..n, |_, corners| triangles += corners.len() as u64 - 2.min(corners.len() as u64));
    assert!(listed.vertices.is_none_or(|vertices| vertices == count("vertices")), "{name}");
    assert!(listed.triangles.is_none_or(|faces| faces == triangles), "{name}");
    // Without the flaps, what hung on them is on its own.
    let duplicates = count("duplicate_faces");
    assert!(listed.components.is_none_or(|all| duplicates > 0 || count("components") <= all), "{name}: {input}");
    check_remark(name, &listed.remark, input, triangles == n as u64);
    for key in ["version", "options", "landmarks", "sigma", "dropped_eigenpairs", "negative_mass", "notes"] {
        assert!(!report[key].is_null(), "{name}: {key}");
    }
    assert!(!kmeans || report["gamma"].as_f64().unwrap() > 0. || n <= 9, "{name}: {}", report["gamma"]);
    // What was not computed is not told.
    assert_eq!(report.get("gamma").is_some(), kmeans, "{name}");
    if let (Some(gamma), Some(per_face)) = (report["gamma"].as_f64(), report["gamma_per_face"].as_f64()) {
        let contracted = n > 60_000 && !how.contains(&"--exact");
        let nodes = if gamma.abs() > 1e-9 { gamma / per_face } else { n as f64 };
        let found = if contracted { (20_000. ..40_000.).contains(&nodes) } else { (nodes - n as f64).abs() < 1e-3 };
        assert!(found, "{name}: Γ over {nodes} nodes of {n} faces");
    }
    let landmarks = numbers(&report["landmarks"]);
    assert!(landmarks.len() == n.min(l.parse().unwrap()) && landmarks.iter().all(|&f| f < n as f64), "{name}");
    assert_eq!(numbers(&report["eigenvalues"]).len(), landmarks.len(), "{name}");
    let last = if kmeans { "assign" } else { "boundaries" };
    for key in ["read", "graph", "weights", "rows", last, "write", "total"] {
        assert!(report["seconds"][key].as_f64().unwrap() >= 0., "{name}: {key}");
    }
    for key in ["peak_allocated", "budget", "work_dir"] {
        assert!(report["bytes"][key].as_u64().unwrap() > 0, "{name}: {key}");
    }

    // The parts.
    let areas = areas(mesh);
    let mut sums = vec![(0u64, 0f64); parts];
    for (&label, area) in labels.iter().zip(&areas) {
        sums[label as usize].0 += 1;
        sums[label as usize].1 += area;
    }
    let total: f64 = areas.iter().sum();
    let mut colours = BTreeMap::new();
    let listed_parts = report["parts"].as_array().unwrap();
    assert_eq!(listed_parts.len(), parts, "{name}");
    for (label, (part, (faces, area))) in listed_parts.iter().zip(sums).enumerate() {
        assert_eq!((part["label"].as_u64(), part["faces"].as_u64()), (Some(label as u64), Some(faces)), "{name}");
        let told = part["area"].as_f64().unwrap();
        let slack = 1e-4 * total + 1e-30;
        let is_right = if duplicates > 0 { told <= area + slack } else { (told - area).abs() <= slack };
        assert!(is_right, "{name}: area {told} instead of {area}");
        colours.insert(label as u32, numbers(&part["colour"]));
    }
    for (a, b) in touching(mesh) {
        let (a, b) = (labels[a as usize], labels[b as usize]);
        assert!(a == b || colours[&a] != colours[&b], "{name}: parts {a} and {b} touch and look the same");
    }

    // The labelled mesh: the same faces, and what another reader finds on them.
    let scratch = folder();
    let again = mesh::open(&ply, scratch.path(), &run).unwrap();
    assert_eq!((again.positions.len(), again.faces.len()), (mesh.positions.len(), n), "{name}");
    if n < 20_000
        && let Some(faces) = labelled(&ply)
    {
        READ_BY_ANOTHER.fetch_add(1, Relaxed);
        assert_eq!(faces.len(), n, "{name}");
        for (face, (label, colour, q)) in faces.into_iter().enumerate() {
            assert_eq!((label, q), (labels[face], quality[face]), "{name}: face {face}");
            assert_eq!(colour.map(f64::from).to_vec(), colours[&label], "{name}: face {face}");
        }
    }
}

/// Compares with what the list says of a mesh's edges, where it counted the same mesh.
fn check_remark(name: &str, remark: &str, input: &Value, only_triangles: bool) {
    let listed = |key: &str| -> Option<u64> {
        let rest = &remark[remark.find(key)? + key.len()..];
        rest[..rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len())].parse().ok()
    };
    let count = |key: &str| input[key].as_u64().unwrap();
    if !only_triangles || remark.contains("polygons") || remark.contains("converted") {
        return;
    }
    if let Some(open) = listed("bnd=") {
        assert_eq!(count("boundary_edges") + count("welded_edges"), open, "{name}: {input}");
    }
    if let Some(shared) = listed("nonman=") {
        assert!(count("nonmanifold_edges") >= shared, "{name}: {input}");
        assert!(count("nonmanifold_edges") == shared || count("welded_edges") > 0, "{name}: {input}");
    }
}

/// A mesh that the library refuses is refused by the program: code 1, one line, nothing left behind.
fn refused(path: &Path, listed: &Listed, refusal: &str) {
    let name = &listed.name;
    let promised = listed.remark.contains("should: same") || listed.triangles.is_some_and(|faces| faces > 0);
    assert!(!promised, "{name}: refused: {refusal}");
    let dir = tempfile::tempdir().unwrap();
    let output =
        common::run(&["segment", common::word(path), "-k", "2", "-q", "-o", common::word(&dir.path().join("x.ply"))]);
    let message = common::errors(&output);
    assert_eq!(output.status.code(), Some(1), "{name}: {message}");
    assert_eq!(message, format!("nystrom-stream: {refusal}\n"), "{name}");
    assert_eq!(message.lines().count(), 1, "{name}: {message}");
    assert!(message.contains(path.file_name().unwrap().to_str().unwrap()) && message.contains("; "), "{message}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0, "{name}");
}

fn is_large(path: &Path) -> bool {
    std::fs::metadata(path).unwrap().len() > 10_000_000
}

fn check_folder(folder: &str, expected: usize) {
    let Some(data) = common::data() else { return };
    let all: Vec<(PathBuf, Listed)> = listed(folder).into_iter().map(|one| (data.join(&one.name), one)).collect();
    assert!(all.len() >= expected, "{folder}: {} meshes", all.len());
    // Files are read alike for both methods, so K-means has one in five of them. The five largest scans, which are opened by other
    // tests too, are left out as well, unless every case is asked for.
    let stride = common::stride(5);
    let too_large = |path: &Path| !common::every_case() && std::fs::metadata(path).unwrap().len() > 5_000_000;
    for (k, (path, listed)) in all.iter().enumerate().filter(|(_, (path, _))| !too_large(path)) {
        check(path, listed, &[]);
        if k % stride == 0 {
            check(path, listed, &["--cluster", "kmeans"]);
        }
    }
}

#[test]
fn measured_shapes() {
    check_folder("real/", 14);
}

#[test]
fn every_flavour() {
    check_folder("flavour/", 70);
    let confirmed = READ_BY_ANOTHER.load(Relaxed);
    assert!(common::data().is_none() || confirmed > 30, "{confirmed}");
}

#[test]
fn nasty_meshes() {
    check_folder("nasty/", 20);
}

#[test]
fn poses() {
    check_folder("corr/", 10);
}
