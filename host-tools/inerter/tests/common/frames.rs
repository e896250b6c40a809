//! Frames that our devices never send.

use inerter_wire::{Capabilities, ClockSource, Hello, MAX_FRAME, Record, encode_record};

/// The Hello of a device that speaks wire version 7, without its delimiter.
pub fn foreign_hello() -> Vec<u8> {
    let hello = Hello {
        wire_version: 7,
        firmware: Hello::text("from the future"),
        git: Hello::text(""),
        board: Hello::text("board"),
        serial: Hello::text("1"),
        sample_rate_hz: 1000.0,
        clock: ClockSource::Crystal,
        capabilities: Capabilities::NONE,
    };
    let mut out = [0; MAX_FRAME];
    let length = encode_record(&Record::Hello(hello), 0, &mut out).unwrap();
    out.get(..length - 1).unwrap().to_vec()
}
