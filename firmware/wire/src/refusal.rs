//! Why a device refuses a request.

use core::fmt;
use inerter_core::{Settings, SettingsError};
use serde::{Deserialize, Serialize};

/// Why a request was refused; nothing was changed. New ones go at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// This device does not know the command or cannot do it.
    Unsupported,
    /// Not now: another operation is in progress.
    Busy,
    /// The injected batch does not fit; none of it was taken.
    QueueFull {
        /// Samples taken since the first `Inject`, wrapping at 2^32.
        accepted: u32,
        /// Samples that would fit now.
        free: u16,
    },
    /// The value of a setting.
    BadSetting {
        /// Number of the setting.
        number: u8,
        /// What is wrong with it.
        fault: SettingFault,
    },
    /// The injected batch is not decodable; none of it was taken.
    BadSamples,
    /// `InjectEnd` without an `Inject` before.
    NotInjecting,
    /// The settings store failed.
    Store,
    /// No samples come in, so there is nothing to measure.
    NoSamples,
    /// The sampler does not start with these settings.
    Source,
    /// No settings are saved.
    NothingSaved,
    /// What is saved cannot be read: damaged, another program's, or a newer firmware's.
    SavedUnreadable,
    /// The flash was written so often recently that it would wear out.
    Worn {
        /// Time until it may be written again, in seconds.
        wait_s: u16,
    },
    /// Nothing is played: `Play::Begin` has not come, or the outputs were released since, for example because nothing
    /// came for too long.
    NotPlaying,
}

/// What is wrong with a setting's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SettingFault {
    /// This device has no setting of this number.
    Unknown,
    /// The value is NaN or infinite.
    NotFinite,
    /// The value lies outside the setting's range.
    OutOfRange,
    /// The value must be a whole number.
    NotWhole,
    /// The value must not be zero.
    Zero,
    /// The value contradicts the setting of this number.
    Conflict(u8),
    /// The setting occurs twice in one request.
    Repeated,
    /// The value is possible, but not on this board.
    NotOffered,
}

impl Refusal {
    /// The refusal that names the setting of `error`, or `number` if the error names none.
    pub fn of_setting(error: &SettingsError, number: u8) -> Self {
        let place = |name| Settings::find(name).and_then(|place| u8::try_from(place).ok());
        let (field, fault) = match *error {
            SettingsError::Unknown => (None, SettingFault::Unknown),
            SettingsError::NotFinite { field } => (Some(field), SettingFault::NotFinite),
            SettingsError::OutOfRange { field, .. } => (Some(field), SettingFault::OutOfRange),
            SettingsError::NotWhole { field, .. } => (Some(field), SettingFault::NotWhole),
            SettingsError::Zero { field } => (Some(field), SettingFault::Zero),
            SettingsError::NotOffered { field, .. } => (Some(field), SettingFault::NotOffered),
            SettingsError::Conflict { field, other, .. } => {
                (Some(field), place(other).map_or(SettingFault::OutOfRange, SettingFault::Conflict))
            }
        };
        Self::BadSetting { number: field.and_then(place).unwrap_or(number), fault }
    }
}

/// The setting's name, for a person.
struct SettingName(u8);

impl fmt::Display for SettingName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match Settings::TABLE.get(usize::from(self.0)) {
            Some(info) => f.write_str(info.name),
            None => write!(f, "setting number {}", self.0),
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Unsupported => {
                f.write_str("this device cannot do that: see its capabilities, or update its firmware")
            }
            Self::Busy => f.write_str("the device is busy: try again"),
            Self::QueueFull { free, .. } => write!(f, "the device has room for {free} samples: send fewer"),
            Self::BadSetting { number, fault } => {
                write!(f, "{}: ", SettingName(number))?;
                let info = Settings::TABLE.get(usize::from(number));
                match (fault, info) {
                    (SettingFault::Unknown, _) => f.write_str("the device has no such setting: update its firmware"),
                    (SettingFault::NotFinite, _) => f.write_str("the value is not a finite number"),
                    (SettingFault::OutOfRange, Some(info)) => {
                        write!(f, "the value is outside {} to {}", info.min, info.max)
                    }
                    (SettingFault::OutOfRange, None) => f.write_str("the value is outside its range"),
                    (SettingFault::NotWhole, _) => f.write_str("the value must be a whole number"),
                    (SettingFault::Zero, _) => f.write_str("the value must not be zero"),
                    (SettingFault::Conflict(other), _) => {
                        write!(f, "the value contradicts {}: change one of the two", SettingName(other))
                    }
                    (SettingFault::Repeated, _) => f.write_str("given twice: give it once"),
                    (SettingFault::NotOffered, _) => {
                        f.write_str("the board does not offer this value: docs/HARDWARE.md lists those that it does")
                    }
                }
            }
            Self::BadSamples => {
                f.write_str("the samples arrived in a form that the device cannot read: update one of the two ends")
            }
            Self::NotInjecting => f.write_str("nothing was injected: send samples first"),
            Self::Store => {
                f.write_str("the device cannot write its settings store: the settings hold until it restarts")
            }
            Self::NoSamples => f.write_str("no samples come in: start the sampler first"),
            Self::Source => f.write_str("the sampler does not start: check the front end and its wiring"),
            Self::NothingSaved => f.write_str("the device has saved no settings: save those in use first"),
            Self::SavedUnreadable => f.write_str(
                "the device cannot read what it has saved: update its firmware, or save settings to replace it",
            ),
            Self::Worn { wait_s } => {
                write!(f, "too many saves in a short time would wear out the device's flash: try again in {wait_s} s")
            }
            Self::NotPlaying => f.write_str("the device is not playing: begin first, and send the rest without delay"),
        }
    }
}

impl core::error::Error for Refusal {}
