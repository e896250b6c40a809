//! `inerter reproduce-paper`: arguments and manual; its work is in `reports/paper.rs`.

use std::path::PathBuf;

/// Simulate the paper's device and rig, identify it blindly, and draw the paper's figures 8, 9, 10 and 11.
///
/// The three tests (0.053 Hz 15.1 mm, 3.2 Hz 4.16 mm, 15.9 Hz 0.806 mm) are simulated with noise; the results of the
/// instrument are compared with the published values, and the band in which the ideal mass model holds is computed. The
/// folder gets a page (reproduction.html) and each figure as SVG and PNG. The same seeds give the same figures.
///
/// The paper's Coulomb friction is missing from our copy of its text: 50 N is our choice.
///
/// With --json one object: {"kind":"reproduced","file":..,"parameters":{..},"ideal_band_rad_per_s":[..],..}.
#[derive(clap::Args)]
pub struct Args {
    /// Folder to write into, which is created if needed
    #[arg(short, long, value_name = "DIR", default_value = "paper")]
    pub output: PathBuf,
    /// Replace files that exist
    #[arg(long)]
    pub force: bool,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}
