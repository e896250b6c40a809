//! The parameters that a run identifies, for comparison with limits or with another run.

use inerter_core::Budget;
use inerter_data::{
    limits::{self, Doubts, Limits, Measured, NAMES},
    replay::Outcome,
};

use crate::{
    diagnose::{Judged, is_suspect},
    fit::each,
};

/// A parameter from a whole run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantity {
    /// Its value.
    pub value: f32,
    /// The sources of its interval.
    pub budget: Budget,
}

/// The parameters of [`NAMES`] that a run identifies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Told {
    /// Each parameter, if the motion identifies it.
    pub found: [Option<Quantity>; NAMES.len()],
    /// Why they prove nothing, if there is a reason.
    pub doubts: Doubts,
}

impl Told {
    /// From the outcome of a run; `are_wrong` means that samples were faulty.
    pub fn new(outcome: &Outcome, judged: &[Judged; 4], are_wrong: bool) -> Self {
        let Outcome { estimate, detail, budgets, law, .. } = outcome;
        let contact = budgets.contact;
        let of_contact = [
            (detail.backlash.known().map(|known| known.value), contact.backlash_m),
            (detail.stiffness_n_per_m.value(), contact.stiffness_n_per_m),
            (detail.contact_damping_n_s_per_m.value(), contact.damping_n_s_per_m),
        ];
        let of_law = each(&estimate.whole_run).into_iter().zip(judged);
        let of_law = of_law.map(|(found, judged)| (found.value(), Some(judged.budget)));
        let mut all = of_law.chain(of_contact).map(|(value, budget)| Some(Quantity { value: value?, budget: budget? }));
        Self {
            found: std::array::from_fn(|_| all.next().flatten()),
            doubts: Doubts::new(detail.changes > 0, are_wrong, law.status, is_suspect(law)),
        }
    }

    /// The verdicts of the run on limits.
    pub fn within(&self, limits: &Limits) -> Vec<limits::Judged> {
        limits.judge(|place| Measured {
            found: self.found[place].map(|Quantity { value, budget }| (value, budget.u95())),
            doubt: self.doubts.of(place),
        })
    }
}
