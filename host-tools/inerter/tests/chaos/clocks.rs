//! The computer's clock is set forwards and backwards while the program runs.

use std::{process::Command, thread, time::Duration};

use inerter_data::recording::{Item, read};
use rustix::process::{Pid, Signal, kill_process};

use crate::{
    common::{inerter, last, run, text, unruly::ended},
    cycles::Simulated,
    scenario::Scenario,
};

/// The times in recordings increase at the right rate, and nothing ends or hangs.
#[test]
#[ignore = "cargo xtask chaos"]
fn clock_steps() {
    let scenario = Scenario::start(120);
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/common/clock.c");
    let built =
        Command::new("cc").args(["-shared", "-fPIC", "-o", "clock.so", source, "-ldl"]).current_dir(folder).status();
    if inerter_needs::or_skip(built.map_err(|error| format!("a C compiler is needed: cc: {error}"))).is_none() {
        return scenario.skipped("no C compiler");
    }
    let stepping = |arguments: &[&str]| {
        let mut command = inerter(folder, arguments);
        command.env("LD_PRELOAD", folder.join("clock.so"));
        command
    };
    // Check that the library works: successive times printed by `date` must differ widely.
    let mut date = Command::new("sh");
    date.args(["-c", "for i in 1 2 3 4 5; do date +%s; sleep 0.2; done"]).env("LD_PRELOAD", folder.join("clock.so"));
    let seconds: Vec<i64> = text(&date.output().unwrap().stdout).lines().map(|line| line.parse().unwrap()).collect();
    let widest = seconds.windows(2).map(|pair| (pair[1] - pair[0]).abs()).max().unwrap();
    assert!(widest > 60, "the clock is not set: {seconds:?}");

    let mut device = Simulated::start(stepping(&["simulate", "--tcp", "127.0.0.1:0", "--json"]));
    let link = ["--connect", device.address.as_str()];
    let commands: [&[&str]; 4] = [
        &["record", "-o", "record.mcap", "--duration", "8"],
        &["monitor", "--plain", "--record", "plain.mcap", "--duration", "8", "--web", "--share", "127.0.0.1:0"],
        &["monitor", "--json", "--record", "json.mcap", "--duration", "8"],
        &["settings", "backup", "board.toml"],
    ];
    let must_do = |command: &[&str]| {
        let output = stepping(&[command, &link].concat()).output().unwrap();
        assert!(output.status.success(), "{command:?}: {}{}", text(&output.stdout), text(&output.stderr));
    };
    thread::scope(|scope| {
        for command in commands {
            scope.spawn(|| must_do(command));
        }
    });
    // The program controls the device alone.
    must_do(&["calibrate", "timebase", "--duration", "3"]);
    let mut worst_s = 0.0_f64;
    for name in ["record.mcap", "plain.mcap", "json.mcap"] {
        let mut times = Vec::new();
        read(&folder.join(name), |incoming| {
            if matches!(incoming.item, Item::Frame(_)) {
                times.push(incoming.time_ns);
            }
        })
        .unwrap();
        let longest_ns =
            times.windows(2).map(|pair| pair[1].checked_sub(pair[0]).expect("time goes back")).max().unwrap();
        assert!(longest_ns < 2_000_000_000, "{name}: {longest_ns} ns without a frame");
        let info = last(&text(&run(folder, &["info", name, "--json"]).stdout));
        let (samples, duration_s) = (info["samples"].as_f64().unwrap(), info["duration_s"].as_f64().unwrap());
        assert_eq!((&info["lost_samples"], &info["lost_frames"]), (&0.into(), &0.into()), "{name}: {info}");
        let error_s = (samples / info["sample_rate_hz"].as_f64().unwrap() - duration_s).abs();
        assert!((6.0..10.0).contains(&duration_s) && error_s < 1.0, "{name}: {duration_s} s, {samples} samples");
        worst_s = worst_s.max(error_s);
    }
    assert!(device.child.try_wait().unwrap().is_none(), "the device has ended");
    kill_process(Pid::from_child(&device.child), Signal::TERM).unwrap();
    assert!(ended(&mut device.child, Duration::from_secs(5)).is_some(), "the device goes on after a signal");
    scenario.passed(&format!(
        "a step every 200 ms, of up to 12 days: {} commands and the device went on; times and samples differ by {worst_s:.2} s at most",
        commands.len() + 1
    ));
}
