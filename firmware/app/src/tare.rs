//! The mean force code of an unloaded sensor.

use inerter_core::Settings;

/// Force codes being averaged.
pub(crate) struct Tare {
    wanted: u32,
    /// Codes at or beyond these limits are saturated and do not count.
    least_code: i32,
    greatest_code: i32,
    taken: u32,
    sum: i64,
}

impl Tare {
    /// An average of `samples` samples under these settings.
    pub fn new(samples: u32, settings: &Settings) -> Self {
        let (least_code, greatest_code) = (settings.force_min_code as i32, settings.force_max_code as i32);
        Self { wanted: samples.max(1), least_code, greatest_code, taken: 0, sum: 0 }
    }

    /// Adds a code; returns the mean once there are enough.
    pub fn add(&mut self, force_code: i32) -> Option<i32> {
        if force_code <= self.least_code || force_code >= self.greatest_code {
            return None;
        }
        self.taken += 1;
        self.sum += i64::from(force_code);
        (self.taken >= self.wanted).then(|| rounded_mean(self.sum, self.taken))
    }
}

/// Mean of `count` numbers that add up to `sum`, rounded half away from zero.
fn rounded_mean(sum: i64, count: u32) -> i32 {
    let count = i64::from(count.max(1));
    let half = sum.signum() * (count / 2);
    ((sum + half) / count) as i32
}

#[cfg(test)]
mod tests {
    use super::rounded_mean;

    #[test]
    fn the_mean_rounds_half_away_from_zero() {
        assert_eq!(rounded_mean(5, 2), 3);
        assert_eq!(rounded_mean(-5, 2), -3);
        assert_eq!(rounded_mean(7, 3), 2);
        assert_eq!(rounded_mean(-8, 3), -3);
        assert_eq!(rounded_mean(i64::from(i32::MIN) * 500, 500), i32::MIN);
        assert_eq!(rounded_mean(0, 0), 0);
    }
}
