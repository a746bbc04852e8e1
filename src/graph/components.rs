//! Connected components, and the bridges that join them.
//!
//! Components are found by union-find over the edges ([`crate::base::union_find`]), and with them which faces are wound
//! against the rest of their component. An edge whose faces run along it in the same direction asks for one of them to
//! be turned: a parity between nodes, kept in the top bit of the parent. A contradiction (Möbius strip, some
//! non-manifold edges) leaves the later edge unsatisfied. The parent array is a mapped file (4 B per node): with faces
//! in scan or curve order its accesses are as local as the graph's. About 10 ns per face, on one thread. Where no two
//! faces are wound against each other, which is known from the lengths of shared edges, components are found block by
//! block on all threads instead (`component_blocks.rs`).
//!
//! Bridges bring every face within reach of every landmark. Components are taken in descending order of area; each is
//! joined to the nearest face among all larger ones by one edge as long as the gap, with no turning. So a tiny
//! component belongs to the part it floats beside, and separate objects stand as far apart in the embedding as in
//! space. (Leaving components unreachable instead makes landmarks sit on tiny components and σ meaningless; both
//! alternatives are recorded in `docs/dev/decisions.md`.) Nearest means nearest among samples: up to [`PER_COMPONENT`]
//! evenly spread faces of a component are looked up in an R*-tree of up to [`TREE_SAMPLES`] faces of the larger ones.
//! Above [`MOST_IN_TREE`] components the rest are joined without joining the tree.
//!
//! Memory, outside of the budget: some 150 bytes per component, 4 per sample, and about 80 per sample in the
//! tree. There are at most [`TREE_SAMPLES`] samples and [`PER_COMPONENT`] + 1 more for each component: 8 MB
//! where one component is large, 140 MB where 100,000 are in the tree, 220 bytes for each one beyond. Nothing
//! where there is one component.

use super::component_blocks::find_roots;
use super::dual_edges::{DualEdges, EdgesWriter, Entry};
use super::half_edge_pairs::AGAINST;
use super::node_geometry::NodeGeometry;
use crate::base::sort::sort_by;
use crate::base::union_find::ParityForest;
use crate::base::{Cancel, Result};
use crate::store::npy::ArrayMut;
use crate::store::{Context, MappedSlice, Run};
use rstar::RTree;
use rstar::primitives::GeomWithData;
use std::collections::{BTreeMap, HashMap};

/// The file of the roots.
pub const FILE: &str = "components.npy";
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
    /// Area in the frame; may be 0 where there is no other component to compare it with.
    pub area: f64,
}

/// Finds the components; writes [`FILE`] (u32, n).
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn find_components(edges: &DualEdges, nodes: &NodeGeometry, context: Context<'_>) -> Result<Components> {
    let n = nodes.len();
    let mut array: ArrayMut<u32> = context.work.array(FILE, &[n])?;
    let side_by_side = !edges.mixed && find_roots(edges.by_distance(), array.data(), context.run)?;
    let mixed = !side_by_side && node_by_node(edges, array.data(), &context.run.cancel)?;
    let root = array.finish(false)?;
    let mut list: BTreeMap<u32, Component> = BTreeMap::new();
    for nodes in root.chunk_by(|a, b| a & !AGAINST == b & !AGAINST) {
        list.entry(nodes[0] & !AGAINST).or_default().nodes += nodes.len() as u64;
    }
    if list.len() > 1 {
        add_areas(&mut list, &root, nodes, &context.run.cancel)?;
    }
    Ok(Components { root, mixed, list })
}

/// Fills `parent` (n) with [`Components::root`]. Returns whether any edge joins faces wound against each other.
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
        // Rows ascend, and the other direction is seen from the later node.
        for (e, near) in graph.entries(i).take_while(|(_, near)| *near < i) {
            let against = if graph.against(i, e) { AGAINST } else { 0 };
            mixed |= against != 0;
            (mine, my_parity) = parents.join((mine, my_parity), near, against);
        }
    }
    let parent = parents.into_parents();
    // Parents come before children, so one ascending pass flattens everything.
    for i in 0..n {
        if i % CHUNK == 0 {
            cancel.check()?;
        }
        let link = parent[i];
        if link & !AGAINST != i as u32 {
            parent[i] = parent[(link & !AGAINST) as usize] ^ (link & AGAINST);
        }
    }
    Ok(mixed)
}

/// Fills in the areas of several components: for one it is not needed.
fn add_areas(list: &mut BTreeMap<u32, Component>, root: &[u32], nodes: &NodeGeometry, cancel: &Cancel) -> Result<()> {
    let mut first = 0;
    // Runs of one component are summed by themselves.
    for run in root.chunk_by(|a, b| a & !AGAINST == b & !AGAINST) {
        cancel.check()?;
        let area = (first..first + run.len()).map(|i| f64::from(nodes.at(i).area)).sum::<f64>();
        list.entry(run[0] & !AGAINST).or_default().area += area;
        first += run.len();
    }
    Ok(())
}

/// Faces of a component that look for a partner.
pub const PER_COMPONENT: u64 = 16;
/// Faces that can be found as partners.
pub const TREE_SAMPLES: u64 = 100_000;
/// Components whose faces can be found as partners.
pub const MOST_IN_TREE: usize = 100_000;

type Point = GeomWithData<[f32; 3], u32>;

/// An edge to add: two nodes and the gap between their centroids in the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bridge {
    /// The nodes, ascending.
    pub nodes: [u32; 2],
    /// Distance of the centroids.
    pub gap: f32,
}

/// The bridges that join all components.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn find_bridges(components: &Components, nodes: &NodeGeometry, run: &Run) -> Result<Vec<Bridge>> {
    let mut order: Vec<(u32, f64, u64)> = components.list.iter().map(|(&root, c)| (root, c.area, c.nodes)).collect();
    if order.len() < 2 {
        return Ok(Vec::new());
    }
    sort_by(&mut order, |a, b| b.1.total_cmp(&a.1).then(b.2.cmp(&a.2)).then(a.0.cmp(&b.0)));
    let rank: HashMap<u32, usize> = order.iter().enumerate().map(|(rank, c)| (c.0, rank)).collect();
    let samples = sample(components, &rank, &order, nodes.len(), run)?;
    let mut tree: RTree<Point> = RTree::new();
    let mut bridges = Vec::with_capacity(order.len() - 1);
    for (place, mine) in samples.by_rank().enumerate() {
        if place % 1024 == 0 {
            run.cancel.check()?;
        }
        if place > 0 {
            let step = (mine.len() as u64).div_ceil(PER_COMPONENT).max(1) as usize;
            let nearest = mine
                .iter()
                .step_by(step)
                .filter_map(|&node| {
                    let at = nodes.at(node as usize).centroid;
                    let (other, square) = tree.nearest_neighbor_iter_with_distance_2(at).next()?;
                    Some((square, node, other.data))
                })
                .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
            if let Some((square, a, b)) = nearest {
                bridges.push(Bridge { nodes: [a.min(b), a.max(b)], gap: square.sqrt() });
            }
        }
        let points = mine.iter().map(|&node| Point::new(nodes.at(node as usize).centroid, node));
        if place == 0 {
            tree = RTree::bulk_load(points.collect());
        } else if place < MOST_IN_TREE {
            points.for_each(|point| tree.insert(point));
        }
    }
    Ok(bridges)
}

/// Evenly spread nodes of every component.
struct Samples {
    /// Where those of each rank begin in `nodes`, and their number (components + 1).
    starts: Vec<usize>,
    nodes: Vec<u32>,
}

impl Samples {
    /// The nodes of each component, by rank.
    fn by_rank(&self) -> impl Iterator<Item = &[u32]> {
        self.starts.windows(2).map(|span| &self.nodes[span[0]..span[1]])
    }
}

/// Evenly spread nodes of every component; at least one each.
fn sample(
    components: &Components,
    rank: &HashMap<u32, usize>,
    order: &[(u32, f64, u64)],
    nodes: usize,
    run: &Run,
) -> Result<Samples> {
    let stride = (nodes as u64).div_ceil(TREE_SAMPLES).max(1);
    // Small components keep up to PER_COMPONENT faces, so that tiny ones are placed exactly.
    let steps: Vec<u64> = order.iter().map(|c| stride.min(c.2.div_ceil(PER_COMPONENT)).max(1)).collect();
    let mut seen = vec![0u64; order.len()];
    let mut starts = vec![0];
    starts.extend(order.iter().zip(&steps).scan(0, |end, (c, step)| {
        *end += c.2.div_ceil(*step) as usize;
        Some(*end)
    }));
    let mut samples = vec![0; starts[order.len()]];
    let (mut last_root, mut last_rank) = (u32::MAX, 0);
    for (node, root) in components.root.iter().map(|link| link & !AGAINST).enumerate() {
        if node % (1 << 20) == 0 {
            run.cancel.check()?;
        }
        if root != last_root {
            (last_root, last_rank) = (root, rank.get(&root).copied().unwrap_or(0));
        }
        if seen[last_rank].is_multiple_of(steps[last_rank]) {
            samples[starts[last_rank] + (seen[last_rank] / steps[last_rank]) as usize] = node as u32;
        }
        seen[last_rank] += 1;
    }
    Ok(Samples { starts, nodes: samples })
}

/// Rewrites the edges with the bridges in their places; one sequential pass.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn insert(edges: &DualEdges, bridges: &[Bridge], context: Context<'_>) -> Result<DualEdges> {
    let mut extra: Vec<(usize, Entry)> = Vec::with_capacity(2 * bridges.len());
    for bridge in bridges {
        let [a, b] = bridge.nodes;
        extra.push((a as usize, Entry { node: b, centroid_distance: bridge.gap, edge: 0. }));
        extra.push((b as usize, Entry { node: a, centroid_distance: bridge.gap, edge: 0. }));
    }
    extra.sort_unstable_by_key(|(row, entry)| (*row, entry.node));
    // Bridges share no edge, which is what computing finds.
    let kept = edges.computed.is_none();
    let mut writer =
        EdgesWriter::create(edges.len(), edges.indices.len() + extra.len(), edges.starts.form(), kept, context.work)?;
    let mut done = 0;
    for group in extra.chunk_by(|a, b| a.0 == b.0) {
        let row = group[0].0;
        copy(edges, done..row, &mut writer, context.run)?;
        let old = edges.by_distance().span(row as u32).map(|e| Entry {
            node: edges.indices[e],
            centroid_distance: edges.centroid_distance[e],
            edge: if kept { edges.edge[e] } else { 0. },
        });
        let mut entries: Vec<Entry> = old.chain(group.iter().map(|(_, entry)| *entry)).collect();
        entries.sort_unstable_by_key(|entry| entry.node);
        let (mut indices, mut centroid_distance, mut edges) = (Vec::new(), Vec::new(), Vec::new());
        for entry in &entries {
            indices.push(entry.node);
            centroid_distance.push(entry.centroid_distance);
            edges.push(entry.edge);
        }
        writer.push(&[entries.len() as u32], &indices, &centroid_distance, &edges)?;
        done = row + 1;
    }
    copy(edges, done..edges.len(), &mut writer, context.run)?;
    Ok(DualEdges { computed: edges.computed.clone(), mixed: edges.mixed, ..writer.finish()? })
}

/// Copies whole rows in blocks.
fn copy(edges: &DualEdges, range: std::ops::Range<usize>, writer: &mut EdgesWriter, run: &Run) -> Result<()> {
    const BLOCK: usize = 1 << 16;
    for start in range.clone().step_by(BLOCK) {
        run.cancel.check()?;
        let end = (start + BLOCK).min(range.end);
        let starts = edges.starts.view();
        let degrees: Vec<u32> = (start..end).map(|row| starts.span(row as u32).len() as u32).collect();
        let span = starts.entries_of(start..end);
        writer.push(
            &degrees,
            &edges.indices[span.clone()],
            &edges.centroid_distance[span.clone()],
            if edges.computed.is_none() { &edges.edge[span] } else { &[] },
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{stream, unit};
    use crate::graph::Node;
    use crate::store::WorkDir;

    /// All nodes of small components are samples, so each bridge is the shortest of all gaps to larger components.
    #[test]
    fn bridges_are_the_shortest_gaps_to_larger_components() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap();
        let mut random = stream(5, "bridges");
        for count in [1, 2, 7, 60] {
            let (mut nodes, mut root, mut list) = (Vec::new(), Vec::new(), BTreeMap::new());
            for k in 0..count {
                let (first, len) = (root.len(), 1 + k * 5 % PER_COMPONENT as usize);
                let area = 1. + (k * 37 % 61) as f64;
                list.insert(first as u32, Component { nodes: len as u64, area });
                root.resize(first + len, first as u32);
                nodes.resize_with(first + len, || Node {
                    centroid: [0; 3].map(|_| unit(&mut random) as f32),
                    normal: [0.; 3],
                    area: 1.,
                });
            }
            let gap = |a: u32, b: u32| {
                let [a, b] = [a, b].map(|node| nodes[node as usize].centroid);
                (0..3).map(|axis| f64::from(a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
            };
            let area_of = |node: u32| list[&root[node as usize]].area;
            let all = 0..nodes.len() as u32;
            let mut expected: Vec<f64> = Vec::new();
            for first in list.keys() {
                let larger = || all.clone().filter(|node| area_of(*node) > area_of(*first));
                let mine = all.clone().filter(|node| root[*node as usize] == *first);
                expected
                    .extend(mine.flat_map(|a| larger().map(move |b| (a, b))).map(|(a, b)| gap(a, b)).reduce(f64::min));
            }
            let components = Components { root: root.clone().into(), mixed: false, list: list.clone() };
            let geometry = NodeGeometry::from(work.write("nodes.npy", &nodes, 7).unwrap());
            let bridges = find_bridges(&components, &geometry, &Run::new(&())).unwrap();
            assert_eq!((bridges.len(), expected.len()), (count - 1, count - 1));
            for bridge in &bridges {
                assert!((f64::from(bridge.gap) - gap(bridge.nodes[0], bridge.nodes[1])).abs() < 1e-6);
            }
            let mut found: Vec<f64> = bridges.iter().map(|bridge| f64::from(bridge.gap)).collect();
            found.sort_by(f64::total_cmp);
            expected.sort_by(f64::total_cmp);
            assert!(found.iter().zip(&expected).all(|(found, expected)| (found - expected).abs() < 1e-6));
        }
    }
}
