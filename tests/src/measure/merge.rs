//! `cargo xtask merge`: how often the interval of merged runs contains the device's value, and how much more runs
//! improve it.

use inerter_analysis::merge::Runs;
use inerter_core::NORMAL_COVERAGE;
use inerter_data::{replay::replay_samples, settings::Overrides};
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Setup, bench_sensors, raw};
use inerter_tests::{
    grid::{Column, Error, NAMES, Result, each, errors},
    sheet::{self, Asked, Measured, significant},
};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use std::array;

/// Number of groups of runs, each of one device.
const GROUPS: u64 = 60;
/// First seed of the runs. No constant was tuned on them.
const FIRST_SEED: u64 = 0x5EED_0000;
/// Number of runs of a group that are merged.
const SIZES: [usize; 4] = [1, 2, 4, 16];
/// Length of a run \[s\].
const DURATION_S: f64 = 10.0;
/// Minimum coverage over all cases and sizes, for each parameter.
const LEAST_HELD: f64 = 0.93;
/// Uncertainties of the rig that are truly zero, and stated so.
const PERFECT: [&str; 4] = ["force_gain_u95", "lead_u95", "timebase_u95", "structure_mass_u95_kg"];

/// The runs of a group.
struct Case {
    name: &'static str,
    motions: &'static [&'static str],
    metres_per_count: f64,
    /// Relative standard deviations of inertance and Coulomb friction from run to run.
    varies: [f64; 2],
    /// Stated uncertainty of the skew; each rig has an error of this size \[s\].
    skew_u95_s: f64,
}

const FINE: f64 = 2.441_406_25e-6;

/// A device that does not change, on a perfect rig.
const SAME: Case = Case { name: "", motions: &[], metres_per_count: FINE, varies: [0.0; 2], skew_u95_s: 0.0 };
const SEVERAL: &[&str] = &["random", "mid", "two", "multi"];

const CASES: [Case; 12] = [
    Case { name: "random", motions: &["random"], ..SAME },
    Case { name: "mid, repeated", motions: &["mid"], ..SAME },
    Case { name: "two, repeated", motions: &["two"], ..SAME },
    Case { name: "fast, repeated", motions: &["fast"], ..SAME },
    Case { name: "several", motions: SEVERAL, ..SAME },
    Case { name: "fast and slow", motions: &["fast", "slow"], ..SAME },
    Case { name: "random, 20 um", motions: &["random"], metres_per_count: 20e-6, ..SAME },
    Case { name: "mid, repeated, 20 um", motions: &["mid"], metres_per_count: 20e-6, ..SAME },
    Case { name: "several, skew wrong by its stated 5 us", motions: SEVERAL, skew_u95_s: 5e-6, ..SAME },
    Case { name: "random, fc varies by 5 %", motions: &["random"], varies: [0.0, 0.05], ..SAME },
    Case { name: "random, fc varies by 0.1 %", motions: &["random"], varies: [0.0, 0.001], ..SAME },
    Case { name: "several, mt varies by 0.1 %", motions: SEVERAL, varies: [0.001, 0.0], ..SAME },
];

/// Error and half width of each parameter, if given, and whether the runs are reported to differ in any parameter.
struct Told {
    found: [Option<(f64, f64)>; 3],
    differ: bool,
}

/// Results of one group, for each number of merged runs.
fn group(case: &Case, seed: u64) -> Result<Vec<Told>> {
    let seed = FIRST_SEED + 1000 * seed;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut overrides = Overrides::default();
    PERFECT.iter().try_for_each(|name| overrides.set(name, 0.0, "the table"))?;
    overrides.set("skew_u95_s", case.skew_u95_s, "the table")?;
    let skew: f64 = StandardNormal.sample(&mut random);
    let delay_s = skew * case.skew_u95_s / f64::from(NORMAL_COVERAGE);
    let (mut runs, mut told) = (Vec::new(), Vec::new());
    let most = SIZES[SIZES.len() - 1];
    for number in 0..most {
        let [inertance, coulomb]: [f64; 2] = array::from_fn(|i| {
            let drawn: f64 = StandardNormal.sample(&mut random);
            1.0 + case.varies[i] * drawn
        });
        let paper = Inerter::paper();
        let device =
            Inerter { inertance_kg: paper.inertance_kg * inertance, coulomb_n: paper.coulomb_n * coulomb, ..paper };
        let seed = seed + number as u64;
        let sensors = Sensors { seed, metres_per_count: case.metres_per_count, delay_s, ..bench_sensors() };
        overrides.set("skew_s", 0.0, "the table")?;
        let motion = case.motions[number % case.motions.len()];
        let setup = Setup::new(device, sensors, motion, Some(DURATION_S), &overrides)?;
        let samples = setup.samples()?.map(|sample| Ok(raw(&sample)));
        let outcome = replay_samples::<Error>(&setup.settings, 0.0, samples, |_, _| Ok(()))?;
        runs.push(Runs::of(&format!("{seed}"), &setup.settings, &outcome));
        if SIZES.contains(&runs.len()) {
            let merged = Runs::all(runs.iter().cloned())?.merged(None)?;
            let found = errors(&merged.fit.symmetric, &paper);
            told.push(Told { found, differ: merged.differs.contains(&true) });
        }
    }
    Ok(told)
}

pub fn measure(_: Asked) -> Measured {
    let mut text = format!(
        "# Runs merged

`cargo xtask merge --update` writes this table. Each of {GROUPS} groups has runs of {DURATION_S} s of one device,
the paper's. `inerter fit` and `inerter.merge` fit 1, 2, 4 or 16 of these runs together. Each run
has a seed of its own. With `repeated` all runs of a group have the same motion, with `several` they
have `random`, `mid`, `two` and `multi` in turn. The settings state the true uncertainties: none for
the rig, and the actual one for the skew.

- *U95*: the median half width.
- *covered*: of the intervals given, how many contain the mean value of the device.
- *rms*: of the error over the half width. An exact interval has 0.51.
- *differ*: groups whose runs are reported to differ by more than their scatter.

A single run cannot show variation between runs: its interval is that of the device during that run.
So, where the device varies, rows of one run are not counted in the totals below.

| motions | runs | mt: U95 kg | covered | rms | cf: U95 N s/m | covered | rms | fc: U95 N | covered | rms | differ |
|---|---|---|---|---|---|---|---|---|---|---|---|
"
    );
    let (mut held, mut told) = ([0; 3], [0; 3]);
    let mut differ_alike = (0, 0);
    for case in &CASES {
        let groups = each(1..=GROUPS, |seed| group(case, seed))?;
        for (place, size) in SIZES.into_iter().enumerate() {
            let mut cells = Vec::new();
            for parameter in 0..NAMES.len() {
                let found = groups.iter().filter_map(|group| group[place].found[parameter]);
                let (column, median) = sheet::by_width(found);
                let Column { rms, given, .. } = column;
                cells.extend(match given {
                    0 => ["-"; 3].map(String::from),
                    _ => [significant(median), format!("{} of {given}", column.covered()), format!("{rms:.2}")],
                });
                // A single run cannot show the variation from run to run.
                if size > 1 || case.varies == [0.0; 2] {
                    held[parameter] += column.covered();
                    told[parameter] += given;
                }
            }
            let differ = groups.iter().filter(|group| group[place].differ).count();
            if case.varies == [0.0; 2] && size > 1 {
                differ_alike = (differ_alike.0 + differ, differ_alike.1 + groups.len());
            }
            cells.push(differ.to_string());
            text += &sheet::row(&[case.name, &size.to_string()], cells);
        }
    }
    let share = |i: usize| 100.0 * held[i] as f64 / told[i] as f64;
    text += &format!(
        "
The interval contains the mean value in {:.1} % of {} cases for mt, {:.1} % of {} for cf and
{:.1} % of {} for fc. Of {} groups of more than one run of a device that does not vary, {} are
reported to differ.
",
        share(0),
        told[0],
        share(1),
        told[1],
        share(2),
        told[2],
        differ_alike.1,
        differ_alike.0
    );
    let are_held = (0..NAMES.len()).all(|i| held[i] as f64 >= LEAST_HELD * told[i] as f64);
    Ok((text, are_held))
}
