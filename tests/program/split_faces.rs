//! Faces split along smooth boundaries, through the program.

use crate::common::{self, errors, ok, word};
use nystrom_stream::base::vector::distance;
use nystrom_stream::mesh::Mesh;
use nystrom_stream::store::Run;
use std::collections::BTreeMap;
use std::path::Path;

/// The faces of each edge, by its ends.
fn sides(mesh: &Mesh) -> BTreeMap<[u32; 2], Vec<usize>> {
    let mut all: BTreeMap<_, Vec<usize>> = BTreeMap::new();
    mesh.faces.for_each(0..mesh.faces.len(), |face, corners| {
        for (k, &a) in corners.iter().enumerate() {
            let b = corners[(k + 1) % corners.len()];
            all.entry([a.min(b), a.max(b)]).or_default().push(face);
        }
    });
    all
}

/// Faces per edge: how many edges have one, two, more.
fn census(mesh: &Mesh) -> [usize; 3] {
    let mut count = [0; 3];
    sides(mesh).values().for_each(|faces| count[faces.len().min(3) - 1] += 1);
    count
}

fn boundary_length(mesh: &Mesh) -> f64 {
    let labels = mesh.face_property("label", &Run::new(&())).unwrap();
    let apart = |(_, faces): &(&[u32; 2], &Vec<usize>)| faces.iter().any(|&face| labels[face] != labels[faces[0]]);
    let length = |([a, b], _): (&[u32; 2], &Vec<usize>)| distance(mesh.positions.get(*a), mesh.positions.get(*b));
    sides(mesh).iter().filter(apart).map(length).sum()
}

fn area(mesh: &Mesh) -> f64 {
    let mut sum = 0.;
    mesh.faces.for_each(0..mesh.faces.len(), |_, corners| {
        use nystrom_stream::base::vector::{double_area, length};
        mesh.triangles(corners, |_, at| sum += 0.5 * length(double_area(at)));
    });
    sum
}

/// Segments `mesh` with and without; checks what must hold of any mesh, and gives how long boundaries are that were 1.
fn shortened(mesh: &Path, folder: &Path, words: &[&str]) -> f64 {
    let [plain, split] = ["plain.ply", "split.ply"].map(|name| folder.join(name));
    common::segment(mesh, &[&["-q", "-o", word(&plain)], words].concat());
    common::segment(mesh, &[&["-q", "--split-faces", "-o", word(&split)], words].concat());
    let [a, b] = [&plain, &split].map(|path| Mesh::open(path).unwrap());
    assert!(b.positions.len() > a.positions.len() && b.faces.len() > a.faces.len());
    for v in 0..a.positions.len() as u32 {
        assert_eq!(a.positions.get(v), b.positions.get(v), "vertices keep their numbers");
    }
    let run = Run::new(&());
    let [mut before, mut after] = [&a, &b].map(|mesh| mesh.face_property("label", &run).unwrap());
    let other = before.iter().zip(&after).filter(|(a, b)| a != b).count();
    assert!(other < before.len() / 20, "{other} faces have another label");
    for labels in [&mut before, &mut after] {
        labels.sort_unstable();
        labels.dedup();
    }
    assert_eq!(before, after, "no part is lost");
    let ([open, _, more], [still_open, _, still_more]) = (census(&a), census(&b));
    assert_eq!((open, more), (still_open, still_more), "what was closed stays so, and borders are not cut");
    assert!((area(&a) - area(&b)).abs() < 1e-6 * area(&a));
    boundary_length(&b) / boundary_length(&a)
}

#[test]
fn boundaries_cross_faces_on_request() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 5_000, false);
    let ratio = shortened(&mesh, dir.path(), &["-k", "6"]);
    assert!(ratio < 0.98, "{ratio}");
    // The same bytes whatever the threads, from a work directory, in a stream, and in a batch.
    let split = std::fs::read(dir.path().join("split.ply")).unwrap();
    let (work, labels) = (dir.path().join("work"), dir.path().join("x.npy"));
    let again = dir.path().join("again.ply");
    let words = ["-q", "-k", "6", "--threads", "1", "--work-dir", word(&work), "-o", word(&labels)];
    common::segment(&mesh, &words);
    ok(&["export", "-q", "--work-dir", word(&work), "--split-faces", "-o", word(&again)]);
    assert_eq!(std::fs::read(&again).unwrap(), split);
    let streamed = common::run(&["export", "-q", "--work-dir", word(&work), "--split-faces", "-o", "-"]);
    assert_eq!(streamed.stdout, split);
}

/// Scans with noise, borders and seams, if they are there.
#[test]
fn so_do_those_of_real_meshes() {
    let Some(data) = common::data() else { return };
    let dir = common::in_memory();
    for (name, most) in
        [("real/horse_4k.ply", 0.97), ("real/kitten_25k.ply", 0.95), ("flavour/meshlab_bunny10k_flags.ply", 0.97)]
    {
        let ratio = shortened(&data.join(name), dir.path(), &[]);
        assert!(ratio < most, "{name}: {ratio}");
    }
}

#[test]
fn what_keeps_the_faces_of_the_input_is_refused() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 1_000, false);
    let out = |name: &str| dir.path().join(name).display().to_string();
    for (words, part) in [
        (vec!["-o".to_string(), out("x.obj")], "--split-faces requires a .ply output"),
        (vec!["-o".into(), out("parts/")], "--split-faces requires a .ply output"),
        (vec!["-o".into(), out("x.ply"), "--vertex-labels".into()], "cannot be used with"),
        (vec!["-o".into(), out("x.ply"), "--split-vertices".into()], "cannot be used with"),
    ] {
        let output = common::program().arg("segment").arg(&mesh).arg("--split-faces").args(&words).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        assert!(errors(&output).contains(part), "{}", errors(&output));
    }
    // Beside a .ply, other outputs have the faces of the input.
    let labels = dir.path().join("x.seg");
    common::segment(&mesh, &["-q", "--split-faces", "-o", &out("x.ply"), "-o", word(&labels)]);
    let lines = std::fs::read_to_string(&labels).unwrap().lines().count();
    assert_eq!(lines, Mesh::open(&mesh).unwrap().faces.len());
}

/// Squares stay whole, and the user is told so.
#[test]
fn faces_of_four_corners_are_told() {
    let dir = common::in_memory();
    let (mesh, n) = (dir.path().join("bend.off"), 40i32);
    let mut text = format!("OFF\n{} {} 0\n", (n + 1) * (n + 1), n * n);
    for k in 0..(n + 1) * (n + 1) {
        let (x, y) = (k % (n + 1), k / (n + 1));
        text += &format!("{x} {y} {}\n", (x + y - n).abs());
    }
    for k in 0..n * n {
        let a = k % n + (n + 1) * (k / n);
        text += &format!("4 {a} {} {} {}\n", a + 1, a + n + 2, a + n + 1);
    }
    std::fs::write(&mesh, text).unwrap();
    let out = dir.path().join("x.ply");
    let output = common::segment(&mesh, &["-k", "2", "--split-faces", "-o", word(&out)]);
    assert!(errors(&output).contains("left whole, since only triangles are split"), "{}", errors(&output));
    assert_eq!(Mesh::open(&out).unwrap().faces.len(), (n * n) as usize);
}

/// A solid like the letter T: its outline on both ends in triangles that reach from the foot to the top, or as one
/// polygon.
fn letter(path: &Path, polygons: bool) {
    let outline: [[u32; 2]; 9] = [[4, 0], [6, 0], [6, 8], [10, 8], [10, 10], [5, 10], [0, 10], [0, 8], [4, 8]];
    let n = outline.len();
    let mut faces: Vec<Vec<usize>> = if polygons {
        vec![(n..2 * n).collect(), (0..n).rev().collect()]
    } else {
        let front = [[0, 1, 5], [1, 2, 5], [2, 3, 4], [2, 4, 5], [0, 5, 8], [5, 6, 8], [6, 7, 8]];
        front.into_iter().flat_map(|[a, b, c]| [vec![a + n, b + n, c + n], vec![c, b, a]]).collect()
    };
    for (a, b) in (0..n).map(|a| (a, (a + 1) % n)) {
        let sides =
            if polygons { vec![vec![a, b, b + n, a + n]] } else { vec![vec![a, b, b + n], vec![a, b + n, a + n]] };
        faces.extend(sides);
    }
    let mut text = format!("OFF\n{} {} 0\n", 2 * n, faces.len());
    for z in ["0", "1.5"] {
        outline.iter().for_each(|[x, y]| text += &format!("{x} {y} {z}\n"));
    }
    for face in faces {
        text += &face.iter().fold(face.len().to_string(), |line, v| format!("{line} {v}"));
        text += "\n";
    }
    std::fs::write(path, text).unwrap();
}

/// Regression: a boundary did not cross the triangles of a mesh whose parts are decided on shorter ones.
#[test]
fn boundaries_cross_long_triangles() {
    let dir = common::in_memory();
    let place = |name: &str| dir.path().join(name);
    for polygons in [false, true] {
        let mesh = place("letter.off");
        letter(&mesh, polygons);
        let [plain, split, work] = ["plain.ply", "split.ply", "work"].map(place);
        let _ = std::fs::remove_dir_all(&work);
        common::segment(&mesh, &["-q", "-k", "2", "-o", word(&plain), "--work-dir", word(&work)]);
        common::segment(&mesh, &["-q", "-k", "2", "--threads", "1", "--split-faces", "-o", word(&split)]);
        let [a, b] = [&plain, &split].map(|path| Mesh::open(path).unwrap());
        for v in 0..a.positions.len() as u32 {
            assert_eq!(a.positions.get(v), b.positions.get(v), "vertices keep their numbers");
        }
        assert_eq!((census(&b)[0], census(&b)[2]), (0, 0), "it stays closed");
        assert!((area(&a) - area(&b)).abs() < 1e-6 * area(&a));
        // Along edges of the file it was 75 long, and 39 on polygons.
        assert!(boundary_length(&b) < 20., "{}", boundary_length(&b));
        assert!(b.faces.len() < 150, "{}", b.faces.len());
        // The same from the work directory, also after another cut, and in another order of faces.
        let bytes = std::fs::read(&split).unwrap();
        let export = || {
            ok(&["export", "-q", "--work-dir", word(&work), "--split-faces", "-o", word(&plain)]);
            std::fs::read(&plain).unwrap()
        };
        assert_eq!(export(), bytes);
        ok(&["cluster", "-q", "--work-dir", word(&work), "-k", "3"]);
        assert_ne!(export(), bytes);
        ok(&["cluster", "-q", "--work-dir", word(&work), "-k", "2"]);
        assert_eq!(export(), bytes);
        common::segment(&mesh, &["-q", "-k", "2", "--order", "hilbert", "--split-faces", "-o", word(&plain)]);
        let other = Mesh::open(&plain).unwrap();
        assert_eq!((census(&other)[0], census(&other)[2]), (0, 0));
        assert!(boundary_length(&other) < 20., "{}", boundary_length(&other));
    }
}
