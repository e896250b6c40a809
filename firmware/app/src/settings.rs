//! Settings in use: what was saved, or the board's defaults.

use crate::board::Store;
use crate::logging::log;
use inerter_core::{Active, Settings, SettingsError};
use inerter_wire::Fault;

/// The settings to begin with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InUse {
    /// In SI.
    pub settings: Settings,
    /// What was wrong with the saved ones, if these are the defaults because of it.
    pub fault: Option<Fault>,
}

/// The saved settings when there are any and they are valid, else `defaults`, which must be valid; and their quantised
/// form.
///
/// Saved settings that this firmware does not know are left out; those that are missing come from `defaults`.
pub async fn load_settings(store: &mut impl Store, defaults: &Settings) -> Result<(InUse, Active), SettingsError> {
    let active = defaults.validate()?;
    let (saved, mut fault) = match store.load().await {
        Ok(None) => (None, None),
        Ok(Some(values)) => match values.read(defaults) {
            Ok(reading) => (Some(reading.settings), None),
            Err(_) => (None, Some(Fault::SavedSettings)),
        },
        Err(_) => (None, Some(Fault::Store)),
    };
    if let Some(settings) = saved {
        match settings.validate() {
            Ok(active) => return Ok((InUse { settings, fault: None }, active)),
            Err(_) => fault = Some(Fault::SavedSettings),
        }
    }
    if fault.is_some() {
        log!(warn, "saved settings unusable, defaults in use");
    }
    Ok((InUse { settings: *defaults, fault }, active))
}

/// Whether a change from `before` to `after` makes what the estimator has gathered meaningless.
///
/// All of it does but intervals, averaging time and publish rate: what was gathered is in quantised units, and the
/// tare and the scales are in them.
pub(crate) fn needs_reset(before: &Settings, after: &Settings) -> bool {
    let unaffected = Settings {
        structure_mass_u95_kg: after.structure_mass_u95_kg,
        skew_u95_s: after.skew_u95_s,
        force_gain_u95: after.force_gain_u95,
        lead_u95: after.lead_u95,
        timebase_u95: after.timebase_u95,
        memory_s: after.memory_s,
        publish_rate_hz: after.publish_rate_hz,
        ..*before
    };
    unaffected != *after
}
