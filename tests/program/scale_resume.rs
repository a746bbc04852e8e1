//! Runs that are killed, resumed, shared out, damaged: the same bytes or a clear error, never a wrong label.

use crate::common::{self, every_case, ok, word};
use nystrom_stream::base::random::{below, stream};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn creature(folder: &Path, faces: u64) -> PathBuf {
    common::creature(folder, faces, false)
}

fn program(arguments: &[&str]) -> Command {
    let mut command = common::program();
    command.args(arguments).stdin(Stdio::null());
    command
}

#[test]
fn killed_at_any_moment_and_resumed_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 60_000);
    let (out, work) = (dir.path().join("labels.npy"), dir.path().join("work"));
    // With rows over all faces, and over the contraction.
    let times = if every_case() { [5, 3] } else { [2, 1] };
    killed_and_resumed(&["--exact"], (&mesh, &out, &work), "distances.npy", times[0]);
    std::fs::remove_dir_all(&work).unwrap();
    killed_and_resumed(&[], (&mesh, &out, &work), "contracted/distances.npy", times[1]);
}

/// Kills a run of K-means three times and ends it, `times` times, and compares its labels and its `rows` with those of a whole run.
fn killed_and_resumed(options: &[&str], (mesh, out, work): (&Path, &Path, &Path), rows_file: &str, times: usize) {
    let task = ["segment", word(mesh), "-k", "6", "-l", "10", "--cluster", "kmeans"];
    let arguments = [&task[..], &["--work-dir", word(work), "-o", word(out)], options].concat();
    let start = Instant::now();
    ok(&arguments);
    let whole = start.elapsed();
    let expected = std::fs::read(out).unwrap();
    let rows = std::fs::read(work.join(rows_file)).unwrap();
    let mut draw = stream(std::process::id().into(), "kills");
    for _ in 0..times {
        std::fs::remove_dir_all(work).unwrap();
        std::fs::remove_file(out).unwrap();
        for _ in 0..3 {
            let mut child = program(&arguments).stderr(Stdio::null()).spawn().unwrap();
            let wait = below(&mut draw, whole.as_millis() as usize + 1) as u64;
            std::thread::sleep(Duration::from_millis(wait));
            child.kill().unwrap();
            child.wait().unwrap();
        }
        ok(&arguments);
        assert!(std::fs::read(out).unwrap() == expected);
        assert!(std::fs::read(work.join(rows_file)).unwrap() == rows);
        ok(&["verify", word(work)]);
        let left: Vec<String> = std::fs::read_dir(work)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .filter(|name| [".partial", ".tmp", ".journal"].iter().any(|end| name.ends_with(end)))
            .collect();
        assert!(left.is_empty(), "{left:?}");
    }
}

#[test]
fn rows_are_taken_over_one_by_one_and_torn_ones_are_not() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 20_000);
    let work = dir.path().join("work");
    let arguments = ["rows", word(&mesh), "-k", "6", "-l", "8", "--cluster", "kmeans", "--work-dir", word(&work)];
    ok(&arguments);
    let rows = std::fs::read(work.join("distances.npy")).unwrap();
    // As a killed run would have left it: made from a shard that is the whole.
    let other = dir.path().join("other");
    let shard = ["rows", word(&mesh), "-k", "6", "-l", "8", "--cluster", "kmeans", "--work-dir", word(&other)];
    ok(&[&shard[..], &["--shard", "0/1"]].concat());
    let journal = std::fs::read_to_string(other.join("rows-0-of-1.journal")).unwrap();
    let lines: Vec<&str> = journal.lines().collect();
    std::fs::write(work.join("rows.journal"), lines[..6].join("\n") + "\n").unwrap();
    let mut partial = rows.clone();
    let nodes = (rows.len() - 128) / 4 / 8;
    partial[128 + nodes * 4 * 2 + 1000] ^= 1;
    std::fs::write(work.join("distances.npy.partial"), partial).unwrap();
    std::fs::remove_file(work.join("distances.npy")).unwrap();
    let output = ok(&arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("distances.npy is missing"), "{said}");
    assert!(said.contains(" of 8 reused"), "{said}");
    assert!(std::fs::read(work.join("distances.npy")).unwrap() == rows);
}

/// Regression: a shard of another division in the directory hid those that were whole, and the advice did not help.
#[test]
fn a_shard_of_another_division_is_no_hindrance() {
    let dir = tempfile::tempdir().unwrap();
    let (mesh, work) = (creature(dir.path(), 4_000), dir.path().join("work"));
    for shard in ["0/3", "1/3", "2/3", "1/2"] {
        ok(&["rows", word(&mesh), "-q", "-l", "8", "--work-dir", word(&work), "--shard", shard]);
    }
    ok(&["merge", word(&work), "-q"]);
    let names = std::fs::read_dir(&work).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(names.filter(|name| name.contains("-of-")).count(), 0);
}

#[test]
fn shards_and_merge_are_one_process_byte_for_byte() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 20_000);
    for method in ["kmeans", "parts"] {
        let (one, many) = (dir.path().join(format!("one-{method}")), dir.path().join(format!("many-{method}")));
        let rows = |work: &Path, more: &[&str]| {
            let arguments =
                ["rows", word(&mesh), "-k", "6", "-l", "7", "--cluster", method, "-q", "--work-dir", word(work)];
            program(&[&arguments[..], more].concat())
        };
        assert!(rows(&one, &[]).status().unwrap().success());
        let children: Vec<_> =
            ["0/3", "1/3", "2/3"].map(|shard| rows(&many, &["--shard", shard]).spawn().unwrap()).into();
        assert!(children.into_iter().all(|mut child| child.wait().unwrap().success()));
        ok(&["merge", word(&many)]);
        for file in ["distances.npy", "landmarks.npy"] {
            assert!(std::fs::read(one.join(file)).unwrap() == std::fs::read(many.join(file)).unwrap(), "{file}");
        }
        let out = dir.path().join("labels.npy");
        let output = ok(&[
            "segment",
            word(&mesh),
            "-k",
            "6",
            "-l",
            "7",
            "--cluster",
            method,
            "--work-dir",
            word(&many),
            "-o",
            word(&out),
        ]);
        assert!(String::from_utf8_lossy(&output.stderr).contains("rows: reused"));
        // Once more, as a scheduler would that did not learn how it ended.
        let told = |output: Output| String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(told(ok(&["merge", word(&many)])).contains("already done"));
        let shard = ["rows", word(&mesh), "-k", "6", "-l", "7", "--cluster", method, "--work-dir", word(&many)];
        let told = told(ok(&[&shard[..], &["--shard", "1/3"]].concat()));
        assert!(told.contains("is already merged") && !many.join("rows-1-of-3.npy").exists(), "{told}");
    }
    let work = dir.path().join("half");
    let half = ["rows", word(&mesh), "-k", "6", "--cluster", "kmeans", "--work-dir", word(&work), "--shard", "1/3"];
    ok(&half);
    let merged = program(&["merge", word(&work)]).output().unwrap();
    let said = String::from_utf8_lossy(&merged.stderr);
    assert!(!merged.status.success() && said.contains("rows-0-of-3.npy") && said.lines().count() == 1, "{said}");
}

/// What `share` divides, in this order.
const STEPS: [&str; 5] = ["normals", "contraction", "rows", "depths", "bands"];

#[test]
fn shares_of_k_means_are_one_process_byte_for_byte() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 62_000);
    let (work, out, expected) = (dir.path().join("work"), dir.path().join("out.seg"), dir.path().join("one.seg"));
    let method = ["-k", "5", "--cluster", "kmeans"];
    ok(&[&["segment", word(&mesh), "-q", "-o", word(&expected)], &method[..]].concat());
    let place = ["--work-dir", word(&work)];
    for step in STEPS {
        for shard in ["1/2", "0/2"] {
            ok(&[&["share", step, word(&mesh), "-q", "--shard", shard], &place[..], &method].concat());
        }
    }
    let output = ok(&[&["segment", word(&mesh), "-o", word(&out)], &place[..], &method].concat());
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("coarser mesh: reused") && said.contains("bands: combined from 2 shares"), "{said}");
    assert!(std::fs::read(&out).unwrap() == std::fs::read(&expected).unwrap());
}

#[test]
fn shares_of_the_default_recipe_are_one_process_byte_for_byte() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 62_000);
    let (one, expected) = (dir.path().join("one"), dir.path().join("one.seg"));
    ok(&["segment", word(&mesh), "-q", "--work-dir", word(&one), "-o", word(&expected)]);
    let told = |output: &Output| String::from_utf8_lossy(&output.stderr).into_owned();
    let shared = |work: &Path| -> Vec<String> {
        let names = |folder: &Path| std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        let all = names(work).chain(names(&work.join("contracted")));
        all.filter_map(|name| name.into_string().ok()).filter(|name| name.contains("-of-")).collect()
    };
    // Three shares have one that is neither the first nor the last, which two and one have not.
    for of in [3, 2, 1].into_iter().take(if every_case() { 3 } else { 2 }) {
        let (work, out) = (dir.path().join(format!("work-{of}")), dir.path().join("many.seg"));
        let share = |step: &str, more: &[&str]| {
            ok(&[&["share", step, word(&mesh), "--work-dir", word(&work), "--json"], more].concat())
        };
        for step in STEPS {
            if of == 2 {
                share(step, &["--prepare"]);
            }
            let shards: Vec<String> = (0..of).rev().map(|shard| format!("{shard}/{of}")).collect();
            let count = |shard: &String| {
                let answer = share(step, &["--shard", shard]).stdout;
                let answer: serde_json::Value = serde_json::from_slice(&answer).unwrap();
                answer[if step == "rows" { "rows" } else { "faces" }].as_u64().unwrap()
            };
            let all: u64 = shards.iter().map(count).sum();
            assert_eq!(all, if step == "rows" { 120 } else { file_len(&one.join("surface_shares.npy")) / 4 }, "{step}");
            if step == "rows" {
                continue;
            }
            // One that was killed before it said that it was whole, one damaged on the disk, and the rest once more.
            let front = if step == "normals" { "normals_02" } else { step };
            std::fs::remove_file(work.join(format!("{front}-0-of-{of}.json"))).unwrap();
            let array = work.join(format!("{front}-{}-of-{of}.npy", of - 1));
            let mut bytes = std::fs::read(&array).unwrap();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 1;
            std::fs::write(&array, bytes).unwrap();
            for (k, shard) in shards.iter().enumerate() {
                let again = told(&share(step, &["--shard", shard]));
                assert_eq!(again.contains("is already done"), k > 0 && k + 1 < shards.len(), "{again}");
            }
        }
        let output = ok(&["segment", word(&mesh), "--work-dir", word(&work), "-o", word(&out)]);
        let said = told(&output);
        assert!(said.contains("edge weights: reused") && said.contains("decision: reused"), "{said}");
        for front in ["depths", "bands"] {
            assert!(said.contains(&format!("{front}: combined from {of} share")), "{said}");
        }
        assert!(std::fs::read(&out).unwrap() == std::fs::read(&expected).unwrap());
        for file in ["surface_shares", "graph_weights", "labels", "quality"] {
            assert!(same_bytes(&one, &work, &format!("{file}.npy")), "{file}");
        }
        for file in ["contracted", "graph_weights", "graph_indices", "node_geometry", "distances", "landmarks", "cells"]
        {
            assert!(same_bytes(&one, &work, &format!("contracted/{file}.npy")), "{file}");
        }
        assert_eq!(shared(&work), [""; 0]);
        ok(&["verify", word(&work)]);
        // A scheduler that did not learn how a share ended.
        for step in STEPS {
            let again = told(&share(step, &["--shard", &format!("0/{of}")]));
            assert!(again.contains("nothing to do") || again.contains("is already merged"), "{again}");
        }
    }
    // Of an unfinished division nothing is taken.
    let (work, out) = (dir.path().join("half"), dir.path().join("half.seg"));
    let half = |step| told(&ok(&["share", step, word(&mesh), "--work-dir", word(&work), "--shard", "1/2"]));
    let said =
        STEPS.map(half).concat() + &told(&ok(&["segment", word(&mesh), "--work-dir", word(&work), "-o", word(&out)]));
    for what in [
        "normals_02: not all 2",
        "coarser mesh: not all 2",
        "rows-0-of-2.npy: this shard is missing",
        "bands: not all 2",
    ] {
        assert!(said.contains(what), "{what} {said}");
    }
    assert!(!said.contains("distance rows: reused") && said.contains("depths: combined from 1 share"), "{said}");
    assert!(std::fs::read(&out).unwrap() == std::fs::read(&expected).unwrap());
    // What cannot be divided is said to be done; what is no share is refused.
    let small = dir.path().join("small");
    std::fs::create_dir(&small).unwrap();
    let small = creature(&small, 1_000);
    for step in STEPS {
        let place = ["share", step, word(&small), "--work-dir", word(&dir.path().join("little"))].map(String::from);
        let words = |more: &[&str]| -> Vec<String> {
            place.iter().cloned().chain(more.iter().map(|word| word.to_string())).collect()
        };
        let run = |words: Vec<String>| program(&words.iter().map(String::as_str).collect::<Vec<_>>()).output().unwrap();
        assert!(told(&run(words(&["--shard", "0/2"]))).contains("nothing to do"));
        for wrong in [
            &[][..],
            &["--shard", "2/2"],
            &["--shard", "0"],
            &["--shard", "0/2", "--prepare"],
            &["--shard", "0/2", "--exact"],
        ] {
            assert_eq!(run(words(wrong)).status.code(), Some(2), "{step} {wrong:?}");
        }
    }
    for step in STEPS {
        let work = dir.path().join("many");
        let many = ["share", step, word(&mesh), "-q", "--work-dir", word(&work), "--shard", "0/50000"];
        assert_eq!(program(&many).output().unwrap().status.code(), Some(2), "{step}");
    }
}

fn file_len(path: &Path) -> u64 {
    std::fs::metadata(path).unwrap().len() - 128
}

fn same_bytes(one: &Path, many: &Path, file: &str) -> bool {
    std::fs::read(one.join(file)).unwrap() == std::fs::read(many.join(file)).unwrap()
}

#[test]
fn shards_take_no_weights_of_other_options() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 5_000);
    let (one, many) = (dir.path().join("one"), dir.path().join("many"));
    let rows = |work: &Path, more: &[&str]| {
        let arguments = ["rows", word(&mesh), "-l", "6", "--work-dir", word(work), "--json"];
        serde_json::from_slice::<serde_json::Value>(&ok(&[&arguments[..], more].concat()).stdout).unwrap()
    };
    assert_eq!(rows(&one, &[])["rows"], 6);
    let told = rows(&many, &["--prepare"]);
    assert!(told["seconds"]["weights"].is_number() && told["rows"].is_null(), "{told}");
    assert!(rows(&many, &["--prepare"])["seconds"]["weights"].is_null());
    // Another run replaces the weights that the shards were promised.
    rows(&many, &["--metric", "geodesic"]);
    let told = rows(&many, &["--shard", "1/2"]);
    assert!(told["seconds"]["weights"].is_number() && told["rows"] == 3 && told["shard"][1] == 2, "{told}");
    rows(&many, &["--shard", "0/2"]);
    let merged: serde_json::Value = serde_json::from_slice(&ok(&["merge", word(&many), "--json"]).stdout).unwrap();
    assert_eq!(merged["rows"], 6);
    assert!(std::fs::read(one.join("distances.npy")).unwrap() == std::fs::read(many.join("distances.npy")).unwrap());
}

#[test]
fn damaged_and_busy_directories_are_told_apart() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 5_000);
    let (out, work) = (dir.path().join("labels.npy"), dir.path().join("work"));
    let arguments =
        ["segment", word(&mesh), "-k", "4", "--cluster", "kmeans", "--work-dir", word(&work), "-o", word(&out)];
    ok(&arguments);
    let expected = std::fs::read(&out).unwrap();
    let info = ok(&["info", word(&work)]);
    assert!(String::from_utf8_lossy(&info.stdout).contains("graph_indices.npy"));

    let path = work.join("graph_weights.npy");
    let whole = std::fs::read(&path).unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 4;
    std::fs::write(&path, flipped).unwrap();
    let output = program(&["verify", word(&work)]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1));
    assert!(said.contains("graph_weights.npy") && said.contains("checksum"), "{said}");

    // Truncated and missing files are made anew; no wrong label comes out.
    for damage in [&whole[..whole.len() / 2], &[]] {
        std::fs::write(&path, damage).unwrap();
        ok(&arguments);
        assert!(std::fs::read(&out).unwrap() == expected && std::fs::read(&path).unwrap() == whole);
    }
    std::fs::write(work.join("manifest.json"), "{").unwrap();
    let output = program(&arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("manifest.json"), "{said}");

    std::fs::remove_dir_all(&work).unwrap();
    let held = nystrom_stream::store::WorkDir::open(&work).unwrap();
    let output = program(&arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("in use by another run"), "{said}");
    drop(held);
    ok(&arguments);
    assert!(std::fs::read(&out).unwrap() == expected);
}

#[cfg(target_os = "linux")]
#[test]
fn an_input_that_shrinks_while_it_is_read_is_told_and_the_work_can_be_taken_up() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 300_000);
    let whole = std::fs::read(&mesh).unwrap();
    let (out, work) = (dir.path().join("labels.npy"), dir.path().join("work"));
    let arguments = [
        "segment",
        word(&mesh),
        "-k",
        "4",
        "-l",
        "6",
        "--cluster",
        "kmeans",
        "--work-dir",
        word(&work),
        "-o",
        word(&out),
    ];
    ok(&arguments);
    let expected = std::fs::read(&out).unwrap();
    let mut told = 0;
    for wait in [0, 5, 10, 20, 40, 80] {
        std::fs::remove_dir_all(&work).unwrap();
        let child = program(&arguments).stderr(Stdio::piped()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(wait));
        std::fs::File::options().write(true).open(&mesh).unwrap().set_len(4096).unwrap();
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        // Done before, or an error; never a signal.
        assert!(matches!(output.status.code(), Some(0 | 1)), "after {wait} ms: {:?} {said}", output.status);
        if output.status.code() == Some(1) {
            assert!(said.contains("creature_300000.ply") || said.contains("shrank"), "after {wait} ms: {said}");
            told += 1;
        }
        std::fs::write(&mesh, &whole).unwrap();
        ok(&arguments);
        assert!(std::fs::read(&out).unwrap() == expected, "after {wait} ms");
    }
    assert!(told > 0);
}

#[cfg(unix)]
#[test]
fn a_disk_that_fills_up_is_an_error_and_no_signal() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 100_000);
    let (out, work) = (dir.path().join("labels.npy"), dir.path().join("work"));
    let line = format!(
        "ulimit -f 1500; exec '{}' segment '{}' -k 4 --cluster kmeans --work-dir '{}' -o '{}'",
        env!("CARGO_BIN_EXE_nystrom-stream"),
        word(&mesh),
        word(&work),
        word(&out)
    );
    let output = Command::new("sh").args(["-c", &line]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains(word(&work)), "{said}");
    assert!(!out.exists());
    ok(&["segment", word(&mesh), "-k", "4", "--cluster", "kmeans", "--work-dir", word(&work), "-o", word(&out)]);
}

/// A temporary folder that could not be locked was left beside the output.
#[cfg(unix)]
#[test]
fn a_disk_that_is_full_from_the_beginning_is_left_as_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let (mesh, out) = (creature(dir.path(), 2_000), dir.path().join("out"));
    std::fs::create_dir(&out).unwrap();
    let line = format!(
        "ulimit -f 0; exec '{}' segment '{}' -o '{}'",
        env!("CARGO_BIN_EXE_nystrom-stream"),
        word(&mesh),
        word(&out.join("labels.npy"))
    );
    let output = Command::new("sh").args(["-c", &line]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("cannot write"), "{said}");
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 0);
}
