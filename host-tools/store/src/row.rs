//! The row of a run in the table `runs`.

use inerter_core::{LawStatus, Machine};
use inerter_data::{
    limits::{Doubts, Judged, Limits, Measured, NAMES, field},
    names::beside,
    words::code,
};
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::place::Place;

/// Columns that hold objects: objects in JSON, text in the table.
pub const OBJECTS: [&str; 2] = ["settings", "truth"];

/// Maximum length of a row as JSON \[KB\]: ours have some kilobytes, and what is parsed takes many times as much
/// memory.
pub(crate) const LONGEST_ROW_KB: usize = 256;
/// The same \[bytes\].
pub(crate) const LONGEST_ROW: usize = LONGEST_ROW_KB << 10;
/// Maximum number of columns of a row: ours have about 50. In a CSV each row has a cell for each column of all rows.
pub(crate) const MOST_COLUMNS: usize = 512;

/// A run of a store: its columns by name.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    pub(crate) place: Place,
    pub(crate) values: Map<String, Value>,
}

impl Row {
    /// The run's place.
    pub fn place(&self) -> &Place {
        &self.place
    }

    /// SHA-256 of the recording: 64 hexadecimal digits.
    pub fn name(&self) -> &str {
        self.place.name()
    }

    /// The device, as in the folder names.
    pub fn device(&self) -> &str {
        &self.place.device
    }

    /// Day of the recording in UTC: `2026-01-31`. For a simulation it is 1970-01-01.
    pub fn date(&self) -> &str {
        &self.place.date
    }

    /// A column, if known; `run`, `device` and `date` are columns too.
    pub fn get(&self, column: &str) -> Option<Value> {
        match column {
            "run" => Some(json!(self.name())),
            "device" => Some(json!(self.device())),
            "date" => Some(json!(self.date())),
            column => self.values.get(column).filter(|value| !value.is_null()).cloned(),
        }
    }

    /// A number, if known.
    pub fn number(&self, column: &str) -> Option<f64> {
        self.values.get(column)?.as_f64()
    }

    /// A text, if known.
    pub fn text(&self, column: &str) -> Option<&str> {
        self.values.get(column)?.as_str()
    }

    /// Its machine kind.
    pub fn machine(&self) -> Machine {
        if self.text("machine") == Some("rotary") { Machine::Rotary } else { Machine::Linear }
    }

    /// Its verdicts on limits: the same as a replay of its recording with its own settings.
    pub fn within(&self, limits: &Limits) -> Vec<Judged> {
        let doubts = self.doubts();
        limits.judge(|place| {
            let field = field(self.machine(), NAMES.get(place).copied().unwrap_or_default());
            let (value, u95) = (self.number(field.path), self.number(&beside(field, "_u95")));
            Measured { found: value.zip(u95).map(|(value, u95)| (value as f32, u95 as f32)), doubt: doubts.of(place) }
        })
    }

    /// Why its values prove nothing, if there is a reason.
    fn doubts(&self) -> Doubts {
        let Some(wrong) = self.number("wrong_samples") else {
            return Doubts::because("it was added by a version that did not count wrong samples");
        };
        let law = [LawStatus::Holds, LawStatus::Broken].into_iter().find(|law| self.text("law") == Some(&*code(law)));
        let misfit = self.number("law_ratio").zip(self.number("law_limit"));
        let is_beyond = misfit.is_some_and(|(ratio, limit)| ratio > limit);
        let changed = self.number("changes").is_some_and(|changes| changes > 0.0);
        Doubts::new(changed, wrong > 0.0, law.unwrap_or(LawStatus::Unknown), is_beyond)
    }

    /// Names of all columns.
    pub fn columns(&self) -> impl Iterator<Item = &str> {
        let own = self.values.keys().map(String::as_str).filter(|name| !["run", "device", "date"].contains(name));
        ["run", "device", "date"].into_iter().chain(own)
    }
}

impl Serialize for Row {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.columns().map(|name| (name, self.get(name).unwrap_or_default())))
    }
}
