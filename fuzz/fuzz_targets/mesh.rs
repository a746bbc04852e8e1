//! Mesh files of all formats, compressed or not: the first byte chooses the ending, the rest is the file. What opens has
//! corners within its vertices and no more faces than bytes.
#![no_main]

#[path = "common.rs"]
mod common;

use libfuzzer_sys::{Corpus, fuzz_target};
use nystrom_stream::mesh;

const ENDINGS: [&str; 5] = ["ply", "obj", "off", "stl", "ply.gz"];

fuzz_target!(|data: &[u8]| -> Corpus {
    let Some((&first, bytes)) = data.split_first() else { return Corpus::Reject };
    let Some(ending) = ENDINGS.get(first as usize) else { return Corpus::Reject };
    let path = common::file(ending, bytes);
    match mesh::open(&path, common::folder(), common::run()) {
        Ok(mesh) => {
            let (faces, vertices) = (mesh.faces.len(), mesh.positions.len());
            // A byte of a compressed file may stand for a thousand.
            assert!(first == 4 || faces <= bytes.len());
            mesh.faces.for_each(0..faces, |_, corners| assert!(corners.iter().all(|&v| (v as usize) < vertices)));
            if let Err(error) = mesh.face_property("label", common::run()) {
                common::check(&error);
            }
        }
        Err(error) => common::check(&error),
    }
    Corpus::Keep
});
