//! What the estimator says, in SI units, and when it declines to.

use serde::{Deserialize, Serialize};

/// Whether a parameter's value can be used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Status {
    /// The motion seen so far cannot show this parameter: there is no value.
    #[default]
    NotIdentifiable,
    /// Nothing moves: the value is the last one from motion.
    Held,
    /// Value and interval hold.
    Ok,
}

/// One parameter with its 95 % interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Value in SI; 0 and meaningless when [`Status::NotIdentifiable`].
    pub value: f32,
    /// Half width of the 95 % interval in the same unit; infinite when nothing is known.
    pub u95: f32,
    /// Whether the value holds.
    pub status: Status,
}

/// The four parameters of `F = mt a + cf v + fc sgn(v) + F0`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Bank {
    /// Box of about 16 ms: motion above about 0.5 Hz.
    #[default]
    Fast,
    /// Box of about 64 ms: slow motion, where the encoder's steps drown the acceleration in the fast bank.
    Slow,
}

/// A published estimate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Index of the sample at which it was computed.
    pub index: u32,
    /// Samples since the estimator was reset, gaps included.
    pub elapsed_samples: u64,
    /// Bank that it comes from.
    pub bank: Bank,
    /// False while nothing moves.
    pub moving: bool,
    /// With the memory of `memory_s`.
    pub recent: Parameters,
    /// From all motion since the reset, nothing forgotten; never `Held`, as it speaks of the run and not of now.
    pub whole_run: Parameters,
    /// Root mean square of what the model leaves unexplained in the recent memory \[N\].
    pub residual_rms_n: f32,
    /// Updates that the published bank has taken since the reset.
    pub updates: u32,
}
