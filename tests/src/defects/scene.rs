//! The ingredients of a run: a device and a rig, into which a defect can be put.

use super::{
    draw::Draw,
    instruments::Instruments,
    plant::{Body, Trace},
};
use inerter_core::{RawSample, Settings};
use inerter_plant::Inerter;

/// Range of the true values of one parameter in the run; both ends are equal if it is constant.
pub type Range = (f64, f64);

/// Extremes of a clean run of the same device after its first second. Sizes of defects are relative to them.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    /// Greatest absolute displacement \[m\].
    pub stroke_m: f64,
    /// Greatest absolute velocity \[m/s\].
    pub speed_m_per_s: f64,
    /// Root mean square of the velocity \[m/s\].
    pub speed_rms_m_per_s: f64,
    /// Greatest absolute force \[N\].
    pub peak_n: f64,
    /// Length of the run \[s\].
    pub duration_s: f64,
}

impl Seen {
    /// From a clean run.
    pub fn of(trace: &Trace, duration_s: f64) -> Self {
        let from = (1.0 / trace.step_s) as usize;
        let velocities = trace.position_m.windows(2).skip(from).map(|pair| (pair[1] - pair[0]) / trace.step_s);
        let velocities: Vec<f64> = velocities.collect();
        let peak = |all: &[f64]| all.iter().fold(0.0, |peak, x| f64::max(peak, x.abs()));
        Self {
            stroke_m: peak(trace.position_m.get(from..).unwrap_or_default()),
            speed_m_per_s: peak(&velocities),
            speed_rms_m_per_s: (velocities.iter().map(|v| v * v).sum::<f64>() / velocities.len().max(1) as f64).sqrt(),
            peak_n: peak(trace.force_n.get(from..).unwrap_or_default()),
            duration_s,
        }
    }
}

/// The ingredients of one run.
pub struct Scene {
    /// The device.
    pub device: Inerter,
    /// Forces on its screw besides the law.
    pub body: Body,
    /// Position and force of the clean run; a defect of the signals changes them.
    pub trace: Trace,
    /// The rig.
    pub instruments: Instruments,
    /// The settings: exact for the rig without the defect.
    pub settings: Settings,
    /// True values of mt, cf and fc.
    pub truth: [Range; 3],
    /// Extremes of a clean run.
    pub seen: Seen,
    /// Whether the second plant makes the run.
    pub by_second: bool,
}

/// Counts per turn of common encoders.
const TURN_COUNTS: [f64; 9] = [2000.0, 2048.0, 3600.0, 4000.0, 4096.0, 5000.0, 8192.0, 10_000.0, 20_000.0];

impl Scene {
    /// The forces besides the law that only the second plant can simulate; it then makes the run.
    pub fn second_body(&mut self) -> &mut Body {
        self.by_second = true;
        &mut self.body
    }

    /// Adds a defect of the samples as sent.
    pub fn on_samples(&mut self, change: impl Fn(&mut Vec<RawSample>, &mut Draw) + 'static) {
        self.instruments.on_samples.push(Box::new(change));
    }

    /// Adds a defect of each sample as sent.
    pub fn on_each_sample(&mut self, change: impl Fn(&mut RawSample, &mut Draw) + 'static) {
        self.on_samples(move |samples, draw| samples.iter_mut().for_each(|sample| change(sample, draw)));
    }

    /// A common number of counts per turn that makes a lead between 4 and 40 mm, if any does.
    pub fn turn_counts(&self, draw: &mut Draw) -> Option<f64> {
        let count_m = self.instruments.sensors.metres_per_count;
        let fitting: Vec<f64> = TURN_COUNTS.into_iter().filter(|n| (4e-3..40e-3).contains(&(n * count_m))).collect();
        (!fitting.is_empty()).then(|| draw.one_of(&fitting))
    }
}
