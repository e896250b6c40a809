//! `cargo xtask skew`: how often the interval of a measured skew contains the true one, for machines of any size.

use inerter_analysis::skew::{Skew, SkewError};
use inerter_tests::{
    grid::{Column, Result, each},
    sheet::{Asked, Measured, by_width, significant},
    skew::{Case, Found, drawn},
};
use std::{collections::BTreeSet, ops::RangeInclusive};

/// Seeds of the machines that determined the thresholds.
const SETTING: RangeInclusive<u64> = 1..=300;
/// Seeds of the machines that count.
const JUDGING: RangeInclusive<u64> = 20_001..=20_400;
/// Minimum fraction of the reported skews whose interval contains the true value.
const LEAST_HELD: f64 = 0.9;

/// Result for one machine.
struct Told {
    device: &'static str,
    motion: &'static str,
    /// Error and half width \[s\], or the reason why there is no skew.
    skew: Result<(f64, f64), &'static str>,
    /// Residual before and after, relative to the force.
    residual: Option<[f64; 2]>,
}

fn told(seed: u64) -> Result<Told> {
    let case = drawn(seed)?;
    let Found { skew, .. } = case.found()?;
    let Case { device, motion, .. } = case;
    let part = |found: &Skew| found.residual_rms_n.map(|rms_n| rms_n / found.force_rms_n);
    let residual = skew.as_ref().ok().map(part);
    let skew = match skew {
        Ok(found) => Ok((found.skew_s - case.delay_s(), found.u95_s)),
        Err(SkewError::SingleTone { .. }) => Err("single tone"),
        Err(SkewError::TooNoisy { .. }) => Err("noise"),
        Err(SkewError::Beyond { .. }) => Err("beyond 5 ms"),
        Err(SkewError::Backwards { .. }) => Err("wrong way"),
        Err(SkewError::Fit(_)) => Err("too little motion"),
        Err(error @ SkewError::Settings(_)) => return Err(error.into()),
    };
    Ok(Told { device, motion, skew, residual })
}

/// The skews that are reported, and their median half width \[s\].
fn counted<'a>(all: impl Iterator<Item = &'a Told>) -> (Column, f64) {
    by_width(all.filter_map(|one| one.skew.ok()))
}

pub fn measure(_: Asked) -> Measured {
    let judging = each(JUDGING, told)?;
    let mut text = format!(
        "# Skews

`cargo xtask skew --update` writes this table. Each run is of another machine, drawn by the seeds
{} to {}: 3 mg m^2 to 500 kg, friction of 1 to 150 % of the inertance's force, noise of 0.02
to 5 % of the force, 300 to 300 000 counts per stroke, sample rates of 500 Hz to 4 kHz, and a force
up to 5 ms late or early. Each run has 20 s of motion. Its settings do not state the delay.

- *reported*: runs with a reported skew. *covered*: those of them whose interval contains the delay.
- *rms*: of the error over the half width. An exact interval has 0.51.

| device or motion | runs | reported | covered | rms | median U95 us |
|---|---|---|---|---|---|
",
        JUDGING.start(),
        JUDGING.end()
    );
    let kinds: [fn(&Told) -> &'static str; 2] = [|one| one.device, |one| one.motion];
    for kind in kinds {
        for name in judging.iter().map(kind).collect::<BTreeSet<_>>() {
            let those = judging.iter().filter(|one| kind(one) == name);
            let (told, u95_s) = counted(those.clone());
            text += &format!(
                "| {name} | {} | {} | {} | {:.2} | {} |\n",
                those.count(),
                told.given,
                told.covered(),
                told.rms,
                significant(1e6 * u95_s)
            );
        }
    }
    let (told, _) = counted(judging.iter());
    let refused = |why: &str| judging.iter().filter(|one| one.skew.err() == Some(why)).count();
    let [before, after] = [0, 1].map(|place| {
        let mut residuals: Vec<f64> = judging.iter().filter_map(|one| Some(one.residual?[place])).collect();
        residuals.sort_by(f64::total_cmp);
        residuals[residuals.len() / 2]
    });
    let setting = each(SETTING, self::told)?;
    let (set, _) = counted(setting.iter());
    text += &format!(
        "
Of {} machines, {} have a reported skew. Its interval contains the delay in {} of them ({:.1} %,
rms {:.2}). Of the machines that set the thresholds (seeds {} to {}) it does so in {} of {}
(rms {:.2}). With the skew set, the median residual of the law falls from {:.1} to {:.1} % of the
force.

The other machines have no reported skew, for these reasons: in {} there is too little motion
outside rest (strokes shorter than the kernel, or friction that holds the screw), {} are too noisy,
{} look like a single tone, and {} seem to have a delay beyond 5 ms, which none of them has.
",
        judging.len(),
        told.given,
        told.covered(),
        100.0 * told.covered() as f64 / told.given.max(1) as f64,
        told.rms,
        SETTING.start(),
        SETTING.end(),
        set.covered(),
        set.given,
        set.rms,
        100.0 * before,
        100.0 * after,
        refused("too little motion"),
        refused("noise"),
        refused("single tone"),
        refused("beyond 5 ms") + refused("wrong way"),
    );
    Ok((text, told.covered() as f64 >= LEAST_HELD * told.given as f64))
}
