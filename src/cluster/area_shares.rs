//! The share of the surface area that each face has, 0 in tiny components; seeds and sums weighted by these shares.
//!
//! Components below [`TINY`] of the area, and far smaller than the largest, are tiny: scanning debris that must not
//! become seeds, cells or parts. Hundreds of components of similar size are not debris. Faces of tiny components have
//! the share 0. Bridges join them to the rest, so they get the label of what is next to them. Lengths scale with the
//! shares: in units of √(area without tiny components), the same shape has the same size at every resolution.
//!
//! [`spread_seeds`] takes one seed per equal quantum of area along the order of the nodes: as good as farthest points
//! for cells (measured), for the cost of one pass. [`surface_sums`] adds up areas, centroids and normals of cells,
//! micro-cells and contracted nodes. Each chunk of nodes has sums of the classes that occur in it; they are added in
//! order, so that the number of threads does not change the result.
//!
//! Cost: one pass over the nodes for each; shares take 4 bytes per node on disk.

use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::random::{stratified, stream, unit};
use crate::base::vector::unit as unit_vector;
use crate::graph::components::ComponentTable;
use crate::graph::{DualGraph, Node, NodeGeometry, NodeView};
use crate::store::npy::ArrayMut;
use crate::store::{Context, MappedSlice, Run};
use std::ops::Range;

/// Share of the area below which a component is tiny, if it is also far smaller than the largest.
pub const TINY: f64 = 0.005;
/// Share of the area of the largest component below which another may be tiny.
const BESIDE_LARGEST: f64 = 0.1;
/// Minimum share of a face, relative to the mean: no face counts for nothing.
const FLOOR: f64 = 1e-4;
const CHUNK: usize = 1 << 15;
/// The array of stored shares.
pub const FILE: &str = "surface_shares.npy";

/// Area shares of the faces, 0 in tiny components, and the unit of length. They sum to 1 except for the minimum share.
#[derive(Clone, Debug)]
pub struct AreaShares {
    /// Share of each node (n). Empty if they are computed from the geometry.
    stored: MappedSlice<f32>,
    computed: Option<(NodeGeometry, FromArea)>,
    /// Factor from lengths in the frame to units of √(area).
    pub unit: f32,
    /// Nodes in tiny components.
    pub tiny_nodes: u64,
}

/// The conversion from area to share.
#[derive(Clone, Copy, Debug)]
struct FromArea {
    scale: f64,
    least: f64,
}

impl FromArea {
    #[inline]
    fn share(self, area: f32) -> f32 {
        (f64::from(area) * self.scale).max(self.least) as f32
    }
}

impl AreaShares {
    /// Computes the shares. They are stored as [`FILE`], unless the graph has a single component and its geometry is
    /// computed at each access.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn of(graph: &DualGraph, context: Context<'_>) -> Result<Self> {
        let n = graph.nodes.len();
        let tiny = TinyComponents::of(graph, context)?;
        let (total, tiny_nodes) = tiny.as_ref().map_or((graph.facts.area, 0), |tiny| (tiny.rest, tiny.nodes));
        let tiny = tiny.filter(|tiny| tiny.nodes > 0);
        let real = n as u64 - tiny_nodes;
        // If all faces are degenerate, each counts the same.
        let even = total <= 0.;
        let scale = if even { 0. } else { 1. / total };
        let least = if even { 1. / real.max(1) as f64 } else { FLOOR / real.max(1) as f64 };
        let from = FromArea { scale, least };
        let unit = if even { 1. } else { (1. / total.sqrt()) as f32 };
        if graph.nodes.is_computed() && tiny_nodes == 0 {
            let computed = Some((graph.nodes.clone(), from));
            return Ok(Self { stored: MappedSlice::empty(), computed, unit, tiny_nodes });
        }
        let mut array = context.work.array::<f32>(FILE, &[n])?;
        context.run.fill_chunks(
            array.data(),
            CHUNK,
            || 0,
            |k, out, near| {
                for (slot, i) in out.iter_mut().zip(chunk_range(n, CHUNK, k)) {
                    let is_tiny = tiny.as_ref().is_some_and(|tiny| tiny.has(i, near));
                    *slot = if is_tiny { 0. } else { from.share(graph.nodes.area(i)) };
                }
                Ok(())
            },
        )?;
        Ok(Self::of_array(array.finish(false)?, unit, tiny_nodes))
    }

    /// Shares that were stored before (n), with the other fields.
    pub fn of_array(stored: MappedSlice<f32>, unit: f32, tiny_nodes: u64) -> Self {
        Self { stored, computed: None, unit, tiny_nodes }
    }

    /// Whether the shares are computed at each access.
    pub fn is_computed(&self) -> bool {
        self.computed.is_some()
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.computed.as_ref().map_or(self.stored.len(), |(nodes, _)| nodes.len())
    }

    /// The share of the node number `at` with geometry `node`.
    #[inline]
    pub(super) fn of_node(&self, at: usize, node: &Node) -> f32 {
        self.computed.as_ref().map_or_else(|| self.stored[at], |(_, from)| from.share(node.area))
    }

    /// Calls `visit` with the shares of the nodes `range`, in order.
    pub(super) fn each(&self, range: Range<usize>, mut visit: impl FnMut(f32)) {
        match &self.computed {
            None => self.stored[range].iter().for_each(|&share| visit(share)),
            Some((nodes, from)) => nodes.view().each(range, |_, node| visit(from.share(node.area))),
        }
    }

    /// The share of the node `at`.
    #[inline]
    pub fn at(&self, at: usize) -> f32 {
        self.computed.as_ref().map_or_else(|| self.stored[at], |(nodes, from)| from.share(nodes.area(at)))
    }
}

/// The area below which a component is tiny, if all have the area `total` and the largest has `largest`.
pub fn tiny_below(total: f64, largest: f64) -> f64 {
    (TINY * total).min(BESIDE_LARGEST * largest)
}

/// Which components are tiny, if there are several.
struct TinyComponents<'a> {
    root: &'a [u32],
    table: ComponentTable,
    /// 1 for each tiny component.
    tiny: ArrayMut<u8>,
    /// Nodes in tiny components.
    nodes: u64,
    /// Area of the other components.
    rest: f64,
}

impl<'a> TinyComponents<'a> {
    fn of(graph: &'a DualGraph, context: Context<'_>) -> Result<Option<Self>> {
        let Some(root) = &graph.components else { return Ok(None) };
        let Some(table) = ComponentTable::of(root, &graph.nodes, context)? else { return Ok(None) };
        let (order, area) = (table.by_size(context)?, table.area());
        let area_of = |number: u32| area[number as usize];
        let least = tiny_below(graph.facts.area, area_of(order.items()[0]));
        let mut tiny: ArrayMut<u8> = context.work.array("tiny_components.tmp", &[table.count()])?;
        let (mut rest, mut nodes) = (0., 0);
        for (rank, &number) in order.items().iter().enumerate() {
            if rank > 0 && area_of(number) < least {
                tiny.data()[number as usize] = 1;
                nodes += u64::from(table.nodes()[number as usize]);
            } else {
                rest += area_of(number);
            }
        }
        Ok(Some(Self { root, table, tiny, nodes, rest }))
    }

    /// Whether `node` is in a tiny component; `near` is the component number of an earlier node.
    #[inline]
    fn has(&self, node: usize, near: &mut usize) -> bool {
        *near = self.table.number(self.root[node], *near);
        self.tiny.items()[*near] != 0
    }
}

/// Mean number of seeds per block of nodes.
const SEEDS_PER_BLOCK: usize = 16;

/// The result of drawing in a block of nodes.
struct Drawn {
    nodes: Vec<u32>,
    /// Number of points drawn; several may fall into one node.
    points: usize,
    /// Nodes whose share is not 0.
    eligible: usize,
    share: f64,
}

/// About `count` nodes with a positive share, ascending, one per equal quantum of area; all such nodes if there are no
/// more than `count`. Each block of nodes is drawn independently, so faces of another size change only the seeds of
/// their own block.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn spread_seeds(shares: &AreaShares, count: usize, purpose: &str, run: &Run) -> Result<Vec<u32>> {
    let n = shares.len();
    let block = (SEEDS_PER_BLOCK * n / count).max(1);
    let points = |k: usize, share: f64, total: f64| {
        let mut random = stream(run.seed, &format!("{purpose} {k}"));
        ((share / (total / count as f64) + unit(&mut random)) as usize, random)
    };
    let draw = |k: usize, total: f64, area: &mut Vec<f64>| {
        area.clear();
        shares.each(chunk_range(n, block, k), |share| area.push(f64::from(share)));
        let (eligible, share) = (area.iter().filter(|share| **share > 0.).count(), area.iter().sum());
        let (points, mut random) = points(k, share, total);
        let drawn = stratified(area.iter().copied(), share, points, &mut random);
        let nodes = drawn.into_iter().map(|(node, _)| (k * block) as u32 + node).collect();
        Drawn { nodes, points, eligible, share }
    };
    // All shares sum to 1 or slightly more; assuming 1, one pass over the geometry suffices for nearly all blocks.
    let mut blocks = run.map_chunks(chunk_count(n, block), Vec::new, |k, area| Ok(draw(k, 1., area)))?;
    if blocks.iter().map(|drawn| drawn.eligible).sum::<usize>() <= count {
        return Ok((0..n as u32).filter(|&i| shares.at(i as usize) > 0.).collect());
    }
    let total: f64 = blocks.iter().map(|drawn| drawn.share).sum();
    for (k, drawn) in blocks.iter_mut().enumerate() {
        if points(k, drawn.share, total).0 != drawn.points {
            *drawn = draw(k, total, &mut Vec::new());
        }
    }
    Ok(blocks.into_iter().flat_map(|drawn| drawn.nodes).collect())
}

/// Sums over a class of nodes, in the frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfaceSum {
    /// Area of all nodes, including those without a share.
    pub area: f64,
    /// Area shares.
    pub share: f64,
    /// Weights: area shares, but at least the requested minimum.
    pub weight: f64,
    /// Centroids times weights.
    pub centre: [f64; 3],
    /// Normals times weights.
    pub normal: [f64; 3],
}

impl SurfaceSum {
    /// Adds a node with the weight `share`, but at least `least`.
    #[inline]
    pub(super) fn take(&mut self, node: &Node, share: f64, least: f64) {
        self.area += f64::from(node.area);
        let weight = share.max(least);
        if weight <= 0. {
            return;
        }
        self.share += share;
        self.weight += weight;
        for axis in 0..3 {
            self.centre[axis] += weight * f64::from(node.centroid[axis]);
            self.normal[axis] += weight * f64::from(node.normal[axis]);
        }
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.area += other.area;
        self.share += other.share;
        self.weight += other.weight;
        for axis in 0..3 {
            self.centre[axis] += other.centre[axis];
            self.normal[axis] += other.normal[axis];
        }
    }

    /// The centroid; the frame's origin if nothing was summed.
    pub fn centroid(&self) -> [f64; 3] {
        self.centre.map(|x| x / self.weight.max(1e-300))
    }

    /// The mean direction, of length 1 or 0.
    pub fn direction(&self) -> [f64; 3] {
        unit_vector(self.normal)
    }
}

/// Sums over the classes of one chunk of nodes after another. Few classes occur in a chunk, as the nodes of one lie
/// together.
pub(super) struct ChunkSums {
    /// The place of each class in `sums`, or [`NOWHERE`].
    place: Vec<u32>,
    sums: Vec<(u32, SurfaceSum)>,
}

const NOWHERE: u32 = u32::MAX;

impl ChunkSums {
    /// For `classes` classes.
    pub fn new(classes: usize) -> Self {
        Self { place: vec![NOWHERE; classes], sums: Vec::new() }
    }

    /// The sums of the classes among the nodes of `chunk`, each with its class, in order of appearance: see
    /// [`surface_sums`].
    pub fn of_chunk(
        &mut self,
        (nodes, shares): (NodeView<'_>, &AreaShares),
        class: &[u32],
        chunk: Range<usize>,
        least: f64,
    ) -> Vec<(u32, SurfaceSum)> {
        nodes.each(chunk, |i, node| {
            if let Some(sum) = self.of(class[i]) {
                sum.take(node, f64::from(shares.of_node(i, node)), least);
            }
        });
        let sums = std::mem::take(&mut self.sums);
        sums.iter().for_each(|(class, _)| self.place[*class as usize] = NOWHERE);
        sums
    }

    /// The sums of `class`; `None` beyond the last class.
    #[inline]
    fn of(&mut self, class: u32) -> Option<&mut SurfaceSum> {
        let place = self.place.get_mut(class as usize)?;
        if *place == NOWHERE {
            *place = self.sums.len() as u32;
            self.sums.push((class, SurfaceSum::default()));
        }
        Some(&mut self.sums[*place as usize].1)
    }
}

/// Sums over the nodes of each of `classes` classes; nodes of a class beyond the last are skipped. Nodes without a
/// share contribute only their area, unless `least` gives each a weight.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn surface_sums(
    graph: &DualGraph,
    shares: &AreaShares,
    class: &[u32],
    classes: usize,
    least: f64,
    run: &Run,
) -> Result<Vec<SurfaceSum>> {
    let (n, nodes) = (class.len(), graph.nodes.view());
    let sum = |k: usize, sums: &mut ChunkSums| {
        let chunk = chunk_range(n, CHUNK, k);
        run.will_need(class, chunk.clone());
        Ok(sums.of_chunk((nodes, shares), class, chunk, least))
    };
    let mut total = vec![SurfaceSum::default(); classes];
    run.in_order(
        chunk_count(n, CHUNK),
        || ChunkSums::new(classes),
        sum,
        |_, sums| {
            sums.iter().for_each(|(class, sum)| total[*class as usize].add(sum));
            Ok(())
        },
    )?;
    Ok(total)
}

/// The class of a node in two bytes: there are fewer than 2¹⁶ cells or contracted nodes. Nodes without a class, which
/// have `u32::MAX`, get `u16::MAX`.
#[inline]
pub(super) fn narrow(class: u32) -> u16 {
    u16::try_from(class).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::{AreaShares, SEEDS_PER_BLOCK};
    use crate::store::{Run, WorkDir};

    fn spread(share: &[f32], count: usize, seed: u64) -> Vec<u32> {
        let run = Run { seed, ..Run::new(&()) };
        let work = WorkDir::temporary(&std::env::temp_dir()).unwrap();
        let share = work.write("share.npy", share, 1).unwrap();
        super::spread_seeds(&AreaShares::of_array(share, 1., 0), count, "test", &run).unwrap()
    }

    #[test]
    fn seeds_follow_the_area_and_avoid_what_counts_nothing() {
        let share: Vec<f32> = (0..10_000).map(|i| if i % 2 == 0 { 1e-4 } else { 0. }).collect();
        let seeds = spread(&share, 100, 1);
        assert_eq!(seeds.len(), 100);
        assert!(seeds.iter().all(|s| s % 2 == 0) && seeds.is_sorted());
        for (k, &s) in seeds.iter().enumerate() {
            assert!((s as usize).abs_diff(k * 100) <= 101, "one in each quantum");
        }
        // Regression: a face of another size moved all later seeds, which changed a twentieth of the labels.
        let mut other = share.clone();
        other[3_000] *= 3.;
        let moved: Vec<u32> = spread(&other, 100, 1).into_iter().filter(|s| !seeds.contains(s)).collect();
        let block = SEEDS_PER_BLOCK as u32 * 100;
        assert!(!moved.is_empty() && moved.iter().all(|s| s / block == 3_000 / block), "{moved:?}");
        assert_eq!(spread(&share[..20], 100, 1).len(), 10);
    }
}
