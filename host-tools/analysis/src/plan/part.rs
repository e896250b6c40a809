//! Parts of a motion: tones that ramp up from rest together and down again.

use inerter_plant::{Excitation, Tone};
use serde_json::{Value, json};

/// One part of a motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Its tones.
    pub tones: Vec<Tone>,
    /// Its length \[s\].
    pub duration_s: f64,
    /// Length of each of its two ramps \[s\].
    pub fade_s: f64,
}

impl Part {
    /// Its motion.
    pub fn motion(&self) -> Excitation {
        Excitation::tones(self.tones.clone()).with_ramp(self.fade_s).lasting(self.duration_s)
    }

    /// In JSON.
    pub fn json(&self) -> Value {
        let tones = self.tones.iter().map(|tone| {
            json!({ "frequency_hz": tone.frequency_hz, "amplitude_m": tone.amplitude_m, "phase_rad": tone.phase_rad })
        });
        json!({ "duration_s": self.duration_s, "fade_s": self.fade_s, "tones": tones.collect::<Vec<_>>() })
    }

    /// Multiplies the amplitudes by a factor.
    pub(super) fn scale(&mut self, factor: f64) {
        self.tones.iter_mut().for_each(|tone| tone.amplitude_m *= factor);
    }
}

/// Parts in sequence.
pub fn in_a_row(parts: &[Part]) -> Excitation {
    Excitation::sequence(parts.iter().map(Part::motion))
}

/// Total duration of parts in sequence \[s\].
pub fn duration_s(parts: &[Part]) -> f64 {
    parts.iter().map(|part| part.duration_s).sum()
}
