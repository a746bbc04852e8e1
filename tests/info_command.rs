//! `info` and `plan` of mesh files: what a header promises, and what is said of files without faces.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn program(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_nystrom-stream"));
    command.args(arguments).stdin(Stdio::null()).output().unwrap()
}

fn write(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

const TETRAHEDRON: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty double y\nproperty float z\n\
    element face 4\nproperty list uchar int vertex_indices\nproperty uchar red\nend_header\n\
    0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1 9\n3 0 1 3 9\n3 0 3 2 9\n3 1 2 3 9\n";

#[test]
fn info_of_a_ply_tells_its_header() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = write(dir.path(), "tetrahedron.ply", TETRAHEDRON);
    let output = program(&["info", mesh.to_str().unwrap()]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0));
    for line in ["4 faces, 4 vertices", "PLY, ascii", "vertex  4", "list uchar int", "double", "red"] {
        assert!(text.contains(line), "{line} in {text}");
    }
    let output = program(&["info", "--json", mesh.to_str().unwrap()]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["faces"], 4);
    assert_eq!(json["elements"][0]["properties"][1], serde_json::json!({"name": "y", "type": "double"}));
    assert_eq!(json["bytes"], TETRAHEDRON.len());
}

#[test]
fn info_of_another_format_tells_its_counts() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = write(dir.path(), "square.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n");
    let output = program(&["info", mesh.to_str().unwrap()]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success() && text.contains("1 faces, 4 vertices") && !text.contains("PLY"), "{text}");
}

/// `plan` said "-l: 0 landmarks; choose at least 1" of a point cloud, and ended as if misused.
#[test]
fn a_mesh_without_faces_is_named_as_such() {
    let dir = tempfile::tempdir().unwrap();
    let points = write(
        dir.path(),
        "points.ply",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
         element face 0\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n",
    );
    let objects = write(dir.path(), "points.obj", "v 0 0 0\nv 1 0 0\n");
    for mesh in [&points, &objects] {
        for command in ["plan", "info"] {
            let output = program(&[command, mesh.to_str().unwrap()]);
            let text = String::from_utf8(output.stderr).unwrap();
            assert_eq!(output.status.code(), Some(1), "{command}: {text}");
            assert!(text.contains("has no faces") && text.lines().count() == 1, "{command}: {text}");
        }
    }
}
