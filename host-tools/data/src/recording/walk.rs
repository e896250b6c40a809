//! Reads the records of an MCAP file one after the other, including those in chunks, whatever state the file is in.
//!
//! A file is a magic number and records: operation code (u8), length (u64), content. A chunk's content is a header and
//! further records. Nothing is read ahead and no length above [`LONGEST_RECORD`] is trusted, so that everything before
//! a cut or damage can be read. (The `mcap` crate's own linear reader, 0.26, panics on a record that is longer than its
//! chunk.)

use std::io::{self, Read};

use mcap::{MAGIC, records::op};

/// Maximum length of a record that is parsed; a larger length means damage.
const LONGEST_RECORD: u64 = 1 << 20;
/// Operation code and length.
const HEAD: usize = 9;
/// A chunk's header up to the name of its compression: two times, size, CRC, length of the name.
const CHUNK_HEAD: usize = 8 + 8 + 8 + 4 + 4;

/// What follows in a file.
#[derive(Debug, PartialEq, Eq)]
pub enum Step<'a> {
    /// A record that may be parsed.
    Record {
        /// Operation code.
        opcode: u8,
        data: &'a [u8],
    },
    /// The file does not begin like an MCAP file.
    WrongKind,
    /// The footer: the file was closed.
    Closed,
    /// The file ends without a footer.
    CutOff,
    /// A chunk uses this compression.
    Compressed(String),
    /// What follows cannot be parsed.
    Damaged(String),
}

/// Walks through a file.
pub struct Walker<R> {
    source: R,
    buffer: Vec<u8>,
    begun: bool,
    /// Bytes left in the current chunk.
    chunk_left: u64,
    /// Bytes read so far.
    pub offset: u64,
}

impl<R: Read> Walker<R> {
    /// At the beginning of the file.
    pub fn new(source: R) -> Self {
        Self { source, buffer: Vec::new(), begun: false, chunk_left: 0, offset: 0 }
    }

    /// The next step. After anything but a record nothing more follows.
    pub fn step(&mut self) -> io::Result<Step<'_>> {
        if !self.begun {
            if !self.fill(MAGIC.len())? || self.buffer != MAGIC {
                return Ok(Step::WrongKind);
            }
            self.begun = true;
        }
        loop {
            if !self.fill(HEAD)? {
                return Ok(Step::CutOff);
            }
            let opcode = self.buffer.first().copied().unwrap_or(0);
            let length = self.buffer.last_chunk().map_or(0, |length| u64::from_le_bytes(*length));
            if self.chunk_left > 0 {
                let whole = length.saturating_add(HEAD as u64);
                if whole > self.chunk_left {
                    return Ok(Step::Damaged("a record is longer than its chunk".into()));
                }
                self.chunk_left -= whole;
            }
            match opcode {
                op::FOOTER => return Ok(Step::Closed),
                op::CHUNK => {
                    if let Some(end) = self.enter_chunk(length)? {
                        return Ok(end);
                    }
                }
                op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA => {
                    if length > LONGEST_RECORD {
                        return Ok(Step::Damaged(format!("a record claims to be {length} bytes long")));
                    }
                    // Not above the limit checked before.
                    if !self.fill(length as usize)? {
                        return Ok(Step::CutOff);
                    }
                    return Ok(Step::Record { opcode, data: &self.buffer });
                }
                _ => {
                    let skipped = io::copy(&mut self.source.by_ref().take(length), &mut io::sink())?;
                    self.offset += skipped;
                    if skipped < length {
                        return Ok(Step::CutOff);
                    }
                }
            }
        }
    }

    fn enter_chunk(&mut self, length: u64) -> io::Result<Option<Step<'static>>> {
        let damaged = |reason: &str| Ok(Some(Step::Damaged(reason.into())));
        if self.chunk_left > 0 {
            return damaged("a chunk within a chunk");
        }
        if !self.fill(CHUNK_HEAD)? {
            return Ok(Some(Step::CutOff));
        }
        let name_length = u64::from(self.buffer.last_chunk().map_or(0, |bytes| u32::from_le_bytes(*bytes)));
        if name_length > 64 {
            return damaged("a chunk's header makes no sense");
        }
        if !self.fill(name_length as usize)? {
            return Ok(Some(Step::CutOff));
        }
        if name_length > 0 {
            return Ok(Some(Step::Compressed(String::from_utf8_lossy(&self.buffer).into_owned())));
        }
        if !self.fill(8)? {
            return Ok(Some(Step::CutOff));
        }
        self.chunk_left = self.buffer.first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes));
        if self.chunk_left.checked_add(CHUNK_HEAD as u64 + 8) != Some(length) {
            return damaged("a chunk's length contradicts its header");
        }
        Ok(None)
    }

    /// Reads the next `count` bytes into the buffer; false if there are fewer.
    fn fill(&mut self, count: usize) -> io::Result<bool> {
        self.buffer.clear();
        let read = self.source.by_ref().take(count as u64).read_to_end(&mut self.buffer)?;
        self.offset += read as u64;
        Ok(read == count)
    }
}
