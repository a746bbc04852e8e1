//! Bridges, which join components.
//!
//! They put every face within reach of every landmark. Each component is joined to the nearest face among all larger
//! ones by one edge as long as the gap, with no turning. So a tiny component belongs to the part next to it, and
//! separate objects are as far apart in the embedding as in space. (Leaving components unreachable instead puts
//! landmarks on tiny components and makes σ meaningless; both alternatives are recorded in `docs/dev/decisions.md`.)
//! Nearest means nearest among samples: up to [`PER_COMPONENT`] evenly spread faces of a component are looked up among
//! up to [`SAMPLES`] faces of the larger ones, and at least one of each ([`super::ranked_tree`]).
//!
//! Cost: nothing for a single component. Else arrays in the work directory, in memory where the budget has room: 36
//! bytes per component, and 26 per sample, of which a component has up to [`PER_COMPONENT`] + 1, or more if it is
//! large; 1 to 2 µs per component and thread.

use super::components::{ComponentTable, Components};
use super::dual_edges::{DualEdges, EdgesWriter};
use super::face_rows::Entry;
use super::node_geometry::NodeGeometry;
use super::ranked_tree::{RankedPoint, RankedTree};
use crate::base::{Error, Result};
use crate::store::npy::{ArrayMut, Item};
use crate::store::{Context, Run};
use bytemuck::{Pod, Zeroable};

/// Faces of a component that search for a partner.
pub const PER_COMPONENT: u64 = 16;
/// Number of faces that can be found as partners, if components are large.
pub const SAMPLES: u64 = 100_000;
/// Components that one thread joins at a time.
const CHUNK: usize = 1 << 10;

/// An edge to add: two nodes and the distance of their centroids in the frame.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Bridge {
    /// The nodes, ascending.
    pub nodes: [u32; 2],
    /// Distance of the centroids.
    pub gap: f32,
}

impl Item for Bridge {
    const DESCR: &'static str = "[('nodes','<u4',(2,)),('gap','<f4')]";
}

/// The bridges that join all components, none shorter than `least`; `None` if there is only one component.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn find_bridges(
    components: &Components,
    nodes: &NodeGeometry,
    least: f32,
    context: Context<'_>,
) -> Result<Option<ArrayMut<Bridge>>> {
    let (Some(table), Some(root)) = (&components.table, &components.root) else { return Ok(None) };
    let (run, count) = (context.run, table.count());
    let order = table.by_size(context)?;
    let mut rank: ArrayMut<u32> = context.work.array("component_rank.tmp", &[count])?;
    for (place, &number) in order.items().iter().enumerate() {
        rank.data()[number as usize] = place as u32;
    }
    let (largest, rank) = (order.items()[0] as usize, rank.items());
    drop(order);
    let samples = Samples::of(root, table, context)?;
    let tree = RankedTree::new(samples.points(nodes, rank, context)?, context)?;
    let mut bridges: ArrayMut<Bridge> = context.work.array("bridges.tmp", &[count - 1])?;
    let join = |k: usize, out: &mut [Bridge], (): &mut ()| {
        for (bridge, number) in out.iter_mut().zip(k * CHUNK..) {
            // The largest component has no bridge of its own, so skip its number.
            let number = number + usize::from(number >= largest);
            let mine = samples.of_component(number);
            let step = (mine.len() as u64).div_ceil(PER_COMPONENT).max(1) as usize;
            let nearest = mine.iter().step_by(step).filter_map(|&node| {
                let (square, other) = tree.nearest_below(rank[number], nodes.at(node as usize).centroid)?;
                Some((square, node, other))
            });
            let by_distance = |a: &(f32, u32, u32), b: &(f32, u32, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
            let (square, a, b) =
                nearest.min_by(by_distance).ok_or_else(|| Error::internal("a component without faces"))?;
            *bridge = Bridge { nodes: [a.min(b), a.max(b)], gap: square.sqrt().max(least) };
        }
        Ok(())
    };
    run.fill_chunks(bridges.data(), CHUNK, || (), join)?;
    Ok(Some(bridges))
}

/// Evenly spread nodes of every component, at least one each.
struct Samples {
    /// Where the samples of each component start in `nodes`, and the total (components + 1).
    starts: ArrayMut<u32>,
    nodes: ArrayMut<u32>,
}

impl Samples {
    /// Samples the components given by `root` ([`Components::root`]).
    fn of(root: &[u32], table: &ComponentTable, context: Context<'_>) -> Result<Self> {
        let stride = (root.len() as u64).div_ceil(SAMPLES).max(1);
        // Small components keep up to PER_COMPONENT faces, so that tiny ones are placed exactly.
        let step = |nodes: u32| stride.min(u64::from(nodes).div_ceil(PER_COMPONENT)).max(1) as u32;
        let sizes = table.nodes();
        let mut starts: ArrayMut<u32> = context.work.array("sample_starts.tmp", &[sizes.len() + 1])?;
        let mut end = 0;
        for (start, &size) in starts.data()[1..].iter_mut().zip(sizes) {
            end += size.div_ceil(step(size));
            *start = end;
        }
        let mut nodes: ArrayMut<u32> = context.work.array("samples.tmp", &[end as usize])?;
        let mut seen: ArrayMut<u32> = context.work.array("component_seen.tmp", &[sizes.len()])?;
        let (seen, starts_of, samples) = (seen.data(), starts.items(), nodes.data());
        let mut number = 0;
        for (node, &link) in root.iter().enumerate() {
            if node % (1 << 20) == 0 {
                context.run.cancel.check()?;
            }
            number = table.number(link, number);
            let (before, step) = (seen[number], step(sizes[number]));
            if before.is_multiple_of(step) {
                samples[(starts_of[number] + before / step) as usize] = node as u32;
            }
            seen[number] += 1;
        }
        Ok(Self { starts, nodes })
    }

    /// The samples of component `number`.
    fn of_component(&self, number: usize) -> &[u32] {
        let starts = self.starts.items();
        &self.nodes.items()[starts[number] as usize..starts[number + 1] as usize]
    }

    /// All samples with their positions and the ranks of their components.
    fn points(&self, nodes: &NodeGeometry, rank: &[u32], context: Context<'_>) -> Result<ArrayMut<RankedPoint>> {
        let mut points: ArrayMut<RankedPoint> = context.work.array("bridge_points.tmp", &[self.nodes.items().len()])?;
        let starts = self.starts.items();
        let fill = |k: usize, out: &mut [RankedPoint], (): &mut ()| {
            let first = k * CHUNK;
            let mut number = starts.partition_point(|start| *start as usize <= first) - 1;
            for (place, point) in (first..).zip(out) {
                while starts[number + 1] as usize <= place {
                    number += 1;
                }
                let node = self.nodes.items()[place];
                *point = RankedPoint { at: nodes.at(node as usize).centroid, node, rank: rank[number] };
            }
            Ok(())
        };
        context.run.fill_chunks(points.data(), CHUNK, || (), fill)?;
        Ok(points)
    }
}

/// One end of a bridge: the edge added to the row of `node`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
struct End {
    node: u32,
    other: u32,
    gap: f32,
}

impl Item for End {
    const DESCR: &'static str = "[('node','<u4'),('other','<u4'),('gap','<f4')]";
}

/// Rewrites the edges with the bridges inserted; one sequential pass.
///
/// # Errors
/// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
pub fn insert(edges: &DualEdges, bridges: &[Bridge], context: Context<'_>) -> Result<DualEdges> {
    let mut ends: ArrayMut<End> = context.work.array("bridge_ends.tmp", &[2 * bridges.len()])?;
    for (two, bridge) in ends.data().chunks_exact_mut(2).zip(bridges) {
        let ([a, b], gap) = (bridge.nodes, bridge.gap);
        two.copy_from_slice(&[End { node: a, other: b, gap }, End { node: b, other: a, gap }]);
    }
    ends.data().sort_unstable_by_key(|end| (end.node, end.other));
    // A bridge has no shared edge; computed lengths give 0 for it.
    let kept = edges.keeps_edges();
    let entries = edges.indices.len() + ends.items().len();
    let mut writer = EdgesWriter::create(edges.len(), entries, edges.starts.form(), kept, context.work)?;
    let (mut row, mut columns) = (Vec::new(), (Vec::new(), Vec::new(), Vec::new()));
    let mut done = 0;
    for ends in ends.items().chunk_by(|a, b| a.node == b.node) {
        let node = ends[0].node as usize;
        copy(edges, done..node, &mut writer, context.run)?;
        row.clear();
        row.extend(edges.by_distance().span(node as u32).map(|e| Entry {
            node: edges.indices[e],
            centroid_distance: edges.centroid_distance[e],
            edge: if kept { edges.edge[e] } else { 0. },
        }));
        row.extend(ends.iter().map(|end| Entry { node: end.other, centroid_distance: end.gap, edge: 0. }));
        row.sort_unstable_by_key(|entry| entry.node);
        let (indices, centroid_distance, edges) = &mut columns;
        indices.clear();
        centroid_distance.clear();
        edges.clear();
        for entry in &row {
            indices.push(entry.node);
            centroid_distance.push(entry.centroid_distance);
            edges.push(entry.edge);
        }
        writer.push(&[row.len() as u32], indices, centroid_distance, edges)?;
        done = node + 1;
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
            if edges.keeps_edges() { &edges.edge[span] } else { &[] },
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{stream, unit};
    use crate::graph::Node;
    use crate::store::{Run, WorkDir};

    /// All nodes of small components are samples, so each bridge is the shortest of all gaps to larger components.
    #[test]
    fn bridges_are_the_shortest_gaps_to_larger_components() {
        let dir = tempfile::tempdir().unwrap();
        let work = WorkDir::temporary(dir.path()).unwrap();
        let mut random = stream(5, "bridges");
        for (count, scattered, threads) in [(1, false, 1), (2, false, 2), (7, true, 1), (60, false, 3), (60, true, 2)] {
            let sizes: Vec<usize> = (0..count).map(|k| 1 + k * 5 % PER_COMPONENT as usize).collect();
            let mut of: Vec<usize> = (0..count).flat_map(|k| vec![k; sizes[k]]).collect();
            if scattered {
                // A stride of 13 scatters the nodes of each component.
                assert!(!of.len().is_multiple_of(13));
                of = (0..of.len()).map(|i| of[i * 13 % of.len()]).collect();
            }
            let area_of = |k: usize| 1. + (k * 37 % 61) as f64;
            let root: Vec<u32> = of.iter().map(|k| of.iter().position(|other| other == k).unwrap() as u32).collect();
            let place = |k: &usize| Node {
                centroid: [0; 3].map(|_| unit(&mut random) as f32),
                normal: [0.; 3],
                area: (area_of(*k) / sizes[*k] as f64) as f32,
            };
            let nodes: Vec<Node> = of.iter().map(place).collect();
            let gap = |a: u32, b: u32| {
                let [a, b] = [a, b].map(|node| nodes[node as usize].centroid);
                (0..3).map(|axis| f64::from(a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
            };
            let all = 0..nodes.len() as u32;
            let mut expected: Vec<f64> = Vec::new();
            for k in 0..count {
                let larger = || all.clone().filter(|node| area_of(of[*node as usize]) > area_of(k));
                let mine = all.clone().filter(|node| of[*node as usize] == k);
                expected
                    .extend(mine.flat_map(|a| larger().map(move |b| (a, b))).map(|(a, b)| gap(a, b)).reduce(f64::min));
            }
            let run = Run { threads, ..Run::new(&()) };
            let context = Context::new(&work, &run);
            let geometry = NodeGeometry::from(work.write("nodes.npy", &nodes, 7).unwrap());
            let table = ComponentTable::of(&root, &geometry, context).unwrap();
            let components = Components { root: Some(root.clone().into()), mixed: false, table };
            let bridges = find_bridges(&components, &geometry, 0., context).unwrap();
            let bridges = bridges.as_ref().map_or(&[][..], ArrayMut::items);
            assert_eq!((components.count(), bridges.len(), expected.len()), (count, count - 1, count - 1));
            for bridge in bridges {
                assert!((f64::from(bridge.gap) - gap(bridge.nodes[0], bridge.nodes[1])).abs() < 1e-6);
            }
            let mut found: Vec<f64> = bridges.iter().map(|bridge| f64::from(bridge.gap)).collect();
            found.sort_by(f64::total_cmp);
            expected.sort_by(f64::total_cmp);
            assert!(found.iter().zip(&expected).all(|(found, expected)| (found - expected).abs() < 1e-6));
        }
    }
}
