//! Figures and pages of runs of an instrumented inerter.
//!
//! [`figure`] draws as SVG and PNG, [`page`] makes a page of a run, [`compared`] of several, [`paper`] of the
//! reproduction of the paper's experiment, and [`selftest`] of a board's self-test; [`index`] lists pages of runs.

pub mod compared;
pub mod figure;
mod frame;
pub mod index;
pub mod page;
pub mod paper;
pub mod selftest;
