//! What the device is: inertance, friction, contact and structure mass.
//!
//! Everything is referred to the terminal, in SI units.
//! Source: Li, Liang and Wang, "Two-terminal manipulation of masses ... Part I", sections 2.2, 3 and 4.3.

use std::f64::consts::PI;

use crate::PlantError;
use crate::table::field_table;

/// Fastest rate of a device that can be followed \[rad/s\]: beyond it a simulated second takes a million steps.
const FASTEST_RAD_PER_S: f64 = 1e5;

/// The device's physical constants, referred to the terminal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// Effective inertance `mt`: what turns with the screw \[kg\].
    pub inertance_kg: f64,
    /// Viscous friction `cf` on the screw \[N s/m\].
    pub viscous_n_s_per_m: f64,
    /// Coulomb friction `fc` on the screw, sliding and at rest alike \[N\].
    pub coulomb_n: f64,
    /// Contact stiffness `ks` between terminal and screw \[N/m\].
    pub stiffness_n_per_m: f64,
    /// Contact damping `cs` between terminal and screw \[N s/m\].
    pub contact_damping_n_s_per_m: f64,
    /// Total backlash `eps`: play between one flank and the other \[m\].
    pub backlash_m: f64,
    /// Structure mass `mr` that hangs on the measured terminal beside the screw \[kg\].
    pub structure_mass_kg: f64,
}

field_table! { Parameters {
    inertance_kg, "kg", 299.4906, 1e-3, 1e7, Real, "Effective inertance";
    viscous_n_s_per_m, "N s/m", 31.4, 0.0, 1e7, Real, "Viscous friction on the screw";
    coulomb_n, "N", 50.0, 0.0, 1e6, Real, "Coulomb friction on the screw";
    stiffness_n_per_m, "N/m", 2.1e6, 1.0, 1e12, Real, "Contact stiffness between terminal and screw";
    contact_damping_n_s_per_m, "N s/m", 1200.0, 0.0, 1e9, Real, "Contact damping between terminal and screw";
    backlash_m, "m", 0.0, 0.0, 0.1, Real, "Total backlash between the flanks";
    structure_mass_kg, "kg", 1.515, 0.0, 1e4, Real, "Mass on the measured terminal beside the screw";
} }

impl Parameters {
    /// The paper's device. Its Coulomb friction did not survive in our text of the paper: 50 N is our choice.
    pub const fn paper() -> Self {
        Self {
            inertance_kg: 299.4906,
            viscous_n_s_per_m: 31.4,
            coulomb_n: 50.0,
            stiffness_n_per_m: 2.1e6,
            contact_damping_n_s_per_m: 1200.0,
            backlash_m: 0.0,
            structure_mass_kg: 1.515,
        }
    }

    /// The paper's device after wear: 0.1 mm of backlash.
    pub const fn worn() -> Self {
        Self { backlash_m: 1e-4, ..Self::paper() }
    }

    /// The preset of this name: `paper` or `worn`.
    pub fn preset(name: &str) -> Option<Self> {
        match name {
            "paper" => Some(Self::paper()),
            "worn" => Some(Self::worn()),
            _ => None,
        }
    }

    /// Names that [`preset`](Self::preset) knows.
    pub const PRESETS: &'static [&'static str] = &["paper", "worn"];

    /// Checks every value by itself and that the device is slow enough to be followed.
    pub fn validate(&self) -> Result<(), PlantError> {
        self.check_fields()?;
        let by_spring = (self.stiffness_n_per_m / self.inertance_kg).sqrt();
        let by_contact = self.contact_damping_n_s_per_m / self.inertance_kg;
        let by_viscous = self.viscous_n_s_per_m / self.inertance_kg;
        let (field, rate) = [
            ("stiffness_n_per_m", by_spring),
            ("contact_damping_n_s_per_m", by_contact),
            ("viscous_n_s_per_m", by_viscous),
        ]
        .into_iter()
        .fold(("", 0.0), |worst, each| if each.1 > worst.1 { each } else { worst });
        if rate > FASTEST_RAD_PER_S {
            return Err(PlantError::TooFast { field, rate_rad_per_s: rate, max_rad_per_s: FASTEST_RAD_PER_S });
        }
        Ok(())
    }

    /// A rate no mode of the device exceeds \[rad/s\]; sets the length of a step.
    pub(crate) fn fastest_rad_per_s(&self) -> f64 {
        let damping = (self.contact_damping_n_s_per_m + self.viscous_n_s_per_m) / self.inertance_kg;
        damping.max((self.stiffness_n_per_m / self.inertance_kg).sqrt())
    }
}

/// The screw and its flywheel, from which the ideal inertance follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScrewGeometry {
    /// Travel per turn \[m\].
    pub lead_m: f64,
    /// Pitch diameter `D` of the screw \[m\].
    pub pitch_diameter_m: f64,
    /// Mass of the flywheel \[kg\].
    pub flywheel_mass_kg: f64,
    /// Radius of the flywheel, a solid cylinder \[m\].
    pub flywheel_radius_m: f64,
    /// Inertance of the other turning parts (screw, bearing ring) \[kg\].
    pub other_inertance_kg: f64,
}

impl ScrewGeometry {
    /// The paper's device: 0.738 kg of flywheel feel like 297.0673 kg, other turning parts add 2.4233 kg.
    ///
    /// The text gives no dimension, only this ratio, from which the flywheel's radius is 4.5158 leads. A lead of 10 mm
    /// and a pitch diameter of 12 mm are our choice.
    pub fn paper() -> Self {
        let (lead_m, flywheel_mass_kg, ideal_kg) = (0.010, 0.738, 297.0673);
        let flywheel_radius_m = lead_m / PI * f64::sqrt(ideal_kg / flywheel_mass_kg / 2.0);
        Self { lead_m, pitch_diameter_m: 0.012, flywheel_mass_kg, flywheel_radius_m, other_inertance_kg: 2.4233 }
    }

    /// Helix angle `alpha`, from `lead = pi D tan(alpha)` \[rad\].
    pub fn helix_angle_rad(&self) -> f64 {
        (self.lead_m / (PI * self.pitch_diameter_m)).atan()
    }

    /// Times by which the flywheel's mass is magnified: `b = 2 r^2 / (D^2 tan(alpha)^2)`.
    pub fn magnification(&self) -> f64 {
        let d_tan_alpha = self.pitch_diameter_m * self.helix_angle_rad().tan();
        2.0 * self.flywheel_radius_m.powi(2) / d_tan_alpha.powi(2)
    }

    /// Ideal inertance of the flywheel alone: `b m` \[kg\].
    pub fn ideal_inertance_kg(&self) -> f64 {
        self.magnification() * self.flywheel_mass_kg
    }

    /// Effective inertance `mt` with the other turning parts \[kg\].
    pub fn inertance_kg(&self) -> f64 {
        self.ideal_inertance_kg() + self.other_inertance_kg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_inertance_follows_from_its_geometry() {
        let screw = ScrewGeometry::paper();
        let inertia = screw.flywheel_mass_kg * screw.flywheel_radius_m.powi(2) / 2.0;
        let by_energy = inertia * (2.0 * PI / screw.lead_m).powi(2);
        assert!((screw.ideal_inertance_kg() - 297.0673).abs() < 1e-9);
        assert!((by_energy - 297.0673).abs() < 1e-9);
        assert!((screw.inertance_kg() - Parameters::paper().inertance_kg).abs() < 1e-9);
    }

    #[test]
    fn defaults_of_the_table_are_the_paper() {
        let defaults: Vec<f64> = Parameters::TABLE.iter().map(|field| field.default).collect();
        assert_eq!(defaults, Parameters::paper().values());
        assert_eq!(Parameters::paper().validate(), Ok(()));
        assert_eq!(Parameters::worn().validate(), Ok(()));
    }

    #[test]
    fn refusals_name_the_field() {
        let mut device = Parameters::paper();
        assert_eq!(device.set("coulomb_n", f64::NAN), Err(PlantError::NotFinite { field: "coulomb_n" }));
        assert!(matches!(device.set("weight", 1.0), Err(PlantError::UnknownField { .. })));
        device.backlash_m = -1.0;
        assert!(device.validate().unwrap_err().to_string().contains("backlash_m: -1 is outside"));
        let device = Parameters { inertance_kg: 0.01, stiffness_n_per_m: 1e12, ..Parameters::paper() };
        assert!(device.validate().unwrap_err().to_string().contains("stiffness_n_per_m"));
    }
}
