//! `inerter calibrate`: values found at commissioning and kept as settings.

use super::args::LinkArgs;
use crate::Error;

mod common;
mod direction;
mod encoder;
mod force;
mod load_cell;
mod motion;
pub mod person;
mod skew;
mod stiffness;
mod timebase;
mod wizard;
mod zero;

/// Calibrate a device: a wizard, or each of its steps as a command.
///
/// Without a step: a wizard that goes through all of them on a device and asks before it changes anything. The steps as
/// commands are for scripts and for experienced users: each shows its result with its uncertainty, --write puts that in
/// use on the device and saves it, and --json prints one object. Order: load-cell, zero, force, encoder, direction,
/// skew, timebase; also stiffness, if there is a displacement sensor at the terminal.
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
