//! What may break the law, and how strong its evidence must be.

/// F statistic that a run without a fault does not reach (docs/tables/diagnose.md).
pub const LIMIT: f64 = 150.0;
/// The same of what acts at the reversals, which a sign that is placed a part of a sample too early or late looks like.
pub const LIMIT_AT_REVERSALS: f64 = 1000.0;

/// What may break the law.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Friction grows with the force.
    LoadDependent,
    /// Force or friction repeats with the turns of the screw.
    PositionPeriodic,
    /// Friction falls with the velocity.
    Stribeck,
    /// Friction turns over a distance.
    Presliding,
    /// Offset or friction changes with time.
    Drift,
    /// Force and position are not of the same moment.
    Skew,
    /// The position is wrong once a turn, or within a line.
    EncoderError,
    /// Friction differs by direction.
    Direction,
}

impl Kind {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::LoadDependent,
        Self::PositionPeriodic,
        Self::Stribeck,
        Self::Presliding,
        Self::Drift,
        Self::Skew,
        Self::EncoderError,
        Self::Direction,
    ];

    /// F statistic from which on it is named.
    pub fn limit(self) -> f64 {
        if matches!(self, Self::Stribeck | Self::Presliding) { LIMIT_AT_REVERSALS } else { LIMIT }
    }
}
