//! The simulated inerter on the shaker, measured by the firmware in QEMU.

use crate::{
    firmware::{self, Image},
    process, setup,
};
use anyhow::{Context, Result};

/// Arguments passed on to the demo.
#[derive(clap::Args)]
pub struct Options {
    /// Arguments of the demo itself (`--help` lists them)
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    pub arguments: Vec<String>,
}

/// Sets up what is missing, builds the image and the programs, and runs the demo.
pub fn run(options: &Options) -> Result<()> {
    process::heading("set-up");
    setup::ensure(&[setup::Need::Firmware, setup::Need::System(&setup::ARM_QEMU)], false)?;
    process::heading("building the firmware");
    let image = firmware::build(Image::QEMU)?;
    process::heading("building the programs");
    process::run(process::cargo().args(["build", "--package", "inerter-demo"]))?;
    let run = ["run", "--quiet", "--package", "inerter-demo", "--"];
    process::run(process::cargo().args(run).args(&options.arguments).env(Image::QEMU.variable, &image))
        .context("the demo failed")
}
