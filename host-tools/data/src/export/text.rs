//! CSV.

use std::io::{self, Write};

use super::{Column, Row, Source, selection::Sink};
use crate::output::{OutputError, Pending};

/// A CSV being written. Numbers have enough digits to read back exactly.
pub(super) struct Csv {
    name: String,
    writer: csv::Writer<Box<dyn Write>>,
    columns: Vec<Column>,
}

impl Csv {
    pub(super) fn create(file: &Pending, source: &Source, columns: Vec<Column>) -> Result<Self, OutputError> {
        Self::new(&file.name(), Box::new(file.open()?), source, columns)
    }

    pub(super) fn new(
        name: &str,
        out: Box<dyn Write>,
        source: &Source,
        columns: Vec<Column>,
    ) -> Result<Self, OutputError> {
        // Numbers need no quotes, so they are not searched for characters that would.
        let mut builder = csv::WriterBuilder::new();
        builder.has_headers(false).quote_style(csv::QuoteStyle::Never).buffer_capacity(1 << 16);
        let mut csv = Self { name: name.into(), writer: builder.from_writer(out), columns };
        let names = csv.columns.iter().map(|column| column.name(source.settings.machine));
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
    fn take(&mut self, source: &Source, rows: &[Row]) -> Result<(), OutputError> {
        let mut cells = Vec::with_capacity(self.columns.len());
        for (sample, point) in rows {
            cells.clear();
            cells.extend(self.columns.iter().map(|column| column.cell(source, sample, point)));
            self.writer.serialize(&cells).map_err(|error| self.failed(error))?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), OutputError> {
        self.writer.flush().map_err(|source| OutputError::write(&self.name, source))
    }
}
