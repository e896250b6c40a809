//! Settings as numbered values.
//!
//! A setting's number is its place in [`Settings::TABLE`], where new ones are added at the end. So a reader meets three
//! cases: numbers it knows, numbers that are missing (the sender is older), and numbers beyond its table (the sender is
//! newer).

use crate::{Refusal, SettingFault};
use heapless::Vec;
use inerter_core::{Settings, SettingsError};
use serde::{Deserialize, Serialize};

/// Settings that one message can carry.
pub const MAX_SETTINGS: usize = 48;

const _: () = assert!(Settings::COUNT <= MAX_SETTINGS, "all settings go into one message");

/// One setting.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SettingValue {
    /// Place in [`Settings::TABLE`].
    pub number: u8,
    /// Value in the unit of the setting's name.
    pub value: f64,
}

/// Settings in transit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SettingsValues(pub Vec<SettingValue, MAX_SETTINGS>);

/// Settings as read from a device or a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// Every setting; a missing one has the value of the given base.
    pub settings: Settings,
    /// Settings that this reader does not know, because the device is newer; left out.
    pub unknown: usize,
    /// Known settings with a value that this reader considers impossible; left out.
    pub impossible: usize,
    /// Settings that the device did not send, because it is older; taken from the base.
    pub missing: usize,
}

impl From<&Settings> for SettingsValues {
    fn from(settings: &Settings) -> Self {
        Self((0u8..).zip(settings.values()).map(|(number, value)| SettingValue { number, value }).collect())
    }
}

impl SettingsValues {
    /// Only the settings in which `wanted` differs from `present`.
    pub fn difference(wanted: &Settings, present: &Settings) -> Self {
        let pairs = (0u8..).zip(wanted.values()).zip(present.values());
        Self(
            pairs
                .filter(|((_, wanted), present)| wanted.to_bits() != present.to_bits())
                .map(|((number, value), _)| SettingValue { number, value })
                .collect(),
        )
    }

    /// Adds one setting by its name in [`Settings::TABLE`]; the value is checked by itself.
    pub fn push_by_name(&mut self, name: &str, value: f64) -> Result<(), SettingsError> {
        let (number, info) =
            (0u8..).zip(Settings::TABLE).find(|(_, info)| info.name == name).ok_or(SettingsError::Unknown)?;
        info.check(value)?;
        self.0.retain(|entry| entry.number != number);
        self.0.push(SettingValue { number, value }).map_err(|_| SettingsError::Unknown)
    }

    /// For a host: settings from a device or recording of any age, applied to `base`.
    ///
    /// Unknown numbers and impossible values of known ones, as later firmware may send, are left out and counted.
    pub fn read(&self, base: &Settings) -> Reading {
        let mut settings = *base;
        let (mut unknown, mut impossible, mut seen) = (0, 0, 0u64);
        for entry in &self.0 {
            match settings.set(usize::from(entry.number), entry.value) {
                Ok(()) => seen |= 1 << entry.number,
                Err(SettingsError::Unknown) => unknown += 1,
                Err(_) => {
                    impossible += 1;
                    seen |= 1 << entry.number;
                }
            }
        }
        let missing = Settings::COUNT.saturating_sub(seen.count_ones() as usize);
        Reading { settings, unknown, impossible, missing }
    }

    /// For a device: the requested settings, applied to those in use.
    ///
    /// Unknown numbers, repeated numbers and impossible values are refused. [`Settings::validate`] must still accept
    /// the result.
    pub fn write(&self, present: &Settings) -> Result<Settings, Refusal> {
        let mut settings = *present;
        let mut seen = 0u64;
        for entry in &self.0 {
            let number = entry.number;
            settings.set(usize::from(number), entry.value).map_err(|error| Refusal::of_setting(&error, number))?;
            if seen & (1 << number) != 0 {
                return Err(Refusal::BadSetting { number, fault: SettingFault::Repeated });
            }
            seen |= 1 << number;
        }
        Ok(settings)
    }
}

const _: () = assert!(MAX_SETTINGS <= u64::BITS as usize, "one bit per setting in `seen`");
