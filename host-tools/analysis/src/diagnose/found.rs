//! The causes found: fits them together, and searches each velocity and distance with all the others included.

use super::{
    candidate::{Found, Kind, LIMIT, Term},
    columns::Rows,
    selection::{Model, SIGN},
};
use crate::law::Law;

/// Factor by which a velocity or distance is searched to either side of the nearest value that was tried.
const WIDE: f64 = 2.5;
/// The same after an earlier search.
const NARROW: f64 = 1.4;
/// Steps of the golden-section search, each of which keeps 0.62 of the range.
const STEPS: usize = 12;
/// The golden section.
const GOLDEN: f64 = 0.618_033_988_75;

/// The law with all causes found; `None` if the motion cannot separate them.
pub(super) fn model<'a>(rows: &'a Rows<'a>, found: &[Found]) -> Option<Model<'a>> {
    let mut columns: Vec<Vec<f64>> = rows.base.to_vec();
    for one in found {
        let new = rows.columns(one.term);
        if one.is_whole {
            columns[SIGN].iter_mut().zip(&new[0]).for_each(|(sign, turned)| *sign += turned);
        } else {
            columns.extend(new);
        }
    }
    Model::of(rows, columns)
}

/// Takes the law's values and the sizes from this model.
pub(super) fn taken(model: &Model, found: &mut [Found]) -> Law {
    let values = &model.values;
    let mut place = 4;
    for one in found {
        let first = if one.is_whole { SIGN } else { place };
        one.sizes = [values[first], if one.width() == 2 { values[first + 1] } else { 0.0 }];
        place += one.width();
    }
    Law { inertance_kg: values[0], viscous_n_s_per_m: values[1], coulomb_n: values[2], offset_n: values[3] }
}

/// Searches velocities and distances again, each with all other causes included, for either shape of the term.
pub(super) fn refine(rows: &Rows, found: &mut [Found]) {
    for place in 0..found.len() {
        let term = found[place].term;
        if term.scale().is_none() {
            continue;
        }
        let others = found.iter().enumerate().filter(|(other, _)| *other != place).map(|(_, one)| *one);
        let Some(law) = model(rows, &others.collect::<Vec<Found>>()) else { continue };
        // A friction that reverses as a whole has one size less.
        let of_a_size = LIMIT * law.square();
        let ways: &[bool] = if term.kind() == Kind::Presliding { &[false, true] } else { &[false] };
        let mut best: Option<(f64, Term, bool)> = None;
        for term in [Some(term), term.other_shape()].into_iter().flatten() {
            for &is_whole in ways {
                let left = |term: Term| {
                    let columns = rows.columns(term);
                    columns.first().and_then(|column| law.left_with(column, is_whole)).unwrap_or(f64::INFINITY)
                };
                let (scale, least) = sought(term.scale().unwrap_or(1.0), NARROW, |scale| left(term.with_scale(scale)));
                let least = if is_whole { least } else { least + of_a_size };
                if best.is_none_or(|(before, ..)| least < before) {
                    best = Some((least, term.with_scale(scale), is_whole));
                }
            }
        }
        if let Some((_, term, is_whole)) = best {
            (found[place].term, found[place].is_whole) = (term, is_whole);
        }
    }
}

/// The minimum of a function around a scale: where, and its value.
fn sought(scale: f64, wide: f64, function: impl Fn(f64) -> f64) -> (f64, f64) {
    let at = |log: f64| function(log.exp());
    let (mut low, mut high) = ((scale / wide).ln(), (scale * wide).ln());
    let mut inner = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
    let mut values = inner.map(at);
    for _ in 0..STEPS {
        if values[0] < values[1] {
            high = inner[1];
            inner = [high - GOLDEN * (high - low), inner[0]];
            values = [at(inner[0]), values[0]];
        } else {
            low = inner[0];
            inner = [inner[1], low + GOLDEN * (high - low)];
            values = [values[1], at(inner[1])];
        }
    }
    let [first, second] = [0, 1].map(|place| (inner[place], values[place]));
    let (log, value) = if second.1 < first.1 { second } else { first };
    (log.exp(), value)
}

/// The term with the velocity or distance at which it explains most, according to `strength`.
pub(super) fn strongest(term: Term, strength: impl Fn(Term) -> f64) -> Term {
    let Some(scale) = term.scale() else { return term };
    let (sought, _) = sought(scale, WIDE, |scale| -strength(term.with_scale(scale)));
    term.with_scale(sought)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_is_found_around_the_nearest_that_was_tried() {
        for least in [1.4, 2.0, 2.9] {
            let (scale, value) = sought(2.0, WIDE, |scale| (scale / least).ln().powi(2) - 1.0);
            assert!((scale / least - 1.0).abs() < 0.01 && (value + 1.0).abs() < 1e-4, "{scale} {least}");
        }
    }
}
