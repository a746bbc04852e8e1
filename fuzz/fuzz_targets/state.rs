//! What the program keeps for itself: a hierarchy of parts, the journal of rows, a manifest. The first byte chooses.
#![no_main]

#[path = "common.rs"]
mod common;

use libfuzzer_sys::{Corpus, fuzz_target};
use nystrom_stream::distance::journal::Journal;
use nystrom_stream::pipeline::decision::read_tree;
use nystrom_stream::store::WorkDir;

fuzz_target!(|data: &[u8]| -> Corpus {
    let Some((&first, bytes)) = data.split_first() else { return Corpus::Reject };
    match first {
        0 => match read_tree(&common::file("json", bytes)) {
            Ok(tree) => {
                for k in 0..4 {
                    match tree.cut_k(k) {
                        Ok(cut) => assert_eq!(cut.label.len(), tree.cells()),
                        Err(error) => common::check(&error),
                    }
                }
            }
            Err(error) => common::check(&error),
        },
        1 => {
            if let Some((spec, rows)) = Journal::read(&common::file("jsonl", bytes)) {
                assert!(rows.keys().all(|&row| row < spec.rows));
            }
        }
        2 => {
            let place = common::folder().join("work");
            std::fs::create_dir_all(&place).expect("a folder");
            std::fs::write(place.join("manifest.json"), bytes).expect("the manifest is written");
            match WorkDir::open(&place) {
                Ok(work) => {
                    assert!(work.bytes() <= 1 << 20, "files outside of the directory are not counted");
                }
                Err(error) => common::check(&error),
            }
        }
        _ => return Corpus::Reject,
    }
    Corpus::Keep
});
