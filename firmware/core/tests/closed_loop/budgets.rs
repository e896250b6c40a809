//! The parts of an interval, compared with the same in f64 (`textbook`), with the plant, and with runs in which a cause
//! is present.

use crate::rig::{self, calibrated, four, instruments, is_near, listen, off, shaken, three, truth};
use crate::textbook::{Kernel, Rows, Scatter, budgets, fit, moved};
use inerter_core::{
    Active, Bank, Budget, Interval, LawStatus, NORMAL_COVERAGE, Published, RawSample, Regime, Settings, Source, State,
};
use inerter_plant::{Inerter, Sensors};

/// All uncertainties stated, a memory longer than any run here.
fn stated(device: &Inerter, sensors: &Sensors) -> Settings {
    Settings {
        force_gain_u95: 0.004,
        lead_u95: 0.002,
        timebase_u95: 0.0007,
        skew_u95_s: 20e-6,
        structure_mass_u95_kg: 0.3,
        stiffness_u95_n_per_m: 0.07 * device.stiffness_n_per_m,
        memory_s: 1000.0,
        ..calibrated(device, sensors)
    }
}

struct Told {
    active: Active,
    state: Box<State>,
    published: Published,
    rows: [Rows; 2],
}

fn told(settings: &Settings, samples: &[RawSample]) -> Told {
    let active = settings.validate().unwrap();
    let mut state = Box::new(State::new(&active));
    let mut rows = [Bank::Fast, Bank::Slow].map(Rows::new);
    for sample in samples {
        active.step(&mut state, sample);
        rows.iter_mut().for_each(|rows| rows.follow(&active, &state));
    }
    Told { published: active.publish(&state), active, state, rows }
}

const SOURCES: [Source; 8] = [
    Source::Noise,
    Source::Encoder,
    Source::Skew,
    Source::Gain,
    Source::Lead,
    Source::Timebase,
    Source::Structure,
    Source::Stiffness,
];

/// One run, and the bank whose result is published.
struct Rig {
    motion: &'static str,
    device: Inerter,
    sensors: Sensors,
    settings: Settings,
    bank: Bank,
}

/// Runs whose intervals have different parts: noise; steps that repeat, or are coarse, or slow; many readings; a gap; a
/// contact of unknown stiffness.
fn rigs() -> Vec<Rig> {
    let usual = instruments(5);
    let paper = Inerter::paper();
    let rig = |motion, metres_per_count: f64, device: Inerter| {
        let sensors = Sensors { metres_per_count, ..usual };
        Rig { motion, device, sensors, settings: stated(&device, &sensors), bank: Bank::Fast }
    };
    let fine = usual.metres_per_count;
    let board = Sensors { sample_rate_hz: 4000.0, oversampling: 16.0, newtons_per_code: 0.01, ..usual };
    let light = Inerter { inertance_kg: 20.0, viscous_n_s_per_m: 200.0, coulomb_n: 8.0, ..paper };
    let random = rig("random@20s", fine, paper);
    vec![
        rig("two@20s", fine, paper),
        rig("mid@10s", 20e-6, paper),
        rig("fast@15s", 10e-6, paper),
        rig("random@10s", fine, light),
        rig("random@10s", fine, Inerter { backlash_m: 50e-6, ..paper }),
        rig("sine:2Hz:2mm@20s", 40e-6, Inerter { structure_mass_kg: 0.0, ..paper }),
        rig("slow@60s", fine, paper),
        Rig { bank: Bank::Slow, ..rig("slow@60s", -8e-6, paper) },
        Rig { bank: Bank::Slow, ..rig("slow@60s", 20e-6, paper) },
        Rig { motion: "multi@10s", device: paper, sensors: board, settings: stated(&paper, &board), bank: Bank::Fast },
        Rig { settings: Settings { stiffness_n_per_m: 0.0, ..random.settings }, ..rig("random@10s", fine, paper) },
        Rig { settings: Settings { stiffness_u95_n_per_m: 0.0, ..random.settings }, ..rig("slow@30s", fine, paper) },
        random,
    ]
}

impl Rig {
    fn told(&self) -> Told {
        told(&self.settings, &shaken(&self.device, self.motion, 60.0, &self.sensors))
    }
}

#[test]
fn every_part_of_every_interval_is_that_of_the_theory() {
    for rig in rigs() {
        let Told { active, state, published, rows } = rig.told();
        let Rig { motion, sensors, settings, bank, .. } = rig;
        assert_eq!(published.estimate.bank, bank, "{motion} {} m", sensors.metres_per_count);
        let rows = &rows[bank as usize].rows;
        let kernel = Kernel::of(&settings, bank);
        let known = fit(rows, &kernel, settings.oversampling);
        let motion_of = active.motion(&state);
        let scatter = Scatter::of(&known, &kernel, &settings, &motion_of);
        let wanted = budgets(&known, &scatter, &settings, &motion_of);
        let found = active.budgets(&state).whole_run;
        let parameters = four(&published.estimate.whole_run);
        for i in 0..4 {
            let what = format!("{motion} {} m, parameter {i}", sensors.metres_per_count);
            let structure = if i == 0 { settings.structure_mass_kg } else { 0.0 };
            let Interval { value, u95 } = parameters[i].fitted();
            is_near(f64::from(value) + structure, known.values[i], 2e-4, &what);
            for source in SOURCES {
                let square = wanted[i][source as usize];
                let given = f64::from(found[i].given_u95(source) / NORMAL_COVERAGE);
                is_near(given, square.sqrt(), 2e-3, &format!("{what}, {source:?}"));
            }
            is_near(f64::from(found[i].scatter_freedom()), known.observations - 4.0, 1e-4, &what);
            assert_eq!(u95, found[i].u95(), "{what}");
            let squares: f32 = found[i].parts().iter().map(|(_, part)| part * part).sum();
            is_near(f64::from(squares.sqrt()), f64::from(u95), 1e-5, &what);
        }
        // The motion's properties that enter the budget.
        is_near(f64::from(motion_of.acceleration_squared), known.acceleration_squared, 1e-3, motion);
        is_near(f64::from(motion_of.low_squared), known.acceleration_squared / known.velocity_squared, 1e-3, motion);
        let readings = rows.len() as f64 * kernel.spacing * settings.oversampling;
        is_near(f64::from(motion_of.readings), readings, 1e-6, motion);
        is_near(f64::from(published.estimate.residual_rms_n), known.variance.sqrt(), 1e-3, motion);
        assert_eq!(published.estimate.updates as usize, rows.len());
    }
}

/// As long as the memory has forgotten nothing, its result equals that of the whole run.
#[test]
fn what_is_recent_is_the_whole_run_until_the_memory_is_full() {
    for rig in rigs() {
        let Told { active, state, published, .. } = rig.told();
        let Rig { motion, sensors, .. } = rig;
        let all = active.budgets(&state);
        for (i, (recent, whole)) in all.recent.iter().zip(&all.whole_run).enumerate() {
            let what = format!("{motion} {} m, parameter {i}", sensors.metres_per_count);
            for source in Source::ALL {
                let [recent, whole] = [recent, whole].map(|budget| f64::from(budget.given_u95(source)));
                is_near(recent, whole, 2e-3, &format!("{what}, {source:?}"));
            }
        }
        let Published { estimate, .. } = published;
        for (recent, whole) in four(&estimate.recent).into_iter().zip(four(&estimate.whole_run)) {
            is_near(f64::from(recent.fitted().value), f64::from(whole.fitted().value), 2e-4, motion);
        }
    }
}

/// The shift of the parameters, beyond chance, when the updates near rest are left out. Nothing else contributes to the
/// model's share here.
#[test]
fn what_moves_without_the_updates_near_rest_is_the_models_part() {
    let mut seen = 0;
    for seed in 1..13 {
        for motion in ["random@10s", "two@10s"] {
            let device = Inerter::paper();
            let sensors = instruments(seed);
            let settings = stated(&device, &sensors);
            let Told { active, state, published, rows } = told(&settings, &shaken(&device, motion, 60.0, &sensors));
            if published.detail.friction.regime != Regime::Coulomb || published.law.status != LawStatus::Holds {
                continue;
            }
            let rows = &rows[0].rows;
            let kernel = Kernel::of(&settings, Bank::Fast);
            let known = fit(rows, &kernel, 1.0);
            let motion_of = active.motion(&state);
            let scatter = Scatter::of(&known, &kernel, &settings, &motion_of);
            let wanted = moved(rows, &known, &scatter, &kernel, 1.0, f64::from(motion_of.repeats));
            for (budget, wanted) in active.budgets(&state).whole_run.iter().zip(wanted) {
                let found = f64::from(budget.given_u95(Source::Model));
                let error = f64::from(budget.standard_error());
                seen += u32::from(wanted > 0.1 * error);
                // The difference of nearly equal values is known to a fraction of its standard error.
                let near = (found - wanted).abs() <= 0.02 * wanted + 0.05 * error;
                assert!(near, "{motion} {seed}: {found} for {wanted}");
            }
        }
    }
    assert!(seen > 10, "{seen}");
}

/// Force noise and encoder steps through the kernel explain the residual, and the law is judged against them.
#[test]
fn the_residual_is_the_forces_noise_and_the_encoders_steps() {
    for (rate_hz, noise_n, count_m) in
        [(1000.0, 1.0, 2e-7), (1000.0, 5.0, 2.44e-6), (1000.0, 0.2, 10e-6), (4000.0, 1.0, 2.44e-6), (500.0, 3.0, 1e-6)]
    {
        let sensors =
            Sensors { sample_rate_hz: rate_hz, force_noise_n: noise_n, metres_per_count: count_m, ..instruments(3) };
        let device = Inerter::paper();
        let settings = Settings { memory_s: 1000.0, ..rig::exact(calibrated(&device, &sensors)) };
        let heard = listen(&settings, &shaken(&device, "random", 20.0, &sensors));
        let kernel = Kernel::of(&settings, Bank::Fast);
        let mass = device.inertance_kg + device.structure_mass_kg;
        let code = sensors.newtons_per_code;
        let of_noise = (noise_n * noise_n + code * code / 12.0) * (151.0 / 315.0) / (2.0 * kernel.spacing);
        let of_steps = mass * mass * kernel.steps;
        let what = format!("{rate_hz} Hz, {noise_n} N, {count_m} m");
        let residual = f64::from(heard.last.estimate.residual_rms_n);
        is_near(residual, (of_noise + of_steps).sqrt(), 0.12, &what);
        let misfit = heard.last.law.misfit.unwrap();
        assert_eq!(heard.last.law.status, LawStatus::Holds, "{what}");
        is_near(f64::from(misfit.ratio), 1.0, 0.12, &what);
        // Chance variation over n observations, and over the force's differences: one per update, as far as the memory
        // reaches.
        let updates = f64::from(heard.last.estimate.updates);
        let observations = updates / (2.0 * 2.09);
        let differences = 2048.0 * (1.0 - (1.0 - 1.0 / 2048.0_f64).powf(updates));
        let share = of_steps / (of_noise + of_steps);
        let scatter = 1.0 + share * share * (f64::from(heard.state.repeats()) - 1.0);
        let chance = 2.0 * scatter / (observations - 4.0) + 12.8 / differences;
        is_near(f64::from(misfit.limit), (1.7 + 3.0 * chance.sqrt()).sqrt(), 0.01, &what);
    }
}

/// Values scatter by their stated scatter: not less, and not much more.
#[test]
fn values_scatter_by_their_budget() {
    for (motion, count_m) in [("random", 2.44e-6), ("random", 20e-6), ("mid", 2.44e-6)] {
        let (mut squares, mut covered) = ([0.0; 3], [0; 3]);
        const RUNS: u64 = 32;
        for seed in 1..=RUNS {
            let device = Inerter::paper();
            // Two clocks: nothing repeats itself.
            let sensors = Sensors { sample_rate_hz: 1000.123, metres_per_count: count_m, ..instruments(seed) };
            let settings = rig::exact(calibrated(&device, &sensors));
            let heard = listen(&settings, &shaken(&device, motion, 8.0, &sensors));
            let found = three(&heard.last.estimate.whole_run);
            for (i, (parameter, truth)) in found.into_iter().zip(truth(&device)).enumerate() {
                let ratio = off(parameter, truth);
                squares[i] += (ratio * f64::from(NORMAL_COVERAGE)).powi(2) / RUNS as f64;
                covered[i] += u32::from(ratio.abs() <= 1.0);
            }
        }
        for i in 0..3 {
            let what = format!("{motion}, {count_m} m, {i}: {:.2}, {} of {RUNS}", squares[i].sqrt(), covered[i]);
            assert!((0.2..1.35).contains(&squares[i].sqrt()) && covered[i] >= 26, "{what}");
        }
    }
}

/// Parameters without the offset, from the same samples under other settings.
fn values(settings: &Settings, samples: &[RawSample]) -> [f64; 3] {
    three(&listen(settings, samples).last.estimate.whole_run).map(|found| f64::from(found.fitted().value))
}

/// Gives a setting an error of its half width, in either direction.
type Wrong = fn(&mut Settings, f64);

/// Greatest error of a part that does not matter, in half widths of the whole interval: adding or leaving it out
/// changes the interval by 3 %.
const BESIDE: f64 = 0.25;

/// A setting with an error of its half width moves each parameter by its share of the budget, for all sources that the
/// settings state.
///
/// Where there is no tolerance, the budget has no part, or one too small to be compared with chance, or a bound only.
/// The parameter then moves by less than a tenth of its interval, by the law (docs/THEORY.md, 6 and 7) with `w^2` of
/// 3100/s^2 and `w^4` of 1.6e7/s^4 in this motion:
///
/// - Gain alone, 0.4 %, makes the interval of `mt` 1.2 kg at least, and that of `fc` 0.2 N. Skew, `tau mt w^2`, makes
///   that of `cf` 7 N s/m.
/// - Lead and timebase scale `a` and `v`, but not the sign of `v`: `fc` does not move. By timebase `cf` moves by
///   0.07 %, 0.02 N s/m.
/// - Skew adds `tau F'`, in which `cf a` moves `mt` by `tau cf`, 0.0003 kg.
/// - Structure, 0.3 kg, acts on `cf` and `fc` through its stretch alone: `w^4 mt cs / ks^2` of it is 0.4 N s/m. A
///   friction that reverses 18 times a second through a kernel of 16 ms has a mean square slope of 2100/s^2, and
///   `2100 fc / ks` of it is 0.02 N.
/// - Stiffness, 3 %, does the same with 1.5 kg of structure: 0.1 N s/m and 0.002 N.
#[test]
fn what_a_wrong_setting_does_is_its_part_of_the_budget() {
    let device = Inerter::paper();
    // With fine counts, the signs do not move.
    let sensors = Sensors { metres_per_count: 1e-7, force_noise_n: 0.2, ..instruments(2) };
    let samples = shaken(&device, "random", 20.0, &sensors);
    let right = stated(&device, &sensors);
    let budgets = |settings: &Settings| {
        let heard = listen(settings, &samples);
        let [a, b, c, _]: [Budget; 4] = heard.active.budgets(&heard.state).whole_run;
        [a, b, c]
    };
    let small = Settings { stiffness_u95_n_per_m: 0.03 * device.stiffness_n_per_m, skew_u95_s: 8e-6, ..right };
    let wrong: [(Source, Wrong, [Option<f64>; 3]); 6] = [
        (
            Source::Gain,
            |s, sign| s.newtons_per_code *= 1.0 + sign * s.force_gain_u95,
            [Some(0.02), Some(0.05), Some(0.02)],
        ),
        (Source::Lead, |s, sign| s.metres_per_count *= 1.0 + sign * s.lead_u95, [Some(0.03), Some(0.1), None]),
        (Source::Timebase, |s, sign| s.sample_rate_hz *= 1.0 + sign * s.timebase_u95, [Some(0.03), None, None]),
        (Source::Skew, |s, sign| s.skew_s += sign * s.skew_u95_s, [None, Some(0.03), Some(0.1)]),
        (Source::Structure, |s, sign| s.structure_mass_kg += sign * s.structure_mass_u95_kg, [Some(0.2), None, None]),
        (Source::Stiffness, |s, sign| s.stiffness_n_per_m += sign * s.stiffness_u95_n_per_m, [Some(0.15), None, None]),
    ];
    let parts = budgets(&small);
    for (source, change, tolerances) in wrong {
        let [more, less] = [1.0, -1.0].map(|sign| {
            let mut settings = small;
            change(&mut settings, sign);
            values(&settings, &samples)
        });
        for i in 0..3 {
            let moved = 0.5 * (more[i] - less[i]).abs();
            let given = f64::from(parts[i].given_u95(source));
            let all = f64::from(parts[i].u95());
            // A part of zero excuses no other.
            let most = tolerances[i].map_or(BESIDE * all, |tolerance| tolerance * given);
            assert!(all.is_finite() && (moved - given).abs() <= most, "{source:?} {i}: {moved} for {given} of {all}");
        }
    }
}

/// An exact fit is uncertain by its rounding: half a code, the greatest error of the steps, and half a unit of each
/// regressor, as if all of it resembled one regressor.
#[test]
fn an_exact_fit_is_uncertain_by_its_rounding() {
    for (newtons_per_code, force_of_bend, full_scale) in
        [(0.5, 2, 200.0), (0.002, 7, 200.0), (0.002, -3, 1e6), (2e-4, 100, 1e4), (0.002, 1000, 4e5)]
    {
        let settings = Settings {
            newtons_per_code,
            metres_per_count: 1e-6,
            full_scale_acceleration_m_per_s2: full_scale,
            full_scale_velocity_m_per_s: full_scale / 100.0,
            memory_s: 1000.0,
            ..rig::exact(Settings::default())
        };
        let position = |n: i32| {
            let t_s = f64::from(n) * 1e-3;
            (4e3 * (20.0 * t_s).sin() + 2e3 * (47.0 * t_s).sin()).round() as i32
        };
        let samples: Vec<RawSample> = (0..5000)
            .map(|n| {
                let bend = position(n + 1) - 2 * position(n) + position(n - 1);
                let force_code = 1001 + force_of_bend * bend;
                RawSample { index: n as u32, position_count: position(n), force_code, terminal_code: 0 }
            })
            .collect();
        let Told { active, state, rows, .. } = told(&settings, &samples);
        let [Rows { rows, .. }, _] = rows;
        let kernel = Kernel::of(&settings, Bank::Fast);
        let known = fit(&rows, &kernel, 1.0);
        let units = active.sums(&state, Bank::Fast).units;
        let of_units = units[4] + known.values.iter().zip(units).map(|(value, unit)| value.abs() * unit).sum::<f64>();
        let steps = known.values[0].abs() * kernel.steps.sqrt();
        let rounding = 0.5 * newtons_per_code + 3_f64.sqrt() * steps + 0.5 * of_units;
        for (i, (budget, inverse)) in active.budgets(&state).whole_run.iter().zip(&known.inverse).enumerate() {
            let wanted = rounding * inverse.sqrt() / f64::from(NORMAL_COVERAGE);
            is_near(f64::from(budget.standard_error()), wanted, 0.03, &format!("{force_of_bend} in {full_scale}, {i}"));
        }
    }
}

/// Runs on one rig share gain, lead and clock.
#[test]
fn what_a_rig_shares_is_left_out_of_a_difference() {
    let device = Inerter::paper();
    let sensors = instruments(2);
    let samples = shaken(&device, "random", 10.0, &sensors);
    let of = |settings: &Settings| {
        let heard = listen(settings, &samples);
        heard.active.budgets(&heard.state).whole_run.map(|budget| (budget.u95(), budget.same_rig_u95()))
    };
    let all = stated(&device, &sensors);
    let own = Settings { force_gain_u95: 0.0, lead_u95: 0.0, timebase_u95: 0.0, ..all };
    for ((with, same), (without, _)) in of(&all).into_iter().zip(of(&own)) {
        is_near(f64::from(same), f64::from(without), 1e-5, "same rig");
        assert!(with > without);
    }
}
