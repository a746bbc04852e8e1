//! `picture`: a mesh and its parts as a PNG.

use super::input::{check_there, read};
use super::options::{AppContext, CliError, ForceArgs, ResourceArgs, ScratchArgs, ShownArgs};
use super::output::{Output, check_extensions};
use super::sink::{check_is_no_stream, check_places};
use nystrom_stream::apps::labelled_faces::LabelledFaces;
use nystrom_stream::apps::picture::{PictureParams, Up, render_named, undrawn};
use nystrom_stream::base::Result;
use nystrom_stream::mesh::{Mesh, ends_with};
use nystrom_stream::store::{Context, WorkDir, folder_of};
use std::path::{Path, PathBuf};

/// Arguments of `picture`.
#[derive(Clone, Debug, clap::Args)]
pub struct PictureArgs {
    /// A PLY, OBJ, OFF or STL file, also .gz, labelled or not; `-` reads standard input
    #[arg(value_name = "MESH")]
    pub mesh: PathBuf,
    /// Labels, .seg or .npy of any integers, negative for none [default: the property `label` of the mesh's faces]
    #[arg(long, value_name = "LABELS")]
    pub labels: Option<PathBuf>,
    /// The picture, .png [default: MESH.png]
    #[arg(short, long, value_name = "OUT")]
    pub output: Option<PathBuf>,
    /// Number of views on one sheet, around the mesh; the second is from the opposite side
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub views: usize,
    /// Size of the sheet in pixels
    #[arg(long, value_name = "WxH", default_value = "1600x1200", value_parser = parse_dimensions)]
    pub size: (usize, usize),
    /// Leave the background transparent
    #[arg(long)]
    pub transparent: bool,
    /// Do not list the parts and their shares of the surface
    #[arg(long)]
    pub no_legend: bool,
    /// Draw no lines between parts and at edges
    #[arg(long)]
    pub no_lines: bool,
    /// Axis that points up: x, y, z, -x, -y, -z [default: automatic]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// Additional rotation about that axis in degrees, relative to the automatic view
    #[arg(long, value_name = "DEG", default_value_t = 0., allow_hyphen_values = true)]
    pub turn: f64,
    /// Additional elevation in degrees, relative to the automatic view
    #[arg(long, value_name = "DEG", default_value_t = 0., allow_hyphen_values = true)]
    pub tilt: f64,
    #[command(flatten)]
    pub resources: ResourceArgs,
    #[command(flatten)]
    pub shown: ShownArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
}

/// Parses width and height such as "1600x1200".
fn parse_dimensions(text: &str) -> Result<(usize, usize), String> {
    let numbers = text.split_once(['x', 'X', '×']).map(|(width, height)| (width.trim().parse(), height.trim().parse()));
    match numbers {
        Some((Ok(width), Ok(height))) => Ok((width, height)),
        _ => Err(format!("{text:?} is not a size; write 1600x1200")),
    }
}

impl PictureArgs {
    fn params(&self) -> PictureParams {
        let (width, height) = self.size;
        PictureParams::default()
            .width(width)
            .height(height)
            .views(self.views)
            .transparent(self.transparent)
            .legend(!self.no_legend)
            .lines(!self.no_lines)
            .up(self.up)
            .turn(self.turn)
            .tilt(self.tilt)
    }

    fn target(&self) -> Result<PathBuf, CliError> {
        let stdin = self.mesh.as_os_str() == "-";
        match &self.output {
            Some(path) if ends_with(path, "png") => Ok(path.clone()),
            Some(path) => Err(CliError::Usage(format!("-o {}: pictures are PNG files; use .png", path.display()))),
            None if stdin => Err(CliError::Usage("-o: standard input has no name; give -o OUT.png".into())),
            None => Ok(Output::beside(&self.mesh, ".png")),
        }
    }
}

/// Runs `picture`.
pub fn run(args: &PictureArgs, app: &AppContext) -> Result<(), CliError> {
    let params = args.params();
    params.check()?;
    let target = args.target()?;
    check_labels(args.labels.as_ref())?;
    check_is_no_stream("-o", &target)?;
    check_places([&args.mesh].into_iter().chain(&args.labels), None, [&target])?;
    check_there(&args.mesh)?;
    let bars = args.shown.bars();
    let run = args.resources.run(&bars, app);
    params.check_budget(&run.budget)?;
    let work = WorkDir::temporary(args.scratch.tmp.as_deref().unwrap_or(folder_of(&target)))?;
    let (opened, _) = read(&args.mesh, ForceArgs::default(), Context::new(&work, &run))?;
    let faces = opened.faces.len();
    let mut labelled = labelled(&opened, args.labels.as_deref(), Context::new(&work, &run))?;
    let labels = labelled.as_ref().map(|labelled| labelled.labels.clone());
    let colours = match (&mut labelled, &labels) {
        (Some(labelled), Some(labels)) => labelled.colours(&opened, labels, &run)?,
        _ => Vec::new(),
    };
    let names = labelled.map_or_else(Vec::new, |labelled| labelled.names);
    let draw = || render_named(&opened, labels.as_deref(), (&colours, &names), &params, Context::new(&work, &run));
    let (image, _) = run.stage("draw", "faces", (faces * params.views) as u64, draw)?;
    let undrawn = undrawn(&opened, &run)?;
    if undrawn > 0 {
        let verb = if undrawn == 1 { "face has a corner" } else { "faces have corners" };
        let why = "whose coordinates are not finite numbers, and cannot be drawn";
        run.progress.note(&format!("{}: {undrawn} {verb} {why}", opened.path().display()));
    }
    run.stage("write", "pixels", (image.width * image.height) as u64, || image.write_png(&target))?;
    Ok(())
}

/// Rejects a file of labels that is missing or has an extension other than .seg and .npy, before a mesh is read.
pub(super) fn check_labels(given: Option<&PathBuf>) -> Result<(), CliError> {
    check_extensions("--labels", given, &["seg", "npy"], "give a .seg or .npy file")?;
    Ok(given.map_or(Ok(()), |path| check_there(path))?)
}

/// The labels of `mesh` in the file `given`, or in the mesh's own file; `None` if there are none.
fn labelled(mesh: &Mesh, given: Option<&Path>, context: Context<'_>) -> Result<Option<LabelledFaces>> {
    match given {
        Some(path) => LabelledFaces::of_file(path, mesh, context.work).map(Some),
        None => LabelledFaces::of_mesh(mesh, context),
    }
}
