//! Results of an identification, for programs and for people.

use std::f64::consts::TAU;

use inerter_data::json::ParameterJson;
use inerter_plant::Inerter;
use serde::Serialize;

use crate::response::ModelParameters;

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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FoundStatus {
    /// Value and interval are valid.
    Ok,
    /// Value and interval are valid, but the value may be zero.
    BelowU95,
    /// From the settings: the data add little or nothing.
    Given,
    /// The data cannot identify it.
    #[default]
    NotIdentifiable,
}

/// One parameter.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Found {
    /// Value; `None` if not identifiable.
    pub value: Option<f64>,
    /// Half width of the 95 % interval.
    pub u95: Option<f64>,
    /// Ends of the 95 % interval from the likelihood profile, if one was computed because the parameter is weakly
    /// determined.
    pub profile: Option<[f64; 2]>,
    /// Whether it can be used.
    pub status: FoundStatus,
    /// Why not, or another remark, for a person.
    pub reason: Option<String>,
}

impl Found {
    /// A parameter that the data cannot identify.
    pub fn unknown(reason: impl Into<String>) -> Self {
        Self { reason: Some(reason.into()), ..Self::default() }
    }

    /// A parameter with an interval.
    pub fn known(value: f64, u95: f64) -> Self {
        Self { value: Some(value), u95: Some(u95), status: FoundStatus::Ok, ..Self::default() }
    }

    /// The same, as a bound if it is smaller than its interval.
    pub(super) fn bounded(self) -> Self {
        let is_below = self.value.zip(self.u95).is_some_and(|(value, u95)| value.abs() < u95);
        Self { status: if is_below { FoundStatus::BelowU95 } else { self.status }, ..self }
    }
}

/// The parameters as found.
pub type FoundParameters = Parameters<Found>;

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

/// Correlation of the fitted parameters.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Correlation {
    /// Names, in the order of rows and columns.
    pub names: Vec<&'static str>,
    /// Rows.
    pub matrix: Vec<Vec<f64>>,
}

/// Whether the residual is white, by the Ljung-Box test.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Whiteness {
    /// Number of lags tested.
    pub lags: usize,
    /// The test statistic, a sum of squared autocorrelations; for white noise about the number of lags.
    pub statistic: f64,
    /// Probability of a statistic at least this large for white noise.
    pub p: f64,
}

/// How well the fit predicts the part of the data that was not fitted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Validation {
    /// Fraction of each file that was fitted; 0 for a file that was not.
    pub fitted: f64,
    /// RMS force that the model does not explain there \[N\].
    pub residual_rms_n: f64,
    /// Fraction of the force's mean square that it explains.
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

/// Parameters of a segment, for equal friction in both directions and by direction.
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
    /// For equal friction in both directions.
    pub residual_rms_n: f64,
    /// By direction.
    pub residual_by_direction_rms_n: f64,
}

/// What the data identify about the device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Identified {
    /// What was fitted.
    pub model: Model,
    /// The parameters.
    pub parameters: FoundParameters,
    /// Starting point of the complete fit: from the estimator and the settings, with the stiffness from a scan if
    /// neither knows it. `None` for the linear model, whose fit needs none.
    pub start: Option<Parameters>,
    /// Offsets of all files \[N\].
    pub offsets_n: Vec<Option<f64>>,
    /// Correlation of the parameters' errors.
    pub correlation: Option<Correlation>,
    /// RMS force that the model does not explain \[N\].
    pub residual_rms_n: f64,
    /// The same for the encoder's displacement \[m\].
    pub residual_rms_m: Option<f64>,
    /// RMS ratio of the residual to what the sensors' noise explains; 1 if the model is right.
    pub residual_over_noise: Option<f64>,
    /// Whiteness of the force's residual.
    pub whiteness: Option<Whiteness>,
    /// The result for data that were not fitted.
    pub validation: Option<Validation>,
    /// Linear fits by file and segment.
    pub segments: Vec<Vec<SegmentFit>>,
    /// Notes for a person.
    pub notes: Vec<String>,
}

impl Identified {
    /// The best values, for [`super::predicted`]; parameters that are not identifiable are 0.
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
