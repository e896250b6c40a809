//! Parquet: the samples in groups of rows, units and settings in the metadata of the file; and tables in memory.

use std::{
    fs::File,
    io::{self, Write},
    sync::Arc,
};

use parquet::{
    basic::{Compression, Encoding, LogicalType, Repetition, Type as Physical},
    data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, Int64Type},
    errors::ParquetError,
    file::{
        metadata::KeyValue,
        properties::{WriterProperties, WriterVersion},
        writer::{SerializedColumnWriter, SerializedFileWriter},
    },
    schema::types::{ColumnPath, Type},
};
use serde_json::{Map, Value, json};

use super::{Cells, Column, EstimateTable, HeldColumn, Kind, Row, Source, Values, about, selection::Sink};
use crate::output::{OutputError, Pending};

/// A Parquet file being written.
pub(super) struct Parquet {
    name: String,
    columns: Vec<Column>,
    writer: SerializedFileWriter<File>,
}

impl Parquet {
    pub(super) fn create(file: &Pending, source: &Source, columns: Vec<Column>) -> Result<Self, OutputError> {
        let machine = source.settings.machine;
        let fields = columns.iter().map(|column| (column.name(machine), column.kind(), Repetition::REQUIRED));
        let metadata = metadata(source, about::units(source, &columns));
        let writer = writer(file.open()?, fields, metadata).map_err(|error| failed(&file.name(), error))?;
        Ok(Self { name: file.name(), columns, writer })
    }
}

impl Sink for Parquet {
    fn take(&mut self, source: &Source, rows: &[Row]) -> Result<(), OutputError> {
        let mut columns = self.columns.iter().map(|column| column.values(source, rows));
        group(&mut self.writer, |writer| match columns.next() {
            Some(Values::Float(values)) => put::<DoubleType>(writer, &values, None),
            Some(Values::Whole(values)) => put::<Int64Type>(writer, &values, None),
            Some(Values::Flag(values)) => put::<BoolType>(writer, &values, None),
            None => Ok(()),
        })
        .map_err(|error| failed(&self.name, error))
    }

    fn finish(self: Box<Self>) -> Result<(), OutputError> {
        self.writer.close().map(drop).map_err(|error| failed(&self.name, error))
    }
}

/// Writes the table of estimates; unknown values are null.
pub(super) fn write_estimates(file: &Pending, source: &Source, table: &EstimateTable) -> Result<(), OutputError> {
    let metadata = metadata(source, about::estimate_units(table));
    let columns: Vec<_> = table.clone().held().collect();
    write_held(file.open()?, &columns, metadata).map(drop).map_err(|error| failed(&file.name(), error))
}

/// A table as the bytes of a Parquet file, with the units as metadata; the same columns give the same bytes.
pub fn table_bytes(columns: &[HeldColumn]) -> Result<Vec<u8>, OutputError> {
    let units = about::units_by_name(columns.iter().map(|column| (&*column.name, column.unit)));
    let metadata =
        key_values([("PANDAS_ATTRS", Some(json!({ "units": units }))), ("inerter.units", Some(json!(units)))]);
    write_held(Vec::new(), columns, metadata).map_err(|error| failed("a table", error))
}

fn write_held<W: Write + Send>(to: W, table: &[HeldColumn], metadata: Vec<KeyValue>) -> Result<W, ParquetError> {
    let fields = table.iter().map(|column| {
        let kind = match &column.cells {
            Cells::Float(_) => Kind::Float,
            Cells::Whole(_) => Kind::Whole,
            Cells::Text(_) => Kind::Text,
        };
        (&*column.name, kind, Repetition::OPTIONAL)
    });
    let mut writer = writer(to, fields, metadata)?;
    let mut columns = table.iter();
    group(&mut writer, |writer| match columns.next().map(|column| &column.cells) {
        Some(Cells::Float(values)) => put_known::<DoubleType>(writer, values.iter().copied()),
        Some(Cells::Whole(values)) => put_known::<Int64Type>(writer, values.iter().copied()),
        Some(Cells::Text(values)) => {
            put_known::<ByteArrayType>(writer, values.iter().map(|cell| cell.as_deref().map(ByteArray::from)))
        }
        None => Ok(()),
    })?;
    writer.into_inner()
}

/// The known values of a column, and where they are.
fn put_known<T: DataType>(
    writer: &mut SerializedColumnWriter<'_>,
    cells: impl Iterator<Item = Option<T::T>> + Clone,
) -> Result<(), ParquetError> {
    let levels: Vec<i16> = cells.clone().map(|cell| i16::from(cell.is_some())).collect();
    let known: Vec<T::T> = cells.flatten().collect();
    put::<T>(writer, &known, Some(&levels))
}

/// One row group; `fill` gets the columns in order.
fn group<W: Write + Send>(
    writer: &mut SerializedFileWriter<W>,
    mut fill: impl FnMut(&mut SerializedColumnWriter<'_>) -> Result<(), ParquetError>,
) -> Result<(), ParquetError> {
    let mut group = writer.next_row_group()?;
    while let Some(mut column) = group.next_column()? {
        fill(&mut column)?;
        column.close()?;
    }
    group.close().map(drop)
}

fn put<T: DataType>(
    writer: &mut SerializedColumnWriter<'_>,
    values: &[T::T],
    levels: Option<&[i16]>,
) -> Result<(), ParquetError> {
    writer.typed::<T>().write_batch(values, levels, None).map(drop)
}

fn writer<'a, W: Write + Send>(
    to: W,
    fields: impl Iterator<Item = (&'a str, Kind, Repetition)>,
    metadata: Vec<KeyValue>,
) -> Result<SerializedFileWriter<W>, ParquetError> {
    // Hardly any number repeats, so a dictionary would not help.
    let mut properties = WriterProperties::builder()
        .set_writer_version(WriterVersion::PARQUET_1_0)
        .set_created_by(concat!("inerter ", env!("CARGO_PKG_VERSION")).into())
        .set_compression(Compression::SNAPPY)
        .set_dictionary_enabled(false)
        .set_key_value_metadata(Some(metadata));
    let mut types = Vec::new();
    for (name, kind, repetition) in fields {
        let path = ColumnPath::from(name);
        let (physical, encoding) = match kind {
            // Bytes of equal significance compress well side by side.
            Kind::Float => (Physical::DOUBLE, Encoding::BYTE_STREAM_SPLIT),
            Kind::Whole => (Physical::INT64, Encoding::DELTA_BINARY_PACKED),
            Kind::Flag => (Physical::BOOLEAN, Encoding::PLAIN),
            Kind::Text => {
                properties = properties.set_column_dictionary_enabled(path.clone(), true);
                (Physical::BYTE_ARRAY, Encoding::PLAIN)
            }
        };
        properties = properties.set_column_encoding(path, encoding);
        let logical = (kind == Kind::Text).then_some(LogicalType::String);
        let field = Type::primitive_type_builder(name, physical).with_repetition(repetition).with_logical_type(logical);
        types.push(Arc::new(field.build()?));
    }
    let schema = Type::group_type_builder("schema").with_fields(types).build()?;
    SerializedFileWriter::new(to, Arc::new(schema), Arc::new(properties.build()))
}

/// Everything that accompanies the numbers, each as JSON; pandas puts the first one into `DataFrame.attrs`.
fn metadata(source: &Source, units: Map<String, Value>) -> Vec<KeyValue> {
    let (settings, device, markers) = (about::settings_by_name(source), about::device(source), about::markers(source));
    let attributes = json!({"units": units, "settings": settings, "device": device, "markers": markers});
    key_values([
        ("PANDAS_ATTRS", Some(attributes)),
        ("inerter.units", Some(json!(units))),
        ("inerter.settings", Some(json!(settings))),
        ("inerter.device", Some(json!(device))),
        ("inerter.markers", Some(json!(markers))),
        ("inerter.calibration", source.calibration.as_ref().map(|calibration| json!(calibration.texts()))),
        ("inerter.truth", source.truth.as_ref().map(|truth| json!(truth))),
    ])
}

/// The entries that are known.
fn key_values(entries: impl IntoIterator<Item = (&'static str, Option<Value>)>) -> Vec<KeyValue> {
    let known = entries.into_iter().filter_map(|(name, value)| Some(KeyValue::new(name.into(), value?.to_string())));
    known.collect()
}

fn failed(name: &str, error: ParquetError) -> OutputError {
    let source = match error {
        ParquetError::External(inner) => match inner.downcast::<io::Error>() {
            Ok(error) => *error,
            Err(other) => io::Error::other(other),
        },
        other => io::Error::other(other),
    };
    OutputError::write(name, source)
}
