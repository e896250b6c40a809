//! Closed loop, replay of real data, QEMU, command line: what the tests of the whole share.

#![forbid(unsafe_code)]

pub mod data;
pub mod grid;
pub mod linear;
pub mod qemu;
pub mod reference;
