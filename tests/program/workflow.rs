//! Scripts of the workflow, which need no Snakemake here: `tools/check-workflow` runs them in it.

use crate::common::{self, errors, shapes};
use std::path::Path;
use std::process::{Command, Output};

/// Runs a script with the object that Snakemake gives it.
const CALL: &str = r#"
import runpy, sys
from types import SimpleNamespace as Has
script, program, *names = sys.argv[1:]
has = Has(
    log=["log"], threads=1, wildcards=Has(batch="0000"),
    output=Has(faces="faces/batch=0000", meshes="0000.jsonl"),
    params=Has(program=program, names=names, meshes=[name + ".ply" for name in names], options="-k 2", max_memory="1GiB"),
)
runpy.run_path(script, init_globals={"snakemake": has})
"#;

/// Whether Python can be run; tells that the test is skipped if not.
fn python_is_there() -> bool {
    let is_there = Command::new("python3").arg("-V").output().is_ok_and(|output| output.status.success());
    if !is_there {
        eprintln!("skipped: python3 is not there");
    }
    is_there
}

/// Runs the script of a batch in `folder` with `program`.
fn batch(folder: &Path, program: &str, names: &[&str]) -> Output {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/workflow/scripts/batch.py");
    Command::new("python3").current_dir(folder).args(["-c", CALL, script, program]).args(names).output().unwrap()
}

/// Regression: on a full disk every mesh went to the list of failures, and the batch counted as done.
#[cfg(unix)]
#[test]
fn a_batch_fails_where_its_folder_fails_and_goes_on_where_a_mesh_does() {
    use std::os::unix::fs::PermissionsExt;
    if !python_is_there() {
        return;
    }
    let dir = common::in_memory();
    shapes::grid(9).write(dir.path());
    std::fs::write(dir.path().join("torn.ply"), "ply\n").unwrap();
    let (program, full) = (env!("CARGO_BIN_EXE_nystrom-stream"), dir.path().join("full"));
    for limit in [0, 4] {
        std::fs::write(&full, format!("#!/bin/sh\nulimit -f {limit}\nexec '{program}' \"$@\"\n")).unwrap();
        std::fs::set_permissions(&full, std::fs::Permissions::from_mode(0o755)).unwrap();
        let output = batch(dir.path(), "./full", &["torn", "grid"]);
        assert!(!output.status.success() && errors(&output).contains("(os error"), "{}", errors(&output));
        assert!(!dir.path().join("0000.jsonl").exists());
    }
    let output = batch(dir.path(), program, &["torn", "grid", "gone"]);
    assert!(output.status.success(), "{}", errors(&output));
    let told = std::fs::read_to_string(dir.path().join("0000.jsonl")).unwrap();
    let told: Vec<serde_json::Value> = told.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let failed: Vec<bool> = told.iter().map(|line| line["error"].is_string()).collect();
    assert_eq!(failed, [true, false, true]);
    assert!(dir.path().join("faces/batch=0000/mesh=grid/part-0.parquet").exists());
}

/// Regression: readers found no mesh in `mesh=a=b`, and missed `mesh=a/b` without an error.
#[test]
fn names_of_partitions_are_escaped_as_by_hive() {
    if !python_is_there() {
        return;
    }
    let dir = common::in_memory();
    shapes::grid(9).write(dir.path());
    std::fs::create_dir(dir.path().join("a")).unwrap();
    let names = ["a=1", "a/b", "100% ü", "a%20b"];
    for name in names {
        std::fs::copy(dir.path().join("grid.ply"), dir.path().join(format!("{name}.ply"))).unwrap();
    }
    let output = batch(dir.path(), env!("CARGO_BIN_EXE_nystrom-stream"), &names);
    assert!(output.status.success(), "{}", errors(&output));
    for escaped in ["a%3D1", "a%2Fb", "100%25 ü", "a%2520b"] {
        let file = dir.path().join(format!("faces/batch=0000/mesh={escaped}/part-0.parquet"));
        assert!(file.exists(), "{}", file.display());
    }
}
