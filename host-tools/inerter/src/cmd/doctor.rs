//! `inerter doctor`: finds why a device cannot be used on this machine: ports that cannot be opened, missing rules,
//! versions.

use std::{
    fs,
    io::{self, Write},
    path::Path,
};

use inerter_data::{
    json::json_line,
    output::{self, OutputError},
    words::plural,
};
use inerter_device::{
    Clock, DEFAULT_BAUD, Device, DeviceError, Port, Target,
    board::{ST_VID, USB_VID},
    dfu::{self, DfuDevice},
    list,
    udev::{install_rule, udev_rule},
    update::UpdateError,
};
use inerter_simulate::qemu_version;
use inerter_wire::WIRE_VERSION;
use miette::Diagnostic;
use serde::Serialize;

use super::{args::LinkArgs, print::Kind, terminal::note};
use crate::{Error, error::Failure};

/// Where udev looks for rules.
const RULES: [&str; 4] = ["/etc/udev/rules.d", "/run/udev/rules.d", "/usr/lib/udev/rules.d", "/lib/udev/rules.d"];

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
        return Ok(output::text(udev_rule())?);
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

/// State of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Condition {
    /// As it should be.
    Good,
    /// Not needed now, or only for some work.
    Warning,
    /// A device cannot be used in this state.
    Problem,
}

/// One thing that was checked.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct Check {
    /// What was checked.
    topic: &'static str,
    /// Its state.
    condition: Condition,
    /// What was found.
    text: String,
    /// What to do about it, if anything.
    advice: Option<String>,
}

impl Check {
    /// A check that found no problem.
    fn good(topic: &'static str, text: impl Into<String>) -> Self {
        Self { topic, condition: Condition::Good, text: text.into(), advice: None }
    }

    fn warning(topic: &'static str, text: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { topic, condition: Condition::Warning, text: text.into(), advice: Some(advice.into()) }
    }

    fn of(topic: &'static str, error: &impl Diagnostic) -> Self {
        let advice = error.help().map(|help| help.to_string());
        Self { topic, condition: Condition::Problem, text: error.to_string(), advice }
    }
}

/// Checks everything; asks the connected devices, or only `target`, for their identity.
fn examine(target: Option<&Target>) -> Vec<Check> {
    let version = format!("inerter {}, wire version {WIRE_VERSION}", env!("CARGO_PKG_VERSION"));
    let mut checks = vec![Check::good("program", version)];
    match target {
        Some(target) => checks.push(asked(target)),
        None => checks.extend(plugged_in(&list())),
    }
    checks.extend(waiting(dfu::list(), dfu::may_open));
    if cfg!(target_os = "linux") {
        checks.push(rule(&RULES.map(Path::new)));
        checks.extend(modem_manager(Path::new("/proc")));
    }
    checks.push(match qemu_version() {
        Some(version) => Check::good("simulation", version),
        None => Check::warning(
            "simulation",
            "qemu-system-arm is not installed; only `inerter simulate --qemu` needs it",
            "install Debian's qemu-system-arm, or the package of that name elsewhere",
        ),
    });
    checks
}

/// All our devices that are plugged in; if none, the ports that exist.
fn plugged_in(ports: &[Port]) -> Vec<Check> {
    let ours: Vec<Check> = ports
        .iter()
        .filter(|port| port.inerter)
        .map(|port| asked(&Target::Port { port: port.port.clone(), baud: DEFAULT_BAUD }))
        .collect();
    if !ours.is_empty() {
        return ours;
    }
    let links: Vec<&str> = ports.iter().filter(|port| port.stlink).map(|port| port.port.as_str()).collect();
    let (text, advice) = match links.first() {
        Some(link) => (
            format!("no inerter over USB; an ST-Link is at {}", links.join(", ")),
            format!("it carries a NUCLEO's UART: inerter doctor --port {link}"),
        ),
        None => (
            format!("no inerter among {}", plural(ports.len() as u64, "serial port")),
            "plug in the board's own USB connector; a charging cable without data lines does not work".to_string(),
        ),
    };
    vec![Check::warning("device", text, advice)]
}

/// Who answers at this target.
fn asked(target: &Target) -> Check {
    match Device::connect(target, Clock::new(), || false) {
        Ok(device) => {
            let hello = device.hello();
            let text = format!(
                "{} (serial {}) at {}: {}, wire version {}, {} Hz",
                hello.board,
                hello.serial,
                device.name(),
                hello.firmware,
                hello.wire_version,
                hello.sample_rate_hz
            );
            Check::good("device", text)
        }
        Err(error @ DeviceError::Permission { .. }) => {
            let check = Check::of("device", &error);
            Check {
                advice: check.advice.map(|advice| format!("{advice}; or install the rule: {}", install_rule())),
                ..check
            }
        }
        Err(error) => Check::of("device", &error),
    }
}

/// Devices in update mode, and whether this user may open them.
fn waiting(
    found: Result<Vec<DfuDevice>, UpdateError>,
    may_open: impl Fn(&DfuDevice) -> Result<(), UpdateError>,
) -> Vec<Check> {
    let check = |device: &DfuDevice| match may_open(device) {
        Ok(()) => Check::warning(
            "update mode",
            format!("a device (serial {}) is waiting for firmware", device.serial),
            "load firmware with `inerter update FILE`, or reset the device",
        ),
        Err(error) => Check::of("update mode", &error),
    };
    match found {
        Ok(devices) => devices.iter().map(check).collect(),
        Err(error) => vec![Check { condition: Condition::Warning, ..Check::of("update mode", &error) }],
    }
}

fn rule(folders: &[&Path]) -> Check {
    let needed = [USB_VID, ST_VID].map(|vendor| format!("{vendor:04x}"));
    let files = folders.iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten().flatten();
    let found = files
        .filter_map(|file| Some((file.path(), fs::read_to_string(file.path()).ok()?)))
        .find(|(_, text)| needed.iter().all(|number| text.to_lowercase().contains(number)));
    match found {
        Some((path, _)) => Check::good("udev rule", path.display().to_string()),
        None => Check::warning(
            "udev rule",
            "none for the inerter: updating needs one, and ModemManager may hold a port just after it is plugged in",
            install_rule(),
        ),
    }
}

/// ModemManager probes every new port for a modem.
fn modem_manager(proc: &Path) -> Option<Check> {
    let runs = fs::read_dir(proc)
        .ok()?
        .flatten()
        .any(|process| fs::read_to_string(process.path().join("comm")).is_ok_and(|name| name.trim() == "ModemManager"));
    runs.then(|| {
        Check::warning(
            "ModemManager",
            "is running, and opens each new serial port for some seconds unless a rule says that it is not a modem",
            "install the udev rule above, which says so",
        )
    })
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;
    use crate::hostile::{SHOWN, WORDS, board, printed, probe};

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

    #[test]
    fn a_rule_is_found_by_what_it_says() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("none");
        fs::write(folder.path().join("60-other.rules"), "ATTRS{idVendor}==\"0483\", ATTRS{idProduct}==\"df11\"\n")
            .unwrap();
        let check = rule(&[&missing, folder.path()]);
        assert_eq!(check.condition, Condition::Warning);
        assert!(check.advice.unwrap().contains("inerter doctor --udev-rule | sudo tee"));
        fs::write(folder.path().join("70-mine.rules"), udev_rule()).unwrap();
        let check = rule(&[&missing, folder.path()]);
        assert_eq!(check.condition, Condition::Good);
        assert!(check.text.ends_with("70-mine.rules"));
    }

    #[test]
    fn modem_manager_is_seen_among_the_processes() {
        let proc = tempfile::tempdir().unwrap();
        fs::create_dir(proc.path().join("17")).unwrap();
        fs::write(proc.path().join("17/comm"), "bash\n").unwrap();
        assert_eq!(modem_manager(proc.path()), None);
        fs::create_dir(proc.path().join("18")).unwrap();
        fs::write(proc.path().join("18/comm"), "ModemManager\n").unwrap();
        assert_eq!(modem_manager(proc.path()).unwrap().condition, Condition::Warning);
    }

    #[test]
    fn a_port_that_is_not_there_is_a_problem_with_advice() {
        let check = asked(&Target::Port { port: "/dev/no-such-port".into(), baud: 9600 });
        assert_eq!(check.condition, Condition::Problem);
        assert!(check.text.contains("/dev/no-such-port") && check.advice.is_some());
    }
}
