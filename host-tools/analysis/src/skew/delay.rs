//! Finds the delay of the force with the smallest residual of the law, among those that a setting can correct.
//!
//! Rows keep their times, and the force is taken a number of samples later: the residual is a smooth function of the
//! delay, and neither its size nor noise in the force's rate shifts its minimum. Signs come from the position alone,
//! because a delayed force cannot locate reversals; friction may reverse at another moment.

use inerter_core::{Bank, Settings};
use inerter_data::series::Series;

use super::rows::Rows;
use crate::law::{Law, dot, inverse, products, products_with};

/// Largest delay that is searched for \[s\]: the range of the setting `skew_s`.
pub const MOST_S: f64 = 0.005;

/// The delay with the smallest residual \[s\], within the range; `None` if no delay gives a positive inertance, or the
/// motion cannot separate inertance and friction. The skew that the settings already correct does not matter.
pub(super) fn delay_s(series: &Series, settings: &Settings, bank: Bank) -> Option<f64> {
    let as_measured = Settings { skew_s: 0.0, ..*settings };
    let most = (MOST_S / series.period_s) as isize;
    let rows = Rows::of(series, &as_measured, bank, Law::default(), most.unsigned_abs());
    let columns: Vec<Vec<f64>> = rows.base.iter().cloned().chain(rows.turn()).collect();
    let inverse = inverse(&products(&columns, &columns))?;
    let left = |late: isize| {
        let force = rows.force_late_by(late);
        let right = products_with(&columns, &force);
        let values = &inverse * &right;
        // Relative to the force, which differs with the samples that it is taken from.
        (values[0] > 0.0).then(|| (late, 1.0 - values.dot(&right) / dot(&force, &force)))
    };
    let forward: Vec<(isize, f64)> = (-most..=most).filter_map(left).collect();
    let (place, (late, here)) = forward.iter().copied().enumerate().min_by(|(_, a), (_, b)| a.1.total_cmp(&b.1))?;
    let of = |place: usize| forward.get(place).map(|(_, part)| *part);
    let part = match (place.checked_sub(1).and_then(of), of(place + 1)) {
        (Some(before), Some(after)) if before - 2.0 * here + after > 0.0 => {
            0.5 * (before - after) / (before - 2.0 * here + after)
        }
        _ => 0.0,
    };
    Some((late as f64 + part) * series.period_s)
}
