//! `correspond` with what the user knows, what it writes for other programs, and parts.

use super::correspond_cli::{correspond, files, permuted, read};
use crate::common::{errors, every_case, in_memory, ok, refused, shapes, stride, word};
use nystrom_stream::mesh;
use nystrom_stream::store::{Run, npy};
use std::fmt::Write;
use std::path::Path;

/// Mean error of the matches in `out`, as `evaluate` measures it.
fn error(out: &Path, b: &Path, truth: &[u32], dir: &Path) -> serde_json::Value {
    let (map, json) = (dir.join("truth.npy"), dir.join("e.json"));
    npy::write(&map, truth, 1, false).unwrap();
    let json_to = format!("--json={}", json.display());
    let words = ["evaluate", "-q", "--matches", word(out), "--mesh", word(b), "--truth", word(&map), &json_to];
    ok(&words);
    let told: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    told["errors"].clone()
}

#[test]
fn landmarks_by_hand_and_maps_to_begin_with_are_starts() {
    let (dir, a, b) = files();
    let truth = permuted(&a, &b, false);
    let file = |name: &str| dir.path().join(name);
    let (out, again, csv, pairs) = (file("m.npy"), file("n.npy"), file("m.csv"), file("pairs.txt"));
    let opened = mesh::open(&a, dir.path(), &Run::new(&())).unwrap();
    let mut text = String::from("# A, B\n\n");
    for v in (0..truth.len() as u32).step_by(601) {
        // Every other one as points; in B axes are exchanged and three times as long.
        let [x, y, z] = opened.positions.get(v);
        match v % 2 {
            0 => writeln!(text, "{v}, {} # two vertices", truth[v as usize]).unwrap(),
            _ => writeln!(text, "{x} {y} {z}\t{} {} {}", 3. * y, 3. * z, 3. * x).unwrap(),
        }
    }
    std::fs::write(&pairs, text).unwrap();
    correspond(&a, &b, &["-q", "-o", word(&out), "-o", word(&csv), "--landmarks-file", word(&pairs)]);
    assert!(error(&out, &b, &truth, dir.path())["mean"].as_f64().unwrap() < 0.02);
    for map in [&csv, &out].into_iter().step_by(stride(2)) {
        let json = file("r.json");
        let json_to = format!("--json={}", json.display());
        correspond(&a, &b, &["-q", "-o", word(&again), "--initial-map", word(map), &json_to]);
        assert!(error(&again, &b, &truth, dir.path())["mean"].as_f64().unwrap() < 0.02);
        let told: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        assert_eq!(told["refined"][0]["start"], "map");
    }
}

#[test]
fn functions_their_map_and_points_fit_together() {
    let (dir, a, b) = files();
    permuted(&a, &b, false);
    let file = |name: &str| dir.path().join(name);
    let (out, points, map) = (file("m.npy"), file("points.npy"), file("c.npy"));
    let (of_a, of_b) = (file("fa.npy"), file("fb.npy"));
    for refine in ["nystrom", "laplacian"] {
        let words = ["-q", "--refine", refine, "-o", word(&out), "--points", word(&points)];
        let more = ["--functional-map", word(&map), "--functions", word(&of_a), word(&of_b)];
        correspond(&a, &b, &[&words[..], &more].concat());
        let [c, of_a, of_b] = [&map, &of_a, &of_b].map(|path| {
            npy::open::<f32>(path)
                .map(|x| x.to_vec())
                .unwrap_or_else(|_| npy::open::<f64>(path).unwrap().iter().map(|x| *x as f32).collect())
        });
        let matches = read(&out);
        let k = (c.len() as f64).sqrt() as usize;
        assert_eq!((c.len(), of_a.len(), of_b.len()), (k * k, k * matches.len(), k * matches.len()));
        // Φ_B at matches is near C Φ_A.
        let (mut misfit, mut size) = (0f64, 0f64);
        for (v, one) in matches.iter().enumerate().step_by(7) {
            for i in 0..k {
                let carried: f32 = (0..k).map(|j| c[i * k + j] * of_a[v * k + j]).sum();
                let there = of_b[one.target as usize * k + i];
                misfit += f64::from(carried - there).powi(2);
                size += f64::from(there).powi(2);
            }
        }
        assert!(misfit < 0.1 * size, "{refine}: {misfit} of {size}");
        let told = std::fs::read(&points).unwrap();
        assert!(told.len() > 24 * matches.len() && String::from_utf8_lossy(&told[..100]).contains("corners"));
    }
}

/// Writes the mesh at `path` without the faces that touch a ball around one of four of its vertices, `radius` of its extent in y wide, and
/// gives the old numbers of the vertices that are left.
fn with_holes(path: &Path, out: &Path, radius: f64) -> Vec<u32> {
    let dir = in_memory();
    let opened = mesh::open(path, dir.path(), &Run::new(&())).unwrap();
    let n = opened.positions.len();
    let points: Vec<[f64; 3]> = (0..n as u32).map(|v| opened.positions.get(v)).collect();
    let (low, high) = points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p[1]), h.max(p[1])));
    let radius = radius * (high - low);
    let apart = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    let stays = |v: u32| (0..4).all(|k| apart(points[v as usize], points[(2 * k + 1) * n / 8]) > radius);
    let mut faces = Vec::new();
    opened.faces.for_each(0..opened.faces.len(), |_, c| {
        if c.iter().all(|&v| stays(v)) {
            faces.push([c[0], c[1], c[2]]);
        }
    });
    let mut old: Vec<u32> = faces.iter().flatten().copied().collect();
    old.sort_unstable();
    old.dedup();
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        old.len(),
        faces.len()
    );
    for &v in &old {
        let [x, y, z] = opened.positions.get(v);
        writeln!(text, "{x} {y} {z}").unwrap();
    }
    for face in faces {
        let [a, b, c] = face.map(|v| old.binary_search(&v).unwrap());
        writeln!(text, "3 {a} {b} {c}").unwrap();
    }
    std::fs::write(out, text).unwrap();
    old
}

#[test]
fn a_mesh_with_holes_is_found_in_the_whole_and_the_rest_is_told_as_unmatched() {
    let (dir, a, whole) = files();
    permuted(&a, &whole, false);
    let holes = dir.path().join("holes.ply");
    let old = with_holes(&whole, &holes, 0.1);
    let (out, json) = (dir.path().join("m.npy"), dir.path().join("r.json"));
    let json_to = format!("--json={}", json.display());
    let matched = |a: &Path, b: &Path| {
        correspond(a, b, &["-q", "--partial", "-o", word(&out), &json_to]);
        let told: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        let matches = read(&out);
        let none = matches.iter().filter(|one| one.target < 0).count();
        assert_eq!(told["unmatched"].as_u64().unwrap() as usize, none);
        matches
    };
    if every_case() {
        let of_part = matched(&holes, &whole);
        assert!(of_part.iter().filter(|one| one.target >= 0).count() * 10 > 8 * old.len());
        let found = error(&out, &whole, &old, dir.path());
        assert!(found["mean"].as_f64().unwrap() < 0.03, "{found}");
    }
    let from_whole = matched(&whole, &holes);
    // Vertices of the part are found, each near itself.
    let opened = mesh::open(&whole, dir.path(), &Run::new(&())).unwrap();
    let (mut found, mut apart) = (0, 0.);
    for one in old.iter().map(|&v| (v, from_whole[v as usize].target)).filter(|one| one.1 >= 0) {
        let [p, q] = [one.0, old[one.1 as usize]].map(|v| opened.positions.get(v));
        apart += (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>().sqrt();
        found += 1;
    }
    let points = (0..opened.positions.len() as u32).map(|v| opened.positions.get(v)[1]);
    let (low, high) = points.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), y| (low.min(y), high.max(y)));
    assert!(found * 10 > 8 * old.len() && apart / (found as f64) < 0.03 * (high - low), "{found}, {apart}");
    let outside: Vec<_> =
        (0..from_whole.len()).filter(|&v| old.binary_search(&(v as u32)).is_err()).map(|v| from_whole[v]).collect();
    let told = outside.iter().filter(|one| one.target < 0).count();
    assert!(told * 10 > 6 * outside.len(), "{told} of {}", outside.len());
}

/// Regression: a part that was not found had no matches, and nothing was said; or it "may also match elsewhere".
#[test]
fn a_part_that_is_not_found_is_told() {
    let dir = in_memory();
    let [tetrahedron, dumbbell, grid] =
        [shapes::tetrahedron(), shapes::dumbbell(), shapes::grid(9)].map(|shape| shape.write(dir.path()));
    let out = dir.path().join("m.npy");
    for (a, b, note) in [
        (&tetrahedron, &tetrahedron, "tetrahedron.ply: 4 vertices are too few to find it in "),
        (&grid, &dumbbell, "grid.ply: no reliable match with "),
    ] {
        let told = errors(&correspond(a, b, &["--partial", "-o", word(&out)]));
        assert!(told.contains(note), "{told}");
        assert!(read(&out).iter().all(|one| one.target < 0) && !told.contains("ambiguous"), "{told}");
    }
}

#[test]
fn wrong_guidance_is_refused_in_a_line() {
    let (dir, a, b) = files();
    permuted(&a, &b, false);
    let file = |name: &str, text: &str| {
        let path = dir.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let (out, c) = (dir.path().join("m.npy"), dir.path().join("c.npy"));
    let (out, c) = (word(&out), word(&c));
    let [good, three, beyond, empty] =
        [("g", "0 1\n"), ("t", "0 1\n1 2 3\n"), ("b", "0 99999999\n"), ("e", "# none\n")].map(|(n, t)| file(n, t));
    let [short, text] =
        [("s.csv", "vertex,match,distance,confidence\n0,1,0,1\n"), ("m.npy.csv", "nothing\n")].map(|(n, t)| file(n, t));
    for (words, code, part) in [
        (vec!["--landmarks-file", "nowhere.txt"], 1, "nowhere.txt"),
        (vec!["--landmarks-file", word(&three)], 1, "line 2"),
        (vec!["--landmarks-file", word(&beyond)], 1, "99999999"),
        (vec!["--landmarks-file", word(&empty)], 1, "no pair"),
        (vec!["--landmarks-file", word(&good), "--refine", "none"], 2, "refinement"),
        // It was called misuse, and the file was not named.
        (vec!["--initial-map", word(&short)], 1, "s.csv: is not a map"),
        (vec!["--initial-map", word(&text)], 1, "m.npy.csv"),
        (vec!["--functional-map", c, "--refine", "none"], 2, "no functions"),
        (vec!["--points", c, "--refine", "none"], 2, "refinement"),
        (vec!["--partial", "--transfer"], 2, "cannot be used"),
        (vec!["--partial", "--landmarks-file", word(&good)], 2, "cannot be used"),
        (vec!["--partial", "--refine", "none"], 2, "--partial"),
        (vec!["--partial", "--alternative", "1"], 2, "cannot be used"),
        (vec!["--partial", "--functional-map", c], 2, "cannot be used"),
        (vec!["--partial", "--initial-map", out], 2, "cannot be used"),
    ] {
        refused(&[&["correspond", word(&a), word(&b), "-q", "-o", out], &words[..]].concat(), code, part);
    }
    // Regression: both meshes were read first.
    let words = ["correspond", word(&a), word(&b), "-o", out, "--initial-map", "nowhere.npy"];
    let told = refused(&words, 1, "nowhere.npy: cannot open");
    assert!(told.starts_with("nystrom-stream: nowhere.npy"), "{told}");
}
