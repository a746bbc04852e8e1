//! Cuts a mesh file into parts and prints their sizes: the whole recipe in a few lines.
//!
//! `cargo run --release --example cut -- mesh.ply [PARTS]`

use nystrom_stream::base::Result;
use nystrom_stream::cluster::parts::{PartCount, PartsParams};
use nystrom_stream::mesh;
use nystrom_stream::pipeline::{SegmentParams, input, segment};
use nystrom_stream::store::{Context, Run, WorkDir};
use std::path::Path;

fn cut(path: &Path, parts: Option<usize>) -> Result<()> {
    // All cores, half of the free memory, no progress, seed 0.
    let run = Run::new(&());
    // Intermediate results go here; `WorkDir::open` would keep them for the next run.
    let work = WorkDir::temporary(&std::env::temp_dir())?;
    let opened = mesh::open(path, work.path(), &run)?;
    let count = parts.map_or(PartCount::Found, PartCount::Exactly);
    let params = SegmentParams { parts: PartsParams { count, ..PartsParams::default() }, ..SegmentParams::default() };
    let cut = segment(&opened, &input::identity(path)?, &params, Context::new(&work, &run))?;
    let whole: f64 = cut.numbers.area.iter().sum();
    for (part, (faces, area)) in cut.numbers.faces.iter().zip(&cut.numbers.area).enumerate() {
        println!("part {part:3}: {faces:10} faces, {:5.1} % of the area", 100. * area / whole);
    }
    println!("the first face lies in part {}", cut.labels[0]);
    Ok(())
}

fn main() -> std::process::ExitCode {
    let mut arguments = std::env::args().skip(1);
    let Some(path) = arguments.next() else {
        eprintln!("usage: cut MESH [PARTS]");
        return 2.into();
    };
    match cut(Path::new(&path), arguments.next().and_then(|parts| parts.parse().ok())) {
        Ok(()) => 0.into(),
        Err(error) => {
            eprintln!("{error}");
            1.into()
        }
    }
}
