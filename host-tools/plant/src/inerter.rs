//! The device: inertance, friction, contact and structure mass.
//!
//! Everything is referred to the terminal, in SI units. Source: Li, Liang and Wang, "Two-terminal manipulation of
//! masses ... Part I", sections 2.2, 3 and 4.3. Friction beyond Coulomb's: Armstrong-Helouvry, Dupont and Canudas de
//! Wit, "A survey of models, analysis tools and compensation methods for the control of machines with friction",
//! Automatica 30 (1994), sections 2.1 (Stribeck, with a Gaussian) and 2.2 (Dahl).

use std::collections::BTreeMap;

use crate::PlantError;
use crate::table::field_table;

/// Fastest rate of a device that can be simulated \[rad/s\]: beyond it a simulated second takes a million steps.
const FASTEST_RAD_PER_S: f64 = 1e5;

field_table! {
/// The device's physical constants, referred to the terminal.
pub struct Inerter {
    /// Effective inertance `mt`: everything that rotates with the screw \[kg\].
    inertance_kg, "kg", 299.4906, 1e-9, 1e7, Real, "Effective inertance";
    /// Viscous friction `cf` on the screw, the mean of both directions \[N s/m\].
    viscous_n_s_per_m, "N s/m", 31.4, 0.0, 1e7, Real, "Viscous friction on the screw";
    /// Coulomb friction `fc` on the screw in fast sliding, the mean of both directions \[N\].
    coulomb_n, "N", 50.0, 0.0, 1e6, Real, "Coulomb friction on the screw";
    /// Contact stiffness `ks` between terminal and screw \[N/m\].
    stiffness_n_per_m, "N/m", 2.1e6, 1e-6, 1e12, Real, "Contact stiffness between terminal and screw";
    /// Contact damping `cs` between terminal and screw \[N s/m\].
    contact_damping_n_s_per_m, "N s/m", 1200.0, 0.0, 1e9, Real, "Contact damping between terminal and screw";
    /// Total backlash `eps`: play between one flank and the other \[m\].
    backlash_m, "m", 0.0, 0.0, 1.0, Real, "Total backlash between the flanks";
    /// Structure mass `mr` attached to the measured terminal in parallel with the screw \[kg\].
    structure_mass_kg, "kg", 1.515, 0.0, 1e4, Real, "Mass on the measured terminal in addition to the screw";
    /// Relative excess of the forward Coulomb friction over the mean of both directions; backward it is less by the
    /// same.
    coulomb_asymmetry, "", 0.0, -1.0, 1.0, Real, "Fraction by which Coulomb friction is greater forward and less backward";
    /// The same for viscous friction.
    viscous_asymmetry, "", 0.0, -1.0, 1.0, Real, "Fraction by which viscous friction is greater forward and less backward";
    /// Static friction relative to that of fast sliding; 1 means Coulomb friction.
    stribeck_ratio, "", 1.0, 1.0, 10.0, Real, "Friction at rest over that of fast sliding";
    /// Velocity at which the excess (Stribeck) has fallen to `1/e` \[m/s\].
    stribeck_velocity_m_per_s, "m/s", 0.002, 1e-6, 1e3, Real, "Velocity at which the excess at rest has fallen to 1/e";
    /// Travel over which friction approaches its sliding level by a factor of `1 - 1/e`; 0 means at once \[m\].
    presliding_m, "m", 0.0, 0.0, 1.0, Real, "Travel over which friction reverses by 1 - 1/e; 0 reverses at once";
    /// 1 if the flanks can only push.
    unilateral, "", 0.0, 0.0, 1.0, Whole, "1 if the flanks can only push";
    /// Force on the screw in addition to the contact's, e.g. a weight; positive pushes forward \[N\].
    constant_force_n, "N", 0.0, -1e6, 1e6, Real, "Force on the screw, e.g. a weight; positive pushes forward";
} }

impl Inerter {
    /// The paper's device: 0.738 kg of flywheel, 4.5158 leads in radius, act as 297.0673 kg, other rotating parts add
    /// 2.4233 kg. Its Coulomb friction is missing from our copy of the paper: 50 N is our choice.
    pub const fn paper() -> Self {
        Self::DEFAULT
    }

    /// The paper's device after wear: 0.1 mm of backlash.
    pub const fn worn() -> Self {
        Self { backlash_m: 1e-4, ..Self::paper() }
    }

    /// The paper's device with its nut preloaded: no backlash, and three times the friction.
    pub const fn preloaded() -> Self {
        Self { coulomb_n: 150.0, ..Self::paper() }
    }

    /// The paper's device with friction that reverses over 50 um, as in a ball screw.
    pub const fn presliding() -> Self {
        Self { presliding_m: 50e-6, ..Self::paper() }
    }

    /// The paper's device with static friction 1.3 times the sliding friction.
    pub const fn stribeck() -> Self {
        Self { stribeck_ratio: 1.3, ..Self::paper() }
    }

    /// The preset of this name, one of [`PRESETS`](Self::PRESETS).
    pub fn preset(name: &str) -> Result<Self, PlantError> {
        match name {
            "paper" => Ok(Self::paper()),
            "worn" => Ok(Self::worn()),
            "preloaded" => Ok(Self::preloaded()),
            "presliding" => Ok(Self::presliding()),
            "stribeck" => Ok(Self::stribeck()),
            _ => Err(PlantError::UnknownPreset { name: name.into(), known: Self::PRESETS }),
        }
    }

    /// Sets several fields by name.
    pub fn set_all(&mut self, values: &BTreeMap<String, f64>) -> Result<(), PlantError> {
        values.iter().try_for_each(|(name, value)| self.set(name, *value))
    }

    /// Names accepted by [`preset`](Self::preset).
    pub const PRESETS: &'static [&'static str] = &["paper", "worn", "preloaded", "presliding", "stribeck"];

    /// Checks every single value, and that the device is slow enough to be simulated.
    pub fn validate(&self) -> Result<(), PlantError> {
        self.check_fields()?;
        let inertance_kg = self.inertance_kg;
        let (field, rate) = [
            ("stiffness_n_per_m", (self.stiffness_n_per_m / inertance_kg).sqrt()),
            ("presliding_m", (self.presliding_n_per_m() / inertance_kg).sqrt()),
            ("contact_damping_n_s_per_m", self.contact_damping_n_s_per_m / inertance_kg),
            ("viscous_n_s_per_m", self.greatest_viscous() / inertance_kg),
            ("stribeck_velocity_m_per_s", self.stribeck_n_s_per_m() / inertance_kg),
        ]
        .into_iter()
        .fold(("", 0.0), |worst, each| if each.1 > worst.1 { each } else { worst });
        if rate > FASTEST_RAD_PER_S {
            return Err(PlantError::TooFast { field, rate_rad_per_s: rate, max_rad_per_s: FASTEST_RAD_PER_S });
        }
        Ok(())
    }

    /// The viscous friction in the direction that has more of it \[N s/m\].
    fn greatest_viscous(&self) -> f64 {
        self.viscous(self.viscous_asymmetry.signum())
    }

    /// An upper bound of the rates of all modes of the device \[rad/s\]; sets the length of a step.
    pub(crate) fn fastest_rad_per_s(&self) -> f64 {
        let viscous = self.greatest_viscous() + self.stribeck_n_s_per_m();
        let stiffness = self.stiffness_n_per_m + self.presliding_n_per_m();
        let damping = (self.contact_damping_n_s_per_m + viscous) / self.inertance_kg;
        damping.max((stiffness / self.inertance_kg).sqrt())
    }

    /// Coulomb friction of fast sliding in a direction, 1 or -1 \[N\].
    pub(crate) fn sliding_n(&self, direction: f64) -> f64 {
        self.coulomb_n * (1.0 + direction * self.coulomb_asymmetry)
    }

    /// Breakaway force in a direction \[N\].
    pub(crate) fn breakaway_n(&self, direction: f64) -> f64 {
        self.sliding_n(direction) * self.stribeck_ratio
    }

    /// Viscous friction in a direction \[N s/m\].
    pub(crate) fn viscous(&self, direction: f64) -> f64 {
        self.viscous_n_s_per_m * (1.0 + direction * self.viscous_asymmetry)
    }

    /// Whether friction reverses over a distance (presliding).
    pub(crate) fn presslides(&self) -> bool {
        self.presliding_m > 0.0 && self.coulomb_n > 0.0
    }

    /// Whether friction falls with the speed.
    pub(crate) fn has_stribeck(&self) -> bool {
        self.stribeck_ratio > 1.0 && self.coulomb_n > 0.0
    }

    /// Whether friction differs by direction.
    pub(crate) fn has_directions(&self) -> bool {
        self.coulomb_n > 0.0 || (self.viscous_asymmetry != 0.0 && self.viscous_n_s_per_m > 0.0)
    }

    /// Whether friction can hold the screw at rest.
    pub(crate) fn sticks(&self) -> bool {
        self.has_directions() && !self.presslides()
    }

    /// Whether the flanks always touch.
    pub(crate) fn is_closed(&self) -> bool {
        self.backlash_m == 0.0 && self.unilateral == 0.0
    }

    /// Steepest slope of friction over travel \[N/m\].
    fn presliding_n_per_m(&self) -> f64 {
        let turned_n = 2.0 * self.coulomb_n * (1.0 + self.coulomb_asymmetry.abs()) * self.stribeck_ratio;
        if self.presslides() { turned_n / self.presliding_m } else { 0.0 }
    }

    /// Steepest fall of friction over velocity, `sqrt(2/e)` of the excess per velocity \[N s/m\].
    fn stribeck_n_s_per_m(&self) -> f64 {
        let surplus_n = self.coulomb_n * (1.0 + self.coulomb_asymmetry.abs()) * (self.stribeck_ratio - 1.0);
        0.858 * surplus_n / self.stribeck_velocity_m_per_s
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    #[test]
    fn the_papers_inertance_follows_from_its_flywheel() {
        // A solid cylinder, its radius in leads.
        let flywheel_kg = 0.5 * 0.738 * (TAU * 4.5158).powi(2);
        assert!((flywheel_kg - 297.0673).abs() < 1e-3, "{flywheel_kg}");
        assert!((297.0673 + 2.4233 - Inerter::paper().inertance_kg).abs() < 1e-9);
    }

    #[test]
    fn presets_are_valid() {
        for name in Inerter::PRESETS {
            assert_eq!(Inerter::preset(name).and_then(|device| device.validate()), Ok(()), "{name}");
        }
    }

    #[test]
    fn refusals_name_the_field() {
        let mut device = Inerter::paper();
        assert_eq!(device.set("coulomb_n", f64::NAN), Err(PlantError::NotFinite { field: "coulomb_n" }));
        assert!(matches!(device.set("weight", 1.0), Err(PlantError::UnknownField { .. })));
        for (device, words) in [
            (Inerter { backlash_m: -1.0, ..device }, "backlash_m: -1 is outside"),
            (Inerter { inertance_kg: 0.01, stiffness_n_per_m: 1e12, ..device }, "stiffness_n_per_m"),
            (Inerter { presliding_m: 1e-12, ..device }, "presliding_m"),
            (Inerter { unilateral: 0.5, ..device }, "unilateral: 0.5 is not a whole"),
        ] {
            assert!(device.validate().unwrap_err().to_string().contains(words), "{words}");
        }
    }
}
