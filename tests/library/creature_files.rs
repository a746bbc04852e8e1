//! The creature's files say what its functions say, whatever the threads, in any order, and
//! refusals are clear.

use nystrom_stream::apps::creature::{Creature, Options};
use nystrom_stream::base::{Cancel, Error, Progress};
use nystrom_stream::store::{Run, npy};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Positions and faces of a file just written, read the simple way.
fn read(path: &Path) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let bytes = std::fs::read(path).unwrap();
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = String::from_utf8(bytes[..end].to_vec()).unwrap();
    let count = |what: &str| -> usize {
        let line = header.lines().find(|line| line.starts_with(&format!("element {what} "))).unwrap();
        line.rsplit(' ').next().unwrap().parse().unwrap()
    };
    let (vertices, faces) = (count("vertex"), count("face"));
    assert_eq!(bytes.len(), end + 12 * vertices + 13 * faces);
    let word = |at: usize| -> [u8; 4] { bytes[at..at + 4].try_into().unwrap() };
    let points = (0..vertices).map(|v| [0, 4, 8].map(|k| f32::from_le_bytes(word(end + 12 * v + k)))).collect();
    let start = end + 12 * vertices;
    let faces = (0..faces)
        .map(|f| {
            assert_eq!(bytes[start + 13 * f], 3);
            [1, 5, 9].map(|k| u32::from_le_bytes(word(start + 13 * f + k)))
        })
        .collect();
    (points, faces)
}

fn write(options: &Options, folder: &Path, threads: usize) -> (Vec<[f32; 3]>, Vec<[u32; 3]>, Creature) {
    let creature = Creature::new(options).unwrap();
    let path = folder.join(format!("creature{threads}.ply"));
    let mut run = Run::new(&());
    run.threads = threads;
    creature.write_ply(&path, &run).unwrap();
    let (points, faces) = read(&path);
    (points, faces, creature)
}

#[test]
fn the_file_holds_what_the_functions_say_for_any_threads() {
    let dir = tempfile::tempdir().unwrap();
    for shuffle in [false, true] {
        let options = Options { faces: 90_000, noise: 0.05, holes: 3, shuffle, tiles: shuffle, seed: 2 };
        let (points, faces, creature) = write(&options, dir.path(), 1);
        assert_eq!((points.len() as u64, faces.len() as u64), (creature.vertex_count(), creature.face_count()));
        assert!(points.iter().enumerate().all(|(v, x)| creature.position(v as u64) == *x));
        assert!(faces.iter().enumerate().all(|(f, face)| creature.face(f as u64) == *face));
        let (more_points, more_faces, _) = write(&options, dir.path(), 3);
        assert!(points == more_points && faces == more_faces);
    }
}

#[test]
fn shuffling_permutes_faces_vertices_and_labels_together() {
    let plain = Creature::new(&Options { faces: 20_000, noise: 0.05, seed: 4, ..Options::default() }).unwrap();
    let mixed = Creature::new(&Options { faces: 20_000, noise: 0.05, seed: 4, shuffle: true, ..Options::default() });
    let mixed = mixed.unwrap();
    let soup = |creature: &Creature| {
        let mut all: Vec<([[u32; 3]; 3], u32)> = (0..creature.face_count())
            .map(|f| {
                let corners = creature.face(f).map(|v| creature.position(u64::from(v)).map(f32::to_bits));
                (corners, creature.truth(f))
            })
            .collect();
        all.sort_unstable();
        all
    };
    assert!(soup(&plain) == soup(&mixed), "the same triangles with the same labels");
    let jump: u64 = (1..1000).map(|f| u64::from(mixed.face(f)[0].abs_diff(mixed.face(f - 1)[0]))).sum();
    assert!(jump / 999 > mixed.vertex_count() / 5, "nearby faces must be far apart");
}

#[test]
fn labels_come_as_array_and_as_text() {
    let dir = tempfile::tempdir().unwrap();
    let creature = Creature::new(&Options { faces: 70_000, shuffle: true, ..Options::default() }).unwrap();
    let (array, text) = (dir.path().join("truth.npy"), dir.path().join("truth.seg"));
    creature.write_truth_npy(&array, &Run::new(&())).unwrap();
    creature.write_truth_seg(&text, &Run::new(&())).unwrap();
    let wanted: Vec<u32> = (0..creature.face_count()).map(|f| creature.truth(f)).collect();
    assert_eq!(*npy::open::<u32>(&array).unwrap(), wanted);
    let lines = std::fs::read_to_string(&text).unwrap();
    assert_eq!(lines.lines().map(|line| line.parse::<u32>().unwrap()).collect::<Vec<_>>(), wanted);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2, "no partial files left");
}

#[test]
fn numbers_are_right_far_beyond_32_bits_of_bytes() {
    let creature = Creature::new(&Options { faces: 4_200_000_000, shuffle: true, ..Options::default() }).unwrap();
    assert!(creature.face_count() >= 4_200_000_000);
    assert_eq!(creature.vertex_count(), creature.face_count() / 2 + 2);
    for face in [0, 1, 2_147_483_648, creature.face_count() - 1] {
        let corners = creature.face(face);
        assert!(corners.iter().all(|&v| u64::from(v) < creature.vertex_count()));
        let [a, b, c] = corners.map(|v| creature.position(u64::from(v)));
        let apart = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
        assert!(apart(a, b).max(apart(b, c)) < 5e-4, "corners of face {face} are near each other");
    }
}

#[test]
fn what_cannot_be_is_refused() {
    let refuse = |options: Options| match Creature::new(&options) {
        Err(Error::Parameter { name, .. }) => name,
        other => panic!("{other:?}"),
    };
    assert_eq!(refuse(Options { faces: 1 << 33, ..Options::default() }), "faces");
    assert_eq!(refuse(Options { faces: u64::from(u32::MAX) - 1, ..Options::default() }), "faces");
    assert_eq!(refuse(Options { holes: 10_000, ..Options::default() }), "holes");
    assert_eq!(refuse(Options { noise: f64::NAN, ..Options::default() }), "noise");
    let creature = Creature::new(&Options::default()).unwrap();
    let missing = creature.write_ply(Path::new("/nowhere/at/all.ply"), &Run::new(&()));
    assert!(matches!(missing, Err(Error::Io { .. })));
}

/// Cancels after the first chunk, and counts what was announced.
#[derive(Default)]
struct Impatient {
    cancel: Cancel,
    done: AtomicU64,
    stop: bool,
}

impl Progress for Impatient {
    fn advance(&self, stage: &str, done: u64) {
        assert_eq!(stage, "generate");
        self.done.fetch_add(done, Ordering::Relaxed);
        if self.stop {
            self.cancel.cancel();
        }
    }
}

#[test]
fn progress_is_told_and_cancelling_leaves_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("creature.ply");
    let creature = Creature::new(&Options { faces: 200_000, ..Options::default() }).unwrap();
    for stop in [true, false] {
        let listener = Impatient { stop, ..Impatient::default() };
        let mut run = Run::new(&listener);
        run.cancel = listener.cancel.clone();
        let result = creature.write_ply(&path, &run);
        if stop {
            assert!(matches!(result, Err(Error::Cancelled)));
            assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        } else {
            result.unwrap();
            let total = creature.face_count() + creature.vertex_count();
            assert_eq!(listener.done.load(Ordering::Relaxed), total);
        }
    }
}
