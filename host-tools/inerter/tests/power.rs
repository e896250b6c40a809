//! The computer loses power: data that was never synchronised to the disk is lost.
//!
//! A library preloaded into the program (`common/kept.c`) copies each file whenever the program synchronises it, and
//! likewise the names in each folder. A power failure leaves the last of these copies.

use std::{
    fs,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    process::Command,
    thread,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use crate::common::{device, done, inerter, last, text, until};
use inerter_data::recording::{Item, read};

/// A folder for the program, a folder for the copies, and the library.
struct Desk {
    folder: tempfile::TempDir,
}

impl Desk {
    fn new() -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        for name in ["here", "kept"] {
            fs::create_dir(folder.path().join(name)).unwrap();
        }
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/common/kept.c");
        let mut compiler = Command::new("cc");
        let built = compiler.args(["-shared", "-fPIC", "-pthread", "-o", "kept.so", source]).current_dir(folder.path());
        let found = built.status().map_err(|error| format!("a C compiler is needed: cc: {error}"));
        let built = inerter_needs::or_skip(found)?;
        assert!(built.success());
        Some(Self { folder })
    }

    fn here(&self) -> PathBuf {
        self.folder.path().join("here")
    }

    fn kept(&self) -> PathBuf {
        self.folder.path().join("kept")
    }

    /// The program, with copies of its files.
    fn inerter(&self, arguments: &[&str]) -> Command {
        let mut command = inerter(&self.here(), arguments);
        command.env("LD_PRELOAD", self.folder.path().join("kept.so")).env("KEPT", self.kept());
        command
    }

    /// The copies with this ending, in order.
    fn all_kept(&self, ending: &str) -> Vec<PathBuf> {
        let mut all: Vec<PathBuf> = fs::read_dir(self.kept()).unwrap().map(|entry| entry.unwrap().path()).collect();
        all.retain(|path| path.extension().is_some_and(|extension| extension == ending));
        all.sort();
        all
    }

    /// The states of this file on the disk; the power may fail after any of them. The file's name must be on the disk
    /// by the first of them.
    fn states(&self, name: &str) -> Vec<PathBuf> {
        let inode = self.here().join(name).metadata().unwrap().ino();
        let states = self.all_kept(&inode.to_string());
        if !states.is_empty() {
            let names = self.all_kept("names").pop().expect("the folder is never synchronised");
            let line = format!("{inode} {name}");
            assert!(
                fs::read_to_string(&names).unwrap().lines().any(|found| found == line),
                "{name} has no name on the disk"
            );
        }
        states
    }

    /// Deletes the copies.
    fn forget(&self) {
        for kept in fs::read_dir(self.kept()).unwrap() {
            fs::remove_file(kept.unwrap().path()).unwrap();
        }
    }
}

/// Host time of each frame \[ns\].
fn times(path: &Path) -> Vec<u64> {
    let mut times = Vec::new();
    read(path, |incoming| {
        if matches!(incoming.item, Item::Frame(_)) {
            times.push(incoming.time_ns);
        }
    })
    .unwrap();
    times
}

#[test]
fn a_power_cut_costs_a_recording_a_second_at_most() {
    let Some(desk) = Desk::new() else { return };
    let device = device(1.0);
    for command in [&["record", "-o"][..], &["monitor", "--plain", "--record"]] {
        let file = desk.here().join("run.mcap");
        let arguments = ["run.mcap", "--force", "--connect", device.name()];
        let mut child = desk.inerter(&[command, &arguments].concat()).spawn().unwrap();
        let mut states = Vec::new();
        until("nothing is brought onto the disk", || {
            if file.exists() {
                states = desk.states("run.mcap");
            }
            states.len() >= 7
        });
        child.kill().unwrap();
        child.wait().unwrap();
        // Everything handed to the operating system, synchronised or not.
        let written = times(&file);
        let counts: Vec<usize> = states.iter().map(|state| times(state).len()).collect();
        let mut all_s = 0.0;
        for pair in counts.windows(2) {
            let &[before, after] = pair else { panic!() };
            if after > before {
                // The power fails just before the second state reaches the disk.
                let lost_s = (written[after - 1] - written[before]) as f64 * 1e-9;
                assert!(lost_s < 1.0, "{lost_s} s, {counts:?}");
                all_s += lost_s;
            }
        }
        assert!(all_s > 1.0, "{all_s} s, {counts:?}");
        let left = states.last().unwrap();
        fs::rename(left, desk.here().join("left.mcap")).unwrap();
        let info = last(&done(&desk.here(), &["info", "left.mcap", "--json"]));
        assert_eq!(info["ending"], "cut_off");
        assert!(info["samples"].as_u64().unwrap() > 1000 && info["settings"].is_object(), "{info}");
        fs::remove_file(file).unwrap();
        desk.forget();
    }
}

#[test]
fn a_disk_that_takes_its_time_does_not_hold_up_the_device() {
    let Some(desk) = Desk::new() else { return };
    let device = device(1.0);
    let stuck = desk.kept().join("stuck");
    fs::write(&stuck, "").unwrap();
    let child =
        desk.inerter(&["record", "-o", "run.mcap", "--connect", device.name(), "--duration", "4"]).spawn().unwrap();
    until("nothing is recorded", || desk.here().join("run.mcap").exists());
    thread::sleep(Duration::from_secs(3));
    fs::remove_file(&stuck).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && text(&output.stderr).contains("none lost"), "{}", text(&output.stderr));
    let times = times(&desk.here().join("run.mcap"));
    let longest_ns = times.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
    assert!(longest_ns < 1_500_000_000, "{longest_ns} ns without a frame");
    // Everything is on the disk when the program ends.
    let states = desk.states("run.mcap");
    assert_eq!(fs::read(states.last().unwrap()).unwrap(), fs::read(desk.here().join("run.mcap")).unwrap());
}

/// What is written survives the program, synchronised or not.
#[test]
fn a_kill_costs_a_second_at_most_while_the_disk_takes_its_time() {
    let Some(desk) = Desk::new() else { return };
    let device = device(1.0);
    fs::write(desk.kept().join("stuck"), "").unwrap();
    let file = desk.here().join("run.mcap");
    let mut child = desk.inerter(&["record", "-o", "run.mcap", "--connect", device.name()]).spawn().unwrap();
    until("nothing is recorded", || file.exists());
    thread::sleep(Duration::from_secs(3));
    let killed = SystemTime::now();
    child.kill().unwrap();
    child.wait().unwrap();
    let last = UNIX_EPOCH + Duration::from_nanos(times(&file).pop().unwrap());
    assert!(
        killed.duration_since(last).unwrap() < Duration::from_secs(1),
        "recorded until {last:?}, killed at {killed:?}"
    );
    assert!(desk.states("run.mcap").is_empty(), "the disk took its time");
}

#[test]
fn what_takes_its_name_at_the_end_is_on_the_disk_by_then() {
    let Some(desk) = Desk::new() else { return };
    let device = device(1.0);
    let link = ["--connect", device.name()];
    let commands: [(&str, &[&str]); 5] = [
        ("run.mcap", &["simulate", "--duration", "2", "-o", "run.mcap"]),
        ("cut.mcap", &["cut", "run.mcap", "-o", "cut.mcap"]),
        ("run.parquet", &["export", "run.mcap", "--parquet", "run.parquet"]),
        ("loop.png", &["plot", "run.mcap", "--figure", "loop", "-o", "loop.png"]),
        ("board.toml", &["settings", "backup", "board.toml", link[0], link[1]]),
    ];
    for (name, arguments) in commands {
        let output = desk.inerter(arguments).output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        let states = desk.states(name);
        assert!(fs::read(states.last().unwrap()).unwrap() == fs::read(desk.here().join(name)).unwrap(), "{name}");
        desk.forget();
    }
}

/// The disk is slow to synchronise the complete file, and the user ends the program.
#[test]
fn what_is_ended_before_it_has_its_name_leaves_nothing_behind() {
    use rustix::process::{Pid, Signal, kill_process};
    let Some(desk) = Desk::new() else { return };
    let device = device(1.0);
    done(&desk.here(), &["simulate", "--duration", "2", "-o", "run.mcap"]);
    done(&desk.here(), &["cut", "run.mcap", "--to", "1", "-o", "first.mcap"]);
    done(&desk.here(), &["cut", "run.mcap", "--from", "1", "-o", "second.mcap"]);
    let names = || {
        let mut names: Vec<_> = fs::read_dir(desk.here()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = names();
    fs::write(desk.kept().join("stuck"), "").unwrap();
    let commands: [&[&str]; 5] = [
        &["settings", "backup", "board.toml", "--connect", device.name()],
        &["cut", "run.mcap", "-o", "cut.mcap"],
        &["merge", "first.mcap", "second.mcap", "-o", "both.mcap"],
        &["plot", "run.mcap", "--figure", "loop", "-o", "loop.png"],
        &["report", "run.mcap", "-o", "page.html"],
    ];
    for command in commands {
        let mut child = desk.inerter(command).spawn().unwrap();
        until("nothing is written", || names() != before);
        kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(130), "{command:?}");
        assert_eq!(names(), before, "{command:?}");
    }
}
