//! Hosts that connect to the virtual device and disconnect.

use std::{
    fs,
    io::{BufRead, BufReader, ErrorKind, Read, Write},
    net::TcpStream,
    process::{Child, Command as Program},
    thread,
    time::{Duration, Instant},
};

use inerter_wire::{Command, Frame, FrameReader, Record, Streams};
use rustix::process::{Pid, Signal, kill_process};

use crate::{
    common::{
        done, inerter, last, run, text,
        unruly::{ended, memory_kb, request},
    },
    scenario::{MOST_KB, Scenario},
};

/// A virtual device in its own process, which prints its address.
pub struct Simulated {
    pub child: Child,
    pub address: String,
}

impl Simulated {
    pub fn start(mut command: Program) -> Self {
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = last(&line)["address"].as_str().unwrap().to_string();
        Self { child, address }
    }

    fn memory_kb(&self) -> u64 {
        memory_kb(self.child.id(), "VmRSS:").unwrap()
    }

    fn files(&self) -> usize {
        fs::read_dir(format!("/proc/{}/fd", self.child.id())).unwrap().count()
    }

    /// Number of open files, once closed connections have disappeared.
    fn settled_files(&self, usual: usize) -> usize {
        let started = Instant::now();
        while self.files() > usual && started.elapsed() < Duration::from_secs(10) {
            thread::sleep(Duration::from_millis(20));
        }
        self.files()
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// One connection. Returns whether the device answered.
fn visit(address: &str, manner: u64) -> bool {
    let mut host = loop {
        match TcpStream::connect(address) {
            Ok(host) => break host,
            // All ports are in use for a moment.
            Err(error) if error.kind() == ErrorKind::AddrNotAvailable => thread::sleep(Duration::from_millis(100)),
            Err(error) => panic!("{error}"),
        }
    };
    host.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let asked = match manner {
        // Sends nothing.
        0 => return false,
        // Half a request.
        1 => host.write_all(&request(1, Command::Hello)[..3]).map(|()| false),
        2 => host.write_all(&[0xFF; 600]).map(|()| false),
        // Does not wait for the data it requested.
        3 => host.write_all(&request(1, Command::Streams(Streams::ALL))).map(|()| false),
        _ => host.write_all(&[&[0][..], &request(1, Command::Hello)].concat()).map(|()| true),
    };
    if !asked.unwrap_or(false) {
        return false;
    }
    let (mut reader, mut some) = (FrameReader::<Record>::new(), [0; 512]);
    // The device turns a surplus host away.
    while let Ok(count @ 1..) = host.read(&mut some) {
        let mut input = &some[..count];
        while let Some(frame) = reader.read(&mut input) {
            if matches!(frame, Frame::Message { message: Record::Hello(_), .. }) {
                return true;
            }
        }
    }
    false
}

/// Memory and open files of the device stay constant.
#[test]
#[ignore = "cargo xtask chaos"]
fn cycles() {
    let mut scenario = Scenario::start(600);
    let cycles = scenario.cycles();
    let folder = tempfile::tempdir().unwrap();
    let mut device = Simulated::start(inerter(folder.path(), &["simulate", "--tcp", "127.0.0.1:0", "--json"]));
    let mut random = scenario.random("cycles");
    let mut answered = 0;
    let mut go = |count: u64| {
        for _ in 0..count {
            answered += u64::from(visit(&device.address, random.below(10)));
        }
    };
    let files = device.files();
    go(cycles / 10);
    let (memory, grown_files) = (device.memory_kb(), device.settled_files(files));
    go(cycles - cycles / 10);
    let (memory_after, files_after) = (device.memory_kb(), device.settled_files(files));
    assert!(answered > cycles / 2, "only {answered} of {cycles} were answered");
    assert_eq!((grown_files, files_after), (files, files), "files that the device has open");
    assert!(memory_after < MOST_KB && memory_after * 20 <= memory * 21, "memory: {memory} kB, then {memory_after} kB");
    // The device works as before.
    let started = Instant::now();
    done(folder.path(), &["settings", "get", "--connect", &device.address]);
    let output = run(folder.path(), &["record", "-o", "run.mcap", "--connect", &device.address, "--duration", "1"]);
    assert!(output.status.success() && text(&output.stderr).contains("none lost"), "{}", text(&output.stderr));
    assert!(started.elapsed() < Duration::from_secs(20));
    kill_process(Pid::from_child(&device.child), Signal::TERM).unwrap();
    let status = ended(&mut device.child, Duration::from_secs(5)).expect("the device goes on after a signal");
    assert!(matches!(status.code(), Some(0 | 130)), "{status}");
    scenario.passed(&format!(
        "{cycles} hosts connected and disconnected, {answered} got an answer; memory {memory} kB after a tenth, \
         {memory_after} kB at the end; {files} open files at the start and at the end"
    ));
}
