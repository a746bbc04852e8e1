//! What a run will need, told before it starts: memory, disk and time a stage.
//!
//! Disk follows from the sizes of the arrays alone, memory from the same arithmetic that cuts shuffles to the budget,
//! time from a short calibration: the same recipe on two small creatures ([`CALIBRATION`] faces and a quarter), drawn
//! out along the line through both. The input's header is read, nothing else.

use super::calibrate::Pace;
use super::{Cluster, SegmentParams, default_landmarks, landmarks_for_parts};
use crate::base::{Error, Result};
use crate::cluster::parts::PartCount;
use crate::graph::Order;
use crate::graph::half_edge_pairs;
use crate::graph::order::LARGE;
use crate::store::Run;
use crate::store::shuffle::Sizing;
use serde::Serialize;
use std::path::Path;

/// Faces of the calibration's creature.
pub const CALIBRATION: u64 = 200_000;
/// Bytes allocated besides what is computed below: queues of fronts, buffers of writers.
const BASE: u64 = 2 << 20;

/// The size of a mesh, and how its file has to be read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MeshSize {
    /// Faces n.
    pub faces: u64,
    /// Vertices.
    pub vertices: u64,
    /// Corners of all faces; three a face where the header does not tell.
    pub corners: u64,
    /// Bytes that decoding (and decompressing) writes; 0 where the file is read where it lies.
    pub decoded: u64,
}

/// A stage's needs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StagePlan {
    /// The stage.
    pub name: &'static str,
    /// Bytes allocated at the most.
    pub memory: u64,
    /// Bytes that it leaves in the work directory.
    pub keeps: u64,
    /// Bytes that it needs there besides while it runs.
    pub passing: u64,
    /// Bytes of it and of stages before it that it gives up at its end.
    pub frees: u64,
    /// Seconds, where calibrated.
    pub seconds: Option<f64>,
}

/// A run's needs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// The mesh.
    pub mesh: MeshSize,
    /// Landmarks l.
    pub landmarks: usize,
    /// Its stages in order.
    pub stages: Vec<StagePlan>,
    /// Bytes allocated at the most.
    pub memory: u64,
    /// Bytes in the work directory at the end.
    pub disk: u64,
    /// Bytes in the work directory at the most, while it runs.
    pub disk_peak: u64,
    /// Mapped bytes that fronts walk all over: what the page cache should hold for full speed.
    pub walked: u64,
    /// Seconds in all, where calibrated.
    pub seconds: Option<f64>,
}

/// Most bytes of a shuffle that are in memory, staged ones included, when it may use the `part`-th part of `left`.
fn held(records: u64, size: usize, copies: u64, part: u64, left: u64, threads: usize) -> u64 {
    let room = left / part;
    let sizing = Sizing::new(records, size, copies, threads, room / 2);
    sizing.bytes.min(room.saturating_sub(sizing.fixed())) + sizing.staging
}

/// The budget as work arrays take it that are held in memory: while half of it stays for others.
struct Room {
    total: u64,
    used: u64,
    holding: bool,
}

impl Room {
    fn left(&self) -> u64 {
        self.total.saturating_sub(self.used)
    }

    /// What of `bytes` is held where any array may be: all or nothing.
    fn spare(&mut self, bytes: u64) -> u64 {
        let held = if self.left() >= bytes + self.total / 2 { bytes } else { 0 };
        self.used += held;
        held
    }

    /// What of an array of the work directory is held.
    fn take(&mut self, bytes: u64) -> u64 {
        if self.holding { self.spare(bytes) } else { 0 }
    }

    fn give_back(&mut self, bytes: u64) {
        self.used -= bytes;
    }
}

/// What such a shuffle takes from the budget.
fn granted(records: u64, size: usize, copies: u64, part: u64, left: u64, threads: usize) -> u64 {
    let room = left / part;
    let sizing = Sizing::new(records, size, copies, threads, room / 2);
    (sizing.fixed() + sizing.bytes).min(room)
}

impl Plan {
    /// The plan for a mesh of size `mesh` under `params`, in a work directory that is `lasting` or temporary. Where
    /// [`Order::Auto`] has to look at the mesh to decide, the file's order is taken to be good; `reordered` says
    /// otherwise.
    pub fn new(mesh: MeshSize, params: &SegmentParams, reordered: bool, lasting: bool, run: &Run) -> Self {
        let MeshSize { faces: n, vertices, corners, .. } = mesh;
        let (budget, threads) = (run.budget.total(), run.threads);
        let t = threads as u64;
        let l = params.landmarks.unwrap_or(match (params.cluster, params.parts.count) {
            (Cluster::KMeans, PartCount::Exactly(parts)) => default_landmarks(parts),
            _ => landmarks_for_parts(n as usize),
        });
        let l = l.min(n as usize) as u64;
        let stage = |name, memory: u64, keeps, passing| StagePlan {
            name,
            memory: (BASE + memory).min(budget.max(BASE)),
            keeps,
            passing,
            frees: 0,
            seconds: None,
        };
        let mut room = Room { total: budget, used: 0, holding: !lasting };
        let mut stages = vec![stage("read", 0, mesh.decoded, 0)];
        let reordered = reordered || params.order == Order::Hilbert;
        if reordered {
            let ranks = room.take(4 * vertices);
            let joined = budget < 8 * vertices;
            let left = if joined { budget } else { budget - 4 * vertices };
            let sorting = held(vertices, 24, 6 * t, 2, left, threads).max(held(n, 20, 6 * t, 3, left, threads));
            let memory = if joined { budget } else { sorting };
            let passing = 4 * vertices + (24 * vertices).max(20 * n + if joined { 16 * corners } else { 0 });
            let passing = passing.saturating_sub(memory + ranks);
            stages.push(stage("order", memory + ranks, 12 * vertices + 4 * corners + 4 * n, passing));
            room.give_back(ranks);
        }
        // Half-edges and links beside the nodes; then links beside all that is kept; then the components' roots.
        let nodes = room.take(28 * n);
        let edges = held(corners, 12, 3 * t, 3, room.left(), threads);
        let left = room.left() - granted(corners, 12, 3 * t, 3, room.left(), threads);
        let table = half_edge_pairs::fit(corners, left);
        let (links, taken) = if table {
            (4 * corners, 4 * corners)
        } else {
            (held(corners, 8, 12 * t, 2, left, threads), granted(corners, 8, 12 * t, 2, left, threads))
        };
        room.used += taken;
        let matrix = room.take(8 * n) + room.take(4 * corners);
        room.give_back(taken);
        let roots = room.take(4 * n);
        room.give_back(roots);
        let kept = 36 * n + 12 * corners - nodes - matrix;
        let spilled = if table { 0 } else { (8 * corners).saturating_sub(links) };
        let matching = (28 * n - nodes + spilled + (12 * corners).saturating_sub(edges)).saturating_sub(kept);
        let passing = matching.max(spilled).max(4 * n - roots);
        let sorted = if reordered && !lasting { 12 * vertices + 4 * corners } else { 0 };
        let matched = if table { edges + links } else { edges.max(links) };
        let graph = stage("graph", nodes + matched.max(links + matrix).max(matrix + roots), kept, passing);
        stages.push(StagePlan { frees: sorted, ..graph });
        if params.cluster == Cluster::Parts {
            let surface = room.take(20 * n);
            let passing = room.take(36 * n + 4 * corners);
            room.give_back(passing);
            // Not all of what passes is there at a time.
            let memory = (24 << 20) + room.used + passing / 2;
            stages.push(stage("surface", memory, 20 * n - surface, 36 * n + 4 * corners - passing));
        }
        // Lengths go when weights are made of them, weights when rows are.
        let frees = |held: u64| if params.cluster == Cluster::Parts || lasting { 0 } else { 4 * corners - held };
        let weights = room.take(4 * corners);
        stages.push(StagePlan { frees: frees(0), ..stage("weights", room.used, 4 * corners - weights, 0) });
        // The field of the search, the graph once more for fronts, and one row per thread.
        let field = room.take(4 * n);
        let triples = room.spare(24 * n);
        let own: u64 = (0..t).map(|_| room.spare(4 * n)).sum();
        let fronts = triples + own;
        // Where nobody keeps them, a thread without memory for a row has a file for it.
        let (kept, scratch) = if params.keeps_rows(lasting) { (4 * l * n, 0) } else { (0, 4 * n * t - own) };
        let rows = stage("rows", room.used, kept, 4 * n - field + scratch);
        room.give_back(field + fronts);
        stages.push(StagePlan { frees: frees(weights), ..rows });
        if frees(0) > 0 {
            room.give_back(weights);
        }
        // The sample of columns and their coordinates.
        let dimensions = match params.parts.count {
            PartCount::Exactly(parts) => parts.max(2) as u64,
            _ => 0,
        };
        let labels = room.take(8 * n);
        let restored = if reordered { room.take(8 * n) } else { 0 };
        let sample = 12 * (1 << 15).min(n) * (l + dimensions);
        stages.push(stage("labels", sample + room.used, 8 * n - labels, 8 * n - restored));
        let (mut disk, mut disk_peak) = (0, 0);
        for stage in &stages {
            disk_peak = disk_peak.max(disk + stage.keeps + stage.passing);
            disk = disk + stage.keeps - stage.frees;
        }
        Self {
            mesh,
            landmarks: l as usize,
            memory: stages.iter().map(|stage| stage.memory).max().unwrap_or(0),
            disk,
            disk_peak,
            // Row starts, neighbours, weights, a row and the field.
            walked: 16 * n + 8 * corners,
            stages,
            seconds: None,
        }
    }

    /// Fills in the times from `measured`, the pace of each stage.
    pub fn with_times(mut self, measured: impl Fn(&str) -> Pace) -> Self {
        for stage in &mut self.stages {
            stage.seconds = Some(measured(stage.name).of(self.mesh.faces));
        }
        self.seconds = self.stages.iter().map(|stage| stage.seconds).sum();
        self
    }

    /// Refuses a run whose files the disk under `folder` cannot hold. Bytes that are there already count as free.
    ///
    /// # Errors
    /// [`Error::Disk`].
    pub fn check_disk(&self, folder: &Path, there: u64) -> Result<()> {
        let Ok(available) = fs4::available_space(folder) else { return Ok(()) };
        if self.disk_peak > available.saturating_add(there) {
            let needed = self.disk_peak.saturating_sub(there);
            return Err(Error::Disk { path: folder.to_path_buf(), needed, available });
        }
        Ok(())
    }

    /// What would make the run slow under the memory that is there, in a line; `cache`: bytes that the page cache may
    /// use.
    pub fn warning(&self, cache: u64) -> Option<String> {
        (self.walked > cache).then(|| {
            format!(
                "fronts walk over {:.1} GB of mapped files, and {:.1} GB of memory are left for them: expect them to wait \
                 for the disk",
                self.walked as f64 / 1e9,
                cache as f64 / 1e9
            )
        })
    }
}

/// Whether the order of a mesh of `faces` faces is decided by a look at it.
pub fn order_is_open(params: &SegmentParams, faces: u64) -> bool {
    params.order == Order::Auto && faces > LARGE as u64
}
