//! The sample on which parts are decided: rows of distances over all faces, averaged over cells.
//!
//! The decision needs only the averages. A kept work directory keeps the rows nevertheless: a run with other options,
//! an embedding, or a run after a killed one can use them. In a temporary one each row is averaged as soon as its front
//! is done and then discarded. That saves 4 l bytes of disk per face, 80 to 240, and the time to write and read them.
//! The averages are the same numbers either way.
//!
//! Cost: one front per landmark, and one pass over each row; l × 2,000 averages are kept.

use super::labels::SegmentStats;
use super::params::SegmentParams;
use super::surface::{PreparedSurface, WeightedSurface};
use crate::base::Result;
use crate::base::parallel::lock;
use crate::cluster::cells::{self, CellAverages, greatest_share};
use crate::distance::DistanceRows;
use crate::distance::VisitedRow;
use crate::distance::rows::{Landmarks, ROWS, RowParams};
use crate::graph::{DualGraph, WeightedGraph};
use crate::landmarks::Sampling;
use crate::store::Context;
use crate::store::needs::{BudgetEstimate, Extent, Needs};
use crate::store::stage::{BuiltStage, Stage};
use serde_json::{Value, json};
use std::sync::{Mutex, PoisonError};

/// Maximum share of the surface that may be nearest to a single landmark.
const OUTLIERS: f64 = 0.8;
/// With this few landmarks, outliers cannot be judged.
const FEW: usize = 10;
/// The file of the averages.
const FILE: &str = "cell_rows.npy";

/// The rows `[A B]` for `params`.
pub(super) fn rows(
    graph: &DualGraph,
    weighted: &WeightedGraph,
    l: usize,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<DistanceRows> {
    DistanceRows::build(
        weighted,
        graph.nodes.view(),
        RowParams { l, sampling: params.sampling.unwrap_or_default() },
        context,
    )
}

/// Landmarks, and their distances averaged over cells.
pub(super) struct Sample {
    pub landmarks: Landmarks,
    /// Distances of each landmark from the earlier ones (lengths 0, 1, … l − 1).
    pub between: Vec<Vec<f32>>,
    /// Mean distances of cells, row-major l × S.
    pub b: Vec<f64>,
    /// How landmarks were chosen.
    pub sampling: Sampling,
}

impl Sample {
    /// Number of landmarks.
    pub fn len(&self) -> usize {
        self.landmarks.nodes.len()
    }
}

impl WeightedSurface<'_> {
    /// The sample for `params`, with `l` landmarks; if they are farthest points that turn out to be outliers, landmarks
    /// drawn by area are used instead.
    ///
    /// Farthest points are at extremities: mostly tips of limbs, which is what distinguishes parts. On a surface full
    /// of pockets, such as an isosurface of a scanned body, all of them may be in pockets. Then the rest of the surface
    /// is equally far from every landmark, one cluster of the embedding, and one part.
    pub fn representative(self, l: usize, params: &SegmentParams, context: Context<'_>) -> Result<Sample> {
        let first = self.sample(l, params, context)?;
        let share = greatest_share(&first.b, &self.surface.cells()?.graph.area);
        if first.sampling != Sampling::Farthest || l < FEW || first.len() < l || share <= OUTLIERS {
            return Ok(first);
        }
        context.run.progress.note(&format!(
            "landmarks: {:.0} % of the surface is nearest to one of {l}: the others are outliers; drawn by area \
             instead",
            100. * share
        ));
        context.work.remove(ROWS);
        self.sample(l, &params.clone().sampling(Some(Sampling::Random)), context)
    }

    fn sample(self, l: usize, params: &SegmentParams, context: Context<'_>) -> Result<Sample> {
        let sampling = params.sampling.unwrap_or_default();
        if !params.keeps_rows(context.work.durable()) {
            return self.averaged_on_the_fly(RowParams { l, sampling }, context);
        }
        let rows = rows(self.graph, self.weighted, l, params, context)?;
        let before = |k: usize| rows.landmarks[..k].iter().map(|&node| rows.row(k)[node as usize]).collect();
        Ok(Sample {
            landmarks: Landmarks { nodes: rows.landmarks.clone(), facts: rows.facts.clone() },
            between: (0..rows.len()).map(before).collect(),
            b: context.stage(CellRows { rows: &rows, surface: self.surface })?,
            sampling,
        })
    }

    /// Rows averaged as they are computed, and discarded.
    fn averaged_on_the_fly(self, params: RowParams<Sampling>, context: Context<'_>) -> Result<Sample> {
        let Self { graph, weighted, surface } = self;
        let average = CellAverages::new(surface.cells()?, &surface.shares);
        let seen = Mutex::new(vec![(Vec::new(), Vec::new()); params.l.min(graph.nodes.len())]);
        let look = |row: VisitedRow<'_>| {
            let before = row.earlier.iter().map(|&node| row.distances[node as usize]).collect();
            let mean = average.of(row.distances);
            if let Some(slot) = lock(&seen).get_mut(row.number) {
                *slot = (before, mean);
            }
            Ok(())
        };
        let landmarks = DistanceRows::stream_rows(weighted, graph.nodes.view(), params, &look, context)?;
        let seen = seen.into_inner().unwrap_or_else(PoisonError::into_inner);
        let (between, b): (Vec<_>, Vec<_>) = seen.into_iter().unzip();
        Ok(Sample { landmarks, between, b: b.concat(), sampling: params.sampling })
    }

    /// The rows of a decision that reported `numbers`, and their means over cells: usually they still exist.
    pub fn rows_used(
        self,
        numbers: &SegmentStats,
        params: &SegmentParams,
        context: Context<'_>,
    ) -> Result<(DistanceRows, Vec<f64>)> {
        let params = params.clone().sampling(numbers.sampling.or(params.sampling));
        let l = params.landmarks_over(self.graph.nodes.len());
        let rows = rows(self.graph, self.weighted, l, &params, context)?;
        let b = context.stage(CellRows { rows: &rows, surface: self.surface })?;
        Ok((rows, b))
    }
}

/// The stage that averages kept rows over cells.
struct CellRows<'a> {
    rows: &'a DistanceRows,
    surface: &'a PreparedSurface,
}

impl Stage for CellRows<'_> {
    const NAME: &'static str = "cell rows";
    const VERSION: u32 = 1;
    type Facts = ();
    /// Mean distances of cells, row-major l × S.
    type Output = Vec<f64>;

    fn inputs(&self, _: Context<'_>) -> Value {
        json!({"rows": self.rows.key, "surface": self.surface.key})
    }

    fn progress(&self) -> Option<(&'static str, u64)> {
        Some(("rows", self.rows.len() as u64))
    }

    fn make(self, _: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let Self { rows, surface } = self;
        let cells = surface.cells()?;
        let b = cells::average(rows, cells, &surface.shares, context.run)?;
        context.work.write(FILE, &b, cells.len())?;
        Ok(BuiltStage { output: b, facts: (), files: vec![FILE] })
    }

    fn open(self, (): (), _: &str, context: Context<'_>) -> Result<Vec<f64>> {
        Ok(context.work.array_of::<f64>(FILE, self.rows.len() * self.surface.cells()?.len())?.to_vec())
    }

    fn needs(_: &Extent, _: &mut BudgetEstimate) -> Needs {
        Needs::default()
    }
}
