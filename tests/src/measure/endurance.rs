//! `cargo xtask endurance [SAMPLES]`: feeds a thousand million samples through the estimator, repeating the same two
//! minutes.
//!
//! The sample counter, the encoder and every running sum wrap on the way. Each repetition must add exactly the same
//! amount to the sums of the whole run, and the values published at its end must not change.

use inerter_core::{Active, Bank, Counters, Detail, Estimate, Published, RawSample, Settings, State};
use inerter_plant::{Inerter, Sensors};
use inerter_tests::{
    grid::{self, Error},
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

/// The amounts that one repetition adds to the sums of both banks.
type Growth = [Vec<i128>; 2];

/// The values compared after each repetition.
struct Look {
    estimate: Estimate,
    sums: [inerter_core::Sums; 2],
    counters: Counters,
    backlash_m: f64,
    reversals: u32,
}

impl Look {
    fn at(active: &Active, state: &State) -> Self {
        let sums = [Bank::Fast, Bank::Slow].map(|bank| active.sums(state, bank));
        let Published { estimate, detail: Detail { backlash, .. }, .. } = active.publish(state);
        let (backlash_m, reversals) =
            (backlash.known().map_or(0.0, |known| f64::from(known.value)), backlash.reversals);
        Self { estimate, sums, counters: state.counters(), backlash_m, reversals }
    }

    fn values(&self) -> Vec<f64> {
        [&self.estimate.recent, &self.estimate.whole_run]
            .into_iter()
            .flat_map(grid::four)
            .flat_map(|parameter| [parameter.fitted().value, parameter.u95()])
            .map(f64::from)
            .collect()
    }
}

pub fn run(words: &[&str]) -> Result<bool, Error> {
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
    let active = settings.validate()?;
    let mut state = Box::new(State::new(&active));
    let repetitions = wanted.div_ceil(u64::from(length)).max(SETTLING + 2);
    let (mut index, mut position) = (u32::MAX - 3 * length, i32::MAX - 7);
    let (mut before, mut reference): (Option<Look>, Option<(Look, Growth)>) = (None, None);
    let (mut greatest, mut changes) = ([0.0_f64; 2], 0_u64);
    for repetition in 1..=repetitions {
        for sample in &segment {
            let raw = RawSample {
                index: index.wrapping_add(sample.index),
                position_count: position.wrapping_add(sample.position_count),
                ..*sample
            };
            changes += u64::from(active.step(&mut state, &raw).change.is_some());
        }
        index = index.wrapping_add(length);
        position = position.wrapping_add(advance);
        let now = Look::at(&active, &state);
        if let Some(before) = &before {
            let growth = [0, 1].map(|bank| {
                let sums = now.sums[bank].sums.iter().zip(&before.sums[bank].sums);
                sums.map(|(now, before)| now - before).collect::<Vec<i128>>()
            });
            match &reference {
                None if repetition > SETTLING => reference = Some((Look::at(&active, &state), growth)),
                None => {}
                Some((look, usual)) => {
                    if growth != *usual {
                        println!("repetition {repetition}: the sums grew otherwise than before");
                        return Ok(false);
                    }
                    for (i, (now, then)) in now.values().iter().zip(look.values()).take(8).enumerate() {
                        greatest[i % 2] = greatest[i % 2].max((now - then).abs() / then.abs().max(1e-9));
                    }
                }
            }
        }
        if now.counters.discontinuities != 0 || now.counters.saturated != 0 {
            println!("repetition {repetition}: {:?}", now.counters);
            return Ok(false);
        }
        before = Some(now);
    }
    let Some((look, _)) = &reference else { return Err("too few samples".into()) };
    println!(
        "{} samples in {repetitions} repetitions of {DURATION_S} s: every one added the same to the sums of the whole run; the live \
         values moved by at most {:.1e} of themselves, their intervals by {:.1e}, {changes} changes found",
        state.counters().samples,
        greatest[0],
        greatest[1]
    );
    let last = Look::at(&active, &state);
    let moved_m = (last.backlash_m - look.backlash_m).abs();
    println!("after {} repetitions: {:?}", SETTLING + 1, look.estimate.recent);
    println!("after all: {:?}", last.estimate.recent);
    println!(
        "backlash {:.3} um from {} reversals, {:.3} um from {}",
        look.backlash_m * 1e6,
        look.reversals,
        last.backlash_m * 1e6,
        last.reversals
    );
    // An average over more repetitions of the same may settle, but must not drift.
    let counted = u64::from(last.reversals) * (SETTLING + 1) >= u64::from(look.reversals) * (repetitions - SETTLING);
    let settled = greatest.iter().zip(GREATEST_DIFFERENCE).all(|(found, most)| *found <= most);
    Ok(settled && changes == 0 && moved_m <= GREATEST_BACKLASH_M && counted)
}
