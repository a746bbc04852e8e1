//! Matches the vertices of two meshes.
//!
//! A thin wrapper: costs are those of [`crate::pipeline::correspond`]. The result has 16 bytes per vertex of the first
//! mesh.

use super::mesh::{checked, identity};
use super::run::{RunOptions, run_options, work_options};
use crate::apps::correspond::matches::{Match, Matching};
use crate::apps::correspond::{Refine, files};
use crate::base::Result;
use crate::distance::vertex_rows::Distance;
use crate::landmarks::Sampling;
use crate::mesh::Mesh;
use crate::pipeline::admission::{admit_two, identity_of_two};
use crate::pipeline::correspond::{self as recipe, CorrespondParams, default_landmarks_for_vertices};
use serde_json::Value;
use std::path::Path;

/// Matches the vertices of two meshes by their spectral embeddings.
///
/// ```
/// # fn main() -> nystrom_stream::Result<()> {
/// use nystrom_stream::{Matcher, Mesh};
/// let mesh = Mesh::creature(3_528)?;
/// let found = Matcher::new().landmarks(20).run(&mesh, &mesh)?;
/// assert_eq!(found.matches().len(), mesh.positions.len());
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, Default)]
pub struct Matcher {
    params: CorrespondParams,
    landmarks: Option<usize>,
    pub(super) options: RunOptions,
}

run_options!(Matcher);
work_options!(Matcher);

impl Matcher {
    /// Matches every vertex of the first mesh with the nearest of the second; all options have their defaults.
    pub fn new() -> Self {
        Self::default()
    }

    /// The number of landmarks on each mesh; by default 50, for more than 300,000 vertices 20.
    #[must_use]
    pub fn landmarks(mut self, count: usize) -> Self {
        self.landmarks = Some(count);
        self
    }

    /// How landmarks are chosen, on each mesh independently.
    #[must_use]
    pub fn sampling(mut self, sampling: Sampling) -> Self {
        self.params.sampling = sampling;
        self
    }

    /// How distances between vertices are measured.
    #[must_use]
    pub fn distance(mut self, distance: Distance) -> Self {
        self.params.distance = distance;
        self
    }

    /// The number of coordinates of the embedding, 2 to 8.
    #[must_use]
    pub fn dimensions(mut self, dimensions: usize) -> Self {
        self.params.embedding.dimensions = dimensions;
        self
    }

    /// The width of the kernel, in mean distances; 1 by default.
    #[must_use]
    pub fn width(mut self, width: f64) -> Self {
        self.params.embedding.width = width;
        self
    }

    /// Which matches are kept.
    #[must_use]
    pub fn matching(mut self, matching: Matching) -> Self {
        self.params.matching = matching;
        self
    }

    /// Transfers the landmarks of the first mesh to the second by the first matches, and matches again.
    #[must_use]
    pub fn transfer(mut self, transfer: bool) -> Self {
        self.params.transfer = transfer;
        self
    }

    /// Which of several alignments to use if the shape is symmetric, from 0: see [`Correspondence::report`].
    #[must_use]
    pub fn alternative(mut self, alternative: usize) -> Self {
        self.params.alternative = alternative;
        self
    }

    /// How the first matches are refined; by default in smooth functions of a local sample.
    #[must_use]
    pub fn refine(mut self, refine: Refine) -> Self {
        self.params.refine = refine;
        self
    }

    /// Treats one mesh as a part of the other, at the same scale: vertices without a counterpart stay unmatched.
    #[must_use]
    pub fn partial(mut self, partial: bool) -> Self {
        self.params.partial = partial;
        self
    }

    /// Matches the vertices of `a` with those of `b`.
    ///
    /// # Errors
    /// [`crate::Error::Parameter`], [`crate::Error::Unusable`] for a mesh without triangles, [`crate::Error::WorkDir`]
    /// for a work directory of other meshes, [`crate::Error::Memory`], [`crate::Error::Io`],
    /// [`crate::Error::Cancelled`].
    pub fn run(&self, a: &Mesh, b: &Mesh) -> Result<Correspondence> {
        [a, b].into_iter().try_for_each(checked)?;
        let most = a.positions.len().max(b.positions.len());
        let params = self.params.landmarks(self.landmarks.unwrap_or(default_landmarks_for_vertices(most)));
        self.options.with(|context, log| {
            let paths = [a.path(), b.path()];
            let inputs = [identity(a, context.work, identity_of_two)?, identity(b, context.work, identity_of_two)?];
            admit_two(paths, &inputs, self.options.force, context)?;
            let inputs = (!context.work.is_temporary()).then_some(inputs);
            [a, b].into_iter().flat_map(Mesh::notes).for_each(|note| context.run.progress.note(note));
            let found = recipe::correspond(a, b, inputs.as_ref(), &params, context)?;
            let report = found.report(paths, &params, context.run, log);
            Ok(Correspondence { found, report, options: self.options.afterwards() })
        })
    }
}

/// Matches of the vertices of a mesh A in a mesh B.
#[derive(Debug)]
pub struct Correspondence {
    found: recipe::Correspondence,
    report: Value,
    options: RunOptions,
}

impl Correspondence {
    /// One match per vertex of A, with its distance and confidence (vertices of A).
    pub fn matches(&self) -> &[Match] {
        &self.found.matches
    }

    /// Whether the shape is symmetric, so that other alignments fit about as well.
    pub fn is_ambiguous(&self) -> bool {
        self.found.alignments.ambiguous
    }

    /// The alignments that fit, facts about both meshes, options, seconds by stage.
    pub fn report(&self) -> &Value {
        &self.report
    }

    /// Writes the matches as `.npy` or `.csv`, with the feature `parquet` also as `.parquet`.
    ///
    /// # Errors
    /// [`crate::Error::Parameter`] for an unknown file extension; [`crate::Error::Io`].
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        self.options.with(|context, _| files::write(path.as_ref(), &self.found.matches, context.run))
    }
}
