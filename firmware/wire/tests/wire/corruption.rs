//! No damage yields a wrong record: single bytes are tested exhaustively, other damage in hundreds of thousands of
//! cases.
//!
//! Each case damages a stream of numbered frames with known content. Every message that the reader returns must be the
//! record sent under that number, in order. Undamaged frames must arrive. Messages and reported losses together must
//! account for every frame.

use crate::frames::{framed, read, read_all};
use crate::reference::line_bytes;
use crate::values::{records, requests, some_record};
use inerter_needs::Random;
use inerter_wire::*;
use std::fmt::Debug;
use std::ops::Range;

/// Numbered messages and where their frames lie in the stream, delimiters included.
struct Stream<T> {
    bytes: Vec<u8>,
    frames: Vec<(T, Range<usize>)>,
    first: u16,
}

impl<T: Message + PartialEq + Debug> Stream<T> {
    fn new(messages: Vec<T>, first: u16) -> Self {
        let mut bytes = Vec::new();
        let mut frames = Vec::new();
        for (place, message) in messages.into_iter().enumerate() {
            let start = bytes.len();
            bytes.extend(framed(&message, first.wrapping_add(place as u16)));
            frames.push((message, start..bytes.len()));
        }
        Self { bytes, frames, first }
    }

    /// Reads `damaged` and checks all these properties; `touched` is the changed part of the original. Returns the
    /// number of frames that were not delivered.
    fn check(&self, damaged: &[u8], touched: Range<usize>) -> usize {
        let mut delivered = vec![false; self.frames.len()];
        let (mut next, mut started) = (0, false);
        for frame in read_all::<T>(damaged) {
            match frame {
                Frame::Message { sequence, message } => {
                    let place = usize::from(sequence.wrapping_sub(self.first));
                    assert_eq!(self.frames.get(place).map(|(sent, _)| sent), Some(&message), "a wrong record");
                    if started {
                        assert_eq!(place, next, "out of order, or lost and not reported");
                    }
                    delivered[place] = true;
                    (next, started) = (place + 1, true);
                }
                Frame::Lost { frames } => next += usize::from(frames),
                Frame::Corrupt(_) => {}
                other => panic!("{other:?} out of damage"),
            }
        }
        for (place, (_, range)) in self.frames.iter().enumerate() {
            // The delimiter before a frame belongs to it as much as the one that ends it.
            let apart = range.end <= touched.start || range.start > touched.end;
            assert!(delivered[place] || !apart, "frame {place} at {range:?} was lost to damage at {touched:?}");
        }
        delivered.iter().filter(|delivered| !**delivered).count()
    }
}

fn exhaust<T: Message + PartialEq + Debug + Clone>(messages: &[T]) -> usize {
    let mut cases = 0;
    for (place, message) in messages.iter().enumerate() {
        let neighbour = &messages[(place + 7) % messages.len()];
        let stream = Stream::new(vec![neighbour.clone(), message.clone(), neighbour.clone()], 1_000);
        let mut damaged = stream.bytes.clone();
        for at in stream.frames[1].1.clone() {
            for change in 1..=255 {
                damaged[at] = stream.bytes[at] ^ change;
                let missing = stream.check(&damaged, at..at + 1);
                // A changed delimiter joins two frames; any other changed byte costs at most its own frame.
                let most = if stream.bytes[at] == DELIMITER { 2 } else { 1 };
                assert!(missing <= most, "{missing} frames lost to byte {at}");
                cases += 1;
            }
            damaged[at] = stream.bytes[at];
        }
    }
    cases
}

/// Every byte of every golden frame, changed to every other value.
#[test]
fn every_single_byte() {
    let mut all: Vec<Record> = records().into_iter().map(|(_, record)| record).collect();
    // These announce a restart; otherwise their frames are like any other.
    all.retain(|record| !matches!(record, Record::Event(Event { kind: EventKind::Started, .. }) | Record::Hello(_)));
    let cases = exhaust(&all) + exhaust(&requests().into_iter().map(|(_, request)| request).collect::<Vec<_>>());
    assert!(cases >= 200_000, "{cases}");
}

/// A Hello states the wire version: damage must not yield another one.
#[test]
fn every_single_byte_of_a_hello() {
    let hello = Record::Hello(crate::values::hello());
    let sent = framed(&hello, 9);
    for at in 0..sent.len() {
        for change in 1..=255 {
            let mut damaged = sent.clone();
            damaged[at] ^= change;
            for frame in read_all::<Record>(&damaged) {
                match frame {
                    Frame::Corrupt(_) => {}
                    Frame::Message { sequence: 9, message } if message == hello => {}
                    other => panic!("{other:?}"),
                }
            }
        }
    }
}

/// Kinds of damage to a stream.
enum Damage {
    Byte,
    Bits,
    Burst,
    Hole,
    End,
    Garbage,
    Twice,
}

/// Longer frames, wrapping sequence numbers, and every kind of damage, 140 000 times.
#[test]
fn any_damage() {
    let mut numbers = Random(2);
    let mut missing = [0; 7];
    for _ in 0..2_000 {
        let messages = (0..5).map(|_| some_record(&mut numbers)).collect();
        let stream = Stream::new(messages, numbers.draw() as u16);
        let length = stream.bytes.len();
        for case in 0..70 {
            let mut damaged = stream.bytes.clone();
            let at = numbers.below(length);
            let damage =
                [Damage::Byte, Damage::Bits, Damage::Burst, Damage::Hole, Damage::End, Damage::Garbage, Damage::Twice];
            let touched = match damage[case % 7] {
                Damage::Byte => {
                    damaged[at] ^= 1 + numbers.below(255) as u8;
                    at..at + 1
                }
                Damage::Bits => {
                    damaged[at] ^= 1 << numbers.below(8);
                    damaged[at] ^= 1 << numbers.below(8);
                    at..at + 1
                }
                Damage::Burst => {
                    let end = (at + 1 + numbers.below(30)).min(length);
                    for byte in &mut damaged[at..end] {
                        *byte = numbers.draw() as u8 >> numbers.below(8);
                    }
                    at..end
                }
                Damage::Hole => {
                    let end = (at + 1 + numbers.below(300)).min(length);
                    damaged.drain(at..end);
                    at..end
                }
                Damage::End => {
                    damaged.truncate(at);
                    at..length
                }
                Damage::Garbage => {
                    // Inserted between frames, as by a boot loader or an aborted write; sometimes longer than any
                    // frame.
                    let at = stream.frames[numbers.below(5)].1.start;
                    let longest = if numbers.below(4) == 0 { 2 * MAX_FRAME } else { 40 };
                    damaged.splice(at..at, line_bytes(&mut numbers, longest));
                    at..at
                }
                Damage::Twice => {
                    // A stretch repeated in place of what followed, at arbitrary cuts.
                    let end = (at + 1 + numbers.below(60)).min(length);
                    let source = numbers.below(length - (end - at) + 1);
                    let again = stream.bytes[source..source + (end - at)].to_vec();
                    // A repeated whole frame would be an intact frame, and count as a restart.
                    if !again.contains(&DELIMITER) {
                        damaged.splice(at..end, again);
                    }
                    at..end
                }
            };
            missing[case % 7] += stream.check(&damaged, touched);
        }
    }
    // Every kind of damage cost frames, and most frames survived (100 000 were sent for each kind).
    assert!(missing.iter().all(|missing| (5_000..90_000).contains(missing)), "{missing:?}");
}

/// Garbage alone contains no message.
#[test]
fn garbage_holds_nothing() {
    let mut numbers = Random(4);
    let mut records = FrameReader::<Record>::new();
    let mut requests = FrameReader::<Request>::new();
    for _ in 0..100_000 {
        let garbage = line_bytes(&mut numbers, 100);
        for frame in read(&mut records, &garbage) {
            assert!(matches!(frame, Frame::Corrupt(_)), "{frame:?}");
        }
        for frame in read(&mut requests, &garbage) {
            assert!(matches!(frame, Frame::Corrupt(_)), "{frame:?}");
        }
    }
    assert!(records.counts().corrupt() > 100_000);
    assert_eq!(records.counts().messages, 0);
}
