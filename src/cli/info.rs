//! `info` and `verify`: what a work directory or a mesh file holds, and whether a work directory still does.

use super::bars::human;
use super::options::RunArgs;
use super::{AppContext, Failure};
use nystrom_stream::mesh::header;
use nystrom_stream::mesh::model::{Element, Kind, Property};
use nystrom_stream::pipeline::calibrate::size_of_mesh;
use nystrom_stream::store::Context;
use nystrom_stream::store::verify::verify as check;
use nystrom_stream::store::workdir::Manifest;
use nystrom_stream::store::{MappedBytes, Run, WorkDir};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Arguments of `info`.
#[derive(Clone, Debug, clap::Args)]
pub struct InfoArgs {
    /// A work directory, or a PLY, OBJ, OFF or STL file, of which the header is told (of text: what it counts)
    #[arg(value_name = "WORK|MESH")]
    pub path: PathBuf,
    /// Answer as JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Arguments of `verify`.
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

/// A property as a header has it, without its name.
fn written(kind: Kind) -> String {
    match kind {
        Kind::One(scalar) => scalar.word().to_string(),
        Kind::List { count, item } => format!("list {} {}", count.word(), item.word()),
    }
}

/// Tells what the header of a mesh file promises; whether the payload keeps it shows only when it is read.
fn mesh(path: &Path, as_json: bool) -> Result<(), Failure> {
    let size = size_of_mesh(path)?;
    let bytes = MappedBytes::open(path)?;
    // What is compressed, or no PLY, has no header that could be told.
    let header = header::parse(path, &bytes).ok();
    let (encoding, elements) =
        header.map_or((None, Vec::new()), |header| (Some(header.encoding.word()), header.elements));
    let mut out = std::io::stdout().lock();
    if as_json {
        let property = |p: &Property| json!({"name": p.name, "type": written(p.kind)});
        let element = |e: &Element| -> Value {
            json!({"name": e.name, "count": e.count, "properties": e.properties.iter().map(property).collect::<Vec<_>>()})
        };
        let all = json!({
            "mesh": path.display().to_string(), "bytes": bytes.len(), "faces": size.faces, "vertices": size.vertices,
            "encoding": encoding, "elements": elements.iter().map(element).collect::<Vec<_>>(),
        });
        let _ = writeln!(out, "{}", serde_json::to_string_pretty(&all).unwrap_or_default());
        return Ok(());
    }
    let (length, per_face) = (human(bytes.len() as f64), bytes.len() as f64 / size.faces as f64);
    let _ = writeln!(out, "{}, {length}B, {per_face:.1} B/face", path.display());
    let _ = writeln!(out, "{} faces, {} vertices", size.faces, size.vertices);
    if let Some(encoding) = encoding {
        let _ = writeln!(out, "PLY, {encoding}");
    }
    for element in &elements {
        let _ = writeln!(out, "{}  {}", element.name, element.count);
        for property in &element.properties {
            let _ = writeln!(out, "  {:24} {}", property.name, written(property.kind));
        }
    }
    Ok(())
}

pub fn run(args: &InfoArgs) -> Result<(), Failure> {
    if args.path.is_file() {
        return mesh(&args.path, args.json);
    }
    let manifest = WorkDir::open_existing(&args.path)?.manifest();
    let mut out = std::io::stdout().lock();
    if args.json {
        let _ = writeln!(out, "{}", serde_json::to_string_pretty(&manifest).unwrap_or_default());
        return Ok(());
    }
    let faces = faces(&manifest);
    let per_face = |bytes: u64| faces.map_or(String::new(), |n| format!("{:8.2} B/face", bytes as f64 / n));
    let _ = writeln!(out, "{}, format {}, by {}", args.path.display(), manifest.format, manifest.program);
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

pub fn verify(args: &Args, app: &AppContext) -> Result<(), Failure> {
    let bars = args.run.bars();
    let run: Run = args.run.run(&bars, app);
    let work = WorkDir::open_existing(&args.work_dir)?;
    let bytes = work.manifest().stages.values().flat_map(|stage| stage.files.values()).map(|file| file.bytes).sum();
    let (all, _) = run.stage("verify", "bytes", bytes, || check(Context::new(&work, &run)))?;
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
