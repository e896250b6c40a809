//! Messages of USB/IP 1.1.1.
//!
//! All numbers are big-endian. A connection starts with one of two requests. After a successful import it carries
//! commands and replies of 48 bytes each, some followed by data.
//!
//! Source: Linux, Documentation/usb/usbip_protocol.rst.

use crate::usb_host::{Description, Setup, Transfer};

/// Protocol version.
const VERSION: u16 = 0x0111;
/// Length of a bus ID field \[bytes\].
const BUS_ID: usize = 32;
/// Length of a path field \[bytes\].
const PATH: usize = 256;
/// Length of a command or reply header \[bytes\].
pub const HEADER: usize = 48;
/// Full speed, in Linux's `enum usb_device_speed`.
const FULL_SPEED: u32 = 2;
/// Bus number of the only device.
const BUS: u32 = 1;
/// Number of the device on the bus.
const DEVICE: u32 = 2;
/// Bus ID of the device.
pub const BUS_NAME: &str = "1-1";
/// `URB_ZERO_PACKET`: an empty packet follows data that ends with a full one.
const ZERO_PACKET: u32 = 0x40;
/// Limit on announced data, above anything that our clients send. A peer that announces more is not a client.
const MOST_BYTES: u32 = 1 << 20;

/// A client's request: the first two at the start of a connection, the others once it has imported the device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// `OP_REQ_DEVLIST`: list the devices.
    List,
    /// `OP_REQ_IMPORT`: import the device with this bus ID.
    Import(String),
    /// Submit a transfer.
    Submit {
        /// Sequence number of the command.
        sequence: u32,
        /// Whether it is an IN transfer.
        to_host: bool,
        /// The transfer.
        transfer: Transfer,
    },
    /// Cancel a command.
    Unlink {
        /// Sequence number of this command.
        sequence: u32,
        /// Sequence number of the command to cancel.
        other: u32,
    },
}

/// An error reply to an import.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Another client has imported the device (`ST_DEV_BUSY`).
    Busy = 2,
    /// There is no device with this name, or it cannot be used (`ST_NODEV`).
    NoDevice = 4,
}

/// Data that does not follow this protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Foreign;

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..at + 4)?.try_into().ok().map(u32::from_be_bytes)
}

/// Takes a request from the front of `bytes`; none until it is complete.
pub fn take_question(bytes: &mut Vec<u8>) -> Result<Option<Request>, Foreign> {
    let Some(head) = word(bytes, 0).filter(|_| bytes.len() >= 8) else { return Ok(None) };
    if (head >> 16) as u16 != VERSION {
        return Err(Foreign);
    }
    match head as u16 {
        0x8005 => {
            bytes.drain(..8);
            Ok(Some(Request::List))
        }
        0x8003 if bytes.len() < 8 + BUS_ID => Ok(None),
        0x8003 => {
            let name: Vec<u8> = bytes.drain(..8 + BUS_ID).skip(8).take_while(|byte| *byte != 0).collect();
            Ok(Some(Request::Import(String::from_utf8_lossy(&name).into_owned())))
        }
        _ => Err(Foreign),
    }
}

/// Takes a command from the front of `bytes`; none until it is complete.
pub fn take_command(bytes: &mut Vec<u8>) -> Result<Option<Request>, Foreign> {
    let words: Option<Vec<u32>> = (0..10).map(|at| word(bytes, 4 * at)).collect();
    let (Some(words), Some(&setup)) = (words, bytes.get(40..HEADER).and_then(|eight| eight.first_chunk::<8>())) else {
        return Ok(None);
    };
    let (sequence, to_host, endpoint, flags, length) = (words[1], words[3] != 0, words[4], words[5], words[6]);
    match words[0] {
        1 if endpoint > 15 || length > MOST_BYTES => Err(Foreign),
        1 => {
            let length = length as usize;
            let behind = if to_host { 0 } else { length };
            if bytes.len() < HEADER + behind {
                return Ok(None);
            }
            let data = bytes.drain(..HEADER + behind).skip(HEADER).collect();
            let transfer = match (endpoint as u8, to_host) {
                (0, _) => Transfer::Control(Setup::from_bytes(setup), data),
                (endpoint, true) => Transfer::In(endpoint, length),
                (endpoint, false) => Transfer::Out(endpoint, data, flags & ZERO_PACKET != 0),
            };
            Ok(Some(Request::Submit { sequence, to_host, transfer }))
        }
        2 => {
            bytes.drain(..HEADER);
            Ok(Some(Request::Unlink { sequence, other: flags }))
        }
        _ => Err(Foreign),
    }
}

fn big_endian(numbers: &[u32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_be_bytes()).collect()
}

fn header(code: u16, status: u32) -> Vec<u8> {
    big_endian(&[u32::from(VERSION) << 16 | u32::from(code), status])
}

fn padded(text: &str, length: usize) -> Vec<u8> {
    let mut bytes = text.as_bytes().to_vec();
    bytes.resize(length, 0);
    bytes
}

fn device(description: &Description) -> Vec<u8> {
    let mut bytes = padded("/twin/1-1", PATH);
    bytes.extend(padded(BUS_NAME, BUS_ID));
    bytes.extend(big_endian(&[BUS, DEVICE, FULL_SPEED]));
    for number in [description.vendor, description.product_number, description.version] {
        bytes.extend(number.to_be_bytes());
    }
    bytes.extend(description.class);
    // Linux's vhci reads the configurations itself: current configuration (none), number of configurations (1).
    bytes.extend([0, 1, description.interfaces.len() as u8]);
    bytes
}

/// The reply to [`Request::List`].
pub fn list(description: Option<&Description>) -> Vec<u8> {
    let mut bytes = header(0x0005, 0);
    bytes.extend(u32::from(description.is_some()).to_be_bytes());
    if let Some(description) = description {
        bytes.extend(device(description));
        for [_, class, subclass, protocol] in &description.interfaces {
            bytes.extend([*class, *subclass, *protocol, 0]);
        }
    }
    bytes
}

/// The reply to [`Request::Import`].
pub fn imported(description: Result<&Description, Refusal>) -> Vec<u8> {
    match description {
        Ok(description) => [header(0x0003, 0), device(description)].concat(),
        Err(refusal) => header(0x0003, refusal as u32),
    }
}

fn returned(code: u32, sequence: u32, status: i32, moved: usize) -> Vec<u8> {
    big_endian(&[code, sequence, 0, 0, 0, status as u32, moved as u32, 0, 0, 0, 0, 0])
}

/// The reply to [`Request::Submit`]: Linux error number or 0, number of bytes transferred, and the data for the host.
pub fn submitted(sequence: u32, status: i32, moved: usize, data: &[u8]) -> Vec<u8> {
    let mut bytes = returned(3, sequence, status, moved);
    bytes.extend_from_slice(data);
    bytes
}

/// The reply to [`Request::Unlink`].
pub fn unlinked(sequence: u32, status: i32) -> Vec<u8> {
    returned(4, sequence, status, 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(words: &[u32]) -> Vec<u8> {
        words.iter().flat_map(|word| word.to_be_bytes()).collect()
    }

    /// A submit of three bytes to endpoint 2, as Linux sends it.
    fn submit() -> Vec<u8> {
        let mut bytes = numbers(&[1, 7, 0x1_0002, 0, 2, ZERO_PACKET, 3, 0, 0, 0]);
        bytes.extend([0; 8]);
        bytes.extend(b"abc");
        bytes
    }

    #[test]
    fn commands_come_in_any_portions() {
        let whole = submit();
        for cut in 0..whole.len() {
            let mut bytes = whole[..cut].to_vec();
            assert_eq!(take_command(&mut bytes), Ok(None));
            assert_eq!(bytes.len(), cut, "nothing is taken before it is complete");
        }
        let mut bytes = [whole.clone(), whole].concat();
        for left in [51, 0] {
            let Ok(Some(Request::Submit { sequence: 7, to_host: false, transfer: Transfer::Out(2, data, true) })) =
                take_command(&mut bytes)
            else {
                panic!("expected a submit command")
            };
            assert_eq!((data.as_slice(), bytes.len()), (b"abc".as_slice(), left));
        }
    }

    #[test]
    fn a_read_carries_no_bytes() {
        let setup = Setup { kind: 0x80, request: 6, value: 0x100, index: 0, length: 18 };
        for (endpoint, transfer) in [(0, Transfer::Control(setup, vec![])), (1, Transfer::In(1, 128))] {
            let mut bytes = numbers(&[1, 8, 0x1_0002, 1, endpoint, 0, 128, 0, 0, 0]);
            bytes.extend([0x80, 6, 0, 1, 0, 0, 18, 0]);
            let expected = Request::Submit { sequence: 8, to_host: true, transfer };
            assert_eq!(take_command(&mut bytes), Ok(Some(expected)));
            assert!(bytes.is_empty());
        }
    }

    #[test]
    fn what_is_not_of_the_protocol_is_refused() {
        let mut wrong = submit();
        wrong[3] = 9;
        assert!(take_command(&mut wrong).is_err());
        let mut wrong = submit();
        wrong[19] = 16;
        assert!(take_command(&mut wrong).is_err());
        let mut wrong = submit();
        wrong[24] = 0xFF;
        assert!(take_command(&mut wrong).is_err());
        assert!(take_question(&mut b"GET / HTTP/1.1\r\n".to_vec()).is_err());
        assert!(take_question(&mut numbers(&[0x0111_8004, 0])).is_err());
    }

    #[test]
    fn questions_are_understood() {
        assert_eq!(take_question(&mut numbers(&[0x0111_8005, 0])), Ok(Some(Request::List)));
        let mut import = numbers(&[0x0111_8003, 0]);
        assert_eq!(take_question(&mut import), Ok(None));
        import.extend(padded("1-1", BUS_ID));
        assert_eq!(take_question(&mut import), Ok(Some(Request::Import("1-1".into()))));
        assert!(import.is_empty());
    }

    #[test]
    fn answers_have_the_lengths_that_linux_expects() {
        assert_eq!(imported(Err(Refusal::Busy)), numbers(&[0x0111_0003, 2]));
        assert_eq!(list(None), numbers(&[0x0111_0005, 0, 0]));
        assert_eq!(unlinked(5, -104).len(), HEADER);
        assert_eq!(submitted(5, 0, 3, b"abc").len(), HEADER + 3);
    }
}
