//! `inerter send`: runs a recording or CSV through the estimator of a connected device.

use std::path::PathBuf;

use inerter_analysis::results::{LastJson, warning};
use inerter_data::{
    json::EstimateJson,
    output, text,
    words::{duration_text, plural},
};
use inerter_device::inject::{Injection, inject};
use inerter_wire::EstimatorEvent;

use super::{
    args::{FileSettingsArgs, LinkArgs},
    print::print_machine_json,
    replay::tell,
    terminal::{Progress, catch_interrupts, go_on},
};
use crate::Error;

/// Most warnings in the last line. Our estimator never gives as many.
const MOST_WARNINGS: usize = 1000;

/// Send a recording or a CSV file through a device's own estimator.
///
/// Runs faster than real time. Meanwhile the device uses the run's settings; its own are restored afterwards. Prints
/// the device's final estimate; with --json the same lines as `inerter replay --json`, except what is computed here
/// from the samples: `uncertainty`, causes among the warnings, and `advice`.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recording (.mcap) or CSV file
    file: PathBuf,
    #[command(flatten)]
    link: LinkArgs,
    #[command(flatten)]
    settings: FileSettingsArgs,
    /// Print JSON, one object per line
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let run = args.settings.open(&args.file)?;
    let machine = run.settings.machine;
    // Reject here what the device would reject, with a fuller message.
    inerter_data::settings::validate(&run.settings)?;
    // The device's settings are restored even then.
    catch_interrupts();
    let mut device = args.link.device()?;
    let mut progress = Progress::new("sending", run.samples.len() as u64);
    let started = std::time::Instant::now();
    let mut warnings = Vec::new();
    let publish = |t_s: f64, event: &EstimatorEvent| -> Result<(), Error> {
        match event {
            EstimatorEvent::Estimate(estimated) if args.json => {
                print_machine_json(machine, &EstimateJson::live(t_s, estimated, &run.settings))
            }
            EstimatorEvent::Estimate(..) => Ok(()),
            // No rows follow, so no header is needed.
            _ => {
                if warnings.len() < MOST_WARNINGS {
                    warnings.extend(warning(machine, t_s, event));
                }
                tell(machine, t_s, event, args.json, &mut false)
            }
        }
    };
    let advance = |taken| {
        progress.set(taken);
        go_on().map_err(Error::from)
    };
    let injection = Injection { settings: &run.settings, samples: &run.samples, start_s: run.start_s };
    let injected = inject(&mut device, &injection, publish, advance)?;
    progress.done();
    if args.json {
        let last = EstimateJson::last(injected.t_s, &injected.estimated, &run.settings, None);
        let line = LastJson { last, uncertainty: None, warnings, advice: None, limits: None };
        return print_machine_json(machine, &line);
    }
    output::lines(text::table(&injected.estimated, &run.settings, run.truth.as_ref()).trim_end())?;
    Ok(output::line(format!(
        "{} ({} of motion) sent to {} in {}",
        plural(injected.samples, "sample"),
        duration_text(run.duration_s()),
        device.name(),
        duration_text(started.elapsed().as_secs_f64())
    ))?)
}
