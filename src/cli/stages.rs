//! `graph`, `rows`, `share`, `merge`, `embed`, `cluster` and `export`: the stages of `segment` one by one, in a work
//! directory.
//!
//! `graph` needs the mesh; the others find its location in the work directory, and make missing earlier stages.

use super::choices::choice;
use super::edits::{EditArgs, NameTable, corrections};
use super::errors::{file_of, of_file};
use super::input::{check_is_file, check_there, open_file, read};
use super::method::{KernelArgs, MethodArgs, OrderArgs, PartsArgs};
use super::options::{
    AppContext, CliError, ForceArgs, ResourceArgs, RunArgs, ScratchArgs, ShownArgs, WorkDirArgs, misfit, open,
};
use super::output::{
    FormArgs, JsonArgs, Output, check_folders, check_names, closing_line, faces_in_parts, outputs_of, scratch_folder,
};
use super::results::Cut;
use super::sink::{check_places, check_places_or_folders, print};
use nystrom_stream::apps::edits::Edits;
use nystrom_stream::base::Error;
use nystrom_stream::base::printable::line;
use nystrom_stream::cluster::two_means;
use nystrom_stream::distance::shard;
use nystrom_stream::graph::Order;
use nystrom_stream::mesh::Mesh;
use nystrom_stream::mesh::ply::labelled::Labelling;
use nystrom_stream::mesh::size::is_pipe;
use nystrom_stream::pipeline::input::Record;
use nystrom_stream::pipeline::labels::{self, Labels};
use nystrom_stream::pipeline::recipe;
use nystrom_stream::pipeline::report::Report;
use nystrom_stream::pipeline::sharding::{self, ShareStep, SharedWork};
use nystrom_stream::pipeline::{Cluster, SegmentParams, decision, embed, input};
use nystrom_stream::spectral::EmbeddingParams;
use nystrom_stream::store::{Context, Run, WorkDir, json};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The work directory of a stage.
#[derive(Clone, Debug, clap::Args)]
pub struct Place {
    /// The work directory
    #[arg(long, value_name = "DIR")]
    pub work_dir: PathBuf,
}

/// Arguments of `graph`.
#[derive(Clone, Debug, clap::Args)]
pub struct GraphArgs {
    /// A PLY, OBJ, OFF or STL file, also .gz; `-` reads standard input
    #[arg(value_name = "MESH")]
    pub mesh: PathBuf,
    #[command(flatten)]
    pub place: Place,
    #[command(flatten)]
    pub force: ForceArgs,
    #[command(flatten)]
    pub order: OrderArgs,
    #[command(flatten)]
    pub json: JsonArgs,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Arguments of `rows`.
#[derive(Clone, Debug, clap::Args)]
pub struct RowsArgs {
    /// A PLY, OBJ, OFF or STL file, also .gz [default: the mesh of the work directory]
    #[arg(value_name = "MESH")]
    pub mesh: Option<PathBuf>,
    #[command(flatten)]
    pub place: Place,
    #[command(flatten)]
    pub force: ForceArgs,
    /// Compute only the I-th of N shares, counted from 0; processes may share the work directory
    #[arg(long, value_name = "I/N", value_parser = parse_shard)]
    pub shard: Option<(usize, usize)>,
    /// Compute everything that the shares need, then stop, so that shards started by a scheduler never wait
    #[arg(long, conflicts_with = "shard")]
    pub prepare: bool,
    #[command(flatten)]
    pub json: JsonArgs,
    #[command(flatten)]
    pub method: MethodArgs,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Arguments of `share`.
#[derive(Clone, Debug, clap::Args)]
pub struct ShareArgs {
    /// The step to divide
    #[arg(value_parser = choice::<ShareStep>())]
    pub step: ShareStep,
    #[command(flatten)]
    pub rows: RowsArgs,
}

/// Arguments of `merge`.
#[derive(Clone, Debug, clap::Args)]
pub struct MergeArgs {
    #[command(flatten)]
    pub place: WorkDirArgs,
    #[command(flatten)]
    pub json: JsonArgs,
    #[command(flatten)]
    pub shown: ShownArgs,
}

/// Arguments of `embed`.
#[derive(Clone, Debug, clap::Args)]
pub struct EmbedArgs {
    #[command(flatten)]
    pub place: Place,
    /// Coordinates per face, at most [default: 10]
    #[arg(short, long, value_name = "D", value_parser = clap::value_parser!(u16).range(1..=512))]
    pub dimensions: Option<u16>,
    #[command(flatten)]
    pub kernel: KernelArgs,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Arguments of `cluster`.
#[derive(Clone, Debug, clap::Args)]
pub struct ClusterArgs {
    /// The mesh, if it has moved
    #[arg(value_name = "MESH")]
    pub mesh: Option<PathBuf>,
    #[command(flatten)]
    pub place: Place,
    /// Output, repeatable, as in segment [default: only labels.npy and quality.npy in the work directory]
    #[arg(short, long, value_name = "OUT")]
    pub output: Vec<PathBuf>,
    /// Cut this hierarchy of parts instead of the one in the work directory
    #[arg(long, value_name = "FILE")]
    pub tree: Option<PathBuf>,
    #[command(flatten)]
    pub form: FormArgs,
    #[command(flatten)]
    pub json: JsonArgs,
    #[command(flatten)]
    pub edits: EditArgs,
    #[command(flatten)]
    pub parts: PartsArgs,
    #[command(flatten)]
    pub kernel: KernelArgs,
    #[command(flatten)]
    pub run: RunArgs,
}

impl ClusterArgs {
    /// The parameters of the work directory overridden by the given options, and the edits.
    fn params(&self, record: &Record) -> Result<(SegmentParams, Option<Edits>), CliError> {
        let mut params = record.params.clone();
        if self.parts.cluster.is_some_and(|cluster| cluster != params.cluster) {
            // Options of another clustering method do not apply here.
            let fresh = SegmentParams::default();
            (params.parts, params.boundaries) = (fresh.parts, fresh.boundaries);
            (params.tiny_components, params.walls) = (fresh.tiny_components, fresh.walls);
            params.embedding = fresh.embedding;
        }
        self.parts.apply(&self.kernel, &mut params)?;
        params = params.resolved();
        let edits = self.edits.read(&self.parts, &mut params)?;
        params.check().map_err(|error| self.edits.blamed(&self.parts, error))?;
        if self.tree.is_some() && params.cluster != Cluster::Parts {
            return Err(misfit("--tree", "--cluster parts"));
        }
        Ok((recipe::continued(record, &params), edits))
    }
}

/// Arguments of `export`.
#[derive(Clone, Debug, clap::Args)]
pub struct ExportArgs {
    /// The mesh, if it has moved
    #[arg(value_name = "MESH")]
    pub mesh: Option<PathBuf>,
    #[command(flatten)]
    pub place: Place,
    /// Output, repeatable, as in segment
    #[arg(short, long, value_name = "OUT")]
    pub output: Vec<PathBuf>,
    #[command(flatten)]
    pub form: FormArgs,
    /// Write the hierarchy of parts as JSON; `-` for standard output
    #[arg(long, value_name = "FILE")]
    pub tree: Option<PathBuf>,
    /// Name the parts from this table, one line per part: its number, a tab, its name
    #[arg(long, value_name = "TSV", requires = "output")]
    pub names: Option<PathBuf>,
    #[command(flatten)]
    pub resources: ResourceArgs,
    #[command(flatten)]
    pub shown: ShownArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
}

/// Opens an existing work directory; the run gets its seed, unless another is given.
fn reopen<'a>(place: &Place, seed: Option<u64>, run: Run<'a>) -> Result<(WorkDir, Record, Run<'a>), CliError> {
    drop(WorkDir::open_existing(&place.work_dir)?);
    let work = open(&place.work_dir, &run)?;
    let record = Record::read(&work)?;
    let seed = seed.unwrap_or(record.seed);
    Ok((work, record, Run { seed, ..run }))
}

/// Runs `graph`: the dual graph.
pub fn graph(args: &GraphArgs, app: &AppContext) -> Result<(), CliError> {
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    check_places([&args.mesh], Some(&args.place.work_dir), &args.json.json)?;
    check_there(&args.mesh)?;
    let params = SegmentParams::default().order(args.order.or(Order::default()));
    let work = open(&args.place.work_dir, &run)?;
    let (opened, identity) = read(&args.mesh, args.force, Context::new(&work, &run))?;
    let (_, graph) = input::graph(&opened, &identity, &params, Context::new(&work, &run))?;
    let answer = json!({
        "mesh": args.mesh.to_string_lossy(), "work_dir": args.place.work_dir.to_string_lossy(),
        "faces": graph.nodes.len(),
    });
    Ok(args.json.publish_with(answer, bars.log())?)
}

/// Parses shard and number of shards such as "0/3".
fn parse_shard(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("{text:?} is not a shard; write 0/3, 1/3 and 2/3");
    let (shard, of) = text.split_once('/').ok_or_else(wrong)?;
    match (shard.trim().parse(), of.trim().parse()) {
        (Ok(shard), Ok(of)) if shard < of => Ok((shard, of)),
        _ => Err(wrong()),
    }
}

/// Runs `share`: a part of one step, or what all parts of it need.
pub fn share(args: &ShareArgs, app: &AppContext) -> Result<(), CliError> {
    if args.rows.shard.is_none() && !args.rows.prepare {
        return Err(CliError::Usage("share: --shard I/N or --prepare is missing".into()));
    }
    if args.rows.method.distance.exact {
        return Err(misfit("--exact", "segment, rows and plan"));
    }
    shared(args.step, &args.rows, args.rows.method.params()?, app)
}

/// Runs `rows`: rows over all faces, or a shard of them.
pub fn rows(args: &RowsArgs, app: &AppContext) -> Result<(), CliError> {
    // `rows` makes rows over all faces, so parts must be decided on all faces too, not on a contraction.
    shared(ShareStep::Rows, args, args.method.params()?.exact(true), app)
}

/// Runs `rows` and `share` for `step`.
fn shared(step: ShareStep, args: &RowsArgs, mut params: SegmentParams, app: &AppContext) -> Result<(), CliError> {
    let bars = args.run.bars();
    let mut run = args.run.run(&bars, app);
    let (folder, force) = (&args.place.work_dir, args.force);
    let record = sharding::record(folder, &run)?;
    // The content of a stream is known only after reading it.
    let streams = args.mesh.as_ref().is_some_and(|path| path == Path::new("-") || is_pipe(path));
    if streams && (args.shard.is_some() || args.prepare) {
        let text = "a mesh read from a stream cannot be shared; start with `graph`, and leave out MESH here";
        return Err(CliError::Usage(text.into()));
    }
    let spooled = args.mesh.is_none() && record.as_ref().is_some_and(Record::is_spooled);
    let (path, identity) = match &args.mesh {
        Some(path) if streams => (path.clone(), Value::Null),
        Some(path) => (path.clone(), input::recorded_or_content(path, record.as_ref())?),
        None => {
            // If there is none, this returns the error.
            let record = Record::read(&WorkDir::open_existing(folder)?)?;
            if spooled || !record.mesh.exists() {
                (mesh_path(None, &record, folder)?, record.identity)
            } else {
                (record.mesh.clone(), input::recorded_or_content(&record.mesh, Some(&record))?)
            }
        }
    };
    if let Some(record) = record.filter(|record| input::same(&identity, &record.identity)) {
        run.seed = args.run.seed.unwrap_or(record.seed);
        params.order = args.method.order.or(record.params.order);
    }
    check_places([&path], Some(folder), &args.json.json)?;
    let mut answer = json!({"mesh": path.to_string_lossy(), "work_dir": folder.to_string_lossy()});
    let shared = SharedWork { step, identity: &identity, params: &params };
    let read = |work: &WorkDir| match spooled {
        true => Ok((open_file(&path, work.path(), &run)?, identity.clone())),
        false => read(&path, force, Context::new(work, &run)),
    };
    let opened = |work: &WorkDir| read(work).map(|(opened, _)| opened);
    if let Some(shard) = args.shard {
        let count = sharding::compute_shard(folder, shared, shard, opened, &run)?;
        answer["shard"] = json!([shard.0, shard.1]);
        answer[if step.is_by_landmark() { "rows" } else { "faces" }] = count.into();
        return Ok(args.json.publish_with(answer, bars.log())?);
    }
    let work = open(folder, &run)?;
    let context = Context::new(&work, &run);
    if args.prepare {
        sharding::prepare_shared(shared, || opened(&work), context)?;
    } else {
        let (opened, identity) = read(&work)?;
        answer["rows"] = sharding::compute_all_rows(&opened, &identity, &params, context)?.len().into();
    }
    Ok(args.json.publish_with(answer, bars.log())?)
}

/// Runs `merge`: joins the rows of all shards.
pub fn merge(args: &MergeArgs, app: &AppContext) -> Result<(), CliError> {
    let bars = args.shown.bars();
    let run = Run { cancel: app.cancel.clone(), ..Run::new(&bars) };
    let folder = args.place.path();
    // Opened read-only first: a missing one is not created.
    check_places(&input::recorded_mesh(&WorkDir::open_existing(folder)?), Some(folder), &args.json.json)?;
    let work = open(folder, &run)?;
    let rows = shard::merge(Context::new(&work, &run))?;
    let answer = json!({"work_dir": folder.to_string_lossy(), "rows": rows.len(), "faces": rows.nodes});
    Ok(args.json.publish_with(answer, bars.log())?)
}

/// Runs `embed`: the spectral coordinates of every face.
pub fn embed(args: &EmbedArgs, app: &AppContext) -> Result<(), CliError> {
    let bars = args.run.bars();
    let dimensions = args.dimensions.map_or(two_means::DIMENSIONS, usize::from);
    let params = args.kernel.params(dimensions, None).unwrap_or(EmbeddingParams::for_parts(dimensions));
    let params = EmbeddingParams { dimensions, ..params };
    let (work, record, run) = reopen(&args.place, args.run.seed, args.run.run(&bars, app))?;
    embed::embed(params, &record.params, Context::new(&work, &run))?;
    Ok(())
}

/// Runs `cluster`: cuts the mesh of a work directory, and writes outputs.
pub fn cluster(args: &ClusterArgs, app: &AppContext) -> Result<(), CliError> {
    let start = Instant::now();
    let bars = args.run.bars();
    let outputs = outputs_of(&args.output)?;
    args.form.check(&outputs)?;
    check_names(args.edits.names.as_deref(), &outputs, &args.json)?;
    let (work, record, run) = reopen(&args.place, args.run.seed, args.run.run(&bars, app))?;
    let inputs = [&args.mesh, &args.tree, &args.edits.edits, &args.edits.names].into_iter().flatten();
    let inputs = inputs.chain([&record.mesh]);
    check_places_or_folders(inputs.clone(), Some(work.path()), args.output.iter().chain(&args.json.json))?;
    check_folders(&outputs, inputs.chain(&args.output).chain(&args.json.json))?;
    outputs.iter().try_for_each(|output| output.check_budget(&run.budget))?;
    args.tree.iter().try_for_each(|path| check_is_file(path))?;
    let (params, edits) = args.params(&record)?;
    let names = NameTable::read(args.edits.names.as_deref())?;
    let tree = args.tree.as_deref().map(decision::read_tree).transpose()?;
    check_mesh(args.mesh.as_deref(), &record, work.path())?;
    let context = Context::new(&work, &run);
    let needs_mesh = edits.is_some() || args.edits.hints.is_some();
    let opened = needs_mesh.then(|| open_mesh(args.mesh.as_deref(), &record, None, &work, context)).transpose()?;
    let of_mesh = |name: &String| opened.as_ref().map(|mesh| mesh.face_values(name, context));
    let painted = args.edits.hints.as_ref().and_then(of_mesh).transpose()?;
    let placed = edits.as_ref().zip(opened.as_ref()).map(|(edits, mesh)| edits.on(mesh, &run)).transpose()?;
    drop(opened);
    let corrections = corrections(placed.as_ref(), painted.as_ref());
    let mut result = recipe::cluster(&params, tree.as_ref(), corrections, context)
        .map_err(|error| args.edits.blamed(&args.parts, of_file(error, "tree", args.tree.as_deref())))?;
    if let Some(names) = names {
        names.give(&mut result.names, result.colours.len())?;
        labels::keep(&result, context)?;
    }
    result.graph.notes(&record.mesh).iter().for_each(|note| run.progress.note(note));
    let report = || {
        let peak = Some((app.peak)());
        Report::new(&record.mesh, &params, &result, context, bars.log(), peak)
    };
    let cut = Cut {
        labelling: result.labelling(),
        params: &params,
        tree: tree.as_ref(),
        agreement: result.numbers.expected_agreement(),
        cell_labels: &result.cell_labels,
        edits: edits.as_ref(),
        work: &work,
    };
    let opened = opened_for(&outputs, args.mesh.as_deref(), &record, result.labels.len(), &work, context)?;
    if !outputs.is_empty() {
        cut.write(&outputs, args.form, opened.as_ref(), || json::value("the report", &report()?), context)?;
    }
    let report = report()?;
    args.json.publish(&report)?;
    report.remarks(&params).iter().for_each(|text| run.progress.note(text));
    let (parts, faces) = (report.parts_with_faces(), result.labels.len());
    if !outputs.is_empty() {
        run.progress.note_of_work(&closing_line(faces, parts, start, &outputs));
    } else if args.json.json.is_none() && !args.run.shown.quiet {
        let path = work.file(labels::LABELS);
        let (what, path) = (faces_in_parts(faces, parts), path.to_string_lossy());
        let text = format!("{what}, labels in {}; -o OUT writes a mesh\n", line(&path));
        print(text.as_bytes())?;
    }
    Ok(())
}

/// Runs `export`: writes outputs and the hierarchy of a work directory.
pub fn export(args: &ExportArgs, app: &AppContext) -> Result<(), CliError> {
    let bars = args.shown.bars();
    let outputs = outputs_of(&args.output)?;
    if outputs.is_empty() && args.tree.is_none() {
        return Err(CliError::Usage("export: nothing to write; give -o OUT, --tree FILE, or both".into()));
    }
    args.form.check(&outputs)?;
    check_names(args.names.as_deref(), &outputs, &JsonArgs::default())?;
    let run = args.resources.run(&bars, app);
    let folder = &args.place.work_dir;
    let looked_at = WorkDir::open_existing(folder)?;
    // It is opened read-only, beside other readers, unless an embedding has to be computed.
    let work = if args.form.embedding_columns && embed::kept(&looked_at).is_none() {
        drop(looked_at);
        open(folder, &run)?
    } else {
        looked_at
    };
    let record = Record::read(&work)?;
    let run = Run { seed: record.seed, ..run };
    let inputs = [&args.mesh, &args.names].into_iter().flatten();
    let inputs = inputs.chain([&record.mesh]);
    check_places_or_folders(inputs.clone(), Some(work.path()), args.output.iter().chain(&args.tree))?;
    check_folders(&outputs, inputs.chain(&args.output).chain(&args.tree))?;
    outputs.iter().try_for_each(|output| output.check_budget(&run.budget))?;
    let table = NameTable::read(args.names.as_deref())?;
    check_mesh(args.mesh.as_deref(), &record, work.path())?;
    // Those of the record if nothing was cut yet.
    let params = labels::method(&work).unwrap_or_else(|| record.params.clone());
    if let Some(path) = &args.tree {
        let tree = decision::tree_of(&work, params.exact_rows())?;
        match path.as_os_str() == "-" {
            true => print(&[&json::text(path, &tree)?[..], b"\n"].concat())?,
            false => decision::write_tree(&tree, path)?,
        }
    }
    if !outputs.is_empty() {
        let scratch = args.scratch.tmp.clone().unwrap_or_else(|| scratch_folder(&outputs));
        let scratch = WorkDir::in_memory(&scratch, &run.budget);
        let kept = Labels::read(&work)?;
        let (mut names, colours) = (kept.names(), kept.colours());
        if let Some(table) = table {
            table.give(&mut names, colours.len())?;
        }
        let Labels { labels, quality, fine, parts, edits, tiny_components_label, walls_label, .. } = kept;
        let labelling = Labelling {
            labels: &labels,
            colours: &colours,
            quality: Some(&quality),
            names: &names,
            fine: fine.as_ref(),
        };
        let agreement: Vec<f64> = parts.iter().filter_map(|part| part.expected_agreement).collect();
        let report = || {
            let input = json!({"path": record.mesh.to_string_lossy(), "faces": labels.len()});
            Ok(json!({
                "input": input, "options": params, "parts": parts,
                "tiny_components_label": tiny_components_label, "walls_label": walls_label,
            }))
        };
        let context = Context::new(&scratch, &run);
        let opened = opened_for(&outputs, args.mesh.as_deref(), &record, labels.len(), &work, context)?;
        // An embedding that is there was asked for, even if the labels are of another one.
        let columns = embed::kept(&work).map(|kept| kept.params).or(params.embedding);
        let (of_cut, agreement, edits) = (&params.clone().embedding(columns), &agreement[..], edits.as_ref());
        let cut = Cut { labelling, params: of_cut, tree: None, agreement, cell_labels: &[], edits, work: &work };
        cut.write(&outputs, args.form, opened.as_ref(), report, context)?;
    }
    Ok(())
}

/// The mesh of the work directory `work`, with `faces` labels, if one of `outputs` needs it; opened as by
/// [`open_mesh`].
fn opened_for(
    outputs: &[Output],
    moved: Option<&Path>,
    record: &Record,
    faces: usize,
    work: &WorkDir,
    context: Context<'_>,
) -> Result<Option<Mesh>, Error> {
    let needed = outputs.iter().any(Output::has_more_than_labels);
    needed.then(|| open_mesh(moved, record, Some(faces), work, context)).transpose()
}

/// Opens the mesh of the work directory `work`, from `moved` if given, else from the path in `record`. Decoded arrays
/// go to the work directory of `context`, which may be another one.
fn open_mesh(
    moved: Option<&Path>,
    record: &Record,
    faces: Option<usize>,
    work: &WorkDir,
    context: Context<'_>,
) -> Result<Mesh, Error> {
    let path = mesh_path(moved, record, work.path())?;
    let folder = context.work.path();
    let opened = open_file(&path, folder, context.run).map_err(|error| match context.work.spill("").path() {
        // A folder that could not be created says why.
        Err(reason) if file_of(&error).is_some_and(|file| file.starts_with(folder)) => reason,
        _ => error,
    })?;
    if faces.is_some_and(|faces| opened.faces.len() != faces) {
        return Err(Error::unusable(&path, "has a different number of faces than the labels", "give the right mesh"));
    }
    Ok(opened)
}

/// Rejects a mesh that is given, or is at the path in `record`, but has changed, even if only labels are needed.
fn check_mesh(named: Option<&Path>, record: &Record, folder: &Path) -> Result<(), Error> {
    if named.is_some() || !record.is_spooled() && record.mesh.exists() {
        mesh_path(named, record, folder)?;
    }
    Ok(())
}

/// What to do if the copy of standard input is lost or damaged.
const AGAIN: &str = "repeat the command that read it from standard input";

/// The location of the mesh of the work directory in `folder`: `moved` if given, else the path in `record`.
fn mesh_path(moved: Option<&Path>, record: &Record, folder: &Path) -> Result<PathBuf, Error> {
    let path = moved.map_or_else(|| record.path(folder), Path::to_path_buf);
    if moved.is_none() && !path.exists() {
        let again = || format!("give its new path before --work-dir {}", folder.display());
        let remedy = if record.is_spooled() { AGAIN.into() } else { again() };
        return Err(Error::unusable(path, "is no longer at the path recorded in the work directory", remedy));
    }
    if !record.is_of(&path)? {
        let remedy = if moved.is_none() && record.is_spooled() { AGAIN } else { "give that mesh" };
        return Err(Error::unusable(path, "is not the mesh of the work directory", remedy));
    }
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::parse_shard;

    #[test]
    fn shards() {
        assert_eq!(parse_shard("2/3"), Ok((2, 3)));
        for bad in ["3/3", "1", "0/0", "a/b", "-1/2"] {
            assert!(parse_shard(bad).is_err(), "{bad}");
        }
    }
}
