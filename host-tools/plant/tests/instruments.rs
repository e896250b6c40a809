//! Samples: scales, noise, delay, saturation, losses, seeds.

use inerter_plant::{Excitation, Inerter, Sample, Sensors, Simulation};

fn samples(sensors: Sensors, count: usize) -> Vec<Sample> {
    let motion = Excitation::preset("random", 3).unwrap();
    Simulation::new(Inerter::worn(), motion, sensors).unwrap().take(count).collect()
}

/// Mean, and rms deviation from it.
fn spread(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    (mean, (values.map(|v| (v - mean).powi(2)).sum::<f64>() / count).sqrt())
}

#[test]
fn codes_follow_the_truth_to_their_last_digit() {
    let sensors = Sensors { force_gain: 1.01, force_offset_n: 4.0, force_drift_n_per_s: 0.1, ..Sensors::default() };
    for sample in samples(sensors, 5000) {
        let t = sample.truth;
        assert_eq!(t.t_s, sample.t_s);
        assert_eq!(sample.t_s, f64::from(sample.index) / 1000.0);
        let below = t.x2_m - f64::from(sample.position_count) * sensors.metres_per_count;
        assert!((-1e-15..sensors.metres_per_count + 1e-15).contains(&below));
        let cell = 1.01 * (t.force_n + 1.515 * t.a1_m_per_s2) + 4.0 + 0.1 * t.t_s;
        assert!((f64::from(sample.force_code) * sensors.newtons_per_code - cell).abs() <= 0.001 + 1e-6);
        assert!((f64::from(sample.terminal_code) * sensors.metres_per_terminal_code - t.x1_m).abs() <= 0.5001e-7);
    }
}

#[test]
fn noise_is_as_told_with_and_without_oversampling() {
    for oversampling in [1.0, 16.0] {
        let quiet = Sensors { oversampling, ..Sensors::default() };
        let noisy = Sensors { force_noise_n: 1.0, terminal_noise_m: 1e-6, seed: 5, ..quiet };
        let (quiet, scale) = (samples(quiet, 20_000), noisy.newtons_per_sample_code());
        let noisy = samples(noisy, 20_000);
        let pairs = || noisy.iter().zip(&quiet);
        let (mean, rms) = spread(pairs().map(|(a, b)| f64::from(a.force_code - b.force_code) * scale));
        println!("{oversampling}: force {mean:.4} N, {rms:.4} N rms");
        assert!(mean.abs() < 0.03 && (rms - 1.0).abs() < 0.02);
        let (_, rms) = spread(pairs().map(|(a, b)| f64::from(a.terminal_code - b.terminal_code) * 1e-7));
        assert!((rms - 1e-6).abs() < 0.02e-6);
        assert!(pairs().all(|(a, b)| a.position_count == b.position_count && a.truth == b.truth));
    }
}

#[test]
fn a_sum_over_sub_samples_is_the_mean_around_its_time() {
    let sensors = Sensors { oversampling: 16.0, sample_rate_hz: 4000.0, ..Sensors::default() };
    for sample in samples(sensors, 8000).into_iter().skip(4000) {
        assert!((sample.t_s - (f64::from(sample.index) + 7.5 / 16.0) / 4000.0).abs() < 1e-12);
        // Rounding down reads half a count low on average.
        let position = (f64::from(sample.position_count) + 8.0) * sensors.metres_per_sample_count();
        assert!((position - sample.truth.x2_m).abs() < sensors.metres_per_count);
    }
    let alone = Sensors { oversampling: 1.0, sample_rate_hz: 64000.0, ..sensors };
    let one_by_one = samples(alone, 16 * 1000);
    for (sum, group) in samples(sensors, 1000).iter().zip(one_by_one.chunks(16)) {
        assert_eq!(sum.position_count, group.iter().map(|sample| sample.position_count).sum::<i32>());
        assert_eq!(sum.force_code, group.iter().map(|sample| sample.force_code).sum::<i32>());
    }
}

#[test]
fn the_force_comes_late_by_its_delay() {
    // A delay of 2.5 samples at 1 kHz is 10 samples at 4 kHz.
    for (delay_s, shift) in [(2.5e-3, 10i64), (-2.5e-3, -10)] {
        let late = samples(Sensors { delay_s, ..Sensors::default() }, 1000);
        let fine = samples(Sensors { sample_rate_hz: 4000.0, ..Sensors::default() }, 5000);
        for sample in late.iter().skip(10) {
            let then = usize::try_from(4 * i64::from(sample.index) - shift).unwrap();
            assert!((sample.force_code - fine[then].force_code).abs() <= 1);
            assert_eq!(sample.position_count, fine[4 * sample.index as usize].position_count);
        }
    }
    // Microseconds matter: a delay of 1 us shifts the force by its slope.
    let (late, now) = (
        samples(Sensors { delay_s: 1e-6, newtons_per_code: 1e-6, ..Sensors::default() }, 3000),
        samples(Sensors { newtons_per_code: 1e-6, ..Sensors::default() }, 3000),
    );
    assert!(late.iter().zip(&now).any(|(a, b)| (a.force_code - b.force_code).abs() > 1000));
}

#[test]
fn a_saturated_sample_stands_at_its_limit() {
    let sensors =
        Sensors { force_min_code: -50_000.0, force_max_code: 40_000.0, oversampling: 4.0, ..Sensors::default() };
    let codes: Vec<i32> = samples(sensors, 20_000).iter().map(|sample| sample.force_code).collect();
    assert_eq!(codes.iter().max(), Some(&160_000));
    assert_eq!(codes.iter().min(), Some(&-200_000));
}

#[test]
fn a_lost_sample_leaves_its_number_out() {
    let all = samples(Sensors { force_noise_n: 1.0, ..Sensors::default() }, 20_000);
    let some = samples(Sensors { force_noise_n: 1.0, lost_probability: 0.1, ..Sensors::default() }, 10_000);
    let last = some.last().unwrap().index;
    assert!((10_900..11_300).contains(&last), "{last}");
    assert!(some.iter().all(|sample| *sample == all[sample.index as usize]));
}

#[test]
fn the_same_seeds_give_the_same_samples() {
    let noisy = |seed| Sensors {
        force_noise_n: 1.0,
        terminal_noise_m: 1e-6,
        lost_probability: 0.01,
        seed,
        ..Sensors::default()
    };
    assert_eq!(samples(noisy(1), 5000), samples(noisy(1), 5000));
    let (a, b) = (samples(noisy(1), 5000), samples(noisy(2), 5000));
    assert!(a.iter().zip(&b).filter(|(a, b)| a.force_code != b.force_code).count() > 4000);
    // The sample rate does not affect the true values.
    let coarse = samples(Sensors::default(), 2000);
    let fine = samples(Sensors { sample_rate_hz: 8000.0, ..Sensors::default() }, 16_000);
    assert!(coarse.iter().zip(fine.iter().step_by(8)).all(|(a, b)| a.truth == b.truth));
}

#[test]
fn known_samples_stay_the_same() {
    let sensors = Sensors { force_noise_n: 1.0, encoder_phase_count: 0.5, seed: 42, ..Sensors::default() };
    let samples = samples(sensors, 2000);
    for (index, position, force) in
        [(499, -1004, 141_401), (999, 454, -90_803), (1499, -450, 1_082_106), (1999, 22, 363_820)]
    {
        let sample = samples[index];
        assert_eq!(sample.index as usize, index);
        // Sine and logarithm differ between machines in the last bit, so a code may differ by one.
        assert!((sample.position_count - position).abs() <= 1 && (sample.force_code - force).abs() <= 1, "{sample:?}");
    }
}

#[test]
fn pickup_and_knock_come_on_top_of_the_force() {
    let quiet = Sensors { newtons_per_code: 1e-3, ..Sensors::default() };
    let loud = Sensors { pickup_n: 5.0, pickup_hz: 60.0, knock_n: -200.0, knock_at_s: 1.0, knock_s: 0.01, ..quiet };
    for (a, b) in samples(loud, 3000).iter().zip(samples(quiet, 3000)) {
        let added = f64::from(a.force_code - b.force_code) * 1e-3;
        let mains = 5.0 * (std::f64::consts::TAU * 60.0 * a.t_s).sin();
        let since = a.t_s - 1.0;
        let knock =
            if (0.0..0.01).contains(&since) { -200.0 * (std::f64::consts::PI * since / 0.01).sin() } else { 0.0 };
        assert!((added - mains - knock).abs() < 1.001e-3, "{added} at {}", a.t_s);
        assert_eq!((a.position_count, a.truth), (b.position_count, b.truth));
    }
}
