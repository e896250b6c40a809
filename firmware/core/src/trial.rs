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
