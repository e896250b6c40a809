//! Streams that no sane host sends.

use inerter_core::{Detail, Estimate, Kind, RawSample, Reversal, Settings};
use inerter_needs::Random;
use inerter_wire::{
    ClockSource, Command, DELIMITER, Done, Event, EventKind, Health, Hello, MAX_FRAME, MAX_SETTINGS, Message, Record,
    Refusal, Reply, Request, Samples, SettingValue, SettingsValues, Streams, encode,
};

/// A stream under construction.
#[derive(Clone, Debug, Default)]
pub struct Stream {
    /// Bytes sent to the device.
    pub bytes: Vec<u8>,
    /// IDs of the requests that are complete and alone in their frame, whatever surrounds them.
    pub whole: Vec<u16>,
    sequence: u16,
}

impl Stream {
    /// Requests with IDs from `first` on.
    pub fn requests(&mut self, first: u16, commands: impl IntoIterator<Item = Command>) -> &mut Self {
        (first..).zip(commands).for_each(|(id, command)| _ = self.request(id, command));
        self
    }

    /// A request as a host sends it.
    pub fn request(&mut self, id: u16, command: Command) -> &mut Self {
        let frame = self.next_frame(id, command);
        if self.bytes.last().is_some_and(|&last| last != DELIMITER) {
            self.bytes.push(DELIMITER);
        }
        self.whole.push(id);
        self.raw(&frame)
    }

    /// Appends bytes unchanged.
    pub fn raw(&mut self, bytes: &[u8]) -> &mut Self {
        self.bytes.extend(bytes);
        self
    }

    /// Appends any payload in an intact frame.
    pub fn payload(&mut self, payload: &[u8]) -> &mut Self {
        let frame = frame(payload, self.next_number());
        self.raw(&frame)
    }

    /// The frame of a request, not yet part of the stream.
    pub fn next_frame(&mut self, id: u16, command: Command) -> Vec<u8> {
        request(id, command, self.next_number())
    }

    fn next_number(&mut self) -> u16 {
        let number = self.sequence;
        self.sequence = number.wrapping_add(1);
        number
    }
}

/// The frame of a request; empty if it is too long for one.
pub fn request(id: u16, command: Command, sequence: u16) -> Vec<u8> {
    encoded(&Request { id, command }, sequence)
}

/// The frame of a message; empty if it is too long for one.
fn encoded<T: Message>(message: &T, sequence: u16) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    let length = encode(message, sequence, &mut frame).unwrap_or(0);
    frame[..length].to_vec()
}

/// A frame with an intact CRC around any payload.
pub fn frame(payload: &[u8], sequence: u16) -> Vec<u8> {
    let mut body = payload.to_vec();
    body.extend(sequence.to_le_bytes());
    with_checksum(body, Request::SALT)
}

/// A frame with these bytes and their CRC.
pub fn with_checksum(mut body: Vec<u8>, salt: u32) -> Vec<u8> {
    let checksum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&body) ^ salt;
    body.extend(checksum.to_le_bytes());
    stuffed(&body)
}

/// COBS encoding with the delimiter.
pub fn stuffed(body: &[u8]) -> Vec<u8> {
    let mut frame = vec![0; cobs::max_encoding_length(body.len())];
    let length = cobs::encode(body, &mut frame);
    frame.truncate(length);
    frame.push(DELIMITER);
    frame
}

/// The payload of a request.
pub fn payload(id: u16, command: Command) -> Vec<u8> {
    let mut bytes = [0; MAX_FRAME];
    postcard::to_slice(&Request { id, command }, &mut bytes).map(|bytes| bytes.to_vec()).unwrap_or_default()
}

/// A number as postcard encodes it.
pub fn varint(number: u32) -> Vec<u8> {
    postcard::to_slice(&number, &mut [0; 5]).map(|bytes| bytes.to_vec()).unwrap_or_default()
}

/// A request for the streams whose bits are set.
pub fn streams_of(bits: u64) -> Command {
    let on = |bit: u32| bits >> bit & 1 == 1;
    Command::Streams(Streams { samples: on(0), estimates: on(1), sums: on(2), health: on(3) })
}

/// A batch whose count need not agree with its bytes.
pub fn samples(count: u8, data: &[u8]) -> Samples {
    let bytes = [&[count][..], &varint(data.len() as u32), data].concat();
    postcard::from_bytes(&bytes).unwrap_or_default()
}

/// Records as a device might send them, for a link that echoes.
pub fn records() -> Vec<Vec<u8>> {
    let hello = Hello {
        wire_version: 7,
        firmware: Hello::text("echo"),
        git: Hello::text(""),
        board: Hello::text(""),
        serial: Hello::text(""),
        sample_rate_hz: 1_000.0,
        clock: ClockSource::Internal,
        capabilities: inerter_wire::Capabilities::NONE,
    };
    let values = SettingsValues::from(&Settings::default());
    let batch: Vec<_> = (0..20).map(|index| RawSample { index, ..RawSample::default() }).collect();
    let records = [
        Record::Hello(hello),
        Record::Event(Event { index: 3, kind: EventKind::Started }),
        Record::Reply(Reply { id: 2, result: Ok(Done::Plain) }),
        Record::Reply(Reply { id: 0, result: Err(Refusal::Busy) }),
        Record::Settings(values),
        Record::Samples(Samples::from_slice(&batch).0),
        Record::Health(Health::default()),
        Record::Estimate(Estimate::default()),
        Record::Detail(Detail::default()),
        Record::Reversal(Reversal::default()),
    ];
    (0..).zip(&records).map(|(sequence, record)| encoded(record, sequence)).collect()
}

fn value(noise: &mut Random, number: u8) -> f64 {
    const ODD: [f64; 14] = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        0.0,
        -0.0,
        1.0,
        -1.0,
        0.5,
        f64::MIN_POSITIVE,
        5e-324,
        f64::MAX,
        f64::MIN,
        1e-12,
        4_294_967_296.0,
    ];
    let Some(info) = Settings::TABLE.get(usize::from(number)) else { return noise.pick(&ODD) };
    match noise.below(10) {
        0 => noise.pick(&ODD),
        1 => f64::from_bits(noise.draw()),
        2 => info.min,
        3 => info.max,
        4 => info.default,
        5 => info.max * (1.0 + f64::EPSILON) + f64::from(noise.percent(50)) * 1e-9,
        _ if info.name == "sample_rate_hz" => noise.pick(&[1_000.0, 2_000.0, 4_000.0, 1_953.125, 3_906.25]),
        _ => {
            let value = info.default + (noise.share() - 0.5) * (info.max - info.min).min(info.default.abs() + 1e-3);
            if info.kind == Kind::Whole { value.round() } else { value }
        }
    }
}

fn settings(noise: &mut Random) -> SettingsValues {
    let count = if noise.percent(10) { noise.below(MAX_SETTINGS + 1) } else { 1 + noise.below(3) };
    let mut values = SettingsValues::default();
    for place in 0..count {
        let number = if noise.percent(4) {
            noise.draw() as u8
        } else if count > 3 && noise.percent(95) {
            place as u8
        } else {
            noise.below(Settings::COUNT) as u8
        };
        // The vector has room for this many.
        let _ = values.0.push(SettingValue { number, value: value(noise, number) });
    }
    values
}

fn batch(noise: &mut Random) -> Samples {
    if noise.percent(30) {
        let length = noise.below(Samples::MAX_BYTES + 1);
        return samples(noise.draw() as u8, &noise.bytes(length));
    }
    let count = noise.below(Samples::MAX_SAMPLES + 1);
    let mut index = if noise.percent(80) { noise.below(1_000) as u32 } else { noise.draw() as u32 };
    let wild = noise.percent(20);
    let all: Vec<RawSample> = (0..count)
        .map(|place| {
            index = index.wrapping_add(if noise.percent(90) { 1 } else { noise.draw() as u32 % 50 });
            let noisy = |noise: &mut Random| if wild { noise.draw() as i32 } else { noise.draw() as i32 >> 20 };
            RawSample {
                index,
                position_count: (place as i32).wrapping_mul(40).wrapping_add(noisy(noise)),
                force_code: noisy(noise).wrapping_add(131_040),
                terminal_code: noisy(noise),
            }
        })
        .collect();
    Samples::from_slice(&all).0
}

fn command(noise: &mut Random) -> Command {
    match noise.below(40) {
        0..2 => Command::Hello,
        2 => Command::ReadSettings,
        3 => Command::ReadSaved,
        4..14 => Command::WriteSettings(settings(noise)),
        14..17 => Command::SaveSettings,
        17 => Command::Tare,
        18..20 => streams_of(noise.draw()),
        20..22 => Command::ResetEstimator,
        22..24 => Command::Start,
        24..26 => Command::Stop,
        26..35 => Command::Inject(batch(noise)),
        35..37 => Command::InjectEnd,
        37..39 => Command::FactoryReset,
        _ if noise.percent(4) => Command::Reboot,
        _ if noise.percent(4) => Command::EnterDfu,
        _ => Command::Hello,
    }
}

fn spoilt(noise: &mut Random, mut frame: Vec<u8>) -> Vec<u8> {
    for _ in 0..1 + noise.below(3) {
        let place = place(noise, &frame);
        match noise.below(6) {
            0 if place < frame.len() => frame[place] ^= 1 << noise.below(8),
            1 if place < frame.len() => frame[place] = noise.draw() as u8,
            2 if place < frame.len() => drop(frame.remove(place)),
            3 => frame.insert(place, noise.draw() as u8),
            4 => frame.truncate(place),
            _ if place < frame.len() => frame.rotate_left(place),
            _ => {}
        }
    }
    frame
}

/// The stream of a seed.
pub fn stream(seed: u64) -> Stream {
    let mut noise = Random(seed);
    let mut stream = Stream::default();
    let (pieces, evil) = (1 + noise.below(40), noise.pick(&[0, 10, 50, 90]));
    for _ in 0..pieces {
        let (id, order) = (noise.draw() as u16, command(&mut noise));
        if !noise.percent(evil) {
            stream.request(id, order);
            continue;
        }
        piece(&mut noise, &mut stream, id, order);
    }
    stream
}

/// Fewer random bytes than this.
fn bytes(noise: &mut Random, below: usize) -> Vec<u8> {
    let length = noise.below(below);
    noise.bytes(length)
}

/// A place in these bytes; 0 if there are none.
fn place(noise: &mut Random, bytes: &[u8]) -> usize {
    noise.below(bytes.len().max(1))
}

fn piece(noise: &mut Random, stream: &mut Stream, id: u16, order: Command) {
    match noise.below(16) {
        0 | 1 => {
            let frame = stream.next_frame(id, order);
            stream.raw(&spoilt(noise, frame));
        }
        2 => {
            let frame = stream.next_frame(id, order);
            stream.raw(&frame[..place(noise, &frame)]);
        }
        3 => {
            let (first, second) = (stream.next_frame(id, order), stream.next_frame(id ^ 1, command(noise)));
            let (cut, from) = (place(noise, &first), place(noise, &second));
            stream.raw(&first[..cut]).raw(&second[from..]);
        }
        4 => {
            let frame = stream.next_frame(id, order);
            stream.raw(&[DELIMITER]).raw(&frame).raw(&frame);
        }
        5 => stream.sequence = noise.draw() as u16,
        6 => {
            stream.raw(&bytes(noise, 200));
        }
        7 => {
            let (byte, length) = (noise.pick(&[0, 1, 0x55, 0xFF]), noise.below(1_500));
            stream.raw(&vec![byte; length]);
        }
        8 => {
            stream.raw(&stuffed(&bytes(noise, 700)));
        }
        9 => {
            stream.payload(&bytes(noise, 520));
        }
        damage @ 10..13 => {
            let mut bytes = payload(id, order);
            match damage {
                10 => bytes.truncate(place(noise, &bytes)),
                11 => {
                    let more = 1 + noise.below(8);
                    bytes.extend(noise.bytes(more));
                }
                _ => {
                    for _ in 0..1 + noise.below(3) {
                        let place = place(noise, &bytes);
                        if let Some(byte) = bytes.get_mut(place) {
                            *byte = noise.draw() as u8;
                        }
                    }
                }
            }
            stream.payload(&bytes);
        }
        13 => {
            let mut start = noise.draw().to_le_bytes()[..1 + noise.below(4)].to_vec();
            start.extend(varint(noise.draw() as u32 >> noise.below(32)));
            start.extend(bytes(noise, 20));
            stream.payload(&start);
        }
        14 => {
            for frame in records() {
                if noise.percent(40) {
                    stream.raw(&frame);
                }
            }
        }
        _ => {
            for place in 0..noise.below(40) as u16 {
                stream.request(id.wrapping_add(place), order.clone());
            }
        }
    }
}
