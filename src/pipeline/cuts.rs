//! The mesh in every small number of parts, from the kept hierarchy of a work directory: the data for a page's slider.

use super::decision::{self, KeptDecision};
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
    // Only a large mesh is contracted.
    let mut cells = context.work.array::<u32>(FILE, &[n])?;
    if let Some(inner) = decision::contraction_in_use(work, exact)? {
        let of_small = inner.open_array::<u16>(cells::OF_FACE)?;
        let of_node = inner.array_of::<u16>(contract::OF_FACE, n)?;
        let cell = |i: usize, _| of_small.get(of_node[i] as usize).map_or(u32::MAX, |&cell| cell.into());
        context.run.fill_each(cells.data(), CHUNK, cell)?;
    } else {
        let of_node = work.array_of::<u16>(cells::OF_FACE, n)?;
        context.run.fill_each(cells.data(), CHUNK, |i, _| of_node[i].into())?;
    }
    let restored = order.restore(FILE, cells.finish(false)?, context)?;
    // Only the mapping is used from here on. No stage owns the file, so nobody else would ever remove it.
    context.work.remove(FILE);
    Ok(restored)
}
