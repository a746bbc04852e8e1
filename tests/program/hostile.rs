//! Files made to do harm: names that a terminal obeys or a browser runs, headers that promise too much, links in the place of
//! files to be written.

use crate::common::{creature, errors, every_case, in_memory, ok, run, word};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Output;

const NAME: &str = "a\n\u{1b}[2J\u{202e}<img src=x onerror=alert(1)>\"DATA\"{{TITLE}}&.ply";

/// Whether `text` has only characters that are seen, and line breaks.
fn is_plain(text: &str) -> bool {
    text.chars().all(|c| c == '\n' || !(c.is_control() || matches!(c, '\u{202a}'..='\u{202e}')))
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &errors(output)
}

/// Escape sequences, line breaks and HTML in a mesh's name reached terminals, tables and pages.
#[test]
fn a_name_does_nothing_where_it_is_shown() {
    let dir = in_memory();
    let folder = dir.path().join("meshes");
    std::fs::create_dir(&folder).unwrap();
    let mesh = folder.join(NAME);
    std::fs::rename(creature(dir.path(), 2_000, false), &mesh).unwrap();
    std::fs::write(folder.join("b\u{1b}]0;title\u{7}\n.ply"), "no mesh").unwrap();
    let (page, plot, report) = (dir.path().join("x.html"), dir.path().join("x.svg"), dir.path().join("x.json"));
    let work = dir.path().join("work");
    let json = format!("--json={}", word(&report));
    let output = run(&["segment", word(&mesh), "-o", word(&page), &json, "--work-dir", word(&work)]);
    assert!(output.status.success() && is_plain(&told(&output)), "{:?}", told(&output));
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(!html.contains("<img") && html.contains("&lt;img src=x onerror=alert(1)&gt;"));
    let report: Value = serde_json::from_slice(&std::fs::read(&report).unwrap()).unwrap();
    assert_eq!(report["input"]["path"], word(&mesh));
    let output = run(&["plot", word(&work), "--tree", word(&plot)]);
    assert!(output.status.success() && is_plain(&told(&output)), "{:?}", told(&output));
    let svg = std::fs::read_to_string(&plot).unwrap();
    assert!(!svg.contains("<img") && is_plain(&svg));
    for words in [["info", word(&mesh)], ["info", word(&work)], ["verify", word(&work)], ["plan", word(&mesh)]] {
        let output = run(&words);
        assert!(output.status.success() && is_plain(&told(&output)), "{words:?}: {:?}", told(&output));
    }
    // A table and a list of failures, a line each.
    let output = run(&["segment", word(&folder), "-o", word(&dir.path().join("{}.seg"))]);
    let said = told(&output);
    assert!(output.status.code() == Some(1) && is_plain(&said), "{said:?}");
    assert_eq!(said.lines().filter(|line| line.starts_with("failed: ")).count(), 1, "{said}");
    // Line breaks in names divided rows and lines.
    let rows = said.lines().filter(|line| line.contains(".ply"));
    assert!(rows.clone().count() == 3 && rows.clone().all(|line| line.contains("/meshes/")), "{said}");
    for words in [vec!["segment", "no\nsuch\u{1b}[1m.ply"], vec!["segment", word(&mesh), "--cluster", "x\u{1b}[1m\n"]] {
        let output = run(&words);
        assert!(!output.status.success() && is_plain(&told(&output)), "{words:?}: {:?}", told(&output));
    }
}

/// A PLY of three vertices and a face, with `statements` before the faces and `faces` of them promised.
fn ply(folder: &Path, name: &str, statements: &str, faces: &str) -> PathBuf {
    let path = folder.join(name);
    let head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
    let end = "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    std::fs::write(&path, format!("{head}{statements}element face {faces}\n{end}")).unwrap();
    path
}

/// A million properties took a gigabyte of memory and more, and ten seconds.
#[test]
fn headers_that_promise_too_much_are_refused() {
    let dir = in_memory();
    let many = |line: &str, count: usize| line.repeat(count);
    let out = dir.path().join("out.seg");
    for (name, statements, faces) in [
        ("faces63.ply", String::new(), "9223372036854775808"),
        ("faces64.ply", String::new(), "18446744073709551615"),
        ("faces65.ply", String::new(), "36893488147419103232"),
        ("negative.ply", String::new(), "-1"),
        ("properties.ply", many("property float p\n", 1_000_000), "1"),
        ("elements.ply", many("element e 0\nproperty float p\n", 500_000), "1"),
        ("remarks.ply", many("comment\n", 1_000_000), "1"),
        ("long.ply", many("comment a long line without an end ", 1_000_000) + "\n", "1"),
        ("records.ply", "element e 9223372036854775807\nproperty double p\n".into(), "1"),
    ] {
        let path = ply(dir.path(), name, &statements, faces);
        let output = run(&["segment", word(&path), "-q", "-o", word(&out), "--max-memory", "64MiB"]);
        let said = errors(&output);
        assert_eq!(output.status.code(), Some(1), "{name}: {said}");
        assert!(said.contains(name) && said.lines().count() == 1, "{name}: {said}");
        assert!(!said.contains("internal") && !out.exists(), "{name}: {said}");
    }
    let harmless = ply(dir.path(), "harmless.ply", &many("comment\n", 100_000), "1");
    ok(&["segment", word(&harmless), "-q", "-o", word(&out)]);
}

/// A link planted under the name of a file that is to be written had its target overwritten.
#[test]
fn links_in_the_place_of_outputs_are_not_followed() {
    let dir = in_memory();
    let mesh = creature(dir.path(), 2_000, false);
    let precious = dir.path().join("precious");
    std::fs::write(&precious, "kept").unwrap();
    let link = |name: &str| std::os::unix::fs::symlink(&precious, dir.path().join(name)).unwrap();
    ["out.seg.partial", "out.glb.partial", "out.json.partial"].into_iter().for_each(link);
    let work = dir.path().join("work");
    std::fs::create_dir(&work).unwrap();
    std::fs::write(work.join("lock"), "nystrom-stream work directory\n").unwrap();
    for name in ["manifest.json.partial", "distances.npy.partial", "labels.npy.partial", "rows.journal", "cells.npy"] {
        std::os::unix::fs::symlink(&precious, work.join(name)).unwrap();
    }
    let path = |name: &str| dir.path().join(name);
    let (seg, glb, json) = (path("out.seg"), path("out.glb"), format!("--json={}", word(&path("out.json"))));
    let words = ["segment", word(&mesh), "-q", "-o", word(&seg), "-o", word(&glb), &json];
    ok(&[&words[..], &["--work-dir", word(&work)]].concat());
    assert_eq!(std::fs::read_to_string(&precious).unwrap(), "kept");
    assert!(["out.seg", "out.glb", "out.json"].iter().all(|name| path(name).symlink_metadata().unwrap().is_file()));
}

/// Reports and hierarchies were written into the file that was there: a reader, or another name of that file, saw half of them. In
/// `/dev/shm` they were appended to it, as if it were a device.
#[test]
fn outputs_replace_what_was_there_and_are_not_written_into_it() {
    let dir = in_memory();
    let mesh = creature(dir.path(), 2_000, false);
    let (work, before) = (dir.path().join("work"), dir.path().join("before"));
    std::fs::write(&before, "kept").unwrap();
    let path = |name: &str| dir.path().join(name);
    let names = ["out.seg", "out.npy", "out.glb", "out.json", "tree.json"];
    names.into_iter().for_each(|name| std::fs::hard_link(&before, path(name)).unwrap());
    let json = format!("--json={}", word(&path("out.json")));
    let outputs: Vec<_> = names[..3].iter().map(|name| path(name)).collect();
    let mut words = vec!["segment", word(&mesh), "-q", &json, "--work-dir", word(&work)];
    outputs.iter().for_each(|output| words.extend(["-o", word(output)]));
    for words in [words, vec!["export", "--work-dir", word(&work), "-q", "--tree", word(&path("tree.json"))]] {
        ok(&words);
    }
    assert_eq!(std::fs::read_to_string(&before).unwrap(), "kept");
    for name in names {
        assert_ne!(std::fs::read(path(name)).unwrap(), b"kept", "{name}");
    }
}

/// A vertex far away decides neither what is drawn nor what is matched or carried over, at whatever distance.
#[test]
fn a_stray_vertex_does_not_decide_other_commands() {
    let dir = in_memory();
    let whole = creature(dir.path(), 3_000, false);
    let bytes = std::fs::read(&whole).unwrap();
    let header = b"property float z\nelement face";
    assert!(bytes.windows(header.len()).any(|window| window == header), "a vertex is three floats");
    let start = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
    let labels = dir.path().join("whole.seg");
    ok(&["segment", word(&whole), "-q", "-o", word(&labels)]);
    // Refining takes most of the time.
    let refine = if every_case() { "nystrom" } else { "none" };
    let outputs = |distance: f32| {
        let place = dir.path().join(format!("{distance}"));
        std::fs::create_dir(&place).unwrap();
        let mesh = place.join("stray.ply");
        let mut bytes = bytes.clone();
        let vertex = start + 12 * 700;
        bytes[vertex..vertex + 12].copy_from_slice(&[distance.to_le_bytes(); 3].concat());
        std::fs::write(&mesh, bytes).unwrap();
        let file = |name: &str| place.join(name);
        let (picture, map, carried) = (file("x.png"), file("map.npy"), file("carried.seg"));
        for words in [
            vec!["picture", word(&mesh), "--labels", word(&labels), "-o", word(&picture)],
            vec!["correspond", word(&whole), word(&mesh), "--refine", refine, "-o", word(&map)],
            vec!["transfer-labels", word(&whole), word(&mesh), "--labels", word(&labels), "-o", word(&carried)],
        ] {
            ok(&words);
        }
        [picture, map, carried].map(|path| std::fs::read(path).unwrap())
    };
    let (near, far) = (outputs(1e4), outputs(1e25));
    for (name, (near, far)) in ["picture", "matches", "labels"].iter().zip(near.iter().zip(&far)) {
        assert!(near == far, "other {name}");
    }
    // Faces that do not touch the vertex keep their labels.
    let lines =
        |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap().lines().map(str::to_string).collect::<Vec<_>>();
    let (plain, carried) = (lines(&std::fs::read(&labels).unwrap()), lines(&far[2]));
    let changed = plain.iter().zip(&carried).filter(|(a, b)| a != b).count();
    assert!(plain.len() == carried.len() && changed <= 10, "{changed} labels changed");
}
