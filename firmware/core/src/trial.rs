//! Whether the memories begin anew, once, because the law seems broken by what was seen before friction was known.
//!
//! Floats are allowed here: what flows back to the signal path is whether to forget.

use crate::detail::{Contact, Regime};
use crate::output::Published;

/// Updates after which the law is judged to begin anew or not: 1.6 s in the fast bank. A steady tone of 15.9 Hz hides
/// friction from 1.2 s on.
const JUDGED_UPDATES: u32 = 200;
/// The same until which that waits for whether flanks part: later there is too much to be forgotten.
const WAITED_UPDATES: u32 = 800;
/// Growth of a residual's sum beyond which it goes on: what the beginning alone has left stays as it is.
const GROWS: f32 = 1.5;

/// Whether the law is judged by what was seen before friction was known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Trial {
    /// By that too.
    Ahead,
    /// That is forgotten, as the law seemed broken, and there is too little else yet.
    Open,
    /// The law seemed broken, by so much in all, and the motion hides friction but in its beginning, or whether flanks part.
    Hidden { excess: f32 },
    /// It is over.
    Over,
}

impl Trial {
    /// Goes on with what is published; true where the memories are to begin anew.
    ///
    /// Until friction is known a reversal may have been placed where it was not. Where the first judgement is that the law
    /// is broken, that may be why, and the memories begin anew. Where the motion hides friction they cannot, as its beginning is
    /// all that tells of it: then nothing is known of the law while the residual may be of the beginning alone. So it is
    /// for a while where it is not known whether flanks part, which break the law as well.
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
