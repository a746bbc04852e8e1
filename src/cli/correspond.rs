//! `correspond`: matches the vertices of two meshes, and writes matches, colours, a picture, and transferred
//! properties.

use super::choices::choice;
use super::errors::of_file;
use super::input::{check_there, open_file};
use super::options::{AppContext, CliError, ForceArgs, RunArgs, ScratchArgs, misfit};
use super::output::{JsonArgs, check_extensions, check_picture};
use super::sink::check_places;
use clap::ValueEnum;
use nystrom_stream::apps::correspond::carry::{Colours, Property};
use nystrom_stream::apps::correspond::show::side_by_side;
use nystrom_stream::apps::correspond::{Match, Matching, Refine, files, pairs};
use nystrom_stream::apps::picture::{NO_PICTURE, PictureParams};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::distance::vertex_rows::Distance;
use nystrom_stream::landmarks::Sampling;
use nystrom_stream::mesh::ply::ElementKind;
use nystrom_stream::mesh::{Mesh, ply};
use nystrom_stream::pipeline::admission::{admit_two, identity_of_two};
use nystrom_stream::pipeline::correspond::{
    CorrespondParams, Correspondence, Guidance, correspond_guided, default_landmarks_for_vertices,
};
use nystrom_stream::spectral::nystrom::OrthogonalParams;
use nystrom_stream::store::{Context, Run, WorkDir, folder_of, npy};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Arguments of `correspond`.
#[derive(Clone, Debug, clap::Args)]
pub struct CorrespondArgs {
    /// The mesh whose vertices get matches: PLY, OBJ, OFF or STL, also .gz
    #[arg(value_name = "A")]
    pub a: PathBuf,
    /// The mesh that they are matched to, in the same formats
    #[arg(value_name = "B")]
    pub b: PathBuf,
    /// Matches, repeatable: .npy (records of match, distance, confidence), .csv or .parquet (columns)
    #[arg(short, long, value_name = "OUT")]
    pub output: Vec<PathBuf>,
    #[command(flatten)]
    pub json: JsonArgs,
    /// Write A and B as PLY files with coloured vertices; matched vertices have the same colour
    #[arg(long, value_names = ["A_OUT", "B_OUT"], num_args = 2)]
    pub colours: Vec<PathBuf>,
    /// What the colours on B show, in --colours and --picture [default: position]
    #[arg(long, value_enum)]
    pub colour_by: Option<ColourArg>,
    /// Draw A and B side by side in these colours, .png
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,
    /// Copy properties of the vertices or faces of B to A, such as label,quality; written to --carried
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "carried")]
    pub carry: Vec<String>,
    /// PLY file to write: A with the copied properties, without its own
    #[arg(long, value_name = "FILE", requires = "carry")]
    pub carried: Option<PathBuf>,
    /// Matches as points inside triangles of B, .npy (records of three corners and their weights)
    #[arg(long, value_name = "FILE")]
    pub points: Option<PathBuf>,
    /// The refined map between functions of A and B, .npy (k × k)
    #[arg(long, value_name = "FILE")]
    pub functional_map: Option<PathBuf>,
    /// The functions on the vertices of A and B, .npy (vertices × k each)
    #[arg(long, value_names = ["A_OUT", "B_OUT"], num_args = 2)]
    pub functions: Vec<PathBuf>,
    /// Pairs of landmarks, one per line: two vertices, or two points as six numbers
    #[arg(long, value_name = "FILE")]
    pub landmarks_file: Option<PathBuf>,
    /// Initial matches, .npy or .csv as correspond writes them, or a vector of vertices
    #[arg(long, value_name = "FILE")]
    pub initial_map: Option<PathBuf>,
    /// Keep intermediate results for both meshes in this folder and reuse them [default: a temporary folder]
    #[arg(long, value_name = "DIR")]
    pub work_dir: Option<PathBuf>,
    #[command(flatten)]
    pub force: ForceArgs,
    #[command(flatten)]
    pub method: MethodArgs,
    #[command(flatten)]
    pub run: RunArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
}

/// What the colours show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ColourArg {
    /// Position in the bounding box of B
    Position,
    /// The labels of B's faces
    Parts,
}

/// Options of the method.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Method")]
pub struct MethodArgs {
    /// Number of landmarks on each mesh, 2 to 4096 [default: 50, or 20 beyond 300,000 vertices]
    #[arg(short = 'l', long, value_name = "L", value_parser = clap::value_parser!(u32).range(2..=4096))]
    pub landmarks: Option<u32>,
    /// How landmarks are chosen
    #[arg(long, value_parser = choice::<Sampling>(), default_value = "farthest")]
    pub sampling: Sampling,
    /// How distances between vertices are measured
    #[arg(long, value_parser = choice::<Distance>(), default_value = "march")]
    pub distance: Distance,
    /// Number of leading eigenvectors, 2 to 8
    #[arg(long, value_name = "K", default_value_t = OrthogonalParams::default().dimensions)]
    pub vectors: usize,
    /// Width of the kernel, in mean distances
    #[arg(long, value_name = "X", default_value_t = 1.)]
    pub sigma: f64,
    /// How the matches from the leading eigenvectors are refined
    #[arg(long, value_parser = choice::<Refine>(), default_value = "nystrom")]
    pub refine: Refine,
    /// Keep only matches that are each other's nearest
    #[arg(long, conflicts_with = "one_to_one")]
    pub mutual: bool,
    /// Use each vertex of B at most once
    #[arg(long)]
    pub one_to_one: bool,
    /// One mesh is a part of the other, at the same scale: a crop, a scan with holes; what has no
    /// counterpart gets no match
    #[arg(long, conflicts_with_all = ["transfer", "landmarks_file", "initial_map", "alternative", "functional_map", "functions"])]
    pub partial: bool,
    /// Match again, with the landmarks of A carried to B by the first matches
    #[arg(long)]
    pub transfer: bool,
    /// Which of several alignments to use if the shape is symmetric, from 0; the report lists them
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub alternative: usize,
}

impl MethodArgs {
    fn params(&self) -> CorrespondParams {
        CorrespondParams::default()
            .landmarks(self.landmarks.map_or(0, |l| l as usize))
            .sampling(self.sampling)
            .distance(self.distance)
            .embedding(OrthogonalParams { dimensions: self.vectors, width: self.sigma, ..OrthogonalParams::default() })
            .matching(match (self.mutual, self.one_to_one) {
                (true, _) => Matching::Mutual,
                (_, true) => Matching::OneToOne,
                _ => Matching::All,
            })
            .transfer(self.transfer)
            .partial(self.partial)
            .alternative(self.alternative)
            .refine(self.refine)
    }
}

impl CorrespondArgs {
    /// All files to write, except the report.
    fn outputs(&self) -> impl Iterator<Item = &PathBuf> + Clone {
        let shown = self.output.iter().chain(&self.colours).chain(&self.picture).chain(&self.carried);
        shown.chain(&self.points).chain(&self.functional_map).chain(&self.functions)
    }

    /// Rejects invalid combinations before any work.
    fn check(&self) -> Result<(), CliError> {
        self.check_extensions()?;
        if self.colour_by.is_some() && self.colours.is_empty() && self.picture.is_none() {
            return Err(misfit("--colour-by", "--colours or --picture"));
        }
        if self.method.refine == Refine::None && (self.functional_map.is_some() || !self.functions.is_empty()) {
            return Err(CliError::Usage(
                "without refinement there are no functions to write; leave out --refine none".into(),
            ));
        }
        if self.outputs().next().is_none() && self.json.json.is_none() {
            return Err(CliError::Usage("nothing to write; give -o matches.npy or another output".into()));
        }
        if self.carry.iter().any(String::is_empty) {
            return Err(CliError::Usage("--carry: a name is empty; separate names by single commas".into()));
        }
        let repeated =
            |k: usize| self.carry[..k].contains(&self.carry[k]) || ["x", "y", "z"].contains(&&self.carry[k][..]);
        if let Some(k) = (0..self.carry.len()).find(|&k| repeated(k)) {
            let text = format!("--carry {}: the carried file would have it twice; leave one out", self.carry[k]);
            return Err(CliError::Usage(text));
        }
        let inputs = [&self.a, &self.b].into_iter().chain(&self.landmarks_file).chain(&self.initial_map);
        check_places(inputs.clone(), self.work_dir.as_deref(), self.outputs().chain(&self.json.json))?;
        Ok(inputs.into_iter().try_for_each(|path| check_there(path))?)
    }

    /// Every output has the extension of its format.
    fn check_extensions(&self) -> Result<(), CliError> {
        check_extensions("-o", &self.output, &["npy", "csv", "parquet"], &format!("use {}", files::EXTENSIONS))?;
        check_extensions("--initial-map", &self.initial_map, &["npy", "csv"], "give a .npy or .csv file")?;
        check_extensions("--colours", &self.colours, &["ply"], "use .ply")?;
        check_extensions("--picture", &self.picture, &["png"], "use .png")?;
        check_extensions("--carried", &self.carried, &["ply"], "use .ply")?;
        check_extensions("--points", &self.points, &["npy"], "use .npy")?;
        check_extensions("--functional-map", &self.functional_map, &["npy"], "use .npy")?;
        check_extensions("--functions", &self.functions, &["npy"], "use .npy")
    }
}

/// The parameters of the picture.
fn pictured() -> PictureParams {
    PictureParams::default().height(800)
}

/// Runs `correspond`.
pub fn run(args: &CorrespondArgs, app: &AppContext) -> Result<(), CliError> {
    let mut params = args.method.params();
    params.embedding.check()?;
    args.check()?;
    params.points = args.points.is_some();
    let bars = args.run.bars();
    let run = args.run.run(&bars, app);
    args.picture.as_ref().map_or(Ok(()), |_| check_picture(&pictured(), &run.budget))?;
    let beside = || args.outputs().next().map_or_else(std::env::temp_dir, |path| folder_of(path).to_path_buf());
    let work = args.scratch.work(args.work_dir.as_deref(), beside, &run)?;
    let mut inputs = None;
    if args.work_dir.is_some() {
        let both = [identity_of_two(&args.a)?, identity_of_two(&args.b)?];
        admit_two([&args.a, &args.b], &both, args.force.force, Context::new(&work, &run))?;
        inputs = Some(both);
    }
    let passing = WorkDir::temporary(work.path())?;
    let within = Context::new(&passing, &run);
    let open = |path: &Path, name: &str| -> Result<Mesh> {
        let scratch = passing.file(name);
        std::fs::create_dir_all(&scratch).map_err(Error::io(&scratch, "create"))?;
        open_file(path, &scratch, &run)
    };
    let (a, b) = (open(&args.a, "mesh-a")?, open(&args.b, "mesh-b")?);
    if args.method.landmarks.is_none() {
        params.landmarks = default_landmarks_for_vertices(a.positions.len().max(b.positions.len()));
    }
    let guidance = Guidance {
        pairs: args.landmarks_file.as_ref().map_or(Ok(Vec::new()), |path| pairs::read(path, &a, &b, &run))?,
        map: args.initial_map.as_ref().map(|path| files::read(path)).transpose()?,
    };
    let carried = Carried::read(args, &b, within)?;
    let result = correspond_guided(&a, &b, inputs.as_ref(), &params, &guidance, Context::new(&work, &run))
        .map_err(|error| of_file(error, "map", args.initial_map.as_deref()))?;
    tell(&result, args.method.alternative, &run);
    if !params.partial && one_is_open(&result) {
        run.progress
            .note("one mesh has an open boundary that the other lacks; if it is a part of the other, use --partial");
    }
    let write = || {
        args.output.iter().try_for_each(|path| files::write(path, &result.matches, &run))?;
        write_functional(args, &result)
    };
    run.stage("write", "vertices", result.matches.len() as u64, write)?;
    carried.write(args, &a, &b, &result.matches, within)?;
    if args.json.json.is_none() {
        return Ok(());
    }
    let mut report = result.report([&args.a, &args.b], &params, &run, bars.log());
    report["peak_allocated"] = json!((app.peak)());
    Ok(args.json.publish(&report)?)
}

/// Writes the outputs of the functional map.
fn write_functional(args: &CorrespondArgs, result: &Correspondence) -> Result<()> {
    if let (Some(path), Some(points)) = (&args.points, &result.points) {
        npy::write(path, points, 1, true)?;
    }
    let Some(functional) = &result.functional else { return Ok(()) };
    if let Some(path) = &args.functional_map {
        // Row by row.
        npy::write(path, functional.map.transpose().as_slice(), functional.map.ncols(), true)?;
    }
    for (path, basis) in args.functions.iter().zip(&functional.bases) {
        npy::write(path, &basis.values, basis.count, true)?;
    }
    Ok(())
}

/// What matches transfer from B to A. It is read before anything is matched, so that missing properties of B are
/// reported at once.
struct Carried {
    colours: Option<Colours>,
    properties: Vec<Property>,
}

impl Carried {
    /// Reads the requested colours and properties.
    fn read(args: &CorrespondArgs, b: &Mesh, context: Context<'_>) -> Result<Self> {
        let colours = match args.colour_by {
            _ if args.colours.is_empty() && args.picture.is_none() => None,
            None | Some(ColourArg::Position) => Some(Colours::by_position(b, context)?),
            Some(ColourArg::Parts) => Some(Colours::by_parts(b, context)?),
        };
        let properties = args.carry.iter().map(|name| Property::read(b, name, context)).collect::<Result<_>>()?;
        Ok(Self { colours, properties })
    }

    /// Writes the requested coloured meshes, picture and transferred properties.
    fn write(&self, args: &CorrespondArgs, a: &Mesh, b: &Mesh, matches: &[Match], context: Context<'_>) -> Result<()> {
        if let Some(colours) = &self.colours {
            if let [to_a, to_b] = &args.colours[..] {
                let (of_a, of_b) = (|v: usize| colours.of_match(&matches[v]), |v| colours.of_b(v));
                ply::write_annotated(to_a, a, &ply::plain::colours(of_a), &[], context.run)?;
                ply::write_annotated(to_b, b, &ply::plain::colours(of_b), &[], context.run)?;
            }
            if let Some(path) = &args.picture {
                let both = side_by_side(a, b, matches, colours, &pictured(), context);
                both.map_err(|error| error.with_remedy(NO_PICTURE))?.write_png(path)?;
            }
        }
        let Some(path) = &args.carried else { return Ok(()) };
        let columns = |of: ElementKind| -> Vec<_> {
            self.properties.iter().filter(|one| one.of == of).map(|one| one.column(a, matches)).collect()
        };
        ply::write_annotated(path, a, &columns(ElementKind::Vertices), &columns(ElementKind::Faces), context.run)
    }
}

/// Whether the boundary of one mesh is longer than the other's by more than half the square root of its area, estimated
/// from its vertices.
fn one_is_open(result: &Correspondence) -> bool {
    let [a, b] =
        result.sides.each_ref().map(|side| side.graph.boundary_vertices as f64 / (side.graph.vertices as f64).sqrt());
    (a - b).abs() > 0.5
}

/// Notes if the symmetry of the shape allows several alignments.
fn tell(result: &Correspondence, chosen: usize, run: &Run) {
    let found = &result.alignments.found;
    if !result.partial.is_empty() {
        let matched = result.matches.iter().any(|one| one.vertex().is_some());
        if matched && result.alignments.ambiguous {
            run.progress.note("ambiguous: the part may also match elsewhere, or mirrored; check the picture");
        }
    } else if found.len() > 1 {
        let others = found.len() - 1;
        run.progress.note(&format!(
            "ambiguous: the shape is symmetric, and {others} other alignment{} fit{} about as well; used {chosen}, \
             see --alternative and the report",
            if others == 1 { "" } else { "s" },
            if others == 1 { "s" } else { "" },
        ));
    } else if result.alignments.ambiguous {
        run.progress.note("ambiguous: left and right of the shape are hard to distinguish; matches may be mirrored");
    }
}
