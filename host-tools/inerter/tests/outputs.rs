//! Outputs that are deleted, moved or truncated while they are written, programs that are ended meanwhile, and files
//! that already exist.

use std::{
    fs,
    os::unix::fs::symlink,
    path::Path,
    process::Child,
    time::{Duration, Instant},
};

use crate::common::{device, done, fails, inerter, json_lines, run, text, until};
use rustix::process::{Pid, Signal, kill_process};

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Another program's action on the file.
type Disturb = fn(&Path);

#[test]
fn a_recording_that_another_program_disturbs_ends_with_code_8() {
    let device = device(20.0);
    let disturbances: [(&str, Disturb); 5] = [
        ("another program deleted it", |file| fs::remove_file(file).unwrap()),
        ("another program deleted it", |file| {
            fs::write(file.with_extension("new"), "mine").unwrap();
            fs::rename(file.with_extension("new"), file).unwrap();
        }),
        ("another program moved it", |file| fs::rename(file, file.with_extension("old")).unwrap()),
        ("another program shortened it", |file| drop(fs::File::create(file).unwrap())),
        ("or wrote into it", |file| {
            std::io::Write::write_all(&mut fs::OpenOptions::new().append(true).open(file).unwrap(), b"mine").unwrap();
        }),
    ];
    for command in [&["record", "-o"][..], &["monitor", "--plain", "--record"]] {
        for (words, disturb) in disturbances {
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join("run.mcap");
            let arguments = ["run.mcap", "--connect", device.name(), "--duration", "6"];
            let child = inerter(folder.path(), &[command, &arguments].concat()).spawn().unwrap();
            // More than the header: frames have arrived.
            until("nothing is recorded", || file.metadata().is_ok_and(|metadata| metadata.len() > 14_000));
            disturb(&file);
            let output = child.wait_with_output().unwrap();
            let said = text(&output.stderr);
            assert_eq!(output.status.code(), Some(8), "{words}: {said}");
            assert!(said.contains("run.mcap cannot be written") && said.contains(words), "{words}: {said}");
        }
    }
}

#[test]
fn a_link_that_leads_nowhere_and_an_empty_file_are_left_alone() {
    let device = device(20.0);
    let folder = tempfile::tempdir().unwrap();
    done(folder.path(), &["simulate", "-o", "in.mcap", "--duration", "3"]);
    let link = ["--connect", device.name(), "--duration", "0.2"];
    for name in ["out.mcap", "out.csv", "out.settings.toml", "out.svg", "out.html", "out.toml"] {
        symlink("elsewhere", folder.path().join(name)).unwrap();
    }
    let written: [&[&str]; 11] = [
        &["record", "-o", "out.mcap", link[0], link[1], link[2], link[3]],
        &["monitor", "--plain", "--record", "out.mcap", link[0], link[1], link[2], link[3]],
        &["simulate", "--duration", "1", "-o", "out.mcap"],
        &["simulate", "--duration", "1", "-o", "out.csv"],
        &["cut", "in.mcap", "-o", "out.mcap"],
        &["export", "in.mcap", "--csv", "out.csv"],
        &["plot", "in.mcap", "--figure", "force", "-o", "out.svg"],
        &["report", "in.mcap", "-o", "out.html"],
        &["compare", "in.mcap", "in.mcap", "-o", "out.html"],
        &["plan", "in.mcap", "-o", "out.csv"],
        &["settings", "backup", "out.toml", link[0], link[1]],
    ];
    let before = names(folder.path());
    for arguments in written {
        assert!(fails(folder.path(), arguments, 8).contains("exists already"), "{arguments:?}");
        assert_eq!(names(folder.path()), before, "{arguments:?}");
    }
    fs::write(folder.path().join("empty.mcap"), "").unwrap();
    fails(folder.path(), &["record", "-o", "empty.mcap", link[0], link[1], link[2], link[3]], 8);
    done(folder.path(), &["record", "-o", "empty.mcap", "--force", link[0], link[1], link[2], link[3]]);
}

#[test]
fn a_simulation_replaces_nothing_unasked() {
    let folder = tempfile::tempdir().unwrap();
    for file in ["run.mcap", "run.csv"] {
        let simulate = ["simulate", "--duration", "1", "-o", file];
        fs::write(folder.path().join(file), "mine").unwrap();
        let words = fails(folder.path(), &simulate, 8);
        assert!(words.contains("exists already") && words.contains("--force"), "{words}");
        assert_eq!(fs::read(folder.path().join(file)).unwrap(), b"mine");
        done(folder.path(), &[&simulate[..], &["--force"]].concat());
        done(folder.path(), &["info", file]);
    }
    assert_eq!(names(folder.path()), ["run.csv", "run.mcap", "run.settings.toml"]);
    // The settings file next to a CSV counts too.
    fs::remove_file(folder.path().join("run.csv")).unwrap();
    fails(folder.path(), &["simulate", "--duration", "1", "-o", "run.csv"], 8);
    assert_eq!(names(folder.path()), ["run.mcap", "run.settings.toml"]);
}

/// Ends a program while it writes files, as soon as they exist.
fn end_while_it_writes(folder: &Path, mut child: Child, before: &[String], signals: &[Signal]) {
    until("nothing is written", || names(folder) != before || child.try_wait().unwrap().is_some());
    for signal in signals {
        // The first signal may already have ended it.
        kill_process(Pid::from_child(&child), *signal).ok();
    }
    assert_eq!(child.wait().unwrap().code(), Some(130), "{signals:?}");
    assert_eq!(names(folder), before, "{signals:?}");
}

#[test]
fn a_program_that_is_ended_while_it_writes_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    for signals in [&[Signal::TERM][..], &[Signal::INT], &[Signal::HUP], &[Signal::TERM, Signal::TERM]] {
        let before = names(folder.path());
        let child = inerter(folder.path(), &["simulate", "--duration", "50000", "-o", "long.mcap"]).spawn().unwrap();
        end_while_it_writes(folder.path(), child, &before, signals);
    }
    done(folder.path(), &["simulate", "--duration", "300", "--sample-rate-hz", "4000", "-o", "run.mcap"]);
    let before = names(folder.path());
    let outputs = ["--csv", "o.csv", "--parquet", "o.parquet", "--mat", "o.mat", "--mcap", "o.mcap"];
    for signals in [&[Signal::TERM][..], &[Signal::TERM, Signal::TERM]] {
        let child = inerter(folder.path(), &[&["export", "run.mcap"], &outputs[..]].concat()).spawn().unwrap();
        end_while_it_writes(folder.path(), child, &before, signals);
    }
}

/// Signals a child once it is waiting; it must end within 5 s.
fn ends_soon(mut child: Child, what: &str) {
    std::thread::sleep(Duration::from_secs(3));
    assert!(child.try_wait().unwrap().is_none(), "{what} has ended by itself");
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    let told = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if told.elapsed() > Duration::from_secs(5) {
            child.kill().ok();
            panic!("{what} goes on");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(child.wait().unwrap().code(), Some(130), "{what}");
}

/// A blocking call on a pipe that nobody reads or fills does not notice the signal.
#[test]
fn a_program_that_waits_for_a_pipe_ends_soon_after_a_signal() {
    let (folder, device) = (tempfile::tempdir().unwrap(), device(20.0));
    let pipes = ["pipe0", "pipe1", "pipe2", "pipe3"];
    for pipe in pipes {
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mkfifoat(rustix::fs::CWD, folder.path().join(pipe), mode).unwrap();
    }
    let link = ["--connect", device.name()];
    let commands: [&[&str]; 4] = [
        // Nobody reads its standard output.
        &["monitor", "--json", link[0], link[1]],
        &["record", "-o", "pipe0", link[0], link[1]],
        &["cut", "pipe1", "-o", "part.mcap"],
        &["merge", "pipe2", "pipe3", "-o", "both.mcap"],
    ];
    std::thread::scope(|scope| {
        for command in commands {
            let child = inerter(folder.path(), command).spawn().unwrap();
            scope.spawn(move || ends_soon(child, command[0]));
        }
    });
    assert_eq!(names(folder.path()), pipes);
}

/// A pipe holds 64 KB, less than a second of this device's data.
#[test]
fn whoever_does_not_read_the_lines_holds_up_no_recording() {
    let (folder, device) = (tempfile::tempdir().unwrap(), device(20.0));
    let command = ["monitor", "--json", "--record", "run.mcap", "--connect", device.name()];
    let mut child = inerter(folder.path(), &command).spawn().unwrap();
    let file = folder.path().join("run.mcap");
    // More than a minute of its samples.
    until("the recording waits", || file.metadata().is_ok_and(|metadata| metadata.len() > 4_000_000));
    assert!(child.try_wait().unwrap().is_none());
    // Lines read late are complete, with a count of those dropped.
    let lines = child.stdout.take().unwrap();
    let reader = std::thread::spawn(move || std::io::read_to_string(lines).unwrap());
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let said = reader.join().unwrap();
    assert!(said.lines().count() > 100 && said.ends_with("}\n"), "{said}");
    let info = json_lines(&done(folder.path(), &["info", "run.mcap", "--json"])).remove(0);
    assert_eq!((&info["lost_samples"], &info["ending"]), (&0.into(), &"closed".into()), "{info}");
}

#[test]
fn what_appears_while_a_file_is_made_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let child = inerter(folder.path(), &["simulate", "--duration", "300", "-o", "run.mcap"]).spawn().unwrap();
    until("nothing is written", || !names(folder.path()).is_empty());
    fs::write(folder.path().join("run.mcap"), "mine").unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(8), "{}", text(&output.stderr));
    assert_eq!(fs::read(folder.path().join("run.mcap")).unwrap(), b"mine");
    assert_eq!(names(folder.path()), ["run.mcap"]);
    assert!(run(folder.path(), &["simulate", "--duration", "1", "-o", "/dev/null"]).status.success());
}
