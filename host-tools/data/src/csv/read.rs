//! CSV text to columns of numbers, every cell checked.

use std::{
    fs::File,
    io::{self, BufRead, BufReader, Read},
    path::Path,
    sync::Arc,
};

use inerter_core::Machine;
use miette::SourceSpan;

use super::{
    dialect::{self, Dialect},
    error::CsvError,
    excerpt::Excerpt,
};
use crate::words::{nearest, shortened};

const T_S: &str = "t_s";
const ENCODER_COUNT: &str = "encoder_count";

/// Names of the columns of force and terminal, by the kind of machine.
pub fn column_names(machine: Machine) -> (&'static str, &'static str) {
    match machine {
        Machine::Linear => ("force_n", "terminal_m"),
        Machine::Rotary => ("torque_n_m", "terminal_rad"),
    }
}

/// Longest line \[bytes\]: samples take a hundred or so.
const LONGEST_LINE: usize = 1 << 16;
/// Largest count up to which a double holds every whole number.
const MAX_COUNT: f64 = 9_007_199_254_740_992.0;

/// The columns that matter, one entry per sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Name for messages.
    pub file: String,
    /// Time \[s\], strictly increasing.
    pub t_s: Vec<f64>,
    /// Encoder count; only differences matter.
    pub encoder_count: Vec<i64>,
    /// What the names of the columns say of the machine.
    pub machine: Machine,
    /// Force \[N\].
    pub force_n: Vec<f64>,
    /// Terminal displacement \[m\], empty where the file has none.
    pub terminal_m: Vec<f64>,
    /// Line of each sample, from 1.
    pub line: Vec<usize>,
    /// Decimals that `t_s` is written with: how well the sample instants are known.
    pub time_decimals: u32,
    /// What was put right on the way, for the user.
    pub notes: Vec<String>,
}

/// Reads a CSV file.
pub fn read(path: &Path) -> Result<Table, CsvError> {
    let failed = |source| CsvError::Read { path: path.into(), source };
    let bytes = File::open(path).and_then(as_far_as_needed).map_err(failed)?;
    parse(&path.display().to_string(), &bytes)
}

/// All of a CSV file; of another one, however great, the beginning that shows that it is none.
fn as_far_as_needed(source: impl Read) -> io::Result<Vec<u8>> {
    let (mut source, mut bytes) = (BufReader::new(source), Vec::new());
    loop {
        let before = bytes.len();
        (&mut source).take(LONGEST_LINE as u64).read_until(b'\n', &mut bytes)?;
        let portion = bytes.get(before..).unwrap_or_default();
        let open = bytes.iter().rev().take(2 * LONGEST_LINE).take_while(|byte| !b"\r\n".contains(byte)).count();
        if portion.is_empty() || portion.contains(&0) || open > LONGEST_LINE {
            return Ok(bytes);
        }
    }
}

/// Reads CSV from memory; `file` is its name in messages.
pub fn parse(file: &str, bytes: &[u8]) -> Result<Table, CsvError> {
    let text = dialect::decode(file, bytes)?;
    let mut lines = Lines { text: &text, offset: 0, number: 0 };
    let header = lines.next().ok_or_else(|| CsvError::Empty { file: file.into() })?;
    header.check_length(file)?;
    let dialect = Dialect::detect(header.text);
    let columns = Columns::find(file, &header, dialect)?;
    let mut table = Table { file: file.into(), machine: columns.machine, ..Table::default() };
    let mut previous = None;
    for line in lines {
        line.check_length(file)?;
        let row = match columns.row(file, &line, dialect) {
            Err(CsvError::Short { .. } | CsvError::Cell { .. }) if line.is_cut_off(&text) => {
                table
                    .notes
                    .push(format!("{file}, line {}: the file is cut off within this line; left out", line.number));
                break;
            }
            row => row?,
        };
        if let Some(previous) = previous.filter(|previous| row.t_s <= *previous) {
            let (text, at) = line.source(file, row.time_at, row.time_length);
            return Err(CsvError::Time { file: file.into(), line: line.number, previous, time: row.t_s, text, at });
        }
        previous = Some(row.t_s);
        table.t_s.push(row.t_s);
        table.encoder_count.push(row.encoder_count);
        table.force_n.push(row.force_n);
        table.terminal_m.extend(row.terminal_m);
        table.line.push(line.number);
        table.time_decimals = table.time_decimals.max(row.time_decimals);
    }
    if table.t_s.is_empty() {
        return Err(CsvError::Empty { file: file.into() });
    }
    Ok(table)
}

/// A line that is neither blank nor a comment, or is too long.
struct Line<'a> {
    text: &'a str,
    offset: usize,
    number: usize,
}

impl Line<'_> {
    fn check_length(&self, file: &str) -> Result<(), CsvError> {
        if self.text.len() > LONGEST_LINE {
            return Err(CsvError::LongLine { file: file.into(), line: self.number, longest: LONGEST_LINE });
        }
        Ok(())
    }

    /// True for a last line without its line end.
    fn is_cut_off(&self, all: &str) -> bool {
        self.offset + self.text.len() == all.len()
    }

    fn source(&self, file: &str, at: usize, length: usize) -> (Arc<Excerpt>, SourceSpan) {
        let (excerpt, span) = Excerpt::of(file, self.number, self.text, at, length);
        (Arc::new(excerpt), span)
    }
}

struct Lines<'a> {
    text: &'a str,
    offset: usize,
    number: usize,
}

impl<'a> Iterator for Lines<'a> {
    type Item = Line<'a>;

    fn next(&mut self) -> Option<Line<'a>> {
        loop {
            let rest = self.text.get(self.offset..).filter(|rest| !rest.is_empty())?;
            let end = rest.find(['\n', '\r']).unwrap_or(rest.len());
            // Windows ends a line by both, old spreadsheets by the carriage return alone.
            let ending =
                rest.get(end..).map_or(0, |ending| if ending.starts_with("\r\n") { 2 } else { ending.len().min(1) });
            let (line, length) = (rest.get(..end)?, end + ending);
            let found = Line { text: line, offset: self.offset, number: self.number + 1 };
            self.offset += length;
            self.number += 1;
            let content = found.text.trim();
            if found.text.len() > LONGEST_LINE || !(content.is_empty() || content.starts_with(['#', '%'])) {
                return Some(found);
            }
        }
    }
}

struct Row {
    t_s: f64,
    time_at: usize,
    time_length: usize,
    time_decimals: u32,
    encoder_count: i64,
    force_n: f64,
    terminal_m: Option<f64>,
}

/// Where each column is.
struct Columns {
    t_s: usize,
    encoder_count: usize,
    machine: Machine,
    force_n: usize,
    terminal_m: Option<usize>,
}

impl Columns {
    fn find(file: &str, header: &Line, dialect: Dialect) -> Result<Self, CsvError> {
        let names_found: Vec<(usize, &str)> = dialect.fields(header.text).collect();
        if names_found.iter().all(|(_, name)| dialect.number(name).is_some()) {
            let (text, at) = header.source(file, 0, header.text.len());
            return Err(CsvError::NoHeader { file: file.into(), line: header.number, text, at });
        }
        let find = |column: &'static str| -> Result<Option<usize>, CsvError> {
            let mut places = names_found.iter().enumerate().filter(|(_, (_, name))| name.eq_ignore_ascii_case(column));
            let first = places.next();
            if let Some((_, (offset, name))) = places.next() {
                let (text, at) = header.source(file, *offset, name.len());
                return Err(CsvError::DuplicateColumn { file: file.into(), line: header.number, column, text, at });
            }
            Ok(first.map(|(place, _)| place))
        };
        let need = |column: &'static str| {
            find(column)?.ok_or_else(|| {
                let (text, at) = header.source(file, 0, header.text.len());
                let advice = missing_advice(column, &names_found);
                CsvError::MissingColumn { file: file.into(), line: header.number, column, advice, text, at }
            })
        };
        let (force, _) = column_names(Machine::Linear);
        let (torque, angle) = column_names(Machine::Rotary);
        let is_rotary = find(torque)?.is_some() || (find(angle)?.is_some() && find(force)?.is_none());
        let machine = if is_rotary { Machine::Rotary } else { Machine::Linear };
        let other = match machine {
            Machine::Linear => column_names(Machine::Rotary),
            Machine::Rotary => column_names(Machine::Linear),
        };
        let (force, terminal) = column_names(machine);
        for column in [other.0, other.1] {
            if let Some((offset, name)) = find(column)?.and_then(|place| names_found.get(place)) {
                let (text, at) = header.source(file, *offset, name.len());
                return Err(CsvError::MixedMachines {
                    file: file.into(),
                    line: header.number,
                    column,
                    other: force,
                    text,
                    at,
                });
            }
        }
        Ok(Self {
            t_s: need(T_S)?,
            encoder_count: need(ENCODER_COUNT)?,
            machine,
            force_n: need(force)?,
            terminal_m: find(terminal)?,
        })
    }

    fn row(&self, file: &str, line: &Line, dialect: Dialect) -> Result<Row, CsvError> {
        let fields: Vec<(usize, &str)> = dialect.fields(line.text).collect();
        let cell = |place: usize, column: &'static str| -> Result<(f64, usize, &str), CsvError> {
            let Some((offset, field)) = fields.get(place).copied() else {
                let (text, at) = line.source(file, 0, line.text.len());
                return Err(CsvError::Short { file: file.into(), line: line.number, column, text, at });
            };
            match dialect.number(field) {
                Some(value) if value.is_finite() => Ok((value, offset, field)),
                number => {
                    let (text, at) = line.source(file, offset, field.len());
                    let (what, advice) = cell_words(field, number);
                    Err(CsvError::Cell { file: file.into(), line: line.number, column, what, advice, text, at })
                }
            }
        };
        let (t_s, time_at, time) = cell(self.t_s, T_S)?;
        let (count, count_at, count_field) = cell(self.encoder_count, ENCODER_COUNT)?;
        if count.fract() != 0.0 || count.abs() > MAX_COUNT {
            let (text, at) = line.source(file, count_at, count_field.len());
            return Err(CsvError::Cell {
                file: file.into(),
                line: line.number,
                column: ENCODER_COUNT,
                what: format!("{} is not a whole number of counts", shortened(count_field)),
                advice: "the encoder's raw counts are needed: a displacement in metres must be divided by the metres per \
                         count and rounded",
                text,
                at,
            });
        }
        let (force, terminal) = column_names(self.machine);
        let (force_n, _, _) = cell(self.force_n, force)?;
        let terminal_m = self.terminal_m.map(|place| cell(place, terminal)).transpose()?.map(|(value, _, _)| value);
        Ok(Row {
            t_s,
            time_at,
            time_length: time.len(),
            time_decimals: decimals(time),
            encoder_count: count as i64,
            force_n,
            terminal_m,
        })
    }
}

fn missing_advice(column: &str, names: &[(usize, &str)]) -> String {
    let (force, terminal) = column_names(Machine::Linear);
    let found = names.iter().map(|(_, name)| *name).filter(|name| !name.is_empty()).collect::<Vec<_>>().join(", ");
    let rename = nearest(column, names.iter().map(|(_, name)| *name))
        .filter(|near| ![T_S, ENCODER_COUNT, force, terminal].contains(near));
    match rename {
        Some(near) => {
            format!("rename `{}` if it is the one, in the unit that the name `{column}` ends with", shortened(near))
        }
        None => {
            format!("the columns t_s, encoder_count and force_n are needed, in any order; found: {}", shortened(&found))
        }
    }
}

fn cell_words(field: &str, number: Option<f64>) -> (String, &'static str) {
    let field = shortened(field);
    let leave_out = "leave the whole line out where a sample is missing";
    match number {
        Some(value) => (format!("the value is not finite ({value})"), leave_out),
        None if field.is_empty() => ("the cell is empty".into(), leave_out),
        None if field.contains(',') => {
            (format!("`{field}` is not a number"), "write numbers with one decimal sign and no thousands separators")
        }
        None => (format!("`{field}` is not a number"), "write a number, for example -12.5 or 3e-4"),
    }
}

/// Decimals behind the point of a written number, exponent included.
fn decimals(text: &str) -> u32 {
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let written = mantissa.split_once(['.', ',']).map_or(0, |(_, fraction)| fraction.len());
    let shift: i64 = exponent.parse().unwrap_or(0);
    u32::try_from((written as i64 - shift).clamp(0, 18)).unwrap_or(0)
}

#[cfg(test)]
#[path = "read_tests.rs"]
mod tests;
