//! Total backlash between the flanks, from force and encoder alone or with the terminal's own displacement.
//!
//! Glossary: a *flank* is one side of the contact; it is *firm* while the force clearly presses on it; a *flight* is
//! the time between two flanks; a *reversal* is a flight from one flank to the other; *stretch* is the contact's own
//! deformation `p`, the force over the stiffness through the lag `cs / ks`.
//!
//! While a flank `chi` is firm, `x1 = x2 + p + chi eps / 2`. The terminal's motion `x1` is smooth across the flight, so
//! around each reversal `x2 + p` is a polynomial in time less a step of `eps`. The path: [`flanks`] (stretch, and which
//! samples are firm) -> [`octaves`] (the past at every time scale) -> [`step`] (one reversal) -> [`pool`] (all of
//! them), and beside it [`terminal`], which measures `x1 - x2` where there is a sensor for it. [`report`] gives the
//! status and the interval. Integers from counts and codes to the sums; all lengths are in *units* of
//! `BacklashActive::unit_m`.

pub(crate) mod active;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
pub(crate) mod flanks;
mod law;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod octaves;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod pool;
pub(crate) mod report;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
pub(crate) mod state;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod step;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod terminal;
