//! Parses motions written as text.

use std::f64::consts::PI;

use super::{Excitation, Moves, Tone};
use crate::PlantError;

const SEQUENCE: &str = "mid@20s;hold@5s;random@20s";
const SINE: &str = "sine:3.2Hz:4.16mm";
const TONES: &str = "tones:0.8Hz:8mm,6.4Hz:0.8mm";
const MULTI: &str = "multi:0.5-15Hz:20mm/s";
const RANDOM: &str = "random:0.5-15Hz:20mm/s";
const CHIRP: &str = "chirp:0.1-20Hz:5mm/s:60s";
const MOVES: &str = "moves:0.25m:0.3m/s:2m/s2:0.2s";

/// Units, each with its factor to the SI unit.
type Units = &'static [(&'static str, f64)];

const FREQUENCY: Units = &[("Hz", 1.0), ("mHz", 1e-3)];
const LENGTH: Units =
    &[("mm", 1e-3), ("um", 1e-6), ("µm", 1e-6), ("m", 1.0), ("rad", 1.0), ("mrad", 1e-3), ("deg", DEGREE)];
const SPEED: Units = &[
    ("mm/s", 1e-3),
    ("um/s", 1e-6),
    ("µm/s", 1e-6),
    ("m/s", 1.0),
    ("rad/s", 1.0),
    ("mrad/s", 1e-3),
    ("deg/s", DEGREE),
    ("rpm", 6.0 * DEGREE),
];
const ACCELERATION: Units = &[("m/s2", 1.0), ("mm/s2", 1e-3), ("rad/s2", 1.0), ("deg/s2", DEGREE)];
const TIME: Units = &[("ms", 1e-3), ("min", 60.0), ("s", 1.0)];
const ANGLE: Units = &[("deg", 1.0)];
/// One degree \[rad\].
const DEGREE: f64 = PI / 180.0;

fn wrong<T>(part: &str, problem: impl Into<String>, example: &'static str) -> Result<T, PlantError> {
    Err(PlantError::Motion { part: part.to_owned(), problem: problem.into(), example })
}

impl Excitation {
    /// Parses a preset's name, a motion such as `sine:3.2Hz:4.16mm`, or a sequence such as `mid@20s;hold@5s;random`.
    ///
    /// Motions: `sine:F:A`, `tones:F:A,F:A,...`, `multi:LOW-HIGHHz:V`, `random:LOW-HIGHHz:V`, `chirp:LOW-HIGHHz:V:T`,
    /// `moves:STROKE:V:ACCELERATION:REST`, `hold`. Frequencies in Hz, amplitudes in m, mm, um, rad or deg, rms
    /// velocities in m/s, mm/s, um/s, rad/s or rpm, accelerations in m/s2 or rad/s2, times in s, ms or min. The parts
    /// of a sequence are separated by `;` or `+`; each except the last needs a duration `@T` (a chirp has one). `seed`
    /// is as for [`preset`](Self::preset); each part of a sequence draws its own tones from it.
    pub fn parse(text: &str, seed: u64) -> Result<Self, PlantError> {
        let pieces = split(text);
        let last = pieces.len() - 1;
        let mut parts = Vec::new();
        for (k, piece) in pieces.into_iter().map(str::trim).enumerate() {
            let part = timed(piece, seed.wrapping_add(k as u64))?;
            if k < last && part.duration_s() == f64::INFINITY {
                return wrong(piece, "only the last part of a sequence may last for ever: add a duration", SEQUENCE);
            }
            parts.push(part);
        }
        Ok(Self::sequence(parts))
    }
}

/// Splits at `;` and at `+`, unless the `+` belongs to an exponent (`1e+3`).
fn split(text: &str) -> Vec<&str> {
    let mut pieces = Vec::new();
    let mut start = 0;
    let bytes = text.as_bytes();
    for (k, c) in text.char_indices() {
        let before = |n: usize| k.checked_sub(n).and_then(|i| bytes.get(i).copied());
        let exponent =
            matches!(before(1), Some(b'e' | b'E')) && before(2).is_some_and(|b| b.is_ascii_digit() || b == b'.');
        if c == ';' || (c == '+' && !exponent) {
            pieces.push(&text[start..k]);
            start = k + 1;
        }
    }
    pieces.push(&text[start..]);
    pieces
}

/// A motion with or without `@duration`.
fn timed(text: &str, seed: u64) -> Result<Excitation, PlantError> {
    let Some((motion, time)) = text.split_once('@') else { return single(text, seed) };
    let duration = quantity(time, TIME, "a time", SEQUENCE)?;
    let motion = single(motion.trim(), seed)?.lasting(duration);
    checked(time, motion, SEQUENCE)
}

/// One motion: a preset's name or a kind with its numbers.
fn single(text: &str, seed: u64) -> Result<Excitation, PlantError> {
    let mut fields = text.split(':').map(str::trim);
    let kind = fields.next().unwrap_or_default();
    let fields: Vec<&str> = fields.collect();
    if fields.is_empty()
        && let Some(preset) = Excitation::preset(kind, seed)
    {
        return Ok(preset);
    }
    let (takes, example) = match kind {
        "" if fields.is_empty() => return wrong(text, "a motion is missing here", SEQUENCE),
        "hold" => ("hold takes no numbers, only a duration", "hold@5s"),
        "sine" => ("a sine takes a frequency and an amplitude", SINE),
        "tones" => ("tones take a list of frequencies and amplitudes", TONES),
        "multi" => ("a multisine takes a band and an rms velocity", MULTI),
        "random" => ("a random motion takes a band and an rms velocity", RANDOM),
        "chirp" => ("a chirp takes a band, an rms velocity and a duration", CHIRP),
        "moves" => ("moves take a stroke, a velocity, an acceleration and a rest", MOVES),
        name => {
            let known = Excitation::PRESETS.join(", ");
            let problem = format!("no motion has this name; known: {known}, sine, tones, chirp, moves, hold");
            return wrong(name, problem, SEQUENCE);
        }
    };
    let motion = match (kind, fields.as_slice()) {
        ("hold", []) => Excitation::hold(),
        ("sine", [frequency, amplitude]) => Excitation::tones(vec![tone(frequency, amplitude, example)?]),
        ("tones", [_, ..]) => tones(text)?,
        ("multi" | "random", [band, velocity]) => {
            let (low, high, rms) = band_and_speed(band, velocity, example)?;
            let motion = if kind == "multi" { Excitation::multisine } else { Excitation::random };
            motion(low, high, rms, seed)
        }
        ("chirp", [band, velocity, time]) => {
            let (low, high, rms) = band_and_speed(band, velocity, example)?;
            Excitation::chirp(low, high, rms, quantity(time, TIME, "a time", example)?)
        }
        ("moves", [stroke, velocity, acceleration, rest]) => Excitation::moves(Moves {
            stroke_m: quantity(stroke, LENGTH, "a stroke", example)?,
            velocity_m_per_s: quantity(velocity, SPEED, "a velocity", example)?,
            acceleration_m_per_s2: quantity(acceleration, ACCELERATION, "an acceleration", example)?,
            rest_s: quantity(rest, TIME, "a time", example)?,
        }),
        _ => return wrong(text, takes, example),
    };
    checked(text, motion, example)
}

fn tones(text: &str) -> Result<Excitation, PlantError> {
    let list = text.split_once(':').map_or("", |(_, list)| list);
    let mut tones = Vec::new();
    for part in list.split(',').map(str::trim) {
        match part.split(':').map(str::trim).collect::<Vec<_>>().as_slice() {
            [frequency, amplitude] => tones.push(tone(frequency, amplitude, TONES)?),
            [frequency, amplitude, phase] => {
                let phase_rad = quantity(phase, ANGLE, "a phase", "tones:0.8Hz:8mm:90deg")? * PI / 180.0;
                tones.push(Tone { phase_rad, ..tone(frequency, amplitude, TONES)? });
            }
            _ => return wrong(part, "each tone takes a frequency and an amplitude, and may take a phase", TONES),
        }
    }
    Ok(Excitation::tones(tones))
}

fn tone(frequency: &str, amplitude: &str, example: &'static str) -> Result<Tone, PlantError> {
    let frequency_hz = quantity(frequency, FREQUENCY, "a frequency", example)?;
    Ok(Tone::new(frequency_hz, quantity(amplitude, LENGTH, "an amplitude", example)?))
}

fn band_and_speed(band: &str, velocity: &str, example: &'static str) -> Result<(f64, f64, f64), PlantError> {
    let (low_hz, high_hz) = range(band, example)?;
    Ok((low_hz, high_hz, quantity(velocity, SPEED, "an rms velocity", example)?))
}

/// `0.5-15Hz`, both limits in Hz.
fn range(text: &str, example: &'static str) -> Result<(f64, f64), PlantError> {
    let Some((low, high)) = text.split_once('-') else {
        return wrong(text, "expected a band of two frequencies joined by a minus sign", example);
    };
    let high_hz = quantity(high, FREQUENCY, "a frequency", example)?;
    let low_hz = match low.trim().parse::<f64>() {
        Ok(plain) => plain,
        Err(_) => quantity(low, FREQUENCY, "a frequency", example)?,
    };
    if low_hz >= high_hz || low_hz.is_nan() {
        return wrong(text, "the first frequency of a band must be the lower one", example);
    }
    Ok((low_hz, high_hz))
}

/// A number with its unit.
fn quantity(text: &str, units: Units, what: &str, example: &'static str) -> Result<f64, PlantError> {
    let text = text.trim();
    let names = || units.iter().map(|unit| unit.0).collect::<Vec<_>>().join(", ");
    // Longest unit first: "mm" also ends in "m".
    let unit = units.iter().filter(|unit| text.ends_with(unit.0)).max_by_key(|unit| unit.0.len());
    let Some(&(name, factor)) = unit else {
        return wrong(text, format!("expected {what} with its unit ({})", names()), example);
    };
    match text[..text.len() - name.len()].trim().parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number * factor),
        _ => wrong(text, format!("{what} needs a number before its unit {name}"), example),
    }
}

/// Turns an out-of-range value into an error that shows the original text.
fn checked(text: &str, motion: Excitation, example: &'static str) -> Result<Excitation, PlantError> {
    match motion.validate() {
        Ok(()) => Ok(motion),
        Err(error) => wrong(text, error.to_string(), example),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_the_manual_shows_is_understood() {
        for text in [SEQUENCE, SINE, TONES, MULTI, RANDOM, CHIRP, MOVES, "hold", "slow", "tones:1Hz:1mm:90deg"] {
            Excitation::parse(text, 0).unwrap();
        }
        assert_eq!(Excitation::parse("sine: 3.2 Hz : 4160um", 0), Ok(Excitation::sine(3.2, 4160.0 * 1e-6)));
        assert_eq!(Excitation::parse("random:0.5-15Hz:20mm/s", 4), Ok(Excitation::preset("random", 4).unwrap()));
        assert_eq!(Excitation::parse("multi:500mHz-15Hz:20mm/s", 4), Ok(Excitation::preset("multi", 4).unwrap()));
        let row = Excitation::parse("mid@20s+hold@500ms;chirp:0.1-20Hz:5mm/s:60s;random@1min", 0).unwrap();
        let starts_s: Vec<f64> = row.segments.iter().map(|segment| segment.start_s).collect();
        assert_eq!(starts_s, [0.0, 20.0, 20.5, 80.5]);
        assert_eq!(row.duration_s(), 140.5);
        assert_eq!(Excitation::parse("sine:1Hz:180deg", 0), Excitation::parse("sine:1Hz:3.141592653589793rad", 0));
        let speed = |text| Excitation::parse(text, 4).unwrap().at(0.7).v_m_per_s;
        let (turns, radians) = (speed("multi:1-9Hz:60rpm"), speed("multi:1-9Hz:6.283185307rad/s"));
        assert!((turns - radians).abs() < 1e-8, "{turns} {radians}");
        assert_eq!(Excitation::parse("sine:1e+0Hz:1mm", 0), Ok(Excitation::sine(1.0, 1e-3)));
    }

    #[test]
    fn errors_name_the_part_and_show_an_example() {
        for (text, part, says) in [
            ("wobble", "wobble", "known: slow"),
            ("mid@20s;wobble", "wobble", "no motion has this name"),
            ("mid;random@20s", "\"mid\"", "add a duration"),
            ("mid+fast", "\"mid\"", "add a duration"),
            ("sine:3.2:4.16mm", "\"3.2\"", "unit (Hz, mHz)"),
            ("sine:3.2Hz:4.16", "\"4.16\"", "unit (mm, um"),
            ("sine:abcHz:4mm", "\"abcHz\"", "number before its unit Hz"),
            ("sine:3.2Hz", "\"sine:3.2Hz\"", "sine:3.2Hz:4.16mm"),
            ("sine:-3Hz:4mm", "sine:-3Hz:4mm", "frequency_hz"),
            ("tones:1Hz:1mm,2Hz", "\"2Hz\"", "each tone"),
            ("tones", "\"tones\"", "tones:0.8Hz"),
            ("random:15-0.5Hz:20mm/s", "15-0.5Hz", "lower"),
            ("random:15Hz:20mm/s", "\"15Hz\"", "band"),
            ("random:0.5-15Hz:20mm", "20mm", "mm/s"),
            ("chirp:1-2Hz:5mm/s", "chirp:1-2Hz:5mm/s", "duration"),
            ("mid@-5s", "\"-5s\"", "duration_s"),
            ("mid@", "\"\"", "a time with its unit"),
            ("mid@20s;;slow", "\"\"", "missing"),
            ("", "\"\"", "missing"),
            ("hold:3s", "hold:3s", "hold@5s"),
            ("moves:1m:1m/s:1m/s2", "moves:1m", "a rest"),
            ("moves:1m:1m/s:1m/s:1s", "\"1m/s\"", "an acceleration"),
            ("moves:0m:1m/s:1m/s2:1s", "moves:0m", "stroke_m"),
        ] {
            let error = Excitation::parse(text, 0).unwrap_err().to_string();
            assert!(error.contains(part) && error.contains(says) && error.contains("for example"), "{text}: {error}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in "[a-z0-9.@:;+,\\-/ µHzms]{0,40}") {
            let _ = Excitation::parse(&text, 0);
        }
    }
}
