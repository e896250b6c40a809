//! `inerter calibrate`: what is found at commissioning and then kept as a setting.

use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

use inerter::{Error, device::Device};
use inerter_wire::{Command as Wire, EventKind, Frame, Record, Streams};

use super::{
    args::{FileSettingsArgs, LinkArgs, seconds},
    terminal::{self, Progress},
};

mod common;
mod direction;
mod encoder;
mod force;
mod load_cell;
mod person;
mod skew;
mod stiffness;
mod timebase;
mod wizard;
mod zero;

/// Time after the motion in which the last records must have come.
const LAST_RECORDS: Duration = Duration::from_secs(3);

/// Calibrate a device: a wizard, or each of its steps as a command.
///
/// Without a step: a wizard that goes through all of them at a device and asks before it changes anything. The steps as
/// commands are for scripts and for whoever knows what he wants: each shows what it found with its uncertainty, --write puts
/// that in use on the device and saves it, and --json prints one object. Order: load-cell, zero, force, encoder, direction,
/// skew, timebase; stiffness where there is a displacement sensor at the terminal.
#[derive(clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct Args {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    link: LinkArgs,
}

#[derive(clap::Subcommand)]
enum Command {
    LoadCell(load_cell::Args),
    Zero(zero::Args),
    Force(force::Args),
    Encoder(encoder::Args),
    Direction(direction::Args),
    Skew(skew::Args),
    Stiffness(stiffness::Args),
    Timebase(timebase::Args),
}

/// What the steps take that begin the estimator anew.
#[derive(clap::Args)]
struct CommonArgs {
    /// Recording (.mcap) or CSV file; without it a device
    #[arg(conflicts_with_all = ["write", "port", "connect", "serial"])]
    file: Option<PathBuf>,
    /// Put the result in use on the device and keep it over a restart
    #[arg(long)]
    write: bool,
    /// How long a device is listened to
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true, default_value = "20")]
    duration: Duration,
    #[command(flatten)]
    link: LinkArgs,
    #[command(flatten)]
    settings: FileSettingsArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let Some(command) = &args.command else { return wizard::run(&args.link) };
    match command {
        Command::LoadCell(args) => load_cell::run(args),
        Command::Zero(args) => zero::run(args),
        Command::Force(args) => force::run(args),
        Command::Encoder(args) => encoder::run(args),
        Command::Direction(args) => direction::run(args),
        Command::Skew(args) => skew::run(args),
        Command::Stiffness(args) => stiffness::run(args),
        Command::Timebase(args) => timebase::run(args),
    }
}

/// Lets a device's estimator begin anew and hands on its records for this time; `take` says whether it has what it needs.
fn listen(
    device: &mut Device,
    streams: Streams,
    duration: Duration,
    mut take: impl FnMut(&Record) -> bool,
) -> Result<(), Error> {
    device.stream(streams)?;
    device.start_sampler()?;
    device.request("to begin anew", Wire::ResetEstimator)?;
    // What was under way before belongs to another motion.
    while device.pending().is_some() {}
    let mut progress = Progress::new("listening", duration.as_millis() as u64);
    let started = Instant::now();
    let mut found = false;
    while started.elapsed() < duration + LAST_RECORDS && !(found && started.elapsed() >= duration) {
        if terminal::interrupted() {
            return Err(Error::Interrupted);
        }
        progress.set(started.elapsed().as_millis() as u64);
        let Some(received) = device.receive()? else { continue };
        let Frame::Message { message, .. } = received.frame else { continue };
        found = take(&message);
        let ended = matches!(&message, Record::Event(event) if event.kind == EventKind::SourceEnded);
        if ended && found {
            break;
        }
    }
    progress.done();
    Ok(())
}
