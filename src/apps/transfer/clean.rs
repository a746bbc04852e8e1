//! Faces without a label get their neighbours', ring by ring; islands that uncertain faces make lose theirs first.
//!
//! Over the dual graph of the mesh: two mapped arrays of 4 bytes a face, and the list of faces without label.

use crate::base::{Error, Result};
use crate::graph::DualGraph;
use crate::store::{Context, Run};
use std::collections::BTreeMap;

/// No label.
pub const NONE: u32 = u32::MAX;
/// Faces between two looks at the stop flag.
const CHUNK: usize = 1 << 18;
/// Marks a component with an uncertain face.
const UNCERTAIN: u32 = 1 << 31;

/// The label with the longest contact among the neighbours of `face`; the smallest of several.
fn neighbour(graph: &DualGraph, labels: &[u32], face: usize) -> Option<u32> {
    let rows = &graph.rows;
    let mut best: Option<(f32, u32)> = None;
    let range = rows.indptr[face] as usize..rows.indptr[face + 1] as usize;
    for e in range.clone() {
        let label = labels[rows.indices[e] as usize];
        if label == NONE {
            continue;
        }
        let alike = range.clone().filter(|&other| labels[rows.indices[other] as usize] == label);
        let contact: f32 = alike.map(|other| rows.edge[other].abs()).sum();
        if best.is_none_or(|(most, least)| contact > most || contact == most && label < least) {
            best = Some((contact, label));
        }
    }
    best.map(|(_, label)| label)
}

/// Gives every face a label; how many had none.
///
/// # Errors
/// [`Error::Memory`] where the budget cannot hold the list of those; [`Error::Cancelled`].
pub fn fill(graph: &DualGraph, labels: &mut [u32], run: &Run) -> Result<u64> {
    let count = labels.iter().filter(|&&label| label == NONE).count();
    let _grant = run.budget.take("faces without label", 12 * count as u64, 12 * count as u64)?;
    let mut open: Vec<u32> = Vec::with_capacity(count);
    open.extend((0..labels.len() as u32).filter(|&face| labels[face as usize] == NONE));
    let mut ring: Vec<(u32, u32)> = Vec::new();
    while !open.is_empty() {
        run.cancel.check()?;
        ring.clear();
        let given = |&face: &u32| neighbour(graph, labels, face as usize).map(|label| (face, label));
        ring.extend(open.iter().filter_map(given));
        if ring.is_empty() {
            // No face has a label.
            break;
        }
        ring.iter().for_each(|&(face, label)| labels[face as usize] = label);
        open.retain(|&face| labels[face as usize] == NONE);
    }
    Ok(count as u64)
}

fn root(parent: &mut [u32], mut face: u32) -> u32 {
    while parent[face as usize] != face {
        let up = parent[face as usize];
        parent[face as usize] = parent[up as usize];
        face = up;
    }
    face
}

/// Takes the label off every connected piece of fewer than `least` faces of which one is uncertain (`quality` below 1),
/// unless it is all there is of the label; how many faces that were.
///
/// # Errors
/// [`Error::Io`], [`Error::Cancelled`].
pub fn islands(
    graph: &DualGraph,
    labels: &mut [u32],
    quality: &[f32],
    least: usize,
    context: Context<'_>,
) -> Result<u64> {
    let n = labels.len();
    if n >= UNCERTAIN as usize {
        return Err(Error::unusable(context.work.path(), "more than 2^31 faces", "cut the mesh into several"));
    }
    let mut parents = context.work.array::<u32>("pieces.npy", &[n])?;
    let mut sizes = context.work.array::<u32>("piece_sizes.npy", &[n])?;
    let (parent, size) = (&mut parents.data()[..], &mut sizes.data()[..]);
    let rows = &graph.rows;
    let mut all: BTreeMap<u32, u64> = BTreeMap::new();
    for i in 0..n {
        if i % CHUNK == 0 {
            context.run.cancel.check()?;
        }
        parent[i] = i as u32;
        *all.entry(labels[i]).or_default() += 1;
        for e in rows.indptr[i] as usize..rows.indptr[i + 1] as usize {
            let j = rows.indices[e];
            if j as usize >= i {
                break;
            }
            if labels[j as usize] == labels[i] {
                let (a, b) = (root(parent, i as u32), root(parent, j));
                parent[a.max(b) as usize] = a.min(b);
            }
        }
    }
    for i in 0..n {
        let root = root(parent, i as u32) as usize;
        let mark = if quality[i] < 1. { UNCERTAIN } else { 0 };
        size[root] = (size[root] + 1) | mark;
    }
    let mut taken = 0;
    for i in 0..n {
        let size = size[root(parent, i as u32) as usize];
        let count = size & !UNCERTAIN;
        if size != count && (count as usize) < least && u64::from(count) < all[&labels[i]] {
            taken += 1;
            labels[i] |= NONE;
        }
    }
    Ok(taken)
}
