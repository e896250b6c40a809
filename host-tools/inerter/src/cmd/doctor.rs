//! `inerter doctor`: finds why a device cannot be used on this machine.

use std::io::{self, Write};

use inerter_data::{
    json::json_line,
    output::{self, OutputError},
};
use inerter_device::udev;

use super::{args::LinkArgs, print::Kind, terminal::note};
use crate::{
    Error,
    doctor::{Check, Condition, examine},
    error::Failure,
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
    print(&checks, args.json, &mut io::stdout().lock())?;
    let problems = checks.iter().filter(|check| check.condition == Condition::Problem).count();
    if problems > 0 {
        return Err(Failure::Doctor { problems }.into());
    }
    if !args.json {
        note("nothing prevents this machine from using a device");
    }
    Ok(())
}

/// Prints the checks, each with its advice.
fn print(checks: &[Check], json: bool, out: &mut impl Write) -> Result<(), OutputError> {
    for check in checks {
        if json {
            output::line_to(out, json_line(&Kind { kind: "check", of: check }))?;
            continue;
        }
        let mark = match check.condition {
            Condition::Good => "ok     ",
            Condition::Warning => "note   ",
            Condition::Problem => "PROBLEM",
        };
        output::line_to(out, format!("{mark} {}: {}", check.topic, check.text))?;
        if let Some(advice) = &check.advice {
            output::line_to(out, format!("        {advice}"))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use inerter_device::{dfu::DfuDevice, update::UpdateError};
    use serde_json::Value;

    use super::*;
    use crate::{
        doctor::{plugged_in, waiting},
        hostile::{SHOWN, WORDS, board, printed, probe},
    };

    #[test]
    fn no_usb_device_writes_to_the_terminal_what_it_likes() {
        // macOS names a port after the device's serial number.
        let (link, device) = (probe(WORDS), board());
        let refused = |device: &DfuDevice| Err(UpdateError::Permission { serial: device.serial.clone() });
        let checks = [
            plugged_in(&[link]),
            waiting(Ok(vec![device.clone()]), |_| Ok(())),
            waiting(Ok(vec![device]), refused),
            waiting(Err(UpdateError::Usb { reason: WORDS.into() }), |_| Ok(())),
        ]
        .concat();
        let [text, json] = printed(|json, out| print(&checks, json, out));
        // The four checks, and the port in the advice to the first one.
        assert_eq!((text.lines().count(), text.matches(SHOWN).count()), (8, 5), "{text}");
        // In JSON the same escapes represent the text itself.
        let is_whole = |line: &str| {
            let value: Value = serde_json::from_str(line).unwrap();
            value["text"].as_str().unwrap().contains(WORDS)
        };
        assert_eq!(json.lines().map(is_whole).collect::<Vec<_>>(), [true; 4], "{json}");
    }
}
