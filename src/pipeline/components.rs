//! Parts that are the connected components of the mesh, by descending area: pieces of an assembly, buildings of a city.
//!
//! The graph's construction finds them anyway ([`crate::graph::components`]), so there are no distances, landmarks or
//! cells, and the shape does not matter. Components that only touch, without a common edge, stay apart; those with
//! edges at exactly the same positions are one, since the graph welds them.
//!
//! Cost: one pass over the nodes, some 3 ns per face, but 60 if the components' faces are mixed in the file, and 24
//! bytes per component in arrays of the work directory. Parts themselves (names, colours, reports) are not out of core:
//! each takes a kilobyte.

use super::labels::{self, Clustered, LABELS, QUALITY, SegmentStats};
use super::params::{SegmentParams, TinyComponents, grant_parts};
use crate::base::Result;
use crate::base::parallel::chunk_range;
use crate::cluster::area_shares::tiny_below;
use crate::graph::DualGraph;
use crate::graph::components::ComponentTable;
use crate::store::npy::ArrayMut;
use crate::store::{Context, Run};

const CHUNK: usize = 1 << 15;

/// Labels every face of `graph` with the number of its component. Tiny ones share the last number if `params` gives
/// them a part of their own.
///
/// # Errors
/// [`crate::base::Error::Memory`] if so many parts do not fit the budget, [`crate::base::Error::Io`],
/// [`crate::base::Error::Cancelled`].
pub(super) fn components(graph: &DualGraph, params: &SegmentParams, context: Context<'_>) -> Result<Clustered> {
    let Context { work, run } = context;
    let n = graph.nodes.len();
    labels::begin(work)?;
    let (mut labels, mut quality) = (work.array::<u32>(LABELS, &[n])?, work.array::<f32>(QUALITY, &[n])?);
    run.fill_each(quality.data(), CHUNK, |_, _| 1.)?;
    let table = graph.components.as_ref().map(|root| ComponentTable::of(root, &graph.nodes, context)).transpose()?;
    let numbers = match (&graph.components, table.flatten()) {
        (Some(root), Some(table)) => {
            let ranked = Ranked::of(&table, graph.facts.area, params.tiny_components, context)?;
            let fill = || ranked.fill(root, &table, labels.data(), run);
            run.stage("components", "faces", n as u64, fill)?;
            ranked.numbers
        }
        _ => {
            run.progress.note("all faces are connected: the mesh is left whole");
            run.fill_each(labels.data(), CHUNK, |_, _| 0)?;
            SegmentStats { faces: vec![n as u64], area: vec![graph.facts.area], ..SegmentStats::default() }
        }
    };
    let (labels, quality) = (labels.finish(false)?, quality.finish(false)?);
    Ok(Clustered::of_faces(labels, None, quality, numbers))
}

/// Several components and the parts that they become.
struct Ranked {
    /// Part of each component (c).
    part: ArrayMut<u32>,
    numbers: SegmentStats,
}

impl Ranked {
    /// Numbers the components of `table` by descending area, of a mesh with the area `total`.
    fn of(table: &ComponentTable, total: f64, tiny: TinyComponents, context: Context<'_>) -> Result<Self> {
        let (count, area, order) = (table.count(), table.area(), table.by_size(context)?);
        let (order, area_of) = (order.items(), |component: u32| area[component as usize]);
        let least = if tiny == TinyComponents::Own { tiny_below(total, area_of(order[0])) } else { 0. };
        let large = order.partition_point(|&component| area_of(component) >= least);
        let parts = large + usize::from(large < count);
        let remedy = "let tiny components share a part: `tiny_components` own";
        let _grant = grant_parts(parts, Some(remedy), context.run)?;
        let mut numbers = SegmentStats { faces: vec![0; parts], area: vec![0.; parts], ..SegmentStats::default() };
        let mut part: ArrayMut<u32> = context.work.array("component_part.tmp", &[count])?;
        for (rank, &component) in order.iter().enumerate() {
            let label = rank.min(large);
            part.data()[component as usize] = label as u32;
            numbers.faces[label] += u64::from(table.nodes()[component as usize]);
            numbers.area[label] += area_of(component);
        }
        if large < count {
            (numbers.tiny_components_label, numbers.tiny_faces) = (Some(large as u32), numbers.faces[large]);
        } else if tiny == TinyComponents::Own {
            context.run.progress.note(labels::NO_TINY_COMPONENTS);
        }
        Ok(Self { part, numbers })
    }

    /// Labels the nodes whose components are given by `root` (n) and `table`.
    fn fill(&self, root: &[u32], table: &ComponentTable, labels: &mut [u32], run: &Run) -> Result<()> {
        let part = self.part.items();
        let of_chunk = |k: usize, out: &mut [u32], near: &mut usize| {
            for (slot, i) in out.iter_mut().zip(chunk_range(root.len(), CHUNK, k)) {
                *near = table.number(root[i], *near);
                *slot = part[*near];
            }
            Ok(())
        };
        run.fill_chunks(labels, CHUNK, || 0, of_chunk).map(|_| ())
    }
}
