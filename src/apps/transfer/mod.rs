//! Transfers labels from one mesh to another of the same shape: another resolution, decimated, re-meshed.
//!
//! Every face searches from its middle, or, if its mesh is the coarser one, from four points on it, for the nearest
//! face whose normal agrees within 60° ([`closest_faces`]), so that thin walls keep their sides; if normals are
//! opposite throughout, they are flipped. Faces without a nearby face, and small islands of uncertain ones, get the
//! label around them, ring by ring over the dual graph. Memory: a block of the first mesh as the budget allows; 16
//! bytes per point and 8 per face in the work directory.

pub mod closest_faces;

use crate::base::sort::sort_by;
use crate::base::union_find::Forest;
use crate::base::{Error, Result};
use crate::graph::DualGraph;
use crate::mesh::{Labelling, Mesh, UNLABELLED};
use crate::store::budget::Grant;
use crate::store::{Context, MappedSlice, Run};
use closest_faces::{Agreement, BYTES, Closest, Probe, TriangleTree, UnitFrame, normal, unit, unpack, window};
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;

/// Faces that a thread processes at a time.
const CHUNK: usize = 1 << 12;
/// Number of faces of either mesh sampled to determine the orientation of its normals.
const TRIAL: usize = 20_000;
/// Distance, in edges, beyond which a face is not near.
const FAR: f32 = 8.;
/// Share of the mesh's faces below which a piece is an island.
const ISLAND: f64 = 2e-4;

/// Transferred labels, and the quality of the transfer.
#[derive(Clone, Debug)]
pub struct Transferred {
    /// One label per face (n).
    pub labels: MappedSlice<u32>,
    /// The confidence of each, 0 to 1 (n).
    pub quality: MappedSlice<f32>,
    /// The counts.
    pub facts: TransferCounts,
}

/// The quality of a transfer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct TransferCounts {
    /// Faces of the mesh.
    pub faces: u64,
    /// Faces with an uncertain label: no nearby normal agrees, the nearest face is more than an edge away, its points
    /// disagree, or it is counted in one of the next two.
    pub uncertain: u64,
    /// Faces without a nearby face, or with an unlabelled nearest face, labelled by their neighbours.
    pub filled: u64,
    /// Faces of islands, relabelled by their surroundings.
    pub islands: u64,
    /// Number of query points per face.
    pub points: usize,
    /// Whether normals point in the opposite direction.
    pub opposite_normals: bool,
}

impl TransferCounts {
    /// The note about a transfer to the mesh in the file `path` whose labels are mostly uncertain.
    pub fn note(&self, path: &Path) -> Option<String> {
        let share = 100. * self.uncertain as f64 / self.faces.max(1) as f64;
        let doubt = "are both meshes in the same position and units?";
        let text = || format!("{}: the labels of {share:.0} % of the faces are uncertain; {doubt}", path.display());
        (share > 50.).then(text)
    }
}

/// The mean edge of `opened`'s triangles in `frame`, as if they were equilateral.
fn mean_edge(opened: &Mesh, frame: &UnitFrame, run: &Run) -> Result<f32> {
    let n = opened.faces.len();
    let (mut area, mut count) = (0f64, 0u64);
    for start in (0..n).step_by(1 << 18) {
        run.cancel.check()?;
        frame.triangles(opened, start..n.min(start + (1 << 18)), |_, triangle| {
            area += crate::base::vector::length(normal(&triangle)) / 2.;
            count += 1;
        });
    }
    Ok((area / count.max(1) as f64 * 4. / 3f64.sqrt()).sqrt() as f32)
}

/// The query points of `face`: the mean of the centroids of its triangles, then the points half-way from there to the
/// corners of its first triangle.
fn probe(opened: &Mesh, frame: &UnitFrame, face: usize, point: usize) -> Probe {
    let (mut sum, mut mean, mut count, mut first) = ([0f64; 3], [0f32; 3], 0f32, [[0f32; 3]; 3]);
    frame.triangles(opened, face..face + 1, |_, triangle| {
        let own = normal(&triangle);
        (0..3).for_each(|k| sum[k] += own[k]);
        (0..3).for_each(|k| mean[k] += (triangle[0][k] + triangle[1][k] + triangle[2][k]) / 3.);
        if count == 0. {
            first = triangle;
        }
        count += 1.;
    });
    if count == 0. {
        return Probe { place: [f32::NAN; 3], normal: [0.; 3] };
    }
    let centroid = mean.map(|x| x / count);
    let place = match point {
        0 => centroid,
        k => [0, 1, 2].map(|axis| (centroid[axis] + first[(k - 1) % 3][axis]) / 2.),
    };
    Probe { place, normal: unit(sum) }
}

/// Whether the normals of `to` are mostly opposite to those of `from`.
fn has_opposite_normals(from: &Mesh, to: &Mesh, frame: &UnitFrame) -> bool {
    let (m, n) = (from.faces.len(), to.faces.len());
    let trial = (0..m).step_by(m.div_ceil(TRIAL)).map(|face| face..face + 1);
    let tree = TriangleTree::of(from, frame, trial);
    let mut sum = 0.;
    for face in (0..n).step_by(n.div_ceil(TRIAL / 10)) {
        let own = probe(to, frame, face, 0);
        if own.place[0].is_finite()
            && let Some(other) = tree.normal_near(own.place)
        {
            sum += (0..3).map(|k| f64::from(own.normal[k] * other[k])).sum::<f64>();
        }
    }
    sum < 0.
}

/// Transfers `labels` of the faces of `from` ([`UNLABELLED`]: none) to those of `to`; arrays are stored in `work`.
///
/// ```
/// use nystrom_stream::apps::creature::{Creature, Options};
/// use nystrom_stream::apps::transfer::transfer;
/// use nystrom_stream::mesh;
/// use nystrom_stream::store::{Context, Run, WorkDir};
/// let (work, run) = (WorkDir::temporary(&std::env::temp_dir())?, Run::new(&()));
/// let mut truth = Vec::new();
/// for faces in [4_000, 6_000] {
///     let creature = Creature::new(&Options { faces, ..Options::default() })?;
///     creature.write_ply(&work.file(&format!("{faces}.ply")), &run)?;
///     truth.push((0..creature.face_count()).map(|face| creature.truth(face)).collect::<Vec<u32>>());
/// }
/// let [from, to] = ["4000.ply", "6000.ply"].map(|name| mesh::open(&work.file(name), work.path(), &run));
/// let carried = transfer(&from?, &truth[0], &to?, Context::new(&work, &run))?;
/// let right = carried.labels.iter().zip(&truth[1]).filter(|(a, b)| a == b).count();
/// assert!(right as f64 > 0.98 * truth[1].len() as f64);
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
///
/// # Errors
/// [`Error::Parameter`] for labels that do not match `from`, or if no face has one; [`Error::Unusable`] if most of `to`
/// lies far from `from`; [`Error::Memory`], [`Error::Io`], [`Error::Cancelled`].
pub fn transfer(from: &Mesh, labels: &[u32], to: &Mesh, context: Context<'_>) -> Result<Transferred> {
    Labelling::of(labels).fit(from.faces.len())?;
    if labels.iter().all(|&label| label == UNLABELLED) {
        return Err(Error::parameter("labels", "no face has a label", "label some first"));
    }
    let (m, n) = (from.faces.len(), to.faces.len());
    let (from, to) = (&from.without_strays(context.run)?, &to.without_strays(context.run)?);
    let frame = UnitFrame::of(from, context.run)?;
    let (fine, coarse) = (mean_edge(from, &frame, context.run)?, mean_edge(to, &frame, context.run)?);
    let points = if coarse > 1.5 * fine { 4 } else { 1 };
    let opposite_normals = has_opposite_normals(from, to, &frame);
    let sign = if opposite_normals { -1. } else { 1. };
    let far = FAR * fine.max(coarse);

    let mut array = context.work.array::<u64>("nearest.npy", &[n * points, 2])?;
    let found: &mut [Closest] = bytemuck::cast_slice_mut(&mut array.data()[..]);
    found.fill([u64::MAX; 2]);
    // Triangles per face, so that polygons have room too.
    let triangles = (from.faces.corner_count() as u64).div_ceil(m.max(1) as u64).saturating_sub(2).max(1);
    let grant = context.run.budget.take(
        "nearest faces",
        BYTES * triangles * m.min(1 << 12) as u64,
        BYTES * triangles * m as u64,
    )?;
    let block = (grant.bytes() / (BYTES * triangles)).max(1) as usize;
    let look = || {
        for start in (0..m).step_by(block) {
            let tree = TriangleTree::of(from, &frame, std::iter::once(start..m.min(start + block)));
            let at = |i: usize| probe(to, &frame, i / points, i % points);
            tree.improve_all(at, Agreement { sign, slack: fine, far }, found, context.run)?;
        }
        Ok(())
    };
    context.run.stage("nearest faces", "faces", n as u64, look)?;
    drop(grant);

    let found: &[Closest] = found;
    let mut own = context.work.array::<u32>("transferred_labels.npy", &[n])?;
    let mut quality = context.work.array::<f32>("transferred_quality.npy", &[n])?;
    let choose = |k: usize, own: &mut [u32], quality: &mut [f32], (): &mut ()| {
        for i in 0..own.len() {
            let face = k * CHUNK + i;
            let found = &found[face * points..(face + 1) * points];
            (own[i], quality[i]) = majority_label(found, labels, fine, fine.max(coarse));
        }
        Ok(())
    };
    context.run.fill_two((own.data(), quality.data()), CHUNK, || (), choose)?;

    let is_near = |found: &Closest| unpack(found[0]).is_some_and(|(distance, _)| distance.sqrt() <= far);
    let near = found.chunks_exact(points).filter(|found| found.iter().any(is_near)).count();
    let (path, other) = (to.path(), from.path().display());
    if near * 2 < n {
        let problem = format!("only {near} of {n} faces are close to {other}");
        return Err(Error::unusable(path, problem, "both meshes must have the same position and units"));
    }
    if own.data().iter().all(|&label| label == UNLABELLED) {
        let problem = format!("no face is close to a labelled face of {other}");
        return Err(Error::unusable(path, problem, "label more faces there"));
    }
    let graph = DualGraph::build(to, to.path(), &json!("transfer"), context)?;
    let filled = label_from_neighbours(&graph, own.data(), context.run)?;
    let least = ((n as f64 * ISLAND) as usize).max(4);
    let islands = unlabel_islands(&graph, own.data(), quality.data(), least, context)?;
    for (label, quality) in own.data().iter().zip(quality.data().iter_mut()) {
        *quality = if *label == UNLABELLED { 0. } else { *quality };
    }
    label_from_neighbours(&graph, own.data(), context.run)?;
    let uncertain = quality.data().iter().filter(|&&quality| quality < 1.).count() as u64;
    let facts = TransferCounts { faces: n as u64, uncertain, filled, islands, points, opposite_normals };
    Ok(Transferred { labels: own.finish(false)?, quality: quality.finish(false)?, facts })
}

/// The label of a face given the results of its points, and its confidence; `slack` and `edge` are edge lengths of the
/// first mesh and of the coarser one.
fn majority_label(found: &[Closest], labels: &[u32], slack: f32, edge: f32) -> (u32, f32) {
    let mut votes = [(UNLABELLED, 0f32, 0f32); 4];
    for (found, vote) in found.iter().zip(&mut votes) {
        let Some((nearest, any)) = unpack(found[0]) else { continue };
        let agreeing = unpack(found[1]).filter(|(d, _)| d.sqrt() <= window(nearest.sqrt(), slack));
        let (distance, face) = agreeing.unwrap_or((nearest, any));
        if distance.sqrt() <= FAR * edge {
            let sure = if agreeing.is_some() && distance.sqrt() <= edge { 1. } else { 0.5 };
            *vote = (labels[face as usize], 1., sure);
        }
    }
    let votes = &votes[..found.len()];
    let tally = |label: u32| votes.iter().filter(|vote| vote.0 == label).fold((0., 0.), |a, v| (a.0 + v.1, a.1 + v.2));
    // The first of several: that of the middle, if it is one of them.
    let mut best = (UNLABELLED, (0., 0.));
    for &(label, ..) in votes.iter().filter(|vote| vote.0 != UNLABELLED) {
        let own = tally(label);
        if own.0 > best.1.0 {
            best = (label, own);
        }
    }
    (best.0, best.1.1 / found.len() as f32)
}

/// Faces between two checks of the stop flag.
const STOP_CHECK: usize = 1 << 18;
/// Marks a component with an uncertain face; a mesh has fewer faces than this bit.
const UNCERTAIN: u32 = 1 << 31;

/// The label with the longest contact among the neighbours of `face`; the smallest of several. `contacts` is scratch.
fn neighbour(graph: &DualGraph, labels: &[u32], face: u32, contacts: &mut Vec<(u32, f32)>) -> Option<u32> {
    contacts.clear();
    let neighbours = graph.edges.by_shared_edge().neighbours(face);
    let contact = neighbours.map(|(near, edge)| (labels[near as usize], edge.abs()));
    contacts.extend(contact.filter(|(label, _)| *label != UNLABELLED));
    // Stable, so that sums run in the order of the neighbours.
    sort_by(contacts, |a, b| a.0.cmp(&b.0));
    let mut best: Option<(f32, u32)> = None;
    for alike in contacts.chunk_by(|a, b| a.0 == b.0) {
        let contact: f32 = alike.iter().map(|(_, edge)| edge).sum();
        if best.is_none_or(|(most, _)| contact > most) {
            best = Some((contact, alike[0].0));
        }
    }
    best.map(|(_, label)| label)
}

/// Gives every face a label, ring by ring; returns the number of faces that had none.
///
/// # Errors
/// [`Error::Memory`] if the budget cannot hold the list of those; [`Error::Cancelled`].
fn label_from_neighbours(graph: &DualGraph, labels: &mut [u32], run: &Run) -> Result<u64> {
    let count = labels.iter().filter(|&&label| label == UNLABELLED).count();
    let _grant = run.budget.take("faces without label", 24 * count as u64, 24 * count as u64)?;
    // Faces that may now have a labelled neighbour.
    let mut open: Vec<u32> = Vec::with_capacity(count);
    open.extend((0..labels.len() as u32).filter(|&face| labels[face as usize] == UNLABELLED));
    let (mut ring, mut contacts) = (Vec::new(), Vec::new());
    while !open.is_empty() {
        ring.clear();
        for some in open.chunks(STOP_CHECK) {
            run.cancel.check()?;
            let given = |&face: &u32| neighbour(graph, labels, face, &mut contacts).map(|label| (face, label));
            ring.extend(some.iter().filter_map(given));
        }
        ring.iter().for_each(|&(face, label)| labels[face as usize] = label);
        open.clear();
        for &(face, _) in &ring {
            let next = graph.edges.by_shared_edge().neighbours(face).map(|(near, _)| near);
            open.extend(next.filter(|&near| labels[near as usize] == UNLABELLED));
        }
        open.sort_unstable();
        open.dedup();
    }
    Ok(count as u64)
}

/// The number of faces of each label.
#[derive(Default)]
struct LabelSizes {
    faces: BTreeMap<u32, u64>,
    grants: Vec<Grant>,
}

impl LabelSizes {
    /// Labels whose memory is taken from the budget at a time.
    const BLOCK: usize = 1 << 12;
    /// Bytes per label: a node of the map has room for 11 and may be half empty.
    const BYTES: u64 = 40;

    /// Counts a face with `label`.
    ///
    /// # Errors
    /// [`Error::Memory`] for more labels than there is room for.
    fn count(&mut self, label: u32, run: &Run) -> Result<()> {
        *self.faces.entry(label).or_default() += 1;
        if self.faces.len() > self.grants.len() * Self::BLOCK {
            let bytes = Self::BYTES * Self::BLOCK as u64;
            self.grants.push(run.budget.take_or("so many labels", bytes, "give fewer faces labels of their own")?);
        }
        Ok(())
    }
}

/// Removes the label from every connected piece of fewer than `least` faces with at least one uncertain face (`quality`
/// below 1), unless it is all there is of the label; returns the number of faces.
///
/// # Errors
/// [`Error::Memory`] for more labels than there is room for; [`Error::Io`], [`Error::Cancelled`].
fn unlabel_islands(
    graph: &DualGraph,
    labels: &mut [u32],
    quality: &[f32],
    least: usize,
    context: Context<'_>,
) -> Result<u64> {
    let n = labels.len();
    let mut parents = context.work.array::<u32>("pieces.npy", &[n])?;
    let mut sizes = context.work.array::<u32>("piece_sizes.npy", &[n])?;
    let mut pieces = Forest::over(&mut parents.data()[..]);
    let (size, shared) = (&mut sizes.data()[..], graph.edges.by_shared_edge());
    let mut all = LabelSizes::default();
    for i in 0..n {
        if i % STOP_CHECK == 0 {
            context.run.cancel.check()?;
        }
        all.count(labels[i], context.run)?;
        for (j, _) in shared.neighbours(i as u32).take_while(|(j, _)| (*j as usize) < i) {
            if labels[j as usize] == labels[i] {
                pieces.join(i as u32, j);
            }
        }
    }
    for i in 0..n {
        if i % STOP_CHECK == 0 {
            context.run.cancel.check()?;
        }
        let root = pieces.find(i as u32) as usize;
        let mark = if quality[i] < 1. { UNCERTAIN } else { 0 };
        size[root] = (size[root] + 1) | mark;
    }
    let mut taken = 0;
    for i in 0..n {
        if i % STOP_CHECK == 0 {
            context.run.cancel.check()?;
        }
        let size = size[pieces.find(i as u32) as usize];
        let count = size & !UNCERTAIN;
        if size != count && (count as usize) < least && u64::from(count) < all.faces[&labels[i]] {
            taken += 1;
            labels[i] = UNLABELLED;
        }
    }
    Ok(taken)
}
