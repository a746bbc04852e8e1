//! `picture`: a mesh and its parts as a PNG.

use super::input::{check_there, read};
use super::options::{AppContext, CliError, ForceArgs, RunArgs};
use super::sink::{check_is_no_stream, check_places, folder_of};
use nystrom_stream::apps::colours::colours_for;
use nystrom_stream::apps::open_labels;
use nystrom_stream::apps::picture::{PictureParams, Up, render_named};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::mesh::ply::names::names_of;
use nystrom_stream::mesh::{Mesh, ends_with, ply::ElementKind};
use nystrom_stream::store::{Context, MappedSlice, WorkDir, npy};
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
    /// Which axis points up: x, y, z, -x, -y, -z [default: found]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    pub up: Option<Up>,
    /// Degrees to turn around that axis from the view found
    #[arg(long, value_name = "DEG", default_value_t = 0., allow_negative_numbers = true)]
    pub turn: f64,
    /// Degrees to look from higher than the view found
    #[arg(long, value_name = "DEG", default_value_t = 0., allow_negative_numbers = true)]
    pub tilt: f64,
    #[command(flatten)]
    pub run: RunArgs,
}

/// Width and height from "1600x1200".
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
            Some(path) => Err(CliError::Usage(format!("-o {}: a picture is a PNG; end it with .png", path.display()))),
            None if stdin => Err(CliError::Usage("-o: standard input has no name; say where the picture goes".into())),
            None => Ok(self.mesh.with_extension("png")),
        }
    }
}

pub fn run(args: &PictureArgs, app: &AppContext) -> Result<(), CliError> {
    let params = args.params();
    params.check()?;
    let target = args.target()?;
    check_is_no_stream("-o", &target)?;
    check_places([&args.mesh].into_iter().chain(&args.labels), [&target])?;
    check_there(&args.mesh)?;
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    let work = WorkDir::temporary(args.run.tmp.as_deref().unwrap_or(&folder_of(&target)))?;
    let (opened, _) = read(&args.mesh, ForceArgs::default(), Context::new(&work, &run))?;
    let faces = opened.faces.len();
    let (labels, known) = match &args.labels {
        Some(path) => (Some(labels_of_file(path, &work)?), None),
        None if has_labels(&opened) => {
            let (labels, colours) = labels_of_mesh(&opened, Context::new(&work, &run))?;
            (Some(labels), colours)
        }
        None => (None, None),
    };
    if let (Some(path), Some(labels)) = (&args.labels, &labels)
        && labels.len() != faces
    {
        let problem = format!("has {} labels for {faces} faces", labels.len());
        return Err(Error::unusable(path, problem, "give the labels of this mesh").into());
    }
    let colours = match (known, &labels) {
        (Some(colours), _) => colours,
        (None, Some(labels)) => colours_for(&opened, labels, &run)?,
        (None, None) => Vec::new(),
    };
    let names = match (&args.labels, opened.document()) {
        (None, Some(document)) => names_of(document, colours.len()),
        _ => Vec::new(),
    };
    let draw = || render_named(&opened, labels.as_deref(), (&colours, &names), &params, &run);
    let (image, _) = run.stage("draw", "faces", (faces * params.views) as u64, draw)?;
    run.stage("write", "pixels", (image.width * image.height) as u64, || image.write_png(&target))?;
    Ok(())
}

/// Labels of a .seg or .npy file; another ending is misuse.
pub(super) fn labels_of_file(path: &Path, work: &WorkDir) -> Result<MappedSlice<u32>, CliError> {
    if !["seg", "npy"].iter().any(|ending| ends_with(path, ending)) {
        let text = format!("--labels {}: unknown ending; give a .seg or .npy file", path.display());
        return Err(CliError::Usage(text));
    }
    Ok(open_labels(path, work)?)
}

/// Labels, and colours by label where they are known.
pub(super) type Labelled = (MappedSlice<u32>, Option<Vec<[u8; 3]>>);

/// Whether the faces of the file of `mesh` have labels.
pub(super) fn has_labels(mesh: &Mesh) -> bool {
    mesh.document().is_some_and(|document| document.property(ElementKind::Faces, "label").is_some())
}

/// Labels of a labelled mesh, and the parts' colours where every part has one.
pub(super) fn labels_of_mesh(mesh: &Mesh, context: Context<'_>) -> Result<Labelled> {
    /// Beyond this number of parts, colours are chosen anew.
    const MOST: usize = 1 << 20;
    let document =
        mesh.document().ok_or_else(|| Error::unusable(mesh.path(), "has no labels", "give a labelled file"))?;
    let coloured = ["red", "green", "blue"].iter().all(|name| document.property(ElementKind::Faces, name).is_some());
    let mut writer = npy::ArrayWriter::create(&context.work.file("labels.npy"), 1)?;
    let mut colours: Vec<Option<[u8; 3]>> = Vec::new();
    let mut uniform = coloured;
    document.for_each_face(["label", "red", "green", "blue"], context.run, |_, [label, colour @ ..]| {
        // A negative number is no label; its faces are grey.
        let label = u32::try_from(label).unwrap_or(u32::MAX);
        writer.push(&[label])?;
        if !uniform || label == u32::MAX {
            return Ok(());
        }
        let place = label as usize;
        uniform = place < MOST;
        if uniform {
            let colour = colour.map(|part| part.clamp(0, 255) as u8);
            if colours.len() <= place {
                colours.resize(place + 1, None);
            }
            uniform = *colours[place].get_or_insert(colour) == colour;
        }
        Ok(())
    })?;
    let colours = colours.into_iter().map(|colour| colour.unwrap_or([128; 3])).collect();
    Ok((writer.finish(false)?, uniform.then_some(colours)))
}
