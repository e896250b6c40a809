//! Tables for pandas, Polars, pyarrow and DuckDB: Arrow through the PyCapsule interface, batch by batch.

use std::sync::Arc;

use arrow_array::{
    ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, RecordBatchIterator, RecordBatchOptions,
    ffi_stream::FFI_ArrowArrayStream,
};
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef};
use inerter_analysis::plan::Plan;
use inerter_core::Settings;
use inerter_data::{
    csv::column_names,
    export::{Column, EstimateTable, Kind, Row, Source, Values},
    names::unit,
    words::printable,
};
use pyo3::{
    exceptions::{PyKeyError, PyValueError},
    prelude::*,
    types::{PyCapsule, PyList},
};

use crate::error::Failure;

/// Rows per batch.
const BATCH: usize = 1 << 16;

/// A table of a run, read on demand.
///
/// It implements the Arrow PyCapsule interface, so `pandas.DataFrame.from_arrow`, `polars.DataFrame`, `pyarrow.table`
/// and DuckDB accept it.
#[pyclass(frozen, module = "inerter")]
pub struct Table {
    of: Of,
    schema: SchemaRef,
}

/// The rows of a table, batch by batch.
type Batches = Box<dyn Iterator<Item = Result<RecordBatch, ArrowError>> + Send>;

enum Of {
    Samples(Box<Source>, Vec<Column>),
    /// Columns already in memory, as many as in the schema, with this many rows.
    Known(Vec<ArrayRef>, usize),
}

#[pymethods]
impl Table {
    /// Names of the columns, each with its unit at the end.
    #[getter]
    fn column_names(&self) -> Vec<String> {
        self.schema.fields().iter().map(|field| field.name().clone()).collect()
    }

    /// Unit of each column by name; empty for plain numbers.
    #[getter]
    fn units(&self) -> std::collections::BTreeMap<String, String> {
        let unit = |field: &Arc<Field>| field.metadata().get("unit").cloned().unwrap_or_default();
        self.schema.fields().iter().map(|field| (field.name().clone(), unit(field))).collect()
    }

    fn __len__(&self) -> usize {
        match &self.of {
            Of::Samples(source, _) => source.extent.samples as usize,
            Of::Known(_, rows) => *rows,
        }
    }

    /// The values of a column, as a list.
    fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyList>> {
        let Ok(place) = self.schema.index_of(name) else { return Err(PyKeyError::new_err(name.to_string())) };
        let list = PyList::empty(py);
        let mut batches = self.batches()?;
        while let Some(batch) = py.detach(|| batches.next()) {
            py.check_signals()?;
            let batch = batch.map_err(failed)?;
            let column = batch.column(place);
            if let Some(values) = column.as_any().downcast_ref::<Float64Array>() {
                values.iter().try_for_each(|value| list.append(value))?;
            } else if let Some(values) = column.as_any().downcast_ref::<Int64Array>() {
                values.iter().try_for_each(|value| list.append(value))?;
            } else if let Some(values) = column.as_any().downcast_ref::<BooleanArray>() {
                values.iter().try_for_each(|value| list.append(value))?;
            }
        }
        Ok(list)
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
        // The interface allows a producer to ignore the requested schema.
        drop(requested_schema);
        let batches = self.batches()?.map(|batch| batch.map_err(shown));
        let reader = Box::new(RecordBatchIterator::new(batches, self.schema.clone()));
        PyCapsule::new_with_value(py, FFI_ArrowArrayStream::new(reader), c"arrow_array_stream")
    }
}

/// Why a batch could not be read, with the code and help of the original error.
fn failed(error: ArrowError) -> PyErr {
    let text = error.to_string();
    let ours = match error {
        ArrowError::ExternalError(error) => error.downcast::<inerter_data::Error>().ok(),
        _ => None,
    };
    ours.map_or_else(|| PyValueError::new_err(printable(&text).into_owned()), |error| Failure::from(*error).into())
}

/// The error for a library, which raises its text as it is: it may quote a file.
fn shown(error: ArrowError) -> ArrowError {
    match error {
        ArrowError::ExternalError(source) => {
            ArrowError::ExternalError(printable(&source.to_string()).into_owned().into())
        }
        other => other,
    }
}

impl Table {
    /// Its rows, batch by batch; nothing comes after an error.
    fn batches(&self) -> Result<Batches, Failure> {
        let schema = self.schema.clone();
        let (source, columns) = match &self.of {
            Of::Samples(source, columns) => (source.clone(), columns.clone()),
            Of::Known(columns, rows) => {
                // A run too short for an estimate has no rows, and then no columns either.
                let rows = RecordBatchOptions::new().with_row_count(Some(*rows));
                let batch = RecordBatch::try_new_with_options(schema, columns.clone(), &rows);
                return Ok(Box::new(std::iter::once(batch)));
            }
        };
        let (mut rows, mut has_failed) = (source.rows(0.0..f64::INFINITY)?, false);
        Ok(Box::new(std::iter::from_fn(move || {
            if has_failed {
                return None;
            }
            let batch = match rows.by_ref().take(BATCH).collect::<Result<Vec<Row>, inerter_data::Error>>() {
                Ok(batch) => batch,
                Err(error) => {
                    has_failed = true;
                    return Some(Err(ArrowError::ExternalError(Box::new(error))));
                }
            };
            if batch.is_empty() {
                return None;
            }
            let columns = columns.iter().map(|column| -> ArrayRef {
                match column.values(&source, &batch) {
                    Values::Float(values) => Arc::new(Float64Array::from(values)),
                    Values::Whole(values) => Arc::new(Int64Array::from(values)),
                    Values::Flag(values) => Arc::new(BooleanArray::from(values)),
                }
            });
            Some(RecordBatch::try_new(schema.clone(), columns.collect()))
        })))
    }

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
                Kind::Text => DataType::Utf8,
            };
            field(column.name(machine), column.unit(machine), kind, false)
        });
        let schema = Arc::new(Schema::new(fields.collect::<Vec<_>>()));
        Self { of: Of::Samples(Box::new(source.clone()), columns), schema }
    }

    /// What the device published, or would have published.
    pub fn estimates(table: EstimateTable) -> Self {
        let rows = table.rows();
        let columns = table.columns.into_iter();
        Self::known(rows, columns.map(|column| floats(&column.name, column.unit, column.values, true)))
    }

    /// The points of a planned motion at the setting `sample_rate_hz`: the motion of the terminal.
    pub fn motion(planned: &Plan) -> Self {
        let Settings { machine, sample_rate_hz, .. } = planned.expected.settings;
        let (t_s, terminal): (Vec<f64>, Vec<f64>) =
            planned.points(sample_rate_hz).map(|point| (point.t_s, point.terminal_m)).unzip();
        let (rows, (_, name)) = (t_s.len(), column_names(machine));
        Self::known(rows, [floats("t_s", "s", t_s, false), floats(name, unit(machine, "m"), terminal, false)])
    }

    fn known(rows: usize, columns: impl IntoIterator<Item = (Field, ArrayRef)>) -> Self {
        let (fields, columns): (Vec<Field>, Vec<ArrayRef>) = columns.into_iter().unzip();
        Self { of: Of::Known(columns, rows), schema: Arc::new(Schema::new(fields)) }
    }
}

/// A column of floating-point numbers.
fn floats(name: &str, unit: &str, values: impl Into<Float64Array>, nullable: bool) -> (Field, ArrayRef) {
    let values: Float64Array = values.into();
    (field(name, unit, DataType::Float64, nullable), Arc::new(values))
}

fn field(name: &str, unit: &str, kind: DataType, nullable: bool) -> Field {
    Field::new(name, kind, nullable)
        .with_metadata(std::collections::HashMap::from([("unit".to_string(), unit.to_string())]))
}
