//! The final joint fit of the law and the causes found: sizes and parameters with their intervals.

use inerter_core::{
    Detail, Found as Estimated, Motion, NORMAL_COVERAGE, Parameters, Scatter, Settings, apart, constants,
};

use super::{
    candidate::{Encoder, Found, Kind, Term},
    cause::Cause,
    columns::Rows,
    found::model,
    selection::{Model, SIGN},
};
use crate::fit::{Beside, Judge};

/// Largest apparent skew caused by friction at the reversals \[s\] (docs/THEORY.md, 14).
const SKEW_MODEL_U95_S: f64 = 13e-6;
/// By how much the residual of another period may exceed the smallest, in squares of the noise, for it to be possible:
/// it is then less likely by a factor of 150.
const POSSIBLE: f64 = 10.0;
/// Relative change of a velocity or distance in a numerical derivative.
const STEP: f64 = 0.02;

/// Fits the causes found: the causes, the parameters with them included, and the RMS residual \[N\]. The rows are
/// corrected for a skew of `undone_s`. `None` if the motion cannot separate them all.
pub(super) fn fitted(
    rows: &Rows,
    settings: &Settings,
    detail: &Detail,
    found: &[Found],
    undone_s: f64,
    encoder: Encoder,
) -> Option<(Vec<Cause>, Parameters, f64)> {
    let law = model(rows, found)?;
    // The derivative with respect to a velocity or distance is one more column.
    let slopes: Vec<Option<Vec<f64>>> = found.iter().map(|one| slope(rows, one)).collect();
    let with_slopes = law.beside(slopes.iter().flatten().cloned());
    let variance = with_slopes.as_ref().unwrap_or(&law).variance()?;
    let others = other_turns(rows, settings, &law, found, encoder);
    // By how much another possible fit may differ from this one.
    let off = |of: &dyn Fn(&Model) -> f64| others.iter().map(|other| (of(other) - of(&law)).abs()).fold(0.0, f64::max);
    let (mut at, mut slope_at) = (rows.base.len(), law.values.len());
    let mut causes: Vec<Cause> = Vec::new();
    for (one, slope) in found.iter().zip(&slopes) {
        let width = one.width();
        let first = if one.is_whole { SIGN } else { at };
        let size_by = |model: &Model| match width {
            2 => model.values[first].hypot(model.values[first + 1]),
            _ => model.values[first],
        };
        let size = size_by(&law);
        let size_variance = match width {
            2 => variance(&[first, first + 1].map(|place| (place, law.values[place] / size))),
            _ => variance(&[(first, 1.0)]),
        };
        let is_sought = slope.is_some() && with_slopes.is_some();
        let scale_variance = if is_sought { variance(&[(slope_at, 1.0)]) } else { f64::INFINITY };
        let u95 = |variance: f64| constants::COVERAGE * variance.max(0.0).sqrt();
        let size_u95 = u95(size_variance) + off(&size_by);
        let (value, u95, f) = match one.term {
            Term::Turning(distance) | Term::Bending(distance) => (distance, u95(scale_variance) * distance, one.f()),
            // A corrected skew shows nothing more, and counts with its former evidence.
            Term::Skew => {
                let whole_s = undone_s + size;
                (whole_s, size_u95.hypot(SKEW_MODEL_U95_S), whole_s * whole_s / size_variance)
            }
            _ => (size, size_u95, one.f()),
        };
        let period_m = one.term.period_m();
        let is_part = period_m.is_some_and(|period_m| period_m > rows.span.stroke_m);
        causes.push(Cause {
            kind: one.term.kind(),
            value,
            u95,
            unit: one.term.unit(),
            f,
            period_m,
            is_part_of_a_turn: is_part && encoder.counts_per_turn.is_none(),
            rival: one.rival,
        });
        at += width;
        slope_at += usize::from(slope.is_some());
    }
    causes.sort_by(|a, b| b.f.total_cmp(&a.f));
    let skew_u95_s = causes.iter().find(|cause| cause.kind == Kind::Skew).map_or(settings.skew_u95_s, |skew| skew.u95);
    let settings = Settings { skew_u95_s, ..*settings };
    let errors = [0, 1, 2, 3].map(|i| {
        let off = off(&|model: &Model| model.values[i]);
        variance(&[(i, 1.0)]).sqrt() + off / f64::from(NORMAL_COVERAGE)
    });
    let corrected = corrected(rows, &settings, detail, &law, errors)?;
    Some((causes, corrected, law.residual_rms()))
}

/// The relative derivative of the force with respect to a velocity or distance.
fn slope(rows: &Rows, one: &Found) -> Option<Vec<f64>> {
    let scale = one.term.scale()?;
    let column = |factor: f64| rows.columns(one.term.with_scale(scale * factor)).into_iter().next();
    let (less, more) = (column(1.0 - STEP)?, column(1.0 + STEP)?);
    Some(more.iter().zip(&less).map(|(more, less)| one.sizes[0] * (more - less) / (2.0 * STEP)).collect())
}

/// The same fits with other possible periods, if the period was not given.
fn other_turns<'a>(
    rows: &'a Rows<'a>,
    settings: &Settings,
    law: &Model,
    found: &[Found],
    encoder: Encoder,
) -> Vec<Model<'a>> {
    if encoder.counts_per_turn.is_some() {
        return Vec::new();
    }
    let all = Term::all(&rows.span, settings, encoder);
    let most = law.left() + POSSIBLE * law.square();
    let mut others = Vec::new();
    for (place, one) in found.iter().enumerate() {
        let own = one.term;
        let is_other = |term: Term| term != own && std::mem::discriminant(&term) == std::mem::discriminant(&own);
        for term in all.iter().filter(|term| term.period_m().is_some() && is_other(**term)) {
            let mut with = found.to_vec();
            with[place].term = *term;
            others.extend(model(rows, &with).filter(|other| other.left() <= most));
        }
    }
    others
}

/// The parameters from this fit.
fn corrected(rows: &Rows, settings: &Settings, detail: &Detail, law: &Model, errors: [f64; 4]) -> Option<Parameters> {
    // Effect of an undetected residual skew, whether or not a skew was found.
    let late = rows.columns(Term::Skew);
    let alone = model(rows, &[])?;
    let moved = alone.along(late.first()?)?;
    let of_curvature = alone.along(&rows.curvature())?;
    // They are not corrected, because their effect is known only to a factor of two.
    let steps = law.taken_by_steps()?;
    let found = [0, 1, 2, 3].map(|i| Estimated {
        value: law.values[i] as f32,
        error: errors[i] as f32,
        // The column of a skew is the negative rate of the force.
        per_skew: -moved[i] as f32,
        steps: steps[i].abs() as f32,
    });
    // The violations of the law are in the fit, and repeated steps are in its errors.
    let friction_in_curvature = [1, 2].map(|i| of_curvature[i] as f32);
    let motion = Motion::of(detail, 1.0);
    let [accelerations, ..] = &rows.base;
    let square = accelerations.iter().map(|a| a * a).sum::<f64>() / accelerations.len() as f64;
    let gap_m = detail.contact.gap_m(&detail.backlash);
    let apart = apart(gap_m, motion.frequency_squared, (square - rows.filter.acceleration_square) as f32);
    let beside = Beside { motion: Motion { friction_in_curvature, apart, ..motion }, model_u95: [0.0; 4] };
    let scatter = Scatter::white(law.values[0] as f32, law.freedom(0) as f32);
    Some(Judge { settings, beside: &beside, scatter }.four(found))
}
