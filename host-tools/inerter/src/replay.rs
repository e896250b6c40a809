//! A run through the estimator, as the device would have done it.

use inerter_core::{Active, Counters, Estimate, RawSample, Settings, State};

use crate::{
    run::{Run, step},
    settings::{SettingsInputError, validate},
};

/// The estimator with its state and a clock that counts samples.
pub struct Replay {
    active: Active,
    state: Box<State>,
    rate_hz: f64,
    start_s: f64,
    elapsed: u64,
    last_index: Option<u32>,
}

impl Replay {
    /// An estimator that has seen nothing; the first sample that it takes stands at `start_s` \[s\].
    pub fn new(settings: &Settings, start_s: f64) -> Result<Self, SettingsInputError> {
        let active = validate(settings)?;
        let state = Box::new(State::new(&active));
        Ok(Self { active, state, rate_hz: settings.sample_rate_hz, start_s, elapsed: 0, last_index: None })
    }

    /// Takes one sample; gives an estimate at the publish rate.
    pub fn step(&mut self, sample: &RawSample) -> Option<Estimate> {
        if let Some(last) = self.last_index.replace(sample.index) {
            self.elapsed += step(last, sample.index);
        }
        self.active.step(&mut self.state, sample)
    }

    /// Time of the latest sample \[s\].
    pub fn time_s(&self) -> f64 {
        self.start_s + self.elapsed as f64 / self.rate_hz
    }

    /// The estimate as it stands now.
    pub fn estimate(&self) -> Estimate {
        self.active.estimate(&self.state)
    }

    /// What has been counted so far.
    pub fn counters(&self) -> Counters {
        self.state.counters()
    }
}

/// What a whole run came to.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    /// Time of the last sample \[s\].
    pub t_s: f64,
    /// The estimate after the last sample.
    pub estimate: Estimate,
    /// Samples, gaps and saturation.
    pub counters: Counters,
}

/// Replays a whole run; `publish` is handed the time \[s\] and each estimate at the publish rate.
pub fn replay<E: From<SettingsInputError>>(
    run: &Run,
    mut publish: impl FnMut(f64, &Estimate) -> Result<(), E>,
) -> Result<Outcome, E> {
    let mut replay = Replay::new(&run.settings, run.start_s)?;
    for sample in &run.samples {
        if let Some(estimate) = replay.step(sample) {
            publish(replay.time_s(), &estimate)?;
        }
    }
    Ok(Outcome { t_s: replay.time_s(), estimate: replay.estimate(), counters: replay.counters() })
}
