//! The command line end to end: where results go, what is refused and how, and that the same bytes come out
//! whatever the threads, the memory and the way in.

use crate::common::{self, errors, json, names, ok, program, refused, run, segment, shapes, word};
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;
use std::process::{Output, Stdio};

/// Runs the program with `input` on standard input.
fn with_input(words: &[&str], input: &[u8]) -> Output {
    let mut child =
        program().args(words).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut pipe = child.stdin.take().unwrap();
    std::thread::scope(|scope| {
        // A program that ends early closes the pipe: no failure of this test.
        scope.spawn(move || drop(pipe.write_all(input)));
        child.wait_with_output().unwrap()
    })
}

#[test]
fn without_an_output_the_labelled_mesh_lies_beside_the_input_and_nothing_else() {
    let dir = common::in_memory();
    let mesh = shapes::dumbbell().write(dir.path());
    let output = segment(&mesh, &["-k", "3"]);
    assert!(output.stdout.is_empty());
    assert_eq!(names(dir.path()), ["dumbbell.ply", "dumbbell.segmented.ply"]);
    // Off a terminal: one plain line per stage, no control characters.
    let told = errors(&output);
    for stage in ["reading", "dual graph", "edge weights", "distance rows", "boundaries", "writing"] {
        assert_eq!(told.lines().filter(|line| line.starts_with(stage)).count(), 1, "{told}");
    }
    assert!(!told.contains(['\r', '\u{1b}']), "{told}");
    let last = told.lines().next_back().unwrap();
    assert!(last.contains(" faces in 3 parts in ") && last.contains(" s, written to "), "{last}");
    assert!(last.ends_with(word(&dir.path().join("dumbbell.segmented.ply"))), "{last}");
    assert!(segment(&mesh, &["-k", "3", "--quiet"]).stderr.is_empty());
}

#[test]
fn every_output_form_holds_the_same_labels() {
    let dir = common::in_memory();
    let mesh = shapes::dumbbell().write(dir.path());
    let file = |name: &str| dir.path().join(name);
    let (ply, seg, npy, report) = (file("a.ply"), file("b.SEG"), file("c.npy"), file("d.json"));
    let json = format!("--json={}", word(&report));
    segment(&mesh, &["-k", "3", "-o", word(&ply), "-o", word(&seg), "--output", word(&npy), &json]);
    let labels = nystrom_stream::mesh::read_seg(&seg).unwrap();
    let (array, shape) = nystrom_stream::store::npy::open_shaped::<u32>(&npy).unwrap();
    assert_eq!(shape, [labels.len() as u64]);
    assert_eq!(array[..], labels);
    let text = std::fs::read_to_string(&ply).unwrap();
    let first_face = text.lines().skip_while(|line| *line != "end_header").nth(1 + shapes::dumbbell().vertices.len());
    let words: Vec<&str> = first_face.unwrap().split(' ').collect();
    assert_eq!((words.len(), words[4]), (9, &labels[0].to_string()[..]));
    let report: Value = serde_json::from_str(&std::fs::read_to_string(report).unwrap()).unwrap();
    assert_eq!(report["parts"].as_array().unwrap().len(), 3);
    assert_eq!(report["options"]["parts"]["count"]["exactly"], 3);
    // Binary and text are the same mesh.
    for form in ["binary", "ascii", "same"] {
        segment(&mesh, &["-q", "-k", "3", "-o", word(&ply), "--ply-form", form]);
        let head = std::fs::read(&ply).unwrap();
        let expected = if form == "binary" { "ply\nformat binary_little" } else { "ply\nformat ascii" };
        assert!(head.starts_with(expected.as_bytes()), "{form}");
        let again = file("again.seg");
        segment(&ply, &["-q", "-k", "3", "-o", word(&again)]);
        assert_eq!(nystrom_stream::mesh::read_seg(&again).unwrap(), labels, "{form}");
    }
}

#[test]
fn standard_input_and_output_carry_the_same_mesh_as_files() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 5_000, false);
    let labelled = dir.path().join("labelled.ply");
    segment(&mesh, &["-q", "-k", "5", "-o", word(&labelled)]);
    let (input, expected) = (std::fs::read(&mesh).unwrap(), std::fs::read(&labelled).unwrap());
    for words in [&["segment", "-", "-k", "5"][..], &["segment", "-", "-k", "5", "-o", "-", "-q"]] {
        let output = with_input(words, &input);
        assert!(output.status.success(), "{}", errors(&output));
        assert!(output.stdout == expected, "{words:?}");
        let quiet = words.contains(&"-q");
        assert_eq!(errors(&output).ends_with(", written to standard output\n"), !quiet, "{}", errors(&output));
    }
    assert!(segment(&mesh, &["-k", "5", "-o", "-"]).stdout == expected);
    let output = with_input(&["segment", "-", "-k", "5", "-o", word(&dir.path().join("x.seg")), "--json"], &input);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["input"]["path"], "<stdin>");
    assert_eq!(names(dir.path()), ["creature_5000.ply", "labelled.ply", "x.seg"]);
    let output = with_input(&["segment", "-", "-k", "5"], b"not a mesh");
    assert_eq!(output.status.code(), Some(1));
    assert!(errors(&output).starts_with("nystrom-stream: <stdin>: header line 1: "), "{}", errors(&output));
}

#[test]
fn several_meshes_go_on_when_one_fails() {
    let dir = common::in_memory();
    let (a, b) = (shapes::dumbbell().write(dir.path()), shapes::moebius(30).write(dir.path()));
    let (bad, json) = (dir.path().join("bad.ply"), dir.path().join("reports.json"));
    std::fs::write(&bad, "ply\n").unwrap();
    let output = run(&["segment", word(&a), word(&bad), word(&b), "-q", "-k", "2", &format!("--json={}", word(&json))]);
    assert_eq!(output.status.code(), Some(1));
    let told = errors(&output);
    assert_eq!(told.lines().count(), 2, "{told}");
    assert!(told.contains("bad.ply: ") && told.ends_with("nystrom-stream: 1 of 3 meshes failed\n"), "{told}");
    let expected =
        ["bad.ply", "dumbbell.ply", "dumbbell.segmented.ply", "moebius.ply", "moebius.segmented.ply", "reports.json"];
    assert_eq!(names(dir.path()), expected);
    let reports: Value = serde_json::from_str(&std::fs::read_to_string(json).unwrap()).unwrap();
    let faces: Vec<_> = reports.as_array().unwrap().iter().map(|report| &report["input"]["faces"]).collect();
    assert_eq!(faces, [shapes::dumbbell().faces.len(), 60]);
}

#[test]
fn refusals_are_one_line_with_file_and_remedy_and_code_1() {
    let dir = common::in_memory();
    let mesh = shapes::tetrahedron().write(dir.path());
    let file = |name: &str, content: &[u8]| {
        let path = dir.path().join(name);
        std::fs::write(&path, content).unwrap();
        path
    };
    let text = std::fs::read_to_string(&mesh).unwrap();
    let foreign = dir.path().join("foreign");
    std::fs::create_dir(&foreign).unwrap();
    std::fs::write(foreign.join("thesis.doc"), []).unwrap();
    let (no_folder, foreign) = (dir.path().join("none/x.ply"), word(&foreign).to_owned());
    let cut = file("cut.ply", &text.as_bytes()[..text.len() - 9]);
    let far = file("far.ply", text.replace("3 0 2 1", "3 0 2 4").as_bytes());
    let promises = file("promises.ply", text.replace("face 4", "face 4000000000").as_bytes());
    let points = file("points.ply", text.replace("face 4", "face 0").as_bytes());
    let (empty, other) = (file("empty.ply", b""), file("other.ply", b"cube of cheese\n"));
    let stl = file("stl.ply", b"solid cube\nfacet normal 0 0 1\n");
    let gz = file("cut.ply.gz", &[0x1f, 0x8b, 8, 0, 0, 0]);
    for (words, start, remedy) in [
        (vec![word(&cut)], "cut.ply: face 3: ", "cut short"),
        (vec![word(&far)], "far.ply: face 0: names vertex 4, but there are 4", "export"),
        (vec![word(&promises)], "promises.ply: header, element face: 4000000000 records need", "cut short"),
        (vec![word(&points)], "points.ply: has no faces; a surface is needed, not a point cloud", "reconstruct"),
        (vec![word(&empty)], "empty.ply: is empty", "get the file again"),
        (vec![word(&other)], "other.ply: header line 1: is \"cube of cheese\", not \"ply\"", "PLY"),
        (vec![word(&stl)], "stl.ply: is named as PLY, but its content is STL", "rename it to end with .stl"),
        (vec![word(&gz)], "cut.ply.gz: ", "; "),
        (vec![word(&mesh), "-k", "5"], "tetrahedron.ply: has 4 faces, fewer than the 5 parts", "choose a smaller -k"),
        (vec![word(&mesh), "--parts-range", "5..6"], "fewer than the 5 parts", "choose smaller --parts-range"),
        (vec!["absent.ply"], "absent.ply: cannot open: ", "check the path"),
        (vec![&foreign], "foreign: holds no mesh", "choose another folder"),
        (vec![word(&mesh), "-o", word(&no_folder)], "none/x.ply: its folder ", "create it first"),
        (vec![word(&mesh), "--work-dir", &foreign], "foreign: is not empty and not a work directory", "empty or new"),
        (vec![word(&mesh), "--tmp", "/nonexistent"], "/nonexistent: cannot create", "check the path"),
        (vec![word(&mesh), "-o", "/dev/full/x.ply"], "/dev/full", "; "),
    ] {
        let mut all = vec!["segment", "-q"];
        all.extend(&words);
        if !words.contains(&"-k") && !words.contains(&"--parts-range") {
            all.extend(["-k", "2"]);
        }
        let output = run(&all);
        let message = errors(&output);
        assert_eq!(output.status.code(), Some(1), "{words:?}: {message}");
        assert_eq!(message.lines().count(), 1, "{words:?}: {message}");
        assert!(message.starts_with("nystrom-stream: ") && output.stdout.is_empty(), "{words:?}: {message}");
        assert!(message.contains(start), "{words:?}: {message}");
        let after = &message[message.find(start).unwrap()..];
        assert!(after.contains(remedy), "{words:?}: {message}");
    }
    // Nothing is left of all that.
    assert!(names(dir.path()).iter().all(|name| !name.contains("segmented") && !name.starts_with('.')));
}

/// Regression: help and version that could not be written ended with exit code 0.
#[test]
fn help_that_cannot_be_written_is_an_error() {
    for words in [&["--help"][..], &["--version"], &["segment", "-h"]] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let output = program().args(words).stdout(full).stderr(Stdio::piped()).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{words:?}");
        assert!(errors(&output).starts_with("nystrom-stream: <stdout>: cannot write: "), "{}", errors(&output));
    }
}

#[test]
fn misuse_ends_with_code_2_and_says_what_is_right() {
    let dir = common::in_memory();
    let mesh = shapes::tetrahedron().write(dir.path());
    let mesh = word(&mesh);
    for (words, part) in [
        (&["segment", mesh, "--cluster", "kmeans"][..], "-k: K-means needs the number of parts; give it, as in -k 6"),
        (&["segment", mesh, "-k", "2", "--parts-range", "2..3"], "cannot be used with"),
        (&["segment", mesh, "--parts-range", "5..2"], "is not a range; write 4..12"),
        (&["segment", mesh, "--detail", "2"], "choose from -1 to 1"),
        (&["segment"], "MESH: missing; see nystrom-stream segment --help"),
        (
            &["segment", mesh, "--cluster", "kmean"],
            "--cluster: invalid value 'kmean'; did you mean kmeans?; choose from",
        ),
        (&["segment", mesh, "-q", "-q"], "--quiet: given more than once"),
        (&["segment", mesh, "--thread", "2"], "--thread: unexpected argument; did you mean --threads?"),
        (&["segment", mesh, "--threads"], "--threads: its value is missing"),
        // It said that --work-dir is missing, and not why.
        (&["segment", mesh, "--force"], "--force requires --work-dir; give both"),
        (&["graph", mesh, "--force"], "--work-dir: missing"),
        // A number below 0 was called an unexpected argument.
        (&["segment", mesh, "--seed", "-1"], "--seed: invalid value '-1': not a whole number of 0 or more"),
        (&["segment", mesh, "-l", "-3"], "--landmarks: invalid value '-3': out of range; choose from 1 to 4096"),
        (&["segment", mesh, "--threads", "-1"], "--threads: invalid value '-1': out of range"),
        (&["segment", mesh, "--seed", "99999999999999999999"], "too large"),
        (&["plan", "-"], "standard input has no known size"),
        (&["segment", mesh, "-k", "0"], "0"),
        (&["segment", mesh, "-k", "two"], "invalid value 'two'"),
        (&["segment", mesh, "-k", "-3"], "--parts: invalid value '-3': not a whole number"),
        (&["segment", mesh, "-k", "2", "-l", "0"], "out of range; choose from 1 to 4096"),
        (
            &["segment", mesh, "-k", "2", "-o", "x.xyz"],
            "use .ply, .seg, .npy, .parquet, .csv, .obj, .glb, .html or .png",
        ),
        (&["segment", mesh, mesh, "-k", "2", "-o", "x.ply"], "-o names a single file"),
        (&["segment", mesh, mesh, "-k", "2", "--work-dir", "w"], "--work-dir can only be used with a single mesh"),
        (&["segment", "-", mesh, "-k", "2"], "standard input is a single mesh"),
        (&["segment", "-", "-k", "2", "--json"], "cannot both go to standard output"),
        (&["segment", mesh, "-k", "2", "-o", "-", "--json"], "cannot both go to standard output"),
        (&["segment", mesh, "-k", "2", "--delta", "0.1"], "--delta can only be used with --metric paper"),
        (&["segment", mesh, "-k", "2", "--metric", "paper", "--beta", "1"], "--beta can only be used with"),
        (&["segment", mesh, "-k", "2", "--metric", "geodesic", "--eta", "1"], "--metric geodesic takes no"),
        (&["segment", mesh, "-k", "2", "--eta=-1"], "choose from 0 to 1"),
        (&["segment", mesh, "-k", "2", "--eta=nan"], "out of range"),
        (&["segment", mesh, "-k", "2", "--beta=inf"], "out of range"),
        (&["segment", mesh, "-k", "2", "--cluster", "kmeans", "--sigma", "0"], "choose a positive number"),
        (&["segment", mesh, "-k", "2", "--cluster", "kmeans", "--sigma=nan"], "choose a positive number"),
        // Regression: three hundred digits, and a remedy that it had followed.
        (
            &["segment", mesh, "-k", "2", "--cluster", "kmeans", "--sigma", "1e300"],
            "--sigma: 1e300 is not a width; choose a positive number below 1000000",
        ),
        (&["segment", mesh, "--detail", "1e300"], "--detail: 1e300 is out of range"),
        (&["segment", mesh, "-k", "2", "--beta", "1e30"], "--beta: 1e30 is out of range"),
        (&["quality", mesh, "--sigma", "1e300"], "--sigma: 1e300 is not a width"),
        // Regression: the last landmark was taken.
        (&["quality", mesh, "-l", "3", "--local", "4"], "--local: 3 landmarks have no nearest one of number 4"),
        // Regression: a file of that name was written.
        (&["segment", mesh, mesh, "-o", "{}.seg", "--json={}.json"], "--json writes the reports of all meshes to one"),
        (&["segment", mesh, "--cluster", "components", "--seed", "3"], "--seed can only be used with --cluster"),
        // Regression: "-" became a folder.
        (&["man", "-"], "-: man pages are several files; give a folder"),
        (&["correspond", mesh, mesh, "--carry", ",label,", "--carried", "x.ply"], "--carry: a name is empty"),
        (&["segment", mesh, "-k", "2", "--threads", "0"], "out of range; choose from 1 to 65535"),
        (&["segment", mesh, "-k", "2", "--max-memory", "12"], "at least 1MB"),
        // Regression: it was too little.
        (&["segment", mesh, "-k", "2", "--max-memory", "2000000TB"], "less than 1000000TB"),
        // Regression: not named as an option.
        (&["picture", mesh, "--tilt=inf"], "--tilt: inf is not an angle"),
        (&["segment", mesh, "-k", "2", "--max-memory", "2 parsecs"], "is not a unit; write MiB or GiB"),
        (&["segment", mesh, "-k", "2", "--no-such"], "--no-such"),
        (&["demo", "--faces", "9999999999"], "--faces"),
        (&["demo", "--noise", "2"], "--noise"),
        (&["frobnicate"], "frobnicate: unknown command"),
        (&[mesh], "did you mean nystrom-stream segment"),
        (&[], "Usage"),
    ] {
        let output = program().args(words).current_dir(dir.path()).output().unwrap();
        let message = errors(&output);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {message}");
        assert!(message.contains(part) && output.stdout.is_empty(), "{words:?}: {message}");
        let one_line = message.starts_with("nystrom-stream: ") && message.lines().count() == 1;
        assert!(one_line || words.is_empty(), "{words:?}: {message}");
        // Whoever refuses: the option or the word first, then what is wrong and what to do.
        if one_line {
            let named = message["nystrom-stream: ".len()..].split([':', ' ']).next().unwrap();
            let known = named.starts_with('-') || ["MESH", "frobnicate", "standard", "mesh", mesh].contains(&named);
            assert!(known, "{words:?}: {message}");
        }
    }
    for words in [&["--help"][..], &["--version"], &["segment", "--help"], &["demo", "-h"]] {
        let output = run(words);
        assert!(output.status.success() && output.stderr.is_empty() && !output.stdout.is_empty(), "{words:?}");
    }
}

#[test]
fn threads_memory_and_order_of_work_change_no_byte() {
    let dir = common::in_memory();
    // Large enough that 8 MiB spill the half-edges to disk, and in random order.
    let mesh = common::creature(dir.path(), 150_000, true);
    let mut first: Option<Vec<Vec<u8>>> = None;
    let mut reports = Vec::new();
    for options in [
        &["--threads", "1"][..],
        &["--threads", "2"],
        &["--threads", "7"],
        &["--threads", "1", "--max-memory", "8MiB"],
        &["--threads", "2", "--max-memory", "10MiB"],
        &["--threads", "2", "--max-memory", "4GiB"],
    ] {
        let file = |name: &str| dir.path().join(name);
        let (ply, npy, report) = (file("x.ply"), file("x.npy"), file("x.json"));
        // Regression: pages held times and threads.
        let page = file("x.html");
        let json = format!("--json={}", word(&report));
        let outputs = ["-o", word(&ply), "-o", word(&npy), "-o", word(&page), &json];
        let words = [&["-q", "-k", "9"], &outputs[..], options].concat();
        segment(&mesh, &words);
        let mut report: Value = serde_json::from_str(&std::fs::read_to_string(report).unwrap()).unwrap();
        for key in ["seconds", "bytes", "options"] {
            report.as_object_mut().unwrap().remove(key);
        }
        report["decision"].as_object_mut().unwrap().remove("seconds");
        reports.push(report);
        let bytes = vec![std::fs::read(ply).unwrap(), std::fs::read(npy).unwrap(), std::fs::read(page).unwrap()];
        let expected = first.get_or_insert_with(|| bytes.clone());
        assert!(*expected == bytes, "{options:?}");
        assert_eq!(reports[0], reports[reports.len() - 1], "{options:?}");
    }
}

#[test]
fn a_seed_decides_and_nothing_else() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 3_000, false);
    let labels = |seed: &str| {
        let out = dir.path().join("x.seg");
        segment(
            &mesh,
            &["-q", "-k", "6", "--cluster", "kmeans", "--sampling", "random", "--seed", seed, "-o", word(&out)],
        );
        std::fs::read(out).unwrap()
    };
    assert!(labels("5") == labels("5"), "seed 5 cuts in two ways");
    assert!(labels("5") != labels("6"), "seeds 5 and 6 cut alike");
}

#[test]
fn a_work_directory_is_filled_with_arrays_and_used_again() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 3_000, false);
    let (work, out) = (dir.path().join("work"), dir.path().join("x.seg"));
    let cut = |words: &[&str]| {
        let all = [&["-o", word(&out), "--work-dir", word(&work)], words].concat();
        let told = errors(&segment(&mesh, &all));
        (std::fs::read(&out).unwrap(), told)
    };
    let (first, told) = cut(&["-k", "4", "-l", "12"]);
    assert!(!told.contains("reused"), "{told}");

    // Every array has the header that NumPy writes for its shape (tools/check_rows.py opens them with NumPy).
    let shape = |name: &str| {
        let bytes = std::fs::read(work.join(name)).unwrap();
        let text = std::str::from_utf8(&bytes[10..128]).unwrap();
        let (descr, rest) =
            text.strip_prefix("{'descr': ").unwrap().split_once(", 'fortran_order': False, 'shape': (").unwrap();
        let numbers = rest.split_once("), }").unwrap().0.split(',').map(str::trim).filter(|number| !number.is_empty());
        (descr.to_string(), numbers.map(|number| number.parse().unwrap()).collect::<Vec<u64>>())
    };
    let n = nystrom_stream::mesh::read_seg(&out).unwrap().len() as u64;
    let (u4, f4) = ("'<u4'".to_string(), "'<f4'".to_string());
    assert_eq!(shape("labels.npy"), (u4.clone(), vec![n]));
    assert_eq!(shape("quality.npy"), (f4.clone(), vec![n]));
    assert_eq!(shape("landmarks.npy"), (u4.clone(), vec![12]));
    assert_eq!(shape("distances.npy"), (f4.clone(), vec![12, n]));
    assert_eq!(shape("node_geometry.npy"), (f4.clone(), vec![n, 7]));
    assert_eq!(shape("graph_row_blocks.npy"), ("'<u8'".to_string(), vec![n.div_ceil(64), 4]));
    assert_eq!(shape("graph_long_rows.npy"), ("'<u8'".to_string(), vec![0]));
    // Closed: three neighbours a triangle.
    assert_eq!(shape("graph_indices.npy"), (u4, vec![3 * n]));
    for name in ["graph_weights.npy", "graph_centroid_distances.npy", "graph_shared_edge_lengths.npy"] {
        assert_eq!(shape(name), (f4.clone(), vec![3 * n]), "{name}");
    }
    // Nothing half-made or temporary stays.
    let known = |name: &String| name == "lock" || name.ends_with(".npy") || name.ends_with(".json");
    assert!(names(&work).iter().all(known), "{:?}", names(&work));

    // The same again: every stage but the last is there, and the bytes are the same.
    let (again, told) = cut(&["-k", "4", "-l", "12"]);
    assert!(again == first);
    for stage in ["graph", "weights", "decision"] {
        assert!(told.contains(&format!("{stage}: reused")), "{told}");
    }
    // Another K needs no new row; another metric needs new weights and rows, but no new graph.
    let (_, told) = cut(&["-k", "7", "-l", "12"]);
    assert!(told.contains("decision: reused") && !told.contains("\ndistance rows"), "{told}");
    let (_, told) = cut(&["-k", "7", "-l", "12", "--decision", "single"]);
    assert!(told.contains("rows: reused"), "{told}");
    let (_, told) = cut(&["-k", "7", "-l", "12", "--metric", "paper"]);
    assert!(told.contains("graph: reused") && !told.contains("weights: reused"), "{told}");
    assert!(!told.contains("rows: reused"), "{told}");
    // And back: as if nothing had happened.
    let (back, told) = cut(&["-k", "4", "-l", "12"]);
    assert!(back == first && !told.contains("weights: reused"), "{told}");
    // A changed input is not mistaken for the old one, nor is what is kept of that lost.
    let dumbbell = shapes::dumbbell().write(dir.path());
    std::fs::copy(&dumbbell, &mesh).unwrap();
    let kept = std::fs::read(work.join("manifest.json")).unwrap();
    for (mesh, whose) in [(&mesh, "belongs to an earlier version of "), (&dumbbell, "belongs to another mesh, ")] {
        for command in [&["segment"][..], &["graph"], &["rows"], &["rows", "--shard", "0/2"], &["sequence"]] {
            let told = refused(&[command, &[word(mesh), "-q", "--work-dir", word(&work)]].concat(), 1, whose);
            assert!(told.contains("--force"), "{told}");
        }
    }
    // Nor by what a command tells: it took the place of the manifest.
    let report = format!("--json={}", work.join("manifest.json").display());
    for command in
        [&["graph", word(&mesh)][..], &["rows"], &["share", "normals", "--prepare"], &["merge"], &["info"], &["verify"]]
    {
        let output = run(&[command, &["--work-dir", word(&work), &report]].concat());
        assert!(errors(&output).contains("lies in the work directory"), "{command:?}: {}", errors(&output));
        assert_eq!(output.status.code(), Some(2), "{command:?}");
    }
    assert!(std::fs::read(work.join("manifest.json")).unwrap() == kept, "a refusal changes nothing");
    let (changed, told) = cut(&["-k", "4", "-l", "12", "--force"]);
    assert!(!told.contains("reused"), "{told}");
    segment(&dumbbell, &["-q", "-k", "4", "-l", "12", "-o", word(&out)]);
    assert!(changed == std::fs::read(&out).unwrap());
    // A damaged array is made again.
    std::fs::write(work.join("distances.npy"), b"short").unwrap();
    std::fs::write(work.join("tree.json"), b"{}").unwrap();
    let (mended, told) = cut(&["-k", "4", "-l", "12"]);
    assert!(mended == changed && told.contains("graph: reused") && !told.contains("rows: reused"), "{told}");
}

/// Regression: it ended with exit code 1, and a shell went on with its loop after Ctrl-C.
#[cfg(unix)]
#[test]
fn an_interrupt_leaves_nothing_behind_or_a_work_directory_that_goes_on() {
    use std::io::{BufRead, BufReader};
    use std::os::unix::process::ExitStatusExt;
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 60_000, false);
    let (work, tmp) = (dir.path().join("work"), dir.path().join("tmp"));
    std::fs::create_dir(&tmp).unwrap();
    let place = ["--work-dir", word(&work), "--tmp", word(&tmp)];
    for (place, kept, name, signal) in [(&place[2..], false, "-INT", 2), (&place[..], true, "-TERM", 15)] {
        if signal == 2 && common::interrupts_are_ignored() {
            continue;
        }
        let mut child = program()
            .args(["segment", word(&mesh), "-k", "5", "-l", "2000", "--threads", "1"])
            .args(place)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
        // A stage is recorded after its line, so the weights are when the next one is told.
        assert!(lines.any(|line| line.starts_with("coarser mesh")), "the contraction is told");
        let id = child.id().to_string();
        assert!(std::process::Command::new("kill").args([name, &id]).status().unwrap().success());
        let rest: Vec<String> = lines.collect();
        assert_eq!(child.wait().unwrap().signal(), Some(signal), "{rest:?}");
        let last = rest.last().unwrap();
        assert!(last.starts_with("nystrom-stream: interrupted"), "{rest:?}");
        assert_eq!(last.contains("; the same command continues from "), kept, "{last}");
        assert_eq!(names(&tmp), [""; 0]);
        assert!(names(dir.path()).iter().all(|name| !name.contains("segmented")));
        assert_eq!(work.exists(), kept);
    }
    let output = segment(&mesh, &["-k", "5", "--work-dir", word(&work)]);
    assert!(errors(&output).contains("weights: reused"), "{}", errors(&output));
}

#[test]
fn the_demo_finds_the_parts_it_made() {
    let dir = common::in_memory();
    let folder = dir.path().join("demo");
    let output = run(&["demo", "-q", "--faces", "2e4", "--folder", word(&folder)]);
    assert!(output.status.success() && output.stderr.is_empty(), "{}", errors(&output));
    let table = String::from_utf8(output.stdout).unwrap();
    let number = |key: &str| -> f64 {
        let line = table.lines().find(|line| line.contains(key)).unwrap_or_else(|| panic!("{key} in {table}"));
        line.split_whitespace().find_map(|word| word.parse().ok()).unwrap()
    };
    assert!(number("Rand index") > 0.8 && number("matching parts") > 50., "{table}");
    let expected = ["creature.labels.seg", "creature.ply", "creature.seg", "creature.segmented.ply"];
    assert_eq!(names(&folder), expected);
}

#[test]
fn json_has_one_form_everywhere() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 1_000, false);
    let file = |name: &str| dir.path().join(name);
    let (work, seg, npy, json) = (file("work"), file("x.seg"), file("x.npy"), file("x.json"));
    segment(&mesh, &["-q", "-k", "4", "-o", word(&seg), "--work-dir", word(&work)]);
    let (mesh, work, seg, npy) = (word(&mesh), word(&work), word(&seg), word(&npy));
    for words in [
        &["segment", mesh, "-k", "3", "-o", seg][..],
        &["cluster", "--work-dir", work, "-k", "3"],
        &["plan", mesh],
        &["info", mesh],
        &["info", work],
        &["verify", work],
        &["evaluate", seg, "--truth", seg],
        &["quality", mesh, "-l", "5"],
        &["study", "--points", "40", "-l", "5", "--runs", "3"],
        &["sequence", mesh, "-o", npy],
        &["transfer-labels", mesh, mesh, "--labels", seg, "-o", npy],
        &["correspond", mesh, mesh, "-l", "8", "--refine", "none"],
    ] {
        let quiet: &[&str] = if ["plan", "info"].contains(&words[0]) { &[] } else { &["-q"] };
        let output = ok(&[words, quiet, &["--json"]].concat());
        let printed: Value =
            serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{words:?}: {error}"));
        ok(&[words, quiet, &[&format!("--json={}", word(&json))]].concat());
        let written: Value = serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap();
        let keys = |value: &Value| value.as_object().map(|all| all.keys().cloned().collect::<Vec<_>>());
        assert_eq!(keys(&printed), keys(&written), "{words:?}");
        std::fs::remove_file(&json).unwrap();
    }
    assert!(names(dir.path()).iter().all(|name| !name.contains("partial")), "{:?}", names(dir.path()));
}

/// Regression: errors were lines of text among events of JSON.
#[test]
fn errors_are_events_where_progress_is() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 1_000, false);
    let [bad, work, out] = ["bad.ply", "work", "{}.seg"].map(|name| dir.path().join(name));
    std::fs::write(&bad, "ply\nformat ascii 1.0\n").unwrap();
    segment(&mesh, &["-q", "-k", "3", "--work-dir", word(&work)]);
    let labels = work.join("labels.npy");
    std::fs::write(&labels, b"short").unwrap();
    let events = |words: &[&str]| -> (Option<i32>, Vec<Value>) {
        let output = run(&[words, &["--progress", "json"]].concat());
        let parse =
            |line: &str| serde_json::from_str(line).unwrap_or_else(|error| panic!("{words:?}: {error}: {line}"));
        (output.status.code(), errors(&output).lines().map(parse).collect())
    };
    let (code, told) = events(&["segment", word(&bad)]);
    let last = told.last().unwrap();
    assert!(last["error"].as_str().unwrap().starts_with(word(&bad)), "{last}");
    assert_eq!((code, &last["file"], &last["exit_code"]), (Some(1), &Value::from(word(&bad)), &Value::from(1)));
    for words in [&["segment", word(&mesh), "-k", "x"][..], &["segment", word(&mesh), "-o", "x.unknown"]] {
        let (code, told) = events(words);
        assert_eq!((code, told.len(), &told[0]["exit_code"]), (Some(2), 1, &Value::from(2)), "{told:?}");
    }
    let (code, told) = events(&["segment", word(&bad), word(&mesh), "-o", word(&out)]);
    let failed: Vec<_> = told.iter().filter(|event| event.get("error").is_some()).collect();
    assert_eq!((code, failed.len()), (Some(1), 2), "{told:?}");
    assert_eq!((&failed[0]["mesh"], &failed[0]["file"]), (&Value::from(word(&bad)), &Value::from(word(&bad))));
    assert_eq!(failed[1], &json!({"error": "1 of 2 meshes failed", "exit_code": 1}));
    let (code, told) = events(&["verify", word(&work)]);
    let failed: Vec<_> = told.iter().filter(|event| event.get("error").is_some()).collect();
    assert_eq!((code, failed.len(), &failed[0]["file"]), (Some(1), 2, &Value::from(word(&labels))), "{told:?}");
    // Regression: it asked to delete a file that is missing.
    std::fs::remove_file(&labels).unwrap();
    let (_, told) = events(&["verify", word(&work)]);
    let missing = told.iter().filter_map(|event| event["error"].as_str()).any(|error| error.contains("is missing"));
    assert!(missing && !format!("{told:?}").contains("delete the file"), "{told:?}");
}

/// Regression: options that change nothing were taken in silence.
#[test]
fn options_without_an_effect_are_refused() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 1_000, false);
    let [work, seg, csv] = ["work", "x.seg", "x.csv"].map(|name| dir.path().join(name));
    segment(&mesh, &["-q", "-k", "3", "--work-dir", word(&work), "-o", word(&seg)]);
    let (mesh, work, seg, csv) = (word(&mesh), word(&work), word(&seg), word(&csv));
    for (command, options) in [
        (&["verify", work][..], &["--threads", "--max-memory", "--seed", "--tmp", "--no-plan"][..]),
        (&["merge", work], &["--threads", "--max-memory", "--seed", "--tmp", "--no-plan"]),
        (&["info", mesh], &["--seed", "--no-plan", "--quiet", "--progress"]),
        (&["plan", mesh], &["--no-plan", "--quiet", "--progress"]),
        (&["export", "--work-dir", work, "-o", seg], &["--seed", "--no-plan"]),
        (&["picture", mesh], &["--seed", "--no-plan"]),
        (&["transfer-labels", mesh, mesh, "-o", seg], &["--seed", "--no-plan"]),
        (&["graph", mesh, "--work-dir", work], &["--tmp", "--no-plan"]),
        (&["rows", "--work-dir", work], &["--tmp", "--no-plan"]),
        (&["share", "rows", "--work-dir", work], &["--tmp", "--no-plan"]),
        (&["embed", "--work-dir", work], &["--tmp", "--no-plan"]),
        (&["cluster", "--work-dir", work], &["--tmp", "--no-plan"]),
        (&["sequence", mesh], &["--no-plan"]),
        (&["correspond", mesh, mesh], &["--no-plan"]),
        (&["quality", mesh], &["--no-plan"]),
        (&["study"], &["--tmp", "--no-plan"]),
    ] {
        for option in options {
            let output = run(&[command, &[option]].concat());
            let told = errors(&output);
            assert_eq!(output.status.code(), Some(2), "{command:?} {option}: {told}");
            assert!(told.contains(&format!("{option}: unexpected argument")), "{command:?}: {told}");
        }
    }
    for (words, told) in [
        (&["cluster", "--work-dir", work, "--vertex-labels"][..], "--vertex-labels requires a .ply output"),
        (&["export", "--work-dir", work, "--tree", csv, "--split-faces"], "--split-faces requires a .ply output"),
        (&["quality", mesh, "--embedding", "--csv", csv], "--csv cannot be used with --embedding"),
        (&["quality", mesh, "--embedding", "--exact"], "cannot be used with"),
    ] {
        refused(words, 2, told);
    }
    let vertices = segment(Path::new(mesh), &["-q", "-k", "3", "--vertex-labels"]);
    assert!(vertices.stderr.is_empty());
}

/// Regression: a report took the place of the list of the parts, and an input that of a part.
#[test]
fn nothing_goes_where_a_folder_of_parts_has_its_own_files() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 1_000, false);
    let (parts, list) = (dir.path().join("parts"), dir.path().join("parts/parts.json"));
    let (into, work) = (format!("{}/", word(&parts)), dir.path().join("work"));
    segment(&mesh, &["-q", "-k", "3", "-o", &into, "--work-dir", word(&work)]);
    let before = std::fs::read(&list).unwrap();
    let (json, part) = (format!("--json={}", word(&list)), parts.join("part_000.ply"));
    for words in [
        &["segment", word(&mesh), "-o", &into, &json][..],
        &["cluster", "--work-dir", word(&work), "-o", &into, &json],
        &["export", "--work-dir", word(&work), "-o", &into, "--tree", word(&list)],
        &["segment", word(&part), "-o", &into],
        &["segment", word(&mesh), "-o", &into, "-o", word(&part)],
        &["transfer-labels", word(&mesh), word(&part), "-o", &into],
    ] {
        refused(words, 2, "lies in a folder of parts");
    }
    assert!(std::fs::read(&list).unwrap() == before);
    let report = format!("--json={}", word(&parts.join("report.json")));
    segment(&mesh, &["-q", "-k", "3", "-o", &into, &report]);
}

#[test]
fn a_work_directory_is_named_by_position_or_by_option() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 1_000, false);
    let [work, other, tree] = ["work", "other", "t.svg"].map(|name| dir.path().join(name));
    let (work, other, tree) = (word(&work), word(&other), word(&tree));
    for (folder, place) in [(work, &["--work-dir", work][..]), (other, &[other])] {
        for shard in ["0/2", "1/2"] {
            ok(&["rows", word(&mesh), "-q", "-l", "8", "--work-dir", folder, "--shard", shard]);
        }
        ok(&[&["merge", "-q"][..], place].concat());
    }
    segment(&mesh, &["-q", "-k", "3", "--work-dir", work, "-o", word(&dir.path().join("x.seg"))]);
    for words in [&["info"][..], &["verify", "-q"], &["plot", "--tree", tree], &["merge", "-q"]] {
        let forms = [&["--work-dir", work][..], &[work]].map(|place| {
            let output = ok(&[words, place].concat());
            (output.stdout, std::fs::read(tree).ok())
        });
        assert!(forms[0] == forms[1], "{words:?}");
        for place in [&[][..], &[work, "--work-dir", work]] {
            let output = run(&[words, place].concat());
            assert_eq!(output.status.code(), Some(2), "{words:?} {place:?}: {}", errors(&output));
        }
    }
}

#[test]
fn cluster_keeps_the_options_that_are_not_given_again() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 2_000, false);
    let (work, a, b) = (dir.path().join("work"), dir.path().join("a.seg"), dir.path().join("b.seg"));
    let options =
        ["-q", "--decision", "single", "--tiny-components", "own", "--walls", "own", "--boundaries", "embedding"];
    segment(&mesh, &[&options[..], &["-k", "3", "-o", word(&a), "--work-dir", word(&work)]].concat());
    let report = json(&["cluster", "-q", "--work-dir", word(&work), "-k", "5", "-o", word(&b), "--json"]);
    let kept = &report["options"];
    assert_eq!((&kept["parts"]["decision"], &kept["boundaries"]), (&"single".into(), &"embedding".into()), "{kept}");
    assert_eq!((&kept["tiny_components"], &kept["walls"]), (&"own".into(), &"own".into()), "{kept}");
    segment(&mesh, &[&options[..], &["-k", "5", "-o", word(&a)]].concat());
    assert!(std::fs::read(&a).unwrap() == std::fs::read(&b).unwrap(), "the parts of segment with these options");
}

#[test]
fn an_output_is_never_the_mesh_itself_and_braces_stand_for_its_name() {
    let dir = common::in_memory();
    let mesh = shapes::dumbbell().write(dir.path());
    let before = std::fs::read(&mesh).unwrap();
    let misused = |words: &[&str], problem: &str| {
        refused(words, 2, problem);
    };
    misused(&["segment", word(&mesh), "-o", word(&mesh)], "is the mesh itself");
    let roundabout = dir.path().join("../").join(dir.path().file_name().unwrap()).join("dumbbell.ply");
    misused(&["segment", word(&mesh), "-o", word(&roundabout)], "is the mesh itself");
    misused(&["segment", word(dir.path()), "-o", word(&dir.path().join("{}.ply"))], "is the mesh itself");
    assert_eq!(std::fs::read(&mesh).unwrap(), before);
    misused(&["segment", "-", "-o", "{}.seg"], "standard input has no name");
    misused(&["segment", word(&mesh), "--ply-form", "ascii", "-o", "x.seg"], "--ply-form requires a .ply output");
    misused(&["segment", word(&mesh), "--json", "report.json"], "--json=FILE");
    segment(&mesh, &["-k", "3", "-q", "-o", word(&dir.path().join("{}.seg"))]);
    assert_eq!(names(dir.path()), ["dumbbell.ply", "dumbbell.seg"]);
}

/// A name that was mistyped left an empty work directory, and in a folder that is read-only it was that folder's fault.
#[test]
fn no_folder_is_made_for_a_mesh_that_is_not_there() {
    let dir = common::in_memory();
    let mesh = shapes::tetrahedron().write(dir.path());
    let (absent, work) = (dir.path().join("absent.ply"), dir.path().join("work"));
    let kept = ["--work-dir", word(&work)];
    let picture = dir.path().join("x.png");
    for words in [
        &["segment", word(&absent), kept[0], kept[1]][..],
        &["sequence", word(&absent), kept[0], kept[1]],
        &["correspond", word(&mesh), word(&absent), kept[0], kept[1], "-o", "m.npy"],
        &["picture", word(&absent), "-o", word(&picture), "--tmp", "/nonexistent"],
        &["transfer-labels", word(&absent), word(&mesh), "-o", word(&picture), "--tmp", "/nonexistent"],
    ] {
        refused(words, 1, "absent.ply: cannot open: ");
        assert_eq!(names(dir.path()), ["tetrahedron.ply"], "{words:?}");
    }
}

/// Regression: a run that failed while it read the mesh left a work directory that held nothing but a lock file.
#[test]
fn no_folder_stays_of_a_run_that_fails_at_once() {
    let dir = common::in_memory();
    let mesh = shapes::tetrahedron().write(dir.path());
    let (bad, work) = (dir.path().join("bad.ply"), dir.path().join("deep/work"));
    std::fs::write(&bad, "no mesh").unwrap();
    for words in [
        &["segment", word(&bad)][..],
        &["segment", word(&mesh), "-k", "5"],
        &["graph", word(&bad)],
        &["rows", word(&bad)],
        &["share", "rows", word(&bad), "--shard", "0/2"],
        &["sequence", word(&bad)],
        &["correspond", word(&mesh), word(&bad), "-o", "m.npy"],
    ] {
        refused(&[words, &["--work-dir", word(&work)]].concat(), 1, "");
        assert_eq!(names(dir.path()), ["bad.ply", "tetrahedron.ply"], "{words:?}");
    }
}

/// Regression: the mesh that was decoded stayed, with its folder, where a run failed before its first stage.
#[test]
fn no_decoded_mesh_stays_without_a_use() {
    let dir = common::in_memory();
    let mesh = dir.path().join("mesh.off");
    std::fs::write(&mesh, "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n").unwrap();
    let (work, out) = (dir.path().join("work"), dir.path().join("x.seg"));
    let kept = ["--work-dir", word(&work), "-q", "-o", word(&out)];
    for file in [word(&mesh), "-"] {
        let input = std::fs::File::open(&mesh).unwrap();
        let words = [&["segment", file, "--hints", "none"], &kept[..]].concat();
        let output = program().args(words).stdin(input).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{}", errors(&output));
        assert_eq!(names(dir.path()), ["mesh.off"], "{file}: {}", errors(&output));
    }
    // Nor does that of a mesh which may not use the directory, or which another one replaces.
    let other = shapes::tetrahedron().write(dir.path());
    let decoded = || ["input", "input.ply", "converted.ply"].map(|name| work.join(name).exists());
    segment(&other, &kept);
    let piped = [&["segment", "-"], &kept[..]].concat();
    let output = program().args(&piped).stdin(std::fs::File::open(&mesh).unwrap()).output().unwrap();
    assert!(errors(&output).contains("belongs to another mesh"), "{}", errors(&output));
    assert_eq!(decoded(), [false; 3]);
    segment(&mesh, &[&kept[..], &["--force"]].concat());
    assert_eq!(decoded(), [false, false, true]);
    segment(&other, &[&kept[..], &["--force"]].concat());
    assert_eq!(decoded(), [false; 3]);
}

/// A folder that takes no file was found at the end, after a night's work.
#[test]
fn outputs_that_cannot_be_written_are_told_before_any_work() {
    let dir = common::in_memory();
    let mesh = shapes::dumbbell().write(dir.path());
    let (work, labels) = (dir.path().join("work"), dir.path().join("labels.seg"));
    segment(&mesh, &["-q", "-k", "3", "--work-dir", word(&work), "-o", word(&labels)]);
    let (mesh, work, new) = (word(&mesh), word(&work), dir.path().join("new"));
    let new = ["--work-dir", word(&new)];
    for (words, output) in [
        (&["segment", mesh, new[0], new[1], "-o", word(&labels), "-o", "/proc/x.npy"][..], "x.npy"),
        (&["segment", mesh, new[0], new[1], "-o", word(&labels), "--json=/proc/r.json"], "r.json"),
        (&["segment", mesh, mesh, "-o", word(&dir.path().join("{}.seg")), "--json-lines=/proc/r.jsonl"], "r.jsonl"),
        (&["sequence", mesh, new[0], new[1], "-o", "/proc/s.ply"], "s.ply"),
        (&["correspond", mesh, mesh, new[0], new[1], "-o", "/proc/m.npy"], "m.npy"),
        (&["picture", mesh, "-o", "/proc/p.png"], "p.png"),
        (&["transfer-labels", mesh, mesh, "--labels", word(&labels), "-o", "/proc/t.seg"], "t.seg"),
        (&["cluster", "--work-dir", work, "-k", "2", "-o", "/proc/c.seg"], "c.seg"),
        (&["export", "--work-dir", work, "-o", word(&labels), "--tree", "/proc/tree.json"], "tree.json"),
        (&["quality", mesh, "-l", "5", "--csv", "/proc/q.csv"], "q.csv"),
        (&["plan", mesh, "--json=/proc/plan.json"], "plan.json"),
    ] {
        let output_said = errors(&run(words));
        assert!(output_said.starts_with(&format!("nystrom-stream: /proc/{output}: cannot create: ")), "{output_said}");
        assert_eq!(output_said.lines().count(), 1, "{output_said}");
        assert!(!Path::new(new[1]).exists(), "{words:?}");
    }
}

/// The note about outliers spoke of 60 landmarks on a mesh of one face, and the rate had no space.
#[test]
fn what_is_told_of_a_mesh_of_one_face_is_so() {
    let dir = common::in_memory();
    let mesh = dir.path().join("one.off");
    std::fs::write(&mesh, "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n").unwrap();
    let told = errors(&segment(&mesh, &["-o", word(&dir.path().join("one.seg"))]));
    assert!(!told.contains("outliers") && !told.contains("of 60"), "{told}");
    assert!(told.lines().next_back().unwrap().starts_with("1 face in 1 part in "), "{told}");
    for line in told.lines().filter(|line| line.contains("/s") && !line.contains(word(dir.path()))) {
        let rate = line.rsplit(", ").next().unwrap().split(' ').collect::<Vec<_>>();
        assert!(rate.len() >= 2 && rate.last().unwrap().ends_with("/s"), "a number, a space and a unit: {line}");
    }
}

#[test]
fn what_cluster_leaves_is_said_with_where_and_how_to_get_a_mesh() {
    let dir = common::in_memory();
    let (mesh, work) = (shapes::dumbbell().write(dir.path()), dir.path().join("staged"));
    ok(&["graph", word(&mesh), "-q", "--work-dir", word(&work)]);
    let output = run(&["cluster", "-k", "2", "--work-dir", word(&work)]);
    let told = String::from_utf8(output.stdout).unwrap();
    let labels = work.join("labels.npy");
    assert!(
        told.ends_with(&format!(" faces in 2 parts, labels in {}; -o OUT writes a mesh\n", word(&labels))),
        "{told}"
    );
}

/// Regression: what has an output's name with `.partial` behind was removed, also where it was the mesh. The report of
/// three commands could replace the mesh of a work directory, and a folder in a report's place was found at the end.
#[test]
fn outputs_replace_no_mesh_and_no_folder() {
    let dir = common::in_memory();
    let path = |name: &str| dir.path().join(name);
    let mesh = shapes::dumbbell().write(dir.path());
    let (work, scan) = (path("work"), path("scan.ply.partial"));
    segment(&mesh, &["-q", "-k", "3", "--work-dir", word(&work), "-o", word(&path("labels.seg"))]);
    std::fs::rename(&mesh, &scan).unwrap();
    std::fs::copy(&scan, &mesh).unwrap();
    let refused = |words: &[&str], code: i32, problem: &str| {
        refused(words, code, problem);
    };
    let outputs = [path("scan.ply"), path("x.seg")].map(|path| word(&path).to_string());
    refused(&["segment", word(&scan), "-o", &outputs[0]], 2, "is written to a .partial file first, which is an input");
    let json = format!("--json={}", word(&mesh));
    for command in ["info", "verify", "merge"] {
        refused(&[command, "--work-dir", word(&work), &json], 2, "is an input, and would be overwritten");
        // Regression: `merge` left an empty work directory.
        refused(&[command, "--work-dir", word(&path("missing"))], 1, "is not a work directory");
        assert!(!path("missing").exists());
    }
    // Regression: so did `graph`.
    for command in ["graph", "rows", "segment"] {
        refused(&[command, word(&path("no.ply")), "--work-dir", word(&path("missing"))], 1, "no.ply: cannot open");
        assert!(!path("missing").exists(), "{command}");
    }
    let folder = format!("--json={}", word(dir.path()));
    refused(&["segment", word(&mesh), "-o", &outputs[1], &folder], 1, "is a folder; give a file");
    let long = path(&"x".repeat(250)).with_extension("seg");
    refused(&["segment", word(&mesh), "-o", word(&long)], 1, "its name is too long");
    assert!(scan.exists() && std::fs::read(&mesh).unwrap() == std::fs::read(&scan).unwrap());
}

/// Regression: an existing folder was written twice under two names, or into the work directory, and a missing file
/// among several was found after the work on those before it.
#[test]
fn folders_and_several_files_are_looked_at_before_any_work() {
    let dir = common::in_memory();
    let path = |name: &str| dir.path().join(name);
    let told = |words: &[&str], code: i32, problem: &str| {
        let output = program().current_dir(dir.path()).args(words).output().unwrap();
        let told = errors(&output);
        assert!(output.status.code() == Some(code) && told.contains(problem), "{words:?}: {told}");
        assert!(!told.contains("dual graph") && !told.contains("reading"), "{words:?} worked first: {told}");
    };
    shapes::dumbbell().write(dir.path());
    let mesh = "dumbbell.ply";
    std::fs::create_dir(path("parts")).unwrap();
    for other in ["./parts/", "parts/../parts/"] {
        told(&["segment", mesh, "-o", "parts/", "-o", other], 2, "two outputs cannot have the same name");
    }
    told(&["segment", mesh, "-o", "parts"], 1, "parts: is a folder; end it with / for one file per part");
    segment(&path(mesh), &["-q", "-k", "2", "--work-dir", word(&path("work")), "-o", word(&path("x.seg"))]);
    told(&["segment", mesh, "--work-dir", "work", "-o", "work/"], 2, "lies in the work directory");
    told(&["segment", "[", "-o", "x.seg"], 2, "write [[] for a bracket");
    told(&["quality", mesh, "no.ply", "--compare", "-l", "5"], 1, "no.ply: cannot open");
    told(&["evaluate", "x.seg", "--mesh", mesh, "--truth", "no.seg"], 1, "no.seg: cannot open");
    std::fs::write(path("edits.json"), r#"{"format": "nystrom-stream edits", "version": 1, "edits": []}"#).unwrap();
    for words in [["-o", "none/x.ply"], ["--json=none/x.json", "-q"]] {
        let like = ["segment", mesh, "--like", mesh, "--edits", "edits.json"];
        told(&[&like[..], &words].concat(), 1, "its folder none does not exist");
    }
    // Those of pictures, before boundaries and matches.
    let little = ["--max-memory", "20MiB"];
    told(&[&["cluster", "--work-dir", "work", "-o", "x.png"][..], &little].concat(), 1, "the picture needs");
    told(&[&["export", "--work-dir", "work", "-o", "x.png"][..], &little].concat(), 1, "the picture needs");
    told(&[&["correspond", mesh, mesh, "--picture", "x.png"][..], &little].concat(), 1, "the picture needs");
    // Regression: a map of an unknown format was found after both meshes were read, and ended with 1.
    let map = ["correspond", mesh, mesh, "-o", "x.npy", "--initial-map", "x.seg"];
    told(&map, 2, "x.seg: unknown extension; give a .npy or .csv file");
    // Regressions: it was looked for as a file; a file was said not to exist; a folder was to get another name.
    told(
        &["evaluate", "x.seg", "--mesh", "-", "--truth", "x.seg"],
        1,
        "-: standard input is not read here; give a file",
    );
    told(&["segment", mesh, "-o", "x.seg/x.ply"], 1, "its folder x.seg is not a folder; choose another");
    told(
        &["segment", mesh, "-o", "x.ply", "--edits", "work"],
        1,
        "work: cannot read: Is a directory (os error 21); give a file",
    );
    // Names, before a hierarchy is written.
    let export = ["export", "--work-dir", "work", "-o", "x.ply", "--names", "no.tsv", "--tree", "tree.json"];
    told(&export, 1, "no.tsv: cannot read");
    assert!(!path("tree.json").exists());
}

/// Regression: files of edits, names and hierarchies were read whole whatever their size.
#[test]
fn files_that_people_write_are_refused_where_they_are_huge() {
    let dir = common::in_memory();
    let (mesh, huge) = (shapes::dumbbell().write(dir.path()), dir.path().join("huge"));
    std::fs::File::create(&huge).unwrap().set_len(1 << 30).unwrap();
    for option in ["--edits", "--names"] {
        refused(
            &["segment", word(&mesh), option, word(&huge), "-o", word(&dir.path().join("x.ply"))],
            1,
            "is larger than 64 MiB",
        );
    }
}

/// Regression: a signal was heeded at the second time only while standard input sent nothing, and while nobody had
/// opened a named pipe for writing. The message said to continue with `--resume`, which standard input cannot.
#[cfg(unix)]
#[test]
fn an_interrupt_ends_waiting_for_a_pipe() {
    use std::os::unix::process::ExitStatusExt;
    use std::time::{Duration, Instant};
    let (dir, pipes) = (common::in_memory(), common::in_memory());
    let (out, pipe) = (dir.path().join("x.seg"), pipes.path().join("p.ply"));
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let (out, pipe) = (word(&out), word(&pipe));
    for words in [&["info", "-"][..], &["segment", "-", "-o", out], &["info", pipe], &["segment", pipe, "-o", out]] {
        let mut child = program()
            .args(words)
            .args(["--tmp", word(dir.path())])
            .stdin(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // It has begun to read once its folder is there.
        let begun = Instant::now();
        while names(dir.path()).is_empty() && begun.elapsed() < Duration::from_secs(60) {
            std::thread::sleep(Duration::from_millis(10));
        }
        let id = child.id().to_string();
        assert!(std::process::Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
        // Standard input stays open.
        let input = child.stdin.take();
        let output = child.wait_with_output().unwrap();
        drop(input);
        assert_eq!(output.status.signal(), Some(15), "{words:?}: {}", errors(&output));
        assert_eq!(errors(&output).trim_end(), "nystrom-stream: interrupted");
        assert_eq!(names(dir.path()), [""; 0]);
    }
}
