//! Stray vertices: single ones far outside the mesh, as left behind by scanners and converters.
//!
//! One vertex a hundred diagonals away makes the bounding box a hundred times as large, and the few faces that touch it
//! carry nearly all of the area: sizes, seeds and landmarks then depend only on the stray. So work is done on
//! [`Mesh::without_strays`], where each stray lies at the mean of its neighbours. Its original position does not matter
//! then: the results are the same bytes at any distance. Outputs keep the positions of the file.
//!
//! Genuine geometry must not count as stray: a wall of two triangles around a statue, the tip of a spire and the end of
//! a pole also carry much area on few vertices. Distances are measured from the core, the box between the 5 % and the
//! 95 % quantiles of the coordinates, in units of its diagonal. Vertices [`SPIKE_FROM`] or more outside it are
//! candidates, if they are few. Candidates joined by edges form a cluster, and are strays if the nearest of them is far
//! enough out for the shape of the cluster:
//!
//! - [`SPIKE_FROM`]: a spike on a fine surface. Its base is no wider than the hole that as many missing vertices would
//!   leave, its length is at least [`SPIKE_RATIO`] times that width, and the edges among the candidates enclose
//!   nothing.
//! - [`LOOP_FROM`]: the same where edges among the candidates close a loop. A pole or a blade has a far end that is a
//!   surface.
//! - [`ALWAYS_FROM`]: anything else, such as walls and separate pieces. A single-precision coordinate could not hold
//!   the rest of the mesh together with it.
//!
//! Cost: that of the boxes around runs of vertices, which the bounding box needs too; if there are candidates, also
//! about 5 ns per corner.

use super::geometry::Mesh;
use super::positions::{BOX, Positions};
use crate::base::Result;
use crate::base::union_find::Forest;
use crate::base::vector::{distance, finite, position_key};
use crate::store::Run;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// Distance from the core, in units of its diagonal, from which a vertex may be a stray.
pub const SPIKE_FROM: f64 = 1.;
/// … and from which strays may form closed loops.
pub const LOOP_FROM: f64 = 30.;
/// … and from which every vertex is a stray.
pub const ALWAYS_FROM: f64 = 1e4;
/// At most one in this many vertices may be a stray.
const RARE: usize = 100;
/// … and at most this many in all, which bounds the memory. A mesh with more vertices out there really extends that
/// far.
const MOST: usize = 10_000;
/// Maximum number of corners at candidates, for the same reason.
const MOST_CORNERS: usize = 1 << 20;
/// Width of the hole that a stray would leave, in long edges of the mesh; scaled by the square root of their number for
/// several.
const HOLE: f64 = 4.;
/// Minimum length of a spike, in widths of its hole; the roof of a tower is shorter.
const SPIKE_RATIO: f64 = 8.;
/// The quantile of edge lengths that counts as long.
const LONG: f64 = 0.9;
/// The core lies between these quantiles.
const CORE: [f64; 2] = [0.05, 0.95];
/// Number of vertices and faces sampled for quantiles.
const SAMPLE: usize = 4096;
/// Faces of a chunk.
const CHUNK: usize = 1 << 16;

/// Replacement positions of strays, ascending by vertex; NaN where there is none.
pub type Repairs = Vec<(u32, [f64; 3])>;

impl Mesh {
    /// The note about [`Mesh::strays`].
    pub(crate) fn strays_note(&self) -> String {
        let verb = if self.strays() == 1 { "vertex lies" } else { "vertices lie" };
        let why = "far outside the rest: the mean of the neighbours is used instead";
        format!("{}: {} {verb} {why}", self.path().display(), self.strays())
    }

    /// The same mesh with its stray vertices at the mean of their neighbours; one without a finite neighbour gets no
    /// position (NaN). Faces, the document and all other positions are shared. What this has returned stays as it
    /// is.
    ///
    /// ```
    /// use nystrom_stream::{mesh::Mesh, store::Run};
    /// # fn main() -> nystrom_stream::base::Result<()> {
    /// // A square of 20 × 20 vertices, one of them far away.
    /// let mut points: Vec<[f32; 3]> = (0..400).map(|i| [(i % 20) as f32, (i / 20) as f32, 0.]).collect();
    /// points[210] = [3e30, 0., 7.];
    /// let corner = |i: u32| [[i, i + 1, i + 21], [i, i + 21, i + 20]];
    /// let faces: Vec<[u32; 3]> = (0..380).filter(|i| i % 20 < 19).flat_map(corner).collect();
    /// let mesh = Mesh::from_slices(&points, &faces)?;
    /// let repaired = mesh.without_strays(&Run::new(&()))?;
    /// assert_eq!(repaired.positions.get(210), [10., 10., 0.]);
    /// assert_eq!((mesh.positions.get(210)[2], repaired.strays()), (7., 1));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn without_strays(&self, run: &Run) -> Result<Self> {
        if self.strays() > 0 {
            return Ok(self.clone());
        }
        Ok(self.clone().repaired(find(self, run)?))
    }
}

/// The box that most vertices lie in.
#[derive(Clone, Copy, Debug)]
struct Core {
    low: [f64; 3],
    high: [f64; 3],
    diagonal: f64,
}

impl Core {
    /// Computed from a sample of corners, evenly spread over the faces; `None` where most lie at one point. Unused
    /// vertices do not count, however many there are.
    fn of(mesh: &Mesh, run: &Run) -> Option<Self> {
        let faces = (0..mesh.faces.len()).step_by(mesh.faces.len().div_ceil(SAMPLE).max(1));
        let corner = |face: usize| mesh.faces.with(face, |all| all.get(face % all.len().max(1)).copied());
        let sample: Vec<[f64; 3]> = mesh.sampled(run, |request| {
            if request {
                faces.clone().for_each(|face| mesh.faces.will_need(face..face + 1));
                faces.clone().filter_map(corner).for_each(|v| mesh.positions.will_need(v));
            }
            faces.filter_map(corner).map(|v| mesh.positions.get(v)).filter(|p| finite(*p)).collect()
        });
        let bound = |share, axis| quantile(sample.iter().map(|p| p[axis]).collect(), share);
        let [low, high] = CORE.map(|share| [0, 1, 2].map(|axis| bound(share, axis).unwrap_or(0.)));
        let diagonal = distance(low, high);
        (diagonal > 0. && diagonal.is_finite()).then_some(Self { low, high, diagonal })
    }

    /// How far outside `p` lies, in diagonals; NaN, which does not count as far, if `p` is not finite.
    fn distance(&self, p: [f64; 3]) -> f64 {
        let outside = |axis: usize| (self.low[axis] - p[axis]).max(p[axis] - self.high[axis]);
        outside(0).max(outside(1)).max(outside(2)) / self.diagonal
    }

    /// The core grown by [`SPIKE_FROM`] diagonals; vertices outside it are candidates.
    fn reach(&self) -> [[f64; 3]; 2] {
        let out = SPIKE_FROM * self.diagonal;
        [self.low.map(|x| x - out), self.high.map(|x| x + out)]
    }
}

fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    let at = ((values.len() as f64 * share) as usize).min(values.len().checked_sub(1)?);
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// The strays of `mesh` and their replacement positions.
fn find(mesh: &Mesh, run: &Run) -> Result<Repairs> {
    let positions = &mesh.positions;
    let few = MOST.min(positions.len() / RARE);
    let Some(core) = Core::of(mesh, run).filter(|_| few > 0) else { return Ok(Vec::new()) };
    let [low, high] = core.reach();
    // If there are too many, they are not stored: which ones they are does not matter then.
    let count = AtomicUsize::new(0);
    let is_out =
        |least: [f64; 3], greatest: [f64; 3]| (0..3).any(|axis| least[axis] < low[axis] || greatest[axis] > high[axis]);
    let is_far = |p: [f64; 3]| finite(p) && is_out(p, p);
    // Nearly always there are none.
    let boxes = positions.boxes(run)?;
    let outside = |range: Range<usize>| {
        let [least, greatest] = boxes[range.start / BOX];
        if !is_out(least, greatest) {
            return Ok(Vec::new());
        }
        let far = range.map(|v| v as u32).filter(|&v| is_far(positions.get(v)));
        Ok(far.take_while(|_| count.fetch_add(1, Relaxed) < few).collect::<Vec<u32>>())
    };
    let mut candidates = run.map_ranges(positions.len(), BOX, outside)?.concat();
    if count.into_inner() > few {
        // Most of them may be unused, so they are not part of the geometry.
        candidates = used_where(mesh, is_far, run)?;
    }
    if candidates.is_empty() || candidates.len() > few {
        return Ok(Vec::new());
    }
    match edges_to(mesh, &candidates, run)? {
        Some(edges) => Candidates::of(positions, candidates, edges, core).repairs(long_edge(mesh), run),
        None => Ok(Vec::new()),
    }
}

/// The vertices of faces for which `is_there` holds, ascending; empty if they have more than [`MOST_CORNERS`] corners.
fn used_where(mesh: &Mesh, is_there: impl Fn([f64; 3]) -> bool + Sync, run: &Run) -> Result<Vec<u32>> {
    let count = AtomicUsize::new(0);
    let mut all = run
        .map_ranges(mesh.faces.len(), CHUNK, |range| {
            let mut some = Vec::new();
            mesh.faces.for_each(range, |_, corners| {
                for &v in corners {
                    if is_there(mesh.positions.get(v)) && count.fetch_add(1, Relaxed) < MOST_CORNERS {
                        some.push(v);
                    }
                }
            });
            some.sort_unstable();
            some.dedup();
            Ok(some)
        })?
        .concat();
    all.sort_unstable();
    all.dedup();
    Ok(if count.into_inner() > MOST_CORNERS { Vec::new() } else { all })
}

/// The edges from the candidates, as pairs of a candidate's index and a vertex, ascending, without duplicates; `None`
/// if there are too many.
fn edges_to(mesh: &Mesh, candidates: &[u32], run: &Run) -> Result<Option<Vec<(u32, u32)>>> {
    const BITS: usize = 1 << 16;
    // A small table rejects nearly every corner.
    let mut table = vec![0u64; BITS / 64];
    let count = AtomicUsize::new(0);
    let bit = |v: u32| (v as usize % BITS / 64, 1u64 << (v % 64));
    candidates.iter().for_each(|&v| table[bit(v).0] |= bit(v).1);
    let pairs = run.map_ranges(mesh.faces.len(), CHUNK, |range| {
        let mut pairs = Vec::new();
        mesh.faces.for_each(range, |_, corners| {
            for (k, &v) in corners.iter().enumerate() {
                if table[bit(v).0] & bit(v).1 != 0
                    && let Ok(candidate) = candidates.binary_search(&v)
                    && count.fetch_add(1, Relaxed) < MOST_CORNERS
                {
                    let beside = [corners[(k + 1) % corners.len()], corners[(k + corners.len() - 1) % corners.len()]];
                    pairs.extend(beside.map(|w| (candidate as u32, w)));
                }
            }
        });
        pairs.sort_unstable();
        pairs.dedup();
        Ok(pairs)
    })?;
    if count.into_inner() > MOST_CORNERS {
        return Ok(None);
    }
    let mut pairs = pairs.concat();
    pairs.sort_unstable();
    pairs.dedup();
    Ok(Some(pairs))
}

/// The edge length that nine of ten edges do not exceed, in a sample of faces.
fn long_edge(mesh: &Mesh) -> f64 {
    let mut lengths = Vec::new();
    for face in (0..mesh.faces.len()).step_by(mesh.faces.len().div_ceil(SAMPLE).max(1)) {
        mesh.faces.with(face, |corners| {
            for (k, &v) in corners.iter().enumerate() {
                let ends = [v, corners[(k + 1) % corners.len()]].map(|v| mesh.positions.get(v));
                lengths.push(distance(ends[0], ends[1]));
            }
        });
    }
    lengths.retain(|length| length.is_finite());
    quantile(lengths, LONG).unwrap_or(0.)
}

/// Vertices that may be strays.
struct Candidates<'a> {
    positions: &'a Positions,
    core: Core,
    /// Their numbers, ascending.
    vertices: Vec<u32>,
    /// Index of the first candidate at the same position: if faces share no vertices, a tip consists of several.
    same: Vec<u32>,
    /// Edges from candidates (by index) to vertices.
    edges: Vec<(u32, u32)>,
}

/// A cluster of candidates joined by edges.
struct Cluster {
    /// Candidates at different positions.
    size: usize,
    /// Edges between these.
    inside: usize,
    /// The least distance of them from the core, in its diagonals.
    distance: f64,
    /// The box of the adjacent vertices outside the cluster, if there are any.
    hole: Option<[[f64; 3]; 2]>,
    /// Whether any face touches them.
    used: bool,
}

impl Cluster {
    /// Whether its vertices are strays, for a core with this `diagonal` and a mesh whose long edges have the length
    /// `long_edge`.
    fn is_stray(&self, diagonal: f64, long_edge: f64) -> bool {
        let widest = (HOLE * (self.size as f64).sqrt() * long_edge).min(self.distance * diagonal / SPIKE_RATIO);
        let spike = self.hole.is_some_and(|[low, high]| distance(low, high) <= widest);
        let demanded = match (spike, self.inside < self.size) {
            _ if !self.used => SPIKE_FROM,
            (true, true) => SPIKE_FROM,
            (true, false) => LOOP_FROM,
            (false, _) => ALWAYS_FROM,
        };
        self.distance >= demanded
    }
}

impl<'a> Candidates<'a> {
    fn of(positions: &'a Positions, vertices: Vec<u32>, edges: Vec<(u32, u32)>, core: Core) -> Self {
        let mut first: BTreeMap<[u64; 3], u32> = BTreeMap::new();
        let place = |v: u32| position_key(positions.get(v));
        let same = (0u32..).zip(&vertices).map(|(k, &v)| *first.entry(place(v)).or_insert(k)).collect();
        Self { positions, core, vertices, same, edges }
    }

    /// Index of `v`, if it is one of them.
    fn index(&self, v: u32) -> Option<usize> {
        self.vertices.binary_search(&v).ok()
    }

    /// The clusters, by their first member, and the cluster of each candidate.
    fn clusters(&self) -> (BTreeMap<u32, Cluster>, Vec<u32>) {
        let mut forest = Forest::new(self.vertices.len());
        let mut inside: BTreeSet<(u32, u32)> = BTreeSet::new();
        self.same.iter().zip(0..).for_each(|(&first, k)| _ = forest.join(first, k));
        for &(k, w) in &self.edges {
            if let Some(other) = self.index(w) {
                let (a, b) = (self.same[k as usize], self.same[other]);
                if a != b {
                    forest.join(a, b);
                    inside.insert((a.min(b), a.max(b)));
                }
            }
        }
        let of = forest.labels();
        let mut clusters: BTreeMap<u32, Cluster> = BTreeMap::new();
        let none = || Cluster { size: 0, inside: 0, distance: f64::INFINITY, hole: None, used: false };
        for (k, &v) in self.vertices.iter().enumerate() {
            let cluster = clusters.entry(of[k]).or_insert_with(none);
            cluster.size += usize::from(self.same[k] as usize == k);
            cluster.distance = cluster.distance.min(self.core.distance(self.positions.get(v)));
        }
        for (a, _) in inside {
            clusters.entry(of[a as usize]).or_insert_with(none).inside += 1;
        }
        for &(k, w) in &self.edges {
            let cluster = clusters.entry(of[k as usize]).or_insert_with(none);
            cluster.used = true;
            let p = self.positions.get(w);
            if self.index(w).is_none() && finite(p) {
                let [low, high] = cluster.hole.get_or_insert([p, p]);
                (0..3).for_each(|axis| (low[axis], high[axis]) = (low[axis].min(p[axis]), high[axis].max(p[axis])));
            }
        }
        (clusters, of)
    }

    /// The strays among the candidates of a mesh with such long edges, each at the mean of its neighbours. A stray
    /// whose neighbours are all strays follows once one of these has been placed.
    ///
    /// # Errors
    /// Cancellation.
    fn repairs(&self, long_edge: f64, run: &Run) -> Result<Repairs> {
        let (clusters, of) = self.clusters();
        let stray: Vec<bool> =
            of.iter().map(|cluster| clusters[cluster].is_stray(self.core.diagonal, long_edge)).collect();
        // Vertices at one position stay together.
        let mut around: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
        for &(k, w) in self.edges.iter().filter(|(k, _)| stray[*k as usize]) {
            around.entry(self.same[k as usize]).or_default().insert(w);
        }
        let mut put: BTreeMap<u32, [f64; 3]> = BTreeMap::new();
        let stray_at = |w: u32| self.index(w).filter(|&k| stray[k]).map(|k| self.same[k]);
        // Those that may have a place now: at first all, then the neighbours of what was placed last.
        let mut candidates: BTreeSet<u32> = around.keys().copied().collect();
        while !candidates.is_empty() {
            run.cancel.check()?;
            let place = |w: u32| match stray_at(w) {
                Some(k) => put.get(&k).copied(),
                None => Some(self.positions.get(w)).filter(|p| finite(*p)),
            };
            let next: Vec<(u32, [f64; 3])> = candidates
                .iter()
                .filter_map(|k| Some((*k, mean(around.get(k)?.iter().filter_map(|&w| place(w)))?)))
                .collect();
            put.extend(next.iter().copied());
            let beside = next.iter().flat_map(|(k, _)| &around[k]).filter_map(|&w| stray_at(w));
            candidates = beside.filter(|k| !put.contains_key(k)).collect();
        }
        let repair = |k: usize| (self.vertices[k], put.get(&self.same[k]).copied().unwrap_or([f64::NAN; 3]));
        Ok((0..self.vertices.len()).filter(|&k| stray[k]).map(repair).collect())
    }
}

/// The mean of some points, if there are any.
fn mean(points: impl Iterator<Item = [f64; 3]>) -> Option<[f64; 3]> {
    let (mut sum, mut count) = ([0f64; 3], 0u32);
    for p in points {
        count += 1;
        (0..3).for_each(|axis| sum[axis] += p[axis]);
    }
    (count > 0).then(|| sum.map(|x| x / f64::from(count)))
}

#[cfg(test)]
mod tests {
    use super::*;

    type Arrays = (Vec<[f64; 3]>, Vec<[u32; 3]>);

    /// A square, slightly wavy sheet of `w` × `w` vertices at distance 1.
    fn sheet(w: u32) -> Arrays {
        let at = |i: u32| [f64::from(i % w), f64::from(i / w), 0.1 * f64::from(i % 7)];
        let quad = |i: u32| [[i, i + 1, i + w + 1], [i, i + w + 1, i + w]];
        let faces = (0..w * (w - 1)).filter(|i| i % w < w - 1).flat_map(quad).collect();
        ((0..w * w).map(at).collect(), faces)
    }

    /// Vertices along the border of such a sheet, in order.
    fn border(w: u32) -> Vec<u32> {
        let side = 0..w - 1;
        let (bottom, right) = (side.clone(), side.clone().map(|i| i * w + w - 1));
        let (top, left) = (side.clone().map(|i| w * w - 1 - i), side.map(|i| (w - 1 - i) * w));
        bottom.chain(right).chain(top).chain(left).collect()
    }

    fn strays((points, faces): &Arrays) -> Repairs {
        find(&Mesh::from_slices(points, faces).unwrap(), &Run::new(&())).unwrap()
    }

    /// The mean of the neighbours of `v`.
    fn amid((points, faces): &Arrays, v: u32) -> [f64; 3] {
        let beside: BTreeSet<u32> =
            faces.iter().filter(|face| face.contains(&v)).flatten().copied().filter(|&w| w != v).collect();
        mean(beside.iter().map(|&w| points[w as usize])).unwrap()
    }

    #[test]
    fn strays_go_back_amid_their_neighbours_from_any_distance() {
        let clean = sheet(40);
        assert_eq!(strays(&clean), []);
        let some = [3u32, 150, 444, 487, 700, 813, 902, 1111, 1300, 1599];
        for count in [1, some.len()] {
            let expected: Repairs = some[..count].iter().map(|&v| (v, amid(&clean, v))).collect();
            for far in [120., 1e3, 1e4, 1e10, 1e30, 1e37, 1e150, 1e300] {
                let mut moved = clean.clone();
                for (k, &v) in some[..count].iter().enumerate() {
                    let angle = k as f64;
                    moved.0[v as usize] = [far * angle.cos(), -far * angle.sin(), far * 0.5];
                }
                assert_eq!(strays(&moved), expected, "{count} at {far}");
            }
        }
    }

    #[test]
    fn neighbouring_strays_and_duplicates_are_strays_too() {
        let clean = sheet(40);
        let mut two = clean.clone();
        (two.0[500], two.0[501]) = ([1e6, 0., 0.], [0., -1e7, 3.]);
        let found = strays(&two);
        assert_eq!(found.iter().map(|repair| repair.0).collect::<Vec<u32>>(), [500, 501]);
        assert!(found.iter().all(|(v, p)| distance(*p, clean.0[*v as usize]) < 2.));
        // All vertices of a face, and a vertex without faces.
        let mut face = clean.clone();
        [500, 501, 541].iter().for_each(|&v| face.0[v] = [-3e3 - v as f64, 2. * v as f64, 1e4]);
        face.0.push([1e5; 3]);
        let found = strays(&face);
        assert_eq!(found.iter().map(|repair| repair.0).collect::<Vec<u32>>(), [500, 501, 541, 1600]);
        assert!(found[..3].iter().all(|(v, p)| distance(*p, clean.0[*v as usize]) < 2.));
        assert!(found[3].1[0].is_nan());
        // In a soup, the six copies of a stray get the same position.
        let mut one = clean.clone();
        one.0[820] = [0., 0., 1e9];
        let points: Vec<[f64; 3]> = one.1.iter().flatten().map(|&v| one.0[v as usize]).collect();
        let found = strays(&(points.clone(), (0..one.1.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect()));
        assert!(found.len() == 6 && found.iter().all(|repair| repair.1 == found[0].1), "{found:?}");
        assert!(distance(found[0].1, clean.0[820]) < 1.);
    }

    #[test]
    fn honest_geometry_is_no_stray() {
        // A spire of one vertex on a wide base; then the same as a soup.
        let (w, mut spire) = (40, sheet(40));
        let rim = border(w);
        spire.0.push([20., 20., 2000.]);
        spire.1.extend((0..rim.len()).map(|k| [rim[k], rim[(k + 1) % rim.len()], 1600]));
        assert_eq!(strays(&spire), []);
        let points: Vec<[f64; 3]> = spire.1.iter().flatten().map(|&v| spire.0[v as usize]).collect();
        assert_eq!(strays(&(points, (0..spire.1.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect())), []);
        // A plate a hundred times as large around the sheet, and one apart from it.
        let corners = [[-3e3, -3e3, 0.], [3e3, -3e3, 0.], [3e3, 3e3, 0.], [-3e3, 3e3, 0.]];
        let mut plate = sheet(40);
        plate.0.extend(corners);
        let side = rim.len() / 4;
        for c in 0..4 {
            let [here, next] = [1600 + c as u32, 1600 + (c as u32 + 1) % 4];
            plate.1.extend((side * c..side * (c + 1)).map(|k| [here, rim[(k + 1) % rim.len()], rim[k]]));
            plate.1.push([here, next, rim[side * (c + 1) % rim.len()]]);
        }
        assert_eq!(strays(&plate), []);
        let mut beside = sheet(40);
        beside.0.extend(corners.map(|p| [p[0], p[1], 500.]));
        beside.1.extend([[1600, 1601, 1602], [1600, 1602, 1603]]);
        assert_eq!(strays(&beside), []);
        // A pole with four edges, and a pyramid over a few faces.
        let mut pole = sheet(40);
        pole.0.extend([[20., 20., 500.], [21., 20., 500.], [21., 21., 500.], [20., 21., 500.]]);
        let base = [820u32, 821, 861, 860];
        for k in 0..4 {
            let (a, b, top) = (base[k], base[(k + 1) % 4], 1600 + k as u32);
            pole.1.extend([[a, b, top], [b, 1600 + (k as u32 + 1) % 4, top]]);
        }
        pole.1.extend([[1600, 1601, 1602], [1600, 1602, 1603]]);
        assert_eq!(strays(&pole), []);
        let mut tower = sheet(12);
        tower.0.push([5., 5., 22.]);
        let base: Vec<u32> = [40, 41, 42, 43, 55, 67, 79, 78, 77, 76, 64, 52].to_vec();
        tower.1.extend((0..12).map(|k| [base[k], base[(k + 1) % 12], 144]));
        assert_eq!(strays(&tower), []);
        tower.0[144][2] = 2000.;
        assert_eq!(strays(&tower).len(), 1, "no tower is that high");
    }

    #[test]
    fn many_are_none() {
        // A tenth of the vertices is far away: so many are part of the mesh, not strays.
        let mut mesh = sheet(40);
        (0..160).for_each(|k| mesh.0[10 * k] = [1e9 + k as f64, 0., 0.]);
        assert_eq!(strays(&mesh), []);
        // Meshes of fewer than a hundred vertices have no strays; if most vertices coincide, there is no core.
        let mut small = sheet(9);
        small.0[40] = [1e9; 3];
        assert_eq!(strays(&small), []);
        let mut point = sheet(40);
        point.0[..1590].fill([1.; 3]);
        assert_eq!(strays(&point), []);
        point.0.fill([f64::NAN; 3]);
        assert_eq!(strays(&point), []);
    }
}
