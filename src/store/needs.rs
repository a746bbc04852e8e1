//! What stages will need, estimated before a run: memory, disk while they run, disk that they keep.
//!
//! Each stage states it beside its code, in [`super::stage::Stage::needs`], by the same arithmetic that its code uses;
//! `plan` adds them up. Arrays of a temporary directory are kept in memory while the budget has room, so the
//! arrays of one stage determine what is left for the next: a [`BudgetEstimate`] is passed from stage to stage.

use super::budget::Budget;
use super::shuffle::Sizing;
use serde::Serialize;

/// Bytes allocated besides what stages state: queues of fronts, buffers of writers.
pub const BASE: u64 = 2 << 20;

/// Bytes that deciding about parts, and later splitting faces, may allocate outside the budget: enough for all
/// defaults. What more landmarks need must fit the budget.
pub const BESIDE_BUDGET: u64 = 40 << 20;

/// The size of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Extent {
    /// Faces n.
    pub faces: u64,
    /// Vertices.
    pub vertices: u64,
    /// Corners of all faces.
    pub corners: u64,
    /// Landmarks l.
    pub landmarks: u64,
    /// Parts that are requested, at least.
    pub parts: u64,
    /// Coordinates of the embedding, if faces are clustered in it.
    pub dimensions: u64,
    /// Worker threads.
    pub threads: u64,
    /// Whether faces are put in another order than the file's.
    pub reordered: bool,
    /// Whether the mesh is contracted and rows are computed over the contraction.
    pub contracts: bool,
    /// Whether rows are kept after they have been averaged over cells.
    pub keeps_rows: bool,
    /// Whether geometry is recomputed from the mesh at each access instead of stored.
    pub computed: bool,
    /// Whether the graph and the distance fields exceed what the kernel can keep in memory.
    pub paged: bool,
    /// Whether the surface is so rough that turning is measured with smoothed normals.
    pub rough: bool,
    /// Whether the work directory is kept after the run.
    pub lasting: bool,
    /// Whether stages delete what later ones do not read.
    pub releases: bool,
}

/// What a stage needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Needs {
    /// Peak bytes allocated, besides [`BASE`].
    pub memory: u64,
    /// Bytes that it leaves in the work directory.
    pub keeps: u64,
    /// Further bytes that it needs there while it runs.
    pub temporary: u64,
    /// Bytes of its own and of earlier stages' files that it deletes at its end.
    pub frees: u64,
    /// Bytes read from the disk where memory holds hardly anything of the mesh (measured:
    /// `benches/records/2026-11-22-billion-again.md`).
    pub reads: u64,
    /// Bytes written to the disk in that case.
    pub writes: u64,
}

impl Needs {
    /// The same needs, with the bytes read and written.
    pub fn moving(self, reads: u64, writes: u64) -> Self {
        Self { reads, writes, ..self }
    }
}

/// The budget as arrays in memory see it: they may use it while [`Budget::left_to_stages`] stays free.
#[derive(Clone, Debug)]
pub struct BudgetEstimate {
    total: u64,
    used: u64,
    holding: bool,
    /// Bytes of arrays in memory that a later stage deletes.
    named: Vec<(&'static str, u64)>,
}

impl BudgetEstimate {
    /// A budget of `total` bytes; `holding`: arrays of the work directory may be kept in memory.
    pub fn new(total: u64, holding: bool) -> Self {
        Self { total, used: 0, holding, named: Vec::new() }
    }

    /// All of the budget.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// What is in use now.
    pub fn used(&self) -> u64 {
        self.used
    }

    /// What is free now.
    pub fn left(&self) -> u64 {
        self.total.saturating_sub(self.used)
    }

    /// How many of `bytes` are kept in memory, if arrays of any kind may be: all or nothing.
    pub fn reserve(&mut self, bytes: u64) -> u64 {
        let held = if self.left() >= bytes + Budget::left_to_stages(self.total) { bytes } else { 0 };
        self.used += held;
        held
    }

    /// How many bytes of an array of the work directory are kept in memory.
    pub fn reserve_array(&mut self, bytes: u64) -> u64 {
        if self.holding { self.reserve(bytes) } else { 0 }
    }

    /// [`BudgetEstimate::reserve_array`] for an array that a later stage deletes by name.
    pub fn reserve_named(&mut self, name: &'static str, bytes: u64) -> u64 {
        let held = self.reserve_array(bytes);
        self.named.retain(|(other, _)| *other != name);
        self.named.push((name, held));
        held
    }

    /// Frees the array `name`; returns how many bytes of it were in memory.
    pub fn release_named(&mut self, name: &str) -> u64 {
        let at = self.named.iter().position(|(other, _)| *other == name);
        let held = at.map_or(0, |at| self.named.swap_remove(at).1);
        self.release(held);
        held
    }

    /// Takes what a stage is granted, unconditionally.
    pub fn grant(&mut self, bytes: u64) {
        self.used += bytes;
    }

    /// Returns bytes.
    pub fn release(&mut self, bytes: u64) {
        self.used = self.used.saturating_sub(bytes);
    }
}

/// A shuffle that may use one `part`-th of what the budget has left.
#[derive(Clone, Copy, Debug)]
pub struct ShuffleNeeds {
    /// Most bytes of it in memory, staging blocks included.
    pub held: u64,
    /// What it takes from the budget.
    pub granted: u64,
}

impl ShuffleNeeds {
    /// For `records` of `size` bytes, where consumers hold `copies` buckets and `left` bytes are left.
    pub fn new(records: u64, size: usize, copies: u64, part: u64, left: u64, threads: u64) -> Self {
        let room = left / part;
        let sizing = Sizing::new(records, size, copies, threads as usize, room / 2);
        Self {
            held: sizing.bytes.min(room.saturating_sub(sizing.fixed())) + sizing.staging,
            granted: (sizing.fixed() + sizing.bytes).min(room),
        }
    }
}
