//! What reports, notes and tables say of parts, meshes and batches: which parts most people would not have, aligned
//! columns, names once.

use crate::common::{self, errors, ok, program, run, segment, shapes, word};
use serde_json::Value;
use std::path::Path;

fn report(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// What cutting `mesh` tells, and its report.
fn cut(mesh: &Path, options: &[&str]) -> (String, Value) {
    let dir = common::in_memory();
    let (out, json) = (dir.path().join("x.seg"), dir.path().join("r.json"));
    let ask = format!("--json={}", json.display());
    let told = errors(&segment(mesh, &[&["-o", word(&out), &ask], options].concat()));
    (told, report(&json))
}

#[test]
fn parts_have_an_expected_agreement_in_report_and_table() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 8_000, false);
    let (json, table) = (dir.path().join("r.json"), dir.path().join("t.csv"));
    let ask = format!("--json={}", json.display());
    segment(&mesh, &["-o", word(&table), &ask]);
    let all = report(&json);
    assert_eq!(all["clear_parts"], true, "{all}");
    let shares: Vec<f64> =
        all["parts"].as_array().unwrap().iter().map(|part| part["expected_agreement"].as_f64().unwrap()).collect();
    assert!(shares.len() > 3 && shares.iter().all(|share| (0. ..=1.).contains(share)), "{shares:?}");
    for (part, share) in all["parts"].as_array().unwrap().iter().zip(&shares) {
        assert_eq!(part["unsure"], *share < 0.5, "{part}");
    }
    let text = std::fs::read_to_string(&table).unwrap();
    let column = text.lines().next().unwrap().split(',').position(|name| name == "expected_agreement").unwrap();
    for (row, share) in text.lines().skip(1).zip(&shares) {
        assert_eq!(row.split(',').nth(column).unwrap(), format!("{share:.3}"));
    }
    // Many more than there are: some of them are unsure, which is told in the report alone, since they were asked for.
    let told = errors(&segment(&mesh, &["-k", "60", "-o", word(&dir.path().join("x.seg")), &ask]));
    assert!(report(&json)["parts"].as_array().unwrap().iter().any(|part| part["unsure"] == true));
    assert!(!told.contains("unsure") && !told.contains("no clear parts"), "{told}");
    // What somebody has corrected is what they want.
    let centroid = |label: usize| {
        let names: Vec<&str> = text.lines().next().unwrap().split(',').collect();
        let row: Vec<&str> = text.lines().nth(1 + label).unwrap().split(',').collect();
        let at = |axis: &str| row[names.iter().position(|name| *name == format!("centroid_{axis}")).unwrap()];
        format!("[{}, {}, {}]", at("x"), at("y"), at("z"))
    };
    let edits = dir.path().join("edits.json");
    let merge = format!(r#"{{"edit": "merge", "at": [{}, {}]}}"#, centroid(0), centroid(1));
    std::fs::write(&edits, format!(r#"{{"format": "nystrom-stream edits", "version": 1, "edits": [{merge}]}}"#))
        .unwrap();
    segment(&mesh, &["-q", "--edits", word(&edits), "-o", word(&table), &ask]);
    assert!(report(&json).get("clear_parts").is_none() && report(&json)["parts"][0].get("unsure").is_none());
}

#[test]
fn terrain_is_told_to_have_no_clear_parts() {
    let Some(data) = common::data() else {
        eprintln!("skipped: the test meshes are missing");
        return;
    };
    // Six of eight seeds.
    for seed in ["1", "2", "3"] {
        let (told, all) = cut(&data.join("real/mountain_51k.ply"), &["--seed", seed]);
        assert!(told.contains("no clear parts: people would hardly agree on them\n"), "{told}");
        assert_eq!(all["clear_parts"], false);
    }
    let (told, all) = cut(&data.join("real/horse_4k.ply"), &[]);
    assert!(!told.contains("no clear parts"), "{told}");
    assert_eq!(all["clear_parts"], true);
}

#[test]
fn the_inside_of_a_head_is_told_and_does_not_hide_its_nose() {
    // A hollow shape of 20,000 faces is cut by a test of the library, every time.
    let Some(data) = common::data().filter(|_| common::every_case()) else {
        eprintln!("skipped: no test meshes, or not every case asked for");
        return;
    };
    let head = data.join("real/mri_ch2_head_h.ply");
    let (told, all) = cut(&head, &[]);
    assert!(told.contains("walls of cavities, ") && told.contains("; enclosed bodies, "), "{told}");
    let enclosed = &all["decision"]["enclosed"];
    let share = |name: &str| enclosed[name].as_f64().unwrap();
    assert!((0.25..0.45).contains(&share("walls")) && (0.3..0.45).contains(&share("bodies")), "{enclosed}");
    // Regressions: skin, skull and brain were one part; then there were three to eight parts, depending on the seed.
    let parts = all["parts"].as_array().unwrap().len();
    assert_eq!(parts, 3, "head, brain and nose");
    let dir = common::in_memory();
    let (work, out, json) = (dir.path().join("work"), dir.path().join("x.seg"), dir.path().join("r.json"));
    let (told, all) = cut(&head, &["--walls", "own", "--work-dir", word(&work)]);
    let count = told.lines().filter(|line| line.contains("walls of cavities")).count();
    assert!(count == 1 && told.contains(" % of the area, are one part; enclosed bodies, "), "{told}");
    assert_eq!(all["walls_label"], parts);
    let ask = format!("--json={}", json.display());
    ok(&["cluster", "-q", "--work-dir", word(&work), "-k", "2", "-o", word(&out), &ask]);
    // Regression: the option had no effect where there are more parts than cells.
    let output = run(&["cluster", "-q", "--work-dir", word(&work), "-k", "3000", "-o", word(&out)]);
    assert!(
        output.status.code() == Some(2) && errors(&output).contains("leave out --walls own"),
        "{}",
        errors(&output)
    );
    let two = report(&json);
    assert_eq!((&two["walls_label"], two["parts"].as_array().unwrap().len()), (&2.into(), 3), "head, brain and walls");
    let (told, _) = cut(&data.join("real/horse_4k.ply"), &[]);
    assert!(!told.contains("walls of cavities") && !told.contains("enclosed bodies"), "{told}");
}

#[test]
fn tables_are_aligned_and_failures_name_their_mesh_once() {
    let dir = common::in_memory();
    let meshes = [shapes::dumbbell().write(dir.path()), shapes::grid(9).write(dir.path())];
    let broken = dir.path().join("a_long_name_that_fails.ply");
    std::fs::write(&broken, "ply\nformat ascii 1.0\nend_header\n").unwrap();
    let pattern = dir.path().join("{}.seg");
    let words = ["segment", word(&meshes[0]), word(&broken), word(&meshes[1]), "-o", word(&pattern)];
    let told = errors(&run(&words));
    let rows: Vec<&str> = told.lines().filter(|line| !line.contains(':')).collect();
    assert_eq!(rows.len(), 3, "a header and two meshes: {told}");
    assert!(rows.iter().all(|row| row.len() == rows[0].len()), "{told}");
    let name = broken.display().to_string();
    let of_it: Vec<&str> = told.lines().filter(|line| line.contains(&name)).collect();
    assert!(!of_it.is_empty() && of_it.iter().all(|line| line.matches(&name).count() == 1), "{told}");
    assert!(!told.contains("0 bytes"), "{told}");
}

#[test]
fn as_many_parts_as_faces_can_be_had() {
    let dir = common::in_memory();
    let mesh = shapes::grid(45).write(dir.path());
    let faces = nystrom_stream::Mesh::open(&mesh).unwrap().faces.len();
    let out = dir.path().join("x.seg");
    segment(&mesh, &["-q", "-k", &faces.to_string(), "-o", word(&out)]);
    let mut labels = nystrom_stream::mesh::read_seg(&out).unwrap();
    labels.sort_unstable();
    assert!(faces > 4_000 - 100 && labels.iter().copied().eq(0..faces as u32), "{faces}");
}

/// The reports said nothing of faces without a place, and a work directory told of them once only.
#[test]
fn notes_about_the_mesh_are_in_reports_too() {
    let dir = common::in_memory();
    let mut shape = shapes::grid(9);
    shape.vertices[0] = [f64::NAN; 3];
    let mesh = shape.write(dir.path());
    let (work, json) = (dir.path().join("work"), dir.path().join("r.json"));
    let ask = format!("--json={}", json.display());
    let is_told = |told: &str, all: &Value| {
        let notes: Vec<&str> = all["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap()).collect();
        let of_it = |text: &str| text.contains("whose coordinates are not finite numbers");
        assert!(notes.iter().filter(|note| of_it(note)).count() == 1, "{notes:?}");
        assert!(told.lines().filter(|line| of_it(line)).count() == 1, "{told}");
        // What is reused is about the work, not about the mesh.
        assert!(!notes.iter().any(|note| note.contains("reused")), "{notes:?}");
    };
    for _ in 0..2 {
        let (told, all) = cut(&mesh, &["--work-dir", word(&work)]);
        is_told(&told, &all);
        let notes = all["notes"].as_array().unwrap();
        assert!(notes.iter().all(|note| told.contains(note.as_str().unwrap())), "{notes:?} {told}");
    }
    let output = run(&["cluster", "--work-dir", word(&work), "-k", "2", &ask]);
    is_told(&errors(&output), &report(&json));
    let output = run(&["graph", word(&mesh), "--work-dir", word(&work), &ask]);
    is_told(&errors(&output), &report(&json));
}

/// Regression: of a mesh with the name of a stage, notes named the stage in other words.
#[test]
fn notes_about_a_file_name_it() {
    let dir = common::in_memory();
    let mesh = dir.path().join("cells");
    std::fs::copy(common::creature(dir.path(), 1_000, false), &mesh).unwrap();
    let mut bytes = std::fs::read(&mesh).unwrap();
    bytes.extend([7; 8]);
    std::fs::write(&mesh, bytes).unwrap();
    let output = program().args(["segment", "cells", "-k", "2"]).current_dir(dir.path()).output().unwrap();
    assert!(errors(&output).contains("cells: ignored 8 bytes after the last element"), "{}", errors(&output));
}
