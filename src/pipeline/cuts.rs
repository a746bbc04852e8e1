//! The mesh in every small number of parts, from the kept hierarchy of a work directory: the data for a page's slider.

use super::decision::{self, KeptDecision};
use super::proxy::{self, ProxyMesh};
use crate::base::Result;
use crate::cluster::parts::PartTree;
use crate::cluster::{cells, contract};
use crate::graph::{DualGraph, NodeOrder};
use crate::store::{Context, MappedSlice, WorkDir};

/// Maximum number of parts.
pub const MOST: usize = 30;
const CHUNK: usize = 1 << 16;
/// Temporary file for reordering cells; a leftover of a killed run is removed by the next one.
const FILE: &str = "file_cells.tmp";

/// Cells of the faces, and the part of each cell for every number of parts.
#[derive(Clone, Debug)]
pub struct KeptCuts {
    /// Cell of each face, in file order (n).
    pub cells: MappedSlice<u32>,
    /// The part of each cell for 1, 2, … parts.
    pub parts: Vec<Vec<u32>>,
    /// The data for computing corrections.
    pub kept: KeptDecision,
}

/// The cuts into up to [`MOST`] parts of the segmented mesh in `work`, with rows over all faces if `exact`; with the
/// hierarchy `tree`, if given. `None` if cells and hierarchy do not match. Arrays go to the work directory of
/// `context`, which may be another one: `work` is only read.
///
/// # Errors
/// [`crate::base::Error::WorkDir`], [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn kept(exact: bool, tree: Option<&PartTree>, work: &WorkDir, context: Context<'_>) -> Result<Option<KeptCuts>> {
    let mut kept = KeptDecision::read(work, exact)?;
    if let Some(tree) = tree {
        kept.decision.tree = tree.clone();
    }
    let tree = &kept.decision.tree;
    let cells = cells(exact, work, context)?;
    if cells.iter().any(|&cell| cell as usize >= tree.cells()) {
        return Ok(None);
    }
    Ok(Some(KeptCuts { cells, parts: tree.first_cuts(MOST)?, kept }))
}

/// The cell of each face of the mesh in `work`, in file order (n); the cells of its contraction, unless it is small or
/// rows were `exact`. Arrays go to the work directory of `context`.
///
/// # Errors
/// As [`kept`].
pub fn cells(exact: bool, work: &WorkDir, context: Context<'_>) -> Result<MappedSlice<u32>> {
    let (graph, input) = DualGraph::kept(work)?;
    let n = graph.nodes.len();
    let order = NodeOrder::kept(&input, n, work)?;
    let mut cells = context.work.array::<u32>(FILE, &[n])?;
    if let Some(inner) = proxy::in_use(work, exact)?
        && let Some(fine) = ProxyMesh::kept(&graph, work)?
    {
        let cell = cells_of_nodes(fine.len(), exact, &inner)?;
        cells.data().iter_mut().zip(fine.of_nodes()).for_each(|(slot, own)| *slot = cell(fine.central(own) as usize));
    } else {
        let cell = cells_of_nodes(n, exact, work)?;
        context.run.fill_each(cells.data(), CHUNK, |i, _| cell(i))?;
    }
    let restored = order.restore(FILE, cells.finish(false)?, context)?;
    // Only the mapping is used from here on. No stage owns the file, so nobody else would ever remove it.
    context.work.remove(FILE);
    Ok(restored)
}

/// The cell of each of the `n` nodes of the mesh in `work`: those of its contraction, if that was used.
fn cells_of_nodes(n: usize, exact: bool, work: &WorkDir) -> Result<Box<dyn Fn(usize) -> u32 + Sync>> {
    let Some(inner) = decision::contraction_in_use(work, exact)? else {
        let of_node = work.array_of::<u16>(cells::OF_FACE, n)?;
        return Ok(Box::new(move |i| of_node[i].into()));
    };
    let of_small = inner.open_array::<u16>(cells::OF_FACE)?;
    let of_node = inner.array_of::<u16>(contract::OF_FACE, n)?;
    Ok(Box::new(move |i| of_small.get(of_node[i] as usize).map_or(u32::MAX, |&cell| cell.into())))
}
