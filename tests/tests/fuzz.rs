//! For any stream the device answers as required and keeps running, and the judge detects violations.

use inerter_core::Settings;
use inerter_tests::fuzz::{
    Conditions, End, Link, Played, Requests, corpus, findings, judge, made_corpus, outcomes, play, request, shrink,
    stream, with_probe,
};
use inerter_wire::{Command, Frame, FrameReader, Record, Refusal, Reply, Request, SettingValue, SettingsValues};
use std::collections::BTreeSet;

/// Number of streams. For a longer search, run `cargo run -p inerter-tests --bin measure -- fuzz`.
const STREAMS: u64 = 1_500;

#[test]
fn the_corpus_leads_to_what_it_says() {
    let items = corpus().unwrap();
    assert!(items.len() >= 40);
    let others = [
        Conditions { portion: 1, link: Link::Second, ..Conditions::PLAIN },
        Conditions { portion: 4_096, link: Link::Single, ..Conditions::PLAIN },
    ];
    for item in &items {
        for conditions in [Conditions::PLAIN].into_iter().chain(others) {
            let played = play(&item.bytes, &conditions);
            let name = format!("{} under {conditions:?}", item.name);
            assert_eq!(judge(&item.bytes, &conditions, &played), [""; 0], "{name}");
            assert_eq!(outcomes(&item.bytes, &played), item.expected, "{name}");
        }
    }
}

#[test]
fn the_corpus_is_what_the_command_writes() {
    let (committed, made) = (corpus().unwrap(), made_corpus().unwrap());
    for (committed, made) in committed.iter().zip(&made) {
        assert_eq!(committed, made);
    }
    assert_eq!(committed.len(), made.len());
}

#[test]
fn streams_of_fixed_seeds_find_nothing() {
    for seed in 0..STREAMS {
        let findings = findings(&stream(seed).bytes, &Conditions::of(seed));
        assert_eq!(findings, [""; 0], "seed {seed}");
    }
}

#[test]
fn the_streams_go_everywhere() {
    let (mut done, mut refused, mut bad, mut restarts) = (BTreeSet::new(), BTreeSet::new(), 0, 0);
    for seed in 0..STREAMS / 3 {
        let stream = stream(seed).bytes;
        let requests = Requests::read(&with_probe(&stream));
        bad += requests.bad_frames;
        let played = play(&stream, &Conditions::of(seed));
        restarts += u32::from(matches!(played.end, End::Restarted(_)));
        for ((_, command), reply) in requests.intact.iter().zip(played.replies()) {
            match (&reply.result, command) {
                (Ok(_), Some(command)) => drop(done.insert(command.name())),
                (Err(Refusal::BadSetting { fault, .. }), _) => drop(refused.insert(short(fault))),
                (Err(refusal), _) => drop(refused.insert(short(refusal))),
                (Ok(_), None) => panic!("seed {seed}"),
            }
        }
    }
    // Only a board can measure itself and play. The twin's tests cover these commands.
    for command in Command::TABLE.iter().filter(|command| !["Measure", "Play"].contains(&command.name)) {
        assert!(done.contains(command.name), "{} is not among {done:?}", command.name);
    }
    for wanted in [
        "Unsupported",
        "Busy",
        "BadSamples",
        "NotInjecting",
        "NoSamples",
        "Unknown",
        "NotFinite",
        "OutOfRange",
        "NotWhole",
        "Zero",
        "Conflict",
        "Repeated",
        "NotOffered",
    ] {
        assert!(refused.contains(wanted), "{wanted} is not among {refused:?}");
    }
    assert!(bad > 1_000 && restarts > 5, "{bad} bad frames, {restarts} restarts");
}

/// The name of a variant without its contents.
fn short(of: &impl std::fmt::Debug) -> String {
    format!("{of:?}").chars().take_while(|letter| letter.is_alphanumeric()).collect()
}

#[test]
fn a_request_that_is_whole_is_seen_as_one() {
    let mut whole = 0;
    for seed in 0..STREAMS {
        let stream = stream(seed);
        let requests = Requests::read(&with_probe(&stream.bytes));
        let mut seen = requests.intact.iter();
        for id in &stream.whole {
            assert!(seen.any(|(other, _)| other == id), "seed {seed}, request {id}");
            whole += 1;
        }
    }
    assert!(whole > 10_000, "{whole}");
}

/// A stream in which something can go wrong: one change, one refusal, one save, one damaged frame.
fn sample() -> Vec<u8> {
    let write = |value: f64| {
        let number = Settings::find("memory_s").unwrap() as u8;
        Command::WriteSettings(SettingsValues([SettingValue { number, value }].into_iter().collect()))
    };
    let mut bytes = vec![1, 2, 3, 0];
    for (id, command) in [(1, write(10.0)), (2, write(-1.0)), (3, Command::SaveSettings), (4, Command::Hello)] {
        bytes.extend(request(id, command, id));
    }
    bytes
}

#[test]
fn the_judge_finds_what_is_wrong() {
    let stream = sample();
    let good = play(&stream, &Conditions::PLAIN);
    assert_eq!(judge(&stream, &Conditions::PLAIN, &good), [""; 0]);
    let found = |change: &dyn Fn(&mut Played)| {
        let mut played = good.clone();
        change(&mut played);
        let findings = judge(&stream, &Conditions::PLAIN, &played);
        assert!(!findings.is_empty());
        findings[0].clone()
    };
    let reply = |id: u16| {
        good.records.iter().position(|record| matches!(record, Record::Reply(reply) if reply.id == id)).unwrap()
    };
    let settings = |nth: usize| {
        let all = good.records.iter().enumerate().filter(|(_, record)| matches!(record, Record::Settings(_)));
        all.map(|(place, _)| place).nth(nth).unwrap()
    };
    type Change<'a> = &'a dyn Fn(&mut Played);
    let cases: [(&str, Change); 14] = [
        ("got no reply", &|played| drop(played.records.drain(reply(0xFFFF)..=reply(0xFFFF)))),
        ("a reply to 4 where one to 3 is due", &|played| drop(played.records.remove(reply(3)))),
        ("that nobody waits for", &|played| played.records.push(good.records[reply(4)].clone())),
        ("a reply to 1 where one to 2 is due", &|played| {
            played.records.insert(reply(1), good.records[reply(1)].clone())
        }),
        ("was answered by", &|played| {
            played.records[reply(2)] = Record::Reply(Reply { id: 2, result: Ok(inerter_wire::Done::Plain) });
        }),
        ("was answered by", &|played| {
            played.records[reply(3)] = Record::Reply(Reply { id: 3, result: Err(Refusal::Store) });
        }),
        ("was refused and changed settings", &|played| {
            played.records.insert(reply(2), good.records[settings(0)].clone());
        }),
        ("told no settings", &|played| drop(played.records.remove(settings(0)))),
        ("the settings are", &|played| {
            played.records[settings(1)] = Record::Settings(SettingsValues::from(&Settings::default()));
        }),
        ("bad frames counted", &|played| {
            for record in &mut played.records {
                if let Record::Health(health) = record {
                    health.bad_frames += 1;
                }
            }
        }),
        ("frames dropped", &|played| played.counts.lost = 1),
        ("no health record", &|played| played.records.retain(|record| !matches!(record, Record::Health(_)))),
        ("flash keeps", &|played| played.kept = Ok(None)),
        ("sent what is no record", &|played| played.faults.push("Corrupt(Checksum)".into())),
    ];
    for (expected, change) in cases {
        let finding = found(change);
        assert!(finding.contains(expected), "{finding} instead of {expected}");
    }
    for end in [End::Panicked("index".into()), End::Hung, End::Restarted(inerter_app::Restart::Reboot)] {
        assert!(found(&|played| played.end = end.clone()).starts_with("ended"), "{end:?}");
    }
}

#[test]
fn what_fails_is_shrunk_to_what_matters() {
    let (mut seed, mut all) = (0, Vec::new());
    while all.len() < 5_000 {
        all.extend(stream(seed).bytes);
        all.push(0);
        seed += 1;
    }
    let middle = all.len() / 2;
    all.splice(middle..middle, [&[0][..], &sample()].concat());
    let kept = shrink(&all, |bytes| {
        let mut reader = FrameReader::<Request>::new();
        let mut input = bytes;
        std::iter::from_fn(|| reader.read(&mut input)).any(|frame| match frame {
            Frame::Message { message: Request { id: 3, command }, .. } => command == Command::SaveSettings,
            _ => false,
        })
    });
    assert_eq!(kept, request(3, Command::SaveSettings, 3));
}
