#![doc = include_str!("../README.md")]
#![no_std]

#[cfg(test)]
extern crate std;

// From codes to sums all arithmetic is on integers: those modules deny float arithmetic, except in tests.
mod active;
mod alignment;
mod backlash;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod bank;
mod budget;
mod change;
pub mod constants;
mod detail;
mod estimate;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod estimator;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod feedback;
mod fit;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod gate;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod kernel;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod ldl;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod line;
mod math;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod near_rest;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod noise;
mod output;
mod plausible;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod qformat;
mod regime;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod repeats;
mod report;
#[cfg(not(feature = "bench"))]
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod rls;
#[cfg(feature = "bench")]
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
pub mod rls;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod sample;
mod settings;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod sign;
mod solution;
#[cfg_attr(not(test), deny(clippy::float_arithmetic))]
mod state;
mod sums;
mod systematic;
mod trial;

pub use active::Active;
pub use budget::{Budget, Budgets, ContactBudgets, NORMAL_COVERAGE, Source};
pub use detail::{
    Backlash, BacklashSize, BacklashStatus, Band, Change, Changed, Contact, Detail, Friction, Law, LawStatus, Misfit,
    Reason, Regime, Reversal, Route, Warning, WarningKind,
};
pub use estimate::{Bank, Estimate, Interval, Parameter, Parameters, Status, Unresolved};
pub use output::{Output, Published};
pub use repeats::Repeats;
pub use sample::RawSample;
pub use settings::{FrontEnd, Kind, Machine, SettingInfo, SettingText, Settings, SettingsError};
pub use state::{Counters, State};
pub use sums::{MoreSums, Sums};
pub use systematic::{Found, MOST_REPEATS, Motion, Scatter, Spread, Systematic, apart};
