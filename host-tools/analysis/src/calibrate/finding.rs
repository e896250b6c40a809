//! What a step of the calibration has found: for a person, for a script, and as settings.

use inerter_core::{Settings, SettingsError};
use serde::Serialize;
use serde_json::{Map, Value};

use super::statistics::{rounded, rounded_up};

/// A step of the calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// Diagnosis of the force channel at rest.
    LoadCell,
    /// Code at zero force.
    Zero,
    /// Scale of the force.
    Force,
    /// Scale of the position.
    Encoder,
    /// Whether force and position have the same positive direction.
    Direction,
    /// Delay of the force.
    Skew,
    /// Sample clock.
    Timebase,
}

/// Severity of a remark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Worth knowing.
    Note,
    /// Works, but could be better.
    Doubtful,
    /// Must not be used like this.
    Bad,
}

/// A remark on what was found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Remark {
    /// Its severity.
    pub level: Level,
    /// A name for scripts.
    pub code: &'static str,
    /// What it means and what to do.
    pub text: String,
}

/// What a step has found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The step.
    pub step: Step,
    /// Figures by name, the unit in the name; `null` when unknown.
    pub measured: Map<String, Value>,
    /// Resulting settings, by name.
    pub values: Map<String, Value>,
    /// Their uncertainties by the same names, if any.
    pub u95: Map<String, Value>,
    /// Remarks on the finding.
    pub remarks: Vec<Remark>,
    /// The same for a person.
    #[serde(skip)]
    pub text: Vec<String>,
}

impl Finding {
    /// An empty finding.
    pub fn new(step: Step) -> Self {
        let (measured, values, u95) = Default::default();
        Self { step, measured, values, u95, remarks: Vec::new(), text: Vec::new() }
    }

    /// Adds a figure, rounded to six digits.
    pub fn measure(&mut self, name: &str, value: f64) {
        let value = if value.is_finite() { Value::from(rounded(value, 6)) } else { Value::Null };
        self.measured.insert(name.into(), value);
    }

    /// Adds several figures.
    pub fn measure_all(&mut self, figures: impl IntoIterator<Item = (&'static str, f64)>) {
        figures.into_iter().for_each(|(name, value)| self.measure(name, value));
    }

    /// Adds a resulting setting.
    pub fn set(&mut self, name: &str, value: f64) {
        self.values.insert(name.into(), Value::from(value));
    }

    /// Adds a resulting setting with its uncertainty.
    pub fn set_with(&mut self, name: &str, value: f64, u95: f64) {
        self.set(name, value);
        self.u95.insert(name.into(), Value::from(rounded_up(u95)));
    }

    /// Adds a line for a person.
    pub fn say(&mut self, text: impl Into<String>) {
        self.text.push(text.into());
    }

    /// Adds a remark.
    pub fn remark(&mut self, level: Level, code: &'static str, text: impl Into<String>) {
        self.remarks.push(Remark { level, code, text: text.into() });
    }

    /// Whether it may be used.
    pub fn is_good(&self) -> bool {
        self.problems() == 0
    }

    /// How many remarks forbid its use.
    pub fn problems(&self) -> usize {
        self.remarks.iter().filter(|remark| remark.level == Level::Bad).count()
    }

    /// Whether it has resulting settings.
    pub fn has_settings(&self) -> bool {
        !self.values.is_empty()
    }

    /// The settings with the finding's values.
    pub fn adopted_by(&self, settings: &Settings) -> Result<Settings, SettingsError> {
        let mut settings = *settings;
        for (name, value) in &self.values {
            settings.set_by_name(name, value.as_f64().unwrap_or(f64::NAN))?;
        }
        settings.validate()?;
        Ok(settings)
    }
}
