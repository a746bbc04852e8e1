//! Writing Parquet, a column of a group of rows at a time.

use crate::base::{Error, Result};
use parquet::data_type::DataType;
use parquet::errors::ParquetError;
use parquet::file::properties::WriterPropertiesBuilder;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
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
