//! The effect of open flanks on inertance and friction, on devices that determined no constant: with other mass,
//! stiffness and gap than the reference device.

use inerter_core::{LawStatus, Source};
use inerter_data::{
    replay::{Outcome, replay_samples},
    settings::SettingsInputError,
};
use inerter_plant::{Inerter, Sensors};
use inerter_tests::{coverage::stated_true, grid, sums::part_left};
use std::f64::consts::{FRAC_2_PI, TAU};

const SEEDS: u64 = 12;
const DURATION_S: f64 = 20.0;

/// A device in which only the flanks and the structure vary. Its stiffness lets it follow the terminal.
fn device(inertance_kg: f64, backlash_m: f64, structure_mass_kg: f64) -> Inerter {
    Inerter {
        inertance_kg,
        backlash_m,
        structure_mass_kg,
        viscous_n_s_per_m: 90.0,
        coulomb_n: 28.0,
        stiffness_n_per_m: 3e6,
        contact_damping_n_s_per_m: 1500.0,
        ..Inerter::paper()
    }
}

/// Runs on a rig with true settings.
fn runs(device: Inerter, sample_rate_hz: f64, motion: &str) -> Vec<Outcome> {
    let run = |seed| {
        let sensors = Sensors { sample_rate_hz, seed: 9000 + seed, ..grid::seeded(grid::sensors(), seed) };
        let settings = stated_true(grid::calibrated(&device, &sensors));
        let samples = grid::shaken(&device, motion, sensors)?.lasting(DURATION_S).map(|sample| Ok(grid::raw(&sample)));
        Ok(replay_samples::<SettingsInputError>(&settings, 0.0, samples, |_, _| Ok(()))?)
    };
    grid::each(1..=SEEDS, run).unwrap()
}

/// Absolute errors of the three whole-run parameters, their intervals, and these intervals without one source.
fn judged(outcome: &Outcome, device: &Inerter, without: Source) -> [(f64, f64, f64); 3] {
    let mut found = grid::three(&outcome.estimate.whole_run).into_iter().zip(grid::truth(device));
    let mut budgets = outcome.budgets.whole_run.iter();
    std::array::from_fn(|_| {
        let ((parameter, truth), budget) = (found.next().unwrap(), budgets.next().unwrap());
        let (all, part) = (budget.u95(), budget.given_u95(without));
        let rest = (all * all - part * part).max(0.0).sqrt();
        ((f64::from(parameter.fitted().value) - truth).abs(), f64::from(all), f64::from(rest))
    })
}

/// Heavier and lighter devices. The interval covers every error, and mostly does not without the structure's share.
#[test]
fn a_structure_where_flanks_part_is_held_and_not_without_its_part() {
    let (mut needed, mut all_values) = (0, 0);
    for device in [device(600.0, 60e-6, 6.0), device(140.0, 50e-6, 3.0), device(140.0, 150e-6, 1.0)] {
        for motion in ["multi", "random", "sine:9Hz:1.1mm", "mid"] {
            for run in runs(device, 4000.0, motion) {
                let [(error, all, rest), ..] = judged(&run, &device, Source::Structure);
                assert!(error <= all, "{device:?} {motion}: {error} beyond {all}");
                needed += usize::from(error > rest);
                all_values += 1;
            }
        }
    }
    assert!(2 * needed > all_values, "{needed} of {all_values}");
}

/// Viscous and Coulomb friction with impacts. The model's share was determined on the grid's `worn` device in `multi`.
#[test]
fn friction_beside_impacts_is_held_by_what_the_residual_shows() {
    let (mut beyond_rest, mut all_values) = (0, 0);
    for device in [device(600.0, 60e-6, 6.0), device(140.0, 50e-6, 1.0)] {
        for (rate_hz, motion) in [(1000.0, "multi"), (1000.0, "random"), (4000.0, "multi"), (4000.0, "random")] {
            for run in runs(device, rate_hz, motion) {
                let [_, viscous, coulomb] = judged(&run, &device, Source::Model);
                for (error, all, rest) in [viscous, coulomb] {
                    assert!(error <= all, "{device:?} {rate_hz} {motion}: {error} beyond {all}");
                    beyond_rest += usize::from(error > rest);
                    all_values += 1;
                }
            }
        }
    }
    // Without the model's share, far fewer than 95 % of the errors would be covered.
    assert!(10 * beyond_rest > all_values, "{beyond_rest} of {all_values}");
}

/// While the screw flies, the terminal moves on: a step of the size of the gap, in phase with the acceleration, whose
/// first harmonic is 2/pi of it. The apparent structure mass is therefore smaller, by that amount relative to the
/// screw's amplitude, whatever the interval is.
#[test]
fn flight_takes_of_a_structure_what_the_gap_is_of_the_stroke() {
    const AMPLITUDE_M: f64 = 1.1e-3;
    for (device, hz) in
        [(device(140.0, 50e-6, 3.0), 9.0), (device(140.0, 100e-6, 1.0), 9.0), (device(600.0, 60e-6, 6.0), 7.0)]
    {
        let expected = {
            let own = (TAU * hz).powi(2) * device.inertance_kg / device.stiffness_n_per_m;
            FRAC_2_PI * device.backlash_m / AMPLITUDE_M * (1.0 - own)
        };
        let runs = runs(device, 4000.0, &format!("sine:{hz}Hz:{}mm", 1e3 * AMPLITUDE_M));
        let missing = |run: &Outcome| {
            let found = f64::from(run.estimate.whole_run.inertance_kg.fitted().value);
            (device.inertance_kg - found) / device.structure_mass_kg
        };
        let mean = runs.iter().map(missing).sum::<f64>() / runs.len() as f64;
        assert!((mean / expected - 1.0).abs() < 0.3, "{device:?} {hz}: {mean} for {expected}");
    }
}

/// Impacts act on the screw as well as on the load cell. Nobody would measure a device with so wide a gap and so heavy
/// a structure.
#[test]
fn impacts_leave_a_part_of_the_force_that_a_broken_law_exceeds() {
    let mut most: f64 = 0.0;
    for (inertance_kg, backlash_m, structure_mass_kg) in [(140.0, 3e-3, 6.0), (600.0, 1e-3, 12.0), (60.0, 2e-3, 2.0)] {
        for motion in ["multi", "random", "two", "sine:9Hz:1.1mm"] {
            for outcome in runs(device(inertance_kg, backlash_m, structure_mass_kg), 1000.0, motion) {
                most = most.max(part_left(&outcome));
                assert_ne!(outcome.law.status, LawStatus::Broken, "{inertance_kg} kg, {backlash_m} m, {motion}");
            }
        }
    }
    assert!((0.005..0.03).contains(&most), "{most}");
}
