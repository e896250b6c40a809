use inerter_plant::{Inerter, Sensors};
use inerter_simulate::bench_sensors;

use super::*;
use crate::simulated::{recorded, setup};

/// An amplifier and a 12-bit converter, as in docs/HARDWARE.md: 262080 codes of 0.00957 N, noise of 0.05 % of the
/// range.
fn sensors() -> Sensors {
    Sensors {
        newtons_per_code: 0.01,
        force_min_code: -131_000.0,
        force_max_code: 131_000.0,
        force_noise_n: 1.0,
        ..bench_sensors()
    }
}

fn look(sensors: Sensors, motion: &str, seconds: f64) -> Result<Finding, CalibrateError> {
    diagnose(&recorded(&setup(Inerter::paper(), sensors, motion, seconds)), None)
}

fn figure(finding: &Finding, name: &str) -> f64 {
    finding.measured[name].as_f64().unwrap()
}

fn codes(finding: &Finding) -> Vec<&'static str> {
    finding.remarks.iter().map(|remark| remark.code).collect()
}

#[test]
fn a_good_cell_is_called_good_and_its_noise_is_right() {
    for seed in 0..10 {
        let finding = look(Sensors { seed, ..sensors() }, "hold", 10.0).unwrap();
        assert!(finding.remarks.is_empty(), "{:?}", finding.remarks);
        let noise_n = figure(&finding, "noise_n");
        assert!((noise_n - 1.0).abs() < 0.06, "{noise_n}");
        assert_eq!(figure(&finding, "mains_n"), 0.0);
    }
}

#[test]
fn mains_are_measured_beside_noise_and_drift_and_told_50_from_60() {
    for (hz, seed) in [(50.0, 1), (60.0, 2), (49.9, 3), (60.1, 4)] {
        let sensors = Sensors { pickup_n: 12.0, pickup_hz: hz, force_drift_n_per_s: 0.5, seed, ..sensors() };
        let finding = look(sensors, "hold", 10.0).unwrap();
        let amplitude_n = figure(&finding, "mains_n");
        assert!((amplitude_n - 12.0).abs() < 0.3, "{hz} {amplitude_n}");
        assert_eq!(figure(&finding, "mains_hz"), f64::round(hz / 10.0) * 10.0);
        let noise_n = figure(&finding, "noise_n");
        assert!((noise_n - 1.0).abs() < 0.08, "{noise_n}");
        let [drift, u95] = ["drift_n_per_s", "drift_u95_n_per_s"].map(|name| figure(&finding, name));
        assert!((drift - 0.5).abs() < u95 + 1e-3, "{drift} {u95}");
        assert_eq!(codes(&finding), ["mains", "drift"]);
    }
    // Harmless interference gets no remark.
    let finding = look(Sensors { pickup_n: 4.0, ..sensors() }, "hold", 10.0).unwrap();
    assert!(finding.remarks.is_empty() && figure(&finding, "mains_n") > 3.5, "{finding:?}");
}

#[test]
fn faults_are_named() {
    let named = |sensors| codes(&look(sensors, "hold", 5.0).unwrap());
    assert_eq!(named(Sensors { force_noise_n: 8.0, ..sensors() }), ["noise"]);
    assert_eq!(named(Sensors { force_noise_n: 0.0, ..sensors() }), ["dead"]);
    assert_eq!(named(Sensors { force_noise_n: 2e-3, force_offset_n: 2e-3, ..sensors() }), ["gain"]);
    assert_eq!(named(Sensors { force_offset_n: 1400.0, ..sensors() }), ["saturated"]);
    assert_eq!(named(Sensors { force_offset_n: -1100.0, ..sensors() }), ["off_centre"]);
    assert_eq!(named(Sensors { lost_probability: 0.01, ..sensors() }), ["lost"]);
    assert_eq!(named(Sensors { pickup_n: 60.0, ..sensors() }), ["mains"]);
    let finding = look(Sensors { pickup_n: 60.0, ..sensors() }, "hold", 5.0).unwrap();
    assert!(!finding.is_good() && finding.problems() == 1);
    assert!(matches!(look(sensors(), "mid", 5.0), Err(CalibrateError::Moving { .. })));
    assert!(matches!(look(sensors(), "hold", 2.0), Err(CalibrateError::TooShort { .. })));
}

#[test]
fn a_rate_that_is_not_the_one_stated_is_named() {
    let run = recorded(&setup(Inerter::paper(), sensors(), "hold", 5.0));
    let rate = |deviation| Some(Rate { deviation, scatter_u95: 1e-4, seconds: 5.0 });
    assert_eq!(codes(&diagnose(&run, rate(0.02)).unwrap()), ["rate"]);
    assert!(diagnose(&run, rate(1e-4)).unwrap().remarks.is_empty());
}
