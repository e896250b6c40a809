//! Real machines: one that changes during the run, and one that does not.

use inerter_core::{Changed, RawSample, Settings, State};
use inerter_tests::data::Recording;

/// The changes reported for these samples, each with its time \[s\].
fn changes(settings: &Settings, samples: impl IntoIterator<Item = RawSample>) -> Vec<(f64, inerter_core::Change)> {
    let active = settings.validate().unwrap();
    let mut state = Box::new(State::new(&active));
    let mut found = Vec::new();
    for (n, sample) in samples.into_iter().enumerate() {
        let output = active.step(&mut state, &sample);
        found.extend(output.change.map(|change| (n as f64 / settings.sample_rate_hz, change)));
    }
    found
}

/// Appends the second run to the first as one recording, with missing samples where the rig was stopped.
fn spliced(first: &[RawSample], second: &[RawSample]) -> Vec<RawSample> {
    let last = *first.last().unwrap();
    let start = second[0];
    let moved = second.iter().map(|sample| RawSample {
        index: last.index.wrapping_add(1000).wrapping_add(sample.index.wrapping_sub(start.index)),
        position_count: last.position_count.wrapping_add(sample.position_count.wrapping_sub(start.position_count)),
        ..*sample
    });
    first.iter().copied().chain(moved).collect()
}

#[test]
fn a_ratio_that_moved_in_a_real_machine() {
    let runs = [Recording::LodzSymmetric.run(1), Recording::LodzAsymmetric.run(1)];
    let [Some(first), Some(second)] = runs else { return };
    let [first, second] = [first.unwrap(), second.unwrap()];
    for ((a, kg_before), (b, kg_after)) in [((&first, 61.7), (&second, 32.7)), ((&second, 32.7), (&first, 61.7))] {
        let found = changes(&a.settings, spliced(&a.samples, &b.samples));
        let [(t_s, change)] = found.as_slice() else { panic!("{kg_before} to {kg_after}: {found:?}") };
        assert!((0.5..2.0).contains(&(t_s - a.duration_s())), "found {} s after the splice", t_s - a.duration_s());
        assert_eq!(change.parameter, Changed::Inertance);
        for (value, kg) in [(change.before, kg_before), (change.after, kg_after)] {
            assert!((f64::from(value) / kg - 1.0).abs() < 0.03, "{value} for {kg}");
        }
    }
}

#[test]
fn a_real_machine_that_stays_what_it_is() {
    let Some(run) = Recording::Emps.run(1) else { return };
    let run = run.unwrap();
    assert_eq!(changes(&run.settings, run.samples.iter().copied()), []);
}
