//! Axes: converts values to pixels, and places the ticks.

use std::ops::Range;

use plotters::coord::{
    ranged1d::{BoldPoints, DefaultFormatting, KeyPointHint, Ranged},
    types::RangedCoordf64,
};

/// Maximum decimals of a label; beyond that it uses a power of ten.
const MOST_DECIMALS: usize = 4;

/// Linear or logarithmic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Equal steps are equal differences.
    Linear,
    /// Equal steps are equal ratios.
    Log,
}

impl Scale {
    /// The value as plotted: itself, or its decimal logarithm, which is not finite if undefined.
    pub fn apply(self, value: f64) -> f64 {
        match self {
            Self::Linear => value,
            Self::Log => value.log10(),
        }
    }

    /// The value for a plotted coordinate.
    pub fn undo(self, laid_out: f64) -> f64 {
        match self {
            Self::Linear => laid_out,
            Self::Log => 10f64.powf(laid_out),
        }
    }
}

/// An axis of either kind, with its ticks.
#[derive(Clone, Debug)]
pub struct Coordinate {
    scale: Scale,
    range: Range<f64>,
    laid_out: Range<f64>,
    ticks: Vec<f64>,
    minor: Vec<f64>,
}

impl Coordinate {
    /// An axis from `low` to `high` with at most about this many labels.
    pub fn new(scale: Scale, (low, high): (f64, f64), labels: usize) -> Self {
        let laid_out = scale.apply(low)..scale.apply(high);
        let (ticks, minor) = match scale {
            Scale::Linear => {
                let ticks = |labels| RangedCoordf64::from(low..high).key_points(BoldPoints(labels));
                // Some ranges have too few round values at first.
                let enough = (labels..labels + 6).map(ticks).find(|ticks| ticks.len() > 2);
                (enough.unwrap_or_else(|| ticks(labels + 6)), Vec::new())
            }
            Scale::Log => log_ticks(low, high, labels),
        };
        Self { scale, range: low..high, laid_out, ticks, minor }
    }

    /// Length of the longest label, in characters.
    pub fn longest_label(&self) -> usize {
        self.ticks.iter().map(|tick| self.label(*tick).chars().count()).max().unwrap_or(0)
    }

    /// Label of a tick: plain digits with a true minus sign, or powers of ten where there would be many zeros.
    pub fn label(&self, value: f64) -> String {
        let text = match self.scale {
            Scale::Log => log_label(value),
            Scale::Linear => {
                let steps = self.ticks.windows(2).map(|pair| pair.iter().fold(0.0, |last, tick| tick - last).abs());
                let step = steps.fold(f64::INFINITY, f64::min);
                // The fewest decimals that distinguish adjacent labels; 1e-9 allows for 0.2 rounded to 0.19999.
                let decimals = (0..15).find(|decimals| {
                    let scaled = step * 10f64.powi(*decimals);
                    (scaled - scaled.round()).abs() < 1e-6 * scaled && scaled >= 1.0 - 1e-9
                });
                let decimals = decimals.unwrap_or(2) as usize;
                // Avoids a negative zero.
                let value = if value.abs() < 1e-9 * step { 0.0 } else { value };
                let greatest = self.ticks.iter().fold(0.0_f64, |most, tick| most.max(tick.abs()));
                let exponent = (greatest.log10() + 1e-9).floor();
                if decimals <= MOST_DECIMALS || value == 0.0 || !exponent.is_finite() {
                    format!("{value:.*}", if value == 0.0 && decimals > MOST_DECIMALS { 0 } else { decimals })
                } else {
                    let decimals = (decimals as f64 + exponent).max(0.0) as usize;
                    format!("{:.decimals$}·10{}", value / 10f64.powf(exponent), raised(exponent as i32))
                }
            }
        };
        text.replace('-', "\u{2212}")
    }
}

/// Ticks with labels, and those without, at whole multiples of powers of ten.
fn log_ticks(low: f64, high: f64, labels: usize) -> (Vec<f64>, Vec<f64>) {
    let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
    let inside = |value: &f64| *value >= low * (1.0 - 1e-9) && *value <= high * (1.0 + 1e-9);
    let multiples = |wanted: &[f64], every: i32| -> Vec<f64> {
        let decades = (first..=last).filter(|decade| decade % every == 0);
        let all = decades.flat_map(|decade| wanted.iter().map(move |digit| digit * 10f64.powi(decade)));
        all.filter(inside).collect()
    };
    let every = |count: i32| (1..).find(|every| count / every <= labels as i32).unwrap_or(1);
    let ones = multiples(&[1.0], every(last - first));
    let candidates =
        [multiples(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0], 1), multiples(&[1.0, 2.0, 5.0], 1), multiples(&[1.0, 3.0], 1)];
    let ticks = candidates.into_iter().find(|ticks| ticks.len() <= labels).unwrap_or(ones);
    (ticks, multiples(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0], 1))
}

fn log_label(value: f64) -> String {
    let exponent = (value.log10() + 1e-9).floor() as i32;
    if (-4..5).contains(&exponent) {
        let decimals = (-exponent).max(0) as usize;
        return format!("{value:.decimals$}");
    }
    let digit = (value / 10f64.powi(exponent)).round() as i32;
    let power = raised(exponent);
    if digit == 1 { format!("10{power}") } else { format!("{digit}·10{power}") }
}

fn raised(exponent: i32) -> String {
    exponent.to_string().chars().map(superscript).collect()
}

fn superscript(letter: char) -> char {
    let raised = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    letter.to_digit(10).and_then(|digit| raised.get(digit as usize).copied()).unwrap_or('⁻')
}

impl Ranged for Coordinate {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        let part = (self.scale.apply(*value) - self.laid_out.start) / (self.laid_out.end - self.laid_out.start);
        // Beyond the axis but bounded: the conversion saturates, an addition would not.
        let part = if part.is_finite() { part.clamp(-4.0, 4.0) } else { 0.0 };
        from + (part * f64::from(to - from)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() { self.minor.clone() } else { self.ticks.clone() }
    }

    fn range(&self) -> Range<f64> {
        self.range.clone()
    }
}

/// The minimum and the maximum of the values.
pub(crate) fn ends(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

/// The range of the values plus a margin; never empty.
pub fn around(scale: Scale, values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = ends(values.map(|value| scale.apply(value)).filter(|value| value.is_finite()));
    let (low, high) = match scale {
        _ if low > high => (0.0, 1.0),
        Scale::Linear if high - low <= 1e-9 * high.abs().max(low.abs()).max(1e-12) => {
            let room = if high == 0.0 { 1e-3 } else { 0.1 * high.abs() };
            (low - room, high + room)
        }
        Scale::Log if high - low < 0.02 => (low - 0.1, high + 0.1),
        _ => (low - 0.05 * (high - low), high + 0.05 * (high - low)),
    };
    (scale.undo(low), scale.undo(high))
}
