//! `info` and `plan` of mesh files: what a header promises, and what is said of files without faces.

use crate::common::{errors, in_memory, json, ok, refused, run, word};
use std::path::{Path, PathBuf};
use std::process::Command;

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
    let dir = in_memory();
    let mesh = write(dir.path(), "tetrahedron.ply", TETRAHEDRON);
    let output = run(&["info", word(&mesh)]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0));
    for line in ["4 faces, 4 vertices", "PLY, ascii", "vertex  4", "list uchar int", "double", "red"] {
        assert!(text.contains(line), "{line} in {text}");
    }
    let output = run(&["info", "--json", word(&mesh)]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["faces"], 4);
    assert_eq!(json["elements"][0]["properties"][1], serde_json::json!({"name": "y", "type": "double"}));
    assert_eq!(json["bytes"], TETRAHEDRON.len());
}

#[test]
fn info_of_another_format_tells_its_counts() {
    let dir = in_memory();
    let mesh = write(dir.path(), "square.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n");
    let output = run(&["info", word(&mesh)]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success() && text.contains("1 face, 4 vertices") && !text.contains("PLY"), "{text}");
}

/// Regression: the slit from the rim of a polygon to the hole in it counted as two open edges, so that this frame had no
/// volume.
#[test]
fn a_slit_in_a_face_is_not_open() {
    let dir = in_memory();
    let square = |low: i32, high: i32, z: i32| {
        format!("v {low} {low} {z}\nv {high} {low} {z}\nv {high} {high} {z}\nv {low} {high} {z}\n")
    };
    let points = [square(0, 3, 0), square(1, 2, 0), square(0, 3, 1), square(1, 2, 1)].concat();
    let caps = "f 9 10 11 12 9 13 16 15 14 13\nf 1 5 6 7 8 5 1 4 3 2\n";
    let outside = "f 1 2 10 9\nf 2 3 11 10\nf 3 4 12 11\nf 4 1 9 12\n";
    let inside = ["f 6 5 13 14\n", "f 7 6 14 15\n", "f 8 7 15 16\n", "f 5 8 16 13\n"];
    let measured = |walls: &[&str]| {
        let mesh = write(dir.path(), "frame.obj", &[&points, caps, outside, &walls.concat()].concat());
        json(&["info", "--json", word(&mesh)])
    };
    let frame = measured(&inside);
    let of = |all: &serde_json::Value, name: &str| all["measures"][name].clone();
    assert_eq!((of(&frame, "open_edges"), of(&frame, "boundary_loops")), (0.into(), 0.into()), "{frame}");
    assert!((of(&frame, "volume").as_f64().unwrap() - 8.).abs() < 1e-12, "{frame}");
    // Without a wall of the hole, its rim is open, and the slits are not.
    let open = measured(&inside[1..]);
    assert_eq!((of(&open, "open_edges"), of(&open, "boundary_loops")), (4.into(), 1.into()), "{open}");
    assert!(of(&open, "volume").is_null(), "{open}");
}

/// Regression: coordinates of very large meshes had hundreds of digits, and those of very small ones were all 0.
#[test]
fn sizes_of_any_magnitude_are_short() {
    let dir = in_memory();
    for (unit, shown) in [("1", "1.0000"), ("1e150", "1.0000e150"), ("1e-200", "1.0000e-200")] {
        let points = format!("v 0 0 0\nv {unit} 0 0\nv 0 {unit} 0\nv 0 0 {unit}\n");
        let mesh = write(dir.path(), "m.obj", &(points + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"));
        let told = String::from_utf8(run(&["info", word(&mesh)]).stdout).unwrap();
        assert!(told.contains(&format!("size          {shown} {shown} {shown}\n")), "{told}");
        let table = dir.path().join("t.csv");
        ok(&["segment", word(&mesh), "-q", "-o", word(&table)]);
        let rows = std::fs::read_to_string(&table).unwrap();
        assert!(told.lines().chain(rows.lines().flat_map(|row| row.split(','))).all(|text| text.len() < 90), "{rows}");
        let greatest = rows.lines().nth(1).unwrap().split(',').nth(7).unwrap();
        assert_eq!(greatest.parse::<f64>().ok(), unit.parse().ok(), "{rows}");
    }
}

/// It said that OFF is no PLY, and to convert it to OFF.
#[test]
fn a_file_under_the_name_of_another_format_is_told_as_such() {
    let dir = in_memory();
    let obj = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n";
    let stl = "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid x\n";
    for (text, ending) in [("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", ".off"), (obj, ".obj"), (stl, ".stl")] {
        let mesh = write(dir.path(), "mesh.ply", text);
        let output = run(&["info", word(&mesh)]);
        let told = errors(&output);
        let is_right =
            told.contains("mesh.ply: is named as PLY") && told.contains(&format!("rename it to end with {ending}"));
        assert!(output.status.code() == Some(1) && is_right && told.lines().count() == 1, "{told}");
        let renamed = dir.path().join(format!("mesh{ending}"));
        std::fs::rename(&mesh, &renamed).unwrap();
        ok(&["info", word(&renamed)]);
    }
}

/// They were counted as larger polygons.
#[test]
fn faces_of_two_corners_are_told() {
    let dir = in_memory();
    let text = TETRAHEDRON.replace("element face 4", "element face 6") + "2 0 1 9\n0 9\n";
    let mesh = write(dir.path(), "m.ply", &text);
    let told = String::from_utf8(run(&["info", word(&mesh)]).stdout).unwrap();
    assert!(told.contains("4 triangles, 2 faces with fewer than three corners\n"), "{told}");
    let json: serde_json::Value = serde_json::from_slice(&run(&["info", "--json", word(&mesh)]).stdout).unwrap();
    let measures = &json["measures"];
    assert_eq!((&measures["incomplete_faces"], &measures["polygons"]), (&2.into(), &0.into()), "{measures}");
}

/// `plan` said "-l: 0 landmarks; choose at least 1" of a point cloud, and ended as if misused.
#[test]
fn a_mesh_without_faces_is_named_as_such() {
    let dir = in_memory();
    let points = write(
        dir.path(),
        "points.ply",
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
         element face 0\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n",
    );
    let objects = write(dir.path(), "points.obj", "v 0 0 0\nv 1 0 0\n");
    for mesh in [&points, &objects] {
        for command in ["plan", "info"] {
            let output = run(&[command, word(mesh)]);
            let text = errors(&output);
            assert_eq!(output.status.code(), Some(1), "{command}: {text}");
            assert!(text.contains("has no faces") && text.lines().count() == 1, "{command}: {text}");
        }
    }
}

/// A file without vertices was then said to be a point cloud, and one whose faces are strips behind an empty element of
/// faces to have none.
#[test]
fn what_else_a_header_lacks_is_told_apart() {
    let dir = in_memory();
    let faces = "element face 1\nproperty list uchar int vertex_indices\n";
    let text = format!("ply\nformat ascii 1.0\n{faces}end_header\n3 0 1 2\n");
    refused(&["plan", word(&write(dir.path(), "faces.ply", &text))], 1, "there is no vertex element");
    let strips = TETRAHEDRON.split("element face").next().unwrap().to_string()
        + "element face 0\nproperty list uchar int vertex_indices\nelement tristrips 1\n\
           property list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n4 0 1 2 3\n";
    let mesh = write(dir.path(), "strips.ply", &strips);
    for command in ["info", "plan"] {
        ok(&[command, word(&mesh)]);
    }
}

/// The one strip of a scan of 268,686 faces was counted as one face: `plan` told of 3 MB and no time.
#[test]
fn strips_are_planned_by_the_faces_that_they_may_hold() {
    let dir = in_memory();
    let vertices = 40_000u32;
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
         element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    .into_bytes();
    for k in 0..vertices {
        let [x, y] = [(k / 2) as f32, (k % 2) as f32];
        bytes.extend([x, y, 0.].iter().flat_map(|number| number.to_le_bytes()));
    }
    bytes.extend((vertices as i32).to_le_bytes());
    bytes.extend((0..vertices).flat_map(u32::to_le_bytes));
    let mesh = dir.path().join("strip.ply");
    std::fs::write(&mesh, bytes).unwrap();
    let output = run(&["plan", word(&mesh), "--json"]);
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(plan["mesh"]["faces"], vertices, "{}", errors(&output));
    let text = String::from_utf8(run(&["info", word(&mesh)]).stdout).unwrap();
    assert!(
        text.contains("at most 40000 faces, 40000 vertices") && text.contains("faces         39998 triangles"),
        "{text}"
    );
}

/// Both make a temporary folder beside the mesh, and were refused in an archive. The folder of a process's open files takes none
/// either, whoever asks.
#[test]
fn a_mesh_in_a_folder_that_takes_no_file_is_told_and_planned() {
    let dir = in_memory();
    let ply = write(dir.path(), "tetrahedron.ply", TETRAHEDRON);
    for command in ["info", "plan"] {
        let words = "exec \"$0\" \"$1\" /proc/self/fd/9 9<\"$2\"";
        let program = env!("CARGO_BIN_EXE_nystrom-stream");
        let output = Command::new("bash").args(["-c", words, program, command, word(&ply)]).output().unwrap();
        assert!(output.status.success(), "{command}: {}", errors(&output));
        assert!(String::from_utf8_lossy(&output.stdout).contains("4 faces"), "{command}");
    }
}

/// What a person asks of a mesh first: is it whole, how large, how many pieces.
#[test]
fn info_measures_a_mesh_of_any_format() {
    let dir = in_memory();
    let ply = write(dir.path(), "tetrahedron.ply", TETRAHEDRON);
    let obj = write(dir.path(), "square.obj", "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nf 1 2 3 4\n");
    let told = |words: &[&str]| {
        let output = ok(words);
        String::from_utf8(output.stdout).unwrap()
    };
    let text = told(&["info", word(&ply)]);
    for line in [
        "faces         4 triangles",
        "size          1.0000 1.0000 1.0000",
        "area          2.36603",
        "volume        0.166667",
        "components    1",
        "open edges    0",
        "non-manifold  0 edges",
        "degenerate    0 faces",
    ] {
        assert!(text.lines().any(|told| told == line), "{line} in {text}");
    }
    let text = told(&["info", word(&obj)]);
    for line in ["OBJ", "faces         1 quad", "open edges    4 in 1 loop", "volume        none: the surface is open"]
    {
        assert!(text.lines().any(|told| told == line), "{line} in {text}");
    }
    assert!(!told(&["info", "--header", word(&obj)]).contains("area"));
    let json: serde_json::Value = serde_json::from_str(&told(&["info", "--json", word(&obj)])).unwrap();
    let measures = &json["measures"];
    assert_eq!((&measures["area"], &measures["boundary_loops"]), (&4.0.into(), &1.into()), "{json}");
    assert_eq!((&measures["box"][1][0], &measures["volume"]), (&2.0.into(), &serde_json::Value::Null), "{json}");
    let piped =
        crate::common::program().args(["info", "-"]).stdin(std::fs::File::open(&obj).unwrap()).output().unwrap();
    assert!(String::from_utf8(piped.stdout).unwrap().contains("area          4.00000"));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2, "nothing is left there");
}

/// Regression: the files of a decoded mesh were neither listed nor counted.
#[test]
fn a_decoded_mesh_is_listed_with_the_files_of_its_work_directory() {
    let dir = in_memory();
    let mesh = write(dir.path(), "tetrahedron.ply", TETRAHEDRON);
    let work = dir.path().join("work");
    ok(&["graph", word(&mesh), "--work-dir", word(&work), "-q"]);
    let text = String::from_utf8(run(&["info", word(&work)]).stdout).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&run(&["info", word(&work), "--json"]).stdout).unwrap();
    let mut total = 0;
    for file in std::fs::read_dir(&work).unwrap().map(Result::unwrap) {
        let (name, bytes) = (file.file_name().into_string().unwrap(), file.metadata().unwrap().len());
        if ["manifest.json", "lock"].contains(&name.as_str()) {
            continue;
        }
        total += bytes;
        assert!(text.contains(&format!("  {name} ")), "{name} in {text}");
        let of_no_stage = ["triangles.npy", "vertices.npy"].contains(&name.as_str());
        assert_eq!(json["other_files"][&name].as_u64(), of_no_stage.then_some(bytes), "{name}");
    }
    assert_eq!(json["other_files"].as_object().unwrap().len(), 2, "{json}");
    assert!(text.contains(&format!("total {total}B ")), "{total} in {text}");
}
