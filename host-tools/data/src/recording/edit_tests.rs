use std::fs;

use inerter_core::RawSample;
use inerter_wire::{Event, EventKind};
use proptest::prelude::{ProptestConfig, any};

use super::*;
use crate::{
    fixtures::{Stream, hello, new_file},
    recording::{Item, read, read_run},
    settings::Overrides,
};

/// Sends samples 32 at a time, at 1 kHz; returns the index of the next one.
fn send_samples(stream: &mut Stream, first: u32, batches: u32) -> u32 {
    (0..batches).fold(first, |first, _| {
        let raw = |index: u32| RawSample { index, position_count: (index * 7) as i32, ..RawSample::default() };
        let batch: Vec<RawSample> = (first..first + 32).map(raw).collect();
        stream.time_ns += 32_000_000;
        stream.send(&Record::Samples(Samples::from_slice(&batch).0));
        first + 32
    })
}

fn settings() -> Settings {
    Settings { sample_rate_hz: 1000.0, metres_per_count: 1e-6, ..Settings::default() }
}

/// 3.2 s of samples, with an event and two markers.
fn recording(path: &Path) {
    let mut stream = Stream::new(path);
    stream.recorder.describe(&hello("1"), &settings()).unwrap();
    let next = send_samples(&mut stream, 500, 40);
    stream.recorder.marker(stream.time_ns, "shaker on").unwrap();
    stream.send(&Record::Event(Event { index: 1779, kind: EventKind::EstimatorReset }));
    send_samples(&mut stream, next, 60);
    stream.recorder.marker(stream.time_ns, "shaker off, \"finished\"").unwrap();
    stream.close("finished");
}

fn indices(path: &Path) -> Vec<u32> {
    read_run(path, &Overrides::default()).unwrap().samples.iter().map(|sample| sample.index).collect()
}

fn quiet(_: u64) -> Result<(), Error> {
    Ok(())
}

#[test]
fn parts_hold_whole_frames_and_each_of_them_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    recording(&path("run.mcap"));
    let whole = indices(&path("run.mcap"));
    let mut together = Vec::new();
    for (number, range_s) in [0.0..1.0, 1.0..2.5, 2.5..f64::INFINITY].into_iter().enumerate() {
        let part = path(&format!("{number}.mcap"));
        let found = cut(&path("run.mcap"), range_s.clone(), &part, true, quiet).unwrap();
        let samples = indices(&part);
        assert_eq!(found.samples as usize, samples.len());
        assert_eq!((found.span_s.0 * 1000.0).round() as u32 + 500, samples[0]);
        assert!(range_s.start <= found.span_s.0 && found.span_s.0 < range_s.start + 0.032);
        assert!(found.span_s.1 < range_s.end + 0.032);
        together.extend(samples);
    }
    assert_eq!(together, whole);
    assert_eq!(together.len(), 3200);
    let parts = [path("2.mcap"), path("0.mcap"), path("1.mcap")];
    let merged = merge(&parts, &path("again.mcap"), true, quiet).unwrap();
    assert_eq!((merged.samples, merged.frames), (3200, 101));
    assert_eq!(indices(&path("again.mcap")), whole);
    let (summary, again) = (summary(&path("run.mcap")).unwrap(), super::summary(&path("again.mcap")).unwrap());
    assert_eq!(again.extent, summary.extent);
    assert_eq!(again.markers, summary.markers);
    let marked: Vec<(u64, &str)> = again.markers.iter().map(|marker| (marker.periods, marker.text.as_str())).collect();
    assert_eq!(marked, [(1279, "shaker on"), (3199, "shaker off, \"finished\"")]);
    assert_eq!(again.contents.counts.lost, 0, "streams that follow each other lose nothing between them");
    assert_eq!(again.settings, summary.settings);
    assert_eq!(again.records.get("Event"), Some(&1));
}

#[test]
fn the_frames_of_a_part_are_those_of_the_recording() {
    let (folder, run) = new_file("run.mcap");
    let part = folder.path().join("part.mcap");
    recording(&run);
    cut(&run, 1.0..2.0, &part, true, quiet).unwrap();
    let frames = |path: &Path| {
        let mut frames = Vec::new();
        read(path, |incoming| {
            if let Item::Frame(frame) = incoming.item {
                frames.push((incoming.time_ns, frame));
            }
        })
        .unwrap();
        frames
    };
    let (all, some) = (frames(&run), frames(&part));
    assert_eq!(some.len(), 32, "31 batches and the event among them");
    assert!(all.windows(some.len()).any(|window| window == some));
}

#[test]
fn parts_of_a_recording_that_was_cut_off_or_damaged_hold_what_there_is() {
    let (folder, run) = new_file("run.mcap");
    let part = folder.path().join("part.mcap");
    recording(&run);
    let bytes = fs::read(&run).unwrap();
    fs::write(&run, &bytes[..bytes.len() / 2]).unwrap();
    let before = indices(&run);
    assert!((500..3000).contains(&before.len()), "{}", before.len());
    let found = cut(&run, 0.0..f64::INFINITY, &part, true, quiet).unwrap();
    assert_eq!(indices(&part), before);
    assert_eq!(found.samples as usize, before.len());
    let end = summary(&part).unwrap().contents.metadata.remove(END_METADATA).unwrap();
    assert_eq!(end["reason"], "the file that it was made from is cut off");
}

#[test]
fn what_cannot_follow_is_refused_by_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let make = |name: &str, serial: &str, settings: &Settings, time_ns: u64| {
        let mut stream = Stream::new(&path(name));
        stream.recorder.describe(&hello(serial), settings).unwrap();
        stream.time_ns = time_ns;
        send_samples(&mut stream, 0, 10);
        stream.close("finished");
    };
    make("a", "1", &settings(), 0);
    make("later", "1", &settings(), 320_000_000);
    make("other", "2", &settings(), 320_000_000);
    make("heavier", "1", &Settings { structure_mass_kg: 3.0, ..settings() }, 320_000_000);
    make("same-time", "1", &settings(), 100_000_000);
    let refused = |name: &str| match merge(&[path("a"), path(name)], &path("out"), true, quiet) {
        Err(error) => error.to_string(),
        Ok(merged) => format!("{merged:?}"),
    };
    assert!(refused("later").contains("samples: 640"));
    assert!(refused("other").contains("the device with serial number 1") && refused("other").contains("from 2"));
    assert!(refused("heavier").contains("structure_mass_kg is 0"), "{}", refused("heavier"));
    assert!(refused("same-time").contains("overlap by 0.188 s"), "{}", refused("same-time"));
    let error = cut(&path("a"), 5.0..6.0, &path("out"), true, quiet).unwrap_err();
    assert!(error.to_string().contains("no samples from 5 s to 6 s: it is 0.319 s long"), "{error}");
    let empty = cut(&path("a"), 0.2..0.1, &path("out"), true, quiet);
    assert!(matches!(empty, Err(Error::Recording(RecordingError::EmptyRange { .. }))));
}

#[test]
fn work_that_is_broken_off_says_so() {
    let (folder, run) = new_file("run.mcap");
    recording(&run);
    let broken = cut(&run, 0.0..1.0, &folder.path().join("part.mcap"), true, |_| Err(Error::Interrupted));
    assert!(matches!(broken, Err(Error::Interrupted)));
}

proptest::proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]
    #[test]
    fn no_damage_panics(
        damage in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..6),
        from_s in -1.0..4.0_f64,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let (run, part, twice) = (folder.path().join("run"), folder.path().join("part"), folder.path().join("twice"));
        recording(&run);
        let mut bytes = fs::read(&run).unwrap();
        for (place, value) in damage {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        fs::write(&run, bytes).unwrap();
        if let Ok(cut) = cut(&run, from_s..f64::INFINITY, &part, true, quiet) {
            proptest::prop_assert_eq!(cut.samples as usize, indices(&part).len());
        }
        // The same recording twice overlaps, unless the damage has changed its times.
        merge(&[run.clone(), run], &twice, true, quiet).ok();
    }
}
