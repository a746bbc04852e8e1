//! What listeners are told adds up: stages begin before they advance, never do more than their total, and end.

use nystrom_stream::options::Cluster;
use nystrom_stream::{LabelTransfer, Matcher, Mesh, Progress, SamplingQuality, Segmenter, Sequencer};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// Total and done of the stages that are running; what is wrong.
#[derive(Default)]
struct Counts {
    running: Mutex<BTreeMap<String, (u64, u64)>>,
    begun: Mutex<usize>,
    wrong: Mutex<Vec<String>>,
}

impl Counts {
    fn wrong(&self, text: String) {
        self.wrong.lock().unwrap().push(text);
    }
}

impl Progress for Counts {
    fn begin(&self, stage: &str, _: &'static str, total: u64) {
        *self.begun.lock().unwrap() += 1;
        if self.running.lock().unwrap().insert(stage.into(), (total, 0)).is_some() {
            self.wrong(format!("{stage} begins twice"));
        }
    }

    fn advance(&self, stage: &str, done: u64) {
        match self.running.lock().unwrap().get_mut(stage) {
            Some(counts) => counts.1 += done,
            None => self.wrong(format!("{stage} advances without having begun")),
        }
    }

    fn end(&self, stage: &str, _: f64) {
        match self.running.lock().unwrap().remove(stage) {
            // Without a total, nobody knows.
            Some((total, done)) if total > 0 && done > total => self.wrong(format!("{stage}: {done} of {total}")),
            Some(_) => {}
            None => self.wrong(format!("{stage} ends without having begun")),
        }
    }
}

/// Runs `work` and checks what its listener is told.
fn adds_up<R>(name: &str, work: impl FnOnce(Arc<Counts>) -> nystrom_stream::Result<R>) {
    let counts = Arc::new(Counts::default());
    work(counts.clone()).unwrap();
    assert!(*counts.begun.lock().unwrap() > 0, "{name} has no stages");
    assert_eq!(*counts.wrong.lock().unwrap(), Vec::<String>::new(), "{name}");
    assert!(counts.running.lock().unwrap().is_empty(), "{name}: a stage does not end");
}

#[test]
fn stages_begin_before_they_advance_and_end() {
    let mesh = Mesh::creature(4_000).unwrap();
    for method in [Cluster::Parts, Cluster::KMeans, Cluster::TwoMeans] {
        adds_up(&format!("{method:?}"), |told| Segmenter::new().parts(4).method(method).progress(told).run(&mesh));
    }
    adds_up("sequence", |told| Sequencer::new().sweeps(2).progress(told).run(&mesh));
    adds_up("quality", |told| SamplingQuality::new().landmarks([5, 9]).seeds(2).progress(told).run(&mesh));
    let labels = vec![0; mesh.faces.len()];
    adds_up("transfer", |told| LabelTransfer::new().progress(told).run(&mesh, &labels, &mesh));
    adds_up("match", |told| Matcher::new().landmarks(20).progress(told).run(&mesh, &mesh));
}

#[test]
fn so_does_the_match_of_a_part() {
    // Regression: rows of anchors counted for rows that had ended, 51 of 50, and first matches for no stage at all.
    let whole = Mesh::creature(4_000).unwrap();
    let positions: Vec<[f64; 3]> = (0..whole.positions.len() as u32).map(|v| whole.positions.get(v)).collect();
    let mut faces = Vec::new();
    whole.faces.for_each(0..whole.faces.len() / 2, |_, corners| faces.push([corners[0], corners[1], corners[2]]));
    let part = Mesh::from_vecs(positions, faces).unwrap();
    adds_up("match", |told| Matcher::new().partial(true).landmarks(20).progress(told).run(&part, &whole));
}
