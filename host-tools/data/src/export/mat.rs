//! MATLAB v7.3: column vectors, and structs with settings, units, device and estimates.
//!
//! The layout needs whole columns, one after the other. The samples are read once per column, so that no column is ever
//! held in memory.

use std::{
    io::{self, BufWriter, Write},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use hdf5_pure::mat::{Block, DataProducer, MatBuilder, MatError, Options, StructWriter};
use serde_json::Value;

use super::{Column, EstimateTable, Rows, Selection, Source, about};
use crate::{
    error::Error,
    output::{OutputError, Pending},
};

/// One column, read while it is written.
struct Producer {
    column: Column,
    source: Source,
    rows: Mutex<Option<Rows>>,
    selection: Selection,
    state: Arc<State>,
}

/// What reader and writer share: the library's errors cannot carry ours.
#[derive(Default)]
struct State {
    error: Mutex<Option<Error>>,
    done: Mutex<f64>,
}

impl DataProducer for Producer {
    fn block_bytes(&self, block: Block, out: &mut Vec<u8>) -> Result<(), MatError> {
        self.fill(&block, out).map_err(|error| {
            *lock(&self.state.error) = Some(error);
            MatError::Custom("the samples could not be read".into())
        })
    }
}

impl Producer {
    fn fill(&self, block: &Block, out: &mut Vec<u8>) -> Result<(), Error> {
        let mut rows = lock(&self.rows);
        if rows.is_none() {
            *rows = Some(self.source.rows(self.selection.range_s.clone())?);
        }
        for row in rows.iter_mut().flatten().take(usize::try_from(block.elements).unwrap_or(usize::MAX)) {
            let (sample, point) = row?;
            let value = self.column.value(&self.source, &sample, &point);
            out.extend_from_slice(&value.to_le_bytes());
        }
        let mut done = lock(&self.state.done);
        *done += block.elements as f64;
        Ok(())
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // The data are consistent even if another thread panicked while it held the lock.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Writes the file; `progress` gets the number of columns done.
pub(super) fn write(
    file: &Pending,
    source: &Source,
    selection: &Selection,
    columns: &[Column],
    rows: u64,
    estimates: Option<&EstimateTable>,
    progress: &mut dyn FnMut(f64) -> Result<(), Error>,
) -> Result<(), Error> {
    let state = Arc::new(State::default());
    let failed = |error| failed(file, &state, error);
    let builder = build(source, selection, columns, rows, estimates, &state).map_err(failed)?;
    let out = Watched { out: BufWriter::with_capacity(1 << 16, file.open()?), state: &state, rows, progress };
    builder.finish_to(out).map_err(failed)
}

fn build(
    source: &Source,
    selection: &Selection,
    columns: &[Column],
    rows: u64,
    estimates: Option<&EstimateTable>,
    state: &Arc<State>,
) -> Result<MatBuilder, MatError> {
    let mut mat = MatBuilder::new(Options::default());
    for column in columns {
        let producer = Producer {
            column: *column,
            source: source.clone(),
            rows: Mutex::new(None),
            selection: selection.clone(),
            state: state.clone(),
        };
        let length = usize::try_from(rows).unwrap_or(usize::MAX);
        mat.write_blocks::<f64>(column.name(source.settings.machine), &[length, 1], Box::new(producer))?;
    }
    let texts = |writer: &mut StructWriter<'_>, pairs: &serde_json::Map<String, Value>| {
        for (name, value) in pairs {
            writer.write_char(name, value.as_str().unwrap_or_default())?;
        }
        Ok(())
    };
    mat.struct_("settings", |writer| {
        for (name, value) in about::settings_by_name(source) {
            writer.write_scalar_f64(&name, value.as_f64().unwrap_or(f64::NAN))?;
        }
        Ok(())
    })?;
    let mut units = about::units(source, columns);
    units.extend(estimates.map(about::estimate_units).into_iter().flatten());
    mat.struct_("units", |writer| texts(writer, &units))?;
    let device = about::device(source);
    if !device.is_empty() {
        mat.struct_("device", |writer| texts(writer, &device))?;
    }
    if let Some(table) = estimates {
        mat.struct_("estimates", |writer| {
            for column in &table.columns {
                let values: Vec<f64> = column.values.iter().map(|value| value.unwrap_or(f64::NAN)).collect();
                writer.write_f64(&column.name, &[values.len(), 1], &values)?;
            }
            Ok(())
        })?;
    }
    Ok(mat)
}

fn failed(file: &Pending, state: &State, error: MatError) -> Error {
    if let Some(error) = lock(&state.error).take() {
        return error;
    }
    let source = match error {
        MatError::Io(error) | MatError::Hdf5(hdf5_pure::Error::Io(error)) => error,
        other => io::Error::other(other),
    };
    OutputError::write(file.name(), source).into()
}

/// Reports progress while writing, and stops if requested.
struct Watched<'a, W> {
    out: W,
    state: &'a State,
    rows: u64,
    progress: &'a mut dyn FnMut(f64) -> Result<(), Error>,
}

impl<W: Write> Write for Watched<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let done = *lock(&self.state.done) / self.rows.max(1) as f64;
        if let Err(error) = (self.progress)(done) {
            *lock(&self.state.error) = Some(error);
            return Err(io::Error::other("broken off"));
        }
        self.out.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
