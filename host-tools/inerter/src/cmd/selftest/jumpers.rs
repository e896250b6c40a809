//! The part of the self-test that needs four wires. The outputs are driven only after the user confirms that no rig is
//! connected.

use std::time::{Duration, Instant};

use inerter_data::selftest::Check;
use inerter_device::{Device, DeviceError, Received};
use inerter_jumpers::{Board, JumperError, Measured, run};
use inerter_wire::{Command, Done, Frame, Record};

use crate::{
    Error,
    calibrate::Dialogue,
    cmd::{calibrate::person::Person, terminal::can_ask},
};

/// Name and label of the check as a whole.
pub const CHECK: (&str, &str) = ("jumpers", "Signals through jumpers");
const QUESTION: &str =
    "Drive the board's outputs? Only with no rig connected and the four wires of docs/HARDWARE.md in place: yes or no";

/// The device as the jumper test sees it.
struct Wired<'a> {
    device: &'a mut Device,
    heard: Vec<(f64, Record)>,
    /// Why the link failed.
    failed: Option<DeviceError>,
}

impl Wired<'_> {
    fn keep(&mut self, received: Received) {
        if let Frame::Message { message, .. } = received.frame {
            self.heard.push((received.time_ns as f64 * 1e-9, message));
        }
    }

    fn link(&mut self, error: DeviceError) -> JumperError {
        let words = error.to_string();
        self.failed = Some(error);
        JumperError::Link(words)
    }
}

impl Board for Wired<'_> {
    fn request(&mut self, command: Command) -> Result<Done, JumperError> {
        match self.device.request("to play", command) {
            Err(DeviceError::Refused { refusal: why, .. }) => Err(JumperError::Refused { doing: "play", why }),
            result => result.map_err(|error| self.link(error)),
        }
    }

    fn listen(&mut self, for_s: f64) -> Result<(), JumperError> {
        let end = Instant::now() + Duration::from_secs_f64(for_s);
        while Instant::now() < end {
            self.device.check_interrupted().map_err(|error| self.link(error))?;
            match self.device.receive() {
                Ok(Some(received)) => self.keep(received),
                Ok(None) => {}
                Err(error) => return Err(self.link(error)),
            }
        }
        Ok(())
    }

    fn records(&mut self) -> Vec<(f64, Record)> {
        while let Some(received) = self.device.pending() {
            self.keep(received);
        }
        std::mem::take(&mut self.heard)
    }
}

/// Asks whether the outputs may be driven; without a user the answer is no.
pub fn may_drive() -> Result<bool, Error> {
    if !can_ask() {
        return Ok(false);
    }
    let answer = Person::new(false).ask(QUESTION, "no")?;
    Ok(matches!(answer.to_lowercase().as_str(), "y" | "yes"))
}

/// Plays and judges the signals, and the board's clock if USB has not given it. An error is the link's; any other
/// failure is a failed check, with nothing measured.
pub fn play(device: &mut Device, clock_is_known: bool) -> Result<(Vec<Check>, Option<Measured>), DeviceError> {
    let mut wired = Wired { device, heard: Vec::new(), failed: None };
    let outcome = run(&mut wired, clock_is_known);
    match (outcome, wired.failed) {
        (Ok(report), _) => {
            let checks = report.checks.into_iter().map(|check| {
                Check::words(check.name.replace(' ', "_"), check.name, check.expected, check.found, check.cause)
            });
            Ok((checks.collect(), report.measured))
        }
        (Err(_), Some(error)) => Err(error),
        (Err(error), None) => {
            let ((name, label), words) = (CHECK, error.to_string());
            let check = match error {
                // This computer was too slow, which says nothing about the board.
                JumperError::TooLate(_) => Check::skipped(name, label, words),
                _ => Check::words(name, label, "completed", "aborted", Some(words)),
            };
            Ok((vec![check], None))
        }
    }
}
