//! Connected components, and which faces are wound against the rest of theirs, by union-find over the rows.
//!
//! An edge whose faces run along it in the same direction asks for one of them to be turned: a parity between
//! nodes, kept in the top bit of the parent. A contradiction (Möbius strip, some non-manifold edges) leaves the
//! later edge unsatisfied.
//!
//! The parent array is a mapped file (4 B a node): with faces in scan or curve order its accesses
//! are as local as the graph's. A parent always has the smaller number, so the root of a
//! component is its first node, whatever the order of unions. About 10 ns a face.

use super::assemble::Rows;
use super::half_edge_pairs::AGAINST;
use super::nodes::Node;
use crate::base::Result;
use crate::store::npy::ArrayMut;
use crate::store::{Context, MappedSlice};
use std::collections::BTreeMap;

/// Nodes between looks at the stop flag.
const CHUNK: usize = 1 << 18;

/// The components of a graph.
#[derive(Debug)]
pub struct Components {
    /// Per node the first node of its component, with [`AGAINST`] where it is wound against it (n).
    pub root: MappedSlice<u32>,
    /// Whether any edge joins faces wound against each other.
    pub mixed: bool,
    /// Size and area by first node, ascending.
    pub list: BTreeMap<u32, Component>,
}

/// Size of a component.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Component {
    /// Number of nodes.
    pub nodes: u64,
    /// Area in the frame.
    pub area: f64,
}

/// The root of `node` and the parity on the way there, halving paths.
#[inline]
fn find(parent: &mut [u32], mut node: u32) -> (u32, u32) {
    let mut parity = 0;
    loop {
        let link = parent[node as usize];
        let up = link & !AGAINST;
        if up == node {
            return (node, parity);
        }
        let above = parent[up as usize];
        parity ^= link & AGAINST;
        if above & !AGAINST == up {
            return (up, parity);
        }
        // Both steps at once, for this node from now on.
        let shortcut = above ^ (link & AGAINST);
        parent[node as usize] = shortcut;
        parity ^= above & AGAINST;
        node = above & !AGAINST;
    }
}

/// Finds the components; writes `components.npy` (u32, n).
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn find_components(rows: &Rows, nodes: &[Node], context: Context<'_>) -> Result<Components> {
    let n = nodes.len();
    let mut array: ArrayMut<u32> = context.work.array("components.npy", &[n])?;
    let mut list: BTreeMap<u32, Component> = BTreeMap::new();
    let mut mixed = false;
    {
        let parent = &mut array.data()[..];
        let (indptr, indices, edge) = (&rows.indptr[..], &rows.indices[..], &rows.edge[..]);
        for i in 0..n {
            if i % CHUNK == 0 {
                context.run.cancel.check()?;
            }
            parent[i] = i as u32;
            let (mut mine, mut my_parity) = (i as u32, 0);
            for e in indptr[i] as usize..indptr[i + 1] as usize {
                // Rows ascend, and the other direction is seen from the later node.
                if indices[e] as usize >= i {
                    break;
                }
                let against = if edge[e] < 0. { AGAINST } else { 0 };
                mixed |= against != 0;
                let (other, parity) = find(parent, indices[e]);
                if other != mine {
                    let (low, high) = (mine.min(other), mine.max(other));
                    parent[high as usize] = low | (my_parity ^ parity ^ against);
                    if low != mine {
                        my_parity = parity ^ against;
                    }
                    mine = low;
                }
            }
        }
        // Parents come before children, so one ascending pass flattens everything.
        let (mut current, mut sum) = (0u32, Component::default());
        for i in 0..n {
            if i % CHUNK == 0 {
                context.run.cancel.check()?;
            }
            let link = parent[i];
            let flat = parent[(link & !AGAINST) as usize] ^ (link & AGAINST);
            if link & !AGAINST != i as u32 {
                parent[i] = flat;
            }
            let root = parent[i] & !AGAINST;
            if root != current {
                add(&mut list, current, &mut sum);
                current = root;
            }
            sum.nodes += 1;
            sum.area += f64::from(nodes[i].area);
        }
        add(&mut list, current, &mut sum);
    }
    Ok(Components { root: array.finish(false)?, mixed, list })
}

fn add(list: &mut BTreeMap<u32, Component>, root: u32, sum: &mut Component) {
    if sum.nodes > 0 {
        let entry = list.entry(root).or_default();
        entry.nodes += sum.nodes;
        entry.area += sum.area;
        *sum = Component::default();
    }
}
