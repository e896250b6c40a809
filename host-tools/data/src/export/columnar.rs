//! Parquet: the samples in groups of rows, units and settings in the metadata of the file.

use std::{fs::File, sync::Arc};

use parquet::{
    basic::{Compression, Encoding, Repetition, Type as Physical},
    data_type::{BoolType, DataType, DoubleType, Int64Type},
    errors::ParquetError,
    file::{
        metadata::KeyValue,
        properties::{WriterProperties, WriterVersion},
        writer::{SerializedColumnWriter, SerializedFileWriter},
    },
    schema::types::{ColumnPath, Type},
};
use serde_json::{Map, Value, json};

use super::{Batch, Column, EstimateTable, Kind, Source, Values, about, selection::Sink};
use crate::output::{OutputError, Pending};

/// A Parquet file that is being written.
pub(super) struct Parquet {
    name: String,
    writer: SerializedFileWriter<File>,
}

impl Parquet {
    pub(super) fn create(file: &Pending, source: &Source, columns: &[Column]) -> Result<Self, OutputError> {
        let fields =
            columns.iter().map(|column| (column.name(source.settings.machine), column.kind(), Repetition::REQUIRED));
        let writer = writer(file, fields.collect(), metadata(source, about::units(source, columns)))?;
        Ok(Self { name: file.name(), writer })
    }
}

impl Sink for Parquet {
    fn take(&mut self, batch: &Batch) -> Result<(), OutputError> {
        let mut columns = batch.columns.iter();
        group(&mut self.writer, |writer| {
            match columns.next() {
                Some((_, Values::Float(values))) => put::<DoubleType>(writer, values, None)?,
                Some((_, Values::Whole(values))) => put::<Int64Type>(writer, values, None)?,
                Some((_, Values::Flag(values))) => put::<BoolType>(writer, values, None)?,
                None => {}
            }
            Ok(())
        })
        .map_err(|error| failed(&self.name, error))
    }

    fn finish(self: Box<Self>) -> Result<(), OutputError> {
        self.writer.close().map(drop).map_err(|error| failed(&self.name, error))
    }
}

/// Writes the table of estimates; what is not known is null.
pub(super) fn write_estimates(file: &Pending, source: &Source, table: &EstimateTable) -> Result<(), OutputError> {
    let fields = table.columns.iter().map(|column| (column.name.as_str(), Kind::Float, Repetition::OPTIONAL));
    let mut writer = writer(file, fields.collect(), metadata(source, about::estimate_units(table)))?;
    let mut columns = table.columns.iter();
    let written = group(&mut writer, |writer| {
        let cells = columns.next().map_or(&[][..], |column| &column.values);
        let known: Vec<f64> = cells.iter().flatten().copied().collect();
        let levels: Vec<i16> = cells.iter().map(|cell| i16::from(cell.is_some())).collect();
        put::<DoubleType>(writer, &known, Some(&levels))
    });
    let closed = written.and_then(|()| writer.close().map(drop));
    closed.map_err(|error| failed(&file.name(), error))
}

/// One group of rows; `fill` is handed the columns in order.
fn group(
    writer: &mut SerializedFileWriter<File>,
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

fn writer(
    file: &Pending,
    fields: Vec<(&str, Kind, Repetition)>,
    metadata: Vec<KeyValue>,
) -> Result<SerializedFileWriter<File>, OutputError> {
    let failed = |error| failed(&file.name(), error);
    // Hardly a number comes twice: a dictionary would be built in vain.
    let mut properties = WriterProperties::builder()
        .set_writer_version(WriterVersion::PARQUET_1_0)
        .set_created_by(concat!("inerter ", env!("CARGO_PKG_VERSION")).into())
        .set_compression(Compression::SNAPPY)
        .set_dictionary_enabled(false)
        .set_key_value_metadata(Some(metadata));
    let mut types = Vec::new();
    for (name, kind, repetition) in fields {
        let (physical, encoding) = match kind {
            // Bytes of the same weight side by side pack well.
            Kind::Float => (Physical::DOUBLE, Encoding::BYTE_STREAM_SPLIT),
            Kind::Whole => (Physical::INT64, Encoding::DELTA_BINARY_PACKED),
            Kind::Flag => (Physical::BOOLEAN, Encoding::PLAIN),
        };
        properties = properties.set_column_encoding(ColumnPath::from(name), encoding);
        let field = Type::primitive_type_builder(name, physical).with_repetition(repetition).build();
        types.push(Arc::new(field.map_err(failed)?));
    }
    let schema = Type::group_type_builder("schema").with_fields(types).build().map_err(failed)?;
    SerializedFileWriter::new(file.open()?, Arc::new(schema), Arc::new(properties.build())).map_err(failed)
}

/// Everything that goes with the numbers, each as JSON; pandas puts the first one into `DataFrame.attrs`.
fn metadata(source: &Source, units: Map<String, Value>) -> Vec<KeyValue> {
    let (settings, device, markers) = (about::settings(source), about::device(source), about::markers(source));
    let attributes = json!({"units": units, "settings": settings, "device": device, "markers": markers});
    let truth = source.truth.as_ref().map(|truth| json!(truth));
    let entries = [
        ("PANDAS_ATTRS", Some(attributes)),
        ("inerter.units", Some(json!(units))),
        ("inerter.settings", Some(json!(settings))),
        ("inerter.device", Some(json!(device))),
        ("inerter.markers", Some(json!(markers))),
        ("inerter.truth", truth),
    ];
    let known = entries.into_iter().filter_map(|(name, value)| value.map(|value| (name, value)));
    known.map(|(name, value)| KeyValue::new(name.to_string(), value.to_string())).collect()
}

fn failed(name: &str, error: ParquetError) -> OutputError {
    let source = match error {
        ParquetError::External(inner) => match inner.downcast::<std::io::Error>() {
            Ok(error) => *error,
            Err(other) => std::io::Error::other(other),
        },
        other => std::io::Error::other(other),
    };
    OutputError::write(name, source)
}
