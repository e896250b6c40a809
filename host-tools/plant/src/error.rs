//! Why a simulation was rejected, naming the field or the part of the text.

use std::fmt;

/// Why a simulation was rejected, naming the field or the part of the text.
#[derive(Clone, Debug, PartialEq)]
pub enum PlantError {
    /// No field has this name.
    UnknownField {
        /// The name that was given.
        name: String,
    },
    /// No device has this name.
    UnknownPreset {
        /// The name that was given.
        name: String,
        /// The known names.
        known: &'static [&'static str],
    },
    /// The value is NaN or infinite.
    NotFinite {
        /// The field's name.
        field: &'static str,
    },
    /// The value lies outside its range.
    OutOfRange {
        /// The field's name.
        field: &'static str,
        /// The rejected value.
        value: f64,
        /// Minimum accepted value.
        min: f64,
        /// Maximum accepted value.
        max: f64,
    },
    /// The value must be a whole number.
    NotWhole {
        /// The field's name.
        field: &'static str,
        /// The rejected value.
        value: f64,
    },
    /// Two fields contradict each other.
    Conflict {
        /// The field's name.
        field: &'static str,
        /// The other one.
        other: &'static str,
        /// The condition between them.
        rule: &'static str,
    },
    /// The device is so stiff, damped or light that the simulation cannot follow its fastest rate.
    TooFast {
        /// The field that causes this.
        field: &'static str,
        /// The device's fastest rate \[rad/s\].
        rate_rad_per_s: f64,
        /// Maximum accepted rate \[rad/s\].
        max_rad_per_s: f64,
    },
    /// A motion's text cannot be parsed.
    Motion {
        /// The part that is wrong.
        part: String,
        /// What is wrong with it.
        problem: String,
        /// An example of a valid text.
        example: &'static str,
    },
}

impl fmt::Display for PlantError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownField { name } => write!(f, "{name}: no field of the simulation has this name"),
            Self::UnknownPreset { name, known } => {
                write!(f, "there is no preset `{name}`; the presets are: {}", known.join(", "))
            }
            Self::NotFinite { field } => write!(f, "{field}: the value is not a finite number"),
            Self::OutOfRange { field, value, min, max } => {
                write!(f, "{field}: {value} is outside {min} to {max}")
            }
            Self::NotWhole { field, value } => write!(f, "{field}: {value} is not a whole number"),
            Self::Conflict { field, other, rule } => write!(f, "{field} and {other}: {rule}"),
            Self::TooFast { field, rate_rad_per_s, max_rad_per_s } => write!(
                f,
                "{field}: with this inertance the device would respond at {rate_rad_per_s:.3e} rad/s, \
                 the simulation follows at most {max_rad_per_s:.0e}; lower it or raise inertance_kg"
            ),
            Self::Motion { part, problem, example } => {
                write!(f, "motion, at \"{part}\": {problem}; for example \"{example}\"")
            }
        }
    }
}

impl std::error::Error for PlantError {}
