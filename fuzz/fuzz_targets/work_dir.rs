//! Whole work directories, altered: bytes are edits of the files of a directory that cut a small creature. Each edit takes
//! six bytes: file, kind, place (2), value (2). What the same cut makes of it are the labels of an unharmed directory, or
//! an error.
#![no_main]

#[path = "common.rs"]
mod common;

use libfuzzer_sys::{Corpus, fuzz_target};
use nystrom_stream::{Mesh, Segmenter};
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

struct Whole {
    mesh: Mesh,
    files: Vec<(PathBuf, Vec<u8>)>,
    labels: Vec<u32>,
}

fn segmenter(work: &Path) -> Segmenter {
    Segmenter::new().parts(4).landmarks(4).ensemble_size(1).threads(1).memory(common::BUDGET).work_dir(work)
}

static WHOLE: LazyLock<Whole> = LazyLock::new(|| {
    let place = common::folder().join("whole");
    let mesh = Mesh::creature(300).expect("a creature");
    let labels = segmenter(&place).run(&mesh).expect("a cut").labels().to_vec();
    let mut files: Vec<(PathBuf, Vec<u8>)> = std::fs::read_dir(&place)
        .expect("its files")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.is_file())
        .map(|path| (path.clone(), std::fs::read(&path).expect("its bytes")))
        .collect();
    files.sort();
    Whole { mesh, files, labels }
});

fuzz_target!(|data: &[u8]| -> Corpus {
    if data.len() < 6 || data.len() > 60 {
        return Corpus::Reject;
    }
    let whole = &*WHOLE;
    let place = common::folder().join("altered");
    let _ = std::fs::remove_dir_all(&place);
    std::fs::create_dir_all(&place).expect("a folder");
    let mut files = whole.files.clone();
    for edit in data.chunks_exact(6) {
        let (path, bytes) = &mut files[usize::from(edit[0]) % whole.files.len()];
        let at = usize::from(u16::from_le_bytes([edit[2], edit[3]])) % bytes.len().max(1);
        match edit[1] % 6 {
            0 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = edit[4]),
            1 => bytes.truncate(at),
            2 => bytes.extend(std::iter::repeat_n(edit[4], usize::from(edit[5]))),
            3 => drop(bytes.splice(at..at, [edit[4]; 1])),
            4 => drop(bytes.drain(at..(at + usize::from(edit[4])).min(bytes.len()))),
            _ => path.set_file_name("gone"),
        }
    }
    for (path, bytes) in &files {
        std::fs::write(place.join(path.file_name().expect("a name")), bytes).expect("the file is written");
    }
    match segmenter(&place).run(&whole.mesh) {
        Ok(cut) => assert_eq!(cut.labels(), whole.labels),
        Err(error) => common::check(&error),
    }
    Corpus::Keep
});
