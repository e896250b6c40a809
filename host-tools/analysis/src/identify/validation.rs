//! How well identified parameters explain data.

use super::{
    complete::{Fitted, State, counting, prediction},
    prepared::Prepared,
    result::Validation,
};

/// RMS ratio of the residual to what the noise explains.
pub(super) fn over_noise(fitted: &Fitted) -> f64 {
    (2.0 * fitted.cost / fitted.residual.len().max(1) as f64).sqrt()
}

/// How well a model explains the rest of each stretch after its fitted part.
pub(super) fn judged(stretches: &[Prepared], state: &State, fitted: f64) -> Option<Validation> {
    let (mut left, mut all, mut count) = (0.0, 0.0, 0usize);
    for (number, prepared) in stretches.iter().enumerate() {
        let (_, force) = prediction(state, number, prepared);
        let range = counting(prepared);
        let from = range.start.max((fitted * prepared.force.len() as f64) as usize);
        let offset_n = state.offsets[prepared.file];
        let pairs = prepared.force.iter().zip(&force).take(range.end).skip(from);
        for (measured, predicted) in pairs {
            left += (measured - predicted).powi(2);
            all += (measured - offset_n).powi(2);
            count += 1;
        }
    }
    (count > 0 && all > 0.0).then(|| Validation {
        fitted,
        residual_rms_n: (left / count as f64).sqrt(),
        explained: 1.0 - left / all,
    })
}
