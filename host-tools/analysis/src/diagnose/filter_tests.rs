use super::*;
use crate::law::{around, dot};
use inerter_data::series::Stretch;
use inerter_needs::Random;

/// White noise.
fn noise(samples: usize) -> Vec<f64> {
    let mut random = Random(1);
    (0..samples).map(|_| random.normal()).collect()
}

#[test]
fn the_noise_is_read_off_the_force_whatever_the_motion() {
    let settings = Settings::default();
    let force_n =
        noise(20_000).iter().zip(0..).map(|(noise, n)| 2.0 * noise + 500.0 * (0.1 * f64::from(n)).sin()).collect();
    let series = Series { period_s: 1e-3, stretches: vec![Stretch { force_n, ..Stretch::default() }] };
    let found = force_noise_n(&series, &settings);
    assert!((found / 2.0 - 1.0).abs() < 0.05, "{found}");
    // At least the rounding of the codes.
    let still = Series { period_s: 1e-3, stretches: vec![Stretch { force_n: vec![0.0; 100], ..Stretch::default() }] };
    assert!(force_noise_n(&still, &settings) > 0.0);
}

/// The rows' noise from force and encoder: as large as computed, and white beyond a box.
#[test]
fn noise_and_steps_are_white_behind_the_filter() {
    let law = Law { inertance_kg: 300.0, ..Law::default() };
    let settings = Settings { metres_per_count: 2.44e-6, ..Settings::default() };
    let filter = Filter::of(Sight::White(0.08), 1, 1e-3, &settings, &law, 1.0, 1.0);
    let (force, steps) = (noise(60_000), noise(120_000).split_off(60_000));
    let step_m = settings.metres_per_count * ROUNDING.sqrt();
    let Filter { kernels, whitening, spacing, .. } = &filter;
    let along: Vec<f64> = (100..59_900)
        .step_by(*spacing)
        .map(|middle| around(&kernels.force, &force, middle) - 300.0 * step_m * around(&kernels.second, &steps, middle))
        .collect();
    let half = whitening.len() / 2;
    let rows: Vec<f64> = (half..along.len() - half).map(|row| around(whitening, &along, row)).collect();
    let lag = |apart: usize| dot(&rows, &rows[apart..]) / rows.len() as f64;
    assert!((lag(0) / (filter.noise_square + filter.steps_square) - 1.0).abs() < 0.1, "{}", lag(0));
    for apart in [4, 6, 10, 20, 40] {
        assert!((lag(apart) / lag(0)).abs() < 0.15, "{apart}: {}", lag(apart) / lag(0));
    }
    // Steps that repeat four times are at least half again as large.
    let repeated = Filter::of(Sight::White(0.08), 1, 1e-3, &settings, &law, 1.0, 4.0);
    assert!(filter.inflation() == 1.0 && repeated.inflation() > 1.5 && repeated.steps_square < filter.steps_square);
}
