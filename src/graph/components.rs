//! Connected components by union-find over the rows, in node order.
//!
//! The parent array is a mapped file (4 B a node): with faces in scan or curve order its accesses
//! are as local as the graph's. A parent always has the smaller number, so the root of a
//! component is its first node, whatever the order of unions. About 10 ns a face.

use super::assemble::Rows;
use super::nodes::Node;
use crate::base::Result;
use crate::store::npy::ArrayMut;
use crate::store::{MappedSlice, Run, WorkDir};
use std::collections::BTreeMap;

/// Nodes between looks at the stop flag.
const CHUNK: usize = 1 << 18;

/// The components of a graph.
#[derive(Debug)]
pub struct Components {
    /// Per node the first node of its component (n).
    pub root: MappedSlice<u32>,
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

/// The root of `node`, halving paths on the way.
#[inline]
fn find(parent: &mut [u32], mut node: u32) -> u32 {
    loop {
        let up = parent[node as usize];
        if up == node {
            return node;
        }
        let above = parent[up as usize];
        parent[node as usize] = above;
        node = above;
    }
}

/// Finds the components; writes `components.npy` (u32, n).
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn find_components(rows: &Rows, nodes: &[Node], work: &WorkDir, run: &Run) -> Result<Components> {
    let n = nodes.len();
    let mut array: ArrayMut<u32> = work.array("components.npy", &[n])?;
    let mut list: BTreeMap<u32, Component> = BTreeMap::new();
    {
        let parent = &mut array.data()[..];
        let (indptr, indices) = (&rows.indptr[..], &rows.indices[..]);
        for i in 0..n {
            if i % CHUNK == 0 {
                run.cancel.check()?;
            }
            parent[i] = i as u32;
            let mut mine = i as u32;
            for &j in &indices[indptr[i] as usize..indptr[i + 1] as usize] {
                // Rows ascend, and the other direction is seen from the later node.
                if j as usize >= i {
                    break;
                }
                let other = find(parent, j);
                let low = mine.min(other);
                parent[mine.max(other) as usize] = low;
                mine = low;
            }
        }
        // Parents come before children, so one ascending pass flattens everything.
        let (mut current, mut sum) = (0u32, Component::default());
        for i in 0..n {
            if i % CHUNK == 0 {
                run.cancel.check()?;
            }
            let root = parent[parent[i] as usize];
            parent[i] = root;
            if root != current {
                add(&mut list, current, &mut sum);
                current = root;
            }
            sum.nodes += 1;
            sum.area += f64::from(nodes[i].area);
        }
        add(&mut list, current, &mut sum);
    }
    Ok(Components { root: array.finish(false)?, list })
}

fn add(list: &mut BTreeMap<u32, Component>, root: u32, sum: &mut Component) {
    if sum.nodes > 0 {
        let entry = list.entry(root).or_default();
        entry.nodes += sum.nodes;
        entry.area += sum.area;
        *sum = Component::default();
    }
}
