//! Small named streams, and a device's response to them.
//!
//! `tests/corpus/NAME.bin` holds the bytes, `NAME.txt` the expected outcome: a line `bad_frames N`, then a line for
//! each reply in order: `ID done`, `ID injected` or `ID refused WHY`. Both are made by `cargo run -p inerter-tests
//! --bin measure -- fuzz --write-corpus`, from this file and [`stream`] alone.
//!
//! A delimiter follows each stream, so that an unfinished frame is counted too. The outcomes hold for a device that was
//! never set up, whose sampler runs and which takes the bytes as they come; they are the same on the host and on the
//! twin.

use inerter_core::{RawSample, Settings};
use inerter_needs::Random;
use inerter_wire::{
    Command, DELIMITER, MAX_FRAME, MAX_PAYLOAD, MAX_SETTINGS, Record, Samples, SettingValue, SettingsValues, Streams,
};
use std::{fs, io, path::PathBuf};

use super::{
    device::{Conditions, play, with_probe},
    judge::judge,
    make::{Stream, frame, payload, records, samples, stream, stuffed, varint},
    outcome::outcome,
    requests::Requests,
};

/// The expected outcome of a stream.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Expected {
    /// Frames that the device counts as bad.
    pub bad_frames: u32,
    /// Id and [`outcome`] of each reply, in order.
    pub replies: Vec<(u16, String)>,
}

/// A stream of the corpus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Item {
    /// What it is.
    pub name: String,
    /// Bytes sent to the device.
    pub bytes: Vec<u8>,
    /// Its expected outcome.
    pub expected: Expected,
}

impl Expected {
    fn text(&self) -> String {
        let replies = self.replies.iter().map(|(id, outcome)| format!("{id} {outcome}\n"));
        format!("bad_frames {}\n{}", self.bad_frames, replies.collect::<String>())
    }

    fn parse(text: &str) -> Option<Self> {
        let mut lines = text.lines();
        let bad_frames = lines.next()?.strip_prefix("bad_frames ")?.parse().ok()?;
        let replies = lines.map(|line| {
            let (id, outcome) = line.split_once(' ')?;
            Some((id.parse().ok()?, outcome.to_string()))
        });
        Some(Self { bad_frames, replies: replies.collect::<Option<_>>()? })
    }
}

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

/// The committed corpus, by name.
pub fn corpus() -> io::Result<Vec<Item>> {
    let mut items = Vec::new();
    for entry in fs::read_dir(folder())? {
        let path = entry?.path();
        if path.extension().is_none_or(|extension| extension != "bin") {
            continue;
        }
        let text = fs::read_to_string(path.with_extension("txt"))?;
        let wrong =
            || io::Error::new(io::ErrorKind::InvalidData, format!("{}: its .txt is not of that form", path.display()));
        items.push(Item {
            name: path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
            bytes: fs::read(&path)?,
            expected: Expected::parse(&text).ok_or_else(wrong)?,
        });
    }
    items.sort_by(|one, other| one.name.cmp(&other.name));
    Ok(items)
}

/// The corpus as this file makes it, by name, with the response of the device here; an error says what that does wrong.
pub fn made() -> Result<Vec<Item>, String> {
    let mut items = Vec::new();
    for (name, stream) in streams() {
        let played = play(&stream.bytes, &Conditions::PLAIN);
        let findings = judge(&stream.bytes, &Conditions::PLAIN, &played);
        if let Some(finding) = findings.first() {
            return Err(format!("{name}: {finding}"));
        }
        let replies = played.records.iter().filter_map(|record| match record {
            Record::Reply(reply) => Some((reply.id, outcome(&reply.result))),
            _ => None,
        });
        let mut expected = Expected {
            bad_frames: Requests::read(&[&stream.bytes[..], &[DELIMITER]].concat()).bad_frames,
            replies: replies.collect(),
        };
        // The probe is not part of the item.
        let probe = Requests::read(&with_probe(&[])).intact.len();
        expected.replies.truncate(expected.replies.len().saturating_sub(probe));
        items.push(Item { name, bytes: stream.bytes, expected });
    }
    items.sort_by(|one, other| one.name.cmp(&other.name));
    Ok(items)
}

/// Writes the corpus anew; returns the number of its streams.
pub fn write() -> Result<usize, String> {
    let items = made()?;
    let act = || {
        fs::create_dir_all(folder())?;
        for old in corpus()? {
            fs::remove_file(folder().join(&old.name).with_extension("bin"))?;
            fs::remove_file(folder().join(&old.name).with_extension("txt"))?;
        }
        for item in &items {
            fs::write(folder().join(&item.name).with_extension("bin"), &item.bytes)?;
            fs::write(folder().join(&item.name).with_extension("txt"), item.expected.text())?;
        }
        Ok(items.len())
    };
    act().map_err(|error: io::Error| format!("{}: {error}", folder().display()))
}

fn set(pairs: &[(&str, f64)]) -> Command {
    let pairs = pairs.iter().map(|&(name, value)| (Settings::find(name).unwrap_or(usize::MAX) as u8, value));
    write_numbers(pairs)
}

fn write_numbers(pairs: impl IntoIterator<Item = (u8, f64)>) -> Command {
    Command::WriteSettings(SettingsValues(
        pairs.into_iter().take(MAX_SETTINGS).map(|(number, value)| SettingValue { number, value }).collect(),
    ))
}

fn shaken(from: u32, count: u32) -> Command {
    let sample = |index: u32| {
        let phase = f64::from(index) / 50.0;
        RawSample {
            index,
            position_count: (100_000.0 * phase.sin()) as i32,
            force_code: (131_040.0 - 20_000.0 * phase.sin()) as i32,
            terminal_code: 0,
        }
    };
    Command::Inject(Samples::from_slice(&(from..from + count).map(sample).collect::<Vec<_>>()).0)
}

/// Every stream and its name.
fn streams() -> Vec<(String, Stream)> {
    let mut all: Vec<(&str, Stream)> = Vec::new();
    let mut add = |name, make: &dyn Fn(&mut Stream)| {
        let mut stream = Stream::default();
        make(&mut stream);
        all.push((name, stream));
    };
    requests(&mut add);
    settings(&mut add);
    injections(&mut add);
    frames(&mut add);
    let mut all: Vec<(String, Stream)> = all.into_iter().map(|(name, stream)| (name.to_string(), stream)).collect();
    // Those random streams in which nothing depends on time or on a second front end, and no restart happens.
    let front_end = Settings::find("front_end").map(|number| number as u8);
    let steady = |command: &Command| match command {
        Command::Tare | Command::Inject(_) | Command::Reboot | Command::EnterDfu => false,
        Command::WriteSettings(values) => values.0.iter().all(|entry| Some(entry.number) != front_end),
        _ => true,
    };
    let calm = (0..).map(|seed| (seed, stream(seed))).filter(|(_, stream)| {
        let Requests { intact, bad_frames } = Requests::read(&with_probe(&stream.bytes));
        let telling = bad_frames >= 4 && intact.len() >= 8 && stream.bytes.len() < 4_000;
        telling && intact.iter().all(|(_, command)| command.as_ref().is_none_or(steady))
    });
    all.extend(calm.take(8).map(|(seed, stream)| (format!("random-{seed:04}"), stream)));
    all
}

type Add<'a> = &'a mut dyn FnMut(&'static str, &dyn Fn(&mut Stream));

fn requests(add: Add) {
    add("every-command", &|stream| {
        let commands = [
            Command::Hello,
            Command::ReadSettings,
            set(&[("memory_s", 10.0), ("sample_rate_hz", 2_000.0)]),
            Command::ReadSaved,
            Command::SaveSettings,
            Command::ReadSaved,
            Command::Streams(Streams::ALL),
            Command::ResetEstimator,
            Command::Stop,
            shaken(0, 16),
            shaken(16, 16),
            Command::InjectEnd,
            Command::Start,
            Command::FactoryReset,
            Command::ReadSettings,
        ];
        (1..).zip(commands).for_each(|(id, command)| {
            stream.request(id, command);
        });
    });
    add("tare", &|stream| {
        stream.request(1, Command::Tare).request(2, Command::ReadSettings);
    });
    add("tare-with-nothing-to-measure", &|stream| {
        stream.request(1, Command::Stop).request(2, Command::Tare).request(3, shaken(0, 8)).request(4, Command::Tare);
        stream.request(5, Command::InjectEnd).request(6, Command::Tare);
    });
    add("unknown-commands", &|stream| {
        for number in [15u32, 20, 127, 128, 1_000, u32::MAX] {
            let bytes = [&[7][..], &varint(number)].concat();
            stream.payload(&bytes).payload(&[&bytes[..], &[1, 2, 3, 4]].concat());
        }
    });
    add("ids-of-all-kinds", &|stream| {
        for id in [0, 1, 127, 128, 255, 256, 16_383, 16_384, 32_768, u16::MAX, 5, 5, 5] {
            stream.request(id, Command::Hello);
        }
        // In more bytes than needed, and with a value too large for a u16.
        for id in [&[0x85, 0x00][..], &[0x85, 0x80, 0x00], &[0xFF, 0xFF, 0x7F], &[0x80, 0x80, 0x80, 0x80, 0x01]] {
            stream.payload(&[id, &[0]].concat());
        }
    });
    add("flood-of-hellos", &|stream| {
        (0..150).for_each(|id| {
            stream.request(id, Command::Hello);
        })
    });
    add("flood-of-saves", &|stream| {
        for id in 0..50 {
            stream
                .request(2 * id, set(&[("memory_s", 10.0 + f64::from(id))]))
                .request(2 * id + 1, Command::SaveSettings);
        }
    });
    add("flood-of-factory-resets", &|stream| {
        for id in 0..10 {
            stream.request(3 * id, Command::SaveSettings).request(3 * id + 1, Command::FactoryReset);
            stream.request(3 * id + 2, Command::FactoryReset);
        }
    });
    add("start-and-stop", &|stream| {
        for id in 0..20 {
            stream.request(2 * id, Command::Stop).request(2 * id + 1, Command::Start);
        }
    });
    add("streams-of-all-kinds", &|stream| {
        for bits in 0..16u16 {
            let on = |bit: u16| bits >> bit & 1 == 1;
            let streams = Streams { samples: on(0), estimates: on(1), sums: on(2), health: on(3) };
            stream.request(bits, Command::Streams(streams));
        }
        // A bool is 0 or 1.
        stream.payload(&[99, 5, 2, 0, 0, 0]).payload(&[99, 5, 0, 0, 0, 0xFF]);
    });
}

fn settings(add: Add) {
    add("settings-out-of-range", &|stream| {
        for (number, info) in (0u8..).zip(Settings::TABLE) {
            let beyond = |value: f64, by: f64| value + by * value.abs().max(1e-6) * 1e-6;
            stream.request(2 * u16::from(number), write_numbers([(17, 11.0), (number, beyond(info.max, 1.0))]));
            stream.request(2 * u16::from(number) + 1, write_numbers([(17, 12.0), (number, beyond(info.min, -1.0))]));
        }
        stream.request(100, Command::ReadSettings);
    });
    add("settings-not-finite", &|stream| {
        for (id, value) in (0..).zip([f64::NAN, -f64::NAN, f64::INFINITY, f64::NEG_INFINITY]) {
            stream.request(2 * id, write_numbers([(17, 11.0), (12, value)]));
            stream.request(2 * id + 1, write_numbers([(0, value)]));
        }
    });
    add("settings-zero-and-fractions", &|stream| {
        stream.request(0, set(&[("metres_per_count", 0.0)])).request(1, set(&[("newtons_per_code", -0.0)]));
        stream.request(2, set(&[("newtons_per_code", 5e-324)])).request(3, set(&[("oversampling", 1.5)]));
        stream.request(4, set(&[("force_zero_code", 0.1)])).request(5, set(&[("front_end", 0.5)]));
        stream.request(6, Command::ReadSettings);
    });
    add("settings-repeated", &|stream| {
        stream.request(1, set(&[("memory_s", 10.0), ("memory_s", 10.0)]));
        stream.request(2, set(&[("memory_s", 10.0), ("skew_s", 0.0), ("memory_s", 11.0)]));
        stream.request(3, Command::ReadSettings);
    });
    add("settings-unknown", &|stream| {
        for number in [Settings::COUNT as u8, 47, 48, 63, 64, 127, 128, 255] {
            stream.request(number.into(), write_numbers([(17, 11.0), (number, 1.0)]));
        }
        stream.request(1, Command::ReadSettings);
    });
    add("settings-in-conflict", &|stream| {
        stream.request(1, set(&[("force_min_code", 200_000.0), ("force_max_code", 100_000.0)]));
        stream.request(2, set(&[("force_min_code", 262_080.0)]));
        stream.request(3, Command::ReadSettings);
    });
    add("settings-too-many", &|stream| {
        let all = || (0..MAX_SETTINGS as u8).map(|number| (number, 1.0));
        stream.request(1, write_numbers(all())).request(2, write_numbers(all().map(|(_, value)| (17, value))));
        // One more than fits, and a count without its values.
        let mut bytes = payload(3, write_numbers(all()));
        bytes[2] += 1;
        bytes.extend([17; 9]);
        stream.payload(&bytes).payload(&[4, 2, 48]).payload(&[5, 2, 0xFF, 0xFF, 0xFF, 0xFF, 0x0F]);
        stream.request(6, write_numbers([]));
    });
    add("rates-that-are-not-offered", &|stream| {
        for (id, rate) in (0..).zip([50.0, 500.0, 1_000.5, 3_999.0, 5_000.0, 3_906.25]) {
            stream.request(id, set(&[("sample_rate_hz", rate)]));
        }
        stream.request(9, Command::ReadSettings);
    });
    add("rates-in-turn", &|stream| {
        for (id, rate) in (0..).zip([2_000.0, 4_000.0, 1_000.0, 4_000.0, 2_000.0, 1_000.0]) {
            stream.request(id, set(&[("sample_rate_hz", rate)]));
        }
    });
}

fn injections(add: Add) {
    add("injected-nonsense", &|stream| {
        let odd: [(u8, &[u8]); 8] = [
            (33, &[0; 132]),
            (255, &[0; 400]),
            (2, &[0, 0, 0, 0]),
            (0, &[1]),
            (1, &[0, 0, 0]),
            (1, &[0xFF; 20]),
            (1, &[0xFF, 0xFF, 0xFF, 0xFF, 0x7F, 0, 0, 0]),
            (1, &[0, 0, 0, 0, 0]),
        ];
        for (id, (count, data)) in (0..).zip(odd) {
            stream.request(id, Command::Inject(samples(count, data)));
        }
        stream.request(8, Command::InjectEnd);
        // More bytes than a batch has.
        stream.payload(&[&[9, 9, 1, 0x91, 0x03][..], &[0; 401]].concat());
    });
    add("injected-extremes", &|stream| {
        let ends = [i32::MIN, i32::MAX, 0, -1];
        let sample = |place: u32| RawSample {
            index: [0, u32::MAX, 1, 0x8000_0000][place as usize % 4].wrapping_add(place / 4),
            position_count: ends[place as usize % 4],
            force_code: ends[place as usize / 2 % 4],
            terminal_code: ends[place as usize / 3 % 4],
        };
        for id in 0..12 {
            let all: Vec<RawSample> = (0..16).map(|place| sample(id * 16 + place)).collect();
            stream.request(id as u16, Command::Inject(Samples::from_slice(&all).0));
        }
        stream.request(12, Command::InjectEnd).request(13, Command::InjectEnd);
    });
    add("injection-without-samples", &|stream| {
        stream.request(0, Command::InjectEnd).request(1, Command::Inject(Samples::default()));
        stream.request(2, Command::InjectEnd).request(3, Command::InjectEnd).request(4, Command::Start);
    });
    add("injection-of-a-thousand", &|stream| {
        (0..32).for_each(|id| {
            stream.request(id, shaken(u32::from(id) * 32, 32));
        });
        stream.request(32, Command::InjectEnd);
    });
}

fn frames(add: Add) {
    add("empty-frames", &|stream| {
        stream.raw(&[DELIMITER; 700]).request(1, Command::Hello);
    });
    add("one-long-frame", &|stream| {
        stream.raw(&[0x55; 3_000]).request(1, Command::Hello);
    });
    add("frames-just-too-long", &|stream| {
        for length in MAX_FRAME - 2..MAX_FRAME + 3 {
            stream.raw(&vec![0xFF; length]).raw(&[DELIMITER]);
        }
        for length in MAX_PAYLOAD - 1..MAX_PAYLOAD + 3 {
            stream.payload(&vec![1; length]);
        }
        stream.request(1, Command::Hello);
    });
    add("cut-frames", &|stream| {
        let frame = stream.next_frame(7, set(&[("memory_s", 10.0)]));
        for length in 0..frame.len() {
            stream.raw(&frame[..length]).raw(&[DELIMITER]);
        }
        stream.raw(&frame);
    });
    add("cut-frames-run-together", &|stream| {
        let frame = stream.next_frame(7, Command::Hello);
        for length in 0..frame.len() {
            stream.raw(&frame[..length]);
        }
        stream.raw(&frame).raw(&frame);
    });
    add("every-bit-flipped", &|stream| {
        let frame = stream.next_frame(7, Command::SaveSettings);
        for bit in 0..(frame.len() - 1) * 8 {
            let mut damaged = frame.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            stream.raw(&damaged);
        }
        stream.raw(&[DELIMITER]).raw(&frame);
    });
    add("spliced-frames", &|stream| {
        let (one, other) =
            (stream.next_frame(7, set(&[("memory_s", 10.0)])), stream.next_frame(8, Command::FactoryReset));
        for (head, tail) in [(&one, &other), (&other, &one)] {
            for cut in 1..head.len().min(tail.len()) {
                stream.raw(&head[..cut]).raw(&tail[cut..]);
            }
        }
        stream.request(9, Command::ReadSettings);
    });
    add("payloads-cut-and-drawn-out", &|stream| {
        let bytes = payload(7, set(&[("memory_s", 10.0)]));
        for length in 0..bytes.len() {
            stream.payload(&bytes[..length]);
        }
        stream.payload(&[&bytes[..], &[0]].concat()).payload(&[&payload(8, Command::Hello)[..], &[1, 2, 3]].concat());
        stream.payload(&bytes);
    });
    add("stuffing-gone-wrong", &|stream| {
        for body in [&[2][..], &[0xFF], &[1, 1, 1, 1, 1, 1, 1], &[3, 1], &[8, 1, 2, 3, 4, 5, 6]] {
            stream.raw(body).raw(&[DELIMITER]);
        }
        stream.raw(&stuffed(&[])).raw(&stuffed(&[0; 6])).raw(&stuffed(&[0; 7])).raw(&stuffed(&[0xFF; 100]));
    });
    add("order-of-frames", &|stream| {
        for (id, sequence) in (0..).zip([0, 5, 4, 3, 3, 65_535, 0, 32_768, 1, 40_000, 40_001]) {
            stream.raw(&frame(&payload(id, Command::Hello), sequence));
        }
    });
    add("echo", &|stream| {
        for _ in 0..3 {
            records().iter().for_each(|frame| {
                stream.raw(frame);
            });
        }
        stream.request(1, Command::Hello);
    });
    add("requests-without-their-salt", &|stream| {
        // Like a record's CRC: a request must not be mistaken for one.
        let mut body = [payload(7, Command::FactoryReset), vec![0, 0]].concat();
        body.extend(crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&body).to_le_bytes());
        stream.raw(&stuffed(&body));
    });
    add("noise", &|stream| {
        stream.raw(&Random(1).bytes(3_000));
    });
    add("text", &|stream| {
        stream.raw(b"AT+CGMI\r\nATZ\r\n~\x03\x04\x1b[A\r\nroot\r\n\r\nGET / HTTP/1.1\r\n\r\n").raw(&[DELIMITER]);
        stream.request(1, Command::Hello);
    });
}
