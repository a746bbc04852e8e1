//! `segment` of many meshes: files, folders and patterns; jobs, a table, JSON lines, going on and taking up again.

use crate::common::{self, errors, names, ok, program, refused, run, shapes, word};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Output;

/// A folder with four meshes, a result, another file, and a file that is no mesh.
fn folder() -> (tempfile::TempDir, PathBuf) {
    let dir = common::in_memory();
    let meshes = dir.path().join("meshes");
    std::fs::create_dir(&meshes).unwrap();
    shapes::dumbbell().write(&meshes);
    shapes::moebius(30).write(&meshes);
    shapes::grid(9).write(&meshes);
    common::creature(&meshes, 4_000, false);
    shapes::grid(5).write(dir.path());
    std::fs::copy(dir.path().join("grid.ply"), meshes.join("old.segmented.ply")).unwrap();
    std::fs::write(meshes.join("notes.txt"), "no mesh").unwrap();
    std::fs::write(meshes.join("bad.ply"), "ply\n").unwrap();
    (dir, meshes)
}

const GOOD: [&str; 4] = ["creature_4000", "dumbbell", "grid", "moebius"];

fn lines(text: &[u8]) -> Vec<Value> {
    String::from_utf8_lossy(text).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn batch(meshes: &Path, out: &Path, words: &[&str]) -> Output {
    std::fs::create_dir_all(out).unwrap();
    let pattern = out.join("{}.seg");
    let output =
        program().arg("segment").arg(meshes).args(["-k", "3", "-o", word(&pattern)]).args(words).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", errors(&output));
    output
}

#[test]
fn a_folder_gives_a_table_and_json_lines_and_goes_on_after_a_failure() {
    let (dir, meshes) = folder();
    let out = dir.path().join("out");
    let output = batch(&meshes, &out, &["--json-lines"]);
    assert_eq!(names(&out), GOOD.map(|name| format!("{name}.seg")));
    let told = errors(&output);
    for name in GOOD {
        let path = meshes.join(format!("{name}.ply"));
        let row: Vec<&str> =
            told.lines().find(|line| line.starts_with(word(&path))).unwrap().split_whitespace().collect();
        assert_eq!((row.len(), row[2]), (4, "3"), "{told}");
    }
    assert!(told.contains(&format!("failed: {}", word(&meshes.join("bad.ply")))), "{told}");
    // Columns stand below their names, however long the paths are.
    let column = |line: &str| line.rsplit_once(' ').map(|(before, _)| before.trim_end().len());
    let table: Vec<_> =
        told.lines().filter(|line| line.starts_with("mesh ") || line.starts_with(word(&meshes))).collect();
    assert!(table.len() == 5 && table.iter().all(|row| column(row) == column(table[0])), "{told}");
    assert!(told.lines().next_back().unwrap().starts_with("5 meshes: 4 done, 1 failed, in "), "{told}");
    let lines = lines(&output.stdout);
    assert_eq!(lines.len(), 5);
    let of = |name: &str| lines.iter().find(|line| line["mesh"].as_str().unwrap().ends_with(name)).unwrap();
    assert_eq!((&of("grid.ply")["faces"], &of("grid.ply")["parts"]), (&162.into(), &3.into()));
    assert!(of("grid.ply")["gamma_per_face"].is_null() && of("grid.ply")["seconds"].as_f64().unwrap() > 0.);
    assert_eq!(of("grid.ply")["outputs"][0], word(&out.join("grid.seg")));
    assert!(of("bad.ply")["error"].as_str().unwrap().contains("header"), "{lines:?}");
    // The paper's quality is told where there is one.
    let means = batch(&meshes, &out, &["--cluster", "kmeans", "--json-lines", "-q"]);
    assert!(
        self::lines(&means.stdout).iter().any(|line| line["gamma_per_face"].as_f64().is_some_and(|gamma| gamma > 0.))
    );
}

#[test]
fn jobs_change_nothing_but_the_time() {
    let (dir, meshes) = folder();
    let (one, two) = (dir.path().join("one"), dir.path().join("two"));
    batch(&meshes, &one, &["-q"]);
    let report = format!("--json={}", word(&dir.path().join("reports.json")));
    batch(&meshes, &two, &["--jobs", "3", "--max-memory", "300MB", "-q", &report]);
    for name in names(&one) {
        assert!(std::fs::read(one.join(&name)).unwrap() == std::fs::read(two.join(&name)).unwrap(), "{name}");
    }
    assert_eq!(names(&two).len(), 4, "no temporary folder stays");
    let reports: Value =
        serde_json::from_str(&std::fs::read_to_string(dir.path().join("reports.json")).unwrap()).unwrap();
    let reports = reports.as_array().unwrap();
    // In the order of the meshes, each within its share.
    let paths: Vec<_> = reports.iter().map(|report| report["input"]["path"].as_str().unwrap()).collect();
    assert_eq!(paths, GOOD.map(|name| word(&meshes.join(format!("{name}.ply"))).to_string()));
    assert!(reports.iter().all(|report| report["bytes"]["budget"] == 100_000_000), "{}", reports[0]["bytes"]);
}

#[test]
fn finished_outputs_are_skipped_on_request() {
    let (dir, meshes) = folder();
    let out = dir.path().join("out");
    batch(&meshes, &out, &["-q"]);
    std::fs::remove_file(out.join("grid.seg")).unwrap();
    let output = batch(&meshes, &out, &["--resume", "--json-lines"]);
    let (skipped, done): (Vec<Value>, Vec<Value>) =
        lines(&output.stdout).into_iter().partition(|line: &Value| line["skipped"] == true);
    assert_eq!(done.len(), 2, "the one that failed and the one that was missing: {done:?}");
    assert_eq!(skipped.len(), 3, "those that are there: {skipped:?}");
    assert!(errors(&output).contains("5 meshes: 1 done, 1 failed, 3 skipped, in "), "{}", errors(&output));
    // Other options make other labels: what lies there is not taken for them.
    let pattern = out.join("{}.seg");
    let output = run(&["segment", word(&meshes), "--resume", "-k", "2", "-o", word(&pattern)]);
    assert!(errors(&output).contains("5 meshes: 4 done, 1 failed, in "), "{}", errors(&output));
    assert!(errors(&output).contains("are written again"), "{}", errors(&output));
    let parts = |name: &str| nystrom_stream::mesh::read_seg(&out.join(name)).unwrap().into_iter().max();
    assert_eq!(parts("grid.seg"), Some(1));
    // Nor is a file that something else has written since.
    let other = std::fs::read(out.join("dumbbell.seg")).unwrap();
    std::fs::write(out.join("dumbbell.seg"), [&other[..], b"0\n"].concat()).unwrap();
    let output = run(&["segment", word(&meshes), "--resume", "-k", "2", "-o", word(&pattern)]);
    assert!(errors(&output).contains("5 meshes: 1 done, 1 failed, 3 skipped, in "), "{}", errors(&output));
    assert!(std::fs::read(out.join("dumbbell.seg")).unwrap() == other);
    batch(&meshes, &out, &["--resume", "-q"]);
    // A mesh that changed since is done again.
    std::thread::sleep(std::time::Duration::from_millis(20));
    shapes::moebius(40).write(&meshes);
    let output = batch(&meshes, &out, &["--resume", "--json-lines", "-q"]);
    assert_eq!(lines(&output.stdout).iter().filter(|line| line["skipped"] != true).count(), 2);
    assert_eq!(nystrom_stream::mesh::read_seg(&out.join("moebius.seg")).unwrap().len(), 80);
}

/// Regression: `--resume` replaced the reports of the meshes that it skipped by none.
#[test]
fn reports_of_skipped_meshes_stay() {
    let dir = common::in_memory();
    let meshes = [shapes::dumbbell(), shapes::grid(9), shapes::moebius(30)].map(|mesh| mesh.write(dir.path()));
    let (json, out) = (dir.path().join("all.json"), dir.path().join("{}.seg"));
    let option = format!("--json={}", word(&json));
    let cut = |meshes: &[PathBuf]| {
        let names = meshes.iter().map(|mesh| word(mesh)).collect::<Vec<_>>();
        let output =
            program().arg("segment").args(names).args(["-q", "--resume", "-k", "2", &option, "-o"]).arg(&out).output();
        assert!(output.unwrap().status.success());
        let reports: Vec<Value> = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        let paths: Vec<_> =
            reports.iter().map(|report| PathBuf::from(report["input"]["path"].as_str().unwrap())).collect();
        assert_eq!(paths, meshes);
        reports
    };
    let two = cut(&meshes[..2]);
    let three = cut(&meshes);
    assert_eq!(two, three[..2], "the same reports, times included");
    assert_eq!(three, cut(&meshes));
    // Those of meshes that are not among the given ones go, and what holds no reports is kept.
    cut(&meshes[1..]);
    std::fs::write(&json, "mine").unwrap();
    let words = ["segment", word(&meshes[0]), "-q", "--resume", "-k", "2", &option, "-o", word(&out)];
    refused(&words, 1, "holds no reports of a batch");
    assert_eq!(std::fs::read_to_string(&json).unwrap(), "mine");
}

/// Regression: two batches over one folder of outputs that began together cut each mesh twice, in step.
#[test]
fn what_another_batch_works_on_is_skipped_on_request() {
    let dir = common::in_memory();
    let meshes = [shapes::grid(9).write(dir.path()), shapes::dumbbell().write(dir.path())];
    let out = dir.path().join("{}.seg");
    let again = |words: &[&str]| {
        let words = [&["segment", word(&meshes[0]), word(&meshes[1]), "-k", "2", "-o", word(&out)], words].concat();
        ok(&words)
    };
    let records = dir.path().join(".nystrom-stream");
    std::fs::create_dir(&records).unwrap();
    // What a run does that is alive.
    let claim = records.join("grid.seg.claim");
    let live = std::fs::File::create(&claim).unwrap();
    live.lock().unwrap();
    let output = again(&["--resume", "--json-lines"]);
    let told = errors(&output);
    assert!(told.contains("another run is working on it, and it is skipped"), "{told}");
    assert!(told.contains("2 meshes: 1 done, 0 failed, 1 skipped (1 in another run), in "), "{told}");
    assert_eq!(lines(&output.stdout)[0]["reason"], "another run is working on it");
    assert!(claim.exists() && !dir.path().join("grid.seg").exists());
    // Without the option it is wanted now.
    assert!(errors(&again(&[])).contains("2 meshes: 2 done, 0 failed, in "));
    std::fs::remove_file(dir.path().join("grid.seg")).unwrap();
    // The claim of a run that was killed counts for nothing.
    drop(live);
    assert!(errors(&again(&["--resume"])).contains("2 meshes: 1 done, 0 failed, 1 skipped, in "));
    assert_eq!(names(&records), ["dumbbell.seg.json", "grid.seg.json"]);
}

/// The record of a batch told of the first and the last mebibyte of a mesh alone, and a mesh that takes the place of
/// another by renaming keeps its time.
#[test]
fn a_mesh_of_the_same_ends_that_takes_the_place_of_another_is_done_again() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 200_000, false);
    let (kept, other) = (dir.path().join("kept"), dir.path().join("other"));
    let mut bytes = std::fs::read(&mesh).unwrap();
    assert!(bytes.len() > 3 << 20, "{}", bytes.len());
    std::fs::copy(&mesh, &kept).unwrap();
    // A vertex that lies elsewhere.
    bytes[(1 << 20) + 100] ^= 1;
    std::fs::write(&other, &bytes).unwrap();
    let out = dir.path().join("out.npy");
    std::thread::sleep(std::time::Duration::from_millis(20));
    let again = || {
        let output = run(&["segment", word(&mesh), "--cluster", "kmeans", "-k", "2", "--resume", "-o", word(&out)]);
        let told = errors(&output);
        assert!(output.status.success(), "{told}");
        told.lines().next_back().unwrap_or_default().to_string()
    };
    assert!(again().contains("1 done, 0 failed, in "));
    assert!(again().contains("1 skipped"));
    std::fs::rename(&other, &mesh).unwrap();
    assert!(again().contains("1 done, 0 failed, in "));
    // A copy of the same content is the same mesh.
    std::fs::write(&mesh, &bytes).unwrap();
    let time = std::fs::metadata(&kept).unwrap().modified().unwrap();
    std::fs::File::options().write(true).open(&mesh).unwrap().set_modified(time).unwrap();
    assert!(again().contains("1 skipped"));
}

/// Regression: outputs are never newer than a mesh from a machine whose clock is ahead, so it was cut in every run.
#[test]
fn a_mesh_from_the_future_is_skipped_once_it_is_done() {
    let dir = common::in_memory();
    let (mesh, out) = (shapes::dumbbell().write(dir.path()), dir.path().join("out.seg"));
    let future = std::time::SystemTime::now() + std::time::Duration::from_secs(86_400);
    let again = || {
        std::fs::File::options().write(true).open(&mesh).unwrap().set_modified(future).unwrap();
        let output = run(&["segment", word(&mesh), "-k", "2", "--resume", "-o", word(&out)]);
        errors(&output).lines().next_back().unwrap_or_default().to_string()
    };
    assert!(again().contains("1 done, 0 failed, in "));
    assert!(again().contains("1 skipped"));
    // Another mesh at this path is still cut.
    std::fs::copy(shapes::grid(9).write(dir.path()), &mesh).unwrap();
    assert!(again().contains("1 done, 0 failed, in "));
}

/// Only the list of a folder of parts was looked at: one whose parts were gone or cut short was skipped.
#[test]
fn a_folder_of_parts_is_skipped_if_it_is_whole() {
    let dir = common::in_memory();
    let meshes = [shapes::dumbbell().write(dir.path()), shapes::grid(9).write(dir.path())];
    let pattern = format!("{}/{{}}.parts/", word(dir.path()));
    let again = || {
        let output = run(&["segment", word(&meshes[0]), word(&meshes[1]), "-k", "2", "--resume", "-o", &pattern]);
        let told = errors(&output);
        assert!(output.status.success(), "{told}");
        told.lines().next_back().unwrap_or_default().to_string()
    };
    assert!(again().contains("2 done, 0 failed, in "));
    assert!(again().contains("0 done, 0 failed, 2 skipped"));
    let part = dir.path().join("grid.parts/part_001.ply");
    let bytes = std::fs::read(&part).unwrap();
    std::fs::write(&part, &bytes[..bytes.len() / 2]).unwrap();
    assert!(again().contains("1 done, 0 failed, 1 skipped"));
    assert!(std::fs::read(&part).unwrap() == bytes);
    std::fs::remove_file(&part).unwrap();
    assert!(again().contains("1 done, 0 failed, 1 skipped"));
    assert!(std::fs::read(&part).unwrap() == bytes);
    // What else somebody puts there does not matter.
    std::fs::write(dir.path().join("grid.parts/notes.txt"), "mine").unwrap();
    assert!(again().contains("0 done, 0 failed, 2 skipped"));
}

/// Regression: where a run was killed or a mesh failed, its output in the folder of the meshes had no record, was taken
/// for a mesh, and the same command with `--resume` was refused.
#[test]
fn what_a_failed_or_killed_run_leaves_in_the_folder_of_the_meshes_is_no_mesh() {
    let dir = common::in_memory();
    let grid = shapes::grid(9).write(dir.path());
    shapes::dumbbell().write(dir.path());
    let pattern = dir.path().join("{}.cut.ply");
    let again = |words: &[&str]| {
        let words = [&["segment", word(dir.path()), "-k", "2", "--resume", "-o", word(&pattern)], words].concat();
        errors(&run(&words)).lines().next_back().unwrap_or_default().to_string()
    };
    assert!(again(&[]).starts_with("2 meshes: 2 done"));
    let whole = std::fs::read(&grid).unwrap();
    std::fs::write(&grid, &whole[..whole.len() / 2]).unwrap();
    assert!(again(&[]).starts_with("2 meshes: 0 done, 1 failed, 1 skipped"));
    std::fs::write(&grid, &whole).unwrap();
    assert!(again(&[]).starts_with("2 meshes: 1 done, 0 failed, 1 skipped"));
    assert!(again(&[]).starts_with("2 meshes: 0 done, 0 failed, 2 skipped"));
    // Killed as soon as the first output is there, long before the second is.
    let slow = common::creature(dir.path(), 20_000, false);
    let (first, second) = (dir.path().join("creature_20000.cut.ply"), dir.path().join("{}.html"));
    let words = ["segment", word(dir.path()), "-k", "2", "--resume", "-q", "-o", word(&pattern), "-o", word(&second)];
    let mut child = program().args(words).spawn().unwrap();
    while !first.exists() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    let _ = child.kill();
    child.wait().unwrap();
    std::fs::remove_file(slow).unwrap();
    assert!(first.exists());
    assert!(again(&[]).starts_with("2 meshes: "));
}

/// A mesh that fails in a folder of its own leaves no record there.
#[test]
fn a_failed_mesh_leaves_no_folder_of_records() {
    let dir = common::in_memory();
    std::fs::write(dir.path().join("bad.ply"), "ply\n").unwrap();
    let output = run(&["segment", word(dir.path()), "-q"]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
}

/// Regression: a mesh counted as done before its line was written, so that a full disk or a kill could lose the line
/// for good; and a line that was cut short spoiled the next one.
#[cfg(unix)]
#[test]
fn every_mesh_that_is_done_has_its_line() {
    let dir = common::in_memory();
    let (mesh, out, file) =
        (shapes::grid(9).write(dir.path()), dir.path().join("{}.seg"), dir.path().join("all.jsonl"));
    let again = |lines: &Path| {
        let lines = format!("--json-lines={}", word(lines));
        run(&["segment", word(&mesh), "-k", "2", "-q", "--resume", &lines, "-o", word(&out)])
    };
    if Path::new("/dev/full").exists() {
        assert_eq!(again(Path::new("/dev/full")).status.code(), Some(1));
    }
    let expected = |count: usize| {
        let told = lines(&std::fs::read(&file).unwrap());
        assert!(told.len() == count && told[0]["faces"] == 162, "{told:?}");
    };
    assert!(again(&file).status.success());
    expected(1);
    let whole = std::fs::read(&file).unwrap();
    for torn in [&whole[..3], &whole[..whole.len() / 2]] {
        std::fs::write(&file, [&whole[..], torn].concat()).unwrap();
        assert!(again(&file).status.success());
        expected(2);
    }
    // A line that only lacks its end stays, as does what is none.
    std::fs::write(&file, &whole[..whole.len() - 1]).unwrap();
    assert!(again(&file).status.success());
    expected(2);
    std::fs::write(&file, "notes").unwrap();
    assert!(again(&file).status.success());
    assert!(std::fs::read_to_string(&file).unwrap().starts_with("notes\n{"));
}

/// Regression: `matches no file` and `holds no mesh` were said of outputs, which are skipped.
#[test]
fn a_folder_of_outputs_alone_is_told_of() {
    let dir = common::in_memory();
    shapes::grid(5).write(dir.path());
    std::fs::rename(dir.path().join("grid.ply"), dir.path().join("grid.segmented.ply")).unwrap();
    for path in [dir.path().to_path_buf(), dir.path().join("*.ply")] {
        refused(&["segment", word(&path)], 1, "all meshes here are outputs of this program");
    }
}

/// Regression: folders that could not be listed were passed over in silence, and the batch ended with 0.
#[cfg(unix)]
#[test]
fn a_folder_that_cannot_be_listed_fails_and_the_rest_is_done() {
    use std::os::unix::fs::PermissionsExt;
    use std::os::unix::process::CommandExt;
    let dir = common::in_memory();
    let (open, closed) = (dir.path().join("open"), dir.path().join("closed"));
    for folder in [&open, &closed] {
        std::fs::create_dir(folder).unwrap();
        shapes::grid(5).write(folder);
    }
    let mode = |path: &Path, mode| std::fs::set_permissions(path, PermissionsExt::from_mode(mode)).unwrap();
    [dir.path(), &open].into_iter().for_each(|folder| mode(folder, 0o777));
    // Permissions bind everybody but root, and the program may lie where only root can look.
    let there = dir.path().join("program");
    // By another process: while this one has the copy open for writing, a program that another test starts inherits it for a moment,
    // and a file that is open for writing cannot be run.
    assert!(std::process::Command::new("cp").arg(program().get_program()).arg(&there).status().unwrap().success());
    mode(&closed, 0);
    let is_root = std::fs::read_dir(&closed).is_ok();
    let cut = |mesh: &Path, option: &str| {
        let mut own = std::process::Command::new(&there);
        if is_root {
            own.uid(65_534);
        }
        own.args(["segment", word(mesh), "-k", "2", option]).output().unwrap()
    };
    let output = cut(&dir.path().join("*/*.ply"), "--json-lines");
    let (told, lines) = (errors(&output), lines(&output.stdout));
    let name = word(&closed);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains(&format!("failed: {name}: cannot list: ")), "{told}");
    assert!(told.lines().next_back().unwrap().starts_with("2 meshes: 1 done, 1 failed, in "), "{told}");
    assert!(lines.len() == 2 && lines[0]["mesh"] == name && lines[0]["error"].is_string(), "{lines:?}");
    // Regression: where no wildcard follows the folder, it was passed over still.
    let output = cut(&dir.path().join("*/grid.ply"), "-q");
    let told = errors(&output);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(
        told.contains(&format!("{name}/grid.ply: cannot open: ")) && told.contains("1 of 2 meshes failed"),
        "{told}"
    );
    // Nor may the files of a folder be looked at: each of them fails.
    mode(&closed, 0o644);
    let told = errors(&cut(&closed, "-q"));
    assert!(told.contains("grid.ply") && told.contains("1 of 1 mesh failed"), "{told}");
    mode(&closed, 0o755);
}

/// Regression: the same command again took parts for meshes, and was refused.
#[test]
fn a_pattern_over_all_folders_skips_folders_of_parts() {
    let dir = common::in_memory();
    shapes::grid(9).write(dir.path());
    shapes::dumbbell().write(dir.path());
    let (all, parts) = (dir.path().join("**/*.ply"), format!("{}/{{}}.parts/", word(dir.path())));
    let cut = |pattern: &Path, words: &[&str]| {
        errors(&run(&[&["segment", word(pattern), "-k", "2"], words].concat())).lines().next_back().unwrap().to_string()
    };
    assert!(cut(&all, &["-o", &parts]).starts_with("2 meshes: 2 done"));
    assert!(cut(&all, &["-o", &parts, "--resume"]).starts_with("2 meshes: 0 done, 0 failed, 2 skipped"));
    // Parts can be cut like any mesh.
    let again = dir.path().join("{}.seg");
    assert!(cut(&dir.path().join("grid.parts/*.ply"), &["-o", word(&again)]).starts_with("2 meshes: 2 done"));
}

#[test]
fn patterns_and_events() {
    let (dir, meshes) = folder();
    let (pattern, out) = (meshes.join("[dm]*.ply"), dir.path().join("{}.npy"));
    let output = ok(&["segment", word(&pattern), "-o", word(&out), "-k", "2", "--progress", "json"]);
    assert_eq!(names(dir.path()), ["dumbbell.npy", "grid.ply", "meshes", "moebius.npy"]);
    let events = lines(&output.stderr);
    let meshes_done = events.iter().filter(|event| event["stage"] == "meshes");
    assert_eq!(meshes_done.map(|event| event["done"].as_u64().unwrap()).collect::<Vec<_>>(), [1, 2]);
    assert!(events.iter().any(|event| event["mesh"].as_str().is_some_and(|mesh| mesh.ends_with("dumbbell.ply"))));
}

#[test]
fn what_makes_no_sense_is_refused_before_any_work() {
    let (dir, meshes) = folder();
    let (grid, dumbbell) = (meshes.join("grid.ply"), meshes.join("dumbbell.ply"));
    let other = dir.path().join("grid.ply");
    let (grid, dumbbell, other, folder) = (word(&grid), word(&dumbbell), word(&other), word(&meshes));
    for (words, told) in [
        (&["segment", grid, dumbbell, "-o", "x.ply"][..], "write {} for the name of the mesh"),
        (&["segment", folder, "-o", "x.ply"], "write {} for the name of the mesh"),
        (&["segment", grid, other, "-o", "{}.seg"], "would both be written to grid.seg"),
        (&["segment", grid, "-o", "x.seg", "-o", "x.seg"], "-o x.seg: given more than once"),
        (&["segment", grid, "-o", "-", "-o", "-"], "-o -: given more than once"),
        (
            &["segment", grid, "-o", "x.seg", "--names", "x.tsv"],
            "--names requires --json or an output that holds names",
        ),
        (&["segment", grid, "--measure"], "--measure requires --json"),
        (&["quality", grid, "--plot", "x.svg"], "--plot requires --compare"),
        (&["plot", folder], "give --eigenvalues FILE, --tree FILE, or both"),
        (&["export", "--work-dir", folder], "give -o OUT, --tree FILE, or both"),
        (&["info", folder, "--header"], "--header requires a mesh"),
        (&["segment", "-", "--jobs", "2"], "standard input is a single mesh"),
        (&["segment", folder, "--work-dir", "w"], "--work-dir can only be used with a single mesh"),
        (&["segment", folder, "-"], "standard input is a single mesh"),
        (&["segment", folder, "--json", "--json-lines"], "cannot both go to standard output"),
    ] {
        refused(words, 2, told);
    }
    for (word, told) in [("none*.ply", "matches no file"), (word(&dir.path().join("empty")), "holds no mesh")] {
        let _ = std::fs::create_dir(dir.path().join("empty"));
        refused(&["segment", word], 1, told);
    }
    assert!(!names(&meshes).contains(&"grid.segmented.ply".to_string()));
}

#[cfg(unix)]
#[test]
fn an_interrupt_says_how_to_go_on() {
    use std::io::{BufRead, BufReader};
    use std::os::unix::process::ExitStatusExt;
    if common::interrupts_are_ignored() {
        return;
    }
    let dir = common::in_memory();
    let meshes = [40_000, 50_000].map(|faces| common::creature(dir.path(), faces, false));
    let mut child = program()
        .args(["segment", word(&meshes[0]), word(&meshes[1]), "-l", "2000", "--threads", "1"])
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.next().unwrap().starts_with("mesh "));
    let id = child.id().to_string();
    assert!(std::process::Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let told: Vec<String> = lines.collect();
    assert_eq!(child.wait().unwrap().signal(), Some(2), "{told:?}");
    let how = "nystrom-stream: interrupted; with --resume the same command continues with the rest";
    assert_eq!(told, [how]);
    assert_eq!(names(dir.path()), ["creature_40000.ply", "creature_50000.ply"]);
}

/// Regression: a report, a table or a map in the place of the mesh overwrote it, and one of two outputs of one name was lost.
#[test]
fn nothing_is_written_over_an_input_or_another_output() {
    let (dir, meshes) = folder();
    let (mesh, work) = (meshes.join("grid.ply"), dir.path().join("work"));
    let before = std::fs::read(&mesh).unwrap();
    let (mesh, work) = (word(&mesh), word(&work));
    let labels = dir.path().join("x.seg");
    common::segment(Path::new(mesh), &["-q", "--work-dir", work, "-o", word(&labels)]);
    let json = &format!("--json={mesh}")[..];
    let (x, lines) = (word(&labels), format!("--json-lines={mesh}"));
    for words in [
        &["segment", mesh, "-o", x, json][..],
        &["segment", word(&meshes), "-o", "{}.seg", &lines],
        &["sequence", mesh, "-o", mesh],
        &["quality", mesh, "--csv", mesh],
        &["plan", mesh, json],
        &["info", mesh, json],
        &["graph", mesh, "--work-dir", work, json],
        &["rows", mesh, "--work-dir", work, json],
        &["cluster", "--work-dir", work, json],
        &["export", "--work-dir", work, "-o", mesh],
        &["export", "--work-dir", work, "--tree", mesh],
        &["correspond", mesh, mesh, "--carry", "label", "--carried", mesh],
        &["transfer-labels", mesh, mesh, "--labels", x, "-o", x],
        &["evaluate", x, "--truth", x, &format!("--json={x}")],
        &["picture", mesh, "-o", mesh],
    ] {
        let output = run(words);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {}", errors(&output));
        assert!(std::fs::read(mesh).unwrap() == before, "{words:?}");
    }
    refused(&["segment", mesh, "-o", x, &format!("--json={x}")], 2, "two outputs cannot have the same name");
    // Regression: a report took the place of the materials that an OBJ comes with.
    let [obj, materials] = ["x.obj", "x.mtl"].map(|name| dir.path().join(name));
    for report in [&materials, &dir.path().join("x.obj.partial")] {
        let output = run(&["segment", mesh, "-o", word(&obj), &format!("--json={}", word(report))]);
        let told = format!("{} is written with it, and is another output", word(report));
        assert!(output.status.code() == Some(2) && errors(&output).contains(&told), "{}", errors(&output));
    }
    // Regression: the report was refused too where no materials come with the OBJ, since it has its own.
    let own = dir.path().join("own.obj");
    std::fs::write(&own, "mtllib own.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl skin\nf 1 2 3\n").unwrap();
    let report = format!("--json={}", word(&materials));
    ok(&["segment", word(&own), "-q", "-k", "1", "-o", word(&obj), &report]);
    assert!(std::fs::read_to_string(&materials).unwrap().starts_with('{'));
    assert!(std::fs::read_to_string(&obj).unwrap().contains("usemtl skin"));
    [&obj, &materials].into_iter().for_each(|file| std::fs::remove_file(file).unwrap());
    // Regression: `picture scan.obj` drew over a texture of the scan.
    let [scan, texture, skin] = ["scan.obj", "scan.png", "my skin.png"].map(|name| dir.path().join(name));
    let text = "mtllib scan.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl skin\nf 1 2 3\n";
    std::fs::write(&scan, text).unwrap();
    let library = scan.with_extension("mtl");
    std::fs::write(&library, "newmtl skin\nmap_Kd scan.png\nmap_Bump -bm 0.5 my skin.png\n").unwrap();
    let json = format!("--json={}", word(&library));
    for (file, words) in [
        (&texture, &["picture", word(&scan)][..]),
        (&skin, &["picture", word(&scan), "-o", word(&skin)]),
        (&library, &["info", word(&scan), &json]),
    ] {
        if file != &library {
            std::fs::write(file, "pixels").unwrap();
        }
        let before = std::fs::read(file).unwrap();
        refused(words, 2, "a texture of an input");
        assert_eq!(std::fs::read(file).unwrap(), before);
        std::fs::remove_file(file).unwrap();
    }
    // A file of another program is not overwritten by materials, which get another name.
    std::fs::write(&materials, "newmtl skin\n").unwrap();
    common::segment(Path::new(mesh), &["-q", "-o", word(&obj), &format!("--json={}", word(&materials))]);
    assert!(std::fs::read_to_string(dir.path().join("x.parts.mtl")).unwrap().contains("newmtl part_0"));
}
