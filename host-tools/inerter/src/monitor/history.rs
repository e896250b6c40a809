//! Parameters over the whole run in bounded memory: when it is full, every second entry is removed, and from then on
//! only every second estimate is stored.

use std::array;

use inerter_core::{Interval, Machine};
use inerter_wire::{Estimated, catalogue};

/// Maximum number of entries; divisible by two.
const CAPACITY: usize = 8192;

/// Quantities per entry: the four parameters, and the backlash.
pub const QUANTITIES: usize = 5;

/// Value and interval of a quantity; the value is NaN if there is none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Value, SI; the backlash in micrometres.
    pub value: f32,
    /// Half width of the 95 % interval; infinite if unknown.
    pub u95: f32,
}

impl Point {
    const NONE: Self = Self { value: f32::NAN, u95: f32::INFINITY };

    /// Value and interval, if both are known.
    pub fn known(self) -> Option<(f64, f64)> {
        let u95 = if self.u95.is_finite() { self.u95 } else { 0.0 };
        self.value.is_finite().then_some((self.value.into(), u95.into()))
    }
}

/// What is kept of an estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// When \[s\].
    pub run_s: f64,
    /// The quantities in order.
    pub points: [Point; QUANTITIES],
}

impl Entry {
    /// The entry for an estimate with its detail.
    pub fn new(run_s: f64, Estimated { estimate, detail, .. }: &Estimated) -> Self {
        let point = |known: Option<Interval>, scale: f32| {
            known.map_or(Point::NONE, |Interval { value, u95 }| Point { value: value * scale, u95: u95 * scale })
        };
        let parameters = catalogue::parameters(Machine::Linear, &estimate.recent)
            .map(|(_, parameter)| point(parameter.known(), 1.0));
        let backlash = point(detail.and_then(|detail| detail.backlash.known()), 1e6);
        let mut points = parameters.chain([backlash]);
        Self { run_s, points: array::from_fn(|_| points.next().unwrap_or(Point::NONE)) }
    }
}

/// The whole run.
#[derive(Clone, Debug)]
pub struct History {
    entries: Vec<Entry>,
    stride: u32,
    skipped: u32,
}

impl Default for History {
    fn default() -> Self {
        Self { entries: Vec::with_capacity(CAPACITY), stride: 1, skipped: 0 }
    }
}

impl History {
    /// Adds an entry.
    pub fn push(&mut self, entry: Entry) {
        self.skipped += 1;
        if self.skipped < self.stride {
            return;
        }
        self.skipped = 0;
        if self.entries.len() == CAPACITY {
            let mut keep = false;
            self.entries.retain(|_| {
                keep = !keep;
                keep
            });
            self.stride = self.stride.saturating_mul(2);
        }
        self.entries.push(entry);
    }

    /// Entries from a time on, in order.
    pub fn since(&self, from_s: f64) -> &[Entry] {
        let start = self.entries.partition_point(|entry| entry.run_s < from_s);
        self.entries.get(start..).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_whole_run_stays_in_bounded_memory() {
        let mut history = History::default();
        for index in 0..100_000 {
            history.push(Entry { run_s: f64::from(index), points: [Point::NONE; QUANTITIES] });
        }
        let all = history.since(f64::NEG_INFINITY);
        assert!((CAPACITY / 2..=CAPACITY).contains(&all.len()) && history.entries.capacity() == CAPACITY);
        assert_eq!(all.first().map(|entry| entry.run_s), Some(0.0));
        assert!(all.last().is_some_and(|entry| entry.run_s > 99_980.0));
        assert!(all.windows(2).all(|pair| pair[1].run_s - pair[0].run_s <= 32.0), "evenly thinned");
        assert_eq!(history.since(2e5), []);
        assert_eq!(history.since(99_900.0).first().map(|entry| entry.run_s >= 99_900.0), Some(true));
    }

    #[test]
    fn what_is_not_known_has_no_value() {
        let entry = Entry::new(1.0, &Estimated::default());
        assert!(entry.points.iter().all(|point| point.known().is_none()));
    }
}
