//! The latest samples of a run that is too long to be kept, or still running.

use std::collections::VecDeque;

use inerter_core::{Published, RawSample, Settings, Warning};
use inerter_data::{gated::Gated, run::Run};

use super::{
    cause::Cause,
    search::{is_suspect, suspected},
};

/// How much is kept \[s\].
const KEPT_S: f64 = 60.0;

/// The latest samples, kept so that a cause can be sought in them.
#[derive(Clone, Debug)]
pub struct Latest {
    settings: Settings,
    samples: VecDeque<RawSample>,
    warnings: Vec<Warning>,
    most: usize,
}

impl Latest {
    /// Nothing yet, of a device with these settings.
    pub fn new(settings: &Settings) -> Self {
        let most = (KEPT_S * settings.sample_rate_hz) as usize;
        Self { settings: *settings, samples: VecDeque::new(), warnings: Vec::new(), most }
    }

    /// Takes the next sample.
    pub fn push(&mut self, sample: RawSample) {
        if self.samples.len() >= self.most {
            self.samples.pop_front();
        }
        self.samples.push_back(sample);
    }

    /// The estimator said this of a sample.
    pub fn warn(&mut self, warning: Warning) {
        self.warnings.push(warning);
    }

    /// What comes is of another device.
    pub fn forget(&mut self) {
        self.samples.clear();
        self.warnings.clear();
    }

    /// How long it would take to measure as much \[s\].
    pub fn duration_s(&self) -> f64 {
        self.samples.len() as f64 / self.settings.sample_rate_hz
    }

    /// What they say, without what tells nothing.
    pub fn gated(self) -> Gated {
        let run = Run { settings: self.settings, samples: self.samples.into(), ..Run::default() };
        Gated::of(&run, &self.warnings)
    }

    /// What breaks the law in them, as far as a person should be told; the estimator said this in the end.
    pub fn suspected(self, published: &Published) -> Vec<Cause> {
        if !is_suspect(&published.law) {
            return Vec::new();
        }
        let settings = self.settings;
        suspected(&self.gated(), &settings, published)
    }
}
