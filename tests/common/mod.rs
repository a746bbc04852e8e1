//! What the integration tests share: the test meshes, small meshes made in code, and running the program.
#![allow(dead_code)]

pub mod oracle;
pub mod shapes;
pub mod squares;

use nystrom_stream::apps::creature::{Creature, Options};
use nystrom_stream::mesh::Mesh;
use nystrom_stream::store::Run;
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Ply};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The folder of unpacked test meshes (`real/`, `flavour/`, `nasty/`, …), or `None`, saying so,
/// where they are missing. `NYSTROM_STREAM_DATA` names the packed folder if it is elsewhere;
/// with `NYSTROM_STREAM_REQUIRE_DATA` set, missing meshes are a failure.
pub fn data() -> Option<PathBuf> {
    static DATA: std::sync::OnceLock<Option<PathBuf>> = std::sync::OnceLock::new();
    let found = DATA.get_or_init(unpack);
    if found.is_none() {
        assert!(std::env::var_os("NYSTROM_STREAM_REQUIRE_DATA").is_none(), "no test meshes in {:?}", packed());
        eprintln!("skipped: no test meshes");
    }
    found.clone()
}

/// The packed folder, with `MANIFEST.tsv` and `unpack`.
pub fn packed() -> PathBuf {
    std::env::var_os("NYSTROM_STREAM_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from)
}

fn unpack() -> Option<PathBuf> {
    let script = packed().join("unpack");
    if !script.is_file() {
        return None;
    }
    let target = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("target"), PathBuf::from);
    let folder = target.join("test-data");
    std::fs::create_dir_all(&folder).ok()?;
    // Test binaries may run side by side: the first unpacks, the others wait.
    let lock = std::fs::File::create(target.join("test-data.lock")).ok()?;
    lock.lock().ok()?;
    let done = Command::new("bash").arg(script).arg(&folder).status().ok()?.success();
    done.then_some(folder)
}

/// Whether tests go through every case, as in continuous integration, where `NYSTROM_STREAM_EVERY_CASE` is set. Otherwise they
/// leave out cases that are like others and take long.
pub fn every_case() -> bool {
    std::env::var_os("NYSTROM_STREAM_EVERY_CASE").is_some()
}

/// Of many cases that are alike, one in `usual` is taken, or all by [`every_case`]. Give a number that shares no factor with the cycles
/// that cases run through, so that every kind still has its turn.
pub fn stride(usual: usize) -> usize {
    if every_case() { 1 } else { usual }
}

/// The vertices and triangles of a mesh.
pub fn arrays(mesh: &Mesh) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let points = (0..mesh.positions.len() as u32).map(|v| mesh.positions.get(v)).collect();
    let face = |f| mesh.faces.with(f, |corners| corners.to_vec().try_into().expect("a triangle"));
    (points, (0..mesh.faces.len()).map(face).collect())
}

/// A folder for small files, in memory where there is room. Whatever is to last is synced to the disk, and where a test makes hundreds of
/// work directories it waits for that ten times as long as it computes.
pub fn in_memory() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    let has_room = fs4::available_space(memory).is_ok_and(|free| free > 1 << 30);
    let folder = if has_room { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
    folder.unwrap()
}

/// The program, ready for arguments.
pub fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_nystrom-stream"))
}

/// Runs the program with `words`.
pub fn run(words: &[&str]) -> Output {
    program().args(words).output().expect("the program starts")
}

/// Runs the program with `words`, which must succeed.
#[track_caller]
pub fn ok(words: &[&str]) -> Output {
    let output = run(words);
    assert!(output.status.success(), "{words:?}: {}", errors(&output));
    output
}

/// What the program prints on standard output, as JSON, when run with `words`; it must succeed.
#[track_caller]
pub fn json(words: &[&str]) -> serde_json::Value {
    serde_json::from_slice(&ok(words).stdout).unwrap_or_else(|error| panic!("{words:?}: {error}"))
}

/// Runs the program with `words`, which it must refuse with `code` and a message that contains `part`; returns the message.
#[track_caller]
pub fn refused(words: &[&str], code: i32, part: &str) -> String {
    let output = run(words);
    let told = errors(&output);
    assert!(output.status.code() == Some(code) && told.contains(part), "{words:?}: {:?}: {told}", output.status);
    told
}

/// Standard error as text.
pub fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Runs `segment MESH` with `words`, which must succeed and say nothing on standard error but notes.
pub fn segment(mesh: &Path, words: &[&str]) -> Output {
    let output = program().arg("segment").arg(mesh).args(words).output().expect("the program starts");
    assert!(output.status.success(), "segment {} {words:?}: {}", mesh.display(), errors(&output));
    output
}

/// Writes a creature of at least `faces` faces to `folder` and returns its path.
pub fn creature(folder: &Path, faces: u64, shuffle: bool) -> PathBuf {
    let path = folder.join(format!("creature_{faces}.ply"));
    let creature = Creature::new(&Options { faces, shuffle, ..Options::default() }).unwrap();
    creature.write_ply(&path, &Run::new(&())).unwrap();
    path
}

/// The reference reader's view of a PLY; `None` where it is too strict for the file.
pub fn reference(path: &Path) -> Option<Ply<DefaultElement>> {
    let mut file = std::io::BufReader::new(std::fs::File::open(path).ok()?);
    Parser::<DefaultElement>::new().read_ply(&mut file).ok()
}

/// Asserts that `b` is `a` with faces at `places` and vertices at `numbers`.
pub fn assert_rearranged(name: &str, a: &Mesh, b: &Mesh, places: &[u32], numbers: &[u32]) {
    assert_eq!((a.positions.len(), a.faces.len()), (b.positions.len(), b.faces.len()), "{name}");
    for v in 0..a.positions.len() as u32 {
        let (p, q) = (a.positions.get(v), b.positions.get(numbers[v as usize]));
        assert!((0..3).all(|k| p[k] == q[k] || p[k].is_nan() && q[k].is_nan()), "{name}: vertex {v}: {p:?} {q:?}");
    }
    for f in 0..a.faces.len() {
        let expected: Vec<u32> = a.faces.with(f, |corners| corners.iter().map(|&v| numbers[v as usize]).collect());
        assert_eq!(b.faces.with(places[f] as usize, <[u32]>::to_vec), expected, "{name}: face {f}");
    }
}

/// Whether programs that are started here ignore interrupts, as this process does if a script started it in the
/// background: then they cannot be interrupted.
pub fn interrupts_are_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let signals = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    let ignored = signals & (1 << (2 - 1)) != 0;
    if ignored {
        eprintln!("skipped: interrupts are ignored here");
    }
    ignored
}

/// The names in `folder`, sorted, but for the hidden folder in which a batch says what made its outputs.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.retain(|name| name != ".nystrom-stream");
    names.sort();
    names
}

/// The words of a path.
pub fn word(path: &Path) -> &str {
    path.to_str().expect("a path in Unicode")
}
