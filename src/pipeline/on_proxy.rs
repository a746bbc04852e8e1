//! The default method on a mesh of any kind: if it has a proxy, parts are decided on that, and each face gets the label
//! that has most of its area. The labels of a proxy's finer triangles are kept, for outputs whose faces are split.
//!
//! Cost: that of [`parts`], on the mesh or on the proxy, which has at most 240,000 faces.

use super::labels::{self, Clustered, LABELS, OnProxy, QUALITY, SegmentStats, touching};
use super::params::{SegmentParams, grant_parts};
use super::parts::{self, PartRequests};
use super::proxy::ProxyMesh;
use super::surface::is_tiny;
use crate::base::{Error, Result};
use crate::cluster::divide::divide;
use crate::cluster::part_totals::PartTotals;
use crate::graph::{DualGraph, NodeOrder};
use crate::store::{Context, WorkDir};
use std::collections::{BTreeMap, BTreeSet};
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
    let proxy = if params.exact_rows() { None } else { ProxyMesh::kept(graph, context.work)? };
    let clustered = match proxy {
        Some(proxy) => MeshAndProxy { graph, order, proxy }.parts(&nodes, params, requests, context)?,
        None => parts::parts(graph, (order, &nodes), params, requests, context)?,
    };
    requests.corrections.tell_unmet(&nodes, order, &clustered.labels, context.run);
    Ok(clustered)
}

/// The labels of nodes.
struct NodeLabels {
    /// The label of each node (n).
    of_node: Vec<u32>,
    /// Number of nodes of each label.
    nodes: Vec<u64>,
    /// The area of labels without a node, with the label and the node that it is in, the largest first.
    minor: Vec<(f64, u32, usize)>,
}

impl NodeLabels {
    /// Gives nodes to labels without one until `wanted` labels have some: the node with most of the label's area, or
    /// else the first of `largest`, that is not the last of its own label.
    fn reach(&mut self, wanted: usize, largest: impl FnOnce() -> Vec<usize>) {
        let mut few = self.nodes.iter().filter(|nodes| **nodes > 0).count();
        for (_, label, node) in self.minor.clone() {
            few += usize::from(few < wanted && self.give(node, label));
        }
        if few < wanted {
            let mut largest = largest().into_iter();
            // A node that is the last of its label stays so.
            let lost: Vec<u32> =
                (0..self.nodes.len() as u32).filter(|&label| self.nodes[label as usize] == 0).collect();
            for label in lost {
                few += usize::from(few < wanted && largest.any(|node| self.give(node, label)));
            }
        }
    }

    /// Gives `node` to `label` if that has none, and the node is not the last of its own.
    fn give(&mut self, node: usize, label: u32) -> bool {
        let before = self.of_node[node] as usize;
        let fits = self.nodes[label as usize] == 0 && self.nodes[before] > 1;
        if fits {
            (self.nodes[before], self.nodes[label as usize], self.of_node[node]) = (self.nodes[before] - 1, 1, label);
        }
        fits
    }

    /// The labels with nodes, and the new number of each label: one without nodes joins that of the node with most of
    /// its area.
    fn numbers(&self) -> (Vec<u32>, Vec<u32>) {
        let kept: Vec<u32> = (0..self.nodes.len() as u32).filter(|&label| self.nodes[label as usize] > 0).collect();
        let mut number = vec![0; self.nodes.len()];
        (0..).zip(&kept).for_each(|(new, &old)| number[old as usize] = new);
        for &(_, label, node) in self.minor.iter().rev().filter(|(_, label, _)| self.nodes[*label as usize] == 0) {
            number[label as usize] = number[self.of_node[node] as usize];
        }
        (kept, number)
    }
}

/// A mesh and its proxy.
struct MeshAndProxy<'a> {
    graph: &'a DualGraph,
    order: &'a NodeOrder,
    proxy: ProxyMesh,
}

impl MeshAndProxy<'_> {
    /// The parts of the mesh, decided on its proxy; `nodes` are those at the places of each edit.
    fn parts(
        &self,
        nodes: &[Vec<u32>],
        params: &SegmentParams,
        requests: PartRequests<'_>,
        context: Context<'_>,
    ) -> Result<Clustered> {
        let fine = &self.proxy;
        params.check_memory(fine.len() as u64, context.run)?;
        let inner = ProxyMesh::work(context.work)?;
        let within = Context::new(&inner, context.run);
        let graph = fine.graph(within)?;
        let order = fine.order(self.order, &inner)?;
        let central = |node: &u32| fine.central(fine.of_node(*node));
        let places: Vec<Vec<u32>> = nodes.iter().map(|nodes| nodes.iter().map(central).collect()).collect();
        let clustered = parts::parts(&graph, (&order, &places), params, requests, within)?;
        let clustered = self.on_faces(clustered, &graph, params, &inner, context)?;
        // Those of the proxy, which nobody reads.
        [LABELS, QUALITY].iter().for_each(|name| inner.remove(name));
        Ok(clustered)
    }

    /// Transfers what was decided in `inner` to the faces.
    fn on_faces(
        &self,
        decided: Clustered,
        graph: &DualGraph,
        params: &SegmentParams,
        inner: &WorkDir,
        context: Context<'_>,
    ) -> Result<Clustered> {
        let proxy_parts = decided.numbers.faces.len();
        let tiny = self.tiny_nodes(decided.numbers.tiny_faces, inner)?;
        let own = usize::from(decided.numbers.tiny_components_label.is_some());
        let wanted = params.parts.count.least() + own;
        let mut all = self.most_of_faces(&decided, &tiny);
        all.reach(wanted, || self.largest(&tiny));
        let (kept, number) = all.numbers();
        let quality = self.confidences(&decided, &all.of_node);
        let label: Vec<u32> = all.of_node.iter().map(|&old| number[old as usize]).collect();
        let fine = decided.labels.iter().map(|&old| number[old as usize]).collect();
        let mut on_proxy = self.on_finer(fine, &label, graph, context)?;
        let moved = |own: Option<u32>| own.map(|old| number[old as usize]);
        let mut numbers = SegmentStats {
            landmarks: self.landmarks(&decided.numbers.landmarks),
            tiny_faces: tiny.len() as u64,
            tiny_components_label: moved(decided.numbers.tiny_components_label),
            walls_label: moved(decided.numbers.walls_label),
            ..decided.numbers
        };
        let marks = if kept.len() < proxy_parts { decided.marks.of_parts(&kept) } else { decided.marks };
        if let Some(decision) = &mut numbers.decision {
            let agreement = std::mem::take(&mut decision.expected_agreement);
            decision.expected_agreement = kept.iter().filter_map(|&old| agreement.get(old as usize).copied()).collect();
        }
        let mut cell_labels: Vec<u32> = decided.cell_labels.iter().map(|&old| number[old as usize]).collect();
        labels::begin(context.work)?;
        let mut labels = context.work.write(LABELS, &label, 1)?;
        let quality = context.work.write(QUALITY, &quality, 1)?;
        let own = numbers.tiny_components_label;
        let mut parts = kept.len();
        if parts < wanted {
            let _grant = grant_parts(wanted, None, context.run)?;
            let weighted = self.graph.weighted(params.metric, context)?;
            let pieces = divide(weighted.csr(), &labels, wanted, own, LABELS, context)?;
            weighted.release(context.work)?;
            parts = pieces.count();
            labels = pieces.labels;
            if parts < wanted {
                let problem = "there are not enough faces for as many parts besides tiny components";
                return Err(Error::parameter(params.parts.count.option(), problem, "request fewer parts"));
            }
            numbers.tiny_components_label = own.map(|label| pieces.first[label as usize]);
            numbers.walls_label = numbers.walls_label.map(|label| pieces.first[label as usize]);
            cell_labels.clear();
            // Pieces are those of faces.
            on_proxy = None;
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
        Ok(Clustered { labels, boundary_nodes: None, quality, numbers, marks, cell_labels, on_proxy })
    }

    /// The parts on the proxy, if its triangles are finer than the faces; they have the labels `fine` (t) and nodes the
    /// `label` (n).
    fn on_finer(
        &self,
        mut fine: Vec<u32>,
        label: &[u32],
        graph: &DualGraph,
        context: Context<'_>,
    ) -> Result<Option<OnProxy>> {
        if !self.proxy.is_finer() {
            return Ok(None);
        }
        self.dissolve(&mut fine, label, graph);
        let pairs = touching(graph, &fine, None, context.run)?;
        Ok(Some(OnProxy { proxy: self.proxy.clone(), labels: fine, pairs }))
    }

    /// For each node the label with most of its area. Nodes in `tiny` components do not count, since they have no part
    /// of their own.
    fn most_of_faces(&self, decided: &Clustered, tiny: &BTreeSet<usize>) -> NodeLabels {
        let (labels, numbers) = (&decided.labels, &decided.numbers);
        let parts = numbers.faces.len();
        let mut all = NodeLabels { of_node: Vec::new(), nodes: vec![0; parts], minor: Vec::new() };
        if let Some(own) = numbers.tiny_components_label {
            all.nodes[own as usize] = tiny.len() as u64;
        }
        let mut sums = vec![0.; parts];
        for (node, own) in self.proxy.of_nodes().enumerate() {
            let mut found: Vec<u32> = own.clone().map(|k| labels[k]).collect();
            self.weights(own.clone()).zip(own).for_each(|(weight, k)| sums[labels[k] as usize] += weight);
            found.sort_unstable();
            found.dedup();
            let larger =
                |most: u32, &label: &u32| if sums[label as usize] > sums[most as usize] { label } else { most };
            let most = found.iter().fold(found[0], larger);
            all.of_node.push(most);
            if !tiny.contains(&node) {
                all.nodes[most as usize] += 1;
                let others = found.iter().filter(|label| **label != most);
                all.minor.extend(others.map(|&label| (sums[label as usize], label, node)));
            }
            found.iter().for_each(|&label| sums[label as usize] = 0.);
        }
        all.minor.retain(|(_, label, _)| all.nodes[*label as usize] == 0);
        all.minor.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        all
    }

    /// Gives each connected piece of `fine` labels (t) that has most of no node with that label (n) the one around it.
    fn dissolve(&self, fine: &mut [u32], label: &[u32], graph: &DualGraph) {
        let shared = graph.edges.shared();
        let mut seen = vec![false; fine.len()];
        for start in 0..fine.len() as u32 {
            if std::mem::replace(&mut seen[start as usize], true) {
                continue;
            }
            let own = fine[start as usize];
            let (mut piece, mut next, mut around) = (vec![start], 0, BTreeMap::new());
            while let Some(&k) = piece.get(next) {
                for (e, j) in shared.entries(k) {
                    if fine[j as usize] != own {
                        *around.entry(fine[j as usize]).or_default() += f64::from(shared.length(k, e).abs());
                    } else if !std::mem::replace(&mut seen[j as usize], true) {
                        piece.push(j);
                    }
                }
                next += 1;
            }
            let longer =
                |most: (u32, f64), (label, length): (u32, f64)| if length > most.1 { (label, length) } else { most };
            let (most, length) = around.into_iter().fold((own, 0.), longer);
            if length > 0. && piece.iter().all(|&k| label[self.proxy.node(k) as usize] != own) {
                piece.iter().for_each(|&k| fine[k as usize] = most);
            }
        }
    }

    /// The nodes that are not in `tiny` components, the largest first.
    fn largest(&self, tiny: &BTreeSet<usize>) -> Vec<usize> {
        let area = |own: Range<usize>| own.map(|k| self.proxy.area(k)).sum::<f64>();
        let mut all: Vec<(f64, usize)> =
            self.proxy.of_nodes().map(area).zip(0..).filter(|(_, node)| !tiny.contains(node)).collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        all.into_iter().map(|(_, node)| node).collect()
    }

    /// The weight of each of the triangles `own` of a node: its area, or 1 if none has any.
    fn weights(&self, own: Range<usize>) -> impl Iterator<Item = f64> {
        let fine = &self.proxy;
        let none = own.clone().all(|k| fine.area(k) <= 0.);
        own.map(move |k| if none { 1. } else { fine.area(k) })
    }

    /// The mean confidence of each node where its triangles have its `label` (n); 0 if none has.
    fn confidences(&self, decided: &Clustered, label: &[u32]) -> Vec<f32> {
        let mean = |(own, label): (Range<usize>, &u32)| {
            let (mut sum, mut total) = (0., 0.);
            for (weight, k) in self.weights(own.clone()).zip(own).filter(|(_, k)| decided.labels[*k] == *label) {
                (sum, total) = (sum + weight * f64::from(decided.quality[k]), total + weight);
            }
            if total > 0. { (sum / total) as f32 } else { 0. }
        };
        self.proxy.of_nodes().zip(label).map(mean).collect()
    }

    /// The nodes that the triangles `landmarks` lie on, each once.
    fn landmarks(&self, landmarks: &[u32]) -> Vec<u32> {
        let mut known = BTreeSet::new();
        landmarks.iter().map(|&triangle| self.proxy.node(triangle)).filter(|&node| known.insert(node)).collect()
    }

    /// The nodes in tiny components, if the number of the proxy's is `triangles`.
    fn tiny_nodes(&self, triangles: u64, inner: &WorkDir) -> Result<BTreeSet<usize>> {
        if triangles == 0 {
            return Ok(BTreeSet::new());
        }
        let tiny = is_tiny(self.proxy.len(), inner)?;
        let nodes = self.proxy.of_nodes().enumerate();
        Ok(nodes.filter(|(_, own)| tiny(own.start)).map(|(node, _)| node).collect())
    }
}
