//! The whole instrument on mock parts, as seen by a host over the link.

use crate::rig::{
    IDENTITY, MemoryStore, Options, TestDevice, able_to, all_by_core, begun, by_core, done, estimates, events, lighter,
    live, message, number, raw_samples, shaken, write,
};
use inerter_app::{Restart, SourceError, Start, StoreError, wear::SAVES};
use inerter_core::{Bank, Published, RawSample, Settings, State, Status};
use inerter_needs::Random;
use inerter_wire::{
    Capabilities, ClockSource, Command, Done, Event, EventKind, Fault, Frame, Measure, Measured, Play, Quantity,
    Record, Refusal, Reply, ResetCause, Samples, SettingFault, SettingValue, SettingsValues, Source, Streams,
    WIRE_VERSION,
};

#[test]
fn the_stream_begins_with_the_start_and_who_it_is() {
    let mut rig = TestDevice::cold(Options::default());
    let frames = rig.frames();
    let [
        Frame::Message { sequence: 0, message: started },
        Frame::Message { sequence: 1, message: Record::Hello(hello) },
        Frame::Message { sequence: 2, message: cause },
    ] = frames.as_slice()
    else {
        panic!("{frames:?}");
    };
    assert_eq!(*started, Record::Event(Event { index: 0, kind: EventKind::Started }));
    assert_eq!(*cause, Record::Event(Event { index: 0, kind: EventKind::ResetBy(ResetCause::PowerOn) }));
    assert_eq!(hello.wire_version, WIRE_VERSION);
    assert_eq!((hello.firmware.as_str(), hello.git.as_str()), ("inerter 1.2.3", "0123456789ab"));
    assert_eq!((hello.board.as_str(), hello.serial.as_str()), ("bench", "B-7"));
    assert_eq!((hello.sample_rate_hz, hello.clock), (1000.0, ClockSource::Simulated));
    assert_eq!(hello.capabilities, IDENTITY.capabilities.with(Capabilities::SUMS));
    assert_eq!(rig.tell(Command::Hello), [Record::Hello(hello.clone())]);
}

#[test]
fn settings_are_put_in_use_together() {
    let mut rig = TestDevice::new();
    let records = rig.tell(write(&[("sample_rate_hz", 4000.0), ("memory_s", 10.0)]));
    assert_eq!(events(&records), [EventKind::EstimatorReset, EventKind::SettingsChanged]);
    let wanted = Settings { sample_rate_hz: 4000.0, memory_s: 10.0, ..Settings::default() };
    assert_eq!(records.last(), Some(&Record::Settings(SettingsValues::from(&wanted))));
    assert_eq!(rig.settings(), wanted);
    match rig.tell(Command::Hello).as_slice() {
        [Record::Hello(hello)] => assert_eq!(hello.sample_rate_hz, 4000.0),
        other => panic!("{other:?}"),
    }
}

#[test]
fn refused_settings_name_the_setting_and_change_nothing() {
    let mut rig = TestDevice::new();
    let refused = |rig: &mut TestDevice, command, name: &str, fault| {
        let (records, result, _) = rig.ask(command);
        assert_eq!(result, Err(Refusal::BadSetting { number: number(name), fault }));
        assert_eq!(records, []);
        assert_eq!(rig.settings(), Settings::default());
    };
    let good = ("memory_s", 10.0);
    refused(&mut rig, write(&[good, ("sample_rate_hz", 5e6)]), "sample_rate_hz", SettingFault::OutOfRange);
    refused(&mut rig, write(&[good, ("metres_per_count", 0.0)]), "metres_per_count", SettingFault::Zero);
    refused(&mut rig, write(&[good, ("skew_s", f64::NAN)]), "skew_s", SettingFault::NotFinite);
    refused(&mut rig, write(&[good, ("oversampling", 1.5)]), "oversampling", SettingFault::NotWhole);
    refused(&mut rig, write(&[good, ("memory_s", 11.0)]), "memory_s", SettingFault::Repeated);
    let beyond = SettingValue { number: 200, value: 1.0 };
    let unknown = SettingsValues(heapless::Vec::from_slice(&[beyond]).unwrap());
    let result = rig.result(Command::WriteSettings(unknown));
    assert_eq!(result, Err(Refusal::BadSetting { number: 200, fault: SettingFault::Unknown }));
    // Each value is valid by itself, but the combination is not.
    let result = rig.result(write(&[("force_min_code", 100.0), ("force_max_code", -100.0)]));
    assert!(matches!(result, Err(Refusal::BadSetting { fault: SettingFault::Conflict(_), .. })), "{result:?}");
    assert_eq!(rig.settings(), Settings::default());
}

#[test]
fn only_settings_that_change_what_was_gathered_forget_it() {
    let mut rig = TestDevice::new();
    for (name, value, reset) in [
        ("structure_mass_u95_kg", 0.1, false),
        ("stiffness_u95_n_per_m", 1e4, false),
        ("skew_u95_s", 2e-6, false),
        ("force_gain_u95", 0.002, false),
        ("lead_u95", 0.002, false),
        ("timebase_u95", 2e-5, false),
        ("memory_s", 5.0, false),
        ("publish_rate_hz", 2.0, false),
        ("machine", 1.0, false),
        ("skew_s", 1e-5, true),
        ("structure_mass_kg", 0.5, true),
        ("force_zero_code", 10.0, true),
    ] {
        let events = events(&rig.tell(write(&[(name, value)])));
        assert_eq!(events.contains(&EventKind::EstimatorReset), reset, "{name}");
    }
}

/// Whether the last of these records is the end of the source.
fn have_ended(records: &[Record]) -> bool {
    matches!(records.last(), Some(Record::Event(Event { kind: EventKind::SourceEnded, .. })))
}

#[test]
fn estimates_from_a_source_that_waits_equal_cores_to_the_bit_and_none_is_lost() {
    let mut rig = TestDevice::new();
    let samples = shaken(20_000);
    rig.script.push_all(&samples);
    // The link has room for less than one estimate, and the host reads slowly.
    rig.set_room(100);
    let start = rig.send(Command::Start);
    let records = rig.read_until(5, 70, have_ended);
    assert!(records.contains(&done(start)));
    assert_eq!(estimates(&records), all_by_core(&Settings::default(), &samples));
    let (_, end) = by_core(&Settings::default(), &samples);
    assert_eq!(end.recent.inertance_kg.status(), Status::Ok);
    assert!((end.recent.inertance_kg.fitted().value - 100.0).abs() < 0.5, "{end:?}");
}

#[test]
fn raw_samples_are_streamed_when_asked_for() {
    let mut rig = TestDevice::with(live());
    let samples = shaken(400);
    rig.script.push_samples(&samples[..100]);
    assert_eq!(raw_samples(&rig.records()), []);
    rig.stream(Streams { samples: true, ..Streams::NONE });
    rig.script.push_samples(&samples[100..110]);
    rig.pass(49);
    assert_eq!(rig.records(), [], "a batch waits for more");
    rig.pass(1);
    assert_eq!(raw_samples(&rig.records()), samples[100..110], "but not for ever");
    let mut streamed = Vec::new();
    for part in samples[110..].chunks(7) {
        rig.script.push_samples(part);
        rig.pass(7);
        streamed.extend(raw_samples(&rig.records()));
    }
    rig.pass(50);
    streamed.extend(raw_samples(&rig.records()));
    assert_eq!(streamed, samples[110..]);
}

#[test]
fn a_source_that_waits_streams_every_sample() {
    let mut rig = TestDevice::new();
    rig.stream(Streams { samples: true, ..Streams::NONE });
    let samples = shaken(5_000);
    rig.script.push_all(&samples);
    rig.set_room(50);
    rig.send(Command::Start);
    let records = rig.read_until(1, 50, have_ended);
    // The device reports the end of the source after its last sample.
    assert_eq!(raw_samples(&records), samples);
}

#[test]
fn sums_come_once_a_second_and_at_the_end() {
    let mut rig = TestDevice::new();
    rig.stream(Streams { estimates: true, sums: true, ..Streams::NONE });
    let samples = shaken(3_500);
    let active = Settings::default().validate().unwrap();
    let mut state = State::new(&active);
    let sums =
        |state: &State, bank| [Record::Sums(active.sums(state, bank)), Record::MoreSums(active.more_sums(state, bank))];
    let mut expected = Vec::new();
    for (place, sample) in samples.iter().enumerate() {
        let estimate = active.step(&mut state, sample).estimate().map(Record::Estimate);
        match place + 1 {
            1_000 | 2_000 | 3_000 => expected.extend(sums(&state, Bank::Fast)),
            1_500 | 2_500 | 3_500 => expected.extend(sums(&state, Bank::Slow)),
            _ => {}
        }
        expected.extend(estimate);
    }
    expected.extend([Bank::Fast, Bank::Slow].map(|bank| sums(&state, bank)).into_iter().flatten());
    expected.push(Record::Estimate(active.publish(&state).estimate));

    rig.script.push_all(&samples);
    // The link has room for less than the sums of one bank: the source waits, and no sum is lost.
    rig.set_room(100);
    rig.send(Command::Start);
    let mut records = rig.read_until(1, 50, have_ended);
    records.retain(|record| matches!(record, Record::Estimate(_) | Record::Sums(_) | Record::MoreSums(_)));
    assert_eq!(records, expected);

    // With the estimator, the sums and their interval of one second restart. Without the stream there are no sums.
    rig.set_room(usize::MAX);
    let is_sums = |record: &&Record| matches!(record, Record::Sums(_) | Record::MoreSums(_));
    let again = rig.inject(&samples[..1_000]);
    assert!(again.iter().filter(is_sums).eq(expected.iter().filter(is_sums).take(2)));
    rig.stream(Streams { estimates: true, ..Streams::NONE });
    let mut none = rig.inject(&samples[1_000..]);
    none.extend(rig.tell(Command::InjectEnd));
    assert_eq!(none.iter().find(is_sums), None);
}

#[test]
fn what_goes_with_an_estimate_follows_it_and_reversals_and_changes_come_when_they_happen() {
    let mut rig = TestDevice::new();
    // The flywheel is replaced half-way, which halves the inertance.
    let mut samples = shaken(24_000);
    for (after, lighter) in samples[12_000..].iter_mut().zip(&lighter(24_000)[12_000..]) {
        after.force_code = lighter.force_code;
    }
    let stiff = ("stiffness_n_per_m", 2.1e6);
    rig.tell(write(&[stiff]));
    rig.stream(Streams { estimates: true, sums: true, ..Streams::NONE });
    let active = Settings { stiffness_n_per_m: stiff.1, ..Settings::default() }.validate().unwrap();
    let mut state = State::new(&active);
    let mut expected = Vec::new();
    let (mut reversals, mut changes) = (0, 0);
    let all =
        |Published { estimate, law, detail }| [Record::Estimate(estimate), Record::Law(law), Record::Detail(detail)];
    for sample in &samples {
        let output = active.step(&mut state, sample);
        reversals += output.reversal.iter().count();
        expected.extend(output.reversal.map(Record::Reversal));
        assert_eq!(output.warning, None);
        if let Some(change) = output.change {
            changes += 1;
            // The last sums of the old device.
            for bank in [Bank::Fast, Bank::Slow] {
                expected.push(Record::Sums(active.sums(&state, bank)));
            }
            expected.push(Record::Event(Event { index: sample.index, kind: EventKind::Changed(change) }));
        }
        expected.extend(output.published.into_iter().flat_map(all));
    }
    expected.extend(all(active.publish(&state)));
    assert!(reversals > 50 && changes == 1, "{reversals} reversals, {changes} changes");

    let is_ours = |record: &Record| match record {
        Record::Estimate(_) | Record::Law(_) | Record::Detail(_) | Record::Reversal(_) => true,
        Record::Event(event) => matches!(event.kind, EventKind::Changed(_) | EventKind::Warned(_)),
        // The sums sent every second have their own test.
        Record::Sums(sums) => expected.contains(&Record::Sums(*sums)),
        _ => false,
    };
    rig.script.push_all(&samples);
    rig.send(Command::Start);
    let mut records = rig.read_until(1, 50, have_ended);
    records.retain(is_ours);
    assert_eq!(records, expected);
    let published = records.windows(3).filter_map(|three| match three {
        [Record::Estimate(estimate), Record::Law(law), Record::Detail(detail)] => {
            Some([estimate.index, law.index, detail.index])
        }
        _ => None,
    });
    assert_eq!(published.clone().count(), 121);
    assert!({ published }.all(|[estimate, law, detail]| estimate == law && law == detail));

    // Without the stream, none of this is sent or kept for later.
    rig.stream(Streams::NONE);
    let without = rig.inject(&samples[..5_000]);
    assert!(!without.iter().any(|record| matches!(
        record,
        Record::Estimate(_) | Record::Law(_) | Record::Detail(_) | Record::Reversal(_)
    )));
}

#[test]
fn health_comes_every_second_with_the_boards_figures() {
    let mut rig = TestDevice::with(live());
    rig.pass(3_500);
    let records = rig.records();
    let reports: Vec<_> = records
        .iter()
        .filter_map(|record| if let Record::Health(health) = record { Some(health) } else { None })
        .collect();
    assert_eq!(reports.iter().map(|health| health.uptime_s).collect::<Vec<_>>(), [1, 2, 3]);
    let figures = (reports[0].cpu_load_permille, reports[0].stack_free_bytes, reports[0].temperature_c);
    assert_eq!(figures, (Some(123), Some(4567), Some(30.5)));
    rig.stream(Streams::NONE);
    rig.pass(2_000);
    assert_eq!(rig.records(), []);
}

#[test]
fn frames_that_a_stalled_link_does_not_take_are_counted_by_both_ends() {
    let mut rig = TestDevice::with(live());
    rig.stream(Streams { samples: true, estimates: true, ..Streams::NONE });
    // The reader stops in the middle of a frame.
    rig.set_room(30);
    for part in shaken(10_000).chunks(10) {
        rig.script.push_samples(part);
        rig.pass(10);
    }
    rig.set_room(usize::MAX);
    rig.tell_through_loss(Command::Streams(Streams { health: true, ..Streams::NONE }));
    let health = rig.health();
    assert_eq!((health.lost_samples, health.overruns), (0, 0), "the link holds up no sample");
    assert!(health.dropped_frames > 300, "{health:?}");
    assert_eq!(rig.lost(), health.dropped_frames);
    assert_eq!(rig.corrupt(), 1, "the frame that was cut off");
}

#[test]
fn estimates_go_before_raw_samples() {
    let mut rig = TestDevice::with(live());
    rig.stream(Streams { samples: true, estimates: true, ..Streams::NONE });
    rig.set_room(100);
    // 1 kHz of raw samples is 6 KB/s; the host reads 3 KB/s.
    let samples = shaken(20_000);
    let (mut seen, mut streamed) = (Vec::new(), 0);
    for part in samples.chunks(10) {
        rig.script.push_samples(part);
        rig.pass(10);
        for frame in rig.read_bytes(30) {
            match frame {
                Frame::Message { message: Record::Estimate(estimate), .. } => seen.push(estimate),
                Frame::Message { message: Record::Samples(batch), .. } => streamed += batch.len(),
                _ => {}
            }
        }
    }
    let (expected, _) = by_core(&Settings::default(), &samples);
    assert!(seen.len() >= expected.len() - 1, "{} of {}", seen.len(), expected.len());
    assert_eq!(seen, expected[..seen.len()]);
    assert!((2_000..18_000).contains(&streamed), "{streamed}");
}

#[test]
fn injected_samples_give_cores_estimates() {
    let mut rig = TestDevice::new();
    let samples = shaken(20_000);
    let mut records = rig.inject(&samples);
    assert_eq!(events(&records), [EventKind::SourceChanged(Source::Link), EventKind::EstimatorReset]);
    let (last, result, after) = rig.ask(Command::InjectEnd);
    assert_eq!((result, after), (Ok(Done::Injected { accepted: 20_000, free: 256 }), vec![]));
    assert_eq!(events(&last), [EventKind::SourceEnded]);
    records.extend(last);
    assert_eq!(estimates(&records), all_by_core(&Settings::default(), &samples));
    assert_eq!(rig.result(Command::InjectEnd), Err(Refusal::NotInjecting));
    // The next injection starts afresh.
    let mut records = rig.inject(&samples[..5_000]);
    records.extend(rig.tell(Command::InjectEnd));
    assert_eq!(estimates(&records), all_by_core(&Settings::default(), &samples[..5_000]));
}

#[test]
fn the_final_estimate_of_an_injection_comes_without_the_stream() {
    let mut rig = TestDevice::new();
    rig.stream(Streams::NONE);
    let samples = shaken(3_000);
    assert_eq!(estimates(&rig.inject(&samples)), []);
    let records = rig.tell(Command::InjectEnd);
    assert_eq!(estimates(&records), [by_core(&Settings::default(), &samples).1]);
}

#[test]
fn credit_holds_when_the_host_sends_ahead() {
    let mut rig = TestDevice::new();
    let samples = shaken(10_000);
    let (mut sent, mut accepted, mut free, mut ids) = (0usize, 0u32, 32u32, Vec::new());
    let mut records = Vec::new();
    rig.set_room(200);
    while (accepted as usize) < samples.len() {
        while sent < samples.len() && (sent as u32 - accepted) + 32 <= free {
            let (batch, taken) = Samples::from_slice(&samples[sent..]);
            ids.push(rig.send(Command::Inject(batch)));
            sent += taken;
        }
        rig.settle();
        for message in rig.read_bytes(60).into_iter().map(message) {
            if let Record::Reply(Reply { id, result }) = message {
                assert_eq!(id, ids.remove(0));
                let Ok(Done::Injected { accepted: now, free: room }) = result else { panic!("{result:?}") };
                (accepted, free) = (now, room.into());
            } else {
                records.push(message);
            }
        }
    }
    rig.set_room(usize::MAX);
    records.extend(rig.tell(Command::InjectEnd));
    assert_eq!(estimates(&records), all_by_core(&Settings::default(), &samples));
}

#[test]
fn a_batch_beyond_the_credit_waits_for_room() {
    let mut rig = TestDevice::new();
    rig.inject(&shaken(32));
    // The host does not read: the estimator waits with its next estimate, and the queue fills up.
    rig.set_room(0);
    let samples = shaken(2_000);
    for batch in samples[32..].chunks(32) {
        rig.send(Command::Inject(Samples::from_slice(batch).0));
    }
    rig.pass(1);
    rig.set_room(usize::MAX);
    let records = rig.records();
    let refused = records.iter().filter(|record| matches!(record, Record::Reply(Reply { result: Err(_), .. }))).count();
    assert_eq!(refused, 0);
    let result = rig.result(Command::InjectEnd);
    assert_eq!(result, Ok(Done::Injected { accepted: 2_000, free: 256 }));
}

#[test]
fn injected_nonsense_is_refused_whole() {
    let mut rig = TestDevice::new();
    // A batch that claims 33 samples; two samples with the bytes of one; extra bytes.
    for bytes in [&[33, 1, 0][..], &[2, 4, 0, 0, 0, 0], &[0, 1, 0]] {
        let samples: Samples = postcard::from_bytes(bytes).unwrap();
        assert_eq!(rig.result(Command::Inject(samples)), Err(Refusal::BadSamples), "{bytes:?}");
    }
    assert_eq!(rig.result(Command::InjectEnd), Err(Refusal::NotInjecting));
}

#[test]
fn injection_takes_the_samplers_place_until_the_next_start() {
    let mut rig = TestDevice::with(live());
    let samples = shaken(4_000);
    rig.feed(&samples[..500]);
    rig.records();
    let mut records = rig.inject(&samples[..1_000]);
    rig.feed(&samples[500..700]);
    assert_eq!(rig.script.left(), 200);
    records.extend(rig.inject(&samples[1_000..2_000]));
    records.extend(rig.tell(Command::InjectEnd));
    let expected = all_by_core(&Settings::default(), &samples[..2_000]);
    assert_eq!(estimates(&records), expected, "not one of the sampler's samples among them");
    // The sampler's samples in the meantime are not defined here; in this test it waited.
    let (records, _, _) = rig.ask(Command::Start);
    assert_eq!(events(&records), [EventKind::SourceChanged(Source::Sampler), EventKind::EstimatorReset]);
    rig.records();
    rig.tell(Command::ResetEstimator);
    rig.feed(&samples[700..1_700]);
    assert_eq!(estimates(&rig.records()), by_core(&Settings::default(), &samples[700..1_700]).0);
}

#[test]
fn stop_halts_the_sampler_and_start_goes_on() {
    let mut rig = TestDevice::new();
    let samples = shaken(3_000);
    rig.script.push_samples(&samples[..1_000]);
    rig.settle();
    assert_eq!(rig.script.left(), 1_000, "not before Start");
    let (mut records, _, after) = rig.ask(Command::Start);
    assert_eq!(events(&records), [EventKind::SourceChanged(Source::Sampler)]);
    records.extend(after);
    assert_eq!(rig.tell(Command::Start), [], "once is enough");
    assert_eq!(events(&rig.tell(Command::Stop)), [EventKind::SourceChanged(Source::Stopped)]);
    rig.script.push_samples(&samples[1_000..]);
    rig.settle();
    assert_eq!(rig.script.left(), 2_000);
    let (before, _, after) = rig.ask(Command::Start);
    records.extend(before);
    records.extend(after);
    assert_eq!(estimates(&records), by_core(&Settings::default(), &samples).0);
}

#[test]
fn gaps_and_saturated_samples_are_counted_over_resets() {
    let mut rig = TestDevice::with(live());
    let mut samples = shaken(2_000);
    let at_the_limit = Settings::default().force_max_code as i32;
    samples[600..602].iter_mut().for_each(|sample| sample.force_code = at_the_limit);
    let with_losses = samples.iter().filter(|sample| !matches!(sample.index, 500..530 | 900));
    rig.feed(with_losses);
    let health = rig.health();
    assert_eq!((health.index, health.discontinuities, health.lost_samples), (1_999, 2, 31));
    assert_eq!(health.saturated, 2);
    rig.tell(Command::ResetEstimator);
    rig.script.push([Ok(RawSample { index: 2_000, ..RawSample::default() })]);
    rig.script.push([Ok(RawSample { index: 2_010, force_code: at_the_limit, ..RawSample::default() })]);
    let health = rig.health();
    assert_eq!((health.index, health.discontinuities, health.lost_samples), (2_010, 3, 40));
    assert_eq!(health.saturated, 3);
}

#[test]
fn what_a_live_source_loses_is_counted_and_goes_on() {
    let mut rig = TestDevice::with(live());
    let samples = shaken(1_000);
    rig.feed(&samples[..100]);
    rig.script.push([Err(SourceError::Overrun)]);
    rig.feed(&samples[150..200]);
    rig.script.push([Err(SourceError::Overrun)]);
    rig.feed(&samples[210..]);
    assert_eq!(events(&rig.records()), [EventKind::Fault(Fault::SamplerOverrun)]);
    let health = rig.health();
    assert_eq!((health.index, health.overruns, health.discontinuities, health.lost_samples), (999, 2, 2, 60));
}

#[test]
fn a_burst_from_a_live_source_is_taken_whole() {
    let mut rig = TestDevice::with(live());
    rig.script.push_samples(&shaken(5_000));
    let health = rig.health();
    assert_eq!((health.index, health.overruns, health.discontinuities), (4_999, 0, 0));
}

#[test]
fn an_unreadable_source_is_said_and_left() {
    let mut rig = TestDevice::with(live());
    rig.script.push([Err(SourceError::Unreadable), Ok(RawSample::default())]);
    let records = rig.records();
    assert_eq!(events(&records), [EventKind::Fault(Fault::SourceUnreadable), EventKind::SourceEnded]);
    assert_eq!(estimates(&records), [], "of nothing");
    assert_eq!(rig.script.left(), 1);
    rig.tell(Command::Start);
    assert_eq!(rig.script.left(), 0);
}

#[test]
fn tare_takes_the_present_force_as_zero() {
    let mut rig = TestDevice::with(live());
    let id = rig.send(Command::Tare);
    for index in 0..600 {
        let force_code = match index % 5 {
            0 => Settings::default().force_max_code as i32,
            1 | 2 => -1_235,
            _ => -1_234,
        };
        rig.script.push([Ok(RawSample { index, force_code, ..RawSample::default() })]);
        rig.pass(1);
    }
    assert!(!rig.records().iter().any(|record| matches!(record, Record::Reply(_))), "saturated samples do not count");
    rig.script.push((600..700).map(|index| Ok(RawSample { index, force_code: -1_235, ..RawSample::default() })));
    let records = rig.records();
    assert_eq!(events(&records), [EventKind::EstimatorReset, EventKind::SettingsChanged]);
    assert!(records.contains(&done(id)));
    assert_eq!(rig.settings().force_zero_code, -1_235.0);
}

#[test]
fn tare_without_samples_is_refused() {
    let mut rig = TestDevice::new();
    assert_eq!(rig.result(Command::Tare), Err(Refusal::NoSamples), "stopped");
    rig.inject(&shaken(32));
    assert_eq!(rig.result(Command::Tare), Err(Refusal::Busy), "injecting");
    rig.tell(Command::Start);
    let id = rig.send(Command::Tare);
    rig.pass(2_000);
    let records = rig.records();
    assert!(records.contains(&Record::Reply(Reply { id, result: Err(Refusal::NoSamples) })), "{records:?}");
    // The abandoned tare has no later effect.
    rig.script.push_samples(&shaken(2_000));
    rig.records();
    assert_eq!(rig.settings(), Settings::default());
}

#[test]
fn settings_outlive_a_restart() {
    let store = MemoryStore::default();
    let options = Options { store: store.clone(), ..Options::default() };
    let mut rig = TestDevice::with(options.clone());
    rig.tell(write(&[("newtons_per_code", -0.01)]));
    rig.tell(Command::SaveSettings);
    assert_eq!(rig.result(Command::Reboot), Ok(Done::Plain));
    assert_eq!(rig.ended, Some(Ok(Restart::Reboot)));
    drop(rig);
    let mut rig = TestDevice::with(options);
    assert_eq!(rig.settings(), Settings { newtons_per_code: -0.01, ..Settings::default() });
    *store.error.borrow_mut() = Some(StoreError::Unreadable);
    assert_eq!(rig.result(Command::SaveSettings), Err(Refusal::Store));
}

#[test]
fn a_flood_of_saves_is_refused_and_a_restart_does_not_help() {
    let mut rig = TestDevice::new();
    for nth in 0..SAVES {
        assert_eq!(rig.result(Command::SaveSettings), Ok(Done::Plain), "save {nth}");
    }
    let saved = rig.store.saved.borrow().clone();
    rig.tell(write(&[("memory_s", 12.0)]));
    assert_eq!(rig.result(Command::SaveSettings), Err(Refusal::Worn { wait_s: 120 }));
    assert_eq!(rig.result(Command::FactoryReset), Err(Refusal::Worn { wait_s: 14 * 120 }));
    assert_eq!(*rig.store.saved.borrow(), saved, "nothing was written");
    assert_eq!(rig.settings().memory_s, 12.0, "nothing was changed");
    rig.pass(120_000);
    assert_eq!(rig.result(Command::SaveSettings), Ok(Done::Plain));
    assert_eq!(rig.result(Command::Reboot), Ok(Done::Plain));
    let start = Start { saves_left: rig.app.saves_left(), ..Start::SOFTWARE };
    drop(rig);
    let mut rig = TestDevice::with(begun(start));
    assert_eq!(rig.result(Command::SaveSettings), Err(Refusal::Worn { wait_s: 120 }));
}

#[test]
fn what_the_board_cannot_do_is_refused() {
    let mut rig = TestDevice::with(able_to(Capabilities::NONE));
    let samples = Samples::from_slice(&shaken(1)).0;
    for command in [
        Command::EnterDfu,
        Command::Reboot,
        Command::Measure(Measure::Chip),
        Command::Measure(Measure::Hang),
        Command::SaveSettings,
        Command::FactoryReset,
        Command::Start,
        Command::Stop,
        Command::Inject(samples),
        Command::InjectEnd,
    ] {
        assert_eq!(rig.ask(command.clone()), (vec![], Err(Refusal::Unsupported), vec![]), "{command:?}");
    }
    assert_eq!(rig.ended, None);
}

/// A board that says it has one.
#[test]
fn a_player_that_is_not_there_is_refused() {
    let mut rig = TestDevice::with(able_to(Capabilities::PLAYER));
    assert_eq!(rig.ask(Command::Play(Play::End)), (vec![], Err(Refusal::Unsupported), vec![]));
}

#[test]
fn the_reply_to_a_restart_is_sent_before_it() {
    for (command, restart) in [(Command::Reboot, Restart::Reboot), (Command::EnterDfu, Restart::Dfu)] {
        let mut rig = TestDevice::with(able_to(Capabilities::DFU.with(Capabilities::REBOOT)));
        rig.set_room(3);
        let id = rig.send(command);
        rig.pass(100);
        assert_eq!(rig.ended, None);
        rig.set_room(usize::MAX);
        assert_eq!(rig.records(), [done(id)]);
        assert_eq!(rig.ended, Some(Ok(restart)));
    }
}

#[test]
fn nothing_behind_a_restart_is_obeyed() {
    let mut rig = TestDevice::new();
    // The link is full: the restart waits for its reply to go out.
    rig.set_room(3);
    let (id, mut bytes) = rig.request(Command::Reboot);
    for command in [write(&[("memory_s", 10.0)]), Command::SaveSettings, Command::Hello] {
        bytes.extend(rig.request(command).1);
    }
    rig.send_bytes(&bytes);
    rig.pass(100);
    rig.set_room(usize::MAX);
    assert_eq!(rig.records(), [done(id)]);
    assert_eq!(rig.ended, Some(Ok(Restart::Reboot)));
    assert_eq!(*rig.store.saved.borrow(), None);
}

/// The frame of a request that this version does not know.
fn unknown_request(id: u8, command: u8) -> Vec<u8> {
    let mut body = vec![id, command, 0, 0];
    body.extend(crc::Crc::<u32>::new(&crc::CRC_32_JAMCRC).checksum(&body).to_le_bytes());
    let mut frame = cobs::encode_vec(&body);
    frame.push(0);
    frame
}

#[test]
fn an_unknown_command_is_refused_by_its_id() {
    let mut rig = TestDevice::new();
    rig.send_bytes(&unknown_request(77, 100));
    assert_eq!(rig.records(), [Record::Reply(Reply { id: 77, result: Err(Refusal::Unsupported) })]);
}

#[test]
fn garbage_on_the_link_does_nothing_but_count() {
    let mut rig = TestDevice::new();
    for seed in 0..300 {
        let length = 1 + seed as usize * 7 % 1_500;
        rig.send_bytes(&Random(seed).bytes(length));
        assert_eq!(rig.records(), [], "seed {seed}");
        // A host terminates the frame that another one left unfinished.
        rig.send_bytes(&[0]);
        assert!(matches!(rig.tell(Command::Hello).as_slice(), [Record::Hello(_)]), "seed {seed}");
    }
    assert_eq!(rig.settings(), Settings::default());
    assert!(rig.health().bad_frames > 300);
}

#[test]
fn two_hosts_at_once_spoil_each_others_frames_and_nothing_else() {
    let mut rig = TestDevice::new();
    let mut spoiled = 0;
    for seed in 0..200 {
        let (_, mut first) = rig.request(write(&[("memory_s", 10.0)]));
        let (_, mut second) = rig.request(Command::Streams(Streams::ALL));
        let whole = first[..first.len() - 1].to_vec();
        let mut mixed = Vec::new();
        let mut random = Random(seed);
        loop {
            let from = if random.percent(50) { &mut first } else { &mut second };
            if from.is_empty() {
                break;
            }
            mixed.push(from.remove(0));
        }
        mixed.extend(first);
        mixed.extend(second);
        mixed.push(0);
        rig.send_bytes(&mixed);
        for record in rig.records() {
            assert!(!matches!(record, Record::Reply(Reply { result: Err(_), .. })), "seed {seed}: {record:?}");
        }
        // By chance the first host's frame may have stayed whole.
        if !mixed.split(|byte| *byte == 0).any(|frame| frame == whole) {
            spoiled += 1;
            assert_eq!(rig.settings(), Settings::default(), "seed {seed}");
        }
        rig.tell(write(&[("memory_s", 30.0)]));
    }
    assert_eq!(rig.settings(), Settings::default());
    assert!(spoiled > 0 && rig.health().bad_frames >= spoiled, "{spoiled} spoiled");
}

#[test]
fn a_link_that_comes_back_is_used_again() {
    let mut rig = TestDevice::with(live());
    rig.unplug(true);
    rig.script.push_samples(&shaken(3_000));
    rig.pass(5_000);
    rig.unplug(false);
    rig.pass(100);
    rig.tell_through_loss(Command::Hello);
    let health = rig.health();
    assert!(health.dropped_frames > 0);
    assert_eq!(rig.lost(), health.dropped_frames);
}

#[test]
fn invalid_default_settings_are_the_programmers_mistake_and_named() {
    let defaults = Settings { sample_rate_hz: 0.0, ..Settings::default() };
    let mut rig = TestDevice::cold(Options { defaults, ..Options::default() });
    rig.settle();
    let ended = rig.ended.take().unwrap().unwrap_err();
    assert!(ended.to_string().starts_with("sample_rate_hz"), "{ended}");
}

#[test]
fn what_the_board_measures_comes_before_the_reply() {
    let mut rig = TestDevice::with(able_to(IDENTITY.capabilities.with(Capabilities::MEASURE)));
    let id = rig.send(Command::Measure(Measure::Chip));
    let mut measured = Measured::new(Measure::Chip);
    measured.push(Quantity::FlashKb, 512);
    measured.push(Quantity::SavesLeft, SAVES.into());
    assert_eq!(rig.records(), [Record::Measured(measured), done(id)]);
    assert_eq!(rig.result(Command::Measure(Measure::Hang)), Ok(Done::Plain));
    assert_eq!(rig.ended, Some(Ok(Restart::Hang)));
}
