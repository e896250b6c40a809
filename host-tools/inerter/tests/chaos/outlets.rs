//! The program's output is closed, full, gone or slow.

use std::{
    fs::{File, OpenOptions},
    io::{Read, Write},
    net::TcpStream,
    path::Path,
    process::{Child, Command, Stdio},
    sync::atomic::{AtomicUsize, Ordering},
    thread,
    time::{Duration, Instant},
};

use inerter_wire::Streams;
use rustix::process::{Pid, Signal, kill_process};

use crate::{
    common::{
        done, inerter, last,
        terminal::terminal,
        text,
        unruly::{COMMANDS, ended, memory_kb, prepared, request},
        until,
    },
    cycles::Simulated,
    scenario::{AT_ONCE, MOST_KB, Scenario, device, each},
};

/// Commands that need no device and print something.
const OFFLINE: &[&[&str]] = &[
    &["--help"],
    &["--version"],
    &["replay", "sent.mcap"],
    &["replay", "sent.mcap", "--json"],
    &["info", "sent.mcap"],
    &["info", "sent.mcap", "--json"],
    &["fit", "sent.mcap"],
    &["diagnose", "sent.mcap", "--json"],
    &["identify", "sent.mcap", "--no-profiles"],
    &["plan", "sent.mcap"],
    &["plan", "--preset", "paper"],
    &["export", "sent.mcap", "--csv", "-"],
    &["export", "sent.mcap", "--csv", "e.csv", "--force"],
    &["simulate", "--duration", "2", "-o", "s.mcap", "--force"],
    &["cut", "sent.mcap", "-o", "c.mcap", "--force"],
    &["merge", "sent.mcap", "sent.mcap", "-o", "m.mcap", "--force"],
    &["report", "sent.mcap", "-o", "r.html", "--force"],
    &["compare", "sent.mcap", "sent.mcap", "-o", "c.html", "--force"],
    &["plot", "sent.mcap", "--figure", "force", "-o", "f.svg", "--force"],
    &["man", "-o", ".", "--force"],
    &["completions", "bash"],
    &["ports"],
    &["doctor"],
    &["settings", "diff", "sent.mcap", "before.toml"],
    &["calibrate", "zero", "sent.mcap"],
    &["calibrate", "load-cell", "sent.mcap"],
    &["calibrate", "skew", "sent.mcap"],
    &["nonsense"],
    &["info", "not-there.mcap"],
];

/// All commands; those with a device run briefly or until the signal.
fn all(address: &str) -> Vec<Vec<String>> {
    let owned = |words: &[&str]| words.iter().map(|word| word.to_string()).collect::<Vec<String>>();
    // This command needs a person.
    let live = COMMANDS.iter().filter(|command| **command != ["calibrate"]);
    let live = live.map(|command| owned(&[*command, &["--connect", address]].concat()));
    OFFLINE.iter().map(|command| owned(command)).chain(live).collect()
}

/// The child ends by itself or within 5 s of a signal, with one of our exit codes.
fn must_end(mut child: Child, own_time: Duration, what: &str) -> Option<i32> {
    let started = Instant::now();
    while started.elapsed() < own_time && child.try_wait().unwrap().is_none() {
        thread::sleep(Duration::from_millis(5));
    }
    let is_told = child.try_wait().unwrap().is_none();
    if is_told {
        kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    }
    let status = ended(&mut child, Duration::from_secs(5)).unwrap_or_else(|| panic!("{what} goes on"));
    let by_signal = is_told && status.code().is_none();
    assert!(by_signal || matches!(status.code(), Some(0..=10 | 130)), "{what}: {status}");
    status.code()
}

/// Standard output and standard error are closed, full, or a pipe without a reader.
#[test]
#[ignore = "cargo xtask chaos"]
fn closed_outlets() {
    let scenario = Scenario::start(900);
    let device = device();
    let runs = AtomicUsize::new(0);
    let outlets: [(&str, Outlet, Outlet); 7] = [
        ("standard output full", Outlet::Full, Outlet::Nobody),
        ("standard error full", Outlet::Nobody, Outlet::Full),
        ("both full", Outlet::Full, Outlet::Full),
        ("standard output without a reader", Outlet::Broken, Outlet::Nobody),
        ("standard error without a reader", Outlet::Nobody, Outlet::Broken),
        ("both without a reader", Outlet::Broken, Outlet::Broken),
        ("all closed", Outlet::Nobody, Outlet::Nobody),
    ];
    let pairs: Vec<_> = all(device.name())
        .into_iter()
        .flat_map(|command| outlets.into_iter().map(move |outlet| (command.clone(), outlet)))
        .collect();
    each(&pairs, AT_ONCE, |(command, (name, out, errors))| {
        let folder = prepared();
        let words: Vec<&str> = command.iter().map(String::as_str).collect();
        let mut program = inerter(folder.path(), &words);
        if *name == "all closed" {
            let script = "exec \"$0\" \"$@\" <&- >&- 2>&-";
            let mut shell = Command::new("sh");
            shell.args(["-c", script]).arg(program.get_program()).args(&words).current_dir(folder.path());
            program = shell;
        }
        if *name != "all closed" {
            program.stdout(out.open()).stderr(errors.open());
        }
        let what = format!("{}, {name}", words.join(" "));
        let code = must_end(program.spawn().unwrap(), Duration::from_millis(2500), &what);
        // A command that cannot print its result must not report success. A reader that stops reading has seen enough.
        let is_result = ["replay", "info", "fit"].contains(&words[0]) && words[1] == "sent.mcap";
        match out {
            Outlet::Full if is_result => assert_eq!(code, Some(8), "{what}"),
            Outlet::Broken if is_result => assert_eq!(code, Some(0), "{what}"),
            _ => {}
        }
        runs.fetch_add(1, Ordering::Relaxed);
    });
    scenario.passed(&format!(
        "{} runs of {} commands, each with {} states of its outputs",
        runs.into_inner(),
        pairs.len() / 7,
        outlets.len()
    ));
}

/// Destination of the program's output.
#[derive(Clone, Copy)]
enum Outlet {
    Nobody,
    Full,
    /// A pipe without a reader.
    Broken,
}

impl Outlet {
    fn open(self) -> Stdio {
        match self {
            Self::Nobody => Stdio::null(),
            Self::Full => OpenOptions::new().write(true).open("/dev/full").unwrap().into(),
            Self::Broken => std::io::pipe().unwrap().1.into(),
        }
    }
}

/// The terminal disappears, and the system signals this to its programs.
#[test]
#[ignore = "cargo xtask chaos"]
fn lost_terminals() {
    let mut scenario = Scenario::start(300);
    let times = scenario.kills().div_ceil(25);
    if Command::new("setsid").arg("--version").output().is_err() {
        inerter_needs::skip("a terminal of one's own needs `setsid` (util-linux)");
        return scenario.skipped("no setsid");
    }
    let device = device();
    let commands: [&[&str]; 7] = [
        &["monitor", "--connect", device.name()],
        &["monitor", "--connect", device.name(), "--record", "m.mcap", "--force"],
        &["monitor", "--plain", "--connect", device.name()],
        &["record", "-o", "r.mcap", "--force", "--connect", device.name()],
        &["calibrate", "--connect", device.name()],
        &["simulate", "--tcp", "127.0.0.1:0"],
        &["simulate", "--duration", "100000", "-o", "s.mcap", "--force"],
    ];
    let all: Vec<_> = (0..times).flat_map(|time| commands.into_iter().map(move |command| (time, command))).collect();
    let slowest = AtomicUsize::new(0);
    each(&all, AT_ONCE, |(time, command)| {
        let folder = tempfile::tempdir().unwrap();
        let mut random = scenario.random(&format!("{command:?} {time}"));
        let (master, slave) = terminal();
        let again = || slave.try_clone().unwrap();
        let mut program = Command::new("setsid");
        program.arg("--ctty").arg(env!("CARGO_BIN_EXE_inerter")).args(*command).current_dir(folder.path());
        program.env("TERM", "xterm").stdin(again()).stdout(again()).stderr(again());
        let mut child = program.spawn().unwrap();
        drop((program, slave));
        // Read the screen until the terminal disappears.
        let mut screen = File::from(master);
        let (mut some, started) = ([0; 4096], Instant::now());
        let until_gone = Duration::from_millis(300 + random.below(1500));
        rustix::io::ioctl_fionbio(&screen, true).unwrap();
        while started.elapsed() < until_gone {
            if screen.read(&mut some).is_err() {
                thread::sleep(Duration::from_millis(5));
            }
        }
        let was_running = child.try_wait().unwrap().is_none();
        drop(screen);
        let gone = Instant::now();
        let status = ended(&mut child, Duration::from_secs(5));
        let status = status.unwrap_or_else(|| panic!("{command:?} goes on without its terminal"));
        assert!(matches!(status.code(), Some(0..=10 | 130)), "{command:?}: {status}");
        assert!(was_running, "{command:?} had ended before: {status}");
        slowest.fetch_max(gone.elapsed().as_millis() as usize, Ordering::Relaxed);
        assert!(!parts_are_left(folder.path()), "{command:?} leaves something half written");
    });
    scenario.passed(&format!("{} terminals closed; each program ended within {} ms", all.len(), slowest.into_inner()));
}

fn parts_are_left(folder: &Path) -> bool {
    std::fs::read_dir(folder).unwrap().any(|entry| entry.unwrap().path().extension().is_some_and(|end| end == "part"))
}

/// Readers that take a few bytes per second, or none: the recording loses nothing, other readers lose nothing, and
/// memory stays small.
#[test]
#[ignore = "cargo xtask chaos"]
fn slow_readers() {
    let (scenario, seconds) = (Scenario::start(300), 20_u64);
    let folder = tempfile::tempdir().unwrap();
    let device = Simulated::start(inerter(
        folder.path(),
        &["simulate", "--tcp", "127.0.0.1:0", "--json", "--sample-rate-hz", "4000"],
    ));
    let link = ["--connect", device.address.as_str()];
    let views = ["--web", "--share", "127.0.0.1:0", "--foxglove", "127.0.0.1:0"];
    let command = [&["monitor", "--json", "--record", "run.mcap"][..], &views, &link].concat();
    let mut monitor = inerter(folder.path(), &command).stderr(Stdio::null()).spawn().unwrap();
    let mut output = monitor.stdout.take().unwrap();
    let mut said = Vec::new();
    let mut some = [0; 1];
    let of = |said: &[u8], view: &str| {
        let said = text(said);
        let whole = said.rsplit_once('\n').map_or("", |(whole, _)| whole).to_string();
        let line = whole.lines().find(|line| line.contains("\"view\"") && line.contains(view)).map(last);
        line.map(|line| line["address"].as_str().unwrap().to_string())
    };
    let started = Instant::now();
    while of(&said, "page").and(of(&said, "shared device")).and(of(&said, "Foxglove")).is_none() {
        assert!(started.elapsed() < Duration::from_secs(30) && output.read(&mut some).unwrap() > 0, "{}", text(&said));
        said.push(some[0]);
    }
    // The page and Foxglove, with clients that read nothing.
    let page = of(&said, "page").unwrap().replace("http://", "ws://") + "live";
    let connect = |url: &str, protocol: Option<&str>| {
        let mut request = tungstenite::ClientRequestBuilder::new(url.parse().unwrap());
        if let Some(protocol) = protocol {
            request = request.with_sub_protocol(protocol);
        }
        let stream = TcpStream::connect(url.split('/').nth(2).unwrap()).unwrap();
        tungstenite::client(request, stream).map(|(socket, _)| socket).unwrap()
    };
    let _stuck_pages: Vec<_> = (0..3).map(|_| connect(&page, None)).collect();
    // The shared device, with one slow client, one that reads nothing, and one that must not lose anything.
    let shared = of(&said, "shared device").unwrap();
    let ask = || {
        let mut host = TcpStream::connect(&shared).unwrap();
        host.write_all(&[&[0][..], &request(1, inerter_wire::Command::Streams(Streams::ALL))].concat()).unwrap();
        host
    };
    let (mut slow, _stuck) = (ask(), ask());
    let recorder = inerter(
        folder.path(),
        &[
            "record",
            "-o",
            "beside.mcap",
            "--connect",
            &shared,
            "--duration",
            &seconds.saturating_sub(5).max(2).to_string(),
        ],
    );
    let mut recorder = { recorder }.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let started = Instant::now();
    let mut taken = 0;
    while started.elapsed() < Duration::from_secs(seconds) {
        taken += output.read(&mut some).unwrap() + slow.read(&mut some).unwrap();
        thread::sleep(Duration::from_millis(10));
        assert!(monitor.try_wait().unwrap().is_none(), "the monitor has ended");
    }
    let most_kb = memory_kb(monitor.id(), "VmHWM:").unwrap();
    assert!(recorder.wait().unwrap().success());
    kill_process(Pid::from_child(&monitor), Signal::TERM).unwrap();
    let status = ended(&mut monitor, Duration::from_secs(5)).expect("the monitor goes on after a signal");
    assert!(matches!(status.code(), Some(0 | 130)), "{status}");
    assert!(most_kb < MOST_KB, "{most_kb} kB");
    let mut samples = Vec::new();
    for name in ["run.mcap", "beside.mcap"] {
        let info = last(&done(folder.path(), &["info", name, "--json"]));
        let of = |name: &str| info[name].as_u64().unwrap();
        assert_eq!((of("lost_samples"), of("lost_frames"), of("discontinuities")), (0, 0, 0), "{name}: {info}");
        samples.push(of("samples"));
    }
    assert!(samples[0] > 4000 * (seconds - 3), "{samples:?} samples in {seconds} s");
    until("the device is gone", || TcpStream::connect(&device.address).is_ok());
    scenario.passed(&format!(
        "{seconds} s at 4 kHz, {taken} bytes read by the slow readers: {} samples recorded by `monitor` \
         and {} by `record`, none lost; `monitor` used at most {most_kb} kB",
        samples[0], samples[1]
    ));
}
