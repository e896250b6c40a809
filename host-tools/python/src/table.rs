//! Tables for pandas, Polars, pyarrow and DuckDB: Arrow by the PyCapsule interface, batch after batch.

use std::sync::Arc;

use arrow_array::{
    ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, RecordBatchIterator, RecordBatchOptions,
    RecordBatchReader, ffi_stream::FFI_ArrowArrayStream,
};
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef};
use inerter_data::export::{Batch, Column, EstimateTable, Kind, Rows, Source, Values};
use pyo3::{prelude::*, types::PyCapsule};

/// Rows that are handed over together.
const BATCH: usize = 1 << 16;

/// A table of a run, read when it is asked for.
///
/// It has the Arrow PyCapsule interface: `pandas.DataFrame.from_arrow`, `polars.DataFrame`, `pyarrow.table` and DuckDB take it.
#[pyclass(frozen, module = "inerter")]
pub struct Table {
    of: Of,
    schema: SchemaRef,
}

enum Of {
    Samples(Box<Source>, Vec<Column>),
    Estimates(EstimateTable),
}

#[pymethods]
impl Table {
    /// Names of the columns, each with its unit at the end.
    #[getter]
    fn column_names(&self) -> Vec<String> {
        self.schema.fields().iter().map(|field| field.name().clone()).collect()
    }

    /// Unit of each column by its name; empty for plain numbers.
    #[getter]
    fn units(&self) -> std::collections::BTreeMap<String, String> {
        let unit = |field: &Arc<Field>| field.metadata().get("unit").cloned().unwrap_or_default();
        self.schema.fields().iter().map(|field| (field.name().clone(), unit(field))).collect()
    }

    fn __len__(&self) -> usize {
        match &self.of {
            Of::Samples(source, _) => source.extent.samples as usize,
            Of::Estimates(table) => table.rows(),
        }
    }

    fn __repr__(&self) -> String {
        format!("inerter.Table of {} rows: {}", self.__len__(), self.column_names().join(", "))
    }

    /// The table as an Arrow stream, for libraries.
    #[pyo3(signature = (requested_schema = None))]
    fn __arrow_c_stream__<'py>(
        &self,
        py: Python<'py>,
        requested_schema: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyCapsule>> {
        // The interface lets a producer give what it has.
        drop(requested_schema);
        let reader: Box<dyn RecordBatchReader + Send> = match &self.of {
            Of::Samples(source, columns) => {
                let rows =
                    source.rows(0.0..f64::INFINITY).map_err(|error| crate::error::Failure::from(error).raised(py))?;
                let batches = Batches {
                    source: source.as_ref().clone(),
                    columns: columns.clone(),
                    rows,
                    schema: self.schema.clone(),
                    has_failed: false,
                };
                Box::new(batches)
            }
            Of::Estimates(table) => {
                let batch = estimates(table, &self.schema);
                Box::new(RecordBatchIterator::new([batch], self.schema.clone()))
            }
        };
        PyCapsule::new_with_value(py, FFI_ArrowArrayStream::new(reader), c"arrow_array_stream")
    }
}

impl Table {
    /// All samples of a run.
    pub fn samples(source: &Source) -> Self {
        let machine = source.settings.machine;
        let is_there = |column: &Column| *column != Column::Terminal || source.settings.terminal_sensor;
        let columns: Vec<Column> = Column::ALL.into_iter().filter(is_there).collect();
        let fields = columns.iter().map(|column| {
            let kind = match column.kind() {
                Kind::Float => DataType::Float64,
                Kind::Whole => DataType::Int64,
                Kind::Flag => DataType::Boolean,
            };
            field(column.name(machine), column.unit(machine), kind, false)
        });
        let schema = Arc::new(Schema::new(fields.collect::<Vec<_>>()));
        Self { of: Of::Samples(Box::new(source.clone()), columns), schema }
    }

    /// What the device published, or would have published.
    pub fn estimates(table: EstimateTable) -> Self {
        let fields = table.columns.iter().map(|column| field(&column.name, column.unit, DataType::Float64, true));
        let schema = Arc::new(Schema::new(fields.collect::<Vec<_>>()));
        Self { of: Of::Estimates(table), schema }
    }
}

fn field(name: &str, unit: &str, kind: DataType, nullable: bool) -> Field {
    Field::new(name, kind, nullable)
        .with_metadata(std::collections::HashMap::from([("unit".to_string(), unit.to_string())]))
}

fn estimates(table: &EstimateTable, schema: &SchemaRef) -> Result<RecordBatch, ArrowError> {
    let columns =
        table.columns.iter().map(|column| -> ArrayRef { Arc::new(Float64Array::from(column.values.clone())) });
    // A run too short for an estimate has none, and then no columns either.
    let rows = RecordBatchOptions::new().with_row_count(Some(table.rows()));
    RecordBatch::try_new_with_options(schema.clone(), columns.collect(), &rows)
}

/// Samples, read from their file as they are asked for.
struct Batches {
    source: Source,
    columns: Vec<Column>,
    rows: Rows,
    schema: SchemaRef,
    /// Nothing comes after an error.
    has_failed: bool,
}

impl Iterator for Batches {
    type Item = Result<RecordBatch, ArrowError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.has_failed {
            return None;
        }
        let mut batch = Batch::new(&self.columns, BATCH);
        for row in self.rows.by_ref().take(BATCH) {
            match row {
                Ok((sample, point)) => batch.push(&self.source, &sample, &point),
                Err(error) => {
                    self.has_failed = true;
                    return Some(Err(ArrowError::ExternalError(Box::new(error))));
                }
            }
        }
        if batch.rows == 0 {
            return None;
        }
        let columns = batch.columns.into_iter().map(|(_, values)| -> ArrayRef {
            match values {
                Values::Float(values) => Arc::new(Float64Array::from(values)),
                Values::Whole(values) => Arc::new(Int64Array::from(values)),
                Values::Flag(values) => Arc::new(BooleanArray::from(values)),
            }
        });
        Some(RecordBatch::try_new(self.schema.clone(), columns.collect()))
    }
}

impl RecordBatchReader for Batches {
    fn schema(&self) -> SchemaRef {
        self.schema.clone()
    }
}
