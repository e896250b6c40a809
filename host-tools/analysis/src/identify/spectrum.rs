//! Whitens the residuals of encoder and force: weights each frequency according to its noise.
//!
//! Noise of one sample: encoder and force have white noise of their own. The remaining noise of the terminal affects
//! both through the device's response, which near its resonance far exceeds either. So the covariance of encoder and
//! force at a frequency is `diag(encoder^2, force^2) + T`, with `T` the covariance of the changes in simulations with
//! such noise on the terminal ([`super::complete`]): friction and impacts make the response nonlinear. A wrong weight
//! costs efficiency, not correctness: the actual scatter of the whitened residual is measured ([`Whitening::power`]).

use std::{f64::consts::PI, sync::Arc};

use rustfft::{Fft, FftPlanner, num_complex::Complex};

use super::model::simpson_gain;

type C = Complex<f64>;

/// White noise of one sample of each channel.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    /// Of the encoder \[m\].
    pub position: f64,
    /// Of the force \[N\].
    pub force: f64,
}

/// Weights of one stretch.
#[derive(Clone)]
pub struct Whitening {
    transform: Arc<dyn Fft<f64>>,
    /// Weight of each sample: 0 at the ends, 1 within.
    window: Vec<f64>,
    /// The same for the force, where some samples may be left out.
    force_window: Vec<f64>,
    /// For each frequency from 0: the inverse of the covariance's lower Cholesky factor, divided by the square root of
    /// the window's power.
    factors: Vec<(f64, C, f64)>,
}

/// Frequencies on either side over which the terminal's part is averaged.
const SMEARED: usize = 8;

impl Whitening {
    /// For stretches of `count` samples, the first `skipped` of which do not count, up to `highest_hz`. `left_out` are
    /// samples of the force that do not count; `disturbed` holds repeated realisations of the effect of the terminal's
    /// noise on encoder and force.
    pub fn new(
        count: usize,
        period_s: f64,
        skipped: usize,
        highest_hz: f64,
        noise: Noise,
        left_out: impl Iterator<Item = bool>,
        disturbed: &[(Vec<f64>, Vec<f64>)],
    ) -> Self {
        let window = window(count, skipped, ((0.1 / period_s) as usize).min(count / 8));
        let mut force_window = window.clone();
        force_window.iter_mut().zip(left_out).filter(|(_, out)| *out).for_each(|(weight, _)| *weight = 0.0);
        let power = window.iter().map(|w| w * w).sum::<f64>().max(f64::MIN_POSITIVE);
        let bin_hz = 1.0 / (count as f64 * period_s);
        let bins = ((highest_hz / bin_hz) as usize + 1).min(count.div_ceil(2)).max(1);
        let transform = FftPlanner::new().plan_fft_forward(count);
        let mut whitening = Self { transform, window, force_window, factors: vec![(1.0, C::default(), 1.0); bins] };
        let mut terminal = vec![(0.0, C::default(), 0.0); bins];
        for (position, force) in disturbed {
            let mut slots = terminal.iter_mut();
            whitening.spectra(position.iter().copied(), force.iter().copied(), |x, f| {
                if let Some((xx, fx, ff)) = slots.next() {
                    *xx += x.norm_sqr();
                    *fx += f * x.conj();
                    *ff += f.norm_sqr();
                }
            });
        }
        let root = power.sqrt();
        for (bin, slot) in whitening.factors.iter_mut().enumerate() {
            let around = &terminal[bin.saturating_sub(SMEARED)..(bin + SMEARED + 1).min(bins)];
            let per = 1.0 / (power * (around.len() * disturbed.len()).max(1) as f64);
            let (xx, fx, ff) = around
                .iter()
                .fold((0.0, C::default(), 0.0), |(a, b, c), (xx, fx, ff)| (a + per * xx, b + per * fx, c + per * ff));
            let position = (noise.position.powi(2) + xx).sqrt();
            let cross = fx / position;
            let own = (noise.force * simpson_gain(bin as f64 * bin_hz, period_s)).powi(2);
            let force = (own + (ff - cross.norm_sqr()).max(0.0)).sqrt();
            *slot = (1.0 / (position * root), -cross / (position * force * root), 1.0 / (force * root));
        }
        whitening
    }

    /// Number of values that it makes from a pair of channels.
    pub fn rows(&self) -> usize {
        4 * self.factors.len() - 2
    }

    /// Whether a sample counts fully.
    pub fn counts(&self, place: usize) -> bool {
        self.window.get(place).is_some_and(|weight| *weight == 1.0)
    }

    /// Passes on the spectra of encoder and force, frequency by frequency from 0.
    fn spectra(
        &self,
        position: impl Iterator<Item = f64>,
        force: impl Iterator<Item = f64>,
        mut take: impl FnMut(C, C),
    ) {
        // Both are real, so one transform computes both.
        let mut pair: Vec<C> = position
            .zip(force)
            .zip(self.window.iter().zip(&self.force_window))
            .map(|((x, f), (wx, wf))| C::new(x * wx, f * wf))
            .collect();
        pair.resize(self.window.len(), C::default());
        self.transform.process(&mut pair);
        let mirrored = pair.iter().take(1).chain(pair.iter().rev());
        for (one, other) in pair.iter().zip(mirrored).take(self.factors.len()) {
            take((one + other.conj()) * 0.5, (one - other.conj()) * C::new(0.0, -0.5));
        }
    }

    /// The two channels whitened: for each frequency the real and imaginary part of the encoder's, then of the force's.
    /// If the weights are right, the numbers have variance 1 and are independent.
    pub fn whitened(&self, position: impl Iterator<Item = f64>, force: impl Iterator<Item = f64>, rows: &mut [f64]) {
        let mut slots = rows.iter_mut();
        // The values first: the longer iterator would lose a slot at the end of each call.
        let mut put = |values: &[f64]| values.iter().zip(slots.by_ref()).for_each(|(value, slot)| *slot = *value);
        let mut factors = self.factors.iter();
        let mut is_first = true;
        self.spectra(position, force, |x, f| {
            let Some((own, cross, force)) = factors.next() else { return };
            let (x, f) = (x * own, x * cross + f * force);
            if std::mem::take(&mut is_first) {
                put(&[x.re, f.re]);
            } else {
                put(&[x.re, x.im, f.re, f.im].map(|part| 2f64.sqrt() * part));
            }
        });
    }

    /// Local mean square of the whitened residual around each row, per channel: 1 if the weights are right.
    pub fn power(&self, rows: &[f64]) -> Vec<f64> {
        /// Frequencies on either side included in the average.
        const AROUND: usize = 24;
        let bins = self.factors.len();
        let channel = |offset: usize| -> Vec<f64> {
            let square = |bin: usize| match bin {
                0 => rows[offset] * rows[offset],
                _ => {
                    let place = 2 + 4 * (bin - 1) + 2 * offset;
                    0.5 * (rows[place] * rows[place] + rows[place + 1] * rows[place + 1])
                }
            };
            let (mut sums, mut sum) = (vec![0.0], 0.0);
            for bin in 0..bins {
                sum += square(bin);
                sums.push(sum);
            }
            (0..bins)
                .map(|bin| {
                    let (low, high) = (bin.saturating_sub(AROUND), (bin + AROUND + 1).min(bins));
                    (sums[high] - sums[low]) / (high - low).max(1) as f64
                })
                .collect()
        };
        let (position, force) = (channel(0), channel(1));
        let mut power = Vec::with_capacity(rows.len());
        for (bin, (x, f)) in position.iter().zip(&force).enumerate() {
            if bin == 0 {
                power.extend([*x, *f]);
            } else {
                power.extend([*x, *x, *f, *f]);
            }
        }
        power
    }

    /// The force's whitened residual in the time domain, one sample per independent number.
    pub fn force_in_time(&self, rows: &[f64]) -> Vec<f64> {
        let bins = self.factors.len();
        let count = 2 * bins - 1;
        let mut spectrum = vec![C::default(); count];
        for bin in 1..bins {
            let place = 2 + 4 * (bin - 1) + 2;
            let value = C::new(rows[place], rows[place + 1]);
            (spectrum[bin], spectrum[count - bin]) = (value, value.conj());
        }
        FftPlanner::new().plan_fft_inverse(count).process(&mut spectrum);
        // The ends, where the window vanishes, would look like silence.
        let skipped = |place: usize| self.counts(place * self.window.len() / count);
        spectrum.iter().enumerate().filter(|(place, _)| skipped(*place)).map(|(_, x)| x.re).collect()
    }
}

/// Zero before `skipped`, then rising from 0 to 1 over `taper`, and falling at the end.
fn window(count: usize, skipped: usize, taper: usize) -> Vec<f64> {
    let rise = |place: usize| match (place as f64 + 0.5) / taper.max(1) as f64 {
        z if z >= 1.0 => 1.0,
        z => 0.5 - 0.5 * (PI * z).cos(),
    };
    (0..count)
        .map(|place| match place.checked_sub(skipped) {
            None => 0.0,
            Some(since) => rise(since).min(rise(count - 1 - place)),
        })
        .collect()
}

#[cfg(test)]
#[path = "spectrum_tests.rs"]
mod tests;
