//! What the last estimate feeds back to the signal path: integers, set once per publication.

use crate::qformat::Term;

/// What the estimate gives back to the signal path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Feedback {
    /// Kink of the sign's velocity at a reversal [2^-VELOCITY_BITS per cube of the kernel's half width].
    pub kink: Term,
    /// The sign's velocity per sum of the force [2^-VELOCITY_BITS per code].
    pub velocity_per_force: Term,
    /// Offset of the force [codes].
    pub offset_code: i32,
    /// Force [codes] under which a reversal is weak.
    pub weak_force_code: u32,
    /// Viscous friction [force codes per position code and sample].
    pub viscous: Term,
    /// Whether friction is known well enough to relocate a reversal with it.
    pub friction_known: bool,
    /// Whether the jump that friction would cause in the force is clear of the force's noise.
    pub jumps_are_clear: bool,
    /// Whether the reversals so far look like Coulomb friction.
    pub coulomb_like: bool,
}

impl Feedback {
    pub(crate) const NONE: Self = Self {
        kink: Term { coefficient: 0, shift: 0 },
        velocity_per_force: Term { coefficient: 0, shift: 0 },
        offset_code: 0,
        weak_force_code: 0,
        viscous: Term { coefficient: 0, shift: 0 },
        friction_known: false,
        jumps_are_clear: false,
        coulomb_like: false,
    };

    /// Kink of the sign's velocity at a reversal, through boxes of `m` samples [2^-VELOCITY_BITS codes per sample,
    /// times m^2].
    #[inline]
    pub fn kink(&self, m: u8) -> i64 {
        self.kink.of(i64::from(m) * i64::from(m) * i64::from(m))
    }
}
