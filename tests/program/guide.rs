//! Every command of the README, the guide and the tour, run as it stands there, on real meshes.
//!
//! Blocks fenced as `sh` are run line by line, in order, by one shell a file in a folder of its own. The meshes are
//! those of the collection; without it a creature stands in.

use crate::common;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The commands in the blocks fenced as `sh`, with their lines.
fn commands(name: &str) -> Vec<(usize, String)> {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).unwrap();
    let (mut found, mut inside) = (Vec::new(), false);
    for (number, line) in text.lines().enumerate() {
        if line.starts_with("```") {
            inside = line == "```sh";
        } else if inside && !line.trim().is_empty() {
            found.push((number + 1, line.to_string()));
        }
    }
    assert!(found.len() > 2, "{name}");
    found
}

/// The folder that the commands find themselves in: `scan.ply`, `a.ply`, `b.ply`, `scans/`, `psb/`.
fn scene() -> tempfile::TempDir {
    let dir = common::in_memory();
    let (scans, psb) = (dir.path().join("scans"), dir.path().join("psb"));
    std::fs::create_dir(&scans).unwrap();
    std::fs::create_dir(&psb).unwrap();
    if let Some(data) = common::data() {
        // Two models of two categories with what people said of them: a person and glasses, or the smallest animal and hand.
        let [first, second] = if common::every_case() { ["4", "60"] } else { ["398", "200"] };
        let table = std::fs::read_to_string(data.join("psb/models.tsv")).unwrap();
        let chosen = |line: &&str| ["model", first, second].contains(&line.split('\t').next().unwrap());
        let lines: Vec<&str> = table.lines().filter(chosen).collect();
        assert_eq!(lines.len(), 3, "{table}");
        std::fs::write(psb.join("models.tsv"), lines.join("\n") + "\n").unwrap();
        for entry in std::fs::read_dir(data.join("psb")).unwrap().flatten() {
            let name = entry.file_name().into_string().unwrap();
            if [first, second].contains(&name.split(['.', '_']).next().unwrap()) {
                std::fs::copy(entry.path(), psb.join(&name)).unwrap();
            }
        }
        let model = |name: &str| psb.join(format!("{name}.ply"));
        std::fs::copy(model(first), dir.path().join("scan.ply")).unwrap();
        for (person, name) in [(0, "a.seg"), (1, "b.seg")] {
            std::fs::copy(psb.join(format!("{first}_{person}.seg")), dir.path().join(name)).unwrap();
        }
        for name in [first, second] {
            std::fs::copy(model(name), scans.join(format!("{name}.ply"))).unwrap();
        }
    } else {
        let scan = dir.path().join("scan.ply");
        std::fs::rename(common::creature(dir.path(), 12_000, false), &scan).unwrap();
        for (name, parts) in [("a.seg", "4"), ("b.seg", "6")] {
            common::segment(&scan, &["-q", "-k", parts, "-o", common::word(&dir.path().join(name))]);
        }
        for faces in [4_000, 6_000] {
            common::creature(&scans, faces, false);
            let path = common::creature(&psb, faces, false);
            let number = faces / 1000;
            std::fs::rename(path, psb.join(format!("{number}.ply"))).unwrap();
            let mesh = psb.join(format!("{number}.ply"));
            for person in 0..2 {
                let truth = psb.join(format!("{number}_{person}.seg"));
                common::segment(&mesh, &["-q", "-k", "5", "-o", common::word(&truth)]);
            }
        }
        let table = "model\tcategory\n4\tcreature\n6\tcreature\n";
        std::fs::write(psb.join("models.tsv"), table).unwrap();
    }
    for name in ["a.ply", "b.ply"] {
        std::fs::copy(dir.path().join("scan.ply"), dir.path().join(name)).unwrap();
    }
    dir
}

/// The folder of the tour: the scans that it names. One small scan stands in for all but the first, unless every case is asked for.
fn gallery() -> tempfile::TempDir {
    let dir = common::in_memory();
    let scans = [
        ("horse", "real/horse_97k_orig_BE.ply"),
        ("bunny", "real/bun_zipper_orig_ascii.ply"),
        ("lucy", "real/lucy_100k_orig.ply"),
        ("igea", "real/igea.ply"),
        ("dragon", "real/dragon_vrip_orig_ascii.ply"),
        ("head", "real/mri_ch2_head_h.ply"),
    ];
    for (k, (faces, (name, file))) in (4_000..).step_by(1_000).zip(scans).enumerate() {
        let target = dir.path().join(name).with_extension("ply");
        let file = if k == 0 || common::every_case() { file } else { "real/horse_4k.ply" };
        match common::data() {
            Some(data) => drop(std::fs::copy(data.join(file), target).unwrap()),
            None => std::fs::rename(common::creature(dir.path(), faces, false), target).unwrap(),
        }
    }
    dir
}

/// Runs the commands of `name` in `dir`; those that begin as one of `left_out` are not for a test.
fn all_run(name: &str, dir: &tempfile::TempDir, left_out: &[&str]) {
    let program = PathBuf::from(env!("CARGO_BIN_EXE_nystrom-stream"));
    let path = format!("{}:{}", program.parent().unwrap().display(), std::env::var("PATH").unwrap_or_default());
    for (line, command) in commands(name) {
        if left_out.iter().any(|start| command.starts_with(start)) {
            continue;
        }
        let output = Command::new("bash")
            .args(["-euc", &command])
            .current_dir(dir.path())
            .env("PATH", &path)
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{name}, line {line}: {command}\n{told}");
    }
}

#[cfg(unix)]
#[test]
fn the_guides_commands_run() {
    all_run("docs/guide.md", &scene(), &[]);
}

#[cfg(unix)]
#[test]
fn the_recipes_commands_run() {
    let dir = scene();
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nf 1/1 2/2 3/1\nf 1/1 3/2 4/2\n";
    std::fs::write(dir.path().join("textured.obj"), square).unwrap();
    all_run("docs/recipes.md", &dir, &[]);
    let report = std::fs::read_to_string(dir.path().join("sizes.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["measures"].as_array().map(Vec::len), report["parts"].as_array().map(Vec::len));
    // The first part's solid has its faces and its caps, in binary STL.
    let list = std::fs::read_to_string(dir.path().join("solids/parts.json")).unwrap();
    let list: serde_json::Value = serde_json::from_str(&list).unwrap();
    let part = &list["parts"][0];
    let solid = std::fs::read(dir.path().join("solids").join(part["file"].as_str().unwrap())).unwrap();
    let triangles = u32::from_le_bytes(solid[80..84].try_into().unwrap());
    assert_eq!(solid.len(), 84 + 50 * triangles as usize);
    let told = part["faces"].as_u64().unwrap() + part["caps"]["triangles"].as_u64().unwrap();
    assert!(u64::from(triangles) == told && part["caps"]["solid"] == true, "{triangles} of {part}");
}

#[cfg(unix)]
#[test]
fn the_readmes_commands_run() {
    // What builds and tests the program itself is run by continuous integration.
    all_run("README.md", &scene(), &["cargo "]);
}

#[cfg(unix)]
#[test]
fn the_tours_commands_run() {
    all_run("docs/tour.md", &gallery(), &[]);
}

#[test]
fn the_reference_is_that_of_the_definitions() {
    let told = String::from_utf8(common::run(&["man", "--markdown", "-"]).stdout).unwrap();
    assert!(told.contains("## segment") && told.contains("`-k, --parts <K>`"), "{told}");
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/reference.md")).unwrap();
    let renew = "run `cargo run -- man --markdown docs/reference.md` to renew docs/reference.md";
    assert!(told == page, "the page tells of other options than the program: {renew}");
}
