//! A simulated run: device, motion, instruments and settings together.

use std::collections::BTreeMap;

use inerter_core::{RawSample, Settings};
use inerter_data::{
    calibration::Calibration,
    full_scale::Peaks,
    settings::{Overrides, SettingsInputError, validate},
};
use inerter_plant::{Excitation, Hands, Inerter, Plant, Sample, Sensors, Simulation};

use crate::error::SimulateError;

/// Length of the part of a motion that is searched for its peaks \[s\], and maximum number of points.
const LOOKED_AT_S: f64 = 100.0;
const MOST_LOOKS: f64 = 20_000.0;
/// Factor by which the device may be faster than its terminal.
const SWINGS: f64 = 3.0;

/// Everything that defines a simulated run.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The device.
    pub parameters: Inerter,
    /// The instruments.
    pub sensors: Sensors,
    /// The motion as text.
    pub excite: String,
    /// The motion.
    pub excitation: Excitation,
    /// A later device, and its time \[s\].
    pub later: Option<(f64, Inerter)>,
    /// Load on the load cell in addition to the motion \[N\].
    pub load_n: f64,
    /// Duration \[s\]; `None` without end.
    pub duration_s: Option<f64>,
    /// Settings of the estimator, as known from calibration: scales, structure mass, contact and skew have their true
    /// values.
    pub settings: Settings,
    /// When and how the rig was calibrated, as given.
    pub calibration: Option<Calibration>,
}

impl Setup {
    /// Checks everything; `overrides` take precedence over the settings derived from the true device and instruments.
    ///
    /// The default duration is that of the motion, if it has one.
    pub fn new(
        parameters: Inerter,
        sensors: Sensors,
        excite: &str,
        duration_s: Option<f64>,
        overrides: &Overrides,
    ) -> Result<Self, SimulateError> {
        let excitation = Excitation::parse(excite, sensors.seed)?;
        Self::moved(parameters, sensors, excite.into(), excitation, duration_s, overrides)
    }

    /// The same with an existing motion; `excite` is its name.
    pub fn moved(
        parameters: Inerter,
        sensors: Sensors,
        excite: String,
        excitation: Excitation,
        duration_s: Option<f64>,
        overrides: &Overrides,
    ) -> Result<Self, SimulateError> {
        let mut settings = calibrated(&parameters, &sensors)?;
        peaks(&excitation).hold(&mut settings, overrides)?;
        overrides.apply(&mut settings)?;
        validate(&settings)?;
        let setup = Self {
            parameters,
            sensors,
            excite,
            later: None,
            load_n: 0.0,
            duration_s: duration_s.or(Some(excitation.duration_s()).filter(|own_s| own_s.is_finite())),
            excitation,
            settings,
            calibration: overrides.calibration().cloned(),
        };
        // Constructed once, only to check it.
        setup.simulation()?;
        Ok(setup)
    }

    /// The same device, which becomes another one at a time \[s\]: the calibration remains that of the first.
    pub fn changing(self, at_s: f64, after: Inerter) -> Result<Self, SimulateError> {
        let setup = Self { later: Some((at_s, after)), ..self };
        setup.simulation()?;
        Ok(setup)
    }

    pub(crate) fn simulation(&self) -> Result<Simulation, SimulateError> {
        let plant = Plant::changing(self.parameters, self.later.into_iter().collect(), self.excitation.clone())?;
        let mut simulation = Simulation::of(plant, self.sensors)?;
        simulation.hands = Hands { load_n: self.load_n, moved_m: 0.0 };
        Ok(simulation)
    }

    /// The true parameters, by name, for the recording's metadata.
    pub fn truth(&self) -> BTreeMap<String, String> {
        let device = Inerter::TABLE.iter().zip(self.parameters.values());
        let sensors = Sensors::TABLE.iter().zip(self.sensors.values());
        let mut truth: BTreeMap<String, String> =
            device.chain(sensors).map(|(field, value)| (field.name.to_string(), format!("{value:?}"))).collect();
        truth.insert("excite".into(), self.excite.clone());
        truth.insert("seed".into(), self.sensors.seed.to_string());
        if self.load_n != 0.0 {
            truth.insert("load_n".into(), format!("{:?}", self.load_n));
        }
        if let Some((at_s, _)) = self.later {
            truth.insert("change_at_s".into(), format!("{at_s:?}"));
            truth.extend(self.changes().map(|(name, value)| (format!("changed_{name}"), format!("{value:?}"))));
        }
        truth
    }

    /// The parameters of the device that change, by name, and their new values.
    pub fn changes(&self) -> impl Iterator<Item = (&'static str, f64)> + use<> {
        let after = self.later.map_or(self.parameters, |(_, after)| after);
        let values = self.parameters.values().into_iter().zip(after.values());
        let named = Inerter::TABLE.iter().map(|field| field.name).zip(values);
        named.filter_map(|(name, (before, after))| (before != after).then_some((name, after)))
    }
}

/// The sample as a board hands it over.
pub fn raw(sample: &Sample) -> RawSample {
    RawSample {
        index: sample.index,
        position_count: sample.position_count,
        force_code: sample.force_code,
        terminal_code: sample.terminal_code,
    }
}

/// Peaks of a motion, with a margin for a device that moves farther than its terminal.
fn peaks(excitation: &Excitation) -> Peaks {
    let duration_s = excitation.duration_s().min(LOOKED_AT_S);
    // Eight points per period of the highest tone.
    let step_s = (0.125 / excitation.highest_hz().max(1.0)).max(duration_s / MOST_LOOKS);
    let mut peaks = Peaks::default();
    for look in 0..(duration_s / step_s) as u32 {
        let point = excitation.at(f64::from(look) * step_s);
        peaks.velocity = peaks.velocity.max(SWINGS * point.v_m_per_s.abs());
        peaks.acceleration = peaks.acceleration.max(SWINGS * point.a_m_per_s2.abs());
    }
    peaks
}

/// Settings of a device that was calibrated without error.
pub fn calibrated(parameters: &Inerter, sensors: &Sensors) -> Result<Settings, SettingsInputError> {
    let mut settings = Settings::default();
    let conversions = sensors.oversampling;
    let (least, greatest) = (settings.force_min_code, settings.force_max_code);
    for (name, value) in [
        ("sample_rate_hz", sensors.sample_rate_hz),
        ("metres_per_count", sensors.metres_per_count),
        ("oversampling", conversions),
        ("newtons_per_code", sensors.newtons_per_sample_code()),
        ("force_zero_code", sensors.force_zero_code * conversions),
        ("force_min_code", (sensors.force_min_code * conversions).max(least)),
        ("force_max_code", (sensors.force_max_code * conversions).min(greatest)),
        ("metres_per_terminal_code", sensors.metres_per_terminal_code),
        ("structure_mass_kg", parameters.structure_mass_kg),
        ("stiffness_n_per_m", parameters.stiffness_n_per_m),
        ("contact_damping_n_s_per_m", parameters.contact_damping_n_s_per_m),
        ("skew_s", sensors.delay_s),
    ] {
        settings
            .set_by_name(name, value)
            .map_err(|source| SettingsInputError::Value { origin: "the simulated device's settings".into(), source })?;
    }
    Ok(settings)
}

/// Instruments as on a bench: 1 N rms of noise, and an arbitrary encoder phase.
///
/// With oversampling the codes are coarser by that factor, so that the sum's scale stays.
pub fn bench_sensors() -> Sensors {
    Sensors { force_noise_n: 1.0, encoder_phase_count: 0.37, seed: 1, ..Sensors::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_changes_is_told_and_moves_as_before_until_then() {
        let sensors = Sensors { force_noise_n: 0.0, ..bench_sensors() };
        let setup = Setup::new(Inerter::paper(), sensors, "mid@4s", None, &Overrides::default()).unwrap();
        let after = Inerter { inertance_kg: 150.0, ..Inerter::paper() };
        let changing = setup.clone().changing(2.0, after).unwrap();
        assert_eq!(changing.settings, setup.settings);
        let truth = changing.truth();
        assert_eq!((truth["change_at_s"].as_str(), truth["changed_inertance_kg"].as_str()), ("2.0", "150.0"));
        assert!(!setup.truth().contains_key("change_at_s") && setup.changes().next().is_none());
        let pairs = || setup.samples().unwrap().zip(changing.samples().unwrap());
        assert!(pairs().filter(|(a, _)| a.t_s <= 2.0).all(|(a, b)| a.position_count == b.position_count));
        let (greatest, half) = pairs()
            .filter(|(a, _)| a.t_s > 2.5)
            .fold((0, 0), |(greatest, half), (a, b)| (a.force_code.abs().max(greatest), b.force_code.abs().max(half)));
        assert!(f64::from(half) < 0.6 * f64::from(greatest), "{half} against {greatest}");
        assert!(setup.changing(f64::NAN, after).is_err());
    }
}
