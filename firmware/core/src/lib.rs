#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod active;
mod alignment;
mod backlash;
mod bank;
mod budget;
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
mod plausible;
mod qformat;
mod regime;
mod repeats;
mod report;
#[cfg(not(feature = "bench"))]
mod rls;
#[cfg(feature = "bench")]
pub mod rls;
mod sample;
mod settings;
mod sign;
mod solution;
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
