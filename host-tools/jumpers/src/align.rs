//! Aligns samples with steps, using the counts, which have no noise.

use std::ops::Range;

use crate::recording::Recording;
use crate::tape::Tape;

/// Ticks of the sampling clock per sample: the test runs at 1 kHz.
pub const ENTRIES: usize = 64;
/// A count further than this from the encoder's rest position has left it.
const LEFT_COUNTS: f64 = 3.0;
/// Steps around the first guess that are searched.
const TRIED: i64 = 4 * ENTRIES as i64;

/// Position of a recording's samples on its tape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aligned {
    /// Step at the first sample's first entry, negative if that is before the tape.
    pub lag: i64,
    /// Counts seen per count played.
    pub ratio: f64,
    /// Residual, rms \[counts\].
    pub residual_counts: f64,
}

impl Aligned {
    /// The steps of a sample.
    pub fn steps(&self, sample: usize) -> Range<i64> {
        let first = self.lag + (sample * ENTRIES) as i64;
        first..first + ENTRIES as i64
    }
}

/// Cumulative sums of a quantity over the steps, constant beyond both ends.
pub struct Sums {
    sums: Vec<f64>,
    first: f64,
    last: f64,
}

impl Sums {
    /// From its value at each step; there must be at least one.
    pub fn new(values: impl Iterator<Item = f64>) -> Self {
        let (mut sums, mut first, mut last) = (vec![0.0], None, 0.0);
        let mut sum = 0.0;
        for value in values {
            first.get_or_insert(value);
            last = value;
            sum += value;
            sums.push(sum);
        }
        Self { sums, first: first.unwrap_or(0.0), last }
    }

    fn before(&self, step: i64) -> f64 {
        let end = self.sums.len() as i64 - 1;
        let inside = self.sums[step.clamp(0, end) as usize];
        inside + self.first * step.min(0) as f64 + self.last * (step - end).max(0) as f64
    }

    /// Mean over steps.
    pub fn mean(&self, steps: Range<i64>) -> f64 {
        (self.before(steps.end) - self.before(steps.start)) / (steps.end - steps.start) as f64
    }
}

/// Positions of a recording from its first sample on \[counts\].
pub fn positions(recording: &Recording) -> Vec<f64> {
    let first = recording.samples.first().map_or(0, |sample| sample.position_count);
    let counts = |sample: &inerter_core::RawSample| f64::from(sample.position_count.wrapping_sub(first));
    recording.samples.iter().map(|sample| counts(sample) / ENTRIES as f64).collect()
}

/// Finds the lag; `None` if the count never moves. Samples must be consecutive.
pub fn align(tape: &Tape, recording: &Recording) -> Option<Aligned> {
    let counts = Sums::new(tape.steps().iter().map(|step| f64::from(step.count)));
    let positions = positions(recording);
    let left = |from: f64| positions.iter().position(|count| (count - from).abs() > LEFT_COUNTS);
    let first_left = left(0.0)?;
    let step_left = tape.steps().iter().position(|step| f64::from(step.count).abs() > LEFT_COUNTS)?;
    let guess = step_left as i64 - (first_left * ENTRIES) as i64;
    (guess - TRIED..=guess + TRIED)
        .map(|lag| {
            let trial = Aligned { lag, ratio: 0.0, residual_counts: 0.0 };
            // At the edges, when the pins begin and cease to be driven, the pull-ups' levels may be counted.
            let inside = |steps: &Range<i64>| steps.start >= 0 && steps.end <= tape.steps().len() as i64;
            let samples = positions.iter().enumerate().map(|(sample, position)| (trial.steps(sample), *position));
            let pairs = samples.filter(|(steps, _)| inside(steps)).map(|(steps, seen)| (counts.mean(steps), seen));
            let line = Line::fit(pairs);
            Aligned { ratio: line.slope, residual_counts: line.rms, ..trial }
        })
        .min_by(|one, other| one.residual_counts.total_cmp(&other.residual_counts))
}

/// A straight line by least squares.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Line {
    /// Change of the second quantity with the first.
    pub slope: f64,
    /// The second quantity where the first is 0.
    pub offset: f64,
    /// Residual, rms.
    pub rms: f64,
    /// Largest residual.
    pub worst: f64,
}

impl Line {
    /// The line through these pairs.
    pub fn fit(pairs: impl Iterator<Item = (f64, f64)>) -> Self {
        let pairs: Vec<_> = pairs.collect();
        let count = pairs.len().max(1) as f64;
        let (x, y) = pairs.iter().fold((0.0, 0.0), |(x, y), pair| (x + pair.0 / count, y + pair.1 / count));
        let (xx, xy) = pairs
            .iter()
            .fold((0.0, 0.0), |(xx, xy), pair| (xx + (pair.0 - x).powi(2), xy + (pair.0 - x) * (pair.1 - y)));
        let slope = if xx > 0.0 { xy / xx } else { 0.0 };
        let offset = y - slope * x;
        let left = |pair: &(f64, f64)| pair.1 - offset - slope * pair.0;
        let rms = (pairs.iter().map(|pair| left(pair).powi(2)).sum::<f64>() / count).sqrt();
        let worst = pairs.iter().map(|pair| left(pair).abs()).fold(0.0, f64::max);
        Self { slope, offset, rms, worst }
    }
}
