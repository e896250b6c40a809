//! Which kind of CSV this is: encoding, delimiter, decimal sign, quotes.

use super::error::CsvError;

/// The first bytes of other kinds of file, and what to do about them.
const OTHER_KINDS: &[(&[u8], &str, &str)] = &[
    (b"PK\x03\x04", "an Excel workbook or a zip file", "open it and save it as CSV (UTF-8)"),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook", "open it and save it as CSV (UTF-8)"),
    (b"MATLAB", "a MATLAB file", "write it with writetable(table, \"run.csv\") in MATLAB"),
    (b"\x89HDF", "an HDF5 or MATLAB file", "write the three columns as CSV"),
    (b"\xff\xfe", "UTF-16 text (Excel's \"Unicode text\")", "save it as CSV (UTF-8)"),
    (b"\xfe\xff", "UTF-16 text (Excel's \"Unicode text\")", "save it as CSV (UTF-8)"),
    (b"\x1f\x8b", "a gzip file", "unpack it first: gunzip FILE"),
];

/// The file's text without its byte order mark.
///
/// Bytes that are not UTF-8 (a Latin-1 micro sign in a column that is not ours) are harmless and are replaced.
pub fn decode<'a>(file: &str, bytes: &'a [u8]) -> Result<std::borrow::Cow<'a, str>, CsvError> {
    for (magic, kind, advice) in OTHER_KINDS {
        if bytes.starts_with(magic) {
            return Err(CsvError::WrongKind { file: file.into(), kind, advice });
        }
    }
    if bytes.contains(&0) {
        return Err(CsvError::WrongKind {
            file: file.into(),
            kind: "binary data",
            advice: "give a recording of this program (.mcap) or a text file with columns t_s,encoder_count,force_n",
        });
    }
    Ok(String::from_utf8_lossy(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)))
}

/// The delimiter between fields, and the decimal sign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dialect {
    delimiter: char,
}

impl Dialect {
    /// Detected from the header: the most frequent of `;`, tab and `,`.
    pub fn detect(header: &str) -> Self {
        let count = |delimiter: char| header.matches(delimiter).count();
        let delimiter = [',', '\t', ';'].into_iter().max_by_key(|delimiter| count(*delimiter)).unwrap_or(',');
        Self { delimiter }
    }

    /// The fields of a line, trimmed and without their quotes, each with its offset in the line.
    pub fn fields(self, line: &str) -> impl Iterator<Item = (usize, &str)> {
        let mut next = Some(0_usize);
        std::iter::from_fn(move || {
            let start = next?;
            let rest = line.get(start..)?;
            let mut quoted = false;
            let end = rest.find(|c: char| {
                quoted ^= c == '"';
                !quoted && c == self.delimiter
            });
            next = end.map(|end| start + end + self.delimiter.len_utf8());
            let field = rest.get(..end.unwrap_or(rest.len()))?;
            let trimmed = field.trim();
            let offset = start + (field.len() - field.trim_start().len());
            match trimmed.strip_prefix('"').and_then(|inner| inner.strip_suffix('"')) {
                Some(inner) => Some((offset + 1, inner.trim())),
                None => Some((offset, trimmed)),
            }
        })
    }

    /// Reads a number; with `;` or tab as the delimiter the decimal sign may be a comma, as European Excel writes it.
    pub fn number(self, field: &str) -> Option<f64> {
        if self.delimiter != ',' && field.contains(',') && !field.contains('.') {
            return field.replacen(',', ".", 1).parse().ok();
        }
        field.parse().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_know_quotes_blanks_and_their_offsets() {
        let dialect = Dialect::detect("a,b,c");
        let fields: Vec<_> = dialect.fields(r#"1, "x,y" ,"#).collect();
        assert_eq!(fields, [(0, "1"), (4, "x,y"), (10, "")]);
    }

    #[test]
    fn decimal_commas_are_read_where_they_cannot_be_delimiters() {
        assert_eq!(Dialect::detect("t_s;encoder_count;force_n").number("-1,25"), Some(-1.25));
        assert_eq!(Dialect::detect("t_s\tforce_n").number("1,5e3"), Some(1500.0));
        assert_eq!(Dialect::detect("t_s;force_n").number("1.234,5"), None);
        assert_eq!(Dialect::detect("t_s,force_n").number("1.5"), Some(1.5));
    }

    #[test]
    fn a_file_of_another_kind_is_named() {
        for (bytes, kind) in [(&b"PK\x03\x04...."[..], "Excel"), (b"\xff\xfet\0", "UTF-16"), (b"ab\0c", "binary")] {
            assert!(decode("f", bytes).unwrap_err().to_string().contains(kind));
        }
    }
}
