//! Signs of life, as a watchdog requests them.

use crate::rig::{TestDevice, live, shaken};
use inerter_core::RawSample;
use inerter_wire::{Command, Samples, Streams};

/// Interval between the watchdog's requests \[ms\].
const ASKED_EVERY: u64 = 500;

#[test]
fn a_device_without_anything_to_do_is_alive() {
    let mut rig = TestDevice::new();
    assert!(rig.app.alive());
    for _ in 0..20 {
        rig.pass(ASKED_EVERY);
        assert!(rig.app.alive());
    }
    assert!(!rig.app.alive(), "nothing has gone on since");
}

#[test]
fn a_sampler_in_use_that_gets_no_samples_is_not() {
    let mut rig = TestDevice::with(live());
    rig.pass(ASKED_EVERY);
    rig.app.alive();
    rig.pass(ASKED_EVERY);
    assert!(!rig.app.alive(), "no samples yet");
    for index in 0..20 {
        rig.script.push([Ok(RawSample { index, ..RawSample::default() })]);
        rig.pass(ASKED_EVERY);
        assert!(rig.app.alive());
    }
    rig.pass(ASKED_EVERY);
    assert!(!rig.app.alive(), "no more");
    rig.tell(Command::Stop);
    rig.pass(ASKED_EVERY);
    assert!(rig.app.alive(), "halted, none are due");
}

#[test]
fn a_host_that_does_not_read_is_no_reason() {
    let mut rig = TestDevice::with(live());
    rig.stream(Streams::ALL);
    rig.set_room(10);
    let samples = shaken(10_000);
    for (place, sample) in samples.iter().enumerate() {
        rig.script.push([Ok(*sample)]);
        rig.pass(1);
        if place as u64 % ASKED_EVERY == ASKED_EVERY - 1 {
            assert!(rig.app.alive(), "{place}");
        }
    }
}

#[test]
fn nor_is_one_that_injects_and_does_not_read() {
    let mut rig = TestDevice::with(live());
    rig.stream(Streams::ALL);
    rig.inject(&shaken(32));
    rig.set_room(10);
    let samples = shaken(4_000);
    samples[32..].chunks(32).for_each(|batch| {
        rig.send(Command::Inject(Samples::from_slice(batch).0));
    });
    for place in 0..20 {
        rig.pass(ASKED_EVERY);
        assert!(rig.app.alive(), "{place}");
    }
}
