//! `inerter settings`: the settings and the calibration of a live device.

use std::{
    io::{self, IsTerminal, Write},
    path::PathBuf,
};

use inerter::{
    Error,
    device::{Clock, Device},
    output,
    report::json_line,
    settings::{Overrides, SettingsInputError, validate},
};
use inerter_core::Settings;
use serde_json::{Map, Value, json};

use super::{args::LinkArgs, terminal::say};

mod backup;

/// Show, change and save the settings and the calibration of a device.
///
/// What is changed is in use at once, and is lost at the next restart unless it is saved.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Show the settings in use
    ///
    /// Each with its unit and meaning, as lines that --settings FILE.toml takes.
    /// With --json one object: {"kind":"settings","serial":..,"settings":{..}}.
    Get(Common),
    Set(SetArgs),
    Tare(TareArgs),
    /// Keep the settings in use over a restart
    Save(Common),
    FactoryReset(FactoryResetArgs),
    Backup(backup::BackupArgs),
    Restore(backup::RestoreArgs),
    Diff(backup::DiffArgs),
}

#[derive(clap::Args)]
struct Common {
    #[command(flatten)]
    link: LinkArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Change settings, all of them or, when one is refused, none.
///
/// Prints what has changed; with --json one object with all settings: {"kind":"settings","serial":..,"settings":{..}}.
#[derive(clap::Args)]
#[command(after_long_help = inerter::settings::help_table())]
struct SetArgs {
    /// Settings with their new values; the last one wins
    #[arg(value_name = "KEY=VALUE", required_unless_present = "settings")]
    set: Vec<String>,
    /// Read settings from a TOML file with lines `key = value`; those given by name win over it
    #[arg(long, value_name = "FILE.toml")]
    settings: Option<PathBuf>,
    /// Keep them over a restart
    #[arg(long)]
    save: bool,
    #[command(flatten)]
    common: Common,
}

/// Take the present force as zero.
///
/// The device should stand still, without load. Prints what has changed.
#[derive(clap::Args)]
struct TareArgs {
    /// Keep it over a restart
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
            let mut device = connect(&args.common)?;
            let before = *device.settings();
            device.tare()?;
            finish(&mut device, &before, args.save, args.common.json)
        }
        Command::Save(common) => {
            let mut device = connect(common)?;
            let settings = *device.settings();
            finish(&mut device, &settings, true, common.json)
        }
        Command::FactoryReset(args) => factory_reset(args),
        Command::Backup(args) => backup::backup(args),
        Command::Restore(args) => backup::restore(args),
        Command::Diff(args) => backup::diff(args),
    }
}

fn connect(common: &Common) -> Result<Device, Error> {
    Ok(Device::connect(&common.link.target(), Clock::new())?)
}

fn get(common: &Common) -> Result<(), Error> {
    let device = connect(common)?;
    if common.json {
        return print_json(&device);
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
    let mut device = connect(&args.common)?;
    let before = *device.settings();
    let mut wanted = before;
    overrides.apply(&mut wanted)?;
    // What the device would refuse is refused here, with more words.
    validate(&wanted)?;
    device.write_settings(&wanted)?;
    finish(&mut device, &before, args.save, args.common.json)
}

fn factory_reset(args: &FactoryResetArgs) -> Result<(), Error> {
    let can_ask = io::stdin().is_terminal() && io::stderr().is_terminal();
    if !args.yes && !can_ask {
        return Err(SettingsInputError::Unconfirmed.into());
    }
    let mut device = connect(&args.common)?;
    let name = format!("{} (serial {}) at {}", device.hello().board, device.hello().serial, device.name());
    if !args.yes && !confirmed(&name) {
        say("nothing was changed");
        return Ok(());
    }
    let before = *device.settings();
    device.factory_reset()?;
    if args.common.json {
        return print_json(&device);
    }
    print_changes(&before, device.settings())?;
    say("the board's defaults are in use; nothing is saved");
    Ok(())
}

/// Saves if that is wanted, and says what has come of it.
fn finish(device: &mut Device, before: &Settings, save: bool, json: bool) -> Result<(), Error> {
    if save {
        device.save_settings()?;
    }
    if json {
        return print_json(device);
    }
    let changed = print_changes(before, device.settings())?;
    say(match (save, changed) {
        (true, _) => "saved: these settings outlive a restart",
        (false, true) => "in use until the next restart; `inerter settings save` keeps them",
        (false, false) => "nothing has changed",
    });
    Ok(())
}

fn print_json(device: &Device) -> Result<(), Error> {
    let values = Settings::TABLE.iter().zip(device.settings().values());
    let settings: Map<String, Value> = values.map(|(info, value)| (info.name.into(), json!(value))).collect();
    let line = json!({ "kind": "settings", "serial": device.hello().serial.as_str(), "settings": settings });
    Ok(output::line(json_line(&line))?)
}

/// Prints each setting that is another one than before; gives whether there were any.
fn print_changes(before: &Settings, after: &Settings) -> Result<bool, Error> {
    let mut any = false;
    for ((info, before), after) in Settings::TABLE.iter().zip(before.values()).zip(after.values()) {
        if before.to_bits() != after.to_bits() {
            output::line(format!("{} = {after:?}   # was {before:?}", info.name))?;
            any = true;
        }
    }
    Ok(any)
}

fn confirmed(device: &str) -> bool {
    let question = format!("Erase all settings and the calibration saved on {device}? [y/N] ");
    // Whoever cannot read the question cannot answer it with yes.
    if write!(io::stderr(), "{question}").and_then(|()| io::stderr().flush()).is_err() {
        return false;
    }
    let mut answer = String::new();
    io::stdin().read_line(&mut answer).is_ok() && ["y", "yes"].contains(&answer.trim().to_lowercase().as_str())
}
