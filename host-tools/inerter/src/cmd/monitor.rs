//! `inerter monitor`: shows what a device measures, live.

use std::{
    io::{self, IsTerminal},
    path::PathBuf,
    time::Instant,
};

use inerter_data::{json::json_line, output, recording::Recorder};
use inerter_simulate::share::Share;
use inerter_wire::Streams;
use serde_json::json;

use super::{
    args::{LinkArgs, TimeArgs, calibration, note_exposed},
    lines::{Json, Lines, Printer},
    print::print_now,
    terminal::{self, say},
};
use crate::{
    Error,
    monitor::{
        MonitorError,
        address::check_exposed,
        hub::Hub,
        others::{Place, Wanted},
    },
};

/// Default address where other programs find the device.
const SHARE: &str = "127.0.0.1:7878";

/// Show what a device measures, live.
///
/// In a terminal: signals, parameters with 95 % intervals over time, losses, health, events; `?` lists the keys.
/// Otherwise, or with --plain, one line per estimate is printed. With --json one object per line: {"kind":"device",..}
/// at the beginning and after each reconnection, {"kind":"estimate",..} as `inerter replay --json` prints it,
/// {"kind":"reversal",..} for each reversal of the flanks, {"kind":"health",..} once a second,
/// {"kind":"event","code":..,"event":..}, with a code like cause.skew for what breaks the law,
/// {"kind":"link","lost_frames":..} when frames were lost, {"kind":"link","left_out_lines":..} when lines were not read
/// in time, {"kind":"marker","text":..}, {"kind":"view","view":..,"address":..} for each of --web, --teleplot,
/// --plotjuggler, --foxglove, --share.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    link: LinkArgs,
    #[command(flatten)]
    time: TimeArgs,
    /// Print JSON, one object per line
    #[arg(long)]
    json: bool,
    /// Print lines even in a terminal
    #[arg(long, conflicts_with = "json")]
    plain: bool,
    /// Record everything that the device sends, with the markers
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Store when and how the rig was calibrated: the table `[calibration]` of this settings file, with `date`, and
    /// `certificate` and `expires` if known
    #[arg(long, value_name = "FILE.toml", requires = "record")]
    calibration: Option<PathBuf>,
    /// Replace the recording if it exists
    #[arg(long, requires = "record")]
    force: bool,
    #[command(flatten)]
    others: Wanted,
    /// Let other programs read the device: `monitor` or `record` with --connect HOST:PORT. This program controls it
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, default_missing_value = SHARE, help_heading = "Other views")]
    share: Option<String>,
    /// Allow addresses that other machines can reach (--foxglove, --share)
    #[arg(long, help_heading = "Other views")]
    allow_remote: bool,
}

impl Args {
    /// Causes cannot be found without samples.
    fn streams(&self) -> Streams {
        Streams { sums: self.record.is_some() || self.share.is_some(), ..Streams::ALL }
    }
}

pub fn run(args: &Args) -> Result<(), Error> {
    args.others.check()?;
    if let Some(file) = args.record.as_ref().filter(|_| !args.force) {
        output::refuse_existing(file)?;
    }
    let has_screen = !args.json && !args.plain && io::stdout().is_terminal() && io::stdin().is_terminal();
    let calibration = calibration(args.calibration.as_deref())?;
    terminal::catch_interrupts();
    let live = args.link.live(args.streams(), args.time.wait)?;
    let recording = args.record.as_ref().map(|file| file.display().to_string());
    let mut hub = Hub::new(live, args.time.wait.as_secs_f64());
    let views = views(args, &mut hub, recording.clone())?;
    // This step comes last of those that may fail, so that a mistake does not destroy a file that --force replaces.
    if let Some(file) = &args.record {
        let mut recorder = Recorder::create(file, args.force)?;
        calibration.iter().try_for_each(|calibration| recorder.calibrated(calibration))?;
        hub.recorder = Some(recorder);
    }
    for (view, address) in &views {
        if args.json {
            print_now(json_line(&json!({ "kind": "view", "view": view, "address": address })))?;
        } else {
            say(format!("{view}: {address}"));
        }
    }
    let started = Instant::now();
    let duration = args.time.duration;
    let over = move || terminal::interrupted() || duration.is_some_and(|duration| started.elapsed() >= duration);
    if has_screen {
        #[cfg(feature = "screen")]
        {
            let elsewhere = views.iter().map(|(view, address)| format!("{view}: {address}")).collect();
            return super::screen::run(hub, recording, elsewhere, over);
        }
        #[cfg(not(feature = "screen"))]
        terminal::note(
            "lines instead of the screen, as this `inerter` was built without its feature `screen`: build it with `cargo \
             install --path host-tools/inerter`, or add `--features screen` to your own build command; --plain asks for lines",
        );
    }
    hub.add(if args.json { Printer::new(Json::default()) } else { Printer::new(Lines::default()) }?);
    hub.run(over)
}

/// Adds all requested views; returns the name and address of each.
fn views(args: &Args, hub: &mut Hub, recording: Option<String>) -> Result<Vec<Place>, Error> {
    let foxglove = args.others.foxglove.as_deref();
    for (option, address) in [("--foxglove", foxglove), ("--share", args.share.as_deref())] {
        address.map_or(Ok(()), |address| check_exposed(option, address, args.allow_remote))?;
    }
    let mut views = args.others.open(hub, recording)?;
    foxglove.into_iter().for_each(note_exposed);
    if let Some(address) = &args.share {
        let failed = |error: io::Error| {
            let (what, option, reason) = ("the shared device", "--share", error.to_string());
            MonitorError::Listen { what, option, address: address.clone(), example: SHARE, reason }
        };
        let share = Share::watched(address).map_err(failed)?;
        note_exposed(address);
        views.push(("shared device", share.address().map_err(failed)?.to_string()));
        hub.share = Some(share);
    }
    Ok(views)
}
