//! The program with live devices: virtual ones in this process, and misbehaving ones.

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    path::Path,
    process::Child,
    thread::{self, JoinHandle},
};

use crate::common::{
    self, any_port, assert_same_estimates, device, device_of, done, estimate_of, fails, frames, inerter, json_lines,
    last, run, setup, text,
};
use inerter_data::settings::Overrides;
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Endpoint, Setup, VirtualDevice, bench_sensors};

/// Slightly more bytes than a recording has before its first frame.
const HEAD: u64 = 14_000;

/// A running recording that has created its file.
fn recording(folder: &Path, arguments: &[&str]) -> Child {
    let child = inerter(folder, &[&["record", "-o", "run.mcap"], arguments].concat()).spawn().unwrap();
    let path = folder.join("run.mcap");
    common::until("nothing is recorded", || path.metadata().is_ok_and(|metadata| metadata.len() > HEAD));
    child
}

#[test]
fn what_a_live_device_says_a_replay_of_its_recording_says_too() {
    let folder = tempfile::tempdir().unwrap();
    let device = VirtualDevice::waiting(&setup("random@10s"), &any_port(), 10.0).unwrap();
    done(folder.path(), &["record", "--connect", device.name(), "-o", "run.mcap", "--until-end", "--duration", "60"]);
    let info = last(&done(folder.path(), &["info", "run.mcap", "--json"]));
    assert_eq!((info.get("samples").unwrap(), info.get("discontinuities").unwrap()), (&10_000.into(), &0.into()));
    assert_eq!(info.get("lost_frames").unwrap(), 0);
    let replayed = last(&done(folder.path(), &["replay", "run.mcap", "--json"]));
    assert_eq!(estimate_of(info.get("estimate").unwrap()), estimate_of(&replayed));

    // The same run without a device.
    done(folder.path(), &["simulate", "-o", "file.mcap", "--excite", "random@10s"]);
    let simulated = last(&done(folder.path(), &["replay", "file.mcap", "--json"]));
    assert_eq!(simulated, replayed);

    // The page states the date of a run if the recording has one.
    for (file, dated) in [("run.mcap", true), ("file.mcap", false)] {
        done(folder.path(), &["report", file, "-o", "page.html", "--force"]);
        let page = std::fs::read_to_string(folder.path().join("page.html")).unwrap();
        assert_eq!(page.contains(">Recorded</th><td>20"), dated, "{file}");
    }
}

/// A recording keeps its calibration in all later files, and an outdated calibration is reported.
#[test]
fn a_recording_carries_the_calibration_of_its_rig() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let device = device(10.0);
    let write = |expires: &str| {
        let text =
            format!("memory_s = 10\n[calibration]\ndate = 2020-01-31\ncertificate = \"K\\u001b[2J-<7>\"\n{expires}");
        std::fs::write(at.join("rig.toml"), text).unwrap();
    };
    let record =
        ["record", "--connect", device.name(), "-o", "run.mcap", "--duration", "1", "--force", "--calibration"];
    let record = |file: &str| run(at, &[&record[..], &[file]].concat());
    let page = || {
        done(at, &["report", "cut.mcap", "-o", "page.html", "--force"]);
        std::fs::read_to_string(at.join("page.html")).unwrap()
    };
    write("");
    assert_eq!(record("rig.toml").status.code(), Some(0));
    done(at, &["cut", "run.mcap", "--to", "0.9", "-o", "cut.mcap"]);
    let known = serde_json::json!({"certificate": "K\u{1b}[2J-<7>", "date": "2020-01-31"});
    assert_eq!(last(&done(at, &["info", "cut.mcap", "--json"]))["calibration"], known);
    done(at, &["export", "cut.mcap", "--csv", "cut.csv", "--mcap", "samples.mcap"]);
    let settings = std::fs::read_to_string(at.join("cut.settings.toml")).unwrap();
    assert!(
        settings.ends_with("[calibration]\ncertificate = \"K\\u001b[2J-<7>\"\ndate = \"2020-01-31\"\n"),
        "{settings}"
    );
    let replayed = run(at, &["replay", "cut.csv", "--settings", "cut.settings.toml"]);
    assert!(replayed.status.success(), "{}", text(&replayed.stderr));
    let valid = page();
    assert!(valid.contains("2020-01-31, K\\u001b[2J-&lt;7&gt;") && !valid.contains("was valid until"), "{valid}");

    write("expires = 2021-01-31\n");
    let output = record("rig.toml");
    assert!(text(&output.stderr).contains("was valid until 2021-01-31, and the run was recorded on 20"), "{output:?}");
    done(at, &["cut", "run.mcap", "--to", "0.9", "-o", "cut.mcap", "--force"]);
    assert!(page().contains("was valid until 2021-01-31"));
    done(at, &["store", "add", "store", "cut.mcap"]);
    let row = last(&done(at, &["store", "ls", "store", "--json"]));
    assert_eq!((&row["calibration_date"], &row["calibration_expires"]), (&"2020-01-31".into(), &"2021-01-31".into()));
    // The command line takes precedence.
    std::fs::write(at.join("new.toml"), "[calibration]\ndate = 2026-02-01\n").unwrap();
    let output = run(at, &["replay", "cut.mcap", "--settings", "new.toml"]);
    assert!(output.status.success() && !text(&output.stderr).contains("was valid until"), "{output:?}");

    std::fs::write(at.join("none.toml"), "memory_s = 10\n").unwrap();
    let kept = std::fs::read(at.join("run.mcap")).unwrap();
    for (file, words) in [("none.toml", "[calibration]: there is no such table"), ("gone.toml", "cannot be read")] {
        let output = record(file);
        assert!(!output.status.success() && text(&output.stderr).contains(words), "{output:?}");
    }
    assert_eq!(std::fs::read(at.join("run.mcap")).unwrap(), kept);
}

#[test]
fn a_run_sent_through_a_device_gives_what_a_replay_gives_and_leaves_its_settings_alone() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(10.0);
    let link = ["--connect", device.name()];
    done(folder.path(), &["simulate", "-o", "run.mcap", "--duration", "8", "--set", "memory_s=5"]);
    let replayed = done(folder.path(), &["replay", "run.mcap", "--json"]);
    for _ in 0..2 {
        let sent = done(folder.path(), &[&["send", "run.mcap", "--json"], &link[..]].concat());
        assert_same_estimates(&sent, &replayed);
    }
    let words = done(folder.path(), &[&["send", "run.mcap"], &link[..]].concat());
    assert!(words.contains("8000 samples (8.0 s of motion) sent to"), "{words}");
    done(folder.path(), &[&["record", "-o", "after.mcap", "--duration", "0.2"], &link[..]].concat());
    let after = last(&done(folder.path(), &["info", "after.mcap", "--json"]));
    assert_eq!(after.pointer("/settings/memory_s").unwrap(), 30.0);
}

#[test]
fn instruments_of_a_virtual_device_follow_the_rate_that_is_set() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(5.0);
    let link = ["--connect", device.name()];
    done(folder.path(), &[&["settings", "set", "sample_rate_hz=4000"], &link[..]].concat());
    done(folder.path(), &[&["record", "-o", "run.mcap", "--duration", "2"], &link[..]].concat());
    let info = last(&done(folder.path(), &["info", "run.mcap", "--json"]));
    let samples = info["samples"].as_u64().unwrap();
    // 5 times real time. A busy machine may be slower, but the earlier rate of 1 kHz would give at most 10 000.
    assert!(samples > 12_000 && info["discontinuities"] == 0, "{info}");
    let found = last(&done(folder.path(), &["replay", "run.mcap", "--json"]));
    let inertance = found["inertance_kg"]["value"].as_f64().unwrap();
    assert!((inertance - 299.49).abs() < 1.0, "{found}");
}

#[test]
fn monitor_prints_lines_where_there_is_no_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(5.0);
    let arguments = ["monitor", "--connect", device.name(), "--duration", "1.5"];
    let plain = done(folder.path(), &arguments);
    assert!(plain.starts_with("    t [s]  Effective inertance [kg]"), "{plain}");
    assert!(plain.lines().count() > 5, "{plain}");
    let lines = json_lines(&done(folder.path(), &[&arguments[..], &["--json"]].concat()));
    assert_eq!(lines.first().unwrap().get("kind").unwrap(), "device");
    assert_eq!(lines.first().unwrap().get("wire_version").unwrap(), 1);
    for kind in ["estimate", "health"] {
        assert!(lines.iter().any(|line| line.get("kind").unwrap() == kind), "{kind}");
    }
    // The records that belong to an estimate follow it, and are shown with it.
    for line in lines.iter().filter(|line| line.get("kind").unwrap() == "estimate") {
        assert!(line.get("backlash_m").is_some() && line.get("band_hz").is_some(), "{line}");
    }
}

#[test]
fn a_skew_is_found_on_a_device_and_kept_there() {
    let folder = tempfile::tempdir().unwrap();
    let sensors = Sensors { delay_s: 5e-5, ..bench_sensors() };
    let mut setup = Setup::new(Inerter::paper(), sensors, "random", None, &Overrides::default()).unwrap();
    setup.settings.skew_s = 0.0;
    let device = device_of(&setup, 10.0);
    let link = ["--connect", device.name()];
    let skew = ["calibrate", "skew", "--duration", "25", "--json"];
    let found = last(&done(folder.path(), &[&skew[..], &link].concat()));
    assert_eq!(found.get("written").unwrap(), false);
    let found = last(&done(folder.path(), &[&skew[..], &["--write"], &link].concat()));
    let number = |of: &serde_json::Value, path: &str| of.pointer(path).unwrap().as_f64().unwrap();
    assert!((number(&found, "/skew_s") - 5e-5).abs() < number(&found, "/skew_u95_s"), "{found}");
    assert!(number(&found, "/skew_u95_s") < 5e-6, "{found}");
    let settings = last(&done(folder.path(), &[&["settings", "get", "--json"], &link[..]].concat()));
    for name in ["skew_s", "skew_u95_s"] {
        assert_eq!(number(&settings, &format!("/settings/{name}")), number(&found, &format!("/{name}")), "{name}");
    }
    // With this skew applied, none remains.
    let again = last(&done(folder.path(), &[&skew[..], &link].concat()));
    assert!(number(&again, "/left_s").abs() < number(&again, "/u95_s"), "{again}");
    let words = done(folder.path(), &["calibrate", "skew", "--duration", "15", "--write", link[0], link[1]]);
    assert!(words.contains("nothing to change: this motion cannot improve on the skew in use"), "{words}");
}

#[test]
fn a_stiffness_is_found_on_a_device_and_kept_there() {
    let folder = tempfile::tempdir().unwrap();
    let mut setup = setup("random");
    setup.settings.terminal_sensor = true;
    setup.settings.stiffness_n_per_m = 0.0;
    let device = device_of(&setup, 10.0);
    let link = ["--connect", device.name()];
    let calibrate = ["calibrate", "stiffness", "--duration", "20", "--json", "--write"];
    let found = last(&done(folder.path(), &[&calibrate[..], &link].concat()));
    assert_eq!(found.get("written").unwrap(), true);
    let number = |of: &serde_json::Value, path: &str| of.pointer(path).unwrap().as_f64().unwrap();
    let error = number(&found, "/stiffness_n_per_m") - Inerter::paper().stiffness_n_per_m;
    assert!(error.abs() < number(&found, "/stiffness_u95_n_per_m"), "{found}");
    let settings = last(&done(folder.path(), &[&["settings", "get", "--json"], &link[..]].concat()));
    for name in ["stiffness_n_per_m", "stiffness_u95_n_per_m", "contact_damping_n_s_per_m"] {
        assert_eq!(number(&settings, &format!("/settings/{name}")), number(&found, &format!("/{name}")), "{name}");
    }
}

#[cfg(unix)]
#[test]
fn a_port_that_vanishes_while_recording_leaves_a_recording() {
    for endpoint in [Endpoint::Pty, any_port()] {
        let folder = tempfile::tempdir().unwrap();
        let device = VirtualDevice::start(&setup("random"), &endpoint, 20.0).unwrap();
        let name = device.name().to_string();
        let flag = if endpoint == Endpoint::Pty { "--port" } else { "--connect" };
        let child = recording(folder.path(), &[flag, &name, "--wait", "0.5"]);
        drop(device);
        let output = child.wait_with_output().unwrap();
        let words = text(&output.stderr);
        assert_eq!(output.status.code(), Some(6), "{words}");
        assert!(words.contains(&format!("{name} went away: the connection was closed; waiting 0.5 s")), "{words}");
        assert!(words.contains("before that can be read in run.mcap"), "{words}");
        assert!(words.contains("plug it in again"), "{words}");
        let output = common::run(folder.path(), &["replay", "run.mcap", "--json"]);
        assert!(last(&text(&output.stdout)).get("samples").unwrap().as_u64().unwrap() > 100);
        assert!(text(&output.stderr).contains("the recording ended early"), "{}", text(&output.stderr));
    }
}

#[test]
fn a_device_that_comes_back_is_recorded_further() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(10.0);
    let name = device.name().to_string();
    let child = recording(folder.path(), &["--connect", &name, "--wait", "20", "--duration", "5"]);
    drop(device);
    let _again = VirtualDevice::start(&setup("random"), &Endpoint::Tcp(name.clone()), 10.0).unwrap();
    let output = child.wait_with_output().unwrap();
    let words = text(&output.stderr);
    assert!(output.status.success(), "{words}");
    assert!(
        words.contains("went away")
            && words.contains(&format!("the device is back at {name}, the recording continues")),
        "{words}"
    );
    let info = last(&done(folder.path(), &["info", "run.mcap", "--json"]));
    // One from each device. A slow device may be asked twice on a busy machine.
    assert!(info.pointer("/records/Hello").unwrap().as_u64().unwrap() >= 2, "{info}");
}

#[cfg(unix)]
#[test]
fn a_port_that_another_program_has_open_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let device = VirtualDevice::start(&setup("random"), &Endpoint::Pty, 20.0).unwrap();
    let mut first = recording(folder.path(), &["--port", device.name()]);
    let words = fails(folder.path(), &["monitor", "--port", device.name()], 5);
    let path = folder.path().join("run.mcap");
    common::until("less than half a second is recorded", || {
        path.metadata().is_ok_and(|metadata| metadata.len() > HEAD + 8_000)
    });
    first.kill().unwrap();
    first.wait().unwrap();
    assert!(words.contains("another program has it open"), "{words}");
    // The first program was killed: everything it had written can be read.
    done(folder.path(), &["replay", "run.mcap", "--json"]);
    // A recording is never replaced without `--force`.
    assert!(fails(folder.path(), &["record", "--port", device.name(), "-o", "run.mcap"], 8).contains("exists already"));
}

#[cfg(unix)]
#[test]
fn an_interrupt_ends_a_recording_in_good_order() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(20.0);
    let child = recording(folder.path(), &["--connect", device.name()]);
    let process = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(process, rustix::process::Signal::INT).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && text(&output.stderr).contains("none lost"), "{}", text(&output.stderr));
    let info = last(&done(folder.path(), &["info", "run.mcap", "--json"]));
    assert_eq!((info.get("ending").unwrap(), info.get("reason").unwrap()), (&"closed".into(), &"finished".into()));
}

#[cfg(unix)]
#[test]
fn a_full_disk_ends_a_recording_with_its_own_code() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(1.0);
    let words = fails(folder.path(), &["record", "--connect", device.name(), "-o", "/dev/full"], 8);
    assert!(words.contains("/dev/full cannot be written") && words.contains("the disk is full"), "{words}");
}

#[cfg(unix)]
#[test]
fn what_was_written_before_the_disk_was_full_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let device = device(20.0);
    // A limit on the file size simulates a full disk. Without its signal, the write fails.
    let script = r#"trap "" XFSZ; ulimit -f 300; exec "$0" record -o run.mcap --connect "$1" --duration 60"#;
    let mut command = std::process::Command::new("bash");
    command.args(["-c", script, env!("CARGO_BIN_EXE_inerter"), device.name()]).current_dir(folder.path());
    let output = command.output().unwrap();
    let words = text(&output.stderr);
    assert_eq!(output.status.code(), Some(8), "{words}");
    assert!(words.contains("run.mcap cannot be written any further, after"), "{words}");
    assert!(words.contains("what was written so far can be read"), "{words}");
    let last = last(&done(folder.path(), &["replay", "run.mcap", "--json"]));
    assert!(last.get("samples").unwrap().as_u64().unwrap() > 1000);
}

/// A device that answers every request with these bytes.
fn fake(answer: Vec<u8>) -> (String, JoinHandle<()>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let serve = move |mut stream: TcpStream| {
        let mut request = [0; 256];
        while stream.read(&mut request).is_ok_and(|count| count > 0) && stream.write_all(&answer).is_ok() {}
    };
    (address, thread::spawn(move || listener.accept().map(|(stream, _)| serve(stream)).unwrap()))
}

#[test]
fn a_device_of_another_wire_version_is_refused_with_the_versions() {
    let folder = tempfile::tempdir().unwrap();
    for command in [&["monitor"][..], &["record", "-o", "run.mcap"]] {
        let (address, server) = fake([frames::foreign_hello(), vec![0]].concat());
        let words = fails(folder.path(), &[command, &["--connect", &address]].concat(), 7);
        assert!(words.contains(&format!("{address} speaks wire version 7; this program speaks 1")), "{words}");
        assert!(words.contains("use a newer `inerter` program: one that speaks wire version 7"), "{words}");
        server.join().unwrap();
    }
    assert!(!folder.path().join("run.mcap").exists(), "nothing to record, no file");
}

#[test]
fn a_device_that_talks_nonsense_counts_as_silent() {
    let folder = tempfile::tempdir().unwrap();
    let (address, server) = fake(b"login: \0\x03abc\0".to_vec());
    let words = fails(folder.path(), &["monitor", "--connect", &address], 6);
    assert!(words.contains("does not answer: no valid message came within 3 s"), "{words}");
    server.join().unwrap();
}

#[cfg(unix)]
#[test]
fn the_simulated_device_says_where_it_is_and_ends_at_an_interrupt() {
    let folder = tempfile::tempdir().unwrap();
    for (flag, key) in [(&["--tcp", "127.0.0.1:0"][..], "address"), (&["--pty"], "port")] {
        let mut child = inerter(folder.path(), &[&["simulate", "--json"], flag].concat()).spawn().unwrap();
        let mut line = String::new();
        std::io::BufRead::read_line(&mut std::io::BufReader::new(child.stdout.take().unwrap()), &mut line).unwrap();
        let ready = last(&line);
        assert_eq!(ready.get("kind").unwrap(), "ready");
        assert!(ready.get(key).unwrap().is_string());
        let process = rustix::process::Pid::from_child(&child);
        rustix::process::kill_process(process, rustix::process::Signal::INT).unwrap();
        assert!(child.wait().unwrap().success());
    }
}
