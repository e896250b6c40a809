//! `cargo xtask endurance [SAMPLES]`: feeds a thousand million samples through the estimator, repeating the same two
//! minutes.
//!
//! The sample counter, the encoder and every running sum wrap on the way. Each repetition must add exactly the same
//! amount to the sums of the whole run, and the values published at its end must not change.

use inerter_core::{Bank, Published, RawSample, Settings, Sums};
use inerter_plant::{Inerter, Sensors};
use inerter_tests::{
    grid::{self, Estimator, Result},
    sheet::number,
};

/// Default number of samples.
const SAMPLES: u64 = 1_000_000_000;
/// The repeated motion. It begins and ends at rest.
const MOTION: &str = "random@40s;hold@3s;mid@20s;hold@2s;fast@10s;two@20s;multi@20s;hold@5s";
const DURATION_S: f64 = 120.0;
/// Repetitions until the memory has forgotten the start.
const SETTLING: u64 = 8;
/// Maximum difference of the backlash, which is an average over the whole run \[m\].
const GREATEST_BACKLASH_M: f64 = 0.1e-6;
/// Maximum relative difference of a published value from the one after the first repetitions (the last bits of an
/// `f32`), and of its interval. The interval counts how many strokes were repeated in all, so it settles with one over
/// the number of repetitions.
const GREATEST_DIFFERENCE: [f64; 2] = [1e-6, 1e-3];

/// What is compared after each repetition: what is published, and the sums of both banks.
#[derive(Clone, Copy)]
struct Look {
    published: Published,
    sums: [Sums; 2],
}

impl Look {
    fn at(estimator: &Estimator) -> Self {
        let sums = [Bank::Fast, Bank::Slow].map(|bank| estimator.active.sums(&estimator.state, bank));
        Self { published: estimator.publish(), sums }
    }

    /// Values and intervals of the parameters, one after the other.
    fn values(&self) -> impl Iterator<Item = f64> {
        let estimate = &self.published.estimate;
        let parameters = [&estimate.recent, &estimate.whole_run].map(grid::four).into_iter().flatten();
        parameters.flat_map(|parameter| [parameter.fitted().value, parameter.u95()]).map(f64::from)
    }

    /// What has been added to the sums since another look.
    fn growth(&self, before: &Self) -> Vec<i128> {
        let pairs = self.sums.iter().zip(&before.sums).flat_map(|(now, before)| now.sums.iter().zip(&before.sums));
        pairs.map(|(now, before)| now - before).collect()
    }

    /// The backlash \[m\], 0 if unknown, and the number of its reversals.
    fn backlash(&self) -> (f64, u32) {
        let backlash = self.published.detail.backlash;
        (backlash.known().map_or(0.0, |known| f64::from(known.value)), backlash.reversals)
    }
}

pub fn run(words: &[&str]) -> Result<bool> {
    let wanted = number(words, SAMPLES, "samples")?;
    let device = Inerter { backlash_m: 5e-5, ..Inerter::paper() };
    let sensors = Sensors { seed: 1, ..grid::sensors() };
    let settings = Settings { memory_s: 10.0, ..grid::calibrated(&device, &sensors) };
    let simulation = grid::shaken(&device, MOTION, sensors)?;
    let segment: Vec<RawSample> = simulation.lasting(DURATION_S).map(|sample| grid::raw(&sample)).collect();
    let length = segment.len() as u32;
    // Each repetition starts at a different position, so that the encoder wraps many times.
    let [first, .., last] = segment.as_slice() else { return Err("no samples".into()) };
    let advance = last.position_count.wrapping_sub(first.position_count);
    let mut estimator = Estimator::new(&settings)?;
    let repetitions = wanted.div_ceil(u64::from(length)).max(SETTLING + 2);
    let (mut index, mut position) = (u32::MAX - 3 * length, i32::MAX - 7);
    let mut last = Look::at(&estimator);
    // The first repetitions settle; the last of them is the reference.
    let (mut look, mut usual) = (last, Vec::new());
    let (mut greatest, mut changes) = ([0.0_f64; 2], 0_u64);
    for repetition in 1..=repetitions {
        for sample in &segment {
            let raw = RawSample {
                index: index.wrapping_add(sample.index),
                position_count: position.wrapping_add(sample.position_count),
                ..*sample
            };
            changes += u64::from(estimator.step(&raw).change.is_some());
        }
        index = index.wrapping_add(length);
        position = position.wrapping_add(advance);
        let now = Look::at(&estimator);
        let growth = now.growth(&last);
        if repetition <= SETTLING + 1 {
            (look, usual) = (now, growth);
        } else if growth != usual {
            println!("repetition {repetition}: the sums grew otherwise than before");
            return Ok(false);
        }
        for (i, (now, then)) in now.values().zip(look.values()).take(8).enumerate() {
            greatest[i % 2] = greatest[i % 2].max((now - then).abs() / then.abs().max(1e-9));
        }
        let counters = estimator.state.counters();
        if counters.discontinuities != 0 || counters.saturated != 0 {
            println!("repetition {repetition}: {counters:?}");
            return Ok(false);
        }
        last = now;
    }
    println!(
        "{} samples in {repetitions} repetitions of {DURATION_S} s: every one added the same to the sums of the whole run; the live \
         values moved by at most {:.1e} of themselves, their intervals by {:.1e}, {changes} changes found",
        estimator.state.counters().samples,
        greatest[0],
        greatest[1]
    );
    let ((before_m, before), (after_m, after)) = (look.backlash(), last.backlash());
    println!("after {} repetitions: {:?}", SETTLING + 1, look.published.estimate.recent);
    println!("after all: {:?}", last.published.estimate.recent);
    println!("backlash {:.3} um from {before} reversals, {:.3} um from {after}", before_m * 1e6, after_m * 1e6);
    // An average over more repetitions of the same may settle, but must not drift.
    let counted = u64::from(after) * (SETTLING + 1) >= u64::from(before) * (repetitions - SETTLING);
    let settled = greatest.iter().zip(GREATEST_DIFFERENCE).all(|(found, most)| *found <= most);
    Ok(settled && changes == 0 && (after_m - before_m).abs() <= GREATEST_BACKLASH_M && counted)
}
