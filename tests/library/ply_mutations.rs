//! Damaged files are opened or refused; they never panic, hang or take memory that they do not fill.

use crate::common;
use nystrom_stream::mesh::{self, Labelling, PlyForm};
use nystrom_stream::store::Run;
use proptest::prelude::*;

/// A small mesh of each encoding, with everything a decoder can stumble over.
fn samples() -> Vec<Vec<u8>> {
    let header = |format: &str, faces: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment c\nelement vertex 4\nproperty float x\nproperty double y\nproperty short z\n{faces}end_header\n"
        )
    };
    let plain = "element face 3\nproperty list uchar int vertex_indices\nproperty uchar red\n";
    let lists = "element face 3\nproperty list int ushort vertex_index\nproperty list uchar float uv\nelement edge 1\nproperty int a\n";
    let strips = "element tristrips 1\nproperty list int int vertex_indices\n";
    let vertices = "0 0 0\n1 0 0\n0 1 nan\n1 1 1\n";
    let mut all = vec![
        (header("ascii", plain) + vertices + "3 0 1 2 9\n4 0 1 2 3 9\n0 9\n").into_bytes(),
        (header("ascii", lists) + vertices + "3 0 1 2 1 .5\n3 1 2 3 0\n3 0 2 3 0\n7\n").into_bytes(),
        (header("ascii", strips) + vertices + "6 0 1 2 3 -1 0\n").into_bytes(),
    ];
    for big in [false, true] {
        let format = if big { "binary_big_endian" } else { "binary_little_endian" };
        let order = |bytes: &[u8]| if big { bytes.iter().rev().copied().collect() } else { bytes.to_vec() };
        let four: Vec<u8> = (0..4)
            .flat_map(|v| [order(&(v as f32).to_le_bytes()), order(&(v as f64).to_le_bytes()), vec![0, 0]].concat())
            .collect();
        let int = |values: &[i32]| values.iter().flat_map(|value| order(&value.to_le_bytes())).collect::<Vec<u8>>();
        let face = |corners: &[i32]| [vec![corners.len() as u8], int(corners), vec![7]].concat();
        all.push(
            [header(format, plain).into_bytes(), four.clone(), face(&[0, 1, 2]), face(&[2, 1, 3]), face(&[0, 2, 3])]
                .concat(),
        );
        all.push(
            [header(format, plain).into_bytes(), four.clone(), face(&[0, 1, 2]), face(&[2, 1, 3, 0]), face(&[])]
                .concat(),
        );
        all.push([header(format, strips).into_bytes(), four.clone(), int(&[6, 0, 1, 2, -1, 3, 0])].concat());
    }
    all
}

/// Opens the bytes, and labels the mesh if it is one.
fn try_all(bytes: &[u8]) -> bool {
    let dir = common::in_memory();
    let path = dir.path().join("x.ply");
    std::fs::write(&path, bytes).unwrap();
    let run = Run { threads: 2, ..Run::new(&()) };
    let opened = match mesh::open(&path, dir.path(), &run) {
        Ok(opened) => opened,
        Err(error) => {
            assert!(!error.to_string().contains('\n'), "{error}");
            return false;
        }
    };
    let faces = opened.faces.len();
    assert!(faces <= bytes.len());
    let corners = |_: usize, corners: &[u32]| assert!(corners.iter().all(|&v| (v as usize) < opened.positions.len()));
    opened.faces.for_each(0..faces, corners);
    let labels = vec![1; faces];
    let labelling = Labelling { labels: &labels, colours: &[], quality: None, names: &[], fine: None };
    for form in [PlyForm::Same, PlyForm::Binary, PlyForm::Ascii] {
        let out = dir.path().join("out.ply");
        let written = mesh::write_labelled(&opened, &out, &labelling, form, &run);
        if written.is_ok() {
            let again = mesh::open(&out, dir.path(), &run).expect("our own output opens");
            assert_eq!(again.faces.len(), faces);
        }
    }
    true
}

#[test]
fn samples_open() {
    for (number, sample) in samples().iter().enumerate() {
        assert!(try_all(sample), "sample {number}");
    }
}

#[test]
fn every_truncation_is_refused_or_opened() {
    for sample in samples() {
        for len in 0..sample.len() {
            try_all(&sample[..len]);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_never_panic(
        which in 0usize..9,
        hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        digits in any::<bool>(),
    ) {
        let mut bytes = samples().swap_remove(which);
        for (place, value) in hits {
            let at = place.index(bytes.len());
            // Half of the runs change digits only, so that headers stay headers and counts lie.
            if !digits {
                bytes[at] = value;
            } else if let Some(digit) = bytes[at..].iter().position(u8::is_ascii_digit) {
                bytes[at + digit] = b'0' + value % 10;
            }
        }
        try_all(&bytes);
    }
}
