//! The program is killed at a random moment, without a chance to clean up.

use std::{
    path::Path,
    sync::{
        Mutex,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
    thread,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use inerter_data::recording::{Ending, Item, RecordingError, read};
use serde_json::Value;

use crate::{
    common::{
        done, inerter, last,
        stores::{kill_additions, recordings},
    },
    scenario::{Scenario, device, each},
    writers::{WRITERS, Writer, each_of, names},
};

/// No incomplete file has a final name, and an earlier file of that name is intact.
#[test]
#[ignore = "cargo xtask chaos"]
fn kills() {
    let mut scenario = Scenario::start(2400);
    let kills = scenario.kills();
    kill_writers(scenario, kills, |writer| writer.cost == 1);
}

/// The same for slow writers, each a fifth as often.
#[test]
#[ignore = "cargo xtask chaos"]
fn slow_kills() {
    let mut scenario = Scenario::start(2400);
    let kills = scenario.kills().div_ceil(5);
    kill_writers(scenario, kills, |writer| writer.cost > 1);
}

fn kill_writers(scenario: Scenario, kills: u64, chosen: fn(&Writer) -> bool) {
    let device = device();
    let (count, whole, early) = (AtomicU64::new(0), AtomicUsize::new(0), AtomicUsize::new(0));
    let writers: Vec<&Writer> = WRITERS.iter().filter(|writer| chosen(writer)).collect();
    each_of(&writers, device.name(), |writer, folder, result| {
        let before = names(folder);
        let mut random = scenario.random(&writer.command.join(" "));
        for kill in 0..kills {
            let was_there = kill % 2 == 1;
            if was_there {
                result.earlier(folder);
            }
            let more: &[&str] = if was_there { &["--force"] } else { &[] };
            let mut child = writer.run(folder, device.name(), more).spawn().unwrap();
            // In half of the runs, wait until something is written: the moments at which files are renamed are short.
            if kill % 4 >= 2 {
                let (started, there) = (Instant::now(), before.len() + if was_there { result.files.len() } else { 0 });
                while names(folder).len() <= there
                    && child.try_wait().unwrap().is_none()
                    && started.elapsed() < Duration::from_secs(60)
                {
                    thread::sleep(Duration::from_micros(300));
                }
                thread::sleep(result.took.mul_f64(random.below(300) as f64 * 1e-3));
            } else {
                thread::sleep(result.took.mul_f64(random.below(1200) as f64 * 1e-3));
            }
            early.fetch_add(usize::from(child.try_wait().unwrap().is_none()), Ordering::Relaxed);
            child.kill().unwrap();
            child.wait().unwrap();
            let what = format!("{:?}, kill {kill}", writer.command);
            whole.fetch_add(result.check(folder, &before, was_there, true, &what), Ordering::Relaxed);
            count.fetch_add(1, Ordering::Relaxed);
        }
    });
    let (count, early) = (count.into_inner(), early.into_inner());
    assert!(early as u64 > count / 3, "only {early} of {count} were killed before they ended");
    scenario.passed(&format!(
        "{count} kills of {} writers, {early} before the program ended; \
         no incomplete file, {} complete ones, no earlier file lost",
        writers.len(),
        whole.into_inner()
    ));
}

/// A killed recording loses at most one second, and can be opened.
#[test]
#[ignore = "cargo xtask chaos"]
fn killed_recordings() {
    let mut scenario = Scenario::start(900);
    let kills = scenario.kills();
    let device = device();
    let commands = [&["record", "-o"][..], &["monitor", "--plain", "--record"]];
    let all: Vec<_> = commands.iter().flat_map(|command| (0..kills).map(move |kill| (*command, kill))).collect();
    let (lost, empty) = (Mutex::new(Vec::new()), AtomicUsize::new(0));
    each(&all, 8, |(command, kill)| {
        let folder = tempfile::tempdir().unwrap();
        let what = format!("{command:?}, kill {kill}");
        let mut random = scenario.random(&what);
        let file = folder.path().join("run.mcap");
        let mut child =
            inerter(folder.path(), &[command, &["run.mcap", "--connect", device.name()][..]].concat()).spawn().unwrap();
        // The pipe must not fill up.
        let mut words = child.stdout.take().unwrap();
        let reader = thread::spawn(move || std::io::copy(&mut words, &mut std::io::sink()));
        let started = Instant::now();
        while !file.exists() {
            assert!(started.elapsed() < Duration::from_secs(30), "{what}: nothing is recorded");
            thread::sleep(Duration::from_millis(1));
        }
        let there = Instant::now();
        thread::sleep(Duration::from_millis(random.below(4000)));
        let (killed_ns, recorded) = (now_ns(), there.elapsed());
        child.kill().unwrap();
        child.wait().unwrap();
        reader.join().unwrap().unwrap();
        match judged(folder.path(), killed_ns, &what) {
            Some((lost_s, info)) => {
                assert!(lost_s < 1.0, "{what}: {lost_s} s are lost");
                assert!(info["settings"].is_object() && info["device"].is_object(), "{what}: {info}");
                assert_eq!((&info["lost_samples"], &info["discontinuities"]), (&0.into(), &0.into()), "{what}");
                lost.lock().unwrap().push(lost_s);
                if kill % 5 == 0 && info["samples"].as_u64() > Some(0) {
                    done(folder.path(), &["replay", "run.mcap", "--json"]);
                }
            }
            None => {
                // Nothing has reached the disk yet.
                assert!(recorded < Duration::from_secs(2), "{what}: no frame after {recorded:?}");
                empty.fetch_add(1, Ordering::Relaxed);
            }
        }
    });
    let (lost, empty) = (lost.into_inner().unwrap(), empty.into_inner());
    assert!(lost.len() > all.len() / 2, "only {} of {} recordings hold anything", lost.len(), all.len());
    scenario.passed(&format!(
        "{} kills of `record` and `monitor --record`; at most {:.2} s lost, \
         all files with frames can be opened ({empty} killed before the first frame)",
        all.len(),
        lost.iter().copied().fold(0.0, f64::max)
    ));
}

fn now_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as u64
}

/// The channel of the frames is within this many bytes from the beginning of a recording.
const CHANNEL_WITHIN: u64 = 1024;

/// Seconds between the last frame and the kill, and the output of `info`; `None` if there is no frame: the file is
/// empty, ends before its channel of frames, or has no frame in it. A file that cannot be read otherwise is a fault.
fn judged(folder: &Path, killed_ns: u64, what: &str) -> Option<(f64, Value)> {
    let file = folder.join("run.mcap");
    let length = file.metadata().unwrap().len();
    let mut last_ns = None;
    let contents = read(&file, |incoming| {
        if matches!(incoming.item, Item::Frame(_)) {
            last_ns = Some(incoming.time_ns);
        }
    });
    match contents {
        // Nothing of a file that was cut off is damaged.
        Ok(contents) => assert_eq!(contents.ending, Ending::CutOff, "{what}: {length} bytes"),
        Err(RecordingError::NoChannel { .. }) if length < CHANNEL_WITHIN => {}
        Err(error) => assert_eq!(length, 0, "{what}: {length} bytes: {error}"),
    }
    let last_ns = last_ns?;
    let info = last(&done(folder, &["info", "run.mcap", "--json"]));
    Some((killed_ns.saturating_sub(last_ns) as f64 * 1e-9, info))
}

/// A killed `store add` leaves the whole run in the store, or none of it.
#[test]
#[ignore = "cargo xtask chaos"]
fn killed_stores() {
    let mut scenario = Scenario::start(600);
    let kills = scenario.kills();
    let unfinished = AtomicU64::new(0);
    const PARTS: u64 = 4;
    each(&Vec::from_iter(0..PARTS), PARTS as usize, |part| {
        let folder = recordings();
        let mut random = scenario.random(&format!("store {part}"));
        let share = kills / PARTS + u64::from(*part < kills % PARTS);
        unfinished.fetch_add(kill_additions(folder.path(), share, &mut random), Ordering::Relaxed);
    });
    let unfinished = unfinished.into_inner();
    assert!(unfinished > 0, "no kill left anything unfinished");
    scenario.passed(&format!("{kills} kills of `store add`, {unfinished} left unfinished files; no incomplete run"));
}

/// A killed command has written all of its settings to the device, or none.
#[test]
#[ignore = "cargo xtask chaos"]
fn killed_settings() {
    let mut scenario = Scenario::start(600);
    let kills = scenario.kills();
    let device = device();
    let folder = tempfile::tempdir().unwrap();
    let link = ["--connect", device.name()];
    let command = |value: u64| {
        let (memory, rate) = (format!("memory_s={}", 10 + value), format!("publish_rate_hz={}", 1 + value));
        ["settings", "set", &memory, &rate, link[0], link[1]].map(str::to_string)
    };
    let start = |value: u64| inerter(folder.path(), &command(value).each_ref().map(String::as_str)).spawn().unwrap();
    let begun = Instant::now();
    assert!(start(0).wait().unwrap().success());
    let longest = begun.elapsed().as_millis() as u64 * 5 / 4 + 2;
    let mut random = scenario.random("settings");
    let mut written = 0;
    for kill in 0..kills {
        let wanted = 1 + kill % 4;
        let mut child = start(wanted);
        thread::sleep(Duration::from_millis(random.below(longest)));
        child.kill().unwrap();
        child.wait().unwrap();
        let settings = last(&done(folder.path(), &["settings", "get", "--json", link[0], link[1]]));
        let value = |name: &str| settings["settings"][name].as_f64().unwrap();
        assert_eq!(value("memory_s") - 10.0, value("publish_rate_hz") - 1.0, "kill {kill}: half of the settings");
        written += usize::from(value("memory_s") == (10 + wanted) as f64);
    }
    assert!(written > 0, "every kill came before the write");
    scenario.passed(&format!(
        "{kills} kills of `settings set`; {written} times both settings were new, otherwise both were old"
    ));
}
