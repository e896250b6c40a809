//! Motions without a fault are left alone by what looks for samples that no device can be blamed for.

use inerter_core::State;
use inerter_plant::{Excitation, Inerter, Sensors, Simulation};
use inerter_tests::grid::{MOTIONS, calibrated, raw};

#[test]
fn motions_without_a_fault_are_left_alone() {
    for device in [Inerter::paper(), Inerter::worn(), Inerter::stribeck()] {
        for motion in MOTIONS {
            for force_noise_n in [0.0, 0.2, 1.0, 20.0] {
                let sensors = Sensors { force_noise_n, force_offset_n: 3.0, seed: 31, ..Sensors::default() };
                let active = calibrated(&device, &sensors).validate().unwrap();
                let mut state = Box::new(State::new(&active));
                let excitation = Excitation::parse(motion.name, 31).unwrap();
                for sample in Simulation::new(device, excitation, sensors).unwrap().lasting(motion.duration_s) {
                    let warning = active.step(&mut state, &raw(&sample)).warning;
                    assert_eq!(warning, None, "{}, {force_noise_n} N", motion.name);
                }
            }
        }
    }
}
