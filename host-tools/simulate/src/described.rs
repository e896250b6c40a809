//! A simulated run as the user describes it, by flags or by keywords.

use std::{collections::BTreeMap, path::PathBuf};

use inerter_data::{
    csv::motion::{self, Displacements},
    settings::Overrides,
};
use inerter_plant::{Excitation, Inerter, PlantError, Sensors};

use crate::{
    error::SimulateError,
    setup::{Setup, bench_sensors},
};

/// Duration of a run that must end, if neither its description nor its motion sets one \[s\].
const USUAL_S: f64 = 20.0;

/// A simulated run as described, before defaults are filled in.
#[derive(Clone, Debug)]
pub struct Described {
    /// Device to start from, one of [`Inerter::PRESETS`].
    pub preset: String,
    /// Parameters of the device and of its instruments, which override those of the preset.
    pub given: BTreeMap<String, f64>,
    /// Motion of the terminal.
    pub motion: Motion,
    /// Seed of motion and noise.
    pub seed: u64,
    /// Duration \[s\]; the motion's by default.
    pub duration_s: Option<f64>,
    /// Load on the load cell in addition to the motion \[N\].
    pub load_n: f64,
    /// When the device changes \[s\], and its parameters from then on.
    pub change: Option<(f64, BTreeMap<String, f64>)>,
    /// Settings that override those of a perfect calibration.
    pub overrides: Overrides,
}

/// A motion as given.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// By its name, as [`Excitation::parse`] accepts it.
    Named(String),
    /// Point by point, in a CSV.
    File(PathBuf),
    /// Point by point.
    Points(Displacements),
}

impl Default for Described {
    /// The paper's device in random motion.
    fn default() -> Self {
        Self {
            preset: "paper".into(),
            given: BTreeMap::new(),
            motion: Motion::Named("random".into()),
            seed: 1,
            duration_s: None,
            load_n: 0.0,
            change: None,
            overrides: Overrides::default(),
        }
    }
}

impl Described {
    /// The run; endless if neither it nor its motion has a duration.
    pub fn setup(&self) -> Result<Setup, SimulateError> {
        let mut parameters = Inerter::preset(&self.preset)?;
        let sensors = self.instruments(&mut parameters)?;
        let (excite, excitation) = match &self.motion {
            Motion::Named(name) => (name.clone(), Excitation::parse(name, self.seed)),
            Motion::File(path) => {
                let points = motion::read(path).map_err(inerter_data::Error::from)?;
                (format!("points of {}", path.display()), table(&points))
            }
            Motion::Points(points) => ("points".into(), table(points)),
        };
        let setup = Setup::moved(parameters, sensors, excite, excitation?, self.duration_s, &self.overrides)?;
        let setup = Setup { load_n: self.load_n, ..setup };
        let Some((at_s, values)) = &self.change else { return Ok(setup) };
        let mut after = parameters;
        after.set_all(values)?;
        setup.changing(*at_s, after)
    }

    /// The run with an end: after 20 s if no duration is given.
    pub fn ending(&self) -> Result<Setup, SimulateError> {
        let setup = self.setup()?;
        Ok(Setup { duration_s: setup.duration_s.or(Some(USUAL_S)), ..setup })
    }

    /// Applies the given values to device and instruments.
    fn instruments(&self, parameters: &mut Inerter) -> Result<Sensors, SimulateError> {
        let mut sensors = Sensors { seed: self.seed, ..bench_sensors() };
        for (name, value) in &self.given {
            let is_of_device = Inerter::TABLE.iter().any(|field| field.name == *name);
            if is_of_device { parameters.set(name, *value) } else { sensors.set(name, *value) }?;
        }
        let is_given = |name: &str| self.given.contains_key(name);
        if let Some(set_hz) = self.overrides.get("sample_rate_hz") {
            let rate_hz = sensors.sample_rate_hz;
            if is_given("sample_rate_hz") && set_hz != rate_hz {
                return Err(SimulateError::Rate { set_hz, rate_hz });
            }
            sensors.sample_rate_hz = set_hz;
        }
        if !is_given("newtons_per_code") {
            // A converter with codes coarser by this factor: scale and range of the sum stay.
            sensors.newtons_per_code *= sensors.oversampling;
        }
        for (name, limit) in
            [("force_min_code", &mut sensors.force_min_code), ("force_max_code", &mut sensors.force_max_code)]
        {
            if !is_given(name) {
                *limit = (*limit / sensors.oversampling).trunc();
            }
        }
        Ok(sensors)
    }
}

fn table(points: &Displacements) -> Result<Excitation, PlantError> {
    Excitation::table(points.period_s, &points.terminal_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_out_has_its_usual_value() {
        let setup = Described::default().setup().unwrap();
        assert_eq!((setup.parameters, setup.duration_s), (Inerter::paper(), None));
        assert_eq!(Described::default().ending().unwrap().duration_s, Some(USUAL_S));
        let mid = Described { motion: Motion::Named("mid@5s".into()), ..Described::default() };
        assert_eq!(mid.ending().unwrap().duration_s, Some(5.0));
    }

    #[test]
    fn what_is_given_goes_over_the_preset_and_what_follows_from_it() {
        let given = |pairs: &[(&str, f64)]| -> Described {
            let given = pairs.iter().map(|(name, value)| (name.to_string(), *value)).collect();
            Described { given, ..Described::default() }
        };
        let setup = given(&[("coulomb_n", 7.0), ("oversampling", 16.0)]).setup().unwrap();
        let usual = Described::default().setup().unwrap();
        assert_eq!(setup.parameters.coulomb_n, 7.0);
        assert_eq!(setup.sensors.newtons_per_code, 16.0 * usual.sensors.newtons_per_code);
        assert_eq!(setup.settings.newtons_per_code, usual.settings.newtons_per_code);
        let stated = given(&[("newtons_per_code", 0.5), ("oversampling", 16.0)]).setup().unwrap();
        assert_eq!(stated.sensors.newtons_per_code, 0.5);
        assert!(matches!(given(&[("mass", 1.0)]).setup(), Err(SimulateError::Setup { .. })));
        let mut contradicting = given(&[("sample_rate_hz", 2000.0)]);
        contradicting.overrides.set("sample_rate_hz", 1000.0, "test").unwrap();
        assert!(matches!(contradicting.setup(), Err(SimulateError::Rate { .. })));
    }
}
