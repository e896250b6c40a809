//! How much of the image's stack is never used while it serves: prints `{"stack_free_bytes":N}`.
//!
//! The image in QEMU measures a motion for some seconds with every stream on, while settings are written, the estimator is reset
//! and a tare is asked for. It paints its stack at the start and says in its health how much of the paint is left.
//! `cargo xtask size` runs this.
#![forbid(unsafe_code)]

use std::{error::Error, process::ExitCode, time::Instant};

use inerter_data::settings::Overrides;
use inerter_device::{Device, Target};
use inerter_plant::Inerter;
use inerter_simulate::{Endpoint, Qemu, START_TIME, Setup, bench_sensors, find_image};
use inerter_wire::{Command, EventKind, Frame, Record, Streams};

/// Length of the motion \[s\], and how many times faster than real time it is played.
const MOTION: &str = "multi@40s";
const SPEED: f64 = 10.0;
/// A run that has not ended by then has failed \[s\].
const LIMIT_S: u64 = 60;

fn main() -> ExitCode {
    match measure() {
        Ok(free) => {
            println!("{{\"stack_free_bytes\":{free}}}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn measure() -> Result<u32, Box<dyn Error>> {
    let setup = Setup::new(Inerter::paper(), bench_sensors(), MOTION, None, &Overrides::default())?;
    let image = find_image(None)?;
    let mut qemu = Qemu::boot(&image, &Endpoint::Tcp("127.0.0.1:0".into()), || false)?;
    let target = Target::Tcp { address: qemu.name().to_owned() };
    let alive = || Ok::<(), Box<dyn Error>>(qemu.check()?);
    let mut device = Device::connect_starting(&target, START_TIME, &setup.settings, || false, alive)?;
    device.start_sampler()?;
    qemu.play(&setup, SPEED)?;
    device.stream(Streams::ALL)?;
    let mut settings = *device.settings();
    settings.memory_s *= 2.0;
    device.write_settings(&settings)?;
    device.request("to reset its estimator", Command::ResetEstimator)?;
    device.request("to tare", Command::Tare)?;
    let started = Instant::now();
    let (mut free, mut ended) = (None, false);
    // One more health after the end knows of everything.
    while !ended || free.is_none() {
        if started.elapsed().as_secs() > LIMIT_S {
            return Err(format!("the image did not come to the end of the motion within {LIMIT_S} s").into());
        }
        let Some(received) = device.receive()? else {
            qemu.check()?;
            continue;
        };
        let Frame::Message { message, .. } = received.frame else { continue };
        match message {
            Record::Event(event) if event.kind == EventKind::SourceEnded => (free, ended) = (None, true),
            Record::Health(health) => free = health.stack_free_bytes,
            _ => {}
        }
    }
    free.ok_or("the image does not know its stack".into())
}
