//! `inerter settings`: the settings and the calibration of a live device.

use std::path::PathBuf;

use inerter_core::Settings;
use inerter_data::{
    output,
    settings::{Overrides, validate},
};

use super::terminal::{self, say};
use crate::{Error, error::DialogueError};

mod backup;
mod common;

use common::{Common, finish, print_changes, print_settings};

/// Show, change and save the settings and the calibration of a device.
///
/// Changes are in use at once, and are lost at the next restart unless they are saved.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Show the settings in use
    ///
    /// Each with its unit and meaning, as lines that --settings FILE.toml accepts.
    /// With --json one object: {"kind":"settings","serial":..,"settings":{..}}.
    Get(Common),
    Set(SetArgs),
    Tare(TareArgs),
    /// Save the settings in use, so that they survive a restart
    Save(Common),
    FactoryReset(FactoryResetArgs),
    Backup(backup::BackupArgs),
    Restore(backup::RestoreArgs),
    Diff(backup::DiffArgs),
}

/// Change settings: all of them, or none if one is refused.
///
/// Prints what has changed; with --json one object with all settings: {"kind":"settings","serial":..,"settings":{..}}.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
struct SetArgs {
    /// Settings with their new values; the last one wins
    #[arg(value_name = "KEY=VALUE", required_unless_present = "settings")]
    set: Vec<String>,
    /// Read settings from a TOML file with lines `key = value`; those given by name win over it
    #[arg(long, value_name = "FILE.toml")]
    settings: Option<PathBuf>,
    /// Save them, so that they survive a restart
    #[arg(long)]
    save: bool,
    #[command(flatten)]
    common: Common,
}

/// Take the present force as zero.
///
/// The device should be still, without load. Prints what has changed.
#[derive(clap::Args)]
struct TareArgs {
    /// Save it, so that it survives a restart
    #[arg(long)]
    save: bool,
    #[command(flatten)]
    common: Common,
}

/// Erase the settings and the calibration that a device has saved.
///
/// The defaults of its board are in use at once. Prints what has changed. Asks first; --yes is for scripts.
#[derive(clap::Args)]
struct FactoryResetArgs {
    /// Do not ask
    #[arg(long)]
    yes: bool,
    #[command(flatten)]
    common: Common,
}

pub fn run(args: &Args) -> Result<(), Error> {
    match &args.command {
        Command::Get(common) => get(common),
        Command::Set(args) => set(args),
        Command::Tare(args) => {
            let mut device = args.common.link.device()?;
            let before = *device.settings();
            device.tare()?;
            finish(&mut device, &before, args.save, args.common.json)
        }
        Command::Save(common) => {
            let mut device = common.link.device()?;
            let settings = *device.settings();
            finish(&mut device, &settings, true, common.json)
        }
        Command::FactoryReset(args) => factory_reset(args),
        Command::Backup(args) => backup::backup(args),
        Command::Restore(args) => backup::restore(args),
        Command::Diff(args) => backup::diff(args),
    }
}

fn get(common: &Common) -> Result<(), Error> {
    let device = common.link.device()?;
    if common.json {
        return print_settings(&device);
    }
    for ((info, text), value) in Settings::described().zip(device.settings().values()) {
        let setting = format!("{} = {value:?}", info.name);
        let unit = if text.unit.is_empty() { String::new() } else { format!("{}; ", text.unit) };
        output::line(format!("{setting:<36} # {unit}{}", text.help))?;
    }
    Ok(())
}

fn set(args: &SetArgs) -> Result<(), Error> {
    let overrides = Overrides::from_inputs(args.settings.as_deref(), &args.set)?;
    let mut device = args.common.link.device()?;
    let before = *device.settings();
    let mut wanted = before;
    overrides.apply(&mut wanted)?;
    // Reject here what the device would reject, with a fuller message.
    validate(&wanted)?;
    device.write_settings(&wanted)?;
    finish(&mut device, &before, args.save, args.common.json)
}

fn factory_reset(args: &FactoryResetArgs) -> Result<(), Error> {
    if !args.yes && !terminal::can_ask() {
        return Err(DialogueError::Unconfirmed.into());
    }
    let mut device = args.common.link.device()?;
    let name = format!("{} (serial {}) at {}", device.hello().board, device.hello().serial, device.name());
    let question = format!("Erase all settings and the calibration saved on {name}? [y/N]");
    if !args.yes && !terminal::is_confirmed(question) {
        say("nothing was changed");
        return Ok(());
    }
    let before = *device.settings();
    device.factory_reset()?;
    if args.common.json {
        return print_settings(&device);
    }
    print_changes(&before, device.settings())?;
    say("the board's defaults are in use; nothing is saved");
    Ok(())
}
