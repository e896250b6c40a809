use inerter_core::{Machine, Settings};
use inerter_data::wants;
use inerter_needs::Random;
use inerter_plant::{Excitation, Inerter, Sensors};

use super::{
    candidates::{Candidate, Effort, candidates},
    information::Together,
    observed::Reach,
    search::{times, together},
    *,
};

/// The paper's device on a perfectly calibrated rig.
fn paper() -> Expected {
    let sensors = Sensors { force_noise_n: 1.0, ..Sensors::default() };
    let calibrated = inerter_simulate::calibrated(&Inerter::paper(), &sensors).unwrap();
    let settings = Settings {
        force_gain_u95: 0.0,
        lead_u95: 0.0,
        timebase_u95: 0.0,
        skew_u95_s: 0.0,
        stiffness_u95_n_per_m: 1.0,
        ..calibrated
    };
    Expected { device: Inerter::paper(), settings, force_noise_n: 1.0 }
}

fn rig() -> Limits {
    Limits { stroke_m: 0.01, speed_m_per_s: 0.1, force_n: 600.0, duration_s: 12.0, ..Limits::default() }
}

#[test]
fn no_other_shares_of_the_time_tell_more_than_the_design() {
    let expected = paper();
    let limits = rig().checked(&expected).unwrap();
    let found = candidates(&expected, &limits, Effort { frequencies: 6, varied: true }, |_| ()).unwrap();
    assert!(found.len() > 10, "{}", found.len());
    let choices: Vec<&Candidate> = found.iter().collect();
    let score = |all: &Together| all.told(&expected, None).map_or(f64::INFINITY, |told| told.log_det);
    let (best, least) = times(&choices, 12.0, score).unwrap();
    assert!((best.iter().sum::<f64>() - 12.0).abs() < 1e-9 && least.is_finite());
    // Any three of them, with any shares, are no better.
    let (mut random, mut tried) = (Random(7), 0);
    while tried < 2000 {
        let mut other = vec![0.0; best.len()];
        for _ in 0..3 {
            other[random.below(best.len())] += 1.0 + random.below(100) as f64;
        }
        let all: f64 = other.iter().sum();
        other.iter_mut().for_each(|time| *time *= 12.0 / all);
        if other.iter().zip(&choices).all(|(time, choice)| *time == 0.0 || *time >= choice.shortest_s) {
            tried += 1;
            let score = score(&together(&choices, &other).unwrap());
            assert!(score > least - 0.02, "{other:?}: {score} under {least}");
        }
    }
    // And it is better than any one alone.
    for place in 0..best.len() {
        let mut alone = vec![0.0; best.len()];
        alone[place] = 12.0;
        assert!(score(&together(&choices, &alone).unwrap()) >= least - 2e-3, "{place}");
    }
}

#[test]
fn a_design_keeps_its_limits_and_what_is_wanted_decides_its_length() {
    let expected = paper();
    let values = [299.4906, 31.4, 50.0, 0.0];
    let of = |text: &str| {
        let wants = wants::parse(text, Machine::Linear, values).unwrap();
        design(&expected, Limits { duration_s: 40.0, ..rig() }, &wants, |_| ()).unwrap()
    };
    let [coarse, fine] = ["cf to 3 N s/m", "cf to 1 N s/m"].map(of);
    for plan in [&coarse, &fine] {
        let Peaks { stroke_m, speed_m_per_s, force_n } = plan.prediction.peaks;
        assert!(stroke_m <= 0.01 && speed_m_per_s <= 0.1 && force_n <= 600.0, "{:?}", plan.prediction.peaks);
        assert!(plan.wants.iter().all(|want| plan.reached(want) <= want.u95), "{plan:?}");
        assert!((plan.motion.duration_s() - plan.duration_s).abs() < 1e-9 && plan.duration_s <= 40.0);
        let [start, end] = [0.0, plan.duration_s].map(|t_s| plan.motion.at(t_s));
        assert_eq!((start.x_m, end.x_m), (0.0, 0.0));
    }
    assert!(fine.duration_s > 1.2 * coarse.duration_s, "{} {}", fine.duration_s, coarse.duration_s);
}

#[test]
fn what_calibration_alone_forbids_does_not_stretch_the_motion() {
    let expected = paper();
    let expected = Expected { settings: Settings { force_gain_u95: 0.005, ..expected.settings }, ..expected };
    let wants = wants::parse("mt to 0.1 %, fc to 1 N", Machine::Linear, [299.4906, 31.4, 50.0, 0.0]).unwrap();
    let plan = design(&expected, Limits { duration_s: 60.0, ..rig() }, &wants, |_| ()).unwrap();
    let [of_inertance, of_coulomb] = wants.as_slice() else { panic!("{wants:?}") };
    assert!(plan.reached(of_coulomb) <= 1.0 && plan.duration_s < 10.0, "{}", plan.duration_s);
    assert!(plan.floor(of_inertance) > 1.4 && plan.enough_s(of_inertance).is_none());
}

#[test]
fn sums_by_speed_hold_all_updates() {
    let expected = paper();
    let motion = Excitation::parse("mid", 1).unwrap();
    let seen = expected.quick().see(&motion, 6.0, 3, Some(0.0)).unwrap();
    let [fast, _] = seen.products;
    let speeds = seen.speeds[0].clone().accumulated();
    let all = speeds.above(1e-9).unwrap();
    assert!((all.updates() / fast.updates() - 1.0).abs() < 0.01, "{} of {}", all.updates(), fast.updates());
    let ([a, v], [of_all, v_of_all]) = (fast.mean_squares(), all.mean_squares());
    assert!((of_all / a - 1.0).abs() < 0.01 && (v_of_all / v - 1.0).abs() < 0.01);
    // A tone is below half of its rms velocity during asin(0.354) of a quarter period.
    let away = speeds.above(0.5 * v.sqrt()).unwrap().updates() / fast.updates();
    assert!((away - (1.0 - 2.0 / std::f64::consts::PI * 0.354_f64.asin())).abs() < 0.04, "{away}");
}

#[test]
fn the_reach_of_a_run_is_that_of_its_motion() {
    let expected = paper();
    let sensors = Sensors { force_offset_n: 20.0, ..expected.sensors(5) };
    let mut reach = Reach::new(&expected.settings);
    let mut replay = inerter_data::replay::Replay::new(&expected.settings, 0.0).unwrap();
    let motion = Excitation::parse("mid", 1).unwrap();
    for sample in inerter_plant::Simulation::new(expected.device, motion.clone(), sensors).unwrap().lasting(10.0) {
        let raw = inerter_simulate::raw(&sample);
        reach.push(&raw);
        replay.step(&raw).for_each(drop);
    }
    let (found, limits) = observed(&replay.outcome(), &expected.settings, &reach).unwrap();
    let seen = expected.quick().see(&motion, 10.0, 5, None).unwrap();
    // The screw's, which moves slightly more than the terminal.
    assert!((limits.stroke_m / seen.peaks.stroke_m - 1.0).abs() < 0.1, "{limits:?} {:?}", seen.peaks);
    assert!((limits.speed_m_per_s / seen.peaks.speed_m_per_s - 1.0).abs() < 0.2, "{limits:?} {:?}", seen.peaks);
    assert!((limits.force_n / seen.peaks.force_n - 1.0).abs() < 0.02, "{limits:?} {:?}", seen.peaks);
    assert_eq!(limits.duration_s, 10.0);
    assert!((found.device.inertance_kg - 299.49).abs() < 0.2 && (found.device.coulomb_n - 50.0).abs() < 1.0);
    assert!((found.force_noise_n - 1.0).abs() < 0.2, "{}", found.force_noise_n);
}

#[test]
fn a_limit_that_is_none_is_named() {
    let expected = paper();
    let refused = |limits: Limits| limits.checked(&expected).unwrap_err().to_string();
    assert!(refused(Limits { stroke_m: 0.0, ..rig() }).contains("--stroke-m: 0"));
    assert!(refused(Limits { stroke_m: f64::INFINITY, ..rig() }).contains("--stroke-m is missing"));
    assert!(refused(Limits { speed_m_per_s: f64::NAN, ..rig() }).contains("--speed-m-per-s: NaN"));
    assert!(refused(Limits { force_n: 50.5, ..rig() }).contains("cannot move a screw"));
    assert!(refused(Limits { duration_s: f64::NAN, ..rig() }).contains("--duration: NaN"));
    assert!(refused(Limits { fade_s: -1.0, ..rig() }).contains("--fade-s: -1"));
    assert!(refused(Limits { lowest_hz: f64::NAN, ..rig() }).contains("--lowest-hz: NaN"));
    // The force channel's rails are a limit too.
    let settings = Settings { force_max_code: 20_000.0, ..expected.settings };
    let narrow = rig().checked(&Expected { settings, ..expected }).unwrap_err().to_string();
    assert!(narrow.contains("the force channel's range"), "{narrow}");
}
