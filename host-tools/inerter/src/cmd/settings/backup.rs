//! `inerter settings backup`, `restore` and `diff`: settings in files.

use std::path::{Path, PathBuf};

use inerter_core::Settings;
use inerter_data::{
    backup::{self, values_of},
    output,
    settings::validate,
};
use serde_json::{Value, json};

use super::{
    super::{
        args::LinkArgs,
        print::print_json,
        terminal::{say, tidy_at_interrupts},
    },
    Common, finish,
};
use crate::Error;

/// Name that stands for the device in `diff`.
const DEVICE: &str = "device";

/// Write all settings in use, or those that are saved, to a file.
///
/// The file is TOML with one setting per line, unit and meaning beside it, and the device it belongs to in comments.
/// With --json one object: {"kind":"settings_backup","file":..,"serial":..,"settings":..,"saved":false}.
#[derive(clap::Args)]
pub struct BackupArgs {
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
pub struct RestoreArgs {
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
pub struct DiffArgs {
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

pub fn backup(args: &BackupArgs) -> Result<(), Error> {
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

pub fn restore(args: &RestoreArgs) -> Result<(), Error> {
    let backup = backup::read(&args.file)?;
    let mut device = args.common.link.device()?;
    if !args.force {
        backup.check_owner(&args.file, device.hello())?;
    }
    let before = *device.settings();
    let mut wanted = before;
    backup.values.apply(&mut wanted)?;
    // Reject here what the device would reject, with a fuller message.
    validate(&wanted)?;
    device.write_settings(&wanted)?;
    finish(&mut device, &before, args.save, args.common.json)
}

pub fn diff(args: &DiffArgs) -> Result<(), Error> {
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
