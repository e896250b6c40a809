//! Backlash on the accuracy grid: every width, from the force alone and with the terminal sensor.

use crate::coverage::stated_true;
use crate::grid::{self, Column, Estimator, Instruments, Result, calibrated, error, raw};
use inerter_core::{Detail, Parameter, Reversal, Settings};
use inerter_plant::{Inerter, Sensors};

/// Backlash of the grid \[m\].
pub const BACKLASHES_M: [f64; 6] = [0.0, 10e-6, 20e-6, 50e-6, 100e-6, 200e-6];

/// Goals for bias and sigma of the backlash from the force alone at 1 kHz and 1 N \[m\], and the greatest backlash to
/// which they apply \[m\].
pub fn goal(motion: &str) -> (f64, f64, f64) {
    match motion {
        "slow" => (1e-6, 1e-6, 200e-6),
        "mid" => (1.5e-6, 3e-6, 200e-6),
        "fast" => (1.5e-6, 0.5e-6, 200e-6),
        "multi" => (1e-6, 1e-6, 50e-6),
        "random" => (0.5e-6, 0.5e-6, 200e-6),
        _ => (2e-6, 4e-6, 50e-6),
    }
}

/// Goal with the terminal sensor, for both bias and sigma \[m\].
pub fn sensed_goal(motion: &str) -> f64 {
    if motion == "slow" { 2e-6 } else { 0.9e-6 }
}

/// Results of one run by both methods.
#[derive(Clone, Debug)]
pub struct Run {
    /// From the force alone.
    pub force: Detail,
    /// With the terminal sensor.
    pub sensed: Detail,
    /// Reversals found from the force, in order.
    pub reversals: Vec<Reversal>,
    /// Reversals found with the sensor.
    pub sensed_reversals: Vec<Reversal>,
}

/// Instruments of the grid with a terminal sensor: 0.1 um per code, 1 um rms.
pub fn instruments(rig: &Instruments, seed: u64) -> Sensors {
    Sensors { terminal_noise_m: 1e-6, ..grid::instruments(rig, seed) }
}

/// Settings of a device calibrated against these instruments, its stiffness known to 0.1 %.
pub fn settings(device: &Inerter, sensors: &Sensors) -> Settings {
    Settings { stiffness_u95_n_per_m: 1e-3 * device.stiffness_n_per_m, ..stated_true(calibrated(device, sensors)) }
}

/// Simulates a device, and estimates with and without its sensor.
pub fn run(device: &Inerter, motion: &str, duration_s: f64, rig: &Instruments, seed: u64) -> Result<Run> {
    let sensors = instruments(rig, seed);
    let settings = settings(device, &sensors);
    let mut estimator = Estimator::new(&settings)?;
    let mut sensing = Estimator::new(&Settings { terminal_sensor: true, stiffness_n_per_m: 0.0, ..settings })?;
    let (mut reversals, mut sensed_reversals) = (Vec::new(), Vec::new());
    for sample in grid::shaken(device, motion, sensors)?.lasting(duration_s) {
        let raw = raw(&sample);
        reversals.extend(estimator.step(&raw).reversal);
        sensed_reversals.extend(sensing.step(&raw).reversal);
    }
    let [force, sensed] = [estimator, sensing].map(|estimator| estimator.publish().detail);
    Ok(Run { force, sensed, reversals, sensed_reversals })
}

/// One backlash in one motion on one rig.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cell {
    /// Backlash from the force alone \[m\].
    pub force: Column,
    /// Backlash with the sensor \[m\].
    pub sensed: Column,
    /// Stiffness with the sensor, relative.
    pub stiffness: Column,
    /// Damping with the sensor, relative.
    pub damping: Column,
}

/// Statistics over the runs of one cell.
pub fn cell(device: &Inerter, runs: &[Run]) -> Cell {
    let backlash = |read: fn(&Run) -> &Detail| {
        let given = runs.iter().filter_map(|run| read(run).backlash.known());
        Column::of(given.map(|found| error(found, device.backlash_m)))
    };
    let contact = |read: fn(&Detail) -> Parameter, truth: f64| {
        let given = runs.iter().filter_map(|run| read(&run.sensed).ok());
        Column::of(given.map(|found| (f64::from(found.value) / truth - 1.0, f64::from(found.u95) / truth)))
    };
    Cell {
        force: backlash(|run| &run.force),
        sensed: backlash(|run| &run.sensed),
        stiffness: contact(|detail| detail.stiffness_n_per_m, device.stiffness_n_per_m),
        damping: contact(|detail| detail.contact_damping_n_s_per_m, device.contact_damping_n_s_per_m),
    }
}
