//! Recordings.
//!
//! Input: a byte (bit 0: messages to record instead of a file; bit 1: also cut and merge), then the file, or messages:
//! a kind (u8), a time step (u8), and a counted content (the payload of a record, raw bytes or a marker).
//!
//! Properties: all readers agree on the contents of a file. A cut over the whole time contains the same samples. The
//! recorder's output reads back frame by frame. Every error can be displayed.

use std::path::Path;

use inerter_core::{RawSample, Settings};
use inerter_data::{
    Error,
    recording::{self, Ending, Item, Recorder},
    settings::Overrides,
};
use inerter_wire::{
    Capabilities, ClockSource, DELIMITER, Frame, FrameReader, Hello, MAX_PAYLOAD, Record, WIRE_VERSION,
};

use crate::{
    csv::{check_replay, show, shown},
    input::{Input, counted, seed},
    scratch, wire,
};

const MESSAGES: u8 = 1;
const EDIT: u8 = 2;
/// Maximum number of samples to replay.
const REPLAYED: usize = 500;

/// Checks an input.
pub fn check(mut input: Input) {
    let kind = input.byte();
    if kind & MESSAGES == 0 {
        check_file(&scratch::file(input.rest()), kind & EDIT != 0);
    } else {
        check_recorder(input, kind & EDIT != 0);
    }
}

fn check_file(path: &Path, edit: bool) {
    let mut frames = 0;
    let contents = recording::read(path, |incoming| {
        frames += u32::from(matches!(incoming.item, Item::Frame(Frame::Message { .. })))
    });
    let summary = recording::summary(path);
    let Some(contents) = shown(contents) else { return assert!(summary.is_err()) };
    assert_eq!(contents.counts.messages, frames);
    let one_by_one = samples(path);
    let summary = match summary {
        Ok(summary) => summary,
        Err(error) => {
            assert!(one_by_one.is_empty(), "{error}");
            return show(&error);
        }
    };
    assert_eq!(summary.extent.samples, one_by_one.len() as u64);
    assert_eq!(summary.contents.counts, contents.counts);
    assert!(summary.extent.periods >= summary.extent.missing);
    if let Some(run) = shown(recording::read_run(path, &Overrides::default())) {
        assert_eq!(run.samples, one_by_one);
        assert_eq!(run.elapsed().last().map(|(elapsed, _)| elapsed), Some(summary.extent.periods));
        check_replay(&run, REPLAYED);
    }
    if edit && summary.settings.is_some() && !one_by_one.is_empty() {
        check_edit(path, &one_by_one);
    }
}

/// The samples of a recording that can be read.
fn samples(path: &Path) -> Vec<RawSample> {
    recording::samples(path).expect("a recording").map(|sample| sample.expect("a sample")).collect()
}

fn check_edit(path: &Path, all: &[RawSample]) {
    let (everything, merged) = (scratch::path(), scratch::path());
    let go_on = |_| Ok::<(), Error>(());
    let cut = recording::cut(path, f64::NEG_INFINITY..f64::INFINITY, &everything, false, go_on).expect("all of it");
    assert_eq!(cut.samples, all.len() as u64);
    assert_eq!(samples(&everything), all, "a part that is everything");
    let put_together = recording::merge(&[everything.to_path_buf()], &merged, false, go_on).expect("one in a row");
    assert_eq!((put_together.samples, put_together.frames), (cut.samples, cut.frames));
    assert_eq!(samples(&merged), all);
}

/// A device that could have made a recording.
pub fn hello() -> Hello {
    Hello {
        wire_version: WIRE_VERSION,
        firmware: Hello::text("inerter 0.1.0"),
        git: Hello::text("c8a2d5a"),
        board: Hello::text("fuzzed"),
        serial: Hello::text("F-1"),
        sample_rate_hz: 1_000.0,
        clock: ClockSource::Simulated,
        capabilities: Capabilities::SUMS,
    }
}

fn check_recorder(mut input: Input, edit: bool) {
    let file = scratch::path();
    let (frames, remarks) = record(&mut input, &file).expect("a file that can be written");
    let (mut reader, mut expected) = (FrameReader::<Record>::new(), Vec::new());
    for frame in &frames {
        for mut part in [&frame[..], &[DELIMITER]] {
            while let Some(found) = reader.read(&mut part) {
                expected.push(format!("{found:?}"));
            }
        }
    }
    let (mut found, mut marked) = (Vec::new(), Vec::new());
    let contents = recording::read(&file, |incoming| match incoming.item {
        Item::Frame(frame) => found.push(format!("{frame:?}")),
        Item::Marker(text) => marked.push(text),
    });
    let contents = contents.expect("what was written is read");
    assert_eq!((contents.ending, &contents.counts), (Ending::Closed, reader.counts()));
    assert_eq!(found, expected);
    assert_eq!(marked, remarks);
    check_file(&file, edit);
}

type Written = (Vec<Vec<u8>>, Vec<String>);

fn record(input: &mut Input, path: &Path) -> Result<Written, Error> {
    let (mut frames, mut remarks) = (Vec::new(), Vec::new());
    let mut recorder = Recorder::create(path, false)?;
    if input.byte() & 1 == 0 {
        recorder.describe(&hello(), &Settings::default())?;
    }
    let (mut time_ns, mut sequence) = (0, 0u16);
    while !input.is_empty() {
        let (kind, step) = (input.byte(), u64::from(input.byte()));
        time_ns += step * step * 100_000;
        let content = input.counted();
        match kind % 8 {
            0 => {
                let text = String::from_utf8_lossy(content).into_owned();
                recorder.marker(time_ns, &text)?;
                remarks.push(text);
            }
            1 => {
                // A received frame contains no delimiter.
                let raw: Vec<u8> = content.iter().copied().filter(|byte| *byte != DELIMITER).collect();
                recorder.frame(time_ns, &raw)?;
                frames.push(raw);
            }
            2 => recorder.quiet(time_ns)?,
            _ => {
                let frame = wire::frame::<Record>(&content[..content.len().min(MAX_PAYLOAD)], sequence);
                let frame = frame.strip_suffix(&[DELIMITER]).expect("a frame with its end").to_vec();
                recorder.frame(time_ns, &frame)?;
                frames.push(frame);
                sequence = sequence.wrapping_add(1 + u16::from(kind == 3));
            }
        }
    }
    let count = frames.len() as u32;
    assert_eq!(recorder.frames(), count);
    recorder.close(&recording::End { reason: "finished".into(), lost_frames: 0 })?;
    Ok((frames, remarks))
}

/// Recordings of a simulated device: complete, truncated and damaged.
pub fn seeds() -> Vec<Vec<u8>> {
    let frames = wire::frames();
    let mut messages = vec![MESSAGES | EDIT, 0];
    let mut alone = Vec::new();
    for (place, frame) in (0u8..).zip(&frames) {
        // Kind and payload, without the step and the length that `payloads` prepends.
        let payload = wire::payloads(frame).split_off(3);
        let message = seed(&[4 + place % 4, 60], counted(payload));
        messages.extend(&message);
        if place == 7 {
            messages.extend(seed(&[0, 1], counted(b"the cable was moved")));
        }
        alone.push(seed(&[MESSAGES | EDIT, place & 1], &message));
    }
    let mut seeds = vec![messages];
    seeds.extend(alone);
    for (describe, count) in [(0, frames.len()), (0, 3), (1, 5), (0, 0)] {
        let file = scratch::path();
        let all: Vec<u8> = frames
            .iter()
            .take(count)
            .flat_map(|frame| seed(&[5, 100], counted(wire::payloads(frame).split_off(3))))
            .collect();
        record(&mut Input(&seed(&[describe], all)), &file).expect("a file that can be written");
        let bytes = std::fs::read(&file).expect("a file that was written");
        seeds.push(seed(&[EDIT], &bytes));
        seeds.push(seed(&[0], &bytes[..bytes.len() * 2 / 3]));
    }
    seeds
}
