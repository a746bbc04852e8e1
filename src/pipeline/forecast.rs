//! What a run will take, as it is told before the run: the plan, with times by calibration, and notes on it.
//!
//! The program prints it, and Python returns it. Cost: nothing without calibration, with it that of [`calibrate`], and
//! of a test of the disk if memory is short.

use super::calibrate::calibrate;
use super::params::SegmentParams;
use super::plan::{Plan, StageTime, order_is_open};
use crate::base::printable::human;
use crate::base::{Error, Result};
use crate::mesh::MeshSize;
use crate::store::Run;
use crate::store::disk_speed::DiskSpeed;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Where a run keeps its arrays.
#[derive(Clone, Copy, Debug)]
pub struct Place<'a> {
    /// The folder, which need not exist yet.
    pub folder: &'a Path,
    /// Whether they stay there: a work directory.
    pub lasting: bool,
}

/// The plan of a run, and notes on it.
#[derive(Debug, Serialize)]
pub struct Forecast {
    /// Memory, disk and time.
    #[serde(flatten)]
    pub plan: Plan,
    /// Remarks and warnings, one line each.
    pub notes: Vec<String>,
    /// The error with which the run would end for lack of disk space.
    #[serde(skip)]
    pub shortage: Option<Error>,
}

impl Forecast {
    /// What cutting the mesh in the file `path`, of size `mesh`, takes under `params`; with times if `calibrated`.
    ///
    /// # Errors
    /// [`Error::Unusable`] for a mesh with too many faces, or fewer than parts; [`Error::Parameter`],
    /// [`Error::Memory`]; those of [`calibrate`].
    pub fn new(
        path: &Path,
        mesh: MeshSize,
        params: &SegmentParams,
        place: Place<'_>,
        calibrated: bool,
        run: &Run,
    ) -> Result<Self> {
        let Place { folder, lasting } = place;
        let mut plan = Plan::new(mesh, params, false, lasting, run);
        plan.check_size(path)?;
        params.check_for(path, mesh.faces)?;
        params.check_memory(mesh.faces, run)?;
        // A folder may not exist yet; its disk is that of the nearest existing folder above it.
        let folder = folder.ancestors().find(|folder| folder.is_dir()).unwrap_or(Path::new("."));
        if calibrated {
            plan = timed(plan, params, folder, lasting, run)?;
        }
        let mut notes = Vec::new();
        if order_is_open(params, mesh.faces) {
            let sorted = Plan::new(mesh, params, true, lasting, run);
            let more = human(sorted.disk_peak.saturating_sub(plan.disk_peak) as f64);
            notes.push(format!(
                "if the order of the file is poor: {more}B more disk space, to sort faces along a curve"
            ));
        }
        if plan.memory > run.budget.total() {
            let (needed, budget) = (human(plan.memory as f64), human(run.budget.total() as f64));
            notes.push(format!(
                "warning: at least {needed}B are allocated whatever the mesh, although `memory` is {budget}B"
            ));
        }
        let shortage = plan.check_disk(folder, 0).err();
        let of_disk = plan.disk_warning(folder, 0).filter(|_| shortage.is_none());
        notes.extend(plan.warning().into_iter().chain(of_disk).map(|warning| format!("warning: {warning}")));
        Ok(Self { plan, notes, shortage })
    }
}

/// The plan with times, measured in `folder`.
fn timed(plan: Plan, params: &SegmentParams, folder: &Path, lasting: bool, run: &Run) -> Result<Plan> {
    let measured = calibrate(params, plan.landmarks, plan.mesh.faces, folder, lasting, run)?;
    let time_of = |of: &BTreeMap<String, StageTime>, stage: &str| of.get(stage).copied().unwrap_or_default();
    let plan = plan.with_times(|stage| time_of(&measured.smooth, stage), |stage| time_of(&measured.rough, stage));
    match plan.short_cache() {
        Some(cache) => Ok(plan.with_waits(DiskSpeed::measure(folder)?, cache)),
        None => Ok(plan),
    }
}
