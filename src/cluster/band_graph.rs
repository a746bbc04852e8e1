//! The dual graph of the narrow band along the boundaries, with what a boundary costs on each edge.
//!
//! A boundary costs its length, and less across a crease, so that one on a crease stays there. What counts as a
//! crease depends on the mesh: turning that most of the band's edges have is the shape's roundness, or noise, and
//! would only make a boundary ragged. On a rough mesh the faces' own turning counts, averaged along the edges
//! ([`super::crease`]).
//!
//! Cost: a pass over the edges of the band's nodes, which looks up their neighbours by bisection. 4 bytes per node of
//! the band and 16 per edge, on a rough mesh 48, lie in files where the budget is short; 8 per edge stay.

use super::crease::{self, CreaseEdge, OwnTurning};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range, entry_ends, parts_of};
use crate::distance::voronoi::VisitedPieces;
use crate::graph::csr::near_ranges;
use crate::graph::{Csr, SharedEdges};
use crate::spectral::exp::exp;
use crate::store::{Context, ScratchArray};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

/// Share of the band's edges that are no creases.
const USUAL: f64 = 0.75;
/// Turning cost (β|θ|), above that of a usual edge, at which a boundary costs 1/e of what it costs on a flat edge.
const CREASE: f32 = 1.;
const CHUNK: usize = 1 << 12;
/// Nodes that are looked through at a time for those of the band.
const FIELD_CHUNK: usize = 1 << 15;

/// An edge of a band's node: to another position in the band, or to a fixed node, of which only the label matters.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct BandEdge {
    /// Label, or position in the band with the bit [`INSIDE`].
    to: u32,
    /// The length of the boundary there, in any unit; less across creases.
    pub weight: f32,
}

/// Marks positions in a band; both these and labels have 31 bits.
const INSIDE: u32 = 1 << 31;

/// The edges of all positions of a band.
#[derive(Clone, Copy, Debug)]
pub struct BandGraph<'a> {
    /// First edge of each position (m + 1).
    pub start: &'a [u32],
    /// All edges.
    pub edges: &'a [BandEdge],
}

/// The arrays of a [`BandGraph`].
#[derive(Debug)]
pub struct BandArrays {
    start: ScratchArray<u32>,
    edges: ScratchArray<BandEdge>,
}

/// The graph of all nodes, as a band is taken from it.
#[derive(Clone, Copy)]
pub struct WeightedLengths<'a> {
    /// The graph under the weights that fronts use.
    pub steps: Csr<'a>,
    /// Centroid distance of each step, in the frame (nnz).
    pub centroid_distance: &'a [f32],
    /// Length of the edge that each step crosses, in the frame (nnz).
    pub edge: SharedEdges<'a>,
    /// From the frame to units of √(area).
    pub unit: f32,
    /// The faces' own turning, on a rough mesh.
    pub own: Option<OwnTurning<'a>>,
}

/// The nodes, ascending, that a front has reached beyond where it started, below 0: their `field` (n) is finite.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn band_nodes(field: &[f32], visited: &VisitedPieces, context: Context<'_>) -> Result<ScratchArray<u32>> {
    let nodes = |k: usize| {
        let range = if visited.has(k * FIELD_CHUNK) { chunk_range(field.len(), FIELD_CHUNK, k) } else { 0..0 };
        range.filter(|&i| field[i] >= 0. && field[i] < f32::INFINITY).map(|i| i as u32)
    };
    let count = |k: usize, (): &mut ()| Ok(nodes(k).count());
    let counts = context.run.map_chunks(chunk_count(field.len(), FIELD_CHUNK), || (), count)?;
    let mut band = ScratchArray::<u32>::new("band.tmp", counts.iter().sum(), context)?;
    let ends = counts.iter().scan(0, |end, count| {
        *end += count;
        Some(*end)
    });
    let fill = |k: usize, band: &mut &mut [u32], (): &mut ()| {
        band.iter_mut().zip(nodes(k)).for_each(|(item, node)| *item = node);
        Ok(())
    };
    context.run.fill_pieces(parts_of(&mut band, ends), || (), fill)?;
    Ok(band)
}

impl BandArrays {
    /// The graph of the nodes of `band` (ascending), with fixed nodes of these `labels` (n) around them.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn of(graph: WeightedLengths<'_>, band: &[u32], labels: &[u32], context: Context<'_>) -> Result<Self> {
        let WeightedLengths { steps, centroid_distance, edge, unit, own } = graph;
        let run = context.run;
        let mut start = ScratchArray::<u32>::new("band_starts.tmp", band.len() + 1, context)?;
        run.fill_each(&mut start[1..], CHUNK, |i, _| steps.span(band[i]).len() as u32)?;
        let mut end = 0;
        for start in start.iter_mut() {
            end += *start;
            *start = end;
        }
        // On a smooth mesh the weights know how much the surface turns, on a rough one creases are gathered for it.
        let entries = end as usize;
        let (smooth, rough) = (usize::from(own.is_none()), usize::from(own.is_some()));
        let mut edges = ScratchArray::<BandEdge>::new("band_edges.tmp", entries, context)?;
        let mut turning = ScratchArray::<f32>::new("turning.tmp", smooth * entries, context)?;
        let mut creases = ScratchArray::<CreaseEdge>::new("creases.tmp", rough * entries, context)?;
        let pieces = parts_of(&mut edges, entry_ends(&start, CHUNK))
            .zip(parts_of(&mut turning, entry_ends(&start, CHUNK).map(|end| smooth * end)))
            .zip(parts_of(&mut creases, entry_ends(&start, CHUNK).map(|end| rough * end)));
        let fill = |k: usize, ((edges, turning), creases): &mut ((&mut [_], &mut [_]), &mut [_]), (): &mut ()| {
            let range = chunk_range(band.len(), CHUNK, k);
            // This chunk's rows, and the next one's while it is summed up.
            let soon = || near_ranges(&band[range.start..(range.end + CHUNK).min(band.len())]);
            let entries = || soon().map(|nodes| steps.starts.entries_of(nodes));
            run.will_need_few(steps.indices, entries());
            run.will_need_few(steps.weights, entries());
            run.will_need_few(centroid_distance, entries());
            run.will_need_few(labels, soon());
            let all = band[range].iter().flat_map(|&node| steps.span(node).map(move |e| (node, e)));
            for (at, (node, e)) in all.enumerate() {
                let (length, other) = (edge.length(node, e), steps.indices[e]);
                match own {
                    Some(own) => creases[at] = own.edge(node, other, length),
                    None => turning[at] = (steps.weights[e] - centroid_distance[e] * unit).max(0.),
                }
                edges[at] = match band.binary_search(&other) {
                    Ok(position) => BandEdge::inside(position as u32, length.abs()),
                    Err(_) => BandEdge::to_fixed(labels[other as usize], length.abs()),
                };
            }
            Ok(())
        };
        run.fill_pieces(pieces, || (), fill)?;
        if own.is_some() {
            turning = crease::averaged(&start, |e| edges[e].position(), &creases, context)?;
        }
        drop(creases);
        let usual = {
            let mut all = ScratchArray::<f32>::new("usual.tmp", entries, context)?;
            all.copy_from_slice(&turning);
            usual_turning(&mut all)
        };
        run.fill_each(&mut edges, CHUNK, |e, edge| BandEdge {
            weight: edge.weight * exp(-(turning[e] - usual).max(0.) / CREASE),
            ..edge
        })?;
        Ok(Self { start, edges })
    }

    /// The graph.
    pub fn graph(&self) -> BandGraph<'_> {
        BandGraph { start: &self.start, edges: &self.edges }
    }
}

impl<'a> BandGraph<'a> {
    /// Number of positions.
    pub fn len(&self) -> usize {
        self.start.len() - 1
    }

    /// Which of the edges are those of a position.
    pub fn span(&self, position: u32) -> Range<usize> {
        self.start[position as usize] as usize..self.start[position as usize + 1] as usize
    }

    /// The edges of a position.
    pub fn around(&self, position: u32) -> &'a [BandEdge] {
        &self.edges[self.span(position)]
    }
}

impl BandEdge {
    /// An edge to a position in the band.
    pub fn inside(position: u32, weight: f32) -> Self {
        Self { to: position | INSIDE, weight }
    }

    /// An edge to a fixed node of this label.
    pub fn to_fixed(label: u32, weight: f32) -> Self {
        Self { to: label, weight }
    }

    /// The position where this edge leads to; none where it leads out of the band.
    #[inline]
    pub fn position(&self) -> Option<u32> {
        (self.to & INSIDE != 0).then_some(self.to & !INSIDE)
    }

    /// The label where this edge leads to, with the `labels` of the band's positions (m).
    #[inline]
    pub fn label(&self, labels: &[u32]) -> u32 {
        self.position().map_or(self.to, |position| labels[position as usize])
    }
}

/// The turning that [`USUAL`] of the edges do not exceed; reorders them.
fn usual_turning(turning: &mut [f32]) -> f32 {
    let usual = (turning.len().saturating_sub(1) as f64 * USUAL) as usize;
    if turning.is_empty() { 0. } else { *turning.select_nth_unstable_by(usual, f32::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_of_the_edges_turn_more_than_usual() {
        let mut turning: Vec<f32> = (0..101).map(|i| (i * 37 % 101) as f32).collect();
        assert_eq!(usual_turning(&mut turning), 75.);
        assert_eq!(usual_turning(&mut [3.]), 3.);
        assert_eq!(usual_turning(&mut []), 0.);
    }
}
