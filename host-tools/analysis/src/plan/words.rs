//! Motions and their intervals, as text.

use inerter_core::{Machine, Source};
use inerter_data::{
    names::{description, parameter, unit},
    words::{listed, rounded_text, three_digits},
};
use inerter_plant::Tone;

use super::{limits::Limits, part::Part, peaks::Peaks};
use crate::law::ends;

/// An amplitude in mm, or in mrad for a rotary machine: `±7.08 mm`.
fn stroke_text(machine: Machine, metres: f64) -> String {
    format!("±{} {}", three_digits(1e3 * metres), unit(machine, "mm"))
}

/// A part of a motion: `2.18 Hz at ±7.08 mm`.
pub fn part_text(machine: Machine, part: &Part) -> String {
    match part.tones.as_slice() {
        [Tone { frequency_hz, amplitude_m, .. }] => {
            format!("{} Hz at {}", three_digits(*frequency_hz), stroke_text(machine, *amplitude_m))
        }
        tones => {
            let (low_hz, high_hz) = ends(tones.iter().map(|tone| tone.frequency_hz));
            let (least, most) = ends(tones.iter().map(|tone| tone.amplitude_m));
            format!(
                "{} tones from {} to {} Hz, ±{} to {}",
                tones.len(),
                three_digits(low_hz),
                three_digits(high_hz),
                three_digits(1e3 * least),
                stroke_text(machine, most).trim_start_matches('±')
            )
        }
    }
}

/// What a motion demands of a rig: `±7.08 mm, 0.0970 m/s and 597 N`.
pub fn peaks_text(machine: Machine, peaks: &Peaks) -> String {
    reach_text(machine, peaks.stroke_m, peaks.speed_m_per_s, peaks.force_n)
}

/// The limits of a rig, without those that are not stated.
pub fn limits_text(machine: Machine, limits: &Limits) -> String {
    reach_text(machine, limits.stroke_m, limits.speed_m_per_s, limits.force_n)
}

fn reach_text(machine: Machine, stroke_m: f64, speed_m_per_s: f64, force_n: f64) -> String {
    let speed = speed_m_per_s.is_finite().then(|| format!("{} {}", three_digits(speed_m_per_s), unit(machine, "m/s")));
    let force = force_n.is_finite().then(|| format!("{} {}", three_digits(force_n), unit(machine, "N")));
    let stroke = stroke_text(machine, stroke_m);
    listed(&[Some(stroke), speed, force].into_iter().flatten().collect::<Vec<_>>())
}

/// A parameter with an interval: `cf to ± 1.2 N s/m`.
pub fn interval_of(machine: Machine, place: usize, u95: f64) -> String {
    let field = parameter(machine, place);
    format!("{} to ± {} {}", field.symbol, digits(u95), field.unit)
}

/// The two digits of a half width that matter, however small it is.
pub(super) fn digits(u95: f64) -> String {
    if u95 < 1e-4 { format!("{u95:.1e}") } else { rounded_text(u95, u95) }
}

/// The main source of an interval, and how to reduce it.
pub fn source_words(machine: Machine, source: Source) -> String {
    let words = match source {
        Source::Noise => "the force's noise and the encoder's steps: a longer or stronger motion",
        Source::Encoder => {
            "the encoder's steps, which the motion repeats or which are a large part of its acceleration: a finer encoder, or more samples per second"
        }
        Source::Skew => "the delay between force and position: `inerter calibrate skew`",
        Source::Gain => "the calibration of the force: `inerter calibrate force`, and force_gain_u95",
        Source::Lead => "the travel per count: `inerter calibrate encoder`, and lead_u95",
        Source::Timebase => "the clock: `inerter calibrate timebase`, and timebase_u95",
        Source::Structure => "the structure's mass: weigh it, and set structure_mass_u95_kg",
        Source::Stiffness => "the contact's stiffness: `inerter calibrate stiffness`, and stiffness_u95_n_per_m",
        Source::Model => "how well the run itself tests the law near rest: a longer motion, at several speeds",
    };
    description(machine, words)
}
