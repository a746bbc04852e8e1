//! What edits of a cut are followed with on its page, as Python holds it.

use super::raised;
use nystrom_stream::pipeline::decision::KeptDecision;
use pyo3::prelude::*;

/// What a cut was decided with, and the part of each cell in it: none for a cut that was taken from the hierarchy. It becomes text
/// when it is pickled, and not before: that takes a while and megabytes.
#[pyclass(frozen, name = "Decision", module = "nystrom_stream._native")]
pub struct PyDecision {
    pub kept: KeptDecision,
    pub start: Vec<u32>,
}

#[pymethods]
impl PyDecision {
    #[new]
    fn new(text: &str, start: Vec<u32>) -> PyResult<Self> {
        Ok(Self { kept: KeptDecision::of_text(text).map_err(raised)?, start })
    }

    fn __getnewargs__(&self) -> PyResult<(String, Vec<u32>)> {
        Ok((self.kept.text().map_err(raised)?, self.start.clone()))
    }

    /// Itself: nothing changes it.
    fn __copy__(this: Py<Self>) -> Py<Self> {
        this
    }

    fn __deepcopy__(this: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        this
    }

    /// The same for another cut of its hierarchy.
    fn without_start(&self) -> Self {
        Self { kept: self.kept.clone(), start: Vec::new() }
    }
}
