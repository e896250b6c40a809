use inerter_core::{Settings, WarningKind::*};
use inerter_needs::Random;

use super::*;

/// Ten seconds of oscillation at 1 kHz, with noise of 20 codes, as the given instruments record it.
fn run_of(instruments: impl Fn(usize, f64) -> (i32, f64)) -> Run {
    let mut random = Random(5);
    let samples = (0..10_000).map(|n| {
        let phase = 0.02 * n as f64;
        let (slip, force) = instruments(n, 9000.0 * phase.cos() + 20.0 * random.normal());
        let position_count = (-4000.0 * phase.cos()) as i32 + slip;
        RawSample { index: 70 + n as u32, position_count, force_code: force.round() as i32, terminal_code: 0 }
    });
    Run {
        samples: samples.collect(),
        settings: Settings { sample_rate_hz: 1000.0, ..Settings::default() },
        ..Run::default()
    }
}

#[test]
fn a_run_without_a_fault_is_whole() {
    let run = run_of(|_, force| (0, force));
    assert_eq!(Gated::of(&run, &[]), Gated { series: Series::of(&run), ..Gated::default() });
    let told = [ClippedForce, DeadForce].map(|kind| Warning { index: 100, kind });
    assert_eq!(Gated::of(&run, &told).not_found, [ClippedForce, DeadForce]);
    let before = told.map(|warning| Warning { index: 69, ..warning });
    assert_eq!(Gated::of(&run, &before).not_found, [], "of samples that are gone");
}

#[test]
fn a_clipped_force_is_left_out_with_what_noise_may_have_clipped() {
    for rail in [3000.0, 8000.0, 8900.0] {
        let run = run_of(|_, force| (0, force.min(rail)));
        let gated = Gated::of(&run, &[]);
        assert_eq!(gated.left_out, [ClippedForce]);
        let greatest =
            gated.series.stretches.iter().flat_map(|stretch| &stretch.force_n).fold(0.0, |a: f64, b| a.max(*b));
        let below = rail - greatest / run.settings.newtons_per_code.abs();
        assert!((20.0..90.0).contains(&below), "{rail}: {below}");
    }
    // Forces occur beyond the supposed extreme.
    let run = run_of(|n, force| (0, if n < 5000 { force.min(8000.0) } else { force }));
    let told = [Warning { index: 4000, kind: ClippedForce }];
    assert_eq!(Gated::of(&run, &told).not_found, [ClippedForce]);
}

#[test]
fn a_dead_force_is_left_out_from_its_first_sample_to_its_last() {
    let run = run_of(|n, force| (0, if (4000..6000).contains(&n) { 1500.0 } else { force }));
    let gated = Gated::of(&run, &[]);
    assert_eq!((gated.left_out, gated.series.len()), (vec![DeadForce], 8000));
}

#[test]
fn counts_that_slip_part_the_run_wherever_they_do() {
    let run = run_of(|n, force| (400 * i32::from(n > 3000) + 400 * i32::from(n > 3500), force));
    assert_eq!(Gated::of(&run, &[]).series.stretches.len(), 1, "unless they are told");
    let told = [Warning { index: 70 + 3001, kind: CountSlip }];
    let Gated { series, left_out, .. } = Gated::of(&run, &told);
    assert_eq!((left_out, series.len()), (vec![CountSlip], 10_000));
    let starts: Vec<f64> = series.stretches.iter().map(|stretch| (1e3 * stretch.start_s).round()).collect();
    assert_eq!(starts, [0.0, 3001.0, 3002.0, 3501.0, 3502.0]);
}
