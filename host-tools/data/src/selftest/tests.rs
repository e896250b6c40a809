use super::{
    judge::{Input, Start, Streamed, chip, clocks, noise, restart, restored, same, supply, throughput, work},
    *,
};
use crate::fixtures;
use inerter_core::{RawSample, Settings};
use inerter_needs::Random;
use inerter_wire::{
    Capabilities, ClockSource, Health, MAX_FIGURES, Measure,
    Quantity::{self, *},
    ResetCause,
};
use proptest::prelude::*;

fn hello() -> Hello {
    let capabilities = Capabilities::MEASURE.with_flash_kb(512);
    Hello { clock: ClockSource::Crystal, capabilities, ..fixtures::hello("205735883537") }
}

fn measured(what: Measure, figures: &[(Quantity, u32)]) -> Measured {
    let mut measured = Measured::new(what);
    figures.iter().for_each(|(quantity, value)| measured.push(*quantity, *value));
    measured
}

/// The same with another value of one quantity.
fn with(mut measured: Measured, quantity: Quantity, value: u32) -> Measured {
    measured.figures.iter_mut().filter(|figure| figure.quantity == quantity as u8).for_each(|f| f.value = value);
    measured
}

fn good_chip() -> Measured {
    measured(
        Measure::Chip,
        &[
            (DeviceId, 0x2003_6469),
            (FlashKb, 512),
            (OptionBytes, 0xFFEF_FCAA),
            (OptionBytesWanted, 0xFFEF_FCAA),
            (StackBytes, 50_000),
            (StackFreeBytes, 40_000),
            (ResetFlags, 1 << 26 | 1 << 28),
        ],
    )
}

/// A core clock with this error, and everything else right.
fn clocks_off(ppm: f64) -> Measured {
    let cycles = |nominal: f64| (nominal * (1.0 + ppm * 1e-6)).round() as u32;
    measured(
        Measure::Clocks,
        &[
            (CoreHz, 168_000_000),
            (UsbFrames, 1001),
            (UsbFramesCycles, cycles(168_168_000.0)),
            (LsiPeriods, 128),
            (LsiPeriodsCycles, cycles(672_000.0)),
            (ClockUs, 1_001_000),
            (ClockUsCycles, 168_168_000),
            (ClockControl, 1 << 17 | 1 << 25),
            (RecoveryStatus, 30 << 16 | 1),
        ],
    )
}

fn good_supply() -> Measured {
    measured(
        Measure::Supply,
        &[
            (ReferenceCode, 1504),
            (ReferenceFactoryCode, 1655),
            (TemperatureCode, 939),
            (TemperatureFactory30Code, 1037),
            (TemperatureFactory130Code, 1378),
        ],
    )
}

fn good_work() -> Measured {
    measured(
        Measure::Work,
        &[
            (WorkUs, 1_000_100),
            (IdleUs, 880_000),
            (SamplingCycles, 3_000_000),
            (EstimatingCycles, 7_000_000),
            (TelemetryCycles, 2_500_000),
            (CommandsCycles, 3_000),
            (UsbCycles, 20_000),
            (SupervisingCycles, 90_000),
        ],
    )
}

fn test_of(checks: Vec<Check>) -> SelfTest {
    SelfTest { hello: hello(), port: "p".into(), begun_ns: 0, checks, measured: vec![], skew: None }
}

/// Names of the failed checks.
fn failed(checks: &[Check]) -> Vec<String> {
    checks.iter().filter(|check| check.verdict == Verdict::Fail).map(|check| check.name.to_string()).collect()
}

fn all(figures: &Measured) -> [Vec<Check>; 4] {
    let hello = hello();
    [chip(figures, &hello), clocks(figures, &hello), supply(figures), work(figures)]
}

#[test]
fn a_good_board_passes() {
    let hello = hello();
    for checks in
        [chip(&good_chip(), &hello), clocks(&clocks_off(20.0), &hello), supply(&good_supply()), work(&good_work())]
    {
        assert!(checks.iter().all(|check| check.verdict == Verdict::Pass), "{checks:#?}");
    }
}

#[test]
fn a_clock_that_is_off_is_named() {
    for (ppm, fails) in [(0.0, false), (590.0, false), (-590.0, false), (610.0, true), (-10_000.0, true)] {
        let checks = clocks(&clocks_off(ppm), &hello());
        assert_eq!(failed(&checks), if fails { vec!["clock_usb"] } else { vec![] }, "{ppm}");
    }
    let checks = clocks(&clocks_off(10_000.0), &hello());
    let reason = checks[1].reason.as_deref().unwrap_or_default();
    assert!(reason.starts_with("the core's clock is 1.00 % fast: its crystal"), "{reason}");
    // Without USB the check is skipped.
    let mut no_usb = clocks_off(10_000.0);
    no_usb.figures.retain(|figure| !(10..=11).contains(&figure.quantity));
    assert_eq!(clocks(&no_usb, &hello()).iter().filter(|check| check.verdict == Verdict::Skipped).count(), 2);
    // The internal oscillator may be off, and a failure names it.
    let internal = Hello { clock: ClockSource::Internal, ..hello() };
    assert_eq!(failed(&clocks(&clocks_off(10_000.0), &internal)), ["crystal"]);
}

#[test]
fn each_fault_of_a_chip_is_named() {
    let with = |quantity, value| failed(&chip(&with(good_chip(), quantity, value), &hello()));
    assert_eq!(with(DeviceId, 0x2003_6468), ["chip"]);
    assert_eq!(with(FlashKb, 128), ["flash", "flash_told"]);
    assert_eq!(with(OptionBytes, 0xFFEF_F8AA), ["option_bytes"]);
    assert_eq!(with(StackFreeBytes, 1000), ["stack"]);
    assert_eq!(with(StackFreeBytes, 60_000), ["stack"]);
    assert_eq!(with(StackBytes, 0), ["stack"]);
    // RCC_CSR: low power; window watchdog; both, between power and the firmware; pin; a jump by a debug probe.
    for (flags, fails) in
        [(1 << 31 | 1 << 26, true), (1 << 30 | 1 << 29, true), (7 << 29 | 1 << 27, false), (1 << 26, false), (0, false)]
    {
        assert_eq!(with(ResetFlags, flags).len(), usize::from(fails), "{flags:#x}");
    }
}

#[test]
fn a_start_by_the_watchdog_is_told_but_no_failure() {
    let with = |flags| chip(&with(good_chip(), ResetFlags, flags), &hello()).pop().expect("the last one");
    let start = with(1 << 29 | 1 << 26);
    assert_eq!((&*start.name, start.verdict), ("start", Verdict::Skipped));
    assert!(start.reason.is_some_and(|reason| reason.contains("the watchdog reset")));
    assert_eq!(with(1 << 29 | 1 << 27).verdict, Verdict::Pass, "between power and the firmware");
}

#[test]
fn supply_and_work_have_two_sides() {
    for code in [1300, 1700] {
        assert!(
            failed(&supply(&with(good_supply(), ReferenceCode, code))).iter().any(|name| name == "supply"),
            "{code}"
        );
    }
    assert_eq!(failed(&supply(&with(good_supply(), TemperatureCode, 1400))), ["temperature"]);
    for cycles in [0, 100_000_000] {
        assert_eq!(failed(&work(&with(good_work(), EstimatingCycles, cycles))), ["work_estimating"]);
    }
    assert_eq!(failed(&work(&with(good_work(), IdleUs, 500_000))), ["load"]);
    let expected = work(&good_work()).into_iter().map(|check| check.expected);
    let beside_the_twin = ["twin 1.73: 0.692 to 8.79", "twin 2.32: 0.928 to 11.4", "twin 0.966: 0.386 to 5.35"];
    assert_eq!(expected.take(5).collect::<Vec<_>>(), [&beside_the_twin[..], &["no work: 0 to 1.00"; 2]].concat());
    // Zero time, or so long that the counters may have wrapped.
    for us in [0, 26_000_000, u32::MAX] {
        assert_eq!(failed(&work(&with(good_work(), WorkUs, us))).len(), 7, "{us}");
    }
    // A negative remainder.
    assert_eq!(failed(&work(&with(good_work(), UsbCycles, u32::MAX - 40))), ["work_usb"]);
}

#[test]
fn a_restart_is_what_was_asked_for() {
    let judged = |told, flags, uptime_s| {
        restart("reboot", "Restart", ResetCause::Software, &Start { told, flags, uptime_s }).verdict
    };
    let flags = Some(1 << 28 | 1 << 26);
    assert_eq!(judged(Some(ResetCause::Software), flags, None), Verdict::Pass);
    for (told, flags) in [
        (Some(ResetCause::Software), Some(1 << 26)),
        (Some(ResetCause::Software), None),
        (Some(ResetCause::Watchdog), Some(u32::MAX)),
        (None, Some(1 << 29)),
        (None, None),
    ] {
        assert_eq!(judged(told, flags, Some((1, 20.0))), Verdict::Fail, "{told:?} {flags:?}");
    }
    // Reported on a connection that failed: the time since the start proves the restart.
    assert_eq!(judged(None, flags, Some((1, 20.0))), Verdict::Pass);
    // A board that never restarted still has the flags of its last start.
    for uptime_s in [None, Some((19, 20.0)), Some((20, 20.0)), Some((u32::MAX, 20.0)), Some((0, f64::NAN))] {
        let start = Start { told: None, flags, uptime_s };
        let check = restart("reboot", "Restart", ResetCause::Software, &start);
        assert_eq!(check.verdict, Verdict::Fail, "{uptime_s:?}");
        assert!(check.reason.is_some_and(|reason| reason.contains("an earlier start")), "{uptime_s:?}");
    }
}

/// Samples around the middle code with this noise in each conversion, each the sum of `summed` conversions.
fn noisy(codes: f64, summed: f64) -> Vec<RawSample> {
    let mut random = Random(1);
    (0..2000)
        .map(|index| {
            let noise = codes * 64.0 / summed.sqrt() * random.normal();
            let force_code = (131_040.0 + noise + f64::from(index) * 0.05) as i32;
            RawSample { index, force_code, ..RawSample::default() }
        })
        .collect()
}

#[test]
fn noise_is_that_of_a_conversion_at_any_rate() {
    for (rate_hz, summed) in [(1000.0, 64.0), (4000.0, 16.0)] {
        let found = |codes| {
            let checks = noise(Input::Force, &noisy(codes, summed), rate_hz);
            (failed(&checks), checks[0].found.as_deref().and_then(|found| found.parse::<f64>().ok()))
        };
        let (none, measured) = found(0.7);
        assert_eq!(none, [""; 0]);
        assert!(measured.is_some_and(|codes| (codes - 0.7).abs() < 0.05), "{measured:?}");
        assert_eq!(found(5.0).0, ["noise_force"]);
        assert_eq!(found(0.0).0, ["noise_force"], "nothing converts");
    }
    let mut first = noisy(0.7, 64.0);
    first[0].force_code += 3000;
    assert_eq!(failed(&noise(Input::Force, &first, 1000.0)), ["first_force"]);
    // The terminal's codes are all zero here, at the rail.
    let checks = noise(Input::Terminal, &first, 1000.0);
    assert!(checks.iter().all(|check| check.verdict == Verdict::Skipped), "{checks:?}");
    let is_dead = |checks: &[Check]| checks.iter().all(|check| check.line().contains("not judged: constant"));
    assert!(is_dead(&checks), "{checks:?}");
    assert_eq!(
        test_of(checks).summary(),
        "0 passed, 0 failed, 2 skipped (Noise of the terminal input, First terminal sample)"
    );
    // A code that leaves the rail shows that the converter runs.
    first[7].terminal_code = 64;
    let checks = noise(Input::Terminal, &first, 1000.0);
    assert!(checks.iter().all(|check| check.verdict == Verdict::Skipped) && !is_dead(&checks), "{checks:?}");
    assert_eq!(failed(&noise(Input::Force, &first[..50], 1000.0)), ["noise_force"], "too few to say");
}

#[test]
fn each_fault_of_a_stream_is_named() {
    let samples: Vec<_> = (0..8000).map(|index| RawSample { index, ..RawSample::default() }).collect();
    let gap = [&samples[..10], &samples[11..]].concat();
    let report = |uptime_s, index| Health { uptime_s, index, ..Health::default() };
    let reports = [report(7, u32::MAX - 100), report(8, 3899)];
    let good = Streamed { samples: &samples, bytes: 38_000, bad_frames: 0, reports: &reports };
    let overrun = reports.map(|report| Health { overruns: 1, ..report });
    let half = [report(7, 100), report(9, 4100)];
    let fast = [report(7, 100), report(8, 4230)];
    let standing = [report(7, 100), report(7, 4100)];
    let backwards = [report(7, 100), report(6, 4100)];
    let heard = |heard: Streamed| {
        let checks = throughput(&heard);
        (failed(&checks), checks.map(|check| check.found))
    };
    let (none, found) = heard(good);
    assert_eq!((none, found[0].as_deref()), (vec![], Some("4000")));
    assert_eq!(found[4].as_deref(), Some("19.0"), "KB in each of two seconds");
    for (fault, names) in [
        (Streamed { bad_frames: 1, ..good }, &["frames_lost"][..]),
        (Streamed { samples: &gap, ..good }, &["samples_lost"]),
        (Streamed { reports: &overrun, ..good }, &["overruns"]),
        (Streamed { reports: &[], ..good }, &["sample_rate", "overruns"]),
        (Streamed { reports: &reports[..1], ..good }, &["sample_rate"]),
        (Streamed { reports: &half, ..good }, &["sample_rate"]),
        (Streamed { reports: &fast, ..good }, &["sample_rate"]),
        (Streamed { reports: &standing, ..good }, &["sample_rate"]),
        (Streamed { reports: &backwards, ..good }, &["sample_rate"]),
        (Streamed { bytes: 19_000, ..good }, &["throughput"]),
        (Streamed { bytes: 2_100_000, ..good }, &["throughput"]),
        (Streamed { samples: &samples[..1000], ..good }, &["throughput"]),
        (Streamed::default(), &["sample_rate", "overruns", "throughput"]),
    ] {
        assert_eq!(heard(fault).0, names, "{fault:?}");
    }
}

#[test]
fn lost_samples_are_told_of_the_sampler_or_of_the_link() {
    let samples: Vec<_> =
        (0..8000).filter(|index| *index != 10).map(|index| RawSample { index, ..RawSample::default() }).collect();
    let lost = |bad_frames: u64, overruns: u32| {
        let reports = [7, 8].map(|uptime_s| Health { uptime_s, index: 4000 * uptime_s, overruns, ..Health::default() });
        let heard = Streamed { samples: &samples, bytes: 38_000, bad_frames, reports: &reports };
        throughput(&heard)
    };
    let reason = |checks: &[Check], name: &str| {
        checks.iter().find(|check| check.name == name).and_then(|check| check.reason.clone()).unwrap_or_default()
    };
    let (by_link, by_sampler) = (lost(1, 0), lost(0, 1));
    assert_eq!(failed(&by_link), ["frames_lost", "samples_lost"]);
    assert!(reason(&by_link, "samples_lost").contains("the link"), "{by_link:?}");
    assert_eq!(failed(&by_sampler), ["samples_lost", "overruns"]);
    assert!(reason(&by_sampler, "samples_lost").starts_with("the sampler itself"), "{by_sampler:?}");
    for (bad_frames, overruns, words) in [
        (0, 1, "the sampler itself lost them: see its overruns"),
        (0, 0, "the sampler itself lost them, after its last report"),
        (1, 0, "the sampler or the link does not keep up"),
        (1, 1, "the sampler or the link does not keep up"),
    ] {
        assert_eq!(reason(&lost(bad_frames, overruns), "samples_lost"), words, "{bad_frames} {overruns}");
    }
    for cause in ["a DMA transfer was lost", "a trigger other than the sampling clock"] {
        assert!(reason(&by_sampler, "overruns").contains(cause), "{by_sampler:?}");
    }
}

#[test]
fn the_check_that_explains_others_comes_first_and_its_cause_is_in_the_summary() {
    let test = |failed: &[&'static str]| {
        let names = ["frames_lost", "samples_lost", "overruns", "restart", "sampling"];
        let check = |name: &'static str| {
            let cause = failed.contains(&name).then(|| format!("cause of {name}"));
            Check::words(name, name, "", "", cause)
        };
        let checks = Vec::from(names.map(check));
        test_of(checks)
    };
    for (failed, first, named) in [
        (&["samples_lost", "overruns", "sampling"][..], "sampling", Some("sampling")),
        (&["samples_lost", "overruns", "restart"], "overruns", Some("overruns")),
        (&["frames_lost", "samples_lost", "overruns"], "frames_lost", None),
        (&["frames_lost", "samples_lost", "sampling"], "sampling", Some("sampling")),
        (&["overruns", "sampling"], "sampling", Some("sampling")),
        (&["restart", "sampling"], "restart", None),
        (&["overruns"], "overruns", None),
    ] {
        let test = test(failed);
        assert_eq!((test.failed().first(), test.failed().len()), (Some(&first), failed.len()));
        let counts = format!("{} passed, {} failed, 0 skipped", 5 - failed.len(), failed.len());
        let cause = named.map(|name| format!("; likely cause: cause of {name}")).unwrap_or_default();
        assert_eq!(test.summary(), counts + &cause);
    }
}

#[test]
fn settings_that_are_not_kept_or_not_restored_fail() {
    let saved = Settings::default();
    let found = Settings { skew_s: 1e-6, publish_rate_hz: 7.0, ..saved };
    assert_eq!(same("kept", "Settings", "as saved", &saved, &saved).verdict, Verdict::Pass);
    let check = same("kept", "Settings", "as saved", &saved, &found);
    assert_eq!((check.verdict, check.found.as_deref()), (Verdict::Fail, Some("others")));
    assert_eq!(check.reason.as_deref(), Some("2 settings differ from those saved"));
    assert_eq!(restored(Ok(true)).verdict, Verdict::Pass);
    for (outcome, reason) in [(Ok(false), "its settings now differ"), (Err("no board".to_owned()), "no board")] {
        let check = restored(outcome);
        assert_eq!((check.verdict, check.found.as_deref()), (Verdict::Fail, Some("others")));
        assert!(check.reason.is_some_and(|found| found.contains(reason)), "{reason}");
    }
}

#[test]
fn a_board_that_tells_nothing_fails_everything_it_can() {
    let checks = all(&Measured::new(Measure::Chip)).concat();
    assert!(checks.iter().all(|check| check.verdict != Verdict::Pass), "{checks:#?}");
}

proptest! {
    /// Implausible figures neither cause a panic nor pass.
    #[test]
    fn nonsense_does_not_pass(figures in prop::collection::vec((any::<u8>(), any::<u32>()), 0..=MAX_FIGURES)) {
        let figures = figures.iter().map(|&(quantity, value)| Figure { quantity: quantity % 40, value }).collect();
        let measured = Measured { what: Measure::Work, figures };
        for checks in all(&measured) {
            prop_assert!(!failed(&checks).is_empty());
        }
        let test = SelfTest { measured: vec![measured], ..test_of(vec![]) };
        prop_assert!(!test.json().to_string().contains("NaN"));
    }

    #[test]
    fn samples_of_any_kind_are_judged(codes in prop::collection::vec(any::<i32>(), 0..300), rate_hz in any::<f64>()) {
        let samples: Vec<RawSample> =
            codes.iter().map(|&force_code| RawSample { force_code, ..RawSample::default() }).collect();
        let checks = noise(Input::Force, &samples, rate_hz);
        prop_assert!(checks[0].verdict != Verdict::Pass);
    }
}
