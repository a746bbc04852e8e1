//! A Parquet table of the faces, for DuckDB, pandas, Polars, Spark; and the writer used for other tables.
//!
//! One row per face in file order: `face`, `label` (unsigned, 32 bits), `area` (in the squared unit of the file),
//! `centroid_x`, `centroid_y`, `centroid_z`, `quality` if there is one, `name` (of the part) if parts have names, and
//! `embedding_0` … if given. Rows are written in groups of [`GROUP`]. The columns of a group are encoded in parallel,
//! as many at a time as there are threads: memory is 32 bytes per row of a group, and 24 per thread. About 45 bytes
//! per face on disk.

use crate::base::vector::{area, finite};
use crate::base::{Error, Result};
use crate::mesh::output::publish;
use crate::mesh::{Labelling, Mesh, polygon};
use crate::store::Run;
use crate::store::budget::Grant;
use bytes::Bytes;
use parquet::basic::Encoding;
use parquet::column::writer::{ColumnCloseResult, ColumnWriter, get_column_writer, get_typed_column_writer_mut};
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int32Type};
use parquet::errors::ParquetError;
use parquet::file::properties::{WriterProperties, WriterPropertiesBuilder, WriterPropertiesPtr};
use parquet::file::writer::{SerializedFileWriter, SerializedPageWriter, TrackedWrite};
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::ColumnPath;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::Arc;

/// Rows per group: enough for readers to skip and to parallelise, few enough to hold in memory.
pub const GROUP: usize = 1 << 18;

/// Rows that a thread measures, or passes to an encoder, at a time.
const CHUNK: usize = 1 << 14;

type Out<'a> = BufWriter<&'a mut File>;

/// Bytes per row of a group and thread for the encoder's output of a column.
const BYTES_PER_THREAD: u64 = 24;

/// `run` on as many threads as the budget has room for in groups of a table of `rows`, and the grant: `held` bytes per
/// row of a group plus [`BYTES_PER_THREAD`] per thread.
///
/// # Errors
/// [`Error::Memory`] if there is no room for one thread.
pub fn threads_for_groups<'a>(rows: usize, held: u64, run: &Run<'a>) -> Result<(Run<'a>, Grant)> {
    let [held, each] = [held, BYTES_PER_THREAD].map(|bytes| bytes * GROUP.min(rows) as u64);
    run.some_threads("a group of rows of the .parquet file", held, each)
}

/// A file being written.
pub struct Writer<'a> {
    path: &'a Path,
    properties: WriterPropertiesPtr,
    inner: SerializedFileWriter<Out<'a>>,
}

/// A column of a group of rows: passes its values to a writer.
pub type Column<'a> = Box<dyn Fn(&mut ColumnWriter<'_>) -> Result<(), ParquetError> + Sync + 'a>;

/// A column of `values`.
pub fn column<'a, T: DataType, V: Iterator<Item = T::T>>(values: impl Fn() -> V + Sync + 'a) -> Column<'a> {
    Box::new(move |writer| {
        let (mut values, mut some) = (values(), Vec::with_capacity(CHUNK));
        loop {
            some.clear();
            some.extend(values.by_ref().take(CHUNK));
            if some.is_empty() {
                return Ok(());
            }
            get_typed_column_writer_mut::<T>(writer).write_batch(&some, None, None)?;
        }
    })
}

fn wrong(path: &Path) -> impl Fn(ParquetError) -> Error {
    move |error| {
        let error = match error {
            ParquetError::External(source) => match source.downcast::<std::io::Error>() {
                Ok(source) => *source,
                Err(source) => std::io::Error::other(source.to_string()),
            },
            other => std::io::Error::other(other.to_string()),
        };
        Error::io(path, "write")(error)
    }
}

impl<'a> Writer<'a> {
    /// Starts `file`, whose path is `path`, with columns of the given message type.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn new(path: &'a Path, file: &'a mut File, schema: &str, properties: WriterPropertiesBuilder) -> Result<Self> {
        let schema = parse_message_type(schema).map_err(wrong(path))?;
        let properties = properties.set_created_by(format!("nystrom-stream {}", env!("CARGO_PKG_VERSION"))).build();
        let properties = Arc::new(properties);
        let out = BufWriter::with_capacity(1 << 20, file);
        let inner = SerializedFileWriter::new(out, Arc::new(schema), Arc::clone(&properties)).map_err(wrong(path))?;
        Ok(Self { path, properties, inner })
    }

    /// Writes a group with `columns` in the order of the message type, on the threads of `run`.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Cancelled`].
    pub fn group(&mut self, columns: &[Column<'_>], run: &Run) -> Result<()> {
        let schema = self.inner.schema_descr().clone();
        let (path, properties) = (self.path, &self.properties);
        let encode = |k: usize| -> Result<(Bytes, ColumnCloseResult), ParquetError> {
            let mut out = TrackedWrite::new(Vec::new());
            let pages = Box::new(SerializedPageWriter::new(&mut out));
            let mut writer = get_column_writer(schema.column(k), Arc::clone(properties), pages);
            columns[k](&mut writer)?;
            let chunk = writer.close()?;
            Ok((Bytes::from(out.into_inner()?), chunk))
        };
        let mut group = self.inner.next_row_group().map_err(wrong(path))?;
        for first in (0..columns.len()).step_by(run.threads.max(1)) {
            let some = run.threads.max(1).min(columns.len() - first);
            for (bytes, chunk) in run.map_chunks(some, || (), |k, ()| encode(first + k).map_err(wrong(path)))? {
                group.append_column(&bytes, chunk).map_err(wrong(path))?;
            }
        }
        group.close().map(drop).map_err(wrong(path))
    }

    /// Ends the file.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn finish(self) -> Result<()> {
        let mut out = self.inner.into_inner().map_err(wrong(self.path))?;
        out.flush().map_err(Error::io(self.path, "write"))
    }
}

/// Coordinates per face in some embedding.
#[derive(Clone, Copy, Debug)]
pub struct Coordinates<'a> {
    /// Row by row (n × dimensions).
    pub values: &'a [f32],
    /// Coordinates per face.
    pub dimensions: usize,
}

/// Area and centroid of a polygon, as [triangles](polygon::triangles); without area, the centroid is the mean of the
/// corners. A polygon with a non-finite corner has no area, and the mean is that of the other corners.
///
/// ```
/// use nystrom_stream::apps::export::parquet::measure;
/// let (area, centroid) = measure(&[[0., 0., 0.], [2., 0., 0.], [2., 1., 0.], [0., 1., 0.]]);
/// assert_eq!((area, centroid), (2., [1., 0.5, 0.]));
/// ```
pub fn measure(corners: &[[f64; 3]]) -> (f64, [f64; 3]) {
    let (mut whole, mut moment, mut mean) = (0., [0.; 3], [0.; 3]);
    let placed = corners.iter().filter(|corner| finite(**corner)).count();
    for corner in corners.iter().filter(|corner| finite(**corner)) {
        (0..3).for_each(|axis| mean[axis] += corner[axis] / placed as f64);
    }
    if placed < corners.len() {
        return (0., if placed > 0 { mean } else { [f64::NAN; 3] });
    }
    polygon::triangles(corners, |triangle| whole += area(triangle.map(|k| corners[k])));
    // Moments of very large or very small polygons would overflow or underflow.
    let unit = if (1e-150..1e150).contains(&whole) { 1. } else { whole };
    polygon::triangles(corners, |triangle| {
        let [a, b, c] = triangle.map(|k| corners[k]);
        let part = area([a, b, c]) / unit;
        (0..3).for_each(|axis| moment[axis] += part * (a[axis] + b[axis] + c[axis]) / 3.);
    });
    let centroid = moment.map(|x| x / (whole / unit));
    (whole, if whole > 0. && finite(centroid) { centroid } else { mean })
}

/// Writes the table to `path`, by rename.
///
/// ```
/// use nystrom_stream::apps::export::parquet;
/// use nystrom_stream::mesh::{Labelling, Mesh};
/// use nystrom_stream::store::Run;
/// let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
/// let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]])?;
/// let labelling = Labelling { labels: &[0, 1], colours: &[], quality: None, names: &[], fine: None };
/// parquet::write(&std::env::temp_dir().join("square.parquet"), &mesh, &labelling, None, &Run::new(&()))?;
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
///
/// # Errors
/// [`Error::Parameter`] for labels, qualities or coordinates that do not match the faces; [`Error::Io`];
/// [`Error::Cancelled`].
pub fn write(path: &Path, mesh: &Mesh, labelling: &Labelling, embedding: Option<Coordinates>, run: &Run) -> Result<()> {
    let n = mesh.faces.len();
    labelling.fit(n)?;
    let len = embedding.map_or(n, |e| e.values.len() / e.dimensions.max(1));
    if len != n {
        return Err(Error::parameter("embedding", format!("{len} rows for {n} faces"), "give one for every face"));
    }
    let (run, _grant) = threads_for_groups(n, 32, run)?;
    publish(path, 0, |file| FaceTable { path, mesh, labelling, embedding, run: &run }.write(file))
}

/// The data of the table.
struct FaceTable<'a> {
    path: &'a Path,
    mesh: &'a Mesh,
    labelling: &'a Labelling<'a>,
    embedding: Option<Coordinates<'a>>,
    run: &'a Run<'a>,
}

impl FaceTable<'_> {
    fn schema(&self) -> String {
        let mut text = String::from("message faces { required int32 face (INTEGER(32, false));");
        text += " required int32 label (INTEGER(32, false)); required double area;";
        ["x", "y", "z"].iter().for_each(|axis| text += &format!(" required double centroid_{axis};"));
        if self.labelling.quality.is_some() {
            text += " required float quality;";
        }
        if !self.labelling.names.is_empty() {
            text += " required binary name (UTF8);";
        }
        let dimensions = self.embedding.map_or(0, |embedding| embedding.dimensions);
        (0..dimensions).for_each(|k| text += &format!(" required float embedding_{k};"));
        text + " }"
    }

    fn write(&self, file: &mut File) -> Result<()> {
        let properties = WriterProperties::builder()
            // A dictionary does not pay for numbers that hardly repeat; labels do repeat, and face numbers are
            // consecutive.
            .set_dictionary_enabled(false)
            .set_column_dictionary_enabled(ColumnPath::from("label"), true)
            .set_column_dictionary_enabled(ColumnPath::from("name"), true)
            // Each name is written once per group, however long.
            .set_column_dictionary_page_size_limit(ColumnPath::from("name"), usize::MAX)
            .set_column_encoding(ColumnPath::from("face"), Encoding::DELTA_BINARY_PACKED);
        let schema = self.schema();
        let mut writer = Writer::new(self.path, file, &schema, properties)?;
        let n = self.mesh.faces.len();
        for start in (0..n).step_by(GROUP) {
            self.run.cancel.check()?;
            self.group(start, n.min(start + GROUP), &mut writer)?;
        }
        writer.finish()
    }

    /// The rows `start..end`.
    fn group(&self, start: usize, end: usize, writer: &mut Writer) -> Result<()> {
        let labels = &self.labelling.labels[start..end];
        let mut measures = vec![[0.; 4]; end - start];
        self.run.fill_chunks(&mut measures, CHUNK, Vec::new, |k, out, corners| {
            let first = start + k * CHUNK;
            let mut out = out.iter_mut();
            self.mesh.faces.for_each(first..first + out.len(), |_, vertices| {
                corners.clear();
                corners.extend(vertices.iter().map(|&v| self.mesh.positions.get(v)));
                let (area, [x, y, z]) = measure(corners);
                out.next().into_iter().for_each(|row| *row = [area, x, y, z]);
            });
            Ok(())
        })?;
        // All rows of a part share its name.
        let names: Vec<_> = self.labelling.names.iter().map(|name| Bytes::from(name.clone())).collect();
        let name = |&label: &u32| ByteArray::from(names.get(label as usize).cloned().unwrap_or_default());
        let mut columns: Vec<Column> = vec![
            column::<Int32Type, _>(|| (start..end).map(|face| face as u32 as i32)),
            column::<Int32Type, _>(|| labels.iter().map(|&label| label as i32)),
        ];
        let measures = &measures;
        columns.extend((0..4).map(|k| column::<DoubleType, _>(move || measures.iter().map(move |row| row[k]))));
        if let Some(quality) = self.labelling.quality {
            columns.push(column::<FloatType, _>(move || quality[start..end].iter().copied()));
        }
        if !names.is_empty() {
            columns.push(column::<ByteArrayType, _>(|| labels.iter().map(name)));
        }
        if let Some(Coordinates { values, dimensions }) = self.embedding {
            let rows = &values[start * dimensions..end * dimensions];
            let coordinate = |k: usize| move || rows.iter().skip(k).step_by(dimensions).copied();
            columns.extend((0..dimensions).map(|k| column::<FloatType, _>(coordinate(k))));
        }
        writer.group(&columns, self.run)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: their areas were NaN, and so was any sum over a table.
    #[test]
    fn polygons_of_any_size_and_without_a_place_are_measured() {
        let square = [[0., 0., 0.], [2., 0., 0.], [2., 1., 0.], [0., 1., 0.]];
        for size in [1e150, 1e-150] {
            let (area, centroid) = measure(&square.map(|p| p.map(|x| x * size)));
            let right = [area / size / size / 2., centroid[0] / size, 2. * centroid[1] / size];
            assert!(right.iter().all(|x| (x - 1.).abs() < 1e-12), "{right:?}");
        }
        let mut beyond = square;
        beyond[3] = [f64::NAN, 1., 0.];
        let (area, centroid) = measure(&beyond);
        assert!(area == 0. && (centroid[0] - 4. / 3.).abs() < 1e-12 && (centroid[1] - 1. / 3.).abs() < 1e-12);
        assert_eq!(measure(&[[f64::INFINITY; 3]; 3]).0, 0.);
    }
    /// Regression: a name was copied for each face of its part, and beyond a mebibyte of names also written that way.
    #[test]
    fn each_name_is_written_once() {
        let faces = vec![[0, 1, 2]; 60];
        let mesh = Mesh::from_slices(&[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]], &faces).unwrap();
        let labels: Vec<u32> = (0..60).map(|face| face % 3).collect();
        let names = ["head", "arm"].map(|name| name.repeat(200_000));
        let labelling = Labelling { labels: &labels, colours: &[], quality: None, names: &names, fine: None };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("names.parquet");
        write(&path, &mesh, &labelling, None, &Run::new(&())).unwrap();
        let bytes = std::fs::metadata(&path).unwrap().len();
        assert!(bytes < 2 * (800_000 + 600_000), "{bytes} bytes");
    }
}
