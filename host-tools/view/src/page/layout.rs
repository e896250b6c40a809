//! Sizes of the panels of a figure, and what drawing one gives.

use crate::figure::Panel;

pub(crate) const TALL_PX: u32 = 280;
pub(crate) const LOW_PX: u32 = 190;

/// Caption and panels, or why there are none.
pub(super) type Made = Result<(String, Vec<Panel>), String>;
