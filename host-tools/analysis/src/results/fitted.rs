//! The fit to one run or to several together, as JSON.

use inerter_core::Machine;
use inerter_data::{
    json::{ParameterJson, ParametersJson},
    names::parameter,
    words::code,
};
use serde::Serialize;

use super::by_name::ByName;
use crate::merge::Merged;

/// A fit in JSON.
#[derive(Clone, Debug, Serialize)]
pub struct FitJson {
    kind: &'static str,
    /// Of one run.
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<String>,
    /// Of several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    files: Vec<String>,
    bank: String,
    updates: u64,
    symmetric: ParametersJson,
    symmetric_residual_rms_n: f64,
    by_direction: DirectionsJson,
    residual_rms_n: f64,
    /// By how much the runs differ beyond their scatter, and for which parameters that is more than chance.
    #[serde(skip_serializing_if = "Option::is_none")]
    apart: Option<ByName<Option<f32>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    differs: Option<Vec<&'static str>>,
    /// Runs for which the law does not hold.
    law_broken: Vec<String>,
    /// Runs with too little motion to be summed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    nothing_summed: Vec<String>,
}

#[derive(Clone, Debug, Serialize)]
struct DirectionsJson {
    inertance_kg: ParameterJson,
    viscous_positive_n_s_per_m: ParameterJson,
    viscous_negative_n_s_per_m: ParameterJson,
    coulomb_n: ParameterJson,
    coulomb_positive_n: Option<ParameterJson>,
    coulomb_negative_n: Option<ParameterJson>,
    offset_n: Option<f64>,
    difference_and_twice_offset_n: ParameterJson,
}

impl FitJson {
    /// From a fit with this offset, if known.
    pub fn new(merged: &Merged, offset_n: Option<f64>) -> Self {
        let Merged { fit, bank, updates, names, apart, differs, broken, empty } = merged;
        let [viscous_positive, viscous_negative] = fit.viscous_n_s_per_m;
        let coulomb = fit.coulomb_by_direction_n;
        let name = |i: usize| parameter(Machine::Linear, i).path;
        let differing = differs.iter().enumerate().filter(|(_, differs)| **differs).map(|(i, _)| name(i)).collect();
        let are_several = names.len() > 1;
        let (file, files) = match names.as_slice() {
            [one] => (Some(one.clone()), Vec::new()),
            _ => (None, names.clone()),
        };
        Self {
            kind: "fit",
            file,
            files,
            bank: code(bank),
            updates: *updates,
            symmetric: (&fit.symmetric).into(),
            symmetric_residual_rms_n: fit.symmetric_residual_rms_n,
            by_direction: DirectionsJson {
                inertance_kg: fit.inertance_kg.into(),
                viscous_positive_n_s_per_m: viscous_positive.into(),
                viscous_negative_n_s_per_m: viscous_negative.into(),
                coulomb_n: fit.coulomb_n.into(),
                coulomb_positive_n: coulomb.map(|[positive, _]| positive.into()),
                coulomb_negative_n: coulomb.map(|[_, negative]| negative.into()),
                offset_n,
                difference_and_twice_offset_n: ParameterJson::offset(fit.difference_n),
            },
            residual_rms_n: fit.residual_rms_n,
            apart: are_several.then(|| ByName((0..4).map(|i| (name(i), apart[i])).collect())),
            differs: are_several.then_some(differing),
            law_broken: broken.clone(),
            nothing_summed: empty.clone(),
        }
    }
}
