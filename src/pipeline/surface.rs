//! The surface as deciding parts needs it: shares of area, normals at a radius, cells. A stage of its own, independent
//! of landmarks, weights and numbers of parts.

use crate::base::parallel::map_chunks;
use crate::base::{Error, Result};
use crate::cluster::area_shares::AreaShares;
use crate::cluster::cells::{Cells, SmoothedNormals};
use crate::cluster::normals::{self, Normals, RADII};
use crate::cluster::parts::CellGraph;
use crate::graph::DualGraph;
use crate::store::stage::options_key;
use crate::store::{Context, MappedSlice, WorkDir};
use serde::{Deserialize, Serialize};
use serde_json::json;

const NORMALS: [&str; 3] = ["normals_01.npy", "normals_02.npy", "normals_04.npy"];
const CELL_GRAPH: &str = "cell_graph.json";

/// What the nodes of a graph are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Faces of a mesh.
    Faces,
    /// Cells of a contracted one.
    Contracted,
}

/// The surface: what faces count, how they are oriented, and which cell they belong to.
pub(super) struct Surface {
    pub shares: AreaShares,
    pub cells: Cells,
    /// The smoothed normals that turning is measured with, where the faces' own are too rough.
    pub normals: Option<Normals>,
    /// Their radius, in units of √(area); 0: the faces' own.
    pub radius: f32,
    /// Key of the stage.
    pub key: String,
}

/// What the manifest keeps.
#[derive(Debug, Serialize, Deserialize)]
struct Facts {
    unit: f32,
    tiny_components: u64,
    /// Index into [`RADII`] of the normals in use.
    radius: Option<usize>,
    /// Σ length · |θ| with the faces' own normals and those at .01 and .02.
    turning: Vec<f64>,
}

impl Surface {
    /// Makes the surface of `graph`, or opens it where that was done.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn build(graph: &DualGraph, kind: Kind, context: Context<'_>) -> Result<Self> {
        let options = json!({"stage": "surface", "graph": graph.key, "seed": context.run.seed});
        let key = options_key(&options);
        if let Ok(facts) = context.work.reuse::<Facts>("surface", 1, &key) {
            context.run.progress.note("surface: reused");
            return Self::open(facts, context.work, key);
        }
        let n = graph.nodes.len() as u64;
        let shares = AreaShares::of(graph, context)?;
        let ([fine, medium, coarse], spent) =
            context.run.stage("normals", "faces", n, || smooth(graph, kind, &shares, context))?;
        let turning = normals::total_turning(graph, &shares, &[&fine, &medium], context.run)?;
        let radius = normals::choose_radius(&turning);
        let smooth = SmoothedNormals { fine: &fine, medium: &medium, coarse: &coarse };
        let (cells, seconds) =
            context.run.stage("cells", "faces", n, || Cells::cut(graph, &shares, smooth, context))?;
        drop(coarse);
        let normals = radius.map(|k| [fine, medium][k].clone());
        let mut files = vec!["surface_shares.npy", "cells.npy", CELL_GRAPH];
        for (k, name) in NORMALS.into_iter().enumerate() {
            if radius == Some(k) {
                files.push(name);
            } else {
                context.work.remove(name);
            }
        }
        let path = context.work.file(CELL_GRAPH);
        let text = serde_json::to_vec(&cells.graph).unwrap_or_default();
        std::fs::write(&path, text).map_err(Error::io(&path, "write"))?;
        let facts = Facts { unit: shares.unit, tiny_components: shares.tiny_components, radius, turning };
        context.work.stamp_as("surface", &key, &options, &files, &facts, spent + seconds)?;
        Ok(Self { shares, cells, normals, radius: radius.map_or(0., |k| RADII[k]), key })
    }

    fn open(facts: Facts, work: &WorkDir, key: String) -> Result<Self> {
        let path = work.file(CELL_GRAPH);
        let text = std::fs::read(&path).map_err(Error::io(&path, "read"))?;
        let graph: CellGraph = serde_json::from_slice(&text)
            .map_err(|error| Error::work_dir(&path, error.to_string(), "delete the work directory"))?;
        let share = work.open_array("surface_shares.npy")?;
        Ok(Self {
            shares: AreaShares { share, unit: facts.unit, tiny_components: facts.tiny_components },
            cells: Cells { of_node: work.open_array("cells.npy")?, graph },
            normals: facts.radius.and_then(|k| NORMALS.get(k)).map(|name| work.open_array(name)).transpose()?,
            radius: facts.radius.and_then(|k| RADII.get(k)).copied().unwrap_or(0.),
            key,
        })
    }
}

/// Normals at the three radii; with two threads, two fronts at a time.
fn smooth(graph: &DualGraph, kind: Kind, shares: &AreaShares, context: Context<'_>) -> Result<[Normals; 3]> {
    let made = map_chunks(
        context.run.threads.min(3),
        &context.run.cancel,
        3,
        || (),
        |k, ()| match kind {
            Kind::Faces => normals::smoothed(graph, shares, RADII[k], NORMALS[k], context),
            Kind::Contracted => normals::averaged(graph, shares, RADII[k], NORMALS[k], context),
        },
    )?;
    let mut made = made.into_iter();
    let mut next = || made.next().unwrap_or_else(MappedSlice::empty);
    Ok([next(), next(), next()])
}
