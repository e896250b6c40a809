//! Realistic defects of device, rig and sampling, each over several motions and seeds: what is wrong without a word.
//!
//! Devices, motions, rigs and sizes are drawn; half of the runs come from a second plant. None of it has set a constant of the
//! estimator. Seeds up to [`DEVELOPMENT`] have been looked at while defects and judge were written, those beyond are counted.

pub mod draw;
pub mod instruments;
pub mod judge;
pub mod kinds;
pub mod made;
pub mod plant;
pub mod scene;
pub mod tally;

/// The last seed that was looked at while they were written.
pub const DEVELOPMENT: u64 = 100;
