//! The gates for impossible samples and for stops leave motions without a fault alone.

use inerter_core::State;
use inerter_data::settings::Overrides;
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Setup, bench_sensors};
use inerter_tests::grid::{MOTIONS, calibrated, published, raw, shaken};

#[test]
fn motions_without_a_fault_are_left_alone() {
    for device in [Inerter::paper(), Inerter::worn(), Inerter::stribeck()] {
        for motion in MOTIONS {
            for force_noise_n in [0.0, 0.2, 1.0, 20.0] {
                let sensors = Sensors { force_noise_n, force_offset_n: 3.0, seed: 31, ..Sensors::default() };
                let active = calibrated(&device, &sensors).validate().unwrap();
                let mut state = Box::new(State::new(&active));
                for sample in shaken(&device, motion.name, sensors).unwrap().lasting(motion.duration_s) {
                    let warning = active.step(&mut state, &raw(&sample)).warning;
                    assert_eq!(warning, None, "{}, {force_noise_n} N", motion.name);
                }
            }
        }
    }
}

/// A stop is judged in counts, regardless of how many of them a sample sums.
#[test]
fn as_many_samples_are_left_out_whatever_the_oversampling() {
    let updates = [1.0, 16.0, 64.0].map(|oversampling| {
        let bench = bench_sensors();
        // Keeps the scale of the summed codes, so that they fit.
        let newtons_per_code = bench.newtons_per_code * oversampling;
        let sensors = Sensors { oversampling, newtons_per_code, seed: 3, ..bench };
        let setup = Setup::new(Inerter::paper(), sensors, "random", None, &Overrides::default()).unwrap();
        let samples = setup.samples().unwrap().take(20_000).map(|sample| raw(&sample));
        published(&setup.settings, samples).unwrap().estimate.updates
    });
    assert_eq!(updates[1], updates[2]);
    assert!(updates[0] > 2_000 && updates[0].abs_diff(updates[1]) <= 2, "{updates:?}");
}
