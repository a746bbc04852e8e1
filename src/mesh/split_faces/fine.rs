//! Labels of a refined mesh, and faces of the mesh split along the boundaries found on it.
//!
//! Where triangles are long, parts are decided on short ones, and their boundaries cross the mesh's faces anywhere. So
//! the short triangles are split ([`FaceSplit::of`]), and the pieces of each face are then joined again as far as
//! neither the mesh nor a boundary needs their vertices ([`coalesce`](super::coalesce)). A face that lies in a single
//! part becomes whole again. Polygons are divided like triangles.
//!
//! Cost: one to two microseconds per short triangle, and 300 bytes.

use super::coalesce::{Pieces, Place, Triangle, turn};
use super::curves::mixed;
use super::strip::is_soup;
use super::{FaceSplit, NewVertex, Piece};
use crate::base::Result;
use crate::base::vector::{area, finite, position_key};
use crate::mesh::geometry::{Mesh, one_per_face, too_many_vertices};
use crate::store::needs::BESIDE_BUDGET;
use crate::store::{MappedSlice, Run};
use std::collections::{BTreeMap, HashMap};
use xxhash_rust::xxh3::xxh3_64;

/// Bytes per short triangle.
const BYTES: u64 = 300;

/// The labels of a refined mesh: of short triangles on the faces of a mesh. Numbers that do not fit together are taken
/// for faces that are not refined.
#[derive(Clone, Debug)]
pub struct FineLabels {
    /// The face of the mesh that each triangle lies on, and its label (t × 2). The triangles of a face follow each
    /// other.
    pub triangles: MappedSlice<u32>,
    /// The corners of each triangle (t × 3).
    pub corners: MappedSlice<u32>,
    /// Where each vertex comes from (v × 2): of a vertex of the mesh, a face, numbered in the order of the triangles,
    /// and the corner of it; of the others, midpoints, the two vertices, which come before.
    pub parents: MappedSlice<u32>,
    /// How many of these vertices the mesh has.
    pub originals: usize,
    /// The [`FineLabels::hash`] of the labels of faces that they belong to.
    pub belongs_to: u64,
}

impl FineLabels {
    /// A hash of the labels of faces.
    pub fn hash(labels: &[u32]) -> u64 {
        xxh3_64(bytemuck::cast_slice(labels))
    }

    fn len(&self) -> usize {
        (self.triangles.len() / 2).min(self.corners.len() / 3)
    }

    fn face(&self, triangle: usize) -> u32 {
        self.triangles[2 * triangle]
    }

    fn corners(&self, triangle: usize) -> [u32; 3] {
        [0, 1, 2].map(|k| self.corners[3 * triangle + k])
    }
}

/// The vertices of a refined mesh, as places on the mesh.
struct FineVertices {
    /// For each vertex the first one at the same position.
    first: Vec<u32>,
    /// Their places, of the first vertices at their positions; `None` where numbers do not fit together.
    places: Vec<Option<Place>>,
    /// Which vertex of the mesh the first ones are.
    originals: Vec<Option<u32>>,
    /// The first vertex at the position of a vertex of the mesh.
    at_vertex: HashMap<u32, u32>,
}

impl FineVertices {
    fn of(mesh: &Mesh, fine: &FineLabels) -> Self {
        let mut faces: Vec<u32> = (0..fine.len()).map(|triangle| fine.face(triangle)).collect();
        faces.dedup();
        let parents: Vec<[u32; 2]> = fine.parents.chunks_exact(2).map(|two| [two[0], two[1]]).collect();
        let vertex = |[face, corner]: [u32; 2]| {
            let face = faces.get(face as usize).filter(|face| (**face as usize) < mesh.faces.len())?;
            mesh.faces.with(*face as usize, |corners| corners.get(corner as usize).copied())
        };
        let originals: Vec<Option<u32>> = parents.iter().take(fine.originals).map(|own| vertex(*own)).collect();
        let (mut at_position, mut at_middle, mut at_vertex) = (HashMap::new(), HashMap::new(), HashMap::new());
        let mut all = Self { first: Vec::new(), places: Vec::new(), originals, at_vertex: HashMap::new() };
        for (k, own) in (0..).zip(&parents) {
            if let Some(vertex) = all.originals.get(k as usize) {
                let at = vertex.map(|v| mesh.positions.get(v)).filter(|at| finite(*at));
                let first = at.map_or(k, |at| *at_position.entry(position_key(at)).or_insert(k));
                vertex.iter().for_each(|v| _ = at_vertex.insert(*v, first));
                all.first.push(first);
                all.places.push(vertex.map(|_| Place::vertex(first)));
                continue;
            }
            let ends = own.map(|v| all.first.get(v as usize).copied().unwrap_or(k));
            let [a, b] = [ends[0].min(ends[1]), ends[0].max(ends[1])];
            all.first.push(*at_middle.entry([a, b]).or_insert(k));
            let half = |v: u32| all.places.get(v as usize).copied().flatten().map(|place| (place, 0.5));
            all.places.push(half(a).zip(half(b)).and_then(|(a, b)| Place::mean([a, b])));
        }
        all.at_vertex = at_vertex;
        all
    }

    /// The vertex of the mesh that the first one `k` at a position is.
    fn original(&self, k: u32) -> Option<u32> {
        self.originals.get(k as usize).copied().flatten()
    }

    /// The position of a place.
    fn position(&self, mesh: &Mesh, place: &Place) -> [f64; 3] {
        mixed(place.of.map(|k| self.original(k).map_or([f64::NAN; 3], |v| mesh.positions.get(v))), place.weights)
    }
}

/// A new vertex: how many vertices it lies between, these, and their weights as bits.
type Key = (usize, [u32; 3], [u64; 3]);

impl FaceSplit {
    /// Splits the faces of `mesh`, which have `labels` (n), along the boundaries of `fine` labels on its refinement;
    /// as [`FaceSplit::of`] if these belong to other labels.
    ///
    /// # Errors
    /// As [`FaceSplit::of`].
    pub fn of_refined(mesh: &Mesh, labels: &[u32], fine: &FineLabels, run: &Run) -> Result<Self> {
        one_per_face("labels", labels.len(), mesh.faces.len())?;
        if fine.belongs_to != FineLabels::hash(labels) {
            return Self::of(mesh, labels, run);
        }
        let bytes = (BYTES * fine.len() as u64).saturating_sub(BESIDE_BUDGET);
        let _grant = run.budget.take_or("pieces of refined faces", bytes, "leave out `split_faces`")?;
        let vertices = FineVertices::of(mesh, fine);
        let mut pieces = pieces(mesh, fine, &vertices, run)?;
        run.cancel.check()?;
        pieces.coalesce();
        run.cancel.check()?;
        Joined { mesh, vertices: &vertices, pieces: &pieces, soup: is_soup(mesh) }.split(labels)
    }
}

/// The short triangles, split where smooth boundaries cross them.
fn pieces(mesh: &Mesh, fine: &FineLabels, vertices: &FineVertices, run: &Run) -> Result<Pieces> {
    let own: Vec<u32> = fine.triangles.chunks_exact(2).map(|two| two[1]).take(fine.len()).collect();
    let n = vertices.first.len() as u32;
    if n == 0 {
        return Ok(Pieces::default());
    }
    // In a soup, positions identify vertices. Otherwise boundaries stay where they are at seams.
    let soup = is_soup(mesh);
    let number = |v: u32| vertices.first.get(v as usize).map_or(0, |&first| if soup { first } else { v });
    let place = |v: u32| vertices.places.get(*vertices.first.get(v as usize)? as usize).copied().flatten();
    let position = |v: u32| place(v).map_or([f64::NAN; 3], |place| vertices.position(mesh, &place));
    let positions: Vec<[f64; 3]> = (0..n).map(position).collect();
    let corners: Vec<[u32; 3]> = (0..fine.len()).map(|t| fine.corners(t).map(number)).collect();
    let tied = tied(&corners, &own, n as usize, place);
    let short = Mesh::from_vecs(positions, corners)?;
    let split = FaceSplit::through(&short, &own, &tied, run)?;
    let mut all = Pieces::default();
    let nowhere = Place { count: 0, ..Place::vertex(0) };
    all.places.extend((0..n).map(|v| place(v).unwrap_or(nowhere)));
    all.places.extend(split.vertices.iter().map(|new| {
        let shares = new.of.into_iter().zip(new.weights);
        let whole: Option<Vec<(Place, f64)>> = shares.map(|(v, share)| place(v).map(|place| (place, share))).collect();
        whole.and_then(Place::mean).unwrap_or(nowhere)
    }));
    all.at = all.places.iter().map(|place| vertices.position(mesh, place)).collect();
    let mut units = HashMap::new();
    let mut add = |face: u32, label: u32, corners: [u32; 3]| {
        let corners = corners.map(|v| vertices.first.get(v as usize).copied().unwrap_or(v));
        let places = corners.map(|v| all.places[v as usize]);
        // A triangle with a side of no length is not refined.
        let Some(of) = Place::mean(places.map(|place| (place, 1. / 3.))).filter(|all| all.count == 3) else { return };
        if places.iter().any(|place| place.count == 0) {
            return;
        }
        let unit = *units.entry((face, of.of)).or_insert_with(|| {
            let within = places.map(|place| place.within(of.of));
            let [a, b, c] = of.of;
            all.units.push(if turn(within) < 0. { [b, a, c] } else { of.of });
            all.units.len() as u32 - 1
        });
        all.triangles.push(Some(Triangle { face, unit, label, corners }));
    };
    let mut changed = split.pieces.chunk_by(|a, b| a.face == b.face).peekable();
    for t in 0..fine.len() {
        match changed.next_if(|pieces| pieces[0].face as usize == t) {
            Some(pieces) => pieces.iter().for_each(|piece| add(fine.face(t), piece.label, piece.corners)),
            None => add(fine.face(t), own[t], fine.corners(t).map(number)),
        }
    }
    Ok(all)
}

/// Which of `n` vertices a boundary has to pass through: those on an edge of the mesh that it follows on either side.
fn tied(corners: &[[u32; 3]], labels: &[u32], n: usize, place: impl Fn(u32) -> Option<Place>) -> Vec<bool> {
    let (mut first, mut several) = (vec![None; n], vec![false; n]);
    for (own, &label) in corners.iter().zip(labels) {
        own.iter().for_each(|&v| several[v as usize] |= *first[v as usize].get_or_insert(label) != label);
    }
    let mut edges: Vec<([u32; 2], u32)> = Vec::new();
    for (&[a, b, c], &label) in corners.iter().zip(labels) {
        let on = |[a, b]: &[u32; 2]| several[*a as usize] && several[*b as usize];
        let own = [[a, b], [b, c], [c, a]].into_iter().filter(on);
        edges.extend(own.map(|[a, b]| ([a.min(b), a.max(b)], label)));
    }
    edges.sort_unstable();
    // How many edges of the boundary begin at a vertex, and how many of them lie on an edge of the mesh.
    let mut count = vec![[0; 2]; n];
    for sides in edges.chunk_by(|a, b| a.0 == b.0).filter(|sides| sides.iter().any(|side| side.1 != sides[0].1)) {
        let ends = sides[0].0;
        let middle = place(ends[0]).zip(place(ends[1])).and_then(|(a, b)| Place::mean([(a, 0.5), (b, 0.5)]));
        let along = usize::from(middle.is_some_and(|middle| middle.count == 2));
        ends.iter().for_each(|&v| count[v as usize] = [count[v as usize][0] + 1, count[v as usize][1] + along]);
    }
    let within = |v: u32| place(v).is_some_and(|place| place.count == 2);
    (0..).zip(count).map(|(v, count)| count == [2, 2] && within(v)).collect()
}

/// Joined pieces of the faces of a mesh.
struct Joined<'a> {
    mesh: &'a Mesh,
    vertices: &'a FineVertices,
    pieces: &'a Pieces,
    soup: bool,
}

impl Joined<'_> {
    /// The faces that change, of a mesh whose faces have `labels`.
    fn split(&self, labels: &[u32]) -> Result<FaceSplit> {
        let mut all: Vec<Triangle> = self.pieces.triangles.iter().flatten().copied().collect();
        all.sort_by_key(|piece| piece.face);
        let mut changed: Vec<(&[Triangle], Vec<u32>)> = Vec::new();
        for own in all.chunk_by(|a, b| a.face == b.face) {
            let face = own[0].face as usize;
            if face < self.mesh.faces.len() {
                let corners = self.mesh.faces.with(face, <[u32]>::to_vec);
                if self.is_changed(own, &corners, labels[face]) {
                    changed.push((own, corners));
                }
            }
        }
        let mut numbers: BTreeMap<Key, u32> = BTreeMap::new();
        for (own, corners) in &changed {
            let own = own.iter().flat_map(|piece| piece.corners).filter_map(|v| self.new_vertex(v, corners));
            own.for_each(|key| _ = numbers.insert(key, 0));
        }
        let first = self.mesh.positions.len();
        let mut split = FaceSplit { vertices: Vec::new(), pieces: Vec::new(), polygons: 0, first };
        for (&(_, of, weights), number) in &mut numbers {
            *number = u32::try_from(split.vertex_count()).map_err(|_| too_many_vertices(self.mesh.path()))?;
            split.vertices.push(NewVertex { of, weights: weights.map(f64::from_bits) });
        }
        for (own, corners) in &changed {
            let number = |v: u32| match self.new_vertex(v, corners) {
                Some(key) => numbers[&key],
                None => self.own_corner(self.pieces.places[v as usize].of[0], corners),
            };
            let start = split.pieces.len();
            split.pieces.extend(own.iter().map(|piece| {
                let Triangle { face, label, corners, .. } = *piece;
                Piece { face, label, corners: corners.map(number) }
            }));
            if let ([piece], [a, b, c]) = (&mut split.pieces[start..], &corners[..]) {
                // A relabelled face keeps its first corner.
                piece.corners = [*a, *b, *c];
            }
            let size = |piece: &Triangle| area(piece.corners.map(|v| self.pieces.at[v as usize]));
            let larger = |most: usize, k: usize| if size(&own[k]) > size(&own[most]) { k } else { most };
            split.pieces.swap(start, start + (1..own.len()).fold(0, larger));
        }
        Ok(split)
    }

    /// Whether the pieces of a face with `corners` and `label` are not the face itself.
    fn is_changed(&self, own: &[Triangle], corners: &[u32], label: u32) -> bool {
        let whole = |piece: &Triangle| piece.corners.iter().all(|&v| self.pieces.places[v as usize].count == 1);
        let mut parts: Vec<u32> = own.iter().map(|piece| piece.unit).collect();
        parts.sort_unstable();
        parts.dedup();
        // Of a polygon whose triangles have not all an area, the others do not cover it.
        parts.len() + 2 == corners.len() && !own.iter().all(|piece| whole(piece) && piece.label == label)
    }

    /// The vertex `v` of a piece of a face with `corners`, if it is new.
    fn new_vertex(&self, v: u32, corners: &[u32]) -> Option<Key> {
        let place = &self.pieces.places[v as usize];
        let from = |k: usize| {
            let first = place.of[k];
            // In a soup, faces share new vertices.
            let own = if self.soup { self.vertices.original(first) } else { None };
            (own.unwrap_or_else(|| self.own_corner(first, corners)), place.weights[k].to_bits())
        };
        let mut of = [0, 1, 2].map(from);
        of[..place.count].sort_unstable();
        if place.count == 2 {
            of[2].0 = of[1].0;
        }
        (place.count > 1).then(|| (place.count, of.map(|own| own.0), of.map(|own| own.1)))
    }

    /// The corner, of a face with `corners`, at the position of the vertex `first`.
    fn own_corner(&self, first: u32, corners: &[u32]) -> u32 {
        let own = corners.iter().copied().find(|v| self.vertices.at_vertex.get(v) == Some(&first));
        own.or_else(|| self.vertices.original(first)).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{below, stream};
    use crate::mesh::long_edges::FineTriangles;
    use std::collections::BTreeSet;

    /// A closed box of 8 × 2 × 1, whose faces have three or four `sides`.
    fn block(sides: usize) -> Mesh {
        let positions: Vec<[f64; 3]> =
            (0..8u32).map(|v| [8. * f64::from(v & 1), f64::from(v & 2), f64::from(v >> 2)]).collect();
        let squares = [[0u32, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let halves = || squares.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect::<Vec<_>>();
        if sides == 3 { Mesh::from_vecs(positions, halves()) } else { Mesh::from_slices(&positions, &squares) }.unwrap()
    }

    /// The same with vertices of its own for each face.
    fn soup(mesh: &Mesh) -> Mesh {
        let corners = faces(mesh).concat();
        let positions: Vec<[f64; 3]> = corners.iter().map(|&v| mesh.positions.get(v)).collect();
        Mesh::from_vecs(positions, (0..corners.len() as u32 / 3).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect())
            .unwrap()
    }

    fn faces(mesh: &Mesh) -> Vec<Vec<u32>> {
        let mut all = Vec::new();
        mesh.faces.for_each(0..mesh.faces.len(), |_, corners| all.push(corners.to_vec()));
        all
    }

    /// `mesh` with the labels of its refinement by `label` at the centre of each triangle, and those of its faces.
    fn refined(mesh: &Mesh, label: impl Fn([f64; 3]) -> u32) -> (FineLabels, Vec<u32>) {
        let mut short = FineTriangles::of(mesh, |p| p);
        assert!(short.split_longer(0.4, 1 << 20));
        let centre = |t: &[u32; 3]| mixed(t.map(|v| short.positions[v as usize]), [1. / 3.; 3]);
        let own: Vec<u32> = short.corners.iter().map(|t| label(centre(t))).collect();
        let mut labels = Vec::new();
        for face in 0..mesh.faces.len() as u32 {
            let mut count: BTreeMap<u32, usize> = BTreeMap::new();
            let on = own.iter().zip(&short.face).filter(|(_, on)| **on == face);
            on.for_each(|(label, _)| *count.entry(*label).or_default() += 1);
            labels.push(count.into_iter().max_by_key(|own| own.1).unwrap().0);
        }
        let triangles: Vec<u32> = short.face.iter().zip(&own).flat_map(|(&face, &label)| [face, label]).collect();
        let parents = [short.originals.clone(), short.midpoints.clone()].concat();
        let fine = FineLabels {
            triangles: triangles.into(),
            corners: short.corners.as_flattened().to_vec().into(),
            parents: parents.as_flattened().to_vec().into(),
            originals: short.originals.len(),
            belongs_to: FineLabels::hash(&labels),
        };
        (fine, labels)
    }

    /// Checks that the split mesh is closed by position, and gives it, its labels, and the area of each label.
    fn checked(mesh: &Mesh, fine: &FineLabels, labels: &[u32]) -> (FaceSplit, BTreeMap<u32, f64>) {
        let run = Run::new(&());
        let split = FaceSplit::of_refined(mesh, labels, fine, &run).unwrap();
        let whole = split.applied(mesh, labels, None, &run).unwrap();
        let mut sides: BTreeMap<[[u64; 3]; 2], [usize; 2]> = BTreeMap::new();
        let mut areas = BTreeMap::new();
        for (face, corners) in faces(&whole.mesh).iter().enumerate() {
            let at: Vec<[f64; 3]> = corners.iter().map(|&v| whole.mesh.positions.get(v)).collect();
            let keys: Vec<[u64; 3]> = at.iter().map(|p| position_key(*p)).collect();
            for k in 0..keys.len() {
                let [a, b] = [keys[k], keys[(k + 1) % keys.len()]];
                sides.entry([a.min(b), a.max(b)]).or_default()[usize::from(a < b)] += 1;
            }
            let size: f64 = (1..at.len() - 1).map(|k| area([at[0], at[k], at[k + 1]])).sum();
            assert!(size > 0.);
            *areas.entry(whole.labels[face]).or_default() += size;
        }
        assert!(sides.values().all(|sides| *sides == [1, 1]), "a crack");
        (split, areas)
    }

    /// The boundary is a plane, oblique to all faces and far from their edges.
    #[test]
    fn long_triangles_are_cut_where_the_boundary_crosses_them() {
        let label = |[x, y, z]: [f64; 3]| u32::from(x + 0.4 * y - 0.3 * z > 3.);
        for mesh in [block(3), soup(&block(3)), block(4)] {
            let (fine, labels) = refined(&mesh, label);
            let (split, areas) = checked(&mesh, &fine, &labels);
            assert!((areas.values().sum::<f64>() - 52.).abs() < 1e-9);
            // At the centre of the box's section, x is 2.75.
            assert!((areas[&0] - (2. + 6. * 2.75)).abs() < 0.6, "{areas:?}");
            let count = split.face_count(mesh.faces.len());
            assert!(count > mesh.faces.len() && count < 120, "{count} of {}", fine.len());
            // The ends are in one part each, and stay whole.
            let changed: BTreeSet<u32> = split.pieces.iter().map(|piece| piece.face).collect();
            let ends = if mesh.faces.len() == 6 { 4..6 } else { 8..12 };
            assert!(ends.clone().all(|face| !changed.contains(&face)), "{changed:?}");
            assert!(split.vertices.iter().all(|new| (new.weights.iter().sum::<f64>() - 1.).abs() < 1e-12));
        }
    }

    /// Islands within a face, parts that meet within one, and a boundary around an end.
    #[test]
    fn boundaries_of_any_kind_leave_no_crack_and_no_part_out() {
        let mut random = stream(2, "fine");
        for round in 0..12 {
            let seeds: Vec<[f64; 3]> =
                (0..5).map(|_| [8, 2, 1].map(|most| f64::from(below(&mut random, 100 * most) as u32) / 100.)).collect();
            let nearest = |at: [f64; 3]| {
                let far = |k: &usize| crate::base::vector::distance(seeds[*k], at);
                (0..5).min_by(|a, b| far(a).total_cmp(&far(b))).unwrap() as u32
            };
            let mesh = if round % 2 == 0 { block(3) } else { block(4) };
            let (fine, labels) = refined(&mesh, nearest);
            let (split, areas) = checked(&mesh, &fine, &labels);
            let own: BTreeSet<u32> = fine.triangles.chunks_exact(2).map(|two| two[1]).collect();
            assert_eq!(areas.keys().copied().collect::<BTreeSet<_>>(), own);
            assert!((areas.values().sum::<f64>() - 52.).abs() < 1e-9);
            assert!(split.face_count(mesh.faces.len()) < fine.len() / 4);
        }
    }

    #[test]
    fn what_needs_no_cut_stays_whole() {
        for mesh in [block(3), soup(&block(3)), block(4)] {
            let (fine, labels) = refined(&mesh, |_| 3);
            assert!(checked(&mesh, &fine, &labels).0.pieces.is_empty());
            // A boundary along edges of the mesh.
            let (fine, labels) = refined(&mesh, |[x, ..]| u32::from(x > 8. - 1e-9));
            let (split, areas) = checked(&mesh, &fine, &labels);
            assert!(split.pieces.is_empty() && split.vertices.is_empty(), "{:?}", split.pieces);
            assert!((areas[&1] - 2.).abs() < 1e-9);
            // Labels that were changed since are those of the faces.
            let (fine, mut labels) = refined(&mesh, |[x, ..]| u32::from(x > 3.));
            labels[0] = 2;
            let run = Run::new(&());
            let [split, plain] =
                [FaceSplit::of_refined(&mesh, &labels, &fine, &run), FaceSplit::of(&mesh, &labels, &run)]
                    .map(Result::unwrap);
            assert_eq!((split.vertices, split.pieces), (plain.vertices, plain.pieces));
        }
    }

    /// Of an altered file.
    #[test]
    fn numbers_that_do_not_fit_together_are_no_panic() {
        let mesh = block(3);
        let (fine, labels) = refined(&mesh, |[x, ..]| u32::from(x > 3.));
        let mut random = stream(7, "altered");
        for _ in 0..200 {
            let mut altered = fine.clone();
            for array in [&mut altered.triangles, &mut altered.corners, &mut altered.parents] {
                let mut numbers = array.to_vec();
                for _ in 0..below(&mut random, 4) {
                    let at = below(&mut random, numbers.len());
                    numbers[at] = below(&mut random, numbers.len()) as u32 / 3;
                }
                *array = numbers.into();
            }
            altered.originals = below(&mut random, 20);
            let run = Run::new(&());
            if let Ok(split) = FaceSplit::of_refined(&mesh, &labels, &altered, &run) {
                _ = split.applied(&mesh, &labels, None, &run);
            }
        }
    }
}
