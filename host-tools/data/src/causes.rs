//! What may be wrong with a run: problems of its samples, found by the estimator, or violations of the law, found by a
//! diagnosis. One list of names for programs, and texts for people.

use inerter_core::{Machine, WarningKind};

use crate::names::description;

/// What may violate the law.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Friction grows with the force.
    LoadDependent,
    /// Force or friction repeats with the revolutions of the screw.
    PositionPeriodic,
    /// Friction falls with the speed (Stribeck effect).
    Stribeck,
    /// Friction reverses gradually over a distance.
    Presliding,
    /// Offset or friction changes with time.
    Drift,
    /// Force and position are not sampled at the same time.
    Skew,
    /// The position has an error per revolution, or within a line.
    EncoderError,
    /// Friction differs by direction.
    Direction,
    /// Friction grows with the square of the velocity.
    QuadraticFriction,
    /// A force depends on the position.
    Spring,
    /// The position yields under the force.
    Compliance,
    /// The measured force is not proportional to the true force.
    ForceNonlinear,
    /// A mass on the terminal does not move with the screw.
    Structure,
}

impl Kind {
    /// All of them.
    pub const ALL: [Self; 13] = [
        Self::LoadDependent,
        Self::PositionPeriodic,
        Self::Stribeck,
        Self::Presliding,
        Self::Drift,
        Self::Skew,
        Self::EncoderError,
        Self::Direction,
        Self::QuadraticFriction,
        Self::Spring,
        Self::Compliance,
        Self::ForceNonlinear,
        Self::Structure,
    ];

    /// Its name for programs.
    pub const fn name(self) -> &'static str {
        self.texts().0
    }

    /// A description for a person.
    pub const fn words(self) -> &'static str {
        self.texts().1
    }

    const fn texts(self) -> (&'static str, &'static str) {
        match self {
            Self::LoadDependent => ("load_dependent", "friction that grows with the load"),
            Self::PositionPeriodic => ("position_periodic", "force or friction that repeats with the turns"),
            Self::Stribeck => ("stribeck", "friction that is greater at low speed"),
            Self::Presliding => ("presliding", "friction that reverses gradually over a distance"),
            Self::Drift => ("drift", "a drift"),
            Self::Skew => ("skew", "a delay of the force"),
            Self::EncoderError => ("encoder_error", "an error of the encoder"),
            Self::Direction => ("direction", "viscous friction that differs by direction"),
            Self::QuadraticFriction => ("quadratic_friction", "friction that grows with the square of the velocity"),
            Self::Spring => ("spring", "a force that varies with the position"),
            Self::Compliance => ("compliance", "a position that yields to the force"),
            Self::ForceNonlinear => ("force_nonlinear", "a nonlinear measurement of the force"),
            Self::Structure => ("structure", "a mass on the terminal that moves differently from the screw"),
        }
    }
}

/// Faults of samples, all of them.
pub const WARNING_KINDS: [WarningKind; 4] =
    [WarningKind::WrongSign, WarningKind::CountSlip, WarningKind::ClippedForce, WarningKind::DeadForce];

/// The name of a fault of samples, for programs.
pub const fn warning_name(kind: WarningKind) -> &'static str {
    warning_texts(kind).0
}

/// What is wrong with the samples and what to do, for a person.
pub fn warning_words(machine: Machine, kind: WarningKind) -> String {
    description(machine, warning_texts(kind).1)
}

const fn warning_texts(kind: WarningKind) -> (&'static str, &'static str) {
    match kind {
        WarningKind::WrongSign => (
            "wrong_sign",
            "the inertance is negative beyond its interval: the force or the position has the wrong sign, or nothing there has \
             inertia; check the signs of newtons_per_code and metres_per_count",
        ),
        WarningKind::CountSlip => (
            "count_slip",
            "the position jumped further than any force could move it, and samples that depend on it are left out: the encoder \
             loses counts; check its cable, its supply and its maximum rate",
        ),
        WarningKind::ClippedForce => (
            "clipped_force",
            "the force is clipped below its stated limits: clipped samples are left out, and the estimator restarts; reduce \
             the amplifier's gain or the motion, or state force_min_code and force_max_code",
        ),
        WarningKind::DeadForce => (
            "dead_force",
            "the force stays constant while the screw moves back and forth: such samples are left out, and the estimator \
             restarts; check the load cell's cable and its supply",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A public contract: docs/CLI.md.
    #[test]
    fn every_cause_has_a_name_of_its_own() {
        let names = [&WARNING_KINDS.map(warning_name)[..], &Kind::ALL.map(Kind::name)].concat();
        let all = "wrong_sign count_slip clipped_force dead_force load_dependent position_periodic stribeck presliding drift \
                   skew encoder_error direction quadratic_friction spring compliance force_nonlinear structure";
        assert_eq!(names.join(" "), all);
        let of_law: Vec<&str> = Kind::ALL.into_iter().map(Kind::name).collect();
        assert_eq!(of_law, names[4..]);
    }
}
