//! What is published with an estimate: the band it holds for, backlash and contact, the regime of friction, and
//! changes.

use crate::estimate::{Interval, Parameter};
use crate::math::greater;

/// Published beside each [`Estimate`](crate::Estimate), of the same sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Detail {
    /// Index of the sample at which it was computed.
    pub index: u32,
    /// Frequencies at which the recent inertance was seen: real inerters soften with frequency.
    pub band: Band,
    /// Total backlash `eps` \[m\].
    pub backlash: Backlash,
    /// How the flanks behave.
    pub contact: Contact,
    /// Contact stiffness `ks` by the terminal's own displacement \[N/m\].
    pub stiffness_n_per_m: Parameter,
    /// Contact damping `cs` by the terminal's own displacement \[N s/m\].
    pub contact_damping_n_s_per_m: Parameter,
    /// How friction behaves.
    pub friction: Friction,
    /// Changes of the device found since the reset.
    pub changes: u32,
}

/// Frequencies between which an inertance was seen, weighted by the square of the acceleration: the harmonic and the
/// quadratic mean, which enclose the centre and coincide for a single tone. Both are 0 if nothing moved.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Band {
    /// Lower edge \[Hz\].
    pub low_hz: f32,
    /// Upper edge \[Hz\].
    pub high_hz: f32,
}

/// Total backlash with its 95 % interval, where there is one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Backlash {
    /// Value and interval \[m\], or the reason there is none.
    pub size: BacklashSize,
    /// Where it comes from.
    pub route: Route,
    /// Reversals that it is based on.
    pub reversals: u32,
}

/// The size of the backlash.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BacklashSize {
    /// There is no value.
    NotIdentifiable(Reason),
    /// Value and interval are valid \[m\], and the backlash is smaller than the interval: there may be none.
    BelowU95(Interval),
    /// Value and interval are valid \[m\].
    Ok(Interval),
}

impl Default for BacklashSize {
    fn default() -> Self {
        Self::NotIdentifiable(Reason::TooFewReversals)
    }
}

/// Whether a backlash can be used. New ones go at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BacklashStatus {
    /// There is no value.
    NotIdentifiable(Reason),
    /// Value and interval are valid, and the backlash is smaller than the interval: there may be none.
    BelowU95,
    /// Value and interval are valid.
    Ok,
}

impl Backlash {
    /// Value and interval \[m\]; `None` if not identifiable.
    pub const fn known(&self) -> Option<Interval> {
        match self.size {
            BacklashSize::NotIdentifiable(_) => None,
            BacklashSize::BelowU95(interval) | BacklashSize::Ok(interval) => Some(interval),
        }
    }

    /// Which of the three it is.
    pub const fn status(&self) -> BacklashStatus {
        match self.size {
            BacklashSize::NotIdentifiable(reason) => BacklashStatus::NotIdentifiable(reason),
            BacklashSize::BelowU95(_) => BacklashStatus::BelowU95,
            BacklashSize::Ok(_) => BacklashStatus::Ok,
        }
    }
}

/// Why there is no value of the backlash. New ones go at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Reason {
    /// The force keeps its sign: one flank carries it all.
    ForceNeverReverses,
    /// Too few reversals to estimate their scatter.
    TooFewReversals,
    /// The flanks touch for too short a time compared with their reversals.
    FlankTooShort,
    /// The contact stiffness is not known, and the force alone needs it.
    StiffnessUnknown,
    /// The reversals contradict each other by more than their noise.
    Scattered,
}

/// Where a backlash comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Route {
    /// Force and encoder alone.
    #[default]
    Force,
    /// The terminal's own displacement sensor.
    Terminal,
}

/// How the flanks behave. New ones go at the end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Contact {
    /// Not enough seen.
    #[default]
    Unknown,
    /// The load stays on one flank.
    OneSided,
    /// The force reverses without any sign of backlash: tight or preloaded.
    Closed,
    /// The flanks part and meet once at each reversal.
    Backlash,
    /// The flanks bounce: several flights at a reversal. Such reversals do not count.
    Bouncing,
}

impl Contact {
    /// Whether the flanks may part, as far as is known.
    pub const fn may_part(self) -> bool {
        !matches!(self, Self::Closed | Self::OneSided)
    }

    /// Greatest gap that the flanks cross \[m\]: 0 where they do not part, infinite where it is unknown.
    pub fn gap_m(self, backlash: &Backlash) -> f32 {
        match backlash.size {
            _ if !self.may_part() => 0.0,
            BacklashSize::NotIdentifiable(_) => f32::INFINITY,
            BacklashSize::Ok(Interval { value, u95 }) | BacklashSize::BelowU95(Interval { value, u95 }) => {
                greater(value + u95, 0.0)
            }
        }
    }
}

/// How friction behaves at a reversal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Friction {
    /// How much of the kink that Coulomb friction would cause in the velocity the reversals have shown: 1 is all of it.
    pub reversal_ratio: Option<f32>,
    /// The regime that this indicates.
    pub regime: Regime,
}

/// Regimes of friction. New ones go at the end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Regime {
    /// Not enough seen.
    #[default]
    Unknown,
    /// Coulomb and viscous friction, within the interval.
    Coulomb,
    /// Friction reverses over a distance: the screw creeps before it slips.
    Presliding,
    /// Greater near rest than in motion.
    Stribeck,
}

/// Whether the law `F = mt a + cf v + fc sgn(v) + F0` holds in what the recent memory has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Law {
    /// Sample that it belongs to.
    pub index: u32,
    /// Whether it holds.
    pub status: LawStatus,
    /// What it is judged by; `None` before there is a fit and the force's noise is known.
    pub misfit: Option<Misfit>,
}

/// The residual compared with what the force's noise and the encoder's steps explain.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Misfit {
    /// Rms of the residual over what noise and steps explain: 1 if the residual contains nothing else.
    pub ratio: f32,
    /// The ratio stays below this where the law holds.
    pub limit: f32,
}

/// Whether the law holds. New ones go at the end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LawStatus {
    /// Not enough seen; or the residual is larger than explained, but under a tenth of the force, and the flanks may
    /// part: their impacts are shorter than the samples resolve.
    #[default]
    Unknown,
    /// Noise and steps explain the residual.
    Holds,
    /// They do not, and the flanks are closed, or the residual exceeds a tenth of the force, which impacts do not
    /// leave.
    Broken,
}

/// One accepted reversal of the flanks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Reversal {
    /// Sample in the middle of the flight.
    pub index: u32,
    /// Total backlash by this reversal alone \[m\].
    pub value_m: f32,
    /// Its standard error \[m\]: by the noise of its own flanks, and with the sensor also by encoder steps and the
    /// contact's law.
    pub error_m: f32,
    /// Where it comes from.
    pub route: Route,
    /// Whether it goes from the negative to the positive flank.
    pub rising: bool,
}

/// A change of the device itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Change {
    /// Sample at which it was found.
    pub index: u32,
    /// What changed most, relative to the limit for a change.
    pub parameter: Changed,
    /// Value before, SI.
    pub before: f32,
    /// Value since, SI.
    pub after: f32,
}

/// Which parameter changed. New ones go at the end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Changed {
    /// Effective inertance \[kg\].
    #[default]
    Inertance,
    /// Viscous friction \[N s/m\].
    Viscous,
    /// Coulomb friction \[N\].
    Coulomb,
    /// Force offset \[N\].
    Offset,
}

/// Something in the samples that no device can cause; the samples that show it are left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Warning {
    /// Sample at which it was found.
    pub index: u32,
    /// What is wrong.
    pub kind: WarningKind,
}

/// What may be wrong with the samples. New ones go at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum WarningKind {
    /// The inertance is negative beyond its interval: force or position has the wrong sign, or there is no inertia.
    WrongSign,
    /// The position jumped by more than any force could move it: the encoder lost counts.
    CountSlip,
    /// The force's codes pile up at an extreme below the rails: something before the converter clips it.
    ClippedForce,
    /// The force stood still while the screw went to and fro: a broken cable, a dead channel.
    DeadForce,
}
