//! The estimator's results in SI units, or a status that says why there is none.

use crate::constants::{self, FAST_BOX_S, SLOW_BOX_S};
use crate::math::magnitude;

/// Whether a parameter's value can be used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Status {
    /// The motion so far cannot identify this parameter: there is no value.
    #[default]
    NotIdentifiable,
    /// Nothing moves: the value is the last one from motion.
    Held,
    /// Value and interval hold.
    Ok,
}

/// A value with its 95 % interval, in the unit of the field that holds it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Interval {
    /// Value.
    pub value: f32,
    /// Half width of the 95 % interval.
    pub u95: f32,
}

/// What is known of a parameter that the motion cannot identify: see [`Parameter::fitted`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Unresolved(Option<Interval>);

impl Unresolved {
    /// Nothing is known.
    pub const NOTHING: Self = Self(None);
}

/// One parameter with its 95 % interval, where there is one.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Parameter {
    /// The motion so far cannot identify this parameter: there is no value.
    NotIdentifiable(Unresolved),
    /// Nothing moves: the value is the last one from motion.
    Held(Interval),
    /// Value and interval hold.
    Ok(Interval),
}

impl Default for Parameter {
    fn default() -> Self {
        Self::NotIdentifiable(Unresolved::NOTHING)
    }
}

impl Parameter {
    /// The result of the least squares, with this status. An infinite interval means that nothing is known, whatever
    /// the status.
    pub const fn new(interval: Interval, status: Status) -> Self {
        match status {
            _ if !(interval.value.is_finite() && interval.u95.is_finite()) => {
                Self::NotIdentifiable(Unresolved::NOTHING)
            }
            Status::NotIdentifiable => Self::NotIdentifiable(Unresolved(Some(interval))),
            Status::Held => Self::Held(interval),
            Status::Ok => Self::Ok(interval),
        }
    }

    /// The result of the least squares, whatever the status; 0 with an infinite half width if there is none. With the
    /// other parameters of the same fit it is the law that fits best. For a parameter that is not identifiable, it is
    /// not a value by itself.
    pub const fn fitted(&self) -> Interval {
        match *self {
            Self::NotIdentifiable(Unresolved(None)) => Interval { value: 0.0, u95: f32::INFINITY },
            Self::NotIdentifiable(Unresolved(Some(interval))) | Self::Held(interval) | Self::Ok(interval) => interval,
        }
    }

    /// Value and interval, of now or of the last motion; `None` if not identifiable.
    pub const fn known(&self) -> Option<Interval> {
        match *self {
            Self::NotIdentifiable(_) => None,
            Self::Held(interval) | Self::Ok(interval) => Some(interval),
        }
    }

    /// Value and interval while the device moves; `None` if held or not identifiable.
    pub const fn ok(&self) -> Option<Interval> {
        match *self {
            Self::NotIdentifiable(_) | Self::Held(_) => None,
            Self::Ok(interval) => Some(interval),
        }
    }

    /// Value and interval if the half width is less than half of the value: accurate enough for further use.
    pub fn usable(&self) -> Option<Interval> {
        self.known().filter(|Interval { value, u95 }| *u95 < constants::WIDEST_INTERVAL as f32 * magnitude(*value))
    }

    /// Value, of now or of the last motion; `None` if not identifiable.
    pub fn value(&self) -> Option<f32> {
        self.known().map(|known| known.value)
    }

    /// Half width of the 95 % interval. If the parameter is not identifiable, it is more than its value allows, or
    /// infinite, as before the first fit.
    pub const fn u95(&self) -> f32 {
        self.fitted().u95
    }

    /// Which of the three it is.
    pub const fn status(&self) -> Status {
        match self {
            Self::NotIdentifiable(_) => Status::NotIdentifiable,
            Self::Held(_) => Status::Held,
            Self::Ok(_) => Status::Ok,
        }
    }
}

/// The four parameters of `F = mt a + cf v + fc sgn(v) + F0`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Parameters {
    /// Effective inertance `mt` \[kg\].
    pub inertance_kg: Parameter,
    /// Viscous friction `cf` \[N s/m\].
    pub viscous_n_s_per_m: Parameter,
    /// Coulomb friction `fc` \[N\].
    pub coulomb_n: Parameter,
    /// Force offset `F0` \[N\].
    pub offset_n: Parameter,
}

/// Which kernel bank the estimate comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Bank {
    /// Box of about 16 ms: motion above about 0.5 Hz.
    #[default]
    Fast,
    /// Box of about 64 ms: slow motion, where the encoder's steps drown the acceleration in the fast bank.
    Slow,
}

impl Bank {
    /// Length of its box \[s\]; the kernel consists of four.
    pub const fn box_s(self) -> f64 {
        match self {
            Self::Fast => FAST_BOX_S,
            Self::Slow => SLOW_BOX_S,
        }
    }
}

/// A published estimate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Estimate {
    /// Index of the sample at which it was computed.
    pub index: u32,
    /// Samples since the estimator was reset, lost ones included.
    pub elapsed_samples: u64,
    /// Bank that it comes from.
    pub bank: Bank,
    /// False while nothing moves.
    pub moving: bool,
    /// With the memory of `memory_s`.
    pub recent: Parameters,
    /// From all motion since the reset, nothing forgotten; never `Held`, because it describes the whole run.
    pub whole_run: Parameters,
    /// Rms of the residual in the recent memory \[N\].
    pub residual_rms_n: f32,
    /// Updates that the published bank has taken since the reset.
    pub updates: u32,
}
