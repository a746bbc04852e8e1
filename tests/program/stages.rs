//! The stages of `segment` as commands of their own over a work directory: the same results as in one run, and another
//! number of parts without mesh, rows or members.

use crate::common::{self, creature, errors, ok, run, segment, shapes, word};
use nystrom_stream::mesh::read_seg;
use nystrom_stream::store::npy;
use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};
use std::time::Duration;

/// Runs a subcommand on `work`, which must succeed; returns what it told.
fn stage(words: &[&str], work: &Path) -> String {
    let output = ok(&[words, &["--work-dir", word(work)]].concat());
    errors(&output)
}

fn refused(words: &[&str], work: &Path, code: i32) -> String {
    common::refused(&[words, &["--work-dir", word(work)]].concat(), code, "")
}

/// The labels that `segment MESH` with `words` writes.
fn direct(mesh: &Path, words: &[&str]) -> Vec<u32> {
    let out = mesh.with_extension("direct.seg");
    segment(mesh, &[words, &["-q", "-o", word(&out)]].concat());
    read_seg(&out).unwrap()
}

fn labels(path: &Path) -> Vec<u32> {
    npy::open::<u32>(path).unwrap().to_vec()
}

struct Scene {
    _dir: tempfile::TempDir,
    mesh: PathBuf,
    work: PathBuf,
    out: PathBuf,
}

fn scene(faces: u64, shuffle: bool) -> Scene {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), faces, shuffle);
    let (work, out) = (dir.path().join("work"), dir.path().join("out.seg"));
    Scene { _dir: dir, mesh, work, out }
}

#[test]
fn stages_one_by_one_give_what_segment_gives() {
    let Scene { mesh, work, out, .. } = &scene(12_000, false);
    stage(&["graph", word(mesh), "--seed", "7"], work);
    let told = stage(&["rows", "-l", "20"], work);
    assert!(told.contains("graph: reused"), "{told}");
    let told = stage(&["cluster", "-o", word(out)], work);
    assert!(told.contains("weights: reused") && told.contains("rows: reused"), "{told}");
    let expected = direct(mesh, &["-l", "20", "--seed", "7"]);
    assert_eq!(read_seg(out).unwrap(), expected);
    assert_eq!(labels(&work.join("labels.npy")), expected);
    // Every form that `segment` writes, later.
    let (ply, ours) = (mesh.with_extension("a.ply"), mesh.with_extension("b.ply"));
    segment(mesh, &["-q", "-l", "20", "--seed", "7", "-o", word(&ply)]);
    stage(&["export", "-o", word(&ours), "-o", word(out)], work);
    assert!(std::fs::read(&ply).unwrap() == std::fs::read(&ours).unwrap());
    assert_eq!(read_seg(out).unwrap(), expected);
    // Everything has a checksum: a flipped bit would be found.
    ok(&["verify", word(work)]);
}

#[test]
fn another_number_of_parts_needs_neither_mesh_nor_rows() {
    let Scene { mesh, work, out, .. } = &scene(12_000, false);
    let ways: [&[&str]; 4] = [&["-k", "9"], &["--detail", "0.6"], &["--parts-range", "3..4"], &["-k", "2"]];
    let expected = ways.map(|way| direct(mesh, way));
    segment(mesh, &["-q", "--work-dir", word(work), "-o", word(out)]);
    std::fs::remove_file(mesh).unwrap();
    std::fs::remove_file(work.join("distances.npy")).unwrap();
    for (way, expected) in ways.iter().zip(expected) {
        let told = stage(&[&["cluster", "-o", word(out)], *way].concat(), work);
        assert!(told.contains("decision: reused") && !told.contains("rows"), "{told}");
        assert_eq!(read_seg(out).unwrap(), expected, "{way:?}");
    }
    let told = refused(&["export", "-o", word(&out.with_extension("ply"))], work, 1);
    assert!(told.contains("give its new path"), "{told}");
    // `segment` itself takes the same short cut.
    let again = creature(mesh.parent().unwrap(), 12_000, false);
    let told = refused(&["cluster", "-k", "100000"], work, 1);
    assert!(told.contains("faces, fewer than"), "{told}");
    let told = errors(&segment(&again, &["-k", "3", "--work-dir", word(work), "-o", word(out)]));
    assert!(told.contains("graph: ") && read_seg(out).unwrap() == direct(&again, &["-k", "3"]), "{told}");
}

#[test]
fn a_hierarchy_can_be_taken_out_and_put_in() {
    let Scene { mesh, work, out, .. } = &scene(8_000, false);
    let tree = mesh.with_extension("json");
    segment(mesh, &["-q", "--work-dir", word(work), "-k", "5", "-o", word(out)]);
    let expected = read_seg(out).unwrap();
    stage(&["export", "--tree", word(&tree)], work);
    stage(&["cluster", "--tree", word(&tree), "-k", "5", "-o", word(out)], work);
    assert_eq!(read_seg(out).unwrap(), expected);
    // Without its last union's level the two halves of the finest cut stay: any other tree gives other parts.
    let text = std::fs::read_to_string(&tree).unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
    json["level"].as_array_mut().unwrap().fill(1.0.into());
    std::fs::write(&tree, json.to_string()).unwrap();
    stage(&["cluster", "--tree", word(&tree), "-o", word(out)], work);
    assert!(read_seg(out).unwrap().iter().all(|&label| label == 0));
    for (text, code) in [("{", 1), (&text[..100], 1), ("{\"version\":1}", 1)] {
        std::fs::write(&tree, text).unwrap();
        refused(&["cluster", "--tree", word(&tree)], work, code);
    }
    let other = shapes::dumbbell().write(mesh.parent().unwrap());
    let small = work.with_extension("small");
    segment(&other, &["-q", "--work-dir", word(&small), "-o", word(out)]);
    stage(&["export", "--tree", word(&tree)], &small);
    let told = refused(&["cluster", "--tree", word(&tree)], work, 1);
    assert!(told.contains(&format!("{}: has ", tree.display())), "{told}");
    assert!(told.contains(" cells, but the hierarchy of the work directory has "), "{told}");
    refused(&["cluster", "--tree", word(&tree), "--cluster", "two-means"], work, 2);
}

#[test]
fn the_papers_ways_work_on_the_rows_that_are_there() {
    let Scene { mesh, work, out, .. } = &scene(8_000, false);
    let way = ["--cluster", "kmeans", "-k", "6", "-l", "12"];
    stage(&[&["rows", word(mesh)], &way[..]].concat(), work);
    let told = stage(&["cluster", "-k", "6", "-o", word(out)], work);
    assert!(!told.contains("weights") && told.contains("rows: 12 of them"), "{told}");
    assert_eq!(read_seg(out).unwrap(), direct(mesh, &way));
    // It advised to leave out an option that was not given.
    let told = refused(&["cluster"], work, 2);
    assert!(
        told.contains("-k: K-means needs the number of parts; give it, as in -k 6, or choose --cluster parts"),
        "{told}"
    );
    stage(&["cluster", "--cluster", "parts", "-o", word(out)], work);
    stage(&["cluster", "--cluster", "two-means", "-k", "4", "-o", word(out)], work);
    // What `embed` was told holds for `cluster`.
    stage(&["embed", "--normalise", "none", "-d", "5"], work);
    let (values, shape) = npy::open_shaped::<f32>(&work.join("embedding.npy")).unwrap();
    let n = read_seg(out).unwrap().len();
    assert_eq!(shape, [n as u64, 5]);
    // Rows of unit length.
    assert!(values.chunks(5).all(|y| (y.iter().map(|x| x * x).sum::<f32>() - 1.).abs() < 1e-3));
    // Regression: a wrong width was refused when the embedding was gone, and under another number.
    let told = refused(&["embed", "--sigma", "-1"], work, 2);
    assert!(told.contains("--sigma: -1 is not a width"), "{told}");
    assert!(stage(&["embed", "--normalise", "none", "-d", "5"], work).contains("embedding: reused"));
    stage(&["cluster", "-k", "6", "-o", word(out)], work);
    let plain = direct(mesh, &[&way[..], &["--normalise", "none", "--sigma", "1"]].concat());
    assert_eq!(read_seg(out).unwrap(), plain);
    // Rows made for parts serve K-means too.
    let parts = work.with_extension("parts");
    segment(mesh, &["-q", "--work-dir", word(&parts), "-o", word(out)]);
    let told = stage(&["cluster", "--cluster", "kmeans", "-k", "4", "-o", word(out)], &parts);
    assert!(told.contains("rows: 120 of them"), "{told}");
    assert_eq!(read_seg(out).unwrap().iter().max(), Some(&3));
    let told = stage(&["cluster"], &parts);
    assert!(told.contains("decision: reused"), "{told}");
}

#[test]
fn results_come_in_the_order_of_the_file_where_faces_were_sorted() {
    let Scene { mesh, work, out, .. } = &scene(8_000, true);
    stage(&["graph", word(mesh), "--order", "hilbert"], work);
    let told = stage(&["rows"], work);
    assert!(told.contains("order: reused") && told.contains("graph: reused"), "{told}");
    stage(&["cluster", "-k", "4", "-o", word(out)], work);
    assert_eq!(read_seg(out).unwrap(), direct(mesh, &["-k", "4", "--order", "hilbert"]));
    stage(&["embed", "-d", "3"], work);
    let kept = work.with_extension("kept");
    stage(&["graph", word(mesh), "--order", "keep"], &kept);
    stage(&["embed", "-d", "3"], &kept);
    let read = |folder: &Path| npy::open::<f32>(&folder.join("embedding.npy")).unwrap();
    // Eigenvectors are known up to sign: products of rows are not.
    let (a, b) = (read(work), read(&kept));
    let far = |i: usize, j: usize| {
        let dot = |x: &[f32]| (0..3).map(|e| x[3 * i + e] * x[3 * j + e]).sum::<f32>();
        (dot(&a) - dot(&b)).abs() > 0.1
    };
    let n = a.len() / 3;
    let apart = (0..1000).filter(|k| far(k * 7919 % n, k * 104_729 % n)).count();
    assert!(apart < 100, "{apart} of 1000");
}

#[test]
fn a_contracted_mesh_can_be_cut_again() {
    let Scene { mesh, work, out, .. } = &scene(70_000, false);
    segment(mesh, &["-q", "--work-dir", word(work), "-o", word(out)]);
    let told = stage(&["cluster", "-k", "3", "-o", word(out)], work);
    assert!(told.contains("coarser mesh: reused") && told.contains("decision: reused"), "{told}");
    let expected = direct(mesh, &["-k", "3"]);
    assert_eq!(read_seg(out).unwrap(), expected);
    let tree = out.with_extension("json");
    stage(&["export", "--tree", word(&tree)], work);
    stage(&["cluster", "-k", "3", "--tree", word(&tree), "-o", word(out)], work);
    assert_eq!(read_seg(out).unwrap(), expected);
    // Cells in the order of the file were left behind, a file that no stage owned.
    stage(&["export", "-o", word(&out.with_extension("html"))], work);
    let names = |folder: &Path| {
        let names = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.filter(|name| name.contains("file_cells")).collect::<Vec<_>>()
    };
    assert_eq!((names(work), names(&work.join("contracted"))), (vec![], vec![]));
}

/// Coordinates stayed those of the rows before: `--embedding-columns` took whatever embedding was there.
#[test]
fn columns_of_the_embedding_are_of_the_rows_that_are_there() {
    let Scene { mesh, work, out, .. } = &scene(2_000, false);
    let table = out.with_extension("parquet");
    let exported = |work: &Path| {
        stage(&["export", "-q", "--embedding-columns", "-o", word(&table)], work);
        std::fs::read(&table).unwrap()
    };
    let cut = |work: &Path, landmarks: &str| {
        let words =
            ["-q", "--cluster", "kmeans", "-k", "4", "-l", landmarks, "--work-dir", word(work), "-o", word(out)];
        segment(mesh, &words);
    };
    let embed = |work: &Path| stage(&["embed", "-q", "-d", "3"], work);
    cut(work, "12");
    embed(work);
    let of_few = exported(work);
    cut(work, "30");
    let of_more = exported(work);
    let fresh = &work.with_extension("fresh");
    cut(fresh, "30");
    embed(fresh);
    assert!(of_more != of_few && of_more == exported(fresh));
}

/// K-means gives up its graph in a temporary directory, and the embedding was made of nothing.
#[test]
fn k_means_has_columns_of_its_embedding_without_a_work_directory_too() {
    let Scene { mesh, work, out, .. } = &scene(2_000, true);
    let table = out.with_extension("parquet");
    let written = |words: &[&str]| {
        let all =
            ["-q", "--cluster", "kmeans", "-k", "4", "--order", "hilbert", "--embedding-columns", "-o", word(&table)];
        segment(mesh, &[&all[..], words].concat());
        std::fs::read(&table).unwrap()
    };
    assert!(written(&[]) == written(&["--work-dir", word(work)]));
    // Regression: columns were of the default kernel whatever kernel the labels are of.
    let of_cauchy = written(&["--kernel", "cauchy"]);
    let kept = &work.with_extension("kept");
    let words =
        ["--cluster", "kmeans", "-k", "4", "--order", "hilbert", "--kernel", "cauchy", "--work-dir", word(kept)];
    segment(mesh, &[&["-q", "-o", word(out)], &words[..]].concat());
    stage(&["embed", "-q", "-d", "4", "--kernel", "cauchy"], kept);
    stage(&["export", "-q", "--embedding-columns", "-o", word(&table)], kept);
    assert!(of_cauchy == std::fs::read(&table).unwrap());
    // Regression: `export` replaced an embedding with other options by that of the labels, under a lock for readers.
    stage(&["embed", "-q", "-d", "3"], kept);
    let embedded = std::fs::read(kept.join("embedding.npy")).unwrap();
    stage(&["export", "-q", "--embedding-columns", "-o", word(&table)], kept);
    assert!(std::fs::read(kept.join("embedding.npy")).unwrap() == embedded);
}

/// A decision that a refused edit had left was told beside labels of the one before.
#[test]
fn a_hierarchy_is_that_of_the_labels() {
    let Scene { mesh, work, out, .. } = &scene(2_000, false);
    segment(mesh, &["-q", "--decision", "single", "--work-dir", word(work), "-o", word(out)]);
    let at = nystrom_stream::Mesh::open(mesh).unwrap().positions.get(0);
    let (edits, tree) = (work.with_extension("edits.json"), work.with_extension("tree.json"));
    let split = serde_json::json!({"edit": "split", "at": at, "into": 60_000});
    let text = serde_json::json!({"format": "nystrom-stream edits", "version": 1, "edits": [split]}).to_string();
    std::fs::write(&edits, text).unwrap();
    stage(&["export", "-q", "--tree", word(&tree)], work);
    refused(&["cluster", "-q", "--decision", "consensus", "--edits", word(&edits)], work, 1);
    let page = out.with_extension("html");
    for words in [["export", "-q", "--tree", word(&tree)], ["export", "-q", "-o", word(&page)]] {
        assert!(refused(&words, work, 1).contains("not the one that its labels were cut from"));
    }
    stage(&["cluster", "-q"], work);
    stage(&["export", "-q", "--tree", word(&tree), "-o", word(&page)], work);
}

/// One option of the embedding brought the others back to their defaults.
#[test]
fn options_of_the_embedding_are_kept_one_by_one() {
    let Scene { mesh, work, out, .. } = &scene(2_000, false);
    let kept = ["--cluster", "kmeans", "-k", "4", "--sigma", "0.4", "--no-unit-rows"];
    segment(mesh, &[&["-q", "--work-dir", word(work), "-o", word(out)], &kept[..]].concat());
    let report = work.with_extension("json");
    let told = |words: &[&str]| {
        let json = format!("--json={}", word(&report));
        stage(&[&["cluster", "-q", "-k", "4", &json], words].concat(), work);
        let report: serde_json::Value = serde_json::from_slice(&std::fs::read(&report).unwrap()).unwrap();
        report["options"]["embedding"].clone()
    };
    let first = told(&[]);
    let mut expected = first.clone();
    expected["kernel"] = told(&["--cluster", "kmeans", "--kernel", "cauchy"])["kernel"].clone();
    assert_ne!(expected, first);
    assert_eq!(told(&["--kernel", "cauchy"]), expected);
    // A width suits its normalisation: another one has its own default.
    assert_ne!(told(&["--normalise", "degree"])["width"], first["width"]);
}

/// A page of `export` told of the options of `segment`, so edits that were saved there began from another cut; under
/// labels of K-means it had the hierarchy's cuts.
#[test]
fn an_exported_page_is_of_the_last_cut() {
    let Scene { mesh, work, out, .. } = &scene(2_000, false);
    segment(mesh, &["-q", "--work-dir", word(work), "-o", word(out)]);
    let page = out.with_extension("html");
    let exported = || {
        stage(&["export", "-q", "-o", word(&page)], work);
        std::fs::read_to_string(&page).unwrap()
    };
    stage(&["cluster", "-q", "-k", "3"], work);
    assert!(exported().contains(r#""count":{"exactly":3}"#));
    stage(&["cluster", "-q", "--cluster", "kmeans", "-k", "4"], work);
    let of_export = exported();
    stage(&["cluster", "-q", "--cluster", "kmeans", "-k", "4", "-o", word(&page)], work);
    assert!(of_export.contains(r#""cluster":"k-means""#));
    // Reports alone differ, by less than what cuts take.
    assert!(of_export.len() <= std::fs::read(&page).unwrap().len());
}

/// K-means of another mesh left the older hierarchy in its place, and it was exported.
#[test]
fn a_hierarchy_is_that_of_the_mesh() {
    let Scene { mesh, work, out, .. } = &scene(2_000, false);
    let tree = out.with_extension("json");
    segment(mesh, &["-q", "--work-dir", word(work), "-o", word(out)]);
    stage(&["export", "--tree", word(&tree)], work);
    let other = creature(mesh.parent().unwrap(), 9_000, false);
    let kmeans = ["-q", "--force", "--cluster", "kmeans", "-k", "3", "--work-dir", word(work), "-o", word(out)];
    segment(&other, &kmeans);
    let said = refused(&["export", "--tree", word(&tree)], work, 1);
    assert!(said.contains("no hierarchy of parts of its mesh"), "{said}");
}

#[test]
fn a_mesh_from_standard_input_stays_in_the_work_directory() {
    let Scene { mesh, work, out, .. } = &scene(2_000, false);
    let input = std::fs::File::open(mesh).unwrap();
    let words = ["segment", "-", "-q", "--work-dir", word(work), "-o", word(out)];
    assert!(common::program().args(words).stdin(input).status().unwrap().success());
    let (ply, direct) = (out.with_extension("ply"), out.with_extension("direct.ply"));
    stage(&["cluster", "-k", "3", "-o", word(&ply)], work);
    segment(mesh, &["-q", "-k", "3", "-o", word(&direct)]);
    assert!(std::fs::read(&ply).unwrap() == std::fs::read(direct).unwrap());
    // Another mesh that is piped in is refused, and what is there stays whole.
    let other = shapes::dumbbell().write(mesh.parent().unwrap());
    let piped = |mesh: &Path, words: &[&str]| {
        let input = std::fs::File::open(mesh).unwrap();
        let words = [&["segment", "-", "-q", "--work-dir", word(work), "-o", word(out)], words].concat();
        common::program().args(words).stdin(input).output().unwrap()
    };
    let output = piped(&other, &[]);
    assert_eq!(output.status.code(), Some(1), "{}", errors(&output));
    assert!(errors(&output).contains("belongs to another mesh, from standard input"), "{}", errors(&output));
    let before = std::fs::read(&ply).unwrap();
    stage(&["cluster", "-k", "3", "-o", word(&ply)], work);
    assert!(std::fs::read(&ply).unwrap() == before);
    // Regression: the mesh that is there stepped aside under the name of a temporary file, and where a run was killed
    // while it read, the next command removed it.
    let mut killed = common::program().args(words).stdin(Stdio::piped()).spawn().unwrap();
    let mut pipe = killed.stdin.take().unwrap();
    pipe.write_all(&std::fs::read(&other).unwrap()).unwrap();
    while !work.join("input.tmp.partial").exists() {
        assert!(killed.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(2));
    }
    killed.kill().unwrap();
    killed.wait().unwrap();
    stage(&["cluster", "-k", "3", "-o", word(&ply)], work);
    assert!(std::fs::read(&ply).unwrap() == before);
    assert!(piped(mesh, &[]).status.success());
    assert!(piped(&other, &["--force"]).status.success());
}

/// Regression: `merge` asked for the missing shards of rows that one process had computed meanwhile, and `rows --shard`
/// said that these are merged already.
#[test]
fn shards_of_rows_that_one_process_has_computed_are_merged() {
    let dir = common::in_memory();
    let mesh = shapes::grid(9).write(dir.path());
    let (mesh, work) = (word(&mesh), dir.path().join("work"));
    stage(&["rows", mesh, "-l", "6", "--shard", "0/2"], &work);
    assert!(refused(&["merge"], &work, 1).contains("this shard is missing"));
    stage(&["rows", mesh, "-l", "6"], &work);
    let before = std::fs::read(work.join("distances.npy")).unwrap();
    stage(&["merge"], &work);
    assert!(std::fs::read(work.join("distances.npy")).unwrap() == before);
    assert!(!work.join("rows-0-of-2.npy").exists() && !work.join("rows-0-of-2.journal").exists());
    // Those of other rows still wait for theirs.
    stage(&["rows", mesh, "-l", "7", "--shard", "0/2"], &work);
    assert!(refused(&["merge"], &work, 1).contains("this shard is missing"));
    assert!(work.join("rows-0-of-2.npy").exists());
}

#[test]
fn what_is_missing_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let none = dir.path().join("none");
    for words in [&["cluster"][..], &["embed"], &["export", "-o", "x.seg"], &["rows"]] {
        let said = refused(words, &none, 1);
        assert!(
            said.contains("is not a work directory") && said.contains("segment MESH --work-dir"),
            "{words:?}: {said}"
        );
    }
    // What a run leaves that was interrupted in its first stage.
    std::fs::create_dir(&none).unwrap();
    std::fs::write(none.join("lock"), "").unwrap();
    for words in [&["info"][..], &["verify"], &["cluster"]] {
        let said = refused(words, &none, 1);
        assert!(said.contains("has no finished stage yet; wait for the run that uses it"), "{words:?}: {said}");
    }
    let mesh = shapes::dumbbell().write(dir.path());
    let work = dir.path().join("work");
    stage(&["graph", word(&mesh)], &work);
    assert!(refused(&["export", "-o", word(&dir.path().join("x.seg"))], &work, 1).contains("holds no labels"));
    let tree = dir.path().join("tree.json");
    assert!(refused(&["export", "--tree", word(&tree)], &work, 1).contains("holds no hierarchy of parts"));
    assert!(refused(&["cluster", "--cluster", "kmeans"], &work, 2).starts_with("nystrom-stream: -k: K-means needs"));
    assert!(refused(&["cluster", "--sigma", "2"], &work, 2).contains("--sigma can only be used with --cluster kmeans"));
    // A mesh that was changed since is not written with labels of the old one.
    stage(&["cluster", "-k", "2"], &work);
    std::fs::write(&mesh, std::fs::read_to_string(shapes::moebius(9).write(dir.path())).unwrap()).unwrap();
    let told = refused(&["export", "-o", word(&dir.path().join("x.ply"))], &work, 1);
    assert!(told.contains("is not the mesh of the work directory"), "{told}");
    // Nor are rows of the old one taken for rows of the new, nor lost without a word.
    assert!(refused(&["rows"], &work, 1).contains("belongs to an earlier version of "));
    let told = stage(&["rows", "--force"], &work);
    assert!(told.contains("emptied, since it belonged to another mesh"), "{told}");
}

/// A dumbbell with specks around it.
pub fn tiny(folder: &Path) -> (PathBuf, usize) {
    let mut shape = shapes::dumbbell();
    let body = shape.faces.len();
    for k in 0..6 {
        let speck = shapes::Shape {
            vertices: shapes::tetrahedron().vertices.iter().map(|v| v.map(|x| 0.004 * x)).collect(),
            ..shapes::tetrahedron()
        };
        shape = shapes::beside("specks", &shape, &speck, [-1. + 0.4 * f64::from(k), 0.6, 0.]);
    }
    (shape.write(folder), body)
}

#[test]
fn tiny_components_join_parts_or_are_one_of_their_own() {
    let dir = tempfile::tempdir().unwrap();
    let (mesh, body) = tiny(dir.path());
    let work = dir.path().join("work");
    let joined = direct(&mesh, &["-k", "3"]);
    assert_eq!(joined.iter().max(), Some(&2));
    let own = direct(&mesh, &["-k", "3", "--dust", "own"]);
    assert!(own[body..].iter().all(|&label| label == 3) && own[..body] == joined[..body]);
    let report = dir.path().join("report.json");
    let json = format!("--json={}", word(&report));
    segment(&mesh, &["-q", "-k", "3", "--tiny-components", "own", "--work-dir", word(&work), &json]);
    let report: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(report).unwrap()).unwrap();
    assert_eq!((&report["tiny_components_label"], &report["tiny_component_faces"]), (&3.into(), &24.into()));
    assert_eq!(report["parts"][3]["colour"], serde_json::json!([128, 128, 128]));
    let out = dir.path().join("out.seg");
    stage(&["cluster", "-k", "2", "--tiny-components", "own", "-o", word(&out)], &work);
    assert!(read_seg(&out).unwrap()[body..].iter().all(|&label| label == 2));
    // Without dust nothing changes, and the paper's ways do not know of it.
    let clean = shapes::dumbbell().write(dir.path());
    assert_eq!(direct(&clean, &["-k", "3", "--tiny-components", "own"]), direct(&clean, &["-k", "3"]));
    let output: Output = run(&["segment", word(&clean), "--cluster", "kmeans", "-k", "3", "--tiny-components", "own"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(errors(&output).contains("--tiny-components can only be used with --cluster parts"));
}

/// Regression: with more parts than other faces, tiny components were divided into several parts, of which the report
/// named one.
#[test]
fn tiny_components_are_not_divided() {
    let dir = common::in_memory();
    let vertices = shapes::tetrahedron().vertices.iter().map(|v| v.map(|x| 1e-4 * x)).collect();
    let speck = shapes::Shape { vertices, ..shapes::tetrahedron() };
    let shape = shapes::beside("a_speck_beside_four_faces", &shapes::tetrahedron(), &speck, [3., 0., 0.]);
    let mesh = shape.write(dir.path());
    assert_eq!(direct(&mesh, &["-k", "4", "--tiny-components", "own"])[4..], [4; 4]);
    for k in ["5", "8"] {
        let told = refused(&["segment", word(&mesh), "-k", k, "--tiny-components", "own"], &dir.path().join("work"), 2);
        assert!(told.contains("request at most 4, or leave out --tiny-components own"), "{told}");
    }
}

#[test]
fn boundaries_by_the_embedding_are_near_those_by_the_front_and_the_same_from_a_work_directory() {
    let Scene { mesh, work, out, .. } = &scene(40_000, false);
    let front = direct(mesh, &["-k", "6"]);
    let one = direct(mesh, &["-k", "6", "--boundaries", "embedding", "--threads", "1"]);
    let capped = direct(mesh, &["-k", "6", "--boundaries", "embedding", "--threads", "2", "--max-memory", "48MiB"]);
    assert_eq!(one, capped);
    let alike = front.iter().zip(&one).filter(|(a, b)| a == b).count();
    assert!(alike * 100 > front.len() * 97, "{alike} of {}", front.len());
    stage(&["graph", word(mesh)], work);
    stage(&["cluster"], work);
    let told = stage(&["cluster", "-k", "6", "--boundaries", "embedding", "-o", word(out)], work);
    assert!(told.contains("decision: reused") && told.contains("rows: reused"), "{told}");
    assert_eq!(read_seg(out).unwrap(), one);
    common::refused(
        &["segment", word(mesh), "--boundaries", "embedding", "--cluster", "kmeans", "-k", "6"],
        2,
        "--boundaries",
    );
}

#[test]
fn an_isosurface_full_of_pockets_is_not_one_part() {
    let Some(data) = common::data().filter(|_| common::every_case()) else {
        eprintln!("skipped: the test meshes are missing, or not every case is asked for");
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let (report, out) = (dir.path().join("report.json"), dir.path().join("out.npy"));
    let json = format!("--json={}", word(&report));
    let told =
        segment(&data.join("real/mri_ch2_head_h.ply"), &["--exact", "--progress", "lines", &json, "-o", word(&out)]);
    assert!(errors(&told).contains("outliers; drawn by area instead"), "{}", errors(&told));
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    assert_eq!((&report["options"]["sampling"], &report["sampling"]), (&serde_json::Value::Null, &"random".into()));
    // Head and brain, and little else.
    let mut area: Vec<f64> = report["parts"].as_array().unwrap().iter().map(|p| p["area"].as_f64().unwrap()).collect();
    area.sort_by(|a, b| b.total_cmp(a));
    let total: f64 = area.iter().sum();
    assert!(area.len() < 6 && area[0] < 0.7 * total && area[1] > 0.3 * total, "{area:?}");
}

/// Regression: K-means took rows over all faces that another command had left, although `segment` would have contracted
/// the mesh.
#[test]
fn rows_that_another_command_left_do_not_decide_k_means() {
    let Scene { mesh, work, out, .. } = &scene(62_000, false);
    stage(&["segment", word(mesh), "-q", "-o", word(out)], work);
    stage(&["embed"], work);
    let means = ["--cluster", "kmeans", "-k", "5"];
    let told = stage(&[&["cluster", "-o", word(out)], &means[..]].concat(), work);
    assert!(read_seg(out).unwrap() == direct(mesh, &means));
    // Regression: only `segment` told how many parts there are.
    assert!(told.contains(" faces in 5 parts in ") && told.contains("out.seg"), "{told}");
}

/// Regression: files of the mesh before stayed, and `info` and `verify` went through them as if they were of this one.
#[test]
fn another_mesh_by_force_leaves_nothing_of_the_one_before() {
    let Scene { mesh, work, out, _dir: dir } = &scene(62_000, false);
    stage(&["segment", word(mesh), "-q", "-o", word(out)], work);
    assert!(work.join("contracted/distances.npy").exists());
    let small = creature(dir.path(), 2_000, false);
    stage(&["segment", word(&small), "-q", "-o", word(out), "--force"], work);
    assert!(read_seg(out).unwrap() == direct(&small, &[]));
    assert!(!work.join("contracted").exists());
}

#[test]
fn a_mesh_that_has_moved_is_named_anew() {
    let Scene { mesh, work, out, .. } = &scene(2_000, false);
    stage(&["segment", word(mesh), "-q", "-k", "3", "-o", word(out)], work);
    let (moved, ply) = (mesh.with_extension("moved.ply"), mesh.with_extension("cut.ply"));
    std::fs::rename(mesh, &moved).unwrap();
    for command in [&["export"][..], &["cluster", "-k", "4"]] {
        let told = refused(&[command, &["-o", word(&ply)]].concat(), work, 1);
        assert!(told.contains("no longer at the path recorded in the work directory; give its new path"), "{told}");
        stage(&[command, &[word(&moved), "-q", "-o", word(&ply)]].concat(), work);
    }
    assert!(ply.exists());
}

/// The dumbbell is the largest component, and its specks follow; they share a part on request.
#[test]
fn connected_components_are_parts_and_need_the_graph_alone() {
    let dir = tempfile::tempdir().unwrap();
    let (mesh, body) = tiny(dir.path());
    let (work, out) = (dir.path().join("work"), dir.path().join("out.seg"));
    let components = ["--cluster", "components"];
    let labels = direct(&mesh, &components);
    assert!(labels[..body].iter().all(|&label| label == 0));
    let specks: Vec<u32> = labels[body..].chunks(4).map(|speck| speck[0]).collect();
    assert!(specks.iter().collect::<BTreeSet<_>>().len() == 6 && labels[body..].chunks(4).all(|of| of == [of[0]; 4]));
    stage(&["graph", word(&mesh)], &work);
    let told = stage(&[&["cluster", "-o", word(&out)], &components[..]].concat(), &work);
    assert!(read_seg(&out).unwrap() == labels && !told.contains("distance rows"), "{told}");
    stage(&[&["cluster", "--tiny-components", "own", "-o", word(&out)], &components[..]].concat(), &work);
    assert!(read_seg(&out).unwrap().iter().eq(labels.iter().map(|label| label.min(&1))));
    // Rows and coordinates for other programs are there all the same.
    stage(&["embed"], &work);
    let plan = run(&[&["plan", word(&mesh)], &components[..]].concat());
    assert!(plan.status.success() && !String::from_utf8_lossy(&plan.stdout).contains("distance rows"));
    for (words, problem) in [
        (["-k", "3"], "as many parts as connected components"),
        (["-l", "3"], "--landmarks can only be used with --cluster parts, kmeans or two-means"),
        (["--walls", "own"], "--walls can only be used with --cluster parts"),
        (["--kernel", "cauchy"], "--kernel can only be used with --cluster kmeans or two-means"),
    ] {
        common::refused(&[&["segment", word(&mesh)], &components[..], &words].concat(), 2, problem);
    }
}

/// Regression: 201 components of one size were all tiny beside the whole, and became one part; 199 were 199 parts.
#[test]
fn many_components_of_one_size_are_parts() {
    let dir = tempfile::tempdir().unwrap();
    let mut shape = shapes::tetrahedron();
    for k in 1..210 {
        shape = shapes::beside(
            "many",
            &shape,
            &shapes::tetrahedron(),
            [f64::from(3 * (k % 15)), f64::from(3 * (k / 15)), 0.],
        );
    }
    let labels = direct(&shape.write(dir.path()), &[]);
    let parts: BTreeSet<Vec<u32>> = labels.chunks(4).map(<[u32]>::to_vec).collect();
    assert!(parts.len() == 210 && parts.iter().all(|part| part.iter().all(|label| *label == part[0])));
}

/// Regression: a mesh without area had a part for each of its two thousand cells.
#[test]
fn a_mesh_without_area_is_left_whole() {
    let dir = tempfile::tempdir().unwrap();
    for (name, scale) in [("nowhere", f64::NAN), ("point", 0.)] {
        let mut shape = shapes::Shape { name, ..shapes::grid(12) };
        shape.vertices.iter_mut().flatten().for_each(|x| *x *= scale);
        let mesh = shape.write(dir.path());
        assert!(direct(&mesh, &[]).iter().all(|label| *label == 0), "{name}");
        let four: BTreeSet<u32> = direct(&mesh, &["-k", "4"]).into_iter().collect();
        assert_eq!(four.len(), 4, "{name}");
    }
}

/// Regression: it took the lock of a writer and kept scratch files there, so that an archive had to be writable.
#[test]
fn export_only_reads_the_work_directory() {
    let scene = scene(2_000, true);
    let path = |name: &str| scene.mesh.with_file_name(name);
    // An OBJ has to be decoded to be written with its labels.
    let (mesh, tmp) = (path("mesh.obj"), path("tmp"));
    segment(&scene.mesh, &["-q", "-k", "4", "-o", word(&mesh)]);
    segment(&mesh, &["-q", "-k", "4", "--work-dir", word(&scene.work), "-o", word(&scene.out)]);
    std::fs::remove_file(scene.work.join("lock")).unwrap();
    std::fs::create_dir(&tmp).unwrap();
    let changed = |folder: &Path| std::fs::metadata(folder).unwrap().modified().unwrap();
    let hidden = |folder: &Path| {
        let names = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        names.filter(|name| name.as_encoded_bytes().starts_with(b".")).count()
    };
    let before = (changed(&scene.work), changed(&tmp));
    let tree = path("tree.json");
    let forms = ["x.ply", "x.obj", "x.html", "x.parquet", "x.csv", "x.npy"].map(path);
    let outputs = forms.iter().flat_map(|form| ["-o", word(form)]);
    let words: Vec<&str> = ["export", "-q", "--tree", word(&tree)].into_iter().chain(outputs).collect();
    stage(&words, &scene.work);
    assert_eq!(changed(&scene.work), before.0);
    assert_eq!(labels(&path("x.npy")), read_seg(&scene.out).unwrap());
    assert!(forms.iter().all(|form| form.exists()) && hidden(scene.work.parent().unwrap()) == 0);
    stage(&[&words[..], &["--tmp", word(&tmp)]].concat(), &scene.work);
    assert!(changed(&tmp) > before.1 && hidden(&tmp) == 0);
    // Regression: a file in the folder that could not be created was named.
    let none = path("none");
    let words = ["export", "--work-dir", word(&scene.work), "-o", word(&forms[0]), "--tmp", word(&none)];
    common::refused(&words, 1, "none: cannot create a temporary folder here: No such file");
    // An embedding that is not there is made and kept.
    let table = path("x.parquet");
    stage(&["export", "-q", "--embedding-columns", "-o", word(&table)], &scene.work);
    assert!(scene.work.join("embedding.npy").exists());
}

/// Regression: areas beyond the range of doubles are `null` in the record of the labels, which `export` could not read.
#[test]
fn a_mesh_whose_area_overflows_is_exported() {
    let dir = common::in_memory();
    let mesh = shapes::all().into_iter().find(|shape| shape.name == "as_far_as_doubles_go").unwrap().write(dir.path());
    let (work, seg, table) = (dir.path().join("work"), dir.path().join("x.seg"), dir.path().join("x.csv"));
    segment(&mesh, &["-q", "-k", "3", "--work-dir", word(&work), "-o", word(&seg), "-o", word(&table)]);
    let written = [&seg, &table].map(|path| std::fs::read(path).unwrap());
    stage(&["export", "-q", "-o", word(&seg), "-o", word(&table)], &work);
    assert_eq!([&seg, &table].map(|path| std::fs::read(path).unwrap()), written);
}

/// Regression: `export` gave the labels and the hierarchy of an older program as if they were today's.
#[test]
fn what_an_older_program_made_is_not_exported() {
    let dir = common::in_memory();
    let mesh = shapes::dumbbell().write(dir.path());
    let (work, tree) = (dir.path().join("work"), dir.path().join("tree.json"));
    segment(&mesh, &["-q", "-k", "3", "--work-dir", word(&work)]);
    let manifest = work.join("manifest.json");
    let now = std::fs::read_to_string(&manifest).unwrap();
    for (name, words) in [("labels", ["-o", word(&dir.path().join("x.seg"))]), ("decision", ["--tree", word(&tree)])] {
        let mut older: serde_json::Value = serde_json::from_str(&now).unwrap();
        older["stages"][name]["version"] = 1.into();
        std::fs::write(&manifest, older.to_string()).unwrap();
        common::refused(
            &[&["export", "--work-dir", word(&work)][..], &words].concat(),
            1,
            "another version of the program",
        );
    }
}

/// Regression: a work directory that an older program had made of another mesh was taken over without a word.
#[test]
fn the_mesh_of_an_older_record_is_known() {
    let dir = common::in_memory();
    let (mesh, other) = (shapes::dumbbell().write(dir.path()), shapes::tetrahedron().write(dir.path()));
    let work = dir.path().join("work");
    segment(&mesh, &["-q", "-k", "3", "--work-dir", word(&work)]);
    let manifest = work.join("manifest.json");
    let mut older: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&manifest).unwrap()).unwrap();
    older["stages"]["record"]["version"] = 1.into();
    std::fs::write(&manifest, older.to_string()).unwrap();
    common::refused(&["segment", word(&other), "-q", "--work-dir", word(&work)], 1, "belongs to another mesh");
    segment(&mesh, &["-q", "-k", "3", "--work-dir", word(&work)]);
}
