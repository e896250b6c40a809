//! `inerter plot`: arguments and manual; its work is in `reports/plot.rs`.

use std::path::PathBuf;

use super::args::FileSettingsArgs;

/// The figures, as [`inerter_view`] names them; not every build includes that crate.
pub const FIGURES: [&str; 6] = ["force", "residual", "loop", "parameters", "backlash", "bode"];

/// Draw one figure of a run, as SVG for print or as PNG.
///
/// force: measured force and law in the middle of the run. loop: force over displacement. residual: residual of the
/// law. parameters: estimates with intervals over time. backlash: by reversal. bode: measured, ideal and complete
/// frequency response. A figure that the run cannot give is refused with code 9.
///
/// With --json one object: {"kind":"plot","file":..,"source":..,"figure":..,"caption":..}.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recording (.mcap) or CSV file
    pub file: PathBuf,
    /// Which figure
    #[arg(long, value_name = "NAME", value_parser = FIGURES)]
    pub figure: String,
    /// File to write, .svg or .png
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Replace a file that exists
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub settings: FileSettingsArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}
