//! What an estimator says, wherever it runs, and where on the sample counter it said it.

use inerter_core::{Change, Detail, Estimate, Reversal};

/// What an estimator says: the one in a device, or the one that replays a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EstimatorEvent {
    /// A reversal of the flanks was accepted.
    Reversal(Reversal),
    /// The device measured has changed.
    Changed(Change),
    /// An estimate, with what goes with it; a device with an older firmware sends it alone.
    Estimate(Estimate, Option<Detail>),
}

impl EstimatorEvent {
    /// Index of the sample that it speaks of: of a reversal the middle of the flight, which came before.
    pub fn index(&self) -> u32 {
        match self {
            Self::Reversal(reversal) => reversal.index,
            Self::Changed(change) => change.index,
            Self::Estimate(estimate, _) => estimate.index,
        }
    }
}

/// Sample periods between two values of the sample counter; one where the counter went back, because the device
/// started anew and nothing says how long that took.
pub fn step(from: u32, to: u32) -> u64 {
    let step = to.wrapping_sub(from);
    if step < 1 << 31 { u64::from(step) } else { 1 }
}
