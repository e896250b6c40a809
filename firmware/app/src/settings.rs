//! Settings in use: the saved ones, or the board's defaults.

use crate::board::{Identity, Store, StoreError};
use crate::logging::log;
use inerter_core::{Active, Settings, SettingsError};
use inerter_wire::{Fault, Reading};

/// The settings to begin with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InUse {
    /// In SI.
    pub settings: Settings,
    /// The settings of a device that was never configured.
    pub defaults: Settings,
    /// What was wrong with the saved settings, if the defaults are in use because of it.
    pub fault: Option<Fault>,
}

/// The saved settings if there are any, they are valid and the board accepts them; otherwise `defaults`, which must be
/// valid and accepted; and their quantised form.
///
/// Saved settings that this firmware does not know are ignored; missing ones come from `defaults`. The store is not
/// changed.
pub async fn load_settings(
    store: &mut impl Store,
    identity: &Identity<'_>,
    defaults: &Settings,
) -> Result<(InUse, Active), SettingsError> {
    let check =
        |settings: &Settings| settings.validate().and_then(|active| (identity.accepts)(settings).map(|()| active));
    let active = check(defaults)?;
    let fault = match store.load().await {
        Ok(None) => None,
        Ok(Some(values)) => {
            let Reading { settings, impossible, .. } = values.read(defaults);
            // All or nothing: a mixture of two calibrations is not a calibration.
            if impossible == 0
                && let Ok(active) = check(&settings)
            {
                return Ok((InUse { settings, defaults: *defaults, fault: None }, active));
            }
            Some(Fault::SavedSettings)
        }
        Err(StoreError::Unreadable) => Some(Fault::Store),
        Err(StoreError::Newer) => Some(Fault::NewerSettings),
        Err(StoreError::Foreign) => Some(Fault::ForeignSettings),
    };
    if fault.is_some() {
        log!(warn, "saved settings unusable, defaults in use");
    }
    Ok((InUse { settings: *defaults, defaults: *defaults, fault }, active))
}

/// `defaults`, whatever is saved: the saved settings may be why a device keeps failing at startup.
pub fn leave_settings_alone(defaults: &Settings) -> Result<(InUse, Active), SettingsError> {
    log!(warn, "the device did not start with the saved settings, defaults in use");
    let in_use = InUse { settings: *defaults, defaults: *defaults, fault: Some(Fault::SettingsLeft) };
    Ok((in_use, defaults.validate()?))
}

/// Whether a change from `before` to `after` concerns the source of samples, which applies it while halted.
pub(crate) fn concerns_source(before: &Settings, after: &Settings) -> bool {
    let concerned = |settings: &Settings| (settings.sample_rate_hz, settings.front_end, settings.oversampling);
    concerned(before) != concerned(after)
}

/// Whether a change from `before` to `after` makes what the estimator has gathered meaningless.
///
/// Every change does, except one of uncertainties, averaging time or publish rate: the estimator's sums are in
/// quantised units, which include the tare and the scales.
pub(crate) fn needs_reset(before: &Settings, after: &Settings) -> bool {
    let unaffected = Settings {
        structure_mass_u95_kg: after.structure_mass_u95_kg,
        stiffness_u95_n_per_m: after.stiffness_u95_n_per_m,
        skew_u95_s: after.skew_u95_s,
        force_gain_u95: after.force_gain_u95,
        lead_u95: after.lead_u95,
        timebase_u95: after.timebase_u95,
        memory_s: after.memory_s,
        publish_rate_hz: after.publish_rate_hz,
        // Only affects names and units on display.
        machine: after.machine,
        ..*before
    };
    unaffected.values() != after.values()
}
