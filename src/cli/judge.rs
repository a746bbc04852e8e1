//! `evaluate --matches`: how far from the truth the matches of `correspond` are.

use super::evaluate::Outcome;
use nystrom_stream::apps::correspond::{Errors, accuracy, files};
use nystrom_stream::base::{Error, Result};
use nystrom_stream::graph::VertexGraph;
use nystrom_stream::mesh;
use nystrom_stream::store::Context;
use nystrom_stream::store::{Run, WorkDir};
use serde_json::json;
use std::path::Path;

/// Judges `matches`, which point to vertices of `mesh`, by the vertex map `truth` (by number without one), at up to
/// `samples` vertices spread evenly.
pub fn judge(matches: &Path, mesh: &Path, truth: Option<&Path>, samples: usize, run: &Run) -> Result<Outcome> {
    let found = files::read(matches)?;
    let real = truth.map(files::read).transpose()?;
    if let Some(real) = real.as_ref().filter(|real| real.len() != found.len()) {
        let problem = format!("has {} vertices, the matches {}", real.len(), found.len());
        return Err(Error::unusable(truth.unwrap_or(matches), problem, "give the map of this mesh"));
    }
    let work = WorkDir::temporary(&std::env::temp_dir())?;
    let opened = mesh::open(mesh, work.path(), run)?;
    let graph = VertexGraph::build(&opened.mesh, mesh, Context::new(&work, run))?;
    let real = |v: usize| real.as_ref().map_or(Some(v as u32), |real| real[v]);
    let step = found.len().div_ceil(samples.max(1)).max(1);
    let (mut pairs, mut unmatched) = (Vec::new(), 0);
    for v in (0..found.len()).step_by(step) {
        match (found[v], real(v)) {
            (Some(found), Some(real)) => pairs.push((found, real)),
            (None, Some(_)) => unmatched += 1,
            (_, None) => {}
        }
    }
    let judge = || accuracy::distances(&graph, &pairs, run);
    let (errors, _) = run.stage("march", "vertices", pairs.len() as u64, judge)?;
    let errors = Errors::of(errors, unmatched);
    let mut text = format!(
        "{} vertices judged, {} without a match\nerror over √area: mean {:.4}, median {:.4}, 90 % below {:.4}, greatest {:.4}\n",
        errors.judged, errors.unmatched, errors.mean, errors.median, errors.ninth_decile, errors.most
    );
    for (i, share) in errors.curve.iter().enumerate().filter(|(i, _)| [0, 2, 5, 10, 20, 30, 40, 50].contains(i)) {
        text += &format!("{:5.1} % within {:.3}\n", 100. * share, Errors::END * i as f64 / 50.);
    }
    let json = json!({"matches": matches.display().to_string(), "mesh": mesh.display().to_string(), "errors": errors});
    Ok(Outcome { text, json: serde_json::to_string_pretty(&json).unwrap_or_default() })
}
