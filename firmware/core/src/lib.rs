//! Counts and codes in, inertance and friction with honest intervals out.
//!
//! ```
//! use inerter_core::{RawSample, Settings, State};
//!
//! let active = Settings { sample_rate_hz: 1000.0, ..Settings::default() }.validate()?;
//! let mut state = State::new(&active);
//! let sample = RawSample { index: 0, position_count: 12, force_code: -345, terminal_code: 0 };
//! if let Some(estimate) = active.step(&mut state, &sample).estimate() {
//!     println!("{:?}", estimate.recent.inertance_kg);
//! }
//! # Ok::<(), inerter_core::SettingsError>(())
//! ```
//!
//! The law is `F = mt a + cf v + fc sgn(v) + F0`, in contact and out of it. The path, each room its own file:
//! `sample` -> `gate`, `sign` -> `kernel` -> `rls` -> `ldl` -> `report` -> `estimate`; `settings` -> `active` beside it.
//! Integers up to `ldl`, the same to the bit on every machine; `docs/THEORY.md` has the equations and word lengths.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod active;
mod backlash;
mod bank;
mod change;
pub mod constants;
mod detail;
mod estimate;
mod estimator;
mod feedback;
mod fit;
mod gate;
mod kernel;
mod ldl;
mod line;
mod math;
mod near_rest;
mod noise;
mod output;
mod qformat;
mod regime;
mod report;
pub mod rls;
mod sample;
mod settings;
mod sign;
mod solution;
mod sums;

pub use active::Active;
pub use detail::{
    Backlash, BacklashSize, BacklashStatus, Band, Change, Changed, Contact, Detail, Friction, Reason, Regime, Reversal,
    Route,
};
pub use estimate::{Bank, Estimate, Interval, Parameter, Parameters, Status, Unresolved};
pub use estimator::{Counters, State};
pub use output::{Output, Published};
pub use sample::RawSample;
pub use settings::{FrontEnd, Kind, SettingInfo, SettingText, Settings, SettingsError};
pub use sums::{MoreSums, Sums};
