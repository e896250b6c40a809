use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Setup, bench_sensors};

use super::*;
use crate::simulated::{recorded, setup};

/// The sequence of loads: both directions, up and down, back to zero.
const MASSES_KG: [f64; 9] = [0.0, 5.0, 10.0, 5.0, 0.0, -5.0, -10.0, -5.0, 0.0];

fn readings(masses_kg: &[f64], sensors: Sensors, truth: impl Fn(f64) -> f64) -> (Vec<(Load, rest::Level)>, Settings) {
    let setup = setup(Inerter::paper(), sensors, "hold", 3.1);
    let readings = masses_kg.iter().enumerate().map(|(place, &kg)| {
        let load = Load::mass(kg, &Gravity::given(STANDARD_GRAVITY));
        let sensors = Sensors { seed: sensors.seed * 100 + place as u64, ..sensors };
        let setup = Setup { load_n: truth(load.force_n), sensors, ..setup.clone() };
        (load, rest::level(&recorded(&setup).samples, &setup.settings, 3.0, "").unwrap())
    });
    (readings.collect(), setup.settings)
}

fn number(finding: &Finding, name: &str) -> f64 {
    finding.values[name].as_f64().unwrap()
}

#[test]
fn a_gain_error_is_found_within_its_interval_over_many_seeds() {
    let mut within = 0;
    let mut widest: f64 = 0.0;
    for seed in 0..40 {
        // Masses with a common error within their uncertainty, a slightly nonlinear cell, and a zero with hysteresis.
        let part = (seed as f64 * 0.618_034).fract() * 2.0 - 1.0;
        let (masses_u95, gain) = (1e-3, 1.0 + 0.03 * part);
        let sensors = Sensors { seed, force_gain: gain, force_offset_n: 7.0, ..bench_sensors() };
        let off = 1.0 - masses_u95 * part;
        let (readings, settings) = readings(&MASSES_KG, sensors, |force| force * off * (1.0 + 4e-6 * force));
        let finding = force(&readings, masses_u95, &settings).unwrap();
        // Each code stands for gain * true force; the expected value is the true force per code.
        let expected = settings.newtons_per_code / gain;
        let (found, u95) = (number(&finding, "newtons_per_code"), number(&finding, "force_gain_u95"));
        widest = widest.max(u95);
        within += u32::from((found / expected - 1.0).abs() <= u95);
        assert!((number(&finding, "force_zero_code") - 7.0 / 0.002).abs() < 60.0);
        assert!(finding.is_good());
    }
    // At least 95 %; more, because the largest error of the masses is always covered.
    assert!(within >= 38 && widest < 3e-3, "{within} {widest}");
}

#[test]
fn swapped_wires_are_a_negative_scale_and_are_told() {
    let sensors = Sensors { newtons_per_code: -0.002, ..bench_sensors() };
    let (readings, settings) = readings(&MASSES_KG, sensors, |force| force);
    let before = Settings { newtons_per_code: 0.002, ..settings };
    let finding = force(&readings, 0.0, &before).unwrap();
    assert!((number(&finding, "newtons_per_code") / -0.002 - 1.0).abs() < 2e-3);
    assert_eq!(finding.remarks.first().map(|remark| remark.code), Some("sign"));
    assert!(finding.adopted_by(&before).is_ok());
}

#[test]
fn nonsense_is_refused_and_named() {
    let refused = |masses: &[f64], truth: fn(f64) -> f64| {
        let (readings, settings) = readings(masses, bench_sensors(), truth);
        force(&readings, 0.0, &settings).unwrap_err()
    };
    assert!(matches!(refused(&MASSES_KG, f64::abs), CalibrateError::BothWays { direction: "rises" }));
    assert!(matches!(refused(&MASSES_KG, |_| 3.0), CalibrateError::Unchanged { .. }));
    assert!(matches!(refused(&[0.0, 5.0], |force| force), CalibrateError::TooFewPoints { .. }));
    assert!(matches!(refused(&[5.0, 5.0, 5.0], |force| force), CalibrateError::TooFewPoints { different: 1, .. }));
    // 4 kg entered as 5 kg.
    let mistyped = |force: f64| if (49.0..49.1).contains(&force) { 39.2 } else { force };
    match refused(&[0.0, 2.0, 5.0, 8.0, 10.0, 0.0], mistyped) {
        CalibrateError::Crooked { worst, .. } => assert_eq!(worst, "load 3 of 6 (5 kg)"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_was_not_shown_is_remarked() {
    let (readings, settings) = readings(&[0.0, 5.0, 10.0], bench_sensors(), |force| force);
    let finding = force(&readings, 0.0, &settings).unwrap();
    let codes: Vec<_> = finding.remarks.iter().map(|remark| remark.code).collect();
    assert!(codes.starts_with(&["one_direction", "no_return"]), "{codes:?}");
}

#[test]
fn gravity_follows_the_latitude() {
    assert!((Gravity::at_latitude(45.0).value - 9.8062).abs() < 1e-4);
    assert!((Gravity::at_latitude(90.0).value - 9.8322).abs() < 1e-4);
    assert!((Gravity::at_latitude(0.0).value - 9.7803).abs() < 1e-4);
    for latitude in [0.0, 30.0, 60.0, 90.0] {
        let here = Gravity::at_latitude(latitude).value;
        assert!((here / Gravity::ANYWHERE.value - 1.0).abs() <= Gravity::ANYWHERE.u95, "{latitude}");
    }
}
