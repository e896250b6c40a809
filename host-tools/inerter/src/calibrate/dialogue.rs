//! The interface between a calibration step and the person at the rig.

use miette::Diagnostic;

use crate::error::{DialogueError, Error};

/// Questions and messages to a person.
pub trait Dialogue {
    /// Shows a message.
    fn say(&mut self, text: &str);

    /// Asks for a line; an empty one gives `default`.
    fn ask(&mut self, question: &str, default: &str) -> Result<String, Error>;

    /// Shows that this fraction of `label` is done, from 0 to 1; fails when the person wants to stop.
    fn progress(&mut self, label: &'static str, fraction: f64) -> Result<(), Error>;

    /// Shows an error with its help.
    fn explain(&mut self, error: &dyn Diagnostic) {
        self.say(&error.to_string());
        if let Some(help) = error.help() {
            self.say(&format!("  {help}"));
        }
    }

    /// Asks until one of the choices is named: a word or its first letter. Returns its index; the first one is the
    /// default.
    fn choose(&mut self, question: &str, choices: &[&str]) -> Result<usize, Error> {
        let default = choices.first().copied().unwrap_or_default();
        loop {
            let answer = self.ask(&format!("{question} [{}]", choices.join("/")), default)?.to_lowercase();
            let chosen = choices.iter().position(|choice| !answer.is_empty() && choice.starts_with(&answer));
            match chosen {
                Some(chosen) => return Ok(chosen),
                None => self.say(&format!("please answer with one of: {}", choices.join(", "))),
            }
        }
    }

    /// Asks until the answer is a number with one of these units or none, or empty.
    fn ask_number(&mut self, question: &str, default: &str, units: Units) -> Result<Option<f64>, Error> {
        loop {
            let answer = self.ask(question, default)?;
            match number(&answer, units) {
                _ if answer.trim().is_empty() => return Ok(None),
                Ok(number) => return Ok(Some(number)),
                Err(error) => self.say(&error.to_string()),
            }
        }
    }
}

/// Units that may follow a number, each with its factor; a number without a unit is taken as it is.
pub type Units = &'static [(&'static str, f64)];

/// Masses in kilograms.
pub const KILOGRAMS: Units = &[("kg", 1.0), ("g", 1e-3)];
/// Forces in newtons.
pub const NEWTONS: Units = &[("N", 1.0), ("kN", 1e3), ("mN", 1e-3)];
/// Torques in newton metres.
pub const NEWTON_METRES: Units = &[("Nm", 1.0), ("mNm", 1e-3), ("N", 1.0)];
/// Lengths in metres.
pub const METRES: Units = &[("m", 1.0), ("mm", 1e-3), ("um", 1e-6), ("µm", 1e-6)];
/// Lengths in millimetres.
pub const MILLIMETRES: Units = &[("mm", 1.0), ("m", 1e3), ("um", 1e-3), ("µm", 1e-3)];
/// Lengths in micrometres.
pub const MICROMETRES: Units = &[("um", 1.0), ("µm", 1.0), ("mm", 1e3)];
/// Percent.
pub const PERCENT: Units = &[("%", 1.0)];
/// Parts per million.
pub const PPM: Units = &[("ppm", 1.0)];
/// Angles in degrees.
pub const DEGREES: Units = &[("°", 1.0), ("deg", 1.0)];
/// No unit.
pub const PLAIN: Units = &[];

/// Parses a number as people write it: with a decimal comma or point, and optionally one of these units after it.
pub fn number(text: &str, units: Units) -> Result<f64, DialogueError> {
    let refused = || {
        let known: Vec<&str> = units.iter().map(|(unit, _)| *unit).collect();
        let known = if known.is_empty() { "without a unit".into() } else { format!("in {}", known.join(" or ")) };
        DialogueError::Answer { text: text.trim().into(), known }
    };
    let trimmed = text.trim();
    let is_part = |letter: char| letter.is_ascii_digit() || "+-.,eE".contains(letter);
    let end = trimmed.find(|letter| !is_part(letter)).unwrap_or(trimmed.len());
    let (digits, unit) = (trimmed.get(..end).unwrap_or_default(), trimmed.get(end..).unwrap_or_default().trim());
    let factor = match unit {
        "" => 1.0,
        unit => units.iter().find(|(known, _)| *known == unit).map(|(_, factor)| *factor).ok_or_else(refused)?,
    };
    let value: f64 = digits.replace(',', ".").parse().map_err(|_| refused())?;
    if value.is_finite() { Ok(value * factor) } else { Err(refused()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_taken_as_people_write_it() {
        for (text, units, value) in [
            ("5", PLAIN, 5.0),
            (" 4,998 ", KILOGRAMS, 4.998),
            ("-5 kg", KILOGRAMS, -5.0),
            ("500 g", KILOGRAMS, 0.5),
            ("10mm", METRES, 0.01),
            ("1e-3", PLAIN, 1e-3),
            ("2 kN", NEWTONS, 2e3),
            ("0,1 %", PERCENT, 0.1),
        ] {
            assert_eq!(number(text, units), Ok(value), "{text}");
        }
        for text in ["", "five", "1.2.3", "5 lb", "5 N", "1,000,000", "nan", "1e999", "kg"] {
            assert!(number(text, KILOGRAMS).is_err(), "{text}");
        }
        let words = number("5 kg", NEWTONS).map_err(|error| error.to_string());
        assert_eq!(words, Err("`5 kg` is not a number in N or kN or mN".into()));
    }
}
