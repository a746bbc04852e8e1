//! Small meshes of any connectivity and any coordinates, cut by both methods: bytes are coordinates and corners.
#![no_main]

#[path = "common.rs"]
mod common;

use libfuzzer_sys::{Corpus, fuzz_target};
use nystrom_stream::pipeline::Cluster;
use nystrom_stream::{Mesh, Segmenter};

fuzz_target!(|data: &[u8]| -> Corpus {
    let [options, vertices, rest @ ..] = data else { return Corpus::Reject };
    let vertices = usize::from(*vertices % 64) + 1;
    // Two bytes a coordinate: the first six bits its size, so that huge, tiny and missing values are common.
    let coordinate = |bytes: &[u8]| match i16::from_le_bytes([bytes[0], bytes[1]]) {
        i16::MIN => f32::NAN,
        i16::MAX => f32::INFINITY,
        wide if wide % 64 == 7 => f32::from(wide) * 1e30,
        narrow if narrow % 64 == 9 => f32::from(narrow) * 1e-38,
        plain => f32::from(plain) / 256.,
    };
    if rest.len() < 6 * vertices + 3 {
        return Corpus::Reject;
    }
    let (places, corners) = rest.split_at(6 * vertices);
    let positions: Vec<[f32; 3]> =
        places.chunks_exact(6).map(|p| [coordinate(&p[..2]), coordinate(&p[2..4]), coordinate(&p[4..])]).collect();
    let corner = |byte: u8| u32::from(byte) % vertices as u32;
    let faces: Vec<[u32; 3]> = corners.chunks_exact(3).take(200).map(|c| [0, 1, 2].map(|k| corner(c[k]))).collect();
    let mesh = match Mesh::from_slices(&positions, &faces) {
        Ok(mesh) => mesh,
        Err(error) => {
            common::check(&error);
            return Corpus::Keep;
        }
    };
    let parts = usize::from(options >> 4);
    let method = if options & 1 == 0 { Cluster::Parts } else { Cluster::KMeans };
    let segmenter = Segmenter::new()
        .method(method)
        .landmarks(usize::from(options >> 1 & 7) + 1)
        .exact(options >> 3 & 1 == 1)
        .threads(1)
        .memory(common::BUDGET)
        .temporary_folder(common::folder());
    let segmenter = if parts == 0 { segmenter } else { segmenter.parts(parts) };
    match segmenter.run(&mesh) {
        Ok(cut) => {
            assert_eq!(cut.labels().len(), faces.len());
            assert!(cut.labels().iter().all(|&label| (label as usize) < cut.parts()));
            assert!(cut.confidences().iter().all(|confidence| (0. ..=1.).contains(confidence)));
            assert!(parts == 0 || cut.parts() <= parts.max(1) || method == Cluster::Parts);
        }
        Err(error) => common::check(&error),
    }
    Corpus::Keep
});
