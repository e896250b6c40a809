//! What to write, and in which format.

use std::ops::Range;

use super::{
    columns::Column,
    source::{Row, Source},
};
use crate::output::OutputError;

/// A format for other tools.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Text, one line per sample.
    Csv,
    /// Columns for pandas, Polars, DuckDB and MATLAB's `parquetread`; with the feature `parquet`.
    Parquet,
    /// MATLAB v7.3, which is HDF5; with the feature `matlab`.
    Mat,
    /// Samples in JSON for PlotJuggler and Foxglove.
    Mcap,
}

/// Columns of formats in which they take little space.
const WHOLE: &[Column] = &[Column::Time, Column::EncoderCount, Column::Position, Column::Force];

/// What to write.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Columns, if not the usual ones.
    pub columns: Option<Vec<Column>>,
    /// Time since the first sample \[s\]; the end is excluded.
    pub range_s: Range<f64>,
}

impl Default for Selection {
    fn default() -> Self {
        Self { columns: None, range_s: 0.0..f64::INFINITY }
    }
}

impl Selection {
    /// The columns for a format.
    pub fn columns(&self, format: Format, source: &Source) -> Vec<Column> {
        let usual = match format {
            Format::Csv => &[Column::Time, Column::EncoderCount, Column::Force][..],
            Format::Mcap => &[Column::Time, Column::Position, Column::Force],
            Format::Parquet | Format::Mat => WHOLE,
        };
        let terminal = source.settings.terminal_sensor.then_some(Column::Terminal);
        self.columns.clone().unwrap_or_else(|| usual.iter().copied().chain(terminal).collect())
    }
}

/// A file of a format that takes rows one after the other.
pub(super) trait Sink {
    /// Writes the next rows.
    fn take(&mut self, source: &Source, rows: &[Row]) -> Result<(), OutputError>;
    /// Completes the file.
    fn finish(self: Box<Self>) -> Result<(), OutputError>;
}
