//! A run: settings and raw samples from any source.

use std::collections::BTreeMap;

use inerter_core::{RawSample, Settings};
use inerter_wire::{Hello, step};

use crate::calibration::Calibration;

/// Settings and raw samples of one run, with what the user should know about them.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Name for messages: the file.
    pub name: String,
    /// Settings that the samples were taken with, including the user's overrides.
    pub settings: Settings,
    /// Raw samples in order; a jump of the index is a discontinuity.
    pub samples: Vec<RawSample>,
    /// Time of the first sample \[s\].
    pub start_s: f64,
    /// Host time of the first frame \[ns since 1970\]; `None` if there was no clock, as in a simulation.
    pub recorded_ns: Option<u64>,
    /// What was repaired or found missing while reading.
    pub notes: Vec<String>,
    /// The device that recorded it, when known.
    pub hello: Option<Hello>,
    /// The calibration of its rig, if known.
    pub calibration: Option<Calibration>,
    /// The true parameters of a simulated device, by name.
    pub truth: Option<BTreeMap<String, String>>,
}

impl Run {
    /// The samples, each with the number of sample periods since the first one, including missing ones.
    pub fn elapsed(&self) -> impl Iterator<Item = (u64, &RawSample)> {
        let mut previous: Option<(u32, u64)> = None;
        self.samples.iter().map(move |sample| {
            let elapsed = match previous {
                None => 0,
                Some((index, elapsed)) => elapsed + step(index, sample.index),
            };
            previous = Some((sample.index, elapsed));
            (elapsed, sample)
        })
    }

    /// Number of gaps, and total number of missing samples.
    pub fn discontinuities(&self) -> (u64, u64) {
        let jumps = self.samples.windows(2).filter_map(|pair| match pair {
            [this, next] => Some(step(this.index, next.index).saturating_sub(1)),
            _ => None,
        });
        jumps.filter(|jump| *jump > 0).fold((0, 0), |(places, missing), jump| (places + 1, missing + jump))
    }

    /// Time from the first sample to the last \[s\], including missing ones.
    pub fn duration_s(&self) -> f64 {
        self.elapsed().last().map_or(0.0, |(elapsed, _)| elapsed as f64 / self.settings.sample_rate_hz)
    }
}
