//! What is reported about a file that was written.

use inerter_core::Machine;
use inerter_data::names::unit;
use serde::Serialize;

/// A file that was written.
#[derive(Debug, Serialize)]
pub struct Written {
    /// `csv` or `wav`.
    pub format: &'static str,
    pub file: String,
    /// Points per second \[Hz\].
    pub rate_hz: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    /// Displacement of full scale \[m\].
    pub full_scale_m: Option<f64>,
}

impl Written {
    /// One line for a person.
    pub fn text(&self, machine: Machine) -> String {
        let Self { file, rate_hz, .. } = self;
        match self.full_scale_m {
            Some(metres) => format!("{file}: {rate_hz} Hz, 24 bits, full scale is {metres:?} {}", unit(machine, "m")),
            None => format!("{file}: {rate_hz} points a second; `inerter simulate --motion` tries it out"),
        }
    }
}
