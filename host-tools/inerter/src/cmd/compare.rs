//! `inerter compare`: arguments and manual; its work is in `reports/compare.rs`.

use std::path::PathBuf;

use super::{args::FileSettingsArgs, limits::LimitsArgs};

/// Compare runs side by side: which differences are significant, and one page with all figures overlaid.
///
/// All other runs are compared with the first. Runs on one rig share the errors of force gain, lead and clock, so these
/// do not count in a difference. Runs of another board or calibration, or with another scale of encoder or force, count
/// as measured on another rig, and their full intervals are used; --rigs overrides that. A difference is significant if
/// chance alone would hardly make one as large; the more differences are tested, the stricter each test (Holm's
/// method). A run whose law is broken, in which the device changed, or with wrong samples stays undecided.
///
/// With --limits each run is also checked against limits, and the exit code is 10 unless all pass. With --json one
/// object:
/// {"kind":"compare","files":[..],"rigs":[{"rig":"same"},..],"parameters":{"inertance_kg":[{"value":..,"u95":..,
/// "same_rig_u95":..},{..,"difference":{"value":..,"u95":..,"p":..},"verdict":"differs"}],..}}. docs/CLI.md describes
/// it.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recordings (.mcap) or CSV files, at least two; the others are compared with the first
    #[arg(required = true, num_args = 2.., value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Page to write
    #[arg(short, long, value_name = "FILE.html")]
    pub output: Option<PathBuf>,
    /// Write the figures as PNG files into this folder, which is created if needed
    #[arg(long, value_name = "DIR")]
    pub png: Option<PathBuf>,
    /// Replace files that exist
    #[arg(long)]
    pub force: bool,
    /// Whether the runs share a rig and its calibration [default: as the files show]
    #[arg(long, value_name = "HOW_MANY")]
    pub rigs: Option<Rigs>,
    #[command(flatten)]
    pub settings: FileSettingsArgs,
    #[command(flatten)]
    pub limits: LimitsArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// How many rigs the runs are of.
#[derive(Clone, Copy, clap::ValueEnum)]
pub enum Rigs {
    One,
    Several,
}
