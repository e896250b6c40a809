//! Realistic defects of device, rig and sampling, each over several motions and seeds, to find values that are silently
//! wrong.
//!
//! Devices, motions, rigs and sizes are random; half of the runs come from a second plant. No constant of the estimator
//! was tuned on them. Seeds up to [`DEVELOPMENT`] were inspected while the defects and the judge were written; only
//! later seeds count.

pub mod draw;
pub mod instruments;
pub mod judge;
pub mod kinds;
pub mod made;
pub mod plant;
pub mod scene;
pub mod tally;

/// The last seed inspected during development.
pub const DEVELOPMENT: u64 = 100;
