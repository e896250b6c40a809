//! Width and coverage of the intervals if every stated value is true.

use crate::grid::{Column, Motion, Result, calibrated, each, errors, published, raw, seeded, shaken};
use inerter_core::{LawStatus, NORMAL_COVERAGE, Settings, Source};
use inerter_plant::{Inerter, Sensors};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use std::ops::{Range, RangeInclusive};

/// Fraction of the runs that a 95 % interval should cover.
const COVERED: f64 = 0.95;
/// Probability below which a cell counts as wrong, here or in another table: among hundreds of cells none should.
const CHANCE: f64 = 1e-4;
/// Independent values in a run of 20 s, which spans four memories of 5 s.
const VALUES_OF_A_RUN: f64 = 4.0;
/// Accepted rms of error over half width; 0.51 is exact for a 95 % interval.
pub const RIGHT: RangeInclusive<f64> = 0.25..=0.6;

/// A device on a rig whose settings are exact and stated as exact, except for `wrong`.
#[derive(Clone, Copy, Debug)]
pub struct Bench {
    /// Name in the table.
    pub name: &'static str,
    /// The device.
    pub device: Inerter,
    /// The instruments.
    pub sensors: Sensors,
    /// The quantities whose settings have a stated uncertainty and a random error of that size in each run; the others
    /// are exact.
    pub wrong: &'static [Source],
}

/// Uncertainties that the settings can state.
pub const STATED: [Source; 6] =
    [Source::Gain, Source::Lead, Source::Timebase, Source::Skew, Source::Structure, Source::Stiffness];

impl Column {
    /// Whether significantly more than 95 % of the intervals cover the true value.
    pub fn is_blunt(&self) -> bool {
        // P(at least n covered) = 1 - P(at most n - 1 covered).
        self.given > 0 && 1.0 - at_most(self.covered().saturating_sub(1), self.given) < CHANCE
    }

    /// Whether significantly less than 95 % of the intervals cover the true value.
    pub fn is_low(&self) -> bool {
        at_most(self.covered(), self.given) < CHANCE
    }

    /// Whether no value was given, the coverage is below 95 % or the rms outside [`RIGHT`], beyond chance.
    pub fn is_wrong(&self) -> bool {
        // Four standard deviations of the scatter of a squared normal error.
        let scatter = 1.0 + 4.0 / (2.0 * self.given as f64).sqrt();
        self.given == 0 || self.is_low() || self.rms * scatter < *RIGHT.start() || self.rms / scatter > *RIGHT.end()
    }
}

/// Whether this fraction covered in so many runs is significantly less than 95 %.
pub fn is_low(part: f64, runs: u64) -> bool {
    let all = VALUES_OF_A_RUN * runs as f64;
    at_most((part * all).round() as usize, all as usize) < CHANCE
}

/// Probability that at most `covered` of `all` intervals cover, if each does so with 95 % probability.
fn at_most(covered: usize, all: usize) -> f64 {
    let odds: f64 = COVERED / (1.0 - COVERED);
    // Sums the binomial terms from zero on, in logarithms.
    let mut logarithm = all as f64 * (1.0 - COVERED).ln();
    let mut sum = logarithm.exp();
    for k in 1..=covered.min(all) {
        logarithm += odds.ln() + ((all - k + 1) as f64 / k as f64).ln();
        sum += logarithm.exp();
    }
    sum.min(1.0)
}

/// Errors and half widths of the three parameters in one run, if given, and whether the law is reported as broken.
pub type Outcome = ([Option<(f64, f64)>; 3], bool);

impl Bench {
    /// The runs of a motion with these seeds.
    pub fn runs(&self, motion: &Motion, seeds: Range<u64>) -> Result<Vec<Outcome>> {
        each(seeds, |seed| self.run(motion.name, motion.duration_s, seed))
    }

    /// One run of `duration_s` seconds with a motion in the plant's notation.
    pub fn run(&self, motion: &str, duration_s: f64, seed: u64) -> Result<Outcome> {
        let sensors = seeded(self.sensors, seed);
        let settings = stated(calibrated(&self.device, &sensors), self.wrong, seed);
        let samples = shaken(&self.device, motion, sensors)?.lasting(duration_s).map(|sample| raw(&sample));
        let published = published(&settings, samples)?;
        let found = errors(&published.estimate.whole_run, &self.device);
        Ok((found, published.law.status == LawStatus::Broken))
    }
}

/// The same settings, stated as exact.
pub fn stated_true(settings: Settings) -> Settings {
    Settings {
        force_gain_u95: 0.0,
        lead_u95: 0.0,
        timebase_u95: 0.0,
        skew_u95_s: 0.0,
        structure_mass_u95_kg: 0.0,
        // A value of 0 would mean 1 %.
        stiffness_u95_n_per_m: 1e-6 * settings.stiffness_n_per_m,
        ..settings
    }
}

/// The same settings, except for these sources: each is stated with an uncertainty and has a normal error of that size
/// (JCGM 101).
fn stated(settings: Settings, wrong: &[Source], seed: u64) -> Settings {
    let mut random = ChaCha8Rng::seed_from_u64(0x0101_0000 + seed);
    // Each source's error is independent of which other sources are selected.
    let errors: [f64; STATED.len()] = std::array::from_fn(|_| StandardNormal.sample(&mut random));
    let mut settings = stated_true(settings);
    for (source, error) in STATED.into_iter().zip(errors).filter(|(source, _)| wrong.contains(source)) {
        let (u95, is_relative, stated, value) = match source {
            Source::Gain => (0.005, true, &mut settings.force_gain_u95, &mut settings.newtons_per_code),
            Source::Lead => (0.002, true, &mut settings.lead_u95, &mut settings.metres_per_count),
            Source::Timebase => (0.001, true, &mut settings.timebase_u95, &mut settings.sample_rate_hz),
            Source::Skew => (20e-6, false, &mut settings.skew_u95_s, &mut settings.skew_s),
            Source::Structure => (0.1, false, &mut settings.structure_mass_u95_kg, &mut settings.structure_mass_kg),
            Source::Stiffness => {
                let u95 = 0.2 * settings.stiffness_n_per_m;
                (u95, false, &mut settings.stiffness_u95_n_per_m, &mut settings.stiffness_n_per_m)
            }
            Source::Noise | Source::Encoder | Source::Model => continue,
        };
        let off = error * u95 / f64::from(NORMAL_COVERAGE);
        *stated = u95;
        *value = if is_relative { *value * (1.0 + off) } else { *value + off };
    }
    settings
}

/// The columns of the three parameters, from the runs whose law was not reported as broken.
pub fn columns(runs: &[Outcome]) -> [Column; 3] {
    std::array::from_fn(|i| Column::of(runs.iter().filter(|(_, broken)| !broken).filter_map(|(found, _)| found[i])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_binomial_is_that_of_the_tables() {
        assert!((at_most(400, 400) - 1.0).abs() < 1e-9);
        assert!((at_most(379, 400) - 0.44089).abs() < 1e-5, "{}", at_most(379, 400));
        assert!((at_most(18, 20) - 0.2642).abs() < 1e-4, "{}", at_most(18, 20));
    }

    #[test]
    fn a_cell_is_wrong_where_it_is_empty_too_sharp_or_blunt() {
        let cell = |covered: usize, rms| Column { given: 400, wrong: 400 - covered, rms, ..Column::default() };
        assert!(!cell(380, 0.51).is_wrong() && !cell(400, 0.26).is_wrong() && !cell(400, 0.24).is_wrong());
        assert!(cell(400, 0.3).is_blunt() && !cell(390, 0.5).is_blunt());
        assert!(is_low(0.7, 8) && !is_low(0.9, 8) && is_low(0.85, 32) && !is_low(0.9, 32));
        assert!(cell(350, 0.55).is_wrong() && cell(400, 0.2).is_wrong() && cell(380, 0.8).is_wrong());
        assert!(Column::of(std::iter::empty()).is_wrong());
        assert_eq!(Column::of([(f64::NAN, 1.0), (0.5, f64::NAN), (0.5, 1.0)].into_iter()).covered(), 1);
    }
}
