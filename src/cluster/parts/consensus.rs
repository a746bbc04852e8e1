//! The simpler decisions: a single run with a stop constant, and a consensus of several.
//!
//! A single run merges one over-segmentation until the greatest cost falls below 1.5. The consensus stops eight random
//! over-segmentations at 1.6 times a factor between .8 and 1.25, and groups the superfaces by average linkage of how
//! often they are in one part, down to 1.6 times the median number of parts, plus one. The groups are then merged once
//! more by cost. Both need a stop constant, which the default ([`super::labelling`]) does not; they are kept for
//! comparison.

use super::answer::PartDecision;
use super::cell_graph::CellGraph;
use super::cell_labels::compact;
use super::ensemble::{
    MeasuredSuperfaces, OverSegmentation, OverSegmentationParams, comparison_embedding, draw_ensemble,
};
use super::hierarchy::{CellUnion, PartTree};
use super::labelling::unions_within;
use super::linkage::{Linkage, LinkageRank};
use super::matrix::Square;
use super::merges::{MergeModel, classes_after, meeting_probability, merges};
use crate::base::Result;
use crate::base::random::{stream, unit};
use crate::spectral::anchor::LandmarkDistances;
use crate::spectral::exp::exp_signed;
use crate::store::run::Run;
use libm::log as ln;

/// A single run stops when the greatest cost falls below this.
const SINGLE_STOP: f64 = 1.5;
/// The same for the ensemble of a consensus and its final merge.
const CONSENSUS_STOP: f64 = 1.6;
/// Members stop at this constant times a factor from this range.
const STOP_FACTOR: [f64; 2] = [0.8, 1.25];
/// Number of members of a consensus.
pub const ENSEMBLE: usize = 8;
/// Number of groups per part of the median over-segmentation, plus one.
const GROUPS: f64 = 1.6;
/// Index of the pair width .1, used if none is drawn.
const MIDDLE_WIDTH: usize = 1;
/// The joins within groups have levels above this, those of the final merge below.
const GROUP_LEVEL: f64 = 0.9;

/// Level of a merge at a given cost: ½ at the stop constant.
fn level(log_cost: f64, stop: f64) -> f64 {
    1.0 / (1.0 + stop * exp_signed(-log_cost))
}

/// One over-segmentation from all rows, merged by cost.
///
/// # Errors
/// Cancellation.
pub fn single_run(cells: &CellGraph, rows: &LandmarkDistances, small_part: f64, run: &Run) -> Result<PartDecision> {
    let params = OverSegmentationParams::single(rows.count);
    let over_segmentation =
        OverSegmentation::new(cells, rows, &params, MIDDLE_WIDTH, run.seed, "parts single clusters");
    let measured = MeasuredSuperfaces::of(
        cells,
        &comparison_embedding(cells, rows),
        std::slice::from_ref(&over_segmentation),
        run,
    )?;
    let superfaces = &measured.superfaces;
    let list = merges(
        measured.regions(cells, &superfaces.of_cell, superfaces.len(), MIDDLE_WIDTH),
        &MergeModel::by_cost(),
        |_| false,
    );
    let first = &superfaces.first;
    let unions = list.iter().zip(1i32..).map(|(m, k)| CellUnion {
        level: level(m.log_cost, SINGLE_STOP),
        rank: f64::from(-k),
        a: first[m.i],
        b: first[m.j],
    });
    let tree = PartTree::new(cells, unions_within(cells, &superfaces.of_cell).into_iter().chain(unions), small_part);
    let co_association = meeting_probability(superfaces.len(), &list);
    let superfaces = measured.superfaces;
    Ok(PartDecision::of(superfaces, co_association, tree))
}

/// Eight stopped over-segmentations, average linkage of their co-association, a final merge by cost.
///
/// # Errors
/// Cancellation.
pub fn consensus(cells: &CellGraph, rows: &LandmarkDistances, small_part: f64, run: &Run) -> Result<PartDecision> {
    let ensemble = draw_ensemble(cells, rows, ENSEMBLE, "parts consensus member", run)?;
    let measured = MeasuredSuperfaces::of(cells, &comparison_embedding(cells, rows), &ensemble, run)?;
    let superfaces = &measured.superfaces;
    let labels = run.map_chunks(
        ensemble.len(),
        || (),
        |k, ()| {
            let (m, mut random) = (&ensemble[k], stream(run.seed, &format!("parts consensus stop {k}")));
            let factor = STOP_FACTOR[0] + (STOP_FACTOR[1] - STOP_FACTOR[0]) * unit(&mut random);
            let stop = ln(CONSENSUS_STOP * factor);
            let regions = measured.regions(cells, &m.region, m.regions, m.width);
            let into = classes_after(m.regions, &merges(regions, &MergeModel::by_cost(), |cost| cost < stop));
            let label: Vec<u32> = superfaces.labels(&m.region).iter().map(|&r| into[r as usize]).collect();
            Ok(compact(&label))
        },
    )?;
    let n = superfaces.len();
    let mut co_association = Square::zeros(n);
    for (label, _) in &labels {
        for i in 0..n {
            for (x, &k) in co_association.row_mut(i).iter_mut().zip(label) {
                *x += if k == label[i] { 1.0 / ENSEMBLE as f64 } else { 0.0 };
            }
        }
    }
    let mut counts: Vec<usize> = labels.iter().map(|(_, k)| *k).collect();
    counts.sort_unstable();
    let median = (counts[(ENSEMBLE - 1) / 2] + counts[ENSEMBLE / 2]) as f64 / 2.0;
    let groups = (GROUPS * median).round() as usize + 1;
    let tree = grouped(cells, &measured, &co_association, groups, small_part);
    let superfaces = measured.superfaces;
    Ok(PartDecision::of(superfaces, co_association, tree))
}

/// Average linkage of superfaces to `groups` groups, then merges by cost: the hierarchy.
fn grouped(
    cells: &CellGraph,
    measured: &MeasuredSuperfaces,
    co_association: &Square,
    groups: usize,
    small_part: f64,
) -> PartTree {
    let superfaces = &measured.superfaces;
    let n = superfaces.len();
    let mut sums = co_association.clone();
    for i in 0..n {
        for (x, a) in sums.row_mut(i).iter_mut().zip(&superfaces.area) {
            *x *= a * superfaces.area[i];
        }
    }
    let linkage = Linkage { sums, area: superfaces.area.clone(), touching: None };
    let joins = linkage.joins(LinkageRank::Mean, groups);
    let mut into: Vec<u32> = (0..n as u32).collect();
    let mut unions = unions_within(cells, &superfaces.of_cell);
    for join in &joins {
        into.iter_mut().filter(|k| **k == join.j as u32).for_each(|k| *k = join.i as u32);
        let level = GROUP_LEVEL + (1.0 - GROUP_LEVEL) * join.mean;
        let rank = f64::from(-(unions.len() as i32));
        unions.push(CellUnion { level, rank, a: superfaces.first[join.i], b: superfaces.first[join.j] });
    }
    let (group, count) = compact(&into);
    let of_cell: Vec<u32> = superfaces.of_cell.iter().map(|&a| group[a as usize]).collect();
    let mut first = vec![u32::MAX; count];
    for (&k, &cell) in group.iter().zip(&superfaces.first) {
        first[k as usize] = first[k as usize].min(cell);
    }
    let regions = measured.regions(cells, &of_cell, count, MIDDLE_WIDTH);
    for m in merges(regions, &MergeModel::by_cost(), |_| false) {
        let level = level(m.log_cost, CONSENSUS_STOP).min(GROUP_LEVEL);
        let rank = f64::from(-(unions.len() as i32));
        unions.push(CellUnion { level, rank, a: first[m.i], b: first[m.j] });
    }
    PartTree::new(cells, unions, small_part)
}
