//! A second implementation of the framing from its description, without shared code, and random data typical of a
//! serial line.

use inerter_needs::Random;

/// CRC-32 (ISO-HDLC), bit by bit.
pub fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    for &byte in bytes {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 };
        }
    }
    !crc
}

/// Zero stuffing: each run up to a zero, and each run of 254 bytes, is preceded by its length plus one.
pub fn stuff(body: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut run = Vec::new();
    for &byte in body {
        if byte == 0 {
            out.push(run.len() as u8 + 1);
            out.append(&mut run);
        } else {
            run.push(byte);
            if run.len() == 254 {
                out.push(255);
                out.append(&mut run);
            }
        }
    }
    out.push(run.len() as u8 + 1);
    out.append(&mut run);
    out
}

/// The complete frame of a record's payload.
pub fn frame(payload: &[u8], sequence: u16) -> Vec<u8> {
    salted_frame(payload, sequence, 0)
}

/// The complete frame of a request's payload.
pub fn request_frame(payload: &[u8], sequence: u16) -> Vec<u8> {
    salted_frame(payload, sequence, u32::MAX)
}

fn salted_frame(payload: &[u8], sequence: u16, salt: u32) -> Vec<u8> {
    let mut body = payload.to_vec();
    body.extend(sequence.to_le_bytes());
    body.extend((crc32(&body) ^ salt).to_le_bytes());
    let mut out = stuff(&body);
    out.push(0);
    out
}

/// Up to `longest` bytes. About every eighth is zero, as on a bad line.
pub fn line_bytes(random: &mut Random, longest: usize) -> Vec<u8> {
    let length = random.below(longest + 1);
    (0..length).map(|_| if random.below(8) == 0 { 0 } else { random.draw() as u8 }).collect()
}

/// A small, large or extreme difference.
pub fn step(random: &mut Random) -> i32 {
    let bits = random.below(32);
    (random.draw() as i32) >> bits
}

#[test]
fn check_values() {
    assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    assert_eq!(stuff(&[]), [1]);
    assert_eq!(stuff(&[0]), [1, 1]);
    assert_eq!(stuff(&[0x11, 0x22, 0, 0x33]), [3, 0x11, 0x22, 2, 0x33]);
    assert_eq!(stuff(&[7; 254])[..2], [255, 7]);
    assert_eq!(stuff(&[7; 254])[255..], [1]);
    assert_eq!(stuff(&[7; 255])[255..], [2, 7]);
}
