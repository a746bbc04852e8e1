//! `info` and `verify`: what a work directory or a mesh contains and measures, and whether a work directory is intact.

use super::input::read;
use super::options::{AppContext, CliError, ForceArgs, ResourceArgs, ScratchArgs, ShownArgs, WorkDirArgs, either};
use super::output::JsonArgs;
use super::progress::tell_error;
use super::sink::{check_places, scratch_beside};
use nystrom_stream::apps::measure::{self, MeshMeasures};
use nystrom_stream::base::printable::{Significant, counted, human, line};
use nystrom_stream::base::{Cancel, Error, Result};
use nystrom_stream::mesh::import;
use nystrom_stream::mesh::ply::header;
use nystrom_stream::mesh::ply::{Element, Property};
use nystrom_stream::mesh::size::{is_pipe, shows_when_read, size_of_mesh};
use nystrom_stream::pipeline::input::{self, Record};
use nystrom_stream::store::json::value as to_json;
use nystrom_stream::store::verify::{Checked, unrecorded, verify as check};
use nystrom_stream::store::workdir::Manifest;
use nystrom_stream::store::{Context, MappedBytes, Run, WorkDir};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Arguments of `info`.
#[derive(Clone, Debug, clap::Args)]
pub struct InfoArgs {
    /// A work directory, or a PLY, OBJ, OFF or STL file, also .gz; `-` reads a mesh from standard input
    #[arg(value_name = "DIR|MESH", required_unless_present = "work_dir", conflicts_with = "work_dir")]
    pub path: Option<PathBuf>,
    /// The work directory
    #[arg(long, value_name = "DIR")]
    pub work_dir: Option<PathBuf>,
    /// Show only the header of a mesh file
    #[arg(long)]
    pub header: bool,
    #[command(flatten)]
    pub json: JsonArgs,
    #[command(flatten)]
    pub resources: ResourceArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
}

/// Arguments of `verify`.
#[derive(Clone, Debug, clap::Args)]
pub struct VerifyArgs {
    #[command(flatten)]
    pub place: WorkDirArgs,
    #[command(flatten)]
    pub json: JsonArgs,
    #[command(flatten)]
    pub shown: ShownArgs,
}

/// Number of faces of the mesh behind a manifest, if its graph exists.
fn faces(manifest: &Manifest) -> Option<f64> {
    manifest.stages.get("graph")?.facts.get("nodes")?.as_f64()
}

/// The header of a mesh file as text and JSON; the rest of the file is not checked against it.
fn header(path: &Path, cancel: &Cancel) -> Result<(String, Value)> {
    let size = size_of_mesh(path, cancel)?;
    let bytes = MappedBytes::open(path)?;
    // A compressed file, or one that is not a PLY, has no header to show.
    let header = header::parse(path, &bytes).ok();
    let (encoding, elements) =
        header.map_or((None, Vec::new()), |header| (Some(header.encoding.word()), header.elements));
    let property = |p: &Property| json!({"name": p.name, "type": p.kind.words()});
    let element = |e: &Element| -> Value {
        json!({"name": e.name, "count": e.count, "properties": e.properties.iter().map(property).collect::<Vec<_>>()})
    };
    let format = encoding.map_or_else(|| import::name(path, &bytes), |encoding| format!("PLY, {encoding}"));
    let all = json!({
        "mesh": path.display().to_string(), "bytes": bytes.len(), "format": format, "faces": size.faces,
        "vertices": size.vertices, "encoding": encoding, "elements": elements.iter().map(element).collect::<Vec<_>>(),
    });
    let (length, per_face) = (human(bytes.len() as f64), bytes.len() as f64 / size.faces as f64);
    let mut text = format!("{}, {length}B, {per_face:.1} B/face\n", line(&path.to_string_lossy()));
    let most = if size.strips { "at most " } else { "" };
    let _ = writeln!(text, "{most}{}", faces_and_vertices(size.faces as usize, size.vertices as usize));
    let _ = writeln!(text, "{format}");
    for element in &elements {
        let _ = writeln!(text, "{}  {}", line(&element.name), element.count);
        for property in &element.properties {
            let _ = writeln!(text, "  {:24} {}", line(&property.name), property.kind.words());
        }
    }
    Ok((text, all))
}

/// Reads and measures the mesh at `path` or on standard input; returns text and JSON.
fn mesh(path: &Path, args: &InfoArgs, app: &AppContext) -> Result<(String, Value)> {
    let run = args.resources.run(&(), app);
    let stdin = path.as_os_str() == "-";
    let streams = stdin || is_pipe(path);
    if stdin && args.header {
        return Err(Error::parameter("--header", "standard input has no header until it is read", "give a file"));
    }
    let name = if stdin { "<stdin>".into() } else { path.to_string_lossy() };
    // Without a header that states the size, it is known only after reading.
    let counted_later = stdin || !args.header && shows_when_read(path)?;
    let (mut text, mut all) =
        if counted_later { (String::new(), json!({"mesh": name})) } else { header(path, &run.cancel)? };
    if args.header {
        return Ok((text, all));
    }
    let beside = || if streams { std::env::temp_dir() } else { scratch_beside(path) };
    let work = args.scratch.work(None, beside, &run)?;
    let context = Context::new(&work, &run);
    let (opened, _) = read(path, ForceArgs { force: false }, context)?;
    let measures = measure::mesh(&opened, context)?;
    if counted_later {
        let _ = writeln!(text, "{}", faces_and_vertices(opened.faces.len(), opened.positions.len()));
        (all["faces"], all["vertices"]) = (json!(opened.faces.len()), json!(opened.positions.len()));
    }
    text += &measured(&measures);
    for note in opened.notes() {
        let _ = writeln!(text, "{note}");
    }
    all["notes"] = json!(opened.notes());
    all["measures"] = to_json("the measures", &measures)?;
    Ok((text, all))
}

fn faces_and_vertices(faces: usize, vertices: usize) -> String {
    format!("{}, {}", counted(faces, "face"), counted(vertices, "vertex"))
}

/// Three coordinates of a mesh of `size`, rounded to a ten-thousandth of it.
fn point(p: [f64; 3], size: f64) -> String {
    let power = size.min(f64::MAX).log10().floor();
    let digits = (4. - power).max(0.) as usize;
    let shown = |x: f64| match if x.abs() < 0.5 * 10f64.powf(power - 4.) { 0. } else { x } {
        x if (-8. ..15.).contains(&power) => format!("{x:.digits$}"),
        0. => "0".into(),
        x => format!("{:.5}", Significant(x)),
    };
    p.map(shown).join(" ")
}

/// The lines with the measurements of a mesh.
fn measured(m: &MeshMeasures) -> String {
    let mut rows: Vec<(&str, String)> = Vec::new();
    let kinds = [(m.triangles, "triangle"), (m.quads, "quad"), (m.polygons, "larger polygon")];
    let kinds = kinds.iter().filter(|(count, _)| *count > 0).map(|&(count, word)| counted(count as usize, word));
    let incomplete = (m.incomplete_faces > 0)
        .then(|| format!("{} with fewer than three corners", counted(m.incomplete_faces as usize, "face")));
    rows.push(("faces", kinds.chain(incomplete).collect::<Vec<_>>().join(", ")));
    if let Some([low, high]) = m.all.bounds {
        let size = [0, 1, 2].map(|axis| high[axis] - low[axis]);
        let widest = size.into_iter().fold(f64::MIN_POSITIVE, f64::max);
        rows.push(("box", format!("{} to {}", point(low, widest), point(high, widest))));
        rows.push(("size", point(size, widest)));
    }
    rows.push(("area", format!("{:.6}", Significant(m.all.area))));
    rows.push((
        "volume",
        match m.all.volume {
            Some(volume) if volume < 0. => format!("{:.6}, wound inwards", Significant(-volume)),
            Some(volume) => format!("{:.6}", Significant(volume)),
            None if m.all.open_edges > 0 => "none: the surface is open".into(),
            None if m.degenerate_faces > 0 => {
                "none: faces are not consistently oriented or lack finite coordinates".into()
            }
            None if m.nonmanifold_edges > 0 => {
                "none: faces are not consistently oriented, or an edge has an odd number of faces".into()
            }
            None => "none: faces are not consistently oriented".into(),
        },
    ));
    rows.push(("components", m.components.to_string()));
    let loops = m.boundary_loops.map_or(", loops not counted for lack of memory".into(), |loops| match loops {
        0 => String::new(),
        loops => format!(" in {}", counted(loops as usize, "loop")),
    });
    rows.push(("open edges", format!("{}{loops}", m.all.open_edges)));
    rows.push(("non-manifold", counted(m.nonmanifold_edges as usize, "edge")));
    rows.push(("degenerate", counted(m.degenerate_faces as usize, "face")));
    let odd = [
        (m.nonfinite_faces, "non-finite", "faces whose coordinates are not finite numbers, among the degenerate ones"),
        (m.welded_edges, "welded", "edges at the same position as another, as at texture seams"),
        (m.unoriented_edges, "unoriented", "edges without a consistent winding"),
        (m.stray_vertices, "strays", "vertices far outside the rest"),
        (m.duplicate_faces, "duplicates", "faces exactly where another one lies, not counted in the area"),
    ];
    rows.extend(odd.iter().filter(|(n, ..)| *n > 0).map(|(n, name, what)| (*name, format!("{n} {what}"))));
    rows.iter().map(|(name, value)| format!("{name:14}{value}\n")).collect()
}

/// Runs `info`, on a mesh or a work directory.
pub fn run(args: &InfoArgs, app: &AppContext) -> std::result::Result<(), CliError> {
    let path = either(&args.path, &args.work_dir);
    let is_folder = |path: &Path| path.is_dir() && path.as_os_str() != "-";
    if args.header && is_folder(path) {
        return Err(CliError::Usage("--header requires a mesh; a work directory has no header".into()));
    }
    if let Some(path) = args.path.as_ref().filter(|path| !is_folder(path)) {
        check_places([path], None, &args.json.json)?;
        let (text, all) = mesh(path, args, app)?;
        return Ok(args.json.publish_or_print(&all, &text)?);
    }
    let work = WorkDir::open_any(path)?;
    let mesh = input::recorded_mesh(&work);
    check_places(&mesh, Some(path), &args.json.json)?;
    let (manifest, inner) = (work.manifest(), work.all_inner()?);
    let faces = faces(&manifest);
    let per_face = |bytes: u64| faces.map_or(String::new(), |n| format!("{:8.2} B/face", bytes as f64 / n));
    let name = line(&path.to_string_lossy()).into_owned();
    let mut text = if manifest.stages.is_empty() && !inner.is_empty() {
        format!("{name}, made by correspond, with a folder for each mesh\n")
    } else {
        format!("{name}, format {}, by {}\n", manifest.format, line(&manifest.program))
    };
    if let Some(mesh) = mesh {
        let _ = writeln!(text, "mesh {}", line(&mesh.to_string_lossy()));
    }
    let mut total = 0;
    let mut add = |text: &mut String, file: &str, bytes: u64| {
        total = u64::saturating_add(total, bytes);
        let _ = writeln!(text, "  {file:24} {:>10}B {}", human(bytes as f64), per_face(bytes));
    };
    let mut list = |manifest: &Manifest, others: &BTreeMap<String, u64>, folder: &str| {
        let matched = manifest.stages.get("vertex graph").and_then(|stage| stage.inputs["input"]["file"].as_str());
        if let Some(mesh) = matched {
            let _ = writeln!(text, "{folder} mesh {}", line(mesh));
        }
        for (name, stage) in &manifest.stages {
            let _ = writeln!(text, "{folder}{}  key {}  {:.3} s", line(name), line(&stage.key), stage.seconds);
            stage.files.iter().for_each(|(file, record)| add(&mut text, file, record.bytes));
        }
        if !others.is_empty() {
            let _ = writeln!(text, "{folder}files of no stage, such as a mesh that was decoded");
            others.iter().for_each(|(file, bytes)| add(&mut text, &line(file), *bytes));
        }
    };
    let others = unrecorded(&work);
    list(&manifest, &others, "");
    let mut all = to_json("the manifest", &manifest)?;
    all["other_files"] = json!(others);
    for (folder, inner) in inner {
        let (others, inner) = (unrecorded(&inner), inner.manifest());
        list(&inner, &others, &format!("{}/", line(&folder)));
        all["folders"][&folder] = to_json("a manifest", &inner)?;
        all["folders"][folder]["other_files"] = json!(others);
    }
    let _ = writeln!(text, "total {}B {}", human(total as f64), per_face(total));
    Ok(args.json.publish_or_print(&all, &text)?)
}

/// Runs `verify`.
pub fn verify(args: &VerifyArgs, app: &AppContext) -> std::result::Result<(), CliError> {
    let bars = args.shown.bars();
    let run = Run { cancel: app.cancel.clone(), ..Run::new(&bars) };
    let work = WorkDir::open_any(args.place.path())?;
    check_places(&input::recorded_mesh(&work), Some(work.path()), &args.json.json)?;
    let inner = work.all_inner()?;
    let manifests = [work.manifest()].into_iter().chain(inner.values().map(|inner| inner.manifest()));
    let files =
        manifests.flat_map(|manifest| manifest.stages.into_values().flat_map(|stage| stage.files.into_values()));
    let bytes = files.fold(0, |sum: u64, file| sum.saturating_add(file.bytes));
    let (mut all, _) = run.stage("verify", "bytes", bytes, || check(Context::new(&work, &run)))?;
    all.extend(copy_of_input(&work)?);
    let damaged: Vec<_> = all.iter().filter(|file| file.problem.is_some()).collect();
    for file in &damaged {
        let path = work.file(&file.file);
        let origin = match file.stage.as_str() {
            INPUT => "the mesh from standard input".to_string(),
            stage => format!("stage {stage}, {} bytes expected", file.bytes),
        };
        let text = format!(
            "{}: {} ({origin}); {}rerun the command that wrote it",
            path.display(),
            file.problem.as_deref().unwrap_or_default(),
            if path.exists() { "delete the file and " } else { "" },
        );
        tell_error(bars.style(), &text, Some(&path), Value::Null);
    }
    let bytes = all.iter().fold(0, |sum: u64, file| sum.saturating_add(file.bytes));
    let text = format!("{}, {bytes} bytes: all intact\n", counted(all.len(), "file"));
    args.json.publish_or_print(&all, if damaged.is_empty() { &text } else { "" })?;
    if damaged.is_empty() {
        return Ok(());
    }
    Err(CliError::Reported(format!("{} damaged", counted(damaged.len(), "file"))))
}

/// Stands for a stage in what is told of the copy of standard input, which no stage made.
const INPUT: &str = "input";

/// The copy of a mesh from standard input in `work`, checked, if there is to be one: nothing else has that mesh.
fn copy_of_input(work: &WorkDir) -> Result<Option<Checked>> {
    // Directories of other kinds, and of other versions, record no mesh that could be checked.
    let Some(record) = Record::read(work).ok().filter(Record::is_spooled) else { return Ok(None) };
    let problem = record.problem_of_copy(work.path())?.map(str::to_string);
    let path = record.path(work.path());
    let bytes = path.metadata().map_or(0, |metadata| metadata.len());
    let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(Some(Checked { stage: INPUT.into(), file, bytes, problem }))
}
