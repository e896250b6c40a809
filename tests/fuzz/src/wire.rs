//! Frames of records and requests.
//!
//! Input: a byte (bit 0: requests instead of records; bit 1: payloads to be framed instead of a stream; the other bits:
//! where the stream is split), then the stream, or payloads: a step of the sequence number (i8), a length (u16) and the
//! payload.
//!
//! Properties: the way a stream is split does not matter. A decoded message encodes to bytes that decode and encode to
//! the same bytes. Samples and settings of a record survive decoding and encoding.

use std::fmt::Debug;

use inerter_core::{RawSample, Settings};
use inerter_tests::fuzz::{Stream, corpus};
use inerter_wire::{
    Command, Counts, DELIMITER, Done, Event, EventKind, Fault, Frame, FrameReader, Health, MAX_FRAME, MAX_PAYLOAD,
    Message, Play, Record, Refusal, Reply, Request, Samples, SequenceCounter, SettingsValues, encode, renumber,
};

use crate::{
    estimator,
    input::{Input, counted, seed},
};

const REQUESTS: u8 = 1;
const PAYLOADS: u8 = 2;

/// Checks an input.
pub fn check(mut input: Input) {
    let kind = input.byte();
    let has_payloads = kind & PAYLOADS != 0;
    if kind & REQUESTS == 0 {
        check_stream::<Record>(&stream::<Record>(input, has_payloads), kind >> 2, check_record);
    } else {
        check_stream::<Request>(&stream::<Request>(input, has_payloads), kind >> 2, check_request);
    }
}

/// The stream in an input, or intact frames with its payloads.
pub fn stream<T: Message>(mut input: Input, has_payloads: bool) -> Vec<u8> {
    if !has_payloads {
        return input.rest().to_vec();
    }
    let (mut stream, mut sequence) = (Vec::new(), 0u16);
    while !input.is_empty() {
        sequence = sequence.wrapping_add_signed(i16::from(input.byte() as i8));
        let payload = input.counted();
        stream.extend(frame::<T>(&payload[..payload.len().min(MAX_PAYLOAD)], sequence));
    }
    stream
}

/// An intact frame with any payload.
pub fn frame<T: Message>(payload: &[u8], sequence: u16) -> Vec<u8> {
    // `renumber` fills in the sequence number and the CRC.
    let body = [payload, &[0; 6]].concat();
    let mut stuffed = vec![0; cobs::max_encoding_length(body.len())];
    let length = cobs::encode(&body, &mut stuffed);
    let mut out = [0; MAX_FRAME];
    let length = renumber::<T>(&stuffed[..length], sequence, &mut out).expect("a payload that fits");
    out[..length].to_vec()
}

/// A frame in comparable form, also if its message contains NaN: sequence number and encoding of the message, or what
/// else was found; and the frame's bytes.
type Found<T> = (Result<(u16, Vec<u8>), Frame<T>>, Vec<u8>);

fn read<'a, T: Message>(
    portions: impl IntoIterator<Item = &'a [u8]>,
    mut each: impl FnMut(&T),
) -> (Vec<Found<T>>, Counts) {
    let (mut reader, mut found) = (FrameReader::<T>::new(), Vec::new());
    for mut input in portions {
        while let Some(frame) = reader.read(&mut input) {
            let what = match frame {
                Frame::Message { sequence, message } => {
                    each(&message);
                    Ok((sequence, encoded(&message, sequence)))
                }
                other => Err(other),
            };
            found.push((what, reader.frame_bytes().to_vec()));
        }
        assert!(input.is_empty(), "bytes left over");
    }
    assert!(reader.unfinished() < MAX_FRAME);
    (found, *reader.counts())
}

fn encoded<T: Message>(message: &T, sequence: u16) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = encode(message, sequence, &mut out).expect("a message that fits a frame");
    out[..length].to_vec()
}

fn check_stream<T: Message + Debug + PartialEq>(stream: &[u8], portions: u8, each: impl Fn(&T)) {
    let whole = read([stream], &each);
    let size = 1 + usize::from(portions);
    assert_eq!(read::<T>(stream.chunks(size), |_| ()), whole, "in portions of {size}");
    let (head, tail) = stream.split_at(stream.len() * size / 64);
    assert_eq!(read::<T>([head, &[], tail], |_| ()), whole, "cut at {}", head.len());
    let (found, counts) = whole;
    let count = |is: fn(&Found<T>) -> bool| found.iter().filter(|found| is(found)).count() as u32;
    assert_eq!(counts.messages, count(|(what, _)| what.is_ok()));
    assert_eq!(counts.corrupt(), count(|(what, _)| matches!(what, Err(Frame::Corrupt(_)))));
    for (what, _) in &found {
        let Ok((_, message)) = what else { continue };
        let (again, _) = read::<T>([&message[..]], |_| ());
        let [(twice, frame)] = &again[..] else { panic!("{again:?}") };
        assert_eq!(twice, what, "written and read back");
        assert_eq!(message.strip_suffix(&[DELIMITER]), Some(&frame[..]));
    }
}

fn check_record(record: &Record) {
    match record {
        Record::Samples(samples) => check_samples(samples),
        Record::Settings(values) | Record::Saved(values) => check_settings(values),
        Record::Event(Event { kind: EventKind::Fault(fault), .. }) => drop(fault.to_string()),
        _ => {}
    }
}

fn check_request(request: &Request) {
    match &request.command {
        Command::Inject(samples) => check_samples(samples),
        Command::WriteSettings(values) => check_settings(values),
        _ => {}
    }
}

fn check_samples(samples: &Samples) {
    let read: Result<Vec<RawSample>, _> = samples.iter().collect();
    assert_eq!(read.is_ok(), samples.check().is_ok());
    if let Ok(read) = read {
        assert_eq!(read.len(), samples.len());
        let (again, taken) = Samples::from_slice(&read);
        assert_eq!(taken, read.len(), "no more bytes than before");
        assert!(again.iter().flatten().eq(read));
    }
}

fn check_settings(values: &SettingsValues) {
    let base = Settings::default();
    let reading = values.read(&base);
    let again = SettingsValues::from(&reading.settings).read(&base);
    assert_eq!((again.settings, again.unknown, again.impossible, again.missing), (reading.settings, 0, 0, 0));
    if let Ok(written) = values.write(&base) {
        assert_eq!((written, reading.unknown, reading.impossible), (reading.settings, 0, 0));
    }
    if let Ok(written) = SettingsValues::difference(&reading.settings, &base).write(&base) {
        assert_eq!(written, reading.settings);
    }
}

/// Records of all kinds that a simulated device sends.
pub fn records() -> Vec<Record> {
    let mut records = estimator::records();
    records.push(Record::Settings(SettingsValues::from(&Settings::default())));
    records.push(Record::Saved(SettingsValues::default()));
    records.push(Record::Health(Health {
        cpu_load_permille: Some(311),
        temperature_c: Some(36.5),
        ..Health::default()
    }));
    for kind in [EventKind::Started, EventKind::SourceEnded, EventKind::Fault(Fault::Store)] {
        records.push(Record::Event(Event { index: 9, kind }));
    }
    for (id, result) in
        [(1, Ok(Done::Plain)), (2, Ok(Done::Injected { accepted: 7, free: 3 })), (3, Err(Refusal::Busy))]
    {
        records.push(Record::Reply(Reply { id, result }));
    }
    records
}

/// Frames of [`records`], numbered.
pub fn frames() -> Vec<Vec<u8>> {
    let mut sequence = SequenceCounter::new();
    records().iter().map(|record| encoded(record, sequence.take())).collect()
}

/// The payloads in a stream, each preceded by a step of one and its length.
pub fn payloads(stream: &[u8]) -> Vec<u8> {
    let mut input = Vec::new();
    for frame in stream.split(|&byte| byte == DELIMITER) {
        let mut body = vec![0; frame.len()];
        let length = cobs::decode(frame, &mut body).unwrap_or(0);
        if let Some((payload, _)) = body[..length].split_last_chunk::<6>() {
            input.push(1);
            input.extend(counted(payload));
        }
    }
    input
}

/// Frames of a simulated device, and requests that hosts have sent to one.
pub fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    let mut add = |requests: u8, stream: &[u8]| {
        seeds.push(seed(&[requests | 20 << 2], stream));
        seeds.push(seed(&[requests | PAYLOADS], payloads(stream)));
    };
    let frames = frames();
    add(0, &frames.concat());
    frames.iter().for_each(|frame| add(0, frame));
    for item in corpus().expect("tests/corpus") {
        if item.bytes.len() < 2_000 {
            add(REQUESTS, &item.bytes);
        }
    }
    for command in [
        Command::Hello,
        Command::ReadSaved,
        Command::Tare,
        Command::InjectEnd,
        Command::EnterDfu,
        Command::Play(Play::End),
    ] {
        add(REQUESTS, &Stream::default().request(7, command).bytes);
    }
    seeds
}
