//! The main interface: a mesh, what can be done with it, and the results, without the layers in between.
//!
//! | Question | Builder | Result |
//! |---|---|---|
//! | Which parts does a mesh have? | [`Segmenter`] | [`Segmentation`], [`Hierarchy`] |
//! | Which vertex of one mesh corresponds to which of another? | `Matcher` | `Correspondence` |
//! | In which order does it stream best? | [`Sequencer`] | [`Sequence`] |
//! | How well do landmarks represent it (Γ, eq. 6)? | [`SamplingQuality`] | [`SampleRecord`]s |
//! | How well do labels agree with people's? | [`evaluate()`] | [`Scores`] |
//! | Which labels does another version of it get? | [`LabelTransfer`] | [`Transferred`] |
//!
//! Builders are plain values: cheap to clone, reusable for many meshes, [`Send`]. All have the options of a run:
//! threads, memory, seed, folders, progress, cancellation. Arrays between the stages are kept in memory as long as half
//! of the memory budget stays free; the rest goes to a temporary folder, so that larger meshes only take longer.
//! Results do not depend on threads or memory.

#[cfg(feature = "correspondence")]
pub mod correspond;
pub mod labels;
mod mesh;
mod run;
pub mod segment;
pub mod sequence;

#[cfg(feature = "correspondence")]
pub use correspond::{Correspondence, Matcher};
pub use labels::{LabelTransfer, SamplingQuality, evaluate};
pub use segment::{Hierarchy, Segmentation, Segmenter};
pub use sequence::{Sequence, Sequencer};

/// The types of the builders' options and of what results hold, from all layers: `use nystrom_stream::options::*`.
///
/// ```
/// use nystrom_stream::options::{Cluster, Edit, Edits, EmbeddingParams, KernelWidth, Place, Walls};
/// use nystrom_stream::Segmenter;
/// let name = Edit::Name { at: Place::Face(0), name: "head".into() };
/// let named = Segmenter::new().walls(Walls::Own).edits(Edits { edits: vec![name], ..Edits::default() });
/// let embedding = EmbeddingParams { width: KernelWidth::Mean(0.5), ..EmbeddingParams::for_parts(4) };
/// let paper = Segmenter::new().method(Cluster::KMeans).parts(4).embedding(embedding);
/// # assert!(named.params().check().is_ok() && paper.params().check().is_ok());
/// ```
pub mod options {
    #[cfg(feature = "correspondence")]
    pub use crate::apps::correspond::{
        Refine,
        matches::{Match, Matching},
    };
    pub use crate::apps::edits::{Colour, Edit, Edits, Place};
    pub use crate::apps::export::split::PartForm;
    pub use crate::apps::sequence::{SequenceOrder, StreamMeasures};
    pub use crate::apps::transfer::TransferCounts;
    pub use crate::cluster::parts::{Decision, PartCount, PartTree, PartsParams};
    #[cfg(feature = "correspondence")]
    pub use crate::distance::vertex_rows::Distance;
    pub use crate::graph::{Metric, Order};
    pub use crate::landmarks::Sampling;
    pub use crate::mesh::{PlyForm, UNLABELLED};
    pub use crate::pipeline::report::Report;
    pub use crate::pipeline::{Boundaries, Cluster, SegmentParams, TinyComponents, Walls};
    pub use crate::spectral::{EmbeddingParams, Kernel, KernelWidth, Normalisation};
}

pub use crate::apps::evaluate::Scores;
pub use crate::apps::export::SaveOptions;
pub use crate::apps::study::SampleRecord;
pub use crate::apps::transfer::Transferred;
