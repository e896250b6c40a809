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
    /// The tally of some runs, each with the same run without a defect.
    pub fn of<'a>(runs: impl Iterator<Item = (&'a Said, &'a Said)>) -> Self {
        let runs: Vec<_> = runs.collect();
        let device = |said: &Said, intervals| verdict(&said.device, intervals);
        let replay = |said: &Said, intervals| verdict(&said.replay, intervals);
        let count = |by: &dyn Fn(&Said, f64) -> Verdict, intervals, wanted| {
            runs.iter().filter(|(said, _)| by(said, intervals) == wanted).count() as u32
        };
        Self {
            runs: runs.len() as u32,
            harmful: runs.iter().filter(|(said, clean)| is_harmful(said, clean)).count() as u32,
            device: count(&device, 1.0, Verdict::Silent),
            told: count(&replay, 1.0, Verdict::Told),
            assumed: count(&replay, 1.0, Verdict::Assumed),
            silent: count(&replay, 1.0, Verdict::Silent),
            device_twice: count(&device, 2.0, Verdict::Silent),
            silent_twice: count(&replay, 2.0, Verdict::Silent),
        }
    }

    /// Percentage of the runs.
    pub fn percent(&self, part: u32) -> f64 {
        100.0 * f64::from(part) / f64::from(self.runs.max(1))
    }
}
