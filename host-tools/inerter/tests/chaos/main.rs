//! Campaigns against rare failures. Each is a test that runs only on request: `cargo xtask chaos` runs all of them,
//! `cargo xtask chaos NAME` one.
//!
//! All random numbers derive from one seed, which a failure prints. Variables set the sizes: `INERTER_CHAOS_SEED`,
//! `INERTER_CHAOS_KILLS`, `INERTER_CHAOS_CYCLES`. `INERTER_CHAOS_REPORT` names the file to which each campaign appends
//! its line.
#![cfg(target_os = "linux")]

#[path = "../common/mod.rs"]
mod common;

mod clocks;
mod cycles;
mod devices;
mod disks;
mod kills;
mod outlets;
mod scenario;
mod writers;
