//! Causes that break the law are named and sized, and none is named without a fault. `cargo xtask diagnose` runs many
//! more.

use inerter_analysis::diagnose::{Cause, Diagnosis, Encoder, Kind, assumptions, diagnose, widened};
use inerter_core::Machine;
use inerter_data::{run::Run, series::Series, words::rounded_text};
use inerter_plant::{Inerter, Sensors};
use inerter_tests::{
    data::replayed,
    diagnose::{Added, Case, Replayed, WITHIN, case, cases, clean_case, clean_cases, others},
    grid::{MOTIONS, Motion, error, motion},
};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::PI;

#[test]
fn the_cause_is_named_first_and_its_size_is_right() {
    let motions = ["multi", "random"].map(motion);
    // Stribeck friction is named only in part of the runs that reveal it (docs/tables/diagnose.md).
    for case in cases().iter().filter(|case| case.kind != Some(Kind::Stribeck)) {
        for motion in motions {
            let found = case.diagnosed(motion, 31).unwrap();
            let cause = found.causes.first().unwrap_or_else(|| panic!("{}, {}: nothing", case.name, motion.name));
            assert_eq!(Some(cause.kind), case.kind, "{}, {}: {cause:?}", case.name, motion.name);
            assert!((cause.value / case.size - 1.0).abs() < 0.1, "{}, {}: {cause:?}", case.name, motion.name);
            assert!(cause.u95 > 0.0 && cause.f > 1.0, "{cause:?}");
        }
    }
}

#[test]
fn parameters_are_right_again_with_the_cause_included() {
    let motion = motion("random");
    for case in cases().iter().filter(|case| ["friction of 4 % of the load", "force 1 ms late"].contains(&case.name)) {
        let corrected = case.diagnosed(motion, 32).unwrap().corrected.unwrap();
        let (off, _) = error(corrected.inertance_kg.fitted(), case.device.inertance_kg);
        assert!(off.abs() < 0.3, "{}: {corrected:?}", case.name);
        let (off, u95) = error(corrected.viscous_n_s_per_m.fitted(), case.device.viscous_n_s_per_m);
        assert!(off.abs() < u95 && u95 < 60.0, "{}: {corrected:?}", case.name);
    }
}

/// Encoders of 2000 and 2048 counts imply turns that 20 s of this tone cannot separate, nor can it separate those of
/// 8000 and 8192.
#[test]
fn a_turn_that_nobody_gave_widens_what_rests_on_it() {
    let motion = motion("mid");
    let case = case("ripple of 10 N");
    let run = case.recorded(motion, 2, true).unwrap();
    let outcome = replayed(&run).unwrap();
    let told = |counts_per_turn| {
        let encoder = Encoder { counts_per_turn, ..Encoder::default() };
        let found = diagnose(&Series::of(&run), &run.settings, &outcome.published(), encoder, &|| {}).unwrap();
        let cause = found.causes.first().copied().unwrap();
        assert_eq!(cause.kind, Kind::PositionPeriodic);
        let (off, u95) = error(found.corrected.unwrap().inertance_kg.fitted(), case.device.inertance_kg);
        assert!((cause.value - case.size).abs() < cause.u95 && off.abs() < u95, "{found:?}");
        [cause.u95, u95]
    };
    let (sought, given) = (told(None), told(Some(case.sensors.lead_m / case.sensors.metres_per_count)));
    assert!(sought.iter().zip(given).all(|(sought, given)| *sought > 2.0 * given), "{sought:?} {given:?}");
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

/// A single knock against the rig at the greatest force: no cause is named for it, although a cause that acts only
/// there would explain it.
#[test]
fn what_happened_once_is_no_cause() {
    for name in ["mid", "multi", "random"] {
        let motion = motion(name);
        for (seed, knock_n, length) in [(35, 30.0, 40), (36, 30.0, 100), (37, -60.0, 40)] {
            let mut run = clean_case(1.0, 1000.0).recorded(motion, seed, true).unwrap();
            let code_n = run.settings.newtons_per_code;
            let codes = run.samples.iter().map(|sample| sample.force_code).enumerate().skip(2_000);
            let (top, greatest) = codes.max_by_key(|(_, code)| code.abs()).unwrap();
            for (n, sample) in run.samples.iter_mut().skip(top - length / 2).take(length).enumerate() {
                let shape = f64::from(greatest.signum()) * (PI * n as f64 / length as f64).sin();
                sample.force_code += (knock_n * shape / code_n).round() as i32;
            }
            assert_eq!(diagnosed(&run).causes, [], "{name}, {knock_n} N, {length} ms");
        }
    }
}

/// The force wanders by 3 N with a time constant of 0.3 s, as if air currents acted on the load cell: no cause is named
/// for that either.
#[test]
fn what_wanders_is_no_cause() {
    const RMS_N: f64 = 3.0;
    let keep = (-1.0 / 300.0_f64).exp();
    for name in ["mid", "fast", "multi", "random"] {
        let motion = motion(name);
        for seed in 38..=40 {
            let mut run = clean_case(1.0, 1000.0).recorded(motion, seed, true).unwrap();
            let code_n = run.settings.newtons_per_code;
            let (mut random, mut wandering_n) = (ChaCha8Rng::seed_from_u64(seed), 0.0);
            for sample in &mut run.samples {
                let normal: f64 = StandardNormal.sample(&mut random);
                wandering_n = keep * wandering_n + RMS_N * (1.0 - keep * keep).sqrt() * normal;
                sample.force_code += (wandering_n / code_n).round() as i32;
            }
            assert_eq!(diagnosed(&run).causes, [], "{name}, {seed}");
        }
    }
}

/// The result of `diagnose` for a run, without further information.
fn diagnosed(run: &Run) -> Diagnosis {
    let outcome = replayed(run).unwrap();
    diagnose(&Series::of(run), &run.settings, &outcome.published(), Encoder::default(), &|| {}).unwrap()
}

/// A force of 0.3 N once per turn is too small to be named, and shifts the inertance by more than the device's interval
/// covers.
#[test]
fn what_is_too_small_to_be_named_widens_the_interval_by_the_samples() {
    let motion = motion("random");
    let clean = clean_case(1.0, 1000.0);
    let rippled = Case { added: Added { ripple_n: 0.3, ..clean.added }, ..clean };
    let [mut by_device, mut by_samples] = [0; 2];
    let mut wider = [0.0; 3];
    for seed in 41..=46 {
        let Replayed { outcome, causes, judged } = rippled.replayed(motion, seed).unwrap();
        assert_eq!(causes, []);
        let (off, device_u95) = error(outcome.estimate.whole_run.inertance_kg.fitted(), rippled.device.inertance_kg);
        let u95 = f64::from(judged[0].budget.u95());
        by_device += usize::from(off.abs() <= device_u95);
        by_samples += usize::from(off.abs() <= u95);
        assert!(judged[0].moved_by.is_some(), "{:?}", judged[0]);
        let words = widened(Machine::Linear, &outcome.estimate.whole_run, &judged).unwrap();
        let inertance = format!(" Effective inertance: {} kg", rounded_text(u95, u95));
        assert!(words.contains(&inertance) && words.contains("moved most by what looks like"), "{words}");
        // Without a fault, the intervals grow only as far as the run cannot exclude one.
        let Replayed { outcome, judged, .. } = clean.replayed(motion, seed).unwrap();
        for ((budget, judged), wider) in outcome.budgets.whole_run.iter().zip(&judged).zip(&mut wider) {
            *wider += judged.budget.u95() / budget.u95() / 6.0;
        }
    }
    assert!(wider.iter().all(|wider| (1.0..1.8).contains(wider)), "{wider:?}");
    assert!(by_samples >= 5 && by_device <= 3, "{by_device} of 6 by the device, {by_samples} by the samples");
}

/// Friction of 0.25 % of the load shifts viscous friction by 40 N s/m, and the law leaves too little of it unexplained
/// to be broken.
#[test]
fn what_is_far_beyond_chance_widens_the_interval_also_where_the_law_leaves_little_of_it() {
    for name in ["random", "multi"] {
        let motion = motion(name);
        for seed in [47, 48] {
            let off_and_u95 = |load: f64| {
                let clean = clean_case(1.0, 1000.0);
                let case = Case { added: Added { load, ..clean.added }, ..clean };
                let Replayed { outcome, judged: [_, viscous, ..], .. } = case.replayed(motion, seed).unwrap();
                let found = outcome.estimate.whole_run.viscous_n_s_per_m.fitted();
                let (off, by_device) = error(found, case.device.viscous_n_s_per_m);
                (off.abs(), by_device, f64::from(viscous.budget.u95()), viscous.moved_by)
            };
            let (off, by_device, by_samples, moved_by) = off_and_u95(0.0025);
            assert!(off > by_device && off < by_samples, "{name}: off {off}, {by_device}, {by_samples}");
            assert_eq!(moved_by, Some(Kind::LoadDependent), "{name}");
            let (_, by_device, by_samples, _) = off_and_u95(0.0);
            assert!(by_samples < 2.0 * by_device, "{name}: {by_device}, {by_samples}");
        }
    }
}

/// With the finest noise and counts, the part of the plant that the law omits comes closest to being far beyond chance.
#[test]
fn runs_without_a_fault_are_not_far_beyond_chance() {
    let fine = clean_cases().into_iter().filter(|case| {
        case.sensors.force_noise_n < 0.5 || case.sensors.metres_per_count < 1e-6 || case.device.inertance_kg < 100.0
    });
    for case in fine {
        for motion in MOTIONS.iter().filter(|motion| !motion.is_slow()) {
            let Replayed { outcome, judged, .. } = case.replayed(motion, 54).unwrap();
            for (budget, judged) in outcome.budgets.whole_run.iter().zip(&judged) {
                // A cause far beyond chance shifts a parameter by twenty intervals and more if the law leaves so little
                // of it.
                assert!(judged.budget.u95() < 12.0 * budget.u95(), "{}: {budget:?}, {judged:?}", motion.name);
            }
        }
    }
}

/// Presliding over 0.03 um shifts the inertance by more than the device's interval covers, and is not visible anywhere.
#[test]
fn friction_that_turns_nearly_at_once_is_what_the_inertance_rests_on() {
    for name in ["fast", "random", "multi"] {
        let motion = motion(name);
        let clean = clean_case(1.0, 1000.0);
        let device = Inerter { presliding_m: 0.03e-6, ..clean.device };
        let case = Case { device, ..clean };
        let Replayed { outcome, causes, judged: [inertance, ..] } = case.replayed(motion, 53).unwrap();
        let found = outcome.estimate.whole_run.inertance_kg.fitted();
        let (off, u95) = error(found, device.inertance_kg);
        assert!(causes.is_empty() && off.abs() > u95, "{name}: {causes:?}, {off} of {found:?}");
        assert!(inertance.assumes.contains(&Kind::Presliding), "{name}: {inertance:?}");
    }
}

#[test]
fn what_a_motion_cannot_tell_is_named_as_an_assumption() {
    let assumed = |name: &str| {
        let motion = motion(name);
        let [inertance, viscous, ..] = clean_case(1.0, 1000.0).replayed(motion, 51).unwrap().judged;
        (inertance.assumes, viscous.assumes)
    };
    let (_, of_a_tone) = assumed("fast");
    assert!(of_a_tone.contains(&Kind::LoadDependent) && of_a_tone.contains(&Kind::Skew), "{of_a_tone:?}");
    let (of_inertance, of_viscous) = assumed("random");
    assert!(of_viscous.contains(&Kind::LoadDependent) && !of_viscous.contains(&Kind::Skew), "{of_viscous:?}");
    assert!(
        of_inertance.contains(&Kind::LoadDependent) && !of_inertance.contains(&Kind::Direction),
        "{of_inertance:?}"
    );
}

/// Next to a named cause, the report says which parameter the motion cannot separate from it.
#[test]
fn a_cause_that_was_found_is_no_mere_assumption() {
    let motion = motion("random");
    let case = case("ripple of 10 N");
    let Replayed { causes, judged, .. } = case.replayed(motion, 52).unwrap();
    assert_eq!(causes.iter().map(|cause| cause.kind).collect::<Vec<_>>(), [Kind::PositionPeriodic]);
    let words = assumptions(Machine::Linear, &judged, &causes).unwrap();
    assert_eq!(
        words.matches("force or friction that repeats with the turns (found in this run)").count(),
        2,
        "{words}"
    );
    assert_eq!(words.matches("found in this run").count(), 2, "{words}");
    assert!(!assumptions(Machine::Linear, &judged, &[]).unwrap().contains("found"));
}

#[test]
fn what_is_beside_the_screw_or_in_the_cell_is_named() {
    for name in ["multi", "random"] {
        let motion = motion(name);
        for case in others() {
            let found = case.diagnosed(motion, 34).unwrap();
            let first = found.causes.first().unwrap_or_else(|| panic!("{name}, {}: nothing", case.name));
            assert_eq!(Some(first.kind), case.kind, "{name}, {}: {found:?}", case.name);
            let is_sized = (first.value / case.size - 1.0).abs() < 0.1;
            assert!(case.size.is_nan() || is_sized, "{name}, {}: {first:?}", case.name);
            let inertance = found.corrected.unwrap().inertance_kg.fitted();
            let (off, _) = error(inertance, case.device.inertance_kg);
            assert!(off.abs() / case.device.inertance_kg < 1e-3, "{name}, {}: {inertance:?}", case.name);
        }
    }
}

/// In a tone, a force proportional to the position is indistinguishable from inertance.
#[test]
fn in_a_tone_inertance_rests_on_the_absence_of_a_spring() {
    let motion = motion("mid");
    let [spring, ..] = others();
    let Replayed { outcome, judged: [inertance, ..], .. } = spring.replayed(motion, 35).unwrap();
    let found = outcome.estimate.whole_run.inertance_kg.fitted();
    let (wrong, u95) = error(found, spring.device.inertance_kg);
    assert!(wrong.abs() > 2.0 * u95, "{wrong}: {found:?}");
    assert!(inertance.assumes.contains(&Kind::Spring), "{inertance:?}");
}

/// An encoder mount that deflects by 4 um under 1 kN looks like inertance, and in a tone it looks like nothing else.
#[test]
fn in_a_tone_inertance_rests_on_a_position_that_does_not_give_way() {
    const COMPLIANCE_M_PER_N: f64 = 4e-9;
    let motion = motion("mid");
    let case = clean_case(1.0, 1000.0);
    let mut run = case.recorded(motion, 55, true).unwrap();
    let truths = case.truths(motion, 55).unwrap();
    for (sample, truth) in run.samples.iter_mut().zip(truths.iter().step_by(WITHIN)) {
        let seen_m = truth.x2_m + COMPLIANCE_M_PER_N * truth.force_n;
        sample.position_count = (seen_m / run.settings.metres_per_count).round() as i32;
    }
    let Replayed { outcome, causes, judged: [inertance, ..] } = Replayed::of(&run).unwrap();
    let found = outcome.estimate.whole_run.inertance_kg.fitted();
    let (off, u95) = error(found, case.device.inertance_kg);
    assert!(causes.is_empty() && off.abs() > 2.0 * u95, "{causes:?}, {off} of {found:?}");
    assert!(inertance.assumes.contains(&Kind::Compliance), "{inertance:?}");
}

/// Each cause found is tested again, together with all later ones and against every alternative.
#[test]
fn nothing_is_named_beside_the_only_cause() {
    let motion = motion("two");
    let names = ["friction of 4 % of the load", "presliding 200 um", "a spring"];
    for case in cases().into_iter().chain(others()).filter(|case| names.contains(&case.name)) {
        let found = case.diagnosed(motion, 9301).unwrap().causes;
        assert_eq!(found.iter().map(|cause| Some(cause.kind)).collect::<Vec<_>>(), [case.kind], "{found:?}");
    }
}

/// A skew is removed before the search for other causes, because they do not show clearly next to it.
#[test]
fn what_is_beside_a_skew_is_named_too() {
    let motion = motion("random");
    for name in ["friction of 4 % of the load", "ripple of 10 N"] {
        let case = case(name);
        let late = Case { sensors: Sensors { delay_s: 1e-3, ..case.sensors }, ..case };
        let found = late.diagnosed(motion, 56).unwrap().causes;
        let size = |kind: Kind| found.iter().find(|cause| cause.kind == kind).map_or(0.0, |cause| cause.value);
        assert!((size(Kind::Skew) / 1e-3 - 1.0).abs() < 0.05, "{name}: {found:?}");
        assert!((size(case.kind.unwrap()) / case.size - 1.0).abs() < 0.1, "{name}: {found:?}");
    }
}

/// In slow motion the encoder's steps are a large part of the acceleration, and their correction is known only to a
/// half.
#[test]
fn a_distance_is_right_in_slow_motion() {
    let case = case("presliding 50 um");
    for seed in [61, 62] {
        let found = case.diagnosed(&MOTIONS[0], seed).unwrap().causes;
        let is_right = |cause: &Cause| cause.kind == Kind::Presliding && (cause.value / case.size - 1.0).abs() < 0.05;
        assert!(MOTIONS[0].is_slow() && found.first().is_some_and(is_right), "{found:?}");
    }
}

/// Regressors made from the measured force contain its noise, which is correlated with the force.
#[test]
fn noise_of_a_slow_motion_is_no_cause() {
    for seed in [61, 63] {
        let found = clean_case(5.0, 1000.0).diagnosed(&MOTIONS[0], seed).unwrap().causes;
        assert!(MOTIONS[0].is_slow() && found.is_empty(), "{found:?}");
    }
}

/// Here all of the friction turns over the distance. With a separate parameter for the part that turns, the distance
/// would be half as large again.
#[test]
fn the_distance_is_right_where_all_of_friction_turns() {
    let motion = motion("multi");
    let case = case("presliding 50 um");
    for seed in [9301, 9302] {
        let found = case.diagnosed(motion, seed).unwrap().causes;
        let is_right = |cause: &Cause| cause.kind == Kind::Presliding && (cause.value / case.size - 1.0).abs() < 0.05;
        assert!(found.first().is_some_and(is_right), "{found:?}");
    }
}

/// A cause with more parameters leaves a smaller residual by chance alone. If that decided, this search would go
/// astray.
#[test]
fn of_causes_that_explain_alike_the_simplest_is_named() {
    let motion = motion("multi");
    let [_, square, _] = others();
    let found = square.diagnosed(motion, 9302).unwrap().causes;
    let told: Vec<_> = found.iter().map(|cause| (cause.kind, cause.rival)).collect();
    // Friction that decreases with speed explains the residual equally well, and is named as the rival.
    assert_eq!(told, [(Kind::QuadraticFriction, Some(Kind::Stribeck))], "{found:?}");
}

/// Moves with rests between them leave few places for long kernels.
#[test]
fn a_cause_is_named_in_stop_and_go() {
    let motion = Motion { name: "moves:50mm:0.3m/s:4m/s2:0.1s", ..MOTIONS[1] };
    for case in others() {
        let found = case.diagnosed(&motion, 36).unwrap();
        let first = found.causes.first().unwrap_or_else(|| panic!("{}: nothing", case.name));
        assert_eq!(Some(first.kind), case.kind, "{}: {found:?}", case.name);
    }
}
