//! With a small budget the program restarts itself, so that the allocator returns memory at once: what is resident then
//! stays near the budget, and nobody notices the restart otherwise.
#![cfg(target_os = "linux")]

use crate::common::{self, errors, program, shapes, word};
use std::ffi::OsStr;
use std::io::Write;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A variable that the program sets for its second start.
const SET: &str = "MIMALLOC_PURGE_DELAY=0";

/// The program without what the environment of the tests says about the allocator.
fn unconfigured(mut command: Command) -> Command {
    command.env_remove("MIMALLOC_PURGE_DELAY").env_remove("MIMALLOC_ALLOW_THP");
    command
}

/// Whether a process restarts within a minute.
fn has_restarted(child: &mut Child) -> bool {
    let environment = format!("/proc/{}/environ", child.id());
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() && begun.elapsed() < Duration::from_secs(60) {
        let variables = std::fs::read(&environment).unwrap_or_default();
        if variables.split(|byte| *byte == 0).any(|variable| variable == SET.as_bytes()) {
            return true;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    false
}

/// The greatest number of kilobytes of anonymous memory that was resident while a process ran, by samples.
fn most_resident(child: &mut Child) -> u64 {
    let status = format!("/proc/{}/status", child.id());
    let mut most = 0;
    while child.try_wait().unwrap().is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("RssAnon:"));
        let now = line.and_then(|line| line.trim().strip_suffix(" kB")?.parse().ok()).unwrap_or(0);
        most = most.max(now);
        std::thread::sleep(Duration::from_millis(1));
    }
    most
}

/// Regression: 65 to 81 MB, freed memory that the allocator kept.
#[test]
fn resident_memory_stays_near_a_small_budget() {
    let dir = common::in_memory();
    let mesh = common::creature(dir.path(), 400_000, false);
    for (cluster, budget, limit) in [(&["-k", "6"][..], "32M", 56), (&["--cluster", "components"], "16M", 28)] {
        let mut child = program()
            .args(["segment", word(&mesh), "-q", "--threads", "2", "--max-memory", budget])
            .args(cluster)
            .args(["-o", word(&dir.path().join("x.seg"))])
            .spawn()
            .unwrap();
        let most = most_resident(&mut child) >> 10;
        assert!(child.wait().unwrap().success());
        assert!(most > 4 && most < limit, "{most} MiB resident with {budget} and {cluster:?}");
    }
}

#[test]
fn a_restart_keeps_names_input_exit_codes_and_process() {
    let dir = common::in_memory();
    let mesh = shapes::dumbbell().write(dir.path());
    let small = ["--max-memory", "16M", "-q"];
    // Through a link of another name, from standard input, to a file whose name is no Unicode.
    let link = dir.path().join("cut");
    std::os::unix::fs::symlink(env!("CARGO_BIN_EXE_nystrom-stream"), &link).unwrap();
    let odd = dir.path().join(OsStr::from_bytes(b"\xff\xfe.seg"));
    let mut child = unconfigured(Command::new(&link))
        .args(["segment", "-"])
        .args(small)
        .arg("-o")
        .arg(&odd)
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    assert!(has_restarted(&mut child), "the environment sets {SET}");
    child.stdin.take().unwrap().write_all(&std::fs::read(&mesh).unwrap()).unwrap();
    assert!(child.wait().unwrap().success());
    let plain = dir.path().join("plain.seg");
    common::segment(&mesh, &["-q", "-o", word(&plain)]);
    assert!(std::fs::read(&odd).unwrap() == std::fs::read(&plain).unwrap());

    for (words, code) in [(&["segment", "missing.ply"][..], 1), (&["segment", word(&mesh), "--cluster", "kmeans"], 2)] {
        let output = unconfigured(Command::new(&link)).args(words).args(small).output().unwrap();
        assert_eq!(output.status.code(), Some(code), "{}", errors(&output));
    }

    // A signal to the process that was started reaches the program, which removes its folder.
    let tmp = dir.path().join("tmp");
    std::fs::create_dir(&tmp).unwrap();
    let mut child = unconfigured(program())
        .args(["segment", "-", "-o", word(&plain), "--tmp", word(&tmp)])
        .args(small)
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let entries = || std::fs::read_dir(&tmp).unwrap().count();
    while child.try_wait().unwrap().is_none() && entries() == 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(has_restarted(&mut child));
    let id = child.id().to_string();
    assert!(Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
    let input = child.stdin.take();
    let output = child.wait_with_output().unwrap();
    drop(input);
    assert_eq!((output.status.signal(), errors(&output).trim_end()), (Some(15), "nystrom-stream: interrupted"));
    assert_eq!(entries(), 0);
}

#[test]
fn a_program_that_cannot_restart_runs_as_it_is() {
    let dir = common::in_memory();
    let mesh = shapes::dumbbell().write(dir.path());
    let run = |mut command: Command, out: &str| {
        let out = dir.path().join(out);
        let words = ["segment", word(&mesh), "--max-memory", "16M", "-q", "-o", word(&out)];
        let output = command.args(words).output().unwrap();
        assert!(output.status.success(), "{command:?}: {}", errors(&output));
        std::fs::read(out).unwrap()
    };
    let expected = run(unconfigured(program()), "expected.seg");

    // Its file is deleted before it starts. A copy could still be open for writing in a process that another test starts.
    let beside = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let name = beside.path().join("name");
    std::fs::hard_link(env!("CARGO_BIN_EXE_nystrom-stream"), &name).unwrap();
    let mut deleted = unconfigured(Command::new("sh"));
    let script = r#"exec 3< "$0"; rm "$0"; exec /proc/self/fd/3 "$@""#;
    deleted.args(["-c", script, word(&name)]);
    assert!(run(deleted, "deleted.seg") == expected && !name.exists());

    // Regression: the dynamic loader, whose file the process has here, was started again and looked for a program
    // called `segment`: exit code 127.
    let loader = Path::new("/lib64/ld-linux-x86-64.so.2");
    if cfg!(all(target_env = "gnu", target_arch = "x86_64")) && loader.exists() {
        let mut loaded = unconfigured(Command::new(loader));
        loaded.arg(env!("CARGO_BIN_EXE_nystrom-stream"));
        assert!(run(loaded, "loaded.seg") == expected);
    }
}
