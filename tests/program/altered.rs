//! Work directories that somebody altered: every file cut, lengthened, overwritten and flipped, every value of the manifest
//! replaced, with the manifest's checksums left as they are and with fitting ones. Whatever a command finds, it ends with exit
//! code 0 or 1, without a panic, a signal or a hang, and its message names the file; and where checksums do not fit, labels are
//! never others than before.

use crate::common::{errors, in_memory, ok, program, run, stride, word};
use serde_json::{Value, json};
use std::f64::consts::PI;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Two bodies of `rings` × `sides` quads, some of them cut in two.
fn mesh(path: &Path, rings: usize, sides: usize) {
    let (mut vertices, mut faces) = (String::new(), Vec::new());
    for body in 0..2usize {
        for (i, j) in (0..=rings).flat_map(|i| (0..sides).map(move |j| (i, j))) {
            let (a, b) = (PI * i as f64 / rings as f64, 2. * PI * j as f64 / sides as f64);
            let (x, y) = (3. * body as f64 + a.sin() * b.cos() * (1. + 0.4 * (3. * a).cos()), a.sin() * b.sin());
            let _ = writeln!(vertices, "{x} {y} {}", 1.7 * a.cos());
        }
        for (i, j) in (0..rings).flat_map(|i| (0..sides).map(move |j| (i, j))) {
            let corner = |i: usize, j: usize| body * (rings + 1) * sides + i * sides + j % sides;
            let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
            faces.push(format!("3 {a} {b} {c}"));
            faces.push(format!("3 {a} {c} {d}"));
        }
    }
    let header = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nelement face {}\n\
         property list uchar int vertex_indices\nend_header\n",
        2 * (rings + 1) * sides,
        faces.len()
    );
    std::fs::write(path, header + &vertices + &faces.join("\n") + "\n").unwrap();
}

/// A work directory that is altered, and what is done with it.
struct Subject {
    work: PathBuf,
    /// Commands without `--work-dir`; OUT stands for an output that must hold `labels`.
    commands: Vec<Vec<&'static str>>,
    labels: Vec<u8>,
}

/// Work directories of all kinds of stages over the mesh `mesh`.
fn subjects(dir: &Path, mesh: &Path) -> Vec<Subject> {
    let subject = |name: &str, options: &[&str], cluster: &'static [&'static str]| {
        let (work, labels) = (dir.join(name), dir.join(format!("{name}.seg")));
        ok(&[&["segment", word(mesh), "-o", word(&labels), "-q", "--work-dir", word(&work)], options].concat());
        ok(&["embed", "-q", "--work-dir", word(&work)]);
        let cluster = [&["cluster", "-q", "-o", "OUT"], cluster].concat();
        let others = "export -q -o X.ply/export -q -o X.html/export -q --tree X.json/embed -q/embed -q -d 5/info/verify/merge -q/\
                      rows -q/cluster -q -k 3/segment MESH -q -o X.ply/plot --tree X.svg/plot --eigenvalues X.svg";
        let others = others.split('/').map(|words| words.split(' ').collect());
        Subject {
            work,
            commands: std::iter::once(cluster).chain(others).collect(),
            labels: std::fs::read(labels).unwrap(),
        }
    };
    let means = ["--cluster", "kmeans", "-k", "4"];
    let mut all = vec![
        subject("parts", &[], &[]),
        subject("means", &[&means[..], &["--order", "hilbert"]].concat(), &["--cluster", "kmeans", "-k", "4"]),
    ];
    let work = dir.join("shards");
    ok(&["graph", word(mesh), "-q", "--work-dir", word(&work)]);
    for shard in ["0/2", "1/2"] {
        ok(&["rows", word(mesh), "-q", "--shard", shard, "--work-dir", word(&work)]);
    }
    let commands = ["merge -q", "rows MESH -q --shard 0/2", "info", "verify"].map(|words| words.split(' ').collect());
    all.push(Subject { work, commands: commands.to_vec(), labels: Vec::new() });
    all
}

/// Random numbers that are the same each time.
struct Numbers(u64);

impl Numbers {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((self.0 >> 33) as usize) % end.max(1)
    }
}

/// Damaged versions of a file of `bytes`.
fn damaged(bytes: &[u8], numbers: &mut Numbers) -> Vec<(String, Vec<u8>)> {
    let head = bytes.len().min(128);
    let filled = |value: u8| [&bytes[..head], &vec![value; bytes.len() - head]].concat();
    let mut all = vec![
        ("empty".into(), Vec::new()),
        ("half".into(), bytes[..bytes.len() / 2].to_vec()),
        ("a byte short".into(), bytes[..bytes.len().saturating_sub(1)].to_vec()),
        ("a byte more".into(), [bytes, &[0]].concat()),
        ("pages more".into(), [bytes, &[255; 9000]].concat()),
        ("zeros".into(), filled(0)),
        ("ones".into(), filled(255)),
    ];
    if bytes.starts_with(b"\x93NUMPY") {
        let text = std::str::from_utf8(&bytes[10..128]).unwrap();
        let (start, end) = (text.find('(').unwrap(), text.find(')').unwrap() + 1);
        let rows: u64 = text[start + 1..].split(',').next().unwrap().trim().parse().unwrap();
        let rest = &text[start..end][text[start..end].find(',').unwrap()..];
        let mut shapes = vec!["(0,)".to_string(), "(1,)".into(), "()".into(), "(18446744073709551615,)".into()];
        shapes.extend([
            "(4611686018427387904, 8)".into(),
            format!("({}{rest}", rows.saturating_sub(1)),
            format!("({}{rest}", rows + 1),
        ]);
        for shape in shapes {
            let header = format!("{:<117}\n", format!("{}{shape}, }}", &text[..start]));
            let row = (bytes.len() - 128) / rows.max(1) as usize;
            // Where one row is missing or too many, the data fit.
            let data = match shape == format!("({}{rest}", rows + 1) {
                true => [&bytes[128..], &bytes[bytes.len() - row..]].concat(),
                false => bytes[128..].to_vec(),
            };
            all.push((format!("shape {shape}"), [&bytes[..10], header.as_bytes(), &data].concat()));
        }
    }
    for _ in 0..3 {
        let at = numbers.below(bytes.len());
        let mut flipped = bytes.to_vec();
        flipped[at] ^= 1 << numbers.below(8);
        all.push((format!("byte {at} flipped"), flipped));
    }
    for word in [[255; 4], [0; 4], [255, 255, 255, 127], [0, 0, 128, 255]] {
        let words = (bytes.len() - head) / 4;
        if words > 0 {
            let at = head + 4 * numbers.below(words);
            let mut other = bytes.to_vec();
            other[at..at + 4].copy_from_slice(&word);
            all.push((format!("{word:?} at {at}"), other));
        }
    }
    all
}

/// The paths of all values in `value`, of long lists the first two.
fn places(value: &Value, path: &str, all: &mut Vec<String>) {
    let escaped = |key: &str| key.replace('~', "~0").replace('/', "~1");
    match value {
        Value::Object(fields) => fields.iter().for_each(|(key, value)| {
            all.push(format!("{path}/{}", escaped(key)));
            places(value, &format!("{path}/{}", escaped(key)), all);
        }),
        Value::Array(items) => items.iter().take(2).enumerate().for_each(|(k, value)| {
            all.push(format!("{path}/{k}"));
            places(value, &format!("{path}/{k}"), all);
        }),
        _ => {}
    }
}

/// Manifests with one value replaced or one file renamed.
fn forged(manifest: &Value, numbers: &mut Numbers) -> Vec<(String, Vec<u8>)> {
    let values = [
        json!(null),
        json!(0),
        json!(-1),
        json!(1u64 << 63),
        json!(u64::MAX),
        json!(1e308),
        json!(""),
        json!([]),
        json!({}),
        json!("../../../etc/passwd"),
        json!("x\u{1b}[31m\n"),
        json!(true),
    ];
    let (mut at, mut all) = (Vec::new(), Vec::new());
    places(manifest, "", &mut at);
    for place in &at {
        for _ in 0..2 {
            let value = &values[numbers.below(values.len())];
            let mut other = manifest.clone();
            *other.pointer_mut(place).unwrap() = value.clone();
            all.push((format!("{place} = {value}"), other.to_string().into_bytes()));
        }
        let (parent, name) = place.rsplit_once('/').unwrap();
        if parent.ends_with("/files") {
            let names = [
                "../x.npy",
                "/etc/passwd",
                "manifest.json",
                "lock",
                "..",
                "",
                "a/b",
                "x\u{1b}[31m\n",
                "distances.npy\0",
            ];
            let mut other = manifest.clone();
            let files = other.pointer_mut(parent).unwrap().as_object_mut().unwrap();
            let record = files.remove(name).unwrap();
            files.insert(names[numbers.below(names.len())].into(), record);
            all.push((format!("{place} renamed"), other.to_string().into_bytes()));
        }
    }
    all
}

/// The files in `folder` and in those within it, but locks, in order.
fn files_in(folder: &Path) -> Vec<String> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let (path, name) = (entry.as_ref().unwrap().path(), entry.unwrap().file_name().into_string().unwrap());
        if path.is_dir() {
            all.extend(files_in(&path).into_iter().map(|file| format!("{name}/{file}")));
        } else if name != "lock" {
            all.push(name);
        }
    }
    all.sort();
    all
}

/// Has the manifest in `work` tell the sizes and checksums that its files have.
fn fit(work: &Path) {
    let path = work.join("manifest.json");
    let Ok(mut manifest) = serde_json::from_slice::<Value>(&std::fs::read(&path).unwrap()) else { return };
    for stage in manifest["stages"].as_object_mut().unwrap().values_mut() {
        for (name, record) in stage["files"].as_object_mut().unwrap() {
            if let Ok(bytes) = std::fs::read(work.join(name)) {
                *record = json!({"bytes": bytes.len(), "xxh3": format!("{:016x}", xxhash_rust::xxh3::xxh3_64(&bytes))});
            }
        }
    }
    std::fs::write(path, manifest.to_string()).unwrap();
}

/// What a program says and how it ends, `None` where it does not.
fn outcome(words: &[String]) -> Option<Output> {
    let mut child = program().args(words).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = child.stderr.take().unwrap();
    let reader = std::thread::spawn(move || {
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut said, &mut bytes).map(|_| bytes)
    });
    let end = Instant::now() + Duration::from_secs(120);
    let status = loop {
        match child.try_wait().unwrap() {
            Some(status) => break status,
            None if Instant::now() > end => {
                child.kill().unwrap();
                return None;
            }
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    };
    Some(Output { status, stdout: Vec::new(), stderr: reader.join().unwrap().unwrap() })
}

/// One altered file.
struct Case<'a> {
    subject: &'a Subject,
    file: String,
    what: String,
    bytes: Vec<u8>,
    fits: bool,
}

impl Case<'_> {
    /// Runs command number `k` on a copy; says what is wrong with how it ends.
    fn wrong(&self, k: usize, mesh: &Path, folder: &Path) -> Option<String> {
        let work = folder.join("work");
        for file in files_in(&self.subject.work) {
            std::fs::create_dir_all(work.join(&file).parent().unwrap()).unwrap();
            std::fs::copy(self.subject.work.join(&file), work.join(&file)).unwrap();
        }
        std::fs::write(work.join("lock"), []).unwrap();
        std::fs::write(work.join(&self.file), &self.bytes).unwrap();
        if self.fits {
            let manifests = files_in(&work).into_iter().filter(|file| file.ends_with("manifest.json"));
            manifests.for_each(|file| fit(work.join(file).parent().unwrap()));
        }
        let commands = &self.subject.commands;
        let command = &commands[k % commands.len()];
        let full = |word: &&str| match *word {
            "MESH" => word_of(mesh),
            "OUT" => word_of(&folder.join("out.seg")),
            word if word.starts_with("X.") => word_of(&folder.join(word)),
            word => word.to_string(),
        };
        let mut words: Vec<String> = command.iter().map(full).collect();
        words.extend(["--work-dir".into(), word_of(&work)]);
        let about = format!("{} {}, checksums fit: {}, {command:?}", self.file, self.what, self.fits);
        let Some(output) = outcome(&words) else { return Some(format!("{about}: does not end")) };
        let said = errors(&output);
        let own = [word_of(&work), word_of(mesh)].iter().any(|path| said.contains(path.as_str()));
        let fine = match output.status.code() {
            Some(0) if !self.fits && !self.file.ends_with("manifest.json") && command.contains(&"OUT") => {
                std::fs::read(folder.join("out.seg")).unwrap() == self.subject.labels
            }
            Some(0) => true,
            Some(1) => own || said.contains("mesh"),
            _ => false,
        };
        let calm = !said.contains("panicked") && !said.contains("internal error");
        let plain = said.chars().all(|c| c == '\n' || !c.is_control());
        (!(fine && calm && plain)).then(|| format!("{about}: {:?}: {said}", output.status.code()))
    }
}

fn word_of(path: &Path) -> String {
    word(path).to_string()
}

#[test]
fn an_altered_work_directory_is_made_anew_or_refused() {
    let dir = in_memory();
    let mesh_path = dir.path().join("mesh.ply");
    mesh(&mesh_path, 16, 14);
    let subjects = subjects(dir.path(), &mesh_path);
    let mut numbers = Numbers(1);
    let mut cases = Vec::new();
    for subject in &subjects {
        for file in files_in(&subject.work) {
            let bytes = std::fs::read(subject.work.join(&file)).unwrap();
            for (k, (what, bytes)) in damaged(&bytes, &mut numbers).into_iter().enumerate() {
                // Without fitting checksums one case in three: they all end in the same place.
                for fits in [true, false].into_iter().take(if k % 3 == 0 { 2 } else { 1 }) {
                    cases.push(Case { subject, file: file.clone(), what: what.clone(), bytes: bytes.clone(), fits });
                }
            }
            if file == "manifest.json" {
                let manifest: Value = serde_json::from_slice(&bytes).unwrap();
                for (what, bytes) in forged(&manifest, &mut numbers) {
                    cases.push(Case { subject, file: file.clone(), what, bytes, fits: false });
                }
            }
        }
    }
    assert!(cases.len() > 2000, "{}", cases.len());
    // Eleven shares no factor with the 14 or 4 commands that cases take in turn.
    let stride = stride(11);
    let (next, wrong) = (Mutex::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(|| {
                loop {
                    let k = {
                        let mut next = next.lock().unwrap();
                        *next += stride;
                        *next - stride
                    };
                    let Some(case) = cases.get(k) else { return };
                    let folder = dir.path().join(format!("case-{k}"));
                    if let Some(problem) = case.wrong(k, &mesh_path, &folder) {
                        wrong.lock().unwrap().push(problem);
                    }
                    let _ = std::fs::remove_dir_all(folder);
                }
            });
        }
    });
    let wrong = wrong.into_inner().unwrap();
    assert!(wrong.is_empty(), "{} of {} cases:\n{}", wrong.len(), cases.len() / stride, wrong.join("\n"));
}

/// Meshes of long triangles are decided on shorter ones, in folders within the work directory.
#[test]
fn an_altered_refinement_is_made_anew_or_refused() {
    let dir = in_memory();
    let mesh_path = dir.path().join("mesh.ply");
    mesh(&mesh_path, 8, 7);
    let (work, labels) = (dir.path().join("whole"), dir.path().join("whole.seg"));
    ok(&["segment", word(&mesh_path), "-o", word(&labels), "-q", "--work-dir", word(&work)]);
    let commands = ["cluster -q -o OUT", "segment MESH -q -o OUT", "export -q -o X.html", "verify"];
    let commands = commands.map(|words| words.split(' ').collect()).to_vec();
    let subject = Subject { work, commands, labels: std::fs::read(labels).unwrap() };
    let (mut numbers, mut wrong, mut cases) = (Numbers(2), Vec::new(), 0);
    for file in files_in(&subject.work) {
        let bytes = std::fs::read(subject.work.join(&file)).unwrap();
        for (what, bytes) in damaged(&bytes, &mut numbers).into_iter().step_by(9) {
            let case = Case { subject: &subject, file: file.clone(), what, bytes, fits: cases % 2 == 0 };
            let folder = dir.path().join(format!("case-{cases}"));
            wrong.extend(case.wrong(cases / 2, &mesh_path, &folder));
            let _ = std::fs::remove_dir_all(folder);
            cases += 1;
        }
    }
    assert!(cases > 60 && wrong.is_empty(), "{} of {cases} cases:\n{}", wrong.len(), wrong.join("\n"));
}

/// Sums of rows in a manifest were added up without a look at them.
#[test]
fn sums_that_no_rows_have_are_refused() {
    let dir = in_memory();
    let (mesh_path, work) = (dir.path().join("mesh.ply"), dir.path().join("work"));
    mesh(&mesh_path, 8, 7);
    let folder = ["--work-dir", word(&work)];
    for words in [vec!["graph", word(&mesh_path)], vec!["rows", "-l", "4"]] {
        ok(&[&words[..], &folder].concat());
    }
    let manifest: Value = serde_json::from_slice(&std::fs::read(work.join("manifest.json")).unwrap()).unwrap();
    for (name, value) in
        [("reached", json!(u64::MAX)), ("reached", json!(10_000)), ("sum", json!(-1.)), ("farthest", json!(1e300))]
    {
        let mut other = manifest.clone();
        *other.pointer_mut(&format!("/stages/rows/facts/rows/1/{name}")).unwrap() = value.clone();
        std::fs::write(work.join("manifest.json"), other.to_string()).unwrap();
        let output = run(&[&["embed", "-d", "3"], &folder[..]].concat());
        let said = errors(&output);
        assert!(output.status.code() == Some(1) && !said.contains("internal"), "{name} = {value}: {said}");
    }
}

/// A name in the manifest was followed out of the work directory.
#[test]
fn files_of_a_manifest_lie_in_its_folder() {
    let dir = in_memory();
    let work = dir.path().join("work");
    std::fs::create_dir(&work).unwrap();
    let stage = json!({"key": "k", "version": 1, "inputs": {}, "files": {"../secret.npy": {"bytes": 1, "xxh3": ""}},
                       "facts": null, "seconds": 0.});
    let manifest = json!({"format": 2, "program": "x", "stages": {"s": stage}});
    std::fs::write(work.join("manifest.json"), manifest.to_string()).unwrap();
    for command in ["verify", "info", "merge", "cluster"] {
        let output = run(&[command, "--work-dir", word(&work)]);
        let said = errors(&output);
        assert_eq!(output.status.code(), Some(1), "{command}: {said}");
        assert!(said.contains("manifest.json") && said.contains("../secret.npy"), "{command}: {said}");
    }
}

/// A manifest that is not UTF-8 was told as a file that cannot be read, without what to do.
#[test]
fn a_manifest_of_any_bytes_is_named_with_what_to_do() {
    let dir = in_memory();
    let work = dir.path().join("work");
    std::fs::create_dir(&work).unwrap();
    for bytes in [&b"{\"format\": \xff"[..], b"{", b"\0"] {
        std::fs::write(work.join("manifest.json"), bytes).unwrap();
        let output = run(&["info", "--work-dir", word(&work)]);
        let said = errors(&output);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("manifest.json") && said.contains("delete the work directory"), "{said}");
    }
}

/// Regression: `verify` called a directory intact whose mesh from standard input, of which it has the only copy, was damaged or
/// gone, and `export` then asked for a mesh or a path that its user never had.
#[test]
fn a_damaged_copy_of_standard_input_is_told() {
    let dir = in_memory();
    let (file, work) = (dir.path().join("x.ply"), dir.path().join("w"));
    mesh(&file, 6, 8);
    let (work, copy, page) = (word(&work), work.join("input"), dir.path().join("x.html"));
    let again = || {
        let words = ["segment", "-", "-k", "2", "-q", "--work-dir", work, "-o", word(&page)];
        let output = program().args(words).stdin(std::fs::File::open(&file).unwrap()).output().unwrap();
        assert!(output.status.success(), "{}", errors(&output));
    };
    again();
    ok(&["verify", work]);
    let whole = std::fs::read(&copy).unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    for (damage, told) in [(Some(flipped), "has another checksum"), (None, "is missing")] {
        match damage {
            Some(bytes) => std::fs::write(&copy, bytes).unwrap(),
            None => std::fs::remove_file(&copy).unwrap(),
        }
        let said = errors(&run(&["verify", work]));
        assert!(said.contains(&format!("{}: {told}", word(&copy))), "{said}");
        assert!(said.contains("(the mesh from standard input); "), "{said}");
        let said = errors(&run(&["export", "--work-dir", work, "-o", word(&page)]));
        assert!(said.contains("repeat the command that read it from standard input"), "{said}");
    }
    // What the messages advise.
    again();
    ok(&["verify", work]);
    assert_eq!(std::fs::read(&copy).unwrap(), whole);
}
