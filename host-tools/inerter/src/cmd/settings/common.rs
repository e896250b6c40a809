//! Shared by the commands for a device's settings: how to reach it, and how to show the result.

use inerter_core::Settings;
use inerter_data::{backup::changes, output};
use inerter_device::Device;
use serde_json::{Value, json};

use crate::{
    Error,
    cmd::{args::LinkArgs, print::print_json, terminal::say},
};

/// Flags of every one of them.
#[derive(clap::Args)]
pub struct Common {
    #[command(flatten)]
    pub link: LinkArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Saves if requested, and reports the result.
pub fn finish(device: &mut Device, before: &Settings, save: bool, json: bool) -> Result<(), Error> {
    if save {
        device.save_settings()?;
    }
    if json {
        return print_settings(device);
    }
    let changed = print_changes(before, device.settings())?;
    say(match (save, changed) {
        (true, _) => "saved: these settings survive a restart",
        (false, true) => "in use until the next restart; `inerter settings save` keeps them",
        (false, false) => "nothing has changed",
    });
    Ok(())
}

pub fn print_settings(device: &Device) -> Result<(), Error> {
    let names = Settings::TABLE.iter().map(|info| info.name);
    let settings: Value = names.zip(device.settings().values()).collect();
    let line = json!({ "kind": "settings", "serial": device.hello().serial, "settings": settings });
    print_json(&line)
}

/// Prints each setting that has changed; returns whether there were any.
pub fn print_changes(before: &Settings, after: &Settings) -> Result<bool, Error> {
    let changes = changes(before, after);
    for (name, before, after) in &changes {
        output::line(format!("{name} = {after:?}   # was {before:?}"))?;
    }
    Ok(!changes.is_empty())
}
