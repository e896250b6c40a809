//! `inerter update`: new firmware over USB.

use std::path::PathBuf;

use inerter_data::{output, words::plural};
use inerter_device::{
    Target,
    image::{Identity, Image},
    update::{self, Going, Stage, ThisMachine, UpdateEvent},
};
use serde_json::json;

use super::{
    args::LinkArgs,
    print::print_json,
    terminal::{self, Bars, say},
};
use crate::Error;

/// Load new firmware onto a device over its own USB connector.
///
/// The file is a release's inerter-firmware-VERSION-BOARD.elf, the ELF that `cargo build --release` makes in
/// firmware/stm32g474, or the plain bytes of either (.bin). The device is asked to enter its update mode (the chip's
/// DFU), only the pages of the image are erased and written, everything is read back, and the device is asked what it
/// now runs. Settings and calibration are kept. If the update is interrupted for any reason, the same command completes
/// it; a device already in update mode is used as it is.
/// With --json one object: {"kind":"updated","file":..,"firmware":..,"git":..,"board":..,"serial":..,"port":..}.
#[derive(clap::Args)]
pub struct Args {
    /// Firmware image: ELF or .bin
    file: PathBuf,
    #[command(flatten)]
    link: LinkArgs,
    /// Only show what would be written; needs no device
    #[arg(long)]
    dry_run: bool,
    /// Write an image of another board
    #[arg(long)]
    force: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let image = Image::open(&args.file)?;
    if args.dry_run {
        return dry_run(&image, args.json);
    }
    terminal::catch_interrupts();
    let mut machine = ThisMachine::new(args.link.target(), terminal::interrupted);
    let mut bars = Bars::default();
    let mut tell = |event: UpdateEvent| {
        match event {
            UpdateEvent::Found(running) => {
                let hello = &running.hello;
                say(format!(
                    "{} (serial {}) at {} runs {} ({})",
                    hello.board, hello.serial, running.name, hello.firmware, hello.git
                ));
                say(format!("new: {}", image.identity));
            }
            UpdateEvent::Entering => say("entering update mode"),
            UpdateEvent::InDfu(device) => {
                let what = format!("{}, {}", image.identity, size(&image));
                say(format!("writing {what}, to the device in update mode (serial {})", device.serial));
            }
            UpdateEvent::Pages(stage, done, all) => {
                let label = match stage {
                    Stage::Writing => "writing",
                    Stage::Checking => "reading back",
                };
                bars.set(label, done as u64, all as u64);
            }
            UpdateEvent::Returning => {
                bars.done();
                say("written and read back; starting it");
            }
        }
        if terminal::interrupted() { Going::Stop } else { Going::On }
    };
    let serial = match args.link.target() {
        Target::Usb { serial } => serial,
        _ => None,
    };
    let back = update::update(&mut machine, &image, serial.as_deref(), args.force, &mut tell)?;
    report(&image, &back, "updated", args.json)
}

/// Reports what runs now.
pub fn report(image: &Image, back: &update::Running, kind: &str, json: bool) -> Result<(), Error> {
    let (identity, serial, port) = (Identity::from(&back.hello), back.hello.serial.as_str(), &back.name);
    if json {
        let line = json!({
            "kind": kind, "file": image.file, "firmware": identity.firmware, "git": identity.git,
            "board": identity.board, "serial": serial, "port": port,
        });
        return print_json(&line);
    }
    Ok(output::line(format!("{kind}: {identity}, serial {serial}, at {port}; settings kept"))?)
}

/// How many bytes there are to write.
pub fn size(image: &Image) -> String {
    format!("{:.1} KB in {}", image.length() as f64 / 1024.0, plural(image.page_count() as u64, "page"))
}

fn dry_run(image: &Image, json: bool) -> Result<(), Error> {
    let identity = &image.identity;
    let extents = image.extents();
    if json {
        let extents: Vec<_> = extents.iter().map(|(first, last)| json!({ "first": first, "last": last })).collect();
        let line = json!({
            "kind": "image", "file": image.file, "firmware": identity.firmware, "git": identity.git,
            "board": identity.board, "bytes": image.length(), "pages": image.page_count(), "extents": extents,
        });
        return print_json(&line);
    }
    output::line(format!("{}: {identity}", image.file))?;
    output::line(format!("would erase and write {}:", size(image)))?;
    for (first, last) in extents {
        output::line(format!("  0x{first:08X} to 0x{last:08X}"))?;
    }
    Ok(output::line("settings would be kept")?)
}
