//! The parameters that all stretches share: names, indices and kinds.

use super::Parameters;

/// Parameters that all stretches share, in the order of their columns, each at its own index: `name as usize`.
pub const SHARED: [Name; 8] = [
    Name::Inertance,
    Name::Viscous,
    Name::Coulomb,
    Name::Stiffness,
    Name::Damping,
    Name::Backlash,
    Name::Structure,
    Name::Skew,
];

/// A parameter that all stretches share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Name {
    Inertance,
    Viscous,
    Coulomb,
    Stiffness,
    Damping,
    Backlash,
    Structure,
    Skew,
}

impl Name {
    pub fn key(self) -> &'static str {
        self.names().0
    }

    /// For a person.
    pub fn words(self) -> &'static str {
        self.names().1
    }

    fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Inertance => ("inertance_kg", "inertance"),
            Self::Viscous => ("viscous_n_s_per_m", "viscous friction"),
            Self::Coulomb => ("coulomb_n", "Coulomb friction"),
            Self::Stiffness => ("stiffness_n_per_m", "contact stiffness"),
            Self::Damping => ("contact_damping_n_s_per_m", "contact damping"),
            Self::Backlash => ("backlash_m", "backlash"),
            Self::Structure => ("structure_mass_kg", "structure mass"),
            Self::Skew => ("skew_s", "skew"),
        }
    }

    pub fn of(self, p: &Parameters) -> f64 {
        let mut p = *p;
        *self.slot(&mut p)
    }

    pub fn set(self, p: &mut Parameters, value: f64) {
        *self.slot(p) = value;
    }

    /// Its place among the parameters.
    pub fn slot<T>(self, p: &mut Parameters<T>) -> &mut T {
        match self {
            Self::Inertance => &mut p.inertance_kg,
            Self::Viscous => &mut p.viscous_n_s_per_m,
            Self::Coulomb => &mut p.coulomb_n,
            Self::Stiffness => &mut p.stiffness_n_per_m,
            Self::Damping => &mut p.contact_damping_n_s_per_m,
            Self::Backlash => &mut p.backlash_m,
            Self::Structure => &mut p.structure_mass_kg,
            Self::Skew => &mut p.skew_s,
        }
    }

    /// Derivative of the parameter with respect to its fitted variable.
    pub fn scale(self, p: &Parameters) -> f64 {
        if self.is_logarithmic() { self.of(p) } else { 1.0 }
    }

    /// Positive and of unknown magnitude: its logarithm is fitted.
    pub fn is_logarithmic(self) -> bool {
        matches!(self, Self::Inertance | Self::Stiffness | Self::Damping)
    }

    /// Never negative.
    pub fn has_floor(self) -> bool {
        matches!(self, Self::Coulomb | Self::Backlash)
    }
}
