//! The delay of the force at which the law leaves least over, of all that a setting can undo.
//!
//! Rows stay where they are, and the force comes from so many samples later: what the law leaves over is a smooth
//! function of the delay, and neither its size nor noise in the force's rate shift its minimum. Signs are placed by the
//! position alone, as a force that is late can place none; friction may turn at another moment.

use inerter_core::{Bank, Settings};
use inerter_data::series::Series;

use super::{
    rows::Rows,
    squares::{dot, inverse, products},
};
use crate::law::Law;

/// Greatest delay that is looked for \[s\]: what the setting `skew_s` holds.
pub const MOST_S: f64 = 0.005;

/// The delay at which it is least \[s\], within the range; nothing where no delay gives a positive inertance, or the
/// motion cannot tell inertance and friction apart. What skew the settings undo does not matter.
pub(super) fn delay_s(series: &Series, settings: &Settings, bank: Bank) -> Option<f64> {
    let as_measured = Settings { skew_s: 0.0, ..*settings };
    let most = (MOST_S / series.period_s) as isize;
    let rows = Rows::of(series, &as_measured, bank, Law::default(), most.unsigned_abs());
    let columns: Vec<Vec<f64>> = rows.base.iter().cloned().chain(rows.turn()).collect();
    let inverse = inverse(&columns)?;
    let left = |late: isize| {
        let force = rows.force_late_by(late);
        let right = products(&columns, &force);
        let values = &inverse * &right;
        // As a part of the force, which differs with the samples that it is taken from.
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
