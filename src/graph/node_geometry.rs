//! Geometry of the nodes, and lengths of the edges between them, for the stages: stored in arrays, or computed from the
//! mesh.
//!
//! Arrays cost 40 bytes per triangle: 28 of nodes, 12 of shared edges. If a mesh is larger than memory, they cost more
//! to read than the mesh's own 18 bytes, from which both follow in 10 to 20 ns per access. So such a mesh is not
//! copied: [`ComputedGeometry`] computes the same numbers to the bit, with the same functions. A few edges cannot be
//! computed from two faces alone (welded ones, edges shared twice, some of non-manifold meshes); these are listed.

use super::frame::Frame;
use super::nodes::{self, Node};
use crate::base::Result;
use crate::base::vector::distance;
use crate::mesh::Mesh;
use crate::store::mapped::{Access, advise, prefetch, will_need};
use crate::store::{MappedSlice, Run};
use std::ops::Range;
use std::sync::Arc;

/// Maximum number of listed edges, 12 bytes each; a mesh with more stores arrays.
pub(super) const MOST_LISTED: usize = 1 << 20;

/// Nodes per chunk of a pass.
const CHUNK: usize = 1 << 15;

/// Geometry of the nodes (n).
#[derive(Clone, Debug)]
pub struct NodeGeometry {
    array: MappedSlice<Node>,
    mesh: Option<Arc<ComputedGeometry>>,
}

impl NodeGeometry {
    /// Computed from `mesh` at each access.
    pub(super) fn computed(mesh: ComputedGeometry) -> Self {
        Self { array: MappedSlice::empty(), mesh: Some(Arc::new(mesh)) }
    }

    /// The mesh it is computed from; `None` if it is stored.
    pub(super) fn mesh(&self) -> Option<&Arc<ComputedGeometry>> {
        self.mesh.as_ref()
    }

    /// The array; empty if geometry is computed.
    pub(super) fn array(&self) -> &[Node] {
        &self.array
    }

    /// Whether it is computed at each access.
    pub fn is_computed(&self) -> bool {
        self.mesh.is_some()
    }

    /// A view of the nodes.
    #[inline]
    pub fn view(&self) -> NodeView<'_> {
        NodeView(match &self.mesh {
            None => Look::Array(&self.array),
            Some(mesh) => Look::Mesh(mesh),
        })
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.view().len()
    }

    /// [`NodeView::window`].
    pub fn window<'a>(&'a self, range: Range<usize>, held: &'a mut Vec<Node>) -> NodeWindow<'a> {
        self.view().window(range, held)
    }

    /// The node `node`.
    #[inline]
    pub fn at(&self, node: usize) -> Node {
        self.view().at(node)
    }

    /// The area of the node `node`.
    #[inline]
    pub fn area(&self, node: usize) -> f32 {
        self.view().area(node)
    }
}

/// A view of the nodes (n), stored or computed.
#[derive(Clone, Copy, Debug)]
pub struct NodeView<'a>(Look<'a>);

#[derive(Clone, Copy, Debug)]
enum Look<'a> {
    Array(&'a [Node]),
    Mesh(&'a ComputedGeometry),
}

impl<'a> NodeView<'a> {
    /// Number of nodes.
    pub fn len(self) -> usize {
        match self.0 {
            Look::Array(array) => array.len(),
            Look::Mesh(mesh) => mesh.mesh.faces.len(),
        }
    }

    /// The node `node`.
    #[inline]
    pub fn at(self, node: usize) -> Node {
        match self.0 {
            Look::Array(array) => array[node],
            Look::Mesh(mesh) => mesh.node(node),
        }
    }

    /// Prefetches the node `node`, if it is stored.
    #[inline]
    pub fn prefetch(self, node: usize) {
        if let Look::Array(array) = self.0 {
            prefetch(array, node);
        }
    }

    /// Advises the kernel how nodes, or the faces that they are computed from, are read from now on.
    pub fn advise(self, access: Access) {
        match self.0 {
            Look::Array(array) => advise(array, access),
            Look::Mesh(mesh) => mesh.mesh.faces.advise(access),
        }
    }

    /// Asks the kernel to read the nodes `range`, or their faces, soon.
    pub fn will_need(self, range: Range<usize>) {
        match self.0 {
            Look::Array(array) => will_need(&array[range]),
            Look::Mesh(mesh) => mesh.mesh.faces.will_need(range),
        }
    }

    /// The area of the node `node`: cheaper than [`Self::at`].
    #[inline]
    pub fn area(self, node: usize) -> f32 {
        match self.0 {
            Look::Array(array) => array[node].area,
            Look::Mesh(mesh) => mesh.area(node),
        }
    }

    /// Calls `visit` with the nodes of `range`, in order.
    #[inline]
    pub fn each(self, range: Range<usize>, mut visit: impl FnMut(usize, &Node)) {
        match self.0 {
            Look::Array(array) => range.clone().zip(&array[range]).for_each(|(i, node)| visit(i, node)),
            Look::Mesh(mesh) => mesh.each_node(range, visit),
        }
    }

    /// A window on nodes from `first` on that were computed before.
    pub(super) fn window_of(self, first: usize, items: &'a [Node]) -> NodeWindow<'a> {
        NodeWindow { nodes: self, first, items }
    }

    /// A window on the nodes of `range`; if they are computed, `held` stores them: 28 bytes each.
    pub fn window(self, range: Range<usize>, held: &'a mut Vec<Node>) -> NodeWindow<'a> {
        match self.0 {
            Look::Array(items) => NodeWindow { nodes: self, first: 0, items },
            Look::Mesh(mesh) => {
                let first = range.start;
                held.clear();
                mesh.each_node(range, |_, node| held.push(*node));
                self.window_of(first, held)
            }
        }
    }

    /// Writes the areas of all nodes to `out` (n).
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn areas(self, out: &mut [f32], run: &Run) -> Result<()> {
        let fill = |k: usize, out: &mut [f32], (): &mut ()| {
            let first = k * CHUNK;
            self.each(first..first + out.len(), |i, node| out[i - first] = node.area);
            Ok(())
        };
        run.fill_chunks(out, CHUNK, || (), fill).map(drop)
    }
}

impl<'a> From<&'a [Node]> for NodeView<'a> {
    fn from(nodes: &'a [Node]) -> Self {
        Self(Look::Array(nodes))
    }
}

/// Geometry for passes over a range of nodes and their neighbours, most of which lie in the range too. Nodes of the
/// range are computed once.
#[derive(Clone, Copy, Debug)]
pub struct NodeWindow<'a> {
    nodes: NodeView<'a>,
    first: usize,
    /// The nodes of the range; all nodes if they are stored.
    items: &'a [Node],
}

impl NodeWindow<'_> {
    /// The node `node` if it need not be computed.
    #[inline(always)]
    pub fn held(&self, node: usize) -> Option<&Node> {
        self.items.get(node.wrapping_sub(self.first))
    }

    /// The node `node`, inside or outside the range.
    #[inline(always)]
    pub fn at(&self, node: usize) -> Node {
        match self.held(node) {
            Some(node) => *node,
            None => self.nodes.at(node),
        }
    }

    /// The same without a copy if it is stored; otherwise `computed` holds it. A copy is written in two pieces and read
    /// in three, which defeats the processor's store forwarding: without it, passes over edges take a third of the
    /// time.
    #[inline(always)]
    pub fn look<'b>(&'b self, node: usize, computed: &'b mut Node) -> &'b Node {
        match self.held(node) {
            Some(node) => node,
            None => {
                *computed = self.nodes.at(node);
                computed
            }
        }
    }
}

impl From<MappedSlice<Node>> for NodeGeometry {
    fn from(array: MappedSlice<Node>) -> Self {
        Self { array, mesh: None }
    }
}

/// A mesh in its frame, and which of its faces are flipped.
#[derive(Clone, Debug)]
pub(super) struct ComputedGeometry {
    pub mesh: Mesh,
    pub frame: Frame,
    /// One bit per face, set if its normal is flipped, 64 to a word, least bit first; empty if no face is.
    pub flipped: MappedSlice<u64>,
}

impl ComputedGeometry {
    /// Whether the normal of face `face` is flipped.
    #[inline]
    pub fn is_flipped(&self, face: usize) -> bool {
        self.flipped.get(face / 64).is_some_and(|word| word >> (face % 64) & 1 == 1)
    }

    /// The node of face `face`. Not inlined, like the others, so that loops over arrays stay small.
    #[inline(never)]
    pub fn node(&self, face: usize) -> Node {
        let (node, _) = self.mesh.faces.with(face, |corners| Node::of_face(corners, &self.mesh, &self.frame));
        self.flip(face, node)
    }

    /// Flips the normal of `node`, which follows the winding in the file, if `face` is marked.
    #[inline]
    fn flip(&self, face: usize, mut node: Node) -> Node {
        if self.is_flipped(face) {
            node.normal = node.normal.map(|x| 0. - x);
        }
        node
    }

    /// Calls `visit` with the nodes of `range`, in order, in a loop without calls.
    #[inline]
    pub fn each_node(&self, range: Range<usize>, mut visit: impl FnMut(usize, &Node)) {
        nodes::each_node(&self.mesh, self.frame, range, |face, node, _| visit(face, &self.flip(face, *node)));
    }

    /// The area of face `face`.
    #[inline(never)]
    pub fn area(&self, face: usize) -> f32 {
        self.mesh.faces.with(face, |corners| Node::of_face(corners, &self.mesh, &self.frame).0.area)
    }

    /// The edges of face `from`.
    #[inline(never)]
    pub fn row(&self, from: usize) -> FaceEdges {
        self.mesh.faces.with(from, |corners| match *corners {
            [a, b, c] => {
                let [p, q, r] = [a, b, c].map(|v| self.frame.place(self.mesh.positions.get(v)));
                let lengths = [distance(p, q) as f32, distance(q, r) as f32, distance(r, p) as f32];
                FaceEdges::Triangle([a, b, c], lengths)
            }
            _ => FaceEdges::Polygon(from),
        })
    }

    /// Length of the first of `edges` that face `to` shares, negative if both traverse it in the same direction; 0 if
    /// there is none.
    #[inline(never)]
    pub fn shared(&self, edges: &FaceEdges, to: usize) -> f32 {
        let (length, opposite_winding) = match edges {
            FaceEdges::Triangle(corners, lengths) => {
                let found = self.mesh.faces.with(to, |other| common_edge(corners, other));
                let Some((k, opposite_winding)) = found else { return 0. };
                (lengths[k], opposite_winding)
            }
            &FaceEdges::Polygon(from) => {
                let found = self.mesh.faces.with(from, |a| {
                    let (k, opposite_winding) = self.mesh.faces.with(to, |b| common_edge(a, b))?;
                    Some(([a[k], a[after(k, a.len())]], opposite_winding))
                });
                let Some((ends, opposite_winding)) = found else { return 0. };
                let [a, b] = ends.map(|v| self.frame.place(self.mesh.positions.get(v)));
                (distance(a, b) as f32, opposite_winding)
            }
        };
        if opposite_winding { -length } else { length }
    }
}

/// The edges of a face: corners and the lengths of the edges that leave them, or only the face.
#[derive(Clone, Copy, Debug)]
pub(super) enum FaceEdges {
    Triangle([u32; 3], [f32; 3]),
    Polygon(usize),
}

/// The corner after corner `k` of `len`.
#[inline]
fn after(k: usize, len: usize) -> usize {
    if k + 1 == len { 0 } else { k + 1 }
}

/// The first edge of a face with the corners `a` that a face with the corners `b` shares, given by its first corner,
/// and whether both traverse it in the same direction.
#[inline]
fn common_edge(a: &[u32], b: &[u32]) -> Option<(usize, bool)> {
    for k in 0..a.len() {
        let (u, v) = (a[k], a[after(k, a.len())]);
        for m in 0..b.len() {
            let (x, y) = (b[m], b[after(m, b.len())]);
            if (x, y) == (v, u) {
                return Some((k, false));
            }
            if (x, y) == (u, v) {
                return Some((k, true));
            }
        }
    }
    None
}

/// Edges between faces, computed from the mesh except for those that are listed.
#[derive(Clone, Debug)]
pub(super) struct ComputedEdges {
    pub mesh: Arc<ComputedGeometry>,
    /// From, to and length as matched, before faces were flipped; ascending.
    pub listed: Arc<[ListedEdge]>,
}

/// An edge whose length [`ComputedGeometry::shared`] cannot compute.
pub(super) type ListedEdge = (u32, u32, f32);

impl ComputedEdges {
    /// Length of the edge between two neighbours, negative if their windings contradict.
    #[inline]
    fn between(&self, edges: &FaceEdges, from: u32, to: u32) -> f32 {
        let listed = if self.listed.is_empty() {
            None
        } else {
            self.listed.binary_search_by_key(&(from, to), |edge| (edge.0, edge.1)).ok()
        };
        let length = match listed {
            None => self.mesh.shared(edges, to as usize),
            Some(k) => self.listed[k].2,
        };
        let flip =
            !self.mesh.flipped.is_empty() && self.mesh.is_flipped(from as usize) != self.mesh.is_flipped(to as usize);
        if flip { -length } else { length }
    }
}

/// The graph with the lengths of shared edges.
#[derive(Clone, Copy, Debug)]
pub struct SharedEdges<'a> {
    /// Neighbours, and the lengths if they are stored.
    pub(super) graph: super::Csr<'a>,
    pub(super) computed: Option<&'a ComputedEdges>,
    /// Whether any length may be negative.
    pub(super) mixed: bool,
}

impl<'a> SharedEdges<'a> {
    /// The neighbours of `node`, each with the length of the shared edge in the frame: negative if the windings of the
    /// two contradict and could not be made consistent, 0 (of any sign) for bridges.
    #[inline(always)]
    pub fn neighbours(self, node: u32) -> impl Iterator<Item = (u32, f32)> + Clone + 'a {
        let computed = self.computed.map(|computed| (computed, computed.mesh.row(node as usize)));
        self.graph.span(node).map(move |e| {
            let to = self.graph.indices[e];
            let length = match &computed {
                None => self.graph.weights[e],
                Some((computed, edges)) => computed.between(edges, node, to),
            };
            (to, length)
        })
    }

    /// Asks the kernel to read the rows of `nodes` soon ([`Run::will_need`]).
    pub fn will_need(self, nodes: Range<usize>, run: &Run) {
        self.graph.will_need(nodes, run);
    }

    /// The entries of the row of `node`, each with its neighbour: for passes that need few lengths.
    #[inline(always)]
    pub fn entries(self, node: u32) -> impl Iterator<Item = (usize, u32)> + Clone + 'a {
        self.graph.span(node).map(move |e| (e, self.graph.indices[e]))
    }

    /// The length at entry `e`, which is in the row of `node`.
    #[inline(always)]
    pub fn length(self, node: u32, e: usize) -> f32 {
        match self.computed {
            None => self.graph.weights[e],
            Some(computed) => computed.between(&computed.mesh.row(node as usize), node, self.graph.indices[e]),
        }
    }

    /// Whether the length at entry `e`, which is in the row of `node`, is negative.
    #[inline(always)]
    pub fn opposite_winding(self, node: u32, e: usize) -> bool {
        self.mixed && self.length(node, e) < 0.
    }
}

#[cfg(test)]
mod tests {
    use crate::base::random::{below, stream};
    use crate::graph::DualGraph;
    use crate::mesh::Mesh;
    use crate::store::{Context, Run, WorkDir};
    use serde_json::Value;

    /// Builds the graph of `mesh` both ways and compares all that stages see of it.
    fn compare(mesh: &Mesh, name: &str) {
        let run = Run { threads: 2, ..Run::new(&()) };
        let folder = tempfile::tempdir().unwrap();
        let works = [(); 2].map(|()| WorkDir::temporary(folder.path()).unwrap());
        let [kept, computed] = [DualGraph::build, DualGraph::build_computed];
        let kept = kept(mesh, name.as_ref(), &Value::Null, Context::new(&works[0], &run)).unwrap();
        let computed = computed(mesh, name.as_ref(), &Value::Null, Context::new(&works[1], &run)).unwrap();
        // Links of duplicates do not follow from two faces alone.
        let has_duplicates = kept.facts.duplicate_faces > 0;
        assert!(computed.nodes.is_computed() != has_duplicates && !kept.nodes.is_computed());
        assert_eq!(computed.facts, kept.facts, "{name}");
        let bits = |numbers: &[f32]| numbers.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        let mut held = Vec::new();
        let window = computed.nodes.window(0..kept.nodes.len() / 2, &mut held);
        for i in 0..kept.nodes.len() {
            let [a, b, c] = [kept.nodes.at(i), computed.nodes.at(i), window.at(i)]
                .map(|node| bits(&[&node.centroid[..], &node.normal[..], &[node.area]].concat()));
            assert!(a == b && a == c, "{name}, node {i}");
            assert_eq!(computed.nodes.area(i).to_bits(), kept.nodes.area(i).to_bits(), "{name}, node {i}");
            let [a, b] = [&kept, &computed].map(|graph| graph.edges.shared().neighbours(i as u32).collect::<Vec<_>>());
            // Zeros of any sign are equal.
            assert_eq!(a, b, "{name}, row {i}");
            let shared = computed.edges.shared();
            for ((e, to), (near, length)) in shared.entries(i as u32).zip(b) {
                assert_eq!(
                    (to, shared.length(i as u32, e), shared.opposite_winding(i as u32, e)),
                    (near, length, length < 0.)
                );
            }
        }
        assert!(kept.edges.centroid_distance[..] == computed.edges.centroid_distance[..]);
    }

    #[test]
    fn what_is_computed_is_what_arrays_hold() {
        let strip = |n: u32| {
            let around = |k: u32| f64::from(k) * std::f64::consts::TAU / f64::from(n);
            let point = |k: u32, side: f64| {
                let (turn, half) = (around(k), around(k) / 2.);
                let r = 2. + side * half.cos();
                [r * turn.cos(), r * turn.sin(), side * half.sin()]
            };
            let points: Vec<[f64; 3]> = (0..n).flat_map(|k| [point(k, -0.5), point(k, 0.5)]).collect();
            let next = |k: u32| if k + 1 == n { [1, 0] } else { [2 * k + 2, 2 * k + 3] };
            let faces = (0..n).flat_map(|k| [[2 * k, next(k)[0], 2 * k + 1], [2 * k + 1, next(k)[0], next(k)[1]]]);
            Mesh::from_slices(&points, &faces.collect::<Vec<[u32; 3]>>()).unwrap()
        };
        compare(&strip(12), "a Möbius strip");
        let corners = [[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.], [1., 1., 0.], [0.4, 0.3, -1.]];
        let of = |faces: &[Vec<u32>]| Mesh::from_slices(&corners, faces).unwrap();
        compare(&of(&[vec![0, 1, 2], vec![2, 1, 0]]), "a pillow");
        compare(&of(&[vec![0, 1, 2], vec![0, 3, 1], vec![1, 3, 2], vec![0, 2, 3]]), "a tetrahedron wound inwards");
        compare(&of(&[vec![0, 1, 4, 2], vec![0, 3, 1], vec![2, 4, 5], vec![1, 5, 4], vec![0, 1]]), "polygons");
        compare(&of(&[vec![0, 1, 2], vec![0, 1, 3], vec![1, 0, 4], vec![0, 1, 5]]), "a fan of four");
        let apart =
            [[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.], [1., 0., 0.], [0., 1., 0.], [1., 1., 0.], [7., 7., 7.]];
        compare(&Mesh::from_slices(&apart, &[[0u32, 1, 2], [3, 5, 4], [5, 6, 4]]).unwrap(), "welded");
        compare(&Mesh::from_slices(&apart, &[[0u32, 1, 2], [6, 6, 5], [5, 6, 4]]).unwrap(), "two components");
        for seed in 0..40 {
            let mut random = stream(seed, "soup");
            let count = 4 + below(&mut random, 30);
            let points: Vec<[f32; 3]> = (0..count)
                .map(|_| {
                    [(); 3].map(|()| if below(&mut random, 60) == 0 { f32::NAN } else { below(&mut random, 9) as f32 })
                })
                .collect();
            let faces: Vec<Vec<u32>> = (0..60)
                .map(|_| (0..3 + below(&mut random, 2)).map(|_| below(&mut random, count) as u32).collect())
                .collect();
            compare(&Mesh::from_slices(&points, &faces).unwrap(), &format!("soup {seed}"));
        }
    }
}
