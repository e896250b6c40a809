//! Runs this build of the host's analysis on a set of runs and prints the results, for `cargo xtask ablation --host`.
//!
//! One line per count: its name, a tab, and the count.

use inerter_analysis::diagnose::{Cause, Kind};
use inerter_core::{LawStatus, Parameters};
use inerter_tests::{
    diagnose::{Added, Case, Replayed, cases, clean_case, clean_cases, others, parting},
    grid::{Motion, Result, each, errors, motion},
};

/// No table has this seed.
const SEED: u64 = 9101;
/// Motions with different information: a slow and a fast tone, many tones, and noise.
const NAMES: [&str; 4] = ["mid", "fast", "multi", "random"];
/// Fastest rate used \[Hz\]: here, faster sampling adds no information.
const FASTEST_HZ: f64 = 1000.0;
/// Maximum relative error of a size.
const RIGHT: f64 = 0.1;
/// Backlash whose impacts may look like a cause \[m\].
const BACKLASHES_M: [f64; 2] = [50e-6, 300e-6];
/// Friction as a fraction of the force, and amplitudes of a force once per turn \[N\], too small to break the law.
const LOADS: [f64; 2] = [0.0006, 0.0025];
const RIPPLES_N: [f64; 2] = [0.2, 0.7];

/// Totals over the runs of one motion.
#[derive(Default)]
struct Counts {
    /// Runs whose fault is named first, and those among them with the right size.
    first: u32,
    sized: u32,
    /// Parameters of these runs that are given with the causes included, and those among them within their intervals.
    corrected: u32,
    right: u32,
    /// Runs whose first cause is wrong.
    wrong: u32,
    /// Parameters given in runs without a warning, of a law that is true or nearly so; those outside the interval from
    /// the samples; those of them whose report does not list the fault as an assumption either; and those whose report
    /// lists any assumption.
    given: u32,
    outside: u32,
    unreported: u32,
    assumed: u32,
    /// Sum of the logarithms of the ratios of these intervals to the device's.
    widths: f64,
}

impl Counts {
    fn add_fault(&mut self, case: &Case, motion: &Motion) {
        // With one part of the analysis removed, the search may end in rows that it cannot fit. Then nothing is named.
        let found = case.diagnosed(motion, SEED).ok();
        let Some((first, corrected)) = found.and_then(|found| Some((*found.causes.first()?, found.corrected))) else {
            return;
        };
        if Some(first.kind) != case.kind {
            self.wrong += 1;
            return;
        }
        self.first += 1;
        self.sized += u32::from((first.value - case.size).abs() <= RIGHT * case.size.abs());
        for (off, u95) in corrected.iter().flat_map(|parameters| given(case, parameters)).flatten() {
            self.corrected += 1;
            self.right += u32::from(off <= u95);
        }
    }

    /// A run in which nothing must be named, with the parameters judged by the samples.
    fn add_law(&mut self, case: &Case, motion: &Motion) -> Result<()> {
        let Replayed { outcome, causes, judged } = case.replayed(motion, SEED)?;
        self.wrong += u32::from(causes.first().is_some_and(|cause| Some(cause.kind) != case.kind));
        if !causes.is_empty() || outcome.law.status == LawStatus::Broken {
            return Ok(());
        }
        let mut widths = 0.0;
        for (own, judged) in given(case, &outcome.estimate.whole_run).into_iter().zip(judged) {
            let Some((off, u95)) = own else { continue };
            let wider = f64::from(judged.budget.u95());
            let is_said = case.kind.is_some_and(|kind| judged.assumes.contains(&kind));
            self.given += 1;
            self.outside += u32::from(off > wider);
            self.unreported += u32::from(off > wider && !is_said);
            self.assumed += u32::from(!judged.assumes.is_empty());
            widths += (wider / u95).ln();
        }
        self.widths += widths;
        Ok(())
    }

    /// A run in which flanks separate, with the contact's stiffness stated or not. If it is not stated, a structure
    /// mass may be named, because the device has one.
    fn add_flanks(&mut self, backlash_m: f64, motion: &Motion, with_stiffness: bool) -> Result<()> {
        let causes = parting(backlash_m).told(motion, SEED, with_stiffness)?;
        let is_wrong = |cause: &Cause| with_stiffness || cause.kind != Kind::Structure;
        self.wrong += u32::from(causes.iter().any(is_wrong));
        Ok(())
    }
}

/// Error and half width of inertance, viscous and Coulomb friction, if given.
fn given(case: &Case, parameters: &Parameters) -> [Option<(f64, f64)>; 3] {
    errors(parameters, &case.device).map(|found| found.map(|(error, u95)| (error.abs(), u95)))
}

/// Runs of a law that is nearly true.
fn nearly() -> Vec<Case> {
    let clean = clean_case(1.0, 1000.0);
    let with = |kind, added| Case { kind: Some(kind), added, ..clean };
    let loads = LOADS.map(|load| with(Kind::LoadDependent, Added { load, ..clean.added }));
    let ripples = RIPPLES_N.map(|ripple_n| with(Kind::PositionPeriodic, Added { ripple_n, ..clean.added }));
    loads.into_iter().chain(ripples).collect()
}

pub fn run(_: &[&str]) -> Result<bool> {
    let faults: Vec<Case> = cases().into_iter().chain(others()).collect();
    // A rotary machine gives the same results in other units.
    let clean = clean_cases().into_iter().filter(|case| case.sensors.sample_rate_hz <= FASTEST_HZ && !case.is_rotary);
    let laws: Vec<Case> = clean.chain(nearly()).collect();
    let of_motion = |name: &&str| -> Result<Counts> {
        let motion = motion(name);
        let mut counts = Counts::default();
        faults.iter().for_each(|case| counts.add_fault(case, motion));
        laws.iter().try_for_each(|case| counts.add_law(case, motion))?;
        for backlash_m in BACKLASHES_M {
            for with_stiffness in [true, false] {
                counts.add_flanks(backlash_m, motion, with_stiffness)?;
            }
        }
        Ok(counts)
    };
    let all = each(NAMES.iter(), of_motion)?;
    type Reading = (&'static str, fn(&Counts) -> u32);
    let readings: [Reading; 9] = [
        ("first", |counts| counts.first),
        ("sized", |counts| counts.sized),
        ("corrected", |counts| counts.corrected),
        ("right", |counts| counts.right),
        ("wrong", |counts| counts.wrong),
        ("given", |counts| counts.given),
        ("outside", |counts| counts.outside),
        ("unreported", |counts| counts.unreported),
        ("assumed", |counts| counts.assumed),
    ];
    for (name, count) in readings {
        println!("{name}\t{}", all.iter().map(count).sum::<u32>());
    }
    let given: u32 = all.iter().map(|counts| counts.given).sum();
    let widths = all.iter().fold(0.0, |sum, counts| sum + counts.widths);
    println!("width\t{:.4}", f64::exp(widths / f64::from(given.max(1))));
    Ok(true)
}
