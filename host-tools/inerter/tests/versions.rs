//! The program with devices whose firmware is older or newer.

use std::path::Path;

use crate::common::{any_port, device, done, estimate_of, firmware, inerter, json_lines, last, run, setup, text};
use inerter_simulate::VirtualDevice;
use inerter_wire::{Capabilities, Event, EventKind, Record, SettingValue, SettingsValues};
use serde_json::Value;

/// These settings without those from number `end` on, and with `more` appended.
fn settings(values: &SettingsValues, end: usize, more: &[SettingValue]) -> Record {
    let kept = values.0.iter().filter(|entry| usize::from(entry.number) < end).chain(more);
    Record::Settings(SettingsValues(kept.copied().collect()))
}

/// Sends everything that later firmware may add without a new wire version.
fn newer(record: &Record) -> Vec<Vec<u8>> {
    let next = Record::TABLE.len() as u8;
    let as_it_is = firmware::payload(record);
    match record {
        // One record right after the estimate's, another further on.
        Record::Detail(detail) => {
            let index = [detail.index as u8 | 0x80, (detail.index >> 7) as u8 & 0x7F];
            vec![as_it_is, [&[next], &index[..], &[1, 2, 3]].concat(), vec![200, 1, 0, 0]]
        }
        // An event of an unknown kind, also between an estimate and its detail.
        Record::Estimate(_) | Record::Health(_) => vec![as_it_is, vec![4, 0, 100]],
        Record::Settings(values) => {
            let mut values = values.clone();
            values.0.iter_mut().filter(|entry| entry.number == FRONT_END).for_each(|entry| entry.value = 9.0);
            let values = &values;
            let more = [SettingValue { number: 40, value: 7.0 }, SettingValue { number: 250, value: -1.0 }];
            vec![firmware::payload(&settings(values, usize::MAX, &more))]
        }
        Record::Hello(hello) => {
            let capabilities = hello.capabilities.with(Capabilities(1 << 30));
            vec![firmware::payload(&Record::Hello(inerter_wire::Hello { capabilities, ..hello.clone() }))]
        }
        _ => vec![as_it_is],
    }
}

/// Number of the setting `front_end`, for which later firmware may know more values.
const FRONT_END: u8 = 22;

/// Number of settings in the first firmware.
const OLDER_SETTINGS: usize = 21;

/// Sends only what the first firmware sent.
fn older(record: &Record) -> Vec<Vec<u8>> {
    match record {
        Record::Detail(_) | Record::MoreSums(_) | Record::Reversal(_) | Record::Law(_) => Vec::new(),
        Record::Event(Event { kind: EventKind::Changed(_) | EventKind::Warned(_), .. }) => Vec::new(),
        Record::Settings(values) => vec![firmware::payload(&settings(values, OLDER_SETTINGS, &[]))],
        _ => vec![firmware::payload(record)],
    }
}

/// Records the same run through a device with this firmware. Returns the notes of the recording.
fn record(folder: &Path, file: &str, change: Option<firmware::Change>) -> String {
    let setup = setup("random@10s");
    let device = VirtualDevice::waiting(&setup, &any_port(), 10.0).unwrap();
    let address = change.map_or_else(|| device.name().to_string(), |change| firmware::before(device.name(), change));
    let output = run(folder, &["record", "--connect", &address, "-o", file, "--until-end", "--duration", "60"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stderr)
}

fn info(folder: &Path, file: &str) -> Value {
    last(&done(folder, &["info", file, "--json"]))
}

#[test]
fn a_recording_of_any_firmware_is_replayed_exported_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder, "same.mcap", None);
    let same = done(folder, &["replay", "same.mcap", "--json"]);
    for (file, change, note) in [
        (
            "newer.mcap",
            newer as firmware::Change,
            "the firmware is newer than this program: 2 settings and 1 value unknown here, left out",
        ),
        ("older.mcap", older, "the firmware is older than this program: "),
    ] {
        let notes = record(folder, file, Some(change));
        assert!(notes.contains(note), "{file}: {notes}");
        let info = info(folder, file);
        assert_eq!(
            (&info["samples"], &info["lost_frames"], &info["damaged_frames"]),
            (&10_000.into(), &0.into(), &0.into())
        );
        // The samples are equal, and so are the estimates.
        assert_eq!(done(folder, &["replay", file, "--json"]), same, "{file}");
        let replayed = estimate_of(&last(&same));
        for key in ["inertance_kg", "viscous_n_s_per_m", "coulomb_n", "whole_run", "residual_rms_n"] {
            assert_eq!(info["estimate"][key], replayed[key], "{file}: {key}");
        }
        let targets =
            ["--csv", "out.csv", "--parquet", "out.parquet", "--mat", "out.mat", "--mcap", "out.mcap", "--force"];
        done(folder, &[&["export", file, "--estimates"], &targets[..]].concat());
        assert_eq!(std::fs::read_to_string(folder.join("out.csv")).unwrap().lines().count(), 10_001);
        let rows = std::fs::read_to_string(folder.join("out.estimates.csv")).unwrap().lines().count();
        // This includes the last one, whose detail the older firmware does not send.
        assert_eq!(info["records"]["Estimate"], rows - 1, "{file}");
        done(folder, &["report", file, "-o", "page.html", "--force"]);
    }
    // The records that belong to the last estimate are present if the firmware sends them.
    assert!(!info(folder, "newer.mcap")["estimate"]["backlash_m"].is_null());
    assert!(info(folder, "older.mcap")["estimate"]["backlash_m"].is_null());
    let words = text(&run(folder, &["info", "newer.mcap"]).stderr);
    assert!(words.contains("frames of a kind unknown to this program were left out"), "{words}");
    assert!(words.contains("the firmware is newer than this program"), "{words}");
}

#[test]
fn a_device_with_any_firmware_is_watched_and_set() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (change, has_detail) in [(newer as firmware::Change, true), (older, false)] {
        let device = device(5.0);
        let address = firmware::before(device.name(), change);
        let link = ["--connect", address.as_str()];
        let lines = json_lines(&done(folder, &[&["monitor", "--json", "--duration", "2"], &link[..]].concat()));
        let of = |kind: &'static str| lines.iter().filter(move |line| line["kind"] == kind);
        assert!(of("estimate").count() > 3 && of("health").count() > 0);
        assert!(of("estimate").all(|line| line.get("backlash_m").is_some_and(|value| !value.is_null()) == has_detail));
        assert_eq!(of("link").any(|line| line["unknown_frames"].as_u64() > Some(0)), has_detail);
        assert!(of("link").all(|line| line.get("lost_frames").is_none()));
        let plain =
            inerter(folder, &[&["monitor", "--plain", "--duration", "2"], &link[..]].concat()).output().unwrap();
        let notes = text(&plain.stderr);
        let said = notes.matches("frames of a kind unknown to this program").count();
        assert_eq!(said, usize::from(has_detail), "{notes}");

        let set = ["settings", "set", "memory_s=12", "--json"];
        let settings = last(&done(folder, &[&set[..], &link].concat()));
        assert_eq!(settings.pointer("/settings/memory_s"), Some(&12.0.into()), "{settings}");
        let kept = run(folder, &[&["settings", "backup", "kept.toml", "--force"], &link[..]].concat());
        assert!(kept.status.success() && text(&kept.stderr).contains("than this program"), "{}", text(&kept.stderr));
        done(folder, &[&["settings", "restore", "kept.toml"], &link[..]].concat());
    }
}
