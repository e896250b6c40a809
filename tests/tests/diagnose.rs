//! Causes that break the law are named and sized, and none where there is none; `cargo xtask diagnose` counts over many more runs.

use inerter_tests::{
    diagnose::{cases, clean_case},
    grid::MOTIONS,
};

#[test]
fn the_cause_is_named_first_and_its_size_is_right() {
    let motions: Vec<_> = MOTIONS.iter().filter(|motion| ["multi", "random"].contains(&motion.name)).collect();
    for case in cases().iter().filter(|case| !case.name.starts_with("Stribeck") && !case.name.starts_with("presliding"))
    {
        for motion in &motions {
            let found = case.diagnosed(motion, 31).unwrap();
            let cause = found.causes.first().unwrap_or_else(|| panic!("{}, {}: nothing", case.name, motion.name));
            assert_eq!(Some(cause.kind), case.kind, "{}, {}: {cause:?}", case.name, motion.name);
            // Friction by direction hardly shows.
            assert!((cause.value / case.size - 1.0).abs() < 0.25, "{}, {}: {cause:?}", case.name, motion.name);
            assert!(cause.u95 > 0.0 && cause.f > 1.0, "{cause:?}");
        }
    }
}

#[test]
fn parameters_are_right_again_with_the_cause_included() {
    let motion = MOTIONS.iter().find(|motion| motion.name == "random").unwrap();
    for case in cases().iter().filter(|case| ["friction of 4 % of the load", "force 1 ms late"].contains(&case.name)) {
        let corrected = case.diagnosed(motion, 32).unwrap().corrected.unwrap();
        let inertance = corrected.inertance_kg.fitted().value;
        assert!((f64::from(inertance) - case.device.inertance_kg).abs() < 0.3, "{}: {corrected:?}", case.name);
        let viscous = corrected.viscous_n_s_per_m.fitted();
        let off = (f64::from(viscous.value) - case.device.viscous_n_s_per_m).abs();
        assert!(off < f64::from(viscous.u95) && viscous.u95 < 60.0, "{}: {corrected:?}", case.name);
    }
}

#[test]
fn runs_without_a_fault_have_no_cause() {
    for motion in &MOTIONS {
        for (noise_n, rate_hz) in [(0.2, 1000.0), (5.0, 1000.0)] {
            let found = clean_case(noise_n, rate_hz).diagnosed(motion, 33).unwrap();
            assert_eq!(found.causes, [], "{}, {noise_n} N: {found:?}", motion.name);
        }
    }
}
