//! The default method on a mesh of any kind of triangles: if they are long, parts are decided on its refinement, and
//! each face gets the label that has most of its area.
//!
//! Cost: that of [`parts`], on the mesh or on the refined one, which has at most 240,000 faces.

use super::labels::{self, Clustered, LABELS, QUALITY, SegmentStats};
use super::params::SegmentParams;
use super::parts::{self, PartRequests};
use super::refinement::Refinement;
use super::surface::is_tiny;
use crate::base::{Error, Result};
use crate::cluster::divide::divide;
use crate::cluster::part_totals::PartTotals;
use crate::graph::{DualGraph, NodeOrder};
use crate::store::{Context, WorkDir};
use std::collections::BTreeSet;
use std::ops::Range;

/// Cuts the mesh of `graph`, whose nodes are in `order`.
pub(super) fn parts(
    graph: &DualGraph,
    order: &NodeOrder,
    params: &SegmentParams,
    requests: PartRequests<'_>,
    context: Context<'_>,
) -> Result<Clustered> {
    let nodes = requests.corrections.nodes(graph.nodes.len(), order, context.run)?;
    let refinement = if params.exact_rows() { None } else { Refinement::kept(graph, context.work)? };
    let clustered = match refinement {
        Some(refinement) => RefinedMesh { graph, order, refinement }.parts(&nodes, params, requests, context)?,
        None => parts::parts(graph, (order, &nodes), params, requests, context)?,
    };
    requests.corrections.tell_unmet(&nodes, order, &clustered.labels, context.run);
    Ok(clustered)
}

/// A mesh and its refinement.
struct RefinedMesh<'a> {
    graph: &'a DualGraph,
    order: &'a NodeOrder,
    refinement: Refinement,
}

impl RefinedMesh<'_> {
    /// The parts of the mesh, decided on its refinement; `nodes` are those at the places of each edit.
    fn parts(
        &self,
        nodes: &[Vec<u32>],
        params: &SegmentParams,
        requests: PartRequests<'_>,
        context: Context<'_>,
    ) -> Result<Clustered> {
        let fine = &self.refinement;
        params.check_memory(fine.len() as u64, context.run)?;
        let inner = Refinement::work(context.work)?;
        let within = Context::new(&inner, context.run);
        let graph = fine.graph(within)?;
        let order = fine.order(self.order, &inner)?;
        let central = |node: &u32| fine.central(fine.of_node(*node));
        let places: Vec<Vec<u32>> = nodes.iter().map(|nodes| nodes.iter().map(central).collect()).collect();
        let clustered = parts::parts(&graph, (&order, &places), params, requests, within)?;
        let clustered = self.on_faces(clustered, params, &inner, context)?;
        // Those of the refined mesh, which nobody reads.
        [LABELS, QUALITY].iter().for_each(|name| inner.remove(name));
        Ok(clustered)
    }

    /// Transfers what was decided in `inner` to the faces.
    fn on_faces(
        &self,
        refined: Clustered,
        params: &SegmentParams,
        inner: &WorkDir,
        context: Context<'_>,
    ) -> Result<Clustered> {
        let refined_parts = refined.numbers.faces.len();
        let wanted = params.parts.count.least() + usize::from(refined.numbers.tiny_components_label.is_some());
        let (label, number, kept) = self.most_of_faces(&refined.labels, refined_parts, wanted);
        let quality = self.confidences(&refined, &label);
        let label: Vec<u32> = label.iter().map(|&old| number[old as usize]).collect();
        let moved = |own: Option<u32>| own.map(|old| number[old as usize]);
        let mut numbers = SegmentStats {
            landmarks: self.landmarks(&refined.numbers.landmarks),
            tiny_faces: self.tiny_faces(refined.numbers.tiny_faces, inner)?,
            tiny_components_label: moved(refined.numbers.tiny_components_label),
            walls_label: moved(refined.numbers.walls_label),
            ..refined.numbers
        };
        let marks = if kept.len() < refined_parts { refined.marks.of_parts(&kept) } else { refined.marks };
        if let Some(decision) = &mut numbers.decision {
            let agreement = std::mem::take(&mut decision.expected_agreement);
            decision.expected_agreement = kept.iter().filter_map(|&old| agreement.get(old as usize).copied()).collect();
        }
        let mut cell_labels: Vec<u32> = refined.cell_labels.iter().map(|&old| number[old as usize]).collect();
        labels::begin(context.work)?;
        let mut labels = context.work.write(LABELS, &label, 1)?;
        let quality = context.work.write(QUALITY, &quality, 1)?;
        let own = numbers.tiny_components_label;
        let mut parts = kept.len();
        if parts < wanted {
            let weighted = self.graph.weighted(params.metric, context)?;
            let pieces = divide(weighted.csr(), &labels, wanted, own, LABELS, context)?;
            weighted.release(context.work)?;
            (labels, parts) = (pieces.labels, pieces.first.last().map_or(0, |end| *end as usize));
            if parts < wanted {
                let problem = "there are not enough faces for as many parts besides tiny components";
                return Err(Error::parameter(params.parts.count.option(), problem, "request fewer parts"));
            }
            numbers.tiny_components_label = own.map(|label| pieces.first[label as usize]);
            numbers.walls_label = numbers.walls_label.map(|label| pieces.first[label as usize]);
            cell_labels.clear();
            if let Some(decision) = &mut numbers.decision {
                decision.expected_agreement.clear();
            }
        }
        let mut totals = PartTotals::new(parts);
        for (node, &part) in labels.iter().enumerate() {
            totals.faces[part as usize] += 1;
            totals.area[part as usize] += f64::from(self.graph.nodes.at(node).area);
        }
        let numbers = SegmentStats { faces: totals.faces, area: totals.area, ..numbers };
        Ok(Clustered { labels, boundary_nodes: None, quality, numbers, marks, cell_labels })
    }

    /// For each node the one of `parts` labels with most of its area; the new number of each label, and the labels that
    /// nodes have. A label that has most of no node joins the one of the node with most of its area; if there would be
    /// fewer than `wanted`, it gets that node, or the next one that is not the last of its label.
    fn most_of_faces(&self, labels: &[u32], parts: usize, wanted: usize) -> (Vec<u32>, Vec<u32>, Vec<u32>) {
        let fine = &self.refinement;
        let (mut of_node, mut sums, mut nodes) = (Vec::new(), vec![0.; parts], vec![0u64; parts]);
        // The area of labels in nodes that others have most of.
        let mut minor = Vec::new();
        for (node, own) in fine.of_nodes().enumerate() {
            let mut found: Vec<u32> = own.clone().map(|k| labels[k]).collect();
            self.weights(own.clone()).zip(own).for_each(|(weight, k)| sums[labels[k] as usize] += weight);
            found.sort_unstable();
            found.dedup();
            let most = found
                .iter()
                .fold(found[0], |most, &label| if sums[label as usize] > sums[most as usize] { label } else { most });
            nodes[most as usize] += 1;
            of_node.push(most);
            let others = found.iter().filter(|label| **label != most);
            minor.extend(others.map(|&label| (sums[label as usize], label, node)));
            found.iter().for_each(|&label| sums[label as usize] = 0.);
        }
        minor.retain(|(_, label, _)| nodes[*label as usize] == 0);
        minor.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut few = nodes.iter().filter(|nodes| **nodes > 0).count();
        for &(_, label, node) in &minor {
            let before = of_node[node];
            if few < wanted && nodes[label as usize] == 0 && nodes[before as usize] > 1 {
                (nodes[before as usize], nodes[label as usize]) = (nodes[before as usize] - 1, 1);
                of_node[node] = label;
                few += 1;
            }
        }
        let kept: Vec<u32> = (0..parts as u32).filter(|&label| nodes[label as usize] > 0).collect();
        let mut number = vec![0; parts];
        (0..).zip(&kept).for_each(|(new, &old)| number[old as usize] = new);
        for &(_, label, node) in minor.iter().rev().filter(|(_, label, _)| nodes[*label as usize] == 0) {
            number[label as usize] = number[of_node[node] as usize];
        }
        (of_node, number, kept)
    }

    /// The weight of each of the triangles `own` of a node: its area, or 1 if none has any.
    fn weights(&self, own: Range<usize>) -> impl Iterator<Item = f64> {
        let fine = &self.refinement;
        let none = own.clone().all(|k| fine.area(k) <= 0.);
        own.map(move |k| if none { 1. } else { fine.area(k) })
    }

    /// The mean confidence of each node where its triangles have its `label` (n); 0 if none has.
    fn confidences(&self, refined: &Clustered, label: &[u32]) -> Vec<f32> {
        let mean = |(own, label): (Range<usize>, &u32)| {
            let (mut sum, mut total) = (0., 0.);
            for (weight, k) in self.weights(own.clone()).zip(own).filter(|(_, k)| refined.labels[*k] == *label) {
                (sum, total) = (sum + weight * f64::from(refined.quality[k]), total + weight);
            }
            if total > 0. { (sum / total) as f32 } else { 0. }
        };
        self.refinement.of_nodes().zip(label).map(mean).collect()
    }

    /// The nodes that the triangles `landmarks` lie on, each once.
    fn landmarks(&self, landmarks: &[u32]) -> Vec<u32> {
        let mut known = BTreeSet::new();
        landmarks.iter().map(|&triangle| self.refinement.node(triangle)).filter(|&node| known.insert(node)).collect()
    }

    /// The number of nodes in tiny components, if that of refined ones is `triangles`.
    fn tiny_faces(&self, triangles: u64, inner: &WorkDir) -> Result<u64> {
        if triangles == 0 {
            return Ok(0);
        }
        let tiny = is_tiny(self.refinement.len(), inner)?;
        Ok(self.refinement.of_nodes().filter(|own| tiny(own.start)).count() as u64)
    }
}
