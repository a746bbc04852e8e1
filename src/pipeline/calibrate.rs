//! A short calibration: the recipe on synthetic creatures, timed by stage.
//!
//! They are treated like the mesh: contracted if it is, otherwise with rows over all faces. One has noise, and shows
//! what smoothing the normals of a rough surface costs. Creatures have no more landmarks, and no more parts of K-means
//! and 2-means, than usual; the cost of more of them is extrapolated. For a mesh below a million faces one smooth and
//! one rough creature are cut, in some one and a half times the time of the run. For a larger one there are smooth ones
//! of two sizes: three to six seconds, less than a tenth of the run above ten million faces. Some 20 MB of temporary
//! disk.

use super::params::{Cluster, SegmentParams, default_landmarks_for_faces, dimensions, landmarks_on_contraction};
use super::plan::StageTime;
use super::recipe::segment;
use crate::apps::creature::{Creature, Options};
use crate::base::parallel::lock;
use crate::base::{Progress, Result};
use crate::cluster::contract::{self, NODES};
use crate::cluster::parts::PartsParams;
use crate::mesh;
use crate::spectral::EmbeddingParams;
use crate::spectral::embedding::MOST_COLUMNS;
use crate::store::{Budget, Context, Run, WorkDir};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;

/// Records only the seconds of stages.
#[derive(Default)]
struct Clock(Mutex<BTreeMap<String, f64>>);

impl Progress for Clock {
    fn end(&self, stage: &str, seconds: f64) {
        *lock(&self.0).entry(stage.to_string()).or_default() += seconds;
    }
}

/// Number of faces from which the fixed part of the time is told from the part per face by creatures of two sizes; they
/// would take longer than a run over fewer.
const TWO_SIZES: u64 = 1_000_000;

/// Minimum number of faces of a creature; it has somewhat more than requested.
const LEAST: u64 = 3_550;

/// Minimum and maximum number of faces of the larger of two creatures.
const LARGE: [u64; 2] = [500_000, 5_000_000];

/// Maximum number of parts, and of coordinates, of K-means and 2-means on a creature. A thousand of each take minutes.
const MOST_CENTRES: usize = 30;

/// `params` with landmarks and centres capped to what calibrating has time for, but with the same decision on
/// contracting as for a mesh of `faces` faces.
fn calibrated(params: &SegmentParams, faces: usize) -> SegmentParams {
    let contracts = params.contracts(faces);
    let usual = if contracts { landmarks_on_contraction(usize::MAX) } else { default_landmarks_for_faces(faces) };
    let most = if params.cluster == Cluster::Parts { usize::MAX } else { MOST_CENTRES };
    let few = |embedding: EmbeddingParams| EmbeddingParams { dimensions: embedding.dimensions.min(most), ..embedding };
    let parts = PartsParams { count: params.parts.count.at_most(most), ..params.parts.clone() };
    SegmentParams {
        landmarks: params.landmarks.map(|l| l.min(usual)),
        embedding: params.embedding.map(few),
        exact: params.exact || !contracts,
        parts,
        ..params.clone()
    }
}

/// Approximate number of multiply-adds of K-means or 2-means under `params` over `nodes` nodes.
fn steps(params: &SegmentParams, nodes: f64) -> f64 {
    let l = params.landmarks.unwrap_or(1) as f64;
    let k = params.centres().unwrap_or(1) as f64;
    let d = l.min(params.embedding.map_or(dimensions(params), |embedding| embedding.dimensions) as f64);
    // Eight starts, each with candidates and four rounds, and some twenty rounds of two of them.
    let compared = |k: f64| k * (8. * (2. + libm::log(k)) + 8. * 4. + 2. * 20.);
    let compared = if params.cluster == Cluster::TwoMeans { compared(2.) * libm::log2(k).max(1.) } else { compared(k) };
    let fit = nodes.min(MOST_COLUMNS as f64) * (compared * d + l * l) + 10. * l.powi(3);
    fit + nodes * (l * (l + d + 4.) + k * d)
}

/// The larger of two creatures has at most one in this many of the mesh's faces.
const SHARE: u64 = 20;

/// Runs over creatures of fewer faces are so short that a momentary load can double them: each is repeated, and the
/// mean is used.
const TWICE_BELOW: u64 = 1_000_000;

/// Numbers of faces of the creatures for a mesh of `faces` faces: the same for a small mesh, otherwise one four times
/// the other. All are contracted if the mesh is.
fn sizes(faces: u64) -> [u64; 2] {
    if faces < TWO_SIZES {
        let contracted = contract::LARGE as u64;
        let one = (faces / 2).max(if faces <= contracted { LEAST } else { contracted + 1 });
        return [one, one];
    }
    let many = (faces / SHARE).clamp(LARGE[0], LARGE[1]);
    [many / 4, many]
}

/// Displacement of the vertices of the rough creature, as a share of the mean edge length.
const NOISE: f64 = 0.3;

/// The pace of each stage, by the names in [`super::plan::Plan`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Calibration {
    /// On a smooth surface.
    pub smooth: BTreeMap<String, StageTime>,
    /// On a rough one, whose normals are smoothed first.
    pub rough: BTreeMap<String, StageTime>,
}

/// The pace of each stage on a mesh of `faces` faces, measured in a temporary folder inside `folder`: for a large mesh
/// on creatures of two sizes, since some stages have a fixed cost. Large meshes use different methods than small ones
/// (blocks of nodes, patches to test whether the surface is clean), so their creatures are large. Unless the run's
/// directory is `lasting`, as large a share of a creature's arrays is kept in memory as of the mesh's.
///
/// # Errors
/// As [`segment`].
pub fn calibrate(
    params: &SegmentParams,
    landmarks: usize,
    faces: u64,
    folder: &Path,
    lasting: bool,
    run: &Run,
) -> Result<Calibration> {
    let [few, many] = sizes(faces);
    let of_two = few < many;
    let contracts = params.contracts(faces as usize);
    let asked = params.clone().landmarks((landmarks > 0).then_some(landmarks));
    let mut params = calibrated(&asked, faces as usize);
    // The creatures may have fewer faces than the mesh has parts.
    params.parts.count = params.parts.count.at_most(few.min(LARGE[0] / 4) as usize);
    let more_rows = landmarks as f64 / params.landmarks.unwrap_or(landmarks).max(1) as f64;
    let seconds = |size: u64, noise| {
        // Of a budget as small for the creature as that of the run is for the mesh.
        let held = if lasting { 0. } else { run.budget.total() as f64 * (size as f64 / faces as f64).min(1.) };
        seconds(&params, size, noise, folder, &Budget::new(held as u64), run)
    };
    let mean_seconds = |size, noise| -> Result<Timed> {
        let mut mean = seconds(size, noise)?;
        if of_two && size < TWICE_BELOW {
            for (stage, again) in seconds(size, noise)?.stages {
                mean.stages.entry(stage).and_modify(|mean| *mean = (*mean + again) / 2.);
            }
        }
        let nodes = if contracts { NODES as f64 } else { mean.faces };
        for (stage, seconds) in &mut mean.stages {
            *seconds *= match stage.as_str() {
                "rows" | "cell rows" => more_rows,
                "assign" => steps(&asked, nodes) / steps(&params, nodes),
                _ => 1.,
            };
        }
        Ok(mean)
    };
    if of_two {
        // A warm-up run: the first one pays for the program's own pages and caches, as a short run does, too.
        seconds(few.min(LARGE[0] / 4), 0.)?;
    }
    let (short, rough) = (mean_seconds(few, 0.)?, mean_seconds(few, NOISE)?);
    let larger = of_two.then(|| mean_seconds(many, 0.)).transpose()?;
    let long = larger.as_ref().unwrap_or(&short);
    let mut times = Calibration::default();
    for (stage, &seconds) in &long.stages {
        let is_fixed = if contracts { ON_CONTRACTION.contains(&stage.as_str()) } else { !of_two && stage == "parts" };
        let time = if is_fixed {
            StageTime { fixed: seconds, per_face: 0. }
        } else {
            let least = if of_two { (short.faces, short.of(stage)) } else { (0., 0.) };
            StageTime::through(least, (long.faces, seconds))
        };
        let name = planned_as(stage).to_string();
        *times.smooth.entry(name.clone()).or_default() += time;
        let more = (of_scans(stage) * rough.of(stage) - short.of(stage)).max(0.);
        let slower = StageTime { fixed: time.fixed + more, ..time };
        *times.rough.entry(name).or_default() += if is_fixed { slower } else { time.slower_by(more / short.faces) };
    }
    Ok(times)
}

/// How many times as long a stage takes on a scan as on the rough creature: its faces are in a poorer order, its
/// ensemble differs in more places, and its boundaries have more faces around them (ten scans of 25,000 to 1.7 million
/// faces, measured).
fn of_scans(stage: &str) -> f64 {
    match stage {
        "graph" => 1.3,
        "parts" => 2.,
        "boundaries" => 1.6,
        _ => 1.,
    }
}

/// Stages that take the same time on any contracted mesh: they run over the contraction, or over the landmarks' rows
/// there.
const ON_CONTRACTION: [&str; 5] = ["cells", "rows", "cell rows", "parts", "assign"];

/// The stage of [`super::plan::Plan`] to which a stage of the run belongs.
fn planned_as(stage: &str) -> &str {
    match stage {
        "normals" | "cells" => "surface",
        "assign" | "boundaries" | "cell rows" | "parts" => "labels",
        other => other,
    }
}

/// A timed run over a creature.
struct Timed {
    faces: f64,
    stages: BTreeMap<String, f64>,
}

impl Timed {
    /// Seconds of a stage; 0 if there was no such stage.
    fn of(&self, stage: &str) -> f64 {
        self.stages.get(stage).copied().unwrap_or(0.)
    }
}

/// The seconds of each stage on a creature of about `faces` faces; arrays are kept in memory as far as `held` allows.
fn seconds(params: &SegmentParams, faces: u64, noise: f64, folder: &Path, held: &Budget, run: &Run) -> Result<Timed> {
    let clock = Clock::default();
    let landmarks = params.landmarks.unwrap_or(0);
    let timed = Run {
        threads: run.threads,
        // The mesh may have fewer faces than the creature, and its landmarks would then need less memory.
        budget: Budget::new(run.budget.total().max(2 * params.cluster.fixed_bytes(landmarks as u64, faces))),
        resident: run.resident,
        progress: &clock,
        cancel: run.cancel.clone(),
        seed: run.seed,
    };
    let work = WorkDir::temporary(folder)?.holding(held);
    let path = work.file("calibration.ply");
    let creature = Creature::new(&Options { faces, noise, ..Options::default() })?;
    creature.write_ply(&path, &timed)?;
    let (opened, _) = timed.stage("read", "faces", faces, || mesh::open(&path, work.path(), &timed))?;
    segment(&opened, &serde_json::json!("calibration"), params, Context::new(&work, &timed))?;
    let mut stages = clock.0.into_inner().unwrap_or_else(|poison| poison.into_inner());
    stages.remove("generate");
    Ok(Timed { faces: creature.face_count() as f64, stages })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cluster::parts::PartCount;

    /// Regression: creatures were cut into as many parts as the mesh, so that `plan` with K-means took longer than the
    /// run, minutes for a thousand parts.
    #[test]
    fn calibrating_takes_no_longer_for_many_parts() {
        for cluster in [Cluster::KMeans, Cluster::TwoMeans] {
            for (parts, faces) in [(2, 10_000), (1_000, 30_000), (1_000, 67_080), (1_001, 67_080), (5_000, 10_000_000)]
            {
                let asked = SegmentParams::default().cluster(cluster);
                let count = PartCount::Exactly(parts);
                let asked = asked.parts(PartsParams { count, ..PartsParams::default() });
                let asked = asked.clone().landmarks(Some(asked.landmarks_of(faces)));
                let made = calibrated(&asked, faces);
                assert_eq!(made.contracts(faces), asked.contracts(faces), "{parts} parts of {faces} faces");
                let (steps, all) = (steps(&made, 3e4), steps(&asked, 3e4));
                assert!(steps < 2e10 && steps <= all, "{parts} parts of {faces} faces: {steps} steps of {all}");
                assert!(parts > 2 || steps == all);
            }
        }
        // Those of the default method cost nothing: they are another cut.
        let count = PartCount::Exactly(1_000);
        let asked = SegmentParams::default().parts(PartsParams { count, ..PartsParams::default() });
        assert_eq!(calibrated(&asked, 100_000).parts.count, count);
    }

    /// Regression: the smaller creature was not contracted when the mesh was, so extrapolation from the two was
    /// meaningless.
    #[test]
    fn creatures_are_contracted_if_the_mesh_is() {
        let contracted = |faces: u64| SegmentParams::default().contracts(faces as usize);
        for faces in [100, 3_000, 48_000, 60_000, 60_001, 100_000, 1_000_000, 100_000_000, 1_000_000_000] {
            let [few, many] = sizes(faces);
            let times = if faces < TWO_SIZES { 1 } else { 4 };
            assert!((times * few..=times * few + 3).contains(&many), "{few} and {many} for {faces}");
            for size in [few, many] {
                let made = Creature::new(&Options { faces: size, ..Options::default() }).unwrap().face_count();
                assert_eq!(contracted(made), contracted(faces), "{made} of {size} for {faces}");
            }
        }
    }

    /// Regression: calibrating cut seven creatures, in three to five seconds, for meshes that are cut in one.
    #[test]
    fn calibrating_cuts_fewer_faces_than_a_small_mesh_has() {
        for faces in [10_000, 25_000, 60_000, 270_000, 900_000] {
            let [few, many] = sizes(faces);
            assert!(few == many && 2 * few <= faces, "{few} and {many} for {faces}");
        }
    }
}
