//! Measures the cost of the shipping image while it works; prints one line of JSON.
//!
//! On the twin, the board measures a random motion at 1, 2 and 4 kHz with all streams on, over USB, while settings are
//! changed and saved, the estimator is reset and a tare is requested. At 4 kHz it also does so with the terminal
//! displacement, and with the digital front end. `loads` has for each case (`with`, and the rate \[Hz\]) the
//! instruction rate in the steady part \[instructions/s\], and the bounds of the time that the core is awake on the
//! chip ([`inerter_twin::cycles`]). `stack_bytes` is the peak stack usage of the whole run. `cargo xtask size` runs
//! this.

use ads131m04::{Gain, Osr};
use inerter_core::Settings;
use inerter_plant::Excitation;
use inerter_twin::bench::{Bench, Rig};
use inerter_twin::chip::ads131m04::Ads131m04;
use inerter_twin::machine::{Machine, shipping_image};
use inerter_twin::usb_link::{LinkError, UsbLink};
use inerter_wire::{Command, Record, SettingsValues, Streams};
use std::error::Error;
use std::process::ExitCode;

/// Time for the firmware to start and to be enumerated.
const START_S: f64 = 0.5;
/// Timeout for a reply.
const REPLY_S: f64 = 2.0;
/// Settling time of the estimator, and duration of the measurement.
const SETTLE_S: f64 = 2.0;
const STEADY_S: f64 = 4.0;

fn main() -> ExitCode {
    match measure() {
        Ok(line) => {
            println!("{line}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn measure() -> Result<String, Box<dyn Error>> {
    let image = shipping_image().ok_or("no image to measure")?;
    let rig = Rig::new(Excitation::random(0.5, 15.0, 0.02, 1), START_S);
    let (analogue, digital) = (|rate_hz| rig.settings(rate_hz), |osr| rig.digital_settings(osr, Gain::X64));
    let terminal = |settings| Settings { terminal_sensor: true, ..settings };
    let cases = [
        ("", analogue(1_000.0)),
        ("", analogue(2_000.0)),
        ("", analogue(4_000.0)),
        ("terminal sensor", terminal(analogue(4_000.0))),
        ("ADS131M04", digital(Osr::X2048)),
        ("ADS131M04", digital(Osr::X1024)),
        ("ADS131M04, terminal sensor", terminal(digital(Osr::X1024))),
    ];
    let mut machine = Machine::new(&image, Bench::new(rig)?)?;
    machine.chip_mut().ads131m04 = Some(Ads131m04::new([0.4e-6, 3e-6, 3e-6, 0.0], 3));
    machine.run_for(START_S)?;
    let mut link = UsbLink::new(machine);
    link.plug_in()?;
    ask(&mut link, Command::Hello)?;
    ask(&mut link, Command::Streams(Streams::ALL))?;
    let mut loads = Vec::new();
    for (with, settings) in &cases {
        let write = Command::WriteSettings(SettingsValues::from(settings));
        for command in [write.clone(), Command::SaveSettings, Command::Tare, write, Command::ResetEstimator] {
            ask(&mut link, command)?;
        }
        link.listen(SETTLE_S)?;
        link.socket.cpu.count_cycles()?;
        let before = link.socket.usage();
        link.talk.records();
        link.listen(STEADY_S)?;
        let usage = link.socket.usage().since(&before);
        link.socket.cpu.count_no_cycles()?;
        let [least, most] = usage.load_on_the_chip().ok_or("cycles are not counted")?;
        loads.push(format!(
            r#"{{"with":"{with}","rate_hz":{},"instructions_per_s":{:.0},"least":{least:.4},"most":{most:.4}}}"#,
            settings.sample_rate_hz,
            usage.instructions_per_s()
        ));
        if !link.talk.records().iter().any(|record| matches!(record, Record::Estimate(_))) {
            return Err("no estimate received: nothing was measured".into());
        }
    }
    let stack = link.socket.stack_high_water().ok_or("the image does not paint its stack")?;
    Ok(format!(r#"{{"stack_bytes":{},"loads":[{}]}}"#, stack.used, loads.join(",")))
}

fn ask(link: &mut UsbLink<Machine>, command: Command) -> Result<(), Box<dyn Error>> {
    let what = command.name();
    match link.request(command, REPLY_S)?.result {
        Ok(_) => Ok(()),
        Err(refusal) => Err(format!("{what}: {}", LinkError::Refused(refusal)).into()),
    }
}
