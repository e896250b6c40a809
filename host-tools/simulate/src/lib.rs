//! The simulated inerter as a file or as a live device.
//!
//! [`Described`] is a run as the user describes it; [`Setup`] is the resulting device, motion, instruments and
//! settings. [`mod@file`] writes a recording or a CSV, [`VirtualDevice`] runs the firmware's app on this machine behind
//! a pseudo-terminal or a TCP port, [`Qemu`] runs the firmware image itself. [`share`] lets several hosts use one link,
//! to a virtual device or to any other.

// The app's queues need critical sections; this crate provides the implementation for a machine with threads.
use critical_section as _;

mod clock;
mod described;
mod device;
mod error;
pub mod file;
pub mod operator;
mod port;
mod qemu;
mod setup;
pub mod share;

pub use described::{Described, Motion};
pub use device::{Endpoint, VirtualDevice};
pub use error::SimulateError;
pub use operator::{Operator, Samples};
pub use qemu::{END_OF_SAMPLES, Qemu, START_TIME, end_qemu, find_image, qemu_version, sample_bytes};
pub use setup::{Setup, bench_sensors, calibrated, raw};
