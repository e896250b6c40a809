//! The parameters of the complete model, and which of them all stretches share.

use std::f64::consts::TAU;

use inerter_plant::Inerter;
use serde::Serialize;

/// The parameters of the complete model: their values, all finite, or what is known of each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Parameters<T = f64> {
    /// Effective inertance `mt` \[kg\].
    pub inertance_kg: T,
    /// Viscous friction `cf` \[N s/m\].
    pub viscous_n_s_per_m: T,
    /// Coulomb friction `fc` \[N\].
    pub coulomb_n: T,
    /// Contact stiffness `ks`; as a number 0 if unknown \[N/m\].
    pub stiffness_n_per_m: T,
    /// Contact damping `cs` \[N s/m\].
    pub contact_damping_n_s_per_m: T,
    /// Total backlash `eps` \[m\].
    pub backlash_m: T,
    /// Structure mass `mr` \[kg\].
    pub structure_mass_kg: T,
    /// Force offset `F0`; with several files that of the first one \[N\].
    pub offset_n: T,
    /// Delay `tau` of the force relative to the displacements \[s\].
    pub skew_s: T,
}

impl Parameters {
    /// Natural frequency of the inertance on the contact's spring \[Hz\].
    pub(super) fn own_hz(&self) -> f64 {
        (self.stiffness_n_per_m / self.inertance_kg).max(0.0).sqrt() / TAU
    }
}

/// A simulated device, with a load cell without offset and delay.
impl From<&Inerter> for Parameters {
    fn from(device: &Inerter) -> Self {
        Self {
            inertance_kg: device.inertance_kg,
            viscous_n_s_per_m: device.viscous_n_s_per_m,
            coulomb_n: device.coulomb_n,
            stiffness_n_per_m: device.stiffness_n_per_m,
            contact_damping_n_s_per_m: device.contact_damping_n_s_per_m,
            backlash_m: device.backlash_m,
            structure_mass_kg: device.structure_mass_kg,
            offset_n: 0.0,
            skew_s: 0.0,
        }
    }
}

impl<T> Parameters<T> {
    /// Name and parameter, in order.
    pub fn named(&self) -> [(&'static str, &T); 9] {
        [
            ("inertance_kg", &self.inertance_kg),
            ("viscous_n_s_per_m", &self.viscous_n_s_per_m),
            ("coulomb_n", &self.coulomb_n),
            ("stiffness_n_per_m", &self.stiffness_n_per_m),
            ("contact_damping_n_s_per_m", &self.contact_damping_n_s_per_m),
            ("backlash_m", &self.backlash_m),
            ("structure_mass_kg", &self.structure_mass_kg),
            ("offset_n", &self.offset_n),
            ("skew_s", &self.skew_s),
        ]
    }
}

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
