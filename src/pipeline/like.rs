//! Transfers the parts of a labelled mesh to others of its kind: another scan, another pose.
//!
//! If both meshes occupy the same position in space, each face takes the label of the nearest face of the reference
//! ([`crate::apps::transfer`]). Otherwise vertices are matched by their spectral embeddings ([`super::correspond`]).
//! The transferred labels are hints for every face ([`super::edits::Corrections::painted`]): the decision takes the
//! most frequent label of each cell, so single wrong matches do not matter, and boundaries are refined on the new mesh.
//! Cost: that of the transfer or the matching, and one pass over the faces.

use super::correspond::{CorrespondParams, correspond, default_landmarks_for_vertices};
use super::labels::{self, LABELS, SegmentedMesh};
use super::params::BYTES_PER_PART;
use crate::apps::correspond::Match;
use crate::apps::transfer::transfer;
use crate::base::tally::{add_weight, tally};
use crate::base::{Error, Result};
use crate::mesh::ply::labelled::{GREY, colour_of};
use crate::mesh::{Mesh, UNLABELLED};
use crate::store::npy::ArrayMut;
use crate::store::{Context, MappedSlice, WorkDir};
use serde::Serialize;

/// Maximum share of uncertain faces for two meshes to count as being in the same position.
const SAME_PLACE: f64 = 0.05;
/// Confidence below which a person should check the result, if meshes are in the same position, and if vertices are
/// matched.
const LEAST_CONFIDENCE: [f64; 2] = [0.95, 0.6];
const CHUNK: usize = 1 << 16;

/// A mesh with the parts to transfer.
#[derive(Clone, Copy, Debug)]
pub struct Reference<'a> {
    /// The reference mesh.
    pub mesh: &'a Mesh,
    /// Part of each face (n); [`UNLABELLED`]: none.
    pub labels: &'a [u32],
    /// Colour of each part.
    pub colours: &'a [[u8; 3]],
    /// Name of each part, or none.
    pub names: &'a [String],
}

impl Reference<'_> {
    /// The number of parts: the greatest label plus one.
    fn parts(&self) -> usize {
        let labelled = self.labels.iter().filter(|label| **label != UNLABELLED);
        self.colours.len().max(labelled.map(|label| *label as usize + 1).max().unwrap_or(0))
    }
}

/// How labels were transferred.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum TransferMethod {
    /// From the nearest face: both meshes are in the same position.
    Position,
    /// By matching vertices.
    Shape,
}

/// Labels transferred to a mesh.
#[derive(Clone, Debug)]
pub struct Transferred {
    /// The part of each face plus one (n); 0 if unknown.
    pub values: MappedSlice<u32>,
    /// The quality of the transfer.
    pub facts: LikeFacts,
}

/// The quality of a transfer of labels.
#[derive(Clone, Debug, Serialize)]
pub struct LikeFacts {
    /// The method.
    pub method: TransferMethod,
    /// Confidence, 0 to 1: the share of certain faces, or the mean confidence of the matches.
    pub confidence: f64,
    /// Whether the shape is symmetric, so that parts may be mirrored.
    pub ambiguous: bool,
    /// Parts of the reference that are missing on the mesh.
    pub missing: Vec<u32>,
    /// Whether a person should check the result.
    pub needs_check: bool,
}

/// Temporary file of the transferred values; removed with its last reader.
const VALUES: &str = "transferred.tmp";

/// Transfers the labels of `reference` to `mesh`. Arrays are stored in the folder of `context`, or in a temporary one
/// within.
///
/// # Errors
/// [`Error::Parameter`] for labels that do not match the reference; [`Error::Memory`] if its greatest label is so high
/// that there is no room for as many parts; those of [`transfer`] and [`correspond`].
pub fn transfer_labels(reference: Reference<'_>, mesh: &Mesh, context: Context<'_>) -> Result<Transferred> {
    let parts = BYTES_PER_PART * reference.parts() as u64;
    context.run.budget.take("parts with all numbers up to the reference's greatest label", parts, parts)?;
    let work = WorkDir::temporary(context.work.path())?;
    let within = Context::new(&work, context.run);
    match transfer(reference.mesh, reference.labels, mesh, within) {
        Ok(found) => {
            let uncertain = found.facts.uncertain as f64 / found.facts.faces.max(1) as f64;
            if uncertain <= SAME_PLACE {
                let mut values = context.work.array::<u32>(VALUES, &[found.labels.len()])?;
                context.run.fill_each(values.data(), CHUNK, |face, _| found.labels[face].wrapping_add(1))?;
                return transferred(values, TransferMethod::Position, 1. - uncertain, false, context.work);
            }
        }
        // The meshes are not in the same position.
        Err(Error::Unusable { .. }) => {}
        Err(error) => return Err(error),
    }
    by_shape(reference, mesh, within, context.work)
}

fn transferred(
    values: ArrayMut<u32>,
    method: TransferMethod,
    confidence: f64,
    ambiguous: bool,
    work: &WorkDir,
) -> Result<Transferred> {
    let values = values.finish(false)?;
    work.remove(VALUES);
    Ok(Transferred {
        values,
        facts: LikeFacts { method, confidence, ambiguous, missing: Vec::new(), needs_check: false },
    })
}

/// By matching the vertices of `mesh` with those of the reference. The transferred values are stored in `work`.
fn by_shape(reference: Reference<'_>, mesh: &Mesh, context: Context<'_>, work: &WorkDir) -> Result<Transferred> {
    let most = mesh.positions.len().max(reference.mesh.positions.len());
    let params = CorrespondParams::default().landmarks(default_landmarks_for_vertices(most));
    let found = correspond(mesh, reference.mesh, None, &params, context)?;
    let mut of_vertex = context.work.array::<u32>("of_vertex.tmp", &[reference.mesh.positions.len()])?;
    let of_vertex = of_vertex.data();
    for start in (0..reference.labels.len()).step_by(CHUNK) {
        context.run.cancel.check()?;
        reference.mesh.faces.for_each(start..reference.labels.len().min(start + CHUNK), |face, corners| {
            for &v in corners {
                let value = &mut of_vertex[v as usize];
                if *value == 0 {
                    *value = reference.labels[face].wrapping_add(1);
                }
            }
        });
    }
    let mut array = work.array::<u32>(VALUES, &[mesh.faces.len()])?;
    let values = array.data();
    let matches: &[Match] = &found.matches;
    let mut votes: Vec<(u32, f32)> = Vec::new();
    for start in (0..values.len()).step_by(CHUNK) {
        context.run.cancel.check()?;
        mesh.faces.for_each(start..values.len().min(start + CHUNK), |face, corners| {
            votes.clear();
            for one in corners.iter().map(|&v| &matches[v as usize]) {
                let value = one.vertex().map_or(0, |v| of_vertex[v as usize]);
                add_weight(&mut votes, value, one.confidence);
            }
            let known = votes.iter().filter(|vote| vote.0 > 0);
            let best = known.fold((0, -1.), |best, &vote| if vote.1 > best.1 { vote } else { best });
            values[face] = best.0;
        });
    }
    let matched = || matches.iter().filter(|one| one.vertex().is_some());
    let confidence = matched().map(|one| f64::from(one.confidence)).sum::<f64>() / matched().count().max(1) as f64;
    transferred(array, TransferMethod::Shape, confidence, found.alignments.ambiguous, work)
}

/// Gives the parts of `result`, which was cut with the hints in `transferred`, the numbers, colours and names of the
/// reference, and records them in the work directory.
///
/// # Errors
/// [`Error::Io`], [`Error::Cancelled`].
pub fn apply_reference_numbering(
    mut result: SegmentedMesh,
    transferred: &mut Transferred,
    reference: Reference<'_>,
    context: Context<'_>,
) -> Result<SegmentedMesh> {
    let counts = tally(result.labels.iter().copied().zip(transferred.values.iter().copied()));
    let parts = reference.parts();
    // Tiny components and walls with a label of their own do not correspond to reference parts, whatever was
    // transferred to them.
    let own = [result.numbers.walls_label, result.numbers.tiny_components_label];
    // Parts to which nothing was transferred get new numbers.
    let mut of_label = vec![(0u64, parts as u32); result.colours.len()];
    for ((label, value), count) in counts {
        if value > 0
            && !own.contains(&Some(label))
            && let Some(best) = of_label.get_mut(label as usize).filter(|best| count > best.0)
        {
            *best = (count, value - 1);
        }
    }
    let mut number: Vec<u32> = of_label.iter().map(|best| best.1).collect();
    let is_unknown = |(label, &number): (u32, &u32)| number as usize == parts && !own.contains(&Some(label));
    let some_unknown = (0..).zip(&number).any(is_unknown);
    let mut all = parts + usize::from(some_unknown);
    for label in own.into_iter().flatten() {
        number[label as usize] = all as u32;
        all += 1;
    }
    let before = labels::begin(context.work)?;
    let mut labels = context.work.array::<u32>(LABELS, &[result.labels.len()])?;
    let old: &MappedSlice<u32> = &result.labels;
    context.run.fill_each(labels.data(), CHUNK, |i, _| number[old[i] as usize])?;
    let labels = labels.finish(false)?;
    let (mut faces, mut area) = (vec![0; all], vec![0.; all]);
    for (old, &new) in number.iter().enumerate() {
        faces[new as usize] += result.numbers.faces.get(old).copied().unwrap_or(0);
        area[new as usize] += result.numbers.area.get(old).copied().unwrap_or(0.);
    }
    let facts = &mut transferred.facts;
    // Numbers that the reference does not use are not parts.
    let mut known = vec![false; parts];
    let labelled = reference.labels.iter().filter(|label| **label != UNLABELLED);
    labelled.for_each(|&label| known[label as usize] = true);
    facts.missing = (0..parts as u32).filter(|&part| known[part as usize] && faces[part as usize] == 0).collect();
    let least = LEAST_CONFIDENCE[usize::from(facts.method == TransferMethod::Shape)];
    facts.needs_check = facts.confidence < least || facts.ambiguous || !facts.missing.is_empty() || some_unknown;
    let fine = result.fine.map(|(fine, key)| {
        let fine = labels::renumber_fine(fine, &number, &labels, context.work)?;
        Ok((fine, key))
    });
    result.fine = fine.transpose()?;
    result.labels = labels;
    result.colours = (0..parts as u32).map(|part| colour_of(reference.colours, part)).collect();
    result.colours.resize(all, GREY);
    result.names = reference.names.to_vec();
    result.cell_labels = result.cell_labels.iter().map(|&label| number[label as usize]).collect();
    let now = |label: Option<u32>| label.and_then(|label| number.get(label as usize).copied());
    result.numbers.tiny_components_label = now(result.numbers.tiny_components_label);
    result.numbers.walls_label = now(result.numbers.walls_label);
    (result.numbers.faces, result.numbers.area) = (faces, area);
    // The work directory keeps what was written.
    labels::keep_as(before, &result, context.work)?;
    Ok(result)
}
