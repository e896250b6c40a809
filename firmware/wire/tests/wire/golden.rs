//! Golden encodings of every record and command.
//!
//! The files contain one frame per line, with sequence number 258 (`02 01`). A released line never changes: later
//! versions must always decode what a device sent in that form. New lines are appended; the test prints a missing one
//! in full.

use crate::frames::{framed, hex, intact, payload, read_all};
use crate::reference;
use crate::values::{
    longest_detail, longest_measured, longest_more_sums, longest_samples, longest_sums, most_settings, records,
    requests,
};
use inerter_core::{
    Backlash, BacklashSize, BacklashStatus, Bank, Changed, Contact, Detail, Estimate, Interval, Law, LawStatus, Misfit,
    Parameter, Reason, Regime, Route, Status, WarningKind,
};
use inerter_needs::Random;
use inerter_wire::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Debug;

const SEQUENCE: u16 = 0x0102;

fn unhex(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

/// Compares both ways. `number` and the table ensure that no variant is missing.
fn check<T: Message + PartialEq + Debug + Clone>(
    file: &str,
    text: &str,
    values: &[(&str, T)],
    table: &[protocol::Entry],
    number: impl Fn(&T) -> u32,
) {
    let mut golden: BTreeMap<&str, Vec<u8>> = text
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| line.split_once(": ").unwrap())
        .map(|(name, bytes)| (name, unhex(bytes)))
        .collect();
    let mut missing = String::new();
    for (name, value) in values {
        let bytes = hex(&framed(value, SEQUENCE));
        match golden.remove(name) {
            None => missing += &format!("{name}: {bytes}\n"),
            Some(expected) => {
                assert_eq!(bytes, hex(&expected), "{file}: {name} is sent otherwise than before");
                let frame = intact(value.clone(), SEQUENCE);
                assert_eq!(read_all(&expected), [frame], "{file}: {name} is read otherwise than before");
            }
        }
    }
    assert!(missing.is_empty(), "add to {file}:\n{missing}");
    assert!(golden.is_empty(), "{file} has lines without a value: {:?}", golden.keys());

    let covered: BTreeSet<u32> = values.iter().map(|(_, value)| number(value)).collect();
    let known: BTreeSet<u32> = table.iter().map(|entry| entry.number).collect();
    assert_eq!(covered, known, "every variant has a golden");
    for (name, value) in values {
        let entry = table.iter().find(|entry| entry.number == number(value)).unwrap();
        assert_eq!(name.split('.').next(), Some(entry.name));
    }
}

#[test]
fn records_both_ways() {
    check("golden/records.txt", include_str!("golden/records.txt"), &records(), Record::TABLE, Record::number);
}

#[test]
fn commands_both_ways() {
    check("golden/commands.txt", include_str!("golden/commands.txt"), &requests(), Command::TABLE, |request| {
        request.command.number()
    });
}

/// Older firmware sent zeros before its first fit, where later firmware sends an infinite half width.
#[test]
fn zeros_before_the_first_fit_are_nothing() {
    let zeros = format!("02 02{} 07 02 01 fc f9 fa 85 00", " 01".repeat(80));
    assert_eq!(read_all(&unhex(&zeros)), [intact(Record::Estimate(Estimate::default()), SEQUENCE)]);
    let zeros = format!("02 09{} 03 80 7f 02{} 07 02 01 23 85 05 54 00", " 01".repeat(14), " 01".repeat(24));
    assert_eq!(read_all(&unhex(&zeros)), [intact(Record::Detail(Detail::default()), SEQUENCE)]);
}

/// A value that the motion cannot identify is sent as fitted; a value with zero half width is a valid value.
#[test]
fn parameters_keep_value_and_half_width() {
    let parameter = |value, u95, status| Parameter::new(Interval { value, u95 }, status);
    for sent in [parameter(12.0, 3.0, Status::NotIdentifiable), parameter(12.0, 0.0, Status::Ok)] {
        let message = Record::Detail(Detail { stiffness_n_per_m: sent, ..Detail::default() });
        assert_eq!(read_all(&framed(&message, SEQUENCE)), [intact(message, SEQUENCE)]);
    }
}

/// A backlash that is NaN or infinite counts as unknown, whatever its status.
#[test]
fn a_backlash_without_a_number_is_not_known() {
    for interval in [
        Interval { value: f32::NAN, u95: 1e-6 },
        Interval { value: 1e-4, u95: f32::NAN },
        Interval { value: f32::INFINITY, u95: 1e-6 },
        Interval { value: 1e-4, u95: f32::INFINITY },
    ] {
        for size in [BacklashSize::Ok(interval), BacklashSize::BelowU95(interval)] {
            let sent = Detail { backlash: Backlash { size, ..Backlash::default() }, ..Detail::default() };
            let found = read_all(&framed(&Record::Detail(sent), SEQUENCE));
            assert_eq!(found, [intact(Record::Detail(Detail::default()), SEQUENCE)], "{size:?}");
        }
    }
}

/// A misfit that is NaN or infinite counts as unknown, and nothing is stated about the law.
#[test]
fn a_misfit_without_a_number_is_not_known() {
    for misfit in [
        Misfit { ratio: f32::NAN, limit: 1.5 },
        Misfit { ratio: f32::INFINITY, limit: 1.5 },
        Misfit { ratio: 3.0, limit: f32::NAN },
    ] {
        let sent = Law { index: 7, status: LawStatus::Broken, misfit: Some(misfit) };
        let found = read_all(&framed(&Record::Law(sent), SEQUENCE));
        assert_eq!(found, [intact(Record::Law(Law { index: 7, ..Law::default() }), SEQUENCE)], "{misfit:?}");
    }
}

/// Without the wire, core serialises its own enums: they contain nothing infinite, which JSON cannot represent.
#[test]
fn estimates_survive_json() {
    for (name, record) in records() {
        match record {
            Record::Estimate(estimate) => assert_eq!(through_json(&estimate), estimate, "{name}"),
            Record::Detail(detail) => assert_eq!(through_json(&detail), detail, "{name}"),
            Record::Law(law) => assert_eq!(through_json(&law), law, "{name}"),
            _ => {}
        }
    }
}

fn through_json<T: serde::Serialize + serde::de::DeserializeOwned>(value: &T) -> T {
    serde_json::from_str(&serde_json::to_string(value).unwrap()).unwrap()
}

/// Number and name of a message, in a match that does not compile if a variant is missing.
macro_rules! pinned {
    ($message:expr, $kind:ident: $($number:literal $variant:ident),+ $(,)?) => {
        match $message {
            $($kind::$variant { .. } => ($number, stringify!($variant)),)+
        }
    };
}

/// The numbers as literals.
#[test]
fn numbers_are_pinned() {
    for (_, record) in records() {
        let (number, name) = pinned!(
            record,
            Record: 0 Hello, 1 Samples, 2 Estimate, 3 Health, 4 Event, 5 Reply, 6 Settings, 7 Sums, 8 Reversal,
            9 Detail, 10 MoreSums, 11 Law, 12 Saved, 13 Measured,
        );
        assert_eq!((record.number(), record.name()), (number, name));
        assert_eq!(u32::from(payload(&record)[0]), number);
    }
    for (_, request) in requests() {
        let (number, name) = pinned!(
            request.command,
            Command: 0 Hello, 1 ReadSettings, 2 WriteSettings, 3 SaveSettings, 4 Tare, 5 Streams, 6 ResetEstimator,
            7 Start, 8 Stop, 9 Inject, 10 InjectEnd, 11 EnterDfu, 12 Reboot, 13 FactoryReset, 14 ReadSaved, 15 Measure,
            16 Play,
        );
        assert_eq!((request.command.number(), request.command.name()), (number, name));
        assert_eq!(u32::from(payload(&request)[2]), number);
    }
    let bits = [
        Capabilities::SAMPLER,
        Capabilities::INJECT,
        Capabilities::TERMINAL,
        Capabilities::STORE,
        Capabilities::DFU,
        Capabilities::REBOOT,
        Capabilities::SUMS,
        Capabilities::MEASURE,
        Capabilities::PLAYER,
    ];
    assert_eq!(bits.map(|bit| bit.0), [1, 2, 4, 8, 16, 32, 64, 128, 256]);
    let sized = Capabilities::DFU.with_flash_kb(128).with_flash_kb(512);
    assert_eq!((sized.0, sized.flash_kb()), (512 << 16 | 16, Some(512)));
    assert!(sized.contains(Capabilities::DFU) && !sized.contains(Capabilities::REBOOT));
    assert_eq!(bits.map(Capabilities::flash_kb), [None; 9], "older firmware does not tell");
    assert_eq!(WIRE_VERSION, 1);
}

/// The goldens also contain every variant of the nested enums.
#[test]
fn nested_variants_are_covered() {
    let mut seen = BTreeSet::new();
    for (_, record) in records() {
        let kind = match record {
            Record::Hello(hello) => match hello.clock {
                ClockSource::Internal => "internal",
                ClockSource::Crystal => "crystal",
                ClockSource::External => "external",
                ClockSource::Simulated => "simulated",
            },
            Record::Event(event) => match event.kind {
                EventKind::Started => "started",
                EventKind::SourceEnded => "source ended",
                EventKind::EstimatorReset => "estimator reset",
                EventKind::SettingsChanged => "settings changed",
                EventKind::SourceChanged(source) => match source {
                    Source::Stopped => "stopped",
                    Source::Sampler => "sampler",
                    Source::Link => "link",
                },
                EventKind::Fault(fault) => match fault {
                    Fault::SamplerOverrun => "sampler overrun",
                    Fault::SourceUnreadable => "source unreadable",
                    Fault::Store => "store",
                    Fault::SavedSettings => "saved settings",
                    Fault::Watchdog => "watchdog",
                    Fault::NewerSettings => "newer settings",
                    Fault::ForeignSettings => "foreign settings",
                    Fault::SamplerMisaligned => "sampler misaligned",
                    Fault::SettingsLeft => "settings left",
                },
                EventKind::Panicked(_) => "panicked",
                EventKind::ResetBy(cause) => match cause {
                    ResetCause::PowerOn => "by power",
                    ResetCause::Pin => "by the pin",
                    ResetCause::Software => "by software",
                    ResetCause::Watchdog => "by the watchdog",
                    ResetCause::WindowWatchdog => "by the window watchdog",
                    ResetCause::LowPower => "by low power",
                    ResetCause::OptionBytes => "by option bytes",
                    ResetCause::Panic => "by a panic",
                    ResetCause::Unknown => "by something",
                },
                EventKind::Changed(change) => match change.parameter {
                    Changed::Inertance => "inertance changed",
                    Changed::Viscous => "viscous changed",
                    Changed::Coulomb => "coulomb changed",
                    Changed::Offset => "offset changed",
                },
                EventKind::Warned(warning) => match warning.kind {
                    WarningKind::WrongSign => "wrong sign",
                    WarningKind::CountSlip => "counts slipped",
                    WarningKind::ClippedForce => "clipped force",
                    WarningKind::DeadForce => "dead force",
                },
            },
            Record::Reply(reply) => match reply.result {
                Ok(Done::Plain) => "plain",
                Ok(Done::Injected { .. }) => "injected",
                Ok(Done::Played { .. }) => "played",
                Err(Refusal::Unsupported) => "unsupported",
                Err(Refusal::Busy) => "busy",
                Err(Refusal::QueueFull { .. }) => "queue full",
                Err(Refusal::BadSamples) => "bad samples",
                Err(Refusal::NotInjecting) => "not injecting",
                Err(Refusal::Store) => "store refused",
                Err(Refusal::NoSamples) => "no samples",
                Err(Refusal::Source) => "no source",
                Err(Refusal::NothingSaved) => "nothing saved",
                Err(Refusal::SavedUnreadable) => "saved unreadable",
                Err(Refusal::Worn { .. }) => "worn",
                Err(Refusal::NotPlaying) => "not playing",
                Err(Refusal::BadSetting { fault, .. }) => match fault {
                    SettingFault::Unknown => "unknown",
                    SettingFault::NotFinite => "not finite",
                    SettingFault::OutOfRange => "out of range",
                    SettingFault::NotWhole => "not whole",
                    SettingFault::Zero => "zero",
                    SettingFault::Conflict(_) => "conflict",
                    SettingFault::Repeated => "repeated",
                    SettingFault::NotOffered => "not offered",
                },
            },
            Record::Sums(sums) => match sums.bank {
                Bank::Fast => "fast",
                Bank::Slow => "slow",
            },
            Record::MoreSums(sums) => match sums.bank {
                Bank::Fast => "more, fast",
                Bank::Slow => "more, slow",
            },
            Record::Reversal(reversal) => match reversal.route {
                Route::Force => "reversal by force",
                Route::Terminal => "reversal by the terminal",
            },
            Record::Detail(detail) => {
                seen.insert(match detail.contact {
                    Contact::Unknown => "contact unknown",
                    Contact::OneSided => "one-sided",
                    Contact::Closed => "closed",
                    Contact::Backlash => "backlash",
                    Contact::Bouncing => "bouncing",
                });
                seen.insert(match detail.friction.regime {
                    Regime::Unknown => "regime unknown",
                    Regime::Coulomb => "coulomb",
                    Regime::Presliding => "presliding",
                    Regime::Stribeck => "stribeck",
                });
                match detail.backlash.status() {
                    BacklashStatus::NotIdentifiable(reason) => match reason {
                        Reason::ForceNeverReverses => "force never reverses",
                        Reason::TooFewReversals => "too few reversals",
                        Reason::FlankTooShort => "flank too short",
                        Reason::StiffnessUnknown => "stiffness unknown",
                        Reason::Scattered => "scattered",
                    },
                    BacklashStatus::BelowU95 => "below u95",
                    BacklashStatus::Ok => "backlash ok",
                }
            }
            Record::Law(law) => match law.status {
                LawStatus::Unknown => "law unknown",
                LawStatus::Holds => "law holds",
                LawStatus::Broken => "law broken",
            },
            Record::Measured(measured) => match measured.what {
                Measure::Chip => "measured chip",
                Measure::Clocks => "measured clocks",
                Measure::Supply => "measured supply",
                Measure::Work => "measured work",
                Measure::Hang => "measured nothing",
            },
            Record::Samples(_) | Record::Estimate(_) | Record::Health(_) | Record::Settings(_) | Record::Saved(_) => {
                "plain data"
            }
        };
        seen.insert(kind);
    }
    assert_eq!(seen.len(), 4 + 4 + 3 + 9 + 1 + 12 + 4 + 4 + 3 + 9 + 8 + 2 + 2 + 2 + 5 + 4 + 7 + 3 + 5 + 1);
}

/// A frame decoded by hand, so that the goldens are not compared only with themselves.
#[test]
fn by_hand() {
    let request = Request { id: 513, command: Command::Stop };
    // Varint 513, command 8, sequence 258.
    let summed = [0x81, 0x04, 0x08, 0x02, 0x01];
    let crc = (!reference::crc32(&summed)).to_le_bytes();
    let mut out = [0; MAX_FRAME];
    let length = encode_request(&request, SEQUENCE, &mut out).unwrap();
    let mut expected = vec![10];
    expected.extend(summed);
    expected.extend(crc);
    expected.push(0);
    assert!(!crc.contains(&0));
    assert_eq!(out[..length], expected);
}

/// A message of any length and content.
#[derive(serde::Serialize, serde::Deserialize)]
struct Raw(#[serde(skip_deserializing)] Vec<u8>);

impl Message for Raw {
    const SALT: u32 = 0;

    fn starts_stream(&self, _: u16) -> bool {
        false
    }

    fn peek(_: &[u8]) -> Option<Peek> {
        None
    }
}

/// Framing agrees with a second implementation, for real records and for every length around the 254-byte runs.
#[test]
fn frames_agree_with_the_reference() {
    let mut numbers = Random(11);
    for _ in 0..20_000 {
        let record = crate::values::some_record(&mut numbers);
        let sequence = numbers.draw() as u16;
        assert_eq!(framed(&record, sequence), reference::frame(&payload(&record), sequence));
    }
    for length in 0..=MAX_PAYLOAD - 2 {
        // Lengths 128 to 255 make a varint of two bytes whose last is 1: no zero until the sequence number.
        for sequence in [0x0101, 0x0100, 0x0001, 0x0000] {
            let message = Raw(vec![0x77; length]);
            assert_eq!(framed(&message, sequence), reference::frame(&payload(&message), sequence));
        }
    }
}

/// The longest message of every kind fits a payload, and its frame fits [`MAX_FRAME`].
#[test]
fn the_longest_fit() {
    let text = "\u{7f}".repeat(99);
    let hello = Hello {
        wire_version: WIRE_VERSION,
        firmware: Hello::text(&text),
        git: Hello::text(&text),
        board: Hello::text(&text),
        serial: Hello::text(&text),
        sample_rate_hz: f64::MAX,
        clock: ClockSource::Simulated,
        capabilities: Capabilities(u32::MAX),
    };
    for record in [
        Record::Hello(hello),
        Record::Samples(longest_samples()),
        Record::Settings(most_settings()),
        Record::Saved(most_settings()),
        Record::Sums(longest_sums()),
        Record::MoreSums(longest_more_sums()),
        Record::Detail(longest_detail()),
        Record::Measured(longest_measured()),
        Record::Event(Event { index: u32::MAX, kind: EventKind::Panicked(Hello::text(&text)) }),
    ] {
        assert_eq!(read_all(&framed(&record, u16::MAX)), [intact(record, u16::MAX)]);
    }
    let longest_play = requests().into_iter().find(|(name, _)| *name == "Play.Knots.longest").map(|(_, it)| it.command);
    for command in
        [Command::Inject(longest_samples()), Command::WriteSettings(most_settings())].into_iter().chain(longest_play)
    {
        let request = Request { id: u16::MAX, command };
        assert_eq!(read_all(&framed(&request, u16::MAX)), [intact(request, u16::MAX)]);
    }
    assert!(std::mem::size_of::<Record>() <= 784, "{}", std::mem::size_of::<Record>());
    assert!(std::mem::size_of::<FrameReader<Record>>() <= 600);
}

/// A forwarded frame equals the frame that its new sender would have made.
#[test]
fn frames_take_another_number() {
    fn passes<T: Message>(message: &T) {
        let mut out = [0; MAX_FRAME];
        let first = framed(message, SEQUENCE);
        let stuffed = &first[..first.len() - 1];
        for sequence in [0, 1, SEQUENCE, u16::MAX] {
            let wanted = framed(message, sequence);
            assert_eq!(renumber::<T>(stuffed, sequence, &mut out), Some(wanted.len()));
            assert_eq!(out[..wanted.len()], wanted);
        }
        assert_eq!(renumber::<T>(stuffed, 0, &mut out[..first.len() / 2]), None);
    }
    records().iter().for_each(|(_, record)| passes(record));
    requests().iter().for_each(|(_, request)| passes(request));
    passes(&Record::Samples(longest_samples()));
    passes(&Raw(vec![7; MAX_PAYLOAD - 2]));
    for nothing in [&[][..], &[1], &[9, 1, 1], &[1; MAX_FRAME], &[255; 4]] {
        assert_eq!(renumber::<Record>(nothing, 0, &mut [0; MAX_FRAME]), None, "{nothing:?}");
    }
}

/// Every buffer that is too small is refused, even if it lacks only the delimiter. No buffer is overrun.
#[test]
fn small_buffers_are_refused() {
    for (name, record) in records() {
        let length = framed(&record, SEQUENCE).len();
        for size in 0..length {
            let mut out = [0xA5; MAX_FRAME];
            assert_eq!(
                encode_record(&record, SEQUENCE, &mut out[..size]),
                Err(EncodeError::BufferTooSmall),
                "{name} in {size}"
            );
            assert!(out[size..].iter().all(|&byte| byte == 0xA5));
        }
        let mut out = [0xA5; MAX_FRAME];
        assert_eq!(encode_record(&record, SEQUENCE, &mut out[..length]), Ok(length));
    }
}

/// A message longer than the longest payload is refused; one of exactly that length is not.
#[test]
fn long_messages_are_refused() {
    for fill in [0, 1, 0xFF] {
        let mut out = [0; 2 * MAX_FRAME];
        // The content is preceded by two bytes of length.
        let longest = encode(&Raw(vec![fill; MAX_PAYLOAD - 2]), SEQUENCE, &mut out).unwrap();
        assert!(longest <= MAX_FRAME);
        let too_long = Raw(vec![fill; MAX_PAYLOAD - 1]);
        assert_eq!(encode(&too_long, SEQUENCE, &mut out), Err(EncodeError::TooLong));
        assert_eq!(encode(&too_long, SEQUENCE, &mut out[..MAX_FRAME]), Err(EncodeError::TooLong));
    }
}
