//! Compared runs, and their differences.

use inerter_data::limits::{Judged, NAMES};
use serde::Serialize;
use serde_json::{Value, json};

use super::{by_name::ByName, replayed::LimitsJson};
use crate::compare::{Compared, Difference, Rig, Row, Side, Verdict};

/// A comparison in JSON.
#[derive(Clone, Debug, Serialize)]
pub struct CompareJson {
    kind: &'static str,
    files: Vec<String>,
    /// For each run.
    rigs: Vec<Value>,
    /// For each name a list with one entry per run, in order.
    parameters: ByName<Vec<RunJson>>,
    /// The verdicts on limits for each run, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    limits: Option<Vec<LimitsJson>>,
}

impl CompareJson {
    /// From these runs; `within` has the verdicts of each on limits.
    pub fn new(sides: &[Side], rigs: &[Rig], rows: &[Row], within: Option<&[Vec<Judged>]>) -> Self {
        let of_row = |row: &Row| (NAMES[row.place], row.runs.iter().map(RunJson::from).collect());
        Self {
            kind: "compare",
            files: sides.iter().map(|side| side.name.clone()).collect(),
            rigs: rigs.iter().map(rig_json).collect(),
            parameters: ByName(rows.iter().map(of_row).collect()),
            limits: within.map(|all| all.iter().map(|judged| LimitsJson::new(judged)).collect()),
        }
    }
}

/// Whether a run shares the first one's rig.
fn rig_json(rig: &Rig) -> Value {
    let (rig, reason) = match rig {
        Rig::Same => ("same", None),
        Rig::Assumed => ("assumed", None),
        Rig::Other(reason) => ("other", Some(reason)),
    };
    json!({ "rig": rig, "reason": reason })
}

/// A parameter of a run in the comparison. JSON has null for a half width that is infinite.
#[derive(Clone, Debug, Serialize)]
struct RunJson {
    value: Option<f32>,
    u95: Option<f32>,
    same_rig_u95: Option<f32>,
    /// Why it proves nothing.
    reason: Option<&'static str>,
    /// Difference from the first run, which itself has none; null if one of the two does not identify it.
    #[serde(skip_serializing_if = "Option::is_none")]
    difference: Option<Option<Difference>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    verdict: Option<Verdict>,
}

impl From<&Compared> for RunJson {
    fn from(compared: &Compared) -> Self {
        let budget = compared.found.map(|found| found.budget);
        Self {
            value: compared.found.map(|found| found.value),
            u95: budget.map(|budget| budget.u95()),
            same_rig_u95: budget.map(|budget| budget.same_rig_u95()),
            reason: compared.doubt,
            difference: compared.verdict.map(|_| compared.difference),
            verdict: compared.verdict,
        }
    }
}
