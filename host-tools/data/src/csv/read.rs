//! Parses CSV text into columns of numbers and checks every cell.

use std::path::Path;

use inerter_core::Machine;

use super::{
    dialect::{self, Dialect},
    error::CsvError,
    lines::{Header, Line, Lines, bytes_of, cell},
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
    let columns = Columns::find(&header)?;
    let mut table = Table { file: file.into(), machine: columns.machine, ..Table::default() };
    for line in lines {
        line.check_length()?;
        match table.take(&columns, &line, header.dialect) {
            Err(CsvError::Short { .. } | CsvError::Cell { .. }) if line.is_cut_off(&text) => {
                table
                    .notes
                    .push(format!("{file}, line {}: the file ends within this line, which is left out", line.number));
                break;
            }
            taken => taken?,
        }
    }
    if table.t_s.is_empty() {
        return Err(CsvError::Empty { file: file.into(), header: HEADER });
    }
    Ok(table)
}

/// The name and the index of each column, and the machine that the names belong to.
struct Columns {
    machine: Machine,
    /// Time, encoder count and force.
    needed: [(&'static str, usize); 3],
    terminal: Option<(&'static str, usize)>,
}

impl Columns {
    fn find(header: &Header) -> Result<Self, CsvError> {
        let find = |column| header.find(column);
        let need = |column| Ok::<_, CsvError>((column, header.need(column, |names| missing_advice(column, names))?));
        let [linear, rotary] = [Machine::Linear, Machine::Rotary].map(column_names);
        let is_rotary = find(rotary.0)?.is_some() || (find(rotary.1)?.is_some() && find(linear.0)?.is_none());
        let (machine, (force, terminal), others) =
            if is_rotary { (Machine::Rotary, rotary, linear) } else { (Machine::Linear, linear, rotary) };
        for column in [others.0, others.1] {
            if let Some((offset, name)) = find(column)?.and_then(|place| header.names.get(place)) {
                let (text, at) = header.line.source(*offset, name.len());
                return Err(CsvError::MixedMachines { column, other: force, text, at });
            }
        }
        let needed = [need(T_S)?, need(ENCODER_COUNT)?, need(force)?];
        Ok(Self { machine, needed, terminal: find(terminal)?.map(|place| (terminal, place)) })
    }
}

impl Table {
    /// Adds the sample in a line.
    fn take(&mut self, columns: &Columns, line: &Line, dialect: Dialect) -> Result<(), CsvError> {
        let fields: Vec<_> = dialect.fields(line.text).collect();
        let cell = |(column, place)| cell(line, dialect, &fields, place, column);
        let [time, count, force] = columns.needed.map(cell);
        let (time, (count, count_at, count_field)) = (time?, count?);
        if count.fract() != 0.0 || count.abs() > MAX_COUNT {
            let (text, at) = line.source(count_at, count_field.len());
            return Err(CsvError::Cell {
                column: ENCODER_COUNT,
                what: format!("{} is not a whole number of counts", shortened(count_field)),
                advice: "the encoder's raw counts are needed: a displacement in metres must be divided by the metres per \
                         count and rounded",
                text,
                at,
            });
        }
        let ((force_n, ..), terminal) = (force?, columns.terminal.map(cell).transpose()?);
        let (t_s, decimals) = line.later(self.t_s.last(), time)?;
        self.t_s.push(t_s);
        self.encoder_count.push(count as i64);
        self.force_n.push(force_n);
        self.terminal_m.extend(terminal.map(|(terminal_m, ..)| terminal_m));
        self.line.push(line.number);
        self.time_decimals = self.time_decimals.max(decimals);
        Ok(())
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
