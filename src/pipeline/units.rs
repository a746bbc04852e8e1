//! From units of the surface to faces: transfers the labels and confidences of cells or contracted nodes to every face.
//!
//! Parts are decided on units; the narrow bands between them are relabelled afterwards ([`crate::cluster::boundary`]),
//! so areas have to be summed only where a face left the part of its unit. Cost: one pass over labels for each, 12
//! bytes per face.

use super::labels::QUALITY;
use crate::base::Result;
use crate::cluster::boundary::CellLabels;
use crate::cluster::part_totals::{PartTotals, block_size};
use crate::graph::DualGraph;
use crate::store::{Context, MappedSlice, Run};

const CHUNK: usize = 1 << 15;

/// Cells or contracted nodes, and their parts.
pub(super) struct Units {
    /// Unit of each node (n).
    pub of_node: MappedSlice<u16>,
    /// Label of each unit (u): its part, or a further piece of one.
    pub label: Vec<u32>,
    /// The part of each label beyond the parts: further pieces of parts that a person has joined.
    pub further: Vec<u32>,
    /// Whether each unit (u) has a neighbour of another label, if known.
    pub at_boundary: Option<Vec<bool>>,
    /// Area of the nodes in each unit (u), in the frame, if known.
    pub areas: Option<MappedSlice<f64>>,
    /// The confidence of each unit's label (u).
    pub confidence: Vec<f64>,
}

impl Units {
    /// The labels in the form that boundaries take.
    pub fn cells(&self) -> CellLabels<'_> {
        let at_boundary = self.at_boundary.as_deref();
        CellLabels { of_node: &self.of_node, label: &self.label, further: &self.further, at_boundary }
    }

    /// The confidence of each face's label: that of its unit. Writes `quality.npy`, without recording it.
    ///
    /// # Errors
    /// [`crate::base::Error::Io`], [`crate::base::Error::Cancelled`].
    pub fn confidences(&self, context: Context<'_>) -> Result<MappedSlice<f32>> {
        let mut quality = context.work.array::<f32>(QUALITY, &[self.of_node.len()])?;
        let of = |i: usize, _| self.confidence[self.of_node[i] as usize] as f32;
        context.run.fill_each(quality.data(), CHUNK, of)?;
        quality.finish(false)
    }

    /// Faces and area (in the frame) of each of `parts` parts under `labels` (n). If areas of units are known and
    /// `labels` differ from theirs only in the narrow bands (`near`), geometry is read only where boundaries have
    /// moved.
    ///
    /// # Errors
    /// [`crate::base::Error::Cancelled`].
    pub fn totals(&self, graph: &DualGraph, labels: &[u32], parts: usize, near: bool, run: &Run) -> Result<PartTotals> {
        let (n, part) = (labels.len(), self.cells().part_of_label());
        let areas = self.areas.as_deref().filter(|_| near);
        let blocks = run.map_ranges(n, block_size(n, CHUNK, parts), |range| {
            let mut sums = PartTotals::new(parts);
            for i in range {
                if i % CHUNK == 0 {
                    run.cancel.check()?;
                }
                let label = labels[i] as usize;
                sums.faces[label] += 1;
                let before = areas.map(|_| part[self.label[self.of_node[i] as usize] as usize] as usize);
                if before == Some(label) {
                    continue;
                }
                let area = f64::from(graph.nodes.at(i).area);
                sums.area[label] += area;
                if let Some(before) = before {
                    sums.area[before] -= area;
                }
            }
            Ok(sums)
        })?;
        let mut totals = PartTotals::new(parts);
        if let Some(areas) = areas {
            self.label.iter().zip(areas).for_each(|(&label, unit)| totals.area[part[label as usize] as usize] += unit);
        }
        blocks.iter().for_each(|block| totals.add(block));
        Ok(totals)
    }
}
