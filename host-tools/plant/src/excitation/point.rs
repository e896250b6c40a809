//! A terminal's state at one time, and what a number of a motion may be.

use crate::PlantError;

/// Displacement, velocity and acceleration at one time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// Displacement \[m\].
    pub x_m: f64,
    /// Velocity \[m/s\].
    pub v_m_per_s: f64,
    /// Acceleration \[m/s^2\].
    pub a_m_per_s2: f64,
}

/// Whether a number of a motion lies in its range.
pub(super) fn check(field: &'static str, value: f64, (min, max): (f64, f64)) -> Result<(), PlantError> {
    if !value.is_finite() {
        return Err(PlantError::NotFinite { field });
    }
    if !(min..=max).contains(&value) {
        return Err(PlantError::OutOfRange { field, value, min, max });
    }
    Ok(())
}
