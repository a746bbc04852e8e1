//! The first stages, common to all commands: the mesh in the order of its nodes, and its dual graph.

use super::SegmentParams;
use super::kept::Record;
use crate::base::Result;
use crate::graph::{DualGraph, Ordered};
use crate::mesh::Mesh;
use crate::store::Context;

/// Orders the mesh and builds its graph, or opens both; leaves a record of mesh and options for later commands.
///
/// # Errors
/// [`crate::base::Error::Unusable`] for too large meshes, [`crate::base::Error::Io`], [`crate::base::Error::Memory`],
/// [`crate::base::Error::Cancelled`].
pub fn graph(
    opened: &Mesh,
    identity: &serde_json::Value,
    params: &SegmentParams,
    context: Context<'_>,
) -> Result<(Ordered, DualGraph)> {
    let ordered = Ordered::build(&opened, params.order, identity, context)?;
    let graph = DualGraph::build(&ordered.mesh, opened.path(), &ordered.identity, context)?;
    Record::of(opened, identity, params, context.work).stamp(context)?;
    Ok((ordered, graph))
}
