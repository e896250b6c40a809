use std::{fs, path::PathBuf};

use inerter_core::{Estimate, Published, RawSample, Reversal, Route, Settings, State};
use inerter_wire::{Event, EventKind, Health, Hello, Samples};
use proptest::prelude::*;
use serde_json::Value;
use tempfile::TempDir;

use super::*;
use crate::{
    fixtures::{Stream, hello, new_file},
    recording::summary,
};

/// Ten seconds of samples, 32 to a frame, closed or not.
fn recording(close: bool) -> (TempDir, PathBuf) {
    let (folder, path) = new_file("run.mcap");
    let mut stream = Stream::new(&path);
    let settings = Settings { memory_s: 12.5, sample_rate_hz: 1000.0, metres_per_count: 1e-6, ..Settings::default() };
    stream.recorder.describe(&hello("1"), &settings).unwrap();
    let raws: Vec<RawSample> = (0..10_000)
        .map(|index| RawSample { index, position_count: index as i32 * 3, ..RawSample::default() })
        .collect();
    for (number, batch) in raws.chunks(32).enumerate() {
        stream.time_ns = batch.last().map_or(0, |raw| u64::from(raw.index) * 1_000_000);
        stream.send(&Record::Samples(Samples::from_slice(batch).0));
        if number % 64 == 0 {
            stream.recorder.marker(stream.time_ns, "here").unwrap();
            others(stream.time_ns).iter().for_each(|record| stream.send(record));
        }
    }
    if close {
        stream.close("finished");
    } else {
        // As when the program is killed: all frames are written, the summary is not.
        drop(stream);
        let bytes = fs::read(&path).unwrap();
        let footer = mcap::read::footer(&bytes).unwrap();
        fs::write(&path, &bytes[..footer.summary_start as usize]).unwrap();
    }
    (folder, path)
}

/// The bytes of the closed one.
fn sound() -> Vec<u8> {
    let (_folder, path) = recording(true);
    fs::read(path).unwrap()
}

/// One record for each of the decoded channels.
fn others(time_ns: u64) -> [Record; 5] {
    let settings = Settings { sample_rate_hz: 1000.0, metres_per_count: 1e-6, ..Settings::default() };
    let active = settings.validate().unwrap();
    let state = State::new(&active);
    let index = (time_ns / 1_000_000) as u32;
    let Published { estimate, detail, .. } = active.publish(&state);
    [
        Record::Estimate(Estimate { index, ..estimate }),
        Record::Detail(detail),
        Record::Reversal(Reversal { index, value_m: 1e-5, error_m: 1e-6, route: Route::Force, rising: true }),
        Record::Event(Event { index, kind: EventKind::EstimatorReset }),
        Record::Health(Health { index, ..Health::default() }),
    ]
}

fn samples_of(bytes: &[u8]) -> Result<(usize, Ending), RecordingError> {
    let mut samples = 0;
    let contents = read_all(Messages::new("f", bytes), |incoming| {
        if let Item::Frame(Frame::Message { message: Record::Samples(batch), .. }) = incoming.item {
            samples += batch.iter().flatten().count();
        }
    })?;
    Ok((samples, contents.ending))
}

#[test]
fn a_closed_recording_reads_back_with_its_metadata() {
    let (_folder, path) = recording(true);
    let contents = read(&path, |_| ()).unwrap();
    assert_eq!(contents.ending, Ending::Closed);
    assert_eq!(contents.counts.messages, 313 + 5 * 5);
    let value = |name: &str, key: &str| contents.metadata.get(name).and_then(|map| map.get(key)).cloned();
    assert_eq!(value("inerter.settings", "memory_s").as_deref(), Some("12.5"));
    assert_eq!(value("inerter.hello", "board").as_deref(), Some("desk"));
    assert_eq!(value("inerter.end", "reason").as_deref(), Some("finished"));
    assert_eq!(contents.span_ns, Some((31_000_000, 9_999_000_000)));
    let markers = summary(&path).unwrap().markers;
    assert_eq!(markers.len(), 5);
    assert_eq!((markers[1].periods, markers[1].text.as_str()), (65 * 32 - 1, "here"));
}

#[test]
fn the_decoded_channels_say_what_the_frames_say() {
    let bytes = sound();
    let mut found: BTreeMap<String, Vec<Value>> = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap().map(|message| message.unwrap()) {
        if message.channel.message_encoding == "json" {
            let schema = message.channel.schema.as_ref().unwrap();
            let schema_json: Value = serde_json::from_slice(&schema.data).unwrap();
            let json: Value = serde_json::from_slice(&message.data).unwrap();
            for (key, value) in json.as_object().unwrap() {
                let property = &schema_json["properties"][key];
                let fits = match property["type"].as_str() {
                    Some("number" | "integer") => value.is_number() || value.is_null(),
                    Some("string") => value.is_string() || value.is_null(),
                    Some("object") => value.is_object(),
                    Some("array") => value.is_array() || value.is_null(),
                    Some("boolean") => value.is_boolean(),
                    _ => false,
                };
                assert!(fits, "{}: {key} is {value}, its schema {property}", message.channel.topic);
            }
            found.entry(message.channel.topic.clone()).or_default().push(json);
        }
    }
    let count = |topic: &str| found.get(topic).map_or(0, Vec::len);
    assert_eq!(["marker", "estimate", "reversal", "event", "health"].map(count), [5; 5]);
    assert_eq!(count("motion"), 200, "each of 50 ms");
    let motion = &found["motion"][1];
    assert_eq!(motion["t_s"], 0.0745);
    assert!((motion["position_m"].as_f64().unwrap() - 3.0 * 74.5e-6).abs() < 1e-10, "{motion}");
    assert_eq!(found["reversal"][1]["t_s"], 2.079, "by the sample counter, not the host's clock");
}

#[test]
fn what_was_recorded_before_the_program_was_killed_reads_back_to_within_a_second() {
    let (_folder, path) = recording(false);
    let (samples, ending) = samples_of(&fs::read(&path).unwrap()).unwrap();
    assert!((9000..=10_000).contains(&samples), "{samples}");
    assert_eq!(ending, Ending::CutOff);
}

#[test]
fn a_file_cut_off_anywhere_reads_up_to_the_cut() {
    let bytes = sound();
    let mut before = 0;
    // Size of the channels and schemas, which come first.
    let head = 12_000;
    for cut in (0..=bytes.len()).step_by(97) {
        match samples_of(bytes.get(..cut).unwrap()) {
            Ok((samples, ending)) => {
                assert!(samples >= before);
                // Each frame holds 32 samples: no more than two frames before the cut are missing.
                let part = cut.saturating_sub(head) as f64 / (bytes.len() - head) as f64;
                let expected = (part * 10_000.0) as usize;
                assert!(samples + 800 > expected, "{samples} of about {expected} at {cut}");
                assert!(ending != Ending::Closed || samples == 10_000);
                before = samples;
            }
            Err(RecordingError::WrongKind { .. }) => assert!(cut < 8),
            Err(RecordingError::NoChannel { .. }) => assert!(cut < 1500, "{cut}"),
            Err(other) => panic!("{other}"),
        }
    }
}

#[test]
fn another_kind_of_file_is_refused() {
    assert!(matches!(samples_of(b"t_s,encoder_count,force_n\n"), Err(RecordingError::WrongKind { .. })));
    assert!(matches!(samples_of(b""), Err(RecordingError::WrongKind { .. })));
    let mut file = Vec::new();
    mcap::Writer::new(std::io::Cursor::new(&mut file)).unwrap().finish().unwrap();
    assert!(matches!(samples_of(&file), Err(RecordingError::NoChannel { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
        let _ = samples_of(&bytes);
        let with_magic = [mcap::MAGIC, &bytes].concat();
        let _ = samples_of(&with_magic);
    }

    #[test]
    fn no_damage_panics(damage in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8)) {
        thread_local!(static SOUND: Vec<u8> = sound());
        let mut bytes = SOUND.with(Clone::clone);
        for (place, value) in damage {
            let place = place.index(bytes.len());
            if let Some(byte) = bytes.get_mut(place) {
                *byte = value;
            }
        }
        if let Ok((samples, _)) = samples_of(&bytes) {
            prop_assert!(samples <= 10_000);
        }
    }
}

#[test]
fn of_faults_without_end_the_first_are_told_and_the_others_counted() {
    let (_folder, path) = new_file("run.mcap");
    let mut stream = Stream::new(&path);
    for number in 0..100_000 {
        // Each text occurs twice.
        let kind = EventKind::Panicked(Hello::text(&format!("at line {}", number / 2)));
        stream.time_ns = number;
        stream.send(&Record::Event(Event { index: 0, kind }));
    }
    stream.close("finished");
    let notes = summary(&path).unwrap().notes;
    assert_eq!(notes.len(), 21, "{notes:?}");
    assert!(
        notes[0].contains("had failed before this run: at line 0;") && notes[19].contains("at line 19;"),
        "{notes:?}"
    );
    assert!(notes[20].contains("99960 further reports of such faults"), "{notes:?}");
}

#[test]
fn an_estimate_whose_detail_does_not_come_is_decoded_at_the_end() {
    let (_folder, path) = new_file("run.mcap");
    let mut stream = Stream::new(&path);
    stream.recorder.describe(&hello("1"), &Settings::default()).unwrap();
    stream.time_ns = 7;
    stream.send(&Record::Estimate(Estimate { index: 5, elapsed_samples: 6, ..Estimate::default() }));
    stream.close("finished");
    let bytes = fs::read(&path).unwrap();
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(|message| message.unwrap().channel.topic.clone());
    assert_eq!(messages.filter(|topic| topic == "estimate").count(), 1);
}
