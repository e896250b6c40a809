//! What open flanks do to inertance and friction, on devices that set nothing: another mass, stiffness and gap than the reference device's.

use inerter_core::{LawStatus, Source};
use inerter_data::{
    replay::{Outcome, replay_samples},
    settings::SettingsInputError,
};
use inerter_plant::{Excitation, Inerter, Plant, Sensors, Simulation};
use inerter_tests::{coverage::stated_true, grid, sums::part_left};
use std::f64::consts::{FRAC_2_PI, TAU};

const SEEDS: u64 = 12;
const DURATION_S: f64 = 20.0;

/// A device of which only the flanks' and the structure's part differ, with a stiffness that lets it move as the terminal does.
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

/// Runs on a rig whose settings are true.
fn runs(device: Inerter, sample_rate_hz: f64, motion: &str) -> Vec<Outcome> {
    let run = |seed| {
        let sensors = Sensors {
            sample_rate_hz,
            force_noise_n: 1.0,
            force_offset_n: 3.0,
            encoder_phase_count: (seed as f64 * 0.618) % 1.0,
            seed: 9000 + seed,
            ..Sensors::default()
        };
        let settings = stated_true(grid::calibrated(&device, &sensors));
        let plant = Plant::new(device, Excitation::parse(motion, 9000 + seed)?)?;
        let samples = Simulation::of(plant, sensors)?.lasting(DURATION_S).map(|sample| Ok(grid::raw(&sample)));
        Ok(replay_samples::<SettingsInputError>(&settings, 0.0, samples, |_, _| Ok(()))?)
    };
    grid::each_seed(SEEDS, run).unwrap()
}

/// Errors of the three parameters over the whole run, their intervals, and what these would be without a source.
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

/// Heavier and lighter devices, from a fiftieth of the stroke to a fifth: held, and mostly not without the structure's part.
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

/// Viscous and Coulomb friction by the impacts, of which the grid's `worn` in `multi` set the part.
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
    // Without it far less than 95 % would be held.
    assert!(10 * beyond_rest > all_values, "{beyond_rest} of {all_values}");
}

/// The terminal moves on while the screw flies: a step of the gap in phase with the acceleration, whose first harmonic is 2/pi of it.
/// So the structure is taken for less of its mass, by that over the screw's amplitude, whatever the interval makes of it.
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

/// Impacts act on the screw as on the load cell. So wide a gap, with so heavy a structure, is no device that anyone would measure.
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
