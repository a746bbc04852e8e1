//! `sequence`: orders are permutations that the output carries out and nothing else, measures are what their definitions
//! say, and spectral orders are as narrow as promised.

use crate::common::{self, assert_rearranged, creature, errors, ok, program, reference, run, shapes, word};
use nystrom_stream::apps::sequence::{SequenceOrder, StreamMeasures, VertexUse, places};
use nystrom_stream::mesh::ply::rearranged::{self, Rearrangement};
use nystrom_stream::mesh::{self, PlyForm};
use nystrom_stream::pipeline::sequence::{SequenceParams, Sequencer};
use nystrom_stream::store::Context;
use nystrom_stream::store::{Budget, Run, WorkDir};
use ply_rs_bw::ply::Property;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::Path;

fn permutation(n: usize, factor: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..n as u32).collect();
    order.sort_by_key(|&i| (i as usize * factor) % 10_007);
    order
}

/// Compares every value but corners, record by record, as the reference reader sees them.
fn assert_kept(name: &str, before: &Path, after: &Path, face: &str, places: &[u32], numbers: &[u32]) {
    let (Some(before), Some(after)) = (reference(before), reference(after)) else { return };
    let same = |a: &Property, b: &Property| format!("{a:?}") == format!("{b:?}") || format!("{a:?}").contains("NaN");
    for (element, records) in &before.payload {
        let order = match element.as_str() {
            _ if element == face => Some(places),
            "vertex" => Some(numbers),
            _ => None,
        };
        for (i, record) in records.iter().enumerate() {
            let j = order.map_or(i, |order| order[i] as usize);
            let other = &after.payload[element][j];
            for (property, value) in record {
                if property.starts_with("vertex") && (element == face || element == "edge") {
                    continue;
                }
                assert!(same(value, &other[property]), "{name}: {element} {i}: {property}");
            }
            let told = match element.as_str() {
                _ if element == face => other.get("original_face"),
                "vertex" => other.get("original_vertex"),
                _ => continue,
            };
            assert!(matches!(told, Some(Property::UInt(old)) if *old as usize == i), "{name}: {element} {i}: {told:?}");
        }
    }
}

/// Rearranges the mesh at `path` in every form.
fn survives(name: &str, path: &Path) {
    let dir = common::in_memory();
    let work = WorkDir::temporary(dir.path()).unwrap();
    let before = match mesh::open(path, work.path(), &Run::new(&())) {
        Ok(opened) => opened,
        Err(_) => return,
    };
    let places = permutation(before.faces.len(), 7919);
    let numbers = permutation(before.positions.len(), 31);
    let strips = before.document().unwrap().header().elements.iter().any(|element| element.is("tristrips"));
    let order = Rearrangement { places: &places, numbers: &numbers, original: true };
    let mut outputs = Vec::new();
    for (form, memory, threads) in [
        (PlyForm::Same, 1 << 30, 1),
        (PlyForm::Same, 4 << 20, 3),
        (PlyForm::Binary, 1 << 30, 2),
        (PlyForm::Ascii, 1 << 30, 2),
    ] {
        let run = Run { threads, budget: Budget::new(memory), ..Run::new(&()) };
        let out = dir.path().join("out.ply");
        rearranged::write(&before, &out, &order, form, Context::new(&work, &run)).unwrap();
        outputs.push(std::fs::read(&out).unwrap());
        let scratch = dir.path().join("scratch");
        std::fs::create_dir_all(&scratch).unwrap();
        let after = mesh::open(&out, &scratch, &run).unwrap();
        assert_rearranged(name, &before, &after, &places, &numbers);
        // The second output in this form has the bytes of the first.
        if outputs.len() == 1 && !strips {
            assert_kept(name, path, &out, "face", &places, &numbers);
        }
    }
    assert!(outputs[0] == outputs[1], "{name}: threads and memory show");
}

#[test]
fn every_mesh_survives_rearranging_in_every_form() {
    let dir = common::in_memory();
    for shape in shapes::all() {
        survives(shape.name, &shape.write(dir.path()));
    }
    let Some(data) = common::data() else { return };
    for folder in ["flavour", "nasty"] {
        for entry in std::fs::read_dir(data.join(folder)).unwrap().flatten() {
            let path = entry.path();
            // The largest add nothing here.
            let most = if common::every_case() { 3_000_000 } else { 500_000 };
            if entry.metadata().unwrap().len() < most {
                survives(word(&path), &path);
            }
        }
    }
}

#[test]
fn edges_name_the_vertices_they_named() {
    let dir = common::in_memory();
    let path = dir.path().join("edges.ply");
    let text = "ply\nformat ascii 1.0\ncomment kept\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                element edge 2\nproperty int vertex1\nproperty int vertex2\nproperty uchar crease\nelement face 2\n\
                property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 2 7\n3 0 9\n3 0 1 2\n3 0 2 3\n";
    std::fs::write(&path, text).unwrap();
    let work = WorkDir::temporary(dir.path()).unwrap();
    let run = Run::new(&());
    let opened = mesh::open(&path, work.path(), &run).unwrap();
    let mut out = Vec::new();
    let order = Rearrangement { places: &[1, 0], numbers: &[3, 1, 0, 2], original: false };
    rearranged::write_to(&opened, "x", &mut out, &order, PlyForm::Same, Context::new(&work, &run)).unwrap();
    let out = String::from_utf8(out).unwrap();
    let (head, body) = out.split_once("end_header\n").unwrap();
    assert!(head.contains("comment kept"));
    assert_eq!(body, "1 1 0\n1 0 0\n0 1 0\n0 0 0\n3 0 7\n2 3 9\n3 3 0 2\n3 3 1 0\n");
    let wrong = Rearrangement { places: &[0], ..order };
    assert!(
        rearranged::write_to(&opened, "x", &mut Vec::new(), &wrong, PlyForm::Same, Context::new(&work, &run)).is_err()
    );
}

/// The measures by their definitions, a face at a time.
fn by_definition(faces: &[Vec<u32>], vertices: usize, places: &[u32]) -> StreamMeasures {
    let mut order: Vec<usize> = (0..faces.len()).collect();
    order.sort_by_key(|&f| places[f]);
    let mut number = vec![u32::MAX; vertices];
    let mut next = 0;
    for &f in &order {
        for &v in &faces[f] {
            if number[v as usize] == u32::MAX {
                number[v as usize] = next;
                next += 1;
            }
        }
    }
    let uses = |v: u32| order.iter().enumerate().filter(move |(_, f)| faces[**f].contains(&v)).map(|(at, _)| at);
    let span = |v: u32| uses(v).next().map(|first| (first, uses(v).next_back().unwrap()));
    let spans: Vec<(usize, usize)> = (0..vertices as u32).filter_map(span).collect();
    let widths: Vec<u64> =
        (0..faces.len()).map(|t| spans.iter().filter(|(a, b)| (*a..=*b).contains(&t)).count() as u64).collect();
    let face_span = |f: &Vec<u32>| {
        let numbers = f.iter().map(|&v| number[v as usize]);
        u64::from(numbers.clone().max().unwrap_or(0) - numbers.min().unwrap_or(0))
    };
    let mut edges = BTreeSet::new();
    for face in faces {
        for k in 0..face.len() {
            let (a, b) = (number[face[k] as usize], number[face[(k + 1) % face.len()] as usize]);
            edges.insert((a.max(b), a.min(b)));
        }
    }
    let down = |n: u32| edges.range((n, 0)..(n + 1, 0)).next().map_or(0, |(a, b)| u64::from(a - b));
    StreamMeasures {
        largest_width: widths.iter().copied().max().unwrap(),
        mean_width: widths.iter().sum::<u64>() as f64 / faces.len() as f64,
        largest_vertex_span: spans.iter().map(|(a, b)| (b - a) as u64).max().unwrap(),
        mean_vertex_span: spans.iter().map(|(a, b)| (b - a) as f64).sum::<f64>() / spans.len() as f64,
        largest_face_span: faces.iter().map(face_span).max().unwrap(),
        mean_face_span: faces.iter().map(face_span).sum::<u64>() as f64 / faces.len() as f64,
        bandwidth: edges.iter().map(|(a, b)| u64::from(a - b)).max().unwrap(),
        profile: (0..next).map(down).sum(),
    }
}

#[test]
fn measures_are_their_definitions() {
    for shape in shapes::all() {
        let dir = common::in_memory();
        let work = WorkDir::temporary(dir.path()).unwrap();
        let run = Run { threads: 2, budget: Budget::new(4 << 20), ..Run::new(&()) };
        let opened = mesh::open(&shape.write(dir.path()), work.path(), &run).unwrap();
        let places = permutation(shape.faces.len(), 271);
        let uses = VertexUse::of(&opened, &places, Context::new(&work, &run)).unwrap();
        let found = StreamMeasures::of(&opened, &uses, Context::new(&work, &run)).unwrap();
        assert_eq!(found, by_definition(&shape.faces, shape.vertices.len(), &places), "{}", shape.name);
        let numbers: BTreeSet<u32> = uses.rank.iter().copied().collect();
        assert_eq!(numbers.len(), shape.vertices.len(), "{}", shape.name);
    }
}

#[test]
fn faces_come_by_their_corners_greatest_first() {
    for shape in shapes::all() {
        let dir = common::in_memory();
        let work = WorkDir::temporary(dir.path()).unwrap();
        let run = Run::new(&());
        let opened = mesh::open(&shape.write(dir.path()), work.path(), &run).unwrap();
        let rank = permutation(shape.vertices.len(), 577);
        let found = places("p.tmp", &opened, &rank, Context::new(&work, &run)).unwrap();
        let key = |f: usize| {
            let mut ranks: Vec<u32> = shape.faces[f].iter().map(|&v| rank[v as usize]).collect();
            ranks.sort_unstable_by(|a, b| b.cmp(a));
            let least = ranks.last().copied().unwrap_or(u32::MAX);
            (ranks.first().copied().unwrap_or(u32::MAX), ranks.get(1).copied().unwrap_or(0), least, f)
        };
        let mut order: Vec<usize> = (0..shape.faces.len()).collect();
        order.sort_by_key(|&f| key(f));
        assert!(order.iter().enumerate().all(|(place, &f)| found[f] as usize == place), "{}", shape.name);
    }
}

fn report(mesh: &Path, words: &[&str]) -> Value {
    let output = program().arg("sequence").arg(mesh).args(["-q", "--compare", "--json"]).args(words).output().unwrap();
    assert!(output.status.success(), "{}", errors(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// A measure of the order called `name`.
fn measure(report: &Value, name: &str, key: &str) -> f64 {
    let orders = report["orders"].as_array().unwrap();
    orders.iter().find(|order| order["order"] == name).unwrap()[key].as_f64().unwrap()
}

#[test]
fn spectral_orders_are_narrow() {
    let Some(data) = common::data() else { return };
    let mut logs = [0f64; 5];
    let models = ["42", "62", "122", "222"];
    for model in models {
        let report = report(&data.join(format!("psb/{model}.ply")), &["--smooth", "100"]);
        let width = |name: &str| measure(&report, name, "mean_width");
        let (spectral, exact) = (width("spectral"), width("fiedler"));
        let ratios = [
            spectral / exact,
            width("spectral --smooth 100") / exact,
            spectral / width("hilbert"),
            spectral / width("rcm"),
            width("keep") / width("random"),
        ];
        logs.iter_mut().zip(ratios).for_each(|(log, ratio)| *log += ratio.ln() / models.len() as f64);
    }
    let means = logs.map(f64::exp);
    let bounds = [1.3, 1.12, 0.65, 0.95, 1.];
    assert!(means.iter().zip(bounds).all(|(mean, bound)| *mean <= bound), "{means:?}");
}

#[test]
fn components_come_one_after_another_and_each_is_ordered_along_itself() {
    // Two equal dumbbells: the vector that tells them apart says nothing about either.
    let dir = common::in_memory();
    let one = shapes::dumbbell();
    let both = shapes::beside("two", &one, &one, [0., 5., 0.]);
    let (single, double) =
        (report(&one.write(dir.path()), &["-l", "20"]), report(&both.write(dir.path()), &["-l", "20"]));
    for order in ["fiedler", "spectral", "bfs", "rcm"] {
        for key in ["largest_width", "mean_width"] {
            let (one, two) = (measure(&single, order, key), measure(&double, order, key));
            assert!(two <= 1.35 * one, "{order} {key}: {one} alone, {two} in two");
        }
    }
    let work = WorkDir::temporary(dir.path()).unwrap();
    let run = Run::new(&());
    let opened = mesh::open(&both.write(dir.path()), work.path(), &run).unwrap();
    let identity = json!({});
    let sequencer = Sequencer::new(&opened, &identity, Context::new(&work, &run)).unwrap();
    for (order, sweeps) in
        [(SequenceOrder::Spectral, 0), (SequenceOrder::Spectral, 9), (SequenceOrder::Bfs, 0), (SequenceOrder::Rcm, 0)]
    {
        let sequence = sequencer.sequence(&SequenceParams::default().order(order).sweeps(sweeps)).unwrap();
        let first =
            sequence.places[..one.faces.len()].iter().filter(|&&place| (place as usize) < one.faces.len()).count();
        assert!(first == 0 || first == one.faces.len(), "{order:?}: {first}");
    }
}

#[test]
fn the_same_bytes_whatever_the_threads_and_the_memory() {
    let dir = common::in_memory();
    let mesh = creature(dir.path(), 30_000, true);
    for order in SequenceOrder::ALL {
        let (name, mut outputs) = (order.to_string(), Vec::new());
        for (threads, memory) in [("1", "1GiB"), ("3", "24MiB")] {
            let out = dir.path().join(format!("{threads}.ply"));
            let mut words = vec!["sequence", word(&mesh), "-q", "-o", word(&out), "--order", &name, "--original"];
            words.extend(["--threads", threads, "--max-memory", memory]);
            if order == SequenceOrder::Spectral {
                words.extend(["--smooth", "5"]);
            }
            ok(&words);
            outputs.push(std::fs::read(&out).unwrap());
        }
        assert!(outputs[0] == outputs[1], "{order:?}");
    }
}

#[test]
fn a_work_directory_serves_segment_and_sequence() {
    let dir = common::in_memory();
    let mesh = creature(dir.path(), 12_000, false);
    let (work, out) = (dir.path().join("work"), dir.path().join("out.ply"));
    common::segment(&mesh, &["-q", "--work-dir", word(&work), "-o", word(&dir.path().join("x.seg"))]);
    // The graph serves both; rows that turn at creases stay, and others are made beside them.
    let rows = std::fs::read(work.join("distances.npy")).unwrap();
    for known in [false, true] {
        let output = run(&["sequence", word(&mesh), "--work-dir", word(&work), "-o", word(&out)]);
        let told = errors(&output);
        assert!(output.status.success() && told.contains("graph: reused"), "{told}");
        assert_eq!(told.contains("rows: 10 of them reused"), known, "{told}");
    }
    assert!(std::fs::read(work.join("distances.npy")).unwrap() == rows);
    let alone = dir.path().join("alone.ply");
    ok(&["sequence", word(&mesh), "-q", "-o", word(&alone)]);
    assert!(std::fs::read(&alone).unwrap() == std::fs::read(&out).unwrap());
    let output = run(&["cluster", "--work-dir", word(&work), "-k", "3"]);
    assert!(output.status.success() && errors(&output).contains("decision: reused"), "{}", errors(&output));
    let left: Vec<String> =
        std::fs::read_dir(&work).unwrap().flatten().map(|e| e.file_name().into_string().unwrap()).collect();
    assert!(left.iter().all(|name| !name.ends_with(".tmp")), "{left:?}");
    // And the other way round.
    let fresh = dir.path().join("fresh");
    ok(&["sequence", word(&mesh), "--work-dir", word(&fresh), "-o", word(&out)]);
    ok(&["cluster", "--work-dir", word(&fresh), "-k", "3"]);
}

#[test]
fn outputs_of_every_form_and_misuse() {
    let dir = common::in_memory();
    let mesh = shapes::dumbbell().write(dir.path());
    let at = |name: &str| dir.path().join(name);
    ok(&["sequence", word(&mesh), "-q"]);
    let beside = std::fs::read(mesh.with_extension("sequenced.ply")).unwrap();
    let (png, npy) = (at("o.png"), at("o.npy"));
    let output = ok(&["sequence", word(&mesh), "-q", "-o", word(&png), "-o", word(&npy), "--json"]);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(report["measures"]["mean_width"].as_f64().unwrap() < 60., "{report}");
    let mut places = nystrom_stream::store::npy::open::<u32>(&npy).unwrap().to_vec();
    places.sort_unstable();
    assert!(places.iter().enumerate().all(|(i, &place)| place as usize == i));
    assert!(std::fs::read(&png).unwrap().starts_with(b"\x89PNG"));
    let piped = program().args(["sequence", "-", "-q"]).stdin(std::fs::File::open(&mesh).unwrap()).output().unwrap();
    assert!(piped.status.success() && piped.stdout == beside, "{}", errors(&piped));
    let table = run(&["sequence", word(&mesh), "-q", "--compare", "--smooth", "3"]);
    let table = String::from_utf8(table.stdout).unwrap();
    for order in ["fiedler", "spectral --smooth 3", "pca", "bfs", "rcm", "hilbert", "random", "keep"] {
        assert!(table.lines().any(|line| line.starts_with(order)), "{table}");
    }
    for words in [
        &["--order", "pca", "--smooth", "3"][..],
        &["--order", "bfs", "-l", "9"],
        &["-o", "x.seg"],
        &["-o", "-", "--json"],
        &["-o", "-", "--compare"],
        &["-o", word(&npy), "--original"],
        &["-l", "0"],
    ] {
        let output = run(&[&["sequence", word(&mesh), "-q"], words].concat());
        assert_eq!(output.status.code(), Some(2), "{words:?}: {}", errors(&output));
    }
    let output = run(&["sequence", word(&at("none.ply"))]);
    assert_eq!(output.status.code(), Some(1), "{}", errors(&output));
}
