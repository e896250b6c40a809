//! Whether the memories restart, once, because the law seems broken by what was seen before friction was known.
//!
//! Floats are allowed here: only whether to forget is fed back to the signal path.

use crate::detail::{Contact, Regime};
use crate::output::Published;

/// Updates after which the law is judged, and the memories may restart: 1.6 s in the fast bank. A steady tone of 15.9
/// Hz hides friction from 1.2 s on.
const JUDGED_UPDATES: u32 = 200;
/// Updates until which the judgement waits to learn whether flanks part: later there is too much to forget.
const WAITED_UPDATES: u32 = 800;
/// Growth of the unexplained residual, summed, from which on the law is broken: what the beginning alone has left does
/// not grow.
const GROWS: f32 = 1.5;

/// Whether the law is judged with data from before friction was known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Trial {
    /// With that data; not judged yet.
    Ahead,
    /// That data is forgotten, as the law seemed broken, and there is too little else yet.
    Open,
    /// The law seemed broken, by this excess in all. The motion shows friction only at its beginning, or it is unknown
    /// whether flanks part.
    Hidden { excess: f32 },
    /// The trial is over.
    Over,
}

impl Trial {
    /// Continues with what is published; returns true if the memories must restart.
    ///
    /// Until friction is known, a reversal may be misplaced. If the first judgement is that the law is broken, that may
    /// be why, and the memories restart. They cannot where the motion hides friction, as only its beginning shows
    /// friction: the law is then unknown while the residual may come from the beginning alone. The same applies for a
    /// while where it is unknown whether flanks part, because that breaks the law as well.
    #[inline]
    pub(crate) fn judge(&mut self, Published { estimate, detail, law }: &Published) -> bool {
        let Some(misfit) = law.misfit else { return false };
        let excess = (misfit.ratio * misfit.ratio - 1.0) * estimate.updates as f32;
        let lawful = misfit.ratio <= misfit.limit || estimate.recent.are_backwards();
        let may_wait = detail.contact == Contact::Unknown && estimate.updates < WAITED_UPDATES;
        let parts = detail.contact.may_part() && !may_wait;
        let is_known = !may_wait && detail.friction.regime != Regime::Unknown;
        let next = match *self {
            Trial::Ahead if estimate.updates < JUDGED_UPDATES => Trial::Ahead,
            Trial::Open | Trial::Over => Trial::Over,
            Trial::Ahead | Trial::Hidden { .. } if lawful || parts => Trial::Over,
            Trial::Hidden { excess: before } if excess >= GROWS * before => Trial::Over,
            Trial::Ahead | Trial::Hidden { .. } if is_known => Trial::Open,
            Trial::Ahead => Trial::Hidden { excess },
            Trial::Hidden { .. } => *self,
        };
        let begins_anew = next == Trial::Open;
        *self = next;
        begins_anew
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detail::{Detail, Friction, Law, Misfit};
    use crate::estimate::{Estimate, Interval, Parameter, Parameters};

    /// What is published after so many updates, with so many times the residual that is explained: up to 1.5 times are
    /// lawful.
    fn published(updates: u32, ratio: f32, contact: Contact, regime: Regime) -> Published {
        Published {
            estimate: Estimate { updates, ..Estimate::default() },
            detail: Detail { contact, friction: Friction { regime, ..Friction::default() }, ..Detail::default() },
            law: Law { misfit: Some(Misfit { ratio, limit: 1.5 }), ..Law::default() },
        }
    }

    #[test]
    fn the_memories_restart_once_where_the_law_seems_broken_and_nothing_else_explains_it() {
        use Contact::{Backlash, Closed, OneSided, Unknown};
        use Regime::{Coulomb, Unknown as Unseen};
        // Three times the residual has eight times the variance that is explained beside it.
        let hidden = Trial::Hidden { excess: 8.0 * 200.0 };
        for (before, of, after) in [
            // Judged after 200 updates, and not before.
            (Trial::Ahead, (199, 3.0, Closed, Coulomb), Trial::Ahead),
            (Trial::Ahead, (200, 3.0, Closed, Coulomb), Trial::Open),
            (Trial::Ahead, (200, 3.0, OneSided, Coulomb), Trial::Open),
            // Lawful, or explained by flanks that part.
            (Trial::Ahead, (200, 1.5, Closed, Coulomb), Trial::Over),
            (Trial::Ahead, (200, 3.0, Backlash, Coulomb), Trial::Over),
            // Unknown friction, and for a while unknown flanks, leave it open.
            (Trial::Ahead, (200, 3.0, Closed, Unseen), hidden),
            (Trial::Ahead, (200, 3.0, Unknown, Coulomb), hidden),
            (hidden, (799, 1.7, Unknown, Coulomb), hidden),
            (hidden, (800, 1.7, Unknown, Coulomb), Trial::Over),
            (hidden, (800, 1.7, Closed, Unseen), hidden),
            (hidden, (800, 1.7, Closed, Coulomb), Trial::Open),
            (hidden, (800, 1.5, Closed, Coulomb), Trial::Over),
            // What grows to 1.5 times 1600 does not come from the beginning: 3 times 800 is there, 3 times 799 is not.
            (hidden, (800, 2.0, Closed, Coulomb), Trial::Over),
            (hidden, (799, 2.0, Closed, Coulomb), Trial::Open),
            // Only once.
            (Trial::Open, (1, 3.0, Closed, Coulomb), Trial::Over),
            (Trial::Over, (200, 3.0, Closed, Coulomb), Trial::Over),
        ] {
            let (updates, ratio, contact, regime) = of;
            let mut trial = before;
            let restarts = trial.judge(&published(updates, ratio, contact, regime));
            assert_eq!((trial, restarts), (after, after == Trial::Open), "{before:?} by {of:?}");
        }
    }

    #[test]
    fn a_law_that_is_not_judged_or_backwards_restarts_nothing() {
        for before in [Trial::Ahead, Trial::Hidden { excess: 1.0 }, Trial::Open] {
            let mut trial = before;
            let silent = Published { law: Law::default(), ..published(900, 3.0, Contact::Closed, Regime::Coulomb) };
            assert!(!trial.judge(&silent));
            assert_eq!(trial, before);
        }
        let mut backwards = published(900, 3.0, Contact::Closed, Regime::Coulomb);
        let inertance_kg = Parameter::Ok(Interval { value: -300.0, u95: 1.0 });
        backwards.estimate.recent = Parameters { inertance_kg, ..Parameters::default() };
        let mut trial = Trial::Ahead;
        assert!(!trial.judge(&backwards));
        assert_eq!(trial, Trial::Over);
    }
}
