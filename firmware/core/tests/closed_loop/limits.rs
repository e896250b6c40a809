//! When there is no value, when values begin, and what is reported about friction and the law under disturbances.

use crate::rig::{calibrated, changing, exact, four, instruments, listen, off, shaken, statuses, three, truth};
use inerter_core::{Changed, LawStatus, RawSample, Regime, Settings, State, Status};
use inerter_plant::{Inerter, Sensors};

use Status::{NotIdentifiable, Ok as Known};

/// Samples from positions \[m\] and forces \[N\] as functions of the time \[s\].
fn by(settings: &Settings, duration_s: f64, at: impl Fn(f64) -> (f64, f64)) -> Vec<RawSample> {
    let samples = (0..(duration_s * settings.sample_rate_hz) as u32).map(|index| {
        let (position_m, force_n) = at(f64::from(index) / settings.sample_rate_hz);
        // Add noise so that nothing is exact. Fractions of multiples of two irrational numbers suffice.
        let noise = (f64::from(index) * 0.618_033_988_7).fract() + (f64::from(index) * 0.414_213_562).fract() - 1.0;
        RawSample {
            index,
            position_count: (position_m / settings.metres_per_count).floor() as i32,
            force_code: ((force_n + noise) / settings.newtons_per_code).round() as i32,
            terminal_code: 0,
        }
    });
    samples.collect()
}

/// Without acceleration there is no inertance, and in one direction no Coulomb friction; at one speed the two kinds of
/// friction cannot be distinguished.
#[test]
fn what_a_motion_leaves_open_has_no_value() {
    let settings = exact(Settings::default());
    let of = |at: &dyn Fn(f64) -> (f64, f64)| {
        let heard = listen(&settings, &by(&settings, 20.0, at));
        assert!(heard.last.estimate.updates > 500, "{}", heard.last.estimate.updates);
        (statuses(&heard.last.estimate.whole_run), heard.last)
    };
    // Constant speed in one direction: the force is the sum of friction and offset.
    let (steady, last) = of(&|t| (0.02 * t, 60.0));
    assert_eq!(steady, [NotIdentifiable; 4]);
    assert!(last.estimate.moving);
    // In one direction, faster and slower: inertance and viscous friction are determined, and of the others only the
    // sum.
    let sine = |hz: f64, t: f64| (std::f64::consts::TAU * hz * t).sin_cos();
    let (one_way, last) = of(&|t| {
        let ((sin, cos), (slow, less)) = (sine(2.0, t), sine(0.31, t));
        let w = std::f64::consts::TAU * 2.0;
        let v = 0.05 + 2e-3 * w * cos + 0.01 * less;
        let x = 0.05 * t + 2e-3 * sin + 0.01 / (std::f64::consts::TAU * 0.31) * slow;
        let a = -2e-3 * w * w * sin - 0.01 * std::f64::consts::TAU * 0.31 * slow;
        (x, 200.0 * a + 90.0 * v + 40.0)
    });
    assert_eq!(one_way, [Known, Known, NotIdentifiable, NotIdentifiable]);
    for (parameter, truth) in four(&last.estimate.whole_run).into_iter().zip([200.0, 90.0]) {
        assert!(off(parameter, truth).abs() < 1.0, "{parameter:?} for {truth}");
    }
    // The same motion back and forth determines everything.
    let (both, last) = of(&|t| {
        let ((sin, cos), (slow, less)) = (sine(2.0, t), sine(0.31, t));
        let (w, u) = (std::f64::consts::TAU * 2.0, std::f64::consts::TAU * 0.31);
        let v = 2e-3 * w * cos + 0.01 * u * less;
        let a = -2e-3 * w * w * sin - 0.01 * u * u * slow;
        (2e-3 * sin + 0.01 * slow, 200.0 * a + 90.0 * v + 40.0 * v.signum() - 7.0)
    });
    assert_eq!(both, [Known; 4]);
    for (parameter, truth) in four(&last.estimate.whole_run).into_iter().zip([200.0, 90.0, 40.0, -7.0]) {
        let value = f64::from(parameter.known().unwrap().value);
        assert!((value - truth).abs() < 0.1 + 0.01 * truth, "{parameter:?} for {truth}");
    }
    // No motion.
    let heard = listen(&settings, &by(&settings, 20.0, |_| (1e-7, 60.0)));
    assert_eq!((heard.last.estimate.updates, heard.last.estimate.moving), (0, false));
    assert_eq!(statuses(&heard.last.estimate.whole_run), [NotIdentifiable; 4]);
}

/// Fewer than eight observations give no result. A value given before friction is judged has an interval of half its
/// size.
#[test]
fn values_begin_with_the_eighth_observation() {
    let device = Inerter::paper();
    let sensors = instruments(4);
    for memory_s in [0.5, 30.0] {
        let settings = Settings { memory_s, ..exact(calibrated(&device, &sensors)) };
        let active = settings.validate().unwrap();
        let mut state = Box::new(State::new(&active));
        let mut given = 0;
        for sample in &shaken(&device, "random", 3.0, &sensors) {
            active.step(&mut state, sample);
            let published = active.publish(&state).estimate;
            let observations = f64::from(published.updates) / (2.0 * 2.09);
            for parameters in [published.recent, published.whole_run] {
                let known = four(&parameters).iter().any(|parameter| parameter.u95().is_finite());
                assert!(observations >= 8.0 || !known, "{}", published.updates);
                if observations < 16.0 {
                    for found in four(&parameters).into_iter().filter_map(|parameter| parameter.known()) {
                        given += 1;
                        assert!(found.u95 <= 0.5 * found.value.abs(), "{found:?}");
                    }
                }
            }
            let early = (8.0..9.0).contains(&observations);
            assert!(!early || published.whole_run.inertance_kg.u95().is_finite(), "{}", published.updates);
        }
        assert!(given > 0, "{memory_s} s");
    }
}

/// The recent memory forgets a device at the rate that is set; the whole run never forgets.
#[test]
fn the_recent_memory_is_as_long_as_it_is_set() {
    let device = Inerter::paper();
    let sensors = instruments(4);
    // 1.2 %, which is drift and not a change.
    let heavier = Inerter { inertance_kg: 1.012 * device.inertance_kg, ..device };
    let samples = changing(&device, vec![(12.0, heavier)], "random", 18.0, &sensors);
    for memory_s in [2.0, 4.0, 8.0] {
        let settings = Settings { memory_s, ..calibrated(&device, &sensors) };
        let heard = listen(&settings, &samples);
        assert_eq!(heard.changes, []);
        let Settings { sample_rate_hz, .. } = settings;
        let at = |time_s: f64| {
            let due =
                |published: &&inerter_core::Published| f64::from(published.estimate.index) / sample_rate_hz >= time_s;
            let estimate = heard.published.iter().find(due).unwrap().estimate;
            [estimate.recent, estimate.whole_run]
                .map(|all| f64::from(all.inertance_kg.fitted().value) / device.inertance_kg - 1.0)
        };
        // An exponential memory of this many seconds, with the delay of kernel and gate.
        let [recent, whole] = at(16.0);
        let wanted = 0.012 * (1.0 - (-(16.0 - 12.0 - 0.06) / memory_s).exp());
        assert!((recent - wanted).abs() < 0.0015, "{memory_s} s: {recent} for {wanted}");
        assert!((whole - 0.012 * 4.0 / 16.0).abs() < 0.0015, "{whole}");
    }
}

/// Relevant changes are found, with the parameter that changed. Less than 2 % of inertance or a tenth of dry friction
/// is drift.
#[test]
fn a_change_that_matters_is_found_and_drift_is_not() {
    let paper = Inerter::paper();
    let with = |inertance: f64, viscous: f64, coulomb: f64| Inerter {
        inertance_kg: inertance * paper.inertance_kg,
        viscous_n_s_per_m: viscous * paper.viscous_n_s_per_m,
        coulomb_n: coulomb * paper.coulomb_n,
        ..paper
    };
    for (after, found) in [
        (with(1.035, 1.0, 1.0), Some(Changed::Inertance)),
        (with(0.965, 1.0, 1.0), Some(Changed::Inertance)),
        (with(1.013, 1.0, 1.0), None),
        (with(0.987, 1.0, 1.0), None),
        (with(1.0, 2.5, 1.0), Some(Changed::Viscous)),
        (with(1.0, 1.15, 1.0), None),
        (with(1.0, 1.0, 1.25), Some(Changed::Coulomb)),
        (with(1.0, 1.0, 0.7), Some(Changed::Coulomb)),
        (with(1.0, 1.0, 1.06), None),
    ] {
        for motion in ["random", "two"] {
            let sensors = Sensors { force_noise_n: 0.5, ..instruments(6) };
            let settings = calibrated(&paper, &sensors);
            let samples = changing(&paper, vec![(12.0, after)], motion, 22.0, &sensors);
            let heard = listen(&settings, &samples);
            let kinds: Vec<Changed> = heard.changes.iter().map(|change| change.parameter).collect();
            assert_eq!(kinds, found.into_iter().collect::<Vec<_>>(), "{motion}: {after:?}");
            assert_eq!((heard.last.detail.changes as usize, &heard.warnings), (kinds.len(), &Vec::new()));
            for change in &heard.changes {
                let [before, now] = [&paper, &after].map(|device| match change.parameter {
                    Changed::Inertance => device.inertance_kg,
                    Changed::Viscous => device.viscous_n_s_per_m,
                    _ => device.coulomb_n,
                });
                // Two consecutive blocks of half a second or more.
                assert!((12_500..14_600).contains(&change.index), "{motion}: {change:?}");
                assert!((f64::from(change.before) / before - 1.0).abs() < 0.2, "{motion}: {change:?} from {before}");
                assert!((f64::from(change.after) / now - 1.0).abs() < 0.2, "{motion}: {change:?} to {now}");
                if change.parameter == Changed::Inertance {
                    let moved = f64::from(change.after - change.before);
                    assert!((moved / (now - before) - 1.0).abs() < 0.2, "{change:?}");
                }
            }
        }
    }
    // A change of the offset, like a load on the cell.
    let sensors = instruments(6);
    let mut samples = shaken(&paper, "random", 22.0, &sensors);
    samples.iter_mut().skip(12_000).for_each(|sample| sample.force_code += (15.0 / sensors.newtons_per_code) as i32);
    let heard = listen(&calibrated(&paper, &sensors), &samples);
    let [change] = heard.changes[..] else { panic!("{:?}", heard.changes) };
    assert_eq!(change.parameter, Changed::Offset);
    assert!((change.after - change.before - 15.0).abs() < 1.0, "{change:?}");
}

/// Until six blocks have shown how much blocks scatter, only three times the relevant change is reported.
#[test]
fn a_small_change_waits_until_it_is_known_how_blocks_scatter() {
    let paper = Inerter::paper();
    let sensors = Sensors { force_noise_n: 0.3, ..instruments(6) };
    let settings = calibrated(&paper, &sensors);
    let found = |part: f64| {
        let after = Inerter { inertance_kg: (1.0 + part) * paper.inertance_kg, ..paper };
        let heard = listen(&settings, &changing(&paper, vec![(2.6, after)], "random", 8.0, &sensors));
        heard.changes.iter().map(|change| (change.parameter, change.index)).collect::<Vec<_>>()
    };
    // The memory follows a shift that cannot yet be distinguished from scatter. Later, the same shift is a change.
    assert_eq!(found(0.045), []);
    let [(Changed::Inertance, at)] = found(0.12)[..] else { panic!("{:?}", found(0.12)) };
    assert!((2600..4400).contains(&at), "{at}");
}

/// If friction is mainly viscous, a change of three tenths of it is relevant.
#[test]
fn a_small_change_of_great_viscous_friction_is_drift() {
    let paper = Inerter { viscous_n_s_per_m: 4000.0, coulomb_n: 20.0, ..Inerter::paper() };
    let sensors = Sensors { force_noise_n: 0.3, ..instruments(6) };
    for (part, found) in [(1.18, &[][..]), (0.82, &[]), (1.45, &[Changed::Viscous]), (0.6, &[Changed::Viscous])] {
        let after = Inerter { viscous_n_s_per_m: part * paper.viscous_n_s_per_m, ..paper };
        let heard =
            listen(&calibrated(&paper, &sensors), &changing(&paper, vec![(12.0, after)], "random", 18.0, &sensors));
        let kinds: Vec<Changed> = heard.changes.iter().map(|change| change.parameter).collect();
        assert_eq!(kinds, found, "{part}");
    }
}

/// If the offset of a machine swings from the start, that is its scatter and no change. A machine that was steady
/// before has changed.
#[test]
fn what_a_machine_always_does_is_no_change() {
    let device = Inerter::paper();
    let sensors = instruments(6);
    let settings = Settings { memory_s: 60.0, ..calibrated(&device, &sensors) };
    let changes = |from_s: f64| {
        let mut samples = shaken(&device, "random", 40.0, &sensors);
        for sample in &mut samples {
            let t_s = f64::from(sample.index) * 1e-3;
            // Three seconds in each direction.
            let swing = if t_s < from_s { 0.0 } else { 17.0 * (std::f64::consts::TAU * (t_s - from_s) / 6.0).sin() };
            sample.force_code += (swing / sensors.newtons_per_code) as i32;
        }
        listen(&settings, &samples).changes.len()
    };
    assert_eq!(changes(0.0), 0);
    assert!(changes(20.0) > 0);
}

/// Changes of friction are also found in slow motion.
#[test]
fn a_change_of_friction_is_found_in_slow_motion() {
    let paper = Inerter::paper();
    let sensors = instruments(6);
    let drier = Inerter { coulomb_n: 80.0, ..paper };
    let heard = listen(&calibrated(&paper, &sensors), &changing(&paper, vec![(60.0, drier)], "slow", 90.0, &sensors));
    let [change] = heard.changes[..] else { panic!("{:?}", heard.changes) };
    assert_eq!(change.parameter, Changed::Coulomb);
    assert!(
        (f64::from(change.before) - 50.0).abs() < 2.0 && (f64::from(change.after) - 80.0).abs() < 2.0,
        "{change:?}"
    );
    assert!((60_000..76_000).contains(&change.index), "{change:?}");
}

/// A blow before friction is known is forgotten once the law is judged. A later one stays, and the device reports that
/// it breaks the law.
#[test]
fn a_blow_at_the_beginning_is_forgotten_once() {
    let device = Inerter::paper();
    let sensors = instruments(8);
    let settings = exact(calibrated(&device, &sensors));
    let code = |force_n: f64| (force_n / sensors.newtons_per_code) as i32;
    let struck = |at: usize| {
        let mut samples = shaken(&device, "random", 16.0, &sensors);
        samples.iter_mut().skip(at).take(25).for_each(|sample| sample.force_code += code(400.0));
        let heard = listen(&settings, &samples);
        let updates: Vec<u32> = heard.published.iter().map(|published| published.estimate.updates).collect();
        let anew: Vec<usize> = (1..updates.len()).filter(|n| updates[*n] < updates[n - 1]).collect();
        (anew, heard)
    };
    let (anew, clean) = struck(usize::MAX - 30);
    assert_eq!(anew, []);
    assert_eq!(clean.last.law.status, LawStatus::Holds);
    // The law is judged at the 200th update, before the ninth or tenth estimate.
    let (anew, heard) = struck(900);
    assert_eq!(anew.len(), 1, "{anew:?}");
    assert!((8..12).contains(&anew[0]), "{anew:?}");
    assert_eq!(heard.last.law.status, LawStatus::Holds);
    for (parameter, truth) in three(&heard.last.estimate.whole_run).into_iter().zip(truth(&device)) {
        assert!(off(parameter, truth).abs() <= 1.0, "{parameter:?} for {truth}");
    }
    let (anew, heard) = struck(6000);
    assert_eq!(anew, []);
    let ends: Vec<LawStatus> = heard.published.iter().skip(32).map(|published| published.law.status).collect();
    assert!(ends.contains(&LawStatus::Broken), "{ends:?}");
    assert!(clean.published.iter().skip(15).all(|published| published.law.status == LawStatus::Holds));
    // A broken law widens the intervals.
    let wide = [&heard, &clean].map(|heard| heard.last.estimate.whole_run.inertance_kg.u95());
    assert!(wide[0] > 2.0 * wide[1], "{wide:?}");
}

/// Pickup that follows no law breaks it, also in a motion that hides friction: not at once, because the beginning of
/// the run might be the cause.
#[test]
fn what_goes_on_breaking_the_law_is_told_in_a_tone_too() {
    let device = Inerter::paper();
    for (pickup_n, wanted) in [(0.0, LawStatus::Holds), (12.0, LawStatus::Broken)] {
        let sensors = Sensors { pickup_n, pickup_hz: 31.7, ..instruments(8) };
        let settings = exact(calibrated(&device, &sensors));
        for motion in ["fast", "random", "mid"] {
            let heard = listen(&settings, &shaken(&device, motion, 20.0, &sensors));
            assert_eq!(heard.last.law.status, wanted, "{motion}: {:?} {:?}", heard.last.law, heard.last.detail);
            let early = heard.published.iter().take_while(|published| published.estimate.index < 1700);
            for published in early {
                assert!(published.law.status != LawStatus::Broken, "{motion}: {:?}", published.law);
            }
            let found = heard.last.detail.friction.regime;
            assert!(pickup_n > 0.0 || found == Regime::Coulomb || motion == "fast", "{motion}: {found:?}");
        }
    }
}
