//! Results of an identification, for programs and for people.

use inerter_data::json::ParameterJson;
use inerter_plant::Inerter;
use serde::Serialize;

use crate::response::ModelParameters;

/// Values of the complete model, all finite.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Parameters {
    /// Effective inertance `mt` \[kg\].
    pub inertance_kg: f64,
    /// Viscous friction `cf` \[N s/m\].
    pub viscous_n_s_per_m: f64,
    /// Coulomb friction `fc` \[N\].
    pub coulomb_n: f64,
    /// Contact stiffness `ks`; 0 where it is not known \[N/m\].
    pub stiffness_n_per_m: f64,
    /// Contact damping `cs` \[N s/m\].
    pub contact_damping_n_s_per_m: f64,
    /// Total backlash `eps` \[m\].
    pub backlash_m: f64,
    /// Structure mass `mr` \[kg\].
    pub structure_mass_kg: f64,
    /// Force offset `F0`; with several files that of the first \[N\].
    pub offset_n: f64,
    /// Delay `tau` of the force behind the displacements \[s\].
    pub skew_s: f64,
}

/// A simulated device, under a load cell without offset and delay.
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

/// The linear part: without Coulomb friction, backlash and offset.
impl From<&Parameters> for ModelParameters {
    fn from(parameters: &Parameters) -> Self {
        Self {
            inertance_kg: parameters.inertance_kg,
            viscous_n_s_per_m: parameters.viscous_n_s_per_m,
            stiffness_n_per_m: parameters.stiffness_n_per_m,
            contact_damping_n_s_per_m: parameters.contact_damping_n_s_per_m,
            structure_mass_kg: parameters.structure_mass_kg,
            skew_s: parameters.skew_s,
        }
    }
}

/// Whether a parameter can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FoundStatus {
    /// Value and interval hold.
    Ok,
    /// Value and interval hold, but the value may be zero.
    BelowU95,
    /// From the settings: the data add little or nothing.
    Given,
    /// The data cannot identify it.
    NotIdentifiable,
}

/// One parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Found {
    /// Value; none when not identifiable.
    pub value: Option<f64>,
    /// Half width of the 95 % interval.
    pub u95: Option<f64>,
    /// Ends of the 95 % interval by the profile of the likelihood, where it was taken: the parameter is weakly
    /// determined.
    pub profile: Option<[f64; 2]>,
    /// Whether it can be used.
    pub status: FoundStatus,
    /// Why not, or a remark, for a person.
    pub reason: Option<String>,
}

impl Found {
    /// One that the data cannot identify.
    pub fn unknown(reason: impl Into<String>) -> Self {
        Self {
            value: None,
            u95: None,
            profile: None,
            status: FoundStatus::NotIdentifiable,
            reason: Some(reason.into()),
        }
    }

    /// One with an interval.
    pub fn known(value: f64, u95: f64) -> Self {
        Self { value: Some(value), u95: Some(u95), profile: None, status: FoundStatus::Ok, reason: None }
    }

    /// The same, a bound where it is smaller than its interval.
    pub(super) fn bounded(self) -> Self {
        let is_below = self.value.zip(self.u95).is_some_and(|(value, u95)| value.abs() < u95);
        Self { status: if is_below { FoundStatus::BelowU95 } else { self.status }, ..self }
    }
}

/// All parameters, named as in [`Parameters`].
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented at Parameters")]
pub struct FoundParameters {
    pub inertance_kg: Found,
    pub viscous_n_s_per_m: Found,
    pub coulomb_n: Found,
    pub stiffness_n_per_m: Found,
    pub contact_damping_n_s_per_m: Found,
    pub backlash_m: Found,
    pub structure_mass_kg: Found,
    pub offset_n: Found,
    pub skew_s: Found,
}

impl FoundParameters {
    /// Name and parameter, in order.
    pub fn named(&self) -> [(&'static str, &Found); 9] {
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

/// What was fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// All of the model: the terminal's displacement is known.
    Complete,
    /// Inertance, friction and offset: only encoder and force are known.
    Linear,
}

/// Correlation of the parameters that were fitted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Correlation {
    /// Names, in the order of rows and columns.
    pub names: Vec<&'static str>,
    /// Rows.
    pub matrix: Vec<Vec<f64>>,
}

/// Whether the residual is white, by Ljung and Box.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Whiteness {
    /// Delays looked at.
    pub lags: usize,
    /// Sum over the squares of the autocorrelation; for white noise about the number of lags.
    pub statistic: f64,
    /// Probability that white noise gives as much.
    pub p: f64,
}

/// A part of the data that was not fitted, as the fit of the rest has it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Validation {
    /// Part of each file that was fitted; 0 for a file that was not.
    pub fitted: f64,
    /// Force that the model leaves unexplained there \[N\].
    pub residual_rms_n: f64,
    /// Part of the force's mean square that it explains.
    pub explained: f64,
}

/// Linear fit of one segment from its exact sums.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the parameters are those of `fit`")]
pub struct SegmentFit {
    /// Beginning \[s\].
    pub from_s: f64,
    /// End \[s\].
    pub to_s: f64,
    #[serde(flatten)]
    pub fit: Option<SegmentParameters>,
    /// Why there is no fit.
    pub reason: Option<String>,
}

/// Parameters of a segment, alike in both directions and by direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the parameters are those of `fit`")]
pub struct SegmentParameters {
    pub inertance_kg: ParameterJson,
    pub viscous_n_s_per_m: ParameterJson,
    pub coulomb_n: ParameterJson,
    pub offset_n: ParameterJson,
    pub viscous_positive_n_s_per_m: ParameterJson,
    pub viscous_negative_n_s_per_m: ParameterJson,
    pub difference_and_twice_offset_n: ParameterJson,
    /// Alike in both directions.
    pub residual_rms_n: f64,
    /// By direction.
    pub residual_by_direction_rms_n: f64,
}

/// What the data show of the device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Identified {
    /// What was fitted.
    pub model: Model,
    /// The parameters.
    pub parameters: FoundParameters,
    /// Where the complete fit began: what the estimator and the settings say, the stiffness scanned for where neither
    /// knows it. `None` of the linear model, whose fit begins nowhere.
    pub start: Option<Parameters>,
    /// Offsets of all files \[N\].
    pub offsets_n: Vec<Option<f64>>,
    /// How the errors of the parameters hang together.
    pub correlation: Option<Correlation>,
    /// Force that the model leaves unexplained \[N\].
    pub residual_rms_n: f64,
    /// The same of the encoder's displacement \[m\].
    pub residual_rms_m: Option<f64>,
    /// Residual over what the sensors' noise explains, root mean square; 1 where the model is right.
    pub residual_over_noise: Option<f64>,
    /// Of the force's residual.
    pub whiteness: Option<Whiteness>,
    /// On data that were not fitted.
    pub validation: Option<Validation>,
    /// Linear fits by file and segment.
    pub segments: Vec<Vec<SegmentFit>>,
    /// What a person should know.
    pub notes: Vec<String>,
}

impl Identified {
    /// The best values, for [`super::predicted`]; what is not identifiable is 0.
    pub fn model(&self) -> Parameters {
        let p = &self.parameters;
        let value = |found: &Found| found.value.unwrap_or_default();
        Parameters {
            inertance_kg: value(&p.inertance_kg),
            viscous_n_s_per_m: value(&p.viscous_n_s_per_m),
            coulomb_n: value(&p.coulomb_n),
            stiffness_n_per_m: value(&p.stiffness_n_per_m),
            contact_damping_n_s_per_m: value(&p.contact_damping_n_s_per_m),
            backlash_m: value(&p.backlash_m),
            structure_mass_kg: value(&p.structure_mass_kg),
            offset_n: value(&p.offset_n),
            skew_s: value(&p.skew_s),
        }
    }
}
