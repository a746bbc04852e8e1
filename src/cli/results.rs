//! The sources of outputs: the labels of a mesh, and additional data for tables and pages.

use super::output::{FormArgs, Output};
use nystrom_stream::apps::edits::Edits;
use nystrom_stream::apps::export::parquet::{self, Coordinates};
use nystrom_stream::apps::export::{Form, csv};
use nystrom_stream::apps::page::{CellModel, Cuts, Page};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::cluster::parts::PartTree;
use nystrom_stream::cluster::two_means;
use nystrom_stream::mesh::Mesh;
use nystrom_stream::mesh::ply::labelled::{Labelling, write_labelled_to};
use nystrom_stream::pipeline::cuts::KeptCuts;
use nystrom_stream::pipeline::{Cluster, SegmentParams, cuts, embed};
use nystrom_stream::spectral::EmbeddingParams;
use nystrom_stream::store::{Context, MappedSlice, Run, WorkDir};
use serde_json::Value;
use std::path::Path;

/// The results to write.
pub struct Results<'a> {
    /// Labels, colours, qualities.
    pub labelling: Labelling<'a>,
    /// Options of outputs.
    pub form: FormArgs,
    /// For tables, if requested.
    pub embedding: Option<Coordinates<'a>>,
    /// For tables of parts: the share of people expected to have each, if known.
    pub agreement: &'a [f64],
    /// For pages: the run's report.
    pub report: Value,
    /// For pages: other numbers of parts.
    pub cuts: Option<&'a KeptCuts>,
    /// For pages: the part of each cell, if known.
    pub cell_labels: &'a [u32],
    /// For pages: the edits that produced the labels.
    pub edits: Option<&'a Edits>,
}

impl<'a> Results<'a> {
    /// Only labels.
    pub fn new(labelling: Labelling<'a>, form: FormArgs) -> Self {
        let (embedding, agreement, report, cell_labels) = (None, &[][..], Value::Null, &[][..]);
        Self { labelling, form, embedding, agreement, report, cuts: None, cell_labels, edits: None }
    }

    /// Writes all `outputs` as a stage; the mesh must be given if one of them [has more](Output::has_more_than_labels)
    /// than the labels.
    pub fn write(&self, outputs: &[Output], mesh: Option<&Mesh>, run: &Run) -> Result<()> {
        let each = || outputs.iter().try_for_each(|output| self.write_one(output, mesh, run));
        run.stage("write", "faces", self.labelling.labels.len() as u64, each).map(drop)
    }

    fn write_one(&self, output: &Output, mesh: Option<&Mesh>, run: &Run) -> Result<()> {
        let (labelling, options) = (&self.labelling, self.form.options(mesh));
        match (output.form(), output.path(), mesh) {
            (_, None, Some(mesh)) => {
                write_labelled_to(mesh, "<stdout>", &mut std::io::stdout().lock(), labelling, options.ply, run)
            }
            (Form::Parquet, Some(path), Some(mesh)) => parquet::write(path, mesh, labelling, self.embedding, run),
            (Form::Csv, Some(path), Some(mesh)) => csv::write(path, mesh, labelling, self.agreement, run),
            (Form::Html, Some(path), Some(mesh)) => self.page(mesh, path, run),
            (form, ..) => form.write(output.target(), mesh, labelling, &options, run),
        }
    }

    fn page(&self, mesh: &Mesh, path: &Path, run: &Run) -> Result<()> {
        let title = mesh.path().file_name().unwrap_or_default().to_string_lossy();
        let cuts = self.cuts.map(|cuts| Cuts {
            cells: &cuts.cells,
            parts: &cuts.parts,
            model: Some(CellModel {
                affinities: cuts.kept.affinities(),
                tree: &cuts.kept.decision.tree,
                start: self.cell_labels,
            }),
        });
        let Labelling { labels, colours, names, .. } = self.labelling;
        let page = Page { title: &title, mesh, labels, colours, names, cuts, edits: self.edits, report: &self.report };
        page.write(path, run)
    }
}

/// A segmented mesh, in a work directory that has the additional data for tables and pages.
pub struct Cut<'a> {
    /// Labels, colours, qualities.
    pub labelling: Labelling<'a>,
    /// The options of the cut.
    pub params: &'a SegmentParams,
    /// The hierarchy that was cut, if it is not the one of the work directory.
    pub tree: Option<&'a PartTree>,
    /// The share of people expected to have each part, if known.
    pub agreement: &'a [f64],
    /// The part of each cell, if known.
    pub cell_labels: &'a [u32],
    /// The edits that produced the labels.
    pub edits: Option<&'a Edits>,
    /// The work directory, which is only read unless an embedding has to be computed.
    pub work: &'a WorkDir,
}

impl Cut<'_> {
    /// Writes all `outputs`, pages with the `report`; the mesh must be given if one of them [has
    /// more](Output::has_more_than_labels) than the labels. Data needed only for writing go to the work directory of
    /// `context`, which may be another one.
    pub fn write(
        &self,
        outputs: &[Output],
        form: FormArgs,
        mesh: Option<&Mesh>,
        report: impl Fn() -> Result<Value>,
        context: Context<'_>,
    ) -> Result<()> {
        let Self { labelling, params, tree, agreement, cell_labels, edits, work } = *self;
        let faces = labelling.labels.len();
        let kept = Context::new(work, context.run);
        let embedding = form.embedding_columns.then(|| embedding(params, faces, mesh, kept)).transpose()?;
        let embedding = embedding.as_ref().map(|(values, dimensions)| Coordinates { values, dimensions: *dimensions });
        let page = outputs.iter().any(Output::is_page);
        let of_parts = page && params.cluster == Cluster::Parts;
        let cuts = if of_parts { cuts::kept(params.exact_rows(), tree, work, context)? } else { None };
        let report = if page { report()? } else { Value::Null };
        let cuts = cuts.as_ref();
        let results = Results { labelling, form, embedding, agreement, report, cuts, cell_labels, edits };
        results.write(outputs, mesh, context.run)
    }
}

/// The embedding of the mesh's `faces` faces in the work directory, and its dimensions: the one used for clustering,
/// else the one from `embed`. It is computed now if there is none for the current rows, with the options of the
/// previous one or the defaults.
fn embedding(
    method: &SegmentParams,
    faces: usize,
    mesh: Option<&Mesh>,
    context: Context<'_>,
) -> Result<(MappedSlice<f32>, usize), Error> {
    let clustered = method.embedding.filter(|_| method.cluster != Cluster::Parts);
    let params = || {
        let params = clustered.or_else(|| embed::kept_params(context.work));
        params.unwrap_or(EmbeddingParams::for_parts(two_means::DIMENSIONS))
    };
    let kept = embed::kept(context.work).filter(|kept| clustered.is_none_or(|params| params == kept.params));
    let facts = match (kept, mesh) {
        (Some(facts), _) => facts,
        (None, Some(mesh)) => embed::embed_again(mesh, params(), method, context)?,
        (None, None) => embed::embed(params(), method, context)?,
    };
    let coordinates = context.work.array_of(embed::FILE, faces.saturating_mul(facts.dimensions))?;
    Ok((coordinates, facts.dimensions))
}
