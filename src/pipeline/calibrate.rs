//! A short calibration: the recipe on two creatures smaller than the mesh, timed by stage.
//!
//! Costs about a second and some 20 MB of disk for as long; for meshes of more than four million faces a twentieth of what their run takes,
//! and some four seconds at the most.

use super::params::SegmentParams;
use super::plan::{CALIBRATION, MeshSize, Pace};
use super::recipe::segment;
use crate::apps::creature::{Creature, Options};
use crate::base::{Error, Progress, Result};
use crate::mesh;
use crate::mesh::geometry::no_faces;
use crate::mesh::ply::{Encoding, Kind};
use crate::mesh::{import, ply::header};
use crate::store::{Context, MappedBytes, Run, WorkDir};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;

/// Listens to nothing but the seconds of stages.
#[derive(Default)]
struct Clock(Mutex<BTreeMap<String, f64>>);

impl Progress for Clock {
    fn end(&self, stage: &str, seconds: f64) {
        *self.0.lock().unwrap_or_else(|poison| poison.into_inner()).entry(stage.to_string()).or_default() += seconds;
    }
}

/// Calibrating takes no more than this share of the run, but for small meshes.
const SHARE: u64 = 20;

/// The pace of each stage of [`super::plan::Plan`] on a mesh of `faces` faces, measured in a temporary folder inside `folder` on creatures of two
/// sizes, since some stages take a while whatever the size. Large meshes are cut in other ways than small ones (blocks of nodes, patches that
/// tell whether the surface is clean), so their creatures are large.
///
/// # Errors
/// As [`segment`].
pub fn calibrate(
    params: &SegmentParams,
    landmarks: usize,
    faces: u64,
    folder: &Path,
    run: &Run,
) -> Result<BTreeMap<String, Pace>> {
    let params = SegmentParams { landmarks: Some(landmarks), ..params.clone() };
    let faces = (faces / SHARE).clamp(CALIBRATION[0], CALIBRATION[1]);
    // The first run of all pays for pages and caches of the program itself.
    let few = seconds(&params, faces / 4, folder, run)?;
    let many = seconds(&params, faces, folder, run)?;
    let pace = |(name, &long): (&String, &f64)| {
        let short = few.1.get(name).copied().unwrap_or(0.);
        (name.clone(), Pace::through((few.0, short), (many.0, long)))
    };
    Ok(many.1.iter().map(pace).collect())
}

/// Faces of a creature of about `faces`, and the seconds of each stage on it.
fn seconds(params: &SegmentParams, faces: u64, folder: &Path, run: &Run) -> Result<(f64, BTreeMap<String, f64>)> {
    let clock = Clock::default();
    let quiet = Run {
        threads: run.threads,
        budget: run.budget.clone(),
        resident: run.resident,
        progress: &(),
        cancel: run.cancel.clone(),
        seed: run.seed,
    };
    let timed = Run { progress: &clock, ..quiet };
    let work = WorkDir::temporary(folder)?;
    let path = work.file("calibration.ply");
    let creature = Creature::new(&Options { faces, ..Options::default() })?;
    creature.write_ply(&path, &timed)?;
    let (opened, _) = timed.stage("read", "faces", faces, || mesh::open(&path, work.path(), &timed))?;
    segment(&opened, &serde_json::json!("calibration"), params, Context::new(&work, &timed))?;
    let seconds = clock.0.into_inner().unwrap_or_else(|poison| poison.into_inner());
    let mut by_stage: BTreeMap<String, f64> = BTreeMap::new();
    for (stage, seconds) in seconds {
        let name = match stage.as_str() {
            "generate" => continue,
            "normals" | "cells" => "surface",
            "assign" | "boundaries" | "cell rows" | "parts" => "labels",
            other => other,
        };
        *by_stage.entry(name.to_string()).or_default() += seconds;
    }
    Ok((creature.face_count() as f64, by_stage))
}

/// The size of the mesh in the file `path`, from its header and the file's size.
///
/// # Errors
/// [`Error::Io`], [`Error::Malformed`], [`Error::Unusable`].
pub fn size_of_mesh(path: &Path) -> Result<MeshSize> {
    let bytes = MappedBytes::open(path)?;
    let compressed = bytes.starts_with(&[0x1f, 0x8b]);
    let mut head = Vec::new();
    if compressed {
        use std::io::Read;
        let mut plain = flate2::bufread::MultiGzDecoder::new(&bytes[..]).take(1 << 16);
        plain.read_to_end(&mut head).map_err(Error::io(path, "decompress"))?;
    }
    if !import::is_ply(path, if compressed { &head } else { &bytes[..] }) {
        if compressed {
            let problem = "is compressed and no PLY, so its size shows only when it is read";
            return Err(Error::unusable(path, problem, "uncompress it first"));
        }
        if let Some(counts) = import::count(path, &bytes)? {
            if counts.faces == 0 {
                return Err(no_faces(path));
            }
            let import::Counts { vertices, faces, corners, .. } = counts;
            return Ok(MeshSize { faces, vertices, corners, decoded: counts.bytes() });
        }
    }
    let header = header::parse(path, if compressed { &head } else { &bytes })?;
    let count =
        |name: &str| header.elements.iter().find(|element| element.is(name)).map(|element| element.count as u64);
    let Some(vertices) = count("vertex") else {
        return Err(Error::malformed(path, "header", "there is no vertex element", "export the mesh again"));
    };
    // An empty element of faces may stand before one of strips.
    let some = |name: &str| count(name).filter(|&faces| faces > 0);
    let Some(faces) = some("face").or_else(|| some("tristrips")) else { return Err(no_faces(path)) };
    let least =
        header.elements.iter().map(|element| element.count as u128 * element.least_size().max(1) as u128).sum::<u128>();
    if !compressed && least > bytes.len() as u128 {
        let problem = format!("promises {least} bytes at the least, the file has {}", bytes.len());
        return Err(Error::malformed(path, "header", problem, "the file is cut short; get it again"));
    }
    let corners = 3 * faces;
    let in_place = header.encoding == Encoding::Little
        && header.elements.iter().filter(|element| element.is("face")).all(|element| {
            let lists = element.properties.iter().filter_map(|property| match property.kind {
                Kind::List { item, .. } => Some(item.size()),
                Kind::One(_) => None,
            });
            lists.eq([4])
        });
    let plain = u64::try_from(least).unwrap_or(u64::MAX / 4);
    let spooled = if compressed { plain + 4 * corners } else { 0 };
    let decoded = if in_place { 0 } else { 12 * vertices + 4 * corners };
    Ok(MeshSize { faces, vertices, corners, decoded: spooled + decoded })
}
