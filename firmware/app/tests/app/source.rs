//! The board's source of samples: applying settings, halting, and losses.

use crate::rig::{
    Asked, Options, TestDevice, all_by_core, by_core, done, estimates, events, live, raw_samples, shaken, write,
};
use inerter_app::{Pace, SourceError};
use inerter_core::{FrontEnd, RawSample, Settings};
use inerter_wire::{Command, EventKind, Fault, Record, Refusal, SettingsValues, Source, Streams};

/// Motion at the given rate, from `index` on.
fn at_rate(rate_hz: f64, index: u32, count: u32) -> Vec<RawSample> {
    let step = (rate_hz / 1000.0) as u32;
    let slow = shaken(count / step + 2);
    (0..count)
        .map(|place| {
            let (before, after) = (slow[(place / step) as usize], slow[(place / step + 1) as usize]);
            let part = f64::from(place % step) / f64::from(step);
            let between = |a: i32, b: i32| (f64::from(a) + part * f64::from(b - a)).round() as i32;
            RawSample {
                index: index + place,
                position_count: between(before.position_count, after.position_count),
                force_code: between(before.force_code, after.force_code),
                terminal_code: 0,
            }
        })
        .collect()
}

#[test]
fn the_source_takes_over_settings_before_its_first_sample_and_whenever_they_concern_it() {
    let mut rig = TestDevice::with(live());
    assert_eq!(rig.script.asked(), [Asked::Configure(1000.0, FrontEnd::Analogue)]);
    rig.tell(write(&[("memory_s", 10.0), ("newtons_per_code", 0.01)]));
    assert_eq!(rig.script.asked(), []);
    rig.tell(write(&[("sample_rate_hz", 2000.0)]));
    assert_eq!(rig.script.asked(), [Asked::Halt, Asked::Configure(2000.0, FrontEnd::Analogue)]);
    rig.tell(write(&[("front_end", 1.0)]));
    assert_eq!(rig.script.asked(), [Asked::Halt, Asked::Configure(2000.0, FrontEnd::Ads131m04)]);
    rig.tell(write(&[("oversampling", 64.0), ("metres_per_count", 1e-5)]));
    assert_eq!(rig.script.asked(), [Asked::Halt, Asked::Configure(2000.0, FrontEnd::Ads131m04)]);
    // A halted source is not started by new settings.
    rig.tell(Command::Stop);
    rig.tell(write(&[("sample_rate_hz", 1000.0)]));
    assert_eq!(rig.script.asked(), [Asked::Halt, Asked::Configure(1000.0, FrontEnd::Ads131m04)]);
    rig.script.push([Ok(RawSample::default())]);
    rig.settle();
    assert_eq!(rig.script.left(), 1);
}

#[test]
fn no_sample_of_the_old_rate_is_fed_under_the_new_settings() {
    let mut rig = TestDevice::with(Options { pace: Pace::OnDemand, ..live() });
    rig.stream(Streams { estimates: true, samples: true, ..Streams::NONE });
    let (old, new) = (at_rate(1000.0, 0, 4_000), at_rate(4000.0, 5_000, 12_000));
    // The host reads slowly: the estimator waits, the queue is full, and a batch is about to enter it.
    rig.set_room(60);
    rig.script.push_samples(&old);
    rig.pass(10);
    let waiting = rig.script.left();
    assert!((100..3_700).contains(&waiting), "{waiting}");
    rig.script.push_with_next_settings(&new);
    let id = rig.send(write(&[("sample_rate_hz", 4000.0)]));
    let mut records = rig.read_until(1, 50, |records| records.contains(&done(id)));
    rig.set_room(usize::MAX);
    records.extend(rig.records());
    rig.pass(50);
    records.extend(rig.records());
    assert_eq!(rig.script.left(), 0, "it goes on by itself");
    let settings = Settings { sample_rate_hz: 4000.0, ..Settings::default() };
    let changed = Record::Settings(SettingsValues::from(&settings));
    let changed = records.iter().position(|record| *record == changed).unwrap();
    let (expected, _) = by_core(&settings, &new);
    assert!(!expected.is_empty());
    assert_eq!(estimates(&records[changed..]), expected, "of the new samples alone");
    let streamed = raw_samples(&records);
    let of_old = streamed.iter().filter(|sample| sample.index < 5_000).count();
    assert_eq!(streamed[..of_old], old[..of_old], "those that the estimator has seen");
    assert_eq!(streamed[of_old..], new);
}

#[test]
fn no_batch_holds_samples_of_both_rates() {
    let mut rig = TestDevice::with(live());
    rig.stream(Streams { samples: true, ..Streams::NONE });
    let samples = shaken(20);
    rig.feed(&samples[..10]);
    let (mut records, result, _) = rig.ask(write(&[("sample_rate_hz", 2000.0)]));
    assert!(result.is_ok());
    rig.feed(&samples[10..]);
    rig.pass(50);
    records.extend(rig.records());
    records.retain(|record| matches!(record, Record::Samples(_)));
    let of_each: Vec<_> = records.iter().map(|record| raw_samples(std::slice::from_ref(record))).collect();
    assert_eq!(of_each, [&samples[..10], &samples[10..]]);
}

#[test]
fn a_source_that_does_not_come_up_is_put_back() {
    let mut rig = TestDevice::with(live());
    rig.script.asked();
    rig.script.answer([Err(SourceError::Unreadable)]);
    let (before, result, after) = rig.ask(write(&[("front_end", 1.0), ("memory_s", 10.0)]));
    assert_eq!((before, result, after), (vec![], Err(Refusal::Source), vec![]));
    assert_eq!(
        rig.script.asked(),
        [Asked::Halt, Asked::Configure(1000.0, FrontEnd::Ads131m04), Asked::Configure(1000.0, FrontEnd::Analogue)]
    );
    assert_eq!(rig.settings(), Settings::default(), "as before");
    let samples = shaken(1_000);
    rig.feed(&samples);
    assert_eq!(estimates(&rig.records()), by_core(&Settings::default(), &samples).0, "and it goes on");
}

#[test]
fn a_source_that_is_lost_for_good_is_said_and_comes_back_with_start() {
    let mut rig = TestDevice::with(live());
    rig.script.answer([Err(SourceError::Unreadable); 2]);
    let (before, result, _) = rig.ask(write(&[("front_end", 1.0)]));
    assert_eq!(result, Err(Refusal::Source));
    let expected = [EventKind::Fault(Fault::SourceUnreadable), EventKind::SourceChanged(Source::Stopped)];
    assert_eq!(events(&before), expected);
    rig.script.asked();
    rig.script.answer([Err(SourceError::Unreadable)]);
    assert_eq!(rig.ask(Command::Start), (vec![], Err(Refusal::Source), vec![]), "still lost");
    let (records, result, _) = rig.ask(Command::Start);
    assert!(result.is_ok());
    assert_eq!(events(&records), [EventKind::SourceChanged(Source::Sampler)]);
    assert_eq!(rig.script.asked(), [Asked::Configure(1000.0, FrontEnd::Analogue); 2]);
    // A source that fails while running is also set up again.
    rig.script.push([Err(SourceError::Unreadable)]);
    rig.records();
    assert_eq!(rig.script.asked(), [Asked::Halt]);
    rig.ask(Command::Start).1.unwrap();
    assert_eq!(rig.script.asked(), [Asked::Configure(1000.0, FrontEnd::Analogue)]);
}

#[test]
fn the_rate_may_change_while_samples_are_injected() {
    let mut rig = TestDevice::with(live());
    let samples = shaken(4_000);
    rig.inject(&samples[..32]);
    rig.script.asked();
    rig.tell(write(&[("sample_rate_hz", 4000.0)]));
    assert_eq!(rig.script.asked(), [Asked::Configure(4000.0, FrontEnd::Analogue)], "halted already");
    let mut records = rig.inject(&samples[32..]);
    records.extend(rig.tell(Command::InjectEnd));
    let settings = Settings { sample_rate_hz: 4000.0, ..Settings::default() };
    assert_eq!(estimates(&records), all_by_core(&settings, &samples[32..]));
}

#[test]
fn the_source_is_halted_with_the_sampler() {
    let mut rig = TestDevice::with(live());
    rig.script.asked();
    rig.tell(Command::Stop);
    assert_eq!(rig.script.asked(), [Asked::Halt]);
    rig.pass(2_000);
    rig.ask(Command::Start).1.unwrap();
    rig.inject(&shaken(32));
    assert_eq!(rig.script.asked(), [Asked::Halt], "and when samples come over the link");
}

#[test]
fn channels_that_ran_apart_count_as_an_overrun_and_are_said_once() {
    let mut rig = TestDevice::with(live());
    let samples = shaken(1_000);
    rig.feed(&samples[..100]);
    rig.script.push([Err(SourceError::Misaligned)]);
    rig.feed(&samples[150..200]);
    rig.script.push([Err(SourceError::Misaligned), Err(SourceError::Overrun)]);
    rig.feed(&samples[210..]);
    let kinds = [EventKind::Fault(Fault::SamplerMisaligned), EventKind::Fault(Fault::SamplerOverrun)];
    assert_eq!(events(&rig.records()), kinds);
    let health = rig.health();
    assert_eq!((health.index, health.overruns, health.discontinuities, health.lost_samples), (999, 3, 2, 60));
}
