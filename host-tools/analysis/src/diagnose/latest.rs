//! The latest samples of a run that is too long to keep, or still running.

use std::collections::VecDeque;

use inerter_core::{Published, RawSample, Settings, Warning};
use inerter_data::{gated::Gated, run::Run};

use super::{cause::Cause, search::suspected};

/// Length that is kept \[s\].
const KEPT_S: f64 = 60.0;

/// The latest samples, kept for a search for causes.
#[derive(Clone, Debug)]
pub struct Latest {
    settings: Settings,
    samples: VecDeque<RawSample>,
    warnings: Vec<Warning>,
}

impl Latest {
    /// Empty, for a device with these settings.
    pub fn new(settings: &Settings) -> Self {
        Self { settings: *settings, samples: VecDeque::new(), warnings: Vec::new() }
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
        self.warnings.push(warning);
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
        Gated::of(&run, &self.warnings)
    }

    /// The causes in them that a person should know of; `published` is the estimator's latest result.
    pub fn suspected(self, published: &Published) -> Vec<Cause> {
        let settings = self.settings;
        suspected(&self.gated(), &settings, published)
    }
}
