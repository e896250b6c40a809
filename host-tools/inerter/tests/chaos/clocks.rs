//! The computer's clock is set forwards and backwards while the program runs.
//!
//! Only what tells the date is set (`CLOCK_REALTIME`), not what counts the time (`CLOCK_MONOTONIC`). A recording takes
//! the date once, when it begins, and counts from there. So the time between its frames must be right in spite of
//! steps: it must agree with the device's samples, and fit into the time that the command ran, by this test's own
//! clock.

use std::{
    process::Command,
    thread,
    time::{Duration, Instant},
};

use inerter_data::recording::{Item, read};
use inerter_wire::{Frame, Record};
use rustix::process::{Pid, Signal, kill_process};

use crate::{
    common::{inerter, last, run, text, unruly::ended},
    cycles::Simulated,
    scenario::Scenario,
};

/// Allowed disagreement between times and samples \[s\]: less than any step (7 s and more), as much as a virtual device
/// on a busy machine may be late before it falls behind.
const APART_S: f64 = 1.0;

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
    // Returns how long it took.
    let must_do = |command: &[&str]| {
        let started = Instant::now();
        let output = stepping(&[command, &link].concat()).output().unwrap();
        assert!(output.status.success(), "{command:?}: {}{}", text(&output.stdout), text(&output.stderr));
        started.elapsed().as_secs_f64()
    };
    let took_s = thread::scope(|scope| {
        let running = commands.map(|command| scope.spawn(move || must_do(command)));
        running.map(|one| one.join().unwrap())
    });
    // The program controls the device alone.
    must_do(&["calibrate", "timebase", "--duration", "3"]);
    let mut worst_s = 0.0_f64;
    for (name, took_s) in ["record.mcap", "plain.mcap", "json.mcap"].into_iter().zip(took_s) {
        let mut times = Vec::new();
        // Of each batch of samples: its arrival, and the number of its last sample.
        let mut batches = Vec::new();
        read(&folder.join(name), |incoming| {
            let Item::Frame(frame) = &incoming.item else { return };
            times.push(incoming.time_ns);
            if let Frame::Message { message: Record::Samples(batch), .. } = frame {
                batches.extend(batch.iter().last().map(|sample| (incoming.time_ns, sample.unwrap().index)));
            }
        })
        .unwrap();
        let longest_ns =
            times.windows(2).map(|pair| pair[1].checked_sub(pair[0]).expect("time goes back")).max().unwrap();
        assert!(longest_ns < 2_000_000_000, "{name}: {longest_ns} ns without a frame");
        let info = last(&text(&run(folder, &["info", name, "--json"]).stdout));
        let (samples, rate_hz) = (info["samples"].as_f64().unwrap(), info["sample_rate_hz"].as_f64().unwrap());
        assert_eq!((&info["lost_samples"], &info["lost_frames"]), (&0.into(), &0.into()), "{name}: {info}");
        let span_s = (times[times.len() - 1] - times[0]) as f64 * 1e-9;
        assert!(span_s > 6.0 && span_s <= took_s, "{name}: {span_s} s in a command of {took_s} s");
        // How late each batch is, after the first one.
        let (first_ns, first) = batches[0];
        let late_s = batches.iter().map(|(time_ns, index)| {
            (time_ns - first_ns) as f64 * 1e-9 - f64::from(index.wrapping_sub(first)) / rate_hz
        });
        let (least_s, most_s) =
            late_s.fold((0.0_f64, 0.0_f64), |(least_s, most_s), late_s| (least_s.min(late_s), most_s.max(late_s)));
        let error_s = (samples / rate_hz - span_s).abs().max(most_s - least_s);
        assert!(error_s < APART_S, "{name}: {error_s} s apart: {span_s} s, {samples} samples");
        worst_s = worst_s.max(error_s);
    }
    assert!(device.child.try_wait().unwrap().is_none(), "the device has ended");
    kill_process(Pid::from_child(&device.child), Signal::TERM).unwrap();
    assert!(ended(&mut device.child, Duration::from_secs(5)).is_some(), "the device goes on after a signal");
    scenario.passed(&format!(
        "a clock step of up to 12 days every 200 ms: {} commands and the device kept running; \
         times and samples differ by at most {worst_s:.2} s",
        commands.len() + 1
    ));
}
