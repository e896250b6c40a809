//! The latest samples of a run that is too long to keep, or still running.

use std::collections::VecDeque;

use inerter_core::{Published, RawSample, Settings, Warning};
use inerter_data::{gated::Gated, run::Run};

use super::{cause::Cause, search::suspected};

/// Length that is kept \[s\].
const KEPT_S: f64 = 60.0;
/// Warnings that are kept. In [`KEPT_S`] the estimator gives far fewer; a device may send any number.
const KEPT_WARNINGS: usize = 1000;

/// The latest samples, kept for a search for causes.
#[derive(Clone, Debug)]
pub struct Latest {
    settings: Settings,
    samples: VecDeque<RawSample>,
    warnings: VecDeque<Warning>,
}

impl Latest {
    /// Empty, for a device with these settings.
    pub fn new(settings: &Settings) -> Self {
        Self { settings: *settings, samples: VecDeque::new(), warnings: VecDeque::new() }
    }

    /// Adds the next sample.
    pub fn push(&mut self, sample: RawSample) {
        if self.samples.len() >= (KEPT_S * self.settings.sample_rate_hz) as usize {
            self.samples.pop_front();
        }
        self.samples.push_back(sample);
    }

    /// Adds a warning of the estimator about a sample.
    pub fn warn(&mut self, warning: Warning) {
        if self.warnings.len() >= KEPT_WARNINGS {
            self.warnings.pop_front();
        }
        self.warnings.push_back(warning);
    }

    /// Discards everything: the following samples are from another device.
    pub fn forget(&mut self) {
        self.samples.clear();
        self.warnings.clear();
    }

    /// Length of the kept samples \[s\].
    pub fn duration_s(&self) -> f64 {
        self.samples.len() as f64 / self.settings.sample_rate_hz
    }

    /// The samples, without those that carry no information.
    pub fn gated(self) -> Gated {
        let run = Run { settings: self.settings, samples: self.samples.into(), ..Run::default() };
        Gated::of(&run, &Vec::from(self.warnings))
    }

    /// The causes in them that a person should know of; `published` is the estimator's latest result.
    pub fn suspected(self, published: &Published) -> Vec<Cause> {
        let settings = self.settings;
        suspected(&self.gated(), &settings, published)
    }
}

#[cfg(test)]
mod tests {
    use inerter_core::WarningKind;

    use super::*;

    #[test]
    fn a_flood_of_samples_and_warnings_keeps_the_latest_of_each() {
        let settings = Settings::default();
        let mut latest = Latest::new(&settings);
        let most = (KEPT_S * settings.sample_rate_hz) as u32;
        for index in 0..most + 3 {
            latest.push(RawSample { index, ..RawSample::default() });
            latest.warn(Warning { index, kind: WarningKind::DeadForce });
        }
        assert_eq!((latest.samples.len(), latest.samples[0].index), (most as usize, 3));
        assert_eq!((latest.warnings.len(), latest.warnings[999].index), (1000, most + 2));
    }
}
