//! Scores existing labels, transfers them to another mesh, and measures how well landmarks sample a mesh.
//!
//! Thin wrappers: costs are those of [`crate::apps::evaluate`], [`crate::apps::transfer`] and [`crate::apps::study`].

use super::mesh::{admitted, checked};
use super::run::{RunOptions, run_options, work_options};
use crate::apps::evaluate::{Evaluator, Scores};
use crate::apps::study::data::{StudyData, StudyParams};
use crate::apps::study::{CompareParams, SampleRecord, StudyWidth, compare};
use crate::apps::transfer::{Transferred, transfer};
use crate::base::Result;
use crate::graph::Metric;
use crate::landmarks::{Sampler, Sampling};
use crate::mesh::Mesh;
use crate::spectral::Kernel;

/// Maximum number of seeds of a comparison.
const MOST_SEEDS: u64 = 10_000;

/// The mean scores of `labels` (faces) against each of `truths` (faces each), usually those of people: the metrics of
/// the Princeton Segmentation Benchmark, 0 if equal. The values of labels do not matter, only which faces share one.
///
/// ```
/// # fn main() -> nystrom_stream::Result<()> {
/// use nystrom_stream::{Mesh, Segmenter, evaluate};
/// let mesh = Mesh::creature(4_000)?;
/// let cut = Segmenter::new().parts(4).run(&mesh)?;
/// assert_eq!(evaluate(&mesh, cut.labels(), &[cut.labels()])?.rand, 0.);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// [`crate::Error::Parameter`] if labels and faces differ in number, or without truths.
pub fn evaluate<L: AsRef<[u32]>>(mesh: &Mesh, labels: &[u32], truths: &[L]) -> Result<Scores> {
    checked(mesh)?;
    let evaluator = Evaluator::of(mesh)?;
    let labels = evaluator.segmentation("labels", labels)?;
    evaluator.compare_many(&labels, &evaluator.segmentations(truths)?)
}

/// Transfers labels to another version of a mesh in the same position: another resolution, decimated, re-meshed.
///
/// ```
/// # fn main() -> nystrom_stream::Result<()> {
/// use nystrom_stream::{LabelTransfer, Mesh, Segmenter};
/// let (coarse, fine) = (Mesh::creature(4_000)?, Mesh::creature(8_000)?);
/// let cut = Segmenter::new().parts(4).run(&coarse)?;
/// let carried = LabelTransfer::new().run(&coarse, cut.labels(), &fine)?;
/// assert_eq!(carried.labels.len(), fine.faces.len());
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, Default)]
pub struct LabelTransfer {
    pub(super) options: RunOptions,
}

run_options!(LabelTransfer);

impl LabelTransfer {
    /// A transfer with default options.
    pub fn new() -> Self {
        Self::default()
    }

    /// Transfers `labels`, one per face of `from`, to the faces of `to`. The label [`u32::MAX`] means none; faces
    /// nearest to unlabelled ones get the label around them.
    ///
    /// # Errors
    /// [`crate::Error::Parameter`] for labels that do not match `from`; [`crate::Error::Unusable`] if no face of `from`
    /// has one, or most of `to` lies far from `from`; [`crate::Error::Memory`], [`crate::Error::Io`],
    /// [`crate::Error::Cancelled`].
    pub fn run(&self, from: &Mesh, labels: &[u32], to: &Mesh) -> Result<Transferred> {
        [from, to].into_iter().try_for_each(checked)?;
        self.options.with(|context, _| {
            let found = transfer(from, labels, to, context)?;
            if let Some(note) = found.facts.note(to.path()) {
                context.run.progress.note(&note);
            }
            Ok(found)
        })
    }
}

/// Measures how well samples of landmarks represent a mesh: Γ (eq. 6 of the paper), and the residual of held-out
/// columns.
///
/// ```
/// # fn main() -> nystrom_stream::Result<()> {
/// use nystrom_stream::landmarks::Sampling;
/// use nystrom_stream::{Mesh, SamplingQuality};
/// let mesh = Mesh::creature(3_528)?;
/// let quality = SamplingQuality::new().landmarks([5, 20]).samplings([Sampling::Farthest]).run(&mesh)?;
/// assert!(quality[1].measures.gamma > quality[0].measures.gamma);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, Default)]
pub struct SamplingQuality {
    params: CompareParams,
    seeds: Option<u64>,
    metric: Metric,
    pub(super) options: RunOptions,
}

run_options!(SamplingQuality);
work_options!(SamplingQuality);

impl SamplingQuality {
    /// Ten farthest points with the exponential kernel.
    pub fn new() -> Self {
        Self::default()
    }

    /// Numbers of landmarks to measure; more than there are faces means all faces.
    #[must_use]
    pub fn landmarks(mut self, counts: impl Into<Vec<usize>>) -> Self {
        self.params.landmarks = counts.into();
        self
    }

    /// Samplings to measure.
    #[must_use]
    pub fn samplings(mut self, samplings: impl Into<Vec<Sampling>>) -> Self {
        self.params.samplings = samplings.into();
        self
    }

    /// Number of seeds for each sampling, counted from [`SamplingQuality::seed`]; 1 by default, at most 10,000.
    #[must_use]
    pub fn seeds(mut self, count: u64) -> Self {
        self.seeds = Some(count);
        self
    }

    /// The function from distance to affinity; its width is `width` times the mean distance.
    #[must_use]
    pub fn kernel(mut self, kernel: Kernel, width: f64) -> Self {
        (self.params.kernel, self.params.width) = (kernel, StudyWidth::Mean(width));
        self
    }

    /// The metric of the edge weights.
    #[must_use]
    pub fn metric(mut self, metric: Metric) -> Self {
        self.metric = metric;
        self
    }

    /// Measures samples of the faces of `mesh`: one record per sampling, number of landmarks and seed.
    ///
    /// # Errors
    /// [`crate::Error::Parameter`] for no or 0 landmarks, no sampling, no seed or too many, or a width that is not
    /// positive; [`crate::Error::WorkDir`], [`crate::Error::Memory`], [`crate::Error::Io`],
    /// [`crate::Error::Cancelled`].
    pub fn run(&self, mesh: &Mesh) -> Result<Vec<SampleRecord>> {
        let count = self.seeds.unwrap_or(1);
        if count > MOST_SEEDS {
            let problem = format!("{count} seeds");
            return Err(crate::Error::parameter("seeds", problem, format!("choose from 1 to {MOST_SEEDS}")));
        }
        let seeds = (0..count).map(|seed| seed.wrapping_add(self.options.seed)).collect();
        let params = CompareParams { seeds, ..self.params.clone() };
        let lengths = params.samplings.iter().any(|sampling| sampling.needs_lengths());
        let data = StudyParams { metric: self.metric, matrix: 0, lengths, ..StudyParams::default() };
        self.options.with(|context, _| {
            checked(mesh)?;
            let data = StudyData::of(mesh, &admitted(mesh, self.options.force, context)?, data, context)?;
            compare(&data, &mesh.path().to_string_lossy(), &params, context)
        })
    }
}
