//! The two fronts of boundaries, divided into shares: depths of faces in their parts, then labels of the narrow bands.
//!
//! The start of interiors depends on the depths of all faces, so the second front waits for the first. Before the
//! shares, everything up to the decision is computed, and passes over all faces find the sources. A share of the bands
//! takes the parts from the contracted nodes and the depths from their shares, so nothing of the size of the mesh is
//! written for it.

use super::decision::{CONTRACTED, manifest_of_contraction};
use super::params::SegmentParams;
use super::surface::WeightedSurface;
use super::{contracted, input, labels, means, parts};
use crate::base::{Error, Result};
use crate::cluster::boundary::{self, CellLabels};
use crate::cluster::contract::{self, Contraction};
use crate::graph::dual::WeightsStage;
use crate::graph::row_starts::StartsForm;
use crate::graph::{DualGraph, WeightedGraph};
use crate::mesh::Mesh;
use crate::store::stage::Stage;
use crate::store::{Context, MappedSlice, Run, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Nodes with a neighbour of another part.
const BOUNDARY_NODES: &str = "depths_sources.npy";
/// Nodes where interiors end.
const INTERIOR_EDGE: &str = "bands_sources.npy";
/// Part of each contracted node.
const UNIT_PARTS: &str = "bands_parts.npy";

/// What the shares of boundaries need.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct BoundaryFacts {
    /// Key of the graph, and of the weights.
    keys: [String; 2],
    /// Number of nodes, and of contracted nodes.
    nodes: [usize; 2],
    /// Number of sources: of the depths, and of the bands. 0 if the mesh is too small to be contracted, or is a single
    /// part.
    sources: [usize; 2],
    /// Half the width of the narrow bands.
    half_width: f32,
    /// The depth at which the interior of each part begins; for bands.
    limits: Vec<f32>,
    /// Key of the labels that use them.
    used_by: String,
}

impl BoundaryFacts {
    /// Makes what the shares of the depths, or of the `bands`, need; returns its files.
    ///
    /// # Errors
    /// As [`super::segment()`].
    pub fn make(
        bands: bool,
        opened: &Mesh,
        identity: &Value,
        params: &SegmentParams,
        context: Context<'_>,
    ) -> Result<(Self, Vec<&'static str>)> {
        let Context { work, run } = context;
        let (ordered, graph) = input::graph(opened, identity, params, context)?;
        let n = graph.nodes.len();
        if !params.contracts(n) {
            return Ok((Self::default(), Vec::new()));
        }
        let order = ordered.into_nodes(work)?;
        let (surface, weighted) = contracted::weighted(&graph, params, context)?;
        let whole = WeightedSurface { graph: &graph, weighted: &weighted, surface: &surface };
        let units = match means::fit(params, n) {
            Some(fit) => means::on_contraction(whole, fit, params, context)?.0,
            None => parts::units(whole, &order, params, context)?,
        };
        let (cells, label) = (units.cells(), &units.label);
        let nodes = cells.boundary_nodes(weighted.csr(), run)?;
        if nodes.is_empty() {
            return Ok((Self::default(), Vec::new()));
        }
        work.write(BOUNDARY_NODES, &nodes, 1)?;
        let depths = boundary::depth_front(&graph, boundary::half_width(&surface.shares), &nodes);
        let mut facts = Self {
            keys: [graph.key.clone(), weighted.key.clone()],
            nodes: [n, label.len()],
            sources: [nodes.len(), 0],
            half_width: depths.limit,
            limits: Vec::new(),
            used_by: labels::stage_key(&graph, params, run.seed).key,
        };
        if !bands {
            return Ok((facts, vec![BOUNDARY_NODES]));
        }
        if depths.shares(work)?.is_none() {
            // Nobody has divided them, so they are computed here.
            depths.share((0, 1), &|_| None, context)?;
        }
        let shares = depths.shares(work)?.ok_or_else(|| Error::internal("the depths of faces are gone"))?;
        let deep = |node: usize| (cells.measured(node, &surface.shares), shares.distance(node));
        facts.limits = boundary::interior_limits(n, cells.labels(), deep, depths.limit, run)?;
        let interior = |node: usize| shares.distance(node) >= facts.limits[cells.of(node) as usize];
        let edge = boundary::interior_edge(weighted.csr(), interior, run)?;
        facts.sources[1] = edge.len();
        work.write(INTERIOR_EDGE, &edge, 1)?;
        work.write(UNIT_PARTS, label, 1)?;
        Ok((facts, vec![BOUNDARY_NODES, INTERIOR_EDGE, UNIT_PARTS]))
    }

    /// Whether the graph is unchanged, and for bands its contraction: a run with other options may have made another
    /// contraction, and a later one with these options only the weights.
    pub fn is_current(&self, work: &WorkDir, run: &Run) -> bool {
        let contracted = || {
            let kept = manifest_of_contraction(work).and_then(|mut inner| inner.stages.remove(Contraction::NAME));
            kept.is_some_and(|kept| kept.key == contract::key(&self.keys[1], run.seed))
        };
        self.sources[0] == 0
            || work.has_stage(WeightsStage::NAME, &self.keys[1]) && (self.sources[1] == 0 || contracted())
    }

    /// Whether there is nothing to share, or the labels exist.
    pub fn is_done(&self, work: &WorkDir) -> bool {
        self.sources[0] == 0 || work.manifest().stages.values().any(|stage| stage.key == self.used_by)
    }

    fn boundary_nodes(&self, work: &WorkDir) -> Result<MappedSlice<u32>> {
        work.indices(BOUNDARY_NODES, self.sources[0], self.nodes[0])
    }

    /// Computes a share of the depths; returns its number of faces.
    ///
    /// # Errors
    /// As [`crate::distance::SharedFront::share`].
    pub fn share_depths(&self, shard: (usize, usize), work: &WorkDir, run: &Run) -> Result<usize> {
        let graph = DualGraph::prepared(self.keys[0].clone(), self.nodes[0], work)?;
        let nodes = self.boundary_nodes(work)?;
        boundary::depth_front(&graph, self.half_width, &nodes).share(shard, &|_| None, Context::new(work, run))
    }

    /// Computes a share of the bands; returns its number of faces. `None` if depths are missing.
    ///
    /// # Errors
    /// As [`crate::distance::SharedFront::share`].
    pub fn share_bands(&self, shard: (usize, usize), work: &WorkDir, run: &Run) -> Result<Option<usize>> {
        let [n, units] = self.nodes;
        let graph = DualGraph::prepared(self.keys[0].clone(), self.nodes[0], work)?;
        let nodes = self.boundary_nodes(work)?;
        let Some(depths) = boundary::depth_front(&graph, self.half_width, &nodes).shares(work)? else {
            return Ok(None);
        };
        let weighted = WeightedGraph::open(self.keys[1].clone(), n, StartsForm::Packed, work)?;
        let of_node = work.inner(CONTRACTED)?.indices(contract::OF_FACE, n, units)?;
        let label = work.indices(UNIT_PARTS, units, self.limits.len())?;
        let edge = work.indices(INTERIOR_EDGE, self.sources[1], n)?;
        let cells = CellLabels { of_node: &of_node, label: &label, further: &[], at_boundary: None };
        let of_edge: Vec<u32> = edge.iter().map(|&node| cells.of(node as usize)).collect();
        let interior =
            |node: usize| Some(cells.of(node)).filter(|part| depths.distance(node) >= self.limits[*part as usize]);
        let front = boundary::band_front(&weighted, &edge, &of_edge);
        front.share(shard, &interior, Context::new(work, run)).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::stage::StageKey;

    /// Regression: a run with other weights left its contraction, and one with these recomputed only the weights.
    /// Shares of bands then took the parts of one contraction's nodes from the other.
    #[test]
    fn bands_stand_on_the_contraction_of_their_weights() {
        let dir = tempfile::tempdir().unwrap();
        let (work, run) = (WorkDir::open(dir.path()).unwrap(), Run::new(&()));
        let record = |work: &WorkDir, name, version, key: &str| {
            let stage = StageKey { name, version, key: key.into(), inputs: Value::Null };
            work.record_stage(stage, &[], &(), 0.).unwrap();
        };
        record(&work, WeightsStage::NAME, WeightsStage::VERSION, "weights");
        let keys = ["graph".to_string(), "weights".to_string()];
        let depths = BoundaryFacts { keys, sources: [1, 0], ..BoundaryFacts::default() };
        let bands = BoundaryFacts { sources: [1, 1], keys: depths.keys.clone(), ..BoundaryFacts::default() };
        let current = || [&depths, &bands].map(|facts| facts.is_current(&work, &run));
        assert_eq!(current(), [true, false]);
        for (weights, same) in [("others", false), ("weights", true)] {
            let inner = work.inner(CONTRACTED).unwrap();
            record(&inner, Contraction::NAME, Contraction::VERSION, &contract::key(weights, run.seed));
            assert_eq!(current(), [true, same]);
        }
    }
}
