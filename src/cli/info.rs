//! `info` and `verify`: what a work directory holds, and whether it still does.

use super::bars::human;
use super::options::RunArgs;
use super::{Failure, Surroundings};
use nystrom_stream::store::check::verify as check;
use nystrom_stream::store::workdir::Manifest;
use nystrom_stream::store::{Run, WorkDir};
use std::io::Write;
use std::path::PathBuf;

/// Arguments of `info` and `verify`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// The work directory
    #[arg(value_name = "WORK")]
    pub work_dir: PathBuf,
    /// Answer as JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Faces of the mesh behind a manifest, where its graph is there.
fn faces(manifest: &Manifest) -> Option<f64> {
    manifest.stages.get("graph")?.facts.get("nodes")?.as_f64()
}

pub fn run(args: &Args) -> Result<(), Failure> {
    let manifest = WorkDir::open_existing(&args.work_dir)?.manifest();
    let mut out = std::io::stdout().lock();
    if args.json {
        let _ = writeln!(out, "{}", serde_json::to_string_pretty(&manifest).unwrap_or_default());
        return Ok(());
    }
    let faces = faces(&manifest);
    let per_face = |bytes: u64| faces.map_or(String::new(), |n| format!("{:8.2} B/face", bytes as f64 / n));
    let _ = writeln!(out, "{}, format {}, by {}", args.work_dir.display(), manifest.format, manifest.program);
    if let Some(mesh) = manifest.stages.get("record").and_then(|stage| stage.facts["mesh"].as_str()) {
        let _ = writeln!(out, "of {mesh}");
    }
    let mut total = 0;
    for (name, stage) in &manifest.stages {
        let _ = writeln!(out, "{name}  key {}  {:.3} s", stage.key, stage.seconds);
        for (file, record) in &stage.files {
            total += record.bytes;
            let _ = writeln!(out, "  {file:24} {:>10}B {}", human(record.bytes as f64), per_face(record.bytes));
        }
    }
    let _ = writeln!(out, "total {}B {}", human(total as f64), per_face(total));
    Ok(())
}

pub fn verify(args: &Args, surroundings: &Surroundings) -> Result<(), Failure> {
    let bars = args.run.bars();
    let run: Run = args.run.run(&bars, surroundings);
    let work = WorkDir::open_existing(&args.work_dir)?;
    let bytes = work.manifest().stages.values().flat_map(|stage| stage.files.values()).map(|file| file.bytes).sum();
    let (all, _) = run.stage("verify", "bytes", bytes, || check(&work, &run))?;
    let mut out = std::io::stdout().lock();
    if args.json {
        let _ = writeln!(out, "{}", serde_json::to_string_pretty(&all).unwrap_or_default());
    }
    let damaged: Vec<_> = all.iter().filter(|file| file.problem.is_some()).collect();
    for file in &damaged {
        let problem = file.problem.as_deref().unwrap_or_default();
        let _ = writeln!(
            std::io::stderr(),
            "nystrom-stream: {}: {problem} (stage {}, {} bytes expected); delete the file, and the next run makes it anew",
            work.file(&file.file).display(),
            file.stage,
            file.bytes,
        );
    }
    if !damaged.is_empty() {
        return Err(Failure::Reported);
    }
    if !args.json {
        let _ = writeln!(out, "{} files, {} bytes: all as they were written", all.len(), bytes);
    }
    Ok(())
}
