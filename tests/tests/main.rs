//! The estimator and the analysis, compared with a plant, real machines, references and the image in QEMU.

mod backlash;
mod changes;
mod defects;
mod diagnose;
mod documents;
mod flanks;
mod fuzz;
mod gates;
mod grid;
mod identify;
mod plan;
mod qemu;
mod recordings;
mod reversals;
mod scales;
mod skew;
mod steps;
mod sums;
