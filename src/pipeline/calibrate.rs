//! A short calibration: the recipe on two creatures, timed by stage.
//!
//! Both go the mesh's way: contracted if it is, over all faces if it is not. A third one has noise, and tells what normals of a rough surface
//! take. Costs one to five seconds and some 20 MB of disk for as long; for meshes of more than ten million faces less than a tenth of what
//! their run takes, and some six seconds at the most.

use super::input::is_pipe;
use super::params::SegmentParams;
use super::plan::{MeshSize, Pace};
use super::recipe::segment;
use crate::apps::creature::{Creature, Options};
use crate::base::{Error, Progress, Result};
use crate::cluster::contract;
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

/// Faces of the larger creature for a mesh that is not large enough to be contracted, at the least and at the most: more than asked for are made.
const SMALL: [u64; 2] = [14_200, 48_000];

/// Faces of the larger creature for a larger mesh: half a million at the least, if the mesh has so many, and five million at the most.
const LARGE: [u64; 2] = [500_000, 5_000_000];

/// Calibrating takes no more than this share of the run, but for small meshes.
const SHARE: u64 = 20;

/// Runs over creatures of fewer faces are short enough for a moment's load to double them: each is done again, and the mean counts.
const TWICE_BELOW: u64 = 1_000_000;

/// Faces of the two creatures for a mesh of `faces` faces. Both are contracted if it is.
fn sizes(faces: u64) -> [u64; 2] {
    if faces <= contract::LARGE as u64 {
        let many = faces.clamp(SMALL[0], SMALL[1]);
        return [many / 4, many];
    }
    let many = (faces / SHARE).clamp(LARGE[0].min(faces), LARGE[1]);
    [(many / 4).max(contract::LARGE as u64 + 1), many]
}

/// Displacement of the vertices of the rough creature, as a share of the mean edge length.
const NOISE: f64 = 0.3;

/// What stages take, by the names of [`super::plan::Plan`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Calibration {
    /// On a smooth surface.
    pub smooth: BTreeMap<String, Pace>,
    /// On a rough one, whose normals are smoothed first.
    pub rough: BTreeMap<String, Pace>,
}

/// The pace of each stage on a mesh of `faces` faces, measured in a temporary folder inside `folder` on creatures of two sizes, since some
/// stages take a while whatever the size. Large meshes are cut in other ways than small ones (blocks of nodes, patches that tell whether the
/// surface is clean), so their creatures are large.
///
/// # Errors
/// As [`segment`].
pub fn calibrate(
    params: &SegmentParams,
    landmarks: usize,
    faces: u64,
    folder: &Path,
    run: &Run,
) -> Result<Calibration> {
    let params = SegmentParams { landmarks: Some(landmarks), ..params.clone() };
    let mean_seconds = |size, noise| -> Result<Timed> {
        let mut mean = seconds(&params, size, noise, folder, run)?;
        if size < TWICE_BELOW {
            for (stage, again) in seconds(&params, size, noise, folder, run)?.stages {
                mean.stages.entry(stage).and_modify(|mean| *mean = (*mean + again) / 2.);
            }
        }
        Ok(mean)
    };
    let [few, many] = sizes(faces);
    // The first run of all pays for pages and caches of the program itself.
    seconds(&params, few.min(LARGE[0] / 4), 0., folder, run)?;
    let (short, rough, long) = (mean_seconds(few, 0.)?, mean_seconds(few, NOISE)?, mean_seconds(many, 0.)?);
    let contracts = params.contracts(faces as usize);
    let mut paces = Calibration::default();
    for (stage, &seconds) in &long.stages {
        let pace = if contracts && ON_CONTRACTION.contains(&stage.as_str()) {
            Pace { fixed: seconds, per_face: 0. }
        } else {
            Pace::through((short.faces, short.of(stage)), (long.faces, seconds))
        };
        let name = planned_as(stage).to_string();
        *paces.smooth.entry(name.clone()).or_default() += pace;
        let more = (rough.of(stage) - short.of(stage)).max(0.) / short.faces;
        *paces.rough.entry(name).or_default() += pace.slower_by(more);
    }
    Ok(paces)
}

/// What takes as long on any mesh that is contracted: it goes over the contraction, or over the landmarks' rows there.
const ON_CONTRACTION: [&str; 5] = ["cells", "rows", "cell rows", "parts", "assign"];

/// The stage of [`super::plan::Plan`] that a stage of the run belongs to.
fn planned_as(stage: &str) -> &str {
    match stage {
        "normals" | "cells" => "surface",
        "assign" | "boundaries" | "cell rows" | "parts" => "labels",
        other => other,
    }
}

/// A run over a creature.
struct Timed {
    faces: f64,
    stages: BTreeMap<String, f64>,
}

impl Timed {
    /// Seconds of a stage; none if there was no such stage.
    fn of(&self, stage: &str) -> f64 {
        self.stages.get(stage).copied().unwrap_or(0.)
    }
}

/// The seconds of each stage on a creature of about `faces` faces.
fn seconds(params: &SegmentParams, faces: u64, noise: f64, folder: &Path, run: &Run) -> Result<Timed> {
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
    let creature = Creature::new(&Options { faces, noise, ..Options::default() })?;
    creature.write_ply(&path, &timed)?;
    let (opened, _) = timed.stage("read", "faces", faces, || mesh::open(&path, work.path(), &timed))?;
    segment(&opened, &serde_json::json!("calibration"), params, Context::new(&work, &timed))?;
    let mut stages = clock.0.into_inner().unwrap_or_else(|poison| poison.into_inner());
    stages.remove("generate");
    Ok(Timed { faces: creature.face_count() as f64, stages })
}

/// The faces that strips of triangles hold at the most in a file of `len` bytes: the header counts strips, and each further vertex makes a
/// face. A vertex has two bytes of text at the least; compressed data are taken for plain ones.
fn faces_of_strips(header: &header::Header, len: u64) -> u64 {
    let left = len.saturating_sub(header.payload as u64);
    if header.encoding == Encoding::Ascii {
        return left / 2;
    }
    let fixed = |element: &header::Element| element.count as u128 * element.least_size() as u128;
    let fixed: u128 = header.elements.iter().map(fixed).sum();
    let strips = header.elements.iter().filter(|element| element.is("tristrips"));
    let kinds = strips.flat_map(|element| &element.properties).map(|property| property.kind);
    let items =
        kinds.filter_map(|kind| if let Kind::List { item, .. } = kind { Some(item.size() as u64) } else { None });
    left.saturating_sub(u64::try_from(fixed).unwrap_or(u64::MAX)) / items.min().unwrap_or(4)
}

/// The size of the mesh in the file `path`, from its header and the file's size. Of strips of triangles it tells what they hold at the most.
///
/// # Errors
/// [`Error::Io`], [`Error::Malformed`], [`Error::Unusable`].
pub fn size_of_mesh(path: &Path) -> Result<MeshSize> {
    if is_pipe(path) {
        return Err(Error::unusable(path, "is a pipe, whose size shows only when it is read", "name a file"));
    }
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
            return Ok(MeshSize { faces, vertices, corners, decoded: counts.bytes(), strips: false });
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
    let listed = some("face");
    let in_strips = || some("tristrips").map(|strips| strips.max(faces_of_strips(&header, bytes.len() as u64)));
    let Some(faces) = listed.or_else(in_strips) else { return Err(no_faces(path)) };
    let least =
        header.elements.iter().map(|element| element.count as u128 * element.least_size().max(1) as u128).sum::<u128>();
    if !compressed && least > bytes.len() as u128 {
        let problem = format!("promises {least} bytes at the least, the file has {}", bytes.len());
        return Err(Error::malformed(path, "header", problem, "the file is cut short; get it again"));
    }
    let corners = faces.saturating_mul(3);
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
    Ok(MeshSize { faces, vertices, corners, decoded: spooled + decoded, strips: listed.is_none() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The smaller creature was not contracted where the mesh was, and the line through both told nonsense of it.
    #[test]
    fn both_creatures_are_contracted_if_the_mesh_is() {
        let contracted = |faces: u64| SegmentParams::default().contracts(faces as usize);
        for faces in [100, 3_000, 48_000, 60_000, 60_001, 100_000, 1_000_000, 100_000_000, 1_000_000_000] {
            for size in sizes(faces) {
                let made = Creature::new(&Options { faces: size, ..Options::default() }).unwrap().face_count();
                assert_eq!(contracted(made), contracted(faces), "{made} of {size} for {faces}");
            }
        }
    }

    /// Noise costs normals, and no stage is lost on the way to the plan.
    #[test]
    fn a_rough_surface_takes_longer_than_a_smooth_one() {
        let folder = tempfile::tempdir().unwrap();
        let params = SegmentParams::default();
        let paces = calibrate(&params, 20, 20_000, folder.path(), &Run::new(&())).unwrap();
        assert!(["graph", "surface", "weights", "rows", "labels"].iter().all(|&name| paces.smooth.contains_key(name)));
        for (stage, rough) in &paces.rough {
            assert!(rough.of(20_000) >= paces.smooth[stage].of(20_000), "{stage}");
        }
    }
}
