//! Readers of all kinds, with a device played by the tests.

use inerter_core::{RawSample, Settings};
use inerter_wire::{Capabilities, ClockSource, Event, Samples, WIRE_VERSION};

use super::*;

struct Host {
    stream: TcpStream,
    records: FrameReader<Record>,
    sequence: SequenceCounter,
    seen: Vec<Record>,
    lost: u32,
}

impl Host {
    fn connect(share: &Share) -> Self {
        let stream = TcpStream::connect(share.address().unwrap()).unwrap();
        stream.set_nonblocking(true).unwrap();
        Self { stream, records: FrameReader::new(), sequence: SequenceCounter::new(), seen: Vec::new(), lost: 0 }
    }

    fn ask(&mut self, id: u16, command: Command) {
        let mut out = [0; MAX_FRAME];
        let length = encode_request(&Request { id, command }, self.sequence.take(), &mut out).unwrap();
        assert_eq!(self.stream.write(&out[..length]).unwrap(), length);
    }

    /// Asks for something that is done without more words.
    fn command(&mut self, share: &mut Share, id: u16, command: Command) {
        self.ask(id, command);
        assert_eq!(self.until_reply(share, id).1, Ok(Done::Plain));
    }

    /// Reads the available bytes.
    fn read(&mut self) {
        let mut buffer = [0; 1 << 16];
        while let Ok(count @ 1..) = self.stream.read(&mut buffer) {
            let mut input = &buffer[..count];
            while let Some(frame) = self.records.read(&mut input) {
                match frame {
                    Frame::Message { message, .. } => self.seen.push(message),
                    Frame::Lost { frames } => self.lost += u32::from(frames),
                    other => panic!("{other:?}"),
                }
            }
        }
    }

    /// Everything up to the reply with this number.
    fn until_reply(&mut self, share: &mut Share, id: u16) -> (Vec<Record>, Result<Done, Refusal>) {
        loop {
            share.turn();
            self.read();
            let is_it = |record: &Record| matches!(record, Record::Reply(reply) if reply.id == id);
            if let Some(place) = self.seen.iter().position(is_it) {
                let mut seen: Vec<Record> = self.seen.drain(..=place).collect();
                let Some(Record::Reply(reply)) = seen.pop() else { unreachable!() };
                return (seen, reply.result);
            }
        }
    }
}

/// The device's own frames.
#[derive(Default)]
struct Board(SequenceCounter);

impl Board {
    fn says(&mut self, share: &mut Share, record: &Record) {
        let mut out = [0; MAX_FRAME];
        let length = encode_record(record, self.0.take(), &mut out).unwrap();
        share.relay(&out[..length]);
    }

    /// Sends the next batch of samples.
    fn stream(&mut self, share: &mut Share, batches: &mut u32) {
        self.says(share, &batch(20 * *batches));
        *batches += 1;
    }

    fn start(&mut self, share: &mut Share) {
        self.says(share, &Record::Event(Event { index: 0, kind: EventKind::Started }));
        self.says(share, &Record::Hello(hello()));
        self.says(share, &Record::Settings(SettingsValues::from(&Settings::default())));
    }
}

/// A share of a device that has started.
fn started(listen: fn(&str) -> io::Result<Share>) -> (Share, Board) {
    let mut share = listen("127.0.0.1:0").unwrap();
    let mut board = Board::default();
    board.start(&mut share);
    (share, board)
}

fn hello() -> Hello {
    Hello {
        wire_version: WIRE_VERSION,
        firmware: Hello::text("played"),
        git: Hello::text(""),
        board: Hello::text("board"),
        serial: Hello::text("S7"),
        sample_rate_hz: Settings::default().sample_rate_hz,
        clock: ClockSource::Crystal,
        capabilities: Capabilities::SAMPLER,
    }
}

fn batch(index: u32) -> Record {
    let sample =
        |place: u32| RawSample { index: index + place, position_count: 77_777, force_code: -99_999, terminal_code: 5 };
    let samples: Vec<RawSample> = (0..20).map(sample).collect();
    Record::Samples(Samples::from_slice(&samples).0)
}

/// The requests that have reached the device.
fn at_device(share: &mut Share) -> Vec<Request> {
    let mut buffer = [0; 4096];
    let count = share.requests(&mut buffer);
    let (mut reader, mut input) = (FrameReader::<Request>::new(), &buffer[..count]);
    std::iter::from_fn(|| reader.read(&mut input))
        .map(|frame| match frame {
            Frame::Message { message, .. } => message,
            other => panic!("{other:?}"),
        })
        .collect()
}

const SAMPLES: Streams = Streams { samples: true, ..Streams::NONE };

#[test]
fn the_first_controls_and_each_has_its_own_streams() {
    let (mut share, mut board) = started(Share::controlled);
    let asked: Vec<Command> = at_device(&mut share).into_iter().map(|request| request.command).collect();
    assert_eq!(asked, [Command::Streams(Streams::ALL), Command::ReadSettings]);

    let (mut first, mut second) = (Host::connect(&share), Host::connect(&share));
    for host in [&mut first, &mut second] {
        host.ask(1, Command::Hello);
        assert_eq!(host.until_reply(&mut share, 1), (vec![Record::Hello(hello())], Ok(Done::Plain)));
    }
    second.ask(2, Command::ReadSettings);
    let settings = Record::Settings(SettingsValues::from(&Settings::default()));
    assert_eq!(second.until_reply(&mut share, 2), (vec![settings], Ok(Done::Plain)));
    second.command(&mut share, 3, Command::Streams(SAMPLES));
    for command in [Command::ResetEstimator, Command::Stop, Command::Reboot, Command::InjectEnd, Command::SaveSettings]
    {
        second.ask(4, command);
        assert_eq!(second.until_reply(&mut share, 4).1, Err(Refusal::Busy));
    }
    assert_eq!(at_device(&mut share), []);

    // The second reader's reply carries the same id as the pending request.
    first.ask(4, Command::ResetEstimator);
    while first.seen.is_empty() {
        share.turn();
        for Request { id, command } in at_device(&mut share) {
            assert_eq!(command, Command::ResetEstimator);
            board.says(&mut share, &batch(0));
            board.says(&mut share, &Record::Reply(Reply { id, result: Ok(Done::Plain) }));
        }
        first.read();
    }
    assert_eq!(first.seen, [Record::Reply(Reply { id: 4, result: Ok(Done::Plain) })]);
    while second.seen.is_empty() {
        second.read();
    }
    assert_eq!((&second.seen[..], first.lost, second.lost), (&[batch(0)][..], 0, 0));
}

#[test]
fn the_control_goes_to_the_next_when_its_holder_leaves() {
    let (mut share, _) = started(Share::controlled);
    at_device(&mut share);
    // A silent connection, such as a port scanner's, controls nothing.
    let _mute = Host::connect(&share);
    share.turn();
    let (mut first, mut second) = (Host::connect(&share), Host::connect(&share));
    for host in [&mut first, &mut second] {
        host.command(&mut share, 1, Command::Hello);
    }
    second.ask(2, Command::Stop);
    assert_eq!(second.until_reply(&mut share, 2).1, Err(Refusal::Busy));
    drop(first);
    let passed = loop {
        second.ask(3, Command::Stop);
        share.turn();
        if let Some(request) = at_device(&mut share).pop() {
            break request;
        }
    };
    assert_eq!(passed, Request { id: 3, command: Command::Stop });
}

#[test]
fn a_reader_that_never_reads_holds_up_nobody_and_takes_bounded_room() {
    let (mut share, mut board) = started(Share::watched);
    let (mut stuck, mut other) = (Host::connect(&share), Host::connect(&share));
    for host in [&mut stuck, &mut other] {
        host.command(&mut share, 1, Command::Streams(SAMPLES));
    }
    let (mut batches, mut most) = (0, 0);
    // Until much is dropped: the system's own buffers are full as well.
    while batches < 1000 || share.readers.iter().all(|reader| reader.waiting.len() + MAX_FRAME <= MOST_WAITING) {
        board.stream(&mut share, &mut batches);
        assert!(!share.is_full());
        other.read();
        most = most.max(share.readers.iter().map(|reader| reader.waiting.len()).max().unwrap());
    }
    for _ in 0..100 {
        board.stream(&mut share, &mut batches);
        other.read();
    }
    while other.seen.len() < batches as usize {
        share.turn();
        other.read();
    }
    assert_eq!((other.seen.len(), other.lost), (batches as usize, 0));
    assert!(most <= MOST_WAITING, "{most}");
    // When it reads at last, it detects the loss and continues.
    while stuck.lost == 0 {
        share.turn();
        stuck.read();
        board.stream(&mut share, &mut batches);
    }
    stuck.command(&mut share, 2, Command::ReadSettings);
    assert!(share.controller.is_none(), "nobody controls what is only watched");
}

#[test]
fn a_reader_alone_holds_the_device_up() {
    let (mut share, mut board) = started(Share::controlled);
    let mut host = Host::connect(&share);
    host.command(&mut share, 1, Command::Streams(SAMPLES));
    let mut batches = 0;
    while !share.is_full() {
        board.stream(&mut share, &mut batches);
    }
    while host.seen.len() < batches as usize {
        share.turn();
        host.read();
    }
    assert_eq!(host.lost, 0);
    assert!(!share.is_full());
}

#[test]
fn what_a_newer_device_says_is_passed_on_and_losses_are_told() {
    let (mut share, mut board) = started(Share::watched);
    let mut host = Host::connect(&share);
    host.command(&mut share, 1, Command::Hello);
    // Two lost frames, then an unknown record 99, by hand.
    (0..2).for_each(|_| {
        board.0.take();
    });
    let body = [&[99, 1, 2, 3][..], &board.0.take().to_le_bytes()].concat();
    let mut crc = inerter_wire::Crc32::new();
    crc.update(&body);
    let mut frame = [DELIMITER; 64];
    let length = cobs::encode(&[&body[..], &crc.value().to_le_bytes()].concat(), &mut frame);
    share.relay(&frame[..=length]);
    let mut found = Vec::new();
    let mut buffer = [0; 256];
    while found.len() < 2 {
        if let Ok(count) = host.stream.read(&mut buffer) {
            let mut input = &buffer[..count];
            found.extend(std::iter::from_fn(|| host.records.read(&mut input)));
        }
    }
    assert_eq!(found, [Frame::Lost { frames: 2 }, Frame::Unknown { sequence: 4, number: 99, request: None }]);
}

#[test]
fn readers_wait_for_a_device_that_is_away_and_too_many_are_turned_away() {
    let (mut share, mut board) = started(Share::watched);
    let ended = |host: &mut Host| matches!(host.stream.read(&mut [0; 16]), Ok(0));
    let spoken = |share: &mut Share| {
        let mut host = Host::connect(share);
        host.command(share, 1, Command::Streams(Streams::NONE));
        host
    };
    // Silent readers make room, the oldest first.
    let mut mute: Vec<Host> = (0..MOST_READERS).map(|_| Host::connect(&share)).collect();
    let mut hosts = vec![spoken(&mut share)];
    while !ended(&mut mute[0]) {
        share.turn();
    }
    assert!(!mute[1..].iter_mut().any(ended));
    hosts.extend((1..MOST_READERS).map(|_| spoken(&mut share)));
    while !mute.iter_mut().all(ended) {
        share.turn();
    }
    let mut last = Host::connect(&share);
    while !ended(&mut last) {
        share.turn();
    }
    assert!(!hosts.iter_mut().any(ended));
    share.forget();
    while !hosts.iter_mut().all(ended) {
        share.turn();
    }
    let mut host = Host::connect(&share);
    host.ask(1, Command::Hello);
    share.turn();
    share.turn();
    host.read();
    assert!(host.seen.is_empty());
    board.start(&mut share);
    assert_eq!(host.until_reply(&mut share, 1), (vec![Record::Hello(hello())], Ok(Done::Plain)));
}
