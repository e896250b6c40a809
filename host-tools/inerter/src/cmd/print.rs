//! Machine-readable results on standard output: one object per line.

use inerter_core::Machine;
use inerter_data::{
    json::{json_line, machine_json_line},
    output,
};
use serde::Serialize;

use crate::Error;

/// An object whose first key is its kind.
#[derive(Serialize)]
pub struct Kind<'a, T> {
    pub kind: &'static str,
    #[serde(flatten)]
    pub of: &'a T,
}

/// Prints an object.
pub fn print_json(value: &impl Serialize) -> Result<(), Error> {
    Ok(output::line(json_line(value))?)
}

/// Prints an object with the key names of this machine.
pub fn print_machine_json(machine: Machine, value: &impl Serialize) -> Result<(), Error> {
    Ok(output::line(machine_json_line(machine, value))?)
}

/// Lines of a table with aligned columns, and this between them.
pub fn aligned(rows: &[Vec<String>], between: &str) -> Vec<String> {
    let cells = |place: usize| rows.iter().filter_map(move |row| row.get(place));
    let width = |place: usize| cells(place).map(|cell| cell.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..rows.first().map_or(0, Vec::len)).map(width).collect();
    let line = |row: &Vec<String>| {
        let padded: Vec<String> = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}")).collect();
        padded.join(between).trim_end().to_string()
    };
    rows.iter().map(line).collect()
}

/// A line of CSV, with its end.
pub fn csv_line(cells: impl IntoIterator<Item = String>) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    // It writes to memory.
    let _ = writer.write_record(cells);
    String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
}

/// Prints a line and flushes it, because a reader waits for it.
pub fn print_now(line: impl AsRef<str>) -> Result<(), Error> {
    output::line(line)?;
    Ok(output::flush()?)
}
