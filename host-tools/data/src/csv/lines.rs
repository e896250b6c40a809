//! Lines of a CSV text and their cells, each with its position for messages.

use std::{
    fs::File,
    io::{self, BufRead, BufReader, Read},
    path::Path,
    sync::Arc,
};

use miette::SourceSpan;

use super::{dialect::Dialect, error::CsvError, excerpt::Excerpt};
use crate::words::shortened;

/// Longest line \[bytes\]: samples take a hundred or so.
const LONGEST_LINE: usize = 1 << 16;

/// The bytes of a CSV file.
pub(super) fn bytes_of(path: &Path) -> Result<Vec<u8>, CsvError> {
    let failed = |source| CsvError::Read { path: path.into(), source };
    File::open(path).and_then(as_far_as_needed).map_err(failed)
}

/// The whole of a CSV file; of any other file, however large, only enough to recognise it.
pub(super) fn as_far_as_needed(source: impl Read) -> io::Result<Vec<u8>> {
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

/// A line that is neither blank nor a comment, or is too long.
pub(super) struct Line<'a> {
    file: &'a str,
    pub text: &'a str,
    offset: usize,
    /// From 1.
    pub number: usize,
}

impl Line<'_> {
    /// Rejects a line too long for samples.
    pub fn check_length(&self) -> Result<(), CsvError> {
        if self.text.len() > LONGEST_LINE {
            return Err(CsvError::LongLine { file: self.file.into(), line: self.number, longest: LONGEST_LINE });
        }
        Ok(())
    }

    /// True for a last line without its line end.
    pub fn is_cut_off(&self, all: &str) -> bool {
        self.offset + self.text.len() == all.len()
    }

    /// The time in a cell, which must be later than the previous one, and its decimals.
    pub fn later(&self, previous: Option<&f64>, (time, at, written): Cell) -> Result<(f64, u32), CsvError> {
        if let Some(previous) = previous.copied().filter(|previous| time <= *previous) {
            let (text, at) = self.source(at, written.len());
            return Err(CsvError::Time { previous, time, text, at });
        }
        Ok((time, decimals(written)))
    }

    /// The position of something in the line, for a message: the excerpt, and the span in it.
    pub fn source(&self, at: usize, length: usize) -> (Arc<Excerpt>, SourceSpan) {
        let (excerpt, span) = Excerpt::of(self.file, self.number, self.text, at, length);
        (Arc::new(excerpt), span)
    }
}

/// The lines of a text that are neither blank nor comments.
pub(super) struct Lines<'a> {
    file: &'a str,
    text: &'a str,
    offset: usize,
    number: usize,
}

impl<'a> Lines<'a> {
    /// The lines of this text; `file` is its name in messages.
    pub fn of(file: &'a str, text: &'a str) -> Self {
        Self { file, text, offset: 0, number: 0 }
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = Line<'a>;

    fn next(&mut self) -> Option<Line<'a>> {
        loop {
            let rest = self.text.get(self.offset..).filter(|rest| !rest.is_empty())?;
            let end = rest.find(['\n', '\r']).unwrap_or(rest.len());
            // Windows ends a line with both characters, old spreadsheets with the carriage return alone.
            let ending =
                rest.get(end..).map_or(0, |ending| if ending.starts_with("\r\n") { 2 } else { ending.len().min(1) });
            let (line, length) = (rest.get(..end)?, end + ending);
            let found = Line { file: self.file, text: line, offset: self.offset, number: self.number + 1 };
            self.offset += length;
            self.number += 1;
            let content = found.text.trim();
            if found.text.len() > LONGEST_LINE || !(content.is_empty() || content.starts_with(['#', '%'])) {
                return Some(found);
            }
        }
    }
}

/// The first line, with the names of the columns.
pub(super) struct Header<'a> {
    pub line: Line<'a>,
    pub dialect: Dialect,
    /// The position of each name, and the name.
    pub names: Vec<(usize, &'a str)>,
}

impl<'a> Header<'a> {
    /// Reads the first line; `header` is an example of a valid one.
    pub fn read(lines: &mut Lines<'a>, header: &'static str) -> Result<Self, CsvError> {
        let line = lines.next().ok_or_else(|| CsvError::Empty { file: lines.file.into(), header })?;
        line.check_length()?;
        let dialect = Dialect::detect(line.text);
        let names: Vec<(usize, &str)> = dialect.fields(line.text).collect();
        if names.iter().all(|(_, name)| dialect.number(name).is_some()) {
            let (text, at) = line.source(0, line.text.len());
            return Err(CsvError::NoHeader { header, text, at });
        }
        Ok(Self { line, dialect, names })
    }

    /// The index of a column; an error if two have the name.
    pub fn find(&self, column: &'static str) -> Result<Option<usize>, CsvError> {
        let mut places = self.names.iter().enumerate().filter(|(_, (_, name))| name.eq_ignore_ascii_case(column));
        let first = places.next();
        if let Some((_, (offset, name))) = places.next() {
            let (text, at) = self.line.source(*offset, name.len());
            return Err(CsvError::DuplicateColumn { column, text, at });
        }
        Ok(first.map(|(place, _)| place))
    }

    /// The index of a required column; `advice` says what to do if it is missing.
    pub fn need(&self, column: &'static str, advice: impl Fn(&[(usize, &str)]) -> String) -> Result<usize, CsvError> {
        self.find(column)?.ok_or_else(|| {
            let (text, at) = self.line.source(0, self.line.text.len());
            CsvError::MissingColumn { column, advice: advice(&self.names), text, at }
        })
    }
}

/// The number in a cell, its position, and its text.
pub(super) type Cell<'a> = (f64, usize, &'a str);

/// Reads a cell.
pub(super) fn cell<'a>(
    line: &Line,
    dialect: Dialect,
    fields: &[(usize, &'a str)],
    place: usize,
    column: &'static str,
) -> Result<Cell<'a>, CsvError> {
    let Some((offset, field)) = fields.get(place).copied() else {
        let (text, at) = line.source(0, line.text.len());
        return Err(CsvError::Short { column, text, at });
    };
    match dialect.number(field) {
        Some(value) if value.is_finite() => Ok((value, offset, field)),
        number => {
            let (text, at) = line.source(offset, field.len());
            let (what, advice) = cell_words(field, number);
            Err(CsvError::Cell { column, what, advice, text, at })
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

/// Decimals after the point of a written number, including its exponent.
pub(super) fn decimals(text: &str) -> u32 {
    let (mantissa, exponent) = text.split_once(['e', 'E']).unwrap_or((text, "0"));
    let written = mantissa.split_once(['.', ',']).map_or(0, |(_, fraction)| fraction.len());
    let shift: i64 = exponent.parse().unwrap_or(0);
    u32::try_from((written as i64 - shift).clamp(0, 18)).unwrap_or(0)
}
