//! Generates a creature with known parts, of any size up to billions of faces.
//!
//! `cargo run --release -p nystrom-stream-tools --bin generate -- --faces 1.3e6 --truth creature.seg creature.ply`

use clap::Parser;
use nystrom_stream::apps::creature::{Creature, Options, parse_faces};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::store::Run;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Generate a four-legged creature with known parts, as a binary PLY.
#[derive(Parser)]
struct Arguments {
    /// Where to write the mesh.
    output: PathBuf,
    /// Faces at least; 1.3e6 is understood too.
    #[arg(long, short = 'n', default_value = "1e5", value_parser = parse_faces)]
    faces: u64,
    /// Displace vertices along their normals by at most this share of the mean edge length.
    #[arg(long, default_value_t = 0.0)]
    noise: f64,
    /// Cut this many round holes.
    #[arg(long, default_value_t = 0)]
    holes: usize,
    /// Put faces and vertices in random order.
    #[arg(long)]
    shuffle: bool,
    /// Number the faces of each patch of the skin in tiles, so that a large mesh need not be sorted.
    #[arg(long)]
    tiles: bool,
    /// Seed of noise, holes and order.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Also write the true part of every face: `.npy`, or text, a number a line.
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Threads; all cores by default.
    #[arg(long)]
    threads: Option<usize>,
}

fn generate(arguments: &Arguments) -> Result<()> {
    let Arguments { faces, noise, holes, shuffle, tiles, seed, .. } = *arguments;
    let creature = Creature::new(&Options { faces, noise, holes, shuffle, tiles, seed })?;
    let mut run = Run::new(&());
    run.seed = seed;
    run.threads = arguments.threads.unwrap_or(run.threads).max(1);
    let start = Instant::now();
    creature.write_ply(&arguments.output, &run)?;
    let seconds = start.elapsed().as_secs_f64();
    let faces = creature.face_count();
    eprintln!(
        "{}: {} vertices, {faces} faces, {} parts, {seconds:.2} s ({:.2} million faces/s on {} threads)",
        arguments.output.display(),
        creature.vertex_count(),
        Creature::part_names().len(),
        faces as f64 / seconds / 1e6,
        run.threads,
    );
    match &arguments.truth {
        Some(path) if path.extension().is_some_and(|end| end == "npy") => creature.write_truth_npy(path, &run),
        Some(path) => creature.write_truth_seg(path, &run),
        None => Ok(()),
    }
}

fn main() -> ExitCode {
    match generate(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("generate: {error}");
            if matches!(error, Error::Parameter { .. }) { ExitCode::from(2) } else { ExitCode::FAILURE }
        }
    }
}
