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
mod timebase;
mod wizard;
mod zero;

use motion::MotionArgs;

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
    /// Find the delay of the force behind the position.
    ///
    /// Move the machine for 20 s with several frequencies at once (two tones or a random motion, up to the highest
    /// frequency that the machine reaches) or from point to point: in a single tone a delay and viscous friction are
    /// indistinguishable, and the command says so instead of giving a number. Delays of up to 5 ms either way are
    /// found, on machines of any size. A delay acts as a false damper of mt w^2 tau: 3 N s/m per microsecond at 15.9 Hz
    /// for 300 kg.
    ///
    /// FILE is a recording (.mcap) or a CSV; without it the command measures on a device for --duration. --write puts
    /// skew_s and skew_u95_s in use on the device and saves them if they are better than those in use: if the remaining
    /// delay exceeds its interval, or if its interval is the smaller one. For a file they are printed as --set. With
    /// --json one object: {"kind":"skew","left_s":..,"skew_s":..,"skew_u95_s":..,..}.
    #[command(after_long_help = inerter_data::settings::help_table())]
    Skew(MotionArgs),
    /// Find stiffness and damping of the contact, with a terminal displacement sensor.
    ///
    /// With these two settings the backlash follows from the force alone, and the sensor may be removed again. Shake
    /// the inerter from 3 Hz up for 20 s, hard enough that the force presses on both flanks in turn. If the sensor's
    /// scale is 0.1 % off the encoder's, the stiffness is 1.7 % off at 3.2 Hz: calibrate it against the encoder first,
    /// and state in lead_u95 how well.
    ///
    /// FILE is a recording (.mcap) or a CSV with a column terminal_m; without it the command measures on a device for
    /// --duration. --write puts stiffness_n_per_m, stiffness_u95_n_per_m and contact_damping_n_s_per_m in use on the
    /// device and saves them if they are better than those in use: if no stiffness is set, if the one set lies outside
    /// the interval, or if the new interval is the smaller one. For a file they are printed as --set. With --json one
    /// object:
    /// {"kind":"stiffness","stiffness_n_per_m":..,"stiffness_u95_n_per_m":..,"contact_damping_n_s_per_m":..,..}.
    #[command(after_long_help = inerter_data::settings::help_table())]
    Stiffness(MotionArgs),
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
        Command::Skew(args) => motion::run(args, motion::skew),
        Command::Stiffness(args) => motion::run(args, motion::stiffness),
        Command::Timebase(args) => timebase::run(args),
    }
}
