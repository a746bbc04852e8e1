//! The surface data for deciding on parts: area shares, smoothed normals, cells. A stage of its own, independent of
//! landmarks, weights and numbers of parts.
//!
//! A large surface has no cells of its own: those of its contraction are used.
//!
//! Cost: only a sample if the surface is large and clean, else one to three fronts for normals; one front from two
//! thousand seeds (cells); 4 to 20 bytes per face are kept.

use crate::base::parallel::map_chunks;
use crate::base::{Error, Result};
use crate::cluster::area_shares::{self, AreaShares};
use crate::cluster::boundary::BoundarySurface;
use crate::cluster::cells::{Cells, OF_FACE, SmoothedNormals};
use crate::cluster::crease::OwnTurning;
use crate::cluster::normals::{self, Normals, RADII};
use crate::cluster::parts::CellGraph;
use crate::cluster::roughness;
use crate::distance::voronoi;
use crate::graph::{DualGraph, Metric, WeightedGraph};
use crate::store::manifest::MANIFEST;
use crate::store::needs::{BudgetEstimate, Extent, Needs};
use crate::store::stage::{BuiltStage, Stage};
use crate::store::{Context, MappedSlice, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

const NORMALS: [&str; 3] = ["normals_01.npy", "normals_02.npy", "normals_04.npy"];
/// The name of the kept normals for [`BudgetEstimate`].
pub(super) const NORMALS_KEPT: &str = "normals";
/// The graph of the cells.
pub(super) const CELL_GRAPH: &str = "cell_graph.json";

/// The kind of nodes in a graph.
#[derive(Clone, Copy, Debug)]
pub(super) enum Kind<'a> {
    /// Faces of a mesh.
    Faces,
    /// Nodes of a contraction: the graph of the mesh, and the face from which each node grew.
    Contracted(&'a DualGraph, &'a [u32]),
}

/// The surface: area shares of nodes, their normals, and their cells.
pub(super) struct PreparedSurface {
    pub shares: AreaShares,
    /// Cells, if parts are decided on this surface itself rather than on its contraction.
    pub cells: Option<Cells>,
    /// The smoothed normals for measuring turning, if the faces' own are too rough.
    pub normals: Option<Normals>,
    /// Their radius, in units of √(area); 0: the faces' own.
    pub radius: f32,
    /// Key of the stage.
    pub key: String,
}

impl PreparedSurface {
    /// Its cells.
    pub fn cells(&self) -> Result<&Cells> {
        self.cells.as_ref().ok_or_else(|| Error::internal("a decision on a surface that was not cut into cells"))
    }

    /// Deletes the normals in a temporary `work` once the weights are computed: 12 B of disk per face.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn release_normals(&mut self, work: &WorkDir) -> Result<()> {
        if work.is_temporary() && self.normals.take().is_some() {
            work.release(SurfaceStage::NAME, &NORMALS)?;
        }
        Ok(())
    }
}

/// A graph with its weights and its surface: the basis of rows and of their averages.
#[derive(Clone, Copy)]
pub(super) struct WeightedSurface<'a> {
    pub graph: &'a DualGraph,
    pub weighted: &'a WeightedGraph,
    pub surface: &'a PreparedSurface,
}

impl<'a> WeightedSurface<'a> {
    /// The surface for refining boundaries, if the weights use this `metric`.
    pub fn boundaries(self, metric: Metric) -> BoundarySurface<'a> {
        let Self { graph, weighted, surface } = self;
        let is_rough = surface.radius > 0.;
        let own = if is_rough { OwnTurning::new(graph.nodes.view(), metric) } else { None };
        BoundarySurface { graph, weighted, shares: &surface.shares, own }
    }
}

/// Whether each of the `n` nodes of the surface in `work` is in a tiny component.
///
/// # Errors
/// [`Error::Io`], [`Error::WorkDir`].
pub(super) fn is_tiny(n: usize, work: &WorkDir) -> Result<impl Fn(usize) -> bool> {
    let shares = work.array_of::<f32>(area_shares::FILE, n)?;
    Ok(move |node: usize| shares[node] <= 0.)
}

/// What the manifest records.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SurfaceFacts {
    unit: f32,
    tiny_nodes: u64,
    /// Index into [`RADII`] of the normals in use.
    radius: Option<usize>,
    /// Σ length · |θ| with the faces' own normals, those at .01 if they were needed, and those at .02.
    turning: Vec<f64>,
}

/// The stage that makes a [`PreparedSurface`].
pub(super) struct SurfaceStage<'a> {
    /// The graph whose surface it is.
    pub graph: &'a DualGraph,
    /// The kind of its nodes.
    pub kind: Kind<'a>,
    /// Whether cells are needed.
    pub cells: bool,
}

impl Stage for SurfaceStage<'_> {
    const NAME: &'static str = "surface";
    const VERSION: u32 = 15;
    type Facts = SurfaceFacts;
    type Output = PreparedSurface;

    fn inputs(&self, context: Context<'_>) -> Value {
        json!({"graph": self.graph.key, "cells": self.cells, "seed": context.run.seed})
    }

    fn make(self, key: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let graph = self.graph;
        let n = graph.nodes.len() as u64;
        let shares = AreaShares::of(graph, context)?;
        let (smoothed, _) = context.run.stage("normals", "faces", n, || Smoothed::of(&self, &shares, context))?;
        let Smoothed { normals: [fine, medium, coarse], radius, turning } = smoothed;
        let mut files = if shares.is_computed() { Vec::new() } else { vec![area_shares::FILE] };
        let cells = if self.cells {
            let smooth = SmoothedNormals { fine: &fine, medium: &medium, coarse: &coarse };
            let is_flipped = |node: u32| match self.kind {
                Kind::Faces => graph.is_flipped(node),
                Kind::Contracted(whole, seeds) => whole.is_flipped(seeds[node as usize]),
            };
            let cut = || Cells::cut(graph, &shares, smooth, is_flipped, context);
            let (cells, _) = context.run.stage("cells", "faces", n, cut)?;
            context.work.write_json(CELL_GRAPH, &cells.graph)?;
            files.extend([OF_FACE, CELL_GRAPH]);
            Some(cells)
        } else {
            context.work.remove(OF_FACE);
            context.work.remove(CELL_GRAPH);
            None
        };
        drop(coarse);
        let normals = radius.map(|k| [fine, medium][k].clone());
        for (k, name) in NORMALS.into_iter().enumerate() {
            if radius == Some(k) {
                files.push(name);
            } else {
                context.work.remove(name);
            }
        }
        let facts = SurfaceFacts { unit: shares.unit, tiny_nodes: shares.tiny_nodes, radius, turning };
        let radius = radius.map_or(0., |k| RADII[k]);
        let output = PreparedSurface { shares, cells, normals, radius, key: key.to_string() };
        Ok(BuiltStage { output, facts, files })
    }

    fn open(self, facts: SurfaceFacts, key: &str, context: Context<'_>) -> Result<PreparedSurface> {
        let (work, n) = (context.work, self.graph.nodes.len());
        let SurfaceFacts { unit, tiny_nodes, radius, .. } = facts;
        if !(unit > 0. && unit.is_finite()) {
            return Err(work.damaged(MANIFEST, "has a surface without size"));
        }
        let cells = if self.cells {
            let graph: CellGraph = work.read_json(CELL_GRAPH)?;
            graph.cleaned().map_err(|error| work.damaged(CELL_GRAPH, error.to_string()))?;
            Some(Cells { of_node: work.indices(OF_FACE, n, graph.len())?, graph })
        } else {
            None
        };
        Ok(PreparedSurface {
            shares: AreaShares::of_array(work.array_of(area_shares::FILE, n)?, unit, tiny_nodes),
            cells,
            normals: radius.and_then(|k| NORMALS.get(k)).map(|name| work.array_of(name, n)).transpose()?,
            radius: radius.and_then(|k| RADII.get(k)).copied().unwrap_or(0.),
            key: key.to_string(),
        })
    }

    fn needs(extent: &Extent, estimate: &mut BudgetEstimate) -> Needs {
        let (n, corners) = (extent.faces, extent.corners);
        let kept_normals = if extent.rough { 12 * n } else { 0 };
        // Shares, cells; then other normals, the field and the owners of a front, the weights of cells. Cells need
        // normals at all radii, a rough surface at two, a smooth one at none, or at one if a sample is not conclusive.
        let (keeping, temporary) = match (extent.computed, extent.contracts, extent.rough) {
            // By blocks: one front at a time.
            (true, _, true) => (0, 16 * n),
            (_, true, true) => (4 * n, 28 * n),
            (computed, true, false) => (if computed { 0 } else { 4 * n }, 0),
            _ => (6 * n, 50 * n + 4 * corners - kept_normals),
        };
        let held = estimate.reserve_array(keeping) + estimate.reserve_named(NORMALS_KEPT, kept_normals);
        let keeping = keeping + kept_normals;
        let taken = estimate.reserve_array(temporary);
        estimate.release(taken);
        Needs {
            // Not all of the temporary arrays exist at the same time.
            memory: (if extent.contracts { 12 << 20 } else { 24 << 20 }) + estimate.used() + taken / 2,
            keeps: keeping - held,
            temporary: temporary - taken,
            ..Needs::default()
        }
        .moving(if extent.contracts && !extent.rough { 20 * n } else { 145 * n }, keeping + temporary)
    }
}

/// The smoothed normals of a surface.
struct Smoothed {
    /// At each of [`RADII`]; empty where not needed.
    normals: [Normals; 3],
    /// Index into [`RADII`] of those used for measuring turning; `None`: the nodes' own.
    radius: Option<usize>,
    /// Total turning with the nodes' own normals, then with those at .01 (if they were needed) and .02; estimates for a
    /// large clean mesh.
    turning: Vec<f64>,
}

impl Smoothed {
    /// Cells need all radii. Otherwise .02 shows whether the mesh is rough, and for a large one usually a sample does;
    /// only rough ones need .01 as well.
    fn of(stage: &SurfaceStage<'_>, shares: &AreaShares, context: Context<'_>) -> Result<Self> {
        let SurfaceStage { graph, cells, .. } = *stage;
        let total = |normals: &[&Normals]| normals::total_turning(graph, shares, normals, context.run);
        let mut normals = [(); 3].map(|()| MappedSlice::empty());
        if cells {
            stage.smooth(&[0, 1, 2], &mut normals, shares, context)?;
        } else {
            let clean = |normals, turning: Vec<f64>| Ok(Self { normals, radius: None, turning });
            let sample = roughness::sampled_turning(graph, shares, context.run)?;
            if let Some(sample) = sample.filter(|&sample| stage.is_clean(sample)) {
                return clean(normals, sample.to_vec());
            }
            stage.smooth(likely_radii(sample), &mut normals, shares, context)?;
            if normals[0].is_empty() {
                let turning = total(&[&normals[1]])?;
                if !roughness::is_rough(turning[0], turning[1]) {
                    return clean(normals, turning);
                }
                stage.smooth(&[0], &mut normals, shares, context)?;
            }
        }
        let turning = total(&[&normals[0], &normals[1]])?;
        let rough = roughness::is_rough(turning[0], turning[2]);
        Ok(Self { normals, radius: rough.then(|| roughness::choose_radius(turning[1], turning[2])), turning })
    }
}

/// Indices into [`RADII`] of the normals that a mesh without cells needs, judging by its sampled turning.
fn likely_radii(sample: Option<[f64; 2]>) -> &'static [usize] {
    if sample.is_some_and(roughness::is_likely_rough) { &[0, 1] } else { &[1] }
}

impl SurfaceStage<'_> {
    /// The radii and files of the normals that a surface without cells will probably need.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub(super) fn likely_normals(&self, shares: &AreaShares, context: Context<'_>) -> Result<Vec<(f32, &'static str)>> {
        let sample = roughness::sampled_turning(self.graph, shares, context.run)?;
        let is_clean = sample.is_some_and(|sample| self.is_clean(sample));
        let radii = if is_clean { &[] } else { likely_radii(sample) };
        Ok(radii.iter().map(|&k| (RADII[k], NORMALS[k])).collect())
    }

    /// Whether the sampled turning suffices to choose the nodes' own normals.
    fn is_clean(&self, sample: [f64; 2]) -> bool {
        self.graph.nodes.len() > roughness::SAMPLED && roughness::is_clearly_clean(sample)
    }

    /// Computes normals at the [`RADII`] with indices `radii` into `normals`; with at least two threads, two fronts in
    /// parallel.
    fn smooth(
        &self,
        radii: &[usize],
        normals: &mut [Normals; 3],
        shares: &AreaShares,
        context: Context<'_>,
    ) -> Result<()> {
        // Fronts by blocks already use all threads.
        let by_blocks = voronoi::is_by_blocks(self.graph.edges.by_distance(), context.run);
        let at_a_time = if by_blocks { 1 } else { context.run.threads.min(radii.len()).max(1) };
        let made = map_chunks(
            at_a_time,
            &context.run.cancel,
            radii.len(),
            || (),
            |k, ()| {
                let (radius, file) = (RADII[radii[k]], NORMALS[radii[k]]);
                match self.kind {
                    Kind::Faces => normals::smoothed(self.graph, shares, radius, file, at_a_time, context),
                    Kind::Contracted(..) => normals::averaged(self.graph, shares, radius, file, context),
                }
            },
        )?;
        radii.iter().zip(made).for_each(|(&k, made)| normals[k] = made);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::apps::creature::{Creature, Options};
    use crate::mesh;
    use crate::store::{Run, WorkDir};

    #[test]
    fn a_clean_surface_needs_one_radius_for_the_answer_of_all() {
        let folder = tempfile::tempdir().unwrap();
        for noise in [0., 0.3] {
            let path = folder.path().join("creature.ply");
            let creature = Creature::new(&Options { faces: 62_000, noise, ..Options::default() }).unwrap();
            creature.write_ply(&path, &Run::new(&())).unwrap();
            let smoothed = |cells, threads| {
                let run = Run { threads, ..Run::new(&()) };
                let work = WorkDir::temporary(folder.path()).unwrap();
                let mesh = mesh::open(&path, work.path(), &run).unwrap();
                let context = Context::new(&work, &run);
                let graph = DualGraph::build(&mesh, &path, &Value::Null, context).unwrap();
                let shares = AreaShares::of(&graph, context).unwrap();
                let stage = SurfaceStage { graph: &graph, kind: Kind::Faces, cells };
                let Smoothed { radius, turning, .. } = Smoothed::of(&stage, &shares, context).unwrap();
                let sample = roughness::sampled_turning(&graph, &shares, &run).unwrap().unwrap();
                // Walks have no seams between cells, which contribute to turning smoothed over cells.
                let [own, coarse] = [sample[0] / turning[0], sample[1] / turning[turning.len() - 1]];
                assert!((0.8..1.2).contains(&own) && (0.5..1.1).contains(&coarse), "{sample:?} {turning:?}");
                (radius, turning)
            };
            let (radius, all) = smoothed(true, 2);
            assert_eq!(radius, if noise > 0. { Some(1) } else { None }, "{all:?}");
            for threads in [1, 2] {
                let (same, turning) = smoothed(false, threads);
                assert_eq!(same, radius);
                // Such a small mesh is examined as a whole, in different pieces.
                let whole = if noise > 0. { all.clone() } else { vec![all[0], all[2]] };
                let near = |(a, b): (&f64, &f64)| (a / b - 1.).abs() < 1e-12;
                assert!(turning.len() == whole.len() && turning.iter().zip(&whole).all(near), "{turning:?} {whole:?}");
            }
        }
    }
}
