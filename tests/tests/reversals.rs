//! Whether the estimator can tell Coulomb friction, which turns at once, from friction that takes its time.

use inerter_core::State;
use inerter_plant::{Excitation, Inerter, Sensors, Simulation};
use inerter_tests::data::Recording;
use inerter_tests::grid::{self, MOTIONS, RIGS, calibrated, raw};

#[test]
fn simulated_coulomb_friction_turns_at_once() {
    for motion in ["mid", "fast", "multi", "random", "two"] {
        let device = Inerter::paper();
        let sensors = Sensors { force_noise_n: 1.0, seed: 3, ..Sensors::default() };
        let active = calibrated(&device, &sensors).validate().unwrap();
        let mut state = State::new(&active);
        assert_eq!(active.publish(&state).detail.friction.reversal_ratio, None);
        for sample in Simulation::new(device, Excitation::parse(motion, 3).unwrap(), sensors).unwrap().lasting(20.0) {
            active.step(&mut state, &raw(&sample));
        }
        let ratio = active.publish(&state).detail.friction.reversal_ratio.unwrap();
        assert!((0.95..1.05).contains(&ratio), "{motion}: {ratio}");
    }
}

/// Run 30 of the grid begins with 5 ms of creeping: with 50 N of friction and its sign unknown, that one reversal took cf
/// 1.5 N s/m off over 20 s, five times what the others scatter.
#[test]
fn a_screw_that_creeps_before_friction_is_known_teaches_nothing() {
    let device = Inerter::paper();
    let random = &MOTIONS[4];
    let last = grid::run(&device, random, &RIGS[0], 30).unwrap().last.whole_run;
    let [_, viscous, coulomb] = grid::three(&last).map(|parameter| f64::from(parameter.fitted().value));
    assert!((viscous - device.viscous_n_s_per_m).abs() < 0.6, "{viscous}");
    assert!((coulomb - device.coulomb_n).abs() < 0.08, "{coulomb}");
}

#[test]
fn a_real_ball_screw_takes_its_time() {
    let Some(run) = Recording::Emps.run(1) else { return };
    let run = run.unwrap();
    let active = run.settings.validate().unwrap();
    let mut state = State::new(&active);
    for sample in &run.samples {
        active.step(&mut state, sample);
    }
    let ratio = active.publish(&state).detail.friction.reversal_ratio.unwrap();
    assert!((0.15..0.35).contains(&ratio), "{ratio}");
}
