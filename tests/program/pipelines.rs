//! In other people's pipelines: progress for programs, readers that go away, help, completions, man pages, and option
//! combinations that are refused.

use crate::common::{self, errors, ok, program, refused, run, segment, shapes, word};
use serde_json::Value;
use std::io::Read;
use std::process::Stdio;

#[test]
fn progress_for_programs_is_an_event_a_line() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 20_000, false);
    let output = run(&["segment", word(&mesh), "--progress", "json", "-k", "4"]);
    assert!(output.status.success());
    let events: Vec<Value> = errors(&output).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    for (stage, total) in [("graph", None), ("rows", Some(120)), ("boundaries", None)] {
        let of: Vec<&Value> = events.iter().filter(|event| event["stage"] == stage).collect();
        let (first, last) = (of[0], of[of.len() - 1]);
        assert!(of.len() >= 2 && first["done"] == 0 && last["done"] == last["total"], "{of:?}");
        assert!(of.windows(2).all(|w| w[0]["done"].as_u64() <= w[1]["done"].as_u64()), "{of:?}");
        assert!(last["seconds"].as_f64().unwrap() > 0. && total.is_none_or(|total| last["total"] == total));
    }
    for (words, lines) in [(&["--progress", "none"][..], 0), (&["--progress", "lines"], 9)] {
        let output = run(&[&["segment", word(&mesh)], words].concat());
        assert_eq!(errors(&output).lines().count().min(lines), lines, "{}", errors(&output));
    }
    assert!(run(&["segment", word(&mesh), "--progress", "none"]).stderr.is_empty());
    assert_eq!(run(&["segment", word(&mesh), "--progress", "json", "-q"]).status.code(), Some(2));
}

#[test]
fn a_reader_that_goes_away_is_no_matter_for_words() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 20_000, false);
    for words in [&["segment", word(&mesh), "-q", "-o", "-"][..], &["completions", "bash"]] {
        let mut child = program().args(words).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut out = child.stdout.take().unwrap();
        if words[0] == "segment" {
            out.read_exact(&mut [0; 3]).unwrap();
        }
        drop(out);
        let output = child.wait_with_output().unwrap();
        assert!(output.stderr.is_empty(), "{}", errors(&output));
        assert!(matches!(output.status.code(), Some(0 | 1)), "{:?}", output.status);
    }
    let left: Vec<_> = std::fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["creature_20000.ply"]);
}

#[test]
fn help_is_short_or_long_and_without_colours_on_request() {
    let text = |words: &[&str]| {
        let output = program().args(words).env("NO_COLOR", "1").env("CLICOLOR_FORCE", "1").output().unwrap();
        assert!(output.status.success() && output.stderr.is_empty(), "{words:?}");
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(!text.contains('\u{1b}'), "{words:?}");
        text
    };
    let commands = ["segment", "graph", "rows", "embed", "cluster", "export"];
    for command in commands {
        let (short, long) = (text(&[command, "-h"]), text(&[command, "--help"]));
        assert!(short.len() < long.len() && long.contains("Examples"), "{command}");
        assert!(!short.contains("Examples"), "{command}");
    }
    let long = text(&["segment", "--help"]);
    for heading in ["Many meshes:", "Parts:", "Distances:", "Embedding (kmeans and two-means):", "Running:"] {
        assert!(long.contains(&format!("\n{heading}\n")), "{heading}");
    }
    assert!(!text(&["segment", "-h"]).contains("--kernel"), "what few need is in the long help");
    assert!(text(&["--help"]).contains("Exit codes"));
}

#[test]
fn misspelt_options_are_suggested() {
    for (words, meant) in [
        (&["segment", "x.ply", "--landmark", "3"][..], "--landmarks"),
        (&["segment", "x.ply", "--ouput", "y.ply"], "--output"),
        (&["segment", "x.ply", "--cluster", "kmean"], "kmeans"),
        (&["sgment", "x.ply"], "segment"),
    ] {
        refused(words, 2, meant);
    }
}

#[test]
fn combinations_that_would_be_ignored_are_refused() {
    let dir = common::in_memory();
    let mesh = shapes::dumbbell().write(dir.path());
    let mesh = word(&mesh);
    for (words, told) in [
        (&["--kernel", "gaussian"][..], "--kernel can only be used with --cluster kmeans or two-means"),
        (&["--sigma", "1"], "--sigma can only be used with --cluster kmeans or two-means"),
        (&["--normalise", "none"], "--normalise can only be used with --cluster kmeans or two-means"),
        (&["--no-unit-rows"], "--no-unit-rows can only be used with --cluster kmeans or two-means"),
        (
            &["--cluster", "kmeans", "-k", "3", "--decision", "single"],
            "--decision can only be used with --cluster parts",
        ),
        (&["--cluster", "two-means", "--detail", "0.5"], "--detail can only be used with --cluster parts"),
        (
            &["--cluster", "kmeans", "--parts-range", "3..4"],
            "--parts-range: K-means needs an exact number of parts; give -k",
        ),
        (&["-k", "0"], "-k: 0 parts; choose at least 1"),
        (&["-k", "3", "--detail", "0.5"], "cannot be used with"),
        (&["--quiet", "--progress", "json"], "cannot be used with"),
        (&["--delta", "0.1"], "--delta can only be used with --metric paper"),
    ] {
        refused(&[&["segment", mesh], words].concat(), 2, told);
    }
    // These were taken without a word, and had no effect.
    let labels = ["evaluate", "a.seg", "--truth", "b.seg", "--plot", "x.svg"];
    let (too_many, few) = (["plan", mesh, "-k", "100000"], format!("{mesh}: has"));
    for (words, code, told) in [
        (&labels[..], 2, "--plot can only be used with --benchmark"),
        (&["evaluate", "--matches", "m.npy", "--mesh", mesh, "--no-cuts"], 2, "cannot be used with"),
        (&["quality", mesh, "--seeds", "3"], 2, "--seeds can only be used with --compare"),
        (
            &["quality", mesh, "--nodes", "vertices", "--metric", "paper"],
            2,
            "--metric can only be used with --nodes faces",
        ),
        (&["quality", mesh, "--nodes", "vertices", "--eta", "0.1"], 2, "--eta can only be used with --nodes faces"),
        (
            &["quality", mesh, "--gamma-kernel", "gaussian"],
            2,
            "--gamma-kernel can only be used with --sampling cholesky, greedy or pooled-greedy",
        ),
        (&["sequence", mesh, "-o", "x.npy", "--ply-form", "ascii"], 2, "--ply-form requires a .ply output"),
        (&["sequence", mesh, "--compare", "--order", "bfs"], 2, "--order requires an output"),
        (
            &["correspond", mesh, mesh, "-o", "x.npy", "--colour-by", "parts"],
            2,
            "--colour-by can only be used with --colours or --picture",
        ),
        // It was looked for as a file.
        (&["correspond", "-", mesh, "-o", "x.npy"], 1, "-: standard input is not read here; give a file"),
        // As segment refuses it; the file that was named was one of the program's own.
        (&too_many, 1, &few),
    ] {
        let output = program().current_dir(dir.path()).args(words).output().unwrap();
        assert_eq!(output.status.code(), Some(code), "{words:?}: {}", errors(&output));
        assert!(errors(&output).contains(told), "{words:?}: {}", errors(&output));
    }
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "no work was done");
}

#[test]
fn completions_and_man_pages_know_every_option() {
    let dir = common::in_memory();
    // Regression: the folder was shown as optional.
    assert!(String::from_utf8_lossy(&run(&["help", "man"]).stdout).contains("man <DIR>"));
    assert!(run(&["man"]).status.code() == Some(2) && errors(&run(&["man"])).contains("DIR: missing"));
    ok(&["man", word(&dir.path().join("man"))]);
    for command in ["segment", "graph", "rows", "embed", "cluster", "export", "evaluate", "picture", "demo"] {
        let help = String::from_utf8(run(&[command, "--help"]).stdout).unwrap();
        let page = std::fs::read_to_string(dir.path().join(format!("man/nystrom-stream-{command}.1"))).unwrap();
        let page = page.replace("\\-", "-");
        let options: Vec<&str> = help
            .split_whitespace()
            .filter(|word| word.starts_with("--") && word[2..].chars().all(|c| c.is_ascii_lowercase() || c == '-'))
            .filter(|word| word.len() > 4)
            .collect();
        assert!(options.len() > 5 && options.iter().all(|option| page.contains(option)), "{command}: {options:?}");
    }
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let output = run(&["completions", shell]);
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success() && text.contains("parts-range") && text.contains("work-dir"), "{shell}");
    }
}

/// Regression: the identity of the file was read from the pipe first, and nothing was left.
#[cfg(unix)]
#[test]
fn a_pipe_is_read_once() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 2_000, false);
    let (pipe, out, direct) = (dir.path().join("pipe.ply"), dir.path().join("x.seg"), dir.path().join("y.seg"));
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for words in [&["segment", word(&pipe), "-q", "-o", word(&out)][..], &["info", word(&pipe)]] {
        let (from, to) = (mesh.clone(), pipe.clone());
        let writer = std::thread::spawn(move || std::fs::copy(from, to).unwrap());
        ok(words);
        writer.join().unwrap();
    }
    segment(&mesh, &["-q", "-o", word(&direct)]);
    assert!(std::fs::read(&out).unwrap() == std::fs::read(&direct).unwrap());
    refused(&["plan", word(&pipe)], 1, "is a pipe");
}

/// All rows had the first mesh's.
#[test]
fn numbers_of_landmarks_of_embeddings_are_of_all_meshes() {
    let dir = common::in_memory();
    let small = dir.path().join("small.off");
    std::fs::write(&small, "OFF 4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n").unwrap();
    let large = common::creature(dir.path(), 500, false);
    for meshes in [[&small, &large], [&large, &small]] {
        let [a, b] = meshes.map(|mesh| word(mesh));
        let output = ok(&["quality", a, b, "--embedding", "-l", "8", "-q"]);
        let text = String::from_utf8(output.stdout).unwrap();
        assert!(text.lines().nth(1).is_some_and(|row| row.starts_with("  4-8 ")), "{text}");
    }
}

/// Regression: with a folder named `-`, its meshes were cut instead of standard input; `export --tree -` wrote a file.
#[test]
fn a_dash_is_never_a_file_or_a_folder() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 1_000, false);
    let (odd, work) = (dir.path().join("-"), dir.path().join("w"));
    std::fs::create_dir(&odd).unwrap();
    std::fs::copy(&mesh, odd.join("one.ply")).unwrap();
    let piped = |words: &[&str]| {
        let input = std::fs::File::open(&mesh).unwrap();
        program().args(words).current_dir(dir.path()).stdin(input).output().unwrap()
    };
    let cut = piped(&["segment", "-", "-k", "2", "-q"]);
    assert!(cut.status.success() && cut.stdout.starts_with(b"ply"), "{}", errors(&cut));
    assert_eq!(std::fs::read_dir(&odd).unwrap().count(), 1);
    let told = piped(&["info", "-"]);
    assert!(String::from_utf8_lossy(&told.stdout).starts_with("3528 faces"), "{told:?}");
    segment(&mesh, &["-q", "-k", "2", "--work-dir", word(&work), "-o", word(&dir.path().join("x.seg"))]);
    std::fs::remove_dir_all(&odd).unwrap();
    let tree = piped(&["export", "--work-dir", "w", "--tree", "-"]);
    assert!(serde_json::from_slice::<Value>(&tree.stdout).unwrap()["unions"].is_array(), "{tree:?}");
    for option in ["--tree", "--edits", "--names"] {
        let refused = piped(&["cluster", "--work-dir", "w", option, "-", "-o", "x.csv"]);
        assert!(errors(&refused).contains("standard input is not read here"), "{option}: {}", errors(&refused));
    }
    assert!(!odd.exists());
}
