//! The API at the root of the library: arrays and files give the same labels, nothing is written where memory allows,
//! results are kept where that is asked for, and the caller hears of progress and can stop.

use nystrom_stream::apps::evaluate::Evaluator;
use nystrom_stream::apps::picture::best_view;
use nystrom_stream::apps::sequence::{VertexUse, places};
use nystrom_stream::graph::DualGraph;
use nystrom_stream::mesh::Faces;
use nystrom_stream::mesh::split_faces::FaceSplit;
use nystrom_stream::options::{
    Boundaries, Cluster, Decision, Edit, Edits, EmbeddingParams, Kernel, Order, PartForm, Refine, SequenceOrder,
    UNLABELLED, Walls,
};
use nystrom_stream::pipeline::labels::Labels;
use nystrom_stream::store::{Context, Run, WorkDir};
use nystrom_stream::{
    Cancel, Error, LabelTransfer, Labelling, Matcher, Mesh, Progress, SamplingQuality, SaveOptions, Segmenter,
    Sequencer, evaluate,
};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

/// Remembers what it sees in a folder whenever it is called.
struct Watch {
    folder: PathBuf,
    calls: AtomicUsize,
    seen: Mutex<Vec<String>>,
}

impl Watch {
    fn of(folder: &tempfile::TempDir) -> Arc<Self> {
        let (calls, seen) = (AtomicUsize::new(0), Mutex::default());
        Arc::new(Self { folder: folder.path().to_path_buf(), calls, seen })
    }

    fn look(&self, stage: &str) {
        self.calls.fetch_add(1, Ordering::Relaxed);
        // A folder of its own, with nothing but its lock, may be there.
        let list = |path: &Path| -> Vec<PathBuf> {
            std::fs::read_dir(path).into_iter().flatten().flatten().map(|entry| entry.path()).collect()
        };
        let files =
            list(&self.folder).into_iter().flat_map(|path| if path.is_dir() { list(&path) } else { vec![path] });
        let files = files.filter(|path| path.file_name().is_some_and(|name| name != "lock"));
        self.seen.lock().unwrap().extend(files.map(|path| format!("{stage}: {}", path.display())));
    }
}

impl Progress for Watch {
    fn begin(&self, stage: &str, _: &'static str, _: u64) {
        self.look(stage);
    }

    fn advance(&self, stage: &str, _: u64) {
        self.look(stage);
    }

    fn end(&self, stage: &str, _: f64) {
        self.look(stage);
    }
}

#[test]
fn arrays_are_cut_without_a_file() {
    let mesh = Mesh::creature(4_000).unwrap();
    let both = [Cluster::Parts, Cluster::KMeans, Cluster::TwoMeans];
    for (method, order) in both.into_iter().flat_map(|method| [(method, Order::Keep), (method, Order::Hilbert)]) {
        let folder = tempfile::tempdir().unwrap();
        let watch = Watch::of(&folder);
        let segmenter = Segmenter::new().parts(5).method(method).order(order).temporary_folder(folder.path());
        let cut = segmenter.progress(watch.clone()).run(&mesh).unwrap();
        assert_eq!((cut.labels().len(), cut.confidences().len()), (mesh.faces.len(), mesh.faces.len()));
        assert_eq!(cut.hierarchy().is_some(), method == Cluster::Parts);
        watch.look("at the end");
        assert!(watch.calls.load(Ordering::Relaxed) > 10);
        assert_eq!(*watch.seen.lock().unwrap(), Vec::<String>::new(), "{method:?}, {order:?}");
    }
}

/// Panics in the loop over faces that gives each its cluster, which all threads take part in.
struct Panics;

impl Progress for Panics {
    fn advance(&self, stage: &str, _: u64) {
        assert_ne!(stage, "assign", "told to panic");
    }
}

/// A panic in a worker left the run waiting for ever, and its folder behind.
#[test]
fn a_panic_in_a_worker_ends_the_run_and_leaves_no_file() {
    let mesh = Mesh::creature(20_000).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let (scratch, work) = (dir.path().join("scratch"), dir.path().join("work"));
    std::fs::create_dir(&scratch).unwrap();
    let plain = Segmenter::new().parts(5).method(Cluster::KMeans).threads(3).temporary_folder(&scratch);
    // In memory, in temporary files, and in a directory that is kept.
    for segmenter in [plain.clone(), plain.clone().memory(1 << 20), plain.clone().work_dir(&work)] {
        let Err(error) = segmenter.progress(Arc::new(Panics)).run(&mesh) else { panic!("the panic was lost") };
        assert!(matches!(&error, Error::Internal { problem } if problem.contains("told to panic")), "{error}");
        assert_eq!(std::fs::read_dir(&scratch).unwrap().count(), 0);
    }
    let resumed = plain.clone().work_dir(&work).run(&mesh).unwrap();
    assert_eq!(resumed.labels(), plain.run(&mesh).unwrap().labels());
    // One at the beginning or the end of a stage went through the caller.
    for stage in ["graph", "assign"] {
        for begins in [true, false] {
            let segmenter = plain.clone().progress(Arc::new(PanicsAt { stage, begins }));
            let Err(error) = segmenter.run(&mesh) else { panic!("the panic was lost") };
            assert!(matches!(&error, Error::Internal { .. }), "{error}");
        }
    }
}

/// Panics at the beginning or the end of a stage.
struct PanicsAt {
    stage: &'static str,
    begins: bool,
}

impl Progress for PanicsAt {
    fn begin(&self, stage: &str, _: &'static str, _: u64) {
        assert!(!self.begins || stage != self.stage);
    }

    fn end(&self, stage: &str, _: f64) {
        assert!(self.begins || stage != self.stage);
    }
}

/// Stops the run when boundaries are refined.
struct StopsAfterBoundaries(Cancel);

impl Progress for StopsAfterBoundaries {
    fn end(&self, stage: &str, _: f64) {
        if stage == "boundaries" {
            self.0.cancel();
        }
    }
}

/// Regression: the manifest told of the old labels while new ones lay in their file, so they were called damaged.
#[test]
fn a_run_that_is_stopped_while_it_writes_labels_leaves_none() {
    let mesh = Mesh::creature(4_000).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let cut = |parts| Segmenter::new().parts(parts).work_dir(dir.path());
    cut(5).run(&mesh).unwrap();
    let read = || Labels::read(&WorkDir::open(dir.path()).unwrap());
    assert_eq!(read().unwrap().parts.len(), 5);
    let cancel = Cancel::default();
    let stopped = cut(7).cancel(cancel.clone()).progress(Arc::new(StopsAfterBoundaries(cancel))).run(&mesh);
    assert!(matches!(stopped, Err(Error::Cancelled)));
    let told = read().unwrap_err().to_string();
    assert!(told.contains("holds no labels"), "{told}");
    let again = cut(7).run(&mesh).unwrap().labels().to_vec();
    assert_eq!(again, read().unwrap().labels[..]);
}

#[test]
fn sequencing_arrays_writes_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let watch = Watch::of(&folder);
    let sequencer = Sequencer::new().temporary_folder(folder.path()).progress(watch.clone());
    let sequence = sequencer.run(&Mesh::creature(4_000).unwrap()).unwrap();
    let mut places = sequence.places().to_vec();
    places.sort_unstable();
    assert!(places.iter().zip(0..).all(|(&place, face)| place == face));
    assert_eq!(*watch.seen.lock().unwrap(), Vec::<String>::new());
}

/// A file that another took the place of since it was opened: the work directory got the stages of the one under the name
/// of the other, and later runs on the other took them for its own.
#[test]
fn a_work_directory_gets_no_stages_of_a_file_that_is_gone() {
    let dir = tempfile::tempdir().unwrap();
    let (path, other) = (dir.path().join("a.ply"), dir.path().join("b.ply"));
    let written = |mesh: Mesh, path: &Path| {
        let labelling =
            Labelling { labels: &vec![0; mesh.faces.len()], colours: &[], quality: None, names: &[], fine: None };
        mesh.save(path, labelling).unwrap();
    };
    written(Mesh::creature(3_528).unwrap(), &path);
    written(Mesh::creature(6_000).unwrap(), &other);
    let opened = Mesh::open(&path).unwrap();
    std::fs::rename(&other, &path).unwrap();
    let keeping = Segmenter::new().parts(3).work_dir(dir.path().join("work"));
    let told = keeping.run(&opened).unwrap_err().to_string();
    assert!(told.contains("a.ply: file: has changed since it was opened; open it again"), "{told}");
    let mesh = Mesh::open(&path).unwrap();
    assert_eq!(keeping.run(&mesh).unwrap().labels().len(), mesh.faces.len());
}

#[test]
fn files_arrays_and_work_directories_give_the_same_labels() {
    let dir = tempfile::tempdir().unwrap();
    let arrays = Mesh::creature(4_000).unwrap();
    let cut = Segmenter::new().parts(6).run(&arrays).unwrap();
    let file = dir.path().join("cut.ply");
    cut.save(&file).unwrap();
    let opened = Mesh::open(&file).unwrap();
    let keeping = Segmenter::new().parts(6).work_dir(dir.path().join("work"));
    let small = Segmenter::new().parts(6).memory(64 << 20).threads(1);
    for (name, segmenter) in
        [("file", Segmenter::new().parts(6)), ("work directory", keeping.clone()), ("small", small)]
    {
        let again = segmenter.run(&opened).unwrap();
        assert!(again.labels() == cut.labels() && again.colours() == cut.colours(), "{name}");
    }
    // Another number of parts takes what is kept: no rows are made.
    let fewer = keeping.parts(3).run(&opened).unwrap();
    assert!(!fewer.report().seconds.contains_key("rows") && cut.report().seconds.contains_key("rows"));
    let rough = cut.hierarchy().unwrap().labels(3).unwrap();
    assert!(evaluate(&opened, &rough, &[fewer.labels()]).unwrap().rand < 0.1);
    assert!(cut.hierarchy().unwrap().labels(0).is_err());
}

#[test]
fn files_are_saved_with_the_choices_that_their_form_leaves() {
    let dir = tempfile::tempdir().unwrap();
    let mesh = Mesh::creature(4_000).unwrap();
    let cut = Segmenter::new().parts(4).run(&mesh).unwrap();
    cut.save_with(dir.path().join("solids/"), &SaveOptions::new().cap(true).part_form(PartForm::Stl)).unwrap();
    let listed: serde_json::Value =
        serde_json::from_slice(&std::fs::read(dir.path().join("solids/parts.json")).unwrap()).unwrap();
    for part in listed["parts"].as_array().unwrap() {
        assert_eq!(part["caps"]["solid"], true, "{part}");
        assert!(
            part["caps"]["triangles"].as_u64().unwrap() > 0
                && dir.path().join("solids").join(part["file"].as_str().unwrap()).exists()
        );
    }
    assert_eq!(listed["parts"].as_array().unwrap().len(), 4);
    let sharp = dir.path().join("sharp.ply");
    cut.save_with(&sharp, &SaveOptions::new().split_vertices(true)).unwrap();
    assert!(Mesh::open(&sharp).unwrap().positions.len() > mesh.positions.len());
    // From arrays as from files: faces are split, and vertices are not copied.
    let smooth = dir.path().join("smooth.ply");
    cut.save_with(&smooth, &SaveOptions::new().split_faces(true)).unwrap();
    let smooth = Mesh::open(&smooth).unwrap();
    let labels = smooth.face_property("label", &Run::new(&())).unwrap();
    assert!(smooth.positions.len() > mesh.positions.len() && smooth.faces.len() > mesh.faces.len());
    assert_eq!(labels.iter().max(), cut.labels().iter().max());
    let wrong = [("a.seg", SaveOptions::new().vertex_labels(true)), ("a.ply", SaveOptions::new().cap(true))];
    for (name, options) in wrong.into_iter().chain([("parts/", SaveOptions::new().split_vertices(true))]) {
        let refused = cut.save_with(dir.path().join(name), &options);
        assert!(matches!(refused, Err(Error::Parameter { .. })) && !dir.path().join(name).exists(), "{name}");
    }
}

/// Stops the run at its first row, and counts rows.
#[derive(Default)]
struct StopsAtTheFirstRow {
    cancel: Cancel,
    rows: AtomicUsize,
}

impl Progress for StopsAtTheFirstRow {
    fn advance(&self, stage: &str, done: u64) {
        if stage == "rows" {
            self.cancel.cancel();
            self.rows.fetch_add(done as usize, Ordering::Relaxed);
        }
    }
}

/// Regression: a front looks for a stop every so many visits, which one over a small mesh never makes, so all of
/// thousands of rows were computed.
#[test]
fn a_stop_is_heeded_between_the_rows_of_a_small_mesh() {
    let mesh = Mesh::creature(4_000).unwrap();
    let listener = Arc::new(StopsAtTheFirstRow::default());
    let segmenter = Segmenter::new().landmarks(2_000).threads(1).cancel(listener.cancel.clone());
    let stopped = segmenter.progress(listener.clone()).run(&mesh);
    assert!(matches!(stopped, Err(Error::Cancelled)));
    assert!(listener.rows.load(Ordering::Relaxed) < 2_000);
}

#[test]
fn a_run_can_be_stopped_and_says_what_is_wrong() {
    let mesh = Mesh::creature(4_000).unwrap();
    let cancel = Cancel::default();
    cancel.cancel();
    assert!(matches!(Segmenter::new().cancel(cancel.clone()).run(&mesh), Err(Error::Cancelled)));
    assert!(matches!(Evaluator::stopped_by(&mesh, cancel), Err(Error::Cancelled)));
    assert!(matches!(Segmenter::new().parts(0).run(&mesh), Err(Error::Parameter { .. })));
    // Regression: the message about an empty path had nothing before its colon, and no message listed pages.
    let nowhere = Labelling { labels: &vec![0; mesh.faces.len()], colours: &[], quality: None, names: &[], fine: None };
    let told = mesh.save("", nowhere).unwrap_err().to_string();
    assert!(told.starts_with("path: \"\": unknown extension; use .ply") && told.contains(".html"), "{told}");
    assert!(matches!(Segmenter::new().parts(1 << 30).run(&mesh), Err(Error::Unusable { .. })));
    let wrong = Labelling { labels: &[0], colours: &[], quality: None, names: &[], fine: None };
    for name in ["a.seg", "a.npy", "a.ply", "a.glb", "a.xyz"] {
        assert!(matches!(mesh.save(name, wrong), Err(Error::Parameter { .. })), "{name}");
    }
}

/// Regression: every byte of the mesh was printed, and a million numbers of the decision.
#[test]
fn a_result_is_printed_without_its_arrays() {
    let cut = Segmenter::new().parts(3).run(&Mesh::creature(4_000).unwrap()).unwrap();
    let hierarchy = cut.hierarchy().unwrap();
    assert_eq!(format!("{hierarchy:?}"), format!("Hierarchy {{ faces: {}, .. }}", cut.labels().len()));
    let printed = format!("{cut:?}");
    assert!(printed.contains("MappedBytes { len: ") && printed.len() < 60_000, "{}: {printed}", printed.len());
}

/// Regression: the message began with a colon, since there was no file to name.
#[test]
fn edits_that_a_program_made_are_named() {
    let edits = Edits { edits: vec![Edit::Merge { at: Vec::new() }], ..Edits::default() };
    let error = Segmenter::new().edits(edits).run(&Mesh::creature(4_000).unwrap()).unwrap_err();
    assert!(error.to_string().starts_with("<edits>: edit 1 (merge): "), "{error}");
}

/// Labels beyond `i32` became negative in a PLY; colours and names of another labelling went into files unnoticed; an
/// order was written as a PLY under any ending.
#[test]
fn what_a_file_cannot_hold_and_options_without_effect_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
    let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]]).unwrap();
    let plain = Labelling { labels: &[0, 1], colours: &[], quality: None, names: &[], fine: None };
    let names = vec![String::from("a"); 3];
    let bad = [
        ("quality", "x.glb", Labelling { quality: Some(&[0.5]), ..plain }),
        ("colours", "x.obj", Labelling { colours: &[[1; 3]], ..plain }),
        ("names", "x.ply", Labelling { names: &names, ..plain }),
        ("labels", "x.ply", Labelling { labels: &[0, 1 << 31], ..plain }),
    ];
    let told = |result: nystrom_stream::Result<()>, option: &str| match result {
        Err(Error::Parameter { name, .. }) => assert_eq!(name, option),
        other => panic!("{option}: {other:?}"),
    };
    for (option, name, labelling) in bad {
        told(mesh.save(dir.path().join(name), labelling), option);
    }
    let great = Labelling { labels: &[0, (1 << 24) + 1], ..plain };
    told(mesh.save_with(dir.path().join("x.ply"), great, &SaveOptions::new().vertex_labels(true)), "labels");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    mesh.save(dir.path().join("x.ply"), great).unwrap();
    mesh.save(dir.path().join("x.npy"), Labelling { labels: &[0, u32::MAX], ..plain }).unwrap();
    for (option, segmenter) in [
        ("detail", Segmenter::new().parts(2).detail(0.5)),
        ("detail", Segmenter::new().method(Cluster::TwoMeans).detail(0.5)),
        // K-means took them without a word.
        ("walls", Segmenter::new().parts(2).method(Cluster::KMeans).walls(Walls::Own)),
        ("boundaries", Segmenter::new().parts(2).method(Cluster::KMeans).boundaries(Boundaries::Embedding)),
        ("small_part", Segmenter::new().parts(2).method(Cluster::KMeans).small_part(0.01)),
        ("ensemble_size", Segmenter::new().decision(Decision::Single).ensemble_size(20)),
        ("embedding", Segmenter::new().embedding(EmbeddingParams::for_parts(2))),
        ("landmarks", Segmenter::new().landmarks(0)),
        ("landmarks", Segmenter::new().landmarks(5000)),
        ("ensemble_size", Segmenter::new().ensemble_size(1 << 40)),
    ] {
        told(segmenter.run(&mesh).map(drop), option);
    }
    // These ended in failed allocations, in panics, or after minutes.
    told(SamplingQuality::new().seeds(u64::MAX).run(&mesh).map(drop), "seeds");
    told(Matcher::new().landmarks(1 << 20).run(&mesh, &mesh).map(drop), "landmarks");
    told(Sequencer::new().landmarks(2).run(&mesh).map(drop), "landmarks");
    told(Mesh::creature(2_100_000_000).map(drop), "faces");
    for threads in [usize::MAX / 8, usize::MAX] {
        SamplingQuality::new()
            .landmarks([2])
            .threads(threads)
            .memory(1 << 30)
            .run(&Mesh::creature(500).unwrap())
            .unwrap();
    }
    told(evaluate(&mesh, &[0, 1], &[[0, 1, 2]]).map(drop), "truth 1");
    let stop = Cancel::default();
    let order = Sequencer::new().cancel(stop.clone()).run(&Mesh::open(dir.path().join("x.ply")).unwrap()).unwrap();
    told(order.save(dir.path().join("order.xyz")), "path");
    // What stopped a run does not stop what is done with its result.
    stop.cancel();
    order.save(dir.path().join("order.ply")).unwrap();
}

/// Regression: whatever was short of memory, fewer landmarks were advised, also to `LabelTransfer`, which has none.
#[test]
fn fewer_landmarks_are_advised_where_there_are_some() {
    let mesh = Mesh::creature(3_528).unwrap();
    let told = |error: Error| {
        assert!(matches!(error, Error::Memory { .. }), "{error}");
        error.to_string()
    };
    let error = told(LabelTransfer::new().memory(1_000).run(&mesh, &vec![0; mesh.faces.len()], &mesh).unwrap_err());
    assert!(error.ends_with("raise `memory` or lower `threads`"), "{error}");
    let error = told(Matcher::new().landmarks(4_096).memory(1 << 20).run(&mesh, &mesh).unwrap_err());
    assert!(error.ends_with("raise `memory` or lower `threads` or `landmarks`"), "{error}");
}

/// Regression: a mesh that a program put together wrongly ended in a panic, a bug report, or, in `Sequencer`, in hours of
/// work on four billion vertices; one without faces was told to ask for fewer parts.
#[test]
fn a_mesh_whose_arrays_do_not_fit_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let good = Mesh::creature(3_528).unwrap();
    let polygons =
        |starts: Vec<u64>, corners: Vec<u32>| Faces::Polygons { starts: starts.into(), corners: corners.into() };
    let triangles = Faces::Triangles { bytes: vec![0u32; 3].into(), offset: 0, stride: 12, len: 2 };
    let beyond = good.positions.len() as u32;
    for (faces, problem) in [
        (polygons(vec![], vec![]), "starts: do not ascend from 0 to the 0 corners"),
        (polygons(vec![0], vec![]), "has no faces"),
        (polygons(vec![0, 3, 9], vec![0, 1, 2]), "starts: do not ascend from 0 to the 3 corners"),
        (polygons(vec![0, 3], vec![0, 1, beyond]), "faces[0]: names vertex 1766"),
        (triangles, "faces: 1 records of 12 bytes do not fit"),
    ] {
        let mesh = Mesh::new("made", good.positions.clone(), faces);
        assert!(mesh.check().unwrap_err().to_string().starts_with("made: "));
        let labels = vec![0; mesh.faces.len()];
        let told = |result: nystrom_stream::Result<()>| {
            let error = result.unwrap_err().to_string();
            assert!(error.contains(problem), "{problem}: {error}");
        };
        told(Segmenter::new().run(&mesh).map(drop));
        told(Sequencer::new().order(SequenceOrder::Keep).run(&mesh).map(drop));
        told(SamplingQuality::new().run(&mesh).map(drop));
        told(LabelTransfer::new().run(&mesh, &labels, &good).map(drop));
        told(LabelTransfer::new().run(&good, &vec![0; good.faces.len()], &mesh).map(drop));
        told(Matcher::new().run(&good, &mesh).map(drop));
        told(evaluate(&mesh, &labels, &[&labels]).map(drop));
        told(mesh.save(dir.path().join("x.obj"), Labelling::of(&labels)));
    }
    // Fields that were replaced.
    let mut mesh = good.clone();
    mesh.positions = Mesh::from_slices(&[[0f32; 3]; 3], &[[0, 1, 2]]).unwrap().positions;
    let told = Segmenter::new().run(&mesh).unwrap_err().to_string();
    assert!(told.contains("but there are 3, counted from 0"), "{told}");
}

/// Regression: these ended in panics, or in messages that began with a colon, lacked the number, or led to another error.
#[test]
fn errors_name_what_was_given_and_a_remedy_that_helps() {
    let run = Run::new(&());
    let mesh = Mesh::creature(3_528).unwrap();
    let labels = vec![0; mesh.faces.len()];
    let (short, long) = (&labels[1..], [&labels[..], &[0]].concat());
    for wrong in [short, &long] {
        assert!(matches!(FaceSplit::of(&mesh, wrong, &run), Err(Error::Parameter { name, .. }) if name == "labels"));
        let split = FaceSplit::of(&mesh, &labels, &run).unwrap();
        assert!(matches!(split.applied(&mesh, wrong, None, &run), Err(Error::Parameter { .. })));
        let quality = vec![1f32; wrong.len()];
        let refused = split.applied(&mesh, &labels, Some(&quality), &run);
        assert!(matches!(refused, Err(Error::Parameter { name, .. }) if name == "quality"));
    }
    let told = |result: nystrom_stream::Result<()>, text: &str| {
        let error = result.unwrap_err().to_string();
        assert!(error.starts_with(text), "{error}");
    };
    let work = WorkDir::in_memory(&std::env::temp_dir(), &run.budget);
    let context = Context::new(&work, &run);
    told(VertexUse::of(&mesh, short, context).map(drop), "place: ");
    told(places("places", &mesh, &[0], context).map(drop), "rank: ");
    told(best_view(&mesh, Some(short), 1, &run).map(drop), "labels: ");
    // It divided by 0; and it looked for a corner beyond the last for ever.
    let none = Run { threads: 0, ..Run::new(&()) };
    DualGraph::build(&mesh, "mesh".as_ref(), &"mesh".into(), Context::new(&work, &none)).unwrap();
    let quads = Mesh::from_slices(&[[0f32; 3]; 4], &[[0, 1, 2, 3], [3, 2, 1, 0]]).unwrap();
    assert_eq!(quads.faces.face_of_corner(99), 1);
    let none = vec![UNLABELLED; mesh.faces.len()];
    told(LabelTransfer::new().run(&mesh, &none, &mesh).map(drop), "labels: no face has a label");
    told(Segmenter::new().work_dir("").run(&mesh).map(drop), "\"\": cannot ");
    told(Mesh::open("").map(drop), "\"\": cannot open: ");
    told(SamplingQuality::new().kernel(Kernel::Gaussian, -1.).run(&mesh).map(drop), "width: -1 is not a positive");
    for faces in [1 << 33, 2_000_000_000] {
        let Err(Error::Parameter { remedy, .. }) = Mesh::creature(faces) else { panic!("not refused") };
        assert_eq!(remedy, "request at most 1417339143");
    }
}

#[test]
fn a_report_says_that_rows_are_over_all_faces() {
    // Regression: boundaries by the embedding need such rows, but only the program said so in its reports and work
    // directories.
    let mesh = Mesh::creature(4_000).unwrap();
    for (boundaries, exact) in [(Boundaries::Embedding, true), (Boundaries::Front, false)] {
        let cut = Segmenter::new().parts(4).boundaries(boundaries).run(&mesh).unwrap();
        assert_eq!(cut.report().options["exact"], exact);
    }
}

/// Regression: matrices among landmarks were allocated whatever the budget, 121 MB of 16 MiB for 1,500 landmarks.
#[test]
fn what_many_landmarks_take_must_fit_the_budget() {
    let mesh = Mesh::creature(4_000).unwrap();
    let small = 16 << 20;
    let told = [
        Matcher::new().landmarks(1_500).memory(small).run(&mesh, &mesh).map(drop).unwrap_err(),
        SamplingQuality::new().landmarks([1_500]).memory(small).run(&mesh).map(drop).unwrap_err(),
    ];
    for error in told {
        let text = error.to_string();
        assert!(matches!(error, Error::Memory { .. }) && text.contains("so many landmarks"), "{text}");
    }
    // What the defaults take lies beside the budget.
    SamplingQuality::new().memory(1 << 20).run(&mesh).unwrap();
    let found = |memory| Matcher::new().refine(Refine::None).landmarks(300).memory(memory).run(&mesh, &mesh).unwrap();
    assert_eq!(found(small).matches(), found(1 << 30).matches());
}

/// Regression: reports and records took a kilobyte per part whatever the budget.
#[test]
fn what_many_parts_take_must_fit_the_budget() {
    let mesh = Mesh::creature(100_000).unwrap();
    let error = Segmenter::new().parts(60_000).memory(16 << 20).run(&mesh).map(drop).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, Error::Memory { .. }) && text.contains("so many parts"), "{text}");
    Segmenter::new().parts(6).memory(16 << 20).run(&mesh).unwrap();
}
