//! `plot`: charts from a work directory, a report, a hierarchy; and what it refuses.

use crate::common::{self, errors, ok, word};
use std::path::Path;

fn plot(folder: &Path, words: &str) -> (i32, String) {
    let output =
        common::program().current_dir(folder).arg("plot").args(words.split_whitespace()).output().expect("it starts");
    (output.status.code().unwrap_or(-1), errors(&output))
}

fn text(folder: &Path, name: &str) -> String {
    std::fs::read_to_string(folder.join(name)).unwrap()
}

#[test]
fn work_directories_reports_and_hierarchies_are_plotted() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 8_000, false);
    let (work, report) = (dir.path().join("work"), dir.path().join("report.json"));
    let json = format!("--json={}", word(&report));
    common::segment(&mesh, &["-q", "--work-dir", word(&work), &json, "-o", word(&dir.path().join("x.seg"))]);

    let (code, err) = plot(dir.path(), "work --eigenvalues e.svg --eigenvalues e.png --tree t.svg --tree t.png");
    assert_eq!((code, &err[..]), (0, ""));
    for name in ["e.png", "t.png"] {
        let bytes = std::fs::read(dir.path().join(name)).unwrap();
        assert!(bytes.starts_with(b"\x89PNG") && bytes.len() > 2_000, "{name}");
    }
    let told: serde_json::Value = serde_json::from_str(&text(dir.path(), "report.json")).unwrap();
    let parts = told["parts"].as_array().unwrap();
    // Every part has its row, in the colour that the labels have.
    let drawn = text(dir.path(), "t.svg");
    assert!(drawn.contains(&format!("{} parts, cut at 0.50", parts.len())), "{drawn}");
    for part in parts {
        let colour: String = (0..3).map(|k| format!("{:02X}", part["colour"][k].as_u64().unwrap())).collect();
        assert!(drawn.contains(&format!("#{colour}")), "{part}");
    }
    // As many points as landmarks, and three in the legend.
    let eigenvalues = told["eigenvalues"].as_array().unwrap().len();
    assert_eq!(text(dir.path(), "e.svg").matches("<circle").count(), eigenvalues + 3);

    // The report gives the same chart; the hierarchy taken out gives the same tree.
    assert_eq!(plot(dir.path(), "report.json --eigenvalues r.svg").0, 0);
    assert_eq!(text(dir.path(), "r.svg"), text(dir.path(), "e.svg"));
    let tree = dir.path().join("tree.json");
    let words = ["export", "-q", "--work-dir", word(&work), "--tree", word(&tree)];
    ok(&words);
    assert_eq!(plot(dir.path(), "tree.json --tree again.svg -k 3").0, 0);
    assert!(text(dir.path(), "again.svg").contains("tree: 3 parts, as requested"));
    assert_eq!(plot(dir.path(), "tree.json --tree one.svg --detail -1").0, 0);
    assert!(text(dir.path(), "one.svg").contains("tree: 1 part, cut at 0.00"));
    // A number without a digit before its point was taken for an option.
    assert_eq!(plot(dir.path(), "tree.json --tree fewer.svg --detail -.5").0, 0);

    // Another number of parts is drawn as the work directory has it.
    ok(&["cluster", "-q", "--work-dir", word(&work), "-k", "4"]);
    assert_eq!(plot(dir.path(), "work --tree four.svg").0, 0);
    assert!(text(dir.path(), "four.svg").contains("4 parts, as requested"));

    for (words, code, reason) in [
        ("work", 2, "--eigenvalues"),
        ("work --tree x.gif", 2, "use .svg or .png"),
        ("work --eigenvalues x.svg -k 3", 2, "--tree"),
        ("work --tree x.svg -k 100000", 2, "cannot make"),
        ("work --tree x.svg --detail 3", 2, "-1 to 1"),
        ("report.json --tree x.svg", 1, "holds no hierarchy"),
        ("tree.json --eigenvalues x.svg", 1, "holds no eigenvalues"),
        ("x.seg --tree x.svg", 1, "neither a folder nor JSON"),
        ("nothing --tree x.svg", 1, "nothing"),
        ("work --tree nowhere/x.svg", 1, "nowhere"),
    ] {
        let (got, err) = plot(dir.path(), words);
        assert!(got == code && err.contains(reason), "{words}: {got} {err}");
    }
}

#[test]
fn k_means_keeps_its_eigenvalues_in_the_report_only() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 4_000, false);
    let work = dir.path().join("work");
    let report = format!("--json={}", word(&dir.path().join("report.json")));
    let out = dir.path().join("x.seg");
    let words = ["-q", "--cluster", "kmeans", "-k", "4", &report, "--work-dir", word(&work), "-o", word(&out)];
    common::segment(&mesh, &words);
    assert_eq!(plot(dir.path(), "report.json --eigenvalues r.svg").0, 0);
    let (code, err) = plot(dir.path(), "work --eigenvalues e.svg");
    assert!(code == 1 && err.contains("embed"), "{err}");
    let (code, err) = plot(dir.path(), "work --tree t.svg");
    assert!(code == 1 && err.contains("no hierarchy"), "{err}");
    ok(&["embed", "-q", "--work-dir", word(&work)]);
    assert_eq!(plot(dir.path(), "work --eigenvalues e.svg").0, 0);
}

/// Regression: K-means in another order of faces makes the graph anew; the eigenvalues of the decision about the one
/// before were drawn, though its hierarchy was not.
#[test]
fn eigenvalues_of_a_decision_about_another_graph_are_not_drawn() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 4_000, false);
    let (work, out) = (dir.path().join("work"), dir.path().join("x.seg"));
    let words = ["-q", "-k", "4", "--work-dir", word(&work), "-o", word(&out)];
    common::segment(&mesh, &[&words[..], &["--order", "keep"]].concat());
    assert_eq!(plot(dir.path(), "work --eigenvalues e.svg").0, 0);
    common::segment(&mesh, &[&words[..], &["--order", "hilbert", "--cluster", "kmeans"]].concat());
    for drawn in ["--eigenvalues e.svg", "--tree t.svg"] {
        let (code, err) = plot(dir.path(), &format!("work {drawn}"));
        assert!(code == 1 && err.contains("work: "), "{err}");
    }
}

/// They were taken for those of the cut of the same numbers, which are of other parts once an edit has split one.
#[test]
fn colours_of_edited_parts_are_not_those_of_the_hierarchys_cut() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 8_000, false);
    let (work, edits, out) = (dir.path().join("work"), dir.path().join("edits.json"), dir.path().join("x.seg"));
    common::segment(&mesh, &["-q", "--work-dir", word(&work), "-o", word(&out)]);
    let at = nystrom_stream::Mesh::open(&mesh).unwrap().positions.get(0);
    let split = serde_json::json!({
        "format": "nystrom-stream edits", "version": 1, "edits": [{"edit": "split", "at": at, "into": 3}],
    });
    std::fs::write(&edits, split.to_string()).unwrap();
    let words = ["cluster", "-q", "--work-dir", word(&work), "--edits", word(&edits), "-o", word(&out)];
    ok(&words);
    assert_eq!(plot(dir.path(), "work --tree edited.svg").0, 0);
    assert_eq!(plot(dir.path(), "work --tree plain.svg --detail 0").0, 0);
    assert_eq!(text(dir.path(), "edited.svg"), text(dir.path(), "plain.svg"));
    // Hints painted on faces leave no file of edits, and were overlooked.
    let (labelled, hinted) = (dir.path().join("labelled.ply"), dir.path().join("hinted"));
    common::segment(&mesh, &["-q", "-k", "3", "-o", word(&labelled)]);
    common::segment(&labelled, &["-q", "-k", "4", "--hints", "label", "--work-dir", word(&hinted), "-o", word(&out)]);
    assert_eq!(plot(dir.path(), "hinted --tree hinted.svg").0, 0);
    assert_eq!(plot(dir.path(), "hinted --tree plain.svg --detail 0").0, 0);
    assert_eq!(text(dir.path(), "hinted.svg"), text(dir.path(), "plain.svg"));
}
