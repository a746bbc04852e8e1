//! A table of the faces as Parquet, for DuckDB, pandas, Polars, Spark.
//!
//! A row a face in the order of the file: `face`, `label` (unsigned, 32 bits), `area` (in the square of the file's unit),
//! `centroid_x`, `centroid_y`, `centroid_z`, `quality` where there is one, and `embedding_0` … where it is given. Groups
//! of [`GROUP`] rows, each column of a group at a time: some 40 bytes a row of a group are held. About 45 bytes a face on disk.

use super::fit;
use crate::base::vector::{cross, length, minus};
use crate::base::{Error, Result};
use crate::mesh::output::by_rename;
use crate::mesh::{Labelling, Mesh};
use crate::store::Run;
use parquet::basic::Encoding;
use parquet::data_type::{DataType, DoubleType, FloatType, Int32Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::ColumnPath;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

/// Rows of a group: enough for readers to skip and share out, few enough to hold.
pub const GROUP: usize = 1 << 18;

/// Coordinates a face in some embedding.
#[derive(Clone, Copy, Debug)]
pub struct Coordinates<'a> {
    /// Row by row (n × dimensions).
    pub values: &'a [f32],
    /// Coordinates a face.
    pub dimensions: usize,
}

/// Area and centroid of a polygon, as a fan of triangles; of one without area, the mean of its corners.
pub fn measure(corners: &[[f64; 3]]) -> (f64, [f64; 3]) {
    let (mut area, mut moment, mut mean) = (0., [0.; 3], [0.; 3]);
    for k in 1..corners.len().saturating_sub(1) {
        let [a, b, c] = [corners[0], corners[k], corners[k + 1]];
        let part = length(cross(minus(b, a), minus(c, a))) / 2.;
        area += part;
        (0..3).for_each(|axis| moment[axis] += part * (a[axis] + b[axis] + c[axis]) / 3.);
    }
    for corner in corners {
        (0..3).for_each(|axis| mean[axis] += corner[axis] / corners.len() as f64);
    }
    (area, if area > 0. { moment.map(|x| x / area) } else { mean })
}

/// Writes the table to `path`, by rename.
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
    fit(mesh, labelling)?;
    let n = mesh.faces.len();
    let quality = labelling.quality.map_or(n, <[f32]>::len);
    let coordinates = embedding.map_or(n, |e| e.values.len() / e.dimensions.max(1));
    for (name, len) in [("quality", quality), ("embedding", coordinates)] {
        if len != n {
            return Err(Error::parameter(name, format!("{len} rows for {n} faces"), "give one for every face"));
        }
    }
    // Four measures and a column of a group, and what the writer holds of it.
    let bytes = 56 * GROUP.min(n) as u64;
    let _grant = run.budget.take("a group of rows", bytes, bytes)?;
    by_rename(path, 0, durable, |file| Table { path, mesh, labelling, embedding, run }.write(file))
}

/// What the table is made of.
struct Table<'a> {
    path: &'a Path,
    mesh: &'a Mesh,
    labelling: &'a Labelling<'a>,
    embedding: Option<Coordinates<'a>>,
    run: &'a Run<'a>,
}

impl Table<'_> {
    fn wrong(&self, error: ParquetError) -> Error {
        let error = match error {
            ParquetError::External(source) => match source.downcast::<std::io::Error>() {
                Ok(source) => *source,
                Err(source) => std::io::Error::other(source.to_string()),
            },
            other => std::io::Error::other(other.to_string()),
        };
        Error::io(self.path, "write")(error)
    }

    fn schema(&self) -> String {
        let mut text = String::from("message faces { required int32 face (INTEGER(32, false));");
        text += " required int32 label (INTEGER(32, false)); required double area;";
        ["x", "y", "z"].iter().for_each(|axis| text += &format!(" required double centroid_{axis};"));
        if self.labelling.quality.is_some() {
            text += " required float quality;";
        }
        let dimensions = self.embedding.map_or(0, |embedding| embedding.dimensions);
        (0..dimensions).for_each(|k| text += &format!(" required float embedding_{k};"));
        text + " }"
    }

    fn write(&self, file: &mut File) -> Result<()> {
        let schema = parse_message_type(&self.schema()).map_err(|error| self.wrong(error))?;
        let properties = WriterProperties::builder()
            .set_created_by(format!("nystrom-stream {}", env!("CARGO_PKG_VERSION")))
            // Numbers that hardly repeat make no dictionary; labels do, and faces are counted up.
            .set_dictionary_enabled(false)
            .set_column_dictionary_enabled(ColumnPath::from("label"), true)
            .set_column_encoding(ColumnPath::from("face"), Encoding::DELTA_BINARY_PACKED)
            .build();
        let out = std::io::BufWriter::with_capacity(1 << 20, file);
        let mut writer = SerializedFileWriter::new(out, Arc::new(schema), Arc::new(properties))
            .map_err(|error| self.wrong(error))?;
        let n = self.mesh.faces.len();
        for start in (0..n).step_by(GROUP) {
            self.run.cancel.check()?;
            let mut group = writer.next_row_group().map_err(|error| self.wrong(error))?;
            self.group(start, n.min(start + GROUP), &mut group)?;
            group.close().map_err(|error| self.wrong(error))?;
        }
        writer.into_inner().map_err(|error| self.wrong(error))?.flush().map_err(Error::io(self.path, "write"))
    }

    /// The rows `start..end`.
    fn group<W: Write + Send>(&self, start: usize, end: usize, group: &mut SerializedRowGroupWriter<W>) -> Result<()> {
        let labels = &self.labelling.labels[start..end];
        self.column::<Int32Type, _>(group, (start..end).map(|face| face as u32 as i32))?;
        self.column::<Int32Type, _>(group, labels.iter().map(|&label| label as i32))?;
        let mut measures: Vec<[f64; 4]> = Vec::with_capacity(end - start);
        let mut corners = Vec::new();
        self.mesh.faces.for_each(start..end, |_, vertices| {
            corners.clear();
            corners.extend(vertices.iter().map(|&v| self.mesh.positions.get(v)));
            let (area, [x, y, z]) = measure(&corners);
            measures.push([area, x, y, z]);
        });
        for k in 0..4 {
            self.column::<DoubleType, _>(group, measures.iter().map(|row| row[k]))?;
        }
        if let Some(quality) = self.labelling.quality {
            self.column::<FloatType, _>(group, quality[start..end].iter().copied())?;
        }
        if let Some(Coordinates { values, dimensions }) = self.embedding {
            for k in 0..dimensions {
                self.column::<FloatType, _>(group, (start..end).map(|face| values[face * dimensions + k]))?;
            }
        }
        Ok(())
    }

    fn column<T: DataType, W: Write + Send>(
        &self,
        group: &mut SerializedRowGroupWriter<W>,
        values: impl Iterator<Item = T::T>,
    ) -> Result<()> {
        let values: Vec<T::T> = values.collect();
        let Some(mut column) = group.next_column().map_err(|error| self.wrong(error))? else { return Ok(()) };
        column.typed::<T>().write_batch(&values, None, None).map_err(|error| self.wrong(error))?;
        column.close().map_err(|error| self.wrong(error))
    }
}
