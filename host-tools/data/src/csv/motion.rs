//! A motion as a CSV, for a shaker and for the plant.
//!
//! Columns `t_s,terminal_m,velocity_m_per_s,acceleration_m_per_s2`, for a rotary machine
//! `t_s,terminal_rad,velocity_rad_per_s,acceleration_rad_per_s2`; comments above them describe it. Only time and
//! displacement are read back.

use std::path::Path;

use inerter_core::Machine;

use super::{
    dialect,
    error::CsvError,
    lines::{Header, Lines, bytes_of, cell},
    read::column_names,
    timebase,
};
use crate::{
    output::{self, OutputError},
    words::{printable, shortened},
};

/// An example of a valid header.
const HEADER: &str = "t_s,terminal_m";

/// One point of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Time \[s\].
    pub t_s: f64,
    /// Displacement of the terminal \[m\].
    pub terminal_m: f64,
    /// Its velocity \[m/s\].
    pub velocity_m_per_s: f64,
    /// Its acceleration \[m/s^2\].
    pub acceleration_m_per_s2: f64,
}

/// Displacements of a terminal at equal time steps.
#[derive(Clone, Debug, PartialEq)]
pub struct Displacements {
    /// Time from point to point \[s\].
    pub period_s: f64,
    /// Displacements \[m\].
    pub terminal_m: Vec<f64>,
}

/// Writes a motion whole or not at all, with comment lines above it. Replaces an existing file only with `replace`.
pub fn write(
    path: &Path,
    replace: bool,
    machine: Machine,
    comments: &[String],
    points: impl Iterator<Item = Point>,
) -> Result<(), OutputError> {
    output::write(path, replace, text(machine, comments, points))
}

/// The same as text.
pub fn text(machine: Machine, comments: &[String], points: impl Iterator<Item = Point>) -> String {
    let (_, terminal) = column_names(machine);
    let unit = terminal.strip_prefix("terminal_").unwrap_or_default();
    let mut text: String = comments.iter().map(|comment| format!("# {}\n", printable(comment))).collect();
    text += &format!("t_s,{terminal},velocity_{unit}_per_s,acceleration_{unit}_per_s2\n");
    for Point { t_s, terminal_m, velocity_m_per_s, acceleration_m_per_s2 } in points {
        let [x, v, a] = [terminal_m, velocity_m_per_s, acceleration_m_per_s2].map(rounded);
        text += &format!("{t_s},{x},{v},{a}\n");
    }
    text
}

/// To a picometre (or the equivalent): more digits than any shaker can follow.
fn rounded(value: f64) -> f64 {
    // Avoids a negative zero.
    (value * 1e12).round() / 1e12 + 0.0
}

/// Reads the displacements of a motion.
pub fn read(path: &Path) -> Result<Displacements, CsvError> {
    parse(&path.display().to_string(), &bytes_of(path)?)
}

/// The same from memory; `file` is its name in messages.
pub fn parse(file: &str, bytes: &[u8]) -> Result<Displacements, CsvError> {
    let text = dialect::decode(file, bytes)?;
    let mut lines = Lines::of(file, &text);
    let header = Header::read(&mut lines, HEADER)?;
    let [linear, rotary] = [Machine::Linear, Machine::Rotary].map(|machine| column_names(machine).1);
    let terminal = if header.find(rotary)?.is_some() && header.find(linear)?.is_none() { rotary } else { linear };
    let advice = |names: &[(usize, &str)]| {
        let found = names.iter().map(|(_, name)| *name).collect::<Vec<_>>().join(", ");
        format!("a motion has the columns t_s and {linear} or {rotary}; found: {}", shortened(&found))
    };
    let places = [("t_s", header.need("t_s", advice)?), (terminal, header.need(terminal, advice)?)];
    let (mut times, mut terminal_m, mut digits) = (Vec::new(), Vec::new(), 0);
    for line in lines {
        line.check_length()?;
        let fields: Vec<_> = header.dialect.fields(line.text).collect();
        let [time, displacement] = places.map(|(column, place)| cell(&line, header.dialect, &fields, place, column));
        let (t_s, decimals) = line.later(times.last(), time?)?;
        times.push(t_s);
        terminal_m.push(displacement?.0);
        digits = digits.max(decimals);
    }
    let timebase = timebase::find(file, &times, digits)?;
    if timebase.missing > 0 || timebase.irregular > 0 {
        return Err(CsvError::Uneven { file: file.into() });
    }
    Ok(Displacements { period_s: 1.0 / timebase.rate_hz, terminal_m })
}

#[cfg(test)]
mod tests {
    use miette::Diagnostic;
    use proptest::prelude::*;

    use super::*;

    fn points(count: u32, rate_hz: f64) -> Vec<Point> {
        let point = |k: u32| {
            let t_s = f64::from(k) / rate_hz;
            Point { t_s, terminal_m: 1e-3 * t_s.sin(), velocity_m_per_s: 1e-3 * t_s.cos(), acceleration_m_per_s2: 0.0 }
        };
        (0..count).map(point).collect()
    }

    #[test]
    fn what_is_written_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        for (machine, rate_hz) in [(Machine::Linear, 1000.0), (Machine::Rotary, 4096.0), (Machine::Linear, 333.0)] {
            let path = folder.path().join(format!("{rate_hz}.csv"));
            let points = points(500, rate_hz);
            let comments = ["a motion\nt_s,forged".to_string()];
            write(&path, false, machine, &comments, points.iter().copied()).unwrap();
            let text = std::fs::read_to_string(&path).unwrap();
            let unit = if machine == Machine::Rotary { "rad" } else { "m" };
            let header = format!("t_s,terminal_{unit},velocity_{unit}_per_s,acceleration_{unit}_per_s2");
            assert_eq!(text.lines().nth(1), Some(header.as_str()), "{text}");
            let read = read(&path).unwrap();
            assert!((read.period_s * rate_hz - 1.0).abs() < 1e-9, "{}", read.period_s);
            assert!(read.terminal_m.iter().zip(&points).all(|(read, written)| *read == rounded(written.terminal_m)));
            assert_eq!(read.terminal_m.len(), 500);
            assert!(matches!(write(&path, false, machine, &[], std::iter::empty()), Err(OutputError::Exists { .. })));
        }
    }

    #[test]
    fn what_cannot_be_used_is_refused_with_what_to_do() {
        let rows: String = (0..20).map(|k| format!("{},0.001\n", f64::from(k) * 0.01)).collect();
        let refused = |text: &str| {
            let error = parse("m.csv", text.as_bytes()).unwrap_err();
            format!("{error}; {}", error.help().unwrap())
        };
        assert!(refused("").contains("t_s,terminal_m"));
        assert!(refused("t_s,terminal_m\n").contains("at least 8"));
        assert!(refused("0,1\n1,2\n").contains("put the column names above the numbers: t_s,terminal_m"));
        assert!(refused(&format!("t_s,x\n{rows}")).contains("terminal_m or terminal_rad; found: t_s, x"));
        assert!(refused(&format!("t_s,terminal_m\n{rows}0.2,nan\n")).contains("line 22"));
        assert!(refused(&format!("t_s,terminal_m\n{rows}0.2\n")).contains("ends before the column `terminal_m`"));
        assert!(refused(&format!("t_s,terminal_m\n{rows}0.1,0\n")).contains("goes backwards"));
        assert!(refused(&format!("t_s,terminal_m\n{rows}0.25,0\n")).contains("some are missing"));
        assert!(refused(&format!("t_s,terminal_m,terminal_m\n{rows}")).contains("twice"));
    }

    proptest! {
        #[test]
        fn any_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            parse("m.csv", &bytes).ok();
            parse("m.csv", &[b"t_s,terminal_m\n", &bytes[..]].concat()).ok();
        }
    }
}
