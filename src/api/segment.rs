//! Cuts a mesh into parts, and holds the result.
//!
//! A run costs the same as [`crate::pipeline::segment()`]. Its result has 8 bytes per face, labels and confidences, in
//! memory or mapped.

use super::mesh::{admitted, checked};
use super::run::{RunOptions, run_options, work_options};
use crate::apps::edits::Edits;
#[cfg(feature = "pages")]
use crate::apps::export::Form;
use crate::apps::export::SaveOptions;
use crate::base::Result;
use crate::cluster::parts::{Decision, PartCount, PartTree};
use crate::graph::{Metric, Order};
use crate::landmarks::Sampling;
use crate::mesh::split_faces::FineLabels;
use crate::mesh::{Labelling, Mesh, MeshSize};
use crate::pipeline::decision::KeptDecision;
use crate::pipeline::edits::Corrections;
use crate::pipeline::forecast::{Forecast, Place};
use crate::pipeline::report::Report;
use crate::pipeline::{self, Boundaries, Cluster, SegmentParams, TinyComponents, Walls, cuts};
use crate::spectral::EmbeddingParams;
use crate::store::{Context, MappedSlice};
use std::path::Path;

/// Cuts meshes into parts: legs from a body, a handle from a cup.
///
/// ```
/// # fn main() -> nystrom_stream::Result<()> {
/// use nystrom_stream::{Mesh, Segmenter};
/// let mesh = Mesh::creature(4_000)?;
/// let cut = Segmenter::new().parts(6).seed(1).run(&mesh)?;
/// assert_eq!((cut.labels().len(), cut.parts()), (mesh.faces.len(), 6));
/// # Ok(())
/// # }
/// ```
///
/// A run can be observed, and stopped from another thread:
///
/// ```
/// use nystrom_stream::{Cancel, Error, Mesh, Progress, Segmenter};
/// struct Log;
/// impl Progress for Log {
///     fn end(&self, stage: &str, seconds: f64) {
///         eprintln!("{stage}: {seconds:.1} s");
///     }
/// }
/// # fn main() -> nystrom_stream::Result<()> {
/// let stop = Cancel::default();
/// let segmenter = Segmenter::new().progress(std::sync::Arc::new(Log)).cancel(stop.clone());
/// stop.cancel(); // as a rule from another thread
/// assert!(matches!(segmenter.run(&Mesh::creature(4_000)?), Err(Error::Cancelled)));
/// # Ok(())
/// # }
/// ```
///
/// Memory: some 200 bytes per face if the budget allows, else a few megabytes per thread and the rest on disk. Time:
/// about a second per million faces and core.
#[derive(Clone, Debug, Default)]
pub struct Segmenter {
    params: SegmentParams,
    edits: Option<Edits>,
    hints: Option<Vec<u32>>,
    pub(super) options: RunOptions,
}

run_options!(Segmenter);
work_options!(Segmenter);

impl Segmenter {
    /// Finds the number of parts; all options have their defaults.
    pub fn new() -> Self {
        Self::default()
    }

    /// The same with all options of `params`.
    pub fn with_params(params: SegmentParams) -> Self {
        Self { params, ..Self::default() }
    }

    /// All options as pipeline parameters.
    pub fn params(&self) -> &SegmentParams {
        &self.params
    }

    /// Exactly `count` parts.
    #[must_use]
    pub fn parts(mut self, count: usize) -> Self {
        self.params.parts.count = PartCount::Exactly(count);
        self
    }

    /// As many parts as are found, within `least` and `most`, both included.
    #[must_use]
    pub fn parts_between(mut self, least: usize, most: usize) -> Self {
        self.params.parts.count = PartCount::Between(least, most);
        self
    }

    /// Finds fewer parts (down to −1) or more (up to 1) than by default (0); cannot be combined with
    /// [`Segmenter::parts`].
    #[must_use]
    pub fn detail(mut self, detail: f64) -> Self {
        self.params.parts.detail = detail;
        self
    }

    /// The number of landmarks l, 1 to 4096; by default 120, or 240 above 300,000 faces. With [`Segmenter::exact`],
    /// above 60,000 faces, 60 to 20, fewer on larger meshes. For K-means and 2-means twice the number of parts,
    /// between 10 and 60, or 60 above 60,000 faces without [`Segmenter::exact`]; one more than parts from 60 parts on,
    /// up to 512.
    #[must_use]
    pub fn landmarks(mut self, count: usize) -> Self {
        self.params.landmarks = Some(count);
        self
    }

    /// How landmarks are chosen; by default [`SegmentParams::sampling_of`] the mesh.
    #[must_use]
    pub fn sampling(mut self, sampling: Sampling) -> Self {
        self.params.sampling = Some(sampling);
        self
    }

    /// The metric of the edge weights.
    #[must_use]
    pub fn metric(mut self, metric: Metric) -> Self {
        self.params.metric = metric;
        self
    }

    /// How faces become parts: as people would cut them, by K-means or 2-means in the embedding, or as connected
    /// components. Errors call it `cluster`, as the field of [`SegmentParams`].
    #[doc(alias = "cluster")]
    #[must_use]
    pub fn method(mut self, method: Cluster) -> Self {
        self.params.cluster = method;
        self
    }

    /// Computes rows over the mesh's own faces, not over the contraction of a large mesh, which is faster and steadier,
    /// nor over the proxy of a small one that is rough or has long triangles.
    #[must_use]
    pub fn exact(mut self, exact: bool) -> Self {
        self.params.exact = exact;
        self
    }

    /// The order in which faces are processed.
    #[must_use]
    pub fn order(mut self, order: Order) -> Self {
        self.params.order = order;
        self
    }

    /// The method of deciding on parts.
    #[must_use]
    pub fn decision(mut self, decision: Decision) -> Self {
        self.params.parts.decision = decision;
        self
    }

    /// Number of over-segmentations in the ensemble for deciding on parts; 12 by default.
    #[must_use]
    pub fn ensemble_size(mut self, size: usize) -> Self {
        self.params.parts.ensemble_size = size;
        self
    }

    /// Connected pieces below this share of the area (0 to below 1) join a neighbour.
    #[must_use]
    pub fn small_part(mut self, share: f64) -> Self {
        self.params.parts.small_part = share;
        self
    }

    /// The treatment of components too small to be parts.
    #[must_use]
    pub fn tiny_components(mut self, tiny_components: TinyComponents) -> Self {
        self.params.tiny_components = tiny_components;
        self
    }

    /// The treatment of the inside of hollow bodies.
    #[must_use]
    pub fn walls(mut self, walls: Walls) -> Self {
        self.params.walls = walls;
        self
    }

    /// How faces near boundaries are labelled.
    #[must_use]
    pub fn boundaries(mut self, boundaries: Boundaries) -> Self {
        self.params.boundaries = boundaries;
        self
    }

    /// The embedding of distances, for K-means and 2-means.
    #[must_use]
    pub fn embedding(mut self, embedding: EmbeddingParams) -> Self {
        self.params.embedding = Some(embedding);
        self
    }

    /// Corrects the parts. If the [`Segmenter::work_dir`] already has the stages for the mesh, only the corrections are
    /// computed.
    #[must_use]
    pub fn edits(mut self, edits: Edits) -> Self {
        self.edits = Some(edits);
        self
    }

    /// Hints painted on faces, one value per face (n): equal values belong together, different ones apart, 0 means no
    /// hint.
    #[must_use]
    pub fn hints(mut self, values: Vec<u32>) -> Self {
        self.hints = Some(values);
        self
    }

    /// What a run takes, before it starts: memory, disk and time of cutting the mesh at `path`, whose size is known
    /// from [`size_of_mesh`](crate::mesh::size_of_mesh) or [`MeshSize::of`]. Seconds take a calibration of about as
    /// long as a run, at most some six seconds; they are left out unless `calibrated`. The options' work directory is
    /// not opened, and taken as empty; edits and hints are not counted.
    ///
    /// # Errors
    /// As [`Forecast::new`].
    ///
    /// ```
    /// # fn main() -> nystrom_stream::Result<()> {
    /// use nystrom_stream::mesh::MeshSize;
    /// use nystrom_stream::{Mesh, Segmenter};
    /// let mesh = Mesh::creature(4_000)?;
    /// let forecast = Segmenter::new().plan(mesh.path(), MeshSize::of(&mesh), false)?;
    /// assert!(forecast.plan.memory > 0 && forecast.plan.seconds.is_none());
    /// # Ok(())
    /// # }
    /// ```
    pub fn plan(&self, path: &Path, size: MeshSize, calibrated: bool) -> Result<Forecast> {
        let temporary = self.options.temporary_folder();
        let folder = self.options.work_dir.as_deref();
        let place = Place { folder: folder.unwrap_or(&temporary), lasting: folder.is_some() };
        Forecast::new(path, size, &self.params, place, calibrated, &self.options.run(&()))
    }

    /// Cuts `mesh`.
    ///
    /// # Errors
    /// [`crate::Error::Malformed`] naming the edit that cannot be applied, or for a file that has changed since it was
    /// opened; [`crate::Error::Parameter`] for options that are out of range, without effect, or contradict each other,
    /// and for hints that do not match the faces; [`crate::Error::Unusable`] for more parts than faces, and for the box
    /// or the number of parts of edits; [`crate::Error::WorkDir`] for a work directory in use, of
    /// another mesh, or damaged; [`crate::Error::Memory`], [`crate::Error::Disk`], [`crate::Error::Io`],
    /// [`crate::Error::Cancelled`]; [`crate::Error::Internal`] if a listener panics.
    pub fn run(&self, mesh: &Mesh) -> Result<Segmentation> {
        let mut params = self.params.clone();
        if let Some(edits) =
            self.edits.as_ref().filter(|_| params.parts.count == PartCount::Found && params.parts.detail == 0.)
        {
            params.parts.count = edits.parts.map_or(params.parts.count, PartCount::Exactly);
            params.parts.detail = edits.detail.unwrap_or_default();
        }
        params.check()?;
        self.edits.as_ref().map_or(Ok(()), Edits::check)?;
        let params = &params.resolved();
        self.options.with(|context, log| {
            checked(mesh)?;
            let edits = self.edits.as_ref().map(|edits| edits.on(mesh, context.run)).transpose()?;
            let corrections = Corrections { edits: edits.as_ref(), painted: self.hints.as_deref(), transferred: false };
            let identity = admitted(mesh, self.options.force, context)?;
            let cut = pipeline::segment_corrected(mesh, &identity, params, corrections, context)?;
            let hierarchy = Hierarchy::kept(params, context)?;
            let report = Report::new(mesh.path(), params, &cut, context, log, None)?;
            Ok(Segmentation {
                mesh: mesh.clone(),
                labels: cut.labels,
                fine: cut.fine.map(|(fine, _)| fine),
                quality: cut.quality,
                colours: cut.colours,
                names: cut.names,
                #[cfg(feature = "pages")]
                cell_labels: cut.cell_labels,
                #[cfg(feature = "pages")]
                edits: self.edits.clone(),
                hierarchy,
                report,
                options: self.options.afterwards(),
            })
        })
    }
}

/// A mesh cut into parts.
#[derive(Clone, Debug)]
pub struct Segmentation {
    mesh: Mesh,
    labels: MappedSlice<u32>,
    quality: MappedSlice<f32>,
    fine: Option<FineLabels>,
    colours: Vec<[u8; 3]>,
    names: Vec<String>,
    #[cfg(feature = "pages")]
    cell_labels: Vec<u32>,
    #[cfg(feature = "pages")]
    edits: Option<Edits>,
    hierarchy: Option<Hierarchy>,
    report: Report,
    options: RunOptions,
}

impl Segmentation {
    /// One part per face, from 0, in mesh order (faces).
    pub fn labels(&self) -> &[u32] {
        &self.labels
    }

    /// The faces of a part, ascending; empty if there is no such part. One pass over the labels.
    ///
    /// ```
    /// # fn main() -> nystrom_stream::Result<()> {
    /// use nystrom_stream::{Mesh, Segmenter};
    /// let mesh = Mesh::creature(4_000)?;
    /// let cut = Segmenter::new().parts(4).run(&mesh)?;
    /// let sizes: Vec<usize> = (0..cut.parts() as u32).map(|part| cut.faces_of(part).count()).collect();
    /// assert_eq!(sizes.iter().sum::<usize>(), mesh.faces.len());
    /// # Ok(())
    /// # }
    /// ```
    pub fn faces_of(&self, part: u32) -> impl Iterator<Item = usize> + '_ {
        self.labels.iter().enumerate().filter(move |&(_, &label)| label == part).map(|(face, _)| face)
    }

    /// The confidence of each label, 0 to 1 (faces).
    pub fn confidences(&self) -> &[f32] {
        &self.quality
    }

    /// One colour (sRGB) per part; adjacent parts have colours that colour-blind people can distinguish too.
    pub fn colours(&self) -> &[[u8; 3]] {
        &self.colours
    }

    /// One name per part, empty if it has none; an empty slice if no part has one.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Number of parts.
    pub fn parts(&self) -> usize {
        self.colours.len()
    }

    /// The part of each cell of the [`Hierarchy`] before refinement of boundaries; empty if there are no cells.
    #[cfg(feature = "pages")]
    pub fn cell_labels(&self) -> &[u32] {
        &self.cell_labels
    }

    /// Counts of the mesh, areas of the parts, eigenvalues, seconds by stage; [`serde::Serialize`].
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// The same mesh in any other number of parts, approximately and immediately; `None` for another method than
    /// [`Cluster::Parts`].
    pub fn hierarchy(&self) -> Option<&Hierarchy> {
        self.hierarchy.as_ref()
    }

    /// Labels, colours and confidences in the form that writers take.
    pub fn labelling(&self) -> Labelling<'_> {
        let (quality, fine) = (Some(&self.quality[..]), self.fine.as_ref());
        Labelling { labels: &self.labels, colours: &self.colours, quality, names: &self.names, fine }
    }

    /// Writes the labelled mesh in the format given by the extension of `path`: `.ply` with a colour per face, `.seg`,
    /// `.npy` and others, see [`Mesh::save`]. With the feature `pages` also `.html` (or `.htm`), an interactive page
    /// with a slider for the number of parts.
    ///
    /// # Errors
    /// As [`Mesh::save`].
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        self.save_with(path, &SaveOptions::default())
    }

    /// The same with options.
    ///
    /// # Errors
    /// As [`Mesh::save_with`].
    pub fn save_with(&self, path: impl AsRef<Path>, options: &SaveOptions) -> Result<()> {
        #[cfg(feature = "pages")]
        if *options == SaveOptions::default() && Form::of(path.as_ref()) == Some(Form::Html) {
            return self.options.with(|context, _| self.save_page(path.as_ref(), context.run));
        }
        self.options.with(|context, _| self.mesh.save_under(path, self.labelling(), options, context.run))
    }

    #[cfg(feature = "pages")]
    fn save_page(&self, path: &Path, run: &crate::store::Run) -> Result<()> {
        use crate::apps::page::{CellModel, Cuts, Page};
        let parts = self.hierarchy.as_ref().map(|kept| kept.tree().first_cuts(cuts::MOST)).transpose()?;
        let cuts = self.hierarchy.as_ref().zip(parts.as_ref());
        let page = Page {
            title: &self.mesh.path().file_name().unwrap_or_default().to_string_lossy(),
            mesh: &self.mesh,
            labels: &self.labels,
            colours: &self.colours,
            names: &self.names,
            cuts: cuts.map(|(hierarchy, parts)| {
                let (affinities, tree) = (hierarchy.kept.affinities(), hierarchy.tree());
                let model = Some(CellModel { affinities, tree, start: &self.cell_labels });
                Cuts { cells: &hierarchy.cells, parts, model }
            }),
            edits: self.edits.as_ref(),
            report: &crate::store::json::value("the report", &self.report)?,
        };
        page.write(path, run)
    }
}

/// The hierarchy of parts from which a cut was taken: some two thousand cells, joined one by one down to one part.
///
/// Its cuts follow the borders of cells, which are within a cell of the boundaries in [`Segmentation::labels`]; for
/// refined boundaries, run again with the same [`Segmenter::work_dir`]. Memory: 4 bytes per face.
#[derive(Clone)]
pub struct Hierarchy {
    cells: MappedSlice<u32>,
    kept: KeptDecision,
}

/// Without the decision, which has a million numbers.
impl std::fmt::Debug for Hierarchy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Hierarchy").field("faces", &self.cells.len()).finish_non_exhaustive()
    }
}

impl Hierarchy {
    fn kept(params: &SegmentParams, context: Context<'_>) -> Result<Option<Self>> {
        if params.cluster != Cluster::Parts {
            return Ok(None);
        }
        let kept = KeptDecision::read(context.work, params.exact_rows())?;
        let cells = cuts::cells(params.exact_rows(), context.work, context)?;
        Ok(Some(Self { cells, kept }))
    }

    /// The joins and their levels, over cells.
    pub fn tree(&self) -> &PartTree {
        &self.kept.decision.tree
    }

    /// The decision behind the parts, which edits need.
    pub fn decision(&self) -> &KeptDecision {
        &self.kept
    }

    /// The cell of each face, in mesh order (faces).
    pub fn cells(&self) -> &[u32] {
        &self.cells
    }

    /// The mesh cut into exactly `parts` parts: one label per face, from 0 (faces). If parts were decided on shorter
    /// triangles, some may have no face. One pass over the faces.
    ///
    /// ```
    /// # fn main() -> nystrom_stream::Result<()> {
    /// use nystrom_stream::{Mesh, Segmenter};
    /// let cut = Segmenter::new().run(&Mesh::creature(4_000)?)?;
    /// let labels = cut.hierarchy().unwrap().labels(3)?;
    /// assert_eq!(labels.iter().max(), Some(&2));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`crate::Error::Parameter`] for no parts, or more than there are cells.
    pub fn labels(&self, parts: usize) -> Result<Vec<u32>> {
        let label = self.tree().cut_k(parts)?.label;
        Ok(self.cells.iter().map(|&cell| label.get(cell as usize).copied().unwrap_or(0)).collect())
    }
}
