//! Quantities computed from the sums besides the four parameters: friction by direction and skew.

use inerter_core::{Bank, MoreSums, RawSample, Settings, State, Sums};
use inerter_plant::{Excitation, Inerter, Sensors, Simulation};
use inerter_tests::data::Recording;
use inerter_tests::grid::{calibrated, raw, shaken};
use inerter_tests::sums::{Directions, directions, matrix, skew_s};
use std::f64::consts::TAU;

fn sums(settings: &Settings, samples: impl Iterator<Item = RawSample>, bank: Bank) -> (Sums, MoreSums) {
    let active = settings.validate().unwrap();
    let mut state = Box::new(State::new(&active));
    samples.for_each(|sample| {
        active.step(&mut state, &sample);
    });
    (active.sums(&state, bank), active.more_sums(&state, bank))
}

#[track_caller]
fn is_near(found: &Directions, truth: &Directions, parts: [f64; 3]) {
    let pairs = [
        (found.inertance_kg, truth.inertance_kg, parts[0]),
        (found.viscous_n_s_per_m[0], truth.viscous_n_s_per_m[0], parts[1]),
        (found.viscous_n_s_per_m[1], truth.viscous_n_s_per_m[1], parts[1]),
        (found.coulomb_n[0], truth.coulomb_n[0], parts[2]),
        (found.coulomb_n[1], truth.coulomb_n[1], parts[2]),
    ];
    for (found, truth, part) in pairs {
        assert!((found / truth - 1.0).abs() < part, "{found} against {truth}");
    }
}

/// The published asymmetric fit of the EMPS recording, whose offset is 0 by its definition.
#[test]
fn emps_by_direction() {
    let Some(run) = Recording::Emps.run(1) else { return };
    let run = run.unwrap();
    let published =
        Directions { inertance_kg: 95.1540, viscous_n_s_per_m: [166.7061, 240.4236], coulomb_n: [20.1440, 20.6277] };
    let (sums, more) = sums(&run.settings, run.samples.iter().copied(), Bank::Fast);
    is_near(&directions(&sums, &more).unwrap(), &published, [0.005, 0.01, 0.01]);
}

/// A screw with more friction in one direction, moved in two tones. Force and position are computed analytically.
#[test]
fn a_screw_that_turns_harder_one_way() {
    let truth = Directions { inertance_kg: 300.0, viscous_n_s_per_m: [30.0, 80.0], coulomb_n: [40.0, 60.0] };
    let settings = Settings { metres_per_count: 1e-6, newtons_per_code: 0.01, ..Settings::default() };
    let samples = (0..20_000_u32).map(|index| {
        let t = f64::from(index) / settings.sample_rate_hz;
        let tones = [(5e-3, 2.1 * TAU), (2e-3, 5.7 * TAU)];
        let sum = |of: &dyn Fn(f64, f64) -> f64| tones.iter().map(|&(size, rate)| of(size, rate)).sum::<f64>();
        let x = sum(&|size, rate| size * (rate * t).sin());
        let v = sum(&|size, rate| size * rate * (rate * t).cos());
        let a = sum(&|size, rate| -size * rate * rate * (rate * t).sin());
        let side = usize::from(v < 0.0);
        let force = truth.inertance_kg * a + truth.viscous_n_s_per_m[side] * v + truth.coulomb_n[side] * v.signum();
        RawSample {
            index,
            position_count: (x / settings.metres_per_count).floor() as i32,
            force_code: (force / settings.newtons_per_code).round() as i32,
            terminal_code: 0,
        }
    });
    let (sums, more) = sums(&settings, samples, Bank::Fast);
    is_near(&directions(&sums, &more).unwrap(), &truth, [0.001, 0.02, 0.01]);
}

/// The rows of `MoreSums` come from the same kernel. The product of the force's rate with the constant is the growth of
/// the force. The square of the speed equals that of the velocity, except for kernels that contain a reversal.
#[test]
fn rows_belong_to_the_same_regressors() {
    let (device, sensors) = (Inerter::paper(), Sensors { force_offset_n: 3.0, ..Sensors::default() });
    let samples = Simulation::new(device, Excitation::parse("mid", 4).unwrap(), sensors).unwrap();
    for bank in [Bank::Fast, Bank::Slow] {
        let samples = samples.clone().lasting(20.0).map(|sample| raw(&sample));
        let (sums, more) = sums(&calibrated(&device, &sensors), samples, bank);
        let products = matrix(&sums, &more);
        let (velocity, speed) = (products[1][1], products[5][5]);
        assert!(speed > velocity && speed < 1.5 * velocity, "{bank:?}: {velocity} {speed}");
        // v and |v| are uncorrelated, like a sine and its magnitude; F' leads F by a quarter period.
        assert!(products[5][1].abs() < 0.01 * velocity, "{bank:?}");
        let (force, rate) = (products[4][4], products[6][6]);
        assert!(products[6][4].abs() < 0.01 * (force * rate).sqrt(), "{bank:?}");
        let hertz = (rate / force).sqrt() / TAU;
        // Friction adds harmonics.
        assert!((3.1..3.6).contains(&hertz), "{bank:?}: {hertz} Hz");
    }
}

/// The error of the skew computed from the sums \[us\], for a load cell that is late by `delay_s` under settings that
/// do not state this.
fn skew_error_us(device: &Inerter, motion: &str, rate_hz: f64, noisy: bool, delay_s: f64) -> f64 {
    let (force_noise_n, metres_per_count) = if noisy { (1.0, 2.44140625e-6) } else { (0.0, 1e-8) };
    let seed = 4;
    let sensors =
        Sensors { sample_rate_hz: rate_hz, force_noise_n, metres_per_count, delay_s, seed, ..Sensors::default() };
    let settings =
        Settings { skew_s: 0.0, full_scale_velocity_m_per_s: 0.5, memory_s: 100.0, ..calibrated(device, &sensors) };
    let samples = shaken(device, motion, sensors).unwrap();
    let (sums, more) = sums(&settings, samples.lasting(20.0).map(|sample| raw(&sample)), Bank::Fast);
    (skew_s(&sums, &more).unwrap() - delay_s) * 1e6
}

#[test]
fn a_skew_is_seen_within_the_interval_of_the_setting() {
    for motion in ["multi", "random", "two"] {
        for delay_s in [0.0, 50e-6, -20e-6] {
            let error = skew_error_us(&Inerter::paper(), motion, 4000.0, true, delay_s);
            assert!(error.abs() < 1.0, "{motion}, {delay_s} s: off by {error} us");
        }
    }
}

/// A bias of the skew comes from dry friction alone: a kernel that smooths the step of the friction places the sign 3
/// to 6 us late. With the step removed, less than 1 us of this remains. Kernels, the correction for the structure and
/// the encoder's rounding contribute nothing.
#[test]
fn the_skew_has_no_offset_of_its_own() {
    // Nearly no friction. Without any there would be no sign to fit.
    let slippery = Inerter { coulomb_n: 0.5, ..Inerter::paper() };
    for motion in ["multi", "random", "two"] {
        for rate_hz in [1000.0, 4000.0] {
            let dry = skew_error_us(&Inerter::paper(), motion, rate_hz, false, 20e-6);
            assert!(dry.abs() < 1.2, "{motion} at {rate_hz} Hz: off by {dry} us");
            let wet = skew_error_us(&slippery, motion, rate_hz, false, 20e-6);
            assert!(wet.abs() < 0.1, "{motion} at {rate_hz} Hz: off by {wet} us without friction");
        }
    }
}
