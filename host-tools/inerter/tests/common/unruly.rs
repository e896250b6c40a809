//! Misbehaving devices, the commands that are run with them, and the requirements on these commands.
#![allow(dead_code, reason = "each test file uses its part")]

use std::{
    io::{BufRead, BufReader, ErrorKind, Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    path::Path,
    process::{Child, ExitStatus},
    sync::{
        Arc, Mutex, OnceLock,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use inerter_core::{Change, Estimate, RawSample, Settings, Warning, WarningKind};
use inerter_data::recording::{Item, read};
use inerter_needs::Random;
use inerter_wire::{
    Capabilities, ClockSource, Command, DELIMITER, Done, Event, EventKind, Fault, Figure, Frame, FrameReader, Health,
    Hello, MAX_FIGURES, MAX_FRAME, MAX_PAYLOAD, Measure, Measured, Record, Refusal, Reply, Request, ResetCause,
    Samples, SettingFault, SettingValue, SettingsValues, Source, encode_request,
};

use super::{
    done, elf_file,
    firmware::{framed, payload},
    foreign_words, inerter,
    terminal::{patient, spoken},
    text,
};

macro_rules! manners {
    ($($(#[doc = $doc:literal])+ $name:ident,)+) => {
        /// Behaviour of a device after a host connects.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Manner {
            $($(#[doc = $doc])+ $name,)+
        }

        /// All of them.
        pub const MANNERS: &[Manner] = &[$(Manner::$name,)+];
    };
}

manners! {
    /// Nothing.
    Silent,
    /// Meaningless bytes.
    Noise,
    /// Samples, but no replies.
    Samples,
    /// Answers up to the settings, then sends samples but no other reply.
    Introduced,
    /// Answers up to the settings, then sends nothing.
    Mute,
    /// Answers up to the settings, then sends only delimiters and reads nothing.
    Deaf,
    /// Answers everything, and repeats the same sample.
    Repeating,
    /// One endless frame.
    EndlessFrame,
    /// Delimiters with nothing between them.
    Delimiters,
    /// Echoes the host's bytes.
    Echo,
    /// Sends the bytes of its Hello, two per second.
    Trickle,
    /// Closes the connection at once.
    GoneAtOnce,
    /// Closes the connection after a number of bytes that differs each time.
    ClosesAfter,
    /// Closes the connection with unread requests, which resets it.
    Resets,
    /// Sends nothing after the settings, but keeps reading.
    HalfClosed,
    /// Delays each reply by 2 s.
    Late,
    /// Sends each reply after the host's timeout.
    TooLate,
    /// Replies with the ID of another request.
    OtherId,
    /// Sends everything twice.
    Twice,
    /// Replies without any data.
    Empty,
    /// Refuses everything beyond its settings.
    Refusing,
    /// Refuses everything.
    RefusingAll,
    /// Refuses everything beyond its settings, naming settings that do not exist.
    RefusingSettings,
    /// Sends endless replies with all IDs.
    ReplyFlood,
    /// Uses another wire version.
    OtherVersion,
    /// Announces another wire version a moment later.
    LaterVersion,
    /// Sends endless Hellos.
    HelloFlood,
    /// Restarts endlessly.
    RestartFlood,
    /// Names with control characters.
    ControlText,
    /// Names that are not valid UTF-8.
    TornText,
    /// Has no capabilities.
    NoCapabilities,
    /// A sample rate of zero.
    RateZero,
    /// A negative sample rate.
    RateNegative,
    /// An excessive sample rate.
    RateHuge,
    /// A sample rate of NaN.
    RateNan,
    /// Every setting is NaN.
    SettingsNan,
    /// Every setting is infinite.
    SettingsInfinite,
    /// Every setting at its minimum.
    SettingsLeast,
    /// Every setting at its maximum.
    SettingsGreatest,
    /// More settings than a message can hold.
    SettingsTooMany,
    /// Unknown settings.
    SettingsUnknown,
    /// One setting repeated many times.
    SettingsRepeated,
    /// Frames of the maximum length.
    LongestFrames,
    /// Frames beyond the maximum length.
    TooLongFrames,
    /// Frames with a wrong CRC.
    BadCrc,
    /// Sends byte by byte.
    ByteByByte,
    /// Frames with decreasing sequence numbers.
    SequenceBack,
    /// Frames with a constant sequence number.
    SequenceStands,
    /// Frames with random sequence numbers.
    SequenceRandom,
    /// Samples with a decreasing index.
    IndexBack,
    /// The same few samples in a cycle.
    IndexCircle,
    /// Samples whose index wraps.
    IndexWraps,
    /// Samples with gaps of years.
    IndexLeaps,
    /// Counts and codes that alternate between the ends of the range.
    ExtremeSamples,
    /// Truncated batches.
    TornSamples,
    /// Estimates that are NaN.
    EstimatesNan,
    /// Endless health records with all counters at their maximum.
    HealthFlood,
    /// Endless events.
    EventFlood,
    /// Endless warnings of the estimator, after its first estimates.
    WarningFlood,
    /// Unknown records.
    UnknownRecords,
    /// Known records with random content.
    RandomRecords,
    /// Valid records with flipped bits and matching CRCs.
    Mutated,
}

/// A device at a local address, until it is dropped.
pub struct Unruly {
    pub address: String,
    shared: Arc<Met>,
}

#[derive(Default)]
struct Met {
    guests: AtomicUsize,
    gone: AtomicBool,
    connections: Mutex<Vec<TcpStream>>,
}

impl Unruly {
    pub fn start(manner: Manner, seed: u64) -> Self {
        Self::behaving(move |host, guest| {
            behave(manner, host, guest, seed);
        })
    }

    /// A device that calls `act` for each connection, numbered from 0.
    pub fn behaving(act: impl Fn(TcpStream, usize) + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let (shared, act) = (Arc::new(Met::default()), Arc::new(act));
        let met = shared.clone();
        thread::spawn(move || {
            for host in listener.incoming().map_while(Result::ok) {
                if met.gone.load(Ordering::SeqCst) {
                    break;
                }
                let mut connections = met.connections.lock().unwrap();
                // Earlier connections have been closed by the hosts, or are few.
                connections.retain(|connection| connection.peer_addr().is_ok());
                connections.push(host.try_clone().unwrap());
                drop(connections);
                let (guest, act) = (met.guests.fetch_add(1, Ordering::SeqCst), act.clone());
                thread::spawn(move || {
                    let all = host.try_clone();
                    act(host, guest);
                    all.map(|all| all.shutdown(Shutdown::Both)).ok();
                });
            }
        });
        Self { address, shared }
    }

    /// Number of connections so far.
    pub fn guests(&self) -> usize {
        self.shared.guests.load(Ordering::SeqCst)
    }

    /// Disconnects the device for good.
    pub fn go(&self) {
        if !self.shared.gone.swap(true, Ordering::SeqCst) {
            // The listener ends with the next connection.
            TcpStream::connect(&self.address).ok();
        }
        for connection in self.shared.connections.lock().unwrap().drain(..) {
            connection.shutdown(Shutdown::Both).ok();
        }
    }
}

impl Drop for Unruly {
    fn drop(&mut self) {
        self.go();
    }
}

/// Number of known kinds of records, and the first number that is not known.
const KNOWN: u8 = Record::TABLE.len() as u8;

/// The records that our device sends in 10 s, without replies.
fn usual() -> &'static [Vec<u8>] {
    static USUAL: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    USUAL.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        done(folder.path(), &["simulate", "-o", "usual.mcap", "--duration", "10"]);
        let mut payloads = Vec::new();
        read(&folder.path().join("usual.mcap"), |incoming| {
            if let Item::Frame(Frame::Message { message, .. }) = incoming.item {
                payloads.push(payload(&message));
            }
        })
        .unwrap();
        assert!(payloads.len() > 300, "{}", payloads.len());
        payloads
    })
}

const WORDS: &str = "\u{1b}]52;c;aGk=\u{7}\nforged\u{202e}\u{9b}31m\u{200b}";

/// One conversation with a host.
struct Talk {
    manner: Manner,
    host: TcpStream,
    requests: FrameReader<Request>,
    sequence: u16,
    random: Random,
    /// The host has requested the settings.
    introduced: bool,
    /// Number of frames or batches sent without a request.
    sent: usize,
    /// Number of samples accepted.
    taken: u32,
    /// Number of bytes that may still be sent.
    bytes: usize,
}

fn behave(manner: Manner, host: TcpStream, guest: usize, seed: u64) -> Option<()> {
    host.set_nodelay(true).ok()?;
    let bytes = if manner == Manner::ClosesAfter { guest * 97 % 4096 } else { usize::MAX };
    let random = Random(seed ^ guest as u64);
    let requests = FrameReader::new();
    let mut talk = Talk { manner, host, requests, sequence: 0, random, introduced: false, sent: 0, taken: 0, bytes };
    match manner {
        Manner::Silent => talk.listen(),
        Manner::GoneAtOnce => None,
        Manner::Echo => loop {
            let mut some = [0; 512];
            let count = talk.host.read(&mut some).ok().filter(|count| *count > 0)?;
            talk.raw(&some[..count])?;
        },
        Manner::Trickle => {
            for byte in framed(&payload(&Record::Hello(hello())), 0) {
                talk.raw(&[byte])?;
                thread::sleep(Duration::from_millis(500));
            }
            talk.listen()
        }
        Manner::Noise => talk.forever(&(0..=255).cycle().skip(1).take(4096).collect::<Vec<u8>>()),
        Manner::EndlessFrame => talk.forever(&[0x55; 4096]),
        Manner::Delimiters => talk.forever(&[DELIMITER; 4096]),
        _ => {
            talk.raw(&[DELIMITER])?;
            loop {
                talk.turn()?;
            }
        }
    }
}

pub fn hello() -> Hello {
    Hello {
        wire_version: inerter_wire::WIRE_VERSION,
        firmware: Hello::text("unruly 1"),
        git: Hello::text(""),
        board: Hello::text("unruly"),
        serial: Hello::text("1"),
        sample_rate_hz: 1000.0,
        clock: ClockSource::Crystal,
        capabilities: Capabilities(u32::MAX),
    }
}

impl Talk {
    /// Reads until the host disconnects.
    fn listen(&mut self) -> Option<()> {
        self.host.set_read_timeout(None).ok()?;
        while self.host.read(&mut [0; 512]).ok()? > 0 {}
        None
    }

    fn forever(&mut self, bytes: &[u8]) -> Option<()> {
        loop {
            self.raw(bytes)?;
        }
    }

    fn raw(&mut self, bytes: &[u8]) -> Option<()> {
        let count = bytes.len().min(self.bytes);
        self.bytes -= count;
        self.host.write_all(&bytes[..count]).ok().filter(|()| count == bytes.len())
    }

    fn frame(&mut self, payload: &[u8]) -> Option<()> {
        let mut bytes = framed(payload, self.sequence);
        match self.manner {
            Manner::SequenceStands => {}
            Manner::SequenceBack => self.sequence = self.sequence.wrapping_sub(1),
            Manner::SequenceRandom => self.sequence = self.random.draw() as u16,
            _ => self.sequence = self.sequence.wrapping_add(1),
        }
        match self.manner {
            Manner::BadCrc => {
                let place = bytes.len() - 2;
                // A frame contains no zero byte, and the change must not create one.
                bytes[place] = if bytes[place] == 1 { 2 } else { 1 };
                self.raw(&bytes)
            }
            Manner::ByteByByte => bytes.iter().try_for_each(|byte| self.raw(&[*byte])),
            Manner::Twice => {
                bytes.extend_from_within(..);
                self.raw(&bytes)
            }
            _ => self.raw(&bytes),
        }
    }

    fn say(&mut self, record: &Record) -> Option<()> {
        self.frame(&payload(record))
    }

    /// Reads the requests, answers them, and sends a little more.
    fn turn(&mut self) -> Option<()> {
        if self.introduced {
            match self.manner {
                Manner::Mute => return self.listen(),
                // Until it is disconnected.
                Manner::Deaf => loop {
                    self.raw(&[DELIMITER])?;
                    thread::sleep(Duration::from_millis(200));
                },
                Manner::Resets => {
                    thread::sleep(Duration::from_millis(100));
                    return None;
                }
                Manner::HalfClosed => {
                    self.host.shutdown(Shutdown::Write).ok()?;
                    return self.listen();
                }
                Manner::Introduced => return self.stream(),
                _ => {}
            }
        }
        if self.manner != Manner::Samples {
            for request in requests(&mut self.host, &mut self.requests)? {
                self.answer(request)?;
            }
        }
        self.stream()
    }

    fn answer(&mut self, Request { id, command }: Request) -> Option<()> {
        match self.manner {
            Manner::Late => thread::sleep(Duration::from_secs(2)),
            Manner::TooLate => thread::sleep(Duration::from_millis(3500)),
            _ => {}
        }
        self.introduced |= command == Command::ReadSettings;
        let mut done = Done::Plain;
        let content = match &command {
            Command::Hello => Some(self.hello()),
            Command::ReadSettings => Some(self.settings()),
            Command::ReadSaved => Some(payload(&Record::Saved(SettingsValues::from(&Settings::default())))),
            Command::Measure(what) => Some(payload(&Record::Measured(nonsense(*what)))),
            Command::Inject(samples) if self.manner != Manner::Repeating => {
                self.taken = self.taken.wrapping_add(samples.len() as u32);
                done = Done::Injected { accepted: self.taken, free: 64 };
                None
            }
            _ => None,
        };
        let basic = matches!(command, Command::Hello | Command::ReadSettings);
        let refused = |refusal| (content.clone().filter(|_| basic), if basic { Ok(done) } else { Err(refusal) });
        let (content, result) = match self.manner {
            Manner::Empty => (None, Ok(Done::Plain)),
            Manner::RefusingAll => (None, Err(Refusal::Busy)),
            Manner::Refusing => refused(Refusal::Unsupported),
            Manner::RefusingSettings => {
                refused(Refusal::BadSetting { number: 255, fault: SettingFault::Conflict(255) })
            }
            _ => (content, Ok(done)),
        };
        if let Some(content) = content {
            self.frame(&content)?;
        }
        let id = if self.manner == Manner::OtherId { id.wrapping_add(1) } else { id };
        self.say(&Record::Reply(Reply { id, result }))
    }

    fn hello(&self) -> Vec<u8> {
        let mut hello = hello();
        match self.manner {
            Manner::OtherVersion => hello.wire_version = 7,
            Manner::ControlText => {
                (hello.firmware, hello.git, hello.board) = (Hello::text(WORDS), Hello::text(WORDS), Hello::text(WORDS));
                hello.serial = Hello::text(WORDS);
            }
            Manner::NoCapabilities => hello.capabilities = Capabilities::NONE,
            Manner::RateZero => hello.sample_rate_hz = 0.0,
            Manner::RateNegative => hello.sample_rate_hz = -1000.0,
            Manner::RateHuge => hello.sample_rate_hz = f64::MAX,
            Manner::RateNan => hello.sample_rate_hz = f64::NAN,
            _ => {}
        }
        let mut bytes = payload(&Record::Hello(hello));
        if self.manner == Manner::TornText {
            // The first letter of the firmware's name, after kind, version and length.
            bytes[3] = 0xFF;
        }
        bytes
    }

    fn settings(&self) -> Vec<u8> {
        let mut values = SettingsValues::from(&Settings::default());
        let all = |value: &dyn Fn(usize) -> f64| {
            let mut values = SettingsValues::default();
            for number in 0..Settings::COUNT {
                values.0.push(SettingValue { number: number as u8, value: value(number) }).unwrap();
            }
            values
        };
        match self.manner {
            Manner::SettingsNan => values = all(&|_| f64::NAN),
            Manner::SettingsInfinite => values = all(&|_| f64::INFINITY),
            Manner::SettingsLeast => values = all(&|number| Settings::TABLE[number].min),
            Manner::SettingsGreatest => values = all(&|number| Settings::TABLE[number].max),
            Manner::SettingsUnknown => values.0.iter_mut().for_each(|entry| entry.number += 200),
            Manner::SettingsRepeated => values.0.iter_mut().for_each(|entry| entry.number = 0),
            Manner::SettingsTooMany => {
                // Kind, count, and 50 numbers with their values.
                return [6, 50].into_iter().chain([0, 0, 0, 0, 0, 0, 0, 0, 0x40].repeat(50)).collect();
            }
            _ => {}
        }
        payload(&Record::Settings(values))
    }

    /// Sends data without a request.
    fn stream(&mut self) -> Option<()> {
        let turn = self.sent as u32;
        self.sent += 1;
        if !self.introduced && self.manner != Manner::Samples && self.manner != Manner::HelloFlood {
            return Some(());
        }
        match self.manner {
            Manner::Samples | Manner::Introduced | Manner::Repeating => {
                let batch = samples([7]);
                (0..64).try_for_each(|_| self.frame(&batch))
            }
            Manner::IndexBack => self.frame(&samples((0..16).map(|place| u32::MAX - turn * 16 - place))),
            Manner::IndexCircle => (0..16).try_for_each(|_| self.frame(&samples([7, 8, 9, 7, 8, 9]))),
            Manner::IndexWraps => self.frame(&samples((0..16).map(|place| (turn * 16 + place).wrapping_sub(4000)))),
            Manner::IndexLeaps => {
                self.frame(&samples((0..4).map(|place| (turn * 4 + place).wrapping_mul(0x7FFF_FFFF))))
            }
            Manner::ExtremeSamples => {
                let extreme = |index: u32| {
                    let far = if index.is_multiple_of(2) { i32::MIN } else { i32::MAX };
                    RawSample { index, position_count: far, force_code: far, terminal_code: !far }
                };
                let batch: Vec<RawSample> = (0..16).map(|place| extreme(turn * 16 + place)).collect();
                self.say(&Record::Samples(Samples::from_slice(&batch).0))
            }
            // Kind, count, length, and too few bytes for that count.
            Manner::TornSamples => self.frame(&[1, 200, 3, 0x80, 0x80, 0x80]),
            Manner::EstimatesNan => {
                let mut bytes = vec![2, (turn & 0x7F) as u8, 100, 0, 1];
                for number in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
                    for half in [f32::NAN, -1.0] {
                        bytes.extend(number.to_le_bytes());
                        bytes.extend(half.to_le_bytes());
                        bytes.push(2);
                    }
                }
                bytes.extend(f32::NAN.to_le_bytes());
                bytes.push(1);
                self.frame(&bytes)?;
                self.usual(4, |_, _| {})
            }
            Manner::HealthFlood => {
                let health = Health {
                    index: turn,
                    uptime_s: u32::MAX,
                    dropped_frames: u32::MAX,
                    bad_frames: u32::MAX,
                    lost_samples: u64::MAX,
                    discontinuities: u32::MAX,
                    overruns: u32::MAX,
                    saturated: u32::MAX,
                    cpu_load_permille: Some(u16::MAX),
                    stack_free_bytes: Some(u32::MAX),
                    temperature_c: Some([f32::NAN, f32::INFINITY, f32::MAX][self.sent % 3]),
                };
                let bytes = payload(&Record::Health(health));
                (0..64).try_for_each(|_| self.frame(&bytes))
            }
            Manner::EventFlood => {
                let kinds = [
                    EventKind::Panicked(Hello::text(WORDS)),
                    EventKind::Fault(Fault::SamplerOverrun),
                    EventKind::ResetBy(ResetCause::Unknown),
                    EventKind::Changed(Change::default()),
                    EventKind::Warned(Warning { index: turn, kind: WarningKind::DeadForce }),
                    EventKind::SettingsChanged,
                    EventKind::SourceChanged(Source::Stopped),
                    EventKind::EstimatorReset,
                ];
                kinds.into_iter().try_for_each(|kind| self.say(&Record::Event(Event { index: turn, kind })))
            }
            Manner::WarningFlood => {
                if (1..100).contains(&self.taken) {
                    self.say(&Record::Estimate(Estimate { index: turn, ..Estimate::default() }))?;
                }
                let warned = EventKind::Warned(Warning { index: turn, kind: WarningKind::CountSlip });
                let bytes = payload(&Record::Event(Event { index: turn, kind: warned }));
                (0..64).try_for_each(|_| self.frame(&bytes))
            }
            Manner::HelloFlood => {
                let bytes = self.hello();
                (0..64).try_for_each(|_| {
                    self.sequence = 0;
                    self.frame(&bytes)
                })
            }
            Manner::RestartFlood => {
                self.sequence = 0;
                self.say(&Record::Event(Event { index: 0, kind: EventKind::Started }))?;
                let bytes = self.hello();
                self.frame(&bytes)
            }
            Manner::LaterVersion if turn > 20 => {
                self.frame(&payload(&Record::Hello(Hello { wire_version: 7, ..hello() })))
            }
            Manner::ReplyFlood => (0..64).try_for_each(|_| {
                let id = self.random.draw() as u16;
                self.say(&Record::Reply(Reply { id, result: Ok(Done::Plain) }))
            }),
            Manner::UnknownRecords => (KNOWN..KNOWN + 64)
                .try_for_each(|kind| self.frame(&[kind, 1, 2, 3, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x0F])),
            Manner::LongestFrames => self.frame(&[&[100][..], &[0xA5; MAX_PAYLOAD - 1]].concat()),
            Manner::TooLongFrames => self.frame(&[&[1][..], &[0xA5; 5000]].concat()),
            Manner::RandomRecords => {
                let length = 1 + self.random.draw() as usize % 300;
                let mut bytes: Vec<u8> = (0..length).map(|_| self.random.draw() as u8).collect();
                bytes[0] %= KNOWN;
                self.frame(&bytes)
            }
            Manner::Mutated => self.usual(4, |bytes, random| {
                for _ in 0..random.draw() % 4 {
                    let place = random.draw() as usize % bytes.len();
                    bytes[place] ^= 1 << (random.draw() % 8);
                }
            }),
            Manner::Empty | Manner::RefusingAll => Some(()),
            _ => self.usual(4, |_, _| {}),
        }
    }

    /// Sends some more of the usual records, starting again at the end.
    fn usual(&mut self, frames: usize, mut change: impl FnMut(&mut Vec<u8>, &mut Random)) -> Option<()> {
        let all = usual();
        let from = self.sent * frames;
        (from..from + frames).try_for_each(|place| {
            let mut bytes = all[place % all.len()].clone();
            change(&mut bytes, &mut self.random);
            self.frame(&bytes)
        })
    }
}

/// The requests received within a millisecond; `None` once the host has disconnected.
pub fn requests(host: &mut TcpStream, reader: &mut FrameReader<Request>) -> Option<Vec<Request>> {
    host.set_read_timeout(Some(Duration::from_millis(1))).ok()?;
    let mut portion = [0; 512];
    let count = match host.read(&mut portion) {
        Ok(0) => return None,
        Ok(count) => count,
        Err(error) if [ErrorKind::WouldBlock, ErrorKind::TimedOut].contains(&error.kind()) => 0,
        Err(_) => return None,
    };
    let (mut input, mut asked) = (&portion[..count], Vec::new());
    while let Some(found) = reader.read(&mut input) {
        if let Frame::Message { message, .. } = found {
            asked.push(message);
        }
    }
    Some(asked)
}

/// A batch of samples with these numbers.
fn samples(indices: impl IntoIterator<Item = u32>) -> Vec<u8> {
    let raw = |index| RawSample { index, position_count: 100, force_code: 100, terminal_code: 0 };
    let all: Vec<RawSample> = indices.into_iter().map(raw).collect();
    payload(&Record::Samples(Samples::from_slice(&all).0))
}

/// Every command that talks to a device, without its link option.
pub const COMMANDS: &[&[&str]] = &[
    &["monitor", "--json"],
    &["monitor", "--plain", "--wait", "60"],
    &["monitor", "--plain", "--share", "127.0.0.1:0", "--web", "--bind", "127.0.0.1:0"],
    &["record", "-o", "run.mcap", "--force", "--wait", "60"],
    &["send", "sent.mcap"],
    &["doctor"],
    &["settings", "get"],
    &["settings", "set", "memory_s=12"],
    &["settings", "tare"],
    &["settings", "save"],
    &["settings", "factory-reset", "--yes"],
    &["settings", "backup", "kept.toml", "--force"],
    &["settings", "restore", "before.toml"],
    &["settings", "diff", "device", "before.toml"],
    &["calibrate"],
    &["calibrate", "load-cell", "--duration", "60"],
    &["calibrate", "zero", "--duration", "60"],
    &["calibrate", "force", "--mass", "1"],
    &["calibrate", "encoder", "--revolutions", "1", "--lead", "0.01"],
    &["calibrate", "direction", "--duration", "60"],
    &["calibrate", "skew", "--duration", "60"],
    &["calibrate", "stiffness", "--duration", "60"],
    &["calibrate", "timebase", "--duration", "60"],
    &["selftest", "-o", "board.html", "--force"],
    &["update", "image.elf", "--force"],
];

/// As many figures as possible, each as large as possible.
fn nonsense(what: Measure) -> Measured {
    let figures = (0..MAX_FIGURES).map(|number| Figure { quantity: 3 * number as u8, value: u32::MAX - number as u32 });
    Measured { what, figures: figures.collect() }
}

/// A folder with the files that the commands need.
pub fn prepared() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    done(folder.path(), &["simulate", "-o", "sent.mcap", "--duration", "5"]);
    std::fs::write(folder.path().join("before.toml"), "memory_s = 5.0\n").unwrap();
    std::fs::write(folder.path().join("image.elf"), elf_file::image(5000, "inerter 0.1.0", "c8a2d5a")).unwrap();
    folder
}

/// A command connected to a device; its output is read and checked in the meantime.
pub struct Visit {
    pub child: Child,
    readers: Vec<JoinHandle<Option<String>>>,
    shown: Option<Arc<Mutex<Vec<u8>>>>,
    most_kb: u64,
}

impl Visit {
    /// Starts the command with this device. The calibration wizard gets a simulated person who presses Enter at every
    /// question.
    pub fn start(folder: &Path, command: &[&str], address: &str) -> Self {
        let mut program = inerter(folder, &[command, &["--connect", address]].concat());
        let mut shown = None;
        if command == ["calibrate"] {
            let (terminal, all) = patient();
            program.stdin(terminal.try_clone().unwrap()).stderr(terminal);
            shown = Some(all);
        }
        let mut child = program.spawn().unwrap();
        let out = child.stdout.take().map(|pipe| thread::spawn(|| foreign_line(pipe)));
        let errors = child.stderr.take().map(|pipe| thread::spawn(|| foreign_line(pipe)));
        Self { child, readers: out.into_iter().chain(errors).collect(), shown, most_kb: 0 }
    }

    /// The exit status, if the command ends in time; otherwise it is killed.
    pub fn ended(&mut self, within: Duration) -> Option<ExitStatus> {
        if self.goes_on(within) {
            self.child.kill().ok();
            self.child.wait().ok();
            return None;
        }
        self.child.try_wait().unwrap()
    }

    /// Whether it still runs after this time.
    pub fn goes_on(&mut self, after: Duration) -> bool {
        let started = Instant::now();
        loop {
            self.most_kb = self.most_kb.max(most_memory_kb(&self.child).unwrap_or(0));
            if self.child.try_wait().unwrap().is_some() {
                return false;
            }
            if started.elapsed() > after {
                return true;
            }
            thread::sleep(Duration::from_millis(10));
        }
    }

    /// The most memory that it used, and the first line of its output that must not reach a terminal.
    pub fn end(self) -> (u64, Option<String>) {
        let mut foreign: Option<String> = None;
        for reader in self.readers {
            foreign = foreign.or(reader.join().unwrap());
        }
        let shown = self.shown.map(|shown| spoken(&text(&shown.lock().unwrap())));
        (self.most_kb, foreign.or(shown.and_then(|words| foreign_words(&words))))
    }
}

/// The exit status of a program, if it ends in time; otherwise it is killed.
pub fn ended(child: &mut Child, within: Duration) -> Option<ExitStatus> {
    let started = Instant::now();
    while started.elapsed() < within {
        if let Some(status) = child.try_wait().unwrap() {
            return Some(status);
        }
        thread::sleep(Duration::from_millis(5));
    }
    child.kill().ok();
    child.wait().ok();
    None
}

/// Reads to the end. Returns the first line with characters that must not reach a terminal.
fn foreign_line(pipe: impl Read) -> Option<String> {
    let (mut pipe, mut line, mut foreign) = (BufReader::new(pipe), Vec::new(), None);
    while pipe.read_until(b'\n', &mut line).unwrap() > 0 {
        foreign = foreign.or_else(|| foreign_words(&text(&line)));
        line.clear();
    }
    foreign
}

/// The most memory that a child process has used, if the system reports it. A process that has ended reports none, and
/// one that has not yet executed the program would report this process's memory.
pub fn most_memory_kb(child: &Child) -> Option<u64> {
    let name = std::fs::read_to_string(format!("/proc/{}/comm", child.id())).ok()?;
    memory_kb(child.id(), "VmHWM:").filter(|_| name.trim_end() == "inerter")
}

/// One figure from `/proc/PID/status`.
pub fn memory_kb(pid: u32, name: &str) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    status.lines().find_map(|line| line.strip_prefix(name)?.trim().strip_suffix(" kB")?.parse().ok())
}

/// The bytes of a request.
pub fn request(id: u16, command: Command) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = encode_request(&Request { id, command }, 0, &mut out).unwrap();
    out[..length].to_vec()
}
