//! Batches of raw samples, compactly encoded.
//!
//! Each sample is four numbers: the step of the sample counter beyond one, and the changes of position, force and
//! terminal code, each from the sample before. The first sample's predecessor is (-1, 0, 0, 0), so its numbers are
//! absolute. Differences wrap in 32 bits; each is sent zigzag (0, -1, 1, -2, ...) in groups of seven bits, lowest
//! first, the top bit set while more follow. A sample takes 4 to 20 bytes, about 6 in practice.

use core::fmt;
use heapless::Vec;
use inerter_core::RawSample;
use serde::{Deserialize, Serialize};

/// Bytes that a 32-bit number can take.
const NUMBER_BYTES: usize = 5;

/// What the first sample is counted from.
const ORIGIN: RawSample = RawSample { index: u32::MAX, position_count: 0, force_code: 0, terminal_code: 0 };

/// A batch of raw samples.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Samples {
    count: u8,
    data: Vec<u8, { Samples::MAX_BYTES }>,
}

impl Samples {
    /// Samples that a batch can hold.
    pub const MAX_SAMPLES: usize = 32;
    /// Bytes that a batch can hold: 20 samples at their longest.
    pub const MAX_BYTES: usize = 400;

    /// A builder for the next batch.
    pub const fn builder() -> SamplesBuilder {
        SamplesBuilder::new()
    }

    /// A batch from the front of `samples` and how many of them it took.
    pub fn from_slice(samples: &[RawSample]) -> (Self, usize) {
        let mut builder = Self::builder();
        let taken = samples.iter().take_while(|sample| builder.push(sample).is_ok()).count();
        (builder.take(), taken)
    }

    /// Number of samples, as the sender says.
    pub fn len(&self) -> usize {
        usize::from(self.count)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The samples in order. After an error there are no more.
    pub fn iter(&self) -> Iter<'_> {
        Iter { left: self.count, data: &self.data, before: ORIGIN, failed: false }
    }

    /// Whether every sample is there and nothing else.
    pub fn check(&self) -> Result<(), DecodeError> {
        self.iter().try_for_each(|sample| sample.map(|_| ()))
    }
}

impl<'a> IntoIterator for &'a Samples {
    type Item = Result<RawSample, DecodeError>;
    type IntoIter = Iter<'a>;

    fn into_iter(self) -> Iter<'a> {
        self.iter()
    }
}

/// Collects samples into a batch.
#[derive(Clone, Debug)]
pub struct SamplesBuilder {
    batch: Samples,
    before: RawSample,
}

impl SamplesBuilder {
    /// An empty batch.
    pub const fn new() -> Self {
        Self { batch: Samples { count: 0, data: Vec::new() }, before: ORIGIN }
    }

    /// Adds a sample, or leaves the batch as it is when there is no room: send it and push again.
    pub fn push(&mut self, sample: &RawSample) -> Result<(), Full> {
        if self.batch.len() >= Samples::MAX_SAMPLES {
            return Err(Full);
        }
        let before = &self.before;
        let mut coded = Vec::<u8, { 4 * NUMBER_BYTES }>::new();
        for change in [
            sample.index.wrapping_sub(before.index).wrapping_sub(1) as i32,
            sample.position_count.wrapping_sub(before.position_count),
            sample.force_code.wrapping_sub(before.force_code),
            sample.terminal_code.wrapping_sub(before.terminal_code),
        ] {
            put(change, &mut coded)?;
        }
        self.batch.data.extend_from_slice(&coded).map_err(|_| Full)?;
        self.batch.count += 1;
        self.before = *sample;
        Ok(())
    }

    /// Number of samples so far.
    pub fn len(&self) -> usize {
        self.batch.len()
    }

    /// Whether there are none so far.
    pub fn is_empty(&self) -> bool {
        self.batch.is_empty()
    }

    /// Hands over the batch and starts the next one.
    pub fn take(&mut self) -> Samples {
        core::mem::take(self).batch
    }
}

impl Default for SamplesBuilder {
    fn default() -> Self {
        Self::new()
    }
}

fn put<const N: usize>(change: i32, into: &mut Vec<u8, N>) -> Result<(), Full> {
    let mut rest = ((change << 1) ^ (change >> 31)) as u32;
    while rest >= 0x80 {
        into.push(rest as u8 | 0x80).map_err(|_| Full)?;
        rest >>= 7;
    }
    into.push(rest as u8).map_err(|_| Full)
}

/// There is no room in the batch for this sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

impl fmt::Display for Full {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the batch is full: send it, then push again")
    }
}

impl core::error::Error for Full {}

/// What is wrong with the content of a batch. Its frame arrived intact: the sender is at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeError {
    /// The batch claims more samples than a batch can hold.
    TooMany,
    /// The bytes end before the last sample does.
    Truncated,
    /// A number does not fit 32 bits.
    BadNumber,
    /// Bytes are left over after the last sample.
    TrailingBytes,
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("samples: ")?;
        f.write_str(match self {
            Self::TooMany => "more than 32 in one batch",
            Self::Truncated => "the batch ends inside a sample",
            Self::BadNumber => "a number does not fit 32 bits",
            Self::TrailingBytes => "bytes left over after the last one",
        })?;
        f.write_str("; the device's firmware is at fault, please report it with the recording")
    }
}

impl core::error::Error for DecodeError {}

/// Samples of a batch; see [`Samples::iter`].
#[derive(Clone, Debug)]
pub struct Iter<'a> {
    left: u8,
    data: &'a [u8],
    before: RawSample,
    failed: bool,
}

impl Iter<'_> {
    fn number(&mut self) -> Result<i32, DecodeError> {
        let mut value = 0u32;
        for place in 0..NUMBER_BYTES {
            let (&byte, rest) = self.data.split_first().ok_or(DecodeError::Truncated)?;
            self.data = rest;
            if place == NUMBER_BYTES - 1 && byte > 0x0F {
                return Err(DecodeError::BadNumber);
            }
            value |= u32::from(byte & 0x7F) << (7 * place);
            if byte < 0x80 {
                break;
            }
        }
        Ok((value >> 1) as i32 ^ -((value & 1) as i32))
    }

    fn sample(&mut self) -> Result<RawSample, DecodeError> {
        if usize::from(self.left) > Samples::MAX_SAMPLES {
            return Err(DecodeError::TooMany);
        }
        let before = self.before;
        let sample = RawSample {
            index: before.index.wrapping_add(1).wrapping_add(self.number()? as u32),
            position_count: before.position_count.wrapping_add(self.number()?),
            force_code: before.force_code.wrapping_add(self.number()?),
            terminal_code: before.terminal_code.wrapping_add(self.number()?),
        };
        self.left -= 1;
        self.before = sample;
        Ok(sample)
    }
}

impl Iterator for Iter<'_> {
    type Item = Result<RawSample, DecodeError>;

    fn next(&mut self) -> Option<Self::Item> {
        let item = match (self.failed, self.left) {
            (true, _) => return None,
            (false, 0) if self.data.is_empty() => return None,
            (false, 0) => Err(DecodeError::TrailingBytes),
            (false, _) => self.sample(),
        };
        self.failed = item.is_err();
        Some(item)
    }
}
