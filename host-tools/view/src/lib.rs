//! Figures and pages of runs of an instrumented inerter.
//!
//! [`selftest`] shows a board's self-test. [`figure`] draws as SVG and PNG, [`page`] makes a run into one page,
//! [`compared`] several, [`paper`] shows the paper's experiment done again.
#![forbid(unsafe_code)]

pub mod compared;
pub mod figure;
mod frame;
pub mod page;
pub mod paper;
pub mod selftest;
