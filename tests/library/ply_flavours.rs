//! Every PLY flavour opens with the right counts, or is refused in one line.

use crate::common;
use nystrom_stream::base::Error;
use nystrom_stream::mesh::{self, Faces, Mesh};
use nystrom_stream::store::Run;
use std::fmt::Write as _;
use std::path::Path;

fn open(path: &Path, scratch: &Path) -> Result<Mesh, Error> {
    mesh::open(path, scratch, &Run { threads: 2, ..Run::new(&()) })
}

fn faces_of(mesh: &Mesh) -> Vec<Vec<u32>> {
    let mut faces = Vec::new();
    mesh.faces.for_each(0..mesh.faces.len(), |_, corners| faces.push(corners.to_vec()));
    faces
}

/// Columns file, vertices, faces, remark of the list of test meshes.
fn listed() -> Vec<(String, Option<usize>, Option<usize>, String)> {
    let text = std::fs::read_to_string(common::packed().join("MANIFEST.tsv")).unwrap();
    text.lines()
        .skip(1)
        .map(|line| {
            let columns: Vec<&str> = line.split('\t').collect();
            let name = columns[0].trim_end_matches(".xz").to_owned();
            (name, columns[1].parse().ok(), columns[2].parse().ok(), columns.last().unwrap().to_string())
        })
        .filter(|(name, ..)| ["real/", "flavour/", "nasty/"].iter().any(|folder| name.starts_with(folder)))
        .collect()
}

#[test]
fn every_listed_mesh_opens_with_its_counts_or_is_refused() {
    let Some(data) = common::data() else { return };
    let horse_dir = tempfile::tempdir().unwrap();
    let horse = open(&data.join("real/horse_4k.ply"), horse_dir.path()).unwrap();
    let horse_faces = faces_of(&horse);
    let mut wrong = String::new();
    for (name, vertices, faces, remark) in listed() {
        let scratch = tempfile::tempdir().unwrap();
        let opened = open(&data.join(&name), scratch.path());
        let same = remark.contains("should: same") || remark.contains("same geometry");
        let refuse = (vertices.is_none() && !same && !name.contains("tubemesh")) || faces == Some(0);
        match opened {
            Err(error) => {
                let message = error.to_string();
                if !refuse || message.contains('\n') || !message.contains(&name) || message.matches(';').count() < 1 {
                    let _ = writeln!(wrong, "{name}: {message}");
                }
                eprintln!("refused: {message}");
            }
            Ok(_) if refuse => {
                let _ = writeln!(wrong, "{name}: not refused");
            }
            Ok(mesh) => {
                let mut triangles = 0;
                let mut in_range = true;
                mesh.faces.for_each(0..mesh.faces.len(), |_, corners| {
                    triangles += corners.len().saturating_sub(2);
                    in_range &= corners.iter().all(|&corner| (corner as usize) < mesh.positions.len());
                });
                let right = vertices.is_none_or(|vertices| vertices == mesh.positions.len())
                    && faces.is_none_or(|faces| faces == triangles);
                if !right || !in_range {
                    let _ = writeln!(wrong, "{name}: {} vertices, {triangles} triangles", mesh.positions.len());
                }
                if same && faces_of(&mesh) != horse_faces {
                    let _ = writeln!(wrong, "{name}: faces differ");
                }
                if same {
                    let far = (0..horse.positions.len() as u32).find(|&v| {
                        let (a, b) = (mesh.positions.get(v), horse.positions.get(v));
                        (0..3).any(|k| (a[k] - b[k]).abs() > 1e-5 * b[k].abs().max(1.0))
                    });
                    if let Some(v) = far {
                        let _ = writeln!(
                            wrong,
                            "{name}: vertex {v}: {:?} {:?}",
                            mesh.positions.get(v),
                            horse.positions.get(v)
                        );
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn a_stream_opens_like_the_file() {
    let Some(data) = common::data() else { return };
    for name in ["flavour/synth_plain.ply.gz", "flavour/synth_ascii_crlf_tabs.ply", "real/horse_4k.ply"] {
        let scratch = tempfile::tempdir().unwrap();
        let file = std::fs::File::open(data.join(name)).unwrap();
        let run = Run::new(&());
        let opened = mesh::open_reader(file, "<stdin>", &scratch.path().join("input"), &run).unwrap();
        assert_eq!((opened.positions.len(), opened.faces.len()), (2002, 4000), "{name}");
        assert_eq!(opened.path(), Path::new("<stdin>"));
    }
}

#[test]
fn little_endian_triangles_are_used_where_they_lie() {
    let Some(data) = common::data() else { return };
    for name in ["real/horse_4k.ply", "flavour/synth_le_faceprop_before_after.ply", "flavour/synth_le_face_first.ply"] {
        let scratch = tempfile::tempdir().unwrap();
        let opened = open(&data.join(name), scratch.path()).unwrap();
        assert!(matches!(opened.faces, Faces::Triangles { .. }));
        assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), 0, "{name}");
    }
}

fn refusal(content: &[u8]) -> String {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bad.ply");
    std::fs::write(&path, content).unwrap();
    let message = open(&path, dir.path()).expect_err("refused").to_string();
    assert!(!message.contains('\n'), "{message}");
    assert!(message.contains("bad.ply: "), "{message}");
    message.split_once("bad.ply: ").unwrap().1.to_owned()
}

fn header(format: &str, vertices: &str, faces: &str) -> String {
    format!(
        "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\nelement face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
}

#[test]
fn refusals_name_the_place_and_the_remedy() {
    let cube = |vertices: &str, faces: &str, body: &str| header("ascii", vertices, faces) + body;
    let ok = "0 0 0\n1 0 0\n0 1 0\n";
    for (content, start) in [
        (String::new(), "is empty (0 bytes); "),
        ("stone x\n".into(), "header line 1: is \"stone x\", not \"ply\"; "),
        ("solid x\n".into(), "is named as PLY, but its content is STL; "),
        (cube("3", "0", ok), "has no faces; a surface is needed, not a point cloud; "),
        (cube("3", "1", ok) + "3 0 1 3", "face 0: names vertex 3, but there are 3, counted from 0; "),
        (cube("3", "1", ok) + "3 0 1 -1", "face 0: names vertex -1, but there are 3"),
        (
            cube("3", "2", ok) + "3 0 1 2\n3 0 1",
            "face 1: the file ends here, but 2 were declared; the file is cut short",
        ),
        (cube("3", "1", ok) + "3 0 1 two", "face 0: \"two\" is not a number"),
        (cube("3", "1", ok) + "-3 0 1 2", "face 0: a list has -3 items"),
        (cube("4000000000", "1", ok) + "3 0 1 2", "header, element vertex: 4000000000 records need at least"),
        (cube("3", "1000000000", ok) + "3 0 1 2", "header, element face: 1000000000 records need at least"),
        (cube("3", "5000000000", ok), "header, element face: 5000000000 records need at least"),
        (cube("3", "1", "0 0 0 1,5 0 0 0 1 0 3 0 1 2"), "vertex 1: \"1,5\" is not a number"),
        (
            cube("3", "1", ok).replace("vertex_indices", "x").replace("int x", "float x"),
            "header: the face element has no list",
        ),
        (cube("3", "1", ok).replace("float y", "float q"), "header: the vertices have no x, y and z"),
    ] {
        let message = refusal(content.as_bytes());
        assert!(message.starts_with(start), "{message}\nexpected {start}");
    }
    let mut binary = header("binary_little_endian", "18446744073709551615", "1").into_bytes();
    binary.extend([0; 100]);
    assert!(!refusal(&binary).is_empty());
    assert!(refusal(&[0x1f, 0x8b, 8, 0, 1, 2, 3]).contains("cannot be decompressed"));
}

#[test]
fn faces_of_any_size_are_kept_as_nodes() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("odd.ply");
    let body = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n0\n1 2\n2 0 1\n5 0 1 2 1 0\n";
    std::fs::write(&path, header("ascii", "3", "5") + body).unwrap();
    let opened = open(&path, dir.path()).unwrap();
    assert_eq!(faces_of(&opened), [vec![0, 1, 2], vec![], vec![2], vec![0, 1], vec![0, 1, 2, 1, 0]]);
    assert!(opened.notes().is_empty());
}

#[test]
fn trailing_bytes_are_noted() {
    let Some(data) = common::data() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let opened = open(&data.join("flavour/synth_le_trailing_garbage.ply"), scratch.path()).unwrap();
    assert!(opened.notes()[0].ends_with("ignored 1000 bytes after the last element"), "{:?}", opened.notes());
}

#[cfg(unix)]
#[test]
fn a_named_pipe_opens_like_the_file() {
    let Some(data) = common::data() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let pipe = scratch.path().join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let opened = std::thread::scope(|scope| {
        scope.spawn(|| std::fs::copy(data.join("flavour/synth_plain.ply.gz"), &pipe).unwrap());
        open(&pipe, scratch.path()).unwrap()
    });
    assert_eq!(opened.faces.len(), 4000);
}

#[test]
fn a_stop_is_heeded_while_reading() {
    let Some(data) = common::data() else { return };
    for name in ["real/horse_4k.ply", "flavour/synth_ascii_crlf_tabs.ply", "flavour/synth_plain.ply.gz"] {
        let scratch = tempfile::tempdir().unwrap();
        let run = Run::new(&());
        run.cancel.cancel();
        assert!(matches!(mesh::open(&data.join(name), scratch.path(), &run), Err(Error::Cancelled)), "{name}");
    }
}
