//! Raw samples in SI units: one by one, or a whole run as stretches without a discontinuity.

use std::borrow::Cow;

use inerter_core::{RawSample, Settings};
use inerter_wire::step;

use crate::run::Run;

/// One sample in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Sample periods since the first sample, including missing ones.
    pub elapsed: u64,
    /// Unwrapped encoder count: the sum of `oversampling` counts, as the device latches them.
    pub count: i64,
    /// Displacement of the screw, with the sign of the setting `metres_per_count` \[m\].
    pub position_m: f64,
    /// Force, less the code at zero force \[N\].
    pub force_n: f64,
    /// Displacement of the terminal; `None` without such a sensor \[m\].
    pub terminal_m: Option<f64>,
    /// The force is at or beyond a rail.
    pub saturated: bool,
}

/// Converts raw samples to points; the first one fixes the origin of time, not of position.
#[derive(Clone, Debug)]
pub struct Converter {
    settings: Settings,
    metres_per_code: f64,
    before: Option<(RawSample, u64, i64)>,
}

impl Converter {
    /// For samples that were taken with these settings.
    pub fn new(settings: &Settings) -> Self {
        let metres_per_code = settings.metres_per_count / settings.oversampling;
        Self { settings: *settings, metres_per_code, before: None }
    }

    /// The next sample.
    pub fn point(&mut self, sample: &RawSample) -> Point {
        let (elapsed, count) = match self.before {
            None => (0, i64::from(sample.position_count)),
            Some((last, elapsed, count)) => (
                elapsed + step(last.index, sample.index),
                count + i64::from(sample.position_count.wrapping_sub(last.position_count)),
            ),
        };
        self.before = Some((*sample, elapsed, count));
        let settings = &self.settings;
        let code = f64::from(sample.force_code);
        Point {
            elapsed,
            count,
            position_m: count as f64 * self.metres_per_code,
            force_n: (code - settings.force_zero_code) * settings.newtons_per_code,
            terminal_m: settings
                .terminal_sensor
                .then(|| f64::from(sample.terminal_code) * settings.metres_per_terminal_code),
            saturated: code <= settings.force_min_code || code >= settings.force_max_code,
        }
    }
}

/// Consecutive samples, none missing and none left out; all columns have the same length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stretch {
    /// Time of the first sample \[s\].
    pub start_s: f64,
    /// Displacement of the screw \[m\].
    pub position_m: Vec<f64>,
    /// Force \[N\].
    pub force_n: Vec<f64>,
    /// Displacement of the terminal \[m\]; empty without such a sensor.
    pub terminal_m: Vec<f64>,
}

/// A run in SI units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// Sample period \[s\].
    pub period_s: f64,
    /// In order of time; split at discontinuities and at samples that are left out, as saturated ones are.
    pub stretches: Vec<Stretch>,
}

impl Series {
    /// The series of a whole run.
    pub fn of(run: &Run) -> Self {
        Self::without(run, |_, _| false, |_| false)
    }

    /// A run without some of its samples, and split before others; both are selected by their index.
    pub(crate) fn without(
        run: &Run,
        is_left_out: impl Fn(usize, &RawSample) -> bool,
        is_parted: impl Fn(usize) -> bool,
    ) -> Self {
        let period_s = 1.0 / run.settings.sample_rate_hz;
        let mut converter = Converter::new(&run.settings);
        let (mut stretches, mut next): (Vec<Stretch>, _) = (Vec::new(), None);
        for (n, sample) in run.samples.iter().enumerate() {
            let point = converter.point(sample);
            if point.saturated || is_left_out(n, sample) {
                next = None;
                continue;
            }
            if next != Some(point.elapsed) || is_parted(n) {
                let start_s = run.start_s + point.elapsed as f64 * period_s;
                stretches.push(Stretch { start_s, ..Stretch::default() });
            }
            next = Some(point.elapsed + 1);
            if let Some(stretch) = stretches.last_mut() {
                stretch.position_m.push(point.position_m);
                stretch.force_n.push(point.force_n);
                stretch.terminal_m.extend(point.terminal_m);
            }
        }
        Self { period_s, stretches }
    }

    /// Removes everything before a time \[s\].
    pub fn cut_before(&mut self, from_s: f64) {
        let period_s = self.period_s;
        for stretch in &mut self.stretches {
            let early = ((from_s - stretch.start_s) / period_s - 1e-6).ceil().max(0.0) as usize;
            for column in [&mut stretch.position_m, &mut stretch.force_n, &mut stretch.terminal_m] {
                column.drain(..early.min(column.len()));
            }
            stretch.start_s += early as f64 * period_s;
        }
        self.stretches.retain(|stretch| !stretch.force_n.is_empty());
    }

    /// Pairs force and position of the same instant, by whole samples of the skew; the fractional rest remains
    /// ([`Settings::skew_parts`]).
    pub fn aligned(&self, settings: &Settings) -> Cow<'_, Self> {
        let (late, _) = settings.skew_parts();
        let by = late.unsigned_abs() as usize;
        if by == 0 {
            return Cow::Borrowed(self);
        }
        let stretches = self.stretches.iter().filter(|stretch| stretch.force_n.len() > by).map(|stretch| {
            let mut stretch = stretch.clone();
            let left = stretch.force_n.len() - by;
            for (column, is_force) in
                [(&mut stretch.force_n, true), (&mut stretch.position_m, false), (&mut stretch.terminal_m, false)]
            {
                if is_force == (late > 0) {
                    column.drain(..by.min(column.len()));
                } else {
                    column.truncate(left);
                }
            }
            if late < 0 {
                stretch.start_s += by as f64 * self.period_s;
            }
            stretch
        });
        Cow::Owned(Self { period_s: self.period_s, stretches: stretches.collect() })
    }

    /// Samples in all stretches.
    pub fn len(&self) -> usize {
        self.stretches.iter().map(|stretch| stretch.force_n.len()).sum()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn discontinuities_and_saturation_split_a_run_and_counts_do_not_wrap() {
        let settings = Settings {
            metres_per_count: 2e-6,
            oversampling: 2.0,
            newtons_per_code: 0.5,
            force_zero_code: 10.0,
            force_max_code: 1000.0,
            sample_rate_hz: 1000.0,
            ..Settings::default()
        };
        let sample =
            |index, position_count, force_code| RawSample { index, position_count, force_code, terminal_code: 0 };
        let samples = vec![
            sample(7, i32::MAX, 12),
            sample(8, i32::MIN, 14),
            sample(9, i32::MIN + 1, 1000),
            sample(10, i32::MIN + 2, 16),
            sample(14, i32::MIN + 3, 18),
        ];
        let run = Run { settings, samples, start_s: 2.0, ..Run::default() };
        let series = Series::of(&run);
        let starts: Vec<f64> = series.stretches.iter().map(|stretch| stretch.start_s).collect();
        assert_eq!(starts, [2.0, 2.0 + 3e-3, 2.0 + 7e-3]);
        let first = &series.stretches[0];
        assert_eq!(first.force_n, [1.0, 2.0]);
        assert_eq!(first.position_m, [f64::from(i32::MAX) * 1e-6, 2_147_483_648.0 * 1e-6]);
        assert!(first.terminal_m.is_empty());
        assert_eq!((series.len(), series.is_empty(), series.period_s), (4, false, 1e-3));
        let mut later = series.clone();
        later.cut_before(2.001);
        assert_eq!((later.len(), later.stretches[0].start_s, &later.stretches[0].force_n), (3, 2.001, &vec![2.0]));
        later.cut_before(2.005);
        assert_eq!(later.stretches, series.stretches[2..]);
    }

    #[test]
    fn what_is_of_one_moment_is_aligned() {
        let of = |late: i32| {
            let moments = |from: i32| (from..from + 10).map(f64::from).collect::<Vec<_>>();
            let stretch =
                Stretch { start_s: 1.0, position_m: moments(0), force_n: moments(-late), terminal_m: moments(0) };
            let series = Series { period_s: 0.1, stretches: vec![stretch] };
            let settings = Settings { sample_rate_hz: 1000.0, skew_s: f64::from(late) * 1e-3, ..Settings::default() };
            series.aligned(&settings).into_owned().stretches.remove(0)
        };
        for (late, start_s) in [(-3, 1.3), (0, 1.0), (1, 1.0), (4, 1.0)] {
            let Stretch { start_s: found_s, position_m, force_n, terminal_m } = of(late);
            assert!((found_s - start_s).abs() < 1e-9, "{late}: {found_s}");
            assert_eq!(force_n.len(), 10 - late.unsigned_abs() as usize);
            assert!(force_n == position_m && force_n == terminal_m, "{late}: {force_n:?} {position_m:?}");
        }
    }
}
