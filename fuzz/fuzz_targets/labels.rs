//! Files of labels and arrays: `.seg`, `.npy` as labels, `.npy` as typed arrays. The first byte chooses.
#![no_main]

#[path = "common.rs"]
mod common;

use libfuzzer_sys::{Corpus, fuzz_target};
use nystrom_stream::apps::evaluate::read_labels;
use nystrom_stream::store::npy;
use std::path::Path;

fn array<T: npy::Item>(path: &Path, bytes: usize) {
    match npy::open_shaped::<T>(path) {
        Ok((items, shape)) => {
            assert!(items.len() <= bytes);
            assert_eq!(shape.iter().product::<u64>(), items.len() as u64);
        }
        Err(error) => common::check(&error),
    }
}

fuzz_target!(|data: &[u8]| -> Corpus {
    let Some((&first, bytes)) = data.split_first() else { return Corpus::Reject };
    match first {
        0 | 1 => {
            let path = common::file(if first == 0 { "seg" } else { "npy" }, bytes);
            match read_labels(&path, common::folder(), common::run()) {
                Ok(labels) => assert!(labels.len() <= bytes.len()),
                Err(error) => common::check(&error),
            }
        }
        2 => {
            let path = common::file("npy", bytes);
            array::<u8>(&path, bytes.len());
            array::<u32>(&path, bytes.len());
            array::<f32>(&path, bytes.len());
            array::<f64>(&path, bytes.len());
        }
        _ => return Corpus::Reject,
    }
    Corpus::Keep
});
