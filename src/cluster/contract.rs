//! Contraction: the surface as a graph of some thirty thousand nodes, on which the parts of a large mesh are decided.
//!
//! One front over all faces under the final weights, from area-stratified seeds; the distance of two adjacent nodes is
//! the shortest path between their seeds across their common boundary, min (d_i + w_ij + d_j). Rows, cells and
//! everything else run on that graph as they would on the faces (it is a [`DualGraph`]), in constant time: 240 rows
//! cost less than one over five million faces. On clean meshes the result is as good as with rows over all faces (−.001
//! ± .005 in 1 − Rand); contracting by length only is worse.
//!
//! The length of a common boundary is that of its chord, |Σ oriented edges|, so that zigzags do not count; an edge's
//! direction is perpendicular to the line between its faces. Cost: one front, 10 bytes per face of which 2 are kept,
//! one pass over the graph.

use super::area_shares::{AreaShares, ChunkSums, SurfaceSum, narrow, spread_seeds};
use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::base::sort::lexicographic;
use crate::base::vector::{cross, length as norm, minus, wide};
use crate::distance::SharedFront;
use crate::graph::csr::{INDICES, WEIGHTS};
use crate::graph::dual_edges::{CENTROID_DISTANCES, EDGES};
use crate::graph::row_starts::{OwnedRowStarts, PLAIN, StartsForm};
use crate::graph::{Csr, DualEdges, DualGraph, GraphFacts, Node, WeightedGraph, nodes};
use crate::store::needs::{BudgetEstimate, Extent, Needs};
use crate::store::stage::{BuiltStage, Stage, key_of};
use crate::store::{Context, MappedSlice, Run, WorkDir};
use serde_json::{Value, json};

/// Number of nodes of the contracted graph.
pub const NODES: usize = 30_000;
/// Meshes of more faces than this are contracted. With fewer than two faces per node, nodes are ragged: on the 32
/// models of the benchmark with 30,000 to 60,000 faces, 1 − Rand was .135 with rows over a contraction, and .127 with
/// the same number over all faces.
pub const LARGE: usize = FACES_PER_NODE * NODES;
/// Minimum mean number of faces per node, also of a smaller mesh that is contracted because its parts are in doubt.
const FACES_PER_NODE: usize = 2;
const CHUNK: usize = 1 << 14;
/// Length of a step between centroids, relative to their distance: the detour over the midpoint of the boundary.
const DETOUR: f64 = 1.15;

/// The file of the contracted node of each face.
pub const OF_FACE: &str = "contracted.npy";
const SEEDS: &str = "contraction_seeds.npy";
const AREAS: &str = "contraction_areas.npy";

/// The contracted surface.
#[derive(Debug)]
pub struct ContractedSurface {
    /// Its graph; lengths in the frame of the original.
    pub graph: DualGraph,
    /// Its weights.
    pub weighted: WeightedGraph,
    /// Contracted node of each node of the original (n).
    pub of_node: MappedSlice<u16>,
    /// The original node from which each contracted one grew.
    pub seeds: MappedSlice<u32>,
    /// Total area of the original nodes in each contracted one, in the frame, including tiny components.
    pub areas: MappedSlice<f64>,
}

/// The stage that contracts a surface; its files lie in a nested work directory.
pub struct Contraction<'a> {
    /// The original graph.
    pub graph: &'a DualGraph,
    /// Its weights.
    pub weighted: &'a WeightedGraph,
    /// Area shares of its nodes.
    pub shares: &'a AreaShares,
    /// The work directory of the original, where processes leave their shares of the front.
    pub whole: &'a WorkDir,
}

impl Stage for Contraction<'_> {
    const NAME: &'static str = "contraction";
    const VERSION: u32 = 8;
    type Facts = GraphFacts;
    type Output = ContractedSurface;

    fn inputs(&self, context: Context<'_>) -> Value {
        inputs(&self.weighted.key, context.run.seed)
    }

    fn progress(&self) -> Option<(&'static str, u64)> {
        Some(("faces", self.graph.nodes.len() as u64))
    }

    fn make(self, key: &str, context: Context<'_>) -> Result<BuiltStage<Self>> {
        let output = contract(&self, key, context)?;
        let files = vec![OF_FACE, SEEDS, AREAS, nodes::FILE, WEIGHTS, PLAIN, INDICES, CENTROID_DISTANCES, EDGES];
        Ok(BuiltStage { facts: output.graph.facts.clone(), output, files })
    }

    fn open(self, facts: GraphFacts, key: &str, context: Context<'_>) -> Result<ContractedSurface> {
        let work = context.work;
        let (n, graph) = (self.graph.nodes.len(), DualGraph::open(work, facts, StartsForm::Plain, key.to_string())?);
        let nodes = graph.nodes.len();
        let weighted = WeightedGraph::open(key.to_string(), nodes, StartsForm::Plain, work)?;
        let of_node = work.indices(OF_FACE, n, nodes)?;
        let (seeds, areas) = (work.indices(SEEDS, nodes, n)?, work.array_of(AREAS, nodes)?);
        Ok(ContractedSurface { graph, weighted, of_node, seeds, areas })
    }

    /// The map to contracted nodes, and the field of the front.
    fn needs(extent: &Extent, estimate: &mut BudgetEstimate) -> Needs {
        let n = extent.faces;
        let (map, temporary) = (estimate.reserve_array(2 * n), estimate.reserve_array(8 * n));
        estimate.release(temporary);
        // Boundaries of contracted nodes and messages: measured for a million faces.
        let memory = (10 << 20) + estimate.used() + temporary;
        Needs { memory, keeps: 2 * n - map, temporary: 8 * n - temporary, ..Needs::default() }.moving(170 * n, 27 * n)
    }
}

/// Sums over the common boundary of two contracted nodes.
#[derive(Clone, Copy, Debug)]
struct ContractedEdge {
    weight: f32,
    length: f64,
    chord: [f64; 3],
}

impl ContractedEdge {
    fn add(&mut self, other: &Self) {
        self.weight = self.weight.min(other.weight);
        self.length += other.length;
        (0..3).for_each(|axis| self.chord[axis] += other.chord[axis]);
    }
}

fn contract(contraction: &Contraction<'_>, key: &str, context: Context<'_>) -> Result<ContractedSurface> {
    let Contraction { graph, weighted, shares, whole } = *contraction;
    let Context { work, run } = context;
    let n = graph.nodes.len();
    let seeds = seeds(shares, run)?;
    let mut owner = work.array::<u32>("contracted.tmp", &[n])?;
    let mut field = work.array::<f32>("contracted_field.tmp", &[n])?;
    front(weighted, &seeds).nearest_source(field.data(), owner.data(), Context::new(whole, run))?;
    let mut of_node = work.array::<u16>(OF_FACE, &[n])?;
    let front = FrontValues { owner: owner.data(), field: field.data() };
    let (sums, borders) = gather(graph, weighted.csr(), shares, seeds.len(), front, of_node.data(), run)?;
    let of_node = of_node.finish(false)?;
    drop((field, owner));
    let (nodes, areas) = (interiors(&sums, shares), sums.iter().map(|sum| sum.area).collect::<Vec<f64>>());
    let (graph, weighted) = assemble(graph, nodes, &borders, key.to_string(), work)?;
    let (seeds, areas) = (work.write(SEEDS, &seeds, 1)?, work.write(AREAS, &areas, 1)?);
    Ok(ContractedSurface { graph, weighted, of_node, seeds, areas })
}

/// The original nodes from which contracted ones grow.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn seeds(shares: &AreaShares, run: &Run) -> Result<Vec<u32>> {
    spread_seeds(shares, NODES.min(shares.len() / FACES_PER_NODE), "contraction", run)
}

/// The front from these `seeds` under the weights.
pub fn front<'a>(weighted: &'a WeightedGraph, seeds: &'a [u32]) -> SharedFront<'a> {
    SharedFront {
        name: "contraction",
        stage: "contraction",
        graph: weighted.csr(),
        key: &weighted.key,
        sources: seeds,
        labels: None,
        limit: f32::INFINITY,
    }
}

fn inputs(weights: &str, seed: u64) -> Value {
    json!({"weights": weights, "seed": seed})
}

/// The key of the contraction of the graph whose weights have the key `weights`.
pub fn key(weights: &str, seed: u64) -> String {
    key_of(Contraction::NAME, Contraction::VERSION, &inputs(weights, seed))
}

/// Centroid, direction and area of each contracted node; tiny components are ignored.
fn interiors(sums: &[SurfaceSum], shares: &AreaShares) -> Vec<Node> {
    let area = 1. / f64::from(shares.unit).powi(2);
    let node = |sum: &SurfaceSum| Node {
        centroid: sum.centroid().map(|x| x as f32),
        normal: sum.direction().map(|x| x as f32),
        area: (sum.share * area) as f32,
    };
    sums.iter().map(node).collect()
}

/// Two nodes in one number, the smaller in its upper half: there are fewer than 2¹⁶ nodes ([`narrow`]).
type Pair = u32;

/// The nodes of a pair, the smaller first.
fn nodes_of(pair: Pair) -> (u32, u32) {
    (pair >> 16, pair & 0xffff)
}

/// One boundary for each pair of adjacent nodes, ascending.
type Boundaries = Vec<(Pair, ContractedEdge)>;

/// A piece of the boundary between a pair of nodes: the pair, and two numbers that locate the piece. The pieces of a
/// pair are added in that order.
type Piece = [u32; 3];

/// What the front from the seeds leaves behind.
#[derive(Clone, Copy)]
struct FrontValues<'a> {
    /// The seed that is nearest to each node (n).
    owner: &'a [u32],
    /// Its distance (n).
    field: &'a [f32],
}

/// The sums over the `count` contracted nodes and their boundaries; fills `of_node` (n). All in one pass: if the graph
/// is larger than memory, each pass reads mesh and graph again.
fn gather(
    graph: &DualGraph,
    csr: Csr<'_>,
    shares: &AreaShares,
    count: usize,
    FrontValues { owner, field }: FrontValues<'_>,
    of_node: &mut [u16],
    run: &Run,
) -> Result<(Vec<SurfaceSum>, Boundaries)> {
    let n = owner.len();
    let (edge, nodes) = (graph.edges.shared(), graph.nodes.view());
    // Within a chunk, a piece is located by the face in the chunk and the edge of that face.
    let work = |chunk: usize, (sums, pieces): &mut (ChunkSums, Vec<Piece>)| {
        let range = chunk_range(n, CHUNK, chunk);
        csr.will_need(range.clone(), run);
        run.will_need(owner, range.clone());
        run.will_need(field, range.clone());
        let sums = sums.of_chunk((nodes, shares), owner, range.clone(), 0.);
        pieces.clear();
        for i in range.clone() {
            for (k, (j, _)) in csr.neighbours(i as u32).enumerate() {
                let j = j as usize;
                let (a, b) = (owner[i], owner[j]);
                if j <= i || a == b || a == u32::MAX || b == u32::MAX {
                    continue;
                }
                pieces.push([a.min(b) << 16 | a.max(b), (i - range.start) as u32, k as u32]);
            }
        }
        let boundaries = added(pieces, |&[pair, i, k]| {
            let i = range.start + i as usize;
            let e = csr.span(i as u32).start + k as usize;
            let j = csr.indices[e] as usize;
            let (from, to) = if owner[i] == nodes_of(pair).0 { (i, j) } else { (j, i) };
            let length = f64::from(edge.length(i as u32, e).abs());
            ContractedEdge {
                weight: field[i] + csr.weights[e] + field[j],
                length,
                chord: along(&nodes.at(from), &nodes.at(to), length),
            }
        });
        Ok((sums, boundaries))
    };
    let (mut total, mut parts) = (vec![SurfaceSum::default(); count], Vec::with_capacity(chunk_count(n, CHUNK)));
    let consume = |chunk: usize, (sums, boundaries): (Vec<(u32, SurfaceSum)>, Boundaries)| {
        sums.iter().for_each(|(node, sum)| total[*node as usize].add(sum));
        parts.push(boundaries);
        let range = chunk_range(n, CHUNK, chunk);
        of_node[range.clone()].iter_mut().zip(&owner[range]).for_each(|(slot, &owner)| *slot = narrow(owner));
        Ok(())
    };
    run.in_order(chunk_count(n, CHUNK), || (ChunkSums::new(count), Vec::new()), work, consume)?;
    // Overall, a piece is located by the chunk and the boundary in that chunk.
    let mut pieces: Vec<Piece> = Vec::with_capacity(parts.iter().map(Vec::len).sum());
    for (chunk, part) in (0..).zip(&parts) {
        pieces.extend((0..).zip(part).map(|(at, (pair, _))| [*pair, chunk, at]));
    }
    Ok((total, added(&mut pieces, |&[_, chunk, at]| parts[chunk as usize][at as usize].1)))
}

/// Sorts `pieces`, and adds up the edges of each pair in order.
fn added(pieces: &mut [Piece], edge: impl Fn(&Piece) -> ContractedEdge) -> Boundaries {
    pieces.sort_unstable_by(lexicographic);
    let pairs = || pieces.chunk_by(|a, b| a[0] == b[0]);
    let mut boundaries = Vec::with_capacity(pairs().count());
    for same in pairs() {
        let mut sum = edge(&same[0]);
        same[1..].iter().for_each(|piece| sum.add(&edge(piece)));
        boundaries.push((same[0][0], sum));
    }
    boundaries
}

/// The edge between two faces as a vector of `length`, in the surface and perpendicular to the step from one to the
/// other.
fn along(from: &Node, to: &Node, length: f64) -> [f64; 3] {
    let (n, m) = (wide(from.normal), wide(to.normal));
    let across = minus(wide(to.centroid), wide(from.centroid));
    let along = cross([n[0] + m[0], n[1] + m[1], n[2] + m[2]], across);
    let norm = norm(along);
    let factor = if norm > 0. { length / norm } else { 0. };
    [along[0] * factor, along[1] * factor, along[2] * factor]
}

/// Writes the contracted graph as arrays of `inner`.
fn assemble(
    graph: &DualGraph,
    nodes: Vec<Node>,
    borders: &Boundaries,
    key: String,
    inner: &WorkDir,
) -> Result<(DualGraph, WeightedGraph)> {
    let step = |&(pair, border): &(Pair, ContractedEdge)| {
        let (a, b) = nodes_of(pair);
        let (from, to) = (&nodes[a as usize].centroid, &nodes[b as usize].centroid);
        let gap = norm([0, 1, 2].map(|axis| f64::from(from[axis] - to[axis])));
        // Bridges have no boundary; their length stays 0.
        let length = norm(border.chord).max(0.1 * border.length) as f32;
        (a, b, [border.weight.max(crate::graph::weights::LEAST), (DETOUR * gap.max(1e-9)) as f32, length])
    };
    let steps: Vec<(u32, u32, [f32; 3])> = borders.iter().map(step).collect();
    let mut indptr = vec![0u64; nodes.len() + 1];
    steps.iter().for_each(|&(a, b, _)| [a, b].iter().for_each(|&node| indptr[node as usize + 1] += 1));
    (0..nodes.len()).for_each(|i| indptr[i + 1] += indptr[i]);
    // Boundaries ascend, so filling in each node's smaller neighbours first, then the greater ones, gives ascending
    // rows.
    let (mut next, mut entries) = (indptr.clone(), vec![(0, [0f32; 3]); 2 * steps.len()]);
    let both = steps.iter().map(|&(a, b, values)| (b, a, values)).chain(steps.iter().copied());
    for (row, column, values) in both {
        entries[next[row as usize] as usize] = (column, values);
        next[row as usize] += 1;
    }
    let write =
        |name: &str, k: usize| inner.write(name, &entries.iter().map(|(_, values)| values[k]).collect::<Vec<f32>>(), 1);
    let indices: Vec<u32> = entries.iter().map(|(column, _)| *column).collect();
    let edges = DualEdges::of_arrays(
        OwnedRowStarts::Plain(inner.write(PLAIN, &indptr, 1)?),
        inner.write(INDICES, &indices, 1)?,
        write(CENTROID_DISTANCES, 1)?,
        write(EDGES, 2)?,
    );
    let weights = write(WEIGHTS, 0)?;
    let weighted = WeightedGraph::new(inner.path(), edges.starts.clone(), edges.indices.clone(), weights, key.clone())?;
    let facts = GraphFacts {
        nodes: nodes.len() as u64,
        edges: borders.len() as u64,
        components: 1,
        duplicate_faces: 0,
        bridges: 0,
        area: nodes.iter().map(|node| f64::from(node.area)).sum(),
        ..graph.facts.clone()
    };
    let nodes = inner.write(nodes::FILE, &nodes, 7)?.into();
    Ok((DualGraph { edges, nodes, components: None, duplicates: None, facts, key }, weighted))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distance::voronoi::nearest_source;
    use crate::mesh::Mesh;
    use std::collections::BTreeMap;

    /// Triangles in rows over a wavy surface, more than two chunks of them.
    fn waves() -> Mesh {
        let (rows, columns) = (140u32, 140u32);
        let height = |x: u32, y: u32| (f64::from(x) / 7.).sin() * (f64::from(y) / 9.).cos();
        let points: Vec<[f64; 3]> = (0..rows * columns)
            .map(|v| [v % columns, v / columns])
            .map(|[x, y]| [f64::from(x), f64::from(y), height(x, y)])
            .collect();
        let corners = (0..rows - 1).flat_map(|y| (0..columns - 1).map(move |x| y * columns + x));
        let faces: Vec<[u32; 3]> =
            corners.flat_map(|v| [[v, v + 1, v + columns], [v + 1, v + columns + 1, v + columns]]).collect();
        Mesh::from_slices(&points, &faces).unwrap()
    }

    #[test]
    fn sums_and_boundaries_are_those_of_one_map_per_chunk() {
        let (mesh, run) = (waves(), Run::new(&()));
        let work = WorkDir::temporary(&std::env::temp_dir()).unwrap();
        let graph = DualGraph::build(&mesh, "waves".as_ref(), &Value::Null, Context::new(&work, &run)).unwrap();
        let (csr, n) = (graph.edges.by_distance(), graph.nodes.len());
        assert!(n > 2 * CHUNK);
        let seeds: Vec<u32> = (0..n as u32).step_by(37).collect();
        let (mut field, mut owner) = (vec![0f32; n], vec![0u32; n]);
        nearest_source(csr, &seeds, &mut field, &mut owner, &run).unwrap();
        // A face that no front reached.
        owner[5_000] = u32::MAX;
        let shares = AreaShares::of(&graph, Context::new(&work, &run)).unwrap();
        let mut expected: BTreeMap<(u32, u32), ContractedEdge> = BTreeMap::new();
        let mut expected_sums = vec![SurfaceSum::default(); seeds.len()];
        for chunk in 0..chunk_count(n, CHUNK) {
            let mut sums: BTreeMap<(u32, u32), ContractedEdge> = BTreeMap::new();
            let add = |to: &mut BTreeMap<_, ContractedEdge>, pair, edge: ContractedEdge| {
                to.entry(pair).and_modify(|sum| sum.add(&edge)).or_insert(edge);
            };
            for i in chunk_range(n, CHUNK, chunk) {
                for (e, (j, weight)) in csr.span(i as u32).zip(csr.neighbours(i as u32)) {
                    let (j, [a, b]) = (j as usize, [i, j as usize].map(|node| owner[node]));
                    if j > i && a != b && a != u32::MAX && b != u32::MAX {
                        let (from, to) = if a < b { (i, j) } else { (j, i) };
                        let length = f64::from(graph.edges.shared().length(i as u32, e).abs());
                        let chord = along(&graph.nodes.at(from), &graph.nodes.at(to), length);
                        add(
                            &mut sums,
                            (a.min(b), a.max(b)),
                            ContractedEdge { weight: field[i] + weight + field[j], length, chord },
                        );
                    }
                }
            }
            sums.into_iter().for_each(|(pair, edge)| add(&mut expected, pair, edge));
            let mut of_chunk = vec![SurfaceSum::default(); seeds.len()];
            for i in chunk_range(n, CHUNK, chunk).filter(|&i| owner[i] != u32::MAX) {
                of_chunk[owner[i] as usize].take(&graph.nodes.at(i), f64::from(shares.at(i)), 0.);
            }
            expected_sums.iter_mut().zip(&of_chunk).for_each(|(sum, part)| sum.add(part));
        }
        for threads in [1, 3] {
            let (run, front) = (Run { threads, ..Run::new(&()) }, FrontValues { owner: &owner, field: &field });
            let mut of_node = vec![0; n];
            let (sums, found) = gather(&graph, csr, &shares, seeds.len(), front, &mut of_node, &run).unwrap();
            assert!(sums == expected_sums && of_node.iter().zip(&owner).all(|(own, &owner)| *own == narrow(owner)));
            assert!(found.len() > 1_000 && found.len() == expected.len());
            for ((pair, edge), (expected_pair, expected)) in found.iter().zip(&expected) {
                let bits = |edge: &ContractedEdge| (edge.weight, edge.length, edge.chord);
                assert_eq!((nodes_of(*pair), bits(edge)), (*expected_pair, bits(expected)));
            }
        }
    }
}
