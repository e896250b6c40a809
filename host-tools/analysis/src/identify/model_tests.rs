use inerter_plant::{Excitation, Inerter, Sensors, Simulation};

use super::*;
use crate::identify::Parameters;

/// The plant locates every change of mode; the simulation for fits misses those that begin and end within a
/// millisecond.
#[test]
fn it_does_what_the_plant_does() {
    for backlash_m in [0.0, 1e-4] {
        for motion in ["slow", "mid", "fast", "multi", "random", "two"] {
            let device = Inerter { backlash_m, ..Inerter::paper() };
            let excitation = Excitation::parse(motion, 3).unwrap();
            let truths: Vec<_> = Simulation::new(device, excitation, Sensors::default())
                .unwrap()
                .lasting(10.0)
                .map(|sample| sample.truth)
                .collect();
            let nodes: Vec<Node> = truths.iter().map(|t| [t.x1_m, t.v1_m_per_s, t.a1_m_per_s2]).collect();
            let model = Parameters::from(&device);
            let input = Input::new(&nodes, 1e-3, &model);
            let response = simulate(&model, &input, Start::default());
            let worst = |pairs: &mut dyn Iterator<Item = f64>| pairs.fold(0.0, f64::max);
            let position = worst(&mut truths.iter().zip(&response.position_m).map(|(t, x)| (t.x2_m - x).abs()));
            let square: f64 = truths.iter().zip(&response.force_n).map(|(t, f)| (t.force_n - f).powi(2)).sum();
            let force = (square / truths.len() as f64).sqrt();
            assert!(position < 2e-7, "{motion} {backlash_m}: {position}");
            assert!(force < 0.1, "{motion} {backlash_m}: {force}");
        }
    }
}

#[test]
fn a_delay_is_a_delay() {
    let wave = |t: f64| (0.1 * t).sin();
    let samples: Vec<f64> = (0..100).map(|n| wave(f64::from(n))).collect();
    for late in [-1.3, -0.25, 0.4, 2.75] {
        let shifted = delayed(&samples, late);
        let worst = (10..90).map(|n| (shifted[n] - wave(n as f64 - late)).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-5, "{late}: {worst}");
    }
    assert_eq!(delayed(&samples, 0.0), samples);
    assert!(delayed(&[], 0.5).is_empty());
}

#[test]
fn a_polynomial_seen_from_elsewhere_is_the_same() {
    let c = [1.0, -2.0, 0.5, 3.0, -0.7, 0.2];
    let other = rebased(&c, 0.3, 0.4);
    for u in [0.0, 0.5, 1.0] {
        assert!((value(&other, u) - value(&c, 0.3 + 0.4 * u)).abs() < 1e-12);
    }
}
