//! `inerter plan`: the most informative motion, and its predicted intervals.

mod files;
mod written;

use std::path::PathBuf;

use inerter_analysis::plan::Asked;
use inerter_data::{export::Source, output};

use super::{
    args::FileSettingsArgs,
    plant::ExpectedArgs,
    print::print_machine_json,
    terminal::{self, Progress, note},
};
use crate::Error;
use files::FileArgs;

/// Design the most informative motion within a rig's limits, and predict its intervals.
///
/// State approximately what you expect of the device (or give a recording of an earlier run, or --preset), the force's
/// noise, and what the rig can do: --stroke-m to either side, --speed-m-per-s, --force-n, --duration. The motion is a
/// sequence of tones and multisines, each as large as the limits allow on the simulated device, with a smooth lead-in
/// and lead-out. Without --want it fills the duration and is D-optimal; with --want "fc to 0.3 N, mt to 0.1 %" it is as
/// short as the wanted intervals allow.
///
/// For each parameter it prints the U95 that a run will state, the same without the errors that two runs on one rig
/// share, the scatter from run to run, and the largest source of the interval. --excite predicts a motion of yours
/// instead. -o writes the motion as a CSV, --wav as a sound file for a shaker controller; `inerter simulate --motion
/// FILE.csv` tries it out. If a wanted interval is out of reach, the best possible motion is printed and written, and
/// the exit code is 9.
///
/// The settings are those of the rig (scales, rate, and their uncertainties): --settings, --set, as elsewhere;
/// structure mass and stiffness are those of the expected device. With --json one object:
/// {"kind":"plan","parts":[..],"predicted":{..},"wants":[..]}. docs/CLI.md describes it.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recording (.mcap) or CSV file of an earlier run: its results describe the expected device, and its peaks are the
    /// limits unless you give others
    file: Option<PathBuf>,
    /// Wanted half widths of 95 % intervals, by parameter (mt, cf, fc, F0), e.g. "fc to 0.3 N, mt to 0.1 %"
    #[arg(long, value_name = "WANTS", conflicts_with = "excite")]
    want: Vec<String>,
    /// Travel of the terminal to either side of its middle
    #[arg(long, value_name = "m", allow_negative_numbers = true, help_heading = "Limits")]
    stroke_m: Option<f64>,
    /// Speed of the terminal
    #[arg(long, value_name = "m/s", allow_negative_numbers = true, help_heading = "Limits")]
    speed_m_per_s: Option<f64>,
    /// Force on the load cell
    #[arg(long, value_name = "N", allow_negative_numbers = true, help_heading = "Limits")]
    force_n: Option<f64>,
    /// Length of the motion; with --want, the longest allowed [default: 20, or that of FILE]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, help_heading = "Limits")]
    duration: Option<f64>,
    /// Lowest frequency [default: four periods within the duration]
    #[arg(long, value_name = "Hz", allow_negative_numbers = true, help_heading = "Limits")]
    lowest_hz: Option<f64>,
    /// Highest frequency [default: 16]
    #[arg(long, value_name = "Hz", allow_negative_numbers = true, help_heading = "Limits")]
    highest_hz: Option<f64>,
    /// Time in which each part rises from rest, and returns to it [default: 0.5, or a quarter of the lowest period]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, help_heading = "Limits")]
    fade_s: Option<f64>,
    /// White noise of the force in one sample, rms
    #[arg(long, value_name = "N", allow_negative_numbers = true, help_heading = "Expected device")]
    force_noise_n: Option<f64>,
    /// Device to start from: paper, worn, preloaded, presliding or stribeck
    #[arg(long, value_name = "NAME", conflicts_with = "file", help_heading = "Expected device")]
    preset: Option<String>,
    /// Predict the intervals of this motion instead of designing one, as in `inerter simulate --excite`
    #[arg(long, value_name = "MOTION")]
    excite: Option<String>,
    /// Seed of that motion, if it is random
    #[arg(long, value_name = "NUMBER", default_value_t = 1, requires = "excite")]
    seed: u64,
    #[command(flatten)]
    files: FileArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: FileSettingsArgs,
    #[command(flatten)]
    device: ExpectedArgs,
}

pub fn run(args: &Args) -> Result<(), Error> {
    args.files.check()?;
    terminal::tidy_at_interrupts();
    let asked = asked(args)?;
    let mut progress = Progress::new("planning", 1000);
    let planned = asked.planned::<Error>(|part| progress.set_part(part));
    progress.done();
    let planned = planned?;
    let written = args.files.write(&planned)?;
    planned.remarks().iter().for_each(note);
    let machine = planned.expected.settings.machine;
    if args.json {
        print_machine_json(machine, &planned.json(&written))?;
    } else {
        let files = written.iter().map(|file| file.text(machine));
        planned.text().into_iter().chain(files).try_for_each(output::line)?;
    }
    planned.missed().map_or(Ok(()), |missed| Err(missed.into()))
}

fn asked(args: &Args) -> Result<Asked, Error> {
    let overrides = args.settings.overrides()?;
    let open = |path: &PathBuf| Source::open(path, &overrides, |_| ());
    let run = args.file.as_ref().map(open).transpose()?;
    run.iter().flat_map(|run| &run.notes).for_each(note);
    Ok(Asked {
        run,
        preset: args.preset.clone(),
        given: args.device.given.clone(),
        force_noise_n: args.force_noise_n,
        overrides,
        wants: args.want.join(", "),
        motion: args.excite.clone().map(|text| (text, args.seed)),
        stroke_m: args.stroke_m,
        speed_m_per_s: args.speed_m_per_s,
        force_n: args.force_n,
        duration_s: args.duration,
        lowest_hz: args.lowest_hz,
        highest_hz: args.highest_hz,
        fade_s: args.fade_s,
    })
}
