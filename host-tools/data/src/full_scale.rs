//! How fast a motion is, and whether the full-scale settings cover it: axes turn at tens of rad/s, inerters move at
//! tenths of m/s.

use inerter_core::{Counters, Machine, Settings};

use crate::{
    names::description,
    series::Series,
    settings::{Overrides, SettingsInputError, range_of},
};

/// Length over which velocity and acceleration are measured \[s\]: half a box of the fast bank, which smooths more.
const LENGTH_S: f64 = 0.008;
/// Margin above the largest value found.
const ROOM: f64 = 1.25;

/// Greatest velocity \[m/s\] and acceleration \[m/s^2\] of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Peaks {
    /// Velocity \[m/s\].
    pub velocity: f64,
    /// Acceleration \[m/s^2\].
    pub acceleration: f64,
}

impl Peaks {
    /// The peaks of all samples.
    pub fn of(series: &Series) -> Self {
        let m = (LENGTH_S / series.period_s).round().max(1.0);
        let length_s = m * series.period_s;
        let mut peaks = Self::default();
        for stretch in &series.stretches {
            let x = &stretch.position_m;
            let [later, latest] = [1, 2].map(|boxes| x.iter().skip(boxes * m as usize));
            for ((first, middle), last) in x.iter().zip(later).zip(latest) {
                peaks.velocity = peaks.velocity.max((last - first).abs() / (2.0 * length_s));
                peaks.acceleration = peaks.acceleration.max((last - 2.0 * middle + first).abs() / length_s.powi(2));
            }
        }
        peaks
    }

    /// Raises the full-scale settings that were not given, in powers of two, until they cover these peaks, as far as
    /// the other settings allow. A jump of the count is not motion; samples beyond full scale are left out.
    pub fn hold(&self, settings: &mut Settings, given: &Overrides) -> Result<(), SettingsInputError> {
        for (name, peak) in self.named() {
            let is_held = settings.get(name).is_none_or(|scale| ROOM * peak <= scale);
            if is_held || given.get(name).is_some() {
                continue;
            }
            let (_, most) = range_of(name);
            let mut scale = (ROOM * peak).log2().ceil().exp2().min(most);
            let is_usable = |scale: f64| {
                let mut tried = *settings;
                tried.set_by_name(name, scale).is_ok() && tried.validate().is_ok()
            };
            // Settings that are already invalid are reported as they are.
            let is_wrong_already = settings.validate().is_err();
            let is_raised = |scale: f64| settings.get(name).is_some_and(|before| scale > before);
            while is_raised(scale) && !is_wrong_already && !is_usable(scale) {
                scale *= 0.5;
            }
            if is_raised(scale) {
                settings
                    .set_by_name(name, scale)
                    .map_err(|source| SettingsInputError::Value { origin: "the motion".into(), source })?;
            }
        }
        Ok(())
    }

    /// The message if the estimator left samples out because they exceed full scale.
    pub fn beyond(&self, settings: &Settings, counters: &Counters) -> Option<String> {
        let beyond: Vec<(&str, f64)> = self
            .named()
            .into_iter()
            .filter(|(name, peak)| settings.get(name).is_some_and(|scale| *peak > scale))
            .collect();
        if counters.saturated == 0 || beyond.is_empty() {
            return None;
        }
        let set: Vec<String> =
            beyond.iter().map(|(name, peak)| format!("--set {name}={}", (ROOM * peak).log2().ceil().exp2())).collect();
        let Self { velocity, acceleration } = *self;
        let [per_s, per_s2] = match settings.machine {
            Machine::Linear => ["m/s", "m/s^2"],
            Machine::Rotary => ["rad/s", "rad/s^2"],
        };
        Some(description(
            settings.machine,
            &format!(
                "the motion reaches {velocity:.3} {per_s} and {acceleration:.3} {per_s2}, and samples beyond full scale are left out: {}",
                set.join(" ")
            ),
        ))
    }

    fn named(&self) -> [(&'static str, f64); 2] {
        [("full_scale_velocity_m_per_s", self.velocity), ("full_scale_acceleration_m_per_s2", self.acceleration)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::series::Stretch;

    #[test]
    fn full_scale_is_raised_to_a_motion_that_is_beyond_and_to_no_other() {
        let series = |size: f64| {
            let position_m = (0..5000).map(|n| size * (f64::from(n) * 0.06).sin()).collect();
            let stretch = Stretch { position_m, force_n: vec![0.0; 5000], ..Stretch::default() };
            Peaks::of(&Series { period_s: 1e-3, stretches: vec![stretch] })
        };
        let fast = series(0.5);
        assert!(
            (fast.velocity / 30.0 - 1.0).abs() < 0.05 && (fast.acceleration / 1800.0 - 1.0).abs() < 0.05,
            "{fast:?}"
        );
        let mut settings = Settings::default();
        series(0.02).hold(&mut settings, &Overrides::default()).unwrap();
        assert_eq!(settings, Settings::default());
        // A jump of 112 m in a sample: full scale rises as far as a sample's counts allow, not that far.
        let leap = Peaks { velocity: 1.4e4, acceleration: 3e6 };
        let mut leaping = Settings { sample_rate_hz: 234.0, metres_per_count: 1e-6, ..Settings::default() };
        leap.hold(&mut leaping, &Overrides::default()).unwrap();
        assert!(leaping.validate().is_ok() && leaping.full_scale_velocity_m_per_s == 8192.0, "{leaping:?}");
        let mut given = Overrides::default();
        given.set("full_scale_velocity_m_per_s", 3.0, "a test").unwrap();
        let mut kept = Settings { full_scale_velocity_m_per_s: 3.0, ..settings };
        fast.hold(&mut kept, &given).unwrap();
        assert_eq!([kept.full_scale_velocity_m_per_s, kept.full_scale_acceleration_m_per_s2], [3.0, 4096.0]);
        fast.hold(&mut settings, &Overrides::default()).unwrap();
        assert_eq!([settings.full_scale_velocity_m_per_s, settings.full_scale_acceleration_m_per_s2], [64.0, 4096.0]);
        let counters = Counters { saturated: 9, ..Counters::default() };
        assert_eq!(fast.beyond(&settings, &counters), None);
        let words = fast.beyond(&Settings { machine: Machine::Rotary, ..Settings::default() }, &counters).unwrap();
        assert!(words.contains("rad/s and") && words.contains("--set full_scale_velocity_m_per_s=64"), "{words}");
        assert_eq!(fast.beyond(&Settings::default(), &Counters::default()), None);
    }
}
