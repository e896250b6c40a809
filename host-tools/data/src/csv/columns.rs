//! Columns already in memory, with every number checked.

use inerter_core::Machine;
use miette::Diagnostic;

use super::read::{Table, column_names};

/// Maximum number of decimals considered for a time.
const MOST_DECIMALS: i32 = 12;
/// Fraction of the last decimal by which a time may miss it.
const MISSED: f64 = 1e-3;

/// Columns that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum ColumnsError {
    /// The columns differ in length.
    #[error("{name}: `{column}` has {length} values, and `t_s` has {samples}")]
    #[diagnostic(code(inerter::columns::length), help("give each column one value per sample"))]
    Length { name: String, column: &'static str, length: usize, samples: usize },

    /// Not a number, or infinite.
    #[error("{name}: `{column}[{row}]` is {value}")]
    #[diagnostic(
        code(inerter::columns::number),
        help("leave out the rows where a value is missing: the estimator assumes nothing about them")
    )]
    Number { name: String, column: &'static str, row: usize, value: f64 },

    /// Time does not increase.
    #[error("{name}: `t_s[{row}]` is {time}, and the one before it {previous}")]
    #[diagnostic(code(inerter::columns::time), help("`t_s` is in seconds and increases from sample to sample"))]
    Time { name: String, row: usize, previous: f64, time: f64 },

    /// No rows.
    #[error("{name}: there are no samples")]
    #[diagnostic(code(inerter::columns::empty), help("give columns with one value per sample"))]
    Empty { name: String },
}

impl Table {
    /// A table of these columns: time \[s\], encoder count, force \[N\] or torque \[N m\], and displacement of the
    /// terminal \[m\] or \[rad\], which is empty if it was not measured. `name` identifies the run in messages.
    pub fn of_columns(
        name: String,
        machine: Machine,
        t_s: Vec<f64>,
        encoder_count: Vec<i64>,
        force_n: Vec<f64>,
        terminal_m: Vec<f64>,
    ) -> Result<Self, ColumnsError> {
        let (force, terminal) = column_names(machine);
        let samples = t_s.len();
        if samples == 0 {
            return Err(ColumnsError::Empty { name });
        }
        let terminals = if terminal_m.is_empty() { samples } else { terminal_m.len() };
        for (column, length) in [("encoder_count", encoder_count.len()), (force, force_n.len()), (terminal, terminals)]
        {
            if length != samples {
                return Err(ColumnsError::Length { name, column, length, samples });
            }
        }
        for (column, values) in [("t_s", &t_s), (force, &force_n), (terminal, &terminal_m)] {
            if let Some((row, value)) = values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
                return Err(ColumnsError::Number { name, column, row, value: *value });
            }
        }
        for (row, pair) in t_s.windows(2).enumerate() {
            if let [previous, time] = *pair
                && time <= previous
            {
                return Err(ColumnsError::Time { name, row: row + 1, previous, time });
            }
        }
        Ok(Self {
            file: name,
            time_decimals: decimals(&t_s),
            t_s,
            encoder_count,
            machine,
            force_n,
            terminal_m,
            line: (1..=samples).collect(),
            notes: Vec::new(),
        })
    }
}

/// The number of decimals needed to write these times.
fn decimals(t_s: &[f64]) -> u32 {
    let have = |decimals: i32| {
        let scale = 10f64.powi(decimals);
        t_s.iter().all(|time| {
            (time * scale - (time * scale).round()).abs() <= MISSED.max(time.abs() * scale * 4.0 * f64::EPSILON)
        })
    };
    (0..MOST_DECIMALS).find(|decimals| have(*decimals)).unwrap_or(MOST_DECIMALS).unsigned_abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(t_s: &[f64], counts: &[i64], force_n: &[f64], terminal_m: &[f64]) -> Result<Table, ColumnsError> {
        Table::of_columns("run".into(), Machine::Linear, t_s.into(), counts.into(), force_n.into(), terminal_m.into())
    }

    #[test]
    fn columns_in_memory_are_what_a_file_of_them_would_be() {
        let text = "t_s,encoder_count,force_n,terminal_m\n0.001,1,0.5,1e-6\n0.002,-2,-0.25,2e-6\n";
        let read = super::super::parse("run", text.as_bytes()).unwrap();
        let made = table(&[0.001, 0.002], &[1, -2], &[0.5, -0.25], &[1e-6, 2e-6]).unwrap();
        assert_eq!(Table { line: read.line.clone(), ..made }, read);
    }

    #[test]
    fn times_have_the_decimals_they_are_written_with() {
        let of = |period: f64| decimals(&(0..1000).map(|n| 5000.0 + f64::from(n) * period).collect::<Vec<_>>());
        assert_eq!([1.0, 0.25, 1e-3].map(of), [0, 2, 3]);
        // As many as a double resolves there.
        assert!(of(1.0 / 3.0) >= 10);
    }

    #[test]
    fn columns_that_cannot_be_used_are_named() {
        let code = |result: Result<Table, ColumnsError>| result.unwrap_err().code().unwrap().to_string();
        let good = [0.0, 1.0];
        assert_eq!(code(table(&[], &[], &[], &[])), "inerter::columns::empty");
        assert_eq!(code(table(&good, &[0], &good, &[])), "inerter::columns::length");
        assert_eq!(code(table(&good, &[0, 1], &good, &[1.0])), "inerter::columns::length");
        assert_eq!(code(table(&good, &[0, 1], &[0.0, f64::NAN], &[])), "inerter::columns::number");
        assert_eq!(code(table(&[1.0, 1.0], &[0, 1], &good, &[])), "inerter::columns::time");
        let error = table(&good, &[0, 1], &[0.0, f64::INFINITY], &[]).unwrap_err();
        assert_eq!(error.to_string(), "run: `force_n[1]` is inf");
    }
}
