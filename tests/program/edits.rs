//! Corrections: edits named by places, hints painted on faces, and what is said where they cannot be followed.

use crate::common::{creature, data, errors, in_memory, json, ok, refused, run, segment, shapes, word};
use crate::formats::{has_browser, tool};
use crate::stages::tiny;
use nystrom_stream::mesh::{self, Labelling, Mesh, read_seg};
use nystrom_stream::store::Run;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// A creature in nine parts, with its work directory.
struct Scene {
    dir: tempfile::TempDir,
    mesh: PathBuf,
    work: PathBuf,
    before: Vec<u32>,
}

fn scene(faces: u64) -> Scene {
    let dir = in_memory();
    let mesh = creature(dir.path(), faces, false);
    let (work, out) = (dir.path().join("work"), dir.path().join("before.seg"));
    segment(&mesh, &["-q", "-k", "9", "--work-dir", word(&work), "-o", word(&out)]);
    Scene { before: read_seg(&out).unwrap(), dir, mesh, work }
}

/// The centroid of the face of `part` that lies farthest from all faces of other parts.
fn inside(mesh: &Path, labels: &[u32], part: u32) -> [f64; 3] {
    let mesh = Mesh::open(mesh).unwrap();
    let centre = |face: usize| {
        mesh.faces.with(face, |corners| {
            let points: Vec<[f64; 3]> = corners.iter().map(|&v| mesh.positions.get(v)).collect();
            [0, 1, 2].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64)
        })
    };
    let centres: Vec<[f64; 3]> = (0..labels.len()).map(centre).collect();
    let gap = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
    let own: Vec<usize> = (0..labels.len()).filter(|&face| labels[face] == part).collect();
    let others: Vec<usize> = (0..labels.len()).filter(|&face| labels[face] != part).step_by(3).collect();
    let depth = |face: usize| others.iter().map(|&o| gap(centres[face], centres[o])).fold(f64::INFINITY, f64::min);
    let best = own.iter().step_by(3).copied().max_by(|&a, &b| depth(a).total_cmp(&depth(b))).unwrap();
    centres[best]
}

impl Scene {
    fn file(&self, edits: &Value) -> PathBuf {
        let path = self.dir.path().join("edits.json");
        let all = json!({"format": "nystrom-stream edits", "version": 1, "parts": 9, "edits": edits});
        std::fs::write(&path, all.to_string()).unwrap();
        path
    }

    fn place(&self, part: u32) -> [f64; 3] {
        inside(&self.mesh, &self.before, part)
    }

    fn edited(&self, edits: &Value, more: &[&str]) -> Vec<u32> {
        let (file, out) = (self.file(edits), self.dir.path().join("after.seg"));
        let words = ["cluster", "-q", "--work-dir", word(&self.work), "--edits", word(&file), "-o", word(&out)];
        ok(&[&words, more].concat());
        read_seg(&out).unwrap()
    }

    fn refused(&self, edits: &Value) -> String {
        let file = self.file(edits);
        refused(&["cluster", "-q", "--work-dir", word(&self.work), "--edits", word(&file)], 1, "")
    }
}

/// The share of faces on which `a` and `b` agree, each part of `a` standing for the part of `b` that it shares most with.
fn agreement(a: &[u32], b: &[u32]) -> f64 {
    let (rows, columns) = (a.iter().max().unwrap() + 1, b.iter().max().unwrap() + 1);
    let mut table = vec![0usize; (rows * columns) as usize];
    a.iter().zip(b).for_each(|(&a, &b)| table[(a * columns + b) as usize] += 1);
    let best = table.chunks(columns as usize).map(|row| row.iter().max().unwrap());
    best.sum::<usize>() as f64 / a.len() as f64
}

fn parts(labels: &[u32]) -> u32 {
    labels.iter().max().unwrap() + 1
}

#[test]
fn merge_split_and_cut_change_the_parts_they_name() {
    let scene = scene(12_000);
    let (a, b) = (scene.place(0), scene.place(1));
    let merged = scene.edited(&json!([{"edit": "merge", "at": [a, b]}]), &[]);
    assert_eq!(parts(&merged), 8);
    let expected: Vec<u32> = scene.before.iter().map(|&part| part.max(1) - 1).collect();
    assert!(agreement(&merged, &expected) > 0.995 && agreement(&expected, &merged) > 0.995);

    let split = scene.edited(&json!([{"edit": "split", "at": a, "into": 3}]), &[]);
    assert_eq!(parts(&split), 11);
    assert!(agreement(&split, &scene.before) > 0.99, "the new parts lie in the old one");
    let others: Vec<usize> = (0..split.len()).filter(|&face| scene.before[face] != 0).collect();
    let (old, new): (Vec<u32>, Vec<u32>) = others.iter().map(|&face| (scene.before[face], split[face])).unzip();
    assert!(agreement(&old, &new) > 0.99, "no other part is divided");

    // Merged, then cut between the two places again: nearly as before.
    let again = scene.edited(&json!([{"edit": "merge", "at": [a, b]}, {"edit": "cut", "between": [a, b]}]), &[]);
    assert_eq!(parts(&again), 9);
    assert!(agreement(&again, &scene.before) > 0.95, "{}", agreement(&again, &scene.before));
}

#[test]
fn a_hint_moves_one_cut_and_nothing_else() {
    let scene = scene(12_000);
    let (a, b) = (scene.place(0), scene.place(1));
    assert_eq!(scene.edited(&json!([{"edit": "apart", "at": [a, b]}]), &[]), scene.before, "it holds already");
    let together = scene.edited(&json!([{"edit": "together", "at": [a, b]}]), &[]);
    assert_eq!(together, scene.edited(&json!([{"edit": "merge", "at": [a, b]}]), &[]));
    // Two faces far apart in one part.
    let split = scene.edited(&json!([{"edit": "split", "at": a}]), &[]);
    let pieces: Vec<u32> = (0..parts(&split))
        .filter(|&k| {
            let own = || (0..split.len()).filter(|&face| split[face] == k);
            2 * own().filter(|&face| scene.before[face] == 0).count() > own().count()
        })
        .collect();
    assert_eq!(pieces.len(), 2);
    let places: Vec<[f64; 3]> = pieces.iter().map(|&piece| inside(&scene.mesh, &split, piece)).collect();
    let apart = scene.edited(&json!([{"edit": "apart", "at": places}]), &[]);
    assert_eq!(parts(&apart), 10);
    let others: Vec<usize> = (0..apart.len()).filter(|&face| scene.before[face] != 0).collect();
    let (old, new): (Vec<u32>, Vec<u32>) = others.iter().map(|&face| (scene.before[face], apart[face])).unzip();
    assert!(agreement(&old, &new) > 0.99 && agreement(&new, &old) > 0.99);
}

#[test]
fn dropped_parts_come_last_and_protected_ones_stay() {
    let scene = scene(12_000);
    let (a, b, c) = (scene.place(0), scene.place(1), scene.place(2));
    let dropped = scene.edited(&json!([{"edit": "drop", "at": a}, {"edit": "drop", "at": c}]), &[]);
    assert_eq!(parts(&dropped), 8);
    let gone: Vec<u32> = scene.before.iter().map(|&part| u32::from(part == 0 || part == 2)).collect();
    assert!(agreement(&gone, &dropped.iter().map(|&part| u32::from(part == 7)).collect::<Vec<_>>()) > 0.99);
    let protect = json!({"edit": "protect", "at": a});
    for edit in
        [json!({"edit": "merge", "at": [b, a]}), json!({"edit": "split", "at": a}), json!({"edit": "drop", "at": a})]
    {
        let told = scene.refused(&json!([protect, edit]));
        assert!(told.contains("edits.json: edit 2") && told.contains("a part that edit 1 protects"), "{told}");
    }
    let told = scene.refused(&json!([protect, {"edit": "together", "at": [a, b]}]));
    assert!(told.contains("edit 1 (protect): a hint changes the part"), "{told}");
}

/// Boundaries do not follow cells: a face beside one stands for the part that is seen on it all the same.
#[test]
fn a_place_beside_a_boundary_is_on_the_part_that_is_seen_there() {
    for faces in [12_000, 70_000] {
        let scene = scene(faces);
        let mesh = Mesh::open(&scene.mesh).unwrap();
        let mut of_vertex = vec![u32::MAX; mesh.positions.len()];
        let mut beside = vec![Vec::new(); 9];
        mesh.faces.for_each(0..scene.before.len(), |face, corners| {
            let part = scene.before[face];
            let other = corners.iter().any(|&v| of_vertex[v as usize] != u32::MAX && of_vertex[v as usize] != part);
            corners.iter().for_each(|&v| of_vertex[v as usize] = part);
            if other {
                beside[part as usize].push(face);
            }
        });
        for round in 0..6 {
            let of = |part: usize| beside[part].get(round * beside[part].len() / 6).copied();
            let named: Vec<(usize, usize)> = (0..9).filter_map(|part| Some((part, of(part)?))).collect();
            let name =
                |&(part, face): &(usize, usize)| json!({"edit": "name", "at": face, "name": format!("is {part}")});
            let file = scene.file(&named.iter().map(name).collect());
            let output = run(&["cluster", "-q", "--work-dir", word(&scene.work), "--edits", word(&file), "--json"]);
            let report: Value = serde_json::from_slice(&output.stdout).unwrap();
            for (part, face) in named {
                assert_eq!(report["parts"][part]["name"], format!("is {part}"), "face {face} of {faces}");
            }
        }
    }
}

/// Under another number of parts, what is protected stays, and the rest is cut into the others.
#[test]
fn protected_parts_stay_under_another_number_of_parts() {
    let scene = scene(12_000);
    // The part that six parts do not have: every part of the nine that is another one's piece there.
    let six = scene.edited(&json!([]), &["-k", "6"]);
    let share = |part: u32| {
        let own: Vec<u32> = (0..six.len()).filter(|&face| scene.before[face] == part).map(|face| six[face]).collect();
        let most = (0..6).map(|k| own.iter().filter(|&&x| x == k).count()).max().unwrap();
        let whole = (0..6).find(|&k| own.iter().filter(|&&x| x == k).count() == most).unwrap();
        own.len() as f64 / six.iter().filter(|&&x| x == whole).count() as f64
    };
    let small = (0..9).min_by(|&a, &b| share(a).total_cmp(&share(b))).unwrap();
    assert!(share(small) < 0.8, "{}", share(small));
    let (place, other) = (scene.place(small), scene.place((small + 1) % 9));
    let edits = json!([{"edit": "merge", "at": [place, other]}, {"edit": "protect", "at": place},
        {"edit": "name", "at": other, "name": "kept"}]);
    let own = scene.edited(&edits, &[]);
    assert_eq!(parts(&own), 8);
    let kept: Vec<u32> = scene.before.iter().map(|&part| u32::from(part == small || part == (small + 1) % 9)).collect();
    for count in [2, 4, 6, 12, 20] {
        let cut = scene.edited(&edits, &["-k", &count.to_string()]);
        assert_eq!(parts(&cut), count);
        let within: Vec<u32> = (0..cut.len()).filter(|&face| kept[face] == 1).map(|face| cut[face]).collect();
        let part = (0..count).max_by_key(|&k| within.iter().filter(|&&x| x == k).count()).unwrap();
        let (same, all) = ((0..cut.len()).filter(|&f| (cut[f] == part) == (kept[f] == 1)).count(), cut.len());
        assert!(same as f64 > 0.99 * all as f64, "{same} of {all} with {count} parts");
    }
    let file = scene.file(&json!([{"edit": "protect", "at": place}, {"edit": "protect", "at": other}]));
    let output = run(&["cluster", "-q", "--work-dir", word(&scene.work), "-k", "2", "--edits", word(&file)]);
    let told = errors(&output);
    assert!(told.contains("edit 2 (protect): 2 protected parts and the rest cannot make 2 parts"), "{told}");
}

#[test]
fn the_same_bytes_from_segment_and_from_any_number_of_threads() {
    let scene = scene(12_000);
    let (a, b) = (scene.place(3), scene.place(4));
    let edits = json!([{"edit": "merge", "at": [a, b]}, {"edit": "split", "at": scene.place(0)},
        {"edit": "name", "at": a, "name": "both"}]);
    let expected = scene.edited(&edits, &["--threads", "1"]);
    assert_eq!(scene.edited(&edits, &["--threads", "7"]), expected);
    let (file, out) = (scene.file(&edits), scene.dir.path().join("direct.seg"));
    segment(&scene.mesh, &["-q", "--edits", word(&file), "-o", word(&out)]);
    assert_eq!(read_seg(&out).unwrap(), expected);
    // Numbers of faces name the same places.
    let mesh = Mesh::open(&scene.mesh).unwrap();
    let face = |p: [f64; 3]| {
        let gap = |face: usize| {
            mesh.faces.with(face, |corners| {
                let at = |k: usize| corners.iter().map(|&v| mesh.positions.get(v)[k]).sum::<f64>() / 3.;
                (0..3).map(|k| (at(k) - p[k]).powi(2)).sum::<f64>()
            })
        };
        (0..scene.before.len()).min_by(|&i, &j| gap(i).total_cmp(&gap(j))).unwrap()
    };
    let merged = scene.edited(&json!([{"edit": "merge", "at": [face(a), face(b)]}]), &[]);
    assert_eq!(merged, scene.edited(&json!([{"edit": "merge", "at": [a, b]}]), &[]));
}

#[test]
fn edits_apply_to_another_resolution_and_to_other_units() {
    let scene = scene(12_000);
    let edits = json!([{"edit": "merge", "at": [scene.place(0), scene.place(1)]}]);
    let mesh = Mesh::open(&scene.mesh).unwrap();
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    let corners: Vec<[f64; 3]> = (0..mesh.positions.len() as u32).map(|v| mesh.positions.get(v)).collect();
    for p in &corners {
        (0..3).for_each(|k| (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k])));
    }
    let file = scene.file(&edits);
    let mut text: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    text["box"] = json!([low, high]);
    std::fs::write(&file, text.to_string()).unwrap();

    let coarse = creature(scene.dir.path(), 5_000, false);
    let (plain, merged) = (scene.dir.path().join("plain.seg"), scene.dir.path().join("merged.seg"));
    segment(&coarse, &["-q", "-k", "9", "-o", word(&plain)]);
    segment(&coarse, &["-q", "--edits", word(&file), "-o", word(&merged)]);
    assert_eq!((parts(&read_seg(&plain).unwrap()), parts(&read_seg(&merged).unwrap())), (9, 8));

    // The same mesh in millimetres.
    let large: Vec<[f64; 3]> = corners.iter().map(|p| p.map(|x| 1000. * x)).collect();
    let faces: Vec<Vec<u32>> = (0..mesh.faces.len()).map(|face| mesh.faces.with(face, <[u32]>::to_vec)).collect();
    let path = scene.dir.path().join("millimetres.ply");
    let labelling = Labelling { labels: &scene.before, colours: &[], quality: None, names: &[], fine: None };
    Mesh::from_slices(&large, &faces).unwrap().save(&path, labelling).unwrap();
    segment(&path, &["-q", "--edits", word(&file), "-o", word(&merged)]);
    assert_eq!(parts(&read_seg(&merged).unwrap()), 8);
    // Without the box, the places are inside of it and far from its surface or on the wrong part: they are refused or few.
    let told = scene.refused(&json!([{"edit": "split", "at": [9e3, 0, 0]}]));
    assert!(told.contains("edit 1 (split): the place [9000, 0, 0] is") && told.contains("units"), "{told}");
}

/// Regression: `-k` was blamed, which was not given.
#[test]
fn a_number_of_parts_in_the_edits_is_theirs() {
    let dir = in_memory();
    let (mesh, edits) = (shapes::tetrahedron().write(dir.path()), dir.path().join("edits.json"));
    let all = json!({"format": "nystrom-stream edits", "version": 1, "parts": 5, "edits": []});
    std::fs::write(&edits, all.to_string()).unwrap();
    let words = ["segment", word(&mesh), "-q", "--edits", word(&edits)];
    let told = refused(&words, 1, "has 4 faces, fewer than the 5 parts requested; correct their number in");
    assert!(told.contains("edits.json"), "{told}");
    refused(&[&words[..], &["-k", "6"]].concat(), 1, "choose a smaller -k");
}

#[test]
fn painted_faces_are_hints() {
    let scene = scene(12_000);
    let (painted, out) = (scene.dir.path().join("painted.ply"), scene.dir.path().join("out.seg"));
    // Labels 1 to 8 of the nine parts are hints for a run that would find another number.
    segment(&scene.mesh, &["-q", "-k", "9", "-o", word(&painted)]);
    segment(&painted, &["-q", "-k", "3", "--hints", "label", "-o", word(&out)]);
    let found = read_seg(&out).unwrap();
    let of_painted = |labels: &[u32]| -> Vec<u32> {
        labels.iter().zip(&scene.before).filter(|(_, before)| **before > 0).map(|(&label, _)| label).collect()
    };
    let (a, b) = (of_painted(&found), of_painted(&scene.before));
    assert!(agreement(&a, &b) > 0.97 && agreement(&b, &a) > 0.97, "{} {}", agreement(&a, &b), agreement(&b, &a));
    let output = run(&["segment", word(&painted), "-q", "--hints", "colour", "-o", word(&out)]);
    assert!(!output.status.success() && errors(&output).contains("colour"), "{}", errors(&output));
}

/// Regression: boundaries are refined across cells, so faces painted on a part lie in cells of its neighbours too. The
/// hint joined these to the part.
#[test]
fn a_part_that_is_painted_as_it_is_stays_as_it_is() {
    let scene = scene(12_000);
    let (painted, out) = (scene.dir.path().join("painted.ply"), scene.dir.path().join("out.seg"));
    let mesh = Mesh::open(&scene.mesh).unwrap();
    for part in [0, 4, 8] {
        let values: Vec<u32> = scene.before.iter().map(|&before| u32::from(before == part)).collect();
        let labelling = Labelling { labels: &values, colours: &[[0; 3]; 2], quality: None, names: &[], fine: None };
        mesh::write_labelled(&mesh, &painted, &labelling, mesh::PlyForm::Same, &Run::new(&())).unwrap();
        segment(&painted, &["-q", "-k", "9", "--hints", "label", "-o", word(&out)]);
        assert!(read_seg(&out).unwrap() == scene.before, "part {part}");
    }
}

/// Regression: nothing was told of painted faces whose hint the result does not follow.
#[test]
fn painted_hints_that_stay_unmet_are_told() {
    let scene = scene(12_000);
    let (painted, out) = (scene.dir.path().join("painted.ply"), scene.dir.path().join("out.seg"));
    let mesh = Mesh::open(&scene.mesh).unwrap();
    let mut values = scene.before.clone();
    // A single face in the midst of a part: the cell around it has the part's value.
    let places = mesh.faces.len();
    let inner = (0..places).find(|&face| {
        mesh.faces.with(face, |corners| {
            let touches = |other: usize| mesh.faces.with(other, |all| all.iter().any(|v| corners.contains(v)));
            scene.before[face] == 1 && (0..places).filter(|&other| touches(other)).all(|other| values[other] == 1)
        })
    });
    values[inner.unwrap()] = 77;
    let labelling = Labelling { labels: &values, colours: &[[0; 3]; 78], quality: None, names: &[], fine: None };
    mesh::write_labelled(&mesh, &painted, &labelling, mesh::PlyForm::Same, &Run::new(&())).unwrap();
    let told = |more: &[&str]| {
        let output = ok(&[&["segment", word(&painted), "-k", "9", "-o", word(&out)], more].concat());
        errors(&output)
    };
    let all = told(&["--hints", "label"]);
    assert!(all.contains("painted hints: different values are in one part: 77 with 1; paint more faces"), "{all}");
    let found = read_seg(&out).unwrap();
    let mut faces = vec![[0usize; 16]; 78];
    values
        .iter()
        .zip(&found)
        .filter(|(value, _)| **value > 0)
        .for_each(|(&v, &part)| faces[v as usize][part as usize] += 1);
    let outside: usize = faces.iter().map(|parts| parts.iter().sum::<usize>() - parts.iter().max().unwrap()).sum();
    let painted_faces = values.iter().filter(|value| **value > 0).count();
    let note = format!("painted hints: {outside} of {painted_faces} faces are outside the part of their value");
    assert_eq!(all.contains(&note), outside > 0, "{note}: {all}");
    // Later edits may join and divide what was painted.
    let merge = scene.file(&json!([{"edit": "merge", "at": [scene.place(2), scene.place(3)]}]));
    let merged = told(&["--hints", "label", "--edits", word(&merge)]);
    assert!(!merged.contains("different values"), "{merged}");
    // Labels from another mesh are guesses.
    let output = run(&["segment", word(&scene.mesh), "--like", word(&painted), "-o", word(&out)]);
    assert!(output.status.success() && !errors(&output).contains("painted hints"), "{}", errors(&output));
}

/// Regression: where an edit had a place beside a boundary, the labels that it was looked at with took the place of
/// those in the work directory, which were called damaged when a later edit was refused.
#[test]
fn refused_edits_leave_the_labels_that_are_there() {
    let scene = scene(5_000);
    let merged = scene.edited(&json!([{"edit": "merge", "at": [scene.place(0), scene.place(1)]}]), &[]);
    let mesh = Mesh::open(&scene.mesh).unwrap();
    let corners = |face: usize| mesh.faces.with(face, <[u32]>::to_vec);
    let of_zero: Vec<u32> = (0..merged.len()).filter(|&face| scene.before[face] == 0).flat_map(corners).collect();
    let beside = |&face: &usize| scene.before[face] > 0 && corners(face).iter().any(|vertex| of_zero.contains(vertex));
    let beside = (0..merged.len()).find(beside).unwrap();
    let edits = json!([
        {"edit": "name", "at": beside, "name": "a"},
        {"edit": "split", "at": scene.place(0), "into": 5000}
    ]);
    assert!(scene.refused(&edits).contains("edit 2 (split): the part has"));
    let again = scene.dir.path().join("again.seg");
    ok(&["export", "-q", "--work-dir", word(&scene.work), "-o", word(&again)]);
    assert_eq!(read_seg(&again).unwrap(), merged);
    assert!(!scene.work.join("seen.tmp").exists());
}

#[test]
fn what_cannot_be_followed_is_told_with_its_edit() {
    let scene = scene(5_000);
    let a = scene.place(0);
    for (edits, part) in [
        (json!([{"edit": "cut", "between": [a, a]}]), "edit 1 (cut): its places are so close"),
        (json!([{"edit": "split", "at": 99_999_999}]), "edit 1 (split): there is no face 99999999"),
        (json!([{"edit": "split", "at": a, "into": 5000}]), "edit 1 (split): the part has"),
        (json!([{"edit": "apart", "at": [a, a]}]), "edit 1 (apart): two of its places are so close"),
        (
            json!([{"edit": "together", "at": [a, scene.place(1)]}, {"edit": "apart", "at": [a, scene.place(1)]}]),
            "edit 2 (apart): ",
        ),
        (json!([{"edit": "splice", "at": a}]), "edit 1 (splice): unknown variant"),
    ] {
        let told = scene.refused(&edits);
        assert!(told.contains("edits.json: ") && told.contains(part) && told.lines().count() == 1, "{told}");
    }
    let file = scene.file(&json!([]));
    let output = run(&["segment", word(&scene.mesh), "-k", "4", "--cluster", "kmeans", "--edits", word(&file)]);
    assert_eq!(output.status.code(), Some(2), "{}", errors(&output));
    refused(&["segment", word(&scene.mesh), "--edits", "nowhere.json"], 1, "nowhere.json");
}

/// A page of labels that were corrected before knows the edits, so that what it saves holds all of them.
#[test]
fn an_exported_page_knows_the_edits_of_its_labels() {
    let scene = scene(5_000);
    scene.edited(&json!([{"edit": "split", "at": scene.place(0), "into": 3}]), &[]);
    let page = scene.dir.path().join("later.html");
    ok(&["export", "-q", "--work-dir", word(&scene.work), "-o", word(&page)]);
    let text = std::fs::read_to_string(&page).unwrap();
    assert!(text.contains(r#""edit":"split""#) && text.contains(r#""into":3"#));
}

/// Clicks in a browser, the edits that it saves, and the labels that they make of the full mesh: the parts that were seen.
#[test]
fn clicks_on_a_page_become_labels_of_all_faces() {
    if !has_browser() {
        return;
    }
    for (faces, whole) in [(12_000, true), (140_000, false)] {
        let dir = in_memory();
        let mesh = creature(dir.path(), faces, false);
        let [work, page, seen, out, ply] =
            ["work", "scan.html", "seen", "out.seg", "out.ply"].map(|name| dir.path().join(name));
        segment(&mesh, &["-q", "-k", "9", "--work-dir", word(&work), "-o", word(&page)]);
        std::fs::create_dir(&seen).unwrap();
        tool("check-page", &[&page, &seen]);
        let edits = seen.join("edits.json");
        let words = ["cluster", "--work-dir", word(&work), "--edits", word(&edits), "-o", word(&out), "-o", word(&ply)];
        let report = json(&[&words[..], &["--json"]].concat());
        let told: Value = serde_json::from_slice(&std::fs::read(seen.join("page-seen.json")).unwrap()).unwrap();
        let labels = read_seg(&out).unwrap();
        let (parts_told, shown) = (report["parts"].as_array().unwrap(), told["shares"].as_array().unwrap());
        assert_eq!((parts_told.len(), shown.len() as u64), (parts(&labels) as usize, told["parts"].as_u64().unwrap()));
        // The same numbers for the same parts, of about the same area; the same names.
        let total: f64 = parts_told.iter().map(|part| part["area"].as_f64().unwrap()).sum();
        for (part, share) in parts_told.iter().zip(shown) {
            let apart = part["area"].as_f64().unwrap() / total - share.as_f64().unwrap();
            assert!(apart.abs() < 0.02, "{part} is {share} on the page");
        }
        for name in told["names"].as_array().unwrap() {
            assert_eq!(parts_told[name[0].as_u64().unwrap() as usize]["name"], name[1]);
        }
        let header = std::fs::read(&ply).unwrap();
        assert!(String::from_utf8_lossy(&header[..2000.min(header.len())]).contains(": the body\n"));
        if whole {
            let page_labels = seen.join("creature_12000.seg");
            let page_labels = read_seg(&page_labels).unwrap();
            let same = labels.iter().zip(&page_labels).filter(|(a, b)| a == b).count();
            assert!(same as f64 > 0.98 * labels.len() as f64, "{same} of {}", labels.len());
        }
    }
}

/// Regression: the page forgot which parts earlier edits had dropped and protected.
#[test]
fn clicks_on_a_page_with_edits_come_after_them() {
    if !has_browser() {
        return;
    }
    let scene = scene(12_000);
    let [page, seen, out] = ["later.html", "seen", "out.seg"].map(|name| scene.dir.path().join(name));
    let edits = json!([
        {"edit": "protect", "at": scene.place(0)}, {"edit": "drop", "at": scene.place(2)},
        {"edit": "name", "at": scene.place(1), "name": "one"},
    ]);
    scene.edited(&edits, &["-o", word(&page)]);
    std::fs::create_dir(&seen).unwrap();
    tool("check-page", &[&page, &seen]);
    let (work, edits) = (word(&scene.work), seen.join("edits.json"));
    ok(&["cluster", "-q", "--work-dir", work, "--edits", word(&edits), "-o", word(&out)]);
    let (labels, shown) = (read_seg(&out).unwrap(), read_seg(&seen.join("creature_12000.seg")).unwrap());
    let same = labels.iter().zip(&shown).filter(|(a, b)| a == b).count();
    assert!(parts(&labels) == 10 && same as f64 > 0.98 * labels.len() as f64, "{same} of {}", labels.len());
}

#[test]
fn names_go_into_every_output() {
    let scene = scene(5_000);
    let path = |name: &str| scene.dir.path().join(name);
    std::fs::write(path("names.tsv"), "part\tname\n0\tbody: all of it\n3\tleft leg\n").unwrap();
    let (table, work) = (path("names.tsv"), path("named"));
    let outputs =
        ["a.ply", "a.glb", "parts/", "a.parquet", "a.html"].map(|name| path(name).to_str().unwrap().to_owned());
    let outputs = outputs.iter().flat_map(|name| ["-o", name]);
    let words = ["-q", "-k", "9", "--names", word(&table), "--json", "--work-dir", word(&work)];
    let output = segment(&scene.mesh, &words.into_iter().chain(outputs).collect::<Vec<_>>());
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(
        (&report["parts"][0]["name"], &report["parts"][3]["name"]),
        (&json!("body: all of it"), &json!("left leg"))
    );
    assert!(report["parts"][1].get("name").is_none());
    let text = |name: &str| String::from_utf8_lossy(&std::fs::read(path(name)).unwrap()).into_owned();
    assert!(text("a.ply").contains("comment part 0: body: all of it\ncomment part 3: left leg\nelement vertex"));
    for name in ["a.glb", "a.parquet", "a.html"] {
        assert!(text(name).contains("left leg"), "{name}");
    }
    assert!(path("parts/part_003_left_leg.ply").is_file() && path("parts/part_001.ply").is_file());
    assert!(text("parts/parts.json").contains("\"name\": \"body: all of it\""));
    // The work directory forgot them.
    ok(&["export", "-q", "--work-dir", word(&work), "-o", word(&path("again.ply"))]);
    assert!(text("again.ply") == text("a.ply"));
    // Labelled again without names, the old ones are gone; with others, they are replaced.
    segment(&path("a.ply"), &["-q", "-k", "9", "-o", word(&path("b.ply"))]);
    assert!(!text("b.ply").contains("left leg"));
    std::fs::write(path("names.tsv"), "12\tx\n").unwrap();
    let output = run(&["segment", word(&scene.mesh), "-q", "-k", "9", "--names", word(&path("names.tsv"))]);
    assert!(
        !output.status.success() && errors(&output).contains("names part 12, but there are only 9"),
        "{}",
        errors(&output)
    );
}

/// Regression: a table of names that cannot be read was told of after the cut.
#[test]
fn names_are_read_before_any_work() {
    let scene = scene(1_000);
    let table = scene.dir.path().join("names.tsv");
    for (text, told) in [(None, "cannot read: No such file"), (Some("0 body\n"), "line 1: has no tab")] {
        text.iter().for_each(|text| std::fs::write(&table, text).unwrap());
        let told_all = refused(&["segment", word(&scene.mesh), "--names", word(&table)], 1, told);
        assert_eq!(told_all.lines().count(), 1, "{told_all}");
    }
}

#[test]
fn parts_of_one_scan_are_found_on_others_of_its_kind() {
    let scene = scene(12_000);
    let path = |name: &str| scene.dir.path().join(name);
    std::fs::write(path("names.tsv"), "0\tbody\n1\tpart one\n").unwrap();
    segment(&scene.mesh, &["-q", "-k", "9", "--names", word(&path("names.tsv")), "-o", word(&path("reference.ply"))]);
    std::fs::create_dir_all(path("scans")).unwrap();
    // Another resolution in the same place, and the same elsewhere, turned.
    creature(&path("scans"), 6_000, true);
    let mesh = Mesh::open(&scene.mesh).unwrap();
    let turned: Vec<[f64; 3]> = (0..mesh.positions.len() as u32)
        .map(|v| {
            let [x, y, z] = mesh.positions.get(v);
            [50. - y, 30. + x, z - 7.]
        })
        .collect();
    let faces: Vec<Vec<u32>> = (0..mesh.faces.len()).map(|face| mesh.faces.with(face, <[u32]>::to_vec)).collect();
    let labelling = Labelling { labels: &vec![0; faces.len()], colours: &[], quality: None, names: &[], fine: None };
    Mesh::from_slices(&turned, &faces).unwrap().save(path("scans/moved.ply"), labelling).unwrap();
    let (out, report) = (path("{}.like.ply"), format!("--json={}", path("all.json").display()));
    let (scans, reference_mesh) = (path("scans"), path("reference.ply"));
    let output = ok(&["segment", word(&scans), "--like", word(&reference_mesh), "-o", word(&out), &report]);
    let all: Value = serde_json::from_slice(&std::fs::read(path("all.json")).unwrap()).unwrap();
    let of = |name: &str| {
        all.as_array().unwrap().iter().find(|one| one["input"]["path"].as_str().unwrap().contains(name)).unwrap()
    };
    let (near, far) = (of("creature_6000"), of("moved"));
    assert_eq!(
        (&near["like"]["method"], &near["like"]["needs_check"]),
        (&json!("position"), &json!(false)),
        "{}",
        near["like"]
    );
    assert_eq!(far["like"]["method"], "shape");
    assert_eq!((near["parts"].as_array().unwrap().len(), &near["parts"][1]["name"]), (9, &json!("part one")));
    // The same parts have the same numbers: their shares of the area agree.
    let share = |report: &Value, part: usize| {
        let area = |k: usize| report["parts"][k]["area"].as_f64().unwrap();
        area(part) / (0..9).map(area).sum::<f64>()
    };
    let told = run(&["segment", word(&scene.mesh), "-q", "-k", "9", "-o", word(&path("x.seg")), "--json"]);
    let reference: Value = serde_json::from_slice(&told.stdout).unwrap();
    for part in 0..9 {
        assert!((share(near, part) - share(&reference, part)).abs() < 0.01, "part {part}");
    }
    // On the moved mesh all parts are found; the creature is symmetric, so left and right may be exchanged.
    let moved = Mesh::open(path("moved.like.ply")).unwrap();
    let labels = moved.face_property("label", &Run::new(&())).unwrap();
    assert!(agreement(&labels, &scene.before) > 0.9, "{}", agreement(&labels, &scene.before));
    if far["like"]["needs_check"] == true {
        assert!(errors(&output).contains("check ") && errors(&output).contains("moved.ply"), "{}", errors(&output));
    }
    // Regression: the work directory kept the numbers, colours and names from before those of the reference were given.
    let (near, work, out) = (path("scans/creature_6000.ply"), path("near.work"), path("near.ply"));
    let words = ["-q", "--like", word(&reference_mesh), "--work-dir", word(&work), "-o", word(&out)];
    segment(&near, &words);
    ok(&["export", "--work-dir", word(&work), "-q", "-o", word(&path("kept.ply"))]);
    let bytes = |name: &str| std::fs::read(path(name)).unwrap();
    assert!(bytes("kept.ply") == bytes("near.ply") && bytes("near.ply") == bytes("creature_6000.like.ply"));
    let output = run(&["segment", word(&scene.mesh), "--like", word(&scene.mesh)]);
    assert!(!output.status.success() && errors(&output).contains("no face property `label`"), "{}", errors(&output));
    // Regression: where one face had the label 20,000,000, ten gigabytes were asked for, whatever the budget.
    let reference = mesh::open(&reference_mesh, scene.dir.path(), &Run::new(&())).unwrap();
    let mut labels = vec![0; reference.faces.len()];
    labels[0] = 20_000_000;
    let odd = path("odd.ply");
    reference.save(&odd, Labelling { labels: &labels, colours: &[], quality: None, names: &[], fine: None }).unwrap();
    refused(
        &["segment", word(&near), "--like", word(&odd), "-q", "--max-memory", "1GiB"],
        1,
        "the reference's greatest label",
    );
}

/// The edits of one mesh are carried to another: it needs no labels then, and neither does the file of edits fit the other mesh.
#[test]
fn edits_of_a_reference_are_carried_to_others() {
    let scene = scene(12_000);
    let scans = scene.dir.path().join("scans");
    std::fs::create_dir(&scans).unwrap();
    creature(&scans, 6_000, false);
    let edits = json!([{"edit": "merge", "at": [scene.place(0), scene.place(1)]},
        {"edit": "name", "at": scene.place(2), "name": "third"}, {"edit": "drop", "at": scene.place(3)}]);
    let (file, out) = (scene.file(&edits), scene.dir.path().join("{}.like.ply"));
    let words = ["segment", word(&scans), "--like", word(&scene.mesh), "--edits", word(&file), "-o", word(&out)];
    let report = scene.dir.path().join("all.json");
    ok(&[&words[..], &[&format!("--json={}", report.display())]].concat());
    let all: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    let expected = scene.edited(&edits, &["--json=-"]);
    let found = all[0]["parts"].as_array().unwrap();
    assert_eq!((found.len() as u32, &found[7]["name"]), (parts(&expected), &json!("dropped")));
    assert!(found.iter().any(|part| part["name"] == "third"), "{found:?}");
    // With the same numbers, of about the same share.
    let area =
        |k: usize| found[k]["area"].as_f64().unwrap() / found.iter().map(|p| p["area"].as_f64().unwrap()).sum::<f64>();
    let reference = Mesh::open(&scene.mesh).unwrap();
    let size = |face: usize| {
        reference.faces.with(face, |corners| {
            let [a, b, c] = [0, 1, 2].map(|k| reference.positions.get(corners[k]));
            let (u, w) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
            let n = [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]];
            n.iter().map(|x| x * x).sum::<f64>().sqrt()
        })
    };
    let sizes: Vec<f64> = (0..expected.len()).map(size).collect();
    for part in 0..8 {
        let own: f64 = (0..sizes.len()).filter(|&face| expected[face] == part).map(|face| sizes[face]).sum();
        let gap = own / sizes.iter().sum::<f64>() - area(part as usize);
        assert!(gap.abs() < 0.015, "part {part}: {gap}");
    }
}

/// Regression: a small part that was joined with a large one it does not touch went back to a third part: the interior
/// of both together, from which boundaries are refined, had no face in the small one.
#[test]
fn small_parts_keep_their_faces_where_they_are_joined_with_large_ones() {
    let Some(data) = data() else { return };
    let (dir, mesh) = (in_memory(), data.join("psb/120.ply"));
    let path = |name: &str| dir.path().join(name);
    let labels = |edits: Value| {
        let all = json!({"format": "nystrom-stream edits", "version": 1, "edits": edits});
        std::fs::write(path("edits.json"), all.to_string()).unwrap();
        segment(&mesh, &["-q", "--edits", word(&path("edits.json")), "-o", word(&path("x.seg"))]);
        read_seg(&path("x.seg")).unwrap()
    };
    let before = labels(json!([]));
    let mut faces = vec![Vec::new(); parts(&before) as usize];
    (0..before.len()).for_each(|face| faces[before[face] as usize].push(face));
    let (small, large) = (faces.iter().min_by_key(|f| f.len()).unwrap(), faces.iter().max_by_key(|f| f.len()).unwrap());
    assert!(20 * small.len() < large.len());
    let (a, b) = (large[large.len() / 2], small[small.len() / 2]);
    for edits in
        [json!([{"edit": "merge", "at": [a, b]}]), json!([{"edit": "drop", "at": a}, {"edit": "drop", "at": b}])]
    {
        let after = labels(edits.clone());
        let joined = after[a];
        assert!(small.iter().chain(large).filter(|&&face| after[face] != joined).count() < 9, "{edits}");
        assert_eq!(parts(&after), parts(&before) - 1);
    }
}

/// Regression: only the number of the first place stayed, so what was said of the other parts was lost.
#[test]
fn a_merged_part_keeps_what_was_said_of_any_of_its_places() {
    let scene = scene(12_000);
    let (a, b) = (scene.place(0), scene.place(1));
    let (report, drop) = (scene.dir.path().join("report.json"), json!({"edit": "drop", "at": b}));
    let dropped = scene.edited(&json!([drop, {"edit": "merge", "at": [a, b]}]), &[]);
    let last = parts(&dropped) - 1;
    let faces = |labels: &[u32], part: u32| labels.iter().filter(|label| **label == part).count();
    let joined = faces(&scene.before, 0) + faces(&scene.before, 1);
    assert_eq!(last, 7);
    assert!(faces(&dropped, last).abs_diff(joined) < joined / 50);
    let marks = json!([{"edit": "name", "at": b, "name": "paw"}, {"edit": "colour", "at": b, "colour": "#010203"}]);
    let merge = json!({"edit": "merge", "at": [a, b]});
    let all = json!([marks[0], marks[1], merge]);
    scene.edited(&all, &[&format!("--json={}", word(&report))]);
    let told: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    let named = told["parts"].as_array().unwrap().iter().find(|part| part["name"] == "paw").unwrap();
    assert_eq!(named["colour"], json!([1, 2, 3]));
}

/// Regression: the part that specks would have joined was dropped, named or cut in their place. And beside a reference
/// the label of the specks was that of an ordinary part.
#[test]
fn specks_with_a_label_of_their_own_are_no_part() {
    let dir = in_memory();
    let (mesh, body) = tiny(dir.path());
    let path = |name: &str| dir.path().join(name);
    let edits = json!({"format": "nystrom-stream edits", "version": 1, "edits": [{"edit": "drop", "at": body}]});
    std::fs::write(path("edits.json"), edits.to_string()).unwrap();
    let words = ["segment", word(&mesh), "-q", "--tiny-components", "own"];
    let output = run(&[&words[..], &["-k", "3", "--edits", word(&path("edits.json"))]].concat());
    assert_eq!(output.status.code(), Some(1));
    let told = errors(&output);
    assert!(told.contains("edit 1 (drop): one of its places is on tiny components"), "{told}");
    let report = |name: &str, more: &[&str]| -> Value {
        let (out, json) = (path(name), format!("--json={}", word(&path("report.json"))));
        ok(&[&words[..], &["-o", word(&out), &json], more].concat());
        serde_json::from_slice(&std::fs::read(path("report.json")).unwrap()).unwrap()
    };
    report("reference.ply", &["-k", "3"]);
    // Specks take part in no vote, wherever the reference has them.
    let reference = Mesh::open(path("reference.ply")).unwrap();
    let mut labels = reference.face_property("label", &Run::new(&())).unwrap();
    labels[body..].fill(1);
    // The numbers of people begin anywhere.
    labels.iter_mut().for_each(|label| *label += 1);
    let labelling = Labelling { labels: &labels, colours: &[], quality: None, names: &[], fine: None };
    reference.save(path("people.ply"), labelling).unwrap();
    let told = report("like.ply", &["--like", word(&path("people.ply"))]);
    let label = told["tiny_components_label"].as_u64().unwrap() as usize;
    assert_eq!((label, &told["parts"][label]["faces"]), (4, &json!(24)), "{told}");
    assert_eq!((&told["like"]["missing"], &told["like"]["needs_check"]), (&json!([]), &json!(false)), "{told}");
    // Regression: the lines and the table of a batch counted numbers that the reference does not use.
    let (people, out) = (path("people.ply"), path("{}.seg"));
    let output = run(&[&words[..], &["--like", word(&people), "-o", word(&out), "--json-lines"]].concat());
    let line: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((told["parts"].as_array().unwrap().len(), &line["parts"]), (5, &json!(4)), "{line}");
}
