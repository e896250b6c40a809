//! A motion as a sound file: the waveform format of many shaker controllers.
//!
//! RIFF WAVE, one channel, 24 bits. Full scale (2^23 - 1) is a displacement that the file's comment names, because the
//! format has no unit. The comment is `LIST` `INFO` `ICMT`, after the samples, where programs that do not know it skip
//! it.

use std::{io::Cursor, path::Path};

use hound::{SampleFormat, WavSpec, WavWriter};

use crate::output::{self, OutputError};

/// Largest value of a sample.
const FULL_SCALE: f64 = ((1 << 23) - 1) as f64;
/// Size of a chunk's name and length \[bytes\].
const HEAD: usize = 8;

/// Writes values whole or not at all. A value of `full_scale` is full scale; larger ones are clipped. Replaces an
/// existing file only with `replace`.
pub fn write(
    path: &Path,
    replace: bool,
    rate_hz: u32,
    full_scale: f64,
    comment: &str,
    values: impl Iterator<Item = f64>,
) -> Result<(), OutputError> {
    let bytes = bytes(rate_hz, full_scale, comment, values).map_err(|error| {
        let source = match error {
            hound::Error::IoError(source) => source,
            other => std::io::Error::other(other.to_string()),
        };
        OutputError::write(path.display().to_string(), source)
    })?;
    output::write(path, replace, bytes)
}

fn bytes(
    rate_hz: u32,
    full_scale: f64,
    comment: &str,
    values: impl Iterator<Item = f64>,
) -> Result<Vec<u8>, hound::Error> {
    let spec = WavSpec { channels: 1, sample_rate: rate_hz, bits_per_sample: 24, sample_format: SampleFormat::Int };
    let mut bytes = Vec::new();
    let mut writer = WavWriter::new(Cursor::new(&mut bytes), spec)?;
    for value in values {
        writer.write_sample((value / full_scale * FULL_SCALE).round().clamp(-FULL_SCALE, FULL_SCALE) as i32)?;
    }
    writer.finalize()?;
    Ok(with_comment(bytes, comment))
}

/// Appends a comment after the samples, each chunk at an even offset.
fn with_comment(mut bytes: Vec<u8>, comment: &str) -> Vec<u8> {
    let even = |bytes: &mut Vec<u8>| bytes.extend(vec![0; bytes.len() % 2]);
    let mut text = comment.as_bytes().to_vec();
    text.push(0);
    let mut info = b"INFOICMT".to_vec();
    info.extend((text.len() as u32).to_le_bytes());
    info.extend(text);
    even(&mut info);
    even(&mut bytes);
    bytes.extend(b"LIST");
    bytes.extend((info.len() as u32).to_le_bytes());
    bytes.extend(info);
    // The whole file's length follows its first name.
    let length = (bytes.len() - HEAD) as u32;
    if let Some(place) = bytes.get_mut(4..HEAD) {
        place.copy_from_slice(&length.to_le_bytes());
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::new_file;

    #[test]
    fn what_is_written_reads_back_with_its_rate_scale_and_comment() {
        let (_folder, path) = new_file("m.wav");
        let values: Vec<f64> = (0..1001).map(|k| 0.004 * (f64::from(k) * 0.02).sin()).collect();
        let comment = "full scale is 0.005 m";
        write(&path, false, 1000, 0.005, comment, values.iter().copied()).unwrap();
        let mut reader = hound::WavReader::open(&path).unwrap();
        let spec = reader.spec();
        assert_eq!((spec.sample_rate, spec.channels, spec.bits_per_sample), (1000, 1, 24));
        assert_eq!(reader.len(), 1001);
        for (sample, value) in reader.samples::<i32>().zip(&values) {
            assert!((f64::from(sample.unwrap()) / FULL_SCALE * 0.005 - value).abs() < 1e-9);
        }
        let bytes = std::fs::read(&path).unwrap();
        assert_eq!(u32::from_le_bytes(bytes[4..8].try_into().unwrap()) as usize, bytes.len() - 8);
        assert!(bytes.windows(comment.len()).any(|part| part == comment.as_bytes()));
        assert!(bytes.len().is_multiple_of(2));
        assert!(matches!(write(&path, false, 1000, 1.0, "", std::iter::empty()), Err(OutputError::Exists { .. })));
    }

    #[test]
    fn what_is_beyond_full_scale_is_held_to_it() {
        let bytes = bytes(100, 1.0, "", [2.0, -2.0].into_iter()).unwrap();
        let samples: Vec<i32> =
            hound::WavReader::new(Cursor::new(bytes)).unwrap().into_samples().map(Result::unwrap).collect();
        assert_eq!(samples, [8_388_607, -8_388_607]);
    }
}
