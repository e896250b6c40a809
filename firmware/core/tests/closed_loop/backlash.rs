//! Backlash with both methods: correct if there is a value, and withheld for the right reason if there is none.

use crate::rig::{self, exact, instruments, raw};
use inerter_core::{
    BacklashSize, Contact, Detail, Interval, Published, RawSample, Reason, Reversal, Route, Settings, State,
};
use inerter_plant::{Excitation, Flank, Inerter, Sensors, Simulation};

/// Settings of a device calibrated against these instruments, with its stiffness known to 0.1 %.
fn settings(device: &Inerter, sensors: &Sensors) -> Settings {
    Settings { stiffness_u95_n_per_m: 1e-3 * device.stiffness_n_per_m, ..exact(rig::calibrated(device, sensors)) }
}

fn worn(backlash_m: f64) -> Inerter {
    Inerter { backlash_m, ..Inerter::paper() }
}

/// The estimator's results for these samples.
fn listen(settings: &Settings, samples: impl IntoIterator<Item = RawSample>) -> (Detail, Vec<Reversal>) {
    let active = settings.validate().unwrap();
    let mut state = Box::new(State::new(&active));
    let mut reversals = Vec::new();
    for sample in samples {
        reversals.extend(active.step(&mut state, &sample).reversal);
    }
    (active.publish(&state).detail, reversals)
}

fn shaken(device: &Inerter, motion: &str, duration_s: f64, sensors: &Sensors) -> Vec<RawSample> {
    let excitation = Excitation::parse(motion, sensors.seed).unwrap();
    Simulation::new(*device, excitation, *sensors).unwrap().lasting(duration_s).map(|sample| raw(&sample)).collect()
}

fn sensing(settings: &Settings) -> Settings {
    Settings { terminal_sensor: true, ..*settings }
}

fn covers(detail: &Detail, truth_m: f64) -> bool {
    let within =
        |known: Interval| (f64::from(known.value) - truth_m).abs() <= f64::from(known.u95) && known.u95 < 12e-6;
    detail.backlash.known().is_some_and(within)
}

fn reason(detail: &Detail) -> Option<Reason> {
    match detail.backlash.size {
        BacklashSize::NotIdentifiable(reason) => Some(reason),
        _ => None,
    }
}

/// The reported middle of each flight lies within the flight: from the force, and with the sensor to within half a
/// block.
#[test]
fn reversals_are_where_the_flanks_part() {
    let device = worn(200e-6);
    let sensors = instruments(5);
    let excitation = Excitation::parse("mid", 5).unwrap();
    let samples: Vec<_> = Simulation::new(device, excitation, sensors).unwrap().lasting(10.0).collect();
    let (_, reversals) = listen(&sensing(&settings(&device, &sensors)), samples.iter().map(raw));
    for route in [Route::Force, Route::Terminal] {
        let count = reversals.iter().filter(|reversal| reversal.route == route).count();
        assert!(count > 40, "{route:?}: {count}");
    }
    for reversal in reversals {
        let at = reversal.index as usize;
        let near = &samples[at - 4..at + 5];
        assert!(near.iter().any(|sample| sample.truth.force_n == 0.0), "{at}");
    }
}

#[test]
fn standstill_changes_nothing() {
    let device = worn(50e-6);
    let sensors = instruments(2);
    let settings = sensing(&settings(&device, &sensors));
    let samples = shaken(&device, "random@10s;hold@60s", 70.0, &sensors);
    let (before, _) = listen(&settings, samples.iter().copied().take(11_000));
    let (after, _) = listen(&settings, samples);
    assert!(covers(&before, 50e-6), "{before:?}");
    // The terminal method continues to form blocks: a contact at rest is still a contact.
    assert!(covers(&after, 50e-6), "{after:?}");
    let without = Settings { terminal_sensor: false, ..settings };
    let samples = shaken(&device, "random@10s;hold@60s", 70.0, &sensors);
    let (before, reversals_before) = listen(&without, samples.iter().copied().take(11_000));
    let (after, reversals_after) = listen(&without, samples);
    assert_eq!((before.backlash, before.contact, reversals_before), (after.backlash, after.contact, reversals_after));
}

/// Neither the origins of the index, the encoder and the terminal nor a delay of either channel change a single bit.
#[test]
fn origins_change_nothing() {
    let device = worn(20e-6);
    let usual = instruments(4);
    // A code of the last is finer than a unit of length.
    let fine = Sensors { metres_per_count: 1e-8, oversampling: 64.0, ..usual };
    for (skew_s, sensors) in [(-5e-3, usual), (0.0, usual), (5e-3, usual), (0.0, fine)] {
        let sensors = Sensors { delay_s: skew_s, ..sensors };
        let settings = sensing(&settings(&device, &sensors));
        let samples = shaken(&device, "mid", 8.0, &sensors);
        let expected = rig::listen(&settings, &samples);
        assert!(expected.last.detail.backlash.known().is_some() && expected.reversals.len() > 30, "{skew_s}");
        let first = u32::MAX - 4000;
        let moved = samples.iter().map(|sample| RawSample {
            position_count: sample.position_count.wrapping_add(i32::MAX - 100),
            terminal_code: sample.terminal_code.wrapping_add(i32::MIN + 500),
            index: sample.index.wrapping_add(first),
            ..*sample
        });
        let mut found = rig::listen(&settings, &moved.collect::<Vec<_>>());
        for Published { estimate, detail, law } in &mut found.published {
            for index in [&mut estimate.index, &mut detail.index, &mut law.index] {
                *index = index.wrapping_sub(first);
            }
        }
        for reversal in &mut found.reversals {
            reversal.index = reversal.index.wrapping_sub(first);
        }
        let differs = found.published.iter().zip(&expected.published).position(|(found, expected)| found != expected);
        assert_eq!((differs, found.published.len()), (None, expected.published.len()), "{skew_s}");
        assert_eq!(found.reversals, expected.reversals, "{skew_s}");
    }
}

/// The signs of the scales change not a single bit.
#[test]
fn directions_change_nothing() {
    let device = worn(20e-6);
    let sensors = instruments(4);
    let plain = sensing(&settings(&device, &sensors));
    let samples = shaken(&device, "mid", 8.0, &sensors);
    let expected = listen(&plain, samples.iter().copied());
    // One run in twenty lies outside its interval.
    let known = expected.0.backlash.known().unwrap();
    assert!((f64::from(known.value) - 20e-6).abs() < 2.0 * f64::from(known.u95), "{expected:?}");
    let mirrored = Settings {
        metres_per_count: -plain.metres_per_count,
        newtons_per_code: -plain.newtons_per_code,
        metres_per_terminal_code: -plain.metres_per_terminal_code,
        ..plain
    };
    let turned = samples.iter().map(|sample| RawSample {
        position_count: -sample.position_count,
        force_code: -sample.force_code,
        terminal_code: -sample.terminal_code,
        ..*sample
    });
    let (detail, reversals) = listen(&mirrored, turned);
    assert_eq!(reversals, expected.1);
    assert!(covers(&detail, 20e-6), "{detail:?}");
}

#[test]
fn lost_and_saturated_samples_cost_reversals_and_not_the_truth() {
    let device = worn(50e-6);
    let lossy = Sensors { lost_probability: 0.005, ..instruments(6) };
    let plain = instruments(6);
    for motion in ["mid", "random"] {
        let samples = shaken(&device, motion, 20.0, &plain);
        let (whole, _) = listen(&settings(&device, &plain), samples.iter().copied());
        let (lost, _) = listen(&settings(&device, &plain), shaken(&device, motion, 20.0, &lossy));
        // A third of the greatest force exceeds the converter's range.
        let greatest = samples.iter().map(|sample| sample.force_code).max().unwrap();
        let clipped =
            samples.iter().map(|sample| RawSample { force_code: sample.force_code.min(greatest * 2 / 3), ..*sample });
        let narrow = Settings { force_max_code: f64::from(greatest * 2 / 3), ..settings(&device, &plain) };
        let (saturated, _) = listen(&narrow, clipped);
        for less in [lost, saturated] {
            assert!(covers(&less, 50e-6), "{motion}: {less:?}");
            assert!(less.backlash.reversals < whole.backlash.reversals, "{motion}: {less:?}");
        }
    }
}

/// A load that outweighs the motion stays on one flank, even if the estimator takes it for an offset.
#[test]
fn a_one_sided_load_is_no_backlash() {
    let device = worn(100e-6);
    let sensors = instruments(7);
    for newtons in [3000.0, -3000.0] {
        let code = (newtons / sensors.newtons_per_code) as i32;
        let samples = shaken(&device, "mid", 20.0, &sensors).into_iter();
        let loaded = samples.map(|sample| RawSample { force_code: sample.force_code + code, ..sample });
        let (detail, reversals) = listen(&sensing(&settings(&device, &sensors)), loaded);
        assert_eq!(reason(&detail), Some(Reason::ForceNeverReverses), "{detail:?}");
        assert_eq!(detail.contact, Contact::OneSided);
        assert_eq!(reversals, []);
    }
}

#[test]
fn what_is_missing_is_named() {
    let device = worn(100e-6);
    let sensors = instruments(8);
    let plain = settings(&device, &sensors);
    let unknown = Settings { stiffness_n_per_m: 0.0, ..plain };
    let samples = shaken(&device, "mid", 5.0, &sensors);
    let (detail, reversals) = listen(&unknown, samples.iter().copied());
    assert_eq!((reason(&detail), reversals.len()), (Some(Reason::StiffnessUnknown), 0));
    let (detail, _) = listen(&plain, samples.iter().copied().take(700));
    assert_eq!(reason(&detail), Some(Reason::TooFewReversals));
    // A light and stiff screw rings so fast that no flank lasts long enough.
    let stiff = Inerter { stiffness_n_per_m: 2e7, contact_damping_n_s_per_m: 5000.0, ..device };
    let (detail, _) = listen(&settings(&stiff, &sensors), shaken(&stiff, "mid", 20.0, &sensors));
    assert_eq!(reason(&detail), Some(Reason::FlankTooShort), "{detail:?}");
}

/// Flanks are reported as bouncing exactly if they bounce in the plant, and then hardly any reversal is accepted. A
/// landing that rings and stays in contact is no bounce.
#[test]
fn bounces_are_those_of_the_plant() {
    // At each turn of the shaker one landing is a reversal, more are bounces.
    const TURNS: usize = 2 * 64;
    for (inertance_kg, backlash_um, bounces) in [
        (299.4906, 50.0, false),
        (150.0, 50.0, false),
        (100.0, 50.0, false),
        (80.0, 20.0, false),
        (60.0, 50.0, false),
        (60.0, 20.0, false),
        (100.0, 20.0, true),
        (60.0, 5.0, true),
    ] {
        let device = Inerter { inertance_kg, backlash_m: backlash_um * 1e-6, ..Inerter::paper() };
        let sensors = instruments(1);
        let fine = Sensors { sample_rate_hz: 16_000.0, ..sensors };
        let excitation = Excitation::parse("mid", 1).unwrap();
        let touches: Vec<bool> = Simulation::new(device, excitation, fine)
            .unwrap()
            .lasting(20.0)
            .map(|sample| sample.truth.contact != Flank::Flight)
            .collect();
        let landings = touches.windows(2).filter(|pair| !pair[0] && pair[1]).count();
        let (detail, reversals) = listen(&settings(&device, &sensors), shaken(&device, "mid", 20.0, &sensors));
        let place =
            format!("{inertance_kg} kg, {backlash_um} um: {landings} landings, {} records {detail:?}", reversals.len());
        assert_eq!(landings > 3 * TURNS / 2, bounces, "{place}");
        assert_eq!(detail.contact == Contact::Bouncing, bounces, "{place}");
        if bounces {
            assert!(reason(&detail).is_none_or(|reason| reason == Reason::Scattered), "{place}");
            assert!(reversals.len() < TURNS / 10, "{place}");
        } else if inertance_kg >= 100.0 {
            // Lighter devices ring until their flanks are too short.
            assert!(reversals.len() > TURNS * 9 / 10, "{place}");
        }
        assert!(reason(&detail).is_some() || covers(&detail, device.backlash_m), "{place}");
    }
}

/// With a heavy structure on the load cell, the terminal's flight does not count as a flank.
#[test]
fn a_heavy_structure_is_no_flank() {
    for part in [0.1, 0.2, 0.3] {
        let device = Inerter {
            inertance_kg: 100.0,
            stiffness_n_per_m: 5e6,
            contact_damping_n_s_per_m: 2850.0,
            structure_mass_kg: part * 100.0,
            backlash_m: 200e-6,
            ..Inerter::paper()
        };
        let sensors = instruments(1);
        for motion in ["fast", "multi", "random", "two"] {
            let samples = shaken(&device, motion, 20.0, &sensors);
            let plain = settings(&device, &sensors);
            let unknown = Settings { stiffness_n_per_m: 0.0, ..sensing(&plain) };
            let (sensed, _) = listen(&unknown, samples.iter().copied());
            // The effect of a structure of a fifth and more on a light device at 15.9 Hz is not in the interval
            // (docs/THEORY.md, Limits).
            let known = sensed.backlash.known().unwrap();
            let error = (f64::from(known.value) - 200e-6).abs();
            let is_limit = motion == "fast" && part > 0.15;
            let most = if is_limit { 2.1e-6 } else { f64::from(known.u95) };
            assert!(error < most, "{part} {motion}: {sensed:?}");
            let stiffness = f64::from(sensed.stiffness_n_per_m.fitted().value) / device.stiffness_n_per_m;
            assert!((stiffness - 1.0).abs() < 5e-3, "{part} {motion}: {stiffness}");
            // From the force alone, the value is right or there is none.
            let (by_force, _) = listen(&plain, samples);
            let holds = |known: Interval| (f64::from(known.value) - 200e-6).abs() < f64::from(known.u95);
            assert!(by_force.backlash.known().is_none_or(holds), "{part} {motion}: {by_force:?}");
        }
    }
}

/// A damping that is wrong by a fifth, which no interval includes, moves the backlash by half a micrometre at most.
#[test]
fn a_wrong_damping_moves_little() {
    let device = worn(100e-6);
    for motion in ["fast", "multi", "random"] {
        let mut moved = 0.0;
        for seed in 1..=4 {
            let sensors = instruments(seed);
            let samples = shaken(&device, motion, 20.0, &sensors);
            let [less, more] = [0.8, 1.2].map(|factor| {
                let damping = factor * device.contact_damping_n_s_per_m;
                let wrong = Settings { contact_damping_n_s_per_m: damping, ..settings(&device, &sensors) };
                let (detail, _) = listen(&wrong, samples.iter().copied());
                detail.backlash.known().unwrap().value
            });
            moved += f64::from(less - more) / 8.0;
        }
        assert!(moved.abs() < 0.5e-6, "{motion}: {moved}");
    }
}

/// A stiffness with an error of its uncertainty moves the backlash by no more than its interval.
#[test]
fn the_stiffness_is_in_the_interval() {
    let device = worn(200e-6);
    for motion in ["mid", "fast", "random"] {
        let sensors = instruments(9);
        let wrong = Settings {
            stiffness_n_per_m: 1.04 * device.stiffness_n_per_m,
            stiffness_u95_n_per_m: 0.05 * device.stiffness_n_per_m,
            ..settings(&device, &sensors)
        };
        let (detail, _) = listen(&wrong, shaken(&device, motion, 20.0, &sensors));
        let backlash = detail.backlash.known().unwrap();
        let error = f64::from(backlash.value) - device.backlash_m;
        assert!(error.abs() > 5e-6, "{motion}: {backlash:?}");
        assert!(error.abs() < f64::from(backlash.u95), "{motion}: {backlash:?}");
    }
}

/// A single reversal that differs is reported as such: each has its own backlash.
#[test]
fn a_backlash_that_grows_on_the_way_grows_in_the_records() {
    let sensors = instruments(3);
    let worn_settings = sensing(&settings(&worn(50e-6), &sensors));
    let halves = [50e-6, 60e-6].map(|backlash_m| shaken(&worn(backlash_m), "random@10s;hold@1s", 11.0, &sensors));
    let [first, second] = halves;
    let moved = second.into_iter().map(|sample| RawSample { index: sample.index + 20_000, ..sample });
    let (_, reversals) = listen(&worn_settings, first.into_iter().chain(moved));
    let mean = |later: bool| {
        let of =
            reversals.iter().filter(|reversal| reversal.route == Route::Terminal && (reversal.index > 15_000) == later);
        let (sum, count) =
            of.fold((0.0, 0.0), |(sum, count), reversal| (sum + f64::from(reversal.value_m), count + 1.0));
        assert!(count > 150.0, "{count}");
        sum / count
    };
    let grown = mean(true) - mean(false);
    assert!((grown - 10e-6).abs() < 0.5e-6, "{grown}");
}

/// If flanks bounce from the start, there are too few reversals for a value, and this is the reported reason.
#[test]
fn flanks_that_bounce_leave_scattered_reversals() {
    let sensors = instruments(1);
    let device = Inerter { inertance_kg: 60.0, backlash_m: 5e-6, ..Inerter::paper() };
    for duration_s in [2.0, 8.0] {
        let (detail, _) = listen(&settings(&device, &sensors), shaken(&device, "mid", duration_s, &sensors));
        assert_eq!((detail.contact, reason(&detail)), (Contact::Bouncing, Some(Reason::Scattered)), "{detail:?}");
        assert!(detail.backlash.reversals < 5, "{detail:?}");
    }
}
