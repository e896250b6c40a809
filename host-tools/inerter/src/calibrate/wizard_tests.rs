use std::collections::VecDeque;

use inerter_data::settings::Overrides;
use inerter_device::{Clock, Target};
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Endpoint, Operator, Setup, VirtualDevice, bench_sensors};

use super::*;

/// A simulated technician who follows the instructions and knows only the labels on the bench.
struct Technician {
    bench: Operator,
    /// The present gauge reading \[m\].
    gauge_m: f64,
    step: String,
    said: Vec<String>,
    /// Answers that differ from the usual ones, by a part of the question.
    answers: VecDeque<(&'static str, &'static str)>,
    /// Questions before he presses Ctrl-C.
    patience: usize,
}

impl Technician {
    fn new(bench: Operator, answers: &[(&'static str, &'static str)]) -> Self {
        let answers = answers.iter().copied().collect();
        Self { bench, gauge_m: 0.0, step: String::new(), said: Vec::new(), answers, patience: usize::MAX }
    }

    fn number_in(text: &str, before: &str) -> f64 {
        let head = text.split(before).next().unwrap();
        head.split_whitespace().next_back().unwrap().trim_start_matches('+').parse().unwrap()
    }
}

impl Dialogue for Technician {
    fn say(&mut self, text: &str) {
        if text.get(1..3) == Some(". ") {
            self.step = text.into();
        }
        self.said.push(text.into());
    }

    fn ask(&mut self, question: &str, default: &str) -> Result<String, Error> {
        self.said.push(question.into());
        self.patience = self.patience.checked_sub(1).ok_or(inerter_data::Error::Interrupted)?;
        if self.answers.front().is_some_and(|(part, _)| question.contains(part)) {
            let (_, answer) = self.answers.pop_front().unwrap();
            return Ok(answer.into());
        }
        match question {
            // The device runs twenty times faster than the host's clock.
            _ if question.starts_with("begin?") => {
                let skipped = self.step.starts_with('1') || self.step.starts_with('7');
                return Ok(if skipped { "skip" } else { "begin" }.into());
            }
            _ if question.contains("take all loads off") => self.bench.load(0.0),
            _ if question.contains(" kg on") => {
                let sign = if question.contains("negative") { -1.0 } else { 1.0 };
                self.bench.load(sign * Self::number_in(question, " kg on") * 9.80665);
            }
            _ if question.contains("revolutions in the positive") => {
                self.bench.advance(0.010 * Self::number_in(question, " revolutions"))
            }
            _ if question.contains("go to zero") => self.bench.advance(-std::mem::take(&mut self.gauge_m)),
            _ if question.contains("on the gauge") => {
                let to_m = 1e-3 * Self::number_in(question, " mm");
                self.bench.advance(to_m - self.gauge_m);
                self.gauge_m = to_m;
            }
            _ if question.contains("back and forth") => self.bench.shake("random@12s").unwrap(),
            _ if question.contains("two tones") => self.bench.shake("random@25s").unwrap(),
            _ if question.contains("masses in kg") => return Ok("5 10".into()),
            _ if question.contains("displacement to move") => return Ok("40".into()),
            _ if question.contains("write and save") => return Ok("yes".into()),
            _ if question.contains("back all settings") => return Ok("-".into()),
            _ => {}
        }
        Ok(default.into())
    }

    fn progress(&mut self, _: &'static str, _: f64) -> Result<(), Error> {
        Ok(())
    }
}

/// A device whose settings are all wrong: scale and sign of the encoder, gain, zero, skew.
fn bench() -> (VirtualDevice, Operator, Sensors) {
    let sensors = Sensors {
        force_gain: 1.02,
        force_zero_code: 300.0,
        delay_s: 1.75e-3,
        metres_per_count: -2.44140625e-6,
        ..bench_sensors()
    };
    let mut setup = Setup::new(Inerter::paper(), sensors, "hold", None, &Overrides::default()).unwrap();
    setup.settings.metres_per_count = 2.3e-6;
    setup.settings.force_zero_code = 0.0;
    setup.settings.skew_s = 0.0;
    let (device, bench) = VirtualDevice::with_operator(&setup, &Endpoint::Tcp("127.0.0.1:0".into()), 20.0).unwrap();
    (device, bench, sensors)
}

fn connected(device: &VirtualDevice) -> Device {
    Device::connect(&Target::Tcp { address: device.name().into() }, Clock::new(), || false).unwrap()
}

#[test]
fn a_technician_who_does_what_he_is_told_ends_with_a_calibrated_device() {
    let (virtual_device, bench, sensors) = bench();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept.toml");
    let name: &'static str = Box::leak(path.display().to_string().into_boxed_str());
    let mut technician = Technician::new(bench, &[("latitude", "45.5"), ("back all settings", name)]);
    let mut device = connected(&virtual_device);
    let written = Wizard::new(&mut device, &mut technician).run();
    let said = technician.said.join("\n");
    assert!(written.unwrap_or_else(|error| panic!("{error}\n{said}")), "{said}");
    drop(device);
    let settings = *connected(&virtual_device).settings();
    let near = |value: f64, truth: f64, u95: f64| (value / truth - 1.0).abs() <= u95;
    // The masses there weigh under standard gravity; gravity at a latitude of 45.5 degrees differs from it by 0.5e-4.
    assert!(near(settings.newtons_per_code, 0.002 / 1.02, settings.force_gain_u95), "{settings:?}\n{said}");
    assert!(settings.force_gain_u95 < 3e-3 && settings.lead_u95 < 2e-3, "{settings:?}");
    assert!(near(settings.metres_per_count, sensors.metres_per_count, settings.lead_u95), "{settings:?}");
    assert!((settings.force_zero_code - 300.0).abs() < 60.0, "{settings:?}");
    assert!((settings.skew_s - 1.75e-3).abs() <= settings.skew_u95_s && settings.skew_u95_s < 6e-6, "{settings:?}");
    for words in [
        "same positive direction",
        "4096 counts per revolution",
        "lead 10.00",
        "2.3e-6 -> -2.441",
        "saved on the device",
    ] {
        assert!(said.contains(words), "{words}\n{said}");
    }
    assert_eq!(backup::values_of(&path).unwrap(), settings.values().map(Some));
}

#[test]
fn ctrl_c_at_any_question_leaves_the_device_as_it_was() {
    let (virtual_device, bench, _) = bench();
    let before = *connected(&virtual_device).settings();
    // At the first question, in the middle of the loads, with the zero accepted, and among the encoder's questions.
    for (patience, expected) in
        [(0, &[][..]), (9, &["force_zero_code"]), (20, &["newtons_per_code", "force_zero_code", "force_gain_u95"])]
    {
        let mut technician = Technician::new(bench.clone(), &[]);
        technician.patience = patience;
        let mut device = connected(&virtual_device);
        let mut wizard = Wizard::new(&mut device, &mut technician);
        let error = wizard.run().unwrap_err();
        assert!(matches!(error.downcast_ref(), Some(inerter_data::Error::Interrupted)), "{error}");
        let accepted: Vec<_> = wizard.accepted().iter().map(|(name, ..)| *name).collect();
        assert_eq!(accepted, expected);
        drop(device);
        assert_eq!(*connected(&virtual_device).settings(), before);
    }
}

#[test]
fn what_is_declined_at_the_end_is_not_written() {
    let (virtual_device, bench, _) = bench();
    let before = *connected(&virtual_device).settings();
    let answers = [("begin?", "s"), ("begin?", "b"), ("accept it?", "r"), ("accept it?", "a")];
    let mut technician = Technician::new(bench, &answers);
    technician.answers.extend([("begin?", "s"); 5]);
    technician.answers.push_back(("write and save", "no"));
    let mut device = connected(&virtual_device);
    let mut wizard = Wizard::new(&mut device, &mut technician);
    assert!(!wizard.run().unwrap());
    assert_eq!(wizard.accepted().len(), 1);
    drop(device);
    assert_eq!(*connected(&virtual_device).settings(), before);
}

#[test]
fn loads_are_read_as_they_are_typed() {
    assert_eq!(sizes("5 10", Machine::Linear).unwrap(), [(5.0, true), (10.0, true)]);
    assert_eq!(sizes("10 kg; 5 kg 500 g", Machine::Linear).unwrap(), [(0.5, true), (5.0, true), (10.0, true)]);
    assert_eq!(sizes("0.05 N m 20mNm 0.1", Machine::Rotary).unwrap(), [(0.02, false), (0.05, false), (0.1, false)]);
    assert!(sizes("5 kg", Machine::Rotary).is_err());
    assert_eq!(sizes("50 N 100N", Machine::Linear).unwrap(), [(50.0, false), (100.0, false)]);
    assert!(
        sizes("five", Machine::Linear).is_err()
            && sizes("", Machine::Linear).unwrap().is_empty()
            && sizes("0", Machine::Linear).unwrap().is_empty()
    );
}
