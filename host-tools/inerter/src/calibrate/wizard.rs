//! All steps one after the other, for a person at the rig.
//!
//! Each step shows what it has found and asks whether to accept it, repeat it or go on without it. The next step is
//! evaluated under the settings accepted so far, on the host; the device itself stays unchanged until the last
//! question.

use std::{f64::consts::TAU, path::PathBuf};

use inerter_analysis::{
    calibrate::{
        CalibrateError, Finding, Level,
        direction::Known,
        force::{Gravity, Load},
        timebase::HOST_PPM,
    },
    fit::FitError,
    skew::SkewError,
};
use inerter_core::{Machine, Settings};
use inerter_data::{
    backup::{self, changes},
    names::description,
    output::refuse_existing,
};
use inerter_device::Device;

use super::{
    dialogue::{
        DEGREES, Dialogue, KILOGRAMS, MICROMETRES, MILLIMETRES, NEWTON_METRES, NEWTONS, PERCENT, PLAIN, PPM, number,
    },
    steps::{EncoderPlan, Station},
};
use crate::error::Error;

/// Durations of the steps' measurements \[s\].
const LOAD_CELL_S: f64 = 10.0;
const ZERO_S: f64 = 5.0;
const LOAD_S: f64 = 3.0;
const DIRECTION_S: f64 = 8.0;
const SKEW_S: f64 = 20.0;
const TIMEBASE_S: f64 = 60.0;

/// The sequence of all steps.
pub struct Wizard<'a> {
    rig: Station<'a>,
    known: Known,
}

/// What the person decided about a finding.
enum Verdict {
    Accept,
    Repeat,
    Skip,
}

impl<'a> Wizard<'a> {
    /// A wizard for this device and this person.
    pub fn new(device: &'a mut Device, dialogue: &'a mut dyn Dialogue) -> Self {
        let settings = *device.settings();
        Self { rig: Station { device, dialogue, settings, may_ask: true }, known: Known::default() }
    }

    /// What was accepted so far, by name: the value on the device, and the new value.
    pub fn accepted(&self) -> Vec<(&'static str, f64, f64)> {
        changes(self.rig.device.settings(), &self.rig.settings)
    }

    /// Runs all steps, then writes and saves what was accepted, after confirmation; returns whether anything was
    /// written.
    pub fn run(&mut self) -> Result<bool, Error> {
        let hello = self.rig.device.hello();
        let greeting = format!("{} (serial {}) at {}", hello.board, hello.serial, self.rig.device.name());
        self.say(&greeting);
        self.say("Seven steps, each may be skipped; Enter accepts the value in parentheses.");
        self.say("Nothing is changed on the device before the end, and Ctrl-C leaves it as it is.");
        if !self.rig.device.keeps_settings() {
            self.say(
                "This device does not store settings: they are in use until it restarts, and can be written to a file.",
            );
        }
        self.step("1. Load cell", "Keep the device still, without load: noise, mains and range are checked.", |rig| {
            rig.load_cell(LOAD_CELL_S)
        })?;
        self.step("2. Zero", "Keep the device still, without load: its code becomes the zero.", |rig| {
            rig.zero(ZERO_S)
        })?;
        self.known.force = self.step(
            "3. Force",
            "Known masses or forces (torques) on the load cell, in both directions where possible. Lock the screw first.",
            loads,
        )?;
        self.known.position = self.step(
            "4. Encoder",
            "Turn the screw by hand, then move it along a gauge, or take its lead from the data sheet. A rotary axis is only turned.",
            encoder,
        )?;
        let known = self.known;
        self.step(
            "5. Direction",
            "Move the terminal back and forth: a positive force must accelerate it to the positive side.",
            |rig| {
                rig.dialogue.ask(
                    "move it back and forth by a few millimetres, several times a second; press Enter while it moves",
                    "",
                )?;
                rig.direction(DIRECTION_S, known)
            },
        )?;
        self.step(
            "6. Skew",
            "Move the rig with several frequencies or from point to point, to find the delay of the force behind the position.",
            |rig| {
                rig.dialogue.ask(
                    "start two tones, a random motion or moves from point to point; press Enter while it moves",
                    "",
                )?;
                rig.skew(SKEW_S)
            },
        )?;
        self.step("7. Timebase", "The device's clock is compared with this computer's for a minute.", |rig| {
            let question = "accuracy of this computer's clock in ppm (50: any, 1: disciplined by NTP for hours)";
            let ppm = rig.dialogue.ask_number(question, "50", PPM)?.map_or(HOST_PPM, f64::abs);
            rig.timebase(TIMEBASE_S, ppm)
        })?;
        self.finish()
    }

    fn say(&mut self, text: &str) {
        self.rig.dialogue.say(text);
    }

    /// Repeats one step as often as the person likes; returns whether a finding with settings was accepted.
    fn step(
        &mut self,
        title: &str,
        about: &str,
        mut body: impl FnMut(&mut Station<'a>) -> Result<Finding, Error>,
    ) -> Result<bool, Error> {
        self.say("");
        self.say(&format!("{title}. {about}"));
        if self.rig.dialogue.choose("begin?", &["begin", "skip"])? == 1 {
            return Ok(false);
        }
        loop {
            let verdict = match body(&mut self.rig) {
                Ok(finding) => {
                    let verdict = self.judge(&finding)?;
                    match (&verdict, finding.adopted_by(&self.rig.settings)) {
                        (Verdict::Accept, Ok(settings)) => {
                            self.rig.settings = settings;
                            return Ok(finding.has_settings());
                        }
                        (Verdict::Accept, Err(error)) => {
                            self.say(&format!("this is not a valid setting: {error}"));
                            self.retry()?
                        }
                        _ => verdict,
                    }
                }
                // The measurement is at fault, not the link or the program.
                Err(error) if error.is::<CalibrateError>() || error.is::<FitError>() || error.is::<SkewError>() => {
                    self.rig.dialogue.explain(&*error);
                    self.retry()?
                }
                Err(error) => return Err(error),
            };
            if matches!(verdict, Verdict::Skip) {
                return Ok(false);
            }
        }
    }

    fn retry(&mut self) -> Result<Verdict, Error> {
        let skip = self.rig.dialogue.choose("repeat this step?", &["repeat", "skip"])? == 1;
        Ok(if skip { Verdict::Skip } else { Verdict::Repeat })
    }

    fn judge(&mut self, finding: &Finding) -> Result<Verdict, Error> {
        show(self.rig.dialogue, finding, self.rig.settings.machine);
        if !finding.is_good() {
            return self.retry();
        }
        let question = if finding.has_settings() { "accept it?" } else { "continue?" };
        Ok(match self.rig.dialogue.choose(question, &["accept", "repeat", "skip"])? {
            0 => Verdict::Accept,
            1 => Verdict::Repeat,
            _ => Verdict::Skip,
        })
    }

    fn finish(&mut self) -> Result<bool, Error> {
        self.say("");
        let accepted = self.accepted();
        if accepted.is_empty() {
            self.say("no accepted value differs from the device's: nothing is changed");
            return Ok(false);
        }
        self.say("What would change on the device:");
        for (name, before, after) in &accepted {
            self.say(&format!("  {name:<18} {before:?} -> {after:?}"));
        }
        let keeps = self.rig.device.keeps_settings();
        let question = if keeps { "write and save this?" } else { "put this in use until the device restarts?" };
        if self.rig.dialogue.choose(question, &["no", "yes"])? == 0 {
            self.say("nothing was changed on the device");
            return Ok(false);
        }
        if keeps {
            write(self.rig.device, &self.rig.settings)?;
            self.say("saved on the device: these settings survive a restart");
        } else {
            self.rig.device.write_settings(&self.rig.settings)?;
            self.say("in use on the device, until it restarts");
        }
        self.offer_backup()?;
        Ok(true)
    }

    fn offer_backup(&mut self) -> Result<(), Error> {
        let name = format!("inerter-{}.toml", self.rig.device.hello().serial);
        loop {
            let answer = self.rig.dialogue.ask("back all settings up to a file (- for none)", &name)?;
            if answer == "-" {
                return Ok(());
            }
            let path = PathBuf::from(answer);
            let written = refuse_existing(&path)
                .and_then(|()| backup::write(&path, false, self.rig.device.hello(), self.rig.device.settings()));
            match written {
                Ok(()) => {
                    self.say(&format!(
                        "all settings are in {}; `inerter settings restore` restores them",
                        path.display()
                    ));
                    return Ok(());
                }
                // A full disk must not spoil what is saved on the device.
                Err(error) => self.say(&format!("{error}; choose another name")),
            }
        }
    }
}

/// Shows a finding to a person.
fn show(dialogue: &mut dyn Dialogue, finding: &Finding, machine: Machine) {
    for line in &finding.text {
        dialogue.say(&format!("  {}", description(machine, line)));
    }
    for remark in &finding.remarks {
        let mark = match remark.level {
            Level::Note => "note",
            Level::Doubtful => "doubtful",
            Level::Bad => "BAD",
        };
        dialogue.say(&format!("  {mark}: {}", description(machine, &remark.text)));
    }
}

/// Puts settings in use on a device and saves them; if they cannot be saved, restores the previous ones.
pub fn write(device: &mut Device, settings: &Settings) -> Result<(), Error> {
    let before = *device.settings();
    device.write_settings(settings)?;
    let saved = device.save_settings();
    if saved.is_err() {
        // Works only if the device is still there; the first error is the one to report.
        device.write_settings(&before).ok();
    }
    Ok(saved?)
}

fn loads(rig: &mut Station) -> Result<Finding, Error> {
    let machine = rig.settings.machine;
    let sizes = loop {
        let question = match machine {
            Machine::Linear => "masses in kg (or forces: 50 N), smallest first, for example: 5 10",
            Machine::Rotary => "torques in N m, smallest first, for example: 0.02 0.05",
        };
        let answer = rig.dialogue.ask(question, "")?;
        match sizes(&answer, machine) {
            Ok(sizes) if !sizes.is_empty() => break sizes,
            Ok(_) => rig.dialogue.say("at least one is needed"),
            Err(error) => rig.dialogue.say(&error.to_string()),
        }
    };
    let both = rig.dialogue.choose("can these loads be applied in both directions?", &["yes", "no"])? == 0;
    let gravity = if sizes.iter().any(|(_, is_mass)| *is_mass) {
        let question = "latitude in degrees, for the local gravity (empty: unknown, 0.27 % uncertain)";
        rig.dialogue.ask_number(question, "", DEGREES)?.map_or(Gravity::ANYWHERE, Gravity::at_latitude)
    } else {
        Gravity { value: 1.0, u95: 0.0 }
    };
    let percent = rig
        .dialogue
        .ask_number(&description(machine, "uncertainty of these loads, in percent"), "0.1", PERCENT)?
        .unwrap_or(0.1)
        .abs();
    let mut loads = vec![Load::mass(0.0, &gravity)];
    for sign in if both { &[1.0, -1.0][..] } else { &[1.0] } {
        let up = sizes.iter();
        let down = sizes.iter().rev().skip(1);
        loads.extend(up.chain(down).map(|&(size, is_mass)| {
            if is_mass { Load::mass(sign * size, &gravity) } else { Load::force(sign * size) }
        }));
        loads.push(Load::mass(0.0, &gravity));
    }
    rig.force(&loads, (percent / 100.0).hypot(gravity.u95), LOAD_S)
}

/// Loads as typed: `5 10 kg`, `50 N 100 N`, or for a rotary machine `0.02 0.05 Nm`; each with whether it is a mass.
fn sizes(text: &str, machine: Machine) -> Result<Vec<(f64, bool)>, Error> {
    let mut words: Vec<String> = Vec::new();
    for word in text.replace(';', " ").split_whitespace() {
        match words.last_mut() {
            // A unit separated from its number.
            Some(number) if word.starts_with(char::is_alphabetic) => number.push_str(word),
            _ => words.push(word.into()),
        }
    }
    let each = words.iter().map(|word| {
        let (units, is_mass) = match machine {
            Machine::Rotary => (NEWTON_METRES, false),
            Machine::Linear if word.ends_with('N') => (NEWTONS, false),
            Machine::Linear => (KILOGRAMS, true),
        };
        Ok((number(word, units)?.abs(), is_mass))
    });
    let mut sizes = each.collect::<Result<Vec<_>, Error>>()?;
    sizes.retain(|(size, _)| *size > 0.0);
    sizes.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(sizes)
}

fn encoder(rig: &mut Station) -> Result<Finding, Error> {
    let dialogue = &mut *rig.dialogue;
    let lines = dialogue.ask_number("lines per revolution from the encoder's label (empty: unknown)", "", PLAIN)?;
    let revolutions = dialogue.ask_number("revolutions to turn by hand", "10", PLAIN)?;
    let mut plan = EncoderPlan {
        revolutions: revolutions.filter(|turns| turns.abs() >= 0.5).or(Some(10.0)),
        lines: lines.filter(|lines| *lines > 0.0),
        ..EncoderPlan::default()
    };
    if rig.settings.machine == Machine::Rotary {
        // A revolution is exact: it has no uncertainty.
        plan.lead_m = Some(TAU);
        return rig.encoder(&plan);
    }
    let lead_mm =
        dialogue.ask_number("lead of the screw in mm from its data sheet (empty: unknown)", "", MILLIMETRES)?;
    let gauge_mm =
        dialogue.ask_number("displacement to move along a gauge, in mm (empty: no gauge)", "", MILLIMETRES)?;
    plan.lead_m = lead_mm.map(|lead| 1e-3 * lead.abs()).filter(|lead| *lead > 0.0);
    match gauge_mm.filter(|gauge| *gauge != 0.0) {
        Some(gauge_mm) => {
            let far = 1e-3 * gauge_mm;
            plan.displacements_m = vec![0.0, far, 0.0, far, 0.0];
            let microns = dialogue.ask_number("uncertainty of the gauge in µm", "10", MICROMETRES)?.unwrap_or(10.0);
            plan.gauge_u95_m = 1e-6 * microns.abs();
        }
        None => {
            let percent = dialogue.ask_number("uncertainty of the lead in percent", "0.1", PERCENT)?.unwrap_or(0.1);
            plan.lead_u95 = percent.abs() / 100.0;
        }
    }
    rig.encoder(&plan)
}

#[cfg(test)]
#[path = "wizard_tests.rs"]
mod tests;
