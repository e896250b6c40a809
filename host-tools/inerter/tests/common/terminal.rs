//! A terminal, and a simulated person who presses Enter at every question.

#![allow(dead_code, reason = "each test file uses its part")]

use std::{
    os::fd::OwnedFd,
    sync::{Arc, Mutex},
    thread,
    time::Duration,
};

use rustix::{fs, io, pty};

/// A terminal: the person's end and the program's end.
pub fn terminal() -> (OwnedFd, OwnedFd) {
    let master = pty::openpt(pty::OpenptFlags::RDWR | pty::OpenptFlags::NOCTTY).unwrap();
    io::fcntl_setfd(&master, io::FdFlags::CLOEXEC).unwrap();
    pty::grantpt(&master).unwrap();
    pty::unlockpt(&master).unwrap();
    let name = pty::ptsname(&master, Vec::new()).unwrap();
    let flags = fs::OFlags::RDWR | fs::OFlags::NOCTTY | fs::OFlags::CLOEXEC;
    let terminal = fs::open(name.as_c_str(), flags, fs::Mode::empty()).unwrap();
    (master, terminal)
}

/// The terminal of such a person, and what it has shown so far. The person leaves when the last program closes the
/// terminal.
pub fn patient() -> (OwnedFd, Arc<Mutex<Vec<u8>>>) {
    let (person, terminal) = terminal();
    let (reader, shown) = (person.try_clone().unwrap(), Arc::new(Mutex::new(Vec::new())));
    let all = shown.clone();
    thread::spawn(move || {
        let mut some = [0; 4096];
        while let Ok(count) = io::read(&reader, &mut some) {
            all.lock().unwrap().extend_from_slice(&some[..count]);
        }
    });
    thread::spawn(move || {
        while io::write(&person, b"\n").is_ok() {
            thread::sleep(Duration::from_millis(100));
        }
    });
    (terminal, shown)
}

/// The output without the control sequences that the program applies to its own line, and with plain line ends.
pub fn spoken(shown: &str) -> String {
    let mut words = shown.replace("\r\n", "\n").replace('\r', "\n");
    for own in ["\u{1b}[2K", "\u{1b}[K", "\u{1b}[1A", "\u{1b}[?25h", "\u{1b}[?25l"] {
        words = words.replace(own, "");
    }
    words
}

/// The text of a full screen, without the control sequences with which the program places and styles it.
pub fn drawn(shown: &str) -> String {
    let mut parts = shown.split("\u{1b}[");
    let mut words = parts.next().unwrap_or_default().to_string();
    for part in parts {
        let rest = part.trim_start_matches(|letter: char| letter.is_ascii_digit() || letter == ';' || letter == '?');
        match rest.strip_prefix(['H', 'J', 'h', 'l', 'm']) {
            Some(text) => words += text,
            None => words += &["\u{1b}[", part].concat(),
        }
    }
    words
}
