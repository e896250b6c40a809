//! Prepares stretches for the complete model: the smoothed motion of the terminal, the noise of each channel, the
//! initial state.

use inerter_core::Settings;
use inerter_data::series::Stretch;
use nalgebra::{DMatrix, DVector};

use super::{
    condition::{Smooth, white_noise},
    model::{Start, simpson},
    spectrum::Noise,
};
use crate::law::extent;

/// One stretch, ready to be fitted.
#[derive(Clone)]
pub struct Prepared {
    /// Index of the file.
    pub file: usize,
    /// Sample period \[s\].
    pub period_s: f64,
    /// Measured force \[N\].
    pub force: Vec<f64>,
    /// The measured force as means over two samples.
    pub mean_force: Vec<f64>,
    /// Displacement measured by the encoder \[m\].
    pub position: Vec<f64>,
    /// A step of the encoder \[m\].
    pub step_m: f64,
    pub smooth: Smooth,
    pub noise: Noise,
    /// Initial state of the screw, from the encoder.
    pub begun: Start,
}

/// Initial time of a stretch that does not count, because its initial state is only estimated \[s\].
const SETTLING_S: f64 = 0.5;
/// Samples that the initial state is estimated from.
const BEGINNING: usize = 21;

impl Prepared {
    /// From measured samples; the terminal's displacement may differ from the measured one.
    pub fn new(file: usize, stretch: &Stretch, smooth: Smooth, period_s: f64, settings: &Settings) -> Self {
        let step = |step: f64| step.abs() / 12f64.sqrt();
        let count_m = settings.metres_per_count.abs();
        let noise = Noise {
            position: white_noise(&stretch.position_m).max(step(count_m) / settings.oversampling.sqrt()),
            force: white_noise(&stretch.force_n).max(step(settings.newtons_per_code)).max(f64::MIN_POSITIVE),
        };
        Self {
            file,
            period_s,
            begun: begun(&stretch.position_m, period_s, count_m),
            force: stretch.force_n.clone(),
            mean_force: simpson(&stretch.force_n),
            position: stretch.position_m.clone(),
            step_m: count_m / settings.oversampling,
            smooth,
            noise,
        }
    }

    /// Initial samples that do not count.
    pub fn settling(&self) -> usize {
        (SETTLING_S / self.period_s).min(0.1 * self.force.len() as f64) as usize
    }

    /// The same, up to a given sample.
    pub fn until(&self, end: usize) -> Self {
        let mut part = self.clone();
        part.force.truncate(end);
        part.mean_force.truncate(end);
        part.position.truncate(end);
        part.smooth.nodes.truncate(end);
        part
    }

    /// Offset of the encoder's zero from the terminal's, if the screw is centred on average \[m\].
    pub fn zero(&self) -> f64 {
        let apart: f64 = self.position.iter().zip(&self.smooth.nodes).map(|(x2, [x1, _, _])| x2 - x1).sum();
        apart / self.position.len().max(1) as f64
    }
}

/// Sums of squares of velocity and displacement over all stretches.
pub fn motion<'a>(stretches: impl Iterator<Item = &'a Prepared>) -> (f64, f64) {
    let of_one = |prepared: &Prepared| {
        let nodes = &prepared.smooth.nodes;
        let mean = nodes.iter().map(|[x, _, _]| x).sum::<f64>() / nodes.len().max(1) as f64;
        nodes.iter().fold((0.0, 0.0), |(v, x), node| (v + node[1] * node[1], x + (node[0] - mean).powi(2)))
    };
    stretches.map(of_one).fold((0.0, 0.0), |(v, x), (dv, dx)| (v + dv, x + dx))
}

/// Position and velocity at the first sample, from a parabola through the first samples; at rest if the encoder stays
/// within a count.
fn begun(position: &[f64], period_s: f64, count_m: f64) -> Start {
    let first: Vec<f64> = position.iter().copied().take(BEGINNING).collect();
    let count = first.len().max(1) as f64;
    let mean = first.iter().sum::<f64>() / count;
    if extent(first.iter().copied()) < 1.5 * count_m {
        return Start { position_m: mean, velocity_m_per_s: 0.0 };
    }
    // The parabola at the first sample.
    let rows = DMatrix::from_fn(first.len(), 3, |row, power| (row as f64).powi(power as i32));
    let parabola = rows.svd(true, true).solve(&DVector::from_vec(first), 1e-12);
    match parabola.as_ref().map(DVector::as_slice) {
        Ok([x, v, _]) => Start { position_m: *x, velocity_m_per_s: v / period_s },
        _ => Start { position_m: mean, velocity_m_per_s: 0.0 },
    }
}
