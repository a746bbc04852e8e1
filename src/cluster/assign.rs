//! Labels for every face in one pass over `[A B]`: extrapolate, assign, count.
//!
//! Chunks of columns are independent; each thread embeds a chunk from its distances and takes the nearest
//! centre. Γ's sum rides along. Cost: 4 l bytes read a face, l exponentials; 10–20 ns a face and thread at
//! l = 10. Then [`exactly`] sees to it that no part is empty.

use super::kmeans::{KMeans, nearest_centres};
use crate::base::Result;
use crate::base::parallel::{chunk_range, fill_chunks};
use crate::distance::DistanceRows;
use crate::graph::Node;
use crate::spectral::Embedding;
use crate::spectral::quality::Gamma;
use crate::store::Run;
use bytemuck::{Pod, Zeroable};

/// Faces a chunk: what fits the cache at l = 60. Results do not depend on it but for Γ's last digits.
pub const CHUNK: usize = 2048;

/// A face's label and how sure it is: 0 on the border between two centres, 1 on a centre.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Assigned {
    /// Cluster.
    pub label: u32,
    /// 1 − distance to its centre / distance to the next.
    pub quality: f32,
}

/// Totals of the pass.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Totals {
    /// Faces a cluster.
    pub faces: Vec<u64>,
    /// Area a cluster, in the frame.
    pub area: Vec<f64>,
    /// Γ's sum over all columns.
    pub gamma: f64,
}

/// Labels every face; `out` (n). `parts` clusters.
///
/// # Errors
/// [`crate::base::Error::Cancelled`].
pub fn assign(
    rows: &DistanceRows,
    nodes: &[Node],
    embedding: &Embedding,
    centres: &KMeans,
    gamma: Option<&Gamma>,
    out: &mut [Assigned],
    run: &Run,
) -> Result<Totals> {
    let parts = centres.centres.len() / centres.dimensions.max(1);
    let n = rows.nodes;
    let d = embedding.dimensions;
    struct Scratch {
        affinities: Vec<f32>,
        coordinates: Vec<f32>,
        label: Vec<u32>,
        first: Vec<f32>,
        second: Vec<f32>,
    }
    let scratch = || Scratch {
        affinities: vec![0.; CHUNK],
        coordinates: vec![0.; CHUNK * d],
        label: vec![0; CHUNK],
        first: vec![0.; CHUNK],
        second: vec![0.; CHUNK],
    };
    let chunks = fill_chunks(run.threads, &run.cancel, out, CHUNK, scratch, |k, out, s| {
        let m = out.len();
        let range = chunk_range(n, CHUNK, k);
        let distances = |row: usize| &rows.row(row)[range.clone()];
        embedding.chunk(m, distances, &mut s.affinities[..m], &mut s.coordinates[..m * d]);
        let coordinates = &s.coordinates;
        let row = |e: usize| &coordinates[e * m..(e + 1) * m];
        nearest_centres(m, &centres.centres, d, row, &mut s.label[..m], &mut s.first[..m], &mut s.second[..m]);
        let (mut faces, mut area) = (vec![0u64; parts], vec![0f64; parts]);
        for (i, out) in out.iter_mut().enumerate() {
            let (first, second) = (s.first[i].sqrt(), s.second[i].sqrt());
            let quality = if second > 0. && second.is_finite() { 1. - first / second } else { 1. };
            *out = Assigned { label: s.label[i], quality: quality.clamp(0., 1.) };
            faces[s.label[i] as usize] += 1;
            area[s.label[i] as usize] += f64::from(nodes[range.start + i].area);
        }
        run.progress.advance("assign", m as u64);
        Ok((faces, area, gamma.map_or(0., |gamma| gamma.chunk(m, distances))))
    })?;
    let mut totals = Totals { faces: vec![0; parts], area: vec![0.; parts], gamma: 0. };
    for (faces, area, gamma) in chunks {
        totals.faces.iter_mut().zip(&faces).for_each(|(a, b)| *a += b);
        totals.area.iter_mut().zip(&area).for_each(|(a, b)| *a += b);
        totals.gamma += gamma;
    }
    Ok(totals)
}

/// Makes every part non-empty: while one has no face, it gets the least sure face of the part with most
/// faces. Needed only where the embedding has fewer distinct points than parts (a cube, four
/// faces in four parts); needs at least as many faces as parts.
pub fn exactly(totals: &mut Totals, nodes: &[Node], out: &mut [Assigned]) {
    while let Some(empty) = totals.faces.iter().position(|&faces| faces == 0) {
        let mut most = 0;
        for part in 1..totals.faces.len() {
            if totals.faces[part] > totals.faces[most] {
                most = part;
            }
        }
        let mut worst: Option<usize> = None;
        for (face, a) in out.iter().enumerate() {
            if a.label as usize == most && worst.is_none_or(|w| a.quality < out[w].quality) {
                worst = Some(face);
            }
        }
        let Some(face) = worst.filter(|_| totals.faces[most] > 1) else { return };
        let area = f64::from(nodes[face].area);
        out[face].label = empty as u32;
        totals.faces[most] -= 1;
        totals.area[most] -= area;
        totals.faces[empty] += 1;
        totals.area[empty] += area;
    }
}
