//! The program at devices that are silent, send without an end, or answer nothing that they are asked.
#![cfg(unix)]

mod common;
#[path = "../../device/src/image/elf_file.rs"]
mod elf_file;
#[path = "common/terminal.rs"]
mod terminal;

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    path::Path,
    process::{Child, ExitStatus, Stdio},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use common::{all_are_tried, done, inerter};
use inerter_core::{RawSample, Settings};
use inerter_data::settings::Overrides;
use inerter_plant::Inerter;
use inerter_simulate::{Endpoint, Setup, VirtualDevice, bench_sensors};
use inerter_wire::{
    Capabilities, ClockSource, Command, DELIMITER, Done, Frame, FrameReader, Hello, MAX_FRAME, Record, Reply, Request,
    Samples, SequenceCounter, SettingsValues, encode_record,
};
use rustix::process::{Pid, Signal, kill_process};
use terminal::{patient, terminal};

/// What a device does once somebody has connected.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Manner {
    /// Nothing.
    Silent,
    /// Bytes without meaning.
    Noise,
    /// Samples, and no answer at all.
    Samples,
    /// Answers who it is, then samples and no other answer.
    Introduced,
    /// The same without the samples.
    Mute,
    /// Answers everything, and sends the same sample again and again.
    Repeating,
}

const MANNERS: [Manner; 6] =
    [Manner::Silent, Manner::Noise, Manner::Samples, Manner::Introduced, Manner::Mute, Manner::Repeating];

/// Its address, and how many have connected to it.
fn device(manner: Manner) -> (String, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let guests = Arc::new(AtomicUsize::new(0));
    let count = guests.clone();
    thread::spawn(move || {
        for host in listener.incoming() {
            count.fetch_add(1, Ordering::Relaxed);
            thread::spawn(move || behave(manner, host.unwrap()));
        }
    });
    (address, guests)
}

fn behave(manner: Manner, mut host: TcpStream) -> Option<()> {
    let mut sequence = SequenceCounter::new();
    let mut frame = |record: &Record| {
        let mut out = [0; MAX_FRAME];
        let length = encode_record(record, sequence.take(), &mut out).unwrap();
        out.get(..length).unwrap().to_vec()
    };
    let mut requests = FrameReader::<Request>::new();
    host.write_all(&[DELIMITER]).ok()?;
    while matches!(manner, Manner::Introduced | Manner::Mute)
        && !answer(&mut host, &mut requests, &mut frame)?.contains(&Command::ReadSettings)
    {}
    let raw = RawSample { index: 7, position_count: 100, force_code: 100, terminal_code: 0 };
    loop {
        let bytes = match manner {
            Manner::Silent | Manner::Mute => {
                // Until the host has gone.
                host.read_exact(&mut [0; 64]).ok()?;
                continue;
            }
            Manner::Noise => (0..=255).cycle().skip(1).take(4096).collect(),
            Manner::Samples | Manner::Introduced | Manner::Repeating => {
                if manner == Manner::Repeating {
                    host.set_read_timeout(Some(Duration::from_millis(1))).ok()?;
                    answer(&mut host, &mut requests, &mut frame)?;
                }
                let batch = Record::Samples(Samples::from_slice(&[raw; 1]).0);
                (0..64).flat_map(|_| frame(&batch)).collect::<Vec<u8>>()
            }
        };
        host.write_all(&bytes).ok()?;
    }
}

/// Answers what is asked in one portion; gives it.
fn answer(
    host: &mut TcpStream,
    requests: &mut FrameReader<Request>,
    frame: &mut impl FnMut(&Record) -> Vec<u8>,
) -> Option<Vec<Command>> {
    let mut portion = [0; 512];
    let count = match host.read(&mut portion) {
        Ok(0) => return None,
        Ok(count) => count,
        Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => 0,
        Err(_) => return None,
    };
    let mut input = portion.get(..count)?;
    let mut asked = Vec::new();
    while let Some(found) = requests.read(&mut input) {
        let Frame::Message { message: Request { id, command }, .. } = found else { continue };
        let content = match command {
            Command::Hello => Some(Record::Hello(Hello {
                wire_version: inerter_wire::WIRE_VERSION,
                firmware: Hello::text("unruly 1"),
                git: Hello::text(""),
                board: Hello::text("unruly"),
                serial: Hello::text("1"),
                sample_rate_hz: 1000.0,
                clock: ClockSource::Crystal,
                capabilities: Capabilities(u32::MAX),
            })),
            Command::ReadSettings => Some(Record::Settings(SettingsValues::from(&Settings::default()))),
            _ => None,
        };
        for record in content.into_iter().chain([Record::Reply(Reply { id, result: Ok(Done::Plain) })]) {
            host.write_all(&frame(&record)).ok()?;
        }
        asked.push(command);
    }
    Some(asked)
}

/// With as many views in other programs as are built in.
const OTHER_VIEWS: &[&str] = if cfg!(feature = "bridges") {
    &["monitor", "--plain", "--share", "127.0.0.1:0", "--web", "--bind", "127.0.0.1:0"]
} else {
    &["monitor", "--plain", "--share", "127.0.0.1:0"]
};

/// Every command that talks to a device, without its link.
const COMMANDS: &[&[&str]] = &[
    &["monitor", "--json"],
    &["monitor", "--plain", "--wait", "60"],
    OTHER_VIEWS,
    &["record", "-o", "run.mcap", "--force", "--wait", "60"],
    &["send", "sent.mcap"],
    &["doctor"],
    &["settings", "get"],
    &["settings", "set", "memory_s=12"],
    &["settings", "tare"],
    &["settings", "save"],
    &["settings", "factory-reset", "--yes"],
    &["settings", "backup", "kept.toml", "--force"],
    &["settings", "restore", "before.toml"],
    &["settings", "diff", "device", "before.toml"],
    &["calibrate"],
    &["calibrate", "load-cell", "--duration", "60"],
    &["calibrate", "zero", "--duration", "60"],
    &["calibrate", "force", "--mass", "1"],
    &["calibrate", "encoder", "--revolutions", "1", "--lead", "0.01"],
    &["calibrate", "direction", "--duration", "60"],
    &["calibrate", "skew", "--duration", "60"],
    &["calibrate", "stiffness", "--duration", "60"],
    &["calibrate", "timebase", "--duration", "60"],
    &["update", "image.elf", "--force"],
];

/// The command at this device; the wizard has somebody before it who presses Enter at whatever he is asked.
fn start(folder: &Path, command: &[&str], address: &str) -> Child {
    let mut program = inerter(folder, &[command, &["--connect", address]].concat());
    program.stdout(Stdio::null()).stderr(Stdio::null());
    if command == ["calibrate"] {
        let (terminal, _) = patient();
        program.stdin(terminal.try_clone().unwrap()).stderr(terminal);
    }
    program.spawn().unwrap()
}

/// How it ends, if it does; meanwhile it must not take more and more memory.
fn ended(child: &mut Child, within: Duration) -> Option<ExitStatus> {
    let started = Instant::now();
    while started.elapsed() < within {
        if let Some(most_kb) = most_memory_kb(child) {
            assert!(most_kb < 200_000, "{most_kb} kB");
        }
        if let Some(status) = child.try_wait().unwrap() {
            return Some(status);
        }
        thread::sleep(Duration::from_millis(10));
    }
    child.kill().ok();
    child.wait().ok();
    None
}

/// The most memory that it has held, where the system tells; a process that has ended holds none.
fn most_memory_kb(child: &Child) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).ok()?;
    status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")?.parse().ok())
}

#[test]
fn every_command_that_talks_to_a_device_is_tried() {
    all_are_tried(COMMANDS, |help| help.contains("--connect <HOST:PORT>"));
}

/// A folder with what the commands need.
fn prepared() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    done(folder.path(), &["simulate", "-o", "sent.mcap", "--duration", "5"]);
    std::fs::write(folder.path().join("before.toml"), "memory_s = 5.0\n").unwrap();
    std::fs::write(folder.path().join("image.elf"), elf_file::image(5000, "inerter 0.1.0", "c8a2d5a")).unwrap();
    folder
}

/// Does something with every command at every device, ten at a time.
fn each(act: impl Fn(&Path, &[&str], Manner) + Sync) {
    thread::scope(|scope| {
        for (manner, half) in MANNERS.into_iter().flat_map(|manner| [(manner, 0), (manner, 1)]) {
            let act = &act;
            scope.spawn(move || {
                let folder = prepared();
                COMMANDS.iter().skip(half).step_by(2).for_each(|command| act(folder.path(), command, manner));
            });
        }
    });
}

#[test]
fn every_command_ends_soon_after_a_signal_whatever_the_device_does() {
    each(|folder, command, manner| {
        let (address, guests) = device(manner);
        // The system ends those without a handler by either; in the background some shells have it ignore SIGINT.
        let signals = if command[0] == "settings" { &[Signal::TERM][..] } else { &[Signal::TERM, Signal::INT] };
        for &signal in signals {
            let mut child = start(folder, command, &address);
            // It may have ended by itself.
            thread::sleep(Duration::from_millis(700));
            let pid = Pid::from_child(&child);
            if child.try_wait().unwrap().is_none() {
                kill_process(pid, signal).unwrap();
            }
            let status = ended(&mut child, Duration::from_secs(5));
            assert!(status.is_some(), "{command:?} at a device that is {manner:?} goes on after {signal:?}");
        }
        assert_ne!(guests.load(Ordering::Relaxed), 0, "{command:?} never came to its device");
    });
}

/// The library that reads the keys goes on for ever at a terminal that is gone.
#[test]
fn the_screen_ends_with_its_terminal() {
    use rustix::termios;
    let folder = tempfile::tempdir().unwrap();
    let (master, terminal) = terminal();
    let again = || terminal.try_clone().unwrap();
    termios::tcsetwinsize(&terminal, termios::Winsize { ws_row: 40, ws_col: 100, ws_xpixel: 0, ws_ypixel: 0 }).unwrap();
    let setup = Setup::new(Inerter::paper(), bench_sensors(), "random", None, &Overrides::default()).unwrap();
    let device = VirtualDevice::start(&setup, &Endpoint::Tcp("127.0.0.1:0".into()), 1.0).unwrap();
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
    // The system sends another where the terminal is its own.
    kill_process(Pid::from_child(&child), Signal::HUP).ok();
    let status = ended(&mut child, Duration::from_secs(5)).expect("it goes on without its terminal");
    assert!(matches!(status.code(), Some(0..=9 | 130)), "{status}");
}

#[test]
fn no_request_waits_for_ever() {
    each(|folder, command, manner| {
        // These go on at a device that speaks; how they end is the other test's.
        if ["monitor", "record"].contains(&command[0]) && matches!(manner, Manner::Noise | Manner::Repeating) {
            return;
        }
        let (address, guests) = device(manner);
        let mut child = start(folder, command, &address);
        let status = ended(&mut child, Duration::from_secs(60));
        let code = status.and_then(|status| status.code());
        assert!(matches!(code, Some(0..=9)), "{command:?} at a device that is {manner:?}: {code:?}");
        assert_ne!(guests.load(Ordering::Relaxed), 0, "{command:?} never came to its device");
    });
}
