//! The program with the firmware image in QEMU. Skipped if the image or QEMU is missing.

use std::{io::BufRead, time::Duration};

use crate::common::{self, any_port, assert_same_estimates, done, estimate_of, fails, inerter, last, setup};
use inerter_data::recording::{End, Recorder};
use inerter_device::{
    Device, Target,
    live::{LinkEvent, Live},
};
use inerter_simulate::{Qemu, START_TIME, Setup, find_image};
use inerter_wire::{EventKind, Frame, Record, Streams};

/// The image, if this machine can run it.
fn image() -> Option<std::path::PathBuf> {
    let qemu = std::process::Command::new("qemu-system-arm").arg("--version").output();
    inerter_needs::or_skip(match qemu {
        Ok(_) => find_image(None).map_err(|_| "no image; `cargo xtask build-firmware` makes it".into()),
        Err(error) => Err(format!("qemu-system-arm cannot be run ({error}); `cargo xtask setup` installs it")),
    })
}

/// The image with the settings of the simulated device, at rest.
fn booted(setup: &Setup, image: &std::path::Path) -> Qemu {
    let mut qemu = Qemu::boot(image, &any_port(), || false).unwrap();
    let target = Target::Tcp { address: qemu.name().into() };
    let alive = || Ok::<(), Box<dyn std::error::Error>>(qemu.check()?);
    Device::connect_starting(&target, START_TIME, &setup.settings, || false, alive).unwrap();
    qemu
}

#[test]
fn a_run_through_the_image_replays_to_the_same_digits() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().unwrap();
    let setup = setup("random@8s");
    let mut qemu = booted(&setup, &image);
    let target = Target::Tcp { address: qemu.name().into() };
    let mut live = Live::connect(target, Streams::ALL, Duration::ZERO, || false).unwrap();
    let mut recorder = Recorder::create(&folder.path().join("run.mcap"), false).unwrap();
    let device = live.device().unwrap();
    recorder.describe(device.hello(), device.settings()).unwrap();
    qemu.play(&setup, 8.0).unwrap();
    let mut ended = false;
    loop {
        let received = match live.next().unwrap() {
            LinkEvent::Received(received) => received,
            // The last raw samples may come after the event.
            LinkEvent::Quiet if ended => break,
            _ => continue,
        };
        if !received.bytes.is_empty() {
            recorder.frame(received.time_ns, &received.bytes).unwrap();
        }
        if let Frame::Message { message: Record::Event(event), .. } = received.frame {
            ended |= event.kind == EventKind::SourceEnded;
        }
    }
    recorder.close(&End { reason: "finished".into(), lost_frames: live.lost_frames() }).unwrap();
    let info = last(&done(folder.path(), &["info", "run.mcap", "--json"]));
    assert_eq!((info.get("samples").unwrap(), info.get("discontinuities").unwrap()), (&8000.into(), &0.into()));
    let replayed = last(&done(folder.path(), &["replay", "run.mcap", "--json"]));
    assert_eq!(estimate_of(info.get("estimate").unwrap()), estimate_of(&replayed));
}

#[cfg(unix)]
#[test]
fn the_image_on_a_pseudo_terminal_takes_what_is_sent_to_it() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().unwrap();
    done(folder.path(), &["simulate", "-o", "run.mcap", "--duration", "4"]);
    let image = image.canonicalize().unwrap();
    let arguments = ["simulate", "--qemu", "--pty", "--json", "--image", image.to_str().unwrap()];
    let mut child = inerter(folder.path(), &arguments).spawn().unwrap();
    let mut line = String::new();
    std::io::BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let ready = last(&line);
    let port = ready.get("port").unwrap().as_str().unwrap();
    let sent = done(folder.path(), &["send", "run.mcap", "--json", "--port", port]);
    let replayed = done(folder.path(), &["replay", "run.mcap", "--json"]);
    let process = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(process, rustix::process::Signal::INT).unwrap();
    assert!(child.wait().unwrap().success());
    // At the end, because a failure would leave QEMU running.
    assert_same_estimates(&sent, &replayed);
}

#[test]
fn hands_load_the_cell_of_the_image_which_keeps_no_settings() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().unwrap();
    let setup = setup("hold");
    let mut qemu = booted(&setup, &image);
    let bench = qemu.play_with_operator(&setup, 4.0).unwrap();
    let zero = ["calibrate", "zero", "--duration", "1", "--json", "--connect", qemu.name()];
    // Refused at once, not after an hour of measuring.
    let words = fails(folder.path(), &[&zero[..], &["--write"]].concat(), 6);
    assert!(words.contains("refused to keep settings over a restart, as --write requires"), "{words}");
    bench.load(100.0);
    let found = last(&done(folder.path(), &zero));
    let code = found["values"]["force_zero_code"].as_f64().unwrap();
    assert!((code - 50_000.0).abs() < 100.0, "{found}");
}

#[cfg(unix)]
#[test]
fn an_image_that_does_not_run_is_told_in_qemus_words() {
    if image().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("zeros.bin"), [0; 4096]).unwrap();
    for endpoint in [&["--pty"][..], &["--tcp", "127.0.0.1:0"]] {
        let words = fails(folder.path(), &[&["simulate", "--qemu", "--image", "zeros.bin"], endpoint].concat(), 5);
        assert!(words.contains("QEMU ended unexpectedly") && words.contains("qemu: fatal: Lockup"), "{words}");
    }
}

/// QEMU has its own process group, and could keep running and occupy the port.
#[cfg(unix)]
#[test]
fn a_second_signal_ends_qemu_too() {
    use rustix::process::{Pid, Signal, kill_process};
    if image().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("silent.bin"), silent_image()).unwrap();
    let address = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let arguments = ["simulate", "--qemu", "--image", "silent.bin", "--tcp", &address];
    let mut command = inerter(folder.path(), &arguments);
    let mut child = command.env("TMPDIR", folder.path()).spawn().unwrap();
    // Connect, because a bind that tests whether the port is free could take it from QEMU.
    common::until("QEMU does not start", || std::net::TcpStream::connect(&address).is_ok());
    for _ in 0..2 {
        kill_process(Pid::from_child(&child), Signal::TERM).ok();
    }
    assert_eq!(child.wait().unwrap().code(), Some(130));
    common::until("QEMU goes on", || std::net::TcpListener::bind(&address).is_ok());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "its samples are left");
}

/// A stack pointer, a reset vector and a branch to itself.
#[cfg(unix)]
fn silent_image() -> Vec<u8> {
    [0x2000_1000_u32, 0x0000_0009, 0xE7FE_E7FE].map(u32::to_le_bytes).concat()
}

#[cfg(unix)]
#[test]
fn an_image_that_never_answers_is_left_soon_after_a_signal() {
    use rustix::process::{Pid, Signal, kill_process};
    if image().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("silent.bin"), silent_image()).unwrap();
    for endpoint in [&["--pty"][..], &["--tcp", "127.0.0.1:0"]] {
        for signal in [Signal::TERM, Signal::INT] {
            let arguments = [&["simulate", "--qemu", "--image", "silent.bin"], endpoint].concat();
            let mut child = inerter(folder.path(), &arguments).spawn().unwrap();
            // Otherwise it waits for ten seconds.
            std::thread::sleep(Duration::from_secs(2));
            let told = std::time::Instant::now();
            kill_process(Pid::from_child(&child), signal).unwrap();
            let status = child.wait().unwrap();
            assert_eq!(status.code(), Some(130), "{endpoint:?}, {signal:?}: {status}");
            assert!(told.elapsed() < Duration::from_secs(5), "{endpoint:?}, {signal:?}: {:?}", told.elapsed());
        }
    }
}
