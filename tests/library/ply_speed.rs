//! How long reading and writing take, to be run by hand:
//! `cargo test --release --test library ply_speed -- --ignored --nocapture`.

use crate::common;
use nystrom_stream::mesh::{self, Labelling, PlyForm};
use nystrom_stream::store::Run;
use std::time::Instant;

#[test]
#[ignore = "a measurement"]
fn reading_and_writing() {
    let Some(data) = common::data() else { return };
    for name in
        ["mri_ch2_head_h", "etopo20_globe", "dragon_vrip_orig_ascii", "igea_orig_tristrips", "horse_97k_orig_BE"]
    {
        let path = data.join("real").join(name).with_extension("ply");
        for threads in [1, 2] {
            let run = Run { threads, ..Run::new(&()) };
            let scratch = tempfile::tempdir().unwrap();
            let (mut read, mut write, mut stream, mut seg) = (f64::MAX, f64::MAX, f64::MAX, f64::MAX);
            let mut faces = 0;
            for _ in 0..5 {
                let start = Instant::now();
                let opened = mesh::open(&path, scratch.path(), &run).unwrap();
                read = read.min(start.elapsed().as_secs_f64());
                faces = opened.faces.len();
                let labels: Vec<u32> = (0..faces as u32).map(|face| face / 1000 % 12).collect();
                let quality = vec![0.5; faces];
                let colours = nystrom_stream::apps::colours::assign(12, &[]);
                let labelling = Labelling { labels: &labels, colours: &colours, quality: Some(&quality), names: &[] };
                let mesh = &opened;
                let out = scratch.path().join("out.ply");
                let start = Instant::now();
                mesh::write_labelled(mesh, &out, &labelling, PlyForm::Same, false, &run).unwrap();
                write = write.min(start.elapsed().as_secs_f64());
                let start = Instant::now();
                let mut sink = std::io::sink();
                mesh::write_labelled_to(mesh, "-", &mut sink, &labelling, PlyForm::Same, &run).unwrap();
                stream = stream.min(start.elapsed().as_secs_f64());
                let start = Instant::now();
                mesh::write_seg(&scratch.path().join("out.seg"), &labels, false, &run).unwrap();
                seg = seg.min(start.elapsed().as_secs_f64());
                std::fs::remove_file(out).unwrap();
            }
            println!(
                "{name}: {faces} faces, {threads} threads: open {:.2} ms ({:.2} ns a face), labelled {:.1} ms, to a stream {:.1} ms, seg {:.1} ms",
                read * 1e3,
                read * 1e9 / faces as f64,
                write * 1e3,
                stream * 1e3,
                seg * 1e3
            );
        }
    }
}
