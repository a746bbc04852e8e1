//! Connected components of a graph.
//!
//! They are found by union-find over the edges ([`crate::base::union_find`]), together with the faces whose winding
//! contradicts the rest of their component. If two faces traverse their shared edge in the same direction, one of them
//! must be flipped: a parity between nodes, kept in the top bit of the parent. A contradiction (Möbius strip, some
//! non-manifold edges) leaves the later edge unsatisfied. The parent array is a mapped file (4 B per node): with faces
//! in scan or curve order its accesses are as local as the graph's. About 10 ns per face, on one thread. If all
//! windings agree, which the signs of the shared edges' lengths show, components are joined block by block
//! (`component_blocks.rs`): where rows are assembled, or, if that is done in memory, on all threads afterwards.
//!
//! If there are several, they are numbered by their first nodes, and their data are arrays in the work directory, in
//! memory where the budget has room: 16 bytes per component, and one search among the first nodes for each run of nodes
//! of one component. A mesh may have millions (triangles that share no vertex).

use super::component_blocks::{self, Joined, find_roots};
use super::dual_edges::DualEdges;
use super::half_edge_pairs::OPPOSITE_WINDING;
use super::node_geometry::NodeGeometry;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::union_find::{ParityForest, flatten};
use crate::base::{Cancel, Result};
use crate::store::npy::ArrayMut;
use crate::store::{Context, MappedSlice};

/// Once the graph is oriented ([`super::orient`]), the bit of a root that marks nodes whose normals were flipped.
pub const FLIPPED: u32 = OPPOSITE_WINDING;
/// The file of the roots.
pub const FILE: &str = component_blocks::FILE;
/// Nodes between checks of the stop flag.
const CHUNK: usize = 1 << 18;
/// Nodes whose areas are summed at a time.
const SUMMED: usize = 1 << 15;

/// The components of a graph.
#[derive(Debug)]
pub struct Components {
    /// For each node the first node of its component, with [`OPPOSITE_WINDING`] if their windings disagree (n). `None`
    /// if there is only one component and all windings agree.
    pub root: Option<MappedSlice<u32>>,
    /// Whether any edge joins faces of contradicting winding.
    pub mixed: bool,
    /// Size and area of each, where there are several.
    pub table: Option<ComponentTable>,
}

impl Components {
    /// How many there are.
    pub fn count(&self) -> usize {
        self.table.as_ref().map_or(1, ComponentTable::count)
    }

    /// The first node of the component of `node`, with [`OPPOSITE_WINDING`] if their windings disagree.
    #[inline]
    pub fn link(&self, node: usize) -> u32 {
        self.root.as_ref().map_or(0, |root| root[node])
    }

    /// The number of the component with the root `link`; `near` is a guess to try first.
    #[inline]
    pub fn number(&self, link: u32, near: usize) -> usize {
        self.table.as_ref().map_or(0, |table| table.number(link, near))
    }
}

/// Two components or more (c), numbered by their first nodes.
#[derive(Debug)]
pub struct ComponentTable {
    /// First nodes, ascending.
    first: ArrayMut<u32>,
    nodes: ArrayMut<u32>,
    area: ArrayMut<f64>,
}

impl ComponentTable {
    /// The components of `nodes` given by `root` ([`Components::root`]); `None` if there are fewer than two.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn of(root: &[u32], nodes: &NodeGeometry, context: Context<'_>) -> Result<Option<Self>> {
        let (run, n) = (context.run, root.len());
        let firsts = |range: std::ops::Range<usize>| range.filter(|&i| (root[i] & !OPPOSITE_WINDING) as usize == i);
        let counts = run.map_ranges(n, CHUNK, |range| Ok(firsts(range).count()))?;
        let count: usize = counts.iter().sum();
        if count < 2 {
            return Ok(None);
        }
        let array = |name| context.work.array(name, &[count]);
        let mut all = Self {
            first: array("component_first.tmp")?,
            nodes: array("component_nodes.tmp")?,
            area: context.work.array("component_area.tmp", &[count])?,
        };
        for (slot, first) in all.first.data().iter_mut().zip(firsts(0..n)) {
            *slot = first as u32;
        }
        // Runs of nodes in one component: its number, their count and area.
        let sum = |k: usize, (): &mut ()| {
            let mut runs: Vec<(u32, u32, f64)> = Vec::new();
            nodes.view().each(chunk_range(n, SUMMED, k), |i, node| {
                let root = root[i] & !OPPOSITE_WINDING;
                match runs.last_mut() {
                    Some(run) if run.0 == root => *run = (root, run.1 + 1, run.2 + f64::from(node.area)),
                    _ => runs.push((root, 1, f64::from(node.area))),
                }
            });
            Ok(runs)
        };
        let mut number = 0;
        let add = |_: usize, runs: Vec<(u32, u32, f64)>| {
            for (root, count, area) in runs {
                number = all.number(root, number);
                all.nodes.data()[number] += count;
                all.area.data()[number] += area;
            }
            Ok(())
        };
        run.in_order(chunk_count(n, SUMMED), || (), sum, add)?;
        Ok(Some(all))
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.first.items().len()
    }

    /// Nodes of each.
    pub fn nodes(&self) -> &[u32] {
        self.nodes.items()
    }

    /// Area of each, in the frame.
    pub fn area(&self) -> &[f64] {
        self.area.items()
    }

    /// [`Components::number`].
    #[inline]
    pub fn number(&self, link: u32, near: usize) -> usize {
        let (first, root) = (self.first.items(), link & !OPPOSITE_WINDING);
        // Consecutive nodes are mostly in the same component, or in the next one.
        if first.get(near) == Some(&root) {
            return near;
        }
        if first.get(near + 1) == Some(&root) {
            return near + 1;
        }
        first.partition_point(|first| *first < root).min(first.len() - 1)
    }

    /// The components by descending area, then by descending number of nodes, then ascending.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`].
    pub fn by_size(&self, context: Context<'_>) -> Result<ArrayMut<u32>> {
        let (area, nodes) = (self.area(), self.nodes());
        let mut order: ArrayMut<u32> = context.work.array("component_order.tmp", &[self.count()])?;
        order.data().iter_mut().zip(0..).for_each(|(slot, number)| *slot = number);
        order.data().sort_unstable_by(|&a, &b| {
            let ([a_area, b_area], [a_nodes, b_nodes]) =
                ([a, b].map(|number| area[number as usize]), [a, b].map(|number| nodes[number as usize]));
            b_area.total_cmp(&a_area).then(b_nodes.cmp(&a_nodes)).then(a.cmp(&b))
        });
        Ok(order)
    }
}

/// Finds the components; writes [`FILE`] (u32, n) unless there is only one, whose windings all agree. `joined` are
/// those of an earlier pass, if there was one.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub(super) fn find_components(
    edges: &DualEdges,
    nodes: &NodeGeometry,
    joined: Option<Joined>,
    context: Context<'_>,
) -> Result<Components> {
    let cancel = &context.run.cancel;
    let (mut parents, count) = match joined {
        Some(Joined { parents, count }) => (parents, Some(count)),
        None => {
            let mut parents: ArrayMut<u32> = context.work.array(FILE, &[nodes.len()])?;
            let count = if edges.mixed { None } else { find_roots(edges.by_distance(), parents.data(), context.run)? };
            (parents, count)
        }
    };
    if count == Some(1) {
        drop(parents);
        context.work.remove(FILE);
        return Ok(Components { root: None, mixed: false, table: None });
    }
    let mixed = count.is_none() && node_by_node(edges, parents.data(), cancel)?;
    flatten(parents.data(), cancel)?;
    let root = parents.finish(false)?;
    let table = ComponentTable::of(&root, nodes, context)?;
    Ok(Components { root: Some(root), mixed, table })
}

/// Fills `parent` (n) with the forest of the components, not flattened yet. Returns whether any edge joins faces of
/// contradicting winding.
fn node_by_node(edges: &DualEdges, parent: &mut [u32], cancel: &Cancel) -> Result<bool> {
    let (n, mut mixed) = (parent.len(), false);
    let mut parents = ParityForest::new(parent);
    let graph = edges.shared();
    for i in 0..n as u32 {
        if (i as usize).is_multiple_of(CHUNK) {
            cancel.check()?;
        }
        parents.add(i);
        let (mut mine, mut my_parity) = (i, 0);
        // Rows ascend, and each edge is handled at its later node.
        for (e, near) in graph.entries(i).take_while(|(_, near)| *near < i) {
            let opposite_winding = if graph.opposite_winding(i, e) { OPPOSITE_WINDING } else { 0 };
            mixed |= opposite_winding != 0;
            (mine, my_parity) = parents.join((mine, my_parity), near, opposite_winding);
        }
    }
    Ok(mixed)
}
