//! Messages to bytes and back, by the crate itself.

use inerter_wire::*;

/// The frame of a message.
pub fn framed<T: Message>(message: &T, sequence: u16) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = encode(message, sequence, &mut out).unwrap();
    out[..length].to_vec()
}

/// The payload of a message, or a part of one.
pub fn payload<T: serde::Serialize>(value: &T) -> Vec<u8> {
    let mut out = [0; MAX_PAYLOAD];
    postcard::to_slice(value, &mut out).unwrap().to_vec()
}

/// What a reader finds in these bytes.
pub fn read<T: Message>(reader: &mut FrameReader<T>, bytes: &[u8]) -> Vec<Frame<T>> {
    let mut input = bytes;
    let found = std::iter::from_fn(|| reader.read(&mut input)).collect();
    assert!(input.is_empty());
    found
}

/// What a new reader finds in these bytes.
pub fn read_all<T: Message>(bytes: &[u8]) -> Vec<Frame<T>> {
    read(&mut FrameReader::new(), bytes)
}

/// What a reader makes of an intact frame.
pub fn intact<T>(message: T, sequence: u16) -> Frame<T> {
    Frame::Message { sequence, message }
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}
