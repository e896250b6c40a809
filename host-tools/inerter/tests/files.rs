//! Files made from files: `export`, `cut`, `merge`, and the report of `info` on them.

use std::{fs, path::Path};

use crate::common::{done, fails, inerter, json_lines, last, run, text};
use serde_json::Value;

fn simulate(folder: &Path, more: &[&str]) {
    done(folder, &[&["simulate", "-o", "run.mcap", "--force", "--duration", "6"], more].concat());
}

fn number(of: &Value, key: &str) -> u64 {
    of.get(key).and_then(Value::as_u64).unwrap_or_else(|| panic!("no number {key} in {of}"))
}

#[test]
fn a_recording_becomes_every_format_at_once_and_nothing_is_replaced_unasked() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &["--set", "terminal_sensor=1"]);
    let outputs = ["--csv", "o.csv", "--parquet", "o.parquet", "--mat", "o.mat", "--mcap", "o.mcap"];
    let all = [&["export", "run.mcap", "--from", "1", "--to", "3.5", "--estimates", "--json"], &outputs[..]].concat();
    let exported = last(&done(folder.path(), &all));
    assert_eq!((number(&exported, "samples"), number(&exported, "estimates")), (2500, 12));
    assert_eq!(exported.get("settings_file").unwrap(), "o.settings.toml");
    let files: Vec<&str> = exported
        .get("outputs")
        .unwrap()
        .as_array()
        .unwrap()
        .iter()
        .map(|output| output["file"].as_str().unwrap())
        .collect();
    assert_eq!(files, ["o.csv", "o.estimates.csv", "o.parquet", "o.estimates.parquet", "o.mat", "o.mcap"]);
    for file in &files {
        assert!(folder.path().join(file).metadata().unwrap().len() > 1000, "{file}");
    }
    let csv = fs::read_to_string(folder.path().join("o.csv")).unwrap();
    let times: Vec<&str> = csv.lines().map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!((times[0], times[1], *times.last().unwrap()), ("t_s", "1.0", "3.499"));

    for output in outputs.chunks(2) {
        let words = fails(folder.path(), &[&["export", "run.mcap"], output].concat(), 8);
        assert!(words.contains("exists already") && words.contains("--force"), "{words}");
    }
    fs::write(folder.path().join("p.estimates.csv"), "mine").unwrap();
    fails(folder.path(), &["export", "run.mcap", "--csv", "p.csv", "--estimates"], 8);
    done(folder.path(), &["export", "run.mcap", "--csv", "o.csv", "--columns", "index, saturated,t_s", "--force"]);
    let csv = fs::read_to_string(folder.path().join("o.csv")).unwrap();
    assert!(csv.starts_with("index,saturated,t_s\n0,0,0.0\n1,0,0.001\n"), "{}", &csv[..60]);
    let left = fs::read_dir(folder.path())
        .unwrap()
        .filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().contains(".part"));
    assert_eq!(left.count(), 0, "nothing half-written is left");
}

#[test]
fn a_part_replays_as_its_samples_do() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &[]);
    let cut =
        last(&done(folder.path(), &["cut", "run.mcap", "--from", "2", "--to", "4.5", "-o", "part.mcap", "--json"]));
    let seconds = |key: &str| cut.get(key).unwrap().as_f64().unwrap();
    let (from_s, to_s) = (seconds("from_s"), seconds("to_s"));
    assert!((2.0..2.032).contains(&from_s) && (4.499..4.532).contains(&to_s), "{cut}");
    let (from, to) = (from_s.to_string(), (to_s + 0.0005).to_string());
    done(folder.path(), &["export", "run.mcap", "--from", &from, "--to", &to, "--csv", "part.csv"]);
    let replayed = done(folder.path(), &["replay", "part.mcap", "--json"]);
    let samples = done(folder.path(), &["replay", "part.csv", "--settings", "part.settings.toml", "--json"]);
    let shifted: Vec<Value> = json_lines(&samples).into_iter().map(|line| since(line, from_s)).collect();
    let expected: Vec<Value> = json_lines(&replayed).into_iter().map(|line| since(line, 0.0)).collect();
    assert_eq!(shifted.len(), expected.len());
    for (shifted, expected) in shifted.iter().zip(&expected) {
        assert_eq!(shifted, expected);
    }
}

/// A line with times relative to `start_s`, and without the sample counter, which a CSV does not have.
fn since(mut line: Value, start_s: f64) -> Value {
    if let Some(t_s) = line.get("t_s").and_then(Value::as_f64) {
        line["t_s"] = Value::from(((t_s - start_s) * 1e6).round());
    }
    line.as_object_mut().unwrap().remove("index");
    line
}

#[test]
fn parts_make_the_whole_again() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &[]);
    let whole = fs::read(folder.path().join("run.mcap")).unwrap();
    done(folder.path(), &["cut", "run.mcap", "--to", "3", "-o", "a.mcap"]);
    done(folder.path(), &["cut", "run.mcap", "--from", "3", "-o", "b.mcap"]);
    let merged = last(&done(folder.path(), &["merge", "b.mcap", "a.mcap", "-o", "c.mcap", "--json"]));
    assert_eq!(number(&merged, "samples"), 6000);
    let replayed = |file: &str| done(folder.path(), &["replay", file, "--json"]);
    assert_eq!(replayed("c.mcap"), replayed("run.mcap"));
    let info = last(&done(folder.path(), &["info", "c.mcap", "--json"]));
    let before = last(&done(folder.path(), &["info", "run.mcap", "--json"]));
    for key in [
        "samples",
        "discontinuities",
        "lost_frames",
        "frames",
        "settings",
        "device",
        "estimate",
        "first_ns",
        "last_ns",
        "ending",
    ] {
        assert_eq!(info.get(key), before.get(key), "{key}");
    }
    assert!(fs::read(folder.path().join("run.mcap")).unwrap() == whole, "the input is left alone");

    let words = fails(folder.path(), &["merge", "run.mcap", "a.mcap", "-o", "d.mcap"], 3);
    assert!(words.contains("inerter::recording::overlap"), "{words}");
    let words = fails(folder.path(), &["cut", "run.mcap", "--from", "9", "-o", "d.mcap"], 3);
    assert!(words.contains("no samples from 9 s to its end: it is 5.999 s long"), "{words}");
    fails(folder.path(), &["cut", "run.mcap", "-o", "c.mcap"], 8);
    assert!(!folder.path().join("d.mcap").exists());
}

/// Linux allows any bytes in the name of a file; JSON does not.
#[cfg(target_os = "linux")]
#[test]
fn names_that_are_not_text_are_reported_as_json_too() {
    use std::{ffi::OsStr, os::unix::ffi::OsStrExt};

    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &[]);
    fs::rename(folder.path().join("run.mcap"), folder.path().join(OsStr::from_bytes(b"\xff.mcap"))).unwrap();
    let commands: [&[&[u8]]; 5] = [
        &[b"info", b"\xff.mcap"],
        &[b"cut", b"\xff.mcap", b"--to", b"3", b"-o", b"a\xff.mcap"],
        &[b"cut", b"\xff.mcap", b"--from", b"3", b"-o", b"b\xff.mcap"],
        &[b"merge", b"a\xff.mcap", b"b\xff.mcap", b"-o", b"c\xff.mcap"],
        &[b"export", b"c\xff.mcap", b"--csv", b"c\xff.csv"],
    ];
    for command in commands {
        let arguments = command.iter().map(|argument| OsStr::from_bytes(argument));
        let output = inerter(folder.path(), &[]).args(arguments).arg("--json").output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert!(last(&text(&output.stdout)).to_string().contains('\u{fffd}'), "{}", text(&output.stdout));
    }
}

#[test]
fn a_recording_that_breaks_off_can_be_cut_and_exported() {
    let folder = tempfile::tempdir().unwrap();
    simulate(folder.path(), &[]);
    let bytes = fs::read(folder.path().join("run.mcap")).unwrap();
    for part in [0.3, 0.6, 0.9] {
        fs::write(folder.path().join("cut.mcap"), &bytes[..(bytes.len() as f64 * part) as usize]).unwrap();
        let info = last(&done(folder.path(), &["info", "cut.mcap", "--json"]));
        assert_eq!(info.get("ending").unwrap(), "cut_off");
        let repaired = last(&done(folder.path(), &["cut", "cut.mcap", "-o", "whole.mcap", "--json", "--force"]));
        assert_eq!(number(&repaired, "samples"), number(&info, "samples"));
        let info = last(&done(folder.path(), &["info", "whole.mcap", "--json"]));
        assert_eq!(info.get("ending").unwrap(), "closed");
        let output = run(folder.path(), &["export", "cut.mcap", "--parquet", "o.parquet", "--json", "--force"]);
        assert_eq!(number(&last(&text(&output.stdout)), "samples"), number(&repaired, "samples"));
        assert!(text(&output.stderr).contains("the file is cut off"));
    }
}

/// Lines typed during a recording. A terminal of its own needs `setsid`, which Linux systems have.
#[cfg(target_os = "linux")]
#[test]
fn what_is_typed_while_it_is_recorded_becomes_a_marker() {
    use std::{io::Write, os::unix::ffi::OsStrExt};

    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

    let device = crate::common::device(1.0);
    let folder = tempfile::tempdir().unwrap();
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap();
    let terminal = fs::OpenOptions::new()
        .read(true)
        .write(true)
        .open(Path::new(std::ffi::OsStr::from_bytes(name.as_bytes())))
        .unwrap();
    let plain = inerter(folder.path(), &["record", "--connect", device.name(), "-o", "run.mcap", "--duration", "2.5"]);
    let mut command = std::process::Command::new("setsid");
    command.args(["--ctty", "--wait"]).arg(plain.get_program()).args(plain.get_args()).current_dir(folder.path());
    let mut child = command.stdin(terminal).stderr(std::process::Stdio::piped()).spawn().unwrap();
    // Typing ahead is fine: the terminal keeps the input.
    let mut keyboard = fs::File::from(master);
    keyboard.write_all("shaker on \u{3c9}\n\n".as_bytes()).unwrap();
    assert!(child.wait().unwrap().success());
    let info = last(&done(folder.path(), &["info", "run.mcap", "--json"]));
    let markers = info.get("markers").unwrap().as_array().unwrap();
    let texts: Vec<&str> = markers.iter().map(|marker| marker["text"].as_str().unwrap()).collect();
    assert_eq!(texts, ["shaker on \u{3c9}", "marker 2"]);
    let words = done(folder.path(), &["info", "run.mcap"]);
    assert!(words.contains(" s  shaker on \u{3c9}\n"), "{words}");
}

/// The second copy of the data in a recording, for PlotJuggler and Foxglove, must stay small compared with the first.
#[test]
fn decoded_channels_stay_small() {
    let folder = tempfile::tempdir().unwrap();
    for (rate, least, most) in [("1000", 0.3, 0.6), ("4000", 0.1, 0.25)] {
        simulate(folder.path(), &["--sample-rate-hz", rate]);
        let bytes = fs::read(folder.path().join("run.mcap")).unwrap();
        let (mut frames, mut decoded) = (0, 0);
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            let message = message.unwrap();
            // Including its header and its index entry.
            let size = message.data.len() + 31 + 16;
            *(if message.channel.message_encoding == "json" { &mut decoded } else { &mut frames }) += size;
        }
        let growth = f64::from(u32::try_from(decoded).unwrap()) / f64::from(u32::try_from(frames).unwrap());
        assert!((least..most).contains(&growth), "{growth} at {rate} Hz");
    }
}
