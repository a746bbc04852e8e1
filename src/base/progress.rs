//! How the library tells what it is doing; the command line draws bars from it.
//!
//! The silent implementation is `()`. Calls come from several threads; [`Progress::advance`] is
//! called once per chunk, never once per face.

/// A listener to stages. Every method does nothing by default.
pub trait Progress: Sync {
    /// A stage of `total` units (`unit`: "faces", "rows", "bytes") begins. `total` 0: unknown.
    fn begin(&self, _stage: &str, _unit: &'static str, _total: u64) {}
    /// `done` more units of the stage are finished.
    fn advance(&self, _stage: &str, _done: u64) {}
    /// The stage is finished after `seconds`.
    fn end(&self, _stage: &str, _seconds: f64) {}
    /// Something worth a line about the mesh or the result: an input oddity, an ambiguous match. Reports list it.
    fn note(&self, _text: &str) {}
    /// Something worth a line about the work: a stage reused, a share that is done already. By default told as a note.
    fn note_of_work(&self, text: &str) {
        self.note(text);
    }
}

impl Progress for () {}
