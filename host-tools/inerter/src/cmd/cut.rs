//! `inerter cut`: a part of a recording.

use std::path::PathBuf;

use inerter_data::{recording, words::plural};
use serde_json::json;

use super::{
    args::{OutputArgs, RangeArgs},
    print::print_json,
    terminal::{self, Progress},
};
use crate::Error;

/// Keep a part of a recording.
///
/// The frames stay exactly as received, so a replay of the part gives what a replay of those samples gives. Frames are
/// kept whole: up to 31 samples beyond --to are included, and as many after --from may be missing. Consecutive parts
/// hold every frame once, and `inerter merge` joins them again.
///
/// A truncated recording may be given. The input is never changed.
#[derive(clap::Args)]
pub struct Args {
    /// Recording (.mcap)
    file: PathBuf,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    range: RangeArgs,
    /// Print JSON: one object
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let path = args.output.path()?;
    terminal::catch_interrupts();
    let mut bar = Progress::through("cutting", &args.file);
    let cut = recording::cut(&args.file, args.range.range_s(), path, args.output.force, |offset| {
        bar.set(offset);
        terminal::go_on()
    })?;
    bar.done();
    let (from_s, to_s) = cut.span_s;
    if args.json {
        return print_json(&json!({
            "kind": "cut", "file": path.to_string_lossy(), "samples": cut.samples, "frames": cut.frames,
            "from_s": from_s, "to_s": to_s,
        }));
    }
    terminal::say(format!(
        "{} from {from_s:.3} s to {to_s:.3} s written to {}",
        plural(cut.samples, "sample"),
        path.display()
    ));
    Ok(())
}
