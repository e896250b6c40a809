//! Counts of verdicts over runs.

use super::judge::{Said, Verdict, is_harmful, verdict};

/// Counts of runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// All runs.
    pub runs: u32,
    /// Runs in which the defect moves a fitted value off the true value by more than twice the interval of the clean
    /// run.
    pub harmful: u32,
    /// Silently wrong, judged by the device alone.
    pub device: u32,
    /// Wrong, and `replay` reports it.
    pub told: u32,
    /// Wrong, and `replay` lists it only as an assumption.
    pub assumed: u32,
    /// Silently wrong in `replay`.
    pub silent: u32,
    /// Silently wrong by more than twice the interval, judged by the device alone.
    pub device_twice: u32,
    /// Silently wrong by more than twice the interval in `replay`.
    pub silent_twice: u32,
}

impl Tally {
    /// The tally of one run, given the same run without a defect.
    pub fn of(said: &Said, clean: &Said) -> Self {
        let [device, replay] = [&said.device, &said.replay];
        let is = |values, intervals, wanted| u32::from(verdict(values, intervals) == wanted);
        Self {
            runs: 1,
            harmful: u32::from(is_harmful(said, clean)),
            device: is(device, 1.0, Verdict::Silent),
            told: is(replay, 1.0, Verdict::Told),
            assumed: is(replay, 1.0, Verdict::Assumed),
            silent: is(replay, 1.0, Verdict::Silent),
            device_twice: is(device, 2.0, Verdict::Silent),
            silent_twice: is(replay, 2.0, Verdict::Silent),
        }
    }

    /// Percentage of the runs.
    pub fn percent(&self, part: u32) -> f64 {
        100.0 * f64::from(part) / f64::from(self.runs.max(1))
    }
}

impl std::iter::Sum for Tally {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |a, b| Self {
            runs: a.runs + b.runs,
            harmful: a.harmful + b.harmful,
            device: a.device + b.device,
            told: a.told + b.told,
            assumed: a.assumed + b.assumed,
            silent: a.silent + b.silent,
            device_twice: a.device_twice + b.device_twice,
            silent_twice: a.silent_twice + b.silent_twice,
        })
    }
}
