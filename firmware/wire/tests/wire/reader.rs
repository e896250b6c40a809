//! The reader's results: losses, restarts, other versions, kinds of damage.

use crate::frames::{self, framed, intact, read};
use crate::reference::{self, line_bytes};
use crate::values::{hello, longest_samples, records, requests, some_record};
use inerter_needs::Random;
use inerter_wire::*;
use proptest::prelude::*;

fn health(sequence: u16) -> Vec<u8> {
    framed(&Record::Health(Health::default()), sequence)
}

fn healthy(sequence: u16) -> Frame<Record> {
    intact(Record::Health(Health::default()), sequence)
}

fn read_all(parts: &[Vec<u8>]) -> (Vec<Frame<Record>>, Counts) {
    let mut reader = FrameReader::new();
    let found = read(&mut reader, &parts.concat());
    (found, *reader.counts())
}

#[test]
fn delimiters_alone_are_nothing() {
    assert_eq!(read_all(&[vec![0; 2000]]), (vec![], Counts::default()));
    let (found, _) = read_all(&[vec![0, 0, 0], health(7), vec![0], health(8), vec![0]]);
    assert_eq!(found, [healthy(7), healthy(8)]);
}

#[test]
fn jumps_are_losses() {
    // A reader that joins in the middle of a stream does not count earlier frames as lost.
    let (found, counts) = read_all(&[health(40_000), health(40_001)]);
    assert_eq!((found, counts.lost), (vec![healthy(40_000), healthy(40_001)], 0));

    let (found, counts) = read_all(&[health(5), health(6), health(10)]);
    assert_eq!(found, [healthy(5), healthy(6), Frame::Lost { frames: 3 }, healthy(10)]);
    assert_eq!((counts.lost, counts.messages, counts.corrupt()), (3, 3, 0));

    // Across the wrap of the sequence number, with and without loss.
    let (found, _) = read_all(&[health(65_534), health(65_535), health(0), health(2)]);
    assert_eq!(found, [healthy(65_534), healthy(65_535), healthy(0), Frame::Lost { frames: 1 }, healthy(2)]);

    // The largest loss that does not count as a restart.
    let (found, counts) = read_all(&[health(0), health(1 + 32_767)]);
    assert_eq!(found, [healthy(0), Frame::Lost { frames: 32_767 }, healthy(32_768)]);
    assert_eq!(counts.lost, 32_767);

    // The sender's counter also counts what it drops.
    let mut sequence = SequenceCounter::new();
    let first = health(sequence.take());
    sequence.take();
    let (found, _) = read_all(&[first, health(sequence.take())]);
    assert_eq!(found, [healthy(0), Frame::Lost { frames: 1 }, healthy(2)]);
}

#[test]
fn steps_back_are_restarts() {
    for (before, after) in [(100, 0), (100, 99), (100, 100), (0, 32_769), (5, 65_535)] {
        let (found, counts) = read_all(&[health(before), health(after), health(after.wrapping_add(1))]);
        let expected = [healthy(before), Frame::Restarted, healthy(after), healthy(after.wrapping_add(1))];
        assert_eq!(found, expected, "{before} then {after}");
        assert_eq!((counts.restarts, counts.lost, counts.messages), (1, 0, 3));
    }
}

#[test]
fn a_start_is_no_loss() {
    let started = Record::Event(Event { index: 0, kind: EventKind::Started });
    let greeting = Record::Hello(hello());
    // Counted forwards, 65 000 to 0 would be 535 frames lost.
    let (found, counts) = read_all(&[health(65_000), framed(&greeting, 0), framed(&started, 1)]);
    assert_eq!(found, [healthy(65_000), Frame::Restarted, intact(greeting.clone(), 0), intact(started.clone(), 1)]);
    assert_eq!((counts.restarts, counts.lost), (1, 0));

    // The Hello itself was lost.
    let (found, _) = read_all(&[health(65_000), framed(&started, 1)]);
    assert_eq!(found, [healthy(65_000), Frame::Restarted, intact(started, 1)]);

    // A Hello in the middle of a stream is like any other record, even at the wrap of the sequence number.
    let (found, counts) = read_all(&[health(9), framed(&greeting, 11), health(12)]);
    assert_eq!(found, [healthy(9), Frame::Lost { frames: 1 }, intact(greeting.clone(), 11), healthy(12)]);
    assert_eq!(counts.restarts, 0);
    let (found, counts) = read_all(&[health(65_535), framed(&greeting, 0)]);
    assert_eq!((found, counts.restarts), (vec![healthy(65_535), intact(greeting, 0)], 0));

    // A host that restarts begins with Command::Hello.
    let request = |sequence, command| framed(&Request { id: 1, command }, sequence);
    let bytes = [request(65_000, Command::Tare), request(0, Command::Hello), request(1, Command::Tare)].concat();
    let found = frames::read_all::<Request>(&bytes);
    assert_eq!(found.len(), 4);
    assert_eq!(found[1], Frame::Restarted);
    // Another command with number 0, or a Hello with another number, is an ordinary frame after a loss.
    for (sequence, command) in [(0_u16, Command::Tare), (9, Command::Hello)] {
        let bytes = [request(sequence.wrapping_sub(3), Command::Tare), request(sequence, command)].concat();
        let found = frames::read_all::<Request>(&bytes);
        assert_eq!(found[1], Frame::Lost { frames: 2 }, "{sequence}");
    }
}

#[test]
fn an_announced_frame_needs_no_more_bytes() {
    let mut reader = FrameReader::new();
    assert_eq!(read(&mut reader, &health(0)), [healthy(0)]);
    let bytes = health(2);
    let mut input = &bytes[..];
    assert_eq!(reader.read(&mut input), Some(Frame::Lost { frames: 1 }));
    assert_eq!(reader.frame_bytes(), &bytes[..bytes.len() - 1]);
    assert_eq!(reader.read(&mut &[][..]), Some(healthy(2)));
    assert_eq!(reader.frame_bytes(), &bytes[..bytes.len() - 1]);
    assert_eq!(reader.read(&mut &[][..]), None);
}

#[test]
fn frame_bytes_are_the_frame_as_received() {
    let mut numbers = Random(3);
    let mut reader = FrameReader::<Record>::new();
    assert!(reader.frame_bytes().is_empty());
    for sequence in 0..500 {
        let bytes = framed(&some_record(&mut numbers), sequence);
        let mut input = &bytes[..];
        assert!(matches!(reader.read(&mut input), Some(Frame::Message { .. })));
        assert_eq!(reader.frame_bytes(), &bytes[..bytes.len() - 1]);
        assert_eq!(reader.unfinished(), 0);
    }
    let bytes = health(500);
    assert_eq!(reader.read(&mut &bytes[..5]), None);
    assert_eq!((reader.frame_bytes(), reader.unfinished()), (&[][..], 5));
}

#[test]
fn unknown_variants_are_named_and_left_out() {
    let next = Record::TABLE.len() as u8;
    let newer = reference::frame(&[next, 1, 2, 3], 1);
    let (found, counts) = read_all(&[health(0), newer, health(2)]);
    assert_eq!(found, [healthy(0), Frame::Unknown { sequence: 1, number: u32::from(next), request: None }, healthy(2)]);
    assert_eq!((counts.unknown, counts.lost, counts.corrupt()), (1, 0, 0));

    // A known record with a kind of event that this version does not know.
    let (found, _) = read_all(&[reference::frame(&[4, 0, 100], 1)]);
    assert_eq!(found, [Frame::Unknown { sequence: 1, number: 4, request: None }]);

    // A newer host's command can be refused by its ID.
    let found = frames::read_all::<Request>(&reference::request_frame(&[0x81, 0x04, 99, 7], 5));
    assert_eq!(found, [Frame::Unknown { sequence: 5, number: 99, request: Some(513) }]);

    // Unknown frames count in the sequence, so losses next to them are detected.
    let (found, _) = read_all(&[health(0), reference::frame(&[next], 3), health(4)]);
    assert_eq!(found[1], Frame::Lost { frames: 2 });
    assert_eq!(found[3], healthy(4));
}

#[test]
fn a_foreign_version_is_named_whatever_follows() {
    for rest in [&[][..], &[9; 100], &[0xFF; 300]] {
        // Record 0, version 300, and content that this version cannot interpret.
        let mut payload = vec![0, 0xAC, 0x02];
        payload.extend(rest);
        let foreign = reference::frame(&payload, 0);
        let stranger = |sequence| Frame::ForeignVersion { sequence, wire_version: 300 };
        let (found, counts) = read_all(&[foreign.clone(), health(1), health(3)]);
        // Records of that version may look like ours and mean something else: none is accepted.
        assert_eq!(found, [stranger(0), stranger(1), Frame::Lost { frames: 1 }, stranger(3)]);
        assert_eq!((counts.foreign, counts.messages, counts.corrupt()), (3, 0, 0));

        // After an update and a restart, the device is understood.
        let greeting = Record::Hello(hello());
        let (found, _) = read_all(&[foreign.clone(), health(1), framed(&greeting, 0), health(1)]);
        assert_eq!(found, [stranger(0), stranger(1), Frame::Restarted, intact(greeting, 0), healthy(1)]);

        // The same applies to a reopened link.
        let mut reader = FrameReader::<Record>::new();
        read(&mut reader, &foreign);
        reader.reset();
        assert_eq!(read(&mut reader, &health(77)), [healthy(77)]);
        assert_eq!((reader.counts().foreign, reader.counts().messages), (1, 1));
    }
}

const CORRUPTIONS: [Corruption; 5] =
    [Corruption::TooLong, Corruption::TooShort, Corruption::Stuffing, Corruption::Checksum, Corruption::Malformed];

#[test]
fn damage_is_counted_by_kind() {
    let cut = |bytes: &[u8]| {
        let mut bytes = bytes[..bytes.len() - 4].to_vec();
        bytes.push(0);
        bytes
    };
    let mut flipped = health(1);
    flipped[1] ^= 0x40;
    let text_not_utf8 = reference::frame(&[4, 0, 6, 2, 0xC3, 0x28], 1);
    for (damaged, corruption) in [
        (vec![1, 0], Corruption::TooShort),
        (vec![3, 5, 5, 0], Corruption::TooShort),
        // Sequence number and CRC are right, but there is no payload.
        (reference::frame(&[], 1), Corruption::TooShort),
        (cut(&health(1)), Corruption::Stuffing),
        (vec![200, 1, 2, 3, 0], Corruption::Stuffing),
        (flipped, Corruption::Checksum),
        (b"hello, this is a boot message\0".to_vec(), Corruption::Stuffing),
        ([[1; 600].as_slice(), &[0]].concat(), Corruption::TooLong),
        ([[0xAA; 5000].as_slice(), &[0]].concat(), Corruption::TooLong),
        // The stuffed frame fits the buffer, the unstuffed one is too long.
        ([[1; MAX_FRAME - 1].as_slice(), &[0]].concat(), Corruption::TooLong),
        (reference::frame(&[0xFF; 6], 1), Corruption::Malformed),
        (reference::frame(&[3, 1, 2], 1), Corruption::Malformed),
        (text_not_utf8, Corruption::Malformed),
    ] {
        let (found, counts) = read_all(&[health(0), damaged.clone(), health(2)]);
        assert_eq!(found[1], Frame::Corrupt(corruption), "{damaged:02x?}");
        let kinds = [counts.too_long, counts.too_short, counts.stuffing, counts.checksum, counts.malformed];
        let expected = CORRUPTIONS.map(|kind| u32::from(kind == corruption));
        assert_eq!((kinds, counts.corrupt()), (expected, 1));
        if corruption == Corruption::Malformed {
            // The CRC also covers its sequence number.
            assert_eq!(found[2..], [healthy(2)]);
        } else {
            assert_eq!(found[2..], [Frame::Lost { frames: 1 }, healthy(2)]);
        }
        assert_eq!(counts.messages, 2);
    }
}

#[test]
fn bytes_left_over_in_a_payload_are_malformed() {
    for (name, record) in records() {
        let mut payload = frames::payload(&record);
        payload.push(0);
        let (found, _) = read_all(&[reference::frame(&payload, 1)]);
        assert_eq!(found, [Frame::Corrupt(Corruption::Malformed)], "{name}");
    }
    for (name, request) in requests() {
        let mut payload = frames::payload(&request);
        payload.push(0);
        let found = frames::read_all::<Request>(&reference::request_frame(&payload, 1));
        assert_eq!(found, [Frame::Corrupt(Corruption::Malformed)], "{name}");
    }
}

#[test]
fn payloads_that_end_early_are_malformed() {
    for (name, record) in records() {
        let payload = frames::payload(&record);
        for length in 1..payload.len() {
            let (found, _) = read_all(&[reference::frame(&payload[..length], 1)]);
            assert_eq!(found, [Frame::Corrupt(Corruption::Malformed)], "{name} cut to {length}");
        }
    }
}

#[test]
fn lists_longer_than_ours_are_a_newer_sender() {
    // 49 settings, and a batch of 401 bytes.
    let mut settings = vec![6, 49];
    settings.extend([0; 49 * 9]);
    let (found, _) = read_all(&[reference::frame(&settings, 0)]);
    assert_eq!(found, [Frame::Unknown { sequence: 0, number: 6, request: None }]);
    let mut samples = vec![1, 32, 0x91, 0x03];
    samples.extend([0; 401]);
    let (found, _) = read_all(&[reference::frame(&samples, 0)]);
    assert_eq!(found, [Frame::Unknown { sequence: 0, number: 1, request: None }]);
}

#[test]
fn one_byte_more_than_the_longest_is_too_long() {
    let mut longest = reference::frame(&[99; MAX_PAYLOAD], 0x0101);
    assert_eq!(longest.len(), MAX_FRAME);
    let (found, _) = read_all(&[longest.clone()]);
    assert_eq!(found, [Frame::Unknown { sequence: 0x0101, number: 99, request: None }]);
    // Its beginning alone would be an intact frame.
    longest.insert(MAX_FRAME - 1, 1);
    let (found, _) = read_all(&[longest.clone(), health(1)]);
    assert_eq!(found, [Frame::Corrupt(Corruption::TooLong), healthy(1)]);
    // Of an overlong frame, a recording keeps as many bytes as the longest frame has before its delimiter.
    let mut reader = FrameReader::<Record>::new();
    assert_eq!(reader.read(&mut &longest[..]), Some(Frame::Corrupt(Corruption::TooLong)));
    assert_eq!(reader.frame_bytes(), &longest[..MAX_FRAME - 1]);
}

#[test]
fn the_longest_frame_passes() {
    let record = Record::Samples(longest_samples());
    let (found, _) = read_all(&[framed(&record, 0), health(1)]);
    assert_eq!(found, [intact(record, 0), healthy(1)]);
}

/// Intact frames with any payload: never a panic, and never a message from part of a payload.
#[test]
fn any_payload_is_survived() {
    let mut numbers = Random(5);
    let (mut messages, mut unknown, mut malformed) = (0, 0, 0);
    for case in 0..100_000u32 {
        let mut payload = line_bytes(&mut numbers, 60);
        if case % 2 == 0 {
            // A known record with one changed byte gets further into the decoder.
            let all = records();
            payload = frames::payload(&all[numbers.below(all.len())].1);
            let place = numbers.below(payload.len());
            payload[place] = numbers.draw() as u8;
        }
        for frame in frames::read_all::<Record>(&reference::frame(&payload, 1)) {
            match frame {
                Frame::Message { message, .. } => {
                    messages += 1;
                    if let Record::Samples(samples) = &message {
                        assert!(samples.iter().count() <= Samples::MAX_SAMPLES + 1);
                    }
                    if let Record::Settings(values) = &message {
                        values.read(&inerter_core::Settings::default());
                    }
                }
                Frame::Unknown { .. } | Frame::ForeignVersion { .. } => unknown += 1,
                Frame::Corrupt(Corruption::Malformed | Corruption::TooShort) => malformed += 1,
                other => panic!("{other:?}"),
            }
        }
        for frame in frames::read_all::<Request>(&reference::request_frame(&payload, 1)) {
            match frame {
                Frame::Message { message: Request { command, .. }, .. } => {
                    if let Command::Inject(samples) = &command {
                        samples.check().ok();
                    }
                    if let Command::WriteSettings(values) = &command {
                        values.write(&inerter_core::Settings::default()).ok();
                    }
                }
                Frame::Unknown { request, .. } => assert!(request.is_some()),
                Frame::Corrupt(Corruption::Malformed | Corruption::TooShort) => {}
                other => panic!("{other:?}"),
            }
        }
    }
    // Each kind of result occurred often.
    assert!(messages > 10_000 && unknown > 10_000 && malformed > 10_000, "{messages} {unknown} {malformed}");
}

/// A stream as received over a bad link: frames, missing numbers, fragments, garbage.
fn rough_stream(seed: u64) -> Vec<u8> {
    let mut numbers = Random(seed);
    let mut stream = line_bytes(&mut numbers, 5);
    let mut sequence = numbers.draw() as u16;
    for _ in 0..numbers.below(12) {
        let mut frame = framed(&some_record(&mut numbers), sequence);
        sequence = sequence.wrapping_add(1);
        match numbers.below(8) {
            0 => frame.truncate(numbers.below(frame.len())),
            1 => frame = line_bytes(&mut numbers, 40),
            2 => frame.extend(line_bytes(&mut numbers, 4)),
            3 => frame = vec![0x33; numbers.below(1500)],
            4 => sequence = sequence.wrapping_add(numbers.below(3) as u16),
            5 => frame = reference::frame(&line_bytes(&mut numbers, 30), sequence),
            _ => {}
        }
        stream.extend(frame);
    }
    stream
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    /// The way a stream is split into portions makes no difference.
    #[test]
    fn portions_make_no_difference(seed: u64, portions in prop::collection::vec(0usize..70, 1..40)) {
        // Some portions may be empty, but not all of them.
        let portions = [portions, vec![1]].concat();
        let stream = rough_stream(seed);
        let mut whole = FrameReader::<Record>::new();
        let mut expected = Vec::new();
        let mut input = &stream[..];
        while let Some(frame) = whole.read(&mut input) {
            expected.push((frame, whole.frame_bytes().to_vec()));
        }

        let mut reader = FrameReader::<Record>::new();
        let mut found = Vec::new();
        let mut left = &stream[..];
        for portion in portions.iter().cycle() {
            let (mut input, rest) = left.split_at((*portion).min(left.len()));
            left = rest;
            while let Some(frame) = reader.read(&mut input) {
                found.push((frame, reader.frame_bytes().to_vec()));
            }
            if left.is_empty() {
                break;
            }
        }
        prop_assert_eq!(found, expected);
        prop_assert_eq!(reader.counts(), whole.counts());
        prop_assert_eq!(reader.unfinished(), whole.unfinished());
    }

    /// Byte by byte, and for requests too.
    #[test]
    fn single_bytes_make_no_difference(seed: u64) {
        let stream = rough_stream(seed);
        let expected = frames::read_all::<Request>(&stream);
        let mut reader = FrameReader::<Request>::new();
        let found: Vec<_> = stream.iter().flat_map(|byte| read(&mut reader, &[*byte])).collect();
        prop_assert_eq!(found, expected);
    }
}

#[test]
fn faults_are_told_in_words() {
    for corruption in CORRUPTIONS {
        assert!(corruption.to_string().contains("frame"));
    }
    assert!(EncodeError::BufferTooSmall.to_string().contains(&MAX_FRAME.to_string()));
    assert!(EncodeError::TooLong.to_string().contains("512"));
}
