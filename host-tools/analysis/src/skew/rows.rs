//! The outputs of the estimator's kernels for a run in motion, and those for friction beyond the law's.

use inerter_core::{
    Bank, Settings,
    constants::{CORRELATION_BOXES, REST_WINDOW_S},
};
use inerter_data::series::{Series, Stretch};

use super::signs::{sign, velocities};
use crate::law::{Kernels, Law, around, dot, mark, stands};

/// Travel across a window of rest \[counts\], and force relative to the Coulomb friction, below which a reversal is
/// grazing.
const GRAZING_COUNTS: f64 = 4.0;
const WEAK: f64 = 3.0;
/// Rows per box, and maximum number: of more, evenly spaced ones are taken.
const PER_BOX: usize = 2;
const MOST_ROWS: usize = 20_000;
/// Mean square of the sign's rate, relative to the square of a box, below which the rows contain no reversals.
const LEAST_TURNING: f64 = 1e-3;

/// Friction beyond the law's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Friction {
    /// `|F - F0| s`: it grows with the load.
    Load,
    /// `|v|`: it differs by direction.
    Direction,
    /// `s exp(-|v| / v0)`: it is larger at low speed.
    Falling(f64),
    /// `s exp(-|x - x at the last reversal| / x0)`: it reverses over a distance.
    Turning(f64),
}

/// A stretch with data for each sample.
struct Piece<'a> {
    stretch: &'a Stretch,
    velocities: Vec<(f64, f64)>,
    signs: Vec<f64>,
    /// Samples at the centres of the rows.
    middles: Vec<usize>,
}

/// The rows of a run.
pub(super) struct Rows<'a> {
    kernels: Kernels,
    settings: Settings,
    law: Law,
    period_s: f64,
    pieces: Vec<Piece<'a>>,
    /// Force that the law must explain \[N\].
    pub force: Vec<f64>,
    /// Acceleration, velocity, its sign, one.
    pub base: [Vec<f64>; 4],
    /// Rows per independent observation.
    pub per_observation: f64,
    /// Stroke from end to end \[m\].
    pub stroke_m: f64,
}

impl<'a> Rows<'a> {
    /// Rows for all samples in motion of an aligned series, with signs placed by this law, and a margin of samples on
    /// either side of each row's kernel.
    pub fn of(series: &'a Series, settings: &Settings, bank: Bank, law: Law, margin: usize) -> Self {
        let period_s = series.period_s;
        let kernels = Kernels::new(bank, period_s);
        let near = kernels.reach() + kernels.box_samples;
        let reach = near + margin;
        let spacing = (kernels.box_samples / PER_BOX).max(1).max(series.len() / MOST_ROWS);
        let (mut force, mut base) = (Vec::new(), [const { Vec::new() }; 4]);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut pieces = Vec::new();
        for stretch in &series.stretches {
            let velocities = velocities(stretch, period_s, &law, settings);
            let signs: Vec<f64> = velocities.iter().copied().map(sign).collect();
            let still = still(stretch, &signs, period_s, settings, &law);
            let mut middles = Vec::new();
            for middle in (reach..stretch.force_n.len().saturating_sub(reach)).step_by(spacing) {
                if still.iter().skip(middle - near).take(2 * near).any(|still| *still) {
                    continue;
                }
                let measured = kernels.measured(stretch, settings, middle);
                middles.push(middle);
                force.push(measured.on_screw_n(settings));
                let sign = around(&kernels.sign, &signs, middle);
                let row = [measured.acceleration, measured.velocity, sign, 1.0];
                base.iter_mut().zip(row).for_each(|(column, value)| column.push(value));
                let position = stretch.position_m[middle];
                (low, high) = (low.min(position), high.max(position));
            }
            pieces.push(Piece { stretch, velocities, signs, middles });
        }
        let per_observation = (CORRELATION_BOXES * kernels.box_samples as f64 / spacing as f64).max(1.0);
        let stroke_m = (high - low).max(0.0);
        Self { kernels, settings: *settings, law, period_s, pieces, force, base, per_observation, stroke_m }
    }

    /// Number of independent observations.
    pub fn observations(&self) -> f64 {
        self.force.len() as f64 / self.per_observation
    }

    /// Length of the kernel's box \[s\].
    pub fn box_s(&self) -> f64 {
        self.kernels.box_samples as f64 * self.period_s
    }

    /// Root mean square of the velocity \[m/s\].
    pub fn velocity_rms(&self) -> f64 {
        let [_, velocity, ..] = &self.base;
        (dot(velocity, velocity) / velocity.len().max(1) as f64).sqrt()
    }

    /// Force that the law must explain, taken this many samples later \[N\]: at most the margin of the rows.
    pub fn force_late_by(&self, samples: isize) -> Vec<f64> {
        let of = |piece: &Piece, middle: &usize| {
            let later = middle.saturating_add_signed(samples);
            self.kernels.measured(piece.stretch, &self.settings, later).on_screw_n(&self.settings)
        };
        self.pieces.iter().flat_map(|piece| piece.middles.iter().map(move |middle| of(piece, middle))).collect()
    }

    /// The column of a delay of the force, per second: `-F'`.
    pub fn late(&self) -> Vec<f64> {
        self.through(|piece| piece.stretch.force_n.clone(), |kernels| &kernels.rate)
            .into_iter()
            .map(|rate| -rate)
            .collect()
    }

    /// The column of friction that reverses at another moment than the velocity, `s'`; `None` if hardly any row
    /// contains a reversal.
    pub fn turn(&self) -> Option<Vec<f64>> {
        let column = self.through(|piece| piece.signs.clone(), |kernels| &kernels.rate);
        let square = dot(&column, &column) * self.box_s().powi(2);
        (square > LEAST_TURNING * column.len() as f64).then_some(column)
    }

    /// The column of further friction.
    pub fn friction(&self, friction: Friction) -> Vec<f64> {
        let by_speed = |(before, after): (f64, f64), velocity: f64| {
            let size = (-0.5 * (before + after).abs() / velocity).exp();
            if size.is_nan() { 0.0 } else { size }
        };
        match friction {
            Friction::Load => {
                let offset_n = self.law.offset_n;
                self.signed(|piece| piece.stretch.force_n.iter().map(|force| (force - offset_n).abs()).collect())
            }
            Friction::Falling(velocity) => {
                self.signed(|piece| piece.velocities.iter().map(|pair| by_speed(*pair, velocity)).collect())
            }
            Friction::Turning(distance_m) => self.signed(|piece| turned(piece, distance_m)),
            Friction::Direction => self.through(path, |kernels| &kernels.rate),
        }
    }

    /// A quantity multiplied by the sign of the velocity.
    fn signed(&self, size: impl Fn(&Piece) -> Vec<f64>) -> Vec<f64> {
        let signal = |piece: &Piece| size(piece).iter().zip(&piece.signs).map(|(size, sign)| size * sign).collect();
        self.through(signal, |kernels| &kernels.sign)
    }

    /// A signal of each stretch, passed through a kernel.
    fn through(&self, signal: impl Fn(&Piece) -> Vec<f64>, taps: impl Fn(&Kernels) -> &[f64]) -> Vec<f64> {
        let taps = taps(&self.kernels);
        let each = self.pieces.iter().flat_map(|piece| {
            let signal = signal(piece);
            piece.middles.iter().map(move |middle| around(taps, &signal, *middle))
        });
        each.collect()
    }
}

/// Travel regardless of direction \[m\].
fn path(piece: &Piece) -> Vec<f64> {
    let positions = &piece.stretch.position_m;
    let mut path = vec![0.0];
    for ((a, b), sign) in positions.iter().zip(positions.iter().skip(1)).zip(&piece.signs) {
        path.push(path[path.len() - 1] + (b - a) * sign);
    }
    path
}

/// An exponential of the distance since the last reversal.
fn turned(piece: &Piece, distance_m: f64) -> Vec<f64> {
    let (mut from, mut last) = (f64::NAN, 0.0_f64);
    let each = piece.stretch.position_m.iter().zip(&piece.signs).map(|(position, sign)| {
        if sign * last < 0.0 {
            from = *position;
        }
        if *sign != 0.0 {
            last = *sign;
        }
        if from.is_nan() { 0.0 } else { (-(position - from).abs() / distance_m).exp() }
    });
    each.collect()
}

/// Samples where the screw is at rest, or reverses so slowly that friction may hold it; the device leaves them out too.
fn still(stretch: &Stretch, signs: &[f64], period_s: f64, settings: &Settings, law: &Law) -> Vec<bool> {
    let count_m = settings.metres_per_count.abs();
    let window = (REST_WINDOW_S / period_s).ceil() as usize;
    let weak_n = WEAK * law.coulomb_n.abs();
    let force_n = |at: usize| (stretch.force_n[at] - law.offset_n).abs();
    let mut still = vec![false; stretch.position_m.len()];
    for (at, seen) in stretch.position_m.windows(window + 1).enumerate() {
        if stands(seen, settings) {
            mark(&mut still, at.saturating_sub(window / 2), 2 * window);
        }
        let middle = at + window / 2;
        if (seen[window] - seen[0]).abs() <= GRAZING_COUNTS * count_m && force_n(middle) < weak_n {
            still[middle] = true;
        }
    }
    // A screw that friction can hold at a reversal may have stuck briefly.
    for (at, (still, sign)) in still.iter_mut().zip(signs).enumerate() {
        *still |= sign.abs() < 1.0 && force_n(at) < 0.5 * weak_n;
    }
    still
}
