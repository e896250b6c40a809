//! Stiffness and damping of the contact as settings: once measured with a terminal displacement sensor, they allow the
//! backlash to be found from the force alone.

use inerter_core::constants::UNSTATED_STIFFNESS_U95;
use inerter_core::{BacklashSize, Detail, Interval, Parameter, Reason, Route, Settings};
use miette::Diagnostic;

/// Why there is no stiffness value.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error, Diagnostic)]
pub enum ContactError {
    /// There is no sensor for the terminal's displacement.
    #[error("a stiffness needs the terminal's own displacement, and the settings declare no sensor for it")]
    #[diagnostic(
        code(inerter::contact::no_sensor),
        help(
            "set terminal_sensor=1 and metres_per_terminal_code for the third channel (docs/HARDWARE.md), or give a CSV with \
             a column terminal_m"
        )
    )]
    NoSensor,
    /// The motion cannot identify it.
    #[error("this motion cannot identify the contact's stiffness: {}", why(*reason))]
    #[diagnostic(
        code(inerter::contact::not_shown),
        help("shake harder and faster, from 3 Hz up, for 20 s: the force must press on both flanks in turn")
    )]
    NotShown {
        /// The reason, if known.
        reason: Option<Reason>,
    },
}

fn why(reason: Option<Reason>) -> &'static str {
    match reason {
        Some(Reason::ForceNeverReverses) => "the force never reverses",
        Some(Reason::TooFewReversals) => "neither flank is touched for long enough",
        _ => "the deflection is too small compared with the sensor's noise, or only the sign of the force changes",
    }
}

/// The contact's parameters from the terminal sensor.
#[derive(Clone, Copy, Debug)]
pub struct ContactLaw {
    /// Stiffness \[N/m\].
    pub stiffness: Parameter,
    /// Damping \[N s/m\]; a slow motion cannot identify it.
    pub damping: Parameter,
}

impl ContactLaw {
    /// The result of a run.
    pub fn of(detail: &Detail, settings: &Settings) -> Result<Self, ContactError> {
        if !settings.terminal_sensor {
            return Err(ContactError::NoSensor);
        }
        let (stiffness, damping) = (detail.stiffness_n_per_m, detail.contact_damping_n_s_per_m);
        if stiffness.usable().is_none() {
            let reason = match detail.backlash.size {
                BacklashSize::NotIdentifiable(reason) if detail.backlash.route == Route::Terminal => Some(reason),
                _ => None,
            };
            return Err(ContactError::NotShown { reason });
        }
        Ok(Self { stiffness, damping })
    }

    /// Whether it improves on the stiffness in use: there is none, it lies outside the interval, or the new interval is
    /// the smaller one.
    pub fn is_better_than(&self, settings: &Settings) -> bool {
        let Settings { stiffness_n_per_m: used, stiffness_u95_n_per_m: used_u95, .. } = *settings;
        // Compare as it would be stored, so that an adopted value is not adopted again.
        let Interval { value, u95 } = self.stiffness.fitted();
        let [found, u95] = [value, u95].map(|value| borne(u95, value));
        let used_u95 = if used_u95 > 0.0 { used_u95 } else { UNSTATED_STIFFNESS_U95 * used };
        used <= 0.0 || (found - used).abs() > u95 || u95 < used_u95
    }

    /// The settings with the values found, to the digits that the intervals justify. A damping that was not identified
    /// stays unchanged.
    pub fn adopted_by(&self, settings: &Settings) -> Settings {
        let Interval { value, u95 } = self.stiffness.fitted();
        let damping = self.damping.usable().map(|damping| borne(damping.u95, damping.value));
        Settings {
            stiffness_n_per_m: borne(u95, value),
            stiffness_u95_n_per_m: borne(u95, u95),
            contact_damping_n_s_per_m: damping.unwrap_or(settings.contact_damping_n_s_per_m),
            ..*settings
        }
    }
}

/// A number with as many decimals as two digits of the interval need.
fn borne(u95: f32, value: f32) -> f64 {
    // Integer powers of ten divide exactly, and print without extra digits.
    let places = 1 - f64::from(u95).log10().floor() as i32;
    let scale = 10_f64.powi(places.abs());
    let value = f64::from(value);
    if places > 0 { (value * scale).round() / scale } else { (value / scale).round() * scale }
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_core::Backlash;

    fn parameter(value: f32, u95: f32) -> Parameter {
        Parameter::Ok(Interval { value, u95 })
    }

    fn sensing() -> Settings {
        Settings { terminal_sensor: true, ..Settings::default() }
    }

    #[test]
    fn digits_are_those_of_the_interval() {
        let contact = ContactLaw { stiffness: parameter(2_098_765.4, 10_754.0), damping: parameter(1203.456, 4.56) };
        let settings = contact.adopted_by(&sensing());
        assert_eq!(settings.stiffness_n_per_m, 2_099_000.0);
        assert_eq!(settings.stiffness_u95_n_per_m, 11_000.0);
        assert_eq!(settings.contact_damping_n_s_per_m, 1203.5);
        let slow = ContactLaw { damping: Parameter::default(), ..contact };
        let kept = Settings { contact_damping_n_s_per_m: 900.0, ..sensing() };
        assert_eq!(slow.adopted_by(&kept).contact_damping_n_s_per_m, 900.0);
    }

    #[test]
    fn better_is_new_or_other_or_narrower() {
        let contact = ContactLaw { stiffness: parameter(2.1e6, 1e4), damping: parameter(1200.0, 5.0) };
        let with = |stiffness_n_per_m, stiffness_u95_n_per_m| {
            contact.is_better_than(&Settings { stiffness_n_per_m, stiffness_u95_n_per_m, ..sensing() })
        };
        assert!(with(0.0, 0.0) && with(2.15e6, 1e3) && with(2.105e6, 2e4) && with(2.1e6, 0.0));
        assert!(!with(2.105e6, 5e3));
    }

    #[test]
    fn what_is_missing_is_named() {
        let detail = Detail::default();
        assert_eq!(ContactLaw::of(&detail, &Settings::default()).unwrap_err(), ContactError::NoSensor);
        let size = BacklashSize::NotIdentifiable(Reason::ForceNeverReverses);
        let backlash = Backlash { size, route: Route::Terminal, ..Backlash::default() };
        let refused = |backlash| ContactLaw::of(&Detail { backlash, ..detail }, &sensing()).unwrap_err();
        let found = refused(backlash);
        assert!(found.to_string().ends_with("the force never reverses"), "{found}");
        // A reason given for the force's route does not apply to the sensor.
        let of_force = Backlash { route: Route::Force, ..backlash };
        assert_eq!(refused(of_force), ContactError::NotShown { reason: None });
    }
}
