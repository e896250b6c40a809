//! The intervals of both methods for the backlash: what each part represents, and how far single reversals and whole
//! runs scatter.

use crate::rig::{calibrated, exact, instruments, is_near, listen, shaken};
use inerter_core::{Budget, Contact, Detail, Interval, NORMAL_COVERAGE, RawSample, Reversal, Route, Settings, Source};
use inerter_plant::{Inerter, Sensors};

fn worn(backlash_m: f64) -> Inerter {
    Inerter { backlash_m, ..Inerter::paper() }
}

/// Two clocks, so that nothing repeats.
fn apart(seed: u64) -> Sensors {
    Sensors { sample_rate_hz: 1000.123, ..instruments(seed) }
}

/// From the force alone, or from the sensor alone because no stiffness is set.
fn by(route: Route, settings: &Settings) -> Settings {
    match route {
        Route::Force => Settings { terminal_sensor: false, ..*settings },
        Route::Terminal => Settings { terminal_sensor: true, stiffness_n_per_m: 0.0, ..*settings },
    }
}

struct Told {
    detail: Detail,
    /// Backlash, stiffness and damping.
    budgets: [Option<Budget>; 3],
    values: [f64; 3],
    reversals: Vec<Reversal>,
    repeats: f64,
}

fn told(settings: &Settings, samples: &[RawSample]) -> Told {
    let heard = listen(settings, samples);
    let detail = heard.last.detail;
    let contact = heard.active.budgets(&heard.state).contact;
    let value = |known: Option<Interval>| known.map_or(f64::NAN, |known| f64::from(known.value));
    let values = [
        value(detail.backlash.known()),
        value(detail.stiffness_n_per_m.known()),
        value(detail.contact_damping_n_s_per_m.known()),
    ];
    let budgets = [contact.backlash_m, contact.stiffness_n_per_m, contact.damping_n_s_per_m];
    // Every value has a budget, and the two agree.
    let u95s = [detail.backlash.known().map(|known| known.u95)].into_iter().chain(
        [detail.stiffness_n_per_m, detail.contact_damping_n_s_per_m].map(|all| all.known().map(|known| known.u95)),
    );
    for (u95, budget) in u95s.zip(&budgets) {
        assert_eq!(u95, budget.map(|budget| budget.u95()));
    }
    Told { detail, budgets, values, reversals: heard.reversals, repeats: f64::from(heard.state.repeats()) }
}

/// Gives a setting an error of its half width, in either direction.
type Wrong = fn(&mut Settings, f64);

/// A stiffness, a force or a count with an error of its stated uncertainty moves the backlash by its share.
#[test]
fn what_a_wrong_setting_does_to_a_backlash_is_its_part() {
    for (motion, backlash_m) in [("random", 100e-6), ("mid", 200e-6), ("slow", 50e-6)] {
        let device = worn(backlash_m);
        let sensors = Sensors { force_noise_n: 0.3, ..apart(3) };
        let duration_s = if motion == "slow" { 60.0 } else { 12.0 };
        let samples = shaken(&device, motion, duration_s, &sensors);
        let right = Settings {
            stiffness_u95_n_per_m: 0.02 * device.stiffness_n_per_m,
            force_gain_u95: 0.02,
            lead_u95: 0.01,
            ..by(Route::Force, &exact(calibrated(&device, &sensors)))
        };
        let wrong: [(Source, Wrong); 3] = [
            (Source::Stiffness, |s, sign| s.stiffness_n_per_m += sign * s.stiffness_u95_n_per_m),
            (Source::Gain, |s, sign| s.newtons_per_code *= 1.0 + sign * s.force_gain_u95),
            (Source::Lead, |s, sign| s.metres_per_count *= 1.0 + sign * s.lead_u95),
        ];
        let [budget, ..] = told(&right, &samples).budgets;
        for (source, change) in wrong {
            let [more, less] = [1.0, -1.0].map(|sign| {
                let mut settings = right;
                // The lag of the contact stays the same.
                let lag = settings.contact_damping_n_s_per_m / settings.stiffness_n_per_m;
                change(&mut settings, sign);
                settings.contact_damping_n_s_per_m = lag * settings.stiffness_n_per_m;
                told(&settings, &samples).values[0]
            });
            let given = f64::from(budget.unwrap().given_u95(source));
            let moved = 0.5 * (more - less).abs();
            assert!((moved - given).abs() < 0.05 * given + 0.05e-6, "{motion}, {source:?}: {moved} for {given}");
        }
    }
}

/// The encoder's share is two fifths of a count, plus the reversals' own noise as far as recurring strokes repeat it.
#[test]
fn the_encoders_part_of_a_backlash_is_of_its_count() {
    for count_m in [1e-6, 4e-6, 10e-6] {
        for (sample_rate_hz, oversampling) in [(1000.123, 1.0), (4000.7, 8.0)] {
            let device = worn(100e-6);
            let sensors = Sensors { metres_per_count: count_m, sample_rate_hz, oversampling, ..instruments(3) };
            let settings = by(Route::Force, &exact(calibrated(&device, &sensors)));
            let found = told(&settings, &shaken(&device, "random", 10.0, &sensors));
            let given = f64::from(found.budgets[0].unwrap().given_u95(Source::Encoder));
            is_near(given, 0.4 * count_m, 0.02, "two clocks");
        }
    }
    let device = worn(100e-6);
    let sensors = instruments(3);
    let settings = by(Route::Force, &exact(calibrated(&device, &sensors)));
    let found = told(&settings, &shaken(&device, "mid", 20.0, &sensors));
    let count = found.reversals.len() as f64;
    assert!(found.repeats > 4.0 && count > 100.0, "{} {count}", found.repeats);
    // Weighted by information.
    let own = count / found.reversals.iter().map(|each| f64::from(each.error_m).powi(-2)).sum::<f64>();
    let share = (found.repeats - 1.0) / f64::from(found.detail.backlash.reversals);
    let wanted = (0.4 * sensors.metres_per_count).hypot(f64::from(NORMAL_COVERAGE) * (own * share.min(1.0)).sqrt());
    is_near(f64::from(found.budgets[0].unwrap().given_u95(Source::Encoder)), wanted, 0.12, "one clock");
}

/// The stated scatter follows from the errors of the single reversals and their number. Each reversal belongs to its
/// own flight.
#[test]
fn reversals_scatter_by_their_own_error() {
    for (motion, backlash_m, least) in
        [("random", 50e-6, 150), ("mid", 50e-6, 50), ("fast", 200e-6, 250), ("multi", 0.0, 100)]
    {
        for route in [Route::Force, Route::Terminal] {
            let device = worn(backlash_m);
            let sensors = apart(3);
            let settings = by(route, &exact(calibrated(&device, &sensors)));
            let found = told(&settings, &shaken(&device, motion, 12.0, &sensors));
            let what = format!("{motion}, {route:?}, {backlash_m} m: {:?}", found.detail.backlash);
            let of_route: Vec<_> = found.reversals.iter().filter(|reversal| reversal.route == route).collect();
            assert_eq!(of_route.len(), found.reversals.len(), "{what}");
            let count = of_route.len() as f64;
            assert!(of_route.len() > least && found.detail.backlash.route == route, "{what}: {count}");
            let weights: f64 = of_route.iter().map(|each| f64::from(each.error_m).powi(-2)).sum();
            let mean =
                of_route.iter().map(|each| f64::from(each.value_m) / f64::from(each.error_m).powi(2)).sum::<f64>()
                    / weights;
            let chi = of_route.iter().map(|each| ((f64::from(each.value_m) - mean) / f64::from(each.error_m)).powi(2));
            let ratio = (chi.sum::<f64>() / count).sqrt();
            assert!((0.6..1.6).contains(&ratio), "{what}: {ratio}");
            let Interval { value, u95 } = found.detail.backlash.known().unwrap();
            assert!((mean - f64::from(value)).abs() < 0.6 * f64::from(u95), "{what}: mean {mean}");
            assert!((f64::from(value) - backlash_m).abs() < 1.5 * f64::from(u95), "{what}");
            let rising = of_route.iter().filter(|reversal| reversal.rising).count();
            assert!(rising.abs_diff(of_route.len() / 2) <= 1 + of_route.len() / 12, "{what}: {rising}");
            assert!(of_route.windows(2).all(|pair| pair[0].index < pair[1].index), "{what}");
            if route == Route::Force {
                let error = f64::from(found.budgets[0].unwrap().standard_error());
                let plain =
                    (of_route.iter().map(|each| (f64::from(each.value_m) - mean).powi(2)).sum::<f64>() / count / count)
                        .sqrt();
                assert!((0.6..1.4).contains(&(error / plain)), "{what}: {error} for {plain}");
            }
        }
    }
}

/// Backlash, stiffness and damping over many runs: within their intervals, which are no wider than necessary.
#[test]
fn runs_scatter_within_their_intervals() {
    const RUNS: u64 = 12;
    for (motion, backlash_m) in [("random", 50e-6), ("mid", 100e-6), ("fast", 100e-6)] {
        for route in [Route::Force, Route::Terminal] {
            let device = worn(backlash_m);
            let truths = [backlash_m, device.stiffness_n_per_m, device.contact_damping_n_s_per_m];
            let (mut squares, mut widths) = ([0.0; 3], [0.0; 3]);
            for seed in 1..=RUNS {
                let sensors = apart(seed);
                let settings = by(route, &exact(calibrated(&device, &sensors)));
                let found = told(&settings, &shaken(&device, motion, 10.0, &sensors));
                assert_eq!(found.detail.contact, Contact::Backlash);
                for i in 0..if route == Route::Force { 1 } else { 3 } {
                    let u95 = f64::from(found.budgets[i].unwrap().u95());
                    squares[i] += ((found.values[i] - truths[i]) / u95).powi(2) / RUNS as f64;
                    widths[i] += u95 / RUNS as f64;
                }
            }
            let what = format!("{motion}, {route:?}: {:?}, {widths:?}", squares.map(f64::sqrt));
            assert!(squares.iter().all(|square| square.sqrt() < 0.85), "{what}");
            assert!(squares[0].sqrt() > 0.03 && (0.2e-6..5e-6).contains(&widths[0]), "{what}");
            if route == Route::Terminal {
                assert!((0.00005..0.01).contains(&(widths[1] / truths[1])), "{what}");
                assert!((0.003..0.12).contains(&(widths[2] / truths[2])), "{what}");
            }
        }
    }
}

/// A displacement or force with an error of its stated uncertainty moves the sensor's results by its share.
#[test]
fn what_a_wrong_setting_does_to_stiffness_and_damping_is_its_part() {
    for motion in ["random", "mid"] {
        let device = worn(100e-6);
        let sensors = Sensors { force_noise_n: 0.3, terminal_noise_m: 0.2e-6, ..apart(5) };
        let samples = shaken(&device, motion, 12.0, &sensors);
        let right = Settings {
            force_gain_u95: 0.01,
            lead_u95: 0.0005,
            skew_u95_s: 2e-6,
            ..by(Route::Terminal, &exact(calibrated(&device, &sensors)))
        };
        let plain = told(&right, &samples);
        let of = |change: &dyn Fn(&mut Settings, f64)| {
            [1.0, -1.0].map(|sign| {
                let mut settings = right;
                change(&mut settings, sign);
                told(&settings, &samples).values
            })
        };
        let gain = of(&|s, sign| s.newtons_per_code *= 1.0 + sign * s.force_gain_u95);
        let lead = of(&|s, sign| s.metres_per_count *= 1.0 + sign * s.lead_u95);
        let skew = of(&|s, sign| s.skew_s += sign * s.skew_u95_s);
        let given = |i: usize, source| f64::from(plain.budgets[i].unwrap().given_u95(source));
        let moved = |[more, less]: [[f64; 3]; 2], i: usize| 0.5 * (more[i] - less[i]).abs();
        for i in 1..3 {
            is_near(moved(gain, i), given(i, Source::Gain), 0.05, &format!("{motion}: gain {i}"));
            // The budget includes the false deflection but not its rate: most of the damping's shift, not all of it.
            let part = if i == 1 { 0.1 } else { 0.6 };
            is_near(moved(lead, i), given(i, Source::Lead), part, &format!("{motion}: lead {i}"));
        }
        is_near(moved(lead, 0), given(0, Source::Lead), 0.1, &format!("{motion}: lead of the backlash"));
        is_near(moved(skew, 2), given(2, Source::Skew), 0.03, &format!("{motion}: skew"));
        is_near(given(2, Source::Skew), 2e-6 * plain.values[1], 1e-3, motion);
        // The force's scale does not affect lengths.
        assert!(moved(gain, 0) < 0.02e-6 && given(0, Source::Gain) == 0.0, "{motion}");
        // Blocks of 4 ms reduce the damping by half a percent at most.
        assert!(given(2, Source::Model) >= 0.005 * plain.values[2] * 0.999, "{motion}");
    }
}

/// Noise of the terminal lowers the coefficients, and the interval includes the remaining uncertainty.
#[test]
fn a_noisy_terminal_keeps_its_stiffness_and_loses_its_damping() {
    let device = worn(100e-6);
    let mut widths = Vec::new();
    for noise_m in [0.3e-6, 3e-6, 10e-6] {
        let sensors = Sensors { terminal_noise_m: noise_m, ..apart(5) };
        let settings = by(Route::Terminal, &exact(calibrated(&device, &sensors)));
        let found = told(&settings, &shaken(&device, "random", 20.0, &sensors));
        let Interval { value, u95 } = found.detail.stiffness_n_per_m.known().unwrap();
        let error = (f64::from(value) - device.stiffness_n_per_m) / f64::from(u95);
        assert!(error.abs() < 1.2, "{noise_m} m: {error}, {:?}", found.detail.stiffness_n_per_m);
        widths.push(f64::from(u95) / device.stiffness_n_per_m);
        if let Some(Interval { value, u95 }) = found.detail.contact_damping_n_s_per_m.known() {
            assert!((f64::from(value) - device.contact_damping_n_s_per_m).abs() < 1.2 * f64::from(u95), "{noise_m} m");
        }
    }
    assert!(widths[0] < widths[1] && 2.0 * widths[1] < widths[2] && widths[2] < 0.5, "{widths:?}");
    // If the noise dominates, there is no value.
    let sensors = Sensors { terminal_noise_m: 1e-3, ..apart(5) };
    let settings = by(Route::Terminal, &exact(calibrated(&device, &sensors)));
    let found = told(&settings, &shaken(&device, "random", 10.0, &sensors));
    assert!(found.values.iter().all(|value| value.is_nan()), "{:?}", found.values);
}

/// The method with the narrower interval is published.
#[test]
fn the_better_route_is_told() {
    let device = worn(100e-6);
    for (terminal_noise_m, wanted) in [(0.5e-6, Route::Terminal), (60e-6, Route::Force)] {
        let sensors = Sensors { terminal_noise_m, ..apart(5) };
        let settings = exact(calibrated(&device, &sensors));
        let samples = shaken(&device, "mid", 12.0, &sensors);
        let both = told(&Settings { terminal_sensor: true, ..settings }, &samples);
        let by_force = told(&by(Route::Force, &settings), &samples);
        assert_eq!(both.detail.backlash.route, wanted);
        let [both, by_force] = [&both, &by_force].map(|told| told.detail.backlash.known().unwrap().u95);
        assert!(both <= by_force && (both == by_force) == (wanted == Route::Force), "{both} {by_force}");
    }
}

/// The mirrored device has the same contact, interval by interval.
#[test]
fn the_contact_in_the_mirror_is_the_same() {
    let device = worn(100e-6);
    let sensors = apart(6);
    let settings = Settings { terminal_sensor: true, lead_u95: 0.001, ..calibrated(&device, &sensors) };
    // From a position within the gap, pressed against one flank first.
    let samples = shaken(&device, "hold@1s;mid@12s", 60.0, &sensors);
    let turned: Vec<RawSample> = samples
        .iter()
        .map(|sample| RawSample {
            position_count: !sample.position_count,
            force_code: -sample.force_code,
            terminal_code: -sample.terminal_code,
            ..*sample
        })
        .collect();
    for settings in [settings, by(Route::Force, &settings), by(Route::Terminal, &settings)] {
        let [here, there] = [&samples, &turned].map(|samples| told(&settings, samples));
        assert_eq!(here.reversals.len(), there.reversals.len());
        for (one, other) in here.reversals.iter().zip(&there.reversals) {
            assert_eq!((one.index, one.rising), (other.index, !other.rising));
            assert!((one.value_m - other.value_m).abs() < 0.1e-6, "{one:?} {other:?}");
        }
        for (i, (here, there)) in here.budgets.iter().zip(&there.budgets).enumerate() {
            assert_eq!(here.is_some(), there.is_some());
            let (Some(here), Some(there)) = (here, there) else { continue };
            for source in Source::ALL {
                let [here, there] = [here, there].map(|budget| f64::from(budget.given_u95(source)));
                assert!((here - there).abs() <= 0.03 * here.max(there), "{i}, {source:?}: {here} {there}");
            }
        }
    }
}

/// With the sensor, a pattern of the encoder's steps counts as often as strokes recur. The flanks are assumed to have
/// at most eight patterns.
#[test]
fn patterns_of_steps_are_in_what_the_sensor_tells() {
    let device = worn(100e-6);
    let of = |sensors: Sensors, duration_s: f64| {
        let settings = by(Route::Terminal, &exact(calibrated(&device, &sensors)));
        let found = told(&settings, &shaken(&device, "mid", duration_s, &sensors));
        (found.budgets.map(|budget| f64::from(budget.unwrap().given_u95(Source::Encoder))), found)
    };
    let (two_clocks, other) = of(apart(6), 16.0);
    let (one_clock, same) = of(instruments(6), 16.0);
    assert!(other.repeats < 4.0 && same.repeats > 6.0, "{} {}", other.repeats, same.repeats);
    let share = (same.repeats - 1.0) / f64::from(same.detail.backlash.reversals);
    let wanted = (share / (1.0 / 8.0)).sqrt();
    assert!(wanted > 1.1, "{wanted}");
    for (one, two) in one_clock.into_iter().zip(two_clocks) {
        is_near(one / two, wanted, 0.05, "one clock over two");
    }
    // A finer count has a proportionally smaller part.
    let finer = Sensors { metres_per_count: 0.5 * apart(6).metres_per_count, ..apart(6) };
    for (fine, two) in of(finer, 16.0).0.into_iter().zip(two_clocks) {
        is_near(fine / two, 0.5, 0.05, "half a count");
    }
}

/// A lost sample costs the reversals in progress; the force's noise remains what it was.
#[test]
fn a_lost_sample_costs_few_reversals() {
    let device = worn(100e-6);
    let sensors = apart(6);
    let samples = shaken(&device, "fast", 14.0, &sensors);
    for route in [Route::Force, Route::Terminal] {
        let settings = by(route, &exact(calibrated(&device, &sensors)));
        let whole = told(&settings, &samples).reversals.len();
        let lost = (3000..13_000).step_by(1003);
        let count = lost.clone().count();
        let less: Vec<RawSample> =
            samples.iter().filter(|sample| !lost.clone().any(|at| sample.index == at)).copied().collect();
        assert_eq!(samples.len() - less.len(), count);
        let fewer = told(&settings, &less).reversals.len();
        assert!((count / 2..=2 * count).contains(&(whole - fewer)), "{route:?}: {whole} and {fewer}");
    }
}

/// With the sensor, the backlash is the side's coefficient divided by the stiffness. A wrong travel changes both, and
/// their shifts of the backlash add with their signs. The interval's share is this sum.
#[test]
fn what_a_wrong_travel_does_to_a_backlash_with_the_sensor_is_its_part() {
    for (motion, backlash_m) in
        [("random", 100e-6), ("random", 300e-6), ("mid", 30e-6), ("mid", 100e-6), ("mid", 300e-6), ("two", 300e-6)]
    {
        let device = worn(backlash_m);
        let sensors = Sensors { force_noise_n: 0.3, terminal_noise_m: 0.2e-6, ..apart(5) };
        let samples = shaken(&device, motion, 12.0, &sensors);
        let right = Settings { lead_u95: 0.0005, ..by(Route::Terminal, &exact(calibrated(&device, &sensors))) };
        let [more, less] = [1.0, -1.0].map(|sign| {
            let metres_per_count = right.metres_per_count * (1.0 + sign * right.lead_u95);
            told(&Settings { metres_per_count, ..right }, &samples).values[0]
        });
        let budget = told(&right, &samples).budgets[0].unwrap();
        let given = f64::from(budget.given_u95(Source::Lead));
        is_near(given, 0.5 * (more - less).abs(), 0.05, &format!("{motion}, {backlash_m} m"));
    }
}
