//! `info` and `verify`: what a work directory or a mesh file holds, and whether a work directory still does.

use super::options::{AppContext, CliError, RunArgs, WorkDirArgs, either};
use super::output::JsonArgs;
use super::progress::{human, tell};
use nystrom_stream::base::Result;
use nystrom_stream::base::printable::line;
use nystrom_stream::mesh::ply::header;
use nystrom_stream::mesh::ply::{Element, Property};
use nystrom_stream::pipeline::calibrate::size_of_mesh;
use nystrom_stream::store::verify::verify as check;
use nystrom_stream::store::workdir::Manifest;
use nystrom_stream::store::{Context, MappedBytes, Run, WorkDir};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Arguments of `info`.
#[derive(Clone, Debug, clap::Args)]
pub struct InfoArgs {
    /// A work directory, or a PLY, OBJ, OFF or STL file, also .gz
    #[arg(value_name = "DIR|MESH", required_unless_present = "work_dir", conflicts_with = "work_dir")]
    pub path: Option<PathBuf>,
    /// The work directory
    #[arg(long, value_name = "DIR")]
    pub work_dir: Option<PathBuf>,
    #[command(flatten)]
    pub json: JsonArgs,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Arguments of `verify`.
#[derive(Clone, Debug, clap::Args)]
pub struct VerifyArgs {
    #[command(flatten)]
    pub place: WorkDirArgs,
    #[command(flatten)]
    pub json: JsonArgs,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Faces of the mesh behind a manifest, where its graph is there.
fn faces(manifest: &Manifest) -> Option<f64> {
    manifest.stages.get("graph")?.facts.get("nodes")?.as_f64()
}

/// What the header of a mesh file promises, as text and JSON; whether the rest keeps it shows only when it is read.
fn mesh(path: &Path) -> Result<(String, Value)> {
    let size = size_of_mesh(path)?;
    let bytes = MappedBytes::open(path)?;
    // A compressed file, or one that is no PLY, has no header to show.
    let header = header::parse(path, &bytes).ok();
    let (encoding, elements) =
        header.map_or((None, Vec::new()), |header| (Some(header.encoding.word()), header.elements));
    let property = |p: &Property| json!({"name": p.name, "type": p.kind.words()});
    let element = |e: &Element| -> Value {
        json!({"name": e.name, "count": e.count, "properties": e.properties.iter().map(property).collect::<Vec<_>>()})
    };
    let all = json!({
        "mesh": path.display().to_string(), "bytes": bytes.len(), "faces": size.faces, "vertices": size.vertices,
        "encoding": encoding, "elements": elements.iter().map(element).collect::<Vec<_>>(),
    });
    let (length, per_face) = (human(bytes.len() as f64), bytes.len() as f64 / size.faces as f64);
    let mut text = format!("{}, {length}B, {per_face:.1} B/face\n", line(&path.to_string_lossy()));
    let _ = writeln!(text, "{} faces, {} vertices", size.faces, size.vertices);
    if let Some(encoding) = encoding {
        let _ = writeln!(text, "PLY, {encoding}");
    }
    for element in &elements {
        let _ = writeln!(text, "{}  {}", line(&element.name), element.count);
        for property in &element.properties {
            let _ = writeln!(text, "  {:24} {}", line(&property.name), property.kind.words());
        }
    }
    Ok((text, all))
}

pub fn run(args: &InfoArgs) -> std::result::Result<(), CliError> {
    let path = either(&args.path, &args.work_dir);
    if args.path.is_some() && path.is_file() {
        let (text, all) = mesh(path)?;
        return Ok(args.json.publish_or_print(&all, &text)?);
    }
    let manifest = WorkDir::open_existing(path)?.manifest();
    let faces = faces(&manifest);
    let per_face = |bytes: u64| faces.map_or(String::new(), |n| format!("{:8.2} B/face", bytes as f64 / n));
    let mut text =
        format!("{}, format {}, by {}\n", line(&path.to_string_lossy()), manifest.format, line(&manifest.program));
    if let Some(mesh) = manifest.stages.get("record").and_then(|stage| stage.facts["mesh"].as_str()) {
        let _ = writeln!(text, "of {}", line(mesh));
    }
    let mut total = 0;
    for (name, stage) in &manifest.stages {
        let _ = writeln!(text, "{}  key {}  {:.3} s", line(name), line(&stage.key), stage.seconds);
        for (file, record) in &stage.files {
            total = u64::saturating_add(total, record.bytes);
            let _ = writeln!(text, "  {file:24} {:>10}B {}", human(record.bytes as f64), per_face(record.bytes));
        }
    }
    let _ = writeln!(text, "total {}B {}", human(total as f64), per_face(total));
    Ok(args.json.publish_or_print(&manifest, &text)?)
}

pub fn verify(args: &VerifyArgs, app: &AppContext) -> std::result::Result<(), CliError> {
    let bars = args.run.bars();
    let run: Run = args.run.run(&bars, app);
    let work = WorkDir::open_existing(args.place.path())?;
    let manifest = work.manifest();
    let files = manifest.stages.values().flat_map(|stage| stage.files.values());
    let bytes = files.fold(0, |sum: u64, file| sum.saturating_add(file.bytes));
    let (all, _) = run.stage("verify", "bytes", bytes, || check(Context::new(&work, &run)))?;
    let damaged: Vec<_> = all.iter().filter(|file| file.problem.is_some()).collect();
    for file in &damaged {
        tell(&format!(
            "nystrom-stream: {}: {} (stage {}, {} bytes expected); delete the file, and the next run makes it anew",
            work.file(&file.file).display(),
            file.problem.as_deref().unwrap_or_default(),
            file.stage,
            file.bytes,
        ));
    }
    let text = format!("{} files, {bytes} bytes: all as they were written\n", all.len());
    args.json.publish_or_print(&all, if damaged.is_empty() { &text } else { "" })?;
    if damaged.is_empty() { Ok(()) } else { Err(CliError::Reported) }
}
