//! Runs a run through the estimator, as the device would have done.

use inerter_core::{
    Active, Bank, Budgets, Counters, Detail, Estimate, Law, MoreSums, Motion, Output, Published, RawSample, Settings,
    State, Sums,
};
use inerter_wire::{Estimated, EstimatorEvent, step};

use crate::{
    run::Run,
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
    /// A new estimator; its first sample is at `start_s` \[s\].
    pub fn new(settings: &Settings, start_s: f64) -> Result<Self, SettingsInputError> {
        let active = validate(settings)?;
        let state = Box::new(State::new(&active));
        Ok(Self { active, state, rate_hz: settings.sample_rate_hz, start_s, elapsed: 0, last_index: None })
    }

    /// Takes one sample; returns the resulting events, in the order in which a device sends them.
    pub fn step(&mut self, sample: &RawSample) -> impl Iterator<Item = EstimatorEvent> + use<> {
        if let Some(last) = self.last_index.replace(sample.index) {
            self.elapsed += step(last, sample.index);
        }
        let Output { published, reversal, warning, change, .. } = self.active.step(&mut self.state, sample);
        let published = published.map(|published| EstimatorEvent::Estimate(published.into()));
        let (reversal, change) = (reversal.map(EstimatorEvent::Reversal), change.map(EstimatorEvent::Changed));
        [reversal, warning.map(EstimatorEvent::Warned), change, published].into_iter().flatten()
    }

    /// Time of the latest sample \[s\].
    pub fn time_s(&self) -> f64 {
        self.start_s + self.elapsed as f64 / self.rate_hz
    }

    /// Time of the sample that the event refers to \[s\].
    fn time_of(&self, event: &EstimatorEvent) -> f64 {
        let ago = self.last_index.unwrap_or(0).wrapping_sub(event.index());
        self.time_s() - f64::from(ago) / self.rate_hz
    }

    /// The current whole-run sums of one bank.
    pub fn sums(&self, bank: Bank) -> (Sums, MoreSums) {
        (self.active.sums(&self.state, bank), self.active.more_sums(&self.state, bank))
    }

    /// The outcome so far.
    pub fn outcome(&self) -> Outcome {
        let Published { estimate, law, detail } = self.active.publish(&self.state);
        Outcome {
            t_s: self.time_s(),
            estimate,
            law,
            detail,
            counters: self.counters(),
            motion: self.active.motion(&self.state),
            budgets: self.active.budgets(&self.state),
            fast: self.sums(Bank::Fast),
            slow: self.sums(Bank::Slow),
        }
    }

    /// The counters so far.
    pub fn counters(&self) -> Counters {
        self.state.counters()
    }
}

/// The outcome of a whole run.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    /// Time of the last sample \[s\].
    pub t_s: f64,
    /// The estimate after the last sample.
    pub estimate: Estimate,
    /// Whether its law holds.
    pub law: Law,
    /// The detail of the estimate.
    pub detail: Detail,
    /// Samples, discontinuities and saturation.
    pub counters: Counters,
    /// Statistics of the motion besides the sums.
    pub motion: Motion,
    /// Components of the intervals.
    pub budgets: Budgets,
    /// The sums of the fast bank since the start or the latest change.
    pub fast: (Sums, MoreSums),
    /// The sums of the slow bank since then.
    pub slow: (Sums, MoreSums),
}

impl Outcome {
    /// The estimate with its detail.
    pub fn estimated(&self) -> Estimated {
        self.published().into()
    }

    /// The same in the estimator's own form.
    pub fn published(&self) -> Published {
        Published { estimate: self.estimate, law: self.law, detail: self.detail }
    }

    /// The sums of the bank that the estimate comes from.
    pub fn sums(&self) -> &(Sums, MoreSums) {
        match self.estimate.bank {
            Bank::Fast => &self.fast,
            Bank::Slow => &self.slow,
        }
    }
}

/// Replays a whole run; `publish` gets everything that the estimator reports, with its time \[s\].
pub fn replay_all<E: From<SettingsInputError>>(
    run: &Run,
    publish: impl FnMut(f64, &EstimatorEvent) -> Result<(), E>,
) -> Result<Outcome, E> {
    replay_samples(&run.settings, run.start_s, run.samples.iter().copied().map(Ok), publish)
}

/// Replays samples one by one; the first is at `start_s` \[s\].
pub fn replay_samples<E: From<SettingsInputError>>(
    settings: &Settings,
    start_s: f64,
    samples: impl Iterator<Item = Result<RawSample, E>>,
    mut publish: impl FnMut(f64, &EstimatorEvent) -> Result<(), E>,
) -> Result<Outcome, E> {
    let mut replay = Replay::new(settings, start_s)?;
    for sample in samples {
        for event in replay.step(&sample?) {
            publish(replay.time_of(&event), &event)?;
        }
    }
    Ok(replay.outcome())
}

/// Replays a whole run; `publish` gets the time \[s\] and each estimate at the publish rate.
pub fn replay<E: From<SettingsInputError>>(
    run: &Run,
    mut publish: impl FnMut(f64, &Estimate) -> Result<(), E>,
) -> Result<Outcome, E> {
    replay_all(run, |t_s, event| match event {
        EstimatorEvent::Estimate(estimated) => publish(t_s, &estimated.estimate),
        EstimatorEvent::Reversal(_) | EstimatorEvent::Changed(_) | EstimatorEvent::Warned(_) => Ok(()),
    })
}
