//! Rows over the vertex graph, along edges or through triangles, from given landmarks.
//!
//! Landmarks are chosen along edges in either case (the search needs to know which vertex is far, not how far). A row
//! is a mapped slice; threads take rows in turn. Edges cost about 40 ns per vertex and row, marching ten times as much.
//!
//! In a work directory that is kept ([`open_or_build`]), each finished row is synced and recorded in a journal. An
//! interrupted run continues from the journal. Finished rows are a stage, which later runs with the same landmarks
//! open.

use super::front::mean_weight;
use super::journal::{JobSpec, JournalEntry, ResumeState, RowFacts, checksum};
use super::march::{March, Surface};
use super::rows::{LANDMARKS, ROWS, RowParams};
use super::sampler::{GraphSpace, Sampler, SearchGraph};
use super::{DistanceRows, Front};
use crate::base::{Error, Result};
use crate::store::needs::{BudgetEstimate, Extent, Needs};
use crate::store::rows_file::RowsFile;
use crate::store::stage::{BuiltStage, Stage};
use crate::store::{Context, MappedSlice};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// How distances between vertices are measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Distance {
    /// Along edges: Dijkstra's algorithm, up to a third too long.
    Edges,
    /// Through triangles: fast marching.
    #[default]
    March,
}

/// Chooses landmarks on a surface.
///
/// # Errors
/// [`Error::Parameter`] if none are requested, [`Error::Io`], [`Error::Cancelled`].
pub fn landmarks(surface: Surface<'_>, params: RowParams<impl Sampler>, context: Context<'_>) -> Result<Vec<u32>> {
    chosen(surface, &params.sampling, params.l, context)
}

fn chosen(surface: Surface<'_>, sampler: &dyn Sampler, l: usize, context: Context<'_>) -> Result<Vec<u32>> {
    if l == 0 {
        return Err(Error::parameter("landmarks", "0 landmarks", "choose at least 1"));
    }
    let Surface { graph, nodes, .. } = surface;
    let mut field = context.work.array::<f32>("nearest.tmp", &[nodes.len()])?;
    let mut found = Vec::with_capacity(l);
    let mut front = Front::new(mean_weight(graph));
    // The weights of a vertex graph are lengths already.
    let search = SearchGraph { graph, nodes: nodes.into(), lengths: Some(graph) };
    let mut space = GraphSpace::new(search, &mut front, &(), context.run);
    space.sample(sampler, l, field.data(), &mut |landmark, _| {
        found.push(landmark);
        Ok(())
    })?;
    Ok(found)
}

/// The distances from `landmarks` to all vertices, in the file `name` of `work`. Progress is reported as stage `rows`.
///
/// # Errors
/// [`Error::Io`], [`Error::Cancelled`].
pub fn rows(
    surface: Surface<'_>,
    landmarks: Vec<u32>,
    distance: Distance,
    name: &str,
    context: Context<'_>,
) -> Result<DistanceRows> {
    let file = RowsFile::create(&context.work.file(name), landmarks.len(), surface.nodes.len())?;
    let state = ResumeState { file, done: BTreeMap::new(), journal: None };
    VertexRowJob { surface, landmarks, distance }.fill(state, context)
}

const JOURNAL: &str = "rows.journal";

/// Landmarks and their rows over the graph of the stage `graph` in `work`, which is kept: opened if they exist, else
/// computed, continuing an interrupted run.
///
/// # Errors
/// As [`landmarks`] and [`rows`].
pub fn open_or_build(
    surface: Surface<'_>,
    params: RowParams<impl Sampler + Serialize>,
    distance: Distance,
    graph: &str,
    context: Context<'_>,
) -> Result<DistanceRows> {
    let inputs = json!({"graph": graph, "params": params, "distance": distance, "seed": context.run.seed});
    let l = params.l.min(surface.nodes.len());
    let stage = VertexRowsStage { surface, sampler: &params.sampling, l, distance, inputs };
    let rows = context.stage(stage)?;
    // Left by this run, or by one that ended right after recording the stage.
    context.work.remove(JOURNAL);
    Ok(rows)
}

/// The stage of rows over vertices.
struct VertexRowsStage<'a> {
    surface: Surface<'a>,
    sampler: &'a dyn Sampler,
    l: usize,
    distance: Distance,
    inputs: Value,
}

impl Stage for VertexRowsStage<'_> {
    const NAME: &'static str = "vertex rows";
    const VERSION: u32 = 1;
    type Facts = Vec<RowFacts>;
    type Output = DistanceRows;

    fn inputs(&self, _: Context<'_>) -> Value {
        self.inputs.clone()
    }

    fn make(self, key: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let Self { surface, sampler, l, distance, inputs } = self;
        let nodes = surface.nodes.len();
        let spec = JobSpec { key: key.to_string(), options: inputs, rows: l, nodes, shard: 0, of: 1 };
        let search = || chosen(surface, sampler, l, context);
        let (landmarks, _) = context.run.stage("landmarks", "vertices", nodes as u64, search)?;
        let sound = |entry: &JournalEntry| landmarks.get(entry.row) == Some(&entry.landmark);
        let state = ResumeState::new(&spec, (ROWS, JOURNAL), sound, context)?;
        let fill = || {
            context.run.progress.advance("rows", state.done.len() as u64);
            VertexRowJob { surface, landmarks, distance }.fill(state, context)
        };
        let (mut rows, _) = context.run.stage("rows", "rows", l as u64, fill)?;
        crate::store::npy::write(&context.work.file(LANDMARKS), &rows.landmarks, 1, true)?;
        rows.key = spec.key;
        Ok(BuiltStage { facts: rows.facts.clone(), output: rows, files: vec![LANDMARKS, ROWS] })
    }

    fn open(self, facts: Self::Facts, key: &str, context: Context<'_>) -> Result<DistanceRows> {
        DistanceRows::open(facts, self.surface.nodes.len(), key.to_string(), context.work)
    }

    fn needs(extent: &Extent, _: &mut BudgetEstimate) -> Needs {
        Needs { keeps: 4 * extent.landmarks * extent.vertices, temporary: 4 * extent.vertices, ..Needs::default() }
    }
}

/// Rows over a vertex graph to be computed.
struct VertexRowJob<'a> {
    surface: Surface<'a>,
    landmarks: Vec<u32>,
    distance: Distance,
}

impl VertexRowJob<'_> {
    /// Computes the rows that `state` does not have yet.
    fn fill(self, state: ResumeState, context: Context<'_>) -> Result<DistanceRows> {
        let Context { work, run } = context;
        let Self { surface, landmarks, distance } = self;
        let ResumeState { file, done, journal } = state;
        let mean = mean_weight(surface.graph);
        let row = |k: usize, (front, march): &mut (Front, March)| {
            if let Some(entry) = done.get(&k) {
                return Ok(entry.facts);
            }
            let mut row = file.row(k)?;
            match distance {
                Distance::Edges => front.full(surface.graph, landmarks[k], &mut row, &run.cancel).map(drop)?,
                Distance::March => march.full(surface, landmarks[k], &mut row, &run.cancel)?,
            }
            let facts = RowFacts::of(&row);
            if let Some(journal) = &journal {
                row.sync().map_err(Error::io(work.file(ROWS), "sync"))?;
                journal.append(&JournalEntry { row: k, landmark: landmarks[k], facts, xxh3: checksum(&row) })?;
            }
            run.progress.advance("rows", 1);
            Ok(facts)
        };
        let state = || (Front::new(mean), March::new(mean));
        let facts = run.map_chunks(landmarks.len(), state, row)?;
        let distances: MappedSlice<f32> = file.finish(journal.is_some())?;
        Ok(DistanceRows { landmarks, distances, facts, nodes: surface.nodes.len(), key: String::new() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distance::sampler::{Found, Space};
    use crate::graph::VertexGraph;
    use crate::mesh::Mesh;
    use crate::store::Run;
    use crate::store::WorkDir;
    use crate::store::manifest::MANIFEST;

    /// Chooses the first vertices.
    #[derive(Serialize)]
    struct First;

    impl Sampler for First {
        fn choose(&self, l: usize, _: u64, _: &mut dyn Space, _: &mut [f32], found: &mut Found<'_>) -> Result<()> {
            (0..l as u32).try_for_each(|node| found(node, None))
        }
    }

    /// Regression: sums of rows in the manifest were not validated.
    #[test]
    fn sums_that_no_rows_have_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::new(&());
        let points = [[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        let mesh = Mesh::from_slices(&points, &[[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]).unwrap();
        let rows = || {
            let work = WorkDir::open(dir.path())?;
            let context = Context::new(&work, &run);
            let (graph, key) = VertexGraph::open_or_build(&mesh, "mesh".as_ref(), &Value::Null, context)?;
            let params = RowParams::new(2, First);
            open_or_build(Surface::of(&graph), params, Distance::Edges, &key, context)
        };
        assert!(rows().is_ok() && rows().is_ok());
        let path = dir.path().join(MANIFEST);
        let mut manifest: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        manifest["stages"]["vertex rows"]["facts"][0]["sum"] = json!(-1.);
        std::fs::write(&path, manifest.to_string()).unwrap();
        assert!(rows().unwrap_err().to_string().contains("sums that no rows can have"));
    }

    /// Regression: files had room for as many rows as were requested, and the next run found them too large.
    #[test]
    fn more_landmarks_than_vertices_are_found_again() {
        let dir = tempfile::tempdir().unwrap();
        let run = Run::new(&());
        let points = [[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        let mesh = Mesh::from_slices(&points, &[[0u32, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]).unwrap();
        for _ in 0..2 {
            let work = WorkDir::open(dir.path()).unwrap();
            let context = Context::new(&work, &run);
            let (graph, key) = VertexGraph::open_or_build(&mesh, "mesh".as_ref(), &Value::Null, context).unwrap();
            let params = RowParams::new(9, First);
            let rows = open_or_build(Surface::of(&graph), params, Distance::Edges, &key, context).unwrap();
            assert_eq!((rows.len(), rows.distances.len()), (4, 16));
        }
    }
}
