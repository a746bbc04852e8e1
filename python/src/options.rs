//! Keyword arguments into the library's parameters.

use nystrom_stream::cluster::parts::{PartCount, PartsParams};
use nystrom_stream::pipeline::{Cluster, SegmentParams};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// Keyword arguments of `segment` and `segment_file`.
#[derive(Default)]
pub struct Options {
    parts: Option<usize>,
    parts_range: Option<(usize, usize)>,
    detail: f64,
    cluster: Option<String>,
    pub landmarks: Option<usize>,
    coarse: bool,
    pub seed: u64,
    pub threads: Option<usize>,
    pub max_memory: Option<u64>,
    pub work_dir: Option<PathBuf>,
    pub tmp: Option<PathBuf>,
}

impl Options {
    pub fn of(parts: Option<usize>, given: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut options = Self { parts, ..Self::default() };
        for (name, value) in given.into_iter().flat_map(|given| given.iter()) {
            if value.is_none() {
                continue;
            }
            let name: String = name.extract()?;
            match name.as_str() {
                "parts_range" => options.parts_range = Some(value.extract()?),
                "detail" => options.detail = value.extract()?,
                "cluster" => options.cluster = Some(value.extract()?),
                "landmarks" => options.landmarks = Some(value.extract()?),
                "coarse" => options.coarse = value.extract()?,
                "seed" => options.seed = value.extract()?,
                "threads" => options.threads = Some(value.extract::<usize>()?.max(1)),
                "max_memory" => options.max_memory = Some(value.extract()?),
                "work_dir" => options.work_dir = Some(value.extract()?),
                "tmp" => options.tmp = Some(value.extract()?),
                _ => return Err(PyTypeError::new_err(format!("unexpected keyword argument '{name}'"))),
            }
        }
        Ok(options)
    }

    /// The same without what only cutting takes.
    pub fn of_run(given: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        for name in ["parts_range", "detail", "cluster", "coarse", "work_dir"] {
            if given.is_some_and(|given| given.contains(name).unwrap_or(false)) {
                return Err(PyTypeError::new_err(format!("unexpected keyword argument '{name}'")));
            }
        }
        Self::of(None, given)
    }

    pub fn params(&self) -> PyResult<SegmentParams> {
        let wrong = |text: String| Err(PyValueError::new_err(text));
        let count = match (self.parts, self.parts_range) {
            (Some(_), Some(_)) => return wrong("parts and parts_range exclude each other; give one".into()),
            (Some(parts), None) => PartCount::Exactly(parts),
            (None, Some((least, most))) => PartCount::Between(least, most),
            (None, None) => PartCount::Found,
        };
        let cluster = match self.cluster.as_deref() {
            None | Some("parts") => Cluster::Parts,
            Some("kmeans") => Cluster::KMeans,
            Some("two-means") => Cluster::TwoMeans,
            Some(other) => return wrong(format!("cluster: '{other}'; choose parts, kmeans or two-means")),
        };
        if !(-1. ..=1.).contains(&self.detail) {
            return wrong(format!("detail: {} is not within -1 and 1", self.detail));
        }
        if self.coarse && cluster != Cluster::Parts {
            return wrong("coarse goes with cluster='parts'".into());
        }
        Ok(SegmentParams {
            landmarks: self.landmarks,
            cluster,
            coarse: self.coarse,
            parts: PartsParams { count, detail: self.detail, ..PartsParams::default() },
            ..SegmentParams::default()
        })
    }
}
