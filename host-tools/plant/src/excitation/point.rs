//! A terminal's state at one time.

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
