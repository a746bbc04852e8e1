//! Predictions of memory and disk against what runs used; refusals of disks that are too small.

use crate::common::{self, errors, every_case, in_memory, json, refused, word};
use nystrom_stream::base::random::{stream, unit};
use nystrom_stream::mesh::{Labelling, Mesh};
use serde_json::Value;
use std::path::Path;
use std::process::Command;

fn creature(folder: &Path, faces: u64) -> String {
    word(&common::creature(folder, faces, false)).to_string()
}

/// Writes a mesh to `path`, all of whose faces have label 0.
fn save(path: &Path, points: &[[f32; 3]], faces: &[[u32; 3]]) {
    let labelling =
        Labelling { labels: &vec![0; faces.len()], colours: &[[0; 3]], quality: None, names: &[], fine: None };
    Mesh::from_slices(points, faces).unwrap().save(path, labelling).unwrap();
}

/// The most bytes that the program allocates at once; it must succeed. `folder` is for a file.
fn allocated(folder: &Path, arguments: &[&str]) -> u64 {
    let peak = folder.join("peak");
    let run = common::program().args(arguments).env("NYSTROM_STREAM_PEAK", &peak).output().unwrap();
    assert!(run.status.success(), "{}", errors(&run));
    std::fs::read_to_string(&peak).unwrap().parse().unwrap()
}

#[test]
fn disk_and_memory_are_what_was_planned() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 1_000_000);
    let out = dir.path().join("labels.npy");
    let ways = [("kmeans", "32MiB"), ("parts", "256MiB"), ("kmeans", "256MiB")];
    for (cluster, budget) in ways.into_iter().take(if every_case() { 3 } else { 2 }) {
        let options = ["-k", "6", "-l", "10", "--cluster", cluster, "--max-memory", budget];
        let plan = json(&[&["plan", &mesh, "--json"], &options[..]].concat());
        let report = json(&[&["segment", &mesh, "-q", "--json", "-o", word(&out)], &options[..]].concat());
        // A megabyte more on both sides: where all arrays are held in memory, the disk has only the manifest.
        let megabytes = |value: &Value| 1. + value.as_f64().unwrap() / 1e6;
        let ratio = |planned: &str, used: &str| megabytes(&plan[planned]) / megabytes(&report["bytes"][used]);
        let (disk, memory) = (ratio("disk", "work_dir"), ratio("memory", "peak_allocated"));
        let time = plan["seconds"].as_f64().unwrap() / report["seconds"]["total"].as_f64().unwrap();
        eprintln!("{cluster} {budget}: planned/used: disk {disk:.2}, memory {memory:.2}, time {time:.2}");
        assert!((0.8..1.2).contains(&disk), "{cluster} {budget}: disk {disk}");
        assert!((0.8..1.2).contains(&memory), "{cluster} {budget}: memory {memory}");
    }
}

/// Regression: reports left out the folder of the contraction, which is most of the work directory here, and its graph
/// was written to the disk even where all else is held in memory.
#[test]
fn the_contraction_is_planned_and_reported() {
    let dir = in_memory();
    let mesh = creature(dir.path(), 100_000);
    let [out, work] = ["labels.npy", "work"].map(|name| dir.path().join(name).to_str().unwrap().to_string());
    let bytes_of = |kept: &[&str]| {
        let report = json(&[&["segment", &mesh, "-q", "--json", "-o", &out], kept].concat());
        report["bytes"]["work_dir"].as_f64().unwrap()
    };
    let in_memory = bytes_of(&[]);
    assert!(in_memory < 1e5, "{in_memory}");
    let kept = ["--work-dir", work.as_str()];
    let plan = json(&[&["plan", &mesh, "--json"], &kept[..]].concat());
    let (planned, used) = (plan["disk"].as_f64().unwrap(), bytes_of(&kept));
    assert!((0.8..1.2).contains(&(planned / used)), "{planned} {used}");
}

/// With `ulimit -v`, as on shared machines, the default budget was half of the machine's memory, and the run was aborted.
#[test]
fn the_default_budget_is_within_the_limit_of_the_process() {
    let dir = in_memory();
    let mesh = creature(dir.path(), 100_000);
    let labels = dir.path().join("labels.npy");
    let command = "ulimit -v 600000; exec \"$0\" segment \"$1\" -q --json -o \"$2\"";
    let program = env!("CARGO_BIN_EXE_nystrom-stream");
    let output = Command::new("bash").args(["-c", command, program, &mesh]).arg(&labels).output().unwrap();
    assert!(output.status.success(), "{}", errors(&output));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(report["bytes"]["budget"].as_u64().unwrap() <= 600_000 * 1024 / 4, "{}", report["bytes"]);
}

/// Regression: what deciding parts takes, whatever the budget, was left out where the budget is less.
#[test]
fn a_small_budget_does_not_hide_what_parts_take() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 10_000);
    let out = dir.path().join("labels.npy");
    let budget = ["--max-memory", "1MiB"];
    let plan = common::run(&[&["plan", &mesh], &budget[..]].concat());
    let told = String::from_utf8(plan.stdout).unwrap();
    assert!(
        told.contains("warning: at least 20.97 MB are allocated whatever the mesh, although --max-memory is 1.05 MB"),
        "{told}"
    );
    // The report said nothing of it.
    let report = json(&[&["plan", &mesh, "--json"], &budget[..]].concat());
    let notes = report["notes"].as_array().unwrap();
    assert!(
        notes.iter().any(|note| note.as_str().unwrap().starts_with("warning: at least 20.97 MB are allocated")),
        "{notes:?}"
    );
    let report = json(&[&["segment", &mesh, "-q", "--json", "-o", word(&out)], &budget[..]].concat());
    let allocated = report["bytes"]["peak_allocated"].as_u64().unwrap();
    assert!((1 << 20..20 << 20).contains(&allocated), "{allocated}");
}

/// Regression: more landmarks than usual took hundreds of megabytes beside any budget, and more with every thread.
#[test]
fn what_many_landmarks_take_is_planned_and_fits_the_budget() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 10_000);
    let out = dir.path().join("labels.npy");
    let ways = [("kmeans", "200"), ("parts", "500")];
    for (cluster, landmarks) in ways.into_iter().take(if every_case() { 2 } else { 1 }) {
        let options = ["-k", "6", "-l", landmarks, "--cluster", cluster, "--threads", "8", "--max-memory", "100MB"];
        let plan = json(&[&["plan", &mesh, "--json"], &options[..]].concat());
        let report = json(&[&["segment", &mesh, "-q", "--json", "-o", word(&out)], &options[..]].concat());
        let allocated = report["bytes"]["peak_allocated"].as_f64().unwrap();
        let ratio = plan["memory"].as_f64().unwrap() / allocated;
        assert!(allocated < 140e6 && (0.7..1.3).contains(&ratio), "{cluster}: {allocated}, {ratio}");
        let few = [&["segment", &mesh, "-q", "-o", word(&out)], &options[..8], &["--max-memory", "8MB"]];
        let run = common::run(&few.concat());
        let told = String::from_utf8(run.stderr).unwrap();
        assert_eq!(run.status.code(), Some(if cluster == "kmeans" { 1 } else { 0 }), "{told}");
        assert!(cluster == "parts" || told.contains("landmarks needs") && told.contains(" or -l"), "{told}");
    }
}

/// Regression: joining separate pieces took 220 bytes of memory for each, and deciding about them 2 GB, whatever the
/// budget.
#[test]
fn thousands_of_pieces_fit_the_budget() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("pieces.ply");
    let pieces = 60_000u32;
    let mut random = stream(1, "pieces");
    let corner = |_| [0; 3].map(|_| 1e-3 * unit(&mut random) as f32);
    let mut points: Vec<[f32; 3]> = (0..3 * pieces).map(corner).collect();
    for triangle in points.chunks_exact_mut(3) {
        let place = [0; 3].map(|_| unit(&mut random) as f32);
        triangle.iter_mut().flatten().zip(place.into_iter().cycle()).for_each(|(x, offset)| *x += offset);
    }
    let faces: Vec<[u32; 3]> = (0..pieces).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    save(&path, &points, &faces);
    let (mesh, out) = (word(&path), dir.path().join("labels.npy"));
    let allocated = |arguments: &[&str]| allocated(dir.path(), &[arguments, &["--max-memory", "4MB", "-q"]].concat());
    let graph = allocated(&["graph", mesh, "--work-dir", word(&dir.path().join("work"))]);
    assert!(graph < 6_000_000, "{graph}");
    // Two thousand superfaces take three matrices of 32 MB.
    let parts = allocated(&["segment", mesh, "-o", word(&out)]);
    assert!(parts < 120_000_000, "{parts}");
}

/// Regression: the bands around boundaries were allocated beside the budget, some 200 bytes per face there where the
/// surface is rough: this took 133 MB.
#[test]
fn bands_around_many_boundaries_fit_the_budget() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("rough.ply");
    let side = 700u32;
    let mut random = stream(1, "rough");
    let mut height = |x: f32, y: f32| 20. * (x / 90.).sin() * (y / 70.).cos() + 1.4 * (unit(&mut random) as f32 - 0.5);
    let points: Vec<[f32; 3]> =
        (0..side * side).map(|k| [(k % side) as f32, (k / side) as f32]).map(|[x, y]| [x, y, height(x, y)]).collect();
    let corners = (0..side * side).filter(|k| k % side + 1 < side && k / side + 1 < side);
    let faces: Vec<[u32; 3]> = corners.flat_map(|k| [[k, k + 1, k + side], [k + 1, k + side + 1, k + side]]).collect();
    save(&path, &points, &faces);
    let mesh = word(&path);
    let cut = |name: &str, budget: &str| {
        let out = dir.path().join(name);
        let words = ["segment", mesh, "-k", "500", "-q", "--max-memory", budget, "-o", word(&out)];
        let allocated = allocated(dir.path(), &words);
        (std::fs::read(&out).unwrap(), allocated)
    };
    let (labels, allocated) = cut("small.npy", "8MB");
    assert!(allocated < 48_000_000, "{allocated}");
    assert!(labels == cut("large.npy", "4GB").0);
}

/// Regression: five matrices of all points for each thread were beside the budget.
#[test]
fn a_study_of_points_fits_the_budget() {
    let dir = in_memory();
    let study = ["study", "--points", "300", "--runs", "8", "--threads", "8", "-q", "--max-memory"];
    let peak = allocated(dir.path(), &[&study[..], &["8MiB"]].concat());
    assert!(peak < 8 << 20, "{peak}");
    refused(&[&study[..], &["3MiB"]].concat(), 1, "or take fewer points");
}

/// Mounts a file system of `size` in memory at `at`; whether that is allowed here.
fn mount(at: &Path, size: &str) -> bool {
    let option = format!("size={size}");
    Command::new("mount")
        .args(["-t", "tmpfs", "-o", &option, "tmpfs", word(at)])
        .output()
        .is_ok_and(|output| output.status.success())
}

#[test]
fn a_small_disk_is_refused_at_once_and_a_full_one_is_an_error_that_resumes() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = creature(dir.path(), 100_000);
    let disk = dir.path().join("disk");
    std::fs::create_dir(&disk).unwrap();
    if !mount(&disk, "8m") {
        eprintln!("skipped: no right to mount");
        return;
    }
    let work = disk.join("work");
    let out = dir.path().join("labels.npy");
    let (work, out) = (word(&work), word(&out));
    let arguments = ["segment", &mesh, "-k", "6", "--cluster", "kmeans", "--work-dir", work, "-o", out];
    let refused = common::run(&arguments);
    let said = errors(&refused);
    // Room for the plan, taken away by a file of another program.
    let remount = |size: &str| {
        let option = format!("remount,size={size}");
        Command::new("mount").args(["-o", &option, word(&disk)]).status().unwrap();
    };
    remount("40m");
    let mut full = Vec::new();
    for filler in [38, 34, 31, 28] {
        std::fs::write(disk.join("filler"), vec![1u8; filler << 20]).unwrap();
        full.push(common::run(&[&arguments[..], &["--no-plan"]].concat()));
    }
    std::fs::remove_file(disk.join("filler")).unwrap();
    let resumed = common::run(&arguments);
    Command::new("umount").arg(&disk).status().unwrap();
    assert_eq!(refused.status.code(), Some(1));
    assert!(said.contains("bytes of disk") && said.lines().count() == 1, "{said}");
    assert!(!full[0].status.success(), "two megabytes cannot do");
    for output in full.iter().filter(|output| !output.status.success()) {
        let said = errors(output);
        let last = said.lines().last().unwrap_or_default();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(last.contains("free some disk space"), "{said}");
    }
    assert!(resumed.status.success(), "{}", errors(&resumed));
}

#[test]
fn a_vanished_input_and_a_folder_that_cannot_be_written_are_clear_errors() {
    let dir = tempfile::tempdir().unwrap();
    let gone = dir.path().join("gone.ply");
    for command in ["plan", "segment"] {
        assert_eq!(refused(&[command, word(&gone), "-k", "2"], 1, "gone.ply").lines().count(), 1);
    }
    let mesh = creature(dir.path(), 5_000);
    let said = refused(&["segment", &mesh, "-k", "2", "--work-dir", "/proc/work", "-o", "/dev/null.npy"], 1, "");
    assert_eq!(said.lines().count(), 1, "{said}");
}

#[test]
fn more_corners_than_can_be_numbered_are_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let (path, faces) = (dir.path().join("huge.ply"), 1_500_000_000u64);
    let header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex 750000000\nproperty float x\nproperty float y\n\
         property float z\nelement face {faces}\nproperty list uchar uint vertex_indices\nend_header\n"
    );
    std::fs::write(&path, &header).unwrap();
    // All of it a hole, which takes no disk.
    let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
    file.set_len(header.len() as u64 + 12 * 750_000_000 + 13 * faces).unwrap();
    for words in [&["plan"][..], &["segment", "-q"]] {
        let said = refused(&[words, &[word(&path)]].concat(), 1, "4500000000 corners");
        assert_eq!(said.lines().count(), 1, "{said}");
    }
}
