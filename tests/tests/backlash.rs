//! Backlash with both methods: a reported value is right, and an undetermined one is withheld with the right reason.

use inerter_core::{Contact, Reversal, Route, Settings, Status};
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::bench_sensors;
use inerter_tests::backlash::{Run, cell, goal, instruments, run, sensed_goal, settings};
use inerter_tests::coverage::{Bench, stated_true};
use inerter_tests::grid::{Instruments, MOTIONS, RIGS, errors, published, raw, shaken};

const RIG: Instruments = RIGS[0];

fn worn(backlash_m: f64) -> Inerter {
    Inerter { backlash_m, ..Inerter::paper() }
}

#[test]
fn backlash_of_all_widths_is_found_in_all_motions() {
    let (mut given, mut wrong) = (0, 0);
    for motion in &MOTIONS {
        for backlash_m in [0.0, 20e-6, 100e-6] {
            let device = worn(backlash_m);
            let runs: Vec<_> =
                (1..=4).map(|seed| run(&device, motion.name, motion.duration_s, &RIG, seed).unwrap()).collect();
            let found = cell(&device, &runs);
            let (bias, sigma, up_to) = goal(motion.name);
            let place = format!("{} {:.0} um: {found:?}", motion.name, backlash_m * 1e6);
            if backlash_m <= up_to {
                // Four runs determine a mean and a deviation only to this accuracy.
                assert!(found.force.bias.abs() < bias + sigma, "{place}");
                assert!(found.force.sigma < 2.0 * sigma, "{place}");
            }
            assert!(found.force.given >= 3 && found.sensed.given == 4, "{place}");
            assert!(found.force.u95 < 7e-6, "{place}");
            assert!(found.sensed.bias.abs() < sensed_goal(motion.name), "{place}");
            assert!(found.sensed.sigma < sensed_goal(motion.name), "{place}");
            if motion.name != "slow" {
                assert!(found.stiffness.bias.abs() < 3e-3 && found.stiffness.sigma < 3e-3, "{place}");
            }
            given += found.force.given + found.sensed.given;
            wrong += found.force.wrong + found.sensed.wrong;
            for run in &runs {
                let expected = if backlash_m == 0.0 { Contact::Closed } else { Contact::Backlash };
                assert_eq!(run.sensed.contact, expected, "{place}");
                assert_eq!(run.sensed.backlash.route, Route::Terminal);
                assert_eq!(run.force.stiffness_n_per_m.status(), Status::NotIdentifiable);
            }
        }
    }
    assert!(20 * wrong <= given, "{wrong} of {given} outside their interval");
}

#[test]
fn each_reversal_tells_its_own_backlash_and_error() {
    let reversals = run(&worn(50e-6), "random", 20.0, &RIG, 3).unwrap().reversals;
    assert!(reversals.len() > 300, "{}", reversals.len());
    let normalised =
        reversals.iter().map(|reversal| f64::from((reversal.value_m - 50e-6) / reversal.error_m).powi(2)).sum::<f64>();
    let ratio = normalised / reversals.len() as f64;
    assert!((0.5..2.0).contains(&ratio), "{ratio}");
    assert!(reversals.windows(2).all(|pair| pair[0].index < pair[1].index && pair[0].route == Route::Force));
    let rising = reversals.iter().filter(|reversal| reversal.rising).count();
    assert!(rising.abs_diff(reversals.len() / 2) < reversals.len() / 10, "{rising} of {}", reversals.len());
}

/// With the sensor, the records scatter by their stated error, and their mean agrees with the pooled value of all
/// blocks.
#[test]
fn each_reversal_tells_its_own_backlash_with_the_sensor() {
    for (motion, at_least) in [("mid", 120), ("fast", 600), ("random", 400)] {
        for (rig, backlash_m) in RIGS.iter().flat_map(|rig| [0.0, 50e-6, 200e-6].map(|backlash_m| (rig, backlash_m))) {
            let Run { sensed, sensed_reversals, .. } = run(&worn(backlash_m), motion, 20.0, rig, 3).unwrap();
            let count = sensed_reversals.len() as f64;
            let mean = sensed_reversals.iter().map(|reversal| f64::from(reversal.value_m)).sum::<f64>() / count;
            let normalised =
                |reversal: &Reversal| ((f64::from(reversal.value_m) - mean) / f64::from(reversal.error_m)).powi(2);
            let ratio = (sensed_reversals.iter().map(normalised).sum::<f64>() / count).sqrt();
            let pooled = sensed.backlash.known().unwrap();
            let place = format!("{motion}, {}, {backlash_m}: {mean} {ratio} {count} {pooled:?}", rig.name);
            assert!(sensed_reversals.len() > at_least, "{place}");
            assert!((0.5..2.0).contains(&ratio), "{place}");
            assert!((mean - f64::from(pooled.value)).abs() < f64::from(pooled.u95) / 2.0, "{place}");
            assert!(sensed_reversals.windows(2).all(|pair| pair[0].index < pair[1].index), "{place}");
            assert!(sensed_reversals.iter().all(|reversal| reversal.route == Route::Terminal), "{place}");
            let rising = sensed_reversals.iter().filter(|reversal| reversal.rising).count();
            assert!(rising.abs_diff(sensed_reversals.len() / 2) <= 1, "{place}: {rising}");
        }
    }
}

/// While the screw crosses a gap, the structure is half the gap ahead of it and then half the gap behind: up to 0.24 kg
/// at 0.3 mm.
#[test]
fn a_wide_gap_is_in_the_interval_of_the_inertance() {
    let (mut squares, mut all) = (0.0, 0.0);
    for (backlash_m, structure_mass_kg) in [(2e-5, 4.0), (2e-4, 1.515), (3e-4, 1.515), (2e-4, 4.0)] {
        let device = Inerter { backlash_m, structure_mass_kg, ..Inerter::paper() };
        for motion in MOTIONS.iter().filter(|motion| motion.name != "slow") {
            let bench = Bench { name: "gaps", device, sensors: bench_sensors(), wrong: &[] };
            for seed in 31..34 {
                let (errors, _) = bench.run(motion.name, motion.duration_s, seed).unwrap();
                let [Some((error, u95)), ..] = errors else { panic!("{}: no inertance", motion.name) };
                let what = format!("{backlash_m} m, {structure_mass_kg} kg, {}, {seed}: {error} +- {u95}", motion.name);
                assert!(error.abs() < u95, "{what}");
                squares += (error / u95).powi(2);
                all += 1.0;
            }
        }
    }
    let rms = f64::sqrt(squares / all);
    assert!((0.25..0.7).contains(&rms), "rms {rms}");
}

/// With an unknown stiffness nothing reveals this gap. It moves a parameter out of its interval no more often than
/// chance does: in at most 3 of 20 runs of a motion.
#[test]
fn a_gap_that_is_not_seen_is_within_the_intervals() {
    // No structure mass on the load cell: without a stiffness, the structure would have an interval of its own.
    let device = Inerter { structure_mass_kg: 0.0, ..worn(10e-6) };
    for motion in MOTIONS.iter().filter(|motion| motion.name != "slow") {
        let mut beyond = [0; 3];
        for seed in 1..=20 {
            let sensors = Sensors { force_noise_n: 1.0, ..instruments(&RIG, seed) };
            let unknown = Settings { stiffness_n_per_m: 0.0, ..stated_true(settings(&device, &sensors)) };
            let samples = shaken(&device, motion.name, sensors).unwrap().lasting(motion.duration_s);
            let published = published(&unknown, samples.map(|sample| raw(&sample))).unwrap();
            assert_eq!(published.detail.contact, Contact::Unknown);
            for (found, beyond) in errors(&published.estimate.whole_run, &device).into_iter().zip(&mut beyond) {
                let (error, u95) = found.unwrap();
                *beyond += u32::from(error.abs() > u95);
            }
        }
        assert!(beyond.iter().all(|runs| *runs <= 3), "{}: {beyond:?}", motion.name);
    }
}
