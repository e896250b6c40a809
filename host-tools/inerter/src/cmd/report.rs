//! `inerter report`: arguments and manual; its work is in `reports/page.rs`.

use std::path::PathBuf;

use super::{args::FileSettingsArgs, limits::LimitsArgs};

/// Write a page on a run: parameters with intervals, figures, conditions, settings and versions.
///
/// The page is one HTML file that loads nothing else, prints on A4 and follows the reader's light or dark scheme. It
/// shows the force against the law, the residual, the force-displacement loop, parameters over time, backlash by
/// reversal, and the measured frequency response beside the ideal and the complete model. The page says what this run
/// cannot identify.
///
/// With --limits the page says pass, fail or undecided for each parameter that the file names, as `inerter replay`
/// does, and the exit code is 10 unless all pass.
///
/// --png also writes the figures as PNG files, for slides and papers; `inerter plot` writes a single one. With --json
/// one object: {"kind":"report","file":..,"source":..,"figures":[..],"png":[..]}, and "limits" if there are any.
/// docs/CLI.md describes it.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recording (.mcap) or CSV file
    pub file: PathBuf,
    /// Page to write
    #[arg(short, long, value_name = "FILE.html")]
    pub output: PathBuf,
    /// Write the figures as PNG files into this folder, which is created if needed
    #[arg(long, value_name = "DIR")]
    pub png: Option<PathBuf>,
    /// Replace files that exist
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub settings: FileSettingsArgs,
    #[command(flatten)]
    pub limits: LimitsArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}
