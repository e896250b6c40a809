//! A scale from known steps: the line of readings over applied values, and its uncertainty.

use super::statistics::{Mean, Straight, together};
use crate::law::extent;

/// One step: the applied value, and the reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Applied value \[N or m\].
    pub applied: f64,
    /// Reading \[codes or counts\].
    pub reading: Mean,
}

impl Point {
    /// The applied value and the reading.
    pub(super) fn pair(&self) -> (f64, f64) {
        (self.applied, self.reading.value)
    }
}

/// Reading over applied value. All uncertainties are relative to the scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Reading per unit of the applied value.
    pub slope: f64,
    /// Reading at an applied value of zero.
    pub at_zero: f64,
    /// From the scatter about the line.
    pub scatter_u95: f64,
    /// Largest deviation of the mean at one applied value from the line, relative to the largest applied value.
    pub nonlinearity: f64,
    /// Half of the largest difference at one applied value between approaches from below and above, likewise relative;
    /// `None` if no value was approached from both sides.
    pub hysteresis: Option<f64>,
    /// Largest difference between the readings at zero, likewise relative; `None` if there are fewer than two.
    pub zero_return: Option<f64>,
    /// Largest uncertainty of a single reading, likewise relative.
    pub reading_u95: f64,
    /// The point that fits the line through the others worst.
    pub worst: usize,
    /// Change of the reading over all points.
    pub change: f64,
}

/// Applied values that differ by less than this fraction of the largest are the same.
const SAME: f64 = 1e-6;

/// Distinct applied values.
pub fn sizes(points: &[Point]) -> Vec<f64> {
    let greatest = greatest(points);
    let mut sizes: Vec<f64> = points.iter().map(|point| point.applied).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.dedup_by(|a, b| (*a - *b).abs() <= SAME * greatest);
    sizes
}

/// The largest applied value, whatever its sign.
pub(super) fn greatest(points: &[Point]) -> f64 {
    points.iter().map(|point| point.applied.abs()).fold(0.0, f64::max)
}

fn spread(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.collect();
    (values.len() > 1).then(|| extent(values.into_iter()))
}

fn average(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

impl Line {
    /// The line through at least three points with at least two applied values; otherwise `None`.
    pub fn through(points: &[Point]) -> Option<Self> {
        let (greatest, sizes) = (greatest(points), sizes(points));
        if points.len() < 3 || sizes.len() < 2 {
            return None;
        }
        let straight = Straight::through(&points.iter().map(Point::pair).collect::<Vec<_>>())?;
        let full = straight.slope.abs() * greatest;
        let same = |point: &Point, size: f64| (point.applied - size).abs() <= SAME * greatest;
        let readings =
            |size: f64| points.iter().filter(move |point| same(point, size)).map(|point| point.reading.value);
        let off = |size: &f64| average(readings(*size)).map_or(0.0, |mean| (mean - straight.at(*size)).abs());
        let come = |size: f64, from_below: bool| {
            let steps = points.iter().zip(points.iter().skip(1));
            average(
                steps
                    .filter(|(before, point)| same(point, size) && !same(before, size))
                    .filter(|(before, point)| (before.applied < point.applied) == from_below)
                    .map(|(_, point)| point.reading.value),
            )
        };
        let hysteresis = sizes.iter().filter_map(|size| Some((come(*size, true)? - come(*size, false)?).abs()));
        let zero_return = spread(readings(0.0));
        let reading = points.iter().map(|point| point.reading.u95).fold(0.0, f64::max);
        Some(Self {
            slope: straight.slope,
            at_zero: straight.at_zero,
            scatter_u95: straight.slope_u95 / straight.slope.abs(),
            nonlinearity: sizes.iter().map(off).fold(0.0, f64::max) / full,
            hysteresis: hysteresis.reduce(f64::max).map(|difference| 0.5 * difference / full),
            zero_return: zero_return.map(|difference| difference / full),
            reading_u95: reading / full,
            worst: worst(points),
            change: spread(points.iter().map(|point| point.reading.value)).unwrap_or(0.0),
        })
    }

    /// Relative uncertainty of the scale, including that of the applied values.
    pub fn u95(&self, applied_u95: f64) -> f64 {
        let (hysteresis, zero) = (self.hysteresis.unwrap_or(0.0), self.zero_return.unwrap_or(0.0));
        together([self.scatter_u95, self.nonlinearity, hysteresis, zero, self.reading_u95, applied_u95])
    }
}

/// The point without which the others fit a line best.
fn worst(points: &[Point]) -> usize {
    let left_over = |without: usize| {
        let others = points.iter().enumerate().filter(|(place, _)| *place != without);
        let rest: Vec<_> = others.map(|(_, point)| point.pair()).collect();
        let line = Straight::through(&rest);
        line.map_or(f64::INFINITY, |line| rest.iter().map(|(x, y)| (y - line.at(*x)).powi(2)).sum())
    };
    (0..points.len()).min_by(|a, b| left_over(*a).total_cmp(&left_over(*b))).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(list: &[(f64, f64)]) -> Vec<Point> {
        list.iter().map(|&(applied, value)| Point { applied, reading: Mean { value, u95: 0.0 } }).collect()
    }

    #[test]
    fn what_is_wrong_with_a_line_is_told_apart() {
        let straight = Line::through(&points(&[(0.0, 10.0), (5.0, 60.0), (10.0, 110.0), (0.0, 10.0)])).unwrap();
        assert!((straight.slope - 10.0).abs() < 1e-12 && (straight.at_zero - 10.0).abs() < 1e-9);
        assert!(straight.u95(0.0) < 1e-9 && (straight.u95(0.003) - 0.003).abs() < 1e-9);
        assert_eq!(straight.hysteresis, None);
        let late = Line::through(&points(&[(0.0, 0.0), (5.0, 49.0), (10.0, 100.0), (5.0, 51.0), (0.0, 1.0)])).unwrap();
        assert!((late.hysteresis.unwrap() - 0.01).abs() < 1e-3 && (late.zero_return.unwrap() - 0.01).abs() < 1e-3);
        let bent = Line::through(&points(&[(-10.0, -100.0), (0.0, 10.0), (10.0, 100.0), (0.0, 10.0)])).unwrap();
        assert!((bent.nonlinearity - 0.05).abs() < 1e-9, "{bent:?}");
        let wrong =
            Line::through(&points(&[(0.0, 0.0), (5.0, 50.0), (10.0, 10.0), (15.0, 150.0), (0.0, 0.0)])).unwrap();
        assert_eq!(wrong.worst, 2);
        assert!(Line::through(&points(&[(0.0, 0.0), (5.0, 50.0)])).is_none());
        assert!(Line::through(&points(&[(5.0, 50.0); 4])).is_none());
    }
}
