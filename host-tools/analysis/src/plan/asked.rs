//! The request for a plan, and the resulting device and limits.

use std::collections::BTreeMap;

use inerter_core::Settings;
use inerter_data::{
    Error,
    export::Source,
    replay::replay_samples,
    settings::{Overrides, validate},
    wants,
};
use inerter_plant::{Excitation, Inerter};
use inerter_wire::EstimatorEvent;

use super::{
    design::{Plan, design},
    error::PlanError,
    expected::Expected,
    limits::Limits,
    observed::{Reach, observed, with_contact},
    predict::predict,
};

/// Advice if the expected device is not stated.
const EXPECTED: &str = "state inertance, viscous and Coulomb friction and the force's noise approximately, or give a recording of an earlier run; \
    `--preset paper` is the paper's device";

/// The request for a plan; omitted values follow from the run, or have defaults.
#[derive(Clone, Debug, Default)]
pub struct Asked {
    /// A run that defines the expected device and the limits.
    pub run: Option<Source>,
    /// Device to start from if there is no run, one of [`Inerter::PRESETS`].
    pub preset: Option<String>,
    /// Parameters of the expected device, which override those of run or preset.
    pub given: BTreeMap<String, f64>,
    /// White noise of the force in one sample, rms \[N\].
    pub force_noise_n: Option<f64>,
    /// Settings of the rig; a run has been opened with them.
    pub overrides: Overrides,
    /// Wanted half widths of intervals, such as `fc to 0.3 N, mt to 0.1 %`. If empty, the motion fills the duration.
    pub wants: String,
    /// A motion whose intervals are predicted, and its seed; `None` to design one.
    pub motion: Option<(String, u64)>,
    /// Displacement of the terminal to either side of its middle \[m\].
    pub stroke_m: Option<f64>,
    /// Its speed \[m/s\].
    pub speed_m_per_s: Option<f64>,
    /// Force on the load cell \[N\].
    pub force_n: Option<f64>,
    /// Length of the motion \[s\].
    pub duration_s: Option<f64>,
    /// Lowest frequency \[Hz\].
    pub lowest_hz: Option<f64>,
    /// Highest frequency \[Hz\].
    pub highest_hz: Option<f64>,
    /// Length of the ramps of a part, from rest and to rest \[s\].
    pub fade_s: Option<f64>,
}

impl Asked {
    /// The motion and its prediction, with the expected device; `progress` is called with the completed fraction.
    pub fn planned<E: From<PlanError> + From<Error>>(&self, progress: impl FnMut(f64)) -> Result<Plan, E> {
        let (expected, known) = match &self.run {
            Some(run) => self.by_run::<E>(run)?,
            None => (self.stated()?, Limits::default()),
        };
        let limits = self.limits(known);
        let wants = match self.wants.as_str() {
            "" => Vec::new(),
            wanted => wants::parse(wanted, expected.settings.machine, expected.own()).map_err(PlanError::from)?,
        };
        Ok(match &self.motion {
            Some((text, seed)) => self.given_motion(expected, limits, text, *seed)?,
            None => design(&expected, limits, &wants, progress)?,
        })
    }

    /// The stated device, on the rig of the settings.
    fn stated(&self) -> Result<Expected, PlanError> {
        let mut device = match &self.preset {
            Some(name) => Inerter::preset(name)?,
            None => {
                let flags = [
                    ("inertance_kg", "--inertance-kg"),
                    ("viscous_n_s_per_m", "--viscous-n-s-per-m"),
                    ("coulomb_n", "--coulomb-n"),
                ];
                if let Some((_, missing)) = flags.into_iter().find(|(name, _)| !self.given.contains_key(*name)) {
                    return Err(PlanError::Unstated { missing, help: EXPECTED });
                }
                Inerter { structure_mass_kg: 0.0, ..Inerter::paper() }
            }
        };
        device.set_all(&self.given)?;
        let overrides = &self.overrides;
        let mut settings = Settings::default();
        overrides.apply(&mut settings)?;
        // Structure mass and contact: a value in the settings that no flag gives is the expected one; conversely,
        // without a setting the device's value becomes the setting.
        let is_stated = |name: &str| self.preset.is_some() || self.given.contains_key(name);
        let set = |name: &str| overrides.get(name).filter(|_| !self.given.contains_key(name));
        if set("structure_mass_kg").is_some() {
            device.structure_mass_kg = settings.structure_mass_kg;
        }
        let stiffness = set("stiffness_n_per_m").filter(|stiffness| *stiffness > 0.0);
        let stiffness = stiffness.or(is_stated("stiffness_n_per_m").then_some(device.stiffness_n_per_m));
        let damping = set("contact_damping_n_s_per_m");
        device = with_contact(device, stiffness, damping.unwrap_or(device.contact_damping_n_s_per_m));
        if overrides.get("structure_mass_kg").is_none() {
            settings.structure_mass_kg = device.structure_mass_kg;
        }
        if let Some(stiffness) = stiffness.filter(|_| overrides.get("stiffness_n_per_m").is_none()) {
            settings.stiffness_n_per_m = stiffness;
        }
        if stiffness.is_some() && damping.is_none() {
            settings.contact_damping_n_s_per_m = device.contact_damping_n_s_per_m;
        }
        validate(&settings)?;
        let missing = PlanError::Unstated { missing: "--force-noise-n", help: EXPECTED };
        let force_noise_n = self.force_noise_n.ok_or(missing)?;
        Ok(Expected { device, settings, force_noise_n })
    }

    /// The device to expect from an earlier run, and the limits that it kept to.
    fn by_run<E: From<PlanError> + From<Error>>(&self, run: &Source) -> Result<(Expected, Limits), E> {
        let mut reach = Reach::new(&run.settings);
        let samples = run.samples()?.inspect(|sample| sample.iter().for_each(|sample| reach.push(sample)));
        let outcome = replay_samples(&run.settings, run.start_s, samples, |_, _: &EstimatorEvent| Ok::<_, Error>(()))?;
        let (mut expected, limits) = observed(&outcome, &run.settings, &reach)?;
        expected.device.set_all(&self.given).map_err(PlanError::from)?;
        expected.force_noise_n = self.force_noise_n.unwrap_or(expected.force_noise_n);
        Ok((expected, limits))
    }

    /// The given limits, which override the known ones.
    fn limits(&self, known: Limits) -> Limits {
        Limits {
            stroke_m: self.stroke_m.unwrap_or(known.stroke_m),
            speed_m_per_s: self.speed_m_per_s.unwrap_or(known.speed_m_per_s),
            force_n: self.force_n.unwrap_or(known.force_n),
            duration_s: self.duration_s.unwrap_or(known.duration_s),
            lowest_hz: self.lowest_hz.unwrap_or(known.lowest_hz),
            highest_hz: self.highest_hz.unwrap_or(known.highest_hz),
            fade_s: self.fade_s.unwrap_or(known.fade_s),
        }
    }

    /// The prediction for a given motion.
    fn given_motion(&self, expected: Expected, limits: Limits, text: &str, seed: u64) -> Result<Plan, PlanError> {
        let motion = Excitation::parse(text, seed).map_err(PlanError::Motion)?;
        let own_s = Some(motion.duration_s()).filter(|own_s| own_s.is_finite());
        let duration_s = self.duration_s.or(own_s).unwrap_or(Limits::default().duration_s);
        // The stroke need not be stated if no motion is fitted to it.
        let stroke_m = if limits.stroke_m.is_finite() { limits.stroke_m } else { 1e3 };
        let checked = Limits { stroke_m, duration_s, ..limits }.checked(&expected)?;
        let motion = motion.lasting(duration_s);
        Ok(Plan {
            prediction: predict(&expected, &motion, duration_s)?,
            expected,
            given: Some(text.into()),
            parts: Vec::new(),
            motion,
            duration_s,
            is_wanted: false,
            wants: Vec::new(),
            limits: checked,
            stated: limits,
            chance: [0.0; 4],
        })
    }
}
