//! The simulated inerter as a file or as a live device.
//!
//! [`Setup`] puts device, motion, instruments and settings together; [`mod@file`] writes a recording or a CSV,
//! [`VirtualDevice`] runs the firmware's app on this machine behind a pseudo-terminal or a TCP port, [`Qemu`] runs the
//! firmware image itself.

pub mod bench;
mod clock;
mod device;
pub mod file;
mod port;
mod qemu;

use std::collections::BTreeMap;

use inerter_core::{RawSample, Settings};
use inerter_plant::{Excitation, Hands, Parameters, Plant, PlantError, Sample, Sensors, Simulation};
use miette::Diagnostic;

pub use bench::Bench;
pub use device::{Endpoint, VirtualDevice};
pub use qemu::{END_OF_SAMPLES, Qemu, find_image, qemu_version, sample_bytes};

use crate::{
    error::exit,
    settings::{Overrides, SettingsInputError, validate},
};

/// Why a simulation cannot be set up.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum SimulateError {
    /// Device, motion or instruments cannot be.
    #[error("the simulation cannot be set up: {source}")]
    #[diagnostic(code(inerter::simulate::setup), help("`inerter simulate --help` lists every parameter and motion"))]
    Setup { source: PlantError },

    /// No such preset.
    #[error("there is no preset `{name}`")]
    #[diagnostic(code(inerter::simulate::preset), help("the presets are: {known}"))]
    Preset { name: String, known: String },

    /// The settings say another rate than the instruments sample at.
    #[error("the setting sample_rate_hz = {set_hz} contradicts --sample-rate-hz {rate_hz}")]
    #[diagnostic(
        code(inerter::simulate::rate),
        help("leave one of them out: the settings' rate is that of the simulated instruments")
    )]
    Rate { set_hz: f64, rate_hz: f64 },

    /// A change of the device is not written as it must be.
    #[error("--change `{text}` is not NAME=VALUE")]
    #[diagnostic(
        code(inerter::simulate::change),
        help("name a parameter of the device and its new value, for example --change inertance_kg=150")
    )]
    Change { text: String },

    /// The pseudo-terminal or TCP port cannot be opened.
    #[error("{what} cannot be opened: {source}")]
    #[diagnostic(code(inerter::simulate::endpoint), help("choose another port number, or 0 for any free one"))]
    Endpoint { what: String, source: std::io::Error },

    /// The output's name says no format.
    #[error("{path} has neither the ending .mcap nor .csv")]
    #[diagnostic(code(inerter::simulate::format), help("end the name with .mcap for a recording or with .csv"))]
    Format { path: String },

    /// Hands cannot do this.
    #[error("`{line}` is nothing that hands can do")]
    #[diagnostic(
        code(inerter::simulate::hand),
        help(
            "write `load NEWTONS`, `mass KG`, `move METRES`, `turn REVOLUTIONS` or `shake MOTION`, such as shake \
            random@20s"
        )
    )]
    Hand { line: String },

    /// The image was not found.
    #[error("the firmware image for QEMU was not found")]
    #[diagnostic(
        code(inerter::simulate::image),
        help(
            "build it in the source tree with `cargo xtask build-firmware`, or give it with --image FILE; without \
            --qemu no image is needed"
        )
    )]
    NoImage,

    /// QEMU cannot be started.
    #[error("qemu-system-arm cannot be started: {source}")]
    #[diagnostic(
        code(inerter::simulate::qemu),
        help("install it (Debian: sudo apt-get install qemu-system-arm); without --qemu it is not needed")
    )]
    NoQemu { source: std::io::Error },

    /// QEMU ended on its own.
    #[error("QEMU ended on its own ({status}): {message}")]
    #[diagnostic(
        code(inerter::simulate::qemu_ended),
        help("is the image one for `-M netduinoplus2`, and the port free?")
    )]
    QemuEnded { status: String, message: String },
}

impl From<PlantError> for SimulateError {
    fn from(source: PlantError) -> Self {
        Self::Setup { source }
    }
}

impl SimulateError {
    /// The code that the program ends with.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Setup { .. } | Self::Preset { .. } | Self::Rate { .. } | Self::Change { .. } | Self::Hand { .. } => {
                exit::SETTINGS
            }
            Self::Format { .. } => exit::USAGE,
            Self::Endpoint { .. } | Self::NoImage | Self::NoQemu { .. } | Self::QemuEnded { .. } => exit::NO_DEVICE,
        }
    }
}

/// Everything that defines a simulated run.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The device.
    pub parameters: Parameters,
    /// The instruments.
    pub sensors: Sensors,
    /// The motion, as it was written.
    pub excite: String,
    /// The motion.
    pub excitation: Excitation,
    /// What the device becomes, and when \[s\].
    pub later: Option<(f64, Parameters)>,
    /// Load on the load cell beside the motion \[N\].
    pub load_n: f64,
    /// Duration \[s\]; `None` without end.
    pub duration_s: Option<f64>,
    /// Settings of the estimator, as known from calibration: scales, structure mass, contact and skew are the true ones.
    pub settings: Settings,
}

impl Setup {
    /// Checks everything; `overrides` go over the settings that follow from the true device and instruments.
    ///
    /// A duration that is not given is that of the motion, when it has one.
    pub fn new(
        parameters: Parameters,
        sensors: Sensors,
        excite: &str,
        duration_s: Option<f64>,
        overrides: &Overrides,
    ) -> Result<Self, crate::error::Error> {
        let excitation = Excitation::parse(excite, sensors.seed).map_err(SimulateError::from)?;
        let own = Some(excitation.duration_s()).filter(|duration| duration.is_finite());
        let mut settings = calibrated(&parameters, &sensors)?;
        overrides.apply(&mut settings)?;
        validate(&settings)?;
        let excite = excite.into();
        let duration_s = duration_s.or(own);
        let setup = Self { parameters, sensors, excite, excitation, later: None, load_n: 0.0, duration_s, settings };
        // Built once for its checks.
        setup.simulation()?;
        Ok(setup)
    }

    /// The same device becoming another at a time \[s\]: what is calibrated stays that of the first.
    pub fn changing(self, at_s: f64, after: Parameters) -> Result<Self, SimulateError> {
        let setup = Self { later: Some((at_s, after)), ..self };
        setup.simulation()?;
        Ok(setup)
    }

    /// The samples, with the truth beside them, up to the duration.
    pub fn samples(&self) -> Result<Samples, SimulateError> {
        Ok(Samples { simulation: self.simulation()?, duration_s: self.duration_s.unwrap_or(f64::INFINITY) })
    }

    fn simulation(&self) -> Result<Simulation, SimulateError> {
        let plant = Plant::changing(self.parameters, self.later.into_iter().collect(), self.excitation.clone())?;
        let mut simulation = Simulation::of(plant, self.sensors)?;
        simulation.handle(Hands { load_n: self.load_n, moved_m: 0.0 });
        Ok(simulation)
    }

    /// What is true, by name, for the recording's metadata.
    pub fn truth(&self) -> BTreeMap<String, String> {
        let device = Parameters::TABLE.iter().zip(self.parameters.values());
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
}

impl Setup {
    /// What of the device changes, by name, and to what.
    pub fn changes(&self) -> impl Iterator<Item = (&'static str, f64)> + use<> {
        let after = self.later.map_or(self.parameters, |(_, after)| after);
        let values = self.parameters.values().into_iter().zip(after.values());
        let named = Parameters::TABLE.iter().map(|field| field.name).zip(values);
        named.filter_map(|(name, (before, after))| (before != after).then_some((name, after)))
    }
}

/// Samples of a set-up, up to its duration.
pub struct Samples {
    simulation: Simulation,
    duration_s: f64,
}

impl Iterator for Samples {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        self.simulation.next().filter(|sample| sample.t_s < self.duration_s)
    }
}

/// Samples whose rate a host can change.
trait Sampled: Iterator<Item = Sample> + Send {
    /// What is sampled.
    fn simulation(&mut self) -> &mut Simulation;
}

impl Sampled for Samples {
    fn simulation(&mut self) -> &mut Simulation {
        &mut self.simulation
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

/// Settings of a device that was calibrated without error.
pub fn calibrated(parameters: &Parameters, sensors: &Sensors) -> Result<Settings, SettingsInputError> {
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

/// Instruments as on a bench: 1 N rms of noise, the encoder anywhere in a count.
///
/// With oversampling the codes are so much coarser that the sum's scale stays.
pub fn bench_sensors() -> Sensors {
    Sensors { force_noise_n: 1.0, encoder_phase_count: 0.37, seed: 1, ..Sensors::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_changes_is_told_and_moves_as_before_until_then() {
        let sensors = Sensors { force_noise_n: 0.0, ..bench_sensors() };
        let setup = Setup::new(Parameters::paper(), sensors, "mid@4s", None, &Overrides::default()).unwrap();
        let after = Parameters { inertance_kg: 150.0, ..Parameters::paper() };
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
