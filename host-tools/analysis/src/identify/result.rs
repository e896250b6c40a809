//! Results of an identification, for programs and for people.

use inerter_data::json::ParameterJson;
use serde::Serialize;

use super::parameters::{Parameters, SHARED};

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

/// What was fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Model {
    /// All of the model: the terminal's displacement is known.
    Complete,
    /// Inertance, friction and offset: only encoder and force are known.
    #[default]
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
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
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
        let mut found = self.parameters.clone();
        let offset_n = found.offset_n.value.unwrap_or_default();
        let mut model = Parameters { offset_n, ..Parameters::default() };
        for name in SHARED {
            *name.slot(&mut model) = name.slot(&mut found).value.unwrap_or_default();
        }
        model
    }
}
