//! A table of the faces as Parquet, for DuckDB, pandas, Polars, Spark; and the writer that other tables use.
//!
//! One row per face in the order of the file: `face`, `label` (unsigned, 32 bits), `area` (in the square of the file's
//! unit), `centroid_x`, `centroid_y`, `centroid_z`, `quality` where there is one, and `embedding_0` … where it is
//! given. Rows are written in groups of [`GROUP`], each column of a group at a time: some 40 bytes per row of a group
//! are held. About 45 bytes per face on disk.

use crate::base::vector::{area, finite};
use crate::base::{Error, Result};
use crate::mesh::output::by_rename;
use crate::mesh::{Labelling, Mesh};
use crate::store::Run;
use parquet::basic::Encoding;
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int32Type};
use parquet::errors::ParquetError;
use parquet::file::properties::{WriterProperties, WriterPropertiesBuilder};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::ColumnPath;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::Arc;

/// Rows of a group: enough for readers to skip and share out, few enough to hold.
pub const GROUP: usize = 1 << 18;

type Out<'a> = BufWriter<&'a mut File>;

/// A file under way.
pub struct Writer<'a> {
    path: &'a Path,
    inner: SerializedFileWriter<Out<'a>>,
}

/// A group of rows under way.
pub struct Group<'a, 'b> {
    path: &'a Path,
    inner: SerializedRowGroupWriter<'b, Out<'a>>,
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
    /// Starts `file`, which will be `path`, with columns of the given message type.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn new(path: &'a Path, file: &'a mut File, schema: &str, properties: WriterPropertiesBuilder) -> Result<Self> {
        let schema = parse_message_type(schema).map_err(wrong(path))?;
        let properties = properties.set_created_by(format!("nystrom-stream {}", env!("CARGO_PKG_VERSION"))).build();
        let out = BufWriter::with_capacity(1 << 20, file);
        let inner = SerializedFileWriter::new(out, Arc::new(schema), Arc::new(properties)).map_err(wrong(path))?;
        Ok(Self { path, inner })
    }

    /// Writes a group, whose columns `fill` gives in the order of the message type.
    ///
    /// # Errors
    /// [`Error::Io`], those of `fill`.
    pub fn group(&mut self, fill: impl FnOnce(&mut Group<'a, '_>) -> Result<()>) -> Result<()> {
        let inner = self.inner.next_row_group().map_err(wrong(self.path))?;
        let mut group = Group { path: self.path, inner };
        fill(&mut group)?;
        group.inner.close().map(drop).map_err(wrong(self.path))
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

impl Group<'_, '_> {
    /// Writes the next column.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn column<T: DataType>(&mut self, values: impl Iterator<Item = T::T>) -> Result<()> {
        let values: Vec<T::T> = values.collect();
        let Some(mut column) = self.inner.next_column().map_err(wrong(self.path))? else { return Ok(()) };
        column.typed::<T>().write_batch(&values, None, None).map_err(wrong(self.path))?;
        column.close().map_err(wrong(self.path))
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

/// Area and centroid of a polygon, as a fan of triangles; of one without area, the mean of its corners. One with a
/// corner whose coordinates are not finite has none, and the mean is that of the others.
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
    let triangles = || (1..corners.len().saturating_sub(1)).map(|k| [corners[0], corners[k], corners[k + 1]]);
    triangles().for_each(|triangle| whole += area(triangle));
    // Moments of very large or small ones leave the doubles.
    let unit = if (1e-150..1e150).contains(&whole) { 1. } else { whole };
    for [a, b, c] in triangles() {
        let part = area([a, b, c]) / unit;
        (0..3).for_each(|axis| moment[axis] += part * (a[axis] + b[axis] + c[axis]) / 3.);
    }
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
/// let labelling = Labelling { labels: &[0, 1], colours: &[], quality: None, names: &[] };
/// parquet::write(&std::env::temp_dir().join("square.parquet"), &mesh, &labelling, None, false, &Run::new(&()))?;
/// # Ok::<(), nystrom_stream::base::Error>(())
/// ```
///
/// # Errors
/// [`Error::Parameter`] for labels, qualities or coordinates that do not fit the faces; [`Error::Io`];
/// [`Error::Cancelled`].
pub fn write(
    path: &Path,
    mesh: &Mesh,
    labelling: &Labelling,
    embedding: Option<Coordinates>,
    durable: bool,
    run: &Run,
) -> Result<()> {
    let n = mesh.faces.len();
    labelling.fit(n)?;
    let len = embedding.map_or(n, |e| e.values.len() / e.dimensions.max(1));
    if len != n {
        return Err(Error::parameter("embedding", format!("{len} rows for {n} faces"), "give one for every face"));
    }
    // Four measures and a column of a group, and what the writer holds of it.
    let bytes = 56 * GROUP.min(n) as u64;
    let _grant = run.budget.take("a group of rows", bytes, bytes)?;
    by_rename(path, 0, durable, |file| FaceTable { path, mesh, labelling, embedding, run }.write(file))
}

/// What the table is made of.
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
            // Numbers that hardly repeat make no dictionary; labels do, and faces are counted up.
            .set_dictionary_enabled(false)
            .set_column_dictionary_enabled(ColumnPath::from("label"), true)
            .set_column_dictionary_enabled(ColumnPath::from("name"), true)
            .set_column_encoding(ColumnPath::from("face"), Encoding::DELTA_BINARY_PACKED);
        let schema = self.schema();
        let mut writer = Writer::new(self.path, file, &schema, properties)?;
        let n = self.mesh.faces.len();
        for start in (0..n).step_by(GROUP) {
            self.run.cancel.check()?;
            writer.group(|group| self.group(start, n.min(start + GROUP), group))?;
        }
        writer.finish()
    }

    /// The rows `start..end`.
    fn group(&self, start: usize, end: usize, group: &mut Group<'_, '_>) -> Result<()> {
        let labels = &self.labelling.labels[start..end];
        group.column::<Int32Type>((start..end).map(|face| face as u32 as i32))?;
        group.column::<Int32Type>(labels.iter().map(|&label| label as i32))?;
        let mut measures: Vec<[f64; 4]> = Vec::with_capacity(end - start);
        let mut corners = Vec::new();
        self.mesh.faces.for_each(start..end, |_, vertices| {
            corners.clear();
            corners.extend(vertices.iter().map(|&v| self.mesh.positions.get(v)));
            let (area, [x, y, z]) = measure(&corners);
            measures.push([area, x, y, z]);
        });
        for k in 0..4 {
            group.column::<DoubleType>(measures.iter().map(|row| row[k]))?;
        }
        if let Some(quality) = self.labelling.quality {
            group.column::<FloatType>(quality[start..end].iter().copied())?;
        }
        if !self.labelling.names.is_empty() {
            let name = |&label: &u32| self.labelling.name(label as usize).unwrap_or_default();
            group.column::<ByteArrayType>(labels.iter().map(|label| ByteArray::from(name(label))))?;
        }
        if let Some(Coordinates { values, dimensions }) = self.embedding {
            for k in 0..dimensions {
                group.column::<FloatType>((start..end).map(|face| values[face * dimensions + k]))?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Their areas were no numbers, and no sum over a table was.
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
}
