//! Signals over any time in bounded memory: rings of minimum and maximum values, each ring four times coarser than the
//! one before.
//!
//! A window is drawn from the coarsest ring that is still finer than the columns: the amount read does not grow with
//! the window, and no peak is lost.

use std::collections::VecDeque;

use super::feed::Sample;

/// Number of stored signals.
pub const SIGNALS: usize = 3;
/// Buckets in a ring.
const RING: usize = 4096;
/// Buckets of one ring that make one bucket of the next.
const FACTOR: u32 = 4;
/// Rings: at 4 kHz the last one holds three days.
const LEVELS: usize = 10;

/// The stored signals, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// Force \[N\].
    Force,
    /// Displacement of the screw \[mm\].
    Position,
    /// Displacement of the terminal \[mm\].
    Terminal,
}

/// Minimum and maximum values over an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bucket {
    /// Time of the first sample \[s\].
    pub start_s: f64,
    /// Time of the last one \[s\].
    pub end_s: f64,
    low: [f32; SIGNALS],
    high: [f32; SIGNALS],
}

impl Bucket {
    fn new(sample: &Sample) -> Self {
        let values = [
            sample.force_n as f32,
            (sample.position_m * 1e3) as f32,
            sample.terminal_m.map_or(f32::NAN, |terminal| (terminal * 1e3) as f32),
        ];
        Self { start_s: sample.at.run_s, end_s: sample.at.run_s, low: values, high: values }
    }

    /// Merges a later bucket into this one.
    fn join(&mut self, later: &Self) {
        self.end_s = later.end_s;
        // `min` and `max` ignore NaN.
        self.low.iter_mut().zip(later.low).for_each(|(low, other)| *low = low.min(other));
        self.high.iter_mut().zip(later.high).for_each(|(high, other)| *high = high.max(other));
    }

    /// Minimum and maximum of a signal; `None` if it has no values.
    pub fn range(&self, signal: Signal) -> Option<(f64, f64)> {
        let low = f64::from(*self.low.get(signal as usize)?);
        let high = f64::from(*self.high.get(signal as usize)?);
        (low.is_finite() && high.is_finite()).then_some((low, high))
    }
}

#[derive(Clone, Debug)]
struct Level {
    ring: VecDeque<Bucket>,
    /// The bucket being filled, and how many of the finer ones it holds.
    open: Option<(Bucket, u32)>,
}

/// All signals.
#[derive(Clone, Debug)]
pub struct Traces {
    levels: Vec<Level>,
    period_s: f64,
}

impl Default for Traces {
    fn default() -> Self {
        Self::new(1e-3)
    }
}

impl Traces {
    /// For samples with this period.
    pub fn new(period_s: f64) -> Self {
        let level = || Level { ring: VecDeque::with_capacity(RING), open: None };
        Self { levels: (0..LEVELS).map(|_| level()).collect(), period_s }
    }

    /// Adds a sample; times never go back.
    pub fn push(&mut self, sample: &Sample) {
        if self.latest_s().is_some_and(|latest| sample.at.run_s - latest > 1.5 * self.period_s) {
            // A bucket across a gap would draw a line across it.
            self.close();
        }
        let mut bucket = Bucket::new(sample);
        for level in &mut self.levels {
            keep(&mut level.ring, RING, bucket);
            let (open, count) = level.open.get_or_insert((bucket, 0));
            // The first bucket is merged with itself, which changes nothing.
            open.join(&bucket);
            *count += 1;
            let Some((full, _)) = level.open.take_if(|(_, count)| *count == FACTOR) else { break };
            bucket = full;
        }
    }

    /// Closes all partly filled buckets, each into its own ring.
    fn close(&mut self) {
        let mut carried: Option<Bucket> = None;
        for level in &mut self.levels {
            let open = level.open.take().map(|(bucket, _)| bucket);
            if let Some(bucket) = carried {
                keep(&mut level.ring, RING, bucket);
            }
            carried = match (open, carried) {
                (Some(mut open), Some(later)) => {
                    open.join(&later);
                    Some(open)
                }
                (open, later) => open.or(later),
            };
        }
    }

    /// Time of the latest sample \[s\].
    pub fn latest_s(&self) -> Option<f64> {
        Some(self.levels.first()?.ring.back()?.end_s)
    }

    /// Buckets that begin after `start_s`, as coarse as `resolution_s` allows.
    pub fn after(&self, start_s: f64, resolution_s: f64) -> impl Iterator<Item = &Bucket> {
        let ring = self.levels.get(self.level(resolution_s)).map(|level| &level.ring);
        ring.into_iter().flat_map(move |ring| ring.range(ring.partition_point(|bucket| bucket.start_s <= start_s)..))
    }

    /// The coarsest ring whose buckets are no longer than this.
    fn level(&self, resolution_s: f64) -> usize {
        let length_s = |level: usize| self.period_s * f64::from(FACTOR).powi(level as i32);
        (1..LEVELS).take_while(|level| length_s(*level) <= resolution_s).count()
    }

    /// The interval from `from_s` to `to_s` in at most `columns` buckets; there is none where samples are missing.
    pub fn window(&self, from_s: f64, to_s: f64, columns: usize) -> Vec<Bucket> {
        let column_s = (to_s - from_s) / columns.max(1) as f64;
        // Zero or less for an empty window.
        if column_s.is_nan() || column_s <= 0.0 {
            return Vec::new();
        }
        let Some(Level { ring, .. }) = self.levels.get(self.level(column_s)) else { return Vec::new() };
        let mut buckets: Vec<Bucket> = Vec::with_capacity(columns);
        let mut column = None;
        for bucket in ring.range(ring.partition_point(|bucket| bucket.end_s < from_s)..) {
            if bucket.start_s > to_s {
                break;
            }
            let place = ((bucket.start_s - from_s) / column_s).floor();
            match buckets.last_mut() {
                Some(last) if column == Some(place) => last.join(bucket),
                _ => buckets.push(*bucket),
            }
            column = Some(place);
        }
        buckets
    }
}

/// Appends to a list of bounded length, and removes the oldest item if needed.
pub fn keep<T>(list: &mut VecDeque<T>, most: usize, item: T) {
    if list.len() >= most {
        list.pop_front();
    }
    list.push_back(item);
}

#[cfg(test)]
mod tests {
    use super::{super::feed::Moment, *};

    fn sample(index: u32, force_n: f64) -> Sample {
        let at = Moment { run_s: f64::from(index) * 1e-3, unix_ns: 0 };
        Sample { at, force_n, position_m: f64::from(index) * 1e-6, terminal_m: None }
    }

    #[test]
    fn no_peak_is_lost_and_the_rest_is_bounded() {
        let mut traces = Traces::new(1e-3);
        for index in 0..200_000 {
            traces.push(&sample(index, if index == 123_457 { 50.0 } else { f64::from(index % 7) }));
        }
        assert_eq!(traces.latest_s(), Some(199.999));
        for (from_s, to_s, columns) in [(0.0, 200.0, 300), (100.0, 150.0, 100), (123.4, 123.5, 80)] {
            let window = traces.window(from_s, to_s, columns);
            assert!(window.len() <= columns + 1 && window.len() + 2 > columns.min(window.len()), "{}", window.len());
            let greatest = window.iter().filter_map(|bucket| bucket.range(Signal::Force)).map(|(_, high)| high);
            // The finest ring has overwritten it long ago, the coarser ones have not.
            let expected = if to_s - from_s < 1.0 { None } else { Some(50.0) };
            assert_eq!(greatest.reduce(f64::max), expected, "{from_s} to {to_s}");
        }
        assert!(traces.levels.iter().all(|level| level.ring.len() <= RING && level.ring.capacity() <= 2 * RING));
        assert!(traces.window(0.0, 1.0, 0).len() <= 1 && traces.window(1.0, 1.0, 10).is_empty());
        assert!(traces.window(0.0, f64::NAN, 10).is_empty());
    }

    #[test]
    fn a_hole_stays_a_hole() {
        let mut traces = Traces::new(1e-3);
        for index in (0..1000).chain(3000..5003) {
            traces.push(&sample(index, 1.0));
        }
        let window = traces.window(0.0, 5.0, 100);
        assert!(window.iter().all(|bucket| bucket.end_s < 1.0 || bucket.start_s >= 3.0), "{window:?}");
        let inside = |from_s: f64, to_s: f64| window.iter().filter(|b| b.start_s >= from_s && b.end_s < to_s).count();
        assert!(inside(0.0, 1.0) >= 18 && inside(3.0, 5.0) >= 38);
        assert_eq!(window.first().and_then(|bucket| bucket.range(Signal::Terminal)), None);
    }
}
