//! Parses CSV text into columns of numbers and checks every cell.

use std::path::Path;

use inerter_core::Machine;

use super::{
    dialect::{self, Dialect},
    error::CsvError,
    lines::{Cell, Header, Line, Lines, bytes_of, cell},
};
use crate::words::{nearest, shortened};

const T_S: &str = "t_s";
/// An example of a valid header.
const HEADER: &str = "t_s,encoder_count,force_n";
const ENCODER_COUNT: &str = "encoder_count";

/// Names of the columns of force and terminal, by the kind of machine.
pub fn column_names(machine: Machine) -> (&'static str, &'static str) {
    match machine {
        Machine::Linear => ("force_n", "terminal_m"),
        Machine::Rotary => ("torque_n_m", "terminal_rad"),
    }
}

/// Largest count up to which a double represents every integer.
const MAX_COUNT: f64 = 9_007_199_254_740_992.0;

/// The columns that are used, one entry per sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Name for messages.
    pub file: String,
    /// Time \[s\], strictly increasing.
    pub t_s: Vec<f64>,
    /// Encoder count; only differences matter.
    pub encoder_count: Vec<i64>,
    /// The machine, by the names of the columns.
    pub machine: Machine,
    /// Force \[N\].
    pub force_n: Vec<f64>,
    /// Terminal displacement \[m\], empty if the file has none.
    pub terminal_m: Vec<f64>,
    /// Line of each sample, from 1.
    pub line: Vec<usize>,
    /// Number of decimals of `t_s`: the resolution of the sample times.
    pub time_decimals: u32,
    /// What was repaired while reading, for the user.
    pub notes: Vec<String>,
}

/// Reads a CSV file.
pub fn read(path: &Path) -> Result<Table, CsvError> {
    parse(&path.display().to_string(), &bytes_of(path)?)
}

/// Reads CSV from memory; `file` is its name in messages.
pub fn parse(file: &str, bytes: &[u8]) -> Result<Table, CsvError> {
    let text = dialect::decode(file, bytes)?;
    let mut lines = Lines::of(file, &text);
    let header = Header::read(&mut lines, HEADER)?;
    let dialect = header.dialect;
    let columns = Columns::find(&header)?;
    let mut table = Table { file: file.into(), machine: columns.machine, ..Table::default() };
    for line in lines {
        line.check_length()?;
        let row = match columns.row(&line, dialect) {
            Err(CsvError::Short { .. } | CsvError::Cell { .. }) if line.is_cut_off(&text) => {
                table
                    .notes
                    .push(format!("{file}, line {}: the file ends within this line, which is left out", line.number));
                break;
            }
            row => row?,
        };
        let (t_s, decimals) = line.later(table.t_s.last(), row.time)?;
        table.t_s.push(t_s);
        table.encoder_count.push(row.encoder_count);
        table.force_n.push(row.force_n);
        table.terminal_m.extend(row.terminal_m);
        table.line.push(line.number);
        table.time_decimals = table.time_decimals.max(decimals);
    }
    if table.t_s.is_empty() {
        return Err(CsvError::Empty { file: file.into(), header: HEADER });
    }
    Ok(table)
}

struct Row<'a> {
    time: Cell<'a>,
    encoder_count: i64,
    force_n: f64,
    terminal_m: Option<f64>,
}

/// The index of each column.
struct Columns {
    t_s: usize,
    encoder_count: usize,
    machine: Machine,
    force_n: usize,
    terminal_m: Option<usize>,
}

impl Columns {
    fn find(header: &Header) -> Result<Self, CsvError> {
        let find = |column| header.find(column);
        let need = |column| header.need(column, |names| missing_advice(column, names));
        let [linear, rotary] = [Machine::Linear, Machine::Rotary].map(column_names);
        let is_rotary = find(rotary.0)?.is_some() || (find(rotary.1)?.is_some() && find(linear.0)?.is_none());
        let (machine, (force, terminal), others) =
            if is_rotary { (Machine::Rotary, rotary, linear) } else { (Machine::Linear, linear, rotary) };
        for column in [others.0, others.1] {
            if let Some((offset, name)) = find(column)?.and_then(|place| header.names.get(place)) {
                let (file, line, text, at) = header.line.source(*offset, name.len());
                return Err(CsvError::MixedMachines { file, line, column, other: force, text, at });
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

    fn row<'a>(&self, line: &Line<'a>, dialect: Dialect) -> Result<Row<'a>, CsvError> {
        let fields: Vec<_> = dialect.fields(line.text).collect();
        let cell = |place, column| cell(line, dialect, &fields, place, column);
        let time = cell(self.t_s, T_S)?;
        let (count, count_at, count_field) = cell(self.encoder_count, ENCODER_COUNT)?;
        if count.fract() != 0.0 || count.abs() > MAX_COUNT {
            let (file, line, text, at) = line.source(count_at, count_field.len());
            return Err(CsvError::Cell {
                file,
                line,
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
        Ok(Row { time, encoder_count: count as i64, force_n, terminal_m })
    }
}

fn missing_advice(column: &str, names: &[(usize, &str)]) -> String {
    let (force, terminal) = column_names(Machine::Linear);
    let found = names.iter().map(|(_, name)| *name).filter(|name| !name.is_empty()).collect::<Vec<_>>().join(", ");
    let rename = nearest(column, names.iter().map(|(_, name)| *name))
        .filter(|near| ![T_S, ENCODER_COUNT, force, terminal].contains(near));
    match rename {
        Some(near) => {
            format!(
                "if `{}` is that column, rename it; its unit must be the one that `{column}` ends with",
                shortened(near)
            )
        }
        None => {
            format!("the columns t_s, encoder_count and force_n are needed, in any order; found: {}", shortened(&found))
        }
    }
}

#[cfg(test)]
#[path = "read_tests.rs"]
mod tests;
