//! Simulated runs, for the tests.

use inerter_data::{
    replay::{Outcome, Replay},
    run::Run,
    settings::Overrides,
};
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Setup, raw};

/// A device on a rig in this motion, for so many seconds.
pub fn setup(device: Inerter, sensors: Sensors, motion: &str, seconds: f64) -> Setup {
    Setup::new(device, sensors, motion, Some(seconds), &Overrides::default()).unwrap()
}

/// Its run.
pub fn recorded(setup: &Setup) -> Run {
    let samples = setup.samples().unwrap().map(|sample| raw(&sample)).collect();
    Run { settings: setup.settings, samples, ..Run::default() }
}

/// The estimator's outcome for it.
pub fn replayed(setup: &Setup) -> Outcome {
    let mut replay = Replay::new(&setup.settings, 0.0).unwrap();
    recorded(setup).samples.iter().for_each(|sample| replay.step(sample).for_each(drop));
    replay.outcome()
}
