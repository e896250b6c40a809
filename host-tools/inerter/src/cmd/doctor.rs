//! `inerter doctor`: finds why a device cannot be used on this machine.

use inerter_data::output;
use inerter_device::udev;

use super::{
    args::LinkArgs,
    print::{Kind, print_json},
    terminal::note,
};
use crate::{
    Error,
    doctor::{Check, Condition, examine},
};

/// Find what prevents this machine from using a device.
///
/// Checks the ports, the udev rule and whether the versions match; says why a port cannot be opened, and which
/// `inerter.toml` is in use. Changes nothing. Ends with code 5 if a connected device cannot be used. With --json one
/// object per line:
/// {"kind":"check","topic":..,"condition":"good"|"warning"|"problem","text":..,"advice":..}
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    link: LinkArgs,
    /// Print the udev rule for Linux, which belongs in /etc/udev/rules.d
    #[arg(long)]
    udev_rule: bool,
    /// Print JSON, one object per line
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    if args.udev_rule {
        return Ok(output::text(udev::udev_rule())?);
    }
    let target = args.link.is_given().then(|| args.link.target());
    let mut checks = examine(target.as_ref());
    let typed: Vec<_> = std::env::args_os().collect();
    if let Some(file) = inerter_flags::file(&typed) {
        checks.push(Check::good("flags", format!("taken from {}", file.path.display())));
    }
    for check in &checks {
        if args.json {
            print_json(&Kind { kind: "check", of: check })?;
            continue;
        }
        let mark = match check.condition {
            Condition::Good => "ok     ",
            Condition::Warning => "note   ",
            Condition::Problem => "PROBLEM",
        };
        output::line(format!("{mark} {}: {}", check.topic, check.text))?;
        if let Some(advice) = &check.advice {
            output::line(format!("        {advice}"))?;
        }
    }
    let problems = checks.iter().filter(|check| check.condition == Condition::Problem).count();
    if problems == 0 {
        if !args.json {
            note("nothing prevents this machine from using a device");
        }
        return Ok(());
    }
    Err(Error::Doctor { problems })
}
