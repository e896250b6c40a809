//! Fits the estimator's law again from its exact sums: by segment, by direction, and for a held-back part.
//!
//! The sums of a segment are those at its end minus those at its beginning, as integers; so the segments add up to the
//! run exactly, whatever their number.

use inerter_core::{Bank, MoreSums, Sums};
use inerter_data::{
    json::ParameterJson,
    replay::{Outcome, Replay},
    run::Run,
    settings::SettingsInputError,
};

use super::result::{SegmentFit, SegmentParameters};
use crate::fit::{Beside, Directions, FitError, Products, directions};

/// Sums of both banks at one time.
#[derive(Clone, Copy)]
struct Mark {
    t_s: f64,
    banks: [(Sums, MoreSums); 2],
}

impl Mark {
    fn of(replay: &Replay) -> Self {
        Self { t_s: replay.time_s(), banks: [Bank::Fast, Bank::Slow].map(|bank| replay.sums(bank)) }
    }
}

/// A run as the estimator sees it.
pub struct Linear {
    /// The estimator's final outcome.
    pub outcome: Outcome,
    /// Sums of the whole run, since the last change of the device.
    pub whole: Result<Products, FitError>,
    /// Sums of the held-back part, and of the part before it.
    pub split: Option<(Products, Products)>,
    /// Fits of the segments.
    pub segments: Vec<SegmentFit>,
}

/// Runs a run through the estimator; segments are `segment_s` long, or extend from discontinuity to discontinuity.
pub fn linear(run: &Run, segment_s: Option<f64>, fitted: f64) -> Result<Linear, SettingsInputError> {
    let mut replay = Replay::new(&run.settings, run.start_s)?;
    let start = Mark { t_s: run.start_s, ..Mark::of(&replay) };
    let (mut marks, mut split, mut next) = (vec![start], None, run.start_s);
    let split_s = run.start_s + fitted * run.duration_s();
    let mut last: Option<u64> = None;
    for (elapsed, sample) in run.elapsed() {
        let t_s = run.start_s + elapsed as f64 / run.settings.sample_rate_hz;
        let discontinuity = last.replace(elapsed).is_some_and(|last| elapsed > last + 1);
        let due = match segment_s {
            Some(_) => t_s >= next && elapsed > 0,
            None => discontinuity,
        };
        if due {
            marks.push(Mark::of(&replay));
        }
        if let Some(segment_s) = segment_s {
            while next <= t_s {
                next += segment_s;
            }
        }
        if split.is_none() && t_s >= split_s {
            split = Some(Mark::of(&replay));
        }
        replay.step(sample).for_each(drop);
    }
    let end = Mark::of(&replay);
    marks.push(end);
    let outcome = replay.outcome();
    let bank = outcome.estimate.bank as usize;
    let products = |from: &Mark, to: &Mark| {
        let (sums, more) = grown(&from.banks[bank], &to.banks[bank]);
        Products::of(&sums, &more)
    };
    let segments = marks
        .iter()
        .zip(marks.iter().skip(1))
        .map(|(from, to)| {
            let fit = products(from, to)
                .and_then(|products| directions(&products, &run.settings, &Beside::of(&outcome), None));
            SegmentFit {
                from_s: from.t_s,
                to_s: to.t_s,
                fit: fit.as_ref().ok().map(by_segment),
                reason: fit.err().map(|error| error.to_string()),
            }
        })
        .collect();
    let split = split.and_then(|middle| Some((products(&middle, &end).ok()?, products(&start, &middle).ok()?)));
    Ok(Linear { whole: products(&start, &end), outcome, split, segments })
}

/// The increase of the sums; all of them if they were restarted in between.
fn grown(from: &(Sums, MoreSums), to: &(Sums, MoreSums)) -> (Sums, MoreSums) {
    let (mut sums, mut more) = *to;
    if from.0.updates > sums.updates {
        return (sums, more);
    }
    sums.updates -= from.0.updates;
    more.updates = more.updates.saturating_sub(from.1.updates);
    sums.sums.iter_mut().zip(from.0.sums).for_each(|(to, from)| *to -= from);
    more.sums.iter_mut().zip(from.1.sums).for_each(|(to, from)| *to -= from);
    (sums, more)
}

fn by_segment(fit: &Directions) -> SegmentParameters {
    let [positive, negative] = fit.viscous_n_s_per_m;
    SegmentParameters {
        inertance_kg: fit.symmetric.inertance_kg.into(),
        viscous_n_s_per_m: fit.symmetric.viscous_n_s_per_m.into(),
        coulomb_n: fit.symmetric.coulomb_n.into(),
        offset_n: fit.symmetric.offset_n.into(),
        viscous_positive_n_s_per_m: positive.into(),
        viscous_negative_n_s_per_m: negative.into(),
        difference_and_twice_offset_n: ParameterJson::offset(fit.difference_n),
        residual_rms_n: fit.symmetric_residual_rms_n,
        residual_by_direction_rms_n: fit.residual_rms_n,
    }
}
