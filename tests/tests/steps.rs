//! The effect of the encoder's steps on motions that repeat sample by sample, and on motions that do not.

use inerter_core::Settings;
use inerter_data::{run::Run, settings::Overrides};
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Setup, bench_sensors};
use inerter_tests::bound;
use inerter_tests::coverage::{Bench, stated_true};
use inerter_tests::data::replayed;
use inerter_tests::grid::{
    self, Instruments, Motion, RIGS, TWO_CLOCKS, bias_and_sigma, calibrated, error, instruments, motion, published,
    raw, rms, shaken, simulation, three, truth,
};

/// Number of runs, as in the table: a standard deviation is known to 13 %.
const SEEDS: u64 = 32;
/// Readings summed in one sample of the board at 1 kHz.
const BOARD_OVERSAMPLING: f64 = 64.0;

/// Standard deviations of the estimated viscous and Coulomb friction.
fn friction_scatter(motion: &Motion, rig: &Instruments) -> [f64; 2] {
    let device = Inerter::paper();
    let runs = grid::each(1..=SEEDS, |seed| grid::run(&device, motion, rig, seed)).unwrap();
    let [_, viscous, coulomb] = grid::cells(&device, &runs).map(|cell| cell.last.sigma);
    [viscous, coulomb]
}

/// The same if each sample is a sum of readings, as on the board.
fn friction_scatter_of_sums(motion: &Motion, rig: &Instruments) -> [f64; 2] {
    let device = Inerter::paper();
    let found = grid::each(1..=SEEDS, |seed| {
        let plain = instruments(rig, seed);
        let sensors = Sensors {
            oversampling: BOARD_OVERSAMPLING,
            // Coarser by this factor, so that the sum keeps its scale.
            newtons_per_code: plain.newtons_per_code * BOARD_OVERSAMPLING,
            ..plain
        };
        let settings = Settings { memory_s: 100.0, ..calibrated(&device, &sensors) };
        let samples = shaken(&device, motion.name, sensors)?.lasting(motion.duration_s);
        let last = published(&settings, samples.map(|sample| raw(&sample)))?.estimate;
        Ok(three(&last.whole_run).map(|parameter| f64::from(parameter.fitted().value)))
    })
    .unwrap();
    [1, 2].map(|i| bias_and_sigma(&found.iter().map(|one| one[i]).collect::<Vec<_>>()).1)
}

/// Fraction of the samples in the second half of the run that have the same count as `period` samples before.
fn repeated(motion: &Motion, rig: &Instruments, period: usize) -> f64 {
    let samples = simulation(&Inerter::paper(), motion, rig, 1).unwrap().lasting(motion.duration_s);
    let counts: Vec<i32> = samples.map(|sample| raw(&sample).position_count).collect();
    let later = &counts[counts.len() / 2..];
    let earlier = &counts[counts.len() / 2 - period..];
    let same = later.iter().zip(earlier).filter(|(later, earlier)| later == earlier).count();
    same as f64 / later.len() as f64
}

#[test]
fn on_one_clock_a_periodic_motion_reads_the_same_counts_again() {
    for (name, period, times) in [("mid", 625, 32), ("multi", 2000, 10), ("two", 1250, 16)] {
        let motion = motion(name);
        assert_eq!(period * times, (motion.duration_s * RIGS[0].sample_rate_hz) as usize);
        let [one, two] = [&RIGS[0], &TWO_CLOCKS].map(|rig| repeated(motion, rig, period));
        assert!(one > 0.99 && two < 0.9, "{name}: {one} on one clock, {two} on two");
    }
}

/// The error of the steps, repeated 16 times, accounts for nearly all of the difference between the scatter of `two`
/// and its bound.
#[test]
fn the_steps_average_out_where_nothing_repeats() {
    let (two, rig) = (motion("two"), &RIGS[0]);
    let [_, least @ ..] = bound::least_sigma(&Inerter::paper(), two, rig, 1).unwrap().unwrap();
    let one_clock = friction_scatter(two, rig);
    let without_noise = friction_scatter(two, &Instruments { force_noise_n: 0.0, ..*rig });
    let two_clocks = friction_scatter(two, &TWO_CLOCKS);
    let sums = friction_scatter_of_sums(two, rig);
    for i in 0..2 {
        let [one_clock, without_noise, two_clocks, sums] =
            [one_clock, without_noise, two_clocks, sums].map(|scatter| scatter[i] / least[i]);
        let all = format!("{one_clock}, {without_noise} without noise, {two_clocks} on two clocks, {sums} of sums");
        assert!((2.5..3.8).contains(&one_clock) && without_noise > 0.9 * one_clock, "{all}");
        assert!((0.7..1.3).contains(&two_clocks) && (0.6..1.0).contains(&sums), "{all}");
    }
}

/// Errors of inertance, viscous and Coulomb friction relative to their intervals, in tones on the instrument's own
/// clock, with a rig stated as perfect. Every run has another amplitude and another phase within a count.
fn tones([hz, mm]: [f64; 2], backlash_m: f64, rig: Sensors) -> Vec<[f64; 3]> {
    grid::each(1..=24, |seed| {
        let spread = |step: f64| (seed as f64 * step) % 1.0;
        let sensors = Sensors { seed: 7000 + seed, encoder_phase_count: spread(0.5698), force_offset_n: 3.0, ..rig };
        let device = Inerter { backlash_m, ..Inerter::paper() };
        let motion = format!("sine:{hz}Hz:{}mm", mm * (0.8 + 0.4 * spread(0.7549)));
        let setup = Setup::new(device, sensors, &motion, Some(20.0), &Overrides::default())?;
        let perfect =
            Settings { force_gain_u95: 0.0, lead_u95: 0.0, timebase_u95: 0.0, skew_u95_s: 0.0, ..setup.settings };
        let samples = setup.samples()?.map(|sample| raw(&sample)).collect();
        let found = replayed(&Run { settings: perfect, samples, ..Run::default() })?.estimate.whole_run;
        let (found, truth) = (three(&found), truth(&device));
        Ok([0, 1, 2].map(|i| {
            let (error, u95) = error(found[i].fitted(), truth[i]);
            error / u95
        }))
    })
    .unwrap()
}

/// Before repeating steps were modelled, half of the intervals did not cover the friction at 2, 4, 5, 6 and 8 Hz, with
/// and without a gap of 10 um.
#[test]
fn a_tone_of_the_same_clock_has_friction_within_its_intervals() {
    let (mut all, mut within, mut squares) = (0.0, 0.0, 0.0);
    for tone in [[1.0, 6.0], [2.0, 4.0], [3.0, 3.0], [4.0, 3.0], [5.0, 2.0], [6.0, 2.0], [8.0, 1.5], [10.0, 1.0]] {
        for backlash_m in [0.0, 1e-5] {
            let off: Vec<[f64; 2]> = tones(tone, backlash_m, bench_sensors())
                .iter()
                .map(|[_, viscous, coulomb]| [*viscous, *coulomb])
                .collect();
            let here = off.iter().flatten().filter(|off| off.abs() < 1.0).count() as f64 / (2 * off.len()) as f64;
            assert!(here > 0.75, "{tone:?}, {backlash_m} m: {here}");
            all += (2 * off.len()) as f64;
            within += here * (2 * off.len()) as f64;
            squares += off.iter().flatten().map(|off| off * off).sum::<f64>();
        }
    }
    let (part, rms) = (within / all, (squares / all).sqrt());
    assert!(part > 0.92 && (0.25..0.6).contains(&rms), "{part} within, rms {rms}");
}

/// The repeating counts also determine where the reversals are placed, and the residual follows one pattern.
#[test]
fn a_slow_tone_of_the_same_clock_breaks_no_law_and_is_within_its_intervals() {
    for metres_per_count in [2.44e-6, 20e-6] {
        let sensors = Sensors { metres_per_count, ..bench_sensors() };
        let bench = Bench { name: "tones", device: Inerter::paper(), sensors, wrong: &[] };
        let (mut broken, mut off) = (0, Vec::new());
        for hz in [2.0, 3.0, 4.0, 5.0, 7.0, 8.0] {
            let runs = grid::each(1..=24, |seed| {
                let amplitude_mm = 30.0 / (std::f64::consts::TAU * hz) * (0.85 + 0.3 * (seed as f64 * 0.7549 % 1.0));
                bench.run(&format!("sine:{hz}Hz:{amplitude_mm}mm"), 20.0, 500 + seed)
            });
            for (errors, is_broken) in runs.unwrap() {
                broken += usize::from(is_broken);
                off.extend(errors.into_iter().flatten().map(|(error, u95)| error / u95));
            }
        }
        let part = off.iter().filter(|off| off.abs() < 1.0).count() as f64 / off.len() as f64;
        let rms = rms(off.iter().copied());
        let what = format!("{metres_per_count} m: {broken} broken, {part} of {} within, rms {rms}", off.len());
        assert!(broken == 0 && off.len() > 400 && part > 0.92 && (0.25..0.65).contains(&rms), "{what}");
    }
}

/// With coarse counts, the measured amplitude of a tone depends on its phase within a count, at any sample rate.
#[test]
fn a_tone_in_coarse_counts_has_its_inertance_within_its_interval() {
    for sample_rate_hz in [1000.0, 4000.0] {
        for metres_per_count in [20e-6, 40e-6] {
            let rig = Sensors { sample_rate_hz, metres_per_count, ..bench_sensors() };
            let off: Vec<f64> = [[9.3, 1.5], [12.7, 1.1], [15.9, 0.8], [19.1, 0.9]]
                .into_iter()
                .flat_map(|tone| tones(tone, 0.0, rig))
                .map(|[inertance, ..]| inertance)
                .collect();
            let part = off.iter().filter(|off| off.abs() < 1.0).count() as f64 / off.len() as f64;
            let rms = rms(off.iter().copied());
            let what = format!("{sample_rate_hz} Hz, {metres_per_count} m: {part} within, rms {rms}");
            assert!(part > 0.9 && (0.25..0.6).contains(&rms), "{what}");
        }
    }
}

/// In slow motion, steps of 20 um are not as white as noise: the correction is a quarter too large, which the interval
/// includes.
#[test]
fn what_slow_steps_take_is_known_to_a_half() {
    let device = Inerter::paper();
    let off = grid::each(1..=8, |seed| {
        let sensors = Sensors { metres_per_count: 20e-6, ..instruments(&RIGS[0], seed) };
        let slow = motion("slow");
        let samples = shaken(&device, slow.name, sensors)?.lasting(slow.duration_s).map(|sample| raw(&sample));
        let last = published(&stated_true(calibrated(&device, &sensors)), samples)?.estimate;
        let (error, u95) = error(last.whole_run.inertance_kg.fitted(), device.inertance_kg);
        Ok(error / u95)
    })
    .unwrap();
    let rms = rms(off.iter().copied());
    assert!((0.25..0.7).contains(&rms), "{rms}: {off:?}");
}
