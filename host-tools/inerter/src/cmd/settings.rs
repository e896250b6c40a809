//! `inerter settings`: the settings and the calibration of a live device, and settings in files.

use std::path::{Path, PathBuf};

use inerter_core::Settings;
use inerter_data::{
    backup::{self, changes, values_of},
    output,
    settings::{Overrides, validate},
};
use inerter_device::Device;
use serde_json::{Value, json};

use super::{
    args::LinkArgs,
    print::print_json,
    terminal::{self, say, tidy_at_interrupts},
};
use crate::{Error, error::DialogueError};

/// Name that stands for the device in `diff`.
const DEVICE: &str = "device";

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
    Backup(BackupArgs),
    Restore(RestoreArgs),
    Diff(DiffArgs),
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

/// Write all settings in use, or those that are saved, to a file.
///
/// The file is TOML with one setting per line, unit and meaning beside it, and the device it belongs to in comments.
/// With --json one object: {"kind":"settings_backup","file":..,"serial":..,"settings":..,"saved":false}.
#[derive(clap::Args)]
struct BackupArgs {
    /// File to write
    #[arg(value_name = "FILE.toml")]
    file: PathBuf,
    /// Replace the file if it exists
    #[arg(long)]
    force: bool,
    /// Write the saved settings instead of those in use; works after failed starts too, when the device ignores them
    #[arg(long)]
    saved: bool,
    #[command(flatten)]
    common: Common,
}

/// Restore the settings of a backup.
///
/// Prints what changes. If the device refuses one setting, none is changed. Settings that the file does not name stay
/// as they are. A file of another device is refused unless --force: a calibration belongs to its board, cell and screw.
/// With --json one object with all settings: {"kind":"settings","serial":..,"settings":{..}}.
#[derive(clap::Args)]
struct RestoreArgs {
    /// File from `settings backup`
    #[arg(value_name = "FILE.toml")]
    file: PathBuf,
    /// Save them, so that they survive a restart
    #[arg(long)]
    save: bool,
    /// Accept a file of another device
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    common: Common,
}

/// Show the settings that differ between two files, or between a file and a device.
///
/// Each is a TOML file, a recording (.mcap), or the word `device`. Settings that only one of them has count as
/// different. The exit code is 0, different or not. With --json one object:
/// {"kind":"settings_diff","a":..,"b":..,"differences":{"skew_s":{"a":..,"b":..}}}.
#[derive(clap::Args)]
struct DiffArgs {
    /// FILE.toml, FILE.mcap or `device`
    a: String,
    /// FILE.toml, FILE.mcap or `device`
    b: String,
    #[command(flatten)]
    link: LinkArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Flags of every command that needs a device.
#[derive(clap::Args)]
struct Common {
    #[command(flatten)]
    link: LinkArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Common {
    /// Changes the settings in use, saves them if requested, and reports the result.
    fn change(&self, save: bool, change: impl FnOnce(&mut Device) -> Result<(), Error>) -> Result<(), Error> {
        let mut device = self.link.device()?;
        let before = *device.settings();
        change(&mut device)?;
        if save {
            device.save_settings()?;
        }
        if self.json {
            return print_settings(&device);
        }
        let changed = print_changes(&before, device.settings())?;
        say(match (save, changed) {
            (true, _) => "saved: these settings survive a restart",
            (false, true) => "in use until the next restart; `inerter settings save` keeps them",
            (false, false) => "nothing has changed",
        });
        Ok(())
    }
}

pub fn run(args: &Args) -> Result<(), Error> {
    match &args.command {
        Command::Get(common) => get(common),
        Command::Set(args) => {
            let overrides = Overrides::from_inputs(args.settings.as_deref(), &args.set)?;
            args.common.change(args.save, |device| adopt(device, &overrides))
        }
        Command::Tare(args) => args.common.change(args.save, |device| Ok(device.tare()?)),
        Command::Save(common) => common.change(true, |_| Ok(())),
        Command::FactoryReset(args) => factory_reset(args),
        Command::Backup(args) => backup(args),
        Command::Restore(args) => {
            let backup = backup::read(&args.file)?;
            args.common.change(args.save, |device| {
                if !args.force {
                    backup.check_owner(&args.file, device.hello())?;
                }
                adopt(device, &backup.values)
            })
        }
        Command::Diff(args) => diff(args),
    }
}

/// Puts these settings in use; rejects what the device would reject, with a fuller message.
fn adopt(device: &mut Device, overrides: &Overrides) -> Result<(), Error> {
    let mut wanted = *device.settings();
    overrides.apply(&mut wanted)?;
    validate(&wanted)?;
    Ok(device.write_settings(&wanted)?)
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

fn backup(args: &BackupArgs) -> Result<(), Error> {
    if !args.force {
        output::refuse_existing(&args.file)?;
    }
    tidy_at_interrupts();
    let mut device = args.common.link.device()?;
    let settings = if args.saved { device.saved_settings()? } else { *device.settings() };
    backup::write(&args.file, args.force, device.hello(), &settings)?;
    let (file, serial) = (args.file.display().to_string(), device.hello().serial.as_str());
    if args.common.json {
        let line = json!({ "kind": "settings_backup", "file": file, "serial": serial, "settings": Settings::COUNT, "saved": args.saved });
        return print_json(&line);
    }
    let which = if args.saved { "saved settings" } else { "settings" };
    say(format!("{} {which} of {} (serial {serial}) are in {file}", Settings::COUNT, device.hello().board));
    Ok(())
}

fn diff(args: &DiffArgs) -> Result<(), Error> {
    let values = |name: &str| -> Result<Vec<Option<f64>>, Error> {
        // A file of that name has to be given as a path.
        if name == DEVICE {
            let device = args.link.device()?;
            return Ok(device.settings().values().into_iter().map(Some).collect());
        }
        Ok(values_of(Path::new(name))?)
    };
    let (a, b) = (values(&args.a)?, values(&args.b)?);
    let bits = |value: &Option<f64>| value.map(f64::to_bits);
    let all = Settings::TABLE.iter().zip(a.into_iter().zip(b));
    let differences: Vec<_> = all.filter(|(_, (a, b))| bits(a) != bits(b)).collect();
    if args.json {
        let named = differences.iter().map(|(info, (a, b))| (info.name, json!({ "a": a, "b": b })));
        let named: Value = named.collect();
        let line = json!({ "kind": "settings_diff", "a": args.a, "b": args.b, "differences": named });
        return print_json(&line);
    }
    let text = |value: &Option<f64>| value.map_or_else(|| "(not given)".to_string(), |value| format!("{value:?}"));
    for (info, (a, b)) in &differences {
        output::line(format!("{:<32} {} -> {}", info.name, text(a), text(b)))?;
    }
    if differences.is_empty() {
        say("no setting differs");
    }
    Ok(())
}

fn print_settings(device: &Device) -> Result<(), Error> {
    let names = Settings::TABLE.iter().map(|info| info.name);
    let settings: Value = names.zip(device.settings().values()).collect();
    let line = json!({ "kind": "settings", "serial": device.hello().serial, "settings": settings });
    print_json(&line)
}

/// Prints each setting that has changed; returns whether there were any.
fn print_changes(before: &Settings, after: &Settings) -> Result<bool, Error> {
    let changes = changes(before, after);
    for (name, before, after) in &changes {
        output::line(format!("{name} = {after:?}   # was {before:?}"))?;
    }
    Ok(!changes.is_empty())
}
