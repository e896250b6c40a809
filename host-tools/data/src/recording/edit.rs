//! Edits recordings: cuts a part out of one, or joins several. Frames stay as they were received.

use std::{
    ops::Range,
    path::{Path, PathBuf},
};

use inerter_core::Settings;
use inerter_wire::{DELIMITER, Frame, Record, Samples};

use super::{
    CALIBRATION_METADATA, END_METADATA, Ending, HELLO_METADATA, RecordingError, SETTINGS_METADATA, Summary,
    TRUTH_METADATA,
    messages::{Framing, Message, Messages},
    samples::{Extent, summary},
    write::{End, Recorder, map},
};
use crate::{
    error::Error,
    output::{OutputError, Pending},
};

/// The result of a cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// Samples in it.
    pub samples: u64,
    /// Frames in it.
    pub frames: u32,
    /// Time of its first and its last sample in the recording \[s\].
    pub span_s: (f64, f64),
}

/// The result of a merge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Merged {
    /// Samples in it.
    pub samples: u64,
    /// Frames in it.
    pub frames: u32,
    /// Host time from the first frame to the last \[s\].
    pub duration_s: f64,
}

/// Writes the part of a recording whose time since its first sample lies in `range_s`.
///
/// Frames stay whole: a frame of samples belongs to the part that contains its first sample, any other frame to the
/// part that contains the samples before it. So adjacent parts hold everything exactly once. Replaces an existing file
/// only with `replace`.
pub fn cut(
    path: &Path,
    range_s: Range<f64>,
    to: &Path,
    replace: bool,
    progress: impl FnMut(u64) -> Result<(), Error>,
) -> Result<Cut, Error> {
    let file = path.display().to_string();
    let summary = summary(path)?;
    let rate_hz = summary.settings.ok_or(RecordingError::NoSettings { file: file.clone() })?.sample_rate_hz;
    let pending = Pending::create(to, replace)?;
    let mut recorder = begin(&pending, &summary)?;
    calibrated(&mut recorder, [&summary])?;
    let about = [("file", file.clone()), ("from_s", range_s.start.to_string()), ("to_s", range_s.end.to_string())];
    recorder.metadata("inerter.cut", map(about))?;
    let (mut framing, mut all, mut samples, mut span_s) = (Framing::default(), Extent::default(), 0, None);
    let mut inside = range_s.start <= 0.0;
    copy(path, &mut recorder, progress, |message, bytes| {
        let Message::Raw { part, .. } = *message else { return inside };
        let mut here: Option<(f64, f64, u64)> = None;
        framing.take(part, bytes, |frame| {
            for sample in batch(&frame).into_iter().flat_map(Samples::iter).flatten() {
                all.take(&sample);
                let t_s = all.periods as f64 / rate_hz;
                let (first_s, _, count) = here.unwrap_or((t_s, t_s, 0));
                here = Some((first_s, t_s, count + 1));
            }
        });
        if let Some((first_s, last_s, count)) = here {
            inside = range_s.contains(&first_s);
            if inside {
                let (start_s, _) = span_s.unwrap_or((first_s, last_s));
                (span_s, samples) = (Some((start_s, last_s)), samples + count);
            }
        }
        inside
    })?;
    let duration_s = all.periods as f64 / rate_hz;
    let empty = RecordingError::EmptyRange { file, from_s: range_s.start, to_s: range_s.end, duration_s };
    let span_s = span_s.ok_or(empty)?;
    let frames = recorder.frames();
    recorder.close(&End { reason: reason(&summary), lost_frames: 0 })?;
    pending.commit()?;
    Ok(Cut { samples, frames, span_s })
}

/// Joins recordings of one device, the earliest first.
///
/// Each remains a separate stream. Settings must be the same, and no two may overlap in time. Replaces an existing file
/// only with `replace`.
pub fn merge(
    paths: &[PathBuf],
    to: &Path,
    replace: bool,
    mut progress: impl FnMut(u64) -> Result<(), Error>,
) -> Result<Merged, Error> {
    let mut inputs = Vec::new();
    for path in paths {
        inputs.push((path, summary(path)?));
    }
    inputs.sort_by_key(|(_, summary)| summary.contents.span_ns);
    for ((path, summary), (next_path, next)) in inputs.iter().zip(inputs.iter().skip(1)) {
        check(path, summary, next_path, next)?;
    }
    let Some((_, first)) = inputs.first() else {
        return Ok(Merged { samples: 0, frames: 0, duration_s: 0.0 });
    };
    let pending = Pending::create(to, replace)?;
    let mut recorder = begin(&pending, first)?;
    calibrated(&mut recorder, inputs.iter().map(|(_, summary)| summary))?;
    let names = inputs
        .iter()
        .enumerate()
        .map(|(number, (path, _))| (format!("part_{}", number + 1), path.display().to_string()));
    recorder.metadata("inerter.merged", names.collect())?;
    let (mut done, mut lost_frames) = (0, 0);
    for (number, (path, summary)) in inputs.iter().enumerate() {
        if number > 0 {
            recorder.begin_part()?;
        }
        copy(path, &mut recorder, |offset| progress(done + offset), |_, _| true)?;
        done += summary.contents.bytes;
        lost_frames += u64::from(summary.contents.counts.lost);
    }
    let samples = inputs.iter().map(|(_, summary)| summary.extent.samples).sum();
    let reason = inputs.last().map_or_else(String::new, |(_, summary)| reason(summary));
    let merged = Merged { samples, frames: recorder.frames(), duration_s: recorder.duration_s() };
    recorder.close(&End { reason, lost_frames })?;
    pending.commit()?;
    Ok(merged)
}

/// Copies the messages of a recording that `is_kept` accepts, and begins a new stream where the recording does.
fn copy(
    path: &Path,
    recorder: &mut Recorder,
    mut progress: impl FnMut(u64) -> Result<(), Error>,
    mut is_kept: impl FnMut(&Message, &[u8]) -> bool,
) -> Result<(), Error> {
    let (mut messages, mut channel) = (Messages::open(path)?, None);
    loop {
        progress(messages.offset())?;
        let Some(message) = messages.next()? else { return Ok(()) };
        let bytes = messages.bytes();
        if !is_kept(&message, bytes) {
            continue;
        }
        match message {
            Message::Marker { time_ns, text } => recorder.marker(time_ns, &text)?,
            Message::Raw { time_ns, part } => {
                if channel.replace(part).is_some_and(|before| before != part) {
                    recorder.begin_part()?;
                }
                recorder.frame(time_ns, bytes.strip_suffix(&[DELIMITER]).unwrap_or(bytes))?;
            }
        }
    }
}

fn batch(frame: &Frame<Record>) -> Option<&Samples> {
    match frame {
        Frame::Message { message: Record::Samples(samples), .. } if samples.check().is_ok() => Some(samples),
        _ => None,
    }
}

/// Begins a recording with the device data of `like`.
fn begin(to: &Pending, like: &Summary) -> Result<Recorder, Error> {
    let mut recorder = Recorder::fill(to)?;
    for name in [HELLO_METADATA, SETTINGS_METADATA, TRUTH_METADATA] {
        if let Some(metadata) = like.contents.metadata.get(name) {
            recorder.metadata(name, metadata.clone())?;
        }
    }
    if let Some(settings) = &like.settings {
        recorder.decode_by(settings)?;
    }
    recorder.flush()?;
    Ok(recorder)
}

/// The calibration that all parts share. If they differ, or one has none, none is written.
fn calibrated<'a>(recorder: &mut Recorder, like: impl IntoIterator<Item = &'a Summary>) -> Result<(), OutputError> {
    let mut all = like.into_iter().map(|summary| summary.contents.metadata.get(CALIBRATION_METADATA));
    match all.next().flatten() {
        Some(first) if all.all(|other| other == Some(first)) => recorder.metadata(CALIBRATION_METADATA, first.clone()),
        _ => Ok(()),
    }
}

/// Why the recording ended.
fn reason(summary: &Summary) -> String {
    let reason = summary.contents.metadata.get(END_METADATA).and_then(|end| end.get("reason"));
    match (&summary.contents.ending, reason) {
        (Ending::Closed, Some(reason)) => reason.clone(),
        (Ending::Closed, None) => "finished".into(),
        (Ending::CutOff, _) => "the file that it was made from is cut off".into(),
        (Ending::Damaged { .. }, _) => "the file that it was made from is damaged".into(),
    }
}

/// Whether `next` may follow this recording.
fn check(path: &Path, summary: &Summary, next_path: &Path, next: &Summary) -> Result<(), RecordingError> {
    let (file, other) = (path.display().to_string(), next_path.display().to_string());
    let serial = |summary: &Summary| {
        let hello = summary.contents.metadata.get(HELLO_METADATA);
        hello.and_then(|hello| hello.get("serial")).cloned().unwrap_or_default()
    };
    let (serial, other_serial) = (serial(summary), serial(next));
    if serial != other_serial {
        return Err(RecordingError::OtherDevice { file, serial, other, other_serial });
    }
    let settings = |summary: &Summary, file: &str| {
        summary.settings.ok_or_else(|| RecordingError::NoSettings { file: file.into() })
    };
    let (these, those) = (settings(summary, &file)?, settings(next, &other)?);
    for (info, (value, other_value)) in Settings::TABLE.iter().zip(these.values().into_iter().zip(those.values())) {
        if value != other_value {
            let setting = info.name;
            return Err(RecordingError::OtherSetting { setting, file, value, other, other_value });
        }
    }
    match (summary.contents.span_ns, next.contents.span_ns) {
        (Some((_, end)), Some((start, _))) if start < end => {
            Err(RecordingError::Overlap { file, other, overlap_s: (end - start) as f64 * 1e-9 })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
#[path = "edit_tests.rs"]
mod tests;
