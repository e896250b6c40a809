//! The skew of a late force is found and corrected, or refused with a reason if the motion cannot show it.

use inerter_analysis::skew::SkewError;
use inerter_core::{LawStatus, Parameter, Parameters};
use inerter_data::settings::Overrides;
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::bench_sensors;
use inerter_tests::skew::{Case, Found, case, drawn, servo_axis};

/// The reference device with these instruments, including the delay of the force.
fn late(motion: &'static str, sensors: Sensors) -> Case {
    case(("Coulomb", Inerter::paper()), sensors, (motion, motion), &Overrides::default()).unwrap()
}

fn refusal(case: &Case) -> SkewError {
    match case.found().unwrap().skew {
        Err(error) => error,
        Ok(found) => panic!("{}: {found:?}", case.motion),
    }
}

/// Absolute error of a parameter divided by its interval, which must be narrower than `widest`.
#[track_caller]
fn part(parameter: &Parameter, truth: f64, widest: f64, what: &str) -> f64 {
    let found = parameter.known().unwrap_or_else(|| panic!("{what}: {parameter:?}"));
    assert!(f64::from(found.u95) < widest, "{what}: {found:?}");
    (f64::from(found.value) - truth).abs() / f64::from(found.u95)
}

/// The same for all parameters of the reference device.
#[track_caller]
fn parts(found: &Parameters, what: &str) -> [f64; 3] {
    let paper = Inerter::paper();
    [
        part(&found.inertance_kg, paper.inertance_kg, 2.6, what),
        part(&found.viscous_n_s_per_m, paper.viscous_n_s_per_m, 12.0, what),
        part(&found.coulomb_n, paper.coulomb_n, 1.5, what),
    ]
}

#[test]
fn a_skew_of_up_to_5_ms_is_found_and_undone() {
    let motions = ["random", "multi", "two", "moves:50mm:0.2m/s:4m/s2:0.2s"];
    let delays_ms = [-5.0, -3.37, -0.02, 0.0, 0.5, 1.75, 4.81];
    let rates_hz = [1000.0, 500.0, 2000.0, 4000.0];
    let mut all = Vec::new();
    for (at, delay_ms) in delays_ms.into_iter().enumerate() {
        for (motion, place) in motions.into_iter().zip(at..) {
            let sample_rate_hz = rates_hz[place % rates_hz.len()];
            let delay_s = delay_ms * 1e-3;
            let sensors = Sensors { delay_s, sample_rate_hz, seed: 101 + at as u64, ..bench_sensors() };
            let case = late(motion, sensors);
            let what = format!("{motion} at {sample_rate_hz} Hz, {delay_ms} ms");
            let Found { before, skew, after } = case.found().unwrap();
            let skew = skew.unwrap_or_else(|error| panic!("{what}: {error}"));
            let off_s = (skew.skew_s - delay_s).abs();
            assert!(off_s <= 1.5 * skew.u95_s && skew.u95_s < 12e-6, "{what}: {off_s} of {}", skew.u95_s);
            assert!((skew.left_s - skew.skew_s).abs() < 1e-12);
            let after = after.unwrap();
            all.extend(parts(&after.estimate.whole_run, &what).map(|part| (part, what.clone())));
            if delay_ms.abs() > 0.4 {
                let [was, is] = skew.residual_rms_n;
                assert!(is < 0.2 * was && (0.1..0.8).contains(&is), "{what}: {was} N to {is} N");
                assert_ne!(before.law.status, LawStatus::Holds, "{what}: the delay is not noticed");
                // A delay of 0.5 ms acts like a damper that is far too large for friction: without a value, or wrong.
                let viscous = before.estimate.whole_run.viscous_n_s_per_m;
                assert!(viscous.known().is_none_or(|found| (found.value - 31.4).abs() > 30.0), "{what}: {viscous:?}");
            }
        }
    }
    let outside: Vec<_> = all.iter().filter(|(part, _)| *part > 1.0).collect();
    assert!(outside.len() <= 8 && outside.iter().all(|(part, _)| *part < 2.0), "{outside:?} of {}", all.len());
}

#[test]
fn a_skew_that_is_in_use_is_counted() {
    let mut case = late("random", Sensors { delay_s: 1.4e-3, seed: 111, ..bench_sensors() });
    case.setup.settings.skew_s = 1.1e-3;
    case.setup.settings.skew_u95_s = 1e-5;
    let found = case.found().unwrap().skew.unwrap();
    assert!((found.skew_s - 1.4e-3).abs() < 2e-6 && (found.left_s - 0.3e-3).abs() < 2e-6, "{found:?}");
    assert!(found.is_better_than(&case.setup.settings));
    case.setup.settings.skew_s = found.skew_s;
    case.setup.settings.skew_u95_s = 0.5 * found.u95_s;
    let again = case.found().unwrap().skew.unwrap();
    assert!(again.left_s.abs() < 0.05 * found.u95_s && !again.is_better_than(&case.setup.settings), "{again:?}");
}

/// Kernels, signs and structure introduce no skew of their own.
#[test]
fn nothing_is_found_where_nothing_is() {
    for motion in ["random", "multi", "two"] {
        for sample_rate_hz in [1000.0, 4000.0] {
            let fine =
                Sensors { force_noise_n: 0.01, metres_per_count: 5e-9, newtons_per_code: 1e-3, ..bench_sensors() };
            let case = late(motion, Sensors { sample_rate_hz, seed: 112, ..fine });
            let found = case.found().unwrap().skew.unwrap();
            assert!(found.skew_s.abs() < 0.5e-6, "{motion} at {sample_rate_hz} Hz: {found:?}");
            assert!(found.skew_s.abs() < found.u95_s, "{motion} at {sample_rate_hz} Hz: {found:?}");
        }
    }
}

/// 2e-4 kg m^2 and torques below 0.1 N m: `calibrate skew` used to refuse such axes because of their friction.
#[test]
fn the_torque_of_a_servo_axis_1_75_ms_late_is_found_and_its_inertia_is_right() {
    for (text, seed) in [
        ("moves:6.28rad:15rad/s:300rad/s2:0.1s", 121),
        ("chirp:0.5-20Hz:5rad/s:20s", 122),
        ("multi:0.5-20Hz:5rad/s", 123),
    ] {
        let case = servo_axis(text, 1.75e-3, seed).unwrap();
        let Found { skew, after, .. } = case.found().unwrap();
        let skew = skew.unwrap_or_else(|error| panic!("{text}: {error}"));
        let off_s = (skew.skew_s - 1.75e-3).abs();
        assert!(off_s <= skew.u95_s && skew.u95_s < 80e-6, "{text}: {off_s} of {}", skew.u95_s);
        let [was, is] = skew.residual_rms_n.map(|rms_n| rms_n / skew.force_rms_n);
        assert!(was > 0.04 && is < 0.02 && is < 0.4 * was, "{text}: {was} to {is}");
        let inertia = after.unwrap().estimate.whole_run.inertance_kg.fitted();
        let off = (f64::from(inertia.value) - 2e-4).abs();
        assert!(off < f64::from(inertia.u95) && off < 0.02 * 2e-4, "{text}: {inertia:?}");
    }
}

#[test]
fn a_motion_that_cannot_show_a_skew_is_refused_and_told_why() {
    let delay_s = 5e-5;
    let tone = refusal(&late("fast", Sensors { delay_s, ..bench_sensors() }));
    assert!(matches!(tone, SkewError::SingleTone { .. }), "{tone}");
    assert!(tone.to_string().contains("a delay and viscous friction are indistinguishable"), "{tone}");
    let noisy = refusal(&late("random@3s;hold", Sensors { delay_s, force_noise_n: 3000.0, ..bench_sensors() }));
    assert!(matches!(noisy, SkewError::TooNoisy { .. }) && noisy.to_string().contains("noise hides"), "{noisy}");
    let still = refusal(&late("hold", Sensors { delay_s, ..bench_sensors() }));
    assert!(matches!(still, SkewError::Fit(_)) && still.to_string().contains("too little motion"), "{still}");
    for delay_s in [8e-3, -6e-3] {
        let mut case = late("random", bench_sensors());
        case.setup.sensors.delay_s = delay_s;
        let beyond = refusal(&case);
        assert!(matches!(beyond, SkewError::Beyond { .. }), "{beyond}");
    }
    let mut backwards = late("random", bench_sensors());
    backwards.setup.settings.newtons_per_code *= -1.0;
    let backwards = refusal(&backwards);
    assert!(matches!(backwards, SkewError::Backwards { .. }), "{backwards}");
}

#[test]
fn a_refusal_speaks_of_a_rotary_machine_in_its_words_and_units() {
    let mut case = servo_axis("sine:8Hz:0.6rad", 1e-4, 131).unwrap();
    let tone = refusal(&case).to_string();
    assert!(tone.contains("the torque changes in step") && !tone.contains("force"), "{tone}");
    case.setup.sensors.force_noise_n = 1.0;
    let noisy = refusal(&case).to_string();
    assert!(noisy.contains("N m rms") && noisy.contains("torque") && !noisy.contains("force"), "{noisy}");
}

/// Machines that determined no constant; `cargo xtask skew` runs many more.
#[test]
fn skews_of_machines_of_any_size_are_covered() {
    let (mut given, mut held) = (0, 0);
    for seed in 9001..=9030 {
        let case = drawn(seed).unwrap();
        if let Ok(skew) = case.found().unwrap().skew {
            given += 1;
            held += usize::from((skew.skew_s - case.delay_s()).abs() <= skew.u95_s);
        }
    }
    assert!(given >= 22 && held + 4 >= given, "{held} of {given}");
}

#[test]
fn impacts_that_are_not_resolved_widen_the_interval() {
    let of = |device, name| {
        let sensors = Sensors { delay_s: 1.75e-3, seed: 141, ..bench_sensors() };
        let case = case((name, device), sensors, ("multi", "multi"), &Overrides::default()).unwrap();
        let skew = case.found().unwrap().skew.unwrap();
        assert!((skew.skew_s - 1.75e-3).abs() <= skew.u95_s, "{skew:?}");
        skew.u95_s
    };
    let (worn, closed) = (of(Inerter::worn(), "backlash"), of(Inerter::paper(), "Coulomb"));
    assert!((3.0..30.0).contains(&(worn / closed)), "{worn} {closed}");
}
