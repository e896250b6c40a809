//! The program's calibration and its backups, with virtual devices that a simulated person operates.

use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::Stdio,
};

use crate::common::{any_port, done, fails, inerter, last, run, text};
use inerter_data::settings::Overrides;
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Operator, Setup, VirtualDevice, bench_sensors};
use serde_json::Value;

fn device(sensors: Sensors, speed: f64) -> (VirtualDevice, Operator) {
    let setup = Setup::new(Inerter::paper(), sensors, "hold", None, &Overrides::default()).unwrap();
    VirtualDevice::with_operator(&setup, &any_port(), speed).unwrap()
}

fn setting(folder: &Path, device: &VirtualDevice, name: &str) -> f64 {
    let settings = last(&done(folder, &["settings", "get", "--json", "--connect", device.name()]));
    settings.pointer(&format!("/settings/{name}")).and_then(Value::as_f64).unwrap()
}

/// Runs a command that asks questions. Answers each one by calling `answer` and sending an empty line. Returns the exit
/// code, the last line, and standard error.
fn asked(folder: &Path, arguments: &[&str], mut answer: impl FnMut(&str)) -> (Option<i32>, Value, String) {
    let mut child = inerter(folder, arguments).stdin(Stdio::piped()).spawn().unwrap();
    let mut input = child.stdin.take().unwrap();
    let mut found = Value::Null;
    for line in BufReader::new(child.stdout.take().unwrap()).lines() {
        let line: Value = serde_json::from_str(&line.unwrap()).unwrap();
        if line["kind"] == "prompt" {
            answer(line["question"].as_str().unwrap());
            writeln!(input).unwrap();
        } else {
            found = line;
        }
    }
    let output = child.wait_with_output().unwrap();
    (output.status.code(), found, text(&output.stderr))
}

#[test]
fn masses_give_the_force_scale_and_it_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let sensors = Sensors { force_gain: 0.97, force_offset_n: 4.0, ..bench_sensors() };
    let (device, bench) = device(sensors, 10.0);
    let masses = [0, 5, 10, 5, 0, -5, -10, 0].map(|kg| kg.to_string());
    let masses = masses.iter().flat_map(|kg| ["--mass", kg.as_str()]);
    let arguments: Vec<&str> =
        ["calibrate", "force", "--json", "--write", "--gravity", "9.80665", "--connect", device.name()]
            .into_iter()
            .chain(masses)
            .collect();
    let (code, found, words) = asked(folder.path(), &arguments, |question| {
        let kg = match question.split("put ").nth(1) {
            Some(rest) => rest.split_whitespace().next().unwrap().parse().unwrap(),
            None => 0.0,
        };
        let sign = if question.contains("negative") { -1.0 } else { 1.0 };
        bench.obey(&format!("mass {}", sign * kg)).unwrap();
    });
    assert_eq!(code, Some(0), "{words}");
    assert_eq!((&found["kind"], &found["step"]), (&"calibration".into(), &"force".into()));
    assert_eq!((&found["accepted"], &found["written"]), (&true.into(), &true.into()));
    let u95 = found["values"]["force_gain_u95"].as_f64().unwrap();
    let scale = setting(folder.path(), &device, "newtons_per_code");
    assert!((scale / (0.002 / 0.97) - 1.0).abs() <= u95 && u95 < 3e-3, "{found}");
    assert_eq!(setting(folder.path(), &device, "force_gain_u95"), u95);
    assert!((setting(folder.path(), &device, "force_zero_code") - 2000.0).abs() < 60.0);
}

#[test]
fn a_displacement_gives_the_scale_of_the_position_with_its_sign() {
    let folder = tempfile::tempdir().unwrap();
    let (device, bench) = device(bench_sensors(), 10.0);
    let arguments = [
        "calibrate",
        "encoder",
        "--json",
        "--write",
        "--revolutions",
        "5",
        "--lines",
        "1024",
        "--displacement",
        "0",
        "--displacement",
        "-40mm",
        "--displacement",
        "0",
        "--displacement",
        "-40mm",
        "--connect",
        device.name(),
    ];
    let mut place = 0;
    let (code, found, words) = asked(folder.path(), &arguments, |question| match place {
        // The gauge is reversed: its negative direction is forward here.
        _ if question.contains("revolutions") => bench.obey("turn -5").unwrap(),
        _ if question.contains("displacement") => {
            let steps = ["move 0", "move 0.04", "move -0.04", "move 0.04"];
            bench.obey(steps[place]).unwrap();
            place += 1;
        }
        _ => {}
    });
    assert_eq!(code, Some(0), "{words}");
    let u95 = found["values"]["lead_u95"].as_f64().unwrap();
    let scale = setting(folder.path(), &device, "metres_per_count");
    assert!((scale / -2.44140625e-6 - 1.0).abs() <= u95 && u95 < 2e-3, "{found}");
    assert_eq!(found["measured"]["counts_per_revolution"], 4096.0);
    assert_eq!(found["remarks"][0]["code"], "sign");
}

#[test]
fn a_channel_at_rest_is_judged_live_and_from_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let narrow = |pickup_n| Sensors {
        force_min_code: -5e4,
        force_max_code: 5e4,
        pickup_n,
        force_noise_n: 0.1,
        ..bench_sensors()
    };
    let (good, _) = device(narrow(0.0), 1.0);
    let found =
        last(&done(folder.path(), &["calibrate", "load-cell", "--duration", "4", "--json", "--connect", good.name()]));
    assert_eq!(found["accepted"], true, "{found}");
    let rate = found["measured"]["sample_rate_hz"].as_f64().unwrap();
    assert!((rate - 1000.0).abs() < 2.0, "{found}");
    assert!((found["measured"]["noise_n"].as_f64().unwrap() - 0.1).abs() < 0.01, "{found}");
    let (bad, _) = device(narrow(30.0), 1.0);
    let output = run(folder.path(), &["calibrate", "load-cell", "--duration", "4", "--connect", bad.name()]);
    assert_eq!(output.status.code(), Some(9));
    let (said, words) = (text(&output.stdout), text(&output.stderr));
    assert!(
        said.contains("bad: mains pickup is") && said.contains("screen") && words.contains("1 problem found"),
        "{said}{words}"
    );

    let simulate =
        ["simulate", "-o", "rest.mcap", "--excite", "hold", "--duration", "6", "--load", "12", "--pickup-n", "3"];
    done(folder.path(), &simulate);
    let found = last(&done(folder.path(), &["calibrate", "load-cell", "rest.mcap", "--json"]));
    assert!((found["measured"]["mains_n"].as_f64().unwrap() - 3.0).abs() < 0.2, "{found}");
    let found = last(&done(folder.path(), &["calibrate", "zero", "rest.mcap", "--json"]));
    assert!((found["values"]["force_zero_code"].as_f64().unwrap() - 6000.0).abs() < 60.0, "{found}");
    assert_eq!(found["written"], false);
}

#[test]
fn recordings_of_loads_and_of_a_motion_need_no_device() {
    let folder = tempfile::tempdir().unwrap();
    let mut arguments = vec!["calibrate".to_string(), "force".into(), "--json".into()];
    for (place, newtons) in [0.0, 50.0, 100.0, 0.0, -50.0, 0.0].into_iter().enumerate() {
        let (file, load) = (format!("{place}.mcap"), format!("{newtons}"));
        let simulate =
            ["simulate", "-o", &file, "--force", "--excite", "hold", "--duration", "4", "--force-gain", "1.05"];
        done(folder.path(), &[&simulate[..], &["--load", &load]].concat());
        arguments.extend(["--force".into(), format!("{newtons}={file}")]);
    }
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let found = last(&done(folder.path(), &arguments));
    let scale = found["values"]["newtons_per_code"].as_f64().unwrap();
    assert!((scale / (0.002 / 1.05) - 1.0).abs() <= found["values"]["force_gain_u95"].as_f64().unwrap(), "{found}");
    let words = fails(folder.path(), &["calibrate", "force", "--force", "0=0.mcap", "--force", "50"], 2);
    assert!(words.contains("a recording of each load"), "{words}");

    done(folder.path(), &["simulate", "-o", "run.mcap", "--duration", "6"]);
    let found = last(&done(folder.path(), &["calibrate", "direction", "run.mcap", "--json"]));
    assert_eq!(found["values"], serde_json::json!({}), "{found}");
    let turned = ["calibrate", "direction", "run.mcap", "--json", "--set", "newtons_per_code=-0.002"];
    let found = last(&done(folder.path(), &turned));
    assert_eq!(found["values"]["newtons_per_code"], 0.002, "{found}");
    let words = fails(folder.path(), &["calibrate", "direction", "0.mcap"], 9);
    assert!(words.contains("cannot identify the inertance"), "{words}");
}

#[test]
fn the_clock_of_a_device_is_compared_and_nothing_better_than_the_hosts_is_claimed() {
    let folder = tempfile::tempdir().unwrap();
    // Slow by 5 %, which no crystal is.
    let (slow, _) = device(bench_sensors(), 0.95);
    let output = run(folder.path(), &["calibrate", "timebase", "--duration", "4", "--json", "--connect", slow.name()]);
    assert_eq!(output.status.code(), Some(9));
    let found = last(&text(&output.stdout));
    let figure = |name: &str| found["measured"][name].as_f64().unwrap();
    // Twice the interval: by chance, one measurement in twenty lies outside of it.
    assert!((figure("deviation_ppm") + 5e4).abs() <= 2.0 * figure("deviation_u95_ppm"), "{found}");
    assert_eq!(found["remarks"][0]["code"], "odd_rate", "{found}");
    let (right, _) = device(bench_sensors(), 1.0);
    let found =
        last(&done(folder.path(), &["calibrate", "timebase", "--duration", "6", "--json", "--connect", right.name()]));
    let [deviation, u95] = ["deviation_ppm", "deviation_u95_ppm"].map(|name| found["measured"][name].as_f64().unwrap());
    assert!(deviation.abs() <= 2.0 * u95 && u95 >= 50.0, "{found}");
    assert_eq!(found["values"], serde_json::json!({}));
}

#[test]
fn settings_are_backed_up_compared_and_restored() {
    let folder = tempfile::tempdir().unwrap();
    let (one, _) = device(bench_sensors(), 10.0);
    let link = ["--connect", one.name()];
    let with = |arguments: &[&'static str]| -> Vec<String> {
        arguments.iter().chain(&link).map(|text| text.to_string()).collect()
    };
    let go = |arguments: &[&'static str]| {
        let arguments = with(arguments);
        done(folder.path(), &arguments.iter().map(String::as_str).collect::<Vec<_>>())
    };
    go(&["settings", "backup", "a.toml"]);
    let again = with(&["settings", "backup", "a.toml"]);
    let again: Vec<&str> = again.iter().map(String::as_str).collect();
    assert!(fails(folder.path(), &again, 8).contains("exists already"));
    go(&["settings", "set", "memory_s=12", "skew_s=2e-5"]);
    let found = last(&go(&["settings", "diff", "a.toml", "device", "--json"]));
    assert_eq!(found["differences"]["memory_s"], serde_json::json!({ "a": 30.0, "b": 12.0 }));
    assert_eq!(found["differences"].as_object().unwrap().len(), 2);
    let said = go(&["settings", "restore", "a.toml", "--save"]);
    assert!(said.contains("memory_s = 30.0   # was 12.0") && said.contains("skew_s = 0.0"), "{said}");
    assert_eq!(go(&["settings", "diff", "device", "a.toml"]), "");

    // The saved settings need not be those in use.
    go(&["settings", "set", "memory_s=12", "--save"]);
    go(&["settings", "set", "memory_s=14"]);
    let kept = last(&go(&["settings", "backup", "kept.toml", "--saved", "--json"]));
    assert_eq!(kept["saved"], serde_json::json!(true));
    let found = last(&go(&["settings", "diff", "kept.toml", "device", "--json"]));
    assert_eq!(found["differences"], serde_json::json!({ "memory_s": { "a": 12.0, "b": 14.0 } }));
    assert_eq!(setting(folder.path(), &one, "memory_s"), 14.0, "a look puts nothing in use");

    // Another device, and a file without an owner.
    let (other, _) = device(Sensors { seed: 9, ..bench_sensors() }, 10.0);
    let words = fails(folder.path(), &["settings", "backup", "none.toml", "--saved", "--connect", other.name()], 6);
    assert!(words.contains("has saved no settings") && !folder.path().join("none.toml").exists(), "{words}");
    let restore = ["settings", "restore", "a.toml", "--connect", other.name()];
    let words = fails(folder.path(), &restore, 4);
    assert!(
        words.contains("belongs to another device: virtual, serial SIM-1; this one is virtual, serial SIM-9"),
        "{words}"
    );
    done(folder.path(), &[&restore[..], &["--force"]].concat());
    std::fs::write(folder.path().join("b.toml"), "memory_s = 5\n").unwrap();
    assert!(
        fails(folder.path(), &["settings", "restore", "b.toml", "--connect", other.name()], 4)
            .contains("to which device")
    );
    std::fs::write(folder.path().join("c.toml"), "memory_s = 5000\n").unwrap();
    assert!(fails(folder.path(), &["settings", "restore", "c.toml", "--connect", other.name()], 4).contains("line 1"));
    done(folder.path(), &["simulate", "-o", "run.mcap", "--excite", "hold", "--duration", "1", "--set", "memory_s=7"]);
    let said = done(folder.path(), &["settings", "diff", "b.toml", "run.mcap"]);
    assert!(said.contains("memory_s                         5.0 -> 7.0") && said.contains("(not given)"), "{said}");
}

#[test]
fn without_a_terminal_the_wizard_says_so_and_a_script_that_ends_early_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (device, _) = device(bench_sensors(), 10.0);
    let words = fails(folder.path(), &["calibrate", "--connect", device.name()], 2);
    assert!(words.contains("this is not a terminal"), "{words}");
    let force =
        ["calibrate", "force", "--mass", "0", "--mass", "5", "--mass", "0", "--write", "--connect", device.name()];
    let words = fails(folder.path(), &force, 2);
    assert!(words.contains("no answer: standard input ended"), "{words}");
    assert_eq!(setting(folder.path(), &device, "newtons_per_code"), 0.002);
}

#[test]
fn a_force_that_wanders_is_refused_and_hands_do_what_standard_input_says() {
    let folder = tempfile::tempdir().unwrap();
    let (drifting, _) = device(Sensors { force_drift_n_per_s: 1.0, ..bench_sensors() }, 20.0);
    let words = fails(folder.path(), &["calibrate", "zero", "--write", "--connect", drifting.name()], 9);
    assert!(words.contains("does not settle: it varies by"), "{words}");
    assert_eq!(setting(folder.path(), &drifting, "force_zero_code"), 0.0);

    let simulate =
        ["simulate", "--tcp", "127.0.0.1:0", "--excite", "hold", "--bench", "--load", "3", "--json", "--speed", "10"];
    let mut child = inerter(folder.path(), &simulate).stdin(Stdio::piped()).spawn().unwrap();
    let mut ready = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut ready).unwrap();
    let address = last(&ready)["address"].as_str().unwrap().to_string();
    let mut hands = child.stdin.take().unwrap();
    let zero = || {
        let found = last(&done(folder.path(), &["calibrate", "zero", "--json", "--connect", &address]));
        found["measured"]["mean_code"].as_f64().unwrap()
    };
    assert!((zero() - 1500.0).abs() < 60.0);
    writeln!(hands, "lift 3\nload -7").unwrap();
    let mut notes = BufReader::new(child.stderr.take().unwrap());
    let mut note = String::new();
    notes.read_line(&mut note).unwrap();
    assert!(note.contains("unknown bench command `lift 3`; write `load NEWTONS`"), "{note}");
    assert!((zero() + 3500.0).abs() < 60.0);
    child.kill().unwrap();
    child.wait().unwrap();
}
