//! A message that returns to its sender is never mistaken for one from the other end.
//!
//! A newly opened terminal echoes, so a device receives its own records, complete or truncated. A loop-back returns a
//! host's own requests.

use crate::frames::{framed, intact, read_all};
use crate::reference;
use crate::values::{records, requests, some_record};
use inerter_needs::Random;
use inerter_wire::*;
use proptest::prelude::*;
use std::fmt::Debug;

fn is_refused<T: Message + Debug>(bytes: &[u8]) {
    for frame in read_all::<T>(bytes) {
        assert!(matches!(frame, Frame::Corrupt(_)), "{frame:?}");
    }
}

/// Every golden, whole and from every byte on, with sequence numbers with and without zero bytes.
#[test]
fn no_golden_is_taken_for_the_other_direction() {
    for sequence in [0, 1, 0x0100, 0x0102, 0x7FFF, 0x8000, 0xFFFF] {
        for (_, record) in records() {
            let frame = framed(&record, sequence);
            assert_eq!(read_all::<Record>(&frame).len(), 1);
            assert_eq!(read_all::<Request>(&frame), [Frame::Corrupt(Corruption::Checksum)]);
            (1..frame.len()).for_each(|start| is_refused::<Request>(&frame[start..]));
        }
        for (_, request) in requests() {
            let frame = framed(&request, sequence);
            assert_eq!(read_all::<Request>(&frame).len(), 1);
            assert_eq!(read_all::<Record>(&frame), [Frame::Corrupt(Corruption::Checksum)]);
            (1..frame.len()).for_each(|start| is_refused::<Record>(&frame[start..]));
        }
    }
}

/// A payload that decodes either way: only the CRC distinguishes the directions.
#[test]
fn a_payload_that_is_both_a_record_and_a_request_is_told_apart() {
    let both = [5, 5, 0, 1, 1, 1];
    let record = Record::Reply(Reply { id: 5, result: Ok(Done::Injected { accepted: 1, free: 1 }) });
    let streams = Streams { samples: false, estimates: true, sums: true, health: true };
    let request = Request { id: 5, command: Command::Streams(streams) };
    assert_eq!(postcard::from_bytes(&both), Ok(record.clone()));
    assert_eq!(postcard::from_bytes(&both), Ok(request.clone()));
    let (sent_record, sent_request) = (framed(&record, 9), framed(&request, 9));
    assert_eq!(read_all(&sent_record), [intact(record, 9)]);
    assert_eq!(read_all(&sent_request), [intact(request, 9)]);
    is_refused::<Request>(&sent_record);
    is_refused::<Record>(&sent_request);
}

proptest! {
    /// For any payload and any sequence number, at most one direction accepts it.
    #[test]
    fn no_payload_is_believed_in_both_directions(
        payload in prop::collection::vec(any::<u8>(), 1..MAX_PAYLOAD),
        sequence: u16,
    ) {
        is_refused::<Request>(&reference::frame(&payload, sequence));
        is_refused::<Record>(&reference::request_frame(&payload, sequence));
    }

    /// A stream of records echoed in pieces and modified by a terminal: bytes omitted, changed or inserted.
    #[test]
    fn an_echoed_stream_holds_no_request(seed: u64, cuts in prop::collection::vec((0usize..4000, any::<u8>()), 0..6)) {
        let mut numbers = Random(seed);
        let mut stream: Vec<u8> = (0..20).flat_map(|place| framed(&some_record(&mut numbers), place)).collect();
        for (at, byte) in cuts {
            let at = at % stream.len();
            match byte % 3 {
                0 => drop(stream.remove(at)),
                1 => stream.insert(at, byte),
                _ => stream[at] = byte,
            }
        }
        is_refused::<Request>(&stream);
    }
}
