//! `evaluate` on the command line: equal to the library, errors of one line, exit codes; and `--cluster two-means`.

use crate::common;
use nystrom_stream::apps::evaluate::{Benchmark, compare};
use nystrom_stream::mesh::{self, read_seg, write_seg};
use nystrom_stream::store::{Run, npy};
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;

/// Two humps on a strip of squares, n long, as an ASCII PLY; faces from left to right.
fn write_mesh(path: &Path, n: u32) {
    let side = 7;
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", (n + 1) * side);
    text += "property float x\nproperty float y\nproperty float z\n";
    let _ = write!(text, "element face {}\nproperty list uchar int vertex_indices\nend_header\n", 2 * n * (side - 1));
    for v in 0..(n + 1) * side {
        let (x, y) = (f64::from(v / side), f64::from(v % side));
        let _ = writeln!(text, "{x} {y} {}", 3. * (x / f64::from(n) * 6.3).sin().abs() * (y / 6. * 3.1).sin());
    }
    for q in 0..n * (side - 1) {
        let v = q / (side - 1) * side + q % (side - 1);
        let _ = write!(text, "3 {v} {} {}\n3 {v} {} {}\n", v + side, v + side + 1, v + side + 1, v + 1);
    }
    std::fs::write(path, text).unwrap();
}

/// Labels that change at these shares of `n`.
fn steps(n: usize, at: &[f64]) -> Vec<u32> {
    (0..n).map(|f| at.iter().filter(|&&x| f as f64 >= x * n as f64).count() as u32).collect()
}

/// A benchmark of two models in two categories, labels of the first three people each, and a folder of labels.
fn folder() -> tempfile::TempDir {
    let dir = common::in_memory();
    let run = Run::new(&());
    let mut table = String::from("model\tcategory\tfaces\tparts\n");
    for (model, category, n) in [("1", "hump", 20), ("2", "hill", 30)] {
        write_mesh(&dir.path().join(format!("{model}.ply")), n);
        let faces = 12 * n as usize;
        for (j, at) in [&[0.5][..], &[0.45, 0.8], &[0.3]].into_iter().enumerate() {
            write_seg(&dir.path().join(format!("{model}_{j}.seg")), &steps(faces, at), &run).unwrap();
        }
        let _ = writeln!(table, "{model}\t{category}\t{faces}\t2");
    }
    std::fs::write(dir.path().join("models.tsv"), table).unwrap();
    std::fs::create_dir(dir.path().join("ours")).unwrap();
    write_seg(&dir.path().join("ours/1.seg"), &steps(240, &[0.4, 0.7]), &run).unwrap();
    npy::write::<u32>(&dir.path().join("ours/2.npy"), &steps(360, &[0.55]), 1, false).unwrap();
    dir
}

/// Runs and tells standard output, standard error and exit code.
fn outcome(folder: &Path, arguments: &str) -> (String, String, i32) {
    let output = common::program().current_dir(folder).args(arguments.split_whitespace()).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (text(output.stdout), text(output.stderr), output.status.code().unwrap())
}

#[test]
fn scores_are_those_of_the_library() {
    let dir = folder();
    let run = Run::new(&());
    let mesh = mesh::open(&dir.path().join("1.ply"), dir.path(), &run).unwrap();
    let read = |name: &str| read_seg(&dir.path().join(name)).unwrap();
    let scores = compare(Some(&mesh), &read("ours/1.seg"), &read("1_1.seg")).unwrap();
    let (out, err, code) =
        outcome(dir.path(), "evaluate ours/1.seg --mesh 1.ply --truth 1_0.seg --truth 1_1.seg --json");
    assert_eq!((code, err.as_str()), (0, ""));
    let json: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(json["parts"], 3);
    let second = &json["truths"][1];
    let expected = serde_json::to_value(scores).unwrap();
    for (metric, value) in expected.as_object().unwrap() {
        assert_eq!(&second[metric], value, "{metric}");
    }
    let mean = (json["truths"][0]["rand"].as_f64().unwrap() + scores.rand) / 2.;
    assert!((json["scores"]["rand"].as_f64().unwrap() - mean).abs() < 1e-15);
    assert!(json["people"]["rand"].as_f64().unwrap() > 0.);
}

#[test]
fn labels_in_a_mesh_and_without_a_mesh_are_judged() {
    let dir = folder();
    let (_, err, code) = outcome(dir.path(), "segment 1.ply -q -k 2 -o out.ply -o out.seg --cluster two-means");
    assert_eq!((code, err.as_str()), (0, ""));
    let (out, err, code) = outcome(dir.path(), "evaluate out.ply --truth out.seg --json");
    assert_eq!((code, err.as_str()), (0, ""));
    let json: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(json["scores"]["rand"], 0.);
    assert_eq!(json["scores"]["cut_discrepancy"], 0.);
    let (out, _, code) = outcome(dir.path(), "evaluate out.seg --truth 1_0.seg --truth 1_1.seg");
    assert_eq!(code, 0);
    assert!(out.starts_with("truth") && out.contains("\npeople") && out.lines().count() == 6, "{out}");
}

#[test]
fn a_benchmark_gives_a_table_json_and_charts() {
    let dir = folder();
    let expected = Benchmark::open(dir.path()).unwrap();
    let expected = expected.evaluate(Some(&dir.path().join("ours")), true, &Run::new(&())).unwrap();
    let (out, err, code) = outcome(dir.path(), "evaluate --benchmark . ours --json=t.json --plot t.svg -q");
    assert_eq!((code, err.as_str()), (0, ""));
    assert_eq!(out, expected.table.to_text());
    assert!(out.contains("hump") && out.contains("all models") && out.contains("people"));
    let json = std::fs::read_to_string(dir.path().join("t.json")).unwrap();
    assert_eq!(json.trim_end(), expected.table.to_json().unwrap());
    let chart = std::fs::read_to_string(dir.path().join("t.svg")).unwrap();
    assert!(chart.contains("<svg") && chart.contains("hump") && chart.contains("people"));
    let (people, _, code) = outcome(dir.path(), "evaluate --benchmark . -q --no-cuts");
    assert_eq!(code, 0);
    assert!(people.contains("hill") && !people.contains("\npeople"));
    assert_eq!(outcome(dir.path(), "evaluate --benchmark . ours --plot t.png -q").2, 0);
    assert!(std::fs::read(dir.path().join("t.png")).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn a_model_without_labels_is_left_out_and_said() {
    let dir = folder();
    std::fs::remove_file(dir.path().join("ours/2.npy")).unwrap();
    let (out, err, code) = outcome(dir.path(), "evaluate --benchmark . ours");
    assert_eq!(code, 0);
    assert!(err.contains("no labels for 1 model, left out: 2") && !out.contains("hill"), "{err}{out}");
}

#[test]
fn what_is_wrong_is_said_in_one_line() {
    let dir = folder();
    std::fs::write(dir.path().join("short.seg"), "1\n2\n").unwrap();
    std::fs::create_dir(dir.path().join("empty")).unwrap();
    std::fs::create_dir(dir.path().join("latin")).unwrap();
    std::fs::write(dir.path().join("latin/models.tsv"), b"model\tcategory\n1\th\xfcgel\n").unwrap();
    std::fs::create_dir(dir.path().join("double")).unwrap();
    std::fs::write(dir.path().join("double/models.tsv"), "model\tcategory\n1\thump\n2\thill\n1\thump\n").unwrap();
    std::fs::create_dir(dir.path().join("blank")).unwrap();
    std::fs::write(dir.path().join("blank/models.tsv"), "model\tcategory\n1\thump\n\n2 hill\n").unwrap();
    for (arguments, expected, part) in [
        ("evaluate short.seg --mesh 1.ply --truth 1_0.seg", 1, "short.seg: has 2 labels for 240 faces"),
        ("evaluate ours/1.seg --mesh 1.ply --truth 2_0.seg", 1, "2_0.seg: has 360 labels"),
        (
            "evaluate short.seg --truth 1_0.seg",
            1,
            "1_0.seg: has 240 labels, but short.seg has 2; give labels of the same",
        ),
        ("evaluate ours/1.seg --mesh 1.ply --truth none.seg", 1, "none.seg"),
        ("evaluate 1.ply --truth 1_0.seg", 1, "no face property `label`"),
        // Regression: both ended with 1, the second only after the labels had been read.
        (
            "evaluate models.tsv --truth 1_0.seg",
            2,
            "LABELS models.tsv: unknown extension; give a .seg, .npy or .ply file",
        ),
        (
            "evaluate short.seg --mesh 1.ply --truth 1_0.seg --truth models.tsv",
            2,
            "--truth models.tsv: unknown extension",
        ),
        ("evaluate --benchmark . empty", 1, "has no labels of any model"),
        ("evaluate --benchmark . nowhere", 1, "nowhere"),
        ("evaluate --benchmark empty ours", 1, "models.tsv"),
        // Regression: the text of the system's error, without a remedy.
        ("evaluate --benchmark latin ours", 1, "models.tsv: is not UTF-8; save it as UTF-8"),
        // Regression: such a model counted double.
        ("evaluate --benchmark double ours", 1, "models.tsv: names the model \"1\" twice"),
        ("evaluate --benchmark . ours --plot t.txt", 2, "use .svg or .png"),
        // Regression: refused only after the work.
        ("evaluate --benchmark . ours --plot t.png/", 1, "t.png/: is the name of a folder; leave out the /"),
        // Regression: such lines were left out without a word, and the means looked complete.
        ("evaluate --benchmark blank ours", 1, "models.tsv: line 4: no category; separate the fields by tabs"),
        // Regression: people's labels were replaced by the report.
        ("evaluate --benchmark . ours --json=1_0.seg", 2, "1_0.seg: is an input, and would be overwritten"),
        ("evaluate --benchmark . ours --json=models.tsv", 2, "models.tsv: is an input"),
        ("evaluate --benchmark . ours --json=ours/1.seg", 2, "ours/1.seg: is an input"),
    ] {
        let (out, err, code) = outcome(dir.path(), &format!("{arguments} --quiet"));
        assert_eq!(code, expected, "{arguments}: {err}");
        assert!(err.contains(part) && err.trim_end().lines().count() == 1 && out.is_empty(), "{arguments}: {err}{out}");
    }
    for arguments in [
        "evaluate",
        "evaluate ours/1.seg",
        "evaluate --benchmark . ours --truth 1_0.seg",
        "evaluate --benchmark . --plot x.svg",
    ] {
        assert_eq!(outcome(dir.path(), arguments).2, 2, "{arguments}");
    }
}

#[test]
fn two_means_keeps_exactly_k_parts() {
    let dir = folder();
    for (options, parts) in
        [("-k 1", 1..=1), ("-k 5", 5..=5), ("-k 17 -l 8", 17..=17), ("", 1..=30), ("--parts-range 3..4", 3..=4)]
    {
        let arguments = format!("segment 2.ply -q --cluster two-means -o out.seg --json=- {options}");
        let (out, err, code) = outcome(dir.path(), &arguments);
        assert_eq!((code, err.as_str()), (0, ""), "{options}");
        let json: Value = serde_json::from_str(&out).unwrap();
        let found = json["parts"].as_array().unwrap();
        assert!(parts.contains(&found.len()), "{options}: {}", found.len());
        assert!(found.iter().all(|part| part["faces"].as_u64().unwrap() > 0), "{options}");
        let mut labels = read_seg(&dir.path().join("out.seg")).unwrap();
        labels.sort_unstable();
        labels.dedup();
        assert_eq!(labels.len(), found.len(), "{options}");
    }
}
