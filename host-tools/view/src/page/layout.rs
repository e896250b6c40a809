//! Sizes of a figure's panels, and the result of drawing one.

use crate::figure::Panel;

pub(crate) const TALL_PX: u32 = 280;
pub(crate) const LOW_PX: u32 = 190;

/// Caption and panels, or the reason why there are none.
pub(super) type Made = Result<(String, Vec<Panel>), String>;
