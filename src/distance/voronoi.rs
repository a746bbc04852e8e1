//! Fronts from many sources: whose territory each node is, and how deep in it.
//!
//! In memory one front from all sources; where graph and values are larger than memory the same by [`Rounds`], with the
//! same bytes.

use super::carry::disown;
use super::front::{Front, mean_weight};
use super::paging::Pages;
use super::rounds::Letter;
pub use super::rounds::{BLOCK, Rounds};
use crate::base::Result;
use crate::graph::dual::Csr;
use crate::store::Run;

/// The rounds for `graph` and `bytes` of values, where they are more than the kernel can keep in memory.
fn rounds<'a>(graph: Csr<'a>, bytes: usize, run: &Run) -> Option<Rounds<'a>> {
    Pages::needed(graph, bytes, run).then(|| Rounds::within_budget(graph, run))
}

/// What [`Front::owned`] gives, by whichever way suits the memory.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn spread(graph: Csr<'_>, sources: &[u32], field: &mut [f32], owner: &mut [u32], run: &Run) -> Result<()> {
    match rounds(graph, 2 * size_of_val(field), run) {
        None => Front::new(mean_weight(graph)).owned(graph, sources, field, owner, &run.cancel).map(drop),
        Some(rounds) => rounds.cells(sources, field, owner),
    }
}

/// What [`Front::within`] gives, by whichever way suits the memory.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn within(graph: Csr<'_>, sources: &[u32], limit: f32, field: &mut [f32], run: &Run) -> Result<()> {
    match rounds(graph, 2 * size_of_val(field), run) {
        None => Front::new(mean_weight(graph)).within(graph, sources, limit, field, &run.cancel).map(drop),
        Some(rounds) => rounds.within(sources, limit, field),
    }
}

/// What [`Front::spread_owners`] gives, by whichever way suits the memory.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn spread_owners(graph: Csr<'_>, sources: &[u32], field: &mut [f32], owner: &mut [u32], run: &Run) -> Result<()> {
    match rounds(graph, 2 * size_of_val(field), run) {
        None => Front::new(mean_weight(graph)).spread_owners(graph, sources, field, owner, &run.cancel).map(drop),
        Some(rounds) => rounds.spread_owners(sources, field, owner),
    }
}

impl Rounds<'_> {
    /// What [`Front::owned`] gives.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn cells(&self, sources: &[u32], field: &mut [f32], owner: &mut [u32]) -> Result<()> {
        let seeds = || {
            let letter = |(owner, &node)| Letter { node, distance: 0., owner: owner as u32 };
            sources.iter().enumerate().map(letter).collect::<Vec<_>>()
        };
        field.fill(f32::INFINITY);
        owner.fill(u32::MAX);
        if self.deliver(seeds(), f32::INFINITY, field, owner)? {
            // Once more over the final distances: owners alone move, and nothing can be stale.
            owner.fill(u32::MAX);
            self.deliver(seeds(), f32::INFINITY, field, owner)?;
        }
        Ok(())
    }

    /// What [`Front::within`] gives.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn within(&self, sources: &[u32], limit: f32, field: &mut [f32]) -> Result<()> {
        let letters = sources.iter().map(|&node| Letter { node, distance: 0., owner: () }).collect();
        sources.iter().for_each(|&node| field[node as usize] = f32::INFINITY);
        // Owners that take no room.
        self.deliver(letters, limit, field, &mut vec![(); self.graph().len()]).map(drop)
    }

    /// What [`Front::spread_owners`] gives.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn spread_owners(&self, sources: &[u32], field: &mut [f32], owner: &mut [u32]) -> Result<()> {
        let once = |field: &mut [f32], owner: &mut [u32]| {
            let letter = |&node: &u32| Letter { node, distance: 0., owner: owner[node as usize] };
            let letters = sources.iter().map(letter).collect();
            sources.iter().for_each(|&node| field[node as usize] = f32::INFINITY);
            self.deliver(letters, f32::INFINITY, field, owner)
        };
        if once(field, owner)? {
            disown(field, owner);
            once(field, owner)?;
        }
        Ok(())
    }
}
