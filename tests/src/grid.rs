//! The accuracy grid: six motions, several seeds, three rigs; estimates against the true values.

use crate::{linear::Cholesky, sums::gram};
use inerter_core::{
    Active, Estimate, Interval, Output, Parameter, Parameters, Published, RawSample, Settings, SettingsError, State,
};
use inerter_plant::{Excitation, Inerter, Motion as Screw, Sensors, Simulation};
pub use inerter_simulate::raw;
use std::thread;

/// Errors in setting up a run.
pub type Error = Box<dyn std::error::Error + Send + Sync>;

/// A result with such an error.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// One motion of the grid.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Name of the plant's preset.
    pub name: &'static str,
    /// Length of a run \[s\].
    pub duration_s: f64,
    /// Goals for bias and sigma at 1 kHz and 1 N, in the order of [`NAMES`].
    pub goals: [(f64, f64); 3],
    /// Goals for the time from the start of motion until mt stays within 0.1 %, cf within 5 N s/m and fc within 1 N;
    /// `None` means never.
    pub settling_goals_s: [Option<f64>; 3],
}

/// Time in which the shaker starts a motion from rest \[s\], including the transient that this excites.
const LEAD_IN_S: f64 = 1.0;
/// Memory of the second estimator of a run \[s\], short enough that it forgets within the run.
const SHORT_MEMORY_S: f64 = 4.0;

impl Motion {
    /// Whether the motion is for the slow bank, whose band ends below the device's resonance.
    pub fn is_slow(&self) -> bool {
        self.name == "slow"
    }

    /// Length of the kernels of the motion's bank \[s\]: four boxes.
    pub fn kernel_s(&self) -> f64 {
        if self.is_slow() { 0.256 } else { 0.064 }
    }
}

/// The parameters of the grid.
pub const NAMES: [&str; 3] = ["mt kg", "cf N s/m", "fc N"];

/// The motions, with their goals from the design.
pub const MOTIONS: [Motion; 6] = [
    Motion {
        name: "slow",
        duration_s: 80.0,
        goals: [(1.5, 3.0), (2.0, 3.0), (0.02, 0.015)],
        settling_goals_s: [None, Some(50.0), Some(6.0)],
    },
    Motion {
        name: "mid",
        duration_s: 20.0,
        goals: [(0.03, 0.03), (0.8, 2.0), (0.1, 0.15)],
        settling_goals_s: [Some(0.8), Some(1.3), Some(0.8)],
    },
    Motion {
        name: "fast",
        duration_s: 20.0,
        goals: [(0.005, 0.003), (1.5, 3.0), (0.2, 0.5)],
        settling_goals_s: [Some(0.65), Some(40.0), Some(22.0)],
    },
    Motion {
        name: "multi",
        duration_s: 20.0,
        goals: [(0.01, 0.01), (3.0, 2.0), (0.1, 0.1)],
        settling_goals_s: [Some(0.7), Some(11.0), Some(1.0)],
    },
    Motion {
        name: "random",
        duration_s: 20.0,
        goals: [(0.005, 0.003), (0.3, 0.4), (0.05, 0.05)],
        settling_goals_s: [Some(0.65), Some(1.3), Some(1.0)],
    },
    Motion {
        name: "two",
        duration_s: 20.0,
        goals: [(0.03, 0.04), (0.5, 1.6), (0.05, 0.1)],
        settling_goals_s: [Some(0.9), Some(1.3), Some(0.9)],
    },
];

/// The motion of this name.
///
/// # Panics
/// If the grid has none.
pub fn motion(name: &str) -> &'static Motion {
    MOTIONS.iter().find(|motion| motion.name == name).expect("a motion of the grid")
}

/// Instruments of one rig of the grid.
#[derive(Clone, Copy, Debug)]
pub struct Instruments {
    /// Name in the table.
    pub name: &'static str,
    /// Samples per second \[Hz\].
    pub sample_rate_hz: f64,
    /// White force noise of one sample \[N\].
    pub force_noise_n: f64,
}

/// The rigs.
pub const RIGS: [Instruments; 3] = [
    Instruments { name: "1 kHz, 1 N", sample_rate_hz: 1000.0, force_noise_n: 1.0 },
    Instruments { name: "1 kHz, 5 N", sample_rate_hz: 1000.0, force_noise_n: 5.0 },
    Instruments { name: "4 kHz, 1 N", sample_rate_hz: 4000.0, force_noise_n: 1.0 },
];

/// The first rig with a sampling clock that is 10 ppm faster than the shaker's; the settings state this rate. No motion
/// repeats sample by sample, and the encoder's error does not repeat either.
pub const TWO_CLOCKS: Instruments =
    Instruments { name: "1 kHz, 1 N, two clocks", sample_rate_hz: 1000.01, force_noise_n: 1.0 };

/// Devices on variants of these instruments, whose predicted and stated intervals are compared with the errors: name,
/// device and instruments.
pub fn benches(sensors: Sensors) -> [(&'static str, Inerter, Sensors); 6] {
    let paper = Inerter::paper();
    let light = Inerter { inertance_kg: 95.0, viscous_n_s_per_m: 80.0, coulomb_n: 12.0, ..paper };
    [
        ("1 kHz, 1 N, 2.44 um", paper, sensors),
        ("5 N", paper, Sensors { force_noise_n: 5.0, ..sensors }),
        ("4 kHz", paper, Sensors { sample_rate_hz: 4000.0, ..sensors }),
        ("0.5 um", paper, Sensors { metres_per_count: 0.5e-6, ..sensors }),
        ("20 um", paper, Sensors { metres_per_count: 20e-6, ..sensors }),
        ("95 kg, 80 N s/m, 12 N", light, sensors),
    ]
}

/// The device's true parameters.
pub fn truth(device: &Inerter) -> [f64; 3] {
    [device.inertance_kg, device.viscous_n_s_per_m, device.coulomb_n]
}

/// Settings of a device that was calibrated without error against this plant and these instruments.
///
/// # Panics
/// If the plant or an instrument is beyond the range of a setting.
pub fn calibrated(device: &Inerter, sensors: &Sensors) -> Settings {
    inerter_simulate::calibrated(device, sensors).expect("instruments within the settings' ranges")
}

/// The published estimates of one run, and the last one.
#[derive(Clone, Debug)]
pub struct Run {
    /// Times \[s\] and estimates.
    pub published: Vec<(f64, Estimate)>,
    /// Times and estimates with a short memory.
    pub forgetful: Vec<(f64, Estimate)>,
    /// The estimate at the end.
    pub last: Estimate,
}

/// The first rig: 1 kHz, 1 N of noise, 2.44 um per count, an offset of 3 N.
pub fn sensors() -> Sensors {
    Sensors { force_noise_n: 1.0, force_offset_n: 3.0, ..Sensors::default() }
}

/// The same instruments for one run: each seed has its own noise and its own phase within an encoder count.
pub fn seeded(sensors: Sensors, seed: u64) -> Sensors {
    Sensors { encoder_phase_count: (seed as f64 * 0.618) % 1.0, seed, ..sensors }
}

/// Instruments of this rig.
pub fn instruments(rig: &Instruments, seed: u64) -> Sensors {
    let Instruments { sample_rate_hz, force_noise_n, .. } = *rig;
    seeded(Sensors { sample_rate_hz, force_noise_n, ..sensors() }, seed)
}

/// A device in a motion of the plant's notation; the sensors' seed is also that of the motion.
pub fn shaken(device: &Inerter, motion: &str, sensors: Sensors) -> Result<Simulation> {
    Ok(Simulation::new(*device, Excitation::parse(motion, sensors.seed)?, sensors)?)
}

/// The motion as measured by this rig's instruments.
pub fn simulation(device: &Inerter, motion: &Motion, rig: &Instruments, seed: u64) -> Result<Simulation> {
    shaken(device, motion.name, instruments(rig, seed))
}

/// The estimator: settings and state.
pub struct Estimator {
    /// The settings.
    pub active: Active,
    /// The state.
    pub state: Box<State>,
}

impl Estimator {
    /// Before the first sample.
    pub fn new(settings: &Settings) -> Result<Self, SettingsError> {
        let active = settings.validate()?;
        Ok(Self { state: Box::new(State::new(&active)), active })
    }

    /// Takes a sample.
    pub fn step(&mut self, sample: &RawSample) -> Output {
        self.active.step(&mut self.state, sample)
    }

    /// What it publishes now.
    pub fn publish(&self) -> Published {
        self.active.publish(&self.state)
    }
}

/// What the estimator publishes after these samples.
pub fn published(settings: &Settings, samples: impl IntoIterator<Item = RawSample>) -> Result<Published> {
    let mut estimator = Estimator::new(settings)?;
    for sample in samples {
        estimator.step(&sample);
    }
    Ok(estimator.publish())
}

/// One run for each of these, such as seeds, in two threads: first the odd places, then the even ones.
pub fn each<T, R: Send>(
    all: impl Iterator<Item = T> + Clone + Sync,
    run: impl Fn(T) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    let part = |skipped| all.clone().skip(skipped).step_by(2).map(&run).collect::<Result<Vec<R>>>();
    thread::scope(|scope| {
        let even = scope.spawn(|| part(1));
        let mut runs = part(0)?;
        runs.extend(even.join().map_err(|_| "a run panicked")??);
        Ok(runs)
    })
}

/// Simulates a device and records its estimates. The intervals include no calibration error, because the simulated rig
/// has none.
pub fn run(device: &Inerter, motion: &Motion, rig: &Instruments, seed: u64) -> Result<Run> {
    let simulation = simulation(device, motion, rig, seed)?;
    let settings = Settings {
        force_gain_u95: 0.0,
        lead_u95: 0.0,
        timebase_u95: 0.0,
        publish_rate_hz: 10.0,
        memory_s: 100.0,
        ..calibrated(device, simulation.sensors())
    };
    let mut estimator = Estimator::new(&settings)?;
    let mut short = Estimator::new(&Settings { memory_s: SHORT_MEMORY_S, ..settings })?;
    let (mut published, mut forgetful) = (Vec::new(), Vec::new());
    for sample in simulation.lasting(motion.duration_s) {
        let raw = raw(&sample);
        published.extend(estimator.step(&raw).estimate().map(|estimate| (sample.t_s, estimate)));
        forgetful.extend(short.step(&raw).estimate().map(|estimate| (sample.t_s, estimate)));
    }
    Ok(Run { published, forgetful, last: estimator.publish().estimate })
}

/// The smallest sigma of any unbiased estimator that knows the motion exactly, with this rig's force noise (Cramer and
/// Rao): over all samples in which the screw truly slips, with no sticking within `clearance_s` before or after.
///
/// `None` if these samples do not determine the parameters. For the slow bank, the motion is taken without the
/// transients of its breakaways.
pub fn least_sigma(
    device: &Inerter,
    motion: &Motion,
    rig: &Instruments,
    seed: u64,
    clearance_s: f64,
) -> Result<Option<[f64; 3]>> {
    let truths: Vec<_> = simulation(device, motion, rig, seed)?
        .lasting(motion.duration_s)
        .map(|sample| sample.truth)
        .filter(|truth| !motion.is_slow() || truth.t_s > LEAD_IN_S)
        .collect();
    let stuck: Vec<f64> = truths.iter().filter(|truth| truth.motion == Screw::Stuck).map(|truth| truth.t_s).collect();
    let clear = |t_s: f64| {
        // The last before and the next.
        let around = stuck.partition_point(|stuck| *stuck < t_s).saturating_sub(1);
        stuck.iter().skip(around).take(2).all(|stuck| (stuck - t_s).abs() > clearance_s)
    };
    let rows = truths.iter().filter(|truth| clear(truth.t_s)).map(|truth| {
        let (a, v) = if motion.is_slow() {
            (truth.a1_m_per_s2, truth.v1_m_per_s)
        } else {
            (truth.a2_m_per_s2, truth.v2_m_per_s)
        };
        [a, v, v.signum(), 1.0]
    });
    Ok(sigmas(rows).map(|sigmas| sigmas.map(|sigma| rig.force_noise_n * sigma)))
}

/// Sigma of mt, cf and fc from these rows of the law's regressors in white noise of unit variance; `None` if the rows
/// do not determine them.
pub fn sigmas(rows: impl Iterator<Item = [f64; 4]>) -> Option<[f64; 3]> {
    let [mt, cf, fc, _] = Cholesky::of(&gram(rows), 1e-14)?.inverse_diagonal().map(f64::sqrt);
    Some([mt, cf, fc])
}

/// The three parameters of the grid.
pub fn three(parameters: &Parameters) -> [Parameter; 3] {
    [parameters.inertance_kg, parameters.viscous_n_s_per_m, parameters.coulomb_n]
}

/// All parameters, in the order of the law.
pub fn four(parameters: &Parameters) -> [Parameter; 4] {
    let [mt, cf, fc] = three(parameters);
    [mt, cf, fc, parameters.offset_n]
}

/// Error of a value, and its half width.
pub fn error(found: Interval, truth: f64) -> (f64, f64) {
    (f64::from(found.value) - truth, f64::from(found.u95))
}

/// Errors of the parameters of a whole run, with their half widths.
pub fn errors(parameters: &Parameters, device: &Inerter) -> [Option<(f64, f64)>; 3] {
    let (found, truth) = (three(parameters), truth(device));
    std::array::from_fn(|i| Some(error(found[i].known()?, truth[i])))
}

/// Mean of some values.
pub fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

/// Root mean square.
pub fn rms(all: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = all.fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    (sum / count).sqrt()
}

/// Mean and standard deviation; NaN for fewer than two values.
pub fn bias_and_sigma(errors: &[f64]) -> (f64, f64) {
    if errors.len() < 2 {
        return (f64::NAN, f64::NAN);
    }
    let bias = mean(errors.iter().copied());
    let variance = errors.iter().map(|error| (error - bias).powi(2)).sum::<f64>() / (errors.len() as f64 - 1.0);
    (bias, variance.sqrt())
}

/// Errors of one value, of some runs or of all that they published, with the half widths of its intervals.
#[derive(Clone, Copy, Debug, Default)]
pub struct Column {
    /// Mean error; NaN if fewer than two values were given.
    pub bias: f64,
    /// Standard deviation of the error, with the same convention.
    pub sigma: f64,
    /// Root mean square of the error over the half width of the interval.
    pub rms: f64,
    /// Mean half width of the interval.
    pub u95: f64,
    /// Number of values.
    pub given: usize,
    /// Number of values whose interval does not contain the true value.
    pub wrong: usize,
}

impl Column {
    /// From errors with their half widths.
    pub fn of(found: impl Iterator<Item = (f64, f64)>) -> Self {
        let (errors, u95): (Vec<f64>, Vec<f64>) = found.unzip();
        let (bias, sigma) = bias_and_sigma(&errors);
        let each = || errors.iter().zip(&u95);
        let rms = rms(each().map(|(error, u95)| error / u95));
        // No interval covers a value that is not a number.
        let covered = each().filter(|(error, u95)| error.abs() <= **u95).count();
        let given = errors.len();
        Self { bias, sigma, rms, u95: mean(u95.iter().copied()), given, wrong: given - covered }
    }

    /// Number of values whose interval contains the true value.
    pub fn covered(&self) -> usize {
        self.given - self.wrong
    }

    /// Fraction of the values whose interval contains the true value; `None` if no value was given.
    pub fn coverage(&self) -> Option<f64> {
        (self.given > 0).then(|| self.covered() as f64 / self.given as f64)
    }
}

/// Statistics of one cell: one parameter in one motion on one rig over all seeds.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cell {
    /// Errors at the end.
    pub last: Column,
    /// Fraction of all live values with a short memory whose interval covers the true value; `None` if none was
    /// published.
    pub coverage: Option<f64>,
    /// The same fraction for the whole-run values.
    pub whole_run_coverage: Option<f64>,
    /// Median time from which the live value stays within the limit \[s\]; `None` if it never does.
    pub settling_s: Option<f64>,
}

/// Statistics of the three parameters over the runs of one motion.
pub fn cells(device: &Inerter, runs: &[Run]) -> [Cell; 3] {
    let truth = truth(device);
    let limits = [1e-3 * truth[0], 5.0, 1.0];
    std::array::from_fn(|i| {
        let mut times: Vec<f64> = runs.iter().map(|run| settling(run, i, truth[i], limits[i])).collect();
        times.sort_by(f64::total_cmp);
        let coverage = |published: fn(&Run) -> &[(f64, Estimate)], parameters: fn(&Estimate) -> &Parameters| {
            let all = runs.iter().flat_map(published);
            let given = all.filter_map(|(_, estimate)| three(parameters(estimate))[i].ok());
            Column::of(given.map(|found| error(found, truth[i]))).coverage()
        };
        Cell {
            last: Column::of(runs.iter().filter_map(|run| errors(&run.last.whole_run, device)[i])),
            coverage: coverage(|run| &run.forgetful, |estimate| &estimate.recent),
            whole_run_coverage: coverage(|run| &run.published, |estimate| &estimate.whole_run),
            settling_s: times.get(times.len() / 2).copied().filter(|time| time.is_finite()),
        }
    })
}

/// Time from which every published value is given and within the limit; infinite if there is none.
fn settling(run: &Run, i: usize, truth: f64, limit: f64) -> f64 {
    let bad = |e: &Estimate| three(&e.recent)[i].value().is_none_or(|value| (f64::from(value) - truth).abs() > limit);
    let from = run.published.iter().rposition(|(_, e)| bad(e)).map_or(0, |last| last + 1);
    run.published.get(from).map_or(f64::INFINITY, |(t, _)| *t)
}
