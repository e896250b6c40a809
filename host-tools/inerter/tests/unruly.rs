//! The program with devices that are silent, send endlessly, or answer none of its requests.

use std::{io::Read, path::Path, sync::Mutex, thread, time::Duration};

use crate::common::{
    self, all_are_tried, device, inerter,
    terminal::terminal,
    unruly::{self, COMMANDS, MANNERS, Manner, Unruly, Visit, prepared},
};
use rustix::process::{Pid, Signal, kill_process};

/// One in this many pairs of command and manner is tried here; `cargo xtask chaos unruly` tries all of them.
const ONE_IN: usize = 7;
/// Number of concurrent visits.
const AT_ONCE: usize = 40;
/// More than any command uses with a device that sends everything it can \[kB\].
const MOST_KB: u64 = 64_000;

#[test]
fn every_command_that_talks_to_a_device_is_tried() {
    all_are_tried(COMMANDS, |help| help.contains("--connect <HOST:PORT>"));
}

/// Calls `act` with pairs of a command and a device, many at a time because most of them wait. The pairs include every
/// command and every manner.
fn each(first: usize, act: impl Fn(&Path, &[&str], Manner) + Sync) {
    let pairs: Vec<_> =
        MANNERS.iter().flat_map(|manner| COMMANDS.iter().map(move |command| (*command, *manner))).collect();
    let pairs: Vec<_> = pairs.into_iter().skip(first).step_by(ONE_IN).collect();
    let pairs = Mutex::new(pairs.into_iter());
    let next = || pairs.lock().unwrap().next();
    thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                let folder = prepared();
                while let Some((command, manner)) = next() {
                    act(folder.path(), command, manner);
                }
            });
        }
    });
}

#[test]
fn every_command_ends_soon_after_a_signal_whatever_the_device_does() {
    each(0, |folder, command, manner| {
        let device = Unruly::start(manner, 1);
        // Commands without a handler are ended by the signal itself. Background processes of some shells ignore SIGINT.
        let signals = if command[0] == "settings" { &[Signal::TERM][..] } else { &[Signal::TERM, Signal::INT] };
        for &signal in signals {
            let before = device.guests();
            let mut visit = Visit::start(folder, command, &device.address);
            // The command may have ended by itself. With many concurrent starts, some are late.
            let mut goes_on = visit.goes_on(Duration::from_millis(700));
            for _ in 0..50 {
                if !goes_on || device.guests() > before {
                    break;
                }
                goes_on = visit.goes_on(Duration::from_millis(100));
            }
            if goes_on {
                kill_process(Pid::from_child(&visit.child), signal).unwrap();
            }
            let status = visit.ended(Duration::from_secs(5));
            assert!(status.is_some(), "{command:?} at a device that is {manner:?} goes on after {signal:?}");
            let (most_kb, foreign) = visit.end();
            assert!(most_kb < MOST_KB, "{command:?} at a device that is {manner:?}: {most_kb} kB");
            assert_eq!(foreign, None, "{command:?} at a device that is {manner:?}");
        }
        assert_ne!(device.guests(), 0, "{command:?} never came to its device");
    });
}

#[test]
fn a_send_ends_when_the_device_only_warns() {
    let (folder, device) = (prepared(), Unruly::start(Manner::WarningFlood, 1));
    let program = inerter(folder.path(), &["send", "sent.mcap", "--json", "--connect", &device.address]).output();
    let output = program.unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(6), "{errors}");
    assert!(errors.contains("inerter::device::flood"), "{errors}");
}

/// The library that reads the keys loops forever if its terminal disappears.
#[test]
fn the_screen_ends_with_its_terminal() {
    use rustix::termios;
    let folder = tempfile::tempdir().unwrap();
    let (master, terminal) = terminal();
    let again = || terminal.try_clone().unwrap();
    termios::tcsetwinsize(&terminal, termios::Winsize { ws_row: 40, ws_col: 100, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
    let device = device(1.0);
    let mut command = inerter(folder.path(), &["monitor", "--connect", device.name()]);
    let mut child = command.env("TERM", "xterm").stdin(again()).stdout(again()).stderr(again()).spawn().unwrap();
    drop((command, terminal));
    let mut screen = std::fs::File::from(master);
    let mut shown = Vec::new();
    let mut some = [0; 4096];
    while !String::from_utf8_lossy(&shown).contains("Overview") {
        let length = screen.read(&mut some).unwrap();
        shown.extend_from_slice(&some[..length]);
    }
    kill_process(Pid::from_child(&child), Signal::HUP).unwrap();
    drop(screen);
    // The system sends a second signal if the terminal is the program's own.
    kill_process(Pid::from_child(&child), Signal::HUP).ok();
    let status = unruly::ended(&mut child, Duration::from_secs(5)).expect("it goes on without its terminal");
    assert!(matches!(status.code(), Some(0..=10 | 130)), "{status}");
}

/// As after Ctrl-S, or if the window hangs.
#[test]
fn a_terminal_that_takes_nothing_holds_up_neither_a_recording_nor_the_end() {
    use rustix::{io, termios};
    let device = device(5.0);
    // The screen fills the terminal by itself; a progress line would take minutes.
    for (command, is_full) in [(["monitor", "--record"], false), (["record", "-o"], true)] {
        let folder = tempfile::tempdir().unwrap();
        let (_nobody, terminal) = terminal();
        termios::tcsetwinsize(&terminal, termios::Winsize { ws_row: 40, ws_col: 120, ws_xpixel: 0, ws_ypixel: 0 })
            .unwrap();
        let again = || terminal.try_clone().unwrap();
        let mut program = inerter(folder.path(), &[&command[..], &["run.mcap", "--connect", device.name()]].concat());
        let mut child = program.env("TERM", "xterm").stdin(again()).stdout(again()).stderr(again()).spawn().unwrap();
        let length = || folder.path().join("run.mcap").metadata().map_or(0, |metadata| metadata.len());
        common::until("nothing is recorded", || length() > 20_000);
        if is_full {
            io::ioctl_fionbio(&terminal, true).unwrap();
            while io::write(&terminal, &[b'x'; 512]).is_ok() {}
            io::ioctl_fionbio(&terminal, false).unwrap();
        }
        // Half a minute of the device's data.
        common::until("the recording waits", || length() > 700_000);
        kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
        // The limit of 5 s on an idle machine is checked by the campaign (`cargo xtask chaos lost_terminals`). With
        // other tests running, allow more.
        let status = unruly::ended(&mut child, Duration::from_secs(20));
        assert!(status.is_some(), "{command:?} goes on");
        let info = common::last(&common::done(folder.path(), &["info", "run.mcap", "--json"]));
        assert_eq!((&info["ending"], &info["lost_samples"]), (&"closed".into(), &0.into()), "{command:?}: {info}");
    }
}

/// If the run is interrupted, its backup is the only copy of the board's settings.
#[test]
fn a_self_test_backs_settings_up_before_it_begins_and_replaces_no_backup() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let device = Unruly::start(Manner::Repeating, 1);
    let runs: [(&[&str], &str); 2] =
        [(&["selftest"], "selftest"), (&["selftest", "-o", "board.html", "--force"], "board")];
    for (command, stem) in runs {
        let first = path(&format!("{stem}.settings.toml"));
        std::fs::write(&first, "# of an earlier run\n").unwrap();
        let second = path(&format!("{stem}.settings.2.toml"));
        let mut visit = Visit::start(folder.path(), command, &device.address);
        common::until("no backup is written", || second.exists());
        kill_process(Pid::from_child(&visit.child), Signal::TERM).unwrap();
        visit.ended(Duration::from_secs(10)).expect("it goes on");
        visit.end();
        assert_eq!(std::fs::read_to_string(first).unwrap(), "# of an earlier run\n");
        assert!(inerter_data::backup::read(&second).unwrap().owner.is_some());
    }
    let words = common::fails(folder.path(), &["selftest", "-o", "board.json", "--connect", &device.address], 2);
    assert!(words.contains("give the page another ending"), "{words}");
    assert!(!path("board.json").exists());
}

#[test]
fn no_request_waits_for_ever() {
    each(3, |folder, command, manner| {
        // These keep running with a device that responds; the wizard does because a person answers it. The other test
        // checks how they end.
        let says_nothing =
            matches!(manner, Manner::Silent | Manner::Samples | Manner::Introduced | Manner::Mute | Manner::Empty);
        if (["monitor", "record"].contains(&command[0]) || command == ["calibrate"]) && !says_nothing {
            return;
        }
        let device = Unruly::start(manner, 1);
        let mut visit = Visit::start(folder, command, &device.address);
        let code = visit.ended(Duration::from_secs(60)).and_then(|status| status.code());
        assert!(matches!(code, Some(0..=10)), "{command:?} at a device that is {manner:?}: {code:?}");
        // Their self-reports are nonsense.
        assert!(command[0] != "selftest" || code != Some(0), "a device that is {manner:?} passed");
        assert_ne!(device.guests(), 0, "{command:?} never came to its device");
    });
}
