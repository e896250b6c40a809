//! Shared code of the system tests: closed loop, replay of real data, QEMU, command line.

pub mod backlash;
pub mod bound;
pub mod coverage;
pub mod data;
pub mod defects;
pub mod diagnose;
pub mod fuzz;
pub mod grid;
pub mod identified;
pub mod identify;
#[path = "../../firmware/core/tests/closed_loop/linear.rs"]
pub mod linear;
pub mod nearly;
pub mod plan;
pub mod qemu;
#[path = "../../firmware/core/tests/closed_loop/reference.rs"]
pub mod reference;
pub mod roc;
pub mod sheet;
pub mod skew;
pub mod sums;
pub mod updates;
