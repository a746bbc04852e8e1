//! Estimates what a run will need before it starts: memory, disk and time per stage.
//!
//! Each stage states its needs beside its own code ([`Stage::needs`]); this module adds them up. Disk follows from the
//! sizes of the arrays, memory from the same arithmetic that sizes shuffles to the budget, and time from a short
//! calibration: the same recipe on two synthetic creatures ([`super::calibrate`]), extrapolated linearly. If memory is
//! short, bytes read and written are added, at the speed of the disk ([`DiskSpeed`]). Only the input's header is read.

use super::input::computes;
use super::params::{BYTES_PER_PART, Cluster, SegmentParams};
use super::surface::{NORMALS_KEPT, SurfaceStage};
use crate::base::printable::human;
use crate::base::{Error, Result};
use crate::cluster::contract::{Contraction, NODES};
use crate::cluster::parts::PartCount;
use crate::distance::rows::{ROWS, RowsStage};
use crate::graph::Order;
use crate::graph::csr::WEIGHTS;
use crate::graph::dual::{GraphStage, WeightsStage};
use crate::graph::order::{LARGE, OrderStage};
use crate::mesh::MeshSize;
use crate::mesh::geometry::check_size;
use crate::store::disk_speed::DiskSpeed;
use crate::store::needs::{BASE, BudgetEstimate, Extent, Needs};
use crate::store::{Budget, Run, Stage};
use serde::Serialize;
use std::ops::AddAssign;
use std::path::Path;

/// Caches hold the creature but not the mesh: stages take this many times as long per face on large meshes (measured).
const BEYOND_CACHES: f64 = 1.2;

/// The share of the disk's time that is actually waited for; the rest overlaps with work (measured).
const WAITING: f64 = 0.5;

/// Seconds of processor time per byte read or written if memory is short, besides waiting: faults, reclaiming, cold
/// caches. 19 seconds more for some 42 GB at 100 million faces by default (measured).
const PAGING: f64 = 0.35e-9;

/// The same for rows over all faces, which are read in the order of their fronts: 53 seconds for 61 GB by K-means, of
/// which a quarter was waiting for the disk (measured).
const PAGING_OF_ROWS: f64 = 0.7e-9;

/// The time of a stage: a fixed part, and a part per face.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageTime {
    /// Seconds.
    pub fixed: f64,
    /// Seconds per face.
    pub per_face: f64,
}

impl StageTime {
    /// Seconds for `faces` faces.
    pub fn of(&self, faces: u64) -> f64 {
        self.fixed + self.per_face * faces as f64
    }

    /// The same plus `per_face` seconds per face, corrected for a mesh larger than the one measured.
    pub(super) fn slower_by(self, per_face: f64) -> Self {
        Self { per_face: self.per_face + BEYOND_CACHES * per_face, ..self }
    }

    /// The line through two measurements of (faces, seconds).
    pub(super) fn through((few, short): (f64, f64), (many, long): (f64, f64)) -> Self {
        let slope = ((long - short) / (many - few)).clamp(0., long / many);
        Self { fixed: (long - slope * many).max(0.), per_face: BEYOND_CACHES * slope }
    }
}

impl AddAssign for StageTime {
    fn add_assign(&mut self, other: Self) {
        self.fixed += other.fixed;
        self.per_face += other.per_face;
    }
}

/// A stage and its needs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StagePlan {
    /// The stage.
    pub name: &'static str,
    /// Memory and disk.
    #[serde(flatten)]
    pub needs: Needs,
    /// Seconds on a smooth surface, if calibrated.
    pub seconds: Option<f64>,
}

/// The needs of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// The mesh.
    pub mesh: MeshSize,
    /// Landmarks l.
    pub landmarks: usize,
    /// Its stages in order.
    pub stages: Vec<StagePlan>,
    /// Peak bytes allocated.
    pub memory: u64,
    /// Bytes in the work directory at the end.
    pub disk: u64,
    /// Peak bytes in the work directory while it runs. All of these figures are for a rough surface.
    pub disk_peak: u64,
    /// [`Plan::disk_peak`] for a smooth surface, which needs fewer normals.
    pub disk_peak_smooth: u64,
    /// Mapped bytes that fronts access randomly: what the page cache should hold for full speed.
    pub random_access_bytes: u64,
    /// Total seconds on a smooth surface, if calibrated.
    pub seconds: Option<f64>,
    /// Total seconds on a rough surface, if calibrated.
    pub seconds_rough: Option<f64>,
    /// Bytes read from the disk and written to it in each stage for a rough surface if memory holds hardly anything of
    /// the mesh.
    #[serde(skip)]
    rough_moves: Vec<[u64; 2]>,
}

/// Number of landmarks of `params` on a mesh of `faces` faces; components need none.
fn landmarks(params: &SegmentParams, faces: u64) -> u64 {
    if params.cluster == Cluster::Components {
        return 0;
    }
    (params.landmarks_of(faces as usize) as u64).min(faces)
}

/// Size of the folder of the contracted surface without rows: its graph, cells, their rows, the ensemble (measured).
const ON_CONTRACTION: u64 = 10 << 20;

/// Bytes that finding parts, or recording them, allocates outside the budget.
fn fixed(extent: &Extent, cluster: Cluster) -> u64 {
    let nodes = if extent.contracts { NODES as u64 } else { extent.faces };
    cluster.fixed_bytes(extent.landmarks, nodes).max(BYTES_PER_PART * extent.parts)
}

/// Whether rows are over all faces and every face is embedded: K-means and 2-means without a contraction.
fn embeds_faces(extent: &Extent, cluster: Cluster) -> bool {
    cluster.embeds() && !extent.contracts
}

/// The needs of labelling: labels and confidences, once more in file order, and before them the decision on parts, or
/// the sample on which the centres of K-means are found. The rows of K-means over all faces are deleted before labels
/// are reordered.
fn labels_need(extent: &Extent, cluster: Cluster, estimate: &mut BudgetEstimate) -> Needs {
    let n = extent.faces;
    let embeds_faces = embeds_faces(extent, cluster);
    let before = estimate.used();
    let labels = estimate.reserve_array(8 * n);
    let restored = if extent.reordered { estimate.reserve_array(8 * n) } else { 0 };
    // Labels do not exist yet while parts are decided, but they do while centres are found.
    let held = if cluster == Cluster::Parts { before } else { estimate.used() };
    let beside = extent.threads.saturating_sub(1) * cluster.thread_bytes(extent.landmarks);
    let memory = estimate.used().max(held + fixed(extent, cluster) + beside);
    let frees = if extent.lasting || cluster == Cluster::Components {
        0
    } else if embeds_faces {
        4 * extent.landmarks * n - estimate.release_named(ROWS)
    } else {
        4 * extent.corners - estimate.release_named(WEIGHTS)
    };
    let rows = if embeds_faces { frees } else { 0 };
    let temporary = if extent.reordered { (8 * n - restored).saturating_sub(rows) } else { 0 };
    let needs = Needs { memory, keeps: 8 * n - labels, temporary, frees, ..Needs::default() };
    if embeds_faces {
        return needs.moving((8 * extent.landmarks + 50) * n, 14 * n);
    }
    needs.moving(122 * n, 23 * n)
}

/// The stages of a run over `extent` and their needs; `decoded` as in [`MeshSize`].
fn stages_of(extent: &Extent, cluster: Cluster, decoded: u64, budget: u64) -> Vec<StagePlan> {
    let mut estimate = BudgetEstimate::new(budget, !extent.lasting);
    // Indices are checked in one pass.
    let read = Needs { keeps: decoded, ..Needs::default() }.moving(4 * extent.corners + extent.faces, decoded);
    let mut stages = vec![("read", read)];
    if extent.reordered {
        stages.push(("order", OrderStage::needs(extent, &mut estimate)));
    }
    stages.push(("graph", GraphStage::needs(extent, &mut estimate)));
    if cluster != Cluster::Components {
        distances_need(extent, cluster, &mut estimate, &mut stages);
    }
    stages.push(("labels", labels_need(extent, cluster, &mut estimate)));
    let least = |name: &str| if name == "labels" { fixed(extent, cluster) } else { BASE };
    let within = |name, needs: Needs| (BASE + needs.memory).min(budget.max(least(name)));
    let planned =
        |(name, needs)| StagePlan { name, needs: Needs { memory: within(name, needs), ..needs }, seconds: None };
    stages.into_iter().map(planned).collect()
}

/// Adds the stages from the graph to rows of distances.
fn distances_need(
    extent: &Extent,
    cluster: Cluster,
    estimate: &mut BudgetEstimate,
    stages: &mut Vec<(&'static str, Needs)>,
) {
    if !embeds_faces(extent, cluster) {
        stages.push(("surface", SurfaceStage::needs(extent, estimate)));
    }
    let mut weights = WeightsStage::needs(extent, estimate);
    if extent.rough && !extent.lasting {
        weights.frees += 12 * extent.faces - estimate.release_named(NORMALS_KEPT);
    }
    stages.push(("weights", weights));
    if extent.contracts {
        stages.push(("contraction", Contraction::needs(extent, estimate)));
        // Nothing that grows with the mesh.
        let rows = if extent.keeps_rows { 4 * extent.landmarks * NODES as u64 } else { 0 };
        let held = estimate.reserve_array(rows + ON_CONTRACTION);
        stages.push(("rows", Needs { memory: held, keeps: rows + ON_CONTRACTION - held, ..Needs::default() }));
    } else {
        stages.push(("rows", RowsStage::needs(extent, estimate)));
    }
}

/// Bytes on disk after `stages`, and at most while they run.
fn disk_of(stages: &[StagePlan]) -> (u64, u64) {
    let (mut disk, mut peak) = (0, 0);
    for Needs { keeps, temporary, frees, .. } in stages.iter().map(|stage| stage.needs) {
        peak = peak.max(disk + keeps + temporary);
        disk = disk + keeps - frees;
    }
    (disk, peak)
}

impl Plan {
    /// The plan for a mesh of size `mesh` under `params`, in a work directory that is `lasting` or temporary. If
    /// [`Order::Auto`] would have to examine the mesh, its order is assumed to be good unless `reordered`.
    pub fn new(mesh: MeshSize, params: &SegmentParams, reordered: bool, lasting: bool, run: &Run) -> Self {
        let MeshSize { faces, vertices, corners, decoded, .. } = mesh;
        let budget = run.budget.total();
        let mut extent = Extent {
            faces,
            vertices,
            corners,
            landmarks: landmarks(params, faces),
            parts: params.parts.count.least() as u64,
            dimensions: if let PartCount::Exactly(parts) = params.parts.count { parts.max(2) as u64 } else { 0 },
            threads: run.threads as u64,
            reordered: reordered || params.order == Order::Hilbert,
            contracts: params.contracts(faces as usize),
            keeps_rows: params.keeps_rows(lasting),
            computed: computes(params, faces as usize, !lasting, run),
            paged: 8 * corners + 4 * (run.threads as u64 + 1) * faces > run.resident,
            lasting,
            rough: false,
            releases: false,
        };
        let embeds_faces = embeds_faces(&extent, params.cluster);
        // Normals are for cells.
        extent.rough = !embeds_faces && params.cluster != Cluster::Components;
        extent.releases = embeds_faces && !lasting;
        let mut stages = stages_of(&extent, params.cluster, decoded, budget);
        let (disk, disk_peak) = disk_of(&stages);
        let smooth = stages_of(&Extent { rough: false, ..extent }, params.cluster, decoded, budget);
        let (_, disk_peak_smooth) = disk_of(&smooth);
        let rough_moves = stages.iter().map(|stage| [stage.needs.reads, stage.needs.writes]).collect();
        // Seconds of each stage are those on a smooth surface.
        for (stage, smooth) in stages.iter_mut().zip(&smooth) {
            stage.needs = stage.needs.moving(smooth.needs.reads, smooth.needs.writes);
        }
        Self {
            mesh,
            landmarks: extent.landmarks as usize,
            memory: stages.iter().map(|stage| stage.needs.memory).max().unwrap_or(0),
            disk,
            disk_peak,
            disk_peak_smooth,
            // Row starts, neighbours, weights, a row and the field; components need no fronts.
            random_access_bytes: if params.cluster == Cluster::Components {
                0
            } else {
                8 * faces + faces / 2 + 8 * corners
            },
            stages,
            seconds: None,
            seconds_rough: None,
            rough_moves,
        }
    }

    /// Adds times from the pace of each stage, measured on a smooth and on a rough surface.
    pub fn with_times(mut self, smooth: impl Fn(&str) -> StageTime, rough: impl Fn(&str) -> StageTime) -> Self {
        let faces = self.mesh.faces;
        for stage in &mut self.stages {
            stage.seconds = Some(smooth(stage.name).of(faces));
        }
        self.seconds = self.stages.iter().map(|stage| stage.seconds).sum();
        self.seconds_rough = Some(self.stages.iter().map(|stage| rough(stage.name).of(faces)).sum());
        self
    }

    /// Adds the time for paging with a disk of this speed, if the page cache can hold `cache` bytes of mapped files.
    pub fn with_waits(mut self, speed: DiskSpeed, cache: u64) -> Self {
        let missing = 1. - (cache as f64 / self.random_access_bytes as f64).min(1.);
        let waits = |stage: &str, reads: u64, writes: u64| {
            let (read, written) = (missing * reads as f64, missing * writes as f64);
            let paging = if stage == "rows" { PAGING_OF_ROWS } else { PAGING };
            WAITING * speed.seconds(read, written) + paging * (read + written)
        };
        for (StagePlan { name, needs, seconds }, [reads, writes]) in self.stages.iter_mut().zip(&self.rough_moves) {
            *seconds = seconds.map(|seconds| seconds + waits(name, needs.reads, needs.writes));
            self.seconds_rough = self.seconds_rough.map(|seconds| seconds + waits(name, *reads, *writes));
        }
        self.seconds = self.stages.iter().map(|stage| stage.seconds).sum();
        self
    }

    /// Rejects the mesh in the file `path` if it has more faces or corners than can be numbered.
    ///
    /// # Errors
    /// [`Error::Unusable`].
    pub fn check_size(&self, path: &Path) -> Result<()> {
        check_size(self.mesh.faces, self.mesh.corners, path)
    }

    /// Rejects a run whose files do not fit on the disk under `folder`, even for a smooth surface. The `there` bytes of
    /// existing files count as free.
    ///
    /// # Errors
    /// [`Error::Disk`].
    pub fn check_disk(&self, folder: &Path, there: u64) -> Result<()> {
        match self.lack_of_disk(folder, there, self.disk_peak_smooth) {
            Some((needed, available)) => Err(Error::Disk { path: folder.to_path_buf(), needed, available }),
            None => Ok(()),
        }
    }

    /// A one-line warning if a rough surface, but not a smooth one, would exceed the disk under `folder`.
    pub fn disk_warning(&self, folder: &Path, there: u64) -> Option<String> {
        self.lack_of_disk(folder, there, self.disk_peak).map(|(needed, available)| {
            let [needed, available] = [needed, available].map(|bytes| human(bytes as f64));
            format!("{needed}B of disk space are needed if the surface is rough, but only {available}B are free")
        })
    }

    /// The bytes that a run with `peak` bytes on disk still needs under `folder`, and the free bytes, if these are
    /// fewer.
    fn lack_of_disk(&self, folder: &Path, there: u64, peak: u64) -> Option<(u64, u64)> {
        let available = fs4::available_space(folder).ok()?;
        let needed = peak.saturating_sub(there);
        (needed > available).then_some((needed, available))
    }

    /// Bytes that the page cache of this machine can hold while the run allocates what is planned, if they are too few
    /// for what fronts access.
    pub fn short_cache(&self) -> Option<u64> {
        let cache = Budget::machine_limit()?.saturating_sub(self.memory);
        (self.random_access_bytes > cache).then_some(cache)
    }

    /// A one-line warning if the run will be slow for lack of memory.
    pub fn warning(&self) -> Option<String> {
        self.short_cache().map(|cache| {
            let [traversed, cache] = [self.random_access_bytes, cache].map(|bytes| human(bytes as f64));
            format!(
                "fronts traverse {traversed}B of mapped files, but only {cache}B of memory are left to cache them: \
                 expect waits for the disk"
            )
        })
    }
}

/// Whether the order of a mesh of `faces` faces depends on examining it.
pub fn order_is_open(params: &SegmentParams, faces: u64) -> bool {
    params.order == Order::Auto && faces > LARGE as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::parts::PartsParams;

    /// A billion faces with a budget of 2 GiB.
    fn plan() -> Plan {
        plan_of(&SegmentParams::default())
    }

    fn plan_of(params: &SegmentParams) -> Plan {
        let mesh =
            MeshSize { faces: 1_000_000_000, vertices: 500_000_000, corners: 3_000_000_000, ..MeshSize::default() };
        let mut run = Run::new(&());
        (run.threads, run.budget, run.resident) = (2, Budget::new(2 << 30), 4 << 30);
        Plan::new(mesh, params, false, false, &run)
    }

    /// 46.55 bytes a face were measured on a smooth surface (`benches/records/2026-11-22-billion.md`).
    #[test]
    fn smooth_surfaces_take_as_much_disk_as_measured() {
        let plan = plan();
        let a_face = |bytes: u64| bytes as f64 / plan.mesh.faces as f64;
        assert!((46.0..47.5).contains(&a_face(plan.disk_peak_smooth)), "{}", plan.disk_peak_smooth);
        assert!((52.0..53.5).contains(&a_face(plan.disk_peak)), "{}", plan.disk_peak);
    }

    /// Rows 40, neighbours 12, weights 12, row starts ½: measured at 10 million faces.
    #[test]
    fn rows_of_k_means_take_as_much_disk_as_measured() {
        let count = PartCount::Exactly(6);
        let params = SegmentParams::default().cluster(Cluster::KMeans).exact(true).landmarks(Some(10));
        let params = params.parts(PartsParams { count, ..PartsParams::default() });
        assert_eq!(plan_of(&params).disk_peak, 64_500_000_000);
    }

    #[test]
    fn waiting_grows_with_what_memory_does_not_hold() {
        let timed =
            plan().with_times(|_| StageTime { fixed: 1., per_face: 0. }, |_| StageTime { fixed: 2., per_face: 0. });
        let speed = DiskSpeed { read: 1e9, write: 5e8 };
        let seconds = |cache: u64| timed.clone().with_waits(speed, cache).seconds.unwrap();
        let [reads, writes] = [|needs: Needs| needs.reads, |needs: Needs| needs.writes]
            .map(|of| timed.stages.iter().map(|stage| of(stage.needs)).sum::<u64>());
        let waiting = WAITING * (reads as f64 / 1e9 + writes as f64 / 5e8);
        let all = waiting + PAGING * (reads + writes) as f64;
        assert!((seconds(0) - timed.seconds.unwrap() - all).abs() < 1e-6 && all > 100., "{all}");
        assert!((seconds(timed.random_access_bytes / 2) - timed.seconds.unwrap() - all / 2.).abs() < 1e-3);
        assert_eq!(seconds(timed.random_access_bytes), timed.seconds.unwrap());
        // A rough surface has more to compute and more to read and write.
        let slow = timed.clone().with_waits(speed, 0);
        assert!(slow.seconds_rough.unwrap() > slow.seconds.unwrap() + timed.stages.len() as f64);
    }
}
