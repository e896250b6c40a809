//! The sources of a run's intervals, for programs and for people.

use inerter_core::{Budget, ContactBudgets, Source};
use serde::Serialize;

use crate::json::finite;

/// One component of an interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PartJson {
    /// Its source.
    pub source: &'static str,
    /// Half width in the parameter's unit: the squares of all components add up to the square of the total.
    pub u95: f32,
}

/// The uncertainty of one parameter; numbers that are not finite are `null`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BudgetJson {
    /// Half width of the 95 % interval.
    pub u95: Option<f32>,
    /// The same for comparing runs on one rig: without force gain, lead and clock.
    pub same_rig_u95: Option<f32>,
    /// Standard uncertainty from the scatter of the run (type A).
    pub u_a: Option<f32>,
    /// Degrees of freedom of the scatter.
    pub scatter_degrees_of_freedom: f32,
    /// Effective degrees of freedom of the total, after Welch and Satterthwaite.
    pub degrees_of_freedom: Option<f32>,
    /// Its components, without those that are zero.
    pub budget: Vec<PartJson>,
    /// The cause that moves the parameter most according to the samples, whether identified or too small for that.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moved_by: Option<&'static str>,
    /// Causes that this motion cannot separate from the parameter: its value is right only in their absence.
    pub assumes: Vec<&'static str>,
}

impl BudgetJson {
    /// From a budget, the cause that may have moved the parameter, and the causes that the motion cannot separate from
    /// it.
    pub fn new(budget: &Budget, moved_by: Option<&'static str>, assumes: Vec<&'static str>) -> Self {
        Self {
            u95: finite(budget.u95()),
            same_rig_u95: finite(budget.same_rig_u95()),
            u_a: finite(budget.standard_error()),
            scatter_degrees_of_freedom: budget.scatter_freedom(),
            degrees_of_freedom: finite(budget.freedom()),
            budget: parts(budget).map(|(source, u95)| PartJson { source: source_word(source), u95 }).collect(),
            moved_by,
            assumes,
        }
    }
}

/// The uncertainty of the parameters over a whole run.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented where they are estimated")]
pub struct UncertaintyJson {
    pub inertance_kg: BudgetJson,
    pub viscous_n_s_per_m: BudgetJson,
    pub coulomb_n: BudgetJson,
    pub offset_n: BudgetJson,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backlash_m: Option<BudgetJson>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness_n_per_m: Option<BudgetJson>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact_damping_n_s_per_m: Option<BudgetJson>,
    /// Correlation of the errors of the first four, in this order: 1 if two vary together; `null` if the motion does
    /// not identify it.
    pub correlation: Option<[[f64; 4]; 4]>,
}

impl UncertaintyJson {
    /// From these budgets, in the order of the parameters; those of the contact only if identified.
    pub fn new(
        [inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n]: [BudgetJson; 4],
        contact: &ContactBudgets,
        correlation: Option<[[f64; 4]; 4]>,
    ) -> Self {
        let told = |budget: &Option<Budget>| budget.map(|budget| BudgetJson::new(&budget, None, Vec::new()));
        Self {
            backlash_m: told(&contact.backlash_m),
            stiffness_n_per_m: told(&contact.stiffness_n_per_m),
            contact_damping_n_s_per_m: told(&contact.damping_n_s_per_m),
            inertance_kg,
            viscous_n_s_per_m,
            coulomb_n,
            offset_n,
            correlation: correlation.filter(|all| all.iter().flatten().all(|part| part.is_finite())),
        }
    }
}

/// The components of an interval, without those that are zero.
pub fn parts(budget: &Budget) -> impl Iterator<Item = (Source, f32)> {
    budget.parts().into_iter().filter(|(_, u95)| u95.is_finite() && *u95 > 0.0)
}

/// `noise`, `encoder`, `skew`, `gain`, `lead`, `timebase`, `structure`, `stiffness` or `model`.
pub fn source_word(source: Source) -> &'static str {
    match source {
        Source::Noise => "noise",
        Source::Encoder => "encoder",
        Source::Skew => "skew",
        Source::Gain => "gain",
        Source::Lead => "lead",
        Source::Timebase => "timebase",
        Source::Structure => "structure",
        Source::Stiffness => "stiffness",
        Source::Model => "model",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_known_is_null_and_what_has_no_part_is_left_out() {
        let json = |budget: &Budget| serde_json::to_value(BudgetJson::new(budget, None, Vec::new())).unwrap();
        let unknown = json(&Budget::UNKNOWN);
        assert!(["u95", "same_rig_u95", "u_a"].iter().all(|key| unknown[key].is_null()), "{unknown}");
        assert_eq!(unknown["budget"].as_array().map(Vec::len), Some(0));
        let known = json(&Budget::of_scatter(1.0, 50.0).and(Source::Gain, 2.0));
        let sources: Vec<&str> =
            known["budget"].as_array().unwrap().iter().filter_map(|part| part["source"].as_str()).collect();
        assert_eq!(sources, ["noise", "gain"]);
        assert!(known["same_rig_u95"].as_f64() < known["u95"].as_f64());
    }
}
