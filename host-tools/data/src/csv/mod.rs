//! CSV files with the columns `t_s, encoder_count, force_n` and optionally `terminal_m`; for a rotary machine
//! `torque_n_m` and `terminal_rad`.
//!
//! Columns may be in any order. Other columns, blank lines and lines that begin with `#` or `%` are ignored. [`read`]
//! checks every cell, [`timebase`] finds the sample rate and missing samples, and [`to_run`] quantises what a board
//! would have delivered. [`export`](crate::export) writes such files. [`Table::of_columns`] takes columns already in
//! memory. [`motion`] reads and writes motions for a shaker.

mod columns;
mod dialect;
mod error;
mod excerpt;
mod lines;
pub mod motion;
mod read;
mod samples;
pub mod timebase;

pub use columns::ColumnsError;
pub use error::CsvError;
pub use read::{Table, column_names, parse, read};
pub use samples::to_run;
