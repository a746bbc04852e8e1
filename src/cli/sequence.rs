//! `sequence`: orders a mesh for streaming.

use super::choices::choice;
use super::input::{check_there, read};
use super::options::{AppContext, CliError, ForceArgs, RunArgs, ScratchArgs};
use super::output::{JsonArgs, Output, check_picture};
use super::sink::{check_is_no_stream, check_places, print};
use nystrom_stream::apps::picture::{NO_PICTURE, PictureParams, render_named};
use nystrom_stream::apps::sequence::{ComparedOrder, SequenceOrder, gradient, table};
use nystrom_stream::mesh::Mesh;
use nystrom_stream::mesh::ply::labelled::PlyForm;
use nystrom_stream::mesh::ply::rearranged::{self, Rearrangement};
use nystrom_stream::pipeline::sequence::{Sequence, SequenceParams, Sequencer};
use nystrom_stream::store::{Context, folder_of, npy};
use serde_json::json;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// Arguments of `sequence`.
#[derive(Clone, Debug, clap::Args)]
pub struct SequenceArgs {
    /// A PLY, OBJ, OFF or STL file, also .gz; `-` reads standard input
    #[arg(value_name = "MESH")]
    pub mesh: PathBuf,
    /// Output, repeatable: .ply, the mesh in its new order; .npy, the position of each face in it; .png, the mesh
    /// coloured by position; `-` for the mesh on standard output [default: MESH.sequenced.ply, with --compare none]
    #[arg(short, long, value_name = "OUT")]
    pub output: Vec<PathBuf>,
    /// What to order by [default: spectral]
    #[arg(long, value_parser = choice::<SequenceOrder>())]
    pub order: Option<SequenceOrder>,
    /// Improve spectral coordinates by N sweeps over the graph
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=100_000))]
    pub smooth: u32,
    /// Number of landmarks for spectral orders [default: those in the work directory, or 10]
    #[arg(short = 'l', long, value_name = "L", value_parser = clap::value_parser!(u32).range(3..=4096))]
    pub landmarks: Option<u32>,
    /// Add the properties original_face and original_vertex to PLY outputs
    #[arg(long)]
    pub original: bool,
    /// Encoding of PLY outputs
    #[arg(long, value_parser = choice::<PlyForm>(), default_value = "same", value_name = "FORM")]
    pub ply_form: PlyForm,
    /// Print a table that compares all orders with that of the file, for small meshes also the exact Fiedler order
    #[arg(long)]
    pub compare: bool,
    #[command(flatten)]
    pub json: JsonArgs,
    /// Keep intermediate results in this folder and reuse them [default: a temporary folder]
    #[arg(long, value_name = "DIR")]
    pub work_dir: Option<PathBuf>,
    #[command(flatten)]
    pub force: ForceArgs,
    #[command(flatten)]
    pub run: RunArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
}

impl SequenceArgs {
    /// The order for outputs.
    fn order(&self) -> SequenceOrder {
        self.order.unwrap_or(SequenceOrder::Spectral)
    }
}

/// An output by format.
enum Target {
    Ply(PathBuf),
    Npy(PathBuf),
    Png(PathBuf),
    Stdout,
}

impl Target {
    fn of(path: &Path) -> Result<Self, CliError> {
        if path == Path::new("-") {
            return Ok(Self::Stdout);
        }
        check_is_no_stream("-o", path)?;
        match path.extension().and_then(OsStr::to_str).map(str::to_ascii_lowercase).as_deref() {
            Some("ply") => Ok(Self::Ply(path.into())),
            Some("npy") => Ok(Self::Npy(path.into())),
            Some("png") => Ok(Self::Png(path.into())),
            _ => Err(CliError::Usage(format!("-o {}: unknown extension; use .ply, .npy or .png", path.display()))),
        }
    }

    /// Its name on the command line.
    fn path(&self) -> PathBuf {
        match self {
            Self::Ply(path) | Self::Npy(path) | Self::Png(path) => path.clone(),
            Self::Stdout => "-".into(),
        }
    }
}

/// Rejects invalid combinations, before any work.
fn check(args: &SequenceArgs) -> Result<Vec<Target>, CliError> {
    let misused = |text: &str| Err(CliError::Usage(text.into()));
    let spectral = args.order() == SequenceOrder::Spectral || args.compare;
    if args.smooth > 0 && !spectral {
        return misused("--smooth requires --order spectral");
    }
    if args.landmarks.is_some() && !spectral {
        return misused("-l requires --order spectral");
    }
    let mut targets = args.output.iter().map(|path| Target::of(path)).collect::<Result<Vec<_>, _>>()?;
    let stdin = args.mesh.as_os_str() == "-";
    if targets.is_empty() && !args.compare {
        targets.push(if stdin { Target::Stdout } else { Target::Ply(Output::beside(&args.mesh, ".sequenced.ply")) });
    }
    let mesh = targets.iter().any(|target| matches!(target, Target::Stdout));
    if mesh && args.compare {
        return misused("mesh and measures cannot both go to standard output; give -o FILE");
    }
    if args.order.is_some() && targets.is_empty() {
        return misused("--order requires an output; --compare alone compares all orders");
    }
    let ply = [(args.original, "--original"), (args.ply_form != PlyForm::Same, "--ply-form")];
    let is_ply = |target: &Target| matches!(target, Target::Ply(_) | Target::Stdout);
    if let Some((_, option)) = ply.iter().find(|(given, _)| *given && !targets.iter().any(is_ply)) {
        return misused(&format!("{option} requires a .ply output"));
    }
    Ok(targets)
}

/// Runs `sequence`.
pub fn run(args: &SequenceArgs, app: &AppContext) -> Result<(), CliError> {
    let targets = check(args)?;
    let outputs: Vec<PathBuf> = targets.iter().map(Target::path).chain(args.json.json.clone()).collect();
    check_places([&args.mesh], args.work_dir.as_deref(), &outputs)?;
    check_there(&args.mesh)?;
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    if targets.iter().any(|target| matches!(target, Target::Png(_))) {
        check_picture(&PictureParams::default(), &run.budget)?;
    }
    let folder = |target: &Target| match target {
        Target::Ply(path) | Target::Npy(path) | Target::Png(path) => Some(folder_of(path).to_path_buf()),
        Target::Stdout => None,
    };
    let beside = || targets.iter().find_map(folder).unwrap_or_else(std::env::temp_dir);
    let work = args.scratch.work(args.work_dir.as_deref(), beside, &run)?;
    let (opened, identity) = read(&args.mesh, args.force, Context::new(&work, &run))?;
    let sequencer = Sequencer::new(&opened, &identity, Context::new(&work, &run))?;
    let landmarks = args.landmarks.map(|l| l as usize);
    let params = SequenceParams::default().order(args.order()).sweeps(args.smooth as usize).landmarks(landmarks);
    let mut measured = None;
    if !targets.is_empty() || !args.compare {
        let sequence = sequencer.sequence(&params)?;
        targets.iter().try_for_each(|target| write(target, args, &opened, &sequence, Context::new(&work, &run)))?;
        if args.json.json.is_some() && !args.compare {
            measured = Some(sequencer.measures(&sequence)?);
        }
    }
    let compared = if args.compare { compare(&sequencer, &params)? } else { Vec::new() };
    if args.compare && !args.json.to_stdout() {
        print(table(&compared).as_bytes())?;
    }
    if args.json.json.is_some() {
        let mesh = json!({"path": args.mesh.to_string_lossy(), "vertices": opened.positions.len(), "faces": opened.faces.len()});
        let mut report = json!({"mesh": mesh, "options": params, "seed": run.seed});
        if args.compare {
            report["orders"] = json!(compared);
        }
        if let Some(measures) = measured {
            report["measures"] = json!(measures);
        }
        report["peak_allocated"] = json!((app.peak)());
        args.json.publish_with(report, bars.log())?;
    }
    Ok(())
}

/// Measures every order, with sweeps too if requested, and the exact one of a small mesh.
fn compare(sequencer: &Sequencer, params: &SequenceParams) -> Result<Vec<ComparedOrder>, CliError> {
    let mut compared = Vec::new();
    if let Some(exact) = sequencer.exact(params)? {
        compared.push(ComparedOrder { order: "fiedler".into(), measures: sequencer.measures(&exact)? });
    }
    for order in SequenceOrder::ALL {
        let each = if order == SequenceOrder::Spectral && params.sweeps > 0 { vec![0, params.sweeps] } else { vec![0] };
        for sweeps in each {
            let sequence = sequencer.sequence(&params.order(order).sweeps(sweeps))?;
            let name = match sweeps {
                0 => order.to_string(),
                _ => format!("{order} --smooth {sweeps}"),
            };
            compared.push(ComparedOrder { order: name, measures: sequencer.measures(&sequence)? });
        }
    }
    Ok(compared)
}

fn write(
    target: &Target,
    args: &SequenceArgs,
    opened: &Mesh,
    sequence: &Sequence,
    context: Context<'_>,
) -> Result<(), CliError> {
    let mesh = opened;
    let order = Rearrangement { places: &sequence.places, numbers: &sequence.uses.rank, original: args.original };
    let form = args.ply_form;
    let faces = mesh.faces.len() as u64;
    let each = || match target {
        Target::Ply(path) => rearranged::write(mesh, path, &order, form, context),
        Target::Stdout => {
            let mut out = std::io::stdout().lock();
            rearranged::write_to(mesh, "<stdout>", &mut out, &order, form, context)
        }
        Target::Npy(path) => npy::write(path, &sequence.places, 1, true).map(drop),
        Target::Png(path) => {
            let (labels, colours) = gradient(&sequence.places, context.work)?;
            let params = PictureParams::default().legend(false).lines(false);
            render_named(mesh, Some(&labels), (&colours, &[]), &params, context)
                .map_err(|error| error.with_remedy(NO_PICTURE))?
                .write_png(path)
        }
    };
    context.run.stage("write", "faces", faces, each)?;
    Ok(())
}
