//! Untrusted text and devices that bring it, for tests.

use inerter_core::Settings;
use inerter_data::{output::OutputError, words::printable};
use inerter_device::{Port, dfu::DfuDevice};
use inerter_wire::{Capabilities, ClockSource, Event, EventKind, Hello, WIRE_VERSION};

use crate::monitor::feed::{Item, Moment};

/// Writes the clipboard, forges a line, changes the writing direction, sets a colour with a single character, and hides
/// a character by itself and one behind a letter.
pub const WORDS: &str = "\u{1b}]52;c;aGk=\u{7}\nforged\u{202e}\u{9b}31m\u{200b}x\u{e0041}";

/// The same as it may reach a terminal.
pub const SHOWN: &str = r"\u001b]52;c;aGk=\u0007\nforged\u202e\u009b31m\u200bx\udb40\udc41";

/// What is printed as text and as JSON; no line of it writes to the terminal what it likes.
pub fn printed(print: impl Fn(bool, &mut Vec<u8>) -> Result<(), OutputError>) -> [String; 2] {
    [false, true].map(|json| {
        let mut out = Vec::new();
        print(json, &mut out).unwrap();
        let text = String::from_utf8(out).unwrap();
        for line in text.lines() {
            assert_eq!(printable(line), line);
        }
        text
    })
}

/// A debug probe at this port, with such names.
pub fn probe(port: &str) -> Port {
    let (product, serial) = (Some(WORDS.into()), Some(WORDS.into()));
    Port { port: port.into(), inerter: false, stlink: true, product, serial, vid: Some(0x0483), pid: Some(0x374E) }
}

/// A board in update mode, with such names.
pub fn board() -> DfuDevice {
    DfuDevice { product: Some(WORDS.into()), serial: WORDS.into(), vid: 0x0483, pid: 0xDF11 }
}

/// A device with these names.
pub fn hello(firmware: &str, board: &str, serial: &str, sample_rate_hz: f64) -> Hello {
    Hello {
        wire_version: WIRE_VERSION,
        firmware: Hello::text(firmware),
        git: Hello::text(""),
        board: Hello::text(board),
        serial: Hello::text(serial),
        sample_rate_hz,
        clock: ClockSource::Crystal,
        capabilities: Capabilities::NONE,
    }
}

/// What a monitor may see, with these settings: every text in it is such words.
pub fn monitored(settings: Settings, at: Moment) -> [Item; 6] {
    let hello = Hello { git: Hello::text(WORDS), ..hello(WORDS, WORDS, WORDS, settings.sample_rate_hz) };
    let panic = Event { index: 0, kind: EventKind::Panicked(Hello::text(WORDS)) };
    [
        Item::Device { port: WORDS.into(), hello, settings },
        Item::Event { at, t_s: None, event: panic },
        Item::Refused { words: WORDS.into() },
        Item::Marker { at, t_s: None, text: WORDS.into() },
        Item::Back { port: WORDS.into() },
        Item::Away { reason: WORDS.into() },
    ]
}
