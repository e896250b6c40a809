//! CSV.

use std::io::{self, Write};

use super::{Batch, Column, Source, selection::Sink};
use crate::output::{OutputError, Pending};

/// A CSV being written. Numbers have enough digits to read back exactly.
pub(super) struct Csv {
    name: String,
    writer: csv::Writer<Box<dyn Write>>,
}

impl Csv {
    pub(super) fn create(file: &Pending, source: &Source, columns: &[Column]) -> Result<Self, OutputError> {
        Self::new(&file.name(), Box::new(file.open()?), source, columns)
    }

    pub(super) fn new(
        name: &str,
        out: Box<dyn Write>,
        source: &Source,
        columns: &[Column],
    ) -> Result<Self, OutputError> {
        // Numbers need no quotes, so they are not searched for characters that would.
        let mut builder = csv::WriterBuilder::new();
        builder.has_headers(false).quote_style(csv::QuoteStyle::Never).buffer_capacity(1 << 16);
        let mut csv = Self { name: name.into(), writer: builder.from_writer(out) };
        let names = columns.iter().map(|column| column.name(source.settings.machine));
        csv.writer.write_record(names).map_err(|error| csv.failed(error))?;
        Ok(csv)
    }

    fn failed(&self, error: csv::Error) -> OutputError {
        OutputError::write(&self.name, into_io(error))
    }
}

/// The operating system's reason.
pub(super) fn into_io(error: csv::Error) -> io::Error {
    match error.into_kind() {
        csv::ErrorKind::Io(error) => error,
        other => io::Error::other(format!("{other:?}")),
    }
}

impl Sink for Csv {
    fn take(&mut self, batch: &Batch) -> Result<(), OutputError> {
        let mut row = Vec::with_capacity(batch.columns.len());
        for number in 0..batch.rows {
            row.clear();
            row.extend(batch.columns.iter().filter_map(|(_, values)| values.cell(number)));
            self.writer.serialize(&row).map_err(|error| self.failed(error))?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), OutputError> {
        self.writer.flush().map_err(|source| OutputError::write(&self.name, source))
    }
}
