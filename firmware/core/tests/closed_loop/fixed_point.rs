//! The fixed-point estimator against the same algorithm in f64.

use crate::{linear::Cholesky, reference::Pair, rig};
use inerter_core::Settings;
use inerter_plant::{Excitation, Inerter, Sensors, Simulation};

fn pair(motion: &str, rate_hz: f64, change: impl Fn(&mut Settings)) -> Pair {
    pair_of(motion, rate_hz, Sensors::default().metres_per_count, change)
}

fn pair_of(motion: &str, rate_hz: f64, metres_per_count: f64, change: impl Fn(&mut Settings)) -> Pair {
    let device = Inerter::paper();
    let sensors = Sensors {
        sample_rate_hz: rate_hz,
        metres_per_count,
        force_noise_n: 1.0,
        force_offset_n: -4.0,
        encoder_phase_count: 0.4,
        seed: 3,
        ..Sensors::default()
    };
    let mut settings = rig::calibrated(&device, &sensors);
    change(&mut settings);
    let excitation = Excitation::parse(motion, 3).unwrap();
    let duration_s = excitation.duration_s();
    let mut pair = Pair::new(&settings).unwrap();
    for sample in Simulation::new(device, excitation, sensors).unwrap().lasting(duration_s) {
        pair.step(&rig::raw(&sample));
    }
    pair
}

#[track_caller]
fn agrees(pair: &Pair, updates: u32) {
    assert!(pair.agrees(), "{:?}", pair.greatest);
    // If the two computations shared their rounding, they would not be independent.
    assert!(pair.greatest.iter().all(|greatest| *greatest > 0.0), "{:?}", pair.greatest);
    assert!(pair.updates() >= updates, "{} updates", pair.updates());
    assert!(pair.compared > 500, "{} values", pair.compared);
}

#[test]
fn all_motions() {
    let motion = "mid@90s;hold@10s;slow@200s;random@120s;hold@2s;fast@120s;two@120s;multi@120s;hold@30s;random@120s";
    agrees(&pair(motion, 1000.0, |_| ()), 100_000);
}

#[test]
fn slow_motion_alone() {
    agrees(&pair("slow@400s", 1000.0, |_| ()), 40_000);
}

#[test]
fn a_memory_as_short_as_can_be_at_the_highest_rate() {
    agrees(&pair("random@40s;slow@40s", 5000.0, |settings| settings.memory_s = 0.5), 8_000);
}

#[test]
fn full_scales_far_from_what_comes() {
    let far = |settings: &mut Settings| {
        settings.full_scale_velocity_m_per_s = 50.0;
        settings.full_scale_acceleration_m_per_s2 = 5000.0;
    };
    agrees(&pair("random@60s;mid@60s", 1000.0, far), 10_000);
}

/// Covers the case in which the fast bank is dominated by the encoder's steps and the slow bank's kernel is longer than
/// the moves.
#[test]
fn short_moves_in_coarse_counts() {
    let coarse = |settings: &mut Settings| settings.memory_s = 6.0;
    // At 1 kHz both banks have the same unit of the acceleration.
    for rate_hz in [1000.0, 700.0, 1300.0, 2000.0, 3100.0] {
        for um in [10.0, 20.0, 30.0] {
            let motion = "moves:10mm:100mm/s:3m/s2:10ms@20s;hold@2s;mid@4s;moves:3mm:100mm/s:3m/s2:10ms@20s";
            let pair = pair_of(motion, rate_hz, um * 1e-6, coarse);
            assert!(pair.agrees(), "{rate_hz} Hz, {um} um: {:?}", pair.greatest);
            assert!(pair.compared > 500, "{rate_hz} Hz, {um} um: {} values", pair.compared);
        }
    }
}

/// A matrix for the solver of the reference.
const MATRIX: [[f64; 3]; 3] = [[4.0, 2.0, 1e-3], [2.0, 3.0, 0.0], [1e-3, 0.0, 1e-6]];

#[test]
fn solves_what_it_was_made_from() {
    let wanted = [0.5, -2.0, 300.0];
    let right = std::array::from_fn(|i| (0..3).map(|k| MATRIX[i][k] * wanted[k]).sum());
    let found = Cholesky::of(&MATRIX, 1e-12).unwrap().solve(&right);
    for (found, wanted) in found.iter().zip(wanted) {
        assert!((found / wanted - 1.0).abs() < 1e-12, "{found} {wanted}");
    }
}

#[test]
fn inverts() {
    // From the cofactors of the upper left block and the determinant.
    let determinant = 4.0 * 3.0 * 1e-6 - 2.0 * 2.0 * 1e-6 - 3.0 * 1e-6;
    let found = Cholesky::of(&MATRIX, 1e-12).unwrap().inverse_diagonal();
    assert!((found[0] - 3.0 * 1e-6 / determinant).abs() < 1e-12);
    assert!((found[2] / (8.0 / determinant) - 1.0).abs() < 1e-12);
}

#[test]
fn refuses_what_is_not_definite() {
    assert!(Cholesky::of(&[[1.0, 1.0], [1.0, 1.0]], 1e-12).is_none());
    assert!(Cholesky::of(&[[0.0, 0.0], [0.0, 1.0]], 1e-12).is_none());
    assert!(Cholesky::of(&[[f64::NAN, 0.0], [0.0, 1.0]], 1e-12).is_none());
}
