//! Realistic defects of device, rig and sampling, each over several motions and seeds: what is silently wrong.
//!
//! Devices, motions, rigs and sizes are drawn; half of the runs come from a second plant. No constant of the estimator
//! was set on them. Seeds up to [`DEVELOPMENT`] were looked at while defects and judge were written; only those beyond
//! count.

pub mod draw;
pub mod instruments;
pub mod judge;
pub mod kinds;
pub mod made;
pub mod plant;
pub mod scene;
pub mod tally;

/// The last seed that was looked at during development.
pub const DEVELOPMENT: u64 = 100;
