//! `inerter plan`: the most informative motion, its predicted intervals, and files of it for a shaker controller.

use std::path::{Path, PathBuf};

use inerter_analysis::plan::{Asked, Plan, PlanError};
use inerter_data::{
    csv::motion,
    export::Source,
    names::unit,
    output::{self, OutputError},
    wav,
    words::three_digits,
};
use serde_json::{Value, json};

use super::{
    args::FileSettingsArgs,
    plant::ExpectedArgs,
    print::print_machine_json,
    terminal::{self, Progress, note},
};
use crate::Error;

/// Allowed sample rates of a file \[Hz\].
const RATES_HZ: (f64, f64) = (100.0, 192_000.0);

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

/// Which files are written.
#[derive(clap::Args)]
struct FileArgs {
    /// Write the motion as a CSV: time, displacement, velocity and acceleration of the terminal
    #[arg(short, long, value_name = "FILE.csv", help_heading = "Files")]
    output: Option<PathBuf>,
    /// Write the displacement as a 24-bit WAV; its comment gives the displacement of full scale
    #[arg(long, value_name = "FILE.wav", help_heading = "Files")]
    wav: Option<PathBuf>,
    /// Points per second of the CSV and the WAV [default: the setting sample_rate_hz]
    #[arg(long, value_name = "Hz", allow_negative_numbers = true, help_heading = "Files")]
    rate_hz: Option<f64>,
    /// Displacement of full scale of the WAV [default: the stroke]
    #[arg(long, value_name = "m", allow_negative_numbers = true, requires = "wav", help_heading = "Files")]
    full_scale_m: Option<f64>,
    /// Replace files that exist
    #[arg(long, help_heading = "Files")]
    force: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    args.files.check()?;
    terminal::tidy_at_interrupts();
    let asked = asked(args)?;
    let mut progress = Progress::new("planning", 1000);
    let planned = asked.planned::<Error>(|part| progress.set_part(part));
    progress.done();
    let planned = planned?;
    let (files, texts): (Vec<_>, Vec<_>) = args.files.write(&planned)?.into_iter().unzip();
    planned.remarks().iter().for_each(note);
    let machine = planned.expected.settings.machine;
    if args.json {
        print_machine_json(machine, &planned.json(&files))?;
    } else {
        planned.text().into_iter().chain(texts).try_for_each(output::line)?;
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

impl FileArgs {
    /// Rejects early what would be rejected at the end.
    fn check(&self) -> Result<(), Error> {
        let files = [&self.output, &self.wav];
        let paths: Vec<&Path> = files.into_iter().flatten().map(PathBuf::as_path).collect();
        if let [one, other] = paths.as_slice()
            && one == other
        {
            return Err(OutputError::Exists { path: one.to_path_buf() }.into());
        }
        if let Some(rate_hz) = self.rate_hz {
            self.check_rate(rate_hz)?;
        }
        if let Some(value) = self.full_scale_m.filter(|value| !(value.is_finite() && *value > 0.0)) {
            return Err(full_scale(value, "more than 0 and finite").into());
        }
        if !self.force {
            paths.into_iter().try_for_each(output::refuse_existing)?;
        }
        Ok(())
    }

    fn check_rate(&self, rate_hz: f64) -> Result<(), PlanError> {
        match rate_hz {
            _ if !(RATES_HZ.0..=RATES_HZ.1).contains(&rate_hz) => {
                Err(PlanError::Rate { rate_hz, problem: "is not a valid rate of a file" })
            }
            _ if self.wav.is_some() && rate_hz.fract() != 0.0 => {
                Err(PlanError::Rate { rate_hz, problem: "is not a valid rate of a WAV, which is a whole number" })
            }
            _ => Ok(()),
        }
    }

    /// Writes the requested files; describes each for a program, and for a person.
    fn write(&self, planned: &Plan) -> Result<Vec<(Value, String)>, Error> {
        let settings = &planned.expected.settings;
        let (machine, rate_hz) = (settings.machine, self.rate_hz.unwrap_or(settings.sample_rate_hz));
        let mut written = Vec::new();
        if self.output.is_some() || self.wav.is_some() {
            self.check_rate(rate_hz)?;
        }
        if let Some(path) = &self.output {
            motion::write(path, self.force, machine, &planned.comments(), planned.points(rate_hz))?;
            let file = path.display().to_string();
            let text = format!("{file}: {rate_hz} points a second; `inerter simulate --motion` tries it out");
            written.push((json!({ "format": "csv", "file": file, "rate_hz": rate_hz }), text));
        }
        if let Some(path) = &self.wav {
            let peak_m = planned.prediction.peaks.stroke_m;
            let full_scale_m = self.full_scale_m.unwrap_or(planned.stroke_m());
            if full_scale_m < peak_m {
                return Err(full_scale(full_scale_m, "as much as the motion's own peak").into());
            }
            let metres = unit(machine, "m");
            let comment = format!(
                "displacement of the terminal; full scale (8388607) is {full_scale_m:?} {metres}, the peak {} {metres}; {}",
                three_digits(peak_m),
                planned.comments().join("; ")
            );
            let values = planned.points(rate_hz).map(|point| point.terminal_m);
            wav::write(path, self.force, rate_hz as u32, full_scale_m, &comment, values)?;
            let file = path.display().to_string();
            let text = format!("{file}: {rate_hz} Hz, 24 bits, full scale is {full_scale_m:?} {metres}");
            let line = json!({ "format": "wav", "file": file, "rate_hz": rate_hz, "full_scale_m": full_scale_m });
            written.push((line, text));
        }
        Ok(written)
    }
}

fn full_scale(value: f64, wanted: &'static str) -> PlanError {
    PlanError::Limit { name: "--full-scale-m", value, wanted, help: "leave it out: full scale is then the stroke" }
}
