//! Samples from a file of the host.
//!
//! The file is a sequence of 16-byte records, little-endian: index u32, position i32, force i32, terminal i32, as in
//! [`RawSample`]. An index of `0xFFFF_FFFF`, alone or with the rest of a record, ends it. Until then it may grow: at
//! its present end the source waits and tries again.

use crate::semihosting::File;
use embassy_time::Timer;
use inerter_app::{Pace, SampleSource, SourceError};
use inerter_core::RawSample;

/// Bytes of a record.
const RECORD: usize = 16;
/// Index of the record that ends the file.
const END: u32 = u32::MAX;
/// Bytes read at once.
pub const BUFFER: usize = 128 * RECORD;
/// Pause at the end of what was written so far.
const RETRY_MS: u64 = 1;

/// The file, opened when the first sample is wanted.
pub struct FileSource {
    path: &'static str,
    file: Option<File>,
    buffer: &'static mut [u8; BUFFER],
    /// Part of the buffer that holds bytes not used yet.
    start: usize,
    end: usize,
}

impl FileSource {
    /// A source that will read this file. The buffer is borrowed, as a future stores what is moved into it repeatedly.
    pub fn new(path: &'static str, buffer: &'static mut [u8; BUFFER]) -> Self {
        Self { path, file: None, buffer, start: 0, end: 0 }
    }

    /// The next sample, if it is complete.
    fn next(&mut self) -> Result<Option<RawSample>, SourceError> {
        let waiting = self.buffer.get(self.start..self.end).unwrap_or_default();
        let (words, _) = waiting.as_chunks::<4>();
        let word = |place: usize| words.get(place).map(|bytes| i32::from_le_bytes(*bytes));
        let Some(index) = word(0) else { return Ok(None) };
        if index as u32 == END {
            // Stays in the buffer: the end remains the end.
            return Err(SourceError::Ended);
        }
        let (Some(position_count), Some(force_code), Some(terminal_code)) = (word(1), word(2), word(3)) else {
            return Ok(None);
        };
        self.start += RECORD;
        Ok(Some(RawSample { index: index as u32, position_count, force_code, terminal_code }))
    }

    /// Reads more of the file after what is waiting; returns whether there was more.
    fn refill(&mut self) -> Result<bool, SourceError> {
        if self.file.is_none() {
            self.file = File::open(self.path);
        }
        let file = self.file.as_mut().ok_or(SourceError::Unreadable)?;
        self.buffer.copy_within(self.start..self.end, 0);
        self.end -= self.start;
        self.start = 0;
        let count = file.read(self.buffer.get_mut(self.end..).unwrap_or_default());
        self.end += count;
        Ok(count > 0)
    }
}

impl SampleSource for FileSource {
    fn pace(&self) -> Pace {
        Pace::OnDemand
    }

    async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError> {
        loop {
            let mut count = 0;
            for place in into.iter_mut() {
                match self.next() {
                    Ok(Some(sample)) => *place = sample,
                    Err(error) if count == 0 => return Err(error),
                    _ => break,
                }
                count += 1;
            }
            if count > 0 {
                return Ok(count);
            }
            if !self.refill()? {
                Timer::after_millis(RETRY_MS).await;
            }
        }
    }
}
