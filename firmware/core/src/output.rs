//! The result of one sample.

use crate::detail::{Change, Detail, Law, Reversal, Warning};
use crate::estimate::Estimate;

/// The result of [`Active::step`](crate::Active::step); empty for most samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Output {
    /// The estimate with its detail, at the publish rate.
    pub published: Option<Published>,
    /// A reversal of the flanks that this sample has completed and that agrees with those before it.
    pub reversal: Option<Reversal>,
    /// A warning about samples that no device can cause.
    pub warning: Option<Warning>,
    /// A change of the device. Estimate and sums are still those of before; both memories restart with the next update.
    pub change: Option<Change>,
}

impl Output {
    /// The estimate alone, where one is due.
    pub fn estimate(&self) -> Option<Estimate> {
        self.published.map(|published| published.estimate)
    }
}

/// An estimate with what goes with it, all of the same sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Published {
    /// The parameters.
    pub estimate: Estimate,
    /// Band, backlash, contact, friction and changes.
    pub detail: Detail,
    /// Whether the law holds.
    pub law: Law,
}
