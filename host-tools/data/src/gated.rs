//! A run without the wrong samples, which the estimator's gates leave out.
//!
//! The estimator sees each sample once, and reports the sample at which it detected a fault. Here the whole run is
//! available, so the same rules find the same faults from their first sample on:
//! - *Clipped force*: codes pile up at an extreme below the rails. Codes so close to it that the noise is cut off on
//!   one side are left out too.
//! - *Dead force*: the code stays constant while the screw moves back and forth. It is then invalid wherever it stays
//!   constant.
//! - *Slipped counts*: the position bends by as much as at a sample that the estimator reported. No sample is lost; the
//!   stretch ends there.

use inerter_core::{
    RawSample, Warning, WarningKind,
    constants::{DEAD_REVERSALS, LEAST_NOISE, PILED_WITHIN, QUARTILES, STILL_CODES},
};

use crate::{run::Run, series::Series};

/// Codes near the extreme count as piled up if there are at least this many, and more than half of those within the
/// wider range.
const FEWEST: usize = 16;
/// How far below the extreme a clipped force is left out, in rms of the noise: closer codes have their noise cut off on
/// one side.
const CUT_OFF: f64 = 3.0;
/// Counts that the screw must move back to count as a reversal.
const REVERSED_COUNTS: f64 = 4.0;
/// A working force never stays constant for this long in motion \[s\].
const STILL_S: f64 = 0.1;

/// A run without wrong samples.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gated {
    /// The remaining samples.
    pub series: Series,
    /// What was left out, or where the run was split.
    pub left_out: Vec<WarningKind>,
    /// Faults that the estimator reported and that are not found here; they may be anywhere.
    pub not_found: Vec<WarningKind>,
}

impl Gated {
    /// Whether samples with an invalid force were left out.
    pub fn has_no_force(&self) -> bool {
        self.left_out.iter().any(|kind| matches!(kind, WarningKind::ClippedForce | WarningKind::DeadForce))
    }

    /// Gates a run for which the estimator reported these warnings.
    pub fn of(run: &Run, told: &[Warning]) -> Self {
        let is_in = |warning: &&Warning| {
            run.samples.first().is_none_or(|first| warning.index.wrapping_sub(first.index) < 1 << 31)
        };
        let told: Vec<Warning> = told.iter().filter(is_in).copied().collect();
        let is_told = |kind: WarningKind| told.iter().any(|warning| warning.kind == kind);
        let unclipped = unclipped(run);
        let dead = dead(run, is_told(WarningKind::DeadForce));
        let jumps = jumps(run, &told);
        let found = [
            (WarningKind::ClippedForce, unclipped.is_some()),
            (WarningKind::DeadForce, dead.contains(&true)),
            (WarningKind::CountSlip, !jumps.is_empty()),
        ];
        let left_out = found.iter().filter(|(_, found)| *found).map(|(kind, _)| *kind).collect();
        let not_found = found.iter().filter(|(kind, found)| !found && is_told(*kind)).map(|(kind, _)| *kind).collect();
        let is_left_out = |n: usize, sample: &RawSample| {
            let code = f64::from(sample.force_code);
            dead.get(n).copied().unwrap_or(false)
                || unclipped.is_some_and(|(above, below)| code <= above || code >= below)
        };
        let series = Series::without(run, is_left_out, |n| jumps.binary_search(&n).is_ok());
        Self { series, left_out, not_found }
    }
}

/// The codes between which the force is not clipped, if it is clipped anywhere.
fn unclipped(run: &Run) -> Option<(f64, f64)> {
    let settings = &run.settings;
    let is_within = |code: f64| code > settings.force_min_code && code < settings.force_max_code;
    let codes: Vec<i64> = run
        .samples
        .iter()
        .filter(|sample| is_within(sample.force_code.into()))
        .map(|sample| sample.force_code.into())
        .collect();
    let noise = noise(&codes)?;
    let resolution = ((0.5 * noise) as i64).max(1);
    let wide = i64::from(PILED_WITHIN) * resolution;
    let (greatest, least) = (codes.iter().max()?, codes.iter().min()?);
    // A nearly constant force has no extremes.
    if greatest - least <= 2 * wide {
        return None;
    }
    let piled = |below: &dyn Fn(i64) -> i64| {
        let within = |width: i64| codes.iter().filter(|code| below(**code) < width).count();
        let near = within(resolution);
        near >= FEWEST && 2 * near > within(wide)
    };
    let [high, low] = [piled(&|code| greatest - code), piled(&|code| code - least)];
    let below = if high { *greatest as f64 - CUT_OFF * noise } else { f64::INFINITY };
    let above = if low { *least as f64 + CUT_OFF * noise } else { f64::NEG_INFINITY };
    (high || low).then_some((above, below))
}

/// Noise of the force that is not clipped \[codes, rms\], from the fourth differences; `None` if there is too little.
fn noise(codes: &[i64]) -> Option<f64> {
    let differences = codes.windows(5).filter_map(|five| match five {
        [a, b, c, d, e] => Some((a - 4 * b + 6 * c - 4 * d + e).abs()),
        _ => None,
    });
    let mut differences: Vec<i64> = differences.collect();
    differences.sort_unstable();
    let rms = |(quarters, per_rms): (usize, f64)| {
        differences.get(differences.len() * (quarters + 1) / 4).map(|magnitude| *magnitude as f64 / per_rms)
    };
    QUARTILES.into_iter().enumerate().filter_map(rms).find(|rms| *rms >= LEAST_NOISE)
}

/// Marks the samples in which the force is dead; none if the force is alive throughout, unless the estimator reported
/// it.
fn dead(run: &Run, is_told: bool) -> Vec<bool> {
    let settings = &run.settings;
    let longest = (STILL_S * settings.sample_rate_hz) as usize;
    let reversed = (REVERSED_COUNTS * settings.oversampling) as i32;
    let samples = &run.samples;
    let (mut dead, mut is_dead, mut from) = (vec![false; samples.len()], is_told, 0);
    while let Some(first) = samples.get(from) {
        let rest = samples.get(from..).unwrap_or_default();
        let still = rest.iter().take_while(|sample| sample.force_code.abs_diff(first.force_code) <= STILL_CODES);
        let length = still.clone().count();
        if length >= longest {
            is_dead |= reversals(still, reversed) >= usize::from(DEAD_REVERSALS);
            dead.iter_mut().skip(from).take(length).for_each(|dead| *dead = true);
        }
        from += length.max(1);
    }
    if is_dead { dead } else { vec![false; samples.len()] }
}

/// How often the screw reverses and moves `far` counts.
fn reversals<'a>(samples: impl Iterator<Item = &'a RawSample>, far: i32) -> usize {
    let (mut extreme, mut way, mut times) = (None, 0, 0);
    for sample in samples {
        let position = sample.position_count;
        let from = *extreme.get_or_insert(position);
        let gone = position.wrapping_sub(from);
        if gone.signum() == way {
            extreme = Some(position);
        } else if gone.unsigned_abs() >= far.unsigned_abs() {
            times += usize::from(way != 0);
            (extreme, way) = (Some(position), gone.signum());
        }
    }
    times
}

/// Samples before which the counts slipped, in order: wherever the position bends by as much as at one that the
/// estimator reported.
fn jumps(run: &Run, told: &[Warning]) -> Vec<usize> {
    let bend = |three: &[RawSample]| match three {
        [a, b, c] => {
            let (first, second) =
                (b.position_count.wrapping_sub(a.position_count), c.position_count.wrapping_sub(b.position_count));
            second.wrapping_sub(first).unsigned_abs()
        }
        _ => 0,
    };
    let bends = || run.samples.windows(3).enumerate().map(|(n, three)| (n + 2, bend(three)));
    let is_told = |n: usize| {
        let index = run.samples.get(n).map(|sample| sample.index);
        told.iter().any(|warning| warning.kind == WarningKind::CountSlip && Some(warning.index) == index)
    };
    let Some(least) = bends().filter(|(n, _)| is_told(*n)).map(|(_, bend)| bend).min() else { return Vec::new() };
    bends().filter(|(_, bend)| *bend >= least).map(|(n, _)| n).collect()
}

#[cfg(test)]
#[path = "gated_tests.rs"]
mod tests;
