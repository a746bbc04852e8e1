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

pub use crate::apps::evaluate::Scores;
pub use crate::apps::export::SaveOptions;
pub use crate::apps::study::SampleRecord;
pub use crate::apps::transfer::Transferred;
