//! `inerter flash`: firmware through a debug probe.

use std::path::PathBuf;

use inerter_device::{
    DEFAULT_BAUD, Target, board,
    flash::{self, Work},
    image::Image,
    stlink_port,
    update::{ThisMachine, confirm},
};

use super::{
    terminal::{Bars, interrupted, note, say},
    update,
};
use crate::Error;

/// Program a board through a debug probe, such as the NUCLEO's ST-Link.
///
/// For a board that runs no firmware yet, or none that answers; otherwise `inerter update` needs no probe. Only the
/// pages of the image are erased, so settings and calibration are kept. Everything is read back; then the board is
/// reset, found again on its USB connector or the probe's serial port, and asked what it runs.
/// With --json one object: {"kind":"flashed","file":..,"firmware":..,"git":..,"board":..,"serial":..,"port":..}.
#[derive(clap::Args)]
pub struct Args {
    /// Firmware image: ELF or .bin
    file: PathBuf,
    /// The probe, if several are plugged in
    #[arg(long, value_name = "VID:PID:SERIAL")]
    probe: Option<String>,
    /// The chip, by its name in probe-rs
    #[arg(long, value_name = "CHIP", default_value = board::CHIP)]
    chip: String,
    /// Serial port at which to ask the board afterwards, if neither its USB connector nor an ST-Link is plugged in
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// Do not ask the board afterwards what it runs
    #[arg(long)]
    no_check: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let mut probes = flash::probes()?;
    let image = Image::open(&args.file)?;
    let mut bars = Bars::default();
    let mut progress = |work: Work, done, all| {
        let label = match work {
            Work::Erasing => "erasing",
            Work::Writing => "writing",
            Work::Checking => "reading back",
        };
        bars.set(label, done, all);
    };
    let mut tell = |probe: &flash::Probe| {
        say(format!("writing {}, {}, through {probe}", image.identity, update::size(&image)));
    };
    let flashed = flash::flash(&mut *probes, args.probe.as_deref(), &args.chip, &image, &mut tell, &mut progress)?;
    bars.done();
    say("written and read back; starting it");
    if args.no_check {
        note(format!("the board (serial {}) was not asked what it runs", flashed.serial));
        return Ok(());
    }
    let link = || flashed.probe.serial.as_deref().and_then(stlink_port);
    let target = match args.port.clone().or_else(link) {
        Some(port) => Target::Port { port, baud: DEFAULT_BAUD },
        None => Target::Usb { serial: Some(flashed.serial.clone()) },
    };
    let back = confirm(&mut ThisMachine::new(target, interrupted), &image.identity, &flashed.serial)?;
    update::report(&image, &back, "flashed", args.json)
}
