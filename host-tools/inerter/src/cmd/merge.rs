//! `inerter merge`: joins consecutive recordings of one device.

use std::path::PathBuf;

use inerter_data::{
    recording,
    words::{duration_text, plural},
};
use serde_json::json;

use super::{
    args::OutputArgs,
    print::print_json,
    terminal::{self, Progress},
};
use crate::Error;

/// Join recordings of one device in time order.
///
/// They are sorted by time, in whatever order they are given. Frames, markers and times stay exactly as received.
/// Samples are missing between two recordings unless the device's sample counter continues.
///
/// Recordings with different settings, of different devices, or made at the same time are refused. Truncated recordings
/// may be given. The inputs are never changed.
#[derive(clap::Args)]
pub struct Args {
    /// Recordings (.mcap), two or more
    #[arg(required = true, num_args = 2.., value_name = "FILE")]
    files: Vec<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
    /// Print JSON: one object
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let path = args.output.path()?;
    terminal::catch_interrupts();
    let size = args.files.iter().map(|file| file.metadata().map_or(0, |metadata| metadata.len())).sum();
    let mut bar = Progress::new("merging", size);
    let merged = recording::merge(&args.files, path, args.output.force, |offset| {
        bar.set(offset);
        terminal::go_on()
    })?;
    bar.done();
    if args.json {
        let files: Vec<_> = args.files.iter().map(|file| file.to_string_lossy()).collect();
        return print_json(&json!({
            "kind": "merged", "file": path.to_string_lossy(), "files": files, "samples": merged.samples,
            "frames": merged.frames, "duration_s": merged.duration_s,
        }));
    }
    let (samples, duration) = (plural(merged.samples, "sample"), duration_text(merged.duration_s));
    terminal::say(format!(
        "{samples} of {} within {duration} written to {}",
        plural(args.files.len() as u64, "recording"),
        path.display()
    ));
    Ok(())
}
