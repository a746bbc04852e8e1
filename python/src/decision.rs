//! What a cut was decided with, as Python holds it: other numbers of parts are taken from it, and edits followed on a page.

use super::{raised, text};
use numpy::{PyArray1, PyReadonlyArray1};
use nystrom_stream::pipeline::decision::KeptDecision;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyType};

/// The level of compression: the fastest. Higher ones take several times as long for a tenth less.
const LEVEL: u32 = 1;

/// What a cut was decided with, and the part of each cell in it: none for a cut that was taken from the hierarchy. It becomes text
/// when it is pickled, and not before: that takes a while and megabytes, of which compression leaves two fifths.
#[pyclass(frozen, name = "Decision", module = "nystrom_stream._native")]
pub struct PyDecision {
    pub kept: KeptDecision,
    pub start: Vec<u32>,
}

#[pymethods]
impl PyDecision {
    #[new]
    fn new(py: Python<'_>, packed: &Bound<'_, PyBytes>, start: Vec<u32>) -> PyResult<Self> {
        let text = String::from_utf8(py.import("zlib")?.call_method1("decompress", (packed,))?.extract()?)?;
        Ok(Self { kept: KeptDecision::of_text(&text).map_err(raised)?, start })
    }

    /// Pickled by every protocol.
    fn __reduce__<'py>(this: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyType>, (Bound<'py, PyAny>, Vec<u32>))> {
        let Self { kept, start } = this.get();
        let text = PyBytes::new(this.py(), kept.text().map_err(raised)?.as_bytes());
        Ok((this.get_type(), (this.py().import("zlib")?.call_method1("compress", (text, LEVEL))?, start.clone())))
    }

    /// Itself: nothing changes it.
    fn __copy__(this: Py<Self>) -> Py<Self> {
        this
    }

    fn __deepcopy__(this: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        this
    }

    /// The hierarchy of parts, as JSON.
    fn tree(&self) -> PyResult<String> {
        text(&self.kept.decision.tree)
    }

    /// The labels of all faces, whose `cells` are given, in `parts` parts.
    fn labels<'py>(
        &self,
        py: Python<'py>,
        cells: PyReadonlyArray1<'py, u32>,
        parts: usize,
    ) -> PyResult<Bound<'py, PyArray1<u32>>> {
        let label = self.kept.decision.tree.cut_k(parts).map_err(raised)?.label;
        let of_cell = |&cell: &u32| label.get(cell as usize).copied().unwrap_or(0);
        Ok(PyArray1::from_vec(py, cells.as_array().iter().map(of_cell).collect()))
    }

    /// The same for another cut of its hierarchy.
    fn without_start(&self) -> Self {
        Self { kept: self.kept.clone(), start: Vec::new() }
    }
}
