//! Checksums of the files of a run, as `sha256sum` writes and checks them.

use std::io::{self, Read, Write};

use sha2::{Digest, Sha256};

/// The SHA-256 of data that arrive piece by piece.
#[derive(Clone, Default)]
pub(crate) struct Sum(Sha256);

impl Sum {
    pub(crate) fn of(bytes: &[u8]) -> String {
        Self(Sha256::new_with_prefix(bytes)).hex()
    }

    pub(crate) fn hex(self) -> String {
        self.0.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

impl Write for Sum {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A reader that fails at the end if the data do not have this sum.
pub(crate) struct Expected<'a, R> {
    from: R,
    found: Sum,
    sum: &'a str,
    /// Whether it failed for that reason.
    pub is_other: bool,
}

impl<'a, R> Expected<'a, R> {
    pub(crate) fn new(from: R, sum: &'a str) -> Self {
        Self { from, found: Sum::default(), sum, is_other: false }
    }
}

impl<R: Read> Read for Expected<'_, R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.from.read(into)?;
        self.found.write_all(into.get(..count).unwrap_or_default())?;
        if count == 0 && !into.is_empty() {
            self.is_other = self.found.clone().hex() != self.sum;
            if self.is_other {
                return Err(io::Error::other("its contents have changed since its checksum was computed"));
            }
        }
        Ok(count)
    }
}

/// Lines of `sha256sum` for these files.
pub(crate) fn lines(files: &[(String, String)]) -> String {
    files.iter().map(|(name, sum)| format!("{sum}  {name}\n")).collect()
}

/// Parses them: name and sum; an invalid line is skipped.
pub(crate) fn parse(text: &str) -> Vec<(String, String)> {
    let line = |line: &str| line.split_once("  ").map(|(sum, name)| (name.to_owned(), sum.to_owned()));
    text.lines().filter_map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// FIPS 180-2, B.1.
    #[test]
    fn the_sum_is_that_of_the_standard() {
        let sum = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(Sum::of(b"abc"), sum);
        let mut copied = Sum::default();
        let length = io::copy(&mut &b"abc"[..], &mut copied).unwrap();
        assert_eq!((length, copied.hex().as_str()), (3, sum));
    }

    #[test]
    fn other_bytes_fail_at_their_end() {
        let sum = Sum::of(b"abc");
        let read = |bytes: &[u8]| io::copy(&mut Expected::new(bytes, &sum), &mut io::sink()).ok();
        assert_eq!((read(b"abc"), read(b"abd"), read(b"ab")), (Some(3), None, None));
    }

    #[test]
    fn lines_are_read_back() {
        let files = vec![("runs/a b.parquet".to_owned(), "00".repeat(32)), ("x".to_owned(), "11".repeat(32))];
        assert_eq!(parse(&lines(&files)), files);
    }
}
