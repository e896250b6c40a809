//! The level of a force at rest, and whether it is at rest.
//!
//! A window of fifteen blocks moves along the samples. It is steady if the blocks' means differ by no more than white
//! noise, a code or 0.02 % of the load explain, and the screw stands still. Then the level is their mean, and its
//! interval comes from their scatter, so that drift and oscillation widen it.

use std::collections::VecDeque;

use inerter_core::{RawSample, Settings};
use inerter_data::{names::unit, words::amount_text};

use super::{
    CalibrateError, Finding, Step,
    finding::Level as Rank,
    statistics::{Mean, mean_of_blocks, together},
};
use crate::law::extent;

/// Blocks in a window: at 3 s each is 0.2 s, whole cycles of both 50 and 60 Hz.
const BLOCKS: usize = 15;
/// Allowed difference of the means, in white-noise deviations of a block's mean: fifteen of them exceed it once in 1e4.
const NOISE_FACTOR: f64 = 7.0;
/// Allowed difference of the means as a fraction of the load: well below the other uncertainties.
const LOAD_PART: f64 = 2e-4;
/// Allowed movement of the screw within a window, in counts: an encoder at the edge of a count toggles by one.
const MOST_COUNTS: f64 = 2.0;

/// A force at rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Level {
    /// Mean code.
    pub code: Mean,
    /// Encoder count at this level, of one conversion.
    pub count: Mean,
    /// White noise of one sample, rms \[codes\].
    pub noise_code: f64,
    /// Length of the window \[s\].
    pub seconds: f64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Block {
    code: f64,
    count: f64,
    least_count: f64,
    most_count: f64,
    /// Sum of squares of the codes' differences.
    differences: f64,
    saturated: usize,
}

/// What must come to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Of {
    /// Force and screw.
    Force,
    /// The screw, whatever the force does.
    Position,
}

/// Detects rest in samples as they arrive.
#[derive(Clone, Debug)]
pub struct Watch {
    settings: Settings,
    of: Of,
    /// Length of the window \[s\].
    seconds: f64,
    per_block: usize,
    /// Number of samples so far.
    heard: usize,
    blocks: VecDeque<Block>,
    now: Block,
    last_code: Option<f64>,
    /// Position from which encoder counts are measured, once there is one.
    pub origin: Option<i32>,
}

impl Watch {
    /// For a window of this length; encoder counts are measured from `origin`, or else from the first sample.
    pub fn new(settings: &Settings, of: Of, seconds: f64, origin: Option<i32>) -> Self {
        let per_block = (seconds * settings.sample_rate_hz / BLOCKS as f64).ceil().max(2.0) as usize;
        Self {
            settings: *settings,
            of,
            seconds,
            per_block,
            heard: 0,
            blocks: VecDeque::with_capacity(BLOCKS),
            now: Block::default(),
            last_code: None,
            origin,
        }
    }

    /// Processes the next sample; true if a block is complete and [`level`](Self::level) may have changed.
    pub fn take(&mut self, sample: &RawSample) -> bool {
        let code = f64::from(sample.force_code);
        let origin = *self.origin.get_or_insert(sample.position_count);
        let count = f64::from(sample.position_count.wrapping_sub(origin)) / self.settings.oversampling;
        if self.heard.is_multiple_of(self.per_block) {
            self.now = Block { least_count: count, most_count: count, ..Block::default() };
        }
        let now = &mut self.now;
        now.code += code;
        now.count += count;
        now.least_count = now.least_count.min(count);
        now.most_count = now.most_count.max(count);
        now.differences += self.last_code.replace(code).map_or(0.0, |last| (code - last).powi(2));
        now.saturated += usize::from(code <= self.settings.force_min_code || code >= self.settings.force_max_code);
        self.heard += 1;
        if !self.heard.is_multiple_of(self.per_block) {
            return false;
        }
        let samples = self.per_block as f64;
        now.code /= samples;
        now.count /= samples;
        if self.blocks.len() == BLOCKS {
            self.blocks.pop_front();
        }
        self.blocks.push_back(*now);
        true
    }

    /// Time for which it has listened \[s\].
    pub fn heard_s(&self) -> f64 {
        self.heard as f64 / self.settings.sample_rate_hz
    }

    /// The level in the latest window, or why it is not at rest; `at` says where, for a person.
    pub fn level(&self, at: &str) -> Result<Level, CalibrateError> {
        if self.blocks.len() < BLOCKS {
            return Err(CalibrateError::TooShort { seconds: self.heard_s(), needed: self.seconds });
        }
        let at = at.to_string();
        let samples = (BLOCKS * self.per_block) as f64;
        let saturated: usize = self.blocks.iter().map(|block| block.saturated).sum();
        if saturated > 0 && self.of == Of::Force {
            return Err(CalibrateError::Saturated { at, share: 100.0 * (saturated as f64 / samples) });
        }
        let range = |of: fn(&Block) -> [f64; 2]| extent(self.blocks.iter().flat_map(of));
        let counts = range(|block| [block.least_count, block.most_count]);
        if counts > MOST_COUNTS {
            return Err(CalibrateError::Moving { at, counts });
        }
        let differences: f64 = self.blocks.iter().map(|block| block.differences).sum();
        let noise_code = (0.5 * differences / samples).sqrt();
        let mean = |of: fn(&Block) -> f64| mean_of_blocks(&self.blocks.iter().map(of).collect::<Vec<_>>());
        let code = mean(|block| block.code);
        let load = (code.value - self.settings.force_zero_code).abs();
        let by_noise = NOISE_FACTOR * noise_code / (self.per_block as f64).sqrt();
        let allowed_code = together([by_noise, LOAD_PART * load]) + 1.0;
        let wander_code = range(|block| [block.code; 2]);
        if wander_code > allowed_code && self.of == Of::Force {
            let [wander, allowed] = [wander_code, allowed_code].map(|code| code * self.settings.newtons_per_code.abs());
            let unit = unit(self.settings.machine, "N");
            return Err(CalibrateError::Unsteady { at, wander, allowed, unit });
        }
        let seconds = samples / self.settings.sample_rate_hz;
        Ok(Level { code, count: mean(|block| block.count), noise_code, seconds })
    }
}

/// The level in a series of samples, at the first window of `seconds` that is at rest.
pub fn level(samples: &[RawSample], settings: &Settings, seconds: f64, at: &str) -> Result<Level, CalibrateError> {
    let mut watch = Watch::new(settings, Of::Force, seconds, None);
    for sample in samples {
        if watch.take(sample) && watch.level(at).is_ok() {
            break;
        }
    }
    watch.level(at)
}

/// The code at zero force.
pub fn zero(level: &Level, settings: &Settings) -> Finding {
    let mut finding = Finding::new(Step::Zero);
    let zero = level.code.value.round();
    // A whole code is wrong by up to a half.
    let u95 = together([level.code.u95, 0.475]);
    let newtons = settings.newtons_per_code.abs();
    let shift = zero - settings.force_zero_code;
    finding.set_with("force_zero_code", zero, u95);
    finding.measure_all([
        ("mean_code", level.code.value),
        ("zero_u95_n", u95 * newtons),
        ("shift_n", shift * newtons),
        ("noise_code", level.noise_code),
    ]);
    finding.say(format!("code at no force {zero:.0} ± {u95:.1}, over {:.1} s", level.seconds));
    finding.say(format!(
        "that is {} {unit} from the zero in use, ± {} {unit}, by the force scale in use",
        amount_text(shift * settings.newtons_per_code, 4),
        amount_text(u95 * newtons, 4),
        unit = unit(settings.machine, "N")
    ));
    let (least, most) = (settings.force_min_code, settings.force_max_code);
    let room = (zero - least).min(most - zero) / (most - least);
    if room < 0.15 {
        finding.remark(
            Rank::Doubtful,
            "off_centre",
            format!(
                "only {:.0} % of the range is left on one side of zero: adjust the amplifier's offset",
                100.0 * room
            ),
        );
    }
    finding
}

#[cfg(test)]
mod tests {
    use inerter_plant::{Inerter, Sensors};
    use inerter_simulate::{Setup, bench_sensors};

    use super::*;
    use crate::simulated::{recorded, setup};

    fn samples(sensors: Sensors, motion: &str, load_n: f64, seconds: f64) -> (Vec<RawSample>, Settings) {
        let run = recorded(&Setup { load_n, ..setup(Inerter::paper(), sensors, motion, seconds) });
        (run.samples, run.settings)
    }

    #[test]
    fn the_zero_lies_within_its_interval_over_many_seeds() {
        let mut within = 0;
        for seed in 0..40 {
            let sensors = Sensors { seed, force_zero_code: 321.0, pickup_n: 2.0, ..bench_sensors() };
            let (samples, settings) = samples(sensors, "hold", 0.0, 4.0);
            let level = level(&samples, &settings, 3.0, "").unwrap();
            let finding = zero(&level, &settings);
            let (value, u95) =
                (finding.values["force_zero_code"].as_f64().unwrap(), finding.u95["force_zero_code"].as_f64().unwrap());
            assert!(u95 < 40.0, "{u95}");
            within += u32::from((value - 321.0).abs() <= u95);
        }
        // Of 40, 38 are expected.
        assert!((36..=40).contains(&within), "{within}");
    }

    #[test]
    fn what_is_not_at_rest_is_refused_and_says_why() {
        let refusal = |sensors, motion, load_n| {
            let (samples, settings) = samples(sensors, motion, load_n, 5.0);
            level(&samples, &settings, 3.0, "").unwrap_err()
        };
        let drifting = Sensors { force_drift_n_per_s: 1.0, ..bench_sensors() };
        assert!(matches!(refusal(drifting, "hold", 0.0), CalibrateError::Unsteady { .. }));
        assert!(matches!(refusal(bench_sensors(), "mid", 0.0), CalibrateError::Moving { .. }));
        let narrow = Sensors { force_min_code: -1000.0, force_max_code: 1000.0, ..bench_sensors() };
        assert!(matches!(refusal(narrow, "hold", 3.0), CalibrateError::Saturated { .. }));
        let (samples, settings) = samples(bench_sensors(), "hold", 0.0, 1.0);
        assert!(matches!(level(&samples, &settings, 3.0, ""), Err(CalibrateError::TooShort { .. })));
    }
}
