//! Outputs in other programs' forms: read back here, and opened with the programs themselves where those are there.

use crate::common::{self, errors, ok, refused, word};
use crate::stages::tiny;
use nystrom_stream::mesh::{self, Mesh};
use nystrom_stream::store::Run;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

fn run() -> Run<'static> {
    Run { threads: 2, ..Run::new(&()) }
}

fn open(path: &Path) -> Mesh {
    let scratch = path.parent().unwrap().join("scratch");
    std::fs::create_dir_all(&scratch).unwrap();
    mesh::open(path, &scratch, &run()).unwrap()
}

fn property(path: &Path, name: &str) -> Vec<u32> {
    open(path).face_property(name, &run()).unwrap()
}

fn faces(mesh: &Mesh) -> Vec<Vec<[f64; 3]>> {
    let mut all = Vec::new();
    let places = |corners: &[u32]| corners.iter().map(|&v| mesh.positions.get(v)).collect();
    mesh.faces.for_each(0..mesh.faces.len(), |_, corners| all.push(places(corners)));
    all
}

/// Whether python has `modules`; a failure where the variable `required` is set and it has not.
pub fn has_python(modules: &str, required: &str) -> bool {
    let found = Command::new("python3").args(["-c", &format!("import {modules}")]).output();
    let found = found.is_ok_and(|output| output.status.success());
    assert!(found || std::env::var_os(required).is_none(), "no python3 with {modules}");
    if !found {
        eprintln!("skipped: python3 with {modules} is not there");
    }
    found
}

/// A script of `tools` on `words`, which must succeed.
pub fn tool(name: &str, words: &[&Path]) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools").join(name);
    let output = Command::new("python3").arg(script).args(words).output().unwrap();
    let told = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{name} {words:?}: {told}{}", errors(&output));
    eprint!("{told}");
}

#[test]
fn every_form_opens_in_the_programs_people_use() {
    let modules = "numpy, plyfile, trimesh, pyarrow, pygltflib, pymeshlab";
    if !has_python(modules, "NYSTROM_STREAM_REQUIRE_FORMATS") {
        return;
    }
    let dir = common::in_memory();
    // Enough for two row groups, and a real mesh.
    let mut meshes = vec![common::creature(dir.path(), 270_000, false)];
    meshes.extend(common::data().map(|data| data.join("real/kitten_25k.ply")));
    for (k, mesh) in meshes.iter().enumerate() {
        let folder = dir.path().join(format!("out{k}"));
        std::fs::create_dir(&folder).unwrap();
        let work = folder.join("work");
        let mut words = vec!["-q", "-k", "6", "--vertex-labels", "--embedding-columns", "--work-dir", word(&work)];
        let names = ["out.npy", "out.seg", "out.ply", "out.parquet", "out.glb", "parts/"];
        let outputs: Vec<String> = names.iter().map(|name| format!("{}/{name}", folder.display())).collect();
        outputs.iter().for_each(|output| words.extend(["-o", output]));
        common::segment(mesh, &words);
        let ascii = folder.join("ascii.ply");
        let words = ["export", "-q", "--work-dir", word(&work), "--ply-form", "ascii", "-o", word(&ascii)];
        ok(&words);
        tool("check_formats.py", &[mesh, &folder, Path::new("10")]);
    }
}

/// What docs/formats.md says of each program, in the program itself; those that are not there are named. Blender as a module
/// (`bpy`) may need a Python of its own, which `NYSTROM_STREAM_BLENDER_PYTHON` names.
#[test]
fn parts_arrive_in_other_programs_as_the_page_on_formats_says() {
    let dir = common::in_memory();
    let Some(data) = common::data() else { return };
    let file = |name: &str| dir.path().join(name).to_str().unwrap().to_string();
    let work = file("work");
    let names = ["plain.ply", "out.npy", "out.glb", "out.parquet", "out.csv", "out.obj"].map(&file);
    let mut words = vec!["-q", "--work-dir", &work];
    names.iter().for_each(|name| words.extend(["-o", name]));
    common::segment(&data.join("real/kitten_25k.ply"), &words);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/check_programs.py");
    let export = |way: &str| {
        ok(&["export", "-q", "--work-dir", &work, way, "-o", &file("out.ply")]);
    };
    export("--split-vertices");
    let meshes = ["blender", "cloudcompare", "open3d", "pyvista", "trimesh"];
    for (k, program) in meshes.into_iter().chain(meshes).chain(["duckdb", "polars"]).enumerate() {
        if k == meshes.len() {
            export("--vertex-labels");
        }
        let python = match std::env::var("NYSTROM_STREAM_BLENDER_PYTHON") {
            Ok(python) if program == "blender" => python,
            _ => "python3".into(),
        };
        let output = Command::new(python).arg(&script).args([program, word(dir.path())]).output().unwrap();
        let told = String::from_utf8_lossy(&output.stdout).into_owned() + &errors(&output);
        match output.status.code() {
            Some(0) => eprint!("{told}"),
            Some(3) => eprintln!("skipped: {}", told.trim_end()),
            _ => panic!("{program}: {told}"),
        }
        let required = std::env::var("NYSTROM_STREAM_REQUIRE_PROGRAMS").unwrap_or_default();
        let is_required = required.split(' ').any(|name| name == program);
        assert!(!is_required || output.status.success(), "{program} is required: {told}");
    }
}

/// Flat sides stay flat in a scene: normals of vertices would round a box.
#[test]
fn a_scene_has_normals_where_the_surface_is_smooth() {
    let dir = common::in_memory();
    let cube = dir.path().join("cube.off");
    std::fs::write(
        &cube,
        "OFF\n8 6 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n\
         4 0 3 2 1\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n",
    )
    .unwrap();
    let creature = common::creature(dir.path(), 5_000, false);
    for (mesh, smooth) in [(&cube, false), (&creature, true)] {
        let scene = dir.path().join("x.glb");
        common::segment(mesh, &["-q", "-k", "2", "-o", word(&scene)]);
        let bytes = std::fs::read(&scene).unwrap();
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let json: serde_json::Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        assert_eq!(json["meshes"][0]["primitives"][0]["attributes"].get("NORMAL").is_some(), smooth);
        let nodes = json["nodes"].as_array().unwrap();
        assert_eq!((nodes.len(), &nodes[0]["children"]), (3, &serde_json::json!([1, 2])));
        assert_eq!((&nodes[2]["name"], &nodes[2]["extras"]["label"]), (&"part 1".into(), &1.into()));
        let areas: f64 = (1..3).map(|node| nodes[node]["extras"]["area"].as_f64().unwrap()).sum();
        assert!(smooth || (areas - 6.).abs() < 1e-6, "{areas}");
    }
}

#[test]
fn matches_open_in_pyarrow() {
    if !has_python("numpy, pyarrow", "NYSTROM_STREAM_REQUIRE_FORMATS") {
        return;
    }
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 3_000, false);
    let [table, array] = ["m.parquet", "m.npy"].map(|name| dir.path().join(name));
    // Mutual, so that some have none.
    let words =
        ["correspond", "-q", word(&mesh), word(&mesh), "-l", "9", "--mutual", "-o", word(&table), "-o", word(&array)];
    ok(&words);
    let script = "import sys, numpy, pyarrow.parquet\n\
                  table = pyarrow.parquet.read_table(sys.argv[1])\n\
                  array = numpy.load(sys.argv[2])\n\
                  assert table.column_names == ['vertex', 'match', 'distance', 'confidence'], table.schema\n\
                  assert str(table.schema.field('vertex').type) == 'uint32'\n\
                  assert (table['vertex'].to_numpy() == numpy.arange(len(array))).all()\n\
                  for name in array.dtype.names:\n    assert (table[name].to_numpy() == array[name]).all(), name\n";
    let output = Command::new("python3").args(["-c", script, word(&table), word(&array)]).output().unwrap();
    assert!(output.status.success(), "{}", errors(&output));
}

/// Whether pages can be used in a browser here.
pub fn has_browser() -> bool {
    let required = "NYSTROM_STREAM_REQUIRE_BROWSER";
    let chromium = Command::new("chromium").arg("--version").output().is_ok_and(|output| output.status.success());
    assert!(chromium || std::env::var_os(required).is_none(), "no chromium");
    if !chromium {
        eprintln!("skipped: chromium is not there");
    }
    chromium && has_python("selenium", required)
}

#[test]
fn a_page_of_a_real_mesh_works_in_a_browser() {
    let Some(data) = common::data().filter(|_| has_browser()) else { return };
    let dir = common::in_memory();
    let page = dir.path().join("kitten.html");
    common::segment(&data.join("real/kitten_25k.ply"), &["-q", "-o", word(&page)]);
    tool("check-page", &[&page]);
}

#[test]
fn parts_are_meshes_with_their_faces_and_open_borders() {
    let dir = common::in_memory();
    let quads = "OFF\n8 6 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n\
                 4 0 3 2 1\n4 4 5 6 7\n4 0 1 5 4\n4 1 2 6 5\n4 2 3 7 6\n4 3 0 4 7\n";
    let cube = dir.path().join("cube.off");
    std::fs::write(&cube, quads).unwrap();
    let creature = common::creature(dir.path(), 5_000, true);
    for (k, (path, form)) in [(&cube, "ascii"), (&creature, "binary"), (&creature, "ascii")].into_iter().enumerate() {
        let (folder, seg) = (dir.path().join(format!("parts{k}/")), dir.path().join("all.seg"));
        let with_slash = format!("{}/", folder.display());
        common::segment(path, &["-q", "-k", "3", "--ply-form", form, "-o", &with_slash, "-o", word(&seg)]);
        let labels = mesh::read_seg(&seg).unwrap();
        let whole = faces(&open(path));
        let text = std::fs::read_to_string(folder.join("parts.json")).unwrap();
        let list: serde_json::Value = serde_json::from_str(&text).unwrap();
        let mut seen = vec![u32::MAX; labels.len()];
        for part in list["parts"].as_array().unwrap() {
            let file = folder.join(part["file"].as_str().unwrap());
            let opened = open(&file);
            assert_eq!(opened.document().unwrap().is_text(), form == "ascii");
            let (original, label) = (property(&file, "original_face"), property(&file, "label"));
            for ((corners, &face), &label) in faces(&opened).iter().zip(&original).zip(&label) {
                assert!(*corners == whole[face as usize]);
                seen[face as usize] = label;
            }
            assert_eq!(opened.positions.len() as u64, part["vertices"].as_u64().unwrap());
        }
        assert!(seen == labels, "{form}");
        // Again, in fewer parts: the list tells what is of this cut.
        let again = common::segment(path, &["-k", "2", "-o", &with_slash]);
        assert!(errors(&again).contains("parts of an earlier cut"), "{}", errors(&again));
        let text = std::fs::read_to_string(folder.join("parts.json")).unwrap();
        assert_eq!(text.matches("\"file\"").count(), 2);
    }
}

#[test]
fn vertices_get_labels_in_every_encoding_and_only_once() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 3_000, false);
    let vertex_labels = |path: &Path| -> Vec<f64> {
        let text = std::fs::read_to_string(path).unwrap();
        let body = text.split("end_header\n").nth(1).unwrap();
        let count = open(path).positions.len();
        body.lines().take(count).map(|line| line.split(' ').nth(3).unwrap().parse().unwrap()).collect()
    };
    let ply = |name: &str| dir.path().join(name);
    common::segment(&mesh, &["-q", "-k", "4", "--vertex-labels", "-o", word(&ply("a.ply"))]);
    let words = ["-q", "-k", "4", "--vertex-labels", "--ply-form", "ascii", "-o"];
    common::segment(&mesh, &[&words[..], &[word(&ply("b.ply"))]].concat());
    common::segment(&ply("a.ply"), &[&words[..], &[word(&ply("c.ply"))]].concat());
    let (b, c) = (vertex_labels(&ply("b.ply")), vertex_labels(&ply("c.ply")));
    assert!(b == c && b.iter().all(|label| (0. ..4.).contains(label)));
    let text = std::fs::read_to_string(ply("c.ply")).unwrap();
    assert_eq!(text.matches("scalar_label").count(), 1);
    // Every vertex has a label of one of its faces.
    let (labels, opened) = (property(&ply("b.ply"), "label"), open(&ply("b.ply")));
    let mut met = vec![0u32; b.len()];
    opened.faces.for_each(0..labels.len(), |face, corners| {
        corners.iter().for_each(|&v| met[v as usize] |= 1 << labels[face]);
    });
    assert!(met.iter().zip(&b).all(|(met, &label)| met >> label as u32 & 1 == 1));
}

#[test]
fn the_same_run_writes_the_same_bytes() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 20_000, true);
    let write = |threads: &str, memory: &str| -> Vec<Vec<u8>> {
        let files: Vec<PathBuf> = ["x.parquet", "x.glb", "x.ply"].iter().map(|name| dir.path().join(name)).collect();
        let mut words = vec!["-q", "-k", "5", "--vertex-labels", "--threads", threads, "--max-memory", memory];
        files.iter().for_each(|file| words.extend(["-o", word(file)]));
        common::segment(&mesh, &words);
        files.iter().map(|file| std::fs::read(file).unwrap()).collect()
    };
    assert!(write("1", "1GiB") == write("2", "16MiB"));
}

#[test]
fn pages_have_cuts_from_every_command() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 9_000, true);
    let (work, specks, page) = (dir.path().join("work"), dir.path().join("specks"), dir.path().join("x.html"));
    let cuts = || std::fs::read_to_string(&page).unwrap().contains("\"cuts\":{");
    common::segment(&mesh, &["-q", "-k", "4", "--work-dir", word(&work), "-o", word(&page)]);
    assert!(cuts());
    let run = |words: &[&str]| {
        ok(&[words, &["-q", "--work-dir", word(&work), "-o", word(&page)]].concat());
    };
    run(&["cluster", "-k", "5"]);
    assert!(cuts());
    run(&["export"]);
    assert!(cuts());
    // Here there is nothing that could have a label of its own.
    run(&["cluster", "-k", "5", "--tiny-components", "own", "--walls", "own"]);
    assert!(cuts());
    run(&["cluster", "-k", "5", "--cluster", "kmeans"]);
    assert!(!cuts());
    // Regression: after any edit, pages with a label that is no part gave it to other parts, and saved that.
    let (mesh, _) = tiny(dir.path());
    common::segment(&mesh, &["-q", "-k", "3", "--work-dir", word(&specks), "-o", word(&page)]);
    assert!(cuts());
    for (words, expected) in [("own", false), ("join", true)] {
        for words in [&["cluster", "--tiny-components", words][..], &["export"]] {
            ok(&[words, &["-q", "--work-dir", word(&specks), "-o", word(&page)]].concat());
            assert_eq!(cuts(), expected, "{words:?}");
        }
    }
}

#[test]
fn what_makes_no_sense_is_refused_before_any_work() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 1_000, false);
    let out = |name: &str| dir.path().join(name).display().to_string();
    for (words, part) in [
        (vec!["-o".to_string(), out("parts")], "folder with one PLY per part"),
        (vec!["-o".into(), out("x.seg"), "--vertex-labels".into()], "--vertex-labels requires a .ply"),
        (vec!["--embedding-columns".into()], "--embedding-columns requires a .parquet"),
    ] {
        let output = common::program().arg("segment").arg(&mesh).args(&words).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        assert!(errors(&output).contains(part), "{}", errors(&output));
    }
}

/// With vertices of their own, parts keep their colours up to the boundary in programs that know colours of vertices alone.
#[test]
fn parts_can_have_vertices_of_their_own() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 5_000, false);
    let out = |name: &str| dir.path().join(name);
    let (split, plain) = (out("split.ply"), out("plain.ply"));
    let words =
        ["-q", "-k", "6", "--split-vertices", "--names", word(&out("n.tsv")), "-o", word(&split)].map(str::to_owned);
    std::fs::write(out("n.tsv"), "2\tthird\n").unwrap();
    common::segment(&mesh, &words.each_ref().map(String::as_str));
    common::segment(&mesh, &["-q", "-k", "6", "-o", word(&plain)]);
    let run = Run::new(&());
    let (a, b) = (Mesh::open(&split).unwrap(), Mesh::open(&plain).unwrap());
    let labels = a.face_property("label", &run).unwrap();
    assert_eq!(labels, b.face_property("label", &run).unwrap());
    let mut part = vec![u32::MAX; a.positions.len()];
    for face in 0..labels.len() {
        let corners =
            |mesh: &Mesh| mesh.faces.with(face, |c| c.iter().map(|&v| (v, mesh.positions.get(v))).collect::<Vec<_>>());
        for ((v, here), (_, there)) in corners(&a).into_iter().zip(corners(&b)) {
            assert_eq!(here, there);
            assert!(part[v as usize] == u32::MAX || part[v as usize] == labels[face], "vertex {v} is in two parts");
            part[v as usize] = labels[face];
        }
    }
    let more = a.positions.len() - b.positions.len();
    assert!(more > 20 && more < b.positions.len() / 4, "{more} more vertices");
    let bytes = std::fs::read(&split).unwrap();
    let head = String::from_utf8_lossy(&bytes[..900]).into_owned();
    assert!(head.contains("comment part 2: third\n") && head.contains("property float scalar_label\n"), "{head}");
}

/// A cube of six times n × n quads, or twice as many triangles, blown up to a ball.
fn ball(n: i32, triangles: bool) -> String {
    let (mut numbers, mut points, mut faces) = (BTreeMap::new(), String::new(), Vec::new());
    for (axis, side) in (0..3).flat_map(|axis| [(axis, -n), (axis, n)]) {
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (2 * i - n, 2 * j - n))) {
            let mut corners = [[i, j], [i + 2, j], [i + 2, j + 2], [i, j + 2]].map(|[u, v]| {
                let mut at = [side; 3];
                (at[(axis + 1) % 3], at[(axis + 2) % 3]) = (u, v);
                let next = numbers.len();
                *numbers.entry(at).or_insert_with(|| {
                    let length = f64::from(at.iter().map(|x| x * x).sum::<i32>()).sqrt();
                    let [x, y, z] = at.map(|x| f64::from(x) / length);
                    points += &format!("{} {y} {z}\n", 2. * x);
                    next
                })
            });
            if side < 0 {
                corners.reverse();
            }
            let [a, b, c, d] = corners;
            faces.extend(if triangles { vec![vec![a, b, c], vec![a, c, d]] } else { vec![vec![a, b, c, d]] });
        }
    }
    let line =
        |face: &Vec<usize>| face.iter().fold(face.len().to_string(), |line, corner| format!("{line} {corner}")) + "\n";
    let lines: String = faces.iter().map(line).collect();
    format!("OFF\n{} {} 0\n{points}{lines}", numbers.len(), faces.len())
}

/// Parts of a closed mesh that are capped are closed, and their volumes add up to that of the whole.
#[test]
fn capped_parts_are_solids_whose_volumes_add_up() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 5_000, false);
    let measured = |path: &Path| {
        let work = nystrom_stream::store::WorkDir::temporary(dir.path()).unwrap();
        let run = run();
        nystrom_stream::apps::measure::mesh(&open(path), nystrom_stream::store::Context::new(&work, &run)).unwrap()
    };
    let whole = measured(&mesh).all.volume.unwrap();
    for form in ["ply", "stl"] {
        let folder = dir.path().join(format!("{form}/"));
        let out = format!("{}/", folder.display());
        let ascii: &[&str] = if form == "ply" { &["--ply-form", "ascii"] } else { &[] };
        let words = ["-q", "-k", "7", "--cap", "--part-form", form, "-o", &out];
        common::segment(&mesh, &[&words[..], ascii].concat());
        let listed = std::fs::read(folder.join("parts.json")).unwrap();
        let listed: serde_json::Value = serde_json::from_slice(&listed).unwrap();
        let parts = listed["parts"].as_array().unwrap();
        assert_eq!(parts.len(), 7);
        let mut sum = 0.;
        for part in parts {
            let path = folder.join(part["file"].as_str().unwrap());
            let here = measured(&path);
            assert!(part["caps"]["solid"] == true && part["caps"]["loops"].as_u64() > Some(0), "{part}");
            assert_eq!((here.all.open_edges, here.nonmanifold_edges), (0, 0), "{part}");
            let faces = part["faces"].as_u64().unwrap() + part["caps"]["triangles"].as_u64().unwrap();
            assert_eq!(here.all.faces, faces);
            sum += here.all.volume.unwrap();
            if form == "ply" {
                let text = std::fs::read_to_string(&path).unwrap();
                let caps = text.lines().filter(|line| line.split(' ').nth(4) == Some("-1")).count() as u64;
                assert_eq!(Some(caps), part["caps"]["triangles"].as_u64());
            }
        }
        assert!((sum / whole - 1.).abs() < 1e-6, "{form}: {sum} of {whole}");
    }
    // Regression: a chord of a cap could be an edge beside the cut on one side alone, which got a fan there and a plane on the
    // other; and the diagonal of a quad, which an STL file has, so that four triangles met at it.
    let (quads, triangles) = (dir.path().join("quads.off"), dir.path().join("triangles.off"));
    std::fs::write(&quads, ball(8, false)).unwrap();
    std::fs::write(&triangles, ball(5, true)).unwrap();
    for (mesh, form, parts, more) in [
        (&quads, "stl", "8", &[][..]),
        (&triangles, "ply", "2", &["--cluster", "kmeans"]),
        (&triangles, "ply", "2", &["--cluster", "kmeans", "--seed", "1"]),
    ] {
        let (folder, whole) = (tempfile::tempdir().unwrap(), measured(mesh).all.volume.unwrap());
        let out = format!("{}/", folder.path().display());
        let words = ["-q", "-k", parts, "--cap", "--part-form", form, "-o", &out];
        common::segment(mesh, &[&words[..], more].concat());
        let listed = std::fs::read(folder.path().join("parts.json")).unwrap();
        let listed: serde_json::Value = serde_json::from_slice(&listed).unwrap();
        let mut sum = 0.;
        for part in listed["parts"].as_array().unwrap() {
            let here = measured(&folder.path().join(part["file"].as_str().unwrap()));
            let closed = (here.all.open_edges, here.nonmanifold_edges) == (0, 0);
            assert_eq!(part["caps"]["solid"] == true, closed, "{part}");
            sum += here.all.volume.unwrap_or(f64::NAN);
        }
        // Where three parts meet, caps leave something out.
        assert!(parts == "8" || (sum / whole - 1.).abs() < 1e-6, "{more:?}: {sum} of {whole}");
    }
    refused(&["segment", word(&mesh), "--cap", "-o", "x.glb"], 2, "--cap requires a folder of parts");
}
