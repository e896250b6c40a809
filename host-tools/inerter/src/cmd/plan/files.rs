//! The motion as files for a shaker controller.

use std::path::{Path, PathBuf};

use inerter_analysis::plan::{Plan, PlanError};
use inerter_data::{
    csv::motion,
    names::unit,
    output::{self, OutputError},
    wav,
    words::three_digits,
};

use super::written::Written;
use crate::Error;

/// Allowed sample rates of a file \[Hz\].
const RATES_HZ: (f64, f64) = (100.0, 192_000.0);

/// What is written.
#[derive(clap::Args)]
pub struct FileArgs {
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

impl FileArgs {
    /// Rejects early what would be rejected at the end.
    pub fn check(&self) -> Result<(), Error> {
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

    /// Writes the requested files.
    pub fn write(&self, planned: &Plan) -> Result<Vec<Written>, Error> {
        let settings = &planned.expected.settings;
        let (machine, rate_hz) = (settings.machine, self.rate_hz.unwrap_or(settings.sample_rate_hz));
        let mut written = Vec::new();
        let mut add = |format, path: &Path, full_scale_m| {
            written.push(Written { format, file: path.display().to_string(), rate_hz, full_scale_m });
        };
        if self.output.is_some() || self.wav.is_some() {
            self.check_rate(rate_hz)?;
        }
        if let Some(path) = &self.output {
            motion::write(path, self.force, machine, &planned.comments(), planned.points(rate_hz))?;
            add("csv", path, None);
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
            add("wav", path, Some(full_scale_m));
        }
        Ok(written)
    }
}

fn full_scale(value: f64, wanted: &'static str) -> PlanError {
    PlanError::Limit { name: "--full-scale-m", value, wanted, help: "leave it out: full scale is then the stroke" }
}
