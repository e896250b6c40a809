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

mod skew;
mod stiffness;

/// Time after the motion in which the last records must have come.
const LAST_RECORDS: Duration = Duration::from_secs(3);

/// Find at commissioning what is then kept as a setting.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    Skew(skew::Args),
    Stiffness(stiffness::Args),
}

/// What all of them take.
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
    match &args.command {
        Command::Skew(args) => skew::run(args),
        Command::Stiffness(args) => stiffness::run(args),
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
