//! Meshes that are no PLY: the same labels as of the same mesh as PLY, one line for what is wrong, no panic.

use crate::common;
use nystrom_stream::mesh::{self, Mesh};
use nystrom_stream::store::Run;
use proptest::prelude::*;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

fn run() -> Run<'static> {
    Run { threads: 2, ..Run::new(&()) }
}

fn faces(mesh: &Mesh) -> Vec<Vec<u32>> {
    let mut all = Vec::new();
    mesh.faces.for_each(0..mesh.faces.len(), |_, corners| all.push(corners.to_vec()));
    all
}

fn places(mesh: &Mesh) -> Vec<[f64; 3]> {
    (0..mesh.positions.len() as u32).map(|v| mesh.positions.get(v)).collect()
}

/// The mesh in every form, by ending.
fn all_forms(mesh: &Mesh) -> Vec<(&'static str, Vec<u8>)> {
    let (places, faces) = (places(mesh), faces(mesh));
    let mut obj = "# remark\r\nmtllib a.mtl\no thing\n".to_string();
    let mut off = format!("COFF # colours\n{} {} 0\n\n", places.len(), faces.len());
    for [x, y, z] in &places {
        let _ = write!(obj, "v {x:?} {y:?} {z:?}\nvn 0 0 1\n");
        let _ = writeln!(off, "{x:?} {y:?}\t{z:?} 1 0 0 1");
    }
    for (k, face) in faces.iter().enumerate() {
        let _ = writeln!(off, "{} {} 255 0 0", face.len(), face.iter().map(|v| format!("{v} ")).collect::<String>());
        let word = |v: &u32| match k % 4 {
            0 => format!(" {}", v + 1),
            1 => format!(" {}/7", v + 1),
            2 => format!(" {}//3", v + 1),
            _ => format!(" {}/1/\\\n2", i64::from(*v) - places.len() as i64).replace("/\\\n2", "/2 \\\n"),
        };
        let _ = writeln!(obj, "f{}", face.iter().map(word).collect::<String>());
    }
    let mut text = "solid thing\n".to_string();
    let mut binary = vec![b's'; 80];
    binary.extend((faces.len() as u32).to_le_bytes());
    for face in &faces {
        text += " facet normal 0 0 1\n  outer loop\n";
        binary.extend([0; 12]);
        for &v in face {
            let [x, y, z] = places[v as usize].map(|x| x as f32);
            let _ = writeln!(text, "   VERTEX {x:e} {y:?} {z:?}");
            binary.extend([x, y, z].into_iter().flat_map(f32::to_le_bytes));
        }
        text += "  endloop\n endfacet\n";
        binary.extend([0; 2]);
    }
    text += "endsolid thing\n";
    vec![("obj", obj.into_bytes()), ("off", off.into_bytes()), ("stl", binary), ("text.stl", text.into_bytes())]
}

#[test]
fn labels_are_those_of_the_same_mesh_as_ply() {
    let dir = common::in_memory();
    let ply = common::creature(dir.path(), 6_000, false);
    let opened = mesh::open(&ply, dir.path(), &run()).unwrap();
    let label = |mesh: &Path, out: &str| {
        let out = dir.path().join(out);
        common::segment(mesh, &["-q", "-k", "5", "-o", common::word(&out)]);
        std::fs::read_to_string(out).unwrap()
    };
    let expected = label(&ply, "ply.seg");
    for (ending, bytes) in all_forms(&opened) {
        let path = dir.path().join(format!("mesh.{ending}"));
        std::fs::write(&path, &bytes).unwrap();
        let scratch = common::in_memory();
        let again = mesh::open(&path, scratch.path(), &run()).unwrap();
        if ending.ends_with("stl") {
            let (soup, own) = (places(&again), places(&opened));
            let wanted: Vec<[f64; 3]> = faces(&opened).iter().flatten().map(|&v| own[v as usize]).collect();
            assert!(soup == wanted, "{ending}");
        } else {
            assert!(faces(&again) == faces(&opened) && places(&again) == places(&opened), "{ending}");
        }
        assert!(label(&path, "other.seg") == expected, "{ending}");
        // Compressed, and under a name that says nothing.
        let packed = dir.path().join("packed");
        let mut gz =
            flate2::write::GzEncoder::new(std::fs::File::create(&packed).unwrap(), flate2::Compression::fast());
        gz.write_all(&bytes).unwrap();
        gz.finish().unwrap();
        let again = mesh::open(&packed, scratch.path(), &run()).unwrap();
        assert_eq!(again.faces.len(), opened.faces.len(), "{ending}");
    }
}

#[test]
fn a_labelled_ply_comes_of_any_form() {
    let dir = common::in_memory();
    let path = dir.path().join("box.obj");
    let quads = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1\nv 0 0 1\nv 1 0 1\nf 1 2 6 5\nf 1 5 4\n";
    std::fs::write(&path, quads).unwrap();
    common::segment(&path, &["-q", "-k", "2"]);
    let labelled = mesh::open(&dir.path().join("box.segmented.ply"), dir.path(), &run()).unwrap();
    assert_eq!(faces(&labelled), [vec![0, 1, 2, 3], vec![0, 1, 5, 4], vec![0, 4, 3]]);
    assert_eq!(labelled.face_property("label", &run()).unwrap().len(), 3);

    let many = format!(
        "OFF 300 2 0\n{}300 {}\n3 0 1 2\n",
        "0 1 2\n".repeat(300),
        (0..300).map(|k| format!("{k} ")).collect::<String>()
    );
    std::fs::write(&path, many).unwrap();
    let file = std::fs::File::open(&path).unwrap();
    let opened = mesh::open_reader(file, "<stdin>", &dir.path().join("input"), &run()).unwrap();
    assert_eq!(faces(&opened)[0].len(), 300);
}

#[test]
fn what_is_wrong_is_said_in_one_line_with_its_place() {
    let dir = common::in_memory();
    let mut short = vec![0; 84];
    short[80] = 9;
    let cases: [(&str, &[u8], &str); 23] = [
        ("a.obj", b"v 0 0 0\nv 1 0\nf 1 1 1\n", "line 2: a vertex needs three coordinates"),
        ("a.obj", b"v 0 0 0\n\nv 1 0 x\nf 1 1 1\n", "line 3: \"x\" is not a number"),
        ("a.obj", b"v 0 0 0\nf 1 1 2\n", "line 2: a face names vertex 2, but there are 1"),
        ("a.obj", b"v 0 0 0\nf 1 1 -2\n", "line 2: a face names vertex -2"),
        ("a.obj", b"v 0 0 0\nf 0 1 1\n", "line 2: a face names vertex 0"),
        ("a.obj", b"v 0 0 0\nf a 1 1\n", "line 2: \"a\" is not a vertex's number"),
        ("a.obj", b"v 0 0 0\n", "has no faces"),
        ("a.off", b"OFF\n", "the numbers of vertices and faces are missing"),
        // A line without words was asked for its first.
        ("a.off", b"\\\n1 1 0\n", "the numbers of vertices and faces are missing"),
        ("a.off", b"OFF\n2 1 0\n0 0 0\n", "vertex 1: the file ends here"),
        ("a.off", b"OFF\n1 1 0\n0 0 0\n", "face 0: the file ends here"),
        ("a.off", b"OFF\n1 1 0\n0 0 0\n3 0 0\n", "line 4: a face of 3 corners ends early"),
        ("a.off", b"OFF\n1 1 0\n0 0 0\n3 0 0 1\n", "line 4: a face names vertex 1"),
        ("a.off", b"OFF BINARY\n1 1 0\n", "binary OFF"),
        ("a.off", b"4OFF\n1 1 0\n", "three-dimensional"),
        ("a.stl", b"solid a\nfacet\nouter loop\nvertex 0 0 0\nvertex 0 0 0\nendloop\n", "does not have three vertices"),
        ("a.stl", &short, "byte 80: 9 triangles take 534 bytes"),
        ("scene.glb", b"glTF\x02\0\0\0", "is a glTF file, which is not supported"),
        ("a.fbx", b"; FBX 7.3.0\n", "is a .fbx file, which is not supported; convert it to PLY"),
        // Regression: they were to be converted to PLY, which is then refused, since it has no faces.
        ("a.las", b"LASF", "is a LAS point cloud file, which is not supported; reconstruct a surface"),
        ("a.bin", b"# .PCD v.7\n", "is a PCD point cloud file, which is not supported; reconstruct a surface"),
        ("a.xyz", b"1 2 3\n", "is a .xyz file, which is not supported; reconstruct a surface"),
        ("a.e57", b"ASTM-E57", "is a .e57 file, which is not supported; reconstruct a surface"),
    ];
    for (name, bytes, part) in cases {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let message = mesh::open(&path, dir.path(), &run()).unwrap_err().to_string();
        assert!(message.contains(part) && !message.contains('\n'), "{message}");
        assert!(message.contains(name) && message.contains(';'), "{message}");
    }
}

/// A small mesh in each form.
fn samples() -> Vec<(&'static str, Vec<u8>)> {
    let places = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.5], [0., 1., -1e-3]];
    let mesh = Mesh::from_slices(&places, &[[0u32, 1, 2], [0, 2, 3], [3, 1, 0], [2, 1, 3]]).unwrap();
    all_forms(&mesh)
}

/// Opens the bytes; whatever comes of them is in bounds or said in one line.
fn try_open(ending: &str, bytes: &[u8]) {
    let dir = common::in_memory();
    let path = dir.path().join(format!("x.{ending}"));
    std::fs::write(&path, bytes).unwrap();
    match mesh::open(&path, dir.path(), &run()) {
        Ok(opened) => {
            let vertices = opened.positions.len();
            assert!(vertices <= bytes.len() && faces(&opened).iter().flatten().all(|&v| (v as usize) < vertices));
        }
        Err(error) => assert!(!error.to_string().contains('\n'), "{error}"),
    }
}

#[test]
fn an_obj_is_recognised_by_any_statement() {
    // Regression: `fo`, the older word for `f`, was read in a file named as OBJ only.
    let dir = common::in_memory();
    let path = dir.path().join("mesh");
    std::fs::write(&path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nfo 1 2 3\n").unwrap();
    assert_eq!(faces(&mesh::open(&path, dir.path(), &run()).unwrap()), [[0, 1, 2]]);
}

#[test]
fn every_truncation_is_refused_or_opened() {
    for (ending, sample) in samples() {
        (0..sample.len()).for_each(|len| try_open(ending, &sample[..len]));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_never_panic(
        which in 0usize..4,
        hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        digits in any::<bool>(),
        named in any::<bool>(),
    ) {
        let (ending, mut bytes) = samples().swap_remove(which);
        for (place, value) in hits {
            let at = place.index(bytes.len());
            if !digits {
                bytes[at] = value;
            } else if let Some(digit) = bytes[at..].iter().position(u8::is_ascii_digit) {
                bytes[at + digit] = b'0' + value % 10;
            }
        }
        try_open(if named { ending } else { "bin" }, &bytes);
    }
}
