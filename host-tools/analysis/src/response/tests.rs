use inerter_data::settings::Overrides;
use inerter_plant::Sensors;
use inerter_simulate::{Setup, bench_sensors};

use super::*;
use crate::{identify::Parameters, simulated::recorded};

const PAPER: Parameters = Parameters {
    inertance_kg: 299.4906,
    viscous_n_s_per_m: 31.4,
    coulomb_n: 0.0,
    stiffness_n_per_m: 2.1e6,
    contact_damping_n_s_per_m: 1200.0,
    backlash_m: 0.0,
    structure_mass_kg: 1.515,
    offset_n: 0.0,
    skew_s: 0.0,
};

fn simulated(excite: &str, duration_s: f64, coulomb_n: f64, terminal: bool) -> Series {
    let device = inerter_plant::Inerter { coulomb_n, ..inerter_plant::Inerter::paper() };
    let sensors = Sensors { terminal_noise_m: 1e-6, ..bench_sensors() };
    let mut overrides = Overrides::default();
    overrides.set("terminal_sensor", f64::from(u8::from(terminal)), "test").unwrap();
    Series::of(&recorded(&Setup::new(device, sensors, excite, Some(duration_s), &overrides).unwrap()))
}

#[test]
fn a_random_motion_shows_the_complete_model_within_its_interval() {
    for terminal in [false, true] {
        let response = measured(&simulated("random", 60.0, 0.0, terminal));
        let input = if terminal { Input::Terminal } else { Input::Screw };
        assert_eq!(response.input, input);
        // The window's bias at a resonance hardly wider than its bins.
        let bias = if terminal { 0.02 } else { 1e-3 };
        let within = |point: &&Point| {
            let expected = model(&PAPER, input, point.frequency_hz);
            // A wider interval, for two components instead of one.
            (point.response / expected - 1.0).norm() < 1.3 * point.error + bias
        };
        let highest_hz = if terminal { 11.0 } else { 14.5 };
        let seen = |point: &&Point| (1.0..highest_hz).contains(&point.frequency_hz);
        let band: Vec<_> = response.points.iter().filter(seen).collect();
        let good = band.iter().copied().filter(|point| within(point)).count();
        assert!(band.len() >= 40 && good * 100 >= 93 * band.len(), "{terminal}: {good} of {}", band.len());
        let closest = band.iter().map(|point| point.error).fold(f64::INFINITY, f64::min);
        assert!(closest < 0.02, "{closest}");
    }
}

#[test]
fn a_tone_shows_the_model_with_its_friction_at_its_frequency() {
    for (excite, frequency_hz, seconds) in [("mid", 3.2, 20.0), ("fast", 15.9, 20.0), ("slow", 0.053, 120.0)] {
        let series = simulated(excite, seconds, 50.0, true);
        let response = measured(&series);
        assert_eq!(response.method, Method::Tones, "{excite}");
        let [point] = response.points.as_slice() else { panic!("{excite}: {response:?}") };
        assert!((point.frequency_hz / frequency_hz - 1.0).abs() < 2e-4, "{excite}: {point:?}");
        let friction = equivalent_viscous(&series, 50.0).unwrap();
        let parameters = Parameters { viscous_n_s_per_m: PAPER.viscous_n_s_per_m + friction, ..PAPER };
        let off = (point.response / model(&parameters, Input::Terminal, point.frequency_hz) - 1.0).norm();
        // At 0.053 Hz the screw sticks for some degrees at each end, which viscous friction never does.
        assert!(off < if excite == "slow" { 0.06 } else { 0.03 }, "{excite}: {off} {point:?}");
        assert!(point.error < 0.03, "{excite}: {point:?}");
    }
}

#[test]
fn two_tones_are_two_points_and_rest_is_none() {
    let response = measured(&simulated("two", 20.0, 50.0, false));
    let frequencies: Vec<f64> = response.points.iter().map(|point| (point.frequency_hz * 10.0).round()).collect();
    assert_eq!((response.method, frequencies), (Method::Tones, vec![8.0, 64.0]));
    assert!(measured(&simulated("hold", 10.0, 50.0, false)).points.is_empty());
    assert!(measured(&Series { period_s: 1e-3, ..Series::default() }).points.is_empty());
    assert!(measured(&simulated("random", 0.05, 50.0, false)).points.is_empty());
}

#[test]
fn the_papers_device_is_ideal_from_1_2_to_27_rad_per_s() {
    let within = Agreement { decibels: 1.0, degrees: 5.0 };
    let (low, high) = ideal_band(&PAPER, within).unwrap();
    let (low, high) = (low.unwrap() * std::f64::consts::TAU, high.unwrap() * std::f64::consts::TAU);
    // Below, viscous friction shifts the phase: cf / (mt tan 5); above, the resonance raises the magnitude by 1 dB.
    assert!((low / (31.4 / (299.4906 * 5f64.to_radians().tan())) - 1.0).abs() < 1e-3, "{low}");
    let lifted = (2.1e6 / 299.4906 * (1.0 - 10f64.powf(-0.05))).sqrt();
    assert!((high / lifted - 1.0).abs() < 1e-2, "{high} against {lifted}");
    let rigid = Parameters { inertance_kg: 1.0, ..Parameters::default() };
    assert_eq!(ideal_band(&rigid, within), Some((None, None)));
    let damper = Parameters { viscous_n_s_per_m: 1e9, ..rigid };
    assert_eq!(ideal_band(&damper, within), None);
}
