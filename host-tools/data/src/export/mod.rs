//! Samples and estimates for other tools: CSV, Parquet, MATLAB and MCAP, in bounded memory.
//!
//! A [`Source`] is read once to find its extent, once more for CSV, Parquet and MCAP together, with one thread reading
//! and another writing, and once for each column of a MATLAB file, whose layout needs whole columns. Files get their
//! names when they are complete ([`output::Pending`](crate::output::Pending)).

mod about;
#[cfg(feature = "parquet")]
mod columnar;
mod columns;
mod estimates;
#[cfg(feature = "parquet")]
mod held;
#[cfg(feature = "matlab")]
mod mat;
mod messages;
mod selection;
mod source;
mod text;

use std::{
    ops::Range,
    path::{Path, PathBuf},
    sync::mpsc,
};

pub use about::settings_by_name;
#[cfg(feature = "parquet")]
pub use columnar::table_bytes;
pub use columns::{Column, Kind, Values};
pub use estimates::EstimateTable;
#[cfg(feature = "parquet")]
pub use held::{Cells, HeldColumn};
pub use selection::{Format, Selection};
pub use source::{Row, Rows, Samples, Source};

use selection::Sink;

use crate::{error::Error, output::Pending, recording::RecordingError};

/// Rows that are read, passed on and written together.
const BATCH: usize = 1 << 17;
/// Batches that wait between the two threads.
const BATCHES: usize = 1;

/// What has been written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exported {
    /// Rows in each file.
    pub rows: u64,
    /// Rows in each table of estimates.
    pub estimates: u64,
    /// The files, each with its format, including the tables of estimates beside them.
    pub files: Vec<(Format, PathBuf)>,
}

/// Writes the selection to all of the files.
///
/// `progress` gets the completed fraction, from 0 to 1, and may stop the work. A new file replaces an existing one only
/// when complete, and only if `replace` is set.
pub fn export(
    source: &Source,
    selection: &Selection,
    targets: &[(Format, PathBuf)],
    replace: bool,
    estimates: Option<&EstimateTable>,
    progress: &mut dyn FnMut(f64) -> Result<(), Error>,
) -> Result<Exported, Error> {
    let mut pending = Vec::new();
    let mut sinks = Vec::new();
    for (format, path) in targets {
        let file = Pending::create(path, replace)?;
        let columns = selection.columns(*format, source);
        let sink: Option<Box<dyn Sink>> = match format {
            Format::Csv => Some(Box::new(text::Csv::create(&file, source, columns)?)),
            #[cfg(feature = "parquet")]
            Format::Parquet => Some(Box::new(columnar::Parquet::create(&file, source, columns)?)),
            Format::Mcap => Some(Box::new(messages::Mcap::create(&file, source, columns)?)),
            // Needs its columns one by one.
            #[cfg(feature = "matlab")]
            Format::Mat => None,
            #[cfg(not(all(feature = "parquet", feature = "matlab")))]
            _ => return Err(crate::output::OutputError::BuiltWithout { path: path.clone() }.into()),
        };
        sinks.extend(sink);
        pending.push((*format, file));
        // The other formats hold the estimates themselves, or none.
        if let (Some(table), Format::Csv | Format::Parquet) = (estimates, format) {
            let beside = Pending::create(&beside(path), replace)?;
            match format {
                #[cfg(feature = "parquet")]
                Format::Parquet => columnar::write_estimates(&beside, source, table)?,
                _ => table.write_csv(&beside)?,
            }
            pending.push((*format, beside));
        }
    }
    let columns = selection.columns(Format::Mat, source);
    let mats = targets.iter().filter(|(format, _)| *format == Format::Mat).count();
    let passes = usize::from(!sinks.is_empty()) + mats * columns.len();
    let mut part = |pass: usize, of_it: f64| progress((pass as f64 + of_it) / passes.max(1) as f64);
    let mut rows = None;
    if !sinks.is_empty() {
        rows = Some(write_rows(source, selection, sinks, |of_it| part(0, of_it))?);
    }
    #[cfg(feature = "matlab")]
    {
        let mut pass = usize::from(rows.is_some());
        for (_, file) in pending.iter().filter(|(format, _)| *format == Format::Mat) {
            let rows = match rows {
                Some(rows) => rows,
                None => *rows.insert(count(source, selection)?),
            };
            mat::write(file, source, selection, &columns, rows, estimates, &mut |of_it| part(pass, of_it))?;
            pass += columns.len();
        }
    }
    let Some(rows) = rows.filter(|rows| *rows > 0) else { return Err(empty(source, selection)) };
    let mut files = Vec::new();
    for (format, file) in pending {
        files.push((format, file.commit()?));
    }
    let estimates = estimates.map_or(0, |table| table.rows() as u64);
    Ok(Exported { rows, estimates, files })
}

/// Writes the selected columns as CSV to any writer, such as standard output.
pub fn write_csv(
    source: &Source,
    selection: &Selection,
    name: &str,
    out: impl std::io::Write + Send + 'static,
    progress: &mut dyn FnMut(f64) -> Result<(), Error>,
) -> Result<u64, Error> {
    let sink = text::Csv::new(name, Box::new(out), source, selection.columns(Format::Csv, source))?;
    match write_rows(source, selection, vec![Box::new(sink)], progress)? {
        0 => Err(empty(source, selection)),
        rows => Ok(rows),
    }
}

/// The error when nothing lies in the range.
fn empty(source: &Source, selection: &Selection) -> Error {
    let Range { start: from_s, end: to_s } = selection.range_s;
    RecordingError::EmptyRange { file: source.name.clone(), from_s, to_s, duration_s: source.duration_s() }.into()
}

/// The name of the table of estimates beside a file: `run.csv` gets `run.estimates.csv`.
pub fn beside(path: &Path) -> PathBuf {
    let extension = path.extension().map(|extension| extension.to_string_lossy()).unwrap_or_default();
    path.with_extension(format!("estimates.{extension}"))
}

/// Rows of the selection.
#[cfg(feature = "matlab")]
fn count(source: &Source, selection: &Selection) -> Result<u64, Error> {
    let range = &selection.range_s;
    if range.start <= 0.0 && range.end > source.duration_s() {
        return Ok(source.extent.samples);
    }
    source.rows(range.clone())?.try_fold(0, |count, row| row.map(|_| count + 1))
}

/// One pass for all sinks: another thread reads, this one writes.
fn write_rows(
    source: &Source,
    selection: &Selection,
    mut sinks: Vec<Box<dyn Sink>>,
    mut progress: impl FnMut(f64) -> Result<(), Error>,
) -> Result<u64, Error> {
    let (full, filled) = mpsc::sync_channel::<Result<Vec<Row>, Error>>(BATCHES);
    let count = std::thread::scope(|scope| {
        scope.spawn(move || {
            let read = || -> Result<(), Error> {
                let mut rows = source.rows(selection.range_s.clone())?;
                loop {
                    let batch: Vec<Row> = rows.by_ref().take(BATCH).collect::<Result<_, _>>()?;
                    // Nobody receives it once writing has failed.
                    if batch.is_empty() || full.send(Ok(batch)).is_err() {
                        return Ok(());
                    }
                }
            };
            if let Err(error) = read() {
                full.send(Err(error)).ok();
            }
        });
        let mut count = 0;
        for rows in filled {
            let rows = rows?;
            count += rows.len() as u64;
            sinks.iter_mut().try_for_each(|sink| sink.take(source, &rows))?;
            progress(count as f64 / source.extent.samples.max(1) as f64)?;
        }
        Ok::<u64, Error>(count)
    })?;
    for sink in sinks {
        sink.finish()?;
    }
    Ok(count)
}
