//! Splits faces where smooth boundaries cross them.
//!
//! Face labels change at mesh edges, so boundaries are jagged. [`FaceSplit`] replaces them by the shortest curves in
//! the strip of faces that touch them ([`curves`]), and cuts the faces of the strip along these ([`pieces`]). An edge
//! is cut for all of its faces at one new vertex, and where three parts meet in a face one vertex is placed inside it.
//! So there are no T-junctions, and a closed surface stays closed. New vertices lie on edges and in faces: the surface
//! does not change. Faces other than triangles stay whole, and boundaries next to them do not move.
//!
//! Cost: three passes over the faces, 10 ns per face, and a microsecond or two per face of the strip; 250 bytes per
//! corner of the strip.

mod coalesce;
mod curves;
mod fine;
mod pieces;
mod strip;

use crate::base::Result;
use crate::base::printable::counted;
use crate::mesh::geometry::{Mesh, one_per_face, too_many_vertices};
use crate::store::Run;
use crate::store::budget::Grant;
use curves::{Curves, meeting, mixed};
pub use fine::FineLabels;
use pieces::Cut;
use strip::Strip;
pub(crate) use strip::boundary_vertices;

/// Minimum distance of a triple point from the sides of its face, as a barycentric coordinate.
const LEAST: f64 = 0.05;

/// A vertex that the mesh does not have: a weighted mean of its vertices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NewVertex {
    /// Vertices of the mesh: the ends of an edge, with the second one twice, or the corners of a face.
    pub of: [u32; 3],
    /// Their weights, of sum 1; the third is 0 on an edge.
    pub weights: [f64; 3],
}

impl NewVertex {
    /// Its position.
    pub fn position(&self, mesh: &Mesh) -> [f64; 3] {
        mixed(self.of.map(|v| mesh.positions.get(v)), self.weights)
    }

    /// The mesh vertex with the greatest weight; the first one if equal.
    pub fn nearest(&self) -> u32 {
        let first = (0..3).fold(0, |best, k| if self.weights[k] > self.weights[best] { k } else { best });
        self.of[first]
    }
}

/// A piece of a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// The face of the mesh.
    pub face: u32,
    /// Its label.
    pub label: u32,
    /// Vertices of the mesh, or `v + k` for new vertex `k` of a mesh of `v` vertices.
    pub corners: [u32; 3],
}

/// The split faces of a mesh.
#[derive(Debug)]
pub struct FaceSplit {
    /// The new vertices: those on edges, ascending by the edges' ends, then those in faces.
    pub vertices: Vec<NewVertex>,
    /// The pieces of all faces that change, ascending by face, the largest of each face first. A face that only
    /// changes its label is one piece.
    pub pieces: Vec<Piece>,
    /// Faces next to boundaries that are not triangles.
    pub polygons: usize,
    /// The number of vertices of the mesh.
    first: usize,
}

/// A mesh with split faces, in memory.
pub struct SplitMesh {
    /// The mesh.
    pub mesh: Mesh,
    /// One label per face.
    pub labels: Vec<u32>,
    /// One quality per face, if there is one.
    pub quality: Option<Vec<f32>>,
    _grant: Grant,
}

impl FaceSplit {
    /// Splits the faces of `mesh`, which have `labels` (n).
    ///
    /// # Errors
    /// [`crate::base::Error::Parameter`] for labels that do not match the faces, [`crate::base::Error::Memory`],
    /// [`crate::base::Error::Cancelled`], and [`crate::base::Error::Unusable`] where there would be more vertices than
    /// can be numbered.
    pub fn of(mesh: &Mesh, labels: &[u32], run: &Run) -> Result<Self> {
        Self::through(mesh, labels, &[], run)
    }

    /// [`FaceSplit::of`], where boundaries pass through the vertices of the mesh that are `tied` (v; those beyond are
    /// not).
    fn through(mesh: &Mesh, labels: &[u32], tied: &[bool], run: &Run) -> Result<Self> {
        one_per_face("labels", labels.len(), mesh.faces.len())?;
        let strip = Strip::of(mesh, labels, run)?;
        let curves = Curves::of(&strip, tied, &run.cancel)?;
        let mut split = Self { vertices: Vec::new(), pieces: Vec::new(), polygons: 0, first: mesh.positions.len() };
        // The new vertex at each edge's crossing.
        let mut points: Vec<Option<u32>> = vec![None; strip.edges.len()];
        for (e, &ends) in (0..).zip(&strip.edges) {
            if curves.is_crossed(e) {
                let [a, b] = ends.map(|v| strip.vertices[v as usize]);
                points[e as usize] = Some(match curves.crossing(e) {
                    0. => a,
                    1. => b,
                    t => split.add(mesh, NewVertex { of: [a, b, b], weights: [1. - t, t, 0.] })?,
                });
            }
        }
        for f in 0..strip.len() {
            run.cancel.check()?;
            split.cut(mesh, &strip, &curves, &points, f)?;
        }
        Ok(split)
    }

    /// The number of vertices, including new ones.
    pub fn vertex_count(&self) -> usize {
        self.first + self.vertices.len()
    }

    /// The number of faces after splitting, given `faces` before.
    pub fn face_count(&self, faces: usize) -> usize {
        faces + self.pieces.windows(2).filter(|pair| pair[0].face == pair[1].face).count()
    }

    /// The weights of the corners of a face at vertex `v`, which is one of them or a new one on the face.
    pub fn weights(&self, mesh: &Mesh, corners: &[u32], v: u32) -> Vec<f64> {
        let new = (v as usize).checked_sub(self.first).map(|k| self.vertices[k]);
        let NewVertex { of, weights } = new.unwrap_or(NewVertex { of: [v; 3], weights: [1., 0., 0.] });
        // In a triangle soup, the ends of an edge may be other vertices at the same positions.
        let at = |v: u32| mesh.positions.get(v);
        let same = |v: u32| corners.iter().position(|&w| w == v);
        let corner = |v: u32| same(v).or_else(|| corners.iter().position(|&w| at(w) == at(v)));
        let mut all = vec![0.; corners.len()];
        for (v, weight) in of.into_iter().zip(weights) {
            corner(v).into_iter().for_each(|k| all[k] += weight);
        }
        all
    }

    /// Notes how many faces were not split.
    pub fn tell(&self, run: &Run) {
        if self.polygons > 0 {
            let text = "along boundaries left whole, since only triangles are split: triangulate the mesh for \
                        boundaries that cross them";
            run.progress.note(&format!("{} {text}", counted(self.polygons, "face")));
        }
    }

    /// The mesh with split faces, its labels, and the qualities if there are any: the first piece of a face takes its
    /// place, other pieces and new vertices follow at the end.
    ///
    /// # Errors
    /// [`crate::base::Error::Parameter`] for labels or qualities that do not match the faces;
    /// [`crate::base::Error::Memory`], as all is held.
    pub fn applied(&self, mesh: &Mesh, labels: &[u32], quality: Option<&[f32]>, run: &Run) -> Result<SplitMesh> {
        one_per_face("labels", labels.len(), mesh.faces.len())?;
        quality.map_or(Ok(()), |quality| one_per_face("quality", quality.len(), mesh.faces.len()))?;
        let extra = 3 * (self.face_count(labels.len()) - labels.len());
        let corners = mesh.faces.corner_count() + extra;
        let bytes = 24 * self.vertex_count() as u64 + 16 * (self.face_count(labels.len()) as u64) + 4 * corners as u64;
        let grant = run.budget.take("the mesh with faces split", bytes, bytes)?;
        let mut faces: Vec<u32> = Vec::with_capacity(corners);
        let mut starts = vec![0u64];
        let (mut own, mut qualities) = (labels.to_vec(), quality.map(<[f32]>::to_vec));
        let mut changed = self.pieces.chunk_by(|a, b| a.face == b.face).peekable();
        mesh.faces.for_each(0..labels.len(), |face, corners| {
            if let Some(pieces) = changed.next_if(|pieces| pieces[0].face as usize == face) {
                faces.extend(pieces[0].corners);
                own[face] = pieces[0].label;
            } else {
                faces.extend(corners);
            }
            starts.push(faces.len() as u64);
        });
        for pair in self.pieces.windows(2).filter(|pair| pair[0].face == pair[1].face) {
            faces.extend(pair[1].corners);
            starts.push(faces.len() as u64);
            own.push(pair[1].label);
            if let Some(qualities) = &mut qualities {
                qualities.push(qualities[pair[1].face as usize]);
            }
        }
        let old = (0..self.first as u32).map(|v| mesh.positions.get(v));
        let all = old.chain(self.vertices.iter().map(|new| new.position(mesh)));
        let mesh = if mesh.positions.is_double() {
            Mesh::from_polygons(all.collect::<Vec<_>>(), starts, faces)?
        } else {
            Mesh::from_polygons(all.map(|p| p.map(|x| x as f32)).collect::<Vec<_>>(), starts, faces)?
        };
        Ok(SplitMesh { mesh, labels: own, quality: qualities, _grant: grant })
    }

    fn add(&mut self, mesh: &Mesh, vertex: NewVertex) -> Result<u32> {
        let number = u32::try_from(self.vertex_count()).map_err(|_| too_many_vertices(mesh.path()))?;
        self.vertices.push(vertex);
        Ok(number)
    }

    /// Adds the pieces of face `f` of the strip, if it changes.
    fn cut(&mut self, mesh: &Mesh, strip: &Strip, curves: &Curves, points: &[Option<u32>], f: u32) -> Result<()> {
        let (face, before) = (strip.faces[f as usize], strip.labels[f as usize]);
        let Some(own) = strip.triangle(f) else {
            self.polygons += usize::from(strip.range(f).len() > 3);
            return Ok(());
        };
        let labels = own.map(|v| curves.label[v as usize]);
        if labels.iter().all(|label| label.is_none_or(|label| label == before)) {
            return Ok(());
        }
        let mut corners = [0; 3];
        corners.copy_from_slice(&strip.own[strip.range(f)]);
        let mut crossings = [None; 3];
        for (slot, c) in crossings.iter_mut().zip(strip.range(f)) {
            // The face's own corner at the end of an edge.
            let corner = |v: u32| (0..3).find(|&k| strip.vertices[own[k] as usize] == v).map_or(v, |k| corners[k]);
            *slot = points[strip.edge_of[c] as usize].map(corner);
        }
        let mut centre = None;
        if let [Some(a), Some(b), Some(c)] = crossings {
            let weights = self.meeting(mesh, corners, [a, b, c]);
            centre = Some(self.add(mesh, NewVertex { of: corners, weights })?);
        }
        let at = |v: u32| match (v as usize).checked_sub(self.first) {
            Some(k) => self.vertices[k].position(mesh),
            None => mesh.positions.get(v),
        };
        let pieces = Cut { corners, labels, crossings, centre }.triangles(at);
        if let [(label, _)] = pieces[..] {
            // A relabelled face keeps its first corner.
            self.pieces.extend((label != before).then_some(Piece { face, label, corners }));
        } else {
            self.pieces.extend(pieces.into_iter().map(|(label, corners)| Piece { face, label, corners }));
        }
        Ok(())
    }

    /// The weights of a face's `corners` at the point where three parts meet whose boundaries cross its edges at
    /// `points`.
    fn meeting(&self, mesh: &Mesh, corners: [u32; 3], points: [u32; 3]) -> [f64; 3] {
        let on: [Vec<f64>; 3] = points.map(|v| self.weights(mesh, &corners, v));
        let places = [0, 1, 2].map(|k| mixed(corners.map(|v| mesh.positions.get(v)), [on[k][0], on[k][1], on[k][2]]));
        let shares = meeting(places);
        let weights = [0, 1, 2].map(|corner| (0..3).map(|k| shares[k] * on[k][corner]).sum::<f64>());
        // Moved inside as far as needed.
        let least = weights.into_iter().fold(f64::INFINITY, f64::min);
        let s = if least < LEAST { (LEAST - least) / (1. / 3. - least) } else { 0. };
        weights.map(|x| x + s * (1. / 3. - x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{Random, below, stream, unit};
    use crate::base::vector::{add_scaled, distance, double_area, length};
    use crate::store::Budget;
    use std::collections::{BTreeMap, BTreeSet};

    /// A closed torus of w × h squares, each two triangles, with jittered vertices.
    fn torus(w: u32, h: u32, random: &mut Random) -> Mesh {
        let mut positions = Vec::new();
        for k in 0..w * h {
            let angle =
                |k: u32, of: u32, jitter: f64| (f64::from(k) + 0.6 * jitter) * std::f64::consts::TAU / f64::from(of);
            let (u, v) = (angle(k % w, w, unit(random)), angle(k / w, h, unit(random)));
            let r = 3. + v.cos();
            positions.push([r * u.cos(), r * u.sin(), v.sin()]);
        }
        let at = |x: u32, y: u32| x % w + y % h * w;
        let squares = (0..w * h).map(|k| (k % w, k / w));
        let faces = squares.flat_map(|(x, y)| {
            let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            if (x + y) % 3 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] }
        });
        Mesh::from_vecs(positions, faces.collect()).unwrap()
    }

    /// Labels by the nearest of `parts` random points, noisy at boundaries.
    fn labels(mesh: &Mesh, parts: usize, random: &mut Random) -> Vec<u32> {
        let places: Vec<[f64; 3]> =
            (0..parts).map(|_| mesh.positions.get(below(random, mesh.positions.len()) as u32)).collect();
        let mut labels = Vec::new();
        mesh.faces.for_each(0..mesh.faces.len(), |_, corners| {
            let noise: Vec<f64> = (0..parts).map(|_| 0.4 * unit(random)).collect();
            let far = |k: usize| distance(places[k], mesh.positions.get(corners[0])) + noise[k];
            labels.push((0..parts).min_by(|&a, &b| far(a).total_cmp(&far(b))).unwrap() as u32);
        });
        labels
    }

    fn triangles(mesh: &Mesh) -> Vec<Vec<u32>> {
        let mut all = Vec::new();
        mesh.faces.for_each(0..mesh.faces.len(), |_, corners| all.push(corners.to_vec()));
        all
    }

    fn area(mesh: &Mesh, corners: &[u32]) -> f64 {
        let mut sum = 0.;
        mesh.triangles(corners, |_, at| sum += 0.5 * length(double_area(at)));
        sum
    }

    /// The faces of each directed edge.
    fn halves(faces: &[Vec<u32>]) -> BTreeMap<[u32; 2], Vec<usize>> {
        let mut all: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        for (f, corners) in faces.iter().enumerate() {
            (0..corners.len())
                .for_each(|k| all.entry([corners[k], corners[(k + 1) % corners.len()]]).or_default().push(f));
        }
        all
    }

    /// The edges between faces of different labels, and their total length.
    fn boundary(mesh: &Mesh, labels: &[u32]) -> (Vec<[u32; 2]>, f64) {
        let halves = halves(&triangles(mesh));
        let label = |half: [u32; 2]| halves.get(&half).map(|faces| labels[faces[0]]);
        let apart = |&[a, b]: &[u32; 2]| a < b && label([a, b]) != label([b, a]);
        let edges: Vec<[u32; 2]> = halves.keys().copied().filter(apart).collect();
        let sum = edges.iter().map(|&[a, b]| distance(mesh.positions.get(a), mesh.positions.get(b))).sum();
        (edges, sum)
    }

    fn applied(mesh: &Mesh, labels: &[u32], split: &FaceSplit) -> (Mesh, Vec<u32>) {
        let whole = split.applied(mesh, labels, None, &Run::new(&())).unwrap();
        (whole.mesh, whole.labels)
    }

    #[test]
    fn closed_surfaces_stay_closed_and_where_they_are() {
        let (mut whole, mut met) = (0., 0);
        for seed in 0..12 {
            let mut random = stream(seed, "torus");
            let mesh = torus(24 + seed as u32, 12, &mut random);
            let labels = labels(&mesh, 6, &mut random);
            let split = FaceSplit::of(&mesh, &labels, &Run::new(&())).unwrap();
            let (after, own) = applied(&mesh, &labels, &split);
            let (before, faces) = (triangles(&mesh), triangles(&after));
            assert!(faces.len() > before.len());
            // Closed and consistently wound: every edge is in two faces, once in each direction; the Euler
            // characteristic stays 0.
            let halves = halves(&faces);
            for ([a, b], sides) in &halves {
                assert_eq!((sides.len(), halves.get(&[*b, *a]).map(Vec::len)), (1, Some(1)), "{seed}: {a} {b}");
            }
            assert_eq!(after.positions.len() + faces.len(), halves.len() / 2);
            // The pieces of a face have its area.
            let mut sums: Vec<f64> = before.iter().map(|corners| area(&mesh, corners)).collect();
            let all: f64 = sums.iter().sum();
            let parents: Vec<usize> = (0..before.len())
                .chain(split.pieces.windows(2).filter(|p| p[0].face == p[1].face).map(|p| p[1].face as usize))
                .collect();
            assert_eq!(parents.len(), faces.len());
            for (corners, &parent) in faces.iter().zip(&parents) {
                sums[parent] -= area(&after, corners);
                for &v in corners {
                    let weights = split.weights(&mesh, &before[parent], v);
                    assert!((weights.iter().sum::<f64>() - 1.).abs() < 1e-12 && weights.iter().all(|&x| x >= 0.));
                }
            }
            assert!(sums.iter().all(|sum| sum.abs() < 1e-9 * all), "{seed}");
            // A face whose vertices are all inside one part keeps its label, and no label is lost.
            let mut around = vec![BTreeSet::new(); mesh.positions.len()];
            before.iter().zip(&labels).for_each(|(corners, &label)| {
                corners.iter().for_each(|&v| _ = around[v as usize].insert(label));
            });
            for (corners, label) in faces.iter().zip(&own) {
                for &v in corners.iter().filter(|&&v| around.get(v as usize).is_some_and(|labels| labels.len() == 1)) {
                    assert!(around[v as usize].contains(label), "{seed}: a vertex inside of a part changed it");
                }
            }
            assert_eq!(own.iter().collect::<BTreeSet<_>>(), labels.iter().collect::<BTreeSet<_>>());
            let (old, new) = (boundary(&mesh, &labels).1, boundary(&after, &own).1);
            assert!(new < old, "{seed}: {new} {old}");
            whole += new / old;
            met += split.vertices.iter().filter(|new| new.weights[2] > 0.).count();
        }
        assert!(whole / 12. < 0.85, "boundaries are {} as long", whole / 12.);
        assert!(met > 10, "three parts meet in {met} faces");
    }

    /// By brute force: every crossing is tried at many other positions.
    #[test]
    fn no_crossing_alone_could_make_the_boundary_shorter() {
        let mut random = stream(3, "torus");
        let mesh = torus(40, 20, &mut random);
        // Without noise, the boundary converges.
        let mut labels = Vec::new();
        mesh.faces.for_each(0..mesh.faces.len(), |_, corners| {
            let [x, y, z] = mesh.positions.get(corners[0]);
            labels.push(u32::from(x + 0.3 * y > 0.) + 2 * u32::from(z > 0.2 * x));
        });
        let split = FaceSplit::of(&mesh, &labels, &Run::new(&())).unwrap();
        let (after, own) = applied(&mesh, &labels, &split);
        let (edges, all) = boundary(&after, &own);
        let step = all / edges.len() as f64;
        let (mut tried, mut gained) = (0, 0.);
        for (k, new) in split.vertices.iter().enumerate().filter(|(_, new)| new.weights[2] == 0.) {
            let v = (mesh.positions.len() + k) as u32;
            let ends: Vec<[f64; 3]> = edges
                .iter()
                .filter(|edge| edge.contains(&v))
                .map(|&[a, b]| after.positions.get(if a == v { b } else { a }))
                .collect();
            let [a, b] = [new.of[0], new.of[1]].map(|v| mesh.positions.get(v));
            let sum = |t: f64| {
                let at = add_scaled(a, t, [b[0] - a[0], b[1] - a[1], b[2] - a[2]]);
                ends.iter().map(|&end| distance(end, at)).sum::<f64>()
            };
            // The range that crossings may use.
            let least = (20..=80).map(|t| sum(f64::from(t) / 100.)).fold(f64::INFINITY, f64::min);
            gained += (sum(new.weights[1]) - least).max(0.);
            tried += 1;
        }
        assert!(tried > 100, "{tried}");
        assert!(gained < 0.002 * step * f64::from(tried), "{gained} of {all}");
    }

    #[test]
    fn creases_borders_polygons_and_narrow_parts_stay_on_their_edges() {
        // A roof of two slopes of 8 × 4 squares; the parts are the slopes, so the boundary is the ridge.
        let roof: Vec<[f64; 3]> =
            (0..81).map(|k| [f64::from(k % 9), f64::from(k / 9), -(f64::from(k / 9) - 4.).abs()]).collect();
        let squares = (0..64).map(|k| k % 8 + 9 * (k / 8));
        let halves: Vec<[u32; 3]> = squares.clone().flat_map(|a| [[a, a + 1, a + 10], [a, a + 10, a + 9]]).collect();
        let mesh = Mesh::from_slices(&roof, &halves).unwrap();
        let slopes: Vec<u32> = (0..128).map(|f| u32::from(f >= 64)).collect();
        let split = FaceSplit::of(&mesh, &slopes, &Run::new(&())).unwrap();
        assert!(split.pieces.is_empty() && split.vertices.is_empty());
        // A stepped boundary across the ridge: its ends on the border stay, and border edges are not cut.
        let steps: Vec<u32> = (0..128).map(|f| u32::from(f / 2 % 8 + f / 2 / 8 > 7)).collect();
        let split = FaceSplit::of(&mesh, &steps, &Run::new(&())).unwrap();
        assert!(!split.vertices.is_empty());
        let border = |v: u32| [0, 8].contains(&(v % 9)) || !(9..72).contains(&v);
        assert!(split.vertices.iter().all(|new| new.weights[2] > 0. || !(border(new.of[0]) && border(new.of[1]))));
        // Squares stay whole, and so do triangles next to them on that boundary.
        let quads: Vec<[u32; 4]> = squares.map(|a| [a, a + 1, a + 10, a + 9]).collect();
        let mesh = Mesh::from_slices(&roof, &quads).unwrap();
        let labels: Vec<u32> = (0..64).map(|f| u32::from(f % 8 + f / 8 > 7)).collect();
        let split = FaceSplit::of(&mesh, &labels, &Run::new(&())).unwrap();
        assert!(split.pieces.is_empty() && split.polygons > 0);
        // A part one face wide has no inner vertex, but must not be lost.
        let mesh = Mesh::from_slices(&roof, &halves).unwrap();
        let labels: Vec<u32> = (0..128).map(|f| u32::from(f / 2 % 8 == 3)).collect();
        let split = FaceSplit::of(&mesh, &labels, &Run::new(&())).unwrap();
        assert_eq!(applied(&mesh, &labels, &split).1, labels);
    }

    /// Soups such as STL files: every face has its own vertices.
    #[test]
    fn a_soup_is_split_like_the_mesh_that_it_shows() {
        let mut random = stream(9, "torus");
        let mesh = torus(60, 30, &mut random);
        let labels = labels(&mesh, 4, &mut random);
        let corners = triangles(&mesh).concat();
        let positions: Vec<[f64; 3]> = corners.iter().map(|&v| mesh.positions.get(v)).collect();
        let soup = Mesh::from_vecs(positions, (0..3600).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect()).unwrap();
        let split = FaceSplit::of(&soup, &labels, &Run::new(&())).unwrap();
        // Pieces keep the vertices of their faces; copies of an edge share one new vertex.
        let old = split.pieces.iter().flat_map(|piece| piece.corners.map(|v| (piece.face, v)));
        assert!(old.filter(|&(_, v)| v < 10_800).all(|(face, v)| v / 3 == face));
        let (after, own) = applied(&soup, &labels, &split);
        let mut places = BTreeMap::new();
        let mut welded = Vec::new();
        let faces: Vec<[u32; 3]> = triangles(&after)
            .iter()
            .map(|corners| {
                [0, 1, 2].map(|k| {
                    let at = after.positions.get(corners[k]);
                    *places.entry(at.map(f64::to_bits)).or_insert_with(|| {
                        welded.push(at);
                        welded.len() as u32 - 1
                    })
                })
            })
            .collect();
        let welded = Mesh::from_vecs(welded, faces).unwrap();
        let halves = halves(&triangles(&welded));
        for ([a, b], sides) in &halves {
            assert_eq!((sides.len(), halves.get(&[*b, *a]).map(Vec::len)), (1, Some(1)), "a crack at {a} {b}");
        }
        let expected = FaceSplit::of(&mesh, &labels, &Run::new(&())).unwrap();
        let (plain, plain_labels) = applied(&mesh, &labels, &expected);
        let [a, b] = [boundary(&welded, &own).1, boundary(&plain, &plain_labels).1];
        assert!((a - b).abs() < 0.01 * b, "{a} {b}");
        // Positions are read in as many blocks as the budget requires: here five.
        let near = |face: u32| distance(soup.positions.get(3 * face), [4., 0., 0.]) < 0.5;
        let disc: Vec<u32> = (0..3600).map(|face| u32::from(near(face))).collect();
        let whole = FaceSplit::of(&soup, &disc, &Run::new(&())).unwrap();
        assert!(whole.vertices.len() > 5);
        let small = Run { budget: Budget::new(84_000), ..Run::new(&()) };
        let blocks = FaceSplit::of(&soup, &disc, &small).unwrap();
        assert_eq!((blocks.vertices, blocks.pieces), (whole.vertices, whole.pieces));
    }

    /// Repeated corners, non-manifold edges, positions that are not finite, and arbitrary labels.
    #[test]
    fn the_oddest_meshes_are_split_without_a_crack() {
        let mut cuts = 0;
        for seed in 0..200 {
            let mut random = stream(seed, "odd");
            let whole = torus(9, 8, &mut random);
            let labels = labels(&whole, 3, &mut random);
            let (mut positions, mut faces): (Vec<_>, _) =
                ((0..72).map(|v| whole.positions.get(v)).collect(), triangles(&whole));
            for _ in 0..6 {
                let odd = [f64::NAN, f64::INFINITY, 0., 3., 3., 3.];
                positions[below(&mut random, 72)] = [0; 3].map(|_| odd[below(&mut random, odd.len())]);
                let corners = [0; 3].map(|_| below(&mut random, 72) as u32);
                let at = below(&mut random, faces.len());
                faces[at] = if at < 72 { corners.to_vec() } else { vec![corners[0], faces[at][1], faces[at][2]] };
            }
            let mesh = Mesh::from_slices(&positions, &faces).unwrap();
            let split = FaceSplit::of(&mesh, &labels, &Run::new(&())).unwrap();
            let (after, own) = applied(&mesh, &labels, &split);
            assert_eq!((after.faces.len(), own.len()), (split.face_count(144), split.face_count(144)));
            // No face contains a cut edge as a whole.
            let on_edges = split.vertices.iter().filter(|new| new.weights[2] == 0.);
            let cut: BTreeSet<[u32; 2]> = on_edges.map(|new| [new.of[0], new.of[1]]).collect();
            for c in triangles(&after) {
                for [a, b] in [[c[0], c[1]], [c[1], c[2]], [c[2], c[0]]] {
                    assert!(!cut.contains(&[a.min(b), a.max(b)]), "{seed}: {a} {b}");
                }
            }
            cuts += cut.len();
        }
        assert!(cuts > 100, "{cuts}");
    }

    #[test]
    fn memory_and_threads_change_nothing() {
        let mut random = stream(5, "torus");
        let mesh = torus(400, 100, &mut random);
        let mut labels = vec![0; mesh.faces.len()];
        mesh.faces.for_each(0..labels.len(), |face, corners| {
            labels[face] = u32::from(distance(mesh.positions.get(corners[0]), [4., 0., 0.]) < 0.2);
        });
        let whole = FaceSplit::of(&mesh, &labels, &Run::new(&())).unwrap();
        assert!(whole.vertices.len() > 10);
        // Three blocks of vertices.
        let small = Run { threads: 1, budget: Budget::new(84_000), ..Run::new(&()) };
        let blocks = FaceSplit::of(&mesh, &labels, &small).unwrap();
        assert_eq!((blocks.vertices, blocks.pieces), (whole.vertices.clone(), whole.pieces.clone()));
        // Regression: a small strip was refused where the budget has no room for it.
        let none = Run { budget: Budget::new(22_000), ..Run::new(&()) };
        let split = FaceSplit::of(&mesh, &labels, &none).unwrap();
        assert_eq!((split.vertices, split.pieces), (whole.vertices, whole.pieces));
        // Here all faces lie along boundaries: 60 MB.
        let labels: Vec<u32> = (0..labels.len() as u32).map(|face| face % 2).collect();
        let told = FaceSplit::of(&mesh, &labels, &none).unwrap_err().to_string();
        assert!(told.contains("faces along boundaries") && told.ends_with("or leave out `split_faces`"), "{told}");
    }
}
