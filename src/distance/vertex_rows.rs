//! Rows over the vertex graph, along edges or through triangles, from landmarks that are known.
//!
//! Landmarks are chosen along edges whatever the rows (the search needs to know who is far, not how far). A row is a mapped
//! slice; threads take rows in turn. Edges cost about 40 ns a vertex and row, marching ten times as much.

use super::front::mean_weight;
use super::landmarks::choose;
use super::march::{March, Surface};
use super::rows::{RowFacts, RowParams};
use super::{DistanceRows, Front};
use crate::base::parallel::map_chunks;
use crate::base::{Error, Result};
use crate::store::rows_file::RowsFile;
use crate::store::{MappedSlice, Run, WorkDir};
use serde::{Deserialize, Serialize};

/// How far apart vertices are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Distance {
    /// Along edges: Dijkstra's, up to a third too long.
    Edges,
    /// Through triangles: fast marching.
    #[default]
    March,
}

/// Chooses landmarks on a surface.
///
/// # Errors
/// [`Error::Parameter`] for none at all, [`Error::Io`], [`Error::Cancelled`].
pub fn landmarks(surface: Surface<'_>, params: RowParams, work: &WorkDir, run: &Run) -> Result<Vec<u32>> {
    if params.l == 0 {
        return Err(Error::parameter("-l", "0 landmarks", "choose at least 1"));
    }
    let Surface { graph, nodes, .. } = surface;
    let mut field = work.array::<f32>("nearest.tmp", &[nodes.len()])?;
    let mut found = Vec::with_capacity(params.l);
    let mut front = Front::new(mean_weight(graph));
    let result = choose(
        params.sampling,
        params.l,
        (graph, None),
        nodes,
        run.seed,
        field.data(),
        &mut front,
        &run.cancel,
        &(),
        |landmark, _| {
            found.push(landmark);
            Ok(())
        },
    );
    drop(field);
    work.remove("nearest.tmp.partial");
    result.map(|_| found)
}

/// The distances from `landmarks` to all vertices, in the file `name` of `work`. Progress is told as stage `rows`.
///
/// # Errors
/// [`Error::Io`], [`Error::Cancelled`].
pub fn rows(
    surface: Surface<'_>,
    landmarks: Vec<u32>,
    distance: Distance,
    name: &str,
    work: &WorkDir,
    run: &Run,
) -> Result<DistanceRows> {
    let n = surface.nodes.len();
    let file: RowsFile<f32> = RowsFile::create(&work.file(name), landmarks.len(), n)?;
    let mean = mean_weight(surface.graph);
    let facts = map_chunks(
        run.threads,
        &run.cancel,
        landmarks.len(),
        || (Front::new(mean), March::new(mean)),
        |k, (front, march)| {
            let mut row = file.row(k)?;
            match distance {
                Distance::Edges => front.full(surface.graph, landmarks[k], &mut row, &run.cancel).map(drop)?,
                Distance::March => march.full(surface, landmarks[k], &mut row, &run.cancel)?,
            }
            run.progress.advance("rows", 1);
            Ok(RowFacts::of(&row))
        },
    )?;
    let distances: MappedSlice<f32> = file.finish(false)?;
    Ok(DistanceRows { landmarks, distances, facts, nodes: n, key: String::new() })
}
