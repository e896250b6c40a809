//! The firmware image on a Cortex-M4F in QEMU gives the same results as core on this computer, bit for bit.

use inerter_core::{Estimate, RawSample, Settings, State};
use inerter_data::{replay::replay, run::Run};
use inerter_device::{
    DeviceError,
    inject::{Injection, inject},
};
use inerter_plant::{Excitation, Inerter, Sensors, Simulation};
use inerter_tests::{
    data::Recording,
    grid,
    qemu::{Machine, estimates, image, measure, undisturbed, until_the_end},
};
use inerter_wire::{
    Capabilities, Command, EstimatorEvent, MAX_FRAME, Record, SettingValue, SettingsValues, Streams, encode_record,
};

/// The estimates that core publishes on this computer, with the final one last.
fn here(settings: &Settings, samples: &[RawSample]) -> Vec<Estimate> {
    let active = settings.validate().unwrap();
    let mut state = Box::new(State::new(&active));
    let mut published: Vec<Estimate> =
        samples.iter().filter_map(|sample| active.step(&mut state, sample).estimate()).collect();
    published.push(active.publish(&state).estimate);
    published
}

/// The exact encoding of an estimate, including the sign of a zero.
fn bytes(estimate: &Estimate) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = encode_record(&Record::Estimate(*estimate), 0, &mut out).unwrap();
    out[..length].to_vec()
}

#[track_caller]
fn same(there: &[Estimate], here: &[Estimate]) {
    assert_eq!(there.len(), here.len(), "estimates");
    for (there, here) in there.iter().zip(here) {
        assert_eq!(bytes(there), bytes(here), "{there:?} in QEMU, {here:?} here");
    }
}

fn motion(text: &str) -> (Settings, Vec<RawSample>) {
    let device = Inerter::paper();
    let sensors = Sensors {
        force_noise_n: 1.0,
        force_offset_n: 2.0,
        encoder_phase_count: 0.7,
        lost_probability: 1e-4,
        seed: 21,
        ..Sensors::default()
    };
    let excitation = Excitation::parse(text, 21).unwrap();
    let duration_s = excitation.duration_s();
    let simulation = Simulation::new(device, excitation, sensors).unwrap();
    let samples = simulation.lasting(duration_s).map(|sample| grid::raw(&sample)).collect();
    (Settings { memory_s: 5.0, ..grid::calibrated(&device, &sensors) }, samples)
}

#[test]
fn a_simulated_run_to_the_bit() {
    let Some(image) = image() else { return };
    let (settings, mut samples) = motion("mid@20s;hold@5s;slow@20s;random@20s");
    let there = measure(&image, &settings, &samples).unwrap();
    same(&there, &here(&settings, &samples));
    let last = there.last().unwrap();
    assert!(there.len() > 300 && (last.whole_run.inertance_kg.fitted().value - 299.49).abs() < 0.1, "{last:?}");
    assert!(there.iter().any(|estimate| !estimate.moving) && there.iter().any(|estimate| estimate.moving));
    // Sensitivity check: one encoder count in one of 65 000 samples must change the estimates.
    samples[10_000].position_count += 1;
    let other = here(&settings, &samples);
    assert_eq!(there.len(), other.len());
    let equal = |part: std::ops::Range<usize>| there[part.clone()].iter().map(bytes).eq(other[part].iter().map(bytes));
    assert!(equal(0..49) && !equal(0..52));
}

/// The estimates of `inerter replay`.
fn replayed(run: &Run) -> Vec<Estimate> {
    let mut published = Vec::new();
    let outcome = replay(run, |_, estimate| {
        published.push(*estimate);
        Ok::<(), inerter_data::Error>(())
    });
    published.push(outcome.unwrap().estimate);
    published
}

#[test]
fn recordings_of_real_machines_to_the_bit() {
    let Some(image) = image() else { return };
    for (recording, coarser) in [(Recording::Emps, 1), (Recording::Emps, 100), (Recording::LodzSymmetric, 1)] {
        let Some(run) = recording.run(coarser) else { return };
        let run = run.unwrap();
        let there = measure(&image, &run.settings, &run.samples).unwrap();
        same(&there, &replayed(&run));
        same(&there, &here(&run.settings, &run.samples));
    }
}

/// Samples sent over the link instead of from the file, as `inerter send` does.
#[track_caller]
fn injected(run: &Run) {
    let Some(image) = image() else { return };
    let mut machine = Machine::boot(&image, &[]).unwrap();
    let mut device = machine.connect().unwrap();
    let mut there = Vec::new();
    let publish = |_: f64, event: &EstimatorEvent| {
        if let EstimatorEvent::Estimate(estimated) = event {
            there.push(estimated.estimate);
        }
        Ok::<(), DeviceError>(())
    };
    let injection = Injection { settings: &run.settings, samples: &run.samples, start_s: run.start_s };
    let outcome = inject(&mut device, &injection, publish, |_| Ok(())).unwrap();
    there.push(outcome.estimated.estimate);
    assert_eq!(outcome.samples, run.samples.len() as u64);
    same(&there, &replayed(run));
}

#[test]
fn a_simulated_run_over_the_link_to_the_bit() {
    let (settings, samples) = motion("random@6s;hold@1s;mid@3s");
    injected(&Run { settings, samples, ..Run::default() });
}

#[test]
fn a_recording_over_the_link_to_the_bit() {
    let Some(run) = Recording::Emps.run(1) else { return };
    injected(&run.unwrap());
}

/// Raw values, including ones that our host programs would not send.
fn values_of(values: &[(&str, f64)]) -> SettingsValues {
    let number = |name| u8::try_from(Settings::find(name).unwrap()).unwrap();
    SettingsValues(values.iter().map(|&(name, value)| SettingValue { number: number(name), value }).collect())
}

#[test]
fn it_says_who_it_is_and_refuses_settings_by_name() {
    let Some(image) = image() else { return };
    let mut machine = Machine::boot(&image, &[]).unwrap();
    let mut device = machine.connect().unwrap();
    let hello = device.hello().clone();
    assert_eq!(hello.board.as_str(), "qemu netduinoplus2");
    assert!(hello.capabilities.contains(Capabilities::SAMPLER.with(Capabilities::INJECT)), "{hello:?}");
    assert_eq!(*device.settings(), Settings::default());

    for (name, value) in [("memory_s", 1e9), ("oversampling", 1.5), ("metres_per_count", 0.0), ("skew_s", f64::NAN)] {
        let error = device.request("the settings", Command::WriteSettings(values_of(&[(name, value)]))).unwrap_err();
        let DeviceError::Refused { refusal, .. } = &error else { panic!("{error:?}") };
        assert!(refusal.to_string().contains(name), "{refusal}");
        assert!(error.to_string().contains(name), "{error}");
    }
    // If one of several values is invalid, none is accepted.
    let values = values_of(&[("memory_s", 12.0), ("publish_rate_hz", 1000.0)]);
    device.request("the settings", Command::WriteSettings(values)).unwrap_err();
    device.request("to read its settings", Command::ReadSettings).unwrap();
    let in_use = std::iter::from_fn(|| device.pending()).find_map(|received| match received.frame {
        inerter_wire::Frame::Message { message: Record::Settings(values), .. } => Some(values),
        _ => None,
    });
    assert_eq!(in_use.unwrap().read(&Settings::default()).settings, Settings::default());

    device.request("to save", Command::SaveSettings).unwrap_err();
    device.request("to end what has not begun", Command::InjectEnd).unwrap_err();
    device.request("to restart", Command::Reboot).unwrap();
    assert_eq!(machine.wait().unwrap(), 0);
}

#[test]
fn every_stream_carries_what_it_should() {
    let Some(image) = image() else { return };
    let (settings, samples) = motion("random@8s");
    let run = || {
        let mut machine = Machine::boot(&image, &samples)?;
        let mut device = machine.connect()?;
        device.stream(Streams::ALL)?;
        device.write_settings(&settings)?;
        device.start_sampler()?;
        let records = until_the_end(&mut device)?;
        Ok((machine, device, records))
    };
    let (_machine, mut device, records) = undisturbed(run).unwrap();
    let batches = records.iter().filter_map(|record| match record {
        Record::Samples(batch) => Some(batch),
        _ => None,
    });
    let back: Vec<RawSample> = batches.flat_map(|batch| batch.iter().map(Result::unwrap)).collect();
    assert_eq!(back, samples);
    same(&estimates(&records), &here(&settings, &samples));
    let discontinuities = samples.windows(2).filter(|pair| pair[1].index != pair[0].index + 1).count() as u32;
    // The device sends health once per second of the machine's time, and the samples take no machine time.
    let health = std::iter::from_fn(|| device.receive().ok().map(|received| received.map(|received| received.frame)))
        .take(500)
        .flatten()
        .find_map(|frame| match frame {
            inerter_wire::Frame::Message { message: Record::Health(health), .. } => Some(health),
            _ => None,
        })
        .expect("a health record");
    assert_eq!((health.discontinuities, health.dropped_frames, health.overruns), (discontinuities, 0, 0));
    // The first request may arrive while the machine enables its USART.
    assert!(health.bad_frames <= 1, "{health:?}");
    assert!(discontinuities > 0 && health.stack_free_bytes.is_some_and(|free| free > 1000), "{health:?}");
    assert_eq!((device.counts().lost, device.counts().corrupt()), (0, 0));
}
