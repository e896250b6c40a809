//! Campaigns for what must never happen, each a test that runs only when it is asked for: `cargo xtask chaos` runs them
//! all, `cargo xtask chaos NAME` one.
//!
//! Every draw comes from one seed, which a failure names. The sizes come from variables: `INERTER_CHAOS_SEED`,
//! `INERTER_CHAOS_KILLS`, `INERTER_CHAOS_CYCLES`; `INERTER_CHAOS_REPORT` names the file to which each campaign appends
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
