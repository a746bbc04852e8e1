//! `correspond` and `evaluate --matches` as a user runs them.

use crate::common::{self, errors, json, ok, program, refused, shapes, word};
use nystrom_stream::apps::correspond::Match;
use nystrom_stream::base::random::{below, stream};
use nystrom_stream::mesh;
use nystrom_stream::store::{Run, WorkDir, npy};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// The mesh at `path` with vertices in random order, turned and rescaled; `mirrored` on request. Also the map from old to new.
pub fn permuted(path: &Path, out: &Path, mirrored: bool) -> Vec<u32> {
    let dir = common::in_memory();
    let opened = mesh::open(path, dir.path(), &Run::new(&())).unwrap();
    let n = opened.positions.len();
    let mut draw = stream(9, "permutation");
    let mut place: Vec<u32> = (0..n as u32).collect();
    (1..n).rev().for_each(|k| place.swap(k, below(&mut draw, k + 1)));
    let mut old = vec![0u32; n];
    place.iter().enumerate().for_each(|(from, &to)| old[to as usize] = from as u32);
    let faces = opened.faces.len();
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\n\
         property float heat\nelement face {faces}\nproperty list uchar int vertex_indices\nproperty int label\nend_header\n"
    );
    for v in old {
        let [x, y, z] = opened.positions.get(v);
        let x = if mirrored { -x } else { x };
        writeln!(text, "{} {} {} {v}", 3. * y, 3. * z, 3. * x).unwrap();
    }
    opened.faces.for_each(0..faces, |face, c| {
        let mut c = [c[0], c[1], c[2]].map(|v| place[v as usize]);
        if mirrored {
            c.swap(1, 2);
        }
        writeln!(text, "3 {} {} {} {}", c[0], c[1], c[2], face % 7).unwrap();
    });
    std::fs::write(out, text).unwrap();
    place
}

/// Matches the meshes, which must succeed.
pub fn correspond(a: &Path, b: &Path, words: &[&str]) -> std::process::Output {
    ok(&[&["correspond", word(a), word(b)], words].concat())
}

pub fn read(path: &Path) -> Vec<Match> {
    npy::open::<Match>(path).unwrap().to_vec()
}

pub fn files() -> (tempfile::TempDir, PathBuf, PathBuf) {
    let dir = common::in_memory();
    let a = common::creature(dir.path(), if common::every_case() { 6_000 } else { 3_000 }, false);
    let b = dir.path().join("b.ply");
    (dir, a, b)
}

#[test]
fn a_turned_permuted_copy_is_recognised_and_its_properties_come_back() {
    let (dir, a, b) = files();
    let truth = permuted(&a, &b, false);
    let file = |name: &str| dir.path().join(name);
    let (out, csv, report) = (file("m.npy"), file("m.csv"), format!("--json={}", file("r.json").display()));
    let (ca, cb, picture, carried) = (file("ca.ply"), file("cb.ply"), file("p.png"), file("carried.ply"));
    let words = ["-q", "-o", word(&out), "-o", word(&csv), &report, "--colours", word(&ca), word(&cb)];
    let more = ["--picture", word(&picture), "--carry", "heat,label", "--carried", word(&carried)];
    correspond(&a, &b, &[&words[..], &more].concat());
    let matches = read(&out);
    let right = matches.iter().zip(&truth).filter(|(one, real)| one.target == i64::from(**real)).count();
    // The samples of both start at other vertices, so it is not exact.
    let map = file("truth.npy");
    npy::write(&map, &truth, 1, false).unwrap();
    let json = file("e.json");
    for form in [&out, &csv] {
        let json_to = format!("--json={}", json.display());
        let words = ["evaluate", "-q", "--matches", word(form), "--mesh", word(&b), "--truth", word(&map), &json_to];
        ok(&words);
        let told: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        let mean = told["errors"]["mean"].as_f64().unwrap();
        assert!(mean < 0.02 && told["errors"]["evaluated"] == truth.len(), "{mean}, {right} of {} exact", truth.len());
    }
    // Regression: with no true match at all, errors of 0.
    let none = file("none.csv");
    let lines: String = (0..truth.len()).map(|v| format!("{v},-1,0,0\n")).collect();
    std::fs::write(&none, format!("vertex,match,distance,confidence\n{lines}")).unwrap();
    let words = ["evaluate", "--matches", word(&out), "--mesh", word(&b), "--truth", word(&none)];
    refused(&words, 1, "none.csv: names no true match of a sampled vertex");
    let told: serde_json::Value = serde_json::from_slice(&std::fs::read(file("r.json")).unwrap()).unwrap();
    assert!(told["alignments"][0]["orientation"].as_f64().unwrap() > 0.5, "{told}");
    // Regression: areas were in units of the squared diagonal. The copy is three times as large.
    let [of_a, of_b] = [0, 1].map(|side: usize| told["meshes"][side]["area"].as_f64().unwrap());
    assert!((of_b / of_a - 9.).abs() < 1e-4, "{of_a} {of_b}");
    // Carried: heat was the number of the vertex in A.
    let opened = mesh::open(&carried, dir.path(), &Run::new(&())).unwrap();
    assert_eq!(opened.face_property("label", &Run::new(&())).unwrap().len(), opened.faces.len());
    let mut heat = Vec::new();
    let property = opened.document().unwrap().property(mesh::ply::ElementKind::Vertices, "heat").unwrap();
    property
        .for_each(&Run::new(&()), |_, x| {
            heat.push(x);
            Ok(())
        })
        .unwrap();
    let back = heat.iter().enumerate().filter(|(v, x)| **x == *v as f64).count();
    assert_eq!(back, right);
    for path in [&ca, &cb] {
        let opened = mesh::open(path, dir.path(), &Run::new(&())).unwrap();
        let document = opened.document().unwrap();
        assert!(document.property(mesh::ply::ElementKind::Vertices, "red").is_some());
        assert_eq!(opened.positions.len(), truth.len());
    }
    assert!(std::fs::read(&picture).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn the_same_bytes_whatever_threads_and_memory_in_every_manner() {
    let (dir, a, b) = files();
    permuted(&a, &b, false);
    // Refined matches take four times as long: only by default, unless every case is asked for.
    let every = common::every_case();
    for manner in [
        &[][..],
        &["--mutual"],
        &["--one-to-one"],
        &["--transfer"],
        &["--distance", "edges", "-l", "20"],
        &["--refine", "laplacian"],
    ]
    .into_iter()
    .take(if every { 6 } else { 5 })
    {
        let unrefined: &[&str] = if every || manner.is_empty() { &[] } else { &["--refine", "none"] };
        let mut seen: Option<Vec<u8>> = None;
        for (threads, memory) in [("1", "512MiB"), ("3", "16MiB")] {
            let out = dir.path().join("m.npy");
            let words = ["-q", "-o", word(&out), "--threads", threads, "--max-memory", memory];
            correspond(&a, &b, &[&words[..], manner, unrefined].concat());
            let bytes = std::fs::read(&out).unwrap();
            assert!(seen.as_ref().is_none_or(|seen| *seen == bytes), "{manner:?}");
            let targets: Vec<i64> = read(&out).iter().map(|one| one.target).filter(|&t| t >= 0).collect();
            let mut single = targets.clone();
            single.sort_unstable();
            single.dedup();
            assert!(manner != ["--one-to-one"] || single.len() == targets.len());
            assert!(targets.len() > 1000);
            seen = Some(bytes);
        }
    }
}

#[test]
fn a_work_directory_keeps_graphs_and_rows_for_the_next_question() {
    let (dir, a, b) = files();
    permuted(&a, &b, false);
    let (out, work) = (dir.path().join("m.npy"), dir.path().join("work"));
    let run = |words: &[&str], kept: bool| {
        let place = ["--work-dir", word(&work)];
        let as_it_is = words.contains(&"--refine") || common::every_case();
        let refine: &[&str] = if as_it_is { &[] } else { &["--refine", "none"] };
        let all = [&["-o", word(&out), "-l", "20"][..], refine, words, if kept { &place } else { &[] }].concat();
        let run = correspond(&a, &b, &all);
        (std::fs::read(&out).unwrap(), errors(&run).matches("rows: reused").count())
    };
    assert_eq!(run(&[], true), run(&[], false));
    // Graphs and rows are the same for refined matches, which take four times as long: they are asked for once.
    let refined = ["--vectors", "5", "--refine", "nystrom"];
    for words in [&refined[..], &["--mutual"], &["--sigma", "0.8", "--transfer"]] {
        let ((bytes, reused), (fresh, _)) = (run(words, true), run(words, false));
        assert!(bytes == fresh && reused == 2, "{words:?}: {reused}");
    }
    for words in [&["-l", "21"][..], &["-l", "21", "--distance", "edges"], &["-l", "21", "--seed", "4"]] {
        let words = [&["-o", word(&out), "--refine", "none", "--work-dir", word(&work)][..], words].concat();
        let told = errors(&correspond(&a, &b, &words));
        assert!(told.matches("graph: reused").count() == 2, "{told}");
        assert!(told.matches("rows: rebuilt").count() == 2, "{told}");
    }
    // Functions and matches, 400 bytes per vertex, were left there, and nothing told of them or took them away.
    for folder in [&work, &work.join("a"), &work.join("b")] {
        let stages = WorkDir::open(folder).unwrap().manifest().stages;
        let of_stages: BTreeSet<String> = stages.values().flat_map(|stage| stage.files.keys().cloned()).collect();
        let there = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let left: Vec<String> = there.filter(|name| !of_stages.contains(name)).collect();
        assert!(left.iter().all(|name| ["a", "b", "lock", "manifest.json"].contains(&&name[..])), "{left:?}");
    }
    // Of another mesh nothing is reused.
    let (_, reused) = run(&[], true);
    assert_eq!(reused, 0);
    permuted(&a, &b, true);
    assert_eq!(run(&["--force"], true).1, 1);
}

#[test]
fn a_mirror_image_is_matched_with_its_own_side_turned() {
    let (dir, a, b) = files();
    permuted(&a, &b, true);
    let (out, report) = (dir.path().join("m.npy"), format!("--json={}", dir.path().join("r.json").display()));
    correspond(&a, &b, &["-q", "-o", word(&out), &report]);
    // Its winding was turned too: seen from outside it is a creature like the first, left and right exchanged.
    let told: serde_json::Value = serde_json::from_slice(&std::fs::read(dir.path().join("r.json")).unwrap()).unwrap();
    assert!(told["alignments"][0]["orientation"].as_f64().unwrap() > 0.3, "{told}");
}

/// They were refused, since the search had not been told that the graph's steps are lengths.
/// Regression: with refinement, `--transfer` forgot the other alignments. The report called the matches unambiguous, and
/// `--alternative 1` was refused.
#[test]
fn a_symmetric_shape_stays_ambiguous_when_landmarks_are_transferred() {
    let dir = common::in_memory();
    let mut rough = shapes::dumbbell();
    rough.name = "rough";
    rough.vertices.iter_mut().flatten().zip(0u32..).for_each(|(x, k)| *x += 0.01 * f64::from(37 * k).sin());
    let (a, b) = (rough.write(dir.path()), shapes::dumbbell().write(dir.path()));
    let [first, second] = ["0", "1"].map(|alternative| {
        let out = dir.path().join(format!("{alternative}.npy"));
        let words = ["correspond", word(&a), word(&b), "-q", "--json", "--transfer", "-o", word(&out)];
        let told = json(&[&words[..], &["--alternative", alternative]].concat());
        assert!(told["ambiguous"] == true && told["alignments"].as_array().unwrap().len() == 2, "{told}");
        read(&out)
    });
    let other = first.iter().zip(&second).filter(|(one, other)| one.target != other.target).count();
    assert!(2 * other > first.len(), "{other} of {}", first.len());
}

#[test]
fn landmarks_by_length_alone_are_the_farthest_ones() {
    let (dir, a, b) = files();
    permuted(&a, &b, false);
    let found = ["farthest", "geodesic-farthest"].map(|sampling| {
        let out = dir.path().join(sampling).with_extension("npy");
        correspond(&a, &b, &["-q", "--refine", "none", "--sampling", sampling, "-o", word(&out)]);
        std::fs::read(out).unwrap()
    });
    assert!(found[0] == found[1]);
}

#[test]
fn what_makes_no_sense_is_refused_in_a_line() {
    let (dir, a, b) = files();
    permuted(&a, &b, false);
    let out = dir.path().join("m.npy");
    let out = word(&out);
    let nowhere = dir.path().join("no/m.npy");
    for (words, code, part) in [
        (vec!["-q"], 2, "nothing to write"),
        (vec!["-o", "m.txt"], 2, ".npy, .csv or .parquet"),
        (vec!["-o", word(&nowhere)], 1, "does not exist"),
        (vec!["-o", out, "--vectors", "9"], 2, "from 2 to 8"),
        (vec!["-o", out, "--sigma", "0"], 2, "positive"),
        (vec!["-o", out, "--mutual", "--one-to-one"], 2, "cannot be used"),
        (vec!["-o", out, "--refine", "cotangent"], 2, "choose from nystrom, laplacian, none"),
        (vec!["-o", out, "--alternative", "40"], 2, "count from 0"),
        (vec!["-o", out, "--carry", "x"], 2, "--carried"),
        (vec!["-q", "-o", out, "--refine", "none", "--carry", "nothing", "--carried", "m.ply"], 1, "nothing"),
        (vec!["-o", out, "--picture", "m.jpg"], 2, "--picture m.jpg: unknown extension; use .png"),
        // Regression: a smaller picture was advised, but no option makes it smaller.
        (vec!["-q", "--picture", "p.png", "--max-memory", "2MB"], 1, "raise --max-memory or leave the picture out"),
        (vec!["-o", out, "--functions", "a.npy", "b.csv"], 2, "--functions b.csv: unknown extension; use .npy"),
    ] {
        refused(&[&["correspond", word(&a), word(&b)], &words[..]].concat(), code, part);
    }
    // Regression: it "cannot be segmented", which nobody had asked for.
    let points = dir.path().join("points.ply");
    let text = std::fs::read_to_string(shapes::tetrahedron().write(dir.path())).unwrap();
    std::fs::write(&points, text.replace("face 4", "face 0")).unwrap();
    let problem = "points.ply: has no faces; a surface is needed, not a point cloud; reconstruct";
    refused(&["correspond", word(&points), word(&b), "-o", out], 1, problem);
    // Of another mesh: the file at fault was not named, and it was called misuse.
    let map = |name: &str, targets: &[u32]| {
        let path = dir.path().join(name);
        let rows = targets.iter().enumerate().map(|(v, target)| format!("{v},{target},0,1\n"));
        std::fs::write(&path, format!("vertex,match,distance,confidence\n{}", rows.collect::<String>())).unwrap();
        path
    };
    let n = nystrom_stream::Mesh::open(&a).unwrap().positions.len() as u32;
    let ([beyond, fine], long) = ([map("beyond.csv", &[0, n]), map("fine.csv", &[0, 1])], vec![0; n as usize + 1]);
    let (long, mesh) = (map("long.csv", &long), word(&a));
    for (words, code, part) in [
        (vec!["--matches", word(&beyond), "--mesh", mesh], 1, "beyond.csv: names vertex"),
        (vec!["--matches", word(&fine), "--mesh", mesh, "--truth", word(&beyond)], 1, "beyond.csv: names vertex"),
        (vec!["--matches", word(&long), "--mesh", mesh], 1, "long.csv: has "),
        (vec!["--matches", "x.npy"], 2, "--mesh"),
        (vec!["--matches", word(&fine), "--mesh", mesh, "--samples", "0"], 2, "--samples"),
        // It had no effect.
        (vec!["x.seg", "--truth", "x.seg", "--samples", "5"], 2, "--samples can only be used with --matches"),
        // Regression: misuse, but it was called a file that cannot be used.
        (vec!["--matches", word(&a), "--mesh", word(&a)], 2, ".ply: unknown extension; give a .npy or .csv file"),
        (vec!["--matches", word(&fine), "--mesh", mesh, "--truth", mesh], 2, "--truth"),
    ] {
        refused(&[&["evaluate"], &words[..]].concat(), code, part);
    }
}

/// What B lacks was told only after both meshes had been matched.
#[test]
fn a_missing_property_is_told_before_anything_is_matched() {
    let (dir, a, b) = files();
    permuted(&a, &b, false);
    let out = dir.path().join("m.ply");
    let words = ["correspond", word(&a), word(&b), "--carry", "nothing", "--carried", word(&out)];
    let told = refused(&words, 1, "nothing");
    assert!(!told.contains("distance rows"), "{told}");
}

/// All vertices were matched to one, without a word.
#[test]
fn a_mesh_without_area_is_refused_by_name() {
    let (dir, a, b) = files();
    permuted(&a, &b, false);
    let mut point = shapes::grid(9);
    point.vertices.iter_mut().for_each(|v| *v = [1., 2., 3.]);
    let (point, out) = (point.write(dir.path()), dir.path().join("m.npy"));
    for (a, b) in [(&point, &b), (&a, &point)] {
        let words = ["correspond", word(a), word(b), "-q", "-l", "10", "--refine", "none", "-o", word(&out)];
        refused(&words, 1, "grid.ply: has no area");
    }
}

/// A work directory of other meshes is refused, as everywhere, and nothing in it changes.
#[test]
fn a_work_directory_of_other_meshes_is_refused() {
    let (dir, a, b) = files();
    permuted(&a, &b, false);
    let (work, out) = (dir.path().join("work"), dir.path().join("m.npy"));
    let words = ["-q", "-l", "10", "--refine", "none", "-o", word(&out), "--work-dir", word(&work)];
    correspond(&a, &b, &words);
    // It was called no work directory.
    let folder = word(&work);
    let told = |words: &[&str]| {
        let run = program().args(words).output().unwrap();
        (run.status.code(), String::from_utf8_lossy(&run.stdout).into_owned() + &errors(&run))
    };
    let (code, text) = told(&["info", folder]);
    let parts = ["made by correspond", "a/ mesh creature_", "b/ mesh b.ply", "b/vertex rows", "distances.npy"];
    assert!(code == Some(0) && parts.iter().all(|part| text.contains(part)), "{text}");
    let (code, text) = told(&["verify", "-q", folder]);
    assert!(code == Some(0) && text.contains("all intact"), "{text}");
    let (code, text) = told(&["export", "--work-dir", folder, "-o", word(&out)]);
    assert!(code == Some(1) && text.contains("is a work directory of `correspond`"), "{text}");
    // Another command mixed its files with those of two meshes, and `correspond` with those of one.
    let one = dir.path().join("one");
    for (words, problem) in [
        (vec!["segment", word(&a), "-q", "-o", word(&out), "--work-dir", folder], "belongs to two meshes"),
        (vec!["graph", word(&a), "-q", "--work-dir", word(&one)], ""),
        (
            vec!["correspond", word(&a), word(&b), "-q", "-o", word(&out), "--work-dir", word(&one)],
            "belongs to one mesh, ",
        ),
    ] {
        let (code, text) = told(&words);
        assert_eq!(code, Some(i32::from(!problem.is_empty())), "{text}");
        assert!(text.contains(problem), "{text}");
    }
    let kept = || std::fs::read(work.join("b/manifest.json")).unwrap();
    let before = kept();
    let all = [&["correspond", word(&a), word(&a)], &words[..]].concat();
    let told = refused(&all, 1, "belongs to another mesh, b.ply");
    assert!(told.contains("--force"), "{told}");
    assert_eq!(kept(), before);
    correspond(&a, &a, &[&words[..], &["--force"]].concat());
    assert_ne!(kept(), before);
}
