//! The part of a line that an error shows.

use std::fmt;

use miette::{MietteError, MietteSpanContents, SourceCode, SourceSpan, SpanContents};

use crate::words::printable;

/// Maximum number of characters shown on either side of the error, and of the error itself.
const AROUND: usize = 60;

/// Part of a line, made printable. Its `Display` is its position: file and line.
#[derive(Debug)]
pub struct Excerpt {
    file: String,
    line: usize,
    text: String,
    /// Bytes of the line before it.
    skipped: usize,
}

impl Excerpt {
    /// The text around the `length` bytes at `at`, and the span of those bytes in it.
    pub(super) fn of(file: &str, line: usize, text: &str, at: usize, length: usize) -> (Self, SourceSpan) {
        let (before, rest) = text.split_at_checked(at).unwrap_or((text, ""));
        let (meant, after) = rest.split_at_checked(length).unwrap_or((rest, ""));
        let first = |text: &str| text.char_indices().nth(AROUND).map_or(text.len(), |(at, _)| at);
        let last = before.char_indices().rev().nth(AROUND - 1).map_or(0, |(at, _)| at);
        let [before, meant, after] =
            [before.get(last..), meant.get(..first(meant)), after.get(..first(after))].map(|part| {
                // A tab between columns stays a tab.
                part.unwrap_or_default().split('\t').map(printable).collect::<Vec<_>>().join("\t")
            });
        let span = SourceSpan::new(before.len().into(), meant.len());
        (Self { file: file.into(), line, text: before + &meant + &after, skipped: last }, span)
    }
}

impl fmt::Display for Excerpt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, line {}", self.file, self.line)
    }
}

impl SourceCode for Excerpt {
    fn read_span<'a>(
        &'a self,
        span: &SourceSpan,
        _lines_before: usize,
        _lines_after: usize,
    ) -> Result<Box<dyn SpanContents<'a> + 'a>, MietteError> {
        let whole = SourceSpan::new(0.into(), self.text.len());
        let line = self.line.saturating_sub(1);
        let contents = MietteSpanContents::new_named(
            printable(&self.file).into(),
            self.text.as_bytes(),
            whole,
            line,
            self.skipped + span.offset(),
            1,
        );
        Ok(Box::new(contents))
    }
}
